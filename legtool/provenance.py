"""Where data and figures come from: the commit and the versions that made them."""

from __future__ import annotations

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from threadpoolctl import threadpool_info

_PACKAGES = ("legtool", "legtool-runtime", "numpy", "scipy", "scikit-learn", "pyarrow", "mujoco", "numba")


def commit() -> str | None:
    """The git commit of this legtool, ``-dirty`` where its code was changed; None for an installed wheel."""
    package = Path(__file__).resolve().parent

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(package), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "cli.py")  # a virtual environment may lie in someone else's checkout
        dirty = git("status", "--porcelain", "--untracked-files=no", ".")
        return git("rev-parse", "HEAD") + ("-dirty" if dirty else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def kernels() -> str:
    """NumPy's and SciPy's BLAS libraries, with the kernels that they chose for this processor."""
    import numpy  # noqa: F401  its BLAS is told once it is loaded; others' are loaded or not, and compute no data
    import scipy.linalg  # noqa: F401

    found = {
        " ".join(str(entry[key]) for key in ("internal_api", "version", "architecture") if entry.get(key))
        for entry in threadpool_info()
        if entry["user_api"] == "blas" and any(name in entry["filepath"] for name in ("numpy", "scipy"))
    }
    return ", ".join(sorted(found))


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that figures depend on, where installed; the system, processor and BLAS
    kernels that ran them, for sums of floats differ between processors."""
    found = {"python": platform.python_version(), "system": platform.platform(), "processor": _processor()}
    if told := kernels():
        found["blas"] = told
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
