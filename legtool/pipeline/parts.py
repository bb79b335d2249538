"""Write the missing parts of a dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from legtool.datasets.store import Store
from legtool.workers import LeftToOthers, Workers, run_all


def run_parts(
    store: Store,
    write: Callable[[int], None],
    *,
    total: int,
    workers: int | Workers,
    description: str,
    unit: str,
    judge: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None,
) -> dict[str, Any]:
    """Write every part that the store lacks and finish it.

    Args:
        store: the dataset being written.
        write: writes one part by its number; a pure function of that number, picklable where ``workers`` > 1.
        total: number of parts.
        workers: who works; the result is the same bytes whoever does.
        description: for the progress bar.
        unit: what a part is, in the plural.
        judge: see :meth:`.Store.finish`.

    Returns:
        the dataset's manifest.

    Raises:
        LeftToOthers: the shard's own parts are written, and others are missing.
    """
    workers = Workers.of(workers)
    mine = [index for index in range(total) if workers.takes(index)]
    pending = [index for index in store.pending(total) if workers.takes(index)]
    run_all(write, pending, workers=workers, description=description, unit=unit, done=len(mine) - len(pending))
    if workers.name and (left := len(store.pending(total))):
        raise LeftToOthers(
            f"shard {workers.name}: its {len(mine)} {unit} are done; {left} of {total} are left to others"
        )
    return store.finish(total, judge)
