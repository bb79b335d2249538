"""``results.json``: a flat map of metrics with 95 % intervals, and where they come from. Shared by every suite."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypedDict

from legtool.datasets.files import read_json, write_json
from legtool.errors import OutputError
from legtool.provenance import commit, versions


class Metric(TypedDict):
    """One number: its value, the ends of its 95 % interval (None where none was taken), how many samples, its unit."""

    value: float
    ci95: list[float] | None
    n: int
    unit: str


def metric(value: float, ci95: tuple[float, float] | None, n: int, unit: str) -> Metric:
    """Build one entry; ``unit`` is SI, ``1`` for a share or a count."""
    interval = None if ci95 is None else [float(ci95[0]), float(ci95[1])]
    return {"value": float(value), "ci95": interval, "n": int(n), "unit": unit}


def provenance(settings: Mapping[str, Any], *, seed: int, data_hash: str, **more: Any) -> dict[str, Any]:
    """What is needed to make the same figures again: settings, seed, data, commit, versions, and the suite's own."""
    return {
        "settings": dict(settings),
        "seed": seed,
        "data_hash": data_hash,
        "commit": commit(),
        "versions": versions(),
        **more,
    }


def keep_with_run(results: Path, run: Path, line: str) -> Iterator[str]:
    """Copy the results of a run into it, where ``legtool export`` finds them; those of another line are left there.

    Args:
        results: file that :func:`write_results` wrote.
        run: directory of the run that was measured.
        line: of work that was measured; a network that serves two lines is measured twice.

    Yields:
        a line that says so where the run cannot be written to.
    """
    try:
        write_json(run / f"results_{line}.json", read_json(results))
    except OutputError as error:
        yield f"{error}; give these results to legtool export by --set results={results}"


def write_results(
    path: Path,
    metrics: Mapping[str, Metric],
    provenance: Mapping[str, Any],
    *,
    verdict: Mapping[str, Any] | None = None,
) -> None:
    """Write ``results.json`` atomically.

    Args:
        path: the file.
        metrics: name to number, names dotted from the general to the particular.
        provenance: from :func:`provenance`.
        verdict: on the metrics, where there is one: its ``level`` and ``findings``.

    Raises:
        OutputError: it cannot be written.
        ValueError: a metric is not finite.
    """
    for name, entry in metrics.items():
        numbers = [entry["value"], *(entry["ci95"] or ())]
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"metric {name} is not finite: {entry}")
    path.parent.mkdir(parents=True, exist_ok=True)
    judged = {} if verdict is None else {"verdict": dict(verdict)}
    write_json(path, {**judged, "metrics": dict(metrics), "provenance": dict(provenance)})
