"""Load transitions for the motion models: the usable steps of one or several datasets, mirrored, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from legtool.datasets.logs.recording import Instant
from legtool.datasets.motion.steps import COM_DISPLACEMENT, FOOT_DISPLACEMENT, NEXT_VELOCITY, NUMBERS, OK, SCHEMA
from legtool.datasets.store import data_hash, load_dataset
from legtool.errors import DatasetError
from legtool_runtime.motion.features import FEATURES, REFERENCE, VELOCITY, canonical_features, canonical_targets
from legtool_runtime.robot import TROT_PAIRS, Robot

Array = NDArray[np.float64]
#: No length, speed or angle of a step is greater.
_GREATEST = 1e6


@dataclass(frozen=True, eq=False)
class Transitions:
    """One or several datasets of the same robot, with states taken at the same instant.

    Attributes:
        table: their rows, in order; episodes of different datasets have different names.
        robot: the robot that took the steps.
        instant: the instant at which states were taken.
        info: ``paths``, the ``hash`` over all datasets, and the sum of their ``counts``.
    """

    table: pa.Table
    robot: Robot
    instant: Instant
    info: dict[str, Any]


def load_transitions(paths: Sequence[Path]) -> Transitions:
    """Load datasets of ``collect`` and verify their hashes.

    Raises:
        DatasetError: no dataset is given, one is not a motion dataset or was altered, or robots or instants differ.
    """
    if not paths:
        raise DatasetError("no dataset was given; name one or more directories made by legtool collect")
    datasets = [load_dataset(path, "motion", SCHEMA) for path in paths]
    first = datasets[0].manifest
    for dataset in datasets:
        if dataset.manifest.get("instant") not in get_args(Instant):
            raise DatasetError(f"{dataset.path}: its instant is unknown; collect the dataset again")
    tables = []
    counts: dict[str, float] = {}
    for number, dataset in enumerate(datasets):
        manifest = dataset.manifest
        check_same(
            f"{paths[0]}", first["robot"], first["instant"], f"{dataset.path}", manifest["robot"], manifest["instant"]
        )
        table = dataset.table
        if number > 0:
            episodes = pa.array([f"{number}:{name}" for name in table["episode"].to_pylist()], pa.string())
            table = table.set_column(table.schema.get_field_index("episode"), "episode", episodes)
        tables.append(table)
        for name, value in manifest["counts"].items():
            counts[name] = counts.get(name, 0) + value
    together = data_hash(*(dataset.manifest for dataset in datasets))
    return Transitions(
        table=pa.concat_tables(tables),
        robot=Robot.from_dict(first["robot"]),
        instant=first["instant"],
        info={"paths": [str(path.resolve()) for path in paths], "hash": together, "counts": counts},
    )


def check_same(
    name: str, robot: dict[str, Any], instant: str, other: str, other_robot: dict[str, Any], other_instant: str
) -> None:
    """Reject a mix of robots or instants.

    Args:
        name: name of the first source, for the message.
        robot: description of its robot.
        instant: the instant at which its states were taken.
        other: name of the second source; ``other_robot`` and ``other_instant`` likewise.

    Raises:
        DatasetError: robots or instants differ.
    """
    if robot["name"] != other_robot["name"]:
        raise DatasetError(
            f"{other}: steps of robot {other_robot['name']!r}, but {name} is of {robot['name']!r}; a model holds for "
            "one robot only, so give data of the same robot"
        )
    if robot != other_robot:
        raise DatasetError(
            f"{other}: robot {robot['name']!r} has other dimensions there than in {name}; use only one of the two"
        )
    if instant != other_instant:
        raise DatasetError(
            f"{other}: states taken at {other_instant}, but at {instant} in {name}; collect one of them again with "
            "--set transitions.instant=..., if the log allows it"
        )


@dataclass(frozen=True, eq=False)
class MotionData:
    """The usable steps of a table in the form that the models need, mirrored so that FL+RR swings in every row.

    Attributes:
        features: (n, 24) in the order of FEATURES, canonical.
        targets: model name to (n, k), columns as in TARGETS, canonical.
        stance_motion: (n, 2, 3) displacement of the stance feet, base frame at t, as measured [m].
        command: (n, 3) velocity command as measured: vx, vy [m/s], yaw rate [rad/s].
        velocity: (n, 3) CoM velocity at t as measured.
        time_s: (n,) time since the first step of the episode [s].
        group: (n,) number of the episode that each step belongs to, increasing.
        order: indices of the rows in the table that these steps came from.
    """

    features: Array
    targets: dict[str, Array]
    stance_motion: Array
    command: Array
    velocity: Array
    time_s: Array
    group: NDArray[np.intp]
    order: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.features)


def motion_data(table: pa.Table) -> MotionData:
    """Extract the usable steps of a table of transitions.

    Raises:
        DatasetError: a column is missing, or holds a value that is not finite.
    """
    missing = [name for name in SCHEMA.names if name not in table.column_names]
    if missing:
        raise DatasetError(f"not a table of transitions: column {missing[0]!r} is missing; collect it again")
    order = np.flatnonzero(np.asarray(table["status"].to_pylist(), dtype=object) == OK)
    rows = table.take(pa.array(order))
    block = np.column_stack([np.asarray(rows[name].to_numpy(), dtype=np.float64) for name in NUMBERS])
    plausible = np.abs(block) <= _GREATEST  # which NaN is not
    if not plausible.all():
        row, column = np.argwhere(~plausible)[0]
        raise DatasetError(
            f"step {order[row]} of {rows['recording'][int(row)]}: {NUMBERS[column]} is {block[row, column]}, expected "
            f"a finite number up to {_GREATEST:g}; the recording or the dataset is damaged, so collect it again"
        )

    def columns(names: Sequence[str]) -> Array:
        return block[:, [NUMBERS.index(name) for name in names]]

    pair = rows["swing_pair"].to_numpy().astype(np.int8)
    if not np.isin(pair, (0, 1)).all():
        raise DatasetError(
            f"swing_pair holds {sorted(set(pair.tolist()))}, expected 0 and 1; collect the dataset again"
        )
    feet = columns(FOOT_DISPLACEMENT).reshape(-1, 4, 3)
    features = columns(FEATURES)
    stance = np.array(TROT_PAIRS)[1 - pair]
    names = list(zip(rows["recording"].to_pylist(), rows["episode"].to_pylist(), strict=True))
    number = {name: index for index, name in enumerate(dict.fromkeys(names))}
    group = np.array([number[name] for name in names], dtype=np.intp)
    stamps = rows["stamp_ns"].to_numpy()
    first = np.array([stamps[group == index].min() for index in range(len(number))], dtype=np.int64)
    return MotionData(
        features=canonical_features(features, pair),
        targets=canonical_targets(feet, columns(COM_DISPLACEMENT), columns(NEXT_VELOCITY), pair),
        stance_motion=np.take_along_axis(feet, stance[:, :, None], axis=1),
        command=features[:, REFERENCE],
        velocity=features[:, VELOCITY],
        time_s=(stamps - first[group]) * 1e-9 if len(number) else np.empty(0),
        group=group,
        order=order,
    )
