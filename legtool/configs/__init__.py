"""Typed settings and their YAML presets."""
