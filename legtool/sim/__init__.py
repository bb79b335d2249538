"""MuJoCo: robots, worlds, and the controllers that walk in them."""
