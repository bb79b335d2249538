"""Tracking of planned footholds: a preview of contact forces over whole-body control of a floating-base robot."""
