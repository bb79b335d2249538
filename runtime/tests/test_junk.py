"""Whatever the runtime is given, it answers in its own errors, on one line that is not too long."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from legtool_runtime import LegtoolError, MotionState, Robot, load_bundle
from legtool_runtime.bundle import MANIFEST, content_sha256
from legtool_runtime.errors import BundleError
from legtool_runtime.motion.planning.planner import Goal, Planner, PlannerSettings
from legtool_runtime.perception.camera import Camera
from legtool_runtime.terrain import HeightMap, foot_costmap
from legtool_runtime.terrain.elevation import ElevationGrid

JUNK = [
    None, "a", b"x", "a\nb" * 99, 1, -1, True, 1e300, 10**400, float("nan"), float("inf"), [], {}, [1], [[1, 2], [3]],
    object(), np.zeros(0), np.zeros((3, 3)), np.full(3, np.nan), np.array(["a"]), np.zeros((2, 2), complex),
    np.zeros((4, 3)), np.zeros(1000), np.array([None] * 3), [1e300] * 3, [float("nan")] * 3, np.eye(4) * 1e300,
    (1, 2, "x"), len,
]  # fmt: skip
LONGEST = 400


def calls(path: Path) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Functions of the runtime, each with arguments that it takes."""
    bundle = load_bundle(path)
    robot, motion = bundle.robot, bundle.motion
    rest = [0.0, 0.0, 0.0]
    state = {"velocity": rest, "previous_velocity": rest, "previous_reference": rest, "feet_base": robot.stance}
    now = MotionState(**state, swing_pair=0)
    heights = HeightMap(np.zeros((60, 60), np.float32), 0.02, (0.0, 0.0))
    planner, grid = Planner(motion, robot, settings=PlannerSettings(horizon=3)), ElevationGrid()
    looking = np.eye(4)
    looking[:3, :3], looking[2, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], 0.4
    return {
        "state": (MotionState, {**state, "swing_pair": 0}),
        "predict": (motion.predict, {"state": now, "commands": [[0.1, 0, 0]]}),
        "covariance": (motion.covariance, {"state": now, "commands": [[0.1, 0, 0]]}),
        "goal": (Goal, {"x": 1.0, "y": 0.0, "heading": 0.0, "max_speed": 0.3}),
        "plan": (
            planner.plan,
            {
                "state": now,
                "costmap": foot_costmap(heights),
                "position": [0.0, 0.0, robot.standing_height],
                "rotation": np.eye(3),
                "goal": Goal(0.5, 0.0),
            },
        ),
        "map": (HeightMap, {"heights": np.zeros((9, 9), np.float32), "resolution_m": 0.02, "center": (0.0, 0.0)}),
        "costmap": (foot_costmap, {"heights": heights}),
        "camera": (Camera, {"width": 64, "height": 48, "fx": 40.0, "fy": 40.0, "cx": 32.0, "cy": 24.0}),
        "feet": (robot.feet, {"joint_positions": np.zeros((4, 3))}),
        "joints": (robot.joints, {"feet_base": robot.stance}),
        "robot": (Robot, {name: getattr(robot, name) for name in robot.to_dict()}),
        "move_to": (grid.move_to, {"center": [0.0, 0.0]}),
        "update": (
            grid.update,
            {
                "depth": np.ones((48, 64), np.float32),
                "intrinsics": [40.0, 40.0, 32.0, 24.0],
                "transform_camera_to_world": looking,
                "time_s": 1.0,
            },
        ),
        "load": (load_bundle, {"path": str(path)}),
    }


def test_junk_in_any_argument_is_answered_in_one_line(write_bundle):
    for name, (function, arguments) in calls(write_bundle()).items():
        function(**arguments)
        for argument in arguments:
            for junk in JUNK:
                try:
                    function(**{**arguments, argument: junk})
                except LegtoolError as error:
                    told = (
                        str(error).replace(str(junk), "") if name == "load" else str(error)
                    )  # a path is told as given
                    assert "\n" not in told and len(told) < LONGEST, (name, argument, junk)


FORGED = {
    "a link of 1000 km": {"thigh_length": [1e6] * 4},
    "a link of an atom": {"shank_length": [1e-9] * 4},
    "a foot of an atom": {"foot_radius": 1e-9},
    "a foot of 400 digits": {"foot_radius": 10**400},
    "a hip of 400 digits": {"hips": [[10**400, 0, 0]] * 4},
    "hips far away": {"hips": [[1e9, 0, 0]] * 4},
    "feet far away": {"stance": [[1e9, 0, -0.3]] * 4},
    "feet above the base": {"stance": [[0.2, 0.1, 0.3]] * 4},
    "joints that turn forever": {"joint_limits": [[[-1e9, 1e9]] * 3] * 4},
    "a name of a page": {"name": "x" * 100_000},
    "a name with markup": {"name": "a\n# heading <script>"},
    "no name": {"name": None},
}


def reseal(path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of a bundle with something else in its manifest, and a digest that says nothing was altered."""
    forged = path.with_name("forged")
    shutil.rmtree(forged, ignore_errors=True)
    shutil.copytree(path, forged)
    manifest = json.loads((forged / MANIFEST).read_text())
    change(manifest)
    manifest["content_sha256"] = content_sha256(manifest)
    (forged / MANIFEST).write_text(json.dumps(manifest))
    return forged


@pytest.mark.parametrize("change", FORGED.values(), ids=FORGED)
def test_a_forged_robot_is_refused(change, write_bundle):
    with pytest.raises(BundleError) as told:
        load_bundle(reseal(write_bundle(), lambda manifest: manifest["robot"].update(change)))
    assert len(str(told.value)) < LONGEST + 200 and "\n" not in str(told.value)


@pytest.mark.parametrize(
    "change",
    [
        {"range_of": "training data", "range": {}},
        {"degree": 10**400},
        {"instant": [1] * 10_000},
        {"metrics": {"a": {"value": 10**400, "ci95": None, "n": 1, "unit": "m"}}},
        {"metrics": {"a": 1}},
        {"metrics": {"<script>": {"value": 1, "ci95": None, "n": 1, "unit": "m"}}},
        {"metrics": {"a": {"value": 1, "ci95": [1], "n": 1, "unit": "m"}}},
        {"metrics": {"a": {"value": 1, "ci95": [], "n": 1, "unit": "m"}}},
        {"metrics": {"a": {"value": 1, "ci95": None, "n": 1, "unit": "m" * 99}}},
    ],
)
def test_a_forged_line_is_refused(change, write_bundle):
    with pytest.raises(BundleError):
        load_bundle(reseal(write_bundle(), lambda manifest: manifest["lines"]["motion"].update(change)))
