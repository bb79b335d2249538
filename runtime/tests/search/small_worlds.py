"""Small random worlds for the foothold search: a few candidates per foot, on tiles of their own heights."""

import dataclasses

import numpy as np
from true_regions import rectangle, regions_of

from legtool_runtime.search.candidates import Candidates, keys_of
from legtool_runtime.search.feet import FootProblem
from legtool_runtime.search.settings import FootSettings, PipsSettings
from legtool_runtime.search.surface import outlines_of, surface_of

UP = np.tile([0.0, 0.0, 1.0], (4, 1))


def problem(robot, settings, rng, *, per_foot=2, goal=0.15):
    """Candidates ahead of each foot, with tiles under them, and a waypoint ahead."""
    size = float((robot.thigh_length + robot.shank_length).max()) / 0.6125
    feet = robot.stance * [1.0, 1.0, 0.0] + rng.uniform(-0.02, 0.02, (4, 3)) * size
    feet[:, 2] = rng.uniform(-0.02, 0.02) + rng.uniform(-0.03, 0.03, 4) * size * rng.integers(2)
    places = []
    for leg in range(4):
        ahead = rng.uniform(0.0, 0.5, per_foot) * size
        aside = rng.uniform(-0.15, 0.15, per_foot) * size
        rise = rng.uniform(-0.2, 0.2, per_foot) * size * rng.integers(2)
        places.append(feet[leg] + np.stack([ahead, aside, rise], axis=1))
    points = np.concatenate(places)
    tiles = [rectangle(p, (0.08 * size, 0.08 * size)) for p in (*points, *feet)]
    if rng.random() < 0.5:
        tiles.append(rectangle([*rng.uniform(-0.3, 0.5, 2), rng.uniform(0.0, 0.3) * size], (0.1, 0.1)))
    outlines = outlines_of(regions_of(tiles))
    surface = surface_of(
        outlines, np.ones(len(tiles), bool), middle=(0.0, 0.0), radius=1.2, cell=0.02, seam=0.0, trunk_width=0.2
    )
    n = len(points)
    candidates = Candidates(
        points, np.tile([0.0, 0.0, 1.0], (n, 1)), rng.uniform(0.0, 0.1, n), np.arange(n),
        keys_of(points, settings.candidates.spacing), rng.random(n) < 0.1,
    )  # fmt: skip
    waypoint = feet.mean(axis=0) + np.array([goal * size, 0.0, robot.standing_height])
    return FootProblem(candidates, surface, feet, UP, waypoint)


def exact(robot, mode="walkable", **walkability):
    """Settings of a search that finds the cheapest path: weight 1, no deadline, a narrow goal."""
    base = PipsSettings.of(robot, mode)
    rules = dataclasses.replace(base.walkability, **walkability)
    return dataclasses.replace(base, walkability=rules, feet=FootSettings(weights=(1.0,), tolerance=0.05))
