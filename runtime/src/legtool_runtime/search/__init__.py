"""Searches of QuadPiPS (sections VI-B and VI-C): planar regions to footholds, torso path, stances and contact plan."""
