"""Labelled heightmaps, and the foothold networks' runs."""
