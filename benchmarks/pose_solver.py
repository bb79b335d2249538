"""Hold the online solver of body poses against SciPy's trust-region interior point, on problems of real terrain.

    python benchmarks/pose_solver.py [problems] [robot] [--seed N]

Problems are recorded under the robot on random terrain of every kind and in the worlds of ``eval vpa --suite vital``:
all costs, one and two horizons, with and without limits on the change. SciPy starts twice, from where the solver starts
and from the solver's own answer, and the better one counts. A gap is what the solver falls short of it, relative.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, minimize

from legtool.configs.footholds import TERRAINS
from legtool.configs.robots import load_robot
from legtool.sim.walks.trunk_path import PATHS, vital_map, vital_world
from legtool.sim.worlds.terrain import CELL_M, random_terrain
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.pose import Pose, PosePlanner, below_hips
from legtool_runtime.foothold.pose_kernels import Problem, objective
from legtool_runtime.foothold.pose_search import maximise
from legtool_runtime.foothold.pose_settings import COSTS, PoseSettings
from legtool_runtime.terrain.elevation import HeightMap


def record(robot_name: str, count: int, rng: np.random.Generator) -> Iterator[tuple[str, Problem, np.ndarray]]:
    """Problems, each with its cost's name and the pose to start from."""
    criteria = Criteria(load_robot(robot_name).geometry())
    planners = [PosePlanner(criteria, PoseSettings(cost=c, horizons=h)) for c in COSTS for h in (1, 2)]
    courses = [vital_map(vital_world(name)) for name in sorted({path.world for path in PATHS.values()})]
    for n in range(count):
        planner = planners[n % len(planners)]
        if rng.random() < 0.5:
            elevation, place = courses[rng.integers(len(courses))], (rng.uniform(-0.9, 3.2), 0.0)
            yaw = 0.0
        else:
            heights = random_terrain(TERRAINS[rng.integers(len(TERRAINS))], rng)
            elevation = HeightMap(heights.astype(np.float32), CELL_M, np.zeros(2))
            place, yaw = tuple(rng.uniform(-0.3, 0.3, 2)), rng.uniform(-np.pi, np.pi)
        speed = rng.uniform(0.0, 0.5)
        twist, gait = (speed, 0.0, 0.0, 0.0, 0.0, rng.normal(scale=0.2)), Gait(speed / 1.4, 1.4, 0.55)
        maps, references = planner.heightmaps(elevation, base_position=place, yaw=yaw, base_twist=twist)
        counts = planner.counts(below_hips(maps, base_twist=twist, gait=gait))
        weights = planner.basis.fit(planner.hip_heights, counts)
        previous = None
        if n % 3:
            standing = references[0] + criteria.robot.standing_height
            previous = Pose(standing + rng.uniform(-0.1, 0.1), *rng.uniform(-0.2, 0.2, 2), np.zeros(4), 0.0)
        problem, guess = planner.problem(weights, references, previous=previous, travelled_m=0.05)
        yield f"{planner.settings.cost}, {planner.settings.horizons}", problem, guess


def by_scipy(problem: Problem, guess: np.ndarray) -> float:
    """The objective that SciPy reaches from ``guess`` (h, 3); -inf where its answer breaks a limit."""
    h = len(guess)
    free = problem._replace(low=problem.low - 9, high=problem.high + 9, change=problem.change + 9)
    limits = []
    if h > 1:
        shift = np.array([problem.references[1] - problem.references[0], 0, 0])
        limits = [LinearConstraint(np.hstack([-np.eye(3), np.eye(3)]), -problem.change - shift, problem.change - shift)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = minimize(
            lambda u: -objective(free, u.reshape(h, 3)), guess.ravel(), method="trust-constr",
            bounds=Bounds(problem.low.ravel(), problem.high.ravel()), constraints=limits, options={"maxiter": 200},
        )  # fmt: skip
    return objective(problem, np.clip(found.x.reshape(h, 3), problem.low, problem.high))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problems", nargs="?", type=int, default=2000)
    parser.add_argument("robot", nargs="?", default="hyq")
    parser.add_argument("--seed", type=int, default=5, help="of the problems; the solver was tuned on 5")
    options = parser.parse_args()
    gaps: dict[str, list[float]] = {}
    ours, theirs, impossible = [], [], 0
    for name, problem, guess in record(options.robot, options.problems, np.random.default_rng(options.seed)):
        u = guess.copy()
        start = time.perf_counter()
        value = maximise(problem, guess, u)
        ours.append(time.perf_counter() - start)
        if not np.isfinite(value):
            impossible += 1
            continue
        start = time.perf_counter()
        first = by_scipy(problem, guess)
        theirs.append(time.perf_counter() - start)
        reference = max(first, by_scipy(problem, u), -1e9)
        gaps.setdefault(name, []).append((reference - value) / max(abs(reference), 1e-9))
    print(f"{options.problems} problems; {impossible} without a pose within all limits")
    print("  cost, horizons  problems  reached or better  within 0.1 %  within 1 %  worst gap")
    every = {**gaps, "all": [gap for one in gaps.values() for gap in one]}
    for name, values in every.items():
        g = np.array(values)
        shares = [(g <= limit).sum() for limit in (1e-6, 1e-3, 1e-2)]
        print(f"  {name:15} {len(g):8d} {shares[0]:18d} {shares[1]:13d} {shares[2]:11d} {100 * g.max():9.3f} %")
    print(
        f"  median time: solver {1e3 * np.median(ours):.2f} ms, SciPy from one start {1e3 * np.median(theirs):.0f} ms"
    )


if __name__ == "__main__":
    main()
