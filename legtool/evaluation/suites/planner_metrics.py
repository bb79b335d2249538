"""What the trials of one world and planner come down to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from legtool.evaluation.report.intervals import mean, share
from legtool.evaluation.report.results import Metric, metric
from legtool_runtime.motion.features import TARGETS


def summarise(records: Sequence[dict[str, Any]], deadline_s: float) -> dict[str, Metric]:
    """Metrics: Wilson intervals for shares, bootstrap over trials for means.

    Args:
        records: of the trials.
        deadline_s: plans that took longer are late.
    """
    n = len(records)
    out = {key: share(sum(record[key] for record in records), n) for key in ("success", "clean")}
    out["duration_s"] = mean([record["duration_s"] for record in records], "s")
    out["real_time_factor"] = mean([record["real_time_factor"] for record in records], "1")
    out.update(_tracked(records))
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


def describe_row(world: str, row: str, records: Sequence[dict[str, Any]]) -> str:
    """One line for a terminal."""
    n = len(records)
    reached, clean = (sum(record[key] for record in records) for key in ("success", "clean"))
    text = f"{world} {row}: success {reached}/{n}, clean {clean}/{n}"
    times = np.concatenate([record["planning_times_s"] for record in records])
    if len(times):
        median, p99 = np.quantile(times, [0.5, 0.99]) * 1e3
        text += f", planning median {median:.2f} ms, p99 {p99:.2f} ms"
    if tracked := _tracked(records):
        middle, p95, worst = (1e3 * tracked[f"landing_error_{key}_m"]["value"] for key in ("mean", "p95", "worst"))
        text += f", landing error mean {middle:.1f} mm, p95 {p95:.1f} mm, worst {worst:.1f} mm"
        text += f", torques saturated {100 * tracked['torque_saturation']['value']:.2f} %"
    return text
