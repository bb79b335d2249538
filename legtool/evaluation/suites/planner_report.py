"""The planner suite's page: outcomes beside the blind controller's, times, errors, and the walks drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from legtool.evaluation.report.page import cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric

#: Columns of the table: metric, heading, factor, digits.
_COLUMNS = (
    ("success", "success [%]", 100.0, 0),
    ("clean", "clean [%]", 100.0, 0),
    ("planning_time_median_s", "planning median [ms]", 1e3, 3),
    ("planning_time_p99_s", "p99 [ms]", 1e3, 2),
    ("planning_time_worst_s", "worst [ms]", 1e3, 2),
    ("cumulative_cost", "cumulative cost [m]", 1.0, 1),
    ("cdm_mae", "CDM MAE [mm]", 1e3, 1),
    ("fdm_mae", "FDM MAE [mm]", 1e3, 1),
    ("cvm_mae", "CVM MAE [m/s]", 1.0, 4),
    ("duration_s", "time [s]", 1.0, 1),
)


def write_planner_report(
    path: Path,
    metrics: Mapping[str, Metric],
    records: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]],
    drawings: Mapping[str, Mapping[str, Mapping[str, str]]],
    provenance: Mapping[str, Any],
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        metrics: as in ``results.json``.
        records: course and pilot to the records of their trials.
        drawings: course and pilot to ``course`` and ``film`` SVGs of the first trial.
        provenance: as in ``results.json``.

    Raises:
        OutputError: it cannot be written.
    """
    settings = provenance["settings"]
    facts = [
        ("robot", f"{settings['robot']}, controller {settings['black_box'] or 'built-in trot'}"),
        ("map", "from the robot's depth camera" if settings["map"] == "camera" else "the true course"),
        ("trials", f"{settings['trials']} of each row, start and heading drawn at random"),
        *origin(provenance, hashed="bundle"),
    ]
    sections: list[dict[str, Any]] = []
    for course, by_pilot in drawings.items():
        pilots = [pilot for name, pilot in records if name == course]
        sections.append(
            {
                "title": course,
                "text": "Wilson 95 % intervals behind shares, bootstrap over trials behind means. Clean: the goal was "
                "reached and no foot ever stood in a gap or on an edge. Blind: the same controller at "
                f"{settings['blind_speed']} m/s, from the same starts.",
                "table": _table(course, pilots, metrics),
            }
        )
        lost = _losses(course, records)
        if lost["rows"]:
            sections.append({"title": f"{course}: how trials were lost", "table": lost})
        for pilot in pilots:
            for what in ("course", "film"):
                if what in by_pilot.get(pilot, {}):
                    title = f"{course}, {pilot}: " + ("from above" if what == "course" else "filmstrip")
                    sections.append({"title": title, "figure": by_pilot[pilot][what]})
    write_page(path, "Planner in closed loop", facts, sections)


def _table(course: str, pilots: Sequence[str], metrics: Mapping[str, Metric]) -> dict[str, Any]:
    rows = []
    for pilot in pilots:
        cells = [
            metric_cell(metrics.get(f"{course}.{pilot}.{key}"), factor, digits) for key, _, factor, digits in _COLUMNS
        ]
        rows.append({"name": pilot, "cells": cells})
    return {"head": ["", *(heading for _, heading, _, _ in _COLUMNS)], "rows": rows}


def _losses(course: str, records: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    rows = []
    for (name, pilot), found in records.items():
        reasons = Counter(str(record["outcome"]) for record in found if not record["success"])
        if name == course and reasons:
            text = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common())
            rows.append({"name": pilot, "cells": [cell(text)]})
    return {"head": ["", "reasons"], "rows": rows}
