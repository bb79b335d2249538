"""A training run of the motion line on disk: ``run.json`` and ``models.npz``. No pickle; hashes verified on load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.configs.motion import Estimator, Formulation
from legtool.datasets.files import read_json, replacing, sha256, write_json
from legtool.datasets.logs.recording import Instant
from legtool.datasets.work import RUN, claim
from legtool.errors import DatasetError
from legtool_runtime.robot import Robot

Array = NDArray[np.float64]
#: One model, as :meth:`legtool.models.motion.MotionModel.frozen` gives it.
Frozen = dict[str, Array]

SCHEMA_VERSION = 1
MODELS = "models.npz"
_ARRAYS = ("coefficients", "intercept", "noise_covariance", "weights_covariance", "degree")


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """Motion models fitted to one dataset, in every formulation and by every estimator.

    Attributes:
        robot: the robot whose steps the models were fitted to.
        instant: the instant at which states were taken.
        formulation: the formulation chosen for export; ``estimator`` likewise.
        settings: all settings of the training.
        data: where the steps came from: ``hash``, ``paths``, ``steps`` and the dataset's ``counts``; ``recalibrated``:
            likewise of the logs that intervals were scaled by, where they were, with all ``factors``.
        scores: cross-validated error of each formulation in standard deviations of its targets, if requested.
        models: frozen models by estimator, by formulation, then by ``fdm``, ``cdm``, ``cvm``.
    """

    robot: Robot
    instant: Instant
    formulation: Formulation
    estimator: Estimator
    settings: dict[str, Any]
    data: dict[str, Any]
    scores: dict[str, float]
    models: dict[str, dict[str, dict[str, Frozen]]]
    kind: str = "motion"

    def frozen(self, formulation: str | None = None, estimator: str | None = None) -> dict[str, Frozen]:
        """Return FDM, CDM and CVM of one formulation and estimator, by default the chosen ones."""
        return self.models[estimator or self.estimator][formulation or self.formulation]


def save_run(fitted: FittedMotion, out: Path, *, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a run; the same fit again writes the same run.

    Args:
        fitted: the models.
        out: directory, new, empty, or holding the same run.
        provenance: further entries for ``run.json``: commit, versions.

    Raises:
        OutputError: ``out`` holds something else, another run, or cannot be written.
    """
    identity = {
        "schema_version": SCHEMA_VERSION,
        "kind": fitted.kind,
        "robot": fitted.robot.to_dict(),
        "instant": fitted.instant,
        "settings": fitted.settings,
        "data_hash": fitted.data.get("hash"),
    }
    if noted := fitted.data.get("recalibrated"):
        identity["recalibrated_on"] = noted["hash"]
    arrays = {
        f"{estimator}.{formulation}.{model}.{name}": value
        for estimator, formulations in fitted.models.items()
        for formulation, models in formulations.items()
        for model, frozen in models.items()
        for name, value in frozen.items()
    }
    with claim(out, RUN, identity):
        with replacing(out / MODELS) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        write_json(
            out / RUN.marker,
            {
                **identity,
                "data": fitted.data,
                "formulation": fitted.formulation,
                "estimator": fitted.estimator,
                "scores": fitted.scores,
                **(provenance or {}),
                "files": {MODELS: sha256(out / MODELS)},
            },
        )


def load_run(path: Path) -> FittedMotion:
    """Load a run and verify its hash.

    Raises:
        DatasetError: the path is not a run, or the run is damaged, altered, or newer than this legtool.
    """
    if not (path / RUN.marker).is_file():
        raise DatasetError(f"{path}: not a run (no {RUN.marker}); make one with legtool train motion")
    run = read_json(path / RUN.marker)
    if not isinstance(run.get("schema_version"), int) or run.get("kind") != "motion":
        raise DatasetError(f"{path / RUN.marker}: not a run of the motion line")
    if run["schema_version"] > SCHEMA_VERSION:
        raise DatasetError(f"{path}: schema {run['schema_version']} is newer than {SCHEMA_VERSION}; upgrade legtool")
    if "files" not in run:
        raise DatasetError(f"{path}: the training is not finished; run its train command again")
    if not (path / MODELS).is_file() or sha256(path / MODELS) != run.get("files", {}).get(MODELS):
        raise DatasetError(f"{path / MODELS}: missing, or its bytes differ from the run's SHA-256; train again")
    models: dict[str, dict[str, dict[str, Frozen]]] = {}
    try:
        with np.load(path / MODELS, allow_pickle=False) as arrays:
            for key in arrays.files:
                estimator, formulation, model, name = key.split(".")
                frozen = models.setdefault(estimator, {}).setdefault(formulation, {}).setdefault(model, {})
                frozen[name] = arrays[key]
        fitted = FittedMotion(
            robot=Robot.from_dict(run["robot"]),
            models=models,
            **{key: run[key] for key in ("instant", "formulation", "estimator", "settings", "data", "scores")},
        )
        if any(set(frozen) != set(_ARRAYS) for frozen in fitted.frozen().values()):
            raise KeyError(MODELS)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: the run lacks {error}; train again") from error
    return fitted
