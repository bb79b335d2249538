"""The part of legtool that runs on the robot: it loads a bundle and plans, without torch."""
