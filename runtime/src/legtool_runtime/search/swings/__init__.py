"""Swing optimisation: motions of the whole robot between stances (QuadPiPS, section VI-D)."""
