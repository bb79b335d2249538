import numpy as np
import pytest

from legtool.configs.footholds import TERRAINS, FootholdSettings
from legtool.configs.robots import load_robot
from legtool.datasets.foothold.heightmaps import from_table, load_footholds, split_by_terrain, to_table
from legtool.errors import DatasetError, SettingsError
from legtool.pipeline.footholds import collect_footholds
from legtool.sim.worlds.foothold_samples import foothold_samples
from legtool.sim.worlds.terrain import random_terrain
from legtool_runtime.foothold import Criteria, hip_heights

SETTINGS = FootholdSettings(vpa_share=0.2)
CRITERIA = Criteria(load_robot("hyq").geometry())


@pytest.fixture(scope="module")
def data():
    return foothold_samples(SETTINGS, 3, CRITERIA)


def test_a_part_is_a_pure_function_of_settings_and_number(data):
    again = foothold_samples(SETTINGS, 3, CRITERIA)
    other = foothold_samples(SETTINGS, 4, CRITERIA)
    assert to_table(data).equals(to_table(again))
    assert not np.array_equal(data.heights, other.heights, equal_nan=True)


def test_labels_are_what_the_criteria_say_of_the_stored_tuple(data):
    criteria, tuples = CRITERIA, data.tuples()
    for n in range(0, len(data), 25):
        found = criteria.evaluate(tuples[n])
        assert np.array_equal(found.reasons, data.reasons[n])
        if data.optimal[n] >= 0:
            assert found.safe.reshape(-1)[data.optimal[n]]
        else:
            assert not found.safe.any()
        if data.vpa[n]:
            assert np.array_equal(criteria.counts(tuples[n], hip_heights(criteria.robot)), data.counts[n])
        else:
            assert (data.counts[n] == -1).all()


def test_trunks_are_tilted_up_to_the_largest_angle_and_level_ones_are_those_of_before(data):
    for angle in (data.roll, data.pitch):
        assert 0.3 < np.abs(angle).max() <= 0.35 and abs(angle.mean()) < 0.03
    level = foothold_samples(SETTINGS.replace(tilt=0.0), 3, CRITERIA)
    assert not level.roll.any() and not level.pitch.any()
    # A dataset of before has no such columns: it is read as what it is, level.
    table = to_table(level)
    before = from_table(table.drop_columns(["roll", "pitch"]))
    assert to_table(before).equals(table)
    for n in range(0, len(before), 100):
        assert np.array_equal(CRITERIA.evaluate(before.tuples()[n]).reasons, before.reasons[n])


def test_the_optimal_foothold_is_the_nearest_safe_one(data):
    distance = np.hypot(*(np.indices((33, 33)) - 16)).reshape(-1)
    for n in np.flatnonzero(data.optimal >= 0):
        assert distance[data.optimal[n]] == distance[(data.reasons[n] == 0).reshape(-1)].min()


def test_samples_are_neither_all_safe_nor_all_unsafe_on_any_terrain(data):
    for kind in range(len(TERRAINS)):
        rows = data.terrain_kind == kind
        share = (data.reasons[rows] == 0).mean()
        assert 0.03 < share < 0.7, TERRAINS[kind]


def test_rows_survive_the_way_through_a_table(data):
    back = from_table(to_table(data))
    for name in ("heights", "reasons", "base_twist", "leg", "counts", "roll", "pitch"):
        assert np.array_equal(getattr(back, name), getattr(data, name), equal_nan=name == "heights")


def test_a_dataset_is_collected_loaded_and_split_by_terrain(tmp_path):
    manifest = collect_footholds(FootholdSettings(samples=1500), tmp_path / "data")
    assert manifest["rows"] == 2000 and manifest["counts"]["samples"] == 2000
    loaded, again = load_footholds([tmp_path / "data"])
    assert len(loaded) == 2000 and again["criteria"]["leg_radius_m"] == pytest.approx(0.04)
    training, validation = split_by_terrain(loaded, 0.1, seed=0)
    assert not set(loaded.terrain[training]) & set(loaded.terrain[validation])
    assert validation.mean() == pytest.approx(0.1)
    with pytest.raises(DatasetError, match="no dataset was given"):
        load_footholds([])


def test_an_unknown_terrain_is_told(tmp_path):
    with pytest.raises((SettingsError, ValueError), match="'lava' is unknown; expected some of bars"):
        FootholdSettings(terrains=("lava",))


@pytest.mark.parametrize("kind", TERRAINS)
def test_every_terrain_is_finite_and_not_flat(kind):
    for seed in range(5):
        h = random_terrain(kind, np.random.default_rng(seed))
        assert h.shape == (140, 140) and np.isfinite(h).all() and np.ptp(h) < 3
    assert any(np.ptp(random_terrain(kind, np.random.default_rng(seed))) > 0.02 for seed in range(5))
