import dataclasses
from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from legtool.configs.motion import TransitionSettings
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.datasets.motion.samples import motion_data
from legtool.datasets.motion.steps import FOOT_DISPLACEMENT
from legtool.datasets.motion.transitions import check_enough, cut_transitions
from legtool.errors import DatasetError, LogError
from legtool_runtime.robot import TROT_PAIRS

STANCE = np.array([[0.24, 0.13, -0.35], [0.24, -0.13, -0.35], [-0.24, 0.13, -0.35], [-0.24, -0.13, -0.35]])
SWING_S, FULL_S = 0.26, 0.08
SETTINGS = TransitionSettings()


def trot(
    steps=40,
    *,
    speed=0.4,
    rate=200,
    forces=True,
    rest_s=0.2,
    order=TROT_PAIRS,
    swing_s=SWING_S,
    stride=None,
    noise=0.0,
    full_s=FULL_S,
):
    """A body at constant speed over feet that step, each group in ``order`` in its turn."""
    feet = STANCE.copy()
    feet[:, 2] = 0.0
    stride = 2 * speed * (swing_s + full_s) if stride is None else stride
    world, load, command = [], [], []

    def hold(seconds, lifted=(), vx=speed):
        n = round(seconds * rate)
        start = feet.copy()
        for k in range(1, n + 1):
            at = start.copy()
            for leg in lifted:
                at[leg, 0] += stride * k / n
                at[leg, 2] = 0.08 * np.sin(np.pi * k / n)
            world.append(at)
            load.append([0.0 if leg in lifted else 120.0 / (4 - len(lifted)) * 2 for leg in range(4)])
            command.append([vx, 0.0, 0.0])
        for leg in lifted:
            feet[leg, 0] += stride

    hold(rest_s, vx=0.0)
    for step in range(steps):
        hold(swing_s, order[step % len(order)])
        hold(full_s)
    n = len(world)
    time = np.arange(n) / rate
    position = np.zeros((n, 3))
    moving = np.array(command)[:, 0] != 0
    position[:, 0] = np.cumsum(moving * speed) / rate
    position[:, 2] = 0.35
    rng = np.random.default_rng(0)
    force = np.array(load) + noise * rng.standard_normal((n, 4))
    return Recording(
        name="trot",
        stamps_ns=np.round(time * 1e9).astype(np.int64) + 10**18,
        position_world=position,
        orientation=np.tile([1.0, 0, 0, 0], (n, 1)),
        velocity_base=np.column_stack([moving * speed, np.zeros(n), np.zeros(n)]),
        yaw_rate=np.zeros(n),
        command=np.array(command),
        feet_base=np.array(world) - position[:, None],
        contact_force=force if forces else None,
    )


def statuses(table):
    return Counter(table["status"].to_pylist())


def test_forces_tell_the_steps_their_pairs_and_what_feet_and_trunk_did():
    table, counts = cut_transitions([trot(noise=2.0)], SETTINGS)
    data = motion_data(table)
    assert counts["steps"] == 38  # the first has no step before it, the last is cut off by the recording's end
    assert table["swing_pair"].to_pylist()[:4] == [0, 1, 0, 1]
    np.testing.assert_allclose(data.targets["fdm"][:, [0, 3]], 0.272, atol=1e-3)
    np.testing.assert_allclose(data.targets["cdm"][:, 0], 0.136, atol=3e-3)
    np.testing.assert_allclose(data.stance_motion, 0.0, atol=1e-3)
    np.testing.assert_allclose(table["duration_s"].to_numpy(), SWING_S + FULL_S, atol=0.011)


def test_states_are_taken_at_the_instant_that_was_asked_for():
    recording = trot()
    end, _ = cut_transitions([recording], SETTINGS)
    touchdown, _ = cut_transitions([recording], SETTINGS.replace(instant="touchdown"))
    rows = [np.searchsorted(recording.stamps_ns, table["stamp_ns"].to_numpy()[5]) for table in (touchdown, end)]
    in_contact = (recording.contact_force > 10).all(axis=1)
    assert in_contact[rows[0]] and not in_contact[rows[0] - 1]
    assert in_contact[rows[1]] and not in_contact[rows[1] + 1]


@pytest.mark.parametrize("size", [1, 7, 64, 1000])
@pytest.mark.parametrize("forces", [True, False])
def test_the_size_of_chunks_makes_no_difference(size, forces):
    recording = trot(14, forces=forces)
    settings = SETTINGS.replace(calibration_s=2.0)
    whole = cut_transitions([recording], settings)
    chunks = (recording.rows(slice(i, i + size)) for i in range(0, len(recording), size))
    table, counts = cut_transitions(chunks, settings)
    assert table.equals(whole[0]) and counts == whole[1]


def test_kinematics_alone_find_the_same_steps():
    by_force, _ = cut_transitions([trot(rate=50)], SETTINGS)
    by_motion, _ = cut_transitions([trot(rate=50, forces=False)], SETTINGS)
    assert abs(len(motion_data(by_force)) - len(motion_data(by_motion))) <= 1
    apart = by_motion["stamp_ns"].to_numpy()[3:30] - by_force["stamp_ns"].to_numpy()[3:30]
    assert np.abs(apart).max() <= 40e6  # two samples


def test_an_offset_and_another_unit_of_the_force_sensors_do_not_matter():
    recording = trot()
    odd = dataclasses.replace(recording, contact_force=1000 * recording.contact_force - 5000)
    assert cut_transitions([odd], SETTINGS)[1] == cut_transitions([recording], SETTINGS)[1]


def test_a_flicker_of_contact_is_not_a_step():
    recording = trot()
    force = recording.contact_force.copy()
    force[200, :] = 0.0
    assert cut_transitions([dataclasses.replace(recording, contact_force=force)], SETTINGS)[1]["steps"] == 38


def test_a_gap_is_counted_and_history_does_not_cross_it():
    recording = trot()
    stamps = recording.stamps_ns.copy()
    stamps[1000:] += 86_400 * 10**9
    table, counts = cut_transitions([dataclasses.replace(recording, stamps_ns=stamps)], SETTINGS)
    assert counts["gaps"] == 1 and counts["segments"] == 2
    assert counts["recorded_s"] < 20
    assert table["duration_s"].to_numpy().max() < 0.5
    assert statuses(table)["no_history"] == 2  # at the start, and after the gap


def test_a_standing_start_takes_the_stand_as_the_step_before():
    table, counts = cut_transitions([trot(rest_s=2.0)], SETTINGS)
    first = table.slice(0, 1).to_pylist()[0]
    assert first["status"] == "ok"
    assert (first["previous_velocity_x"], first["previous_reference_x"]) == (0.0, 0.0)
    assert first["reference_x"] == 0.4
    assert counts["standing_s"] == pytest.approx(2.0, abs=0.02)


def test_the_step_before_a_stand_ends_a_full_stance_after_its_touchdown():
    walk = trot(12)
    last = walk.rows(np.full(400, len(walk) - 1))
    stamps = walk.stamps_ns[-1] + 5_000_000 * np.arange(1, 401)
    table, counts = cut_transitions([concatenate([walk, dataclasses.replace(last, stamps_ns=stamps)])], SETTINGS)
    assert counts["standing_s"] == pytest.approx(2.08, abs=0.02)
    assert table["duration_s"].to_numpy()[-1] == pytest.approx(0.34, abs=0.02)
    assert counts["steps"] == 11


def test_a_command_that_changes_within_a_step_counts_by_its_share():
    recording = trot()
    lift = 40 + 12 * 68  # the recording starts with a stand of 40 rows, then steps take 68
    command = recording.command.copy()
    command[lift + 13 :, 0] = 0.8  # after a quarter of the swing's 52 rows
    table, counts = cut_transitions([dataclasses.replace(recording, command=command)], SETTINGS)
    references = table["reference_x"].to_numpy()
    assert counts["command_changes"] == 1
    (mixed,) = np.flatnonzero((references > 0.4) & (references < 0.8))
    assert references[mixed] == pytest.approx(0.25 * 0.4 + 0.75 * 0.8)
    assert table["previous_reference_x"].to_numpy()[mixed + 1] == references[mixed]


def test_a_command_sent_a_little_before_the_end_of_full_stance_is_of_the_next_step():
    recording = trot()
    command = recording.command.copy()
    command[40 + 12 * 68 - 6 :, 0] = 0.8
    table, counts = cut_transitions([dataclasses.replace(recording, command=command)], SETTINGS)
    assert counts["command_changes"] == 0
    assert set(table["reference_x"].to_pylist()) == {0.4, 0.8}


def test_stumbles_are_counted_by_reason_and_break_the_segment():
    one_foot = trot(order=(*TROT_PAIRS * 4, (0,)), steps=27)
    assert cut_transitions([one_foot], SETTINGS)[1]["stumble_single_foot"] == 3
    twice = trot(order=(TROT_PAIRS[0], TROT_PAIRS[1], TROT_PAIRS[1], TROT_PAIRS[0], TROT_PAIRS[1]), steps=20)
    table, counts = cut_transitions([twice], SETTINGS)
    assert counts["stumble_same_pair"] == statuses(table)["stumble_same_pair"] > 2
    sliding = trot()
    feet = sliding.feet_base.copy()
    feet[1000:, :, 1] += 0.15
    table, counts = cut_transitions([dataclasses.replace(sliding, feet_base=feet)], SETTINGS)
    assert counts["stumble_slip"] == 1 and counts["segments"] == 2
    slow = cut_transitions([concatenate_in_time(trot(10), trot(2, swing_s=0.9), trot(10))], SETTINGS)[1]
    assert slow["stumble_step_time"] == 2
    fast = cut_transitions([trot(20)], SETTINGS.replace(min_step_s=0.5))[1]
    assert fast["steps"] == 0 and fast["stumble_short_step"] > 15


def concatenate_in_time(*parts):
    shifted, end = [], 10**18
    for part in parts:
        shift = end - part.stamps_ns[0] + 5_000_000
        shifted.append(dataclasses.replace(part, stamps_ns=part.stamps_ns + shift))
        end = shifted[-1].stamps_ns[-1]
    return concatenate(shifted)


def test_another_gait_is_refused_with_what_was_seen():
    walk = trot(order=((0,), (3,), (1,), (2,)), steps=40)
    _, counts = cut_transitions([walk], SETTINGS)
    with pytest.raises(DatasetError, match=r"only 0 regular steps.*at least 10 of a trot.*40 stumble single foot"):
        check_enough(counts)
    check_enough({"steps": 10})


def test_backward_stamps_are_refused_within_and_between_chunks():
    recording = trot(4)
    with pytest.raises(LogError, match="go backwards or repeat"):
        cut_transitions([recording, recording], SETTINGS)
    stamps = recording.stamps_ns.copy()
    stamps[10] = stamps[9]
    with pytest.raises(LogError, match="go backwards or repeat"):
        cut_transitions([dataclasses.replace(recording, stamps_ns=stamps)], SETTINGS)


def test_an_empty_recording_gives_an_empty_table():
    table, counts = cut_transitions([], SETTINGS)
    assert table.num_rows == 0 and counts == {"steps": 0}


def events(n=30, *, period_s=0.3):
    rng = np.random.default_rng(3)
    roll, pitch, yaw = 0.05 * rng.standard_normal((3, n))
    rotation = Rotation.from_euler("ZYX", np.column_stack([np.cumsum(0.2 * yaw), pitch, roll]))
    position = np.column_stack([0.1 * np.arange(n), np.zeros(n), 0.35 + 0.01 * rng.standard_normal(n)])
    feet = np.empty((n, 4, 3))
    feet[0] = STANCE * [1, 1, 0]
    for i in range(1, n):
        feet[i] = feet[i - 1]
        feet[i, list(TROT_PAIRS[i % 2]), 0] += 0.2
    return Recording(
        name="events",
        stamps_ns=np.round(np.arange(n) * period_s * 1e9).astype(np.int64),
        position_world=position,
        orientation=rotation.as_quat()[:, [3, 0, 1, 2]],
        velocity_base=rng.standard_normal((n, 3)),
        yaw_rate=rng.standard_normal(n),
        command=rng.standard_normal((n, 3)),
        feet_base=np.stack([rotation[i].inv().apply(feet[i] - position[i]) for i in range(n)]),
        swing_pair=np.array([i % 2 for i in range(n)], dtype=np.int8),
    )


def test_stance_feet_stand_still_when_the_trunk_tilts_and_turns():
    # equation 3 with the rotation at both instants (a rotation at t alone makes still feet move)
    table, counts = cut_transitions([events()], SETTINGS)
    assert counts["steps"] == 28 and counts["steps_without_history"] == 1
    np.testing.assert_allclose(motion_data(table).stance_motion, 0.0, atol=1e-12)


def test_a_row_of_events_holds_its_step_and_the_one_before():
    recording = events()
    table, _ = cut_transitions([recording], SETTINGS)
    row = table.slice(5, 1).to_pylist()[0]
    assert row["reference_x"] == recording.command[5, 0]
    assert row["previous_reference_x"] == recording.command[4, 0]
    assert row["velocity_y"] == recording.velocity_base[5, 1]
    assert row["previous_velocity_yaw"] == recording.yaw_rate[4]
    assert row["next_velocity_x"] == recording.velocity_base[6, 0]
    assert row["swing_pair"] == recording.swing_pair[6]
    foot = [row[name] for name in FOOT_DISPLACEMENT[9 * row["swing_pair"] :][:1]]
    assert np.isfinite(foot).all()


def test_events_apart_in_time_are_gaps_and_a_repeated_pair_is_a_stumble():
    recording = events()
    stamps = recording.stamps_ns.copy()
    stamps[15:] += 10**10
    pair = recording.swing_pair.copy()
    pair[22] = 1 - pair[22]
    changed = dataclasses.replace(recording, stamps_ns=stamps, swing_pair=pair)
    settings = SETTINGS.replace(max_slip_m=0.5)
    _, counts = cut_transitions([changed.rows(slice(0, 9)), changed.rows(slice(9, None))], settings)
    assert counts["gaps"] == 1
    # Which of the three flags is wrong is not known: none of the steps between them is believed.
    assert counts["stumble_same_pair"] == 3
    assert counts["steps_without_history"] == 3  # the first, after the gap, after the stumble
    assert counts["steps"] == 29 - 7


@pytest.mark.parametrize(("row", "share"), [(12, 0.5), (17, 0.45)])
def test_both_halves_of_a_step_with_a_phantom_touchdown_are_doubted(row, share):
    recording = events()
    _, counts = cut_transitions([recording], SETTINGS.replace(max_slip_m=0.5))

    def between(values):
        middle = values[row - 1] + share * (values[row] - values[row - 1])
        return np.insert(values, row, middle.astype(values.dtype) if values.dtype.kind == "i" else middle, axis=0)

    changes = {
        field.name: between(value)
        for field in dataclasses.fields(recording)
        if isinstance(value := getattr(recording, field.name), np.ndarray)
    }
    changes["orientation"] /= np.linalg.norm(changes["orientation"], axis=1, keepdims=True)
    changes["swing_pair"][row] = recording.swing_pair[row]  # the same pair, half-way and at the end
    table, doubted = cut_transitions(
        [dataclasses.replace(recording, **changes)], SETTINGS.replace(max_slip_m=0.5, min_step_s=0.1)
    )
    assert doubted["stumble_same_pair"] == 2
    status = table.column("status").to_pylist()
    assert status[row - 1 : row + 1] == ["stumble_same_pair"] * 2
    # Both halves, and the step after them, which has no history.
    assert counts["steps"] - doubted["steps"] == 2


def test_the_real_aliengo_log_gives_952_steps_over_still_feet(shared_data):
    from legtool.configs.robots import load_robot
    from legtool.configs.topics import load_topics
    from legtool.datasets.logs.log import read_log

    path = shared_data / "aliengo" / "real_continuous.csv"
    chunks = read_log(path, load_topics("aliengo_csv"), load_robot("aliengo").geometry())
    table, counts = cut_transitions(chunks, SETTINGS)
    assert counts["steps"] == 952
    assert motion_data(table).stance_motion.reshape(-1, 3).std(axis=0).max() < 0.005


def test_the_real_go2_run_without_contact_signal_gives_steps(shared_data):
    from legtool.configs.robots import load_robot
    from legtool.configs.topics import load_topics
    from legtool.datasets.logs.log import read_log

    chunks = read_log(shared_data / "go2", load_topics("go2_csv"), load_robot("go2").geometry())
    table, counts = cut_transitions(chunks, SETTINGS)
    check_enough(counts)
    assert 2.0 < counts["standing_s"] < 6.0
    assert np.median(motion_data(table).features[:, -1]) < -0.2  # feet below the trunk
