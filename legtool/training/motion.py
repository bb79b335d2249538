"""Fit the motion models to transitions, in every formulation and by every estimator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from legtool.configs.motion import MotionTrainSettings
from legtool.datasets.logs.recording import Instant
from legtool.datasets.motion.excitation import constant_commands
from legtool.datasets.motion.run import FittedMotion, load_run, save_run
from legtool.datasets.motion.samples import MotionData, load_transitions, motion_data
from legtool.datasets.provenance import commit, versions
from legtool.errors import DatasetError
from legtool.models.motion import ESTIMATORS, FORMULATIONS, build
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


def train_motion(paths: Sequence[Path], settings: MotionTrainSettings, out: Path) -> Iterator[str]:
    """Fit to datasets of one robot and write a run.

    Args:
        paths: datasets of ``collect``.
        settings: of the fit.
        out: the run's directory.

    Yields:
        What was done, line by line.

    Raises:
        DatasetError: there is no dataset, robots or instants are mixed, or there are too few steps.
        OutputError: ``out`` holds something else.
    """
    loaded = load_transitions(paths)
    fitted = fit_motion(loaded.table, settings, robot=loaded.robot, instant=loaded.instant, data=loaded.info)
    save_run(fitted, out, provenance={"commit": commit(), "versions": versions()})
    yield (
        f"fitted {len(FORMULATIONS)} formulations by {len(ESTIMATORS)} estimators to {fitted.data['steps']} steps; "
        f"chosen to be exported: {fitted.formulation}, {fitted.estimator}; states at {fitted.instant}"
    )
    yield from constant_commands(motion_data(loaded.table).command)


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
