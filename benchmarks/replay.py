"""How fast a recorded walk with depth images is replayed on one core, and whether its plans are the same again.

A walk of about ``--seconds`` over gaps is simulated with a bundle of motion models, recorded with its camera at 15 Hz,
and replayed in a process of its own that is held to one core. Run it with ``python benchmarks/replay.py BUNDLE``;
``--recording`` takes a recording that was made before.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

#: Of the course: metres for each second of the walk, and the way between two gaps [m].
PACE, APART = 0.5, 3.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--recording", type=Path)
    parser.add_argument("--replay", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.replay:
        print(json.dumps(measure(options.recording, options.bundle)))
        return
    with tempfile.TemporaryDirectory() as folder:
        recording = options.recording or record(Path(folder), options.bundle, options.seconds)
        command = [sys.executable, __file__, str(options.bundle), "--recording", str(recording), "--replay"]
        for _ in range(options.repeats):
            told = json.loads(
                subprocess.run(
                    command, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
                ).stdout
            )
            seconds = told["duration_s"]
            times = ", ".join(
                f"{what} {told[key]:.1f} s ({seconds / told[key]:.1f} times real time)"
                for what, key in (("loop", "loop_s"), ("whole command", "whole_s"), ("of the processor", "cpu_s"))
            )
            print(f"{seconds:.1f} s, {told['images']:g} images, {told['plans']} plans: {times}")
            print(f"  ticks at which the plan is what was commanded: {100 * told['same']:.2f} %")


def record(folder: Path, bundle: Path, seconds: float) -> Path:
    """Walk once over a course of gaps, and record what the robot saw."""
    from legtool.configs.planner import PlannerEvalSettings
    from legtool.evaluation.suites.planner import eval_planner

    length = PACE * seconds
    gaps = "".join(f"  - {{x: {1.5 + APART * k:.2f}, width: 0.10}}\n" for k in range(int((length - 2) / APART)))
    world = folder / "long.yaml"
    world.write_text(f"name: long\nlength: {length:.1f}\ngaps:\n{gaps}")
    settings = PlannerEvalSettings(
        suite=str(world), planners=("velocity",), horizons=(5,), trials=1, films=0, record_images=True,
        timeout_s=min(4 * seconds, 600.0),
    )  # fmt: skip
    for line in eval_planner(bundle, settings, folder / "walk"):
        print(line, flush=True)
    return folder / "walk" / "recordings" / "long.h5.mcap"


def measure(recording: Path, bundle: Path) -> dict[str, float]:
    """Replay it on one core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    from legtool.configs.replay import ReplaySettings
    from legtool.evaluation.replay.replay import replay

    began, worked = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for _ in replay([recording], bundle, ReplaySettings(topics="legtool"), Path(folder) / "out"):
            pass
        whole, cpu = time.perf_counter() - began, time.process_time() - worked
        metrics = json.loads((Path(folder) / "out" / "results.json").read_text())["metrics"]
    duration = metrics["duration"]["value"]
    return {
        "duration_s": duration,
        "loop_s": duration / metrics["speed"]["value"],
        "whole_s": whole,
        "cpu_s": cpu,
        "images": metrics["images"]["value"],
        "plans": metrics["plans.whole"]["n"],
        "same": metrics["plans.as_commanded"]["value"],
    }


if __name__ == "__main__":
    main()
