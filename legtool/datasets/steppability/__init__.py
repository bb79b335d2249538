"""Labelled scenes and real depth frames, and the segmenter's runs."""
