"""Footstep planning over velocity commands (motion paper, section III)."""
