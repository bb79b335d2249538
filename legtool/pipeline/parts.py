"""Write the missing parts of a dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from legtool.datasets.store import Store
from legtool.workers import run_all


def run_parts(
    store: Store,
    write: Callable[[int], None],
    *,
    total: int,
    workers: int,
    description: str,
    unit: str,
    judge: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None,
) -> dict[str, Any]:
    """Write every part that the store lacks and finish it.

    Args:
        store: the dataset being written.
        write: writes one part by its number; a pure function of that number, picklable where ``workers`` > 1.
        total: number of parts.
        workers: processes; the result is the same bytes whatever their number.
        description: for the progress bar.
        unit: what a part is, in the plural.
        judge: see :meth:`.Store.finish`.

    Returns:
        the dataset's manifest.
    """
    pending = store.pending(total)
    run_all(write, pending, workers=workers, description=description, unit=unit, done=total - len(pending))
    return store.finish(total, judge)
