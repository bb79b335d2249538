"""The runtime on recorded walks: ``legtool replay``."""
