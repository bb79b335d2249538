import numpy as np
import pytest

from legtool.evaluation.report.intervals import BlockBootstrap, mean, paired_difference, paired_p, share


def test_shares_have_wilsons_interval():
    entry = share(10, 10)  # 10 of 10 is 72 to 100 %
    assert entry["value"] == 1.0 and entry["n"] == 10 and entry["unit"] == "1"
    assert entry["ci95"] == pytest.approx([0.7225, 1.0], abs=1e-4)
    assert share(0, 0) == {"value": 0.0, "ci95": None, "n": 0, "unit": "1"}


def test_a_mean_has_the_interval_that_plain_resampling_gives():
    values = np.random.default_rng(5).normal(3.0, 1.0, size=30)
    entry = mean(values, "m")
    drawn = np.random.default_rng(0).integers(30, size=(2000, 30))
    assert entry["value"] == values.mean() and entry["n"] == 30 and entry["unit"] == "m"
    assert entry["ci95"] == pytest.approx(np.quantile(values[drawn].mean(axis=1), [0.025, 0.975]), rel=1e-9)
    assert mean([2.0, 2.0], "s")["ci95"] is None  # equal samples: how far others would lie is not known


def test_of_one_sample_there_is_no_interval():
    assert mean([3.0], "m") == {"value": 3.0, "ci95": None, "n": 1, "unit": "m"}
    one = BlockBootstrap(1, samples=100, seed=0)
    assert one.mean(np.arange(5.0), np.zeros(5, int)) == (2.0, None)
    assert one.statistic(np.arange(5.0), np.zeros(5, int), np.median) == (2.0, None)
    # Few blocks would make it far too narrow.
    few = BlockBootstrap(4, samples=100, seed=0)
    assert few.mean(np.arange(40.0), np.arange(40) // 10) == (19.5, None)
    assert BlockBootstrap(5, samples=100, seed=0).mean(np.arange(50.0), np.arange(50) // 10)[1] is not None
    # All blocks alike: a width of 0 would claim certainty.
    assert BlockBootstrap(9, samples=100, seed=0).mean(np.ones(90), np.arange(90) // 10) == (1.0, None)
    # Three blocks, one of which alone holds what is measured.
    assert BlockBootstrap(3, samples=100, seed=0).ratio([0.0, 2.0, 0.0], [0.0, 4.0, 0.0]) is None


def test_the_bootstrap_interval_covers_the_true_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for trial in range(200):
        common = rng.standard_normal((40, 1)).repeat(5, axis=1)  # values within a block go together
        values = (common + 0.1 * rng.standard_normal((40, 5))).ravel()
        block = np.arange(40).repeat(5)
        low, high = BlockBootstrap(40, samples=300, seed=trial).mean(values, block)[1]
        hits += low <= 0.0 <= high
    assert 180 <= hits <= 198


def test_ratio_mean_and_any_statistic_agree_where_they_are_one_thing():
    rng = np.random.default_rng(1)
    values, block = rng.normal(size=(60, 2)), np.sort(rng.integers(8, size=60))
    bootstrap = BlockBootstrap(8, samples=500, seed=2)
    value, interval = bootstrap.mean(values, block)
    sums, counts = np.bincount(block, values.sum(axis=1), 8), 2 * np.bincount(block, minlength=8)
    assert value == values.mean() and bootstrap.ratio(sums, counts) == interval
    other, about = bootstrap.statistic(values.mean(axis=1), block, np.mean)
    assert other == pytest.approx(value) and about == pytest.approx(interval)
    squared, rooted = bootstrap.mean(values**2, block, root=True)
    assert squared == pytest.approx(np.sqrt((values**2).mean()))
    assert rooted == pytest.approx(np.sqrt(bootstrap.mean(values**2, block)[1]))


def test_resamples_without_what_is_measured_are_left_out():
    bootstrap = BlockBootstrap(5, samples=1000, seed=0)
    resampled = np.concatenate([np.full(500, np.nan), np.linspace(0.0, 1.0, 1001)])
    assert bootstrap.interval(resampled, np.ones(5)) == pytest.approx((0.025, 0.975))


def test_a_paired_difference_has_newcombes_interval():
    """His example of 20, 12, 2 and 16 pairs, and pairs of which all or none are alike."""
    first = [True] * 32 + [False] * 18
    second = [True] * 20 + [False] * 12 + [True] * 2 + [False] * 16
    entry = paired_difference(first, second)
    assert entry["value"] == pytest.approx(0.2) and entry["n"] == 50
    assert entry["ci95"] == pytest.approx([0.0562, 0.3290], abs=2e-3)
    swapped = paired_difference(second, first)["ci95"]
    assert swapped == pytest.approx([-entry["ci95"][1], -entry["ci95"][0]])
    never, always = [False] * 10, [True] * 10
    low, high = paired_difference(always, never)["ci95"]
    assert 0.5 < low < 0.75 and high == pytest.approx(1.0)
    low, high = paired_difference(always, always)["ci95"]
    assert low == pytest.approx(-high) and 0.2 < high < 0.45  # ten pairs do not show that two are alike
    assert paired_difference([], [])["ci95"] is None


def test_what_pairs_cannot_tell_has_a_large_p():
    assert paired_p([True] * 9 + [False], [False] * 10) == pytest.approx(2 * 0.5**9)
    assert paired_p([True, False], [True, False]) == 1.0
    assert paired_p([True, False], [False, True]) == 1.0
