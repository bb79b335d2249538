"""Recordings of any kind as rows on one clock: bags, MCAP, CSV."""
