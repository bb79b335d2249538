"""Two results beside each other: differences of all metrics that both hold, with intervals, and which are better."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

from legtool.datasets.files import read_json
from legtool.errors import DatasetError
from legtool.evaluation.report.intervals import difference
from legtool.evaluation.report.results import Metric

Side = Literal["better", "worse", "differs", "same", "unknown"]
#: Ends of the names of metrics of which more is better, and less.
_MORE = re.compile(
    r"(success|clean|clear_of_edges|progress|perfect|safe|mean_safe|min_safe|accuracy|miou|iou\.\w+|purity|coverage|"
    r"coverage_any_range|overlap_\w+|real_time_factor|met)$"
)
_LESS = re.compile(
    r"(rmse|mae|error\w*|regret|distance_m|jitter_\w+|overhang|late|failed_\w+|time_\w+_s|_p99_s|_median_s|hits|contacts|"
    r"blind|blind_steps|collisions|workspace_violations|without_safe|torque_saturation|cost_of_transport|aborts|ade\w*)$"
)
#: What of the settings and origins is told where it differs.
_ORIGINS = ("suite", "robot", "data", "data_hash", "run", "trained_on", "split", "seed", "commit")


class Difference(NamedTuple):
    """Of one metric: its values in the first and the second results, second less first with its 95 % interval (None
    where one of both has none), and whether the second is ``better`` or ``worse`` beyond that, ``differs`` where
    neither more nor less is known to be better, ``same`` where the interval holds 0, ``unknown`` without interval."""

    name: str
    first: Metric
    second: Metric
    value: float
    ci95: tuple[float, float] | None
    side: Side


def compare_results(first: Path, second: Path) -> tuple[list[Difference], list[str]]:
    """Compare two results of ``legtool eval``.

    Intervals are those of independent samples (Zou and Donner's MOVER, which is Newcombe's of two shares); of the same
    trials they are wider than need be.

    Args:
        first: ``results.json``, or the directory that holds it.
        second: likewise.

    Returns:
        differences of all metrics that both hold, in the first one's order; and lines on what else differs.

    Raises:
        DatasetError: no results, or none that have a metric in common.
    """
    one, other = _results(first), _results(second)
    metrics = one["metrics"], other["metrics"]
    common = [name for name, entry in metrics[0].items() if entry["unit"] == metrics[1].get(name, {}).get("unit")]
    if not common:
        raise DatasetError(
            f"{first} and {second} have no metric in common, such as {next(iter(metrics[0]), 'none')} and "
            f"{next(iter(metrics[1]), 'none')}; compare results of the same command"
        )
    told = []
    for key in _ORIGINS:
        a, b = (results.get("provenance", {}).get(key) for results in (one, other))
        if a != b:
            told.append(f"{key.replace('_', ' ')} differs: {_brief(a)} and {_brief(b)}")
    return [_difference(name, metrics[0][name], metrics[1][name]) for name in common], told


def describe(found: list[Difference], told: list[str], *, every: bool) -> Iterator[str]:
    """Lines for a terminal: first what differs, then how many metrics do not; with ``every`` all of them."""
    yield from told
    shown = [entry for entry in found if every or entry.side in ("better", "worse", "differs")]
    for entry in shown:
        interval = "" if entry.ci95 is None else " [{:+.4g}, {:+.4g}]".format(*entry.ci95)
        yield (
            f"{entry.name}: {entry.first['value']:.4g} and {entry.second['value']:.4g} {entry.first['unit']}, "
            f"{entry.value:+.4g}{interval}, {entry.side}"
        )
    counts = {side: sum(entry.side == side for entry in found) for side in ("better", "worse", "differs", "same")}
    bare = len(found) - sum(counts.values())
    yield (
        f"of {len(found)} metrics the second is better in {counts['better']}, worse in {counts['worse']}, otherwise "
        f"different in {counts['differs']}; {counts['same']} do not differ beyond 95 % intervals, {bare} have none"
    )


def as_json(found: list[Difference], told: list[str]) -> str:
    """All differences as JSON."""
    held = {entry.name: {key: value for key, value in entry._asdict().items() if key != "name"} for entry in found}
    return json.dumps({"notes": told, "differences": held}, indent=2, ensure_ascii=False)


def _results(path: Path) -> dict[str, Any]:
    file = path / "results.json" if path.is_dir() else path
    if not file.is_file():
        raise DatasetError(f"{file}: no such file; expected results.json of legtool eval, or its directory")
    held = read_json(file)
    if not isinstance(held.get("metrics"), dict) or not held["metrics"]:
        raise DatasetError(f"{file}: holds no metrics; expected a file written by legtool eval")
    return held


def _difference(name: str, first: Metric, second: Metric) -> Difference:
    value, interval = difference(first, second)
    side: Side = "unknown"
    if interval is not None:
        apart = interval[0] > 0.0 or interval[1] < 0.0
        side = "same" if not apart else _side(name, value)
    return Difference(name, first, second, value, interval, side)


def _side(name: str, value: float) -> Side:
    if _LESS.search(name):
        return "better" if value < 0.0 else "worse"
    if _MORE.search(name):
        return "better" if value > 0.0 else "worse"
    return "differs"


def _brief(value: Any) -> str:
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text[:12] if re.fullmatch(r"[0-9a-f]{40,64}\+?.*", text) else text


def worse(found: list[Difference]) -> bool:
    """Whether the second is worse in anything, beyond its interval."""
    return any(entry.side == "worse" for entry in found)
