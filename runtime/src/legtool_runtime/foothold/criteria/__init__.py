"""Foothold evaluation criteria: exact, and coarse (ViTAL, sections IV and V)."""

from legtool_runtime.foothold.criteria.criteria import Criteria, Footholds

__all__ = ["Criteria", "Footholds"]
