"""Terrain around the robot: the elevation grid that depth images are fused into, and the foot costmap made from it."""
