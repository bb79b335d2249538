"""What the trials of one world and planner come down to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.evaluation.report.intervals import mean, share
from legtool.evaluation.report.results import Metric, metric
from legtool_runtime.motion.features import TARGETS

Array = NDArray[np.float64]

#: Outcomes of a robot that came to a halt.
HALTED = ("stalled", "timeout")
#: What a trial of a planner in stages may be lost by.
CAUSES = ("perception", "search", "optimisation", "tracking", "error")


def summarise(records: Sequence[dict[str, Any]], deadline_s: float) -> dict[str, Metric]:
    """Metrics: Wilson intervals for shares, bootstrap over trials for means.

    Args:
        records: of the trials.
        deadline_s: plans that took longer are late.
    """
    n = len(records)
    out = {key: share(sum(record[key] for record in records), n) for key in ("success", "clean")}
    if all("edges" in record for record in records):
        clear = sum(record["clean"] and not record["edges"] for record in records)
        out["clear_of_edges"] = share(clear, n)
    out["duration_s"] = mean([record["duration_s"] for record in records], "s")
    reached = [record["duration_s"] for record in records if record["success"]]
    if reached:
        out["time_to_goal_s"] = mean(reached, "s")
    costs = [record["cost_of_transport"] for record in records if record["success"] and record.get("cost_of_transport")]
    if costs:
        out["cost_of_transport"] = mean(costs, "1")
    out["real_time_factor"] = mean([record["real_time_factor"] for record in records], "1")
    out.update(_tracked(records))
    for key in ("link_contacts", "ankle_contacts"):
        out[key] = mean([len(record.get(key, ())) for record in records], "1")
    out.update(_posed(records))
    out.update(_staged(records))
    for model in TARGETS:
        # A trial's mean is one sample: steps of one walk are not independent.
        means = [float(np.mean(record["errors"][model])) for record in records if record["errors"].get(model)]
        if means:
            out[f"{model}_mae"] = mean(means, "m/s" if model == "cvm" else "m")
    times = np.concatenate([record["planning_times_s"] for record in records])
    if len(times):
        for key, quantile in (("median", 0.5), ("p95", 0.95), ("p99", 0.99), ("worst", 1.0)):
            out[f"planning_time_{key}_s"] = metric(float(np.quantile(times, quantile)), None, len(times), "s")
        out["planning_late"] = share(int((times > deadline_s).sum()), len(times))
        if any(record["cumulative_cost"] for record in records):
            out["cumulative_cost"] = mean([record["cumulative_cost"] for record in records], "m")
    return out


def _tracked(records: Sequence[dict[str, Any]]) -> dict[str, Metric]:
    """How near to their planned places feet landed, all landings of all trials, and how often torques saturated."""
    walked = [record for record in records if record.get("landings")]
    if not walked:
        return {}
    errors = np.concatenate([[error for _, _, error in record["landings"]] for record in walked])
    # A trial's mean is one sample for the interval: landings of one walk are not independent.
    means = [float(np.mean([error for _, _, error in record["landings"]])) for record in walked]
    average = mean(means, "m")
    average["value"], average["n"] = float(errors.mean()), len(errors)
    out = {"landing_error_mean_m": average}
    for key, quantile in (("p95", 0.95), ("worst", 1.0)):
        out[f"landing_error_{key}_m"] = metric(float(np.quantile(errors, quantile)), None, len(errors), "m")
    shares = [record["saturated"][0] / max(record["saturated"][1], 1) for record in walked]
    out["torque_saturation"] = mean(shares, "1")
    return out


def _posed(records: Sequence[dict[str, Any]]) -> dict[str, Metric]:
    """How well planned poses were held while the ground was uneven, and what they left the feet to choose from.

    Errors are against the planner's pose, and against that as filtered for the body (``_filtered``).
    """
    walked = [record for record in records if record.get("postures")]
    if not walked:
        return {}
    out = {"foot_hits": mean([len(record["foot_hits"]) for record in records], "1")}
    held = [errors for record in walked if len(errors := pose_errors(record["postures"]))]
    for k, (name, unit) in enumerate((("height_error_m", "m"), ("pitch_error_rad", "rad"))):
        for way, suffix in enumerate(("", "_filtered")):
            if held:
                out[f"{name}{suffix}"] = mean([float(errors[:, way, k].mean()) for errors in held], unit)
    out["min_safe"] = mean([float(min(row[5] for row in record["postures"])) for record in walked], "1")
    blind, steps = (sum(record["blind_steps"][k] for record in walked) for k in (0, 1))
    out["blind_steps"] = share(blind, steps)
    return out


def _staged(records: Sequence[dict[str, Any]]) -> dict[str, Metric]:
    """How far walks came; of planners in stages their times and counts, and which stage trials were lost by."""
    out: dict[str, Metric] = {}
    ways = [record["progress"] for record in records if record.get("progress")]
    if ways:
        out["progress"] = mean([way[-1][1] for way in ways], "1")
    walked = [record["stages"] for record in records if record.get("stages")]
    if not walked:
        return out
    for what in dict.fromkeys(key for stages in walked for key in stages["counts"]):
        out[what] = mean([float(stages["counts"].get(what, 0)) for stages in walked], "1")
    for stage in dict.fromkeys(key for stages in walked for key in stages["times_s"]):
        times = np.concatenate([stages["times_s"].get(stage, []) for stages in walked])
        for key, quantile in (("median", 0.5), ("p99", 0.99)):
            if len(times):
                out[f"{stage}_{key}_s"] = metric(float(np.quantile(times, quantile)), None, len(times), "s")
    causes = [cause_of(record) for record in records]
    for cause in CAUSES:
        out[f"failed_{cause}"] = share(causes.count(cause), len(causes))
    return out


def cause_of(record: Mapping[str, Any]) -> str:
    """Which of :data:`CAUSES` a trial was lost by; empty for one that succeeded.

    One that came to a halt was lost by the stage that had no answer at the end. Else the first of the monitor's events
    shortly before the end tells; without one, a robot that fell or whose controller stopped was lost by tracking.
    """
    if record["success"]:
        return ""
    outcome = str(record["outcome"])
    stages = record.get("stages") or {}
    blocked, told = str(stages.get("blocked_by", "")), str(stages.get("cause", ""))
    halted = outcome in HALTED
    if halted and blocked in CAUSES:
        return blocked
    if told in CAUSES and not outcome.startswith("error"):
        return told
    return "error" if outcome.startswith("error") else "tracking"


def pose_errors(postures: Sequence[Sequence[Any]]) -> Array:
    """(n, 2, 2) absolute errors of a walk's moments on uneven ground: against the planned and against the filtered
    pose, of height [m] and pitch [rad]."""
    climbing = [row for row in postures if row[6]]
    rows = [
        [[abs(place[2] - pose[0]), abs(attitude[1] - pose[2])] for pose in (planned, filtered)]
        for _, place, attitude, planned, filtered, _, _ in climbing
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 2, 2)


def describe_row(world: str, row: str, records: Sequence[dict[str, Any]]) -> str:
    """One line for a terminal."""
    n = len(records)
    reached, clean = (sum(record[key] for record in records) for key in ("success", "clean"))
    text = f"{world} {row}: success {reached}/{n}, clean {clean}/{n}"
    times = np.concatenate([record["planning_times_s"] for record in records])
    if len(times):
        median, p99 = np.quantile(times, [0.5, 0.99]) * 1e3
        text += f", planning median {median:.2f} ms, p99 {p99:.2f} ms"
    if (staged := _staged(records)) and "progress" in staged:
        text += f", progress {100 * staged['progress']['value']:.0f} %"
    if tracked := _tracked(records):
        middle, p95, worst = (1e3 * tracked[f"landing_error_{key}_m"]["value"] for key in ("mean", "p95", "worst"))
        text += f", landing error mean {middle:.1f} mm, p95 {p95:.1f} mm, worst {worst:.1f} mm"
        text += f", torques saturated {100 * tracked['torque_saturation']['value']:.2f} %"
    if posed := _posed(records):
        links = np.mean([len(record["link_contacts"]) for record in records])
        text += f", link contacts {links:.1f}, at least {posed['min_safe']['value']:.0f} safe footholds"
        if "height_error_m" in posed:
            height, pitch = (posed[key]["value"] for key in ("height_error_m", "pitch_error_rad"))
            text += f", pose held within {100 * height:.1f} cm, {np.degrees(pitch):.1f}°"
    return text
