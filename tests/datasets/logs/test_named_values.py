"""Named values beside a recording come back as they were written."""

from pathlib import Path

import numpy as np
import pytest

from legtool.datasets.logs.mcap_writer import NamedColumns, write_mcap
from legtool.datasets.logs.named_values import read_named
from legtool.datasets.logs.recording import Recording
from legtool.errors import LogError

N = 700  # more than one chunk


def recording() -> Recording:
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))
    return Recording(
        name="walk", stamps_ns=np.arange(N) * 5_000_000, position_world=np.zeros((N, 3)), orientation=turn,
        velocity_base=np.zeros((N, 3)), yaw_rate=np.zeros(N), command=np.zeros((N, 3)), feet_base=np.zeros((N, 4, 3)),
        contact_force=None,
    )  # fmt: skip


def test_values_come_back_to_the_last_bit_with_their_names(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(N, 3))
    values[0] = np.nan
    given = (NamedColumns("/a", ("x", "y", "how far"), values), NamedColumns("/b", ("z",), rng.normal(size=(N, 1))))
    path = tmp_path / "walk.mcap"
    write_mcap(path, recording(), beside=given, metadata={})
    for one in given:
        read = read_named(path, one.topic)
        assert read.topic == one.topic and read.names == one.names
        np.testing.assert_array_equal(read.values, one.values)


def test_what_is_not_there_or_damaged_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    write_mcap(path, recording(), metadata={})
    for topic in ("/odom", "/none"):
        with pytest.raises(LogError, match="no named values"):
            read_named(path, topic)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(LogError) as refusal:
        read_named(path, "/odom")
    assert "\n" not in str(refusal.value)
