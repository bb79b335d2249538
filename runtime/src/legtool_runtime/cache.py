"""Compiled kernels, kept per user so that a robot compiles them once.

They are kept under ``$NUMBA_CACHE_DIR``, else ``$XDG_CACHE_HOME``, else ``~/.cache``, in a folder of their own for each
installation of this package and each state of its sources: numba alone would look at the kernel's own file only, and
after an upgrade run old machine code of a function that the kernel calls from another file. A place that cannot be
written, or a damaged entry, costs a new compilation and nothing else; a place that was filled before it was made
read-only (a container image) is read.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).resolve().parent


def kernel(function: F) -> F:
    """Compile a function to machine code on its first call, or load what an earlier process compiled."""
    dispatcher: Any = njit(error_model="numpy")(function)
    if cache_directory() is not None:
        dispatcher._cache = _Cache(function)
    return dispatcher


@functools.cache
def cache_directory() -> Path | None:
    """Where this installation's kernels are kept; None where the user has no home."""
    root = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        home = Path(root) if root else Path.home() / ".cache"
    except RuntimeError:
        return None
    sources = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        sources.update(source.relative_to(_PACKAGE).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return home / "legtool-runtime" / f"{_installation()}-{sources.hexdigest()[:16]}"


def _installation() -> str:
    return hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:12]


class _Locator:
    """Tells numba where one kernel's files lie."""

    def __init__(self, directory: Path, function: Callable[..., Any]) -> None:
        source = Path(function.__code__.co_filename).resolve()
        # numba names the files after the module's last name only: keep the packages apart.
        self._directory = directory / source.parent.name
        self._py_file = str(source)
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], _: str) -> _Locator | None:
        directory = cache_directory()
        return None if directory is None else cls(directory, function)

    def ensure_cache_path(self) -> None:
        directory = self._directory.parent
        if not directory.is_dir():
            for outdated in directory.parent.glob(f"{_installation()}-*"):
                shutil.rmtree(outdated, ignore_errors=True)
        self._directory.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._directory)

    def get_source_stamp(self) -> str:
        return self._directory.parent.name

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012  numba's own attribute, a list there too


class _Cache(FunctionCache):
    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a power cut can leave anything in the file
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(OSError):  # read-only or full: the next process compiles anew
            super().save_overload(sig, data)
