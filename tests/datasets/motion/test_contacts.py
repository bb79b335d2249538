import numpy as np

from legtool.datasets.motion.contacts import ContactState, Scale
from legtool.datasets.motion.swings import SwingInterval, SwingTracker

SCALE = Scale(on=np.full(4, 30.0), off=np.full(4, 10.0), speed=1.0, height=1.0)
MS = 1_000_000


def edges(load, *, hold_s=0.0, chunk=None):
    state = ContactState()
    load = np.array(load, dtype=float)[:, None].repeat(4, axis=1)
    load[:, 1:] = 100.0
    state.initial(load[0], SCALE)
    stamps = 5 * MS * np.arange(len(load))
    found = []
    for i in range(0, len(load), chunk or len(load)):
        part = slice(i, i + (chunk or len(load)))
        found += state.edges(load[part], stamps[part], i, scale=SCALE, hold_s=hold_s).tolist()
    return [(row, down) for row, leg, down in found if leg == 0]


def test_contact_changes_only_beyond_both_thresholds():
    assert edges([100, 20, 100, 5, 20, 29, 31, 12, 5]) == [(3, 0), (6, 1), (8, 0)]


def test_a_change_counts_from_where_it_began_once_it_has_lasted():
    load = [100, 100, 5, 100, 100, 5, 5, 5, 5, 100, 5, 5, 100, 100, 100, 100]
    assert edges(load, hold_s=0.01) == [(5, 0), (12, 1)]
    assert edges(load, hold_s=0.01, chunk=1) == [(5, 0), (12, 1)]


def test_two_diagonal_feet_make_one_swing():
    tracker = SwingTracker(np.ones(4), 0)
    assert tracker.feed(10, 0, False) is None
    assert tracker.feed(12, 3, False) is None
    assert tracker.feed(30, 3, True) is None
    assert tracker.feed(33, 0, True) == SwingInterval(0, 10, 33, "")
    assert tracker.full_stance


def test_one_foot_alone_is_a_stumble():
    tracker = SwingTracker(np.ones(4), 0)
    tracker.feed(10, 1, False)
    assert tracker.feed(20, 1, True) == SwingInterval(1, 10, 20, "single_foot")


def test_a_foot_that_lifts_and_lands_within_the_other_pairs_swing_spoils_it():
    tracker = SwingTracker(np.ones(4), 0)
    for row, leg in ((10, 0), (11, 3), (15, 1)):
        tracker.feed(row, leg, False)
    assert tracker.feed(18, 1, True) is None
    tracker.feed(30, 0, True)
    assert tracker.feed(31, 3, True) == SwingInterval(0, 10, 31, "extra_foot")


def test_feet_in_the_air_at_the_start_belong_to_a_swing_cut_off():
    tracker = SwingTracker(np.array([0, 1, 1, 0]), 0)
    tracker.feed(5, 0, True)
    assert tracker.feed(6, 3, True) == SwingInterval(0, 0, 6, "cut_off")
