"""Compiled kernels, kept per user so that a robot compiles them once.

They are kept under ``$NUMBA_CACHE_DIR``, else ``$XDG_CACHE_HOME``, else ``~/.cache``, in a folder for each
installation of this package, module, and state of numba, of the module and of all that it imports from here: numba
alone would look at the kernel's own file only, and after an upgrade run old machine code of a function that the
kernel calls from another file. Folders that nothing has used for a month are removed; versions that share a home,
such as containers with the same paths, keep each other's. A numba whose inner workings are others than those that are
extended here keeps no kernels. A place that cannot be written, or a damaged entry, costs a new compilation and
nothing else; a place that was filled before it was made read-only (a container image) is read. Like all numba caches
these are pickles: keep the place as private as the programs it speeds up.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).resolve().parent
#: Packages whose kernels are kept, by name: this one, and any other that makes kernels with it.
_PACKAGES = {_PACKAGE.name: _PACKAGE}
#: A folder of kernels that was not used for so long is removed when its module's kernels are compiled [s].
_OUTDATED_S = 30 * 86400.0
_IMPORT = re.compile(r"^\s*(?:from|import)\s+(\w[\w.]*)(?:\s+import\s+(\([^)]*\)|.*))?", re.MULTILINE)


def kernel(function: F) -> F:
    """Compile a function of a package on its first call, or load what an earlier process compiled."""
    dispatcher: Any = njit(error_model="numpy", nogil=True)(function)
    package = _package(function)
    if cache_directory() is not None and package is not None and (cache := _cache_type()) is not None:
        _PACKAGES.setdefault(package.name, package)
        with contextlib.suppress(AttributeError, TypeError):  # as below: a numba that is made otherwise keeps none
            dispatcher._cache = cache(function)
    return dispatcher


def _package(function: Callable[..., Any]) -> Path | None:
    """The directory of the package that a function stands in; None for a script."""
    top = sys.modules.get(function.__module__.partition(".")[0])
    if top is None or getattr(top, "__file__", None) is None:
        return None
    directory = Path(str(top.__file__)).resolve().parent
    inside = Path(function.__code__.co_filename).resolve().is_relative_to(directory)
    return directory if inside and (directory / "__init__.py").is_file() else None


@functools.cache
def cache_directory() -> Path | None:
    """Where this installation's kernels are kept; None where the user has no home."""
    root = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        home = Path(root) if root else Path.home() / ".cache"
    except RuntimeError:
        return None
    return home / "legtool-runtime" / hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:12]


@functools.cache
def _digest(module: Path) -> str:
    """Over the sources that a module's kernels can call: its own, and those it imports from these packages."""
    found, pending = {module}, [module]
    while pending:
        new = set(_imports(pending.pop())) - found
        found |= new
        pending += new
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(found):
        digest.update(str(source).encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@functools.cache
def _imports(module: Path) -> tuple[Path, ...]:
    def files() -> Iterator[Path]:
        for name, imported in _IMPORT.findall(module.read_text(encoding="utf-8")):
            package = _PACKAGES.get(name.partition(".")[0])
            if package is None:
                continue
            base = package.parent.joinpath(*name.split("."))
            yield base.with_suffix(".py")
            yield from ((base / part).with_suffix(".py") for part in re.findall(r"\w+", imported))

    return tuple(source for source in files() if source.is_file())


class _Locator:
    """Tells numba where one kernel's files lie."""

    def __init__(self, root: Path, function: Callable[..., Any]) -> None:
        source = Path(function.__code__.co_filename).resolve()
        package = next(package for package in _PACKAGES.values() if source.is_relative_to(package))
        self._module = ".".join(source.relative_to(package.parent).with_suffix("").parts)
        self._directory = root / f"{self._module}-{_digest(source)}"
        self._py_file = str(source)
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], _: str) -> _Locator | None:
        root = cache_directory()
        if root is None:
            return None
        found = cls(root, function)
        with contextlib.suppress(OSError):  # not there yet, or read-only
            os.utime(found._directory)
        return found

    def ensure_cache_path(self) -> None:
        if not self._directory.is_dir():
            for other in self._directory.parent.glob(f"{self._module}-*"):
                with contextlib.suppress(OSError):  # another process may remove it
                    if time.time() - other.stat().st_mtime > _OUTDATED_S:
                        shutil.rmtree(other, ignore_errors=True)
        self._directory.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._directory)

    def get_source_stamp(self) -> str:
        return self._directory.name

    def get_disambiguator(self) -> str:
        return str(self._line)


@functools.cache
def _cache_type() -> Callable[[Callable[..., Any]], Any] | None:
    """Numba's cache of a function, kept where :class:`_Locator` says; None where this numba has no such classes."""
    try:
        from numba.core.caching import CompileResultCacheImpl, FunctionCache
    except ImportError:
        return None

    class Implementation(CompileResultCacheImpl):
        _locator_classes = [_Locator]  # noqa: RUF012  numba's own attribute, a list there too

    class Cache(FunctionCache):
        _impl_class = Implementation

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

    return Cache
