"""What is on disk: recordings, transitions, and the dataset store."""
