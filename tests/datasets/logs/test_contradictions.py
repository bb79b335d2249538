"""Signals that contradict each other: logs that used to be taken in silently wrong."""

import re

import numpy as np
import pytest
import yaml

from legtool.configs.log import LogSettings
from legtool.errors import LogError
from legtool.pipeline.log import collect_log

DEGREES = 180 / np.pi


def test_a_sound_walk_is_taken_without_a_word(walk, write_csv, collect, topics_of):
    manifest = collect(write_csv(walk), topics=topics_of())
    assert manifest["counts"]["steps"] >= 35
    assert "notes" not in manifest


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda v: v * [-1, -1, 1], r"base frame with both signs turned"),
        (lambda v: v * [1, -1, 1], r"base frame with the sign of y turned"),
        (lambda v: v[:, [1, 0, 2]], r"base frame with x and y swapped"),
        (lambda v: v * 1000, r"moves at .* m/s, expected below 10 m/s.*in millimetres"),
        (lambda v: v * 100, r"moves at .* m/s|base frame in cm/s: set velocity: \{unit: cm/s\}"),
    ],
)
def test_velocity_must_agree_with_the_position(walk, write_csv, collect, topics_of, change, expected):
    walk["velocity"] = change(walk["velocity"])
    told = collect(write_csv(walk), topics=topics_of())
    assert isinstance(told, str) and "velocity (walk.csv" in told
    assert re.search(expected, told), told


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.0])
def test_velocity_in_the_world_frame_is_named(make_walk, write_csv, collect, topics_of, heading):
    walk = make_walk(seed=3, heading=heading)
    yaw = 2 * np.arctan2(walk["orientation"][:, 2], walk["orientation"][:, 3])
    c, s = np.cos(yaw), np.sin(yaw)
    vx, vy = walk["velocity"][:, 0], walk["velocity"][:, 1]
    walk["velocity"] = np.column_stack([c * vx - s * vy, s * vx + c * vy, 0 * vx])
    log = write_csv(walk)
    assert "agrees in the world frame: set velocity: {frame: world}" in collect(log, topics=topics_of())
    assert collect(log, topics=topics_of(velocity={"frame": "world"}))["counts"]["steps"] >= 35


def test_velocity_in_the_base_frame_declared_as_world_is_named(walk, write_csv, collect, topics_of):
    told = collect(write_csv(walk), topics=topics_of(velocity={"frame": "world"}))
    assert "agrees in the base frame: set velocity: {frame: base}" in told


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda w: w * DEGREES, r"agrees in deg/s: set yaw_rate: {unit: deg/s}"),
        (lambda w: -w, "agrees with its sign turned"),
        (lambda w: -w * DEGREES, "agrees in deg/s with its sign turned"),
    ],
)
def test_the_yaw_rate_must_agree_with_the_orientation(walk, write_csv, collect, topics_of, change, expected):
    walk["yaw_rate"] = change(walk["yaw_rate"])
    told = collect(write_csv(walk), topics=topics_of())
    assert isinstance(told, str) and told.startswith(str(write_csv(walk))) and expected in told


@pytest.mark.parametrize("signals", [("velocity",), ("velocity", "yaw_rate")])
def test_a_twist_that_was_never_filled_is_told_and_derived(walk, write_csv, collect, topics_of, signals):
    truth = collect(write_csv(walk), topics=topics_of())
    for signal in signals:
        walk[signal][:] = 0.0
    manifest = collect(write_csv(walk), topics=topics_of())
    assert manifest["counts"]["steps"] == truth["counts"]["steps"]
    assert [note for note in manifest["notes"] if "never filled; it was derived" in note] == manifest["notes"]
    assert len(manifest["notes"]) == len(signals)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda c: c * [1, 1, DEGREES], r"yaw rate is up to .* deg/s\? set command: {yaw_unit: deg/s}"),
        (lambda c: 0 * c, "is 0 throughout, while the robot walks at 0."),
        (lambda c: c * [1, 1, -1], "the other way; correct its sign"),
        (lambda c: c[:, [1, 0, 2]], "matches the motion with x and y swapped"),
        (lambda c: c * [-1, 1, 1], "matches the motion with the sign of x turned"),
    ],
)
def test_the_command_must_agree_with_the_motion(walk, write_csv, collect, topics_of, change, expected):
    walk["command"] = change(walk["command"])
    told = collect(write_csv(walk), topics=topics_of())
    assert isinstance(told, str) and "command (walk.csv" in told
    assert re.search(expected, told), told


def test_a_slow_turn_told_in_degrees_is_named_too(walk, write_csv, collect, topics_of):
    walk["command"] = walk["command"] * [1, 1, DEGREES / 10]
    walk["orientation"][:] = [0, 0, 0, 1]  # it walks without the turns, at a tenth of those told
    yaw = np.cumsum(walk["yaw_rate"][:, 0]) / 2000
    walk["orientation"] = np.column_stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)])
    topics = topics_of("position", "orientation", "command", "feet", "contact")
    assert "is it in deg/s? set command: {yaw_unit: deg/s}" in collect(write_csv(walk), topics=topics)


@pytest.mark.parametrize("rows", [120, 200])
def test_a_robot_that_moves_before_it_is_told_has_another_clock(walk, write_csv, collect, topics_of, rows):
    walk["command"] = np.concatenate([walk["command"][:1].repeat(rows, axis=0), walk["command"][:-rows]])
    told = collect(write_csv(walk), topics=topics_of())
    assert "s before it is told" in told and "another clock" in told


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda f: f * [1, -1, 1], r"right of the trunk's middle.*is y positive to the right"),
        (lambda f: f[:, [1, 0, 3, 2]], r"right of the trunk's middle.*legs: \[FR, FL, RR, RL\]"),
        (lambda f: f[:, [2, 3, 0, 1]], r"in another order of the legs.*legs: \[RL, RR, FL, FR\]|behind the hind"),
        (lambda f: f[:, [0, 2, 1, 3]], r"in another order of the legs .* set legs: \[FL, RL, FR, RR\]"),
        (lambda f: f[:, [1, 2, 0, 3]], r"in another order of the legs .* set legs: \[FR, RL, FL, RR\]"),
        (lambda f: f * [1, 1, -1], "below its hip"),
    ],
)
def test_feet_must_be_where_their_legs_are(walk, write_csv, collect, topics_of, change, expected):
    walk["feet"] = change(walk["feet"].reshape(-1, 4, 3)).reshape(-1, 12)
    told = collect(write_csv(walk), topics=topics_of())
    assert isinstance(told, str) and re.search(expected, told), told


def test_the_order_of_legs_that_is_proposed_is_the_right_one(walk, write_csv, collect, topics_of):
    truth = collect(write_csv(walk), topics=topics_of())
    walk["feet"] = walk["feet"].reshape(-1, 4, 3)[:, [1, 2, 0, 3]].reshape(-1, 12)
    manifest = collect(write_csv(walk), topics=topics_of(feet={"legs": ["FR", "RL", "FL", "RR"]}))
    assert manifest["counts"]["steps"] == truth["counts"]["steps"]


@pytest.mark.parametrize(
    ("unit", "change", "expected"),
    [
        ("rad", lambda q: q * DEGREES, r"angles reach .* degrees\? set joints: {unit: deg}"),
        ("deg", lambda q: q, r"angles reach .* radians\? set joints: {unit: rad}"),
        ("rad", lambda q: q.reshape(-1, 4, 3)[:, :, [2, 0, 1]].reshape(-1, 12), "check --robot, the order of joints"),
    ],
)
def test_joint_angles_must_fit_the_legs(walk, write_csv, collect, topics_of, unit, change, expected):
    walk["joints"] = change(walk["joints"])
    topics = topics_of("position", "orientation", "command", "joints", "contact", joints={"unit": unit})
    told = collect(write_csv(walk), topics=topics)
    assert isinstance(told, str) and re.search(expected, told), told


@pytest.mark.parametrize("at", ["same", "copy"])
def test_a_recording_that_is_given_twice_is_refused(walk, write_csv, collect, topics_of, at):
    first = write_csv(walk)
    second = first if at == "same" else write_csv(walk, name="again.csv")
    assert "are the same recording (equal SHA-256)" in collect(first, second, topics=topics_of())
    other = write_csv({**walk, "stamps": walk["stamps"] + 10**11}, name="other.csv")
    assert collect(first, other, topics=topics_of())["counts"]["logs"] == 2


@pytest.mark.parametrize(
    ("order", "legs"),
    [([1, 0, 3, 2], "FR, FL, RR, RL"), ([2, 3, 0, 1], "RL, RR, FL, FR"), ([3, 2, 1, 0], "RR, RL, FR, FL")],
)
def test_joints_of_other_legs_show_in_turns(make_walk, write_csv, collect, topics_of, order, legs):
    walk = make_walk(seed=5, seconds=20.0)
    walk["joints"] = walk["joints"].reshape(-1, 4, 3)[:, order].reshape(-1, 12)
    walk["contact"] = walk["contact"][:, order]
    signals = ("position", "orientation", "command", "joints", "contact")
    told = collect(write_csv(walk), topics=topics_of(*signals))
    assert isinstance(told, str) and f"set legs: [{legs}]" in told, told
    fixed = topics_of(*signals, joints={"legs": legs.split(", ")}, contact={"legs": legs.split(", ")})
    assert collect(write_csv(walk), topics=fixed)["counts"]["steps"] >= 60


@pytest.mark.parametrize("lengths", [(0.3, 0.3), (0.115, 0.115)])
def test_another_robots_legs_make_stance_feet_move(tmp_path, walk, write_csv, collect, topics_of, lengths):
    mine = {
        "name": "mine",
        "hip_x": [0.1934, -0.1934],
        "hip_y": 0.0465,
        "abduction_offset": 0.0955,
        "knee_sign": [-1, -1],
    }
    (tmp_path / "mine.yaml").write_text(
        yaml.safe_dump({**mine, "thigh_length": lengths[0], "shank_length": lengths[1]})
    )
    topics = topics_of("position", "orientation", "velocity", "yaw_rate", "command", "joints", "contact")
    told = collect(write_csv(walk), topics=topics, robot=str(tmp_path / "mine.yaml"))
    notes = told if isinstance(told, str) else "; ".join(told.get("notes", []))
    assert "of the trunk's travel" in notes and "check the lengths of mine" in notes


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_a_recording_that_is_given_again_in_another_format_is_refused(
    tmp_path, walk, as_motion, write_log, collect, kind
):
    first = write_log("db3", tmp_path / "first", as_motion(walk))
    again = write_log(kind, tmp_path / "again", as_motion(walk))
    assert "holds the same steps as" in collect(first, again)


@pytest.mark.parametrize("wrong", ["velocity", "feet"])
def test_a_refusal_in_the_second_log_does_not_block_the_corrected_command(
    tmp_path, walk, make_walk, write_csv, topics_of, wrong
):
    later = make_walk(seed=8)
    good = write_csv({**later, "stamps": later["stamps"] + 10**11}, name="good.csv")
    truth = walk[wrong].copy()
    walk[wrong] = -walk[wrong]
    topics = tmp_path / "topics.yaml"
    topics.write_text(yaml.safe_dump(topics_of()))
    settings = LogSettings(robot="go2", topics=str(topics))
    with pytest.raises(LogError):
        collect_log([good, write_csv(walk)], settings, tmp_path / "data")
    assert not list((tmp_path / "data").iterdir())
    walk[wrong] = truth
    manifest = collect_log([good, write_csv(walk)], settings, tmp_path / "data")
    assert manifest["complete"] and manifest["counts"]["logs"] == 2
