import numpy as np
import pytest

from legtool.configs.topics import Orientation, Position
from legtool.datasets.logs.align import Aligner
from legtool.datasets.logs.derive import slopes, yaw_rates
from legtool.datasets.logs.signals import Samples, trunk_orientation, trunk_position
from legtool_runtime.rotations import multiply

MS = 1_000_000


def aligner(*streams: str, max_gap_ms: int = 50) -> Aligner:
    labels = {name: f"{name} (topic /{name})" for name in ("position", *streams)}
    return Aligner(labels, clock="position", held=frozenset({"command"}), max_gap_ns=max_gap_ms * MS)


def samples(stamps_ms, values) -> Samples:
    return Samples(np.array(stamps_ms, dtype=np.int64) * MS, np.array(values, dtype=float).reshape(len(stamps_ms), -1))


def test_equal_stamps_are_taken_to_the_last_bit():
    values = np.random.default_rng(0).normal(size=(5, 3))
    rows = aligner("joints").push(
        {"position": samples(range(5), values), "joints": samples(range(5), values)}, final=True
    )
    assert np.array_equal(rows.values["joints"], values)


def test_between_samples_it_is_linear_and_bounded_by_the_gap():
    got = aligner("joints").push(
        {
            "position": samples([0, 10, 20, 100, 150], np.zeros((5, 1))),
            "joints": samples([0, 40, 120, 140], [0, 4, 12, 14]),
        },
        final=True,
    )
    # 100 lies in a gap of 80 ms, 150 after the last sample.
    assert (got.stamps_ns // MS).tolist() == [0, 10, 20]
    assert got.values["joints"][:, 0] == pytest.approx([0, 1, 2])


def test_a_command_is_held_and_rows_before_the_first_are_left_out():
    align = aligner("command")
    got = align.push(
        {"position": samples([0, 10, 20, 5000], np.zeros((4, 1))), "command": samples([10, 15], [1, 2])}, final=True
    )
    assert (got.stamps_ns // MS).tolist() == [10, 20, 5000]
    assert got.values["command"][:, 0].tolist() == [1, 2, 2]
    assert align.facts.streams["command"].missing == 1


def test_orientations_turn_the_short_way():
    quaternions = [[1, 0, 0, 0], [-np.cos(0.1), 0, 0, -np.sin(0.1)]]
    got = aligner("orientation").push(
        {"position": samples([0, 10, 20], np.zeros((3, 1))), "orientation": samples([0, 20], quaternions)}, final=True
    )
    assert got.values["orientation"][1] == pytest.approx([np.cos(0.05), 0, 0, np.sin(0.05)])


@pytest.mark.parametrize("size", [1, 3, 17, 400])
def test_the_pieces_in_which_samples_arrive_change_nothing(size):
    rng = np.random.default_rng(1)
    clock = np.cumsum(rng.integers(1, 12, 1000))
    joints = np.cumsum(rng.integers(1, 25, 500))
    command = np.cumsum(rng.integers(1, 900, 10))
    whole = {
        name: samples(at, np.sin(at)) for name, at in (("position", clock), ("joints", joints), ("command", command))
    }
    expected = aligner("joints", "command", max_gap_ms=20).push(whole, final=True)
    align = aligner("joints", "command", max_gap_ms=20)
    got = []
    for start in range(0, int(clock[-1]) + 1, 100 * size):
        cut = {}
        for name, part in whole.items():
            inside = (part.stamps_ns >= start * MS) & (part.stamps_ns < (start + 100 * size) * MS)
            cut[name] = Samples(part.stamps_ns[inside], part.values[inside])
        got.append(align.push(cut))
    got.append(align.push({}, final=True))
    for name in ("joints", "command"):
        assert np.array_equal(
            np.concatenate([rows.values[name] for rows in got if rows is not None]), expected.values[name]
        )


def test_memory_stays_bounded_when_a_stream_falls_silent():
    align = aligner("joints")
    align.push({"joints": samples([0], [0.0])})
    for second in range(200):
        at = second * 1000 + np.arange(0, 1000, 10)
        align.push({"position": samples(at, np.zeros(len(at)))})
    assert len(align.kept["position"].stamps_ns) < 1200
    assert align.facts.streams["joints"].missing > 18_000


def test_repeated_stamps_add_nothing():
    align = aligner()
    first = align.push({"position": samples([0, 10, 10, 20], [0, 1, 9, 2])}, final=True)
    second = align.push({"position": samples([20, 30], [9, 3])}, final=True)
    assert (first.stamps_ns // MS).tolist() == [0, 10, 20] and (second.stamps_ns // MS).tolist() == [30]
    assert first.values["position"][:, 0].tolist() == [0, 1, 2]


def test_why_nothing_came_out_is_told():
    align = aligner("joints")
    align.push({"position": samples([0, 10], [0, 0]), "joints": samples([9_000_000, 9_000_010], [0, 0])}, final=True)
    assert "expected them to overlap" in align.explain()
    align = aligner("joints")
    align.push({"position": samples([0, 10], [0, 0])}, final=True)
    assert align.explain() == "joints (topic /joints): holds no samples"


def test_derivatives_see_through_jitter_and_stay_within_a_stretch():
    rng = np.random.default_rng(2)
    stamps = np.cumsum(rng.integers(3, 8, 300)) * MS
    t = stamps * 1e-9
    stretch = (np.arange(300) >= 150).astype(np.int64)
    values = np.stack([2 * t, 5 * t**2], axis=1)
    values[150:] += 100.0  # the jump lies between the stretches
    got = slopes(stamps, values, stretch, 60 * MS, True)
    inside = np.r_[20:130, 170:280]
    assert np.abs(got[:, 0] - 2).max() < 1e-9
    assert np.abs(got[inside, 1] - 10 * t[inside]).max() < 0.1


def test_yaw_rate_is_about_the_bases_own_axis():
    stamps = np.arange(100) * 10 * MS
    turn = 0.8 * stamps * 1e-9 / 2
    spin = np.stack([np.cos(turn), 0 * turn, 0 * turn, np.sin(turn)], axis=1)
    tilted = multiply(np.array([np.cos(0.3), np.sin(0.3), 0, 0]), spin)  # the base's z axis leans, the turn is about it
    sign = np.where(np.arange(100) % 2, -1.0, 1.0)[:, None]  # q and -q are the same orientation
    got = yaw_rates(stamps, tilted * sign, np.zeros(100, np.int64), 60 * MS, True)
    assert got == pytest.approx(0.8, abs=1e-9)


def test_a_tilted_tracker_ahead_of_the_trunk_is_taken_back_to_it():
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(4)
    trunk = Rotation.random(20, random_state=5)
    mount = (0.1, -0.3, 0.2)
    place = rng.normal(size=(20, 3))
    # The tracked body sees the trunk turned by mount and at offset.
    tracked = trunk * Rotation.from_euler("xyz", mount).inv()
    offset = np.array([-0.2, 0.01, -0.1])
    seen = place - tracked.apply(offset)
    q = tracked.as_quat()[:, [3, 0, 1, 2]]
    back = trunk_orientation(Orientation(columns=(0,), mount=mount), q)
    assert np.allclose(Rotation.from_quat(back[:, [1, 2, 3, 0]]).as_matrix(), trunk.as_matrix())
    assert np.allclose(trunk_position(Position(columns=(0,), offset=tuple(offset)), seen, q), place)
