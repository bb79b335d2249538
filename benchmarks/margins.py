"""What a price on missteps, by the models' own spread, buys: steps into gaps and headway, beside fixed margins.

    python benchmarks/margins.py [BUNDLE] [--walks 200] [--horizon 5]

Walks over the models themselves, with their noise, on the paper's scenarios as strips of unsafe ground; physics and map
play no part here. Without a bundle the made-up walker of the runtime's tests walks.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from planner import SCENARIOS
from scipy.stats import binomtest

from legtool_runtime import load_bundle
from legtool_runtime.motion.planning.planner import Goal, Planner, PlannerSettings, planar_commands

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "runtime" / "tests" / "motion"))
import walker  # type: ignore[import-not-found]  # of the runtime's tests, found by the path above

#: Name, margin_m, misstep_cost_m.
POLICIES = (
    ("the paper's bare check", 0.0, 0.0),
    ("fixed 2 cm", 0.02, 0.0),
    ("fixed 3.5 cm", 0.035, 0.0),
    ("fixed 5 cm", 0.05, 0.0),
    ("misstep costs 0.25 m", 0.0, 0.25),
    ("misstep costs 0.5 m", 0.0, 0.5),
    ("0.5 m, misstep from 1 cm", 0.01, 0.5),
    ("1 m, misstep from 1 cm", 0.01, 1.0),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bundle", nargs="?")
    parser.add_argument("--walks", type=int, default=200, help="of each policy, over the three scenarios in turn")
    parser.add_argument("--horizon", type=int, default=5)
    options = parser.parse_args()
    bundle = None if options.bundle is None else load_bundle(options.bundle)
    model, robot = (walker.model(), walker.ROBOT) if bundle is None else (bundle.motion, bundle.robot)
    commands = planar_commands(np.round(np.arange(-3, 11) * 0.1, 1), [0.0], [0.0])
    maps = [walker.strip(*gaps, unknown_unsafe=True) for gaps in SCENARIOS.values()]
    for name, margin, misstep_cost in POLICIES:
        settings = PlannerSettings(
            horizon=options.horizon,
            margin_m=margin,
            misstep_cost_m=misstep_cost,
            steering_rad_s=0.0,
            deadline_s=None,
        )
        planner = Planner(model, robot, commands=commands, settings=settings)
        planner.warm_up()
        clean = arrived = missteps = steps = 0
        for seed in range(options.walks):
            x, missed, plans = walker.walk(planner, model, maps[seed % len(maps)], Goal(4.2, 0.0), steps=60, seed=seed)
            arrived += x > 3.9
            clean += x > 3.9 and not missed
            missteps += missed
            steps += len(plans)
        low, high = binomtest(clean, options.walks).proportion_ci(method="wilson")
        print(
            f"{name:24} clean {clean}/{options.walks} [{100 * low:.0f}, {100 * high:.0f} %]  arrived {arrived}  "
            f"steps into gaps {1e3 * missteps / steps:.1f} per 1000  steps per walk {steps / options.walks:.1f}"
        )


if __name__ == "__main__":
    main()
