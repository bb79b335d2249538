"""How many future footholds keep their key from frame to frame while a robot stands and its camera goes on looking.

    python benchmarks/keys.py [WORLD ...] [--robot anymal_c] [--frames 20] [--seeds 3] [--ahead 1.0]

The robot stands in physics, with the noise of the suites on its state and its depth images; each frame is segmented
anew and planned on. Beside the chain as it runs, which knows the footholds that it planned last, stands the search
without that knowledge.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from legtool.configs.families import ENVIRONMENTS, FAMILIES
from legtool.configs.planner import PlannerEvalSettings
from legtool.evaluation.report.intervals import share
from legtool.evaluation.suites.suite_robot import suite_robot
from legtool.sim.controllers.tracked import TrackedController, standing_feet
from legtool.sim.walks.environment import PlannedContacts
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.pips import pips_for
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.simulated import Eyes, SimulatedRobot
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool_runtime.perception.chain import PerceptionSettings
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.search.pips import PipsPlan
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.settings import TrackerSettings


def stand(world: str, robot: str, frames: int, seed: int, ahead_m: float) -> tuple[np.ndarray, np.ndarray]:
    """(2,) footholds of a frame that the next one has, too, and (2,) all: of the chain, and of the search alone."""
    settings = PlannerEvalSettings(planners=("quadpips",), robot=robot)
    who = suite_robot(settings, None)
    place = build_world(FAMILIES[world].settings(None), robot=who.name)
    body = who.build(world_spec(place))
    controller = TrackedController(body, TrackerSettings(force_noise=0.01))
    geometry = controller.robot.geometry
    environment = SimulatedRobot(
        place, body, controller, rng=np.random.default_rng(seed), noise=settings.noise,
        eyes=Eyes(who.camera, None, images=True, labelled_m=who.swing_height_max), start=(ahead_m, 0.0, 0.0),
    )  # fmt: skip
    perception = PerceptionSettings(egocan=EgocanSettings(lift=settings.lift))
    finder, mapper = RegionFinder(geometry, perception), Mapper(geometry, settings.elevation, for_feet=True)
    chain, alone = (pips_for(controller.robot, place, expansions=settings.expansions) for _ in range(2))
    environment.begin()
    standing, plan, elevation = None, None, None
    last: list[set[tuple[int, int]]] = [set(), set()]
    kept, all_of = np.zeros(2, int), np.zeros(2, int)
    seen = 0
    while seen < frames:
        observation = environment.observe()
        state = observation.state
        feet = standing_feet(controller.robot, state)
        if standing is None:
            up = np.array([0.0, 0.0, 1.0])
            standing = ContactPlan([[Stance(-np.inf, np.inf, foot, up)] for foot in feet])
        if (found := mapper.see(observation)) is not None:
            elevation = found
        if (regions := finder.see(observation)) is not None:
            seen += 1
            for k, (pips, given) in enumerate(((chain, plan), (alone, None))):
                answer = pips.plan(
                    regions, position=state.position_world.copy(), yaw=float(yaw_of(rotation_of(state.orientation))),
                    feet=feet if given is None else standing_feet(controller.robot, state), goal=place.goal,
                    time_s=0.0, plan=given, elevation=elevation,
                )  # fmt: skip
                keys = _keys(answer)
                kept[k] += len(keys & last[k])
                all_of[k] += len(last[k])
                last[k] = keys
                plan = answer.plan if k == 0 else plan
        environment.apply(PlannedContacts(standing))
    return kept, all_of


def _keys(answer: PipsPlan) -> set[tuple[int, int]]:
    """Leg and key of every foothold that is stepped to."""
    if answer.feet is None:
        return set()
    moved = ~np.asarray(answer.feet.families)
    return {(leg, int(answer.feet.keys[k + 1, leg])) for k, leg in np.argwhere(moved).tolist()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each world."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", nargs="*", default=list(ENVIRONMENTS))
    parser.add_argument("--robot", default="anymal_c")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--ahead", type=float, default=1.0, help="of the world's start [m]")
    given = parser.parse_args(arguments)
    total, out_of = np.zeros(2, int), np.zeros(2, int)
    for world in given.worlds:
        counts = [stand(world, given.robot, given.frames, seed, given.ahead) for seed in range(given.seeds)]
        kept, all_of = (np.sum(part, axis=0) for part in zip(*counts, strict=True))
        print(f"{world:28s} {_row(kept, all_of)}", flush=True)
        total, out_of = total + kept, out_of + all_of
    print(f"{'all':28s} {_row(total, out_of)}")


def _row(kept: np.ndarray, all_of: np.ndarray) -> str:
    parts = []
    for name, k, n in zip(("chain", "search alone"), kept.tolist(), all_of.tolist(), strict=True):
        low, high = share(k, n)["ci95"] if n else (np.nan, np.nan)
        parts.append(f"{name} {k}/{n} = {100 * k / max(n, 1):.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    return ", ".join(parts)


if __name__ == "__main__":
    main()
