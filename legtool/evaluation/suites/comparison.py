"""Planners of a suite beside each other: who reaches which goal, what trials are lost by, and differences of pairs.

All planners begin a trial of one number in the same world from the same start, so that differences are those of pairs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

from legtool.evaluation.report.intervals import mean, paired_difference, paired_p, share
from legtool.evaluation.report.page import Cell, cell
from legtool.evaluation.report.results import Metric, metric
from legtool.evaluation.suites.planner_metrics import CAUSES, HALTED

Record = Mapping[str, Any]
Records = Mapping[tuple[str, str], Sequence[Record]]

#: All worlds together, in names of metrics.
ALL = "all"
#: A robot that falls so soon after a foot stood where none may has lost its trial by that [s].
_SOON_S = 3.0


def lost_by(record: Record) -> str:
    """What a trial was lost by, in a word; empty for one that succeeded.

    ``misstep``: a fall within 3 s after a foot stood where no foot may; ``balance``: any other fall; ``stuck``: no
    headway, where no stage of the planner says that it has no answer, else that stage; ``stopped``: the controller
    would not go on; ``error``.
    """
    if record["success"]:
        return ""
    outcome = str(record["outcome"])
    if outcome == "fell":
        late = any(when >= record["duration_s"] - _SOON_S for when, *_ in record["missteps"])
        return "misstep" if late else "balance"
    if outcome in HALTED:
        blocked = str((record.get("stages") or {}).get("blocked_by", ""))
        return blocked if blocked in CAUSES else "stuck"
    return "error" if outcome.startswith("error") else "stopped"


def compare(records: Records) -> dict[str, Metric]:
    """Differences of each pair of planners, in each world and, of several, in all of them together.

    ``<world>.<one>-<other>.success_difference`` (Newcombe's paired interval), ``.success_p`` (exact McNemar) and
    ``.progress_difference`` (bootstrap over trials), where both have trials of the same numbers.
    """
    out: dict[str, Metric] = {}
    for world, one, other, pairs in _pairs(records):
        name = f"{world}.{one}-{other}"
        reached = [[bool(record["success"]) for record in side] for side in pairs]
        out[f"{name}.success_difference"] = paired_difference(*reached)
        out[f"{name}.success_p"] = metric(paired_p(*reached), None, len(reached[0]), "1")
        if all(record.get("progress") for side in pairs for record in side):
            gained = [a["progress"][-1][1] - b["progress"][-1][1] for a, b in zip(*pairs, strict=True)]
            out[f"{name}.progress_difference"] = mean(gained, "1")
    return out


def _pairs(records: Records) -> Iterator[tuple[str, str, str, tuple[list[Record], list[Record]]]]:
    """World, two planners and their records of the same trials."""
    worlds, rows = (list(dict.fromkeys(key[k] for key in records)) for k in (0, 1))
    for one, other in combinations(rows, 2):
        first: list[Record] = []
        second: list[Record] = []
        for world in worlds:
            a, b = records[world, one], records[world, other]
            both = min(len(a), len(b))
            first += a[:both]
            second += b[:both]
            yield world, one, other, (list(a[:both]), list(b[:both]))
        if len(worlds) > 1:
            yield ALL, one, other, (first, second)


def comparison_sections(records: Records, metrics: Mapping[str, Metric]) -> list[dict[str, Any]]:
    """Sections of a page: successes of all planners in all worlds, differences to the first one, and causes.

    Args:
        records: world and planner to the records of their trials.
        metrics: with those of :func:`compare`.

    Returns:
        none where there is nothing to compare.
    """
    worlds, rows = (list(dict.fromkeys(key[k] for key in records)) for k in (0, 1))
    if len(rows) < 2:
        return []
    sections = [
        {
            "title": "All planners",
            "text": "Goals reached of all trials; below Wilson's 95 % interval in percent, and the clean walks.",
            "table": {
                "head": ["", *rows],
                "rows": [{"name": w, "cells": [_reached(records[w, row]) for row in rows]} for w in worlds],
            },
        },
        {
            "title": f"Differences to {rows[0]}",
            "text": f"Share of goals reached by {rows[0]} less that of each other planner in the same trials, in "
            "percent; below Newcombe's 95 % interval for pairs, and exact McNemar's p.",
            "table": {
                "head": ["", *rows[1:]],
                "rows": [
                    {"name": w, "cells": [_difference(metrics, f"{w}.{rows[0]}-{row}") for row in rows[1:]]}
                    for w in [*worlds, *([ALL] if len(worlds) > 1 else [])]
                ],
            },
        },
    ]  # fmt: skip
    lost = {row: Counter(lost_by(r) for w in worlds for r in records[w, row]) for row in rows}
    causes = sorted({cause for counts in lost.values() for cause in counts if cause})
    if causes:
        sections.append(
            {
                "title": "What trials were lost by",
                "text": "Of all worlds. Misstep: a fall within 3 s after a foot stood where no foot may; balance: any "
                "other fall; stuck: no headway; stopped: the controller would not go on; or the planner's stage that "
                "had no answer.",
                "table": {
                    "head": ["", "trials", "reached", *causes],
                    "rows": [
                        {
                            "name": row,
                            "cells": [cell(str(count)) for count in (lost[row].total(), lost[row][""])]
                            + [cell(str(lost[row][cause]) if lost[row][cause] else "–") for cause in causes],
                        }
                        for row in rows
                    ],
                },
            }
        )
    return sections


def _reached(found: Sequence[Record]) -> Cell:
    entry = share(sum(record["success"] for record in found), len(found))
    low, high = (100 * end for end in entry["ci95"] or (0.0, 0.0))
    clean = sum(record["clean"] for record in found)
    return cell(f"{round(entry['value'] * entry['n'])}/{entry['n']}", f"{low:.0f}–{high:.0f}; {clean} clean")


def _difference(metrics: Mapping[str, Metric], name: str) -> Cell:
    entry = metrics.get(f"{name}.success_difference")
    if entry is None:
        return cell("–")
    low, high = (100 * end for end in entry["ci95"] or (0.0, 0.0))
    p = metrics[f"{name}.success_p"]["value"]
    return cell(f"{100 * entry['value']:+.0f}", f"{low:+.0f} to {high:+.0f}; p {p:.2g}")


def causes_of(records: Sequence[Record]) -> dict[str, Metric]:
    """Shares of trials that were lost by each cause, of causes that there were."""
    counts = Counter(lost_by(record) for record in records)
    return {f"lost_{cause}": share(count, len(records)) for cause, count in sorted(counts.items()) if cause}
