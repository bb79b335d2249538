"""Time the foothold line: exact criteria, foothold selection, body poses, and the networks in their place.

    python benchmarks/foothold.py [robot] [--bundle BUNDLE ...]

Bundles hold the networks: vfa, vpa or both; without one, networks of the same shape with random weights are timed, as
`train vfa` and `train vpa` build them. One core but for body poses, which take two threads. Stairs are timed beside
flat and rough ground, for noise hides the work: it fails early. The fastest call is given beside the median, for other
processes take the core away. Last, labelled samples per second of one core, drawing and all.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from legtool.configs.robots import load_robot
from legtool.errors import LegtoolError
from legtool_runtime import load_bundle
from legtool_runtime.foothold import RESOLUTION_M, SIZE, Criteria, Gait, Tuple, hip_heights
from legtool_runtime.foothold.networks import CountNetwork, FootholdNetwork
from legtool_runtime.foothold.pose import PosePlanner
from legtool_runtime.foothold.selection import FootholdSelector, Method
from legtool_runtime.terrain.elevation import HeightMap

TWIST = (0.3, 0.0, 0.0, 0.0, 0.0, 0.1)
GAIT = Gait(step_length_m=0.21, step_frequency_hz=1.4, duty_factor=0.55, time_to_touchdown_s=10.0)
CALLS = 400


def terrains() -> dict[str, np.ndarray]:
    """Flat ground, the paper's stairs (10 cm rise, 25 cm go) at several places, and rough ground."""
    x = (np.arange(SIZE) - SIZE // 2) * RESOLUTION_M
    out = {"flat": [np.zeros((SIZE, SIZE))]}
    out["stairs"] = [
        np.repeat(((np.floor((x + s) / 0.25) - np.floor(s / 0.25)) * 0.1)[:, None], SIZE, axis=1)
        for s in np.arange(0.01, 0.25, 0.03)
    ]
    rng = np.random.default_rng(0)
    out["rough"] = [np.kron(rng.uniform(-0.05, 0.05, (7, 7)), np.ones((5, 5)))[:SIZE, :SIZE] for _ in range(8)]
    return {name: [h.astype(np.float32) for h in maps] for name, maps in out.items()}


def timed(call: Callable[[int], object], calls: int) -> np.ndarray:
    call(0)
    times = np.empty(calls)
    for n in range(calls):
        start = time.perf_counter_ns()
        call(n)
        times[n] = (time.perf_counter_ns() - start) * 1e-6
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="?", help="preset or YAML; by default the bundles' robot, or hyq without any")
    parser.add_argument("--bundle", action="append", default=[], help="repeatable")
    options = parser.parse_args()
    try:
        bundles = [load_bundle(path) for path in options.bundle]
        robot = bundles[0].robot if bundles and options.robot is None else load_robot(options.robot or "hyq").geometry()
    except LegtoolError as error:
        parser.error(str(error))
    for bundle in bundles:
        if bundle.robot.to_dict() != robot.to_dict():
            parser.error(f"{bundle.path}: made for {bundle.robot.name}, and {robot.name} is timed; time one robot")
    criteria = Criteria(robot)
    criteria.warm_up()
    hips = hip_heights(robot)
    standing = float(robot.standing_height + robot.hips[0, 2])
    print(f"{robot.name}, {SIZE} × {SIZE} cells, legs FL and RL in turn, {CALLS} calls [ms]")
    for name, maps in terrains().items():

        def asked(n: int, maps: list[np.ndarray] = maps) -> Tuple:
            # Built anew for each call: checking it is part of the work.
            return Tuple(maps[n % len(maps)], leg=2 * (n % 2), hip_height=standing, base_twist=TWIST, gait=GAIT)

        one = timed(lambda n, asked=asked: criteria.evaluate(asked(n)), CALLS)
        many = timed(lambda n, asked=asked: criteria.counts(asked(n), hips), CALLS // 8)
        for what, t in (("every mask, one hip height", one), (f"counts, {len(hips)} hip heights", many)):
            tell(name, what, t)
    choosing = [bundle.vfa for bundle in bundles if "vfa" in bundle.lines]
    counting = [bundle.vpa for bundle in bundles if "vpa" in bundle.lines]
    if not bundles:
        choosing, counting = untrained(criteria)
    selections(criteria, choosing)
    poses(criteria, counting)
    labelling(criteria)
    print("the paper: VFA 7.5 ms a leg exact, 3.5 with its CNN; VPA 720 ms exact, 180 with its CNN")


def untrained(criteria: Criteria) -> tuple[list[FootholdNetwork], list[CountNetwork]]:
    """Networks with random weights: as fast as trained ones."""
    import torch

    from legtool.configs.footholds import FootholdTrainSettings
    from legtool.models.foothold import DenseCounts, build_network
    from legtool.training.freeze_foothold import random_inputs
    from legtool.training.onnx_model import to_onnx

    torch.manual_seed(0)
    width, hips = FootholdTrainSettings().width, hip_heights(criteria.robot)
    made: dict[str, list] = {"vfa": [], "vpa": []}
    for task, network in (("vfa", "paper"), ("vfa", "dense"), ("vpa", "paper"), ("vpa", "dense")):
        net = build_network(task, network, width, criteria.robot, criteria.settings)
        if (task, network) == ("vpa", "dense"):
            net = DenseCounts(net, hips)
        example = random_inputs(3, "dense" if network == "dense" else task)
        content = to_onnx(net.eval(), example, outputs=["out"], batched=True)
        build = FootholdNetwork if task == "vfa" else CountNetwork
        made[task].append(build(criteria.robot, content, dense=network == "dense"))
    return made["vfa"], made["vpa"]


def labelling(criteria: Criteria) -> None:
    """Samples labelled per second, of either kind."""
    from legtool.configs.footholds import FootholdSettings
    from legtool.sim.worlds.foothold_samples import foothold_samples

    for share, name in ((0.0, "VFA"), (1.0, "VPA")):
        settings = FootholdSettings(vpa_share=share)
        foothold_samples(settings, 0, criteria)
        rates = []
        for part in range(1, 4):
            wall, own = time.perf_counter(), time.process_time()
            count = len(foothold_samples(settings, part, criteria))
            rates.append((count / (time.perf_counter() - wall), count / (time.process_time() - own)))
        wall_rate, own_rate = np.median(rates, axis=0)
        print(f"  labelling, {name} samples: {wall_rate:.0f}/s by the clock, {own_rate:.0f}/s of its own core time")


def selections(criteria: Criteria, networks: list[FootholdNetwork]) -> None:
    """Foothold selection on stairs, heightmap extraction included."""
    elevation = stairs_map()
    methods: list[tuple[Method, FootholdNetwork | None]] = [("exact", None)]
    methods += [(method, network) for network in networks for method in ("cnn", "verified")]
    for method, network in methods:
        selector = FootholdSelector(criteria, method=method, network=network)
        times = timed(
            lambda n, selector=selector: selector.select_in(
                elevation,
                leg=n % 4,
                base_position=(0.02 * (n % 100), 0.0, criteria.robot.standing_height + 0.2),
                attitude=(0.0, 0.0, 0.0),
                base_twist=TWIST,
                gait=Gait(0.21, 1.4, 0.55, 0.3),
            ),
            CALLS,
        )
        tell("stairs", f"VFA {method} {kind(network)}", times)


def poses(criteria: Criteria, networks: list[CountNetwork]) -> None:
    """Body poses on stairs: 4 legs × 2 horizons, extraction and optimisation included."""
    elevation = stairs_map()
    planners = [PosePlanner(criteria, network=network, threads=2) for network in [None, *networks]]
    for planner in [*planners, PosePlanner(criteria, coarse=True)]:
        planner.warm_up()
        times = timed(
            lambda n, planner=planner: planner.plan(
                elevation, base_position=(0.02 * (n % 100), 0.0), yaw=0.0, base_twist=TWIST, gait=GAIT
            ),
            CALLS // 4,
        )
        how = "coarse, one thread" if planner.coarse else kind(planner.network) or "exact"
        tell("stairs", f"VPA {how}", times)


def kind(network: FootholdNetwork | CountNetwork | None) -> str:
    return "" if network is None else "dense" if network.dense else "paper"


def stairs_map() -> HeightMap:
    """The paper's stairs, from x = 0.4 m on."""
    x = np.arange(-1.5, 4.0, RESOLUTION_M) + 0.5 * RESOLUTION_M
    rise = 0.1 * np.clip(np.floor((x - 0.4) / 0.25) + 1, 0, 5)
    return HeightMap(np.repeat(rise[:, None], 100, axis=1).astype(np.float32), RESOLUTION_M, np.array([x.mean(), 0.0]))


def tell(name: str, what: str, times: np.ndarray) -> None:
    low, median, high, highest = np.percentile(times, [0, 50, 95, 99])
    print(f"  {name:7} {what:27} median {median:6.3f}  fastest {low:6.3f}  p95 {high:6.3f}  p99 {highest:6.3f}")


if __name__ == "__main__":
    main()
