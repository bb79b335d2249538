"""Worlds of primitive shapes, and everything that is derived from one: physics, rays, heights, faces, labels."""
