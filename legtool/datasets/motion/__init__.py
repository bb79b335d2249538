"""Recordings cut into steps, and the motion models' runs."""
