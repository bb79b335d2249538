"""Fit the motion models to transitions, in every formulation and by every estimator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from legtool.configs.motion import MotionTrainSettings
from legtool.datasets.logs.recording import Instant
from legtool.datasets.motion.excitation import constant_commands
from legtool.datasets.motion.run import FittedMotion, load_run, save_run
from legtool.datasets.motion.samples import MotionData, check_same, load_transitions, motion_data
from legtool.datasets.store import load_manifest
from legtool.errors import DatasetError
from legtool.models.motion import ESTIMATORS, FORMULATIONS, build, conformal_factors, rescaled
from legtool.provenance import commit, versions
from legtool_runtime.robot import Robot

__all__ = ["FittedMotion", "fit_motion", "load_run", "save_run", "train_motion"]


def fit_motion(
    table: pa.Table,
    settings: MotionTrainSettings,
    *,
    robot: Robot,
    instant: Instant,
    data: dict[str, Any] | None = None,
) -> FittedMotion:
    """Fit all formulations of FDM, CDM and CVM by both estimators.

    Args:
        table: transitions, from ``cut_transitions`` or a dataset.
        settings: which formulation and estimator are chosen, and how the Bayesian one is calibrated.
        robot: the robot that took the steps.
        instant: the instant at which states were taken.
        data: what to record about the origin of the data.

    Raises:
        DatasetError: there are too few usable steps, or values are not finite.
    """
    steps = motion_data(table)
    if len(steps) < settings.min_steps:
        raise DatasetError(
            f"{len(steps)} usable steps, expected at least {settings.min_steps} (min_steps) to fit 24 inputs and an "
            "intercept; collect more data"
        )
    models = {
        estimator: {
            formulation: {
                name: build(estimator, formulation, folds=settings.folds).fit(steps.features, target).frozen()
                for name, target in steps.targets.items()
            }
            for formulation in FORMULATIONS
        }
        for estimator in ESTIMATORS
    }
    scores: dict[str, float] = {}
    formulation: str = settings.formulation
    if formulation == "best":
        scores = {name: _score(steps, settings.estimator, name, settings.folds) for name in FORMULATIONS}
        formulation = min(scores, key=lambda name: scores[name])
    return FittedMotion(
        robot=robot,
        instant=instant,
        formulation=formulation,  # type: ignore[arg-type]  # a key of FORMULATIONS by now
        estimator=settings.estimator,
        settings=settings.to_dict(),
        data={"steps": len(steps), **(data or {})},
        scores=scores,
        models=models,
    )


def recalibrate(fitted: FittedMotion, table: pa.Table, data: dict[str, Any]) -> FittedMotion:
    """Scale the Bayesian models' intervals by steps that they were not fitted to (:func:`.conformal_factors`).

    Args:
        fitted: to data of other logs; least squares keeps the paper's intervals.
        table: transitions of the held-out logs.
        data: where they are from; ``data["recalibrated"]`` of what is returned, with their number and all factors.

    Raises:
        DatasetError: there are too few steps, or they are those of the fit.
    """
    steps, least = motion_data(table), fitted.settings["min_steps"]
    if len(steps) < least:
        raise DatasetError(f"{len(steps)} usable steps to calibrate on, expected at least {least}; collect more data")
    if data["hash"] == fitted.data["hash"]:
        raise DatasetError("--calibrate names the data that the models are fitted to; name logs that they never saw")
    models, factors = fitted.models["bayesian"], {}
    for formulation, held in models.items():
        found = {name: conformal_factors(held[name], steps.features, y) for name, y in steps.targets.items()}
        factors[formulation] = {name: values.tolist() for name, values in found.items()}
    noted = {"steps": len(steps), "factors": factors, **data}
    return apply_factors(replace(fitted, data={**fitted.data, "recalibrated": noted}))


def apply_factors(fitted: FittedMotion) -> FittedMotion:
    """The same with the factors of ``data["recalibrated"]`` applied, where there are any."""
    noted = fitted.data.get("recalibrated")
    if noted is None:
        return fitted
    scaled = {
        formulation: {
            name: rescaled(frozen, np.array(noted["factors"][formulation][name])) for name, frozen in held.items()
        }
        for formulation, held in fitted.models["bayesian"].items()
    }
    return replace(fitted, models={**fitted.models, "bayesian": scaled})


def train_motion(
    paths: Sequence[Path], settings: MotionTrainSettings, out: Path, *, calibrate: Path | None = None
) -> Iterator[str]:
    """Fit to datasets of one robot and write a run.

    Args:
        paths: datasets of ``collect``.
        settings: of the fit.
        out: the run's directory.
        calibrate: dataset of logs that intervals are scaled by afterwards; None: by what is left out of the fits.

    Yields:
        What was done, line by line.

    Raises:
        DatasetError: there is no dataset, robots or instants are mixed, there are too few steps, or they are the same.
        OutputError: ``out`` holds something else.
    """
    loaded = load_transitions(paths)
    held_out = None if calibrate is None else load_transitions([calibrate])
    if held_out is not None:
        robots = loaded.robot.to_dict(), held_out.robot.to_dict()
        check_same(f"{paths[0]}", robots[0], loaded.instant, f"{calibrate}", robots[1], held_out.instant)
    fitted = fit_motion(loaded.table, settings, robot=loaded.robot, instant=loaded.instant, data=loaded.info)
    if held_out is not None:
        fitted = recalibrate(fitted, held_out.table, held_out.info)
    save_run(fitted, out, provenance={"commit": commit(), "versions": versions()})
    yield (
        f"fitted {len(FORMULATIONS)} formulations by {len(ESTIMATORS)} estimators to {fitted.data['steps']} steps; "
        f"chosen to be exported: {fitted.formulation}, {fitted.estimator}; states at {fitted.instant}"
    )
    if noted := fitted.data.get("recalibrated"):
        of_all = [factor for values in noted["factors"][fitted.formulation].values() for factor in values]
        yield (
            f"intervals of the Bayesian models scaled by {min(of_all):.2f} to {max(of_all):.2f}, so that 90 % ones "
            f"hold 90 % of {noted['steps']} steps of {calibrate} (split conformal)"
        )
    yield from constant_commands(motion_data(loaded.table).command)
    for path in paths:
        if load_manifest(path).get("verdict", {}).get("level") == "red":
            yield f"the verdict on {path} is red: its robot does not walk as it is told; see legtool info {path}"


def _score(steps: MotionData, estimator: str, formulation: str, folds: int) -> float:
    """Root mean square of cross-validated errors, each in standard deviations of its target."""
    errors = []
    rows = np.arange(len(steps))
    for target in steps.targets.values():
        error = np.empty_like(target)
        for block in np.array_split(rows, folds):
            rest = np.delete(rows, block)
            # calibration changes no mean
            model = build(estimator, formulation, folds=0).fit(steps.features[rest], target[rest])
            error[block] = model.predict(steps.features[block]) - target[block]
        errors.append(error / np.maximum(target.std(axis=0), 1e-12))
    return float(np.sqrt(np.mean(np.concatenate(errors, axis=1) ** 2)))
