"""Worlds times planners times trials."""
