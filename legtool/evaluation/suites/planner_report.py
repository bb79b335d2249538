"""The planner suite's page: outcomes beside the blind planner's, times, errors, and the walks drawn and filmed."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from legtool.evaluation.report.page import cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.evaluation.suites.climb_plots import climb_sections
from legtool.evaluation.suites.comparison import comparison_sections
from legtool.evaluation.suites.planner_metrics import HALTED
from legtool.evaluation.suites.progress_plots import progress_section
from legtool.verdict import Verdict

#: What planners do, by their rows.
_DOES = {
    "scripted": "goes where it was told before the walk",
    "vital": "chooses footholds by the criteria, and poses that leave the most of them",
    "tbr": "chooses the same footholds, and poses along their plane",
    "vital_single": "is vital with one horizon",
    "vital_sum": "is vital with the paper's sum of all legs' safe footholds",
    "vital_integral": "is vital with the paper's integral over them",
    "quadpips": "searches for footholds on regions",
    "quadpips_paper": "searches by the paper's own rules",
    "s_mpc": "steps on the region nearest to a nominal foothold",
    "em_mpc": "steps on the flat cell nearest to it, of an elevation map of 2 cm",
    "em_mpc_6cm": "steps on the flat cell nearest to it, of an elevation map of 6 cm",
    "em_rl": "is a learned policy that sees heights about its feet",
    "em_dtc": "is a learned policy that follows the footholds of em_mpc",
}
#: Columns of the table: metric, heading, factor, digits.
_COLUMNS = (
    ("success", "success [%]", 100.0, 0),
    ("clean", "clean [%]", 100.0, 0),
    ("progress", "progress [%]", 100.0, 0),
    ("time_to_goal_s", "time to the goal [s]", 1.0, 1),
    ("cost_of_transport", "cost of transport", 1.0, 2),
    ("planning_time_median_s", "planning median [ms]", 1e3, 3),
    ("planning_time_p99_s", "p99 [ms]", 1e3, 2),
    ("planning_time_worst_s", "worst [ms]", 1e3, 2),
    ("cumulative_cost", "cumulative cost [m]", 1.0, 1),
    ("cdm_mae", "CDM MAE [mm]", 1e3, 1),
    ("fdm_mae", "FDM MAE [mm]", 1e3, 1),
    ("cvm_mae", "CVM MAE [m/s]", 1.0, 4),
    ("planning_late", "late plans [%]", 100.0, 2),
    ("perception_median_s", "perception median [ms]", 1e3, 2),
    ("torso_search_median_s", "torso search median [ms]", 1e3, 2),
    ("torso_search_p99_s", "p99 [ms]", 1e3, 2),
    ("foothold_search_median_s", "foothold search median [ms]", 1e3, 2),
    ("foothold_search_p99_s", "p99 [ms]", 1e3, 2),
    ("swing_median_s", "swing optimisation median [ms]", 1e3, 1),
    ("swing_p99_s", "p99 [ms]", 1e3, 1),
    ("swings_refused", "motions refused", 1.0, 1),
    ("replans", "plans", 1.0, 0),
    ("aborts", "aborts", 1.0, 1),
    ("failed_perception", "lost by perception [%]", 100.0, 0),
    ("failed_search", "by search [%]", 100.0, 0),
    ("failed_tracking", "by tracking [%]", 100.0, 0),
    ("duration_s", "time [s]", 1.0, 1),
    ("landing_error_mean_m", "landing error [mm]", 1e3, 2),
    ("landing_error_p95_m", "p95 [mm]", 1e3, 2),
    ("landing_error_worst_m", "worst [mm]", 1e3, 1),
    ("torque_saturation", "torques saturated [%]", 100.0, 2),
    ("link_contacts", "link contacts", 1.0, 1),
    ("foot_hits", "foot hits", 1.0, 1),
    ("height_error_m", "height off the plan [cm]", 100.0, 1),
    ("height_error_m_filtered", "filtered [cm]", 100.0, 2),
    ("pitch_error_rad", "pitch off the plan [°]", 180.0 / math.pi, 1),
    ("pitch_error_rad_filtered", "filtered [°]", 180.0 / math.pi, 2),
    ("min_safe", "least safe footholds", 1.0, 0),
    ("blind_steps", "blind steps [%]", 100.0, 1),
    ("real_time_factor", "× real time", 1.0, 1),
)


#: What the columns of the models' errors mean.
_MODELS = (
    " MAE: mean absolute error of what the models said of each step: displacement of the feet (FDM) and of the centre "
    "of mass (CDM), and the velocity of that (CVM)."
)


class Drawings(NamedTuple):
    """What was drawn of a trial: from above and as a filmstrip (SVG), and a film (animated WebP); empty if not."""

    above: str = ""
    strip: str = ""
    film: bytes = b""


def write_planner_report(
    path: Path,
    metrics: Mapping[str, Metric],
    records: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]],
    drawings: Mapping[tuple[str, str], Drawings],
    provenance: Mapping[str, Any],
    verdict: Verdict,
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        metrics: as in ``results.json``.
        records: world and planner to the records of their trials.
        drawings: world and planner to what was drawn of their first trial.
        provenance: as in ``results.json``.
        verdict: that the page begins with.

    Raises:
        OutputError: it cannot be written.
    """
    settings = provenance["settings"]
    commanded = [planner for planner in settings["planners"] if planner in ("blind", "velocity")]
    controller = settings["black_box"] or "built-in trot"
    walked = f"; {' and '.join(commanded)} by the {controller}" if commanded else ""
    on_regions = any(planner.startswith("quadpips") for planner in settings["planners"])
    facts = [
        ("robot", f"{provenance['robot']}{walked}"),
        ("map", "from the robot's depth camera" if settings["map"] == "camera" else "the true heights"),
        *([("regions", "of perception" if settings["regions"] == "camera" else "the true ones")] if on_regions else []),
        ("trials", f"{settings['trials']} of each row, start and heading drawn at random"),
        *origin(provenance, hashed="bundle"),
    ]
    sections = [verdict.section(), *comparison_sections(records, metrics)]
    for world in dict.fromkeys(name for name, _ in records):
        planners = [planner for name, planner in records if name == world]
        sections.append(
            {
                "title": world,
                "text": "Wilson 95 % intervals behind shares, bootstrap over trials behind means. Clean: the goal was "
                "reached without a misstep, a foot that stands in a gap, on an edge or beside the world. "
                f"{_who(planners, settings)} All begin from the same starts. Time to the goal and cost of transport "
                "are those of walks that reached it; cost of transport is the sum of |torque · joint velocity| · dt "
                "over weight times the trunk's way. Link contacts and foot hits are counts of a trial, "
                "without ankles that touch the ground on which their foot stands."
                + (_MODELS if f"{world}.{planners[-1]}.fdm_mae" in metrics else ""),
                "table": _table(world, planners, metrics),
            }
        )
        lost = _losses(world, records)
        if lost["rows"]:
            sections.append({"title": f"{world}: how trials were lost", "table": lost})
        sections += progress_section(world, records)
        for planner in planners:
            drawn = drawings.get((world, planner), Drawings())
            film = base64.b64encode(drawn.film).decode()
            title = f"{world}, {planner}, first trial"
            for what, figure in (
                ("from above", drawn.above),
                ("filmstrip", drawn.strip),
                ("film", f'<img alt="film of the walk" src="data:image/webp;base64,{film}">' if film else ""),
            ):
                if figure:
                    sections.append({"title": f"{title}: {what}", "figure": figure})
    write_page(path, "Planners in closed loop", facts, sections + climb_sections(records))


def _table(world: str, planners: Sequence[str], metrics: Mapping[str, Metric]) -> dict[str, Any]:
    rows = []
    for planner in planners:
        cells = [
            metric_cell(metrics.get(f"{world}.{planner}.{key}"), factor, digits) for key, _, factor, digits in _COLUMNS
        ]
        rows.append({"name": planner, "cells": cells})
    # Columns that no planner of this world fills are left out.
    filled = [
        k for k, (key, *_) in enumerate(_COLUMNS) if any(f"{world}.{planner}.{key}" in metrics for planner in planners)
    ]
    rows = [{**row, "cells": [row["cells"][k] for k in filled]} for row in rows]
    return {"head": ["", *(_COLUMNS[k][1] for k in filled)], "rows": rows}


def _lost_by(record: Mapping[str, Any]) -> str:
    """The outcome of a trial, and of one that came to a halt what its planner said at the end."""
    outcome, said = str(record["outcome"]), str((record.get("stages") or {}).get("reason", ""))
    return f"{outcome} ({said})" if said and outcome in HALTED else outcome


def _who(planners: Sequence[str], settings: Mapping[str, Any]) -> str:
    """What the planners of some rows do."""
    does = {"blind": f"walks ahead at {settings['blind_speed']} m/s, or as the world says", **_DOES}
    told = [f"{row} {does[row]}" for row in planners if row in does]
    if steps := [row for row in planners if row[:1] == "h" and row[1:].isdigit()]:
        told.append(f"{', '.join(steps)} plan velocity commands that many steps ahead")
    return f"Planners: {'; '.join(told)}."


def _losses(world: str, records: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    rows = []
    for (name, planner), found in records.items():
        reasons = Counter(_lost_by(record) for record in found if not record["success"])
        if name == world and reasons:
            text = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common())
            rows.append({"name": planner, "cells": [cell(text)]})
    return {"head": ["", "reasons"], "rows": rows}
