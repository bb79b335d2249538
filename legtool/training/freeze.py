"""Freeze a run of the motion line, and compare what was frozen with what was trained."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LinearRegression
from sklearn.preprocessing import PolynomialFeatures

from legtool.configs.export import ExportSettings
from legtool.datasets.files import read_json
from legtool.datasets.motion.run import FittedMotion, load_run
from legtool.datasets.motion.samples import MotionData, load_transitions, motion_data
from legtool.datasets.work import RUN
from legtool.errors import DatasetError, OutputError
from legtool.models.motion import build, predict_frozen
from legtool_runtime.bundle import Bundle
from legtool_runtime.lines import motion_interface
from legtool_runtime.motion.features import (
    FEATURES,
    FEET,
    PREVIOUS_REFERENCE,
    PREVIOUS_VELOCITY,
    REFERENCE,
    TARGETS,
    VELOCITY,
    canonical_features,
    canonical_targets,
)
from legtool_runtime.motion.model import MotionState
from legtool_runtime.robot import Robot

Array = NDArray[np.float64]
#: Mean and standard deviation of each model for features (n, 24), canonical.
Predictor = Callable[[Array], dict[str, tuple[Array, Array]]]

#: Used if the data is not available: speeds up to 1 m/s or rad/s, feet within this distance of their stance [m].
_SPEED, _FOOT_REACH = 1.0, 0.15


@dataclass(frozen=True, eq=False)
class Line:
    """The frozen models of one line (motion, footholds or steppability).

    Attributes:
        name: name of the line.
        run: path of the training run.
        robot: the robot that the models are for.
        instant: the instant at which states are taken; None if the line has no states.
        files: file name in the bundle to content.
        description: entry in ``bundle.json``.
        compare: returns the largest difference of a loaded bundle from the trained model, by reference.
        tolerance: the largest difference that is accepted.
        compared: the number of inputs compared, for the card.
    """

    name: str
    run: Path
    robot: Robot
    instant: str | None
    files: dict[str, bytes]
    description: dict[str, Any]
    compare: Callable[[Bundle], dict[str, float]]
    tolerance: float
    compared: dict[str, int]


def freeze_motion(path: Path, settings: ExportSettings) -> Line:
    """Freeze the formulation and estimator that a run chose.

    Raises:
        DatasetError: the path is not a run, or the run is damaged or has models of different degrees.
        OutputError: the results to include are of other data or cannot be read.
    """
    run = load_run(path)
    frozen = run.frozen()
    degrees = {int(model["degree"]) for model in frozen.values()}
    if len(degrees) != 1:
        raise DatasetError(f"{path}: its models have degrees {sorted(degrees)}, expected a single degree; train again")
    buffer = io.BytesIO()
    arrays = {f"{name}.{key}": value for name in TARGETS for key, value in frozen[name].items() if key != "degree"}
    np.savez(buffer, allow_pickle=False, **arrays)
    data = _training_data(run)
    low, high = _range(run, data)
    header = read_json(path / RUN.marker)
    description = {
        "instant": run.instant,
        "formulation": run.formulation,
        "estimator": run.estimator,
        "degree": degrees.pop(),
        **motion_interface(),
        "range": {name: [float(a), float(b)] for name, a, b in zip(FEATURES, low, high, strict=True)},
        "range_of": "training data" if data is not None else "a walking robot",
        "metrics": {},
        "provenance": {
            "settings": run.settings,
            "data": _named(run.data),
            "scores": run.scores,
            "commit": header.get("commit"),
            "versions": header.get("versions", {}),
        },
        **_results(path, run, settings.results),
    }

    def compare(bundle: Bundle) -> dict[str, float]:
        features = np.random.default_rng(settings.seed).uniform(low, high, size=(settings.states, len(FEATURES)))
        got = _predict(bundle, features)
        references = {"scikit-learn with the run's parameters": _from_parameters(run)}
        if data is not None:
            references["the model as trained, fitted again to the data"] = _fitted_again(run, data)
        return {name: _largest_difference(got, reference(features)) for name, reference in references.items()}

    return Line(
        name="motion",
        run=path,
        robot=run.robot,
        instant=run.instant,
        files={"motion.npz": buffer.getvalue()},
        description=description,
        compare=compare,
        tolerance=settings.tolerance,
        compared={"states": settings.states, "seed": settings.seed},
    )


def _named(data: Mapping[str, Any]) -> dict[str, Any]:
    """Where steps came from, by the names of datasets alone."""
    named = {**data, "paths": [Path(name).name for name in data.get("paths", [])]}
    return {**named, "recalibrated": _named(data["recalibrated"])} if "recalibrated" in data else named


def _training_data(run: FittedMotion) -> MotionData | None:
    """Load the steps that a run was fitted to, if they are still at the same path; else return None."""
    try:
        loaded = load_transitions([Path(path) for path in run.data.get("paths", [])])
    except DatasetError:
        return None
    return motion_data(loaded.table) if loaded.info["hash"] == run.data.get("hash") else None


def _range(run: FittedMotion, data: MotionData | None) -> tuple[Array, Array]:
    if data is not None:
        return data.features.min(axis=0), data.features.max(axis=0)
    low, high = np.full(len(FEATURES), -_SPEED), np.full(len(FEATURES), _SPEED)
    low[FEET] = run.robot.stance.ravel() - _FOOT_REACH
    high[FEET] = run.robot.stance.ravel() + _FOOT_REACH
    return low, high


def _results(path: Path, run: FittedMotion, given: Sequence[Path]) -> dict[str, Any]:
    """Metrics of the chosen models from ``results.json``, and where they come from; nothing where there is none."""
    for results_path in given or kept_results(path):
        results = read_results(results_path)
        metrics, provenance = results["metrics"], results["provenance"]
        if metrics and not any(name.split(".")[0] in TARGETS for name in metrics):
            continue  # of another line
        if provenance.get("trained_on") != run.data.get("hash"):
            raise OutputError(f"{results_path}: measured for a run on other data than {path}; evaluate this run")
        which = "bayesian" if run.estimator == "bayesian" else run.formulation
        chosen = {name: value for name, value in metrics.items() if name.split(".")[1] == which}
        data = [Path(name).name for name in provenance.get("data", [])]
        return {"metrics": chosen, "evaluation": {**provenance, "data": data}}
    return {}


def kept_results(run: Path) -> list[Path]:
    """The ``results.json`` files that ``eval`` kept in the directory of a run."""
    return sorted(run.glob("results*.json"))


def carried_results(path: Path, prefix: str, trained_on: str, given: Sequence[Path]) -> dict[str, Any]:
    """Read metrics of a run and their provenance from the ``results.json`` of ``eval``; empty if there is none.

    Args:
        path: path of the run.
        prefix: prefix of the names of its metrics.
        trained_on: hash of the data of the run.
        given: files to search; if empty, the directory of the run is searched.

    Raises:
        OutputError: a file is not such a file, or belongs to a run on other data.
    """
    for results_path in given or kept_results(path):
        results = read_results(results_path)
        chosen = {name: value for name, value in results["metrics"].items() if name.startswith(prefix)}
        if chosen:
            provenance = results["provenance"]
            if provenance.get("trained_on") != trained_on:
                raise OutputError(f"{results_path}: measured for a run on other data than {path}; evaluate this run")
            names = {"run": path.name, "data": [Path(name).name for name in provenance.get("data", [])]}
            return {"metrics": chosen, "evaluation": {**provenance, **names}}
    return {}


def read_results(path: Path) -> dict[str, Any]:
    """Read ``metrics`` and ``provenance`` of a ``results.json`` for a bundle.

    Raises:
        OutputError: the file was not written by ``legtool eval``.
    """
    try:
        results = read_json(path)
    except DatasetError as error:
        raise OutputError(f"{path}: not the results.json of legtool eval ({error})") from error
    if not isinstance(results.get("metrics"), dict) or not isinstance(results.get("provenance"), dict):
        raise OutputError(f"{path}: not the results.json of legtool eval: it holds no metrics with their provenance")
    return results


def _from_parameters(run: FittedMotion) -> Predictor:
    """scikit-learn's linear regression and polynomial with the run's coefficients; deviations by their formula."""

    def predict(features: Array) -> dict[str, tuple[Array, Array]]:
        out = {}
        for name, frozen in run.frozen().items():
            linear = LinearRegression()
            linear.coef_, linear.intercept_ = frozen["coefficients"], frozen["intercept"]
            inputs = PolynomialFeatures(int(frozen["degree"]), include_bias=False).fit_transform(features)
            out[name] = linear.predict(inputs), predict_frozen(frozen, features)[1]
        return out

    return predict


def _fitted_again(run: FittedMotion, data: MotionData) -> Predictor:
    """The estimators themselves: the fits draw nothing at random, so these are the ones that were trained; deviations
    are scaled as the run says."""
    noted = run.data.get("recalibrated") if run.estimator == "bayesian" else None
    factors = {name: 1.0 if noted is None else np.array(noted["factors"][run.formulation][name]) for name in TARGETS}
    estimators = {
        name: build(run.estimator, run.formulation, folds=run.settings["folds"]).fit(data.features, target)
        for name, target in data.targets.items()
    }

    def predict(features: Array) -> dict[str, tuple[Array, Array]]:
        found = {name: model.predict(features, return_std=True) for name, model in estimators.items()}
        return {name: (mean, std * factors[name]) for name, (mean, std) in found.items()}

    return predict


def _predict(bundle: Bundle, features: Array) -> dict[str, tuple[Array, Array]]:
    """The runtime's answers, half of the states mirrored before and their answers after, so that both pairs are met."""
    pair = (np.arange(len(features)) % 2).astype(np.int8)
    measured = canonical_features(features, pair)  # mirroring twice gives the same
    predictions = [
        bundle.motion.predict(
            MotionState(
                velocity=row[VELOCITY],
                previous_velocity=row[PREVIOUS_VELOCITY],
                previous_reference=row[PREVIOUS_REFERENCE],
                feet_base=row[FEET].reshape(4, 3),
                swing_pair=int(swing),
            ),
            row[None, REFERENCE],
        )
        for row, swing in zip(measured, pair, strict=True)
    ]
    stacked = [np.concatenate(parts) for parts in zip(*predictions, strict=True)]
    mean = canonical_targets(stacked[0], stacked[1], stacked[2], pair)
    std = canonical_targets(stacked[3], stacked[4], stacked[5], pair)
    return {name: (mean[name], np.abs(std[name])) for name in TARGETS}


def _largest_difference(got: Mapping[str, tuple[Array, Array]], want: Mapping[str, tuple[Array, Array]]) -> float:
    differences = [
        np.abs(a - b) / np.maximum(1.0, np.abs(b))
        for name in TARGETS
        for a, b in zip(got[name], want[name], strict=True)
    ]
    return float(max(difference.max() for difference in differences))
