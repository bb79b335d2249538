"""The directory of a suite: every finished trial is a file of its own, named by a digest of all that decides it.

So a suite that was interrupted carries on, more trials of the same kind reuse what is there, and a trial is never
answered by one of another world, robot, controller, bundle or setting, whatever their names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from legtool.datasets.files import read_json, write_json
from legtool.datasets.work import SUITE, claim, digest
from legtool.provenance import commit
from legtool.workers import LeftToOthers, Workers, run_all

TRIALS = "trials"
SCHEMA_VERSION = 1
#: Characters of the digest that a file's name shows.
_SHOWN = 12


class TrialKey(NamedTuple):
    """One trial: the names that people know it by, and the digest of all that decides its outcome."""

    world: str
    planner: str
    number: int
    digest: str

    def __str__(self) -> str:
        return f"{self.world} by {self.planner}, trial {self.number}"


#: Endings of what is to lie beside a trial's record.
Wanted = Callable[[TrialKey], Sequence[str]]


def trial_key(world: str, planner: str, number: int, decides: Mapping[str, Any]) -> TrialKey:
    """The key of a trial.

    Args:
        world: its name.
        planner: its name.
        number: of the trial, from 0 on; the seed of all that it draws.
        decides: contents of world, robot, controller and bundle, and every setting that changes the outcome.
    """
    return TrialKey(world, planner, number, digest({"planner": planner, "number": number, "decides": decides}))


class Trials:
    """The trials of a suite on disk, held while the suite runs (``with Trials(out, kind) as trials``).

    It may be handed to other processes, which read and write under the lock of the one that holds it.
    """

    def __init__(self, out: Path, kind: str, suffix: str = ".json", *, workers: int | Workers = 1) -> None:
        """Name the directory; nothing is touched yet.

        Args:
            out: the suite's directory.
            kind: of suite, such as ``planner``.
            suffix: of the trials' files.
            workers: who walks.
        """
        self.out, self.kind, self.suffix, self.workers = out, kind, suffix, Workers.of(workers)
        self._claim = ExitStack()

    def __enter__(self) -> Trials:
        """Hold the directory.

        Raises:
            OutputError: it holds something else or another kind of suite, or is being written by another process.
        """
        identity = {"schema_version": SCHEMA_VERSION, "suite": self.kind}
        self._claim.enter_context(claim(self.out, SUITE, identity, shard=self.workers.name, commit=commit()))
        (self.out / TRIALS).mkdir(exist_ok=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._claim.close()

    def __reduce__(self) -> tuple[type[Trials], tuple[Path, str, str]]:
        return Trials, (self.out, self.kind, self.suffix)

    def path(self, key: TrialKey) -> Path:
        """Where a trial's record lies: ``<world>.<planner>.<number>-<digest>``."""
        world, planner = (re.sub(r"[^A-Za-z0-9_-]+", "_", name) for name in (key.world, key.planner))
        return self.out / TRIALS / f"{world}.{planner}.{key.number:04d}-{key.digest[:_SHOWN]}{self.suffix}"

    def beside(self, key: TrialKey, ending: str) -> Path:
        """Where something lies that belongs to a trial: a drawing, a film."""
        path = self.path(key)
        return path.with_name(f"{path.name.removesuffix(self.suffix)}.{ending}")

    def pending(self, keys: Iterable[TrialKey], wanted: Wanted = lambda key: ()) -> list[TrialKey]:
        """Those that are not finished, each once, in the order given.

        Args:
            keys: of trials.
            wanted: endings of what is to lie beside a finished one.
        """
        return [
            key
            for key in dict.fromkeys(keys)
            if not all(path.is_file() for path in (self.path(key), *(self.beside(key, end) for end in wanted(key))))
        ]

    def run(
        self,
        keys: Iterable[TrialKey],
        walk: Callable[[TrialKey], None],
        *,
        wanted: Wanted = lambda key: (),
    ) -> None:
        """Walk the trials that are not finished.

        Args:
            keys: of all trials.
            walk: walks one and leaves its record here, last of all; picklable where others than this process walk.
            wanted: as for :meth:`pending`.

        Raises:
            LeftToOthers: the shard's own trials are walked, and others are not.
        """
        every = list(dict.fromkeys(keys))
        mine = [key for place, key in enumerate(every) if self.workers.takes(place)]
        left = self.pending(mine, wanted)
        run_all(walk, left, workers=self.workers, description="walking", unit="trials", done=len(mine) - len(left))
        if self.workers.name and (others := len(self.pending(every, wanted))):
            done = f"shard {self.workers.name}: its {len(mine)} trials are walked"
            raise LeftToOthers(f"{done}; {others} of {len(every)} are left to others")

    def read(self, key: TrialKey) -> dict[str, Any]:
        """The record of a finished trial.

        Raises:
            DatasetError: it is missing or damaged.
        """
        return read_json(self.path(key))

    def write(self, key: TrialKey, record: Mapping[str, Any]) -> None:
        """Keep the record of a trial that is finished, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        write_json(self.path(key), dict(record))
