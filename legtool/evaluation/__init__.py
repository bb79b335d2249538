"""Metrics, results and reports."""
