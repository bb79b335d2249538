"""Learned motion models: features, prediction, planning over velocity commands."""
