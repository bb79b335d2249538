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


def describe_row(world: str, row: str, records: Sequence[dict[str, Any]]) -> str:
    """One line for a terminal."""
    n = len(records)
    reached, clean = (sum(record[key] for record in records) for key in ("success", "clean"))
    text = f"{world} {row}: success {reached}/{n}, clean {clean}/{n}"
    times = np.concatenate([record["planning_times_s"] for record in records])
    if len(times):
        median, p99 = np.quantile(times, [0.5, 0.99]) * 1e3
        text += f", planning median {median:.2f} ms, p99 {p99:.2f} ms"
    return text
