"""Bag files as they can be opened: unpacked where they are compressed as a whole, with what waits beside them."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import zstandard

from legtool.datasets.logs.formats import BAG_SUFFIXES, is_packed
from legtool.errors import LogError

#: Size of the header of SQLite's journal, after which its frames begin [bytes].
_EMPTY_JOURNAL = 32


def journal_of(file: Path) -> Path | None:
    """The journal beside a database that holds messages which are not in it yet: the recorder was killed."""
    journal = file.with_name(f"{file.name}-wal")
    waits = file.suffix.lower() == ".db3" and journal.is_file() and journal.stat().st_size > _EMPTY_JOURNAL
    return journal if waits else None


@contextmanager
def openable(path: Path) -> Iterator[Path]:
    """Yield a path that holds all of a bag's messages: ``path`` itself, or a temporary copy; ``path`` never changes.

    Args:
        path: a bag file, or a directory with metadata.

    Raises:
        LogError: a compressed file, or a database with its journal, is damaged.
    """
    journal = journal_of(path) if path.is_file() else None
    if journal is None and not (path.is_file() and is_packed(path)):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="legtool-") as folder:
        copy = Path(folder) / (path.name if journal is not None else path.stem)
        if journal is None:
            _unpack(path, copy)
        else:
            _merge(path, journal, copy)
        yield copy


def _unpack(path: Path, copy: Path) -> None:
    if copy.suffix.lower() not in BAG_SUFFIXES:
        raise LogError(f"{path}: not a compressed bag; expected a name such as {copy.stem}.mcap{path.suffix}")
    try:
        with path.open("rb") as packed, copy.open("wb") as plain:
            stream = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            shutil.copyfileobj(stream, plain, 2**22)
    except zstandard.ZstdError as error:
        raise LogError(f"{path}: cannot be unpacked as zstd: {error}") from error


def _merge(path: Path, journal: Path, copy: Path) -> None:
    shutil.copyfile(path, copy)
    shutil.copyfile(journal, copy.with_name(f"{copy.name}-wal"))
    try:
        database = sqlite3.connect(copy)
        try:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.execute("PRAGMA journal_mode=DELETE")
        finally:
            database.close()
    except sqlite3.Error as error:
        raise LogError(f"{path}: cannot be read together with {journal.name} beside it: {error}") from error
