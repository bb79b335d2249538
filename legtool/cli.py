"""The command line: parse, call one function, print, exit. The work is done in the modules that the commands name."""

from __future__ import annotations

import functools
import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

_OPTIONS: dict[str, Any] = {
    "no_args_is_help": True,
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
}
app = typer.Typer(help="Models of a black-box walking controller, from its own logs and from simulation.", **_OPTIONS)
collect = typer.Typer(help="Gather data: simulated sweeps, robot logs.", **_OPTIONS)
train = typer.Typer(help="Fit models to a dataset.", **_OPTIONS)
evaluate = typer.Typer(help="Measure a run: results.json and report.html.", **_OPTIONS)
app.add_typer(collect, name="collect")
app.add_typer(train, name="train")
app.add_typer(evaluate, name="eval")

Out = Annotated[Path | None, typer.Option("--out", help="Directory to write; new, empty, or to be carried on.")]
Config = Annotated[Path | None, typer.Option("--config", help="YAML file of settings.")]
Set = Annotated[list[str] | None, typer.Option("--set", help="One setting, key=value; repeatable.")]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of everything random.")]
Workers = Annotated[int | None, typer.Option("--workers", min=1, help="Processes; the result does not depend on it.")]
ShowConfig = Annotated[bool, typer.Option("--show-config", help="Print the full settings as YAML and exit.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
RobotName = Annotated[str | None, typer.Option("--robot", help="Preset or YAML file.")]


def command(group: typer.Typer, name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command whose errors end in one line and exit code 2."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> None:
            try:
                function(*args, **kwargs)
            except typer.Exit:
                raise
            except KeyboardInterrupt:
                _stop("interrupted: what was finished is kept; run the same command again to carry on", 130)
            except Exception as error:
                if kwargs.get("debug"):
                    raise
                _stop(*_explain(error))

        return group.command(name)(run)

    return register


def _explain(error: Exception) -> tuple[str, int]:
    from legtool.errors import LegtoolError

    if isinstance(error, LegtoolError):
        return f"error: {error}", 2
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"error: {where}{error.strerror or error}", 2
    kind = type(error).__name__
    return f"internal error: {kind}: {error}; run again with --debug for the traceback, and report it", 1


def _stop(message: str, code: int) -> None:
    print(" ".join(message.split()), file=sys.stderr)
    raise typer.Exit(code)


def _required(path: Path | None, option: str = "--out", advice: str = "name the directory to write") -> Path:
    if path is None:
        from legtool.errors import SettingsError

        raise SettingsError(f"{option} is missing: {advice}")
    return path


def _settings(name: str, config: Path | None, overrides: list[str] | None, show: bool, **named: Any) -> Any:
    """Settings of a command by ``module:class`` below legtool.configs; with ``show`` print them and exit."""
    from legtool.configs.settings import load

    module, _, attribute = name.partition(":")
    cls = getattr(importlib.import_module(f"legtool.configs.{module}"), attribute)
    settings = load(cls, config, overrides or (), **named)
    if show:
        print(settings.to_yaml(), end="")
        raise typer.Exit(0)
    return settings


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@command(collect, "sweep")
def collect_sweep(
    out: Out = None,
    robot: RobotName = None,
    mjcf: Annotated[Path | None, typer.Option("--mjcf", help="Your own MuJoCo model of the robot.")] = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Drive a controller through all pairs of commands in MuJoCo and cut its steps into transitions."""
    settings = _settings(
        "sweep:SweepSettings", config, set_, show_config, robot=robot, mjcf=mjcf and str(mjcf), seed=seed
    )
    from legtool.pipeline.sweep import collect_sweep as run

    _say_collected(run(settings, _required(out), workers=workers or _cores()), _required(out))


@command(collect, "log")
def collect_log(
    paths: Annotated[list[Path] | None, typer.Argument(help="Logs: .bag, bag directory, .db3, .mcap, .csv.")] = None,
    out: Out = None,
    robot: RobotName = None,
    topics: Annotated[str | None, typer.Option("--topics", help="Preset or YAML file.")] = None,
    msgs: Annotated[Path | None, typer.Option("--msgs", help="Directory of custom .msg definitions.")] = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Cut a real robot's logs into transitions."""
    settings = _settings("log:LogSettings", config, set_, show_config, robot=robot, topics=topics, msgs=msgs, seed=seed)
    from legtool.pipeline.log import collect_log as run

    _say_collected(run(paths or [], settings, _required(out), workers=workers or 1), _required(out))


@command(collect, "footholds")
def collect_footholds(
    robot: RobotName = None,
    samples: Annotated[int | None, typer.Option("--samples", min=1, help="Heightmaps.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Draw heightmaps from random terrain and label them by the foothold evaluation criteria."""
    named = {"robot": robot, "samples": samples, "seed": seed}
    settings = _settings("footholds:FootholdSettings", config, set_, show_config, **named)
    from legtool.pipeline.footholds import collect_footholds as run

    manifest = run(settings, _required(out), workers=workers or _cores())
    print(f"wrote {out}: {manifest['rows']} labelled heightmaps for {settings.robot}")
    print(f"next: legtool train vfa {out} --out RUN, or legtool train vpa {out} --out RUN")


@command(collect, "scenes")
def collect_scenes(
    robot: RobotName = None,
    scenes: Annotated[int | None, typer.Option("--scenes", min=1, help="Scenes.")] = None,
    frames: Annotated[int | None, typer.Option("--frames", min=1, help="Frames of each scene.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Render scenes of primitive shapes: depth, and what a foot may do on each pixel."""
    named = {"robot": robot, "scenes": scenes, "frames": frames, "seed": seed}
    settings = _settings("scenes:SceneSettings", config, set_, show_config, **named)
    from legtool.pipeline.scenes import collect_scenes as run

    manifest = run(settings, _required(out), workers=workers or _cores())
    print(f"wrote {out}: {manifest['rows']} labelled frames\nnext: legtool train steppability {out} --out RUN")


def _say_collected(manifest: dict[str, Any], out: Path) -> None:
    from legtool.info import format_counts

    steps, robot = manifest["counts"].get("steps", 0), manifest["robot"]["name"]
    print(f"wrote {out}: {steps:g} usable steps of {robot}, states at {manifest['instant']}")
    print(format_counts(manifest["counts"]))
    print(f"next: legtool train motion {out} --out RUN")


@command(train, "motion")
def train_motion(
    data: Annotated[list[Path] | None, typer.Argument(help="Datasets of transitions.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Fit the displacement and velocity models (FDM, CDM, CVM)."""
    settings = _settings("motion:MotionTrainSettings", config, set_, show_config, seed=seed)
    from legtool.training.motion import train_motion as run

    out = _required(out)
    for line in run(data or [], settings, out, workers=workers or _cores()):
        print(line)
    print(f"wrote {out}\nnext: legtool eval motion {out} --out REPORT, or legtool export {out} --out BUNDLE")


@command(train, "vfa")
def train_vfa(
    data: Annotated[list[Path] | None, typer.Argument(help="Datasets of collect footholds.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Train a network that chooses footholds (VFA)."""
    settings = _settings("footholds:FootholdTrainSettings", config, set_, show_config, seed=seed)
    from legtool.training.foothold import train_foothold as run

    out = _required(out)
    for line in run("vfa", data or [], settings, out, workers=workers or _cores()):
        print(line)
    print(f"wrote {out}\nnext: legtool eval vfa {out} --data FRESH --out REPORT")


@command(train, "vpa")
def train_vpa(
    data: Annotated[list[Path] | None, typer.Argument(help="Datasets of collect footholds.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Train a network that counts safe footholds over hip heights (VPA)."""
    settings = _settings("footholds:FootholdTrainSettings", config, set_, show_config, seed=seed)
    from legtool.training.foothold import train_foothold as run

    out = _required(out)
    for line in run("vpa", data or [], settings, out, workers=workers or _cores()):
        print(line)
    print(f"wrote {out}\nnext: legtool eval vpa {out} --data FRESH --out REPORT")


@command(train, "steppability")
def train_steppability(
    data: Annotated[list[Path] | None, typer.Argument(help="Datasets of collect scenes.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Train the steppability segmenter (DeepLabV3+)."""
    settings = _settings("steppability:SteppabilityTrainSettings", config, set_, show_config, seed=seed)
    from legtool.training.steppability import train_steppability as run

    out = _required(out)
    for line in run(data or [], settings, out, workers=workers or _cores()):
        print(line)
    print(f"wrote {out}\nnext: legtool eval steppability {out} --out REPORT")


@command(evaluate, "motion")
def eval_motion(
    run_path: Annotated[Path, typer.Argument(metavar="RUN", help="A run of train motion.")],
    data: Annotated[Path | None, typer.Option("--data", help="Another dataset: measured without refitting.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Measure the motion models on data that they were not fitted to."""
    settings = _settings("motion:MotionEvalSettings", config, set_, show_config, seed=seed)
    from legtool.evaluation.motion import eval_motion as run

    out = _required(out)
    for line in run(run_path, settings, out, data=data, workers=workers or _cores()):
        print(line)
    print(f"wrote {out / 'results.json'} and {out / 'report.html'}\nnext: legtool export {run_path} --out BUNDLE")


@command(evaluate, "planner")
def eval_planner(
    bundle: Annotated[Path | None, typer.Option("--bundle", help="A bundle with a motion line.")] = None,
    suite: Annotated[
        str | None, typer.Option("--suite", help="scenarios, gaps, stairs, or courses with commas.")
    ] = None,
    trials: Annotated[int | None, typer.Option("--trials", min=1, help="Of each course and horizon.")] = None,
    horizons: Annotated[str | None, typer.Option("--horizons", help="Steps to look ahead, with commas.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Walk courses in closed loop in MuJoCo, planned and blind."""
    looks = None if horizons is None else horizons.split(",")
    named = {"suite": suite, "trials": trials, "horizons": looks, "seed": seed}
    settings = _settings("planner:PlannerEvalSettings", config, set_, show_config, **named)
    from legtool.evaluation.planner import eval_planner as run

    out = _required(out)
    for line in run(_required(bundle, "--bundle", "name the bundle to plan with"), settings, out, workers=workers or 1):
        print(line)
    print(f"wrote {out / 'results.json'}, {out / 'report.html'} and {out / 'recordings'}")


def _eval_foothold(
    run_path: Path | None, data: Path | None, settings: Any, out: Path | None, workers: int | None
) -> None:
    from legtool.evaluation.foothold import eval_foothold as run

    run_path = _required(run_path, "RUN", "name a run of train vfa or train vpa")
    data = _required(data, "--data", "name a dataset of collect footholds with another seed than the training's")
    out = _required(out)
    for line in run(run_path, data, settings, out, workers=workers or _cores()):
        print(line)
    print(f"wrote {out / 'results.json'}")


@command(evaluate, "vfa")
def eval_vfa(
    run_path: Annotated[Path | None, typer.Argument(metavar="RUN", help="A run of train vfa.")] = None,
    data: Annotated[Path | None, typer.Option("--data", help="Fresh terrain, from collect footholds.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Measure a foothold network on terrain it never saw."""
    settings = _settings("footholds:FootholdEvalSettings", config, set_, show_config, seed=seed)
    _eval_foothold(run_path, data, settings, out, workers)


@command(evaluate, "vpa")
def eval_vpa(
    run_path: Annotated[Path | None, typer.Argument(metavar="RUN", help="A run of train vpa.")] = None,
    data: Annotated[Path | None, typer.Option("--data", help="Fresh terrain, from collect footholds.")] = None,
    suite: Annotated[
        str | None, typer.Option("--suite", help="vital: the paper's courses, with exact criteria.")
    ] = None,
    robot: RobotName = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Measure a pose network on fresh terrain; or with --suite vital pose adaptation itself on the paper's courses."""
    settings = _settings("footholds:FootholdEvalSettings", config, set_, show_config, seed=seed)
    if suite is None:
        _eval_foothold(run_path, data, settings, out, workers)
        return
    from legtool.errors import SettingsError
    from legtool.evaluation.vital import eval_vital

    if suite != "vital":
        raise SettingsError(f"--suite {suite}: expected vital")
    out = _required(out)
    for line in eval_vital(robot or "hyq", out):
        print(line)
    print(f"wrote {out / 'results.json'}")


@command(evaluate, "steppability")
def eval_steppability(
    run_path: Annotated[Path, typer.Argument(metavar="RUN", help="A run of train steppability.")],
    data: Annotated[Path | None, typer.Option("--data", help="Another dataset of scenes.")] = None,
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    workers: Workers = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Measure the segmenter on scenes it never saw."""
    settings = _settings("steppability:SteppabilityEvalSettings", config, set_, show_config, seed=seed)
    from legtool.evaluation.steppability import eval_steppability as run

    out = _required(out)
    for line in run(run_path, settings, out, data=data, workers=workers or _cores()):
        print(line)
    print(f"wrote {out / 'results.json'} and {out / 'report.html'}")


@command(app, "export")
def export(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Runs, at most one of each line.")],
    out: Out = None,
    config: Config = None,
    set_: Set = None,
    seed: Seed = None,
    show_config: ShowConfig = False,
    debug: Debug = False,
) -> None:
    """Freeze runs into a bundle that legtool_runtime loads without torch."""
    settings = _settings("export:ExportSettings", config, set_, show_config, seed=seed)
    from legtool.training.export import export_bundle

    out = _required(out)
    export_bundle(runs, out, settings)
    print(f"wrote {out}; read {out / 'CARD.md'}")
    print(f"next: python -c \"import legtool_runtime; print(legtool_runtime.load_bundle('{out}'))\"")


@command(app, "info")
def info(
    path: Annotated[Path, typer.Argument(help="A recording, dataset, run, bundle or results.")],
    debug: Debug = False,
) -> None:
    """Say what a path holds, with counts, and verify its hashes."""
    from legtool.info import describe

    print("\n".join(describe(path)))


@command(app, "demo")
def demo(
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    debug: Debug = False,
) -> None:
    """Collect a short simulated sweep, train, evaluate and export: the whole way in minutes."""
    from legtool.demo import run_demo

    for line in run_demo(_required(out), seed=seed or 0, workers=workers or _cores()):
        print(line, flush=True)


def main() -> None:
    """Entry point of the ``legtool`` command."""
    app()
