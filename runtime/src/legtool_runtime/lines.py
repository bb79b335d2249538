"""The lines of work that a bundle can hold: which files each has, and how its models are read from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from legtool_runtime.archive import read_arrays
from legtool_runtime.errors import BundleError, PerceptionError, StateError
from legtool_runtime.motion.features import FEATURE_UNITS, FEATURES, TARGET_UNITS, TARGETS
from legtool_runtime.motion.model import DEGREES, MotionModel, parameter_shapes
from legtool_runtime.robot import Robot

if TYPE_CHECKING:
    from legtool_runtime.foothold.networks import CountNetwork, FootholdNetwork
    from legtool_runtime.perception.steppability import Segmenter

#: The lines that this runtime knows, and the files of each.
LINES = {
    "motion": ("motion.npz",),
    "vfa": ("vfa.onnx",),
    "vpa": ("vpa.onnx",),
    "steppability": ("steppability.onnx",),
}
UPGRADE = "upgrade legtool-runtime"


def read_line(line: str, robot: Robot, description: Any, files: Mapping[str, bytes]) -> Any:
    """The models of a line.

    Args:
        line: one of LINES.
        robot: that they were made for.
        description: of the line, from the bundle's manifest.
        files: content of the line's files, by name.

    Raises:
        BundleError: described for another runtime, damaged, or another task's.
    """
    return _READERS[line](robot, description, files)


def motion_interface() -> dict[str, Any]:
    """Names and units of the motion models' inputs and outputs: part of the line's description, and to be the same."""
    return {
        "features": list(FEATURES),
        "feature_units": list(FEATURE_UNITS),
        "targets": {name: list(targets) for name, targets in TARGETS.items()},
        "target_units": {name: list(units) for name, units in TARGET_UNITS.items()},
    }


def _check_description(line: str, description: Any, interface: Mapping[str, Any]) -> None:
    if not isinstance(description, dict):
        raise BundleError(f"its {line} line is {short(description)}, expected its description")
    for key, value in interface.items():
        if description.get(key) != value:
            raise BundleError(f"{line} line: its {key} are not this runtime's, so it would be misread; {UPGRADE}")
    if not isinstance(description.get("metrics"), dict):
        raise BundleError(f"{line} line: metrics is missing, expected a table of them")


def _motion(robot: Robot, description: Any, files: Mapping[str, bytes]) -> MotionModel:
    _check_description("motion", description, motion_interface())
    degree = description.get("degree")
    if type(degree) is not int or degree not in DEGREES:
        raise BundleError(f"motion line: degree is {short(degree)}, expected 1 or 2")
    arrays = read_arrays(files["motion.npz"], parameter_shapes(degree), source="motion.npz")
    return MotionModel(arrays, degree=degree, instant=str(description.get("instant")), limits=_limits(description))


def _limits(description: Mapping[str, Any]) -> list[Any] | None:
    """The range of the inputs in the training data; None where a bundle does not tell that of the data itself."""
    held = description.get("range")
    if description.get("range_of") != "training data" or not isinstance(held, dict):
        return None
    return [held.get(name) for name in FEATURES]


def _vfa(robot: Robot, description: Any, files: Mapping[str, bytes]) -> FootholdNetwork:
    from legtool_runtime.foothold.networks import FootholdNetwork

    dense, criteria = _foothold("vfa", description)
    return FootholdNetwork(robot, files["vfa.onnx"], dense=dense, criteria=criteria)


def _vpa(robot: Robot, description: Any, files: Mapping[str, bytes]) -> CountNetwork:
    from legtool_runtime.foothold.networks import CountNetwork

    dense, criteria = _foothold("vpa", description)
    return CountNetwork(robot, files["vpa.onnx"], dense=dense, criteria=criteria)


def _foothold(line: str, description: Any) -> tuple[bool, Any]:
    """Whether a foothold line's network is the dense one, and the criteria that its labels were judged by."""
    from legtool_runtime.foothold.networks import KINDS, foothold_interface
    from legtool_runtime.foothold.settings import CriteriaSettings

    if isinstance(description, dict) and "roll" not in description.get("features", ["roll"]):
        raise BundleError(
            f"{line} line: its network does not know the trunk's roll and pitch; train it anew with this legtool, on "
            "data that legtool collect footholds draws now, and export that run"
        )
    _check_description(line, description, foothold_interface())
    kind, criteria = description.get("network"), description.get("criteria")
    if kind not in KINDS:
        raise BundleError(f"{line} line: network is {short(kind)}, expected one of {', '.join(KINDS)}")
    try:
        return kind == "dense", CriteriaSettings(**criteria)
    except (TypeError, StateError) as error:
        raise BundleError(f"{line} line: its criteria are not this runtime's ({one_line(error)}); {UPGRADE}") from error


def _steppability(robot: Robot, description: Any, files: Mapping[str, bytes]) -> Segmenter:
    from legtool_runtime.perception.steppability import Segmenter, Sensor, steppability_interface

    _check_description("steppability", description, steppability_interface())
    steps = description.get("preparation")
    if not isinstance(steps, list) or not all(isinstance(step, str) for step in steps):
        raise BundleError(f"steppability line: preparation is {short(steps)}, expected a list of names")
    try:
        sensor = Sensor.from_dict(description.get("sensor"))
        return Segmenter(files["steppability.onnx"], classes=description["labels"][1:], steps=steps, sensor=sensor)
    except PerceptionError as error:
        raise BundleError(f"steppability line: {error}") from error


_READERS: dict[str, Callable[[Robot, Any, Mapping[str, bytes]], Any]] = {
    "motion": _motion,
    "vfa": _vfa,
    "vpa": _vpa,
    "steppability": _steppability,
}


def short(value: Any) -> str:
    """A value in a message: not more than 80 characters of it."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def one_line(error: Exception) -> str:
    """What an error says, on one line."""
    return " ".join(str(error).split())
