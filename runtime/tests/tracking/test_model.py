from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from legtool_runtime.errors import RobotError
from legtool_runtime.tracking.model import TrackedRobot


def test_description_survives_json(tracked: TrackedRobot) -> None:
    again = TrackedRobot.from_dict(json.loads(json.dumps(tracked.to_dict())))
    assert again.to_dict() == tracked.to_dict()
    assert again.mass == tracked.mass


def test_mass_centre_and_inertia_are_those_of_all_bodies(tracked: TrackedRobot) -> None:
    geometry = tracked.geometry
    angles, _ = geometry.joints(geometry.stance)
    masses, places, inertias = [tracked.trunk_mass], [tracked.trunk_com], [tracked.trunk_inertia]
    for leg in range(4):
        hip, pitch = angles[leg, 0], np.cumsum(angles[leg, 1:])
        c, s = np.cos(hip), np.sin(hip)
        abduction = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        joint, turn = geometry.hips[leg].copy(), abduction
        ends = [[0, geometry.abduction_offset[leg], 0], [0, 0, -geometry.thigh_length[leg]], [0, 0, 0]]
        for link in range(3):
            if link:
                c, s = np.cos(pitch[link - 1]), np.sin(pitch[link - 1])
                turn = abduction @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
            masses.append(tracked.link_mass[leg, link])
            places.append(joint + turn @ tracked.link_com[leg, link])
            inertias.append(turn @ tracked.link_inertia[leg, link] @ turn.T)
            joint = joint + turn @ np.array(ends[link])
    com = np.average(places, axis=0, weights=masses)
    inertia = sum(
        inertia + mass * ((place - com) @ (place - com) * np.eye(3) - np.outer(place - com, place - com))
        for mass, place, inertia in zip(masses, places, inertias, strict=True)
    )
    assert np.isclose(tracked.mass, sum(masses))
    np.testing.assert_allclose(tracked.com, com, atol=1e-12)
    np.testing.assert_allclose(tracked.inertia, inertia, atol=1e-12)


@pytest.mark.parametrize("limit", [np.inf, np.nan, 0.0, -1.0])
def test_robot_without_a_torque_limit_is_refused(tracked: TrackedRobot, limit: float) -> None:
    limits = tracked.torque_limit.copy()
    limits[2, 1] = limit
    with pytest.raises(RobotError, match="torque limit of RL thigh"):
        replace(tracked, torque_limit=limits)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("trunk_mass", 0.0, "positive mass"),
        ("trunk_com", [0.0, np.nan, 0.0], "not finite"),
        ("link_com", np.zeros((4, 3)), "shape"),
        ("link_mass", np.full((4, 3), -1.0), "negative"),
        ("trunk_inertia", np.zeros((3, 3)), "positive about every axis"),
        ("link_inertia", np.tile(np.diag([1.0, 1.0, -1.0]), (4, 3, 1, 1)), "symmetric and not negative"),
    ],
)
def test_impossible_robot_is_refused(tracked: TrackedRobot, field: str, value: object, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        replace(tracked, **{field: value})


def test_incomplete_description_is_refused(tracked: TrackedRobot) -> None:
    data = tracked.to_dict()
    del data["armature"]
    with pytest.raises(RobotError, match="missing \\['armature'\\]"):
        TrackedRobot.from_dict(data)
    with pytest.raises(RobotError, match="unknown \\['colour'\\]"):
        TrackedRobot.from_dict({**tracked.to_dict(), "colour": "red"})
