from collections.abc import Callable

import numpy as np
import pytest

from legtool.configs.climbs import CLIMBS
from legtool.configs.courses import COURSES, any_world
from legtool.configs.families import ENVIRONMENTS, FAMILIES, HARDWARE, PARALLEL_BEAMS, winding_beam
from legtool.configs.planner import SUITES
from legtool.configs.worlds import WorldSettings, load_world
from legtool.errors import SettingsError
from legtool.sim.worlds.build import build_world

DRAWN = [name for name, family in FAMILIES.items() if family.drawn]


def test_the_suites_hold_the_worlds_of_the_papers_sections() -> None:
    assert SUITES["quadpips"] == ENVIRONMENTS and len(ENVIRONMENTS) == 10
    assert SUITES["quadpips_hardware"] == HARDWARE and len(HARDWARE) == 6
    assert SUITES["parallel_beams"] == PARALLEL_BEAMS
    assert not set(FAMILIES) & (set(COURSES) | set(CLIMBS))


@pytest.mark.parametrize("name", DRAWN)
def test_members_differ_by_their_seed_alone_and_can_be_started_and_ended(name: str) -> None:
    family = FAMILIES[name]
    assert family.settings() == load_world(name)
    assert family.settings(3) == family.settings(3) != family.settings(4)
    world = build_world(family.settings(3))
    world.require_goal()
    assert world.name == name


def boxes(world: WorldSettings, prefix: str) -> list[np.ndarray]:
    return [np.array([*box.center, *box.size, *box.rpy]) for box in world.boxes if box.name.startswith(prefix)]


def test_sparse_stones_lie_on_the_published_grid_two_in_five() -> None:
    def cells(world: WorldSettings) -> set[tuple[int, int]]:
        places = [stone[:2] / 0.15 for stone in boxes(world, "stone_")]
        return {(round(2 * x), round(2 * y)) for x, y in places}

    published = cells(FAMILIES["sparse_stepping_stones"].settings())
    drawn = [cells(FAMILIES["sparse_stepping_stones"].settings(seed)) for seed in range(20)]
    assert len(published) == 164
    # Odd half cells along x, even ones along y, within the same 20 by 20.
    every = {(2 * i - 19, 2 * j) for i in range(20) for j in range(20)}
    assert published < every and all(cells < every for cells in drawn)
    assert 0.37 < np.mean([len(one) for one in drawn]) / 400 < 0.43


def rubble_draws(world: WorldSettings) -> np.ndarray:
    """What the rule draws of each box: place off the grid, sides over the smallest, turns; each between its bounds."""
    values = np.array(boxes(world, "rubble_"))
    off = values[:, :2] - 0.3 * np.round(values[:, :2] / 0.3)
    return np.column_stack([off / 0.03, (values[:, 3:5] / 0.3 - 1.25) / 0.25, values[:, 6:] / 0.25])


def peg_draws(world: WorldSettings) -> np.ndarray:
    heights = np.array(boxes(world, "peg_"))[:, 2].reshape(10, 10)
    return (heights - heights.mean(axis=0)).reshape(-1, 1) / 0.035


@pytest.mark.parametrize(("name", "draws"), [("rubble", rubble_draws), ("pegboard", peg_draws)])
def test_the_published_world_could_have_been_drawn(name: str, draws: Callable[[WorldSettings], np.ndarray]) -> None:
    published = draws(FAMILIES[name].settings())
    drawn = np.array([draws(FAMILIES[name].settings(seed)) for seed in range(20)])
    for values in (published, drawn):
        assert np.abs(values).max() < 1.3 if name == "pegboard" else np.abs(values).max() < 1.0 + 1e-3
    # As widely spread: 100 values of a uniform distribution have a standard deviation that is within a fifth.
    np.testing.assert_allclose(published.std(axis=0), drawn.std(axis=(0, 1)), rtol=0.2)


def test_pegs_rise_to_the_middle_and_neighbours_differ_as_in_the_published_board() -> None:
    for seed in (None, 0, 1, 2):
        pegs = np.array(boxes(FAMILIES["pegboard"].settings(seed), "peg_"))
        tops = (pegs[:, 2] + 0.05).reshape(10, 10)
        assert tops.min() > 0.05 and tops.max() < 0.4
        assert np.abs(np.diff(tops, axis=1)).max() < 0.14
        assert tops[:, 5].mean() > tops[:, 0].mean() + 0.2


def test_the_winding_beam_of_the_published_amplitude_is_the_published_one() -> None:
    beam = [np.array([*box["center"], *box["size"], *box["rpy"]]) for box in winding_beam(0.45)]
    np.testing.assert_allclose(beam, boxes(load_world("winding_balance_beam"), "beam"), atol=2e-5)


@pytest.mark.parametrize("name", ["balance_beam", "ramped_balance_beam", "obstructed_balance_beam"])
def test_beams_are_drawn_thirty_to_fifty_centimetres_wide(name: str) -> None:
    prefix = "ramp_5" if name == "ramped_balance_beam" else "beam"
    widths = [boxes(FAMILIES[name].settings(seed), prefix)[0][4] for seed in range(30)]
    assert 0.3 <= min(widths) < 0.34 and 0.46 < max(widths) <= 0.5


def test_barriers_are_as_wide_as_their_beam() -> None:
    world = FAMILIES["obstructed_balance_beam"].settings(5)
    widths = {part[4] for prefix in ("beam", "barrier_") for part in boxes(world, prefix)}
    assert len(widths) == 1


def test_a_member_is_named_by_family_and_seed() -> None:
    world = any_world("member:pegboard:7")
    assert world.name == "pegboard_7" and world.boxes == FAMILIES["pegboard"].settings(7).boxes
    with pytest.raises(SettingsError, match="expected one of rubble, pegboard"):
        any_world("member:ramp:1")
    with pytest.raises(SettingsError, match="member:NAME:SEED"):
        any_world("member:pegboard")
