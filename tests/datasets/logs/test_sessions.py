"""Two sessions appended in one file: refused with the line, or taken as recordings of their own."""

import numpy as np
import pytest


@pytest.mark.parametrize("hours", [5, -3, 30])
def test_two_sessions_in_one_file_are_refused_or_split(walk, make_walk, write_csv, collect, topics_of, hours):
    other = make_walk(seed=4)
    other["stamps"] = other["stamps"] + hours * 3600 * 10**9
    both = {name: np.concatenate([values, other[name]]) for name, values in walk.items()}
    log = write_csv(both)
    refused = collect(log, topics=topics_of())
    what = "jumps ahead" if hours > 0 else "goes back"
    assert isinstance(refused, str) and f"line 2402: the time {what}" in refused
    apart = [
        collect(write_csv(part, name=f"{name}.csv"), topics=topics_of())["counts"]["steps"]
        for name, part in (("one", walk), ("two", other))
    ]
    manifest = collect(log, topics=topics_of(), split_at_jumps=True)
    assert manifest["counts"]["steps"] == sum(apart)


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_a_bag_whose_time_jumps_ahead_is_split_too(tmp_path, walk, as_motion, write_log, collect, steps_of, kind):
    later = walk["stamps"] + (np.arange(len(walk["stamps"])) > 1200) * 7200 * 10**9
    walk["stamps"] = later
    log = write_log(kind, tmp_path / "bag", as_motion(walk))
    assert "jumps ahead" in collect(log)
    manifest = collect(log, split_at_jumps=True)
    assert steps_of(manifest)["episode"].nunique() == 2
