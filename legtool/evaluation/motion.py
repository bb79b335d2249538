"""Measure the motion models on steps that they were not fitted to (motion paper, section IV-A)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from legtool.configs.motion import MotionEvalSettings
from legtool.datasets.motion.excitation import constant_commands
from legtool.datasets.motion.run import FittedMotion, load_run
from legtool.datasets.motion.samples import MotionData, check_same, load_transitions, motion_data
from legtool.datasets.work import RESULTS, claim
from legtool.errors import DatasetError
from legtool.evaluation.held_out import AXES, HeldOut, axis_unit
from legtool.evaluation.judges import judge_motion
from legtool.evaluation.motion_report import write_motion_report
from legtool.evaluation.report.intervals import FEWEST_BLOCKS, BlockBootstrap
from legtool.evaluation.report.results import Metric, keep_with_run, metric, provenance, write_results
from legtool.models.motion import FORMULATIONS, Z90, build, predict_frozen
from legtool_runtime.motion.features import TARGETS

Array = NDArray[np.float64]

#: What is compared: the formulations by least squares, the chosen one with intervals, and what shrinkage makes of the
#: second order, which least squares overfits.
_PREDICTORS = (*FORMULATIONS, "bayesian", "poly2_bayesian")


#: How logs are held out where there are several, and the steps that the others need to have for it.
WHOLE_LOGS, _FEWEST_TO_FIT = "whole logs", 100
#: What cross-validation does not show.
ONE_LOG = (
    "measured within the data that it was trained on: another day, ground or payload is not in these figures; measure "
    "on another log with --data"
)


def evaluate_motion(
    table: pa.Table,
    settings: MotionEvalSettings,
    *,
    model: FittedMotion | None = None,
    formulation: str = "full",
) -> tuple[dict[str, Metric], HeldOut]:
    """Measure by cross-validation, or a fitted run on data that it never saw.

    Args:
        table: transitions.
        settings: folds and bootstrap.
        model: where given, nothing is fitted, and the run's models predict every step.
        formulation: of the Bayesian models that are cross-validated; a given run's own otherwise.

    Returns:
        metrics by name, and the predictions behind them.

    Raises:
        DatasetError: too few steps, or values that are not finite.
    """
    steps = motion_data(table)
    if model is not None:
        if len(steps) < 2:
            raise DatasetError(f"{len(steps)} usable steps, expected at least 2 to measure on; collect more")
        block = _blocks(steps, settings)
        held_out = _apply(steps, model, block)
    else:
        held_out = _cross_validate(steps, settings, formulation)
    return measure(held_out, settings), held_out


def measure(held_out: HeldOut, settings: MotionEvalSettings) -> dict[str, Metric]:
    """The metrics of held-out predictions, with 95 % intervals from a bootstrap over blocks."""
    block = held_out.block
    bootstrap = BlockBootstrap(int(block.max()) + 1, samples=settings.bootstrap, seed=settings.seed)
    metrics: dict[str, Metric] = {}

    def add(name: str, values: Array, unit: str, *, root: bool = False) -> None:
        value, ci95 = bootstrap.mean(values, block, root=root)
        metrics[name] = metric(value, ci95, values.size, unit)

    for model, axes in AXES.items():
        for which in held_out.means:
            error = held_out.error(which, model)
            for axis, columns in axes.items():
                unit = axis_unit(model, axis)
                add(f"{model}.{which}.{axis}.rmse", error[:, columns] ** 2, unit, root=True)
                add(f"{model}.{which}.{axis}.mae", np.abs(error[:, columns]), unit)
            planar = [*axes["x"], *axes["y"]]
            add(f"{model}.{which}.mae", np.abs(error[:, planar]), axis_unit(model, "x"))
        inside = np.abs(held_out.error("bayesian", model)) <= Z90 * held_out.std[model]
        for axis, columns in axes.items():
            add(f"{model}.bayesian.{axis}.coverage90", inside[:, columns].astype(float), "1")
        for axis, columns in axes.items():
            spread = held_out.steps.targets[model][:, columns]
            add(f"{model}.naive.{axis}.rmse", (spread - spread.mean(axis=0)) ** 2, axis_unit(model, axis), root=True)
    stance = held_out.steps.stance_motion
    for number, axis in enumerate("xyz"):
        add(f"stance.foot_motion.{axis}.std", (stance[:, :, number] - stance[:, :, number].mean()) ** 2, "m", root=True)
    return metrics


def eval_motion(run_path: Path, settings: MotionEvalSettings, out: Path, *, data: Path | None = None) -> Iterator[str]:
    """Measure a run and write ``results.json`` and ``report.html``.

    Args:
        run_path: of ``train motion``.
        settings: folds and bootstrap.
        out: directory for both files.
        data: another dataset of the same robot and instant, measured without refitting; otherwise the run's own data
            by cross-validation.

    Yields:
        the main figures, line by line.

    Raises:
        DatasetError: the run or data are damaged, changed since, too small, or of another robot or instant.
        OutputError: ``out`` holds something else.
    """
    run = load_run(run_path)
    paths = [data] if data is not None else [Path(path) for path in run.data["paths"]]
    loaded = load_transitions(paths)
    check_same(
        f"the run {run_path}", run.robot.to_dict(), run.instant,
        str(paths[0]), loaded.robot.to_dict(), loaded.instant,
    )  # fmt: skip
    if data is None and loaded.info["hash"] != run.data["hash"]:
        raise DatasetError(f"{paths[0]}: changed since {run_path} was trained on it; train again, or give it as --data")
    with claim(out, RESULTS):
        metrics, held_out = evaluate_motion(
            loaded.table, settings, model=run if data is not None else None, formulation=run.formulation
        )
        where = provenance(
            settings.to_dict(),
            seed=settings.seed,
            data_hash=loaded.info["hash"],
            robot=run.robot.name,
            instant=run.instant,
            split=held_out.split,
            formulation=held_out.formulation,
            data=[str(path) for path in paths],
            trained_on=run.data["hash"],
            counts=loaded.info["counts"],
        )
        constant = constant_commands(held_out.steps.command)
        verdict = judge_motion(metrics, len(held_out.steps), constant)
        write_results(out / RESULTS.marker, metrics, where, verdict=verdict.to_dict())
        write_motion_report(out / "report.html", metrics, held_out, where, verdict)
    yield from keep_with_run(out / RESULTS.marker, run_path, "motion")
    yield f"{len(held_out.steps)} steps of {run.robot.name}, {held_out.split}"
    yield from summary(metrics)
    if (blocks := int(held_out.block.max()) + 1) < FEWEST_BLOCKS:
        yield (
            f"no 95 % intervals: {len(held_out.steps)} steps make {blocks} blocks, and {FEWEST_BLOCKS} are needed; "
            "collect more steps"
        )
    yield from verdict.lines()
    if data is None and WHOLE_LOGS not in held_out.split:
        yield ONE_LOG


def summary(metrics: dict[str, Metric]) -> list[str]:
    """The figures that one looks at first: the errors of the Bayesian models beside what their intervals hold."""
    lines = []
    for model in AXES:
        scale, unit = (1.0, "m/s") if model == "cvm" else (1e3, "mm")
        bayesian, plain = metrics[f"{model}.bayesian.x.rmse"], metrics[f"{model}.full.x.rmse"]
        mae = metrics[f"{model}.bayesian.mae"]
        covered = [metrics[f"{model}.bayesian.{axis}.coverage90"]["value"] for axis in AXES[model]]
        lines.append(
            f"{model.upper()}: RMSE on x {_with_interval(bayesian, scale)} {unit}, MAE over x and y "
            f"{scale * mae['value']:.3g} {unit}, 90 % intervals hold {100 * min(covered):.1f} to "
            f"{100 * max(covered):.1f} %; by least squares RMSE on x {_with_interval(plain, scale)} {unit}"
        )
    return lines


def _with_interval(entry: Metric, scale: float) -> str:
    interval = "" if entry["ci95"] is None else " [{:.3g}, {:.3g}]".format(*(scale * end for end in entry["ci95"]))
    return f"{scale * entry['value']:.3g}{interval}"


def _cross_validate(steps: MotionData, settings: MotionEvalSettings, formulation: str) -> HeldOut:
    needed = 3 * settings.folds
    if len(steps) < needed:
        raise DatasetError(
            f"{len(steps)} usable steps, expected at least {needed} for {settings.folds} folds; collect more, or "
            "measure a run on them with --data"
        )
    folds, split = _folds(steps, settings)
    means = {which: {m: np.empty_like(t) for m, t in steps.targets.items()} for which in _PREDICTORS}
    std = {model: np.empty_like(target) for model, target in steps.targets.items()}
    rows = np.arange(len(steps))
    outputs = np.concatenate(list(steps.targets.values()), axis=1)
    ends = np.cumsum([target.shape[1] for target in steps.targets.values()])
    splits = {
        model: slice(end - target.shape[1], end)
        for (model, target), end in zip(steps.targets.items(), ends, strict=True)
    }
    for fold in folds:
        rest = np.delete(rows, fold)
        seen, unseen = steps.features[rest], steps.features[fold]
        for which in FORMULATIONS:  # least squares takes each output by itself: all of them in one fit
            together = build("ols", which).fit(seen, outputs[rest]).predict(unseen)
            for model, columns in splits.items():
                means[which][model][fold] = together[:, columns]
        for model, target in steps.targets.items():
            bayesian = build("bayesian", formulation).fit(seen, target[rest])
            means["bayesian"][model][fold], std[model][fold] = bayesian.predict(unseen, return_std=True)
            shrunk = build("bayesian", "poly2", folds=0).fit(seen, target[rest])
            means["poly2_bayesian"][model][fold] = shrunk.predict(unseen)
    return HeldOut(steps, means, std, _blocks(steps, settings), split, formulation)


def _apply(steps: MotionData, run: FittedMotion, block: NDArray[np.intp]) -> HeldOut:
    means: dict[str, dict[str, Array]] = {
        which: {m: predict_frozen(run.models["ols"][which][m], steps.features)[0] for m in TARGETS}
        for which in FORMULATIONS
    }
    bayesian = {m: predict_frozen(run.models["bayesian"][run.formulation][m], steps.features) for m in TARGETS}
    means["bayesian"] = {m: mean for m, (mean, _) in bayesian.items()}
    shrunk = run.models["bayesian"]["poly2"]
    means["poly2_bayesian"] = {m: predict_frozen(shrunk[m], steps.features)[0] for m in TARGETS}
    std = {m: deviation for m, (_, deviation) in bayesian.items()}
    return HeldOut(steps, means, std, block, "a run's models on data that they never saw", run.formulation)


def _by_episode(steps: MotionData, settings: MotionEvalSettings) -> bool:
    episodes = len(np.unique(steps.group))
    if settings.split == "episode" and episodes < settings.folds:
        raise DatasetError(f"{episodes} episodes, expected at least one for each of {settings.folds} folds; use "
                           "--set split=contiguous, or --set folds=...")  # fmt: skip
    return settings.split == "episode" or (settings.split == "auto" and episodes >= settings.folds)


def _by_log(steps: MotionData) -> bool:
    """Whether there are several logs, and whichever is held out, the others are enough to fit to."""
    _, counts = np.unique(steps.group, return_counts=True)
    return len(counts) > 1 and len(steps) - int(counts.max()) >= _FEWEST_TO_FIT


def _folds(steps: MotionData, settings: MotionEvalSettings) -> tuple[list[NDArray[np.intp]], str]:
    if _by_episode(steps, settings):
        episodes = np.random.default_rng(settings.seed).permutation(np.unique(steps.group))
        folds = [np.flatnonzero(np.isin(steps.group, part)) for part in np.array_split(episodes, settings.folds)]
        return folds, f"{settings.folds}-fold cross-validation, whole episodes held out"
    if settings.split == "auto" and _by_log(steps):
        logs = [np.flatnonzero(steps.group == log) for log in np.unique(steps.group)]
        return logs, f"{len(logs)}-fold cross-validation, {WHOLE_LOGS} held out"
    folds = np.array_split(np.arange(len(steps)), settings.folds)
    return folds, f"{settings.folds}-fold cross-validation, contiguous blocks held out"


def _blocks(steps: MotionData, settings: MotionEvalSettings) -> NDArray[np.intp]:
    """Whole episodes where they are many, runs of consecutive steps otherwise."""
    if settings.split != "contiguous" and len(np.unique(steps.group)) >= settings.folds:
        return steps.group
    starts = np.flatnonzero(np.diff(steps.group, prepend=-1))
    within = np.arange(len(steps)) - starts[np.searchsorted(starts, np.arange(len(steps)), side="right") - 1]
    return np.cumsum(within % settings.block_steps == 0) - 1
