"""Work on a Dask cluster: one that is running, or one of this machine alone.

Every machine has to see the directories of the command under the same paths (a shared file system), and the same
legtool and libraries: both are looked at before anything is done. A Dask worker hands each item to a process of its
own, which works in its main thread with one thread for numerical libraries, and is killed where an item takes too long.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import secrets
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from legtool.errors import SettingsError
from legtool.processes import OwnProcess
from legtool.provenance import versions

#: Items in hand for each worker: enough that none waits for the next one.
_EACH = 4
#: Seconds within which a scheduler answers.
_ANSWERS_S = 20


class Cluster:
    """Hands items to the workers of a Dask cluster (see :class:`legtool.workers.Crew`)."""

    def __init__(self, address: str, shared: Path) -> None:
        """Connect.

        Args:
            address: of the scheduler, ``tcp://HOST:8786``, or ``local:N``.
            shared: directory that the results are written into.

        Raises:
            SettingsError: dask is not installed, no scheduler answers there, it has no workers, or a worker has other
                software or does not see the directory.
        """
        self._held = ExitStack()
        try:
            client = self._connect(address)
            count = len(client.ncores())
            if not count:
                raise SettingsError(f"--cluster {address}: the scheduler has no workers; start some with dask worker")
            _compare(client, address, shared)
        except BaseException:
            self._held.close()
            raise
        self._executor = client.get_executor(pure=False)
        self._where = str(Path.cwd())
        self.window = _EACH * count

    def _connect(self, address: str) -> Any:
        try:
            import dask
            from distributed import Client, LocalCluster
        except ImportError as error:
            raise SettingsError("--cluster needs dask: pip install 'legtool[cluster]'") from error
        self._held.enter_context(dask.config.set({"distributed.worker.daemon": False}))
        where: Any = address
        if address.startswith("local:"):
            if not re.fullmatch(r"local:[1-9]\d{0,3}", address):
                raise SettingsError(f"--cluster {address}: expected a number of workers, such as local:2")
            where = self._held.enter_context(
                LocalCluster(
                    n_workers=int(address.partition(":")[2]),
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address=None,
                )
            )
        try:
            return self._held.enter_context(Client(where, timeout=_ANSWERS_S, set_as_default=False))
        except (OSError, ValueError) as error:
            raise SettingsError(f"--cluster {address}: no Dask scheduler answers there ({error})") from error

    def submit(self, function: Callable[[Any], None], item: Any, limit_s: float | None) -> Future[None]:
        """Begin an item."""
        future: Future[None] = self._executor.submit(_on_worker, self._where, function, item, limit_s)
        return future

    def leave(self, *, now: bool) -> None:
        """Let go of the cluster; one that was started here ends."""
        self._executor.shutdown(wait=not now, **({"cancel_futures": True} if now else {}))
        self._held.close()


_process = OwnProcess()


def _on_worker(where: str, function: Callable[[Any], None], item: Any, limit_s: float | None) -> None:
    """Run an item in the process that belongs to this Dask worker."""
    import multiprocessing

    os.chdir(where)  # paths of settings may be relative to where the command was given
    # A worker under a nanny counts as a daemon, which multiprocessing lets start no process; it ends with its parent.
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
    _process.run(function, item, limit_s)


def fingerprint() -> dict[str, str]:
    """What decides the bytes that a machine writes: versions, our own source, and the kernels of its BLAS."""
    import legtool
    import legtool_runtime

    digest = hashlib.sha256()
    for package in (legtool, legtool_runtime):
        root = Path(str(package.__file__)).parent
        for source in sorted(root.rglob("*.py")):
            digest.update(str(source.relative_to(root)).encode() + source.read_bytes())
    told = {"source": digest.hexdigest()[:12], **versions()}
    return {name: value for name, value in told.items() if name not in ("system", "processor")}


def _seen(where: str, probe: str) -> tuple[str, dict[str, str], bool]:
    return platform.node(), fingerprint(), Path(where).is_dir() and Path(probe).is_file()


def _compare(client: Any, address: str, shared: Path) -> None:
    """Refuse workers that would write other bytes, or elsewhere."""
    here = fingerprint()
    probe = shared.absolute() / f".{secrets.token_hex(4)}.probe.{os.getpid()}.{secrets.token_hex(4)}.tmp"
    probe.touch()
    try:
        seen = client.run(_seen, str(Path.cwd()), str(probe))
    finally:
        probe.unlink(missing_ok=True)
    for host, there, sees in seen.values():
        for name in here:
            if there.get(name) != here[name]:
                raise SettingsError(
                    f"--cluster {address}: worker on {host} has {name} {there.get(name)}, here it is {here[name]}; "
                    "results would differ: install the same there, or work with --shard on machines of one kind"
                )
        if not sees:
            raise SettingsError(
                f"--cluster {address}: worker on {host} does not see {shared.absolute()} or {Path.cwd()}; both have "
                "to be on a file system that all machines share under the same path"
            )
