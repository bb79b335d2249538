"""The campaign of docs/arena.md: planners beside each other on the worlds of three papers, stage by stage.

    python benchmarks/arena.py OUT --em-rl anymal_c_em_rl.pt --em-dtc anymal_d_dtc_stones.pt [--bundle BUNDLE]

A trial that is finished is a file below OUT, and no stage walks it again: the command may be interrupted at any time
and started anew, with other stages or more trials. Tables are printed; results and page of each stage are kept as
OUT/STAGE.json and OUT/STAGE.html. Without --bundle the planner ``velocity`` is left out, without a policy's file the
policy.

Stages: ``stones`` (superpixels against elevation maps), ``policies`` (EM-RL and EM-DTC where the paper has them
succeed), ``search`` (quadpips against S-MPC), ``arena`` (all planners in all worlds), ``ablations`` (quadpips with one
thing changed).
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any, NamedTuple

from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.settings import build
from legtool.datasets.work import RESULTS
from legtool.errors import LegtoolError
from legtool.evaluation.suites.planner import eval_planner

POLICIES = ("em_rl", "em_dtc")
#: What quadpips does without, or does otherwise, one thing in each row.
ABLATIONS = (
    "quadpips",
    "quadpips[pips.candidates.centroids=true]",  # one candidate a region, as in the paper
    "quadpips[pips.walkability.inverse_kinematics=false]",  # superquadrics alone
    "quadpips[pips.cost_to_go=false]",  # the Euclidean distance guides the search
    "quadpips[pips.walkability.margin_m=0;pips.candidates.least_margin=0]",
    "quadpips[swing=optimised;swing_window=1]",
    "quadpips[swing=optimised;swing_window=3]",
    "quadpips[monitor=looks]",
    "quadpips[warm_start=false]",  # of superpixels
    "quadpips[pips.walkability.anew_m=0;pips.torso.kept_m=0]",  # of searches: nothing is held on to
    "quadpips[regions=truth]",
)


class Stage(NamedTuple):
    """Worlds, planners, and how many times more trials than asked for."""

    suite: str
    planners: tuple[str, ...]
    times: int = 1


STAGES = {
    "stones": Stage("sparse_stepping_stones", ("s_mpc", "em_mpc", "em_mpc_6cm")),
    "policies": Stage("ramp,quadpips_stairs,rubble", POLICIES),
    "search": Stage("sparse_stepping_stones,obstructed_balance_beam,winding_balance_beam", ("quadpips", "s_mpc")),
    "arena": Stage(
        "arena",
        ("quadpips", "quadpips_paper", "s_mpc", "em_mpc", "em_mpc_6cm", *POLICIES, "vital", "velocity", "blind"),
    ),
    "ablations": Stage("sparse_stepping_stones,ramped_balance_beam,pegboard", ABLATIONS, times=2),
}


def walk(name: str, options: argparse.Namespace) -> None:
    stage = STAGES[name]
    files = {row: getattr(options, row) for row in POLICIES}
    left_out = [row for row, path in files.items() if path is None] + (["velocity"] if options.bundle is None else [])
    planners = tuple(row for row in stage.planners if row not in left_out)
    values: dict[str, Any] = {
        "suite": stage.suite, "planners": planners, "robot": options.robot, "trials": options.trials * stage.times,
        "seed": options.seed, "horizons": (5,), "films": options.films,
        "policies": {row: path for row, path in files.items() if path is not None},
    }  # fmt: skip
    print(f"stage {name}: {stage.suite} by {', '.join(planners)}", flush=True)
    settings = build(PlannerEvalSettings, values)
    for line in eval_planner(options.bundle, settings, options.out, workers=options.workers):
        print(line, flush=True)
    shutil.copyfile(options.out / RESULTS.marker, options.out / f"{name}.json")
    shutil.copyfile(options.out / "report.html", options.out / f"{name}.html")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--em-rl", type=Path)
    parser.add_argument("--em-dtc", type=Path)
    parser.add_argument("--bundle", type=Path, help="with a motion line for the robot")
    parser.add_argument("--robot", default="anymal_c")
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--seed", type=int, default=50)
    parser.add_argument("--films", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--stages", default=",".join(STAGES))
    options = parser.parse_args()
    for name in options.stages.split(","):
        if name not in STAGES:
            print(f"stage {name}: expected one of {', '.join(STAGES)}", file=sys.stderr)
            return 2
        try:
            walk(name, options)
        except LegtoolError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
