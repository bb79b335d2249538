"""A dataset on disk: ``manifest.json`` and Parquet parts, each written under a temporary name and renamed when whole.

Whatever the moment at which a writer is killed, the directory holds only whole parts, and the same command carries
on with the missing ones. Each part is a pure function of (settings, seed, part number), so the finished dataset is the
same bytes however often it was interrupted and by however many workers it was written.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from legtool.errors import DatasetError, OutputError

SCHEMA_VERSION = 1
MANIFEST = "manifest.json"
_COUNTS_KEY = b"legtool.counts"
_FILES_KEY = b"legtool.files"
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


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def fsync_directory(path: Path) -> None:
    """Make renames inside a directory durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; on success it takes ``path``'s place at once, on failure it is gone.

    Raises:
        OutputError: the disk is full or the place cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
        fsync_directory(path.parent)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise explain_os_error(error, path) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def explain_os_error(error: OSError, path: Path) -> OutputError:
    """One line for an operating-system error met while writing ``path``."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return OutputError(
            f"{path}: no space left on the disk; what was finished is kept: "
            "free some space and run the same command again"
        )
    return OutputError(f"{path}: cannot be written ({error.strerror or error})")


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, keys in the order given, ending in a newline."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Parse one JSON object.

    Raises:
        DatasetError: missing, unreadable, or not an object.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DatasetError(f"{path}: not readable as JSON ({error})") from error
    if not isinstance(value, dict):
        raise DatasetError(f"{path}: expected a JSON object, got {type(value).__name__}")
    return value


class Store:
    """A dataset being written. Opening an existing directory with the same identity carries on with it."""

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        """Create or carry on.

        Args:
            path: the dataset's directory.
            header: ``kind``, ``robot``, ``settings``, ``inputs``, ``seed`` where anything is drawn, and further fields
                for the manifest.

        Raises:
            OutputError: the directory holds something else, other settings, or is being written by another process.
        """
        self.path = path
        self.header = json.loads(json.dumps({"schema_version": SCHEMA_VERSION, **header}))
        self.complete = False
        try:
            claim_directory(path, MANIFEST)
            self._lock = (path / ".lock").open("w")
        except OSError as error:
            raise explain_os_error(error, path) from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._lock.close()
            raise OutputError(f"{path}: another legtool process is writing here; wait for it to end") from error
        try:
            for leftover in path.rglob(".*.tmp"):
                leftover.unlink()
            if (path / MANIFEST).is_file():
                self._carry_on(read_json(path / MANIFEST))
            else:
                write_json(path / MANIFEST, {**self.header, "complete": False})
        except BaseException:
            self.close()
            raise

    def _carry_on(self, manifest: dict[str, Any]) -> None:
        for key in IDENTITY:
            if manifest.get(key) != self.header.get(key):
                what = _first_difference(key, manifest.get(key), self.header.get(key))
                raise OutputError(
                    f"{self.path}: holds a dataset made otherwise ({what}); choose another --out, or remove it"
                )
        self.header = {**self.header, **{k: v for k, v in manifest.items() if k in self.header}}
        self.complete = bool(manifest.get("complete"))

    def pending(self, total: int) -> list[int]:
        """Numbers of the parts that are not written yet."""
        return [index for index in range(total) if not part_path(self.path, index).is_file()]

    def finish(self, total: int) -> dict[str, Any]:
        """Write the final manifest: hashes and counts of all parts.

        Raises:
            DatasetError: a part is missing.
        """
        if missing := self.pending(total):
            raise DatasetError(f"{self.path}: part {missing[0]} is missing; run the same command again")
        parts, files = [], []
        counts: dict[str, float] = {}
        for index in range(total):
            path = part_path(self.path, index)
            metadata = pq.read_schema(path).metadata
            for name, value in json.loads(metadata[_COUNTS_KEY]).items():
                counts[name] = counts.get(name, 0) + value
            files += json.loads(metadata[_FILES_KEY])
            parts.append({**_entry(path, self.path), "rows": pq.read_metadata(path).num_rows})
        manifest = {
            **self.header,
            "complete": True,
            "rows": sum(part["rows"] for part in parts),
            "counts": counts,
            "parts": parts,
            "files": [_entry(self.path / name, self.path) for name in files],
        }
        write_json(self.path / MANIFEST, manifest)
        self.complete = True
        return manifest

    def close(self) -> None:
        """Let another process write here."""
        (self.path / ".lock").unlink(missing_ok=True)
        self._lock.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def part_path(root: Path, index: int) -> Path:
    """Where part ``index`` of the dataset in ``root`` lies."""
    return root / f"part-{index:05d}.parquet"


def write_part(path: Path, table: pa.Table, *, counts: Mapping[str, float], files: Sequence[str] = ()) -> None:
    """Write one part atomically.

    Args:
        path: from :func:`part_path`.
        table: its rows; may be empty.
        counts: what was found, summed over parts in the manifest.
        files: names, relative to the dataset, of whole files that belong to this part (recordings).
    """
    metadata = {
        **(table.schema.metadata or {}),
        _COUNTS_KEY: json.dumps(dict(counts)).encode(),
        _FILES_KEY: json.dumps(list(files)).encode(),
    }
    with replacing(path) as temporary:
        pq.write_table(table.replace_schema_metadata(metadata), temporary, compression="zstd")


def load_dataset(path: Path, kind: str | None = None) -> Dataset:
    """Load a finished dataset and verify every part's hash.

    Raises:
        DatasetError: not a dataset, another kind, unfinished, newer than this legtool, or altered.
    """
    manifest = load_manifest(path)
    if kind is not None and manifest["kind"] != kind:
        raise DatasetError(f"{path}: holds a {manifest['kind']} dataset, expected a {kind} dataset")
    if not manifest.get("complete"):
        raise DatasetError(f"{path}: the dataset is not finished; run its collect command again to carry on")
    verify(path, manifest["parts"])
    tables = [pq.read_table(path / part["name"]) for part in manifest["parts"]]
    if not tables:
        raise DatasetError(f"{path}: the dataset has no parts; run its collect command again")
    return Dataset(path, manifest, pa.concat_tables(table.replace_schema_metadata(None) for table in tables))


def load_manifest(path: Path) -> dict[str, Any]:
    """Parse a dataset's manifest and check its version.

    Raises:
        DatasetError: not a dataset, or newer than this legtool.
    """
    if not (path / MANIFEST).is_file():
        raise DatasetError(f"{path}: not a dataset (no {MANIFEST}); make one with legtool collect")
    manifest = read_json(path / MANIFEST)
    version = manifest.get("schema_version")
    if not isinstance(version, int) or "kind" not in manifest:
        raise DatasetError(f"{path / MANIFEST}: not a legtool manifest")
    if version > SCHEMA_VERSION:
        raise DatasetError(f"{path}: schema {version} is newer than {SCHEMA_VERSION}; upgrade legtool")
    return manifest


def verify(path: Path, entries: Sequence[Mapping[str, Any]]) -> None:
    """Check files against their recorded SHA-256.

    Raises:
        DatasetError: the first file that is missing or differs.
    """
    for entry in entries:
        file = path / str(entry["name"])
        if not file.resolve().is_relative_to(path.resolve()):
            raise DatasetError(f"{path}: the manifest names {entry['name']!r}, which lies outside the dataset")
        if not file.is_file():
            raise DatasetError(f"{file}: missing; collect the dataset again")
        if sha256(file) != entry["sha256"]:
            raise DatasetError(f"{file}: its bytes differ from the manifest's SHA-256; collect the dataset again")


def data_hash(manifest: Mapping[str, Any]) -> str:
    """One hash for a dataset's content: over its parts' hashes."""
    digest = hashlib.sha256()
    for part in manifest["parts"]:
        digest.update(str(part["sha256"]).encode())
    return digest.hexdigest()


def claim_directory(path: Path, marker: str) -> None:
    """Make a directory, or accept an existing one that is empty or holds ``marker``.

    Raises:
        OutputError: it is a file, or holds something else.
    """
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is a file; --out expects a directory that is new, empty, or made by this command")
    path.mkdir(parents=True, exist_ok=True)
    held = [item.name for item in path.iterdir() if not (item.name == ".lock" or item.name.endswith(".tmp"))]
    if held and marker not in held:
        raise OutputError(f"{path}: holds something else ({sorted(held)[0]}, …); choose another --out")


def _entry(path: Path, root: Path) -> dict[str, Any]:
    return {"name": str(path.relative_to(root)), "bytes": path.stat().st_size, "sha256": sha256(path)}


def _first_difference(key: str, there: Any, here: Any) -> str:
    if isinstance(there, dict) and isinstance(here, dict):
        for name in [*there, *here]:
            if there.get(name) != here.get(name):
                return _first_difference(f"{key}.{name}", there.get(name), here.get(name))
    return f"{key} is {_short(there)} there, {_short(here)} here"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
