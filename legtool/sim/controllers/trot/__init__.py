"""The built-in blind trotting controller."""
