"""The whole way once, on a small simulated sweep: collect, train, evaluate, export, load, predict."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import legtool_runtime
from legtool.configs.export import ExportSettings
from legtool.configs.motion import MotionEvalSettings, MotionTrainSettings
from legtool.configs.sweep import SweepSettings
from legtool.datasets.store import claim_directory
from legtool.evaluation.motion import eval_motion
from legtool.info import format_counts
from legtool.models.motion import Z90
from legtool.pipeline.sweep import collect_sweep
from legtool.training.export import export_bundle
from legtool.training.motion import train_motion

DATA, RUN, REPORT, BUNDLE = "data", "run", "report", "bundle"
#: Ten simulated minutes: enough steps for every formulation, few enough for a minute's work.
EPISODES = 20


def run_demo(out: Path, *, seed: int, workers: int) -> Iterator[str]:
    """Run every stage of the motion line below ``out``; what an earlier run finished there is kept.

    Yields:
        what was done, line by line.

    Raises:
        LegtoolError: whatever a stage refuses; ``out`` holding something else first of all.
    """
    claim_directory(out, DATA)
    sweep = SweepSettings(seed=seed, episodes=EPISODES)
    yield f"1/4 collect: {sweep.episodes} episodes of {sweep.episode_s:g} s of a simulated {sweep.robot}"
    manifest = collect_sweep(sweep, out / DATA, workers=workers)
    yield format_counts(manifest["counts"])
    yield "2/4 train: FDM, CDM and CVM in four formulations"
    yield from train_motion([out / DATA], MotionTrainSettings(seed=seed), out / RUN, workers=workers)
    yield "3/4 eval: episodes that the fit never saw"
    settings = MotionEvalSettings(seed=seed)
    yield from eval_motion(out / RUN, settings, out / REPORT, data=None, workers=workers)
    yield "4/4 export, and predict with the runtime"
    if not (out / BUNDLE).exists():
        measured = out / REPORT / "results.json"
        export_bundle([out / RUN], out / BUNDLE, ExportSettings(seed=seed, results=(measured,)))
    yield from _predict(out / BUNDLE)
    yield f"report: {out / REPORT / 'report.html'}"
    yield f"bundle: {out / BUNDLE}"


def _predict(path: Path) -> Iterator[str]:
    """One prediction as a robot would ask for it: standing, and told to walk."""
    bundle = legtool_runtime.load_bundle(path)
    rest = np.zeros(3)
    state = legtool_runtime.MotionState(rest, rest, rest, bundle.robot.stance, swing_pair=0)
    speeds = (0.2, 0.5)
    step = bundle.motion.predict(state, [[speed, 0.0, 0.0] for speed in speeds])
    for index, speed in enumerate(speeds):
        foot = 1e3 * step.foot_displacement[index, 0, 0]
        half = 1e3 * Z90 * step.foot_displacement_std[index, 0, 0]
        yield f"  from rest at {speed} m/s the front left foot goes {foot:.0f} mm ± {half:.0f} mm (90 %)"
