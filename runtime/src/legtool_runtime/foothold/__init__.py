"""Footholds after ViTAL: exact evaluation criteria, foothold selection (VFA) and body pose optimisation (VPA)."""

from legtool_runtime.foothold.criteria.criteria import Criteria, Footholds
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, CriteriaSettings, hip_heights
from legtool_runtime.foothold.tuples import Tuple

__all__ = ["RESOLUTION_M", "SIZE", "Criteria", "CriteriaSettings", "Footholds", "Gait", "Tuple", "hip_heights"]
