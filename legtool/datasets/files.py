"""Files that are written whole or not at all, and the hash of a file's bytes."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from legtool.errors import DatasetError, OutputError
from legtool_runtime.errors import shown


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


def temporary_beside(path: Path) -> Path:
    """A name beside ``path`` that no other writer has: it holds the process's number and a random part."""
    return path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp")


def sweep_temporaries(directory: Path, name: str | None = None) -> None:
    """Remove what killed writers left under temporary names; no link is followed.

    Only for who holds the directory's lock: a temporary name that is in use looks the same.

    Args:
        directory: with ``name`` None it is searched to any depth.
        name: of the one file or directory beside which its writers left something.
    """
    pattern = re.compile(rf"\.{'.+' if name is None else re.escape(name)}\.\d+(\.[0-9a-f]{{8}})?\.tmp")
    for root, directories, files in os.walk(directory):
        for found in filter(pattern.fullmatch, directories):
            shutil.rmtree(Path(root, found), ignore_errors=True)
        for found in filter(pattern.fullmatch, files):
            Path(root, found).unlink(missing_ok=True)
        if name is not None:
            return


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; on success it takes ``path``'s place at once, on failure it is gone.

    Raises:
        OutputError: the disk is full or the place cannot be written.
    """
    temporary = temporary_beside(path)
    try:
        # Made anew, so that a link which lies there is refused and never written through.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
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


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8 atomically.

    Raises:
        OutputError: the disk is full or the place cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, keys in the order given, ending in a newline."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Parse one JSON object.

    Raises:
        DatasetError: missing, unreadable, or not an object.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: no such file") from error
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: not readable as JSON ({shown(error)})") from error
    if not isinstance(value, dict):
        raise DatasetError(f"{path}: expected a JSON object, got {type(value).__name__}")
    return value
