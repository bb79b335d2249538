"""A dataset on disk: ``manifest.json`` and Parquet parts, each written under a temporary name and renamed when whole.

Whatever the moment at which a writer is killed, the directory holds only whole parts, and the same command carries
on with the missing ones. Each part is a pure function of (settings, seed, part number), so the finished dataset is the
same bytes however often it was interrupted and by however many workers it was written.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from legtool.datasets.files import read_json, replacing, sha256, write_json
from legtool.datasets.work import DATASET, claim
from legtool.errors import DatasetError, LegtoolError, PartsFailed
from legtool_runtime.errors import shown

SCHEMA_VERSION = 1
MANIFEST = DATASET.marker
_COUNTS_KEY = b"legtool.counts"
_FILES_KEY = b"legtool.files"
_NOTES_KEY = b"legtool.notes"
_MEASURED_KEY = b"legtool.measured"
#: What makes two commands the same work: a directory is carried on only if these agree.
IDENTITY = ("schema_version", "kind", "robot", "settings", "seed", "inputs")


@dataclass(frozen=True)
class Dataset:
    """A finished dataset, its hashes verified.

    Attributes:
        path: its directory.
        manifest: the parsed ``manifest.json``.
        table: all parts in order.
    """

    path: Path
    manifest: dict[str, Any]
    table: pa.Table


class Store:
    """A dataset being written. Opening an existing directory with the same identity carries on with it."""

    def __init__(self, path: Path, header: Mapping[str, Any], *, shard: str | None = None) -> None:
        """Create or carry on.

        Args:
            path: the dataset's directory.
            header: ``kind``, ``robot``, ``settings``, ``inputs``, ``seed`` where anything is drawn, and further fields
                for the manifest.
            shard: name of the share of the parts that is written by this process; None: all.

        Raises:
            OutputError: the directory holds something else, other settings, or is being written by another process.
        """
        self.path = path
        header = {"schema_version": SCHEMA_VERSION, **header}
        identity = {key: header.pop(key) for key in IDENTITY if key in header}
        with ExitStack() as held:
            there = held.enter_context(claim(path, DATASET, identity, shard=shard, **header, complete=False))
            self.header = {key: there.get(key, value) for key, value in (identity | header).items()}
            self._claim = held.pop_all()

    def pending(self, total: int) -> list[int]:
        """Numbers of the parts that are not written yet."""
        return [index for index in range(total) if not part_path(self.path, index).is_file()]

    def finish(
        self, total: int, judge: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None
    ) -> dict[str, Any]:
        """Write the final manifest: hashes and counts of all parts, and means of what was measured on them.

        Args:
            total: number of parts.
            judge: gives the manifest's ``verdict`` (``Verdict.to_dict``) by what else it holds; None: without.

        Raises:
            DatasetError: a part is missing.
        """
        if missing := self.pending(total):
            raise DatasetError(f"{self.path}: part {missing[0]} is missing; run the same command again")
        parts, files, notes = [], [], []
        counts: dict[str, float] = {}
        sums: dict[str, tuple[float, float]] = {}
        for index in range(total):
            path = part_path(self.path, index)
            with _readable(path):
                metadata, rows = pq.read_schema(path).metadata, pq.read_metadata(path).num_rows
            for name, value in json.loads(metadata[_COUNTS_KEY]).items():
                counts[name] = counts.get(name, 0) + value
            for name, (value, of) in json.loads(metadata.get(_MEASURED_KEY, b"{}")).items():
                before = sums.get(name, (0.0, 0.0))
                sums[name] = before[0] + value, before[1] + of
            files += json.loads(metadata[_FILES_KEY])
            notes += json.loads(metadata.get(_NOTES_KEY, b"[]"))
            parts.append({**_entry(path, self.path), "rows": rows})
        manifest = {
            **self.header,
            "complete": True,
            "rows": sum(part["rows"] for part in parts),
            "counts": counts,
            **({"measured": {name: value / of for name, (value, of) in sums.items() if of}} if sums else {}),
            **({"notes": notes} if notes else {}),
            "parts": parts,
            "files": [_entry(self.path / name, self.path) for name in files],
        }
        if judge is not None:
            manifest["verdict"] = judge(manifest)
        write_json(self.path / MANIFEST, manifest)
        return manifest

    @contextmanager
    def refusable(self) -> Iterator[None]:
        """Work that may turn out to be wrong: if it ends in an error of the user's, what was begun here is removed.

        A killed or interrupted command leaves its finished parts, so that the same command carries on.
        """
        done = json.loads((self.path / MANIFEST).read_text()).get("complete")
        try:
            yield
        except PartsFailed:
            raise  # what is written is right
        except LegtoolError:
            if not done:
                for part in self.path.glob("part-*.parquet"):
                    part.unlink()
                (self.path / MANIFEST).unlink(missing_ok=True)
            raise

    def close(self) -> None:
        """Let another process write here."""
        self._claim.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def part_path(root: Path, index: int) -> Path:
    """Where part ``index`` of the dataset in ``root`` lies."""
    return root / f"part-{index:05d}.parquet"


def write_part(
    path: Path,
    table: pa.Table,
    *,
    counts: Mapping[str, float],
    files: Sequence[str] = (),
    notes: Sequence[str] = (),
    measured: Mapping[str, tuple[float, float]] | None = None,
) -> None:
    """Write one part atomically.

    Args:
        path: from :func:`part_path`.
        table: its rows; may be empty.
        counts: what was found, summed over parts in the manifest.
        files: names, relative to the dataset, of whole files that belong to this part (recordings).
        notes: what is doubtful about it, one line each; they are told with the dataset.
        measured: sums, and what they are divided by, whose means over all parts the manifest holds.
    """
    metadata = {
        **(table.schema.metadata or {}),
        _COUNTS_KEY: json.dumps(dict(counts)).encode(),
        _FILES_KEY: json.dumps(list(files)).encode(),
        **({_NOTES_KEY: json.dumps(list(notes)).encode()} if notes else {}),
        **({_MEASURED_KEY: json.dumps(dict(measured)).encode()} if measured else {}),
    }
    with replacing(path) as temporary:
        pq.write_table(table.replace_schema_metadata(metadata), temporary, compression="zstd")


def load_dataset(path: Path, kind: str | None = None, schema: pa.Schema | None = None) -> Dataset:
    """Load a finished dataset and verify every part's hash.

    Args:
        path: its directory.
        kind: that it has to be of.
        schema: columns that every part has to have; others may be there.

    Raises:
        DatasetError: not a dataset, another kind, unfinished, newer than this legtool, altered, or with other columns.
    """
    manifest = load_manifest(path)
    if kind is not None and manifest["kind"] != kind:
        raise DatasetError(f"{path}: holds a {manifest['kind']} dataset, expected a {kind} dataset")
    if not manifest.get("complete"):
        raise DatasetError(f"{path}: the dataset is not finished; run its collect command again to carry on")
    verify(path, manifest["parts"], schema)
    tables = [read_part(path / part["name"]) for part in manifest["parts"]]
    if not tables:
        raise DatasetError(f"{path}: the dataset has no parts; run its collect command again")
    return Dataset(path, manifest, pa.concat_tables(tables))


def read_part(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a part, all columns or those named, without metadata.

    Raises:
        DatasetError: the part is damaged, or lacks a column.
    """
    with _readable(path):
        table = pq.read_table(path, columns=None if columns is None else list(columns))
        if lacking := set(columns or ()) - set(table.column_names):
            raise KeyError(min(lacking))
        return table.replace_schema_metadata(None)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say which part is damaged, whatever Arrow says of it."""
    try:
        yield
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: missing; collect the dataset again") from error
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        text = " ".join(str(error).split())[:120]
        raise DatasetError(f"{path}: damaged, not readable as a part ({text}); collect the dataset again") from error


def load_manifest(path: Path) -> dict[str, Any]:
    """Parse a dataset's manifest and check its version.

    Raises:
        DatasetError: not a dataset, or newer than this legtool.
    """
    if not (path / MANIFEST).is_file():
        raise DatasetError(f"{path}: not a dataset (no {MANIFEST}); make one with legtool collect")
    manifest = read_json(path / MANIFEST)
    version = manifest.get("schema_version")
    if not isinstance(version, int) or not isinstance(manifest.get("kind"), str):
        raise DatasetError(f"{path / MANIFEST}: not a legtool manifest")
    if version > SCHEMA_VERSION:
        raise DatasetError(f"{path}: schema {shown(version)} is newer than {SCHEMA_VERSION}; upgrade legtool")
    needed: dict[str, type] = {"robot": dict, "settings": dict, "inputs": list}
    if manifest.get("complete"):
        needed |= {"parts": list, "files": list, "counts": dict, "rows": int}
    for name, kind in needed.items():
        if not isinstance(manifest.get(name), kind):
            raise DatasetError(
                f"{path / MANIFEST}: damaged: {name} is {shown(manifest.get(name))}, expected a {kind.__name__}; "
                "collect the dataset again"
            )
    if not isinstance(manifest["robot"].get("name"), str):
        raise DatasetError(f"{path / MANIFEST}: damaged: its robot has no name; collect the dataset again")
    if any(not isinstance(count, (int, float)) for count in manifest.get("counts", {}).values()):
        raise DatasetError(f"{path / MANIFEST}: damaged: a count is no number; collect the dataset again")
    return manifest


def verify(path: Path, entries: Sequence[Mapping[str, Any]], schema: pa.Schema | None = None) -> None:
    """Check files against their recorded SHA-256, and parts for their columns.

    Args:
        path: the dataset.
        entries: of its manifest.
        schema: columns that each has to have, if they are parts.

    Raises:
        DatasetError: the first file that is missing or differs.
    """
    for entry in entries:
        if not isinstance(entry, dict) or not isinstance(entry.get("name"), str) or "\0" in entry["name"]:
            raise DatasetError(f"{path / MANIFEST}: damaged: names a file {shown(entry)}; collect the dataset again")
        file = path / entry["name"]
        if not file.resolve().is_relative_to(path.resolve()):
            raise DatasetError(f"{path}: the manifest names {entry['name']!r}, which lies outside the dataset")
        if not file.is_file():
            raise DatasetError(f"{file}: missing; collect the dataset again")
        if sha256(file) != entry.get("sha256"):
            raise DatasetError(f"{file}: its bytes differ from the manifest's SHA-256; collect the dataset again")
        if schema is not None:
            with _readable(file):
                there = pq.read_schema(file)
            for field in schema:
                if field.name not in there.names or there.field(field.name).type != field.type:
                    raise DatasetError(f"{file}: has no column {field.name} of {field.type}; collect the dataset again")


def data_hash(manifest: Mapping[str, Any], *more: Mapping[str, Any]) -> str:
    """One hash for the content of a dataset, over its parts' hashes; of several in their order, over theirs."""
    if more:
        return hashlib.sha256("".join(data_hash(one) for one in (manifest, *more)).encode()).hexdigest()
    digest = hashlib.sha256()
    for part in manifest["parts"]:
        digest.update(str(part["sha256"]).encode())
    return digest.hexdigest()


def _entry(path: Path, root: Path) -> dict[str, Any]:
    return {"name": str(path.relative_to(root)), "bytes": path.stat().st_size, "sha256": sha256(path)}
