"""Datasets out of datasets: merged, split by what goes together, filtered; and what their columns hold.

Parents are named by their hashes in ``inputs``. What goes together is never torn apart: steps of one log or episode,
samples of one terrain, frames of one scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from legtool.datasets.motion.steps import OK
from legtool.datasets.store import Store, data_hash, load_manifest, part_path, read_part, verify, write_part
from legtool.errors import DatasetError
from legtool.provenance import commit
from legtool.verdict import Verdict

#: By kind of dataset, the column that says what goes together.
GROUPS = {"motion": "episode", "footholds": "terrain", "scenes": "scene"}
#: What datasets that are merged must have in common, where they have it.
_ALIKE = ("kind", "robot", "instant", "criteria", "hip_heights")
#: Fields of a manifest that :meth:`.Store.finish` writes.
_FINISHED = ("complete", "rows", "counts", "measured", "verdict", "parts", "files", "notes", "commit")


class Parent(NamedTuple):
    """A finished dataset, its parts verified."""

    path: Path
    manifest: dict[str, Any]

    @property
    def group(self) -> str:
        """The column that says what goes together."""
        return GROUPS[self.manifest["kind"]]

    def tables(self) -> Iterator[pa.Table]:
        """Its parts, one after the other."""
        for part in self.manifest["parts"]:
            yield read_part(self.path / part["name"])


def open_parent(path: Path) -> Parent:
    """Open a dataset of any kind.

    Raises:
        DatasetError: not a dataset, of an unknown kind, not finished, altered, or newer than this legtool.
    """
    manifest = load_manifest(path)
    if manifest["kind"] not in GROUPS:
        raise DatasetError(f"{path}: holds a {manifest['kind']} dataset, expected one of {', '.join(GROUPS)}")
    if not manifest.get("complete"):
        raise DatasetError(f"{path}: the dataset is not finished; run its collect command again to carry on")
    verify(path, manifest["parts"])
    return Parent(path, manifest)


def merge(paths: Sequence[Path], out: Path) -> dict[str, Any]:
    """Join datasets of one kind and robot; episodes, terrains and scenes stay apart.

    Returns:
        the manifest of what was written.

    Raises:
        DatasetError: fewer than two, one is given twice, or they are of another kind, robot, instant or criteria.
        OutputError: ``out`` holds something else.
    """
    if len(paths) < 2:
        raise DatasetError("name two datasets or more to merge")
    parents = [open_parent(path) for path in paths]
    first = parents[0]
    seen: dict[str, Path] = {}
    for parent in parents:
        for key in _ALIKE:
            if parent.manifest.get(key) != first.manifest.get(key):
                raise DatasetError(f"{parent.path}: has another {key.replace('_', ' ')} than {first.path}")
        hashed = data_hash(parent.manifest)
        if hashed in seen:
            raise DatasetError(f"{parent.path}: holds the same rows as {seen[hashed]}; name each dataset once")
        seen[hashed] = parent.path

    def tables() -> Iterator[pa.Table]:
        offset = 0
        for number, parent in enumerate(parents):
            most = -1
            for table in parent.tables():
                column = table[parent.group]
                if pa.types.is_string(column.type):
                    named = [f"{number}:{name}" for name in column.to_pylist()] if number else column.to_pylist()
                    values = pa.array(named, pa.string())
                else:
                    if len(column):
                        most = max(most, int(pc.max(column).as_py()))
                    values = pc.add(column, offset).cast(column.type)
                yield table.set_column(table.schema.get_field_index(parent.group), parent.group, values)
            offset += most + 1

    return _write(out, parents, {"derived": "merge"}, tables())


def split(path: Path, shares: Sequence[float], out: Path, *, seed: int = 0) -> list[dict[str, Any]]:
    """Divide a dataset into several, named ``0``, ``1``, … below ``out``; episodes, terrains, scenes are drawn whole.

    Args:
        path: the dataset.
        shares: of each; they are divided by their sum.
        out: directory of the datasets.
        seed: of the draw.

    Returns:
        the manifests.

    Raises:
        DatasetError: fewer than two shares, one that is not positive, or fewer groups than shares.
        OutputError: there is something else.
    """
    weights = np.array(shares, dtype=np.float64)
    if len(weights) < 2 or not (np.isfinite(weights).all() and (weights > 0).all()):
        raise DatasetError(f"shares {list(shares)}: expected two or more above 0, such as 0.8,0.2")
    parent = open_parent(path)
    groups = pa.chunked_array([chunk for table in parent.tables() for chunk in table[parent.group].chunks]).unique()
    if len(groups) < len(weights):
        raise DatasetError(
            f"{path}: {len(groups)} {parent.group}s, which are not torn apart; expected at least {len(weights)}"
        )
    order = np.random.default_rng(seed).permutation(len(groups))
    ends = np.round(np.cumsum(weights) / weights.sum() * len(groups)).astype(int)
    ends = np.maximum(ends, np.arange(1, len(weights) + 1))  # one each at least
    ends = np.minimum(ends, len(groups) - np.arange(len(weights))[::-1])
    manifests = []
    for number, chosen in enumerate(np.split(order, ends[:-1])):
        held = groups.take(pa.array(np.sort(chosen)))
        made = {"derived": "split", "shares": [float(share) for share in weights], "seed": seed, "number": number}
        rows = (table.filter(pc.is_in(table[parent.group], held)) for table in parent.tables())
        manifests.append(_write(out / str(number), [parent], made, rows))
    return manifests


def keep_where(path: Path, condition: str, out: Path) -> dict[str, Any]:
    """Keep the rows for which an expression over columns of numbers and text holds, such as ``velocity_x > 0.2``.

    Args:
        path: the dataset.
        condition: as :meth:`pandas.DataFrame.query` takes it.
        out: directory to write.

    Returns:
        the manifest.

    Raises:
        DatasetError: the expression cannot be evaluated, is no condition, or holds for no row.
        OutputError: ``out`` holds something else.
    """
    parent = open_parent(path)

    def rows() -> Iterator[pa.Table]:
        kept = 0
        for table in parent.tables():
            mask = _evaluate(table, condition)
            kept += int(mask.sum())
            yield table.filter(pa.array(mask))
        if not kept:
            raise DatasetError(f"{condition!r} holds for none of the {parent.manifest['rows']} rows of {path}")

    return _write(out, [parent], {"derived": "filter", "where": condition}, rows())


def statistics(path: Path) -> dict[str, dict[str, float]]:
    """By column (and ``[k]`` of a list), over all rows: ``n`` of those that are finite, ``missing``, ``mean``, ``std``,
    ``min``, ``p5``, ``median``, ``p95``, ``max``; of text and truth values how often each is met.

    Raises:
        DatasetError: see :func:`open_parent`.
    """
    parent = open_parent(path)
    out: dict[str, dict[str, float]] = {}
    table = pa.concat_tables(table.select(_described(table)) for table in parent.tables())
    for name in table.column_names:
        column = table[name].combine_chunks()
        if pa.types.is_string(column.type) or pa.types.is_boolean(column.type):
            counted = {str(entry["values"]): float(entry["counts"]) for entry in pc.value_counts(column).to_pylist()}
            out[name] = counted if len(counted) <= _MANY else {"different values": float(len(counted))}
        elif pa.types.is_fixed_size_list(column.type):
            size = column.type.list_size
            values = column.flatten().to_numpy(zero_copy_only=False).reshape(-1, size)
            out |= {f"{name}[{k}]": _numbers(values[:, k]) for k in range(size)}
        else:
            out[name] = _numbers(column.to_numpy(zero_copy_only=False))
    return out


def describe_statistics(path: Path, found: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Lines for a terminal."""
    manifest = load_manifest(path)
    yield f"{path}: {manifest['kind']} dataset of {manifest['robot']['name']}, {manifest['rows']} rows"
    yield f"  {'':28}" + "".join(f"{key:>11}" for key in _KEYS)
    for name, values in found.items():
        if "mean" in values or not values.get("n", 1):
            yield f"  {name:28}" + "".join(f"{values.get(key, np.nan):>11.4g}" for key in _KEYS)
        else:
            yield f"  {name:28}  " + ", ".join(f"{value} {count:g}" for value, count in values.items())


_KEYS = ("n", "missing", "mean", "std", "min", "p5", "median", "p95", "max")
#: Lists that are longer are images or maps; text of more different values than this is only counted.
_LONGEST, _MANY = 16, 12


def _described(table: pa.Table) -> list[str]:
    """Columns of numbers, short lists of them, text and truth values."""
    return [
        field.name
        for field in table.schema
        if pa.types.is_integer(field.type) or pa.types.is_floating(field.type) or pa.types.is_string(field.type)
        or pa.types.is_boolean(field.type)
        or (pa.types.is_fixed_size_list(field.type) and field.type.list_size <= _LONGEST)
    ]  # fmt: skip


def _numbers(values: np.ndarray[Any, Any]) -> dict[str, float]:
    known = values.astype(np.float64)
    known = known[np.isfinite(known)]
    out = {"n": float(len(known)), "missing": float(len(values) - len(known))}
    if len(known):
        low, five, middle, most, high = np.quantile(known, [0.0, 0.05, 0.5, 0.95, 1.0])
        out |= {"mean": known.mean(), "std": known.std(), "min": low, "p5": five, "median": middle, "p95": most}
        out["max"] = high
    return {key: float(value) for key, value in out.items()}


def _evaluate(table: pa.Table, condition: str) -> np.ndarray[Any, Any]:
    plain = [field.name for field in table.schema if not _is_list_or_bytes(field.type)]
    frame = table.select(plain).to_pandas()
    try:
        mask = frame.eval(condition, engine="python")
    except Exception as error:  # pandas raises what its parser and the columns' types bring
        names = ", ".join(frame.columns)
        raise DatasetError(f"{condition!r}: {error}; expected a condition on columns: {names}") from error
    if not isinstance(mask, pd.Series) or mask.dtype != np.bool_:
        raise DatasetError(f"{condition!r} is no condition; expected one such as velocity_x > 0.2")
    return mask.to_numpy()


def _is_list_or_bytes(kind: pa.DataType) -> bool:
    return bool(pa.types.is_nested(kind) or pa.types.is_binary(kind))


def _write(out: Path, parents: Sequence[Parent], made: Mapping[str, Any], tables: Iterator[pa.Table]) -> dict[str, Any]:
    """Write a derived dataset, a part for each part of its parents; recordings stay with these."""
    first = parents[0].manifest
    header = {key: value for key, value in first.items() if key not in (*_FINISHED, "schema_version")}
    header["settings"] = {**first["settings"], **made}
    header["inputs"] = [{"name": parent.path.name, "sha256": data_hash(parent.manifest)} for parent in parents]
    header["commit"] = commit()
    judged = [Verdict.from_dict(one.manifest["verdict"]) for one in parents if "verdict" in one.manifest]
    if judged:  # what was found of a parent holds of its rows wherever they are
        found = dict.fromkeys(finding for verdict in judged for finding in verdict.findings)
        header["verdict"] = Verdict(tuple(found)).to_dict()
    total = sum(len(parent.manifest["parts"]) for parent in parents)
    with Store(out, header) as store, store.refusable():
        missing = set(store.pending(total))
        for number, table in enumerate(tables):
            if number in missing:
                write_part(part_path(store.path, number), table, counts=_counts(first["kind"], table))
        return store.finish(total)


def _counts(kind: str, table: pa.Table) -> Mapping[str, float]:
    if kind == "motion":
        steps = int(pc.sum(pc.equal(table["status"], OK)).as_py() or 0)
        return {"steps": steps, "rows": len(table)}
    groups = len(pc.unique(table[GROUPS[kind]]))
    return {"scenes": groups, "frames": len(table)} if kind == "scenes" else {"samples": len(table)}
