"""What a robot measures: its depth camera, its state, and their errors."""
