"""Stamps and sampling that cannot carry steps: refused, or told and counted."""

import numpy as np
import pytest

MS = 1_000_000
BAG = {
    "name": "bag",
    **{name: {"topic": "/odom"} for name in ("position", "orientation", "velocity", "yaw_rate")},
    "command": {"topic": "/cmd_vel"},
    "joints": {"topic": "/joint_states"},
    "contact": {"topic": "/foot_readings", "field": "force"},
}
DERIVED = {name: value for name, value in BAG.items() if name not in ("velocity", "yaw_rate")}


@pytest.fixture
def bag(tmp_path, write_log, as_motion):
    """Writes a walk as an MCAP bag; streams may be thinned out, and topics logged later."""

    def write(walk, *, keep=None, logged=None, name="bag"):
        motion = as_motion(walk)
        for stream, chosen in (keep or {}).items():
            stamps, values = getattr(motion, stream)
            motion = motion._replace(**{stream: (stamps[chosen], values[chosen])})
        return write_log("mcap", tmp_path / name, motion, logged=logged)

    return write


def test_a_sound_bag_is_taken_without_a_word(walk, bag, collect):
    manifest = collect(bag(walk), topics=BAG)
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


@pytest.mark.parametrize(
    ("logged", "refused", "topic"),
    [
        ({"/odom": 800 * MS, "/joint_states": 800 * MS, "/foot_readings": 800 * MS}, True, "/cmd_vel: has the time of"),
        ({"/cmd_vel": 1200 * MS}, True, "s before it is told"),
        ({"/odom": -300 * MS}, True, "/odom are +0.3 s"),
        ({"/odom": 250 * MS}, True, "/odom are -0.25 s"),
        ({"/foot_readings": 50 * MS}, False, "/foot_readings: header stamps are -0.0504 s"),
        ({"/joint_states": -60 * MS}, False, "/joint_states: header stamps are +0.0596 s"),
    ],
)
def test_two_clocks_are_told_apart(walk, bag, collect, logged, refused, topic):
    told = collect(bag(walk, logged=logged), topics=BAG)
    assert isinstance(told, str) == refused
    notes = told if refused else "; ".join(told["notes"])
    assert topic in notes


def test_a_clock_of_its_own_is_the_reason_why_nothing_overlaps(walk, bag, collect):
    hours = {topic: 10_000 * 10**9 for topic in ("/odom", "/joint_states", "/foot_readings")}
    told = collect(bag(walk, logged=hours), topics=BAG)
    assert "/cmd_vel: has the time of logging, those of /odom are -1e+04 s beside them" in told
    assert "stamps: log" in told


@pytest.mark.parametrize("rate", [5, 10, 12])
@pytest.mark.parametrize("stream", ["pose", "joints", "force"])
def test_streams_too_sparse_for_a_step_are_refused(walk, bag, collect, rate, stream):
    keep = {stream: slice(None, None, 200 // rate)} | (
        {"twist": slice(None, None, 200 // rate)} if stream == "pose" else {}
    )
    for topics in (BAG, DERIVED) if stream == "pose" else (BAG,):
        told = collect(bag(walk, keep=keep, name=topics["name"] + str(len(topics))), topics=topics)
        assert isinstance(told, str) and "ms apart, a step takes 0.3" in told and "too sparse" in told, told


@pytest.mark.parametrize("seed", [1, 2])
def test_at_20_hz_with_jitter_no_velocity_is_zero(walk, bag, collect, steps_of, seed):
    rng = np.random.default_rng(seed)
    chosen = np.arange(2, len(walk["stamps"]) - 2, 10) + rng.integers(
        -1, 2, len(np.arange(2, len(walk["stamps"]) - 2, 10))
    )
    manifest = collect(bag(walk, keep={"pose": chosen, "twist": chosen}), topics=DERIVED)
    assert any("50 ms apart" in note for note in manifest["notes"])
    table = steps_of(manifest)
    assert len(table) >= 30 and (table.filter(like="velocity_x").abs() > 0.05).all().all()


@pytest.mark.parametrize("length", [15, 30])
def test_dropouts_of_the_pose_are_gaps(walk, bag, collect, steps_of, length):
    n = len(walk["stamps"])
    gone = np.zeros(n, dtype=bool)
    for start in range(300, n - 100, 400):
        gone[start : start + length] = True
        gone[start + length + 1 : start + 2 * length] = True  # one row alone, without any neighbour
    manifest = collect(bag(walk, keep={"pose": ~gone, "twist": ~gone}), topics=DERIVED)
    assert manifest["counts"]["gaps"] >= 4
    assert manifest["counts"]["rows_without_neighbour"] >= 4
    assert (steps_of(manifest).filter(like="velocity_x").abs() > 0.05).all().all()


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_command_that_stops_is_not_held(walk, bag, collect, share):
    count = int(share * len(walk["stamps"]) / 4)
    manifest = collect(bag(walk, keep={"command": slice(0, count)}), topics=BAG)
    assert manifest["counts"]["rows_with_stale_command"] == pytest.approx(2400 * (1 - share) - 200, abs=5)
    assert any("/cmd_vel): came every 20 ms and stopped" in note for note in manifest["notes"])
    forever = {**BAG, "command": {"topic": "/cmd_vel", "max_age_s": 1000.0}}
    assert (
        "rows_with_stale_command"
        not in collect(bag(walk, keep={"command": slice(0, count)}, name="b"), topics=forever)["counts"]
    )


def test_a_command_that_is_sent_on_change_is_held(walk, bag, collect):
    command = walk["command"][::4]
    changes = np.concatenate([[True], (np.diff(command, axis=0) != 0).any(axis=1)])
    manifest = collect(bag(walk, keep={"command": changes}), topics=BAG)
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


@pytest.mark.parametrize(("digits", "refused"), [(2, True), (1, True), (3, False)])
def test_rounded_stamps_are_counted_and_refused(walk, write_csv, collect, topics_of, digits, refused):
    told = collect(write_csv(walk, digits=digits), topics=topics_of())
    assert isinstance(told, str) == refused
    if refused:
        assert "repeat an earlier stamp" in told and "stamps rounded" in told


def test_float32_stamps_are_named(walk, write_csv, collect, topics_of):
    walk["stamps"] = (walk["stamps"] * 1e-9).astype(np.float32).astype(np.float64).astype(np.int64) * 10**9
    walk["stamps"][1200:] += 128 * 10**9
    told = collect(write_csv(walk), topics=topics_of())
    assert "are they float32?" in told


@pytest.mark.parametrize(
    ("scale", "unit", "expected"),
    [
        (10**6, "s", "is the time in ms or finer"),
        (10**9, "ms", "is the time in s or coarser|coarser unit"),
        (10**9, "us", "coarser"),
    ],
)
def test_the_unit_of_time_is_named(walk, write_csv, collect, topics_of, scale, unit, expected):
    import re

    walk["stamps"] -= 1_699_999_000 * 10**9  # since boot
    told = collect(write_csv(walk, scale=scale), topics=topics_of(csv={"stamp_unit": unit}))
    assert isinstance(told, str) and re.search(expected, told), told


def test_rows_that_come_late_are_sorted_in_and_counted(walk, write_csv, collect, topics_of):
    truth = collect(write_csv(walk), topics=topics_of())
    order = np.arange(len(walk["stamps"]))
    for at in (500, 900, 1300):
        order[at : at + 40] = np.roll(order[at : at + 40], -1)
    walk = {name: values[order] for name, values in walk.items()}
    manifest = collect(write_csv(walk, name="late.csv"), topics=topics_of())
    assert manifest["counts"]["steps"] == truth["counts"]["steps"]
    assert manifest["counts"]["disordered_position"] == 3
