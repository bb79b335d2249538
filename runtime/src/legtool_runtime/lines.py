"""The lines of work that a bundle can hold: which files each has, and how its models are read from them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from legtool_runtime.archive import read_arrays
from legtool_runtime.checks import Bounds
from legtool_runtime.errors import BundleError, PerceptionError, StateError, shown
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
_METRIC, _MOST_LETTERS = re.compile(r"[\w.,;=+\[\] -]{1,200}"), 40
_FIGURE = Bounds(-1e300, 1e300)
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
        raise BundleError(f"its {line} line is {shown(description)}, expected its description")
    for key, value in interface.items():
        if description.get(key) != value:
            raise BundleError(f"{line} line: its {key} are not this runtime's, so it would be misread; {UPGRADE}")
    metrics = description.get("metrics")
    if not isinstance(metrics, dict):
        raise BundleError(f"{line} line: metrics is missing, expected a table of them")
    for name, metric in metrics.items():
        if not _METRIC.fullmatch(name) or not _is_metric(metric):
            raise BundleError(
                f"{line} line: metric {shown(name)} is {shown(metric)}, expected value, unit, n and ci95 by a name"
            )


def _is_metric(metric: Any) -> bool:
    """Whether it holds a figure as an evaluation writes it."""
    if not isinstance(metric, dict) or not metric.keys() >= {"value", "unit", "n", "ci95"}:
        return False
    ends = metric["ci95"] if metric["ci95"] is not None else [0.0, 0.0]
    if not isinstance(ends, list) or len(ends) != 2 or not isinstance(metric["unit"], str):
        return False
    return len(metric["unit"]) <= _MOST_LETTERS and all(_FIGURE.hold(x) for x in (metric["value"], metric["n"], *ends))


def _motion(robot: Robot, description: Any, files: Mapping[str, bytes]) -> MotionModel:
    _check_description("motion", description, motion_interface())
    degree = description.get("degree")
    if type(degree) is not int or degree not in DEGREES:
        raise BundleError(f"motion line: degree is {shown(degree)}, expected 1 or 2")
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
        raise BundleError(f"{line} line: network is {shown(kind)}, expected one of {', '.join(KINDS)}")
    try:
        return kind == "dense", CriteriaSettings(**criteria)
    except (TypeError, StateError) as error:
        raise BundleError(f"{line} line: its criteria are not this runtime's ({shown(error)}); {UPGRADE}") from error


def _steppability(robot: Robot, description: Any, files: Mapping[str, bytes]) -> Segmenter:
    from legtool_runtime.perception.steppability import Segmenter, Sensor, steppability_interface

    _check_description("steppability", description, steppability_interface())
    steps = description.get("preparation")
    if not isinstance(steps, list) or not all(isinstance(step, str) for step in steps):
        raise BundleError(f"steppability line: preparation is {shown(steps)}, expected a list of names")
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
