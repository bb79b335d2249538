"""Whether two commands are the same work, and the claim that one of them has on the directory it writes.

A marker file in a directory (``manifest.json``, ``run.json``, …) begins with the *identity* of the work: all that
decides its outcome, as content and not as names. A command claims its directory before it writes anything else there.
The same work carries on with what is there; other work is refused, and the message names the first difference.
"""

from __future__ import annotations

import dataclasses
import fcntl
import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from legtool.datasets.files import explain_os_error, read_json, sweep_temporaries, write_json
from legtool.errors import OutputError
from legtool_runtime.bundle import MANIFEST

LOCK = ".lock"
#: Tenths of a second for which who shares a lock waits for who begins the work.
_BRIEFLY = 100


class Kind(NamedTuple):
    """What a directory is written for: its name in messages, and the file that tells which work it holds."""

    what: str
    marker: str


DATASET = Kind("dataset", "manifest.json")
RUN = Kind("run", "run.json")
BUNDLE = Kind("bundle", MANIFEST)
SUITE = Kind("suite", "suite.json")
RESULTS = Kind("results", "results.json")


def digest(value: Any) -> str:
    """SHA-256 of what a value holds, the same for equal content whatever the order of its keys.

    Args:
        value: JSON types, arrays, settings, dataclasses, and mappings and sequences of them.

    Raises:
        TypeError: something else, which would have no content of its own.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [value.dtype.str, list(value.shape), hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()]
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    raise TypeError(f"{type(value).__name__} has no content to take a digest of")


@contextmanager
def claim(
    directory: Path, kind: Kind, identity: Mapping[str, Any] | None = None, *, shard: str | None = None, **more: Any
) -> Iterator[dict[str, Any]]:
    """Hold a directory for one piece of work while it is written; no other process can claim it meanwhile.

    Shards of one piece of work hold a directory together, each but once.

    Leftovers of writers that were killed are removed. A directory with nothing but a marker in it holds nothing that
    could be lost: it is claimed anew, so that a command which failed at once does not block its correction.

    Args:
        directory: new, empty, or holding work of this kind.
        kind: of work.
        identity: all that decides the outcome; None: what is there is replaced, whatever it came from, and no marker
            is begun.
        shard: name of the share of the work that is done by this process; None: all of it.
        more: what a marker begins with besides.

    Yields:
        what the marker holds: what was found there, or what was begun.

    Raises:
        OutputError: the directory holds something else or other work, cannot be written, or is being written.
        DatasetError: its marker is damaged.
    """
    with ExitStack() as held:
        try:
            check_free(directory, kind.marker)
            directory.mkdir(parents=True, exist_ok=True)
            hold = held.enter_context(locked(directory / LOCK, directory, shared=shard is not None))
            if shard is not None:
                held.enter_context(locked(directory / f"{LOCK}-{shard}", directory))
            names = check_free(directory, kind.marker)
            if hold.alone:
                sweep_temporaries(directory)
        except OSError as error:
            raise explain_os_error(error, directory) from error
        fresh = hold.alone and names == {kind.marker}
        there = {} if identity is None else _take_up(directory, kind, identity, more, alone=fresh)
        if shard is not None:
            hold.share()
        yield there


def _take_up(
    directory: Path, kind: Kind, identity: Mapping[str, Any], more: Mapping[str, Any], *, alone: bool
) -> dict[str, Any]:
    """What the marker holds, begun where there is none, or where there is but one of ours and nothing beside it."""
    marker, here = directory / kind.marker, json.loads(json.dumps(identity))
    there: dict[str, Any] = read_json(marker) if marker.is_file() else {}
    if not there or (alone and here.keys() <= there.keys()):
        there = here | json.loads(json.dumps(more))
        write_json(marker, there)
    check_same(directory, kind.what, {key: there.get(key) for key in here}, here)
    return there


class Hold(NamedTuple):
    """A lock that is held: its file, and whether nobody else holds it."""

    descriptor: int
    alone: bool

    def share(self) -> None:
        """Let others in who share it."""
        fcntl.flock(self.descriptor, fcntl.LOCK_SH)


@contextmanager
def locked(path: Path, subject: Path, *, shared: bool = False) -> Iterator[Hold]:
    """Hold a lock file; the operating system lets go of it however the process ends.

    Args:
        path: of the lock file, which is gone once nobody holds it.
        subject: what is being written, for the message.
        shared: whether others may hold it too who share it.

    Yields:
        the hold; where it is shared and nobody else is there, others wait until :meth:`Hold.share`.

    Raises:
        OutputError: another process holds it.
        OSError: it cannot be made, or a link lies in its place.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            alone = _lock(descriptor, shared)
            if _is_still_there(path, descriptor):
                break
        except BlockingIOError as error:
            os.close(descriptor)
            raise OutputError(f"{subject}: another legtool process is writing here; wait for it to end") from error
        except BaseException:
            os.close(descriptor)
            raise
        # Its last holder removed it between our opening and locking it: what we hold keeps nobody out.
        os.close(descriptor)
    try:
        yield Hold(descriptor, alone)
    finally:
        with suppress(BlockingIOError):  # others share it
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink(missing_ok=True)
        os.close(descriptor)


def _lock(descriptor: int, shared: bool) -> bool:
    """Take a lock, and tell whether it is held alone.

    Raises:
        BlockingIOError: another process holds it, and does not share it.
    """
    for last in [False] * _BRIEFLY + [True]:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if not shared:
                raise
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
            return False
        except BlockingIOError:
            if last:
                raise
        time.sleep(0.1)  # the first one to come holds it alone for a moment
    raise AssertionError


def _is_still_there(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.lstat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def check_free(directory: Path, marker: str) -> set[str]:
    """Names in a directory that may be written: one that is new, empty, or holds ``marker``.

    Lock and temporary files do not count.

    Raises:
        OutputError: it is a file, or holds something else.
    """
    if not directory.exists() and not directory.is_symlink():
        return set()
    if not directory.is_dir():
        raise OutputError(
            f"{directory}: is a file; --out expects a directory that is new, empty, or made by this command"
        )
    held = {item.name for item in directory.iterdir() if not (item.name.startswith(LOCK) or item.name.endswith(".tmp"))}
    if held and marker not in held:
        raise OutputError(f"{directory}: holds something else ({min(held)}, …); choose another --out")
    return held


def check_same(directory: Path, what: str, there: Any, here: Any) -> None:
    """Refuse to write over other work.

    Args:
        directory: which holds it.
        what: it is.
        there: its identity, as plain JSON.
        here: the identity of the work that is to be written.

    Raises:
        OutputError: they differ; the message names the first difference.
    """
    if found := _first_difference("", there, here):
        raise OutputError(
            f"{directory}: holds a {what} made with other settings or inputs ({found}); choose another --out, or "
            "remove it"
        )


def _first_difference(key: str, there: Any, here: Any) -> str | None:
    if there == here:
        return None
    if isinstance(there, dict) and isinstance(here, dict):
        pairs = [(name, there.get(name), here.get(name)) for name in dict.fromkeys([*there, *here])]
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        pairs = [(str(n), *both) for n, both in enumerate(zip(there, here, strict=True))]
    else:
        return f"{key} is {_short(there)} there, {_short(here)} here"
    found = (_first_difference(f"{key}.{name}".lstrip("."), a, b) for name, a, b in pairs)
    return next((difference for difference in found if difference), None)


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."
