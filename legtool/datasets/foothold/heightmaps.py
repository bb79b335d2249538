"""Labelled heightmaps on disk and in memory: ViTAL's tuples, with what the exact criteria say of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from legtool.datasets.store import load_dataset
from legtool.errors import DatasetError
from legtool_runtime.foothold import SIZE, Gait, Tuple

KIND = "footholds"
CELLS = SIZE * SIZE
#: Columns: name, numbers per row, type on disk.
_COLUMNS: tuple[tuple[str, int, Any], ...] = (
    ("heights", CELLS, np.float16),
    ("leg", 1, np.int8),
    ("hip_height", 1, np.float32),
    ("base_twist", 6, np.float32),
    ("gait", 4, np.float32),
    ("nominal", 2, np.float32),
    ("roll", 1, np.float32),
    ("pitch", 1, np.float32),
    ("vpa", 1, np.int8),
    ("terrain", 1, np.int32),
    ("terrain_kind", 1, np.int8),
    ("reasons", CELLS, np.uint8),
    ("optimal", 1, np.int16),
    ("counts", 31, np.int16),
)


@dataclass(frozen=True, eq=False)
class FootholdData:
    """Samples as arrays; n rows each.

    Attributes:
        heights: (n, 33, 33) float16 [m], horizontal frame, zero at the ground's median; NaN where unknown.
        leg: (n,) index into FL, FR, RL, RR.
        hip_height: (n,) z_h at touchdown [m].
        base_twist: (n, 6) v_b [m/s, rad/s].
        gait: (n, 4) α: step length [m], frequency [Hz], duty factor, time to touchdown [s].
        nominal: (n, 2) the map's centre from below the hip [m]; zero for maps below hips (VPA).
        roll: (n,) of the trunk [rad].
        pitch: (n,) of the trunk, positive is nose down [rad].
        vpa: (n,) 1 where the map lies below a hip.
        terrain: (n,) number of the terrain.
        terrain_kind: (n,) index into the settings' terrains.
        reasons: (n, 33, 33) why a cell is unsafe, sum of the criteria's bits.
        optimal: (n,) nearest safe cell to the centre, ix · 33 + iy; -1 where none is safe.
        counts: (n, 31) numbers of safe footholds over the set of hip heights; -1 where the map lies around a foothold.
    """

    heights: NDArray[np.float16]
    leg: NDArray[np.int8]
    hip_height: NDArray[np.float32]
    base_twist: NDArray[np.float32]
    gait: NDArray[np.float32]
    nominal: NDArray[np.float32]
    roll: NDArray[np.float32]
    pitch: NDArray[np.float32]
    vpa: NDArray[np.int8]
    terrain: NDArray[np.int32]
    terrain_kind: NDArray[np.int8]
    reasons: NDArray[np.uint8]
    optimal: NDArray[np.int16]
    counts: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.leg)

    def take(self, rows: Any) -> FootholdData:
        """Some rows, by mask, slice or numbers."""
        return FootholdData(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def tuples(self) -> list[Tuple]:
        """What the samples were judged by, as criteria and networks take it."""
        return [
            Tuple(
                self.heights[n].astype(np.float32),
                leg=int(self.leg[n]),
                hip_height=float(self.hip_height[n]),
                base_twist=self.base_twist[n].tolist(),
                gait=Gait(*self.gait[n].tolist()),
                nominal=None if self.vpa[n] else self.nominal[n].tolist(),
                roll=float(self.roll[n]),
                pitch=float(self.pitch[n]),
            )
            for n in range(len(self))
        ]


def to_table(data: FootholdData) -> pa.Table:
    """Rows for a dataset's part; each array a column of bytes or of plain numbers."""
    columns = {}
    for name, width, kind in _COLUMNS:
        value = np.ascontiguousarray(getattr(data, name), dtype=kind).reshape(len(data), width)
        if width == 1:
            columns[name] = pa.array(value[:, 0])
        else:
            size = width * value.itemsize
            columns[name] = pa.FixedSizeBinaryArray.from_buffers(
                pa.binary(size), len(data), [None, pa.py_buffer(value.tobytes())]
            )
    return pa.table(columns)


def _schema() -> pa.Schema:
    """Columns that every part has; the attitude's came later."""
    kinds = [
        (name, pa.from_numpy_dtype(kind) if width == 1 else pa.binary(width * np.dtype(kind).itemsize))
        for name, width, kind in _COLUMNS
    ]
    return pa.schema([(name, kind) for name, kind in kinds if name not in ("roll", "pitch")])


SCHEMA = _schema()


def from_table(table: pa.Table) -> FootholdData:
    """The reverse of :func:`to_table`.

    Datasets of before the attitude was drawn have no columns for it: their trunks are level, and judged as ever.
    """
    arrays: dict[str, Any] = {}
    for name, width, kind in _COLUMNS:
        if name in ("roll", "pitch") and name not in table.column_names:
            arrays[name] = np.zeros(table.num_rows, kind)
            continue
        column = table.column(name).combine_chunks()
        if isinstance(column, pa.ChunkedArray):
            column = column.chunk(0) if column.num_chunks else pa.array([], column.type)
        if width == 1:
            arrays[name] = np.asarray(column, dtype=kind)
        else:
            item = np.dtype(kind).itemsize * width
            begin = column.offset * item
            buffer = column.buffers()[1]
            raw = np.frombuffer(buffer, np.uint8)[begin : begin + len(column) * item] if buffer is not None else b""
            shape = (len(column), SIZE, SIZE) if width == CELLS else (len(column), width)
            arrays[name] = np.frombuffer(raw, kind).reshape(shape)
    return FootholdData(**arrays)


def load_footholds(paths: Sequence[Path]) -> tuple[FootholdData, dict[str, Any]]:
    """Load datasets of one robot.

    Returns:
        all samples, terrains numbered apart; and the first dataset's manifest.

    Raises:
        DatasetError: no dataset, another kind, damaged, or of several robots.
    """
    if not paths:
        raise DatasetError("no dataset was given; make one with legtool collect footholds")
    parts, first = [], None
    offset = 0
    for path in paths:
        dataset = load_dataset(path, KIND, SCHEMA)
        first = first or dataset.manifest
        for key in ("robot", "criteria"):
            if dataset.manifest.get(key) != first.get(key):
                raise DatasetError(
                    f"{path}: made with another {key} than {paths[0]}; train on one robot's data at a time"
                )
        data = from_table(dataset.table)
        parts.append({field.name: getattr(data, field.name) for field in fields(data)})
        parts[-1]["terrain"] = data.terrain + offset
        offset += int(data.terrain.max()) + 1
    assert first is not None
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return FootholdData(**joined), first


def split_by_terrain(data: FootholdData, share: float, *, seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of training and validation rows: no terrain is in both.

    Raises:
        DatasetError: fewer than two terrains.
    """
    terrains = np.unique(data.terrain)
    if len(terrains) < 2:
        raise DatasetError(f"{len(terrains)} terrain, expected several to hold some out; collect more samples")
    held = np.random.default_rng([seed, 9]).permutation(terrains)[: max(1, round(share * len(terrains)))]
    validation = np.isin(data.terrain, held)
    return ~validation, validation
