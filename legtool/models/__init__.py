"""Estimators and network definitions; no I/O, no loops."""
