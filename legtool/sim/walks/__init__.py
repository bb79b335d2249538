"""Closed loops: robot, world, sensors, controller and planner, tick by tick."""
