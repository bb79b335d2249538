"""Collecting data: one file per stage, each a plain function."""
