"""Robots in MuJoCo: from lengths and masses, or from the user's own MJCF."""
