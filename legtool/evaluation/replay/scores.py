"""The figures of a replay, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from legtool.evaluation.replay.predictions import Ahead, OneStep
from legtool.evaluation.report.intervals import BlockBootstrap, share
from legtool.evaluation.report.results import Metric, metric
from legtool.models.motion import Z90
from legtool.sim.walks.replayed import Answers, Touchdown
from legtool_runtime.motion.features import TARGETS

Array = NDArray[np.float64]

#: Steps of one block of the bootstrap, at most.
_BLOCK = 20
_SAMPLES = 2000


@dataclass(eq=False)
class Replayed:
    """What came of a replay.

    Attributes:
        duration_s: of the log [s].
        elapsed_s: that the runtime took for it, of real time [s].
        one: predictions of single steps; None without a motion line, or without usable steps.
        ahead: predictions of several steps.
        answers: plans; None where there was nothing to plan on.
        touchdowns: of feet on the map.
        planning_s: times of plans [s].
        map_s: of maps, one for each image [s].
        perception_s: of frames of perception, and ``labels_s`` of their labels [s].
        images: that were seen.
        missed: images that no row of the log came soon after.
        regions: found in each frame.
        counts: of steps, by the names of ``collect log``.
        notes: what is doubtful about the log.
    """

    duration_s: float
    elapsed_s: float
    one: OneStep | None = None
    ahead: Ahead | None = None
    answers: Answers | None = None
    touchdowns: Sequence[Touchdown] = ()
    planning_s: Sequence[float] = ()
    map_s: Sequence[float] = ()
    perception_s: Sequence[float] = ()
    labels_s: Sequence[float] = ()
    images: int = 0
    missed: int = 0
    regions: Sequence[int] = ()
    counts: dict[str, float] = field(default_factory=dict)
    notes: Sequence[str] = ()


def measure(replayed: Replayed, deadline_s: float) -> dict[str, Metric]:
    """All metrics of a replay, named from the general to the particular."""
    out = {
        "duration": metric(replayed.duration_s, None, 1, "s"),
        "speed": metric(replayed.duration_s / max(replayed.elapsed_s, 1e-9), None, 1, "1"),
    }
    if replayed.one is not None:
        out |= _one_step(replayed.one)
    if replayed.ahead is not None and len(replayed.ahead.start):
        out |= _ahead(replayed.ahead)
    if replayed.answers is not None:
        answers = replayed.answers
        count = sum(answers.plans.values())
        whole = answers.plans.get("goal", 0) + answers.plans.get("horizon", 0)
        out["plans.whole"] = share(whole, count)
        out["plans.steps_planned"] = share(answers.planned, answers.steps)
        out["plans.late"] = share(int((np.asarray(replayed.planning_s) > deadline_s).sum()), len(replayed.planning_s))
        out["plans.as_commanded"] = metric(answers.same / max(answers.ticks, 1), None, answers.ticks, "1")
        said = [touchdown.said for touchdown in replayed.touchdowns]
        seen = len(said) - said.count("unknown")
        out["touchdowns.unsafe"] = share(said.count("unsafe"), seen)
        out["touchdowns.unknown"] = share(said.count("unknown"), len(said))
    for name, times in (
        ("plans", replayed.planning_s), ("map", replayed.map_s), ("perception", replayed.perception_s),
        ("labels.age", replayed.labels_s),
    ):  # fmt: skip
        if len(times):
            out[f"{name}.median_s"] = metric(float(np.median(times)), None, len(times), "s")
            out[f"{name}.p99_s"] = metric(float(np.quantile(times, 0.99)), None, len(times), "s")
    if replayed.images:
        out["images"] = metric(replayed.images, None, 1, "1")
        out["images.missed"] = metric(replayed.missed, None, 1, "1")
    if len(replayed.regions):
        out["regions"] = metric(float(np.mean(replayed.regions)), None, len(replayed.regions), "1")
    return out


def _one_step(one: OneStep) -> dict[str, Metric]:
    out: dict[str, Metric] = {}
    count = len(one.steps)
    if not count:
        return out
    block, bootstrap = blocks(count)
    for name, targets in TARGETS.items():
        planar = [index for index, target in enumerate(targets) if target.split("_")[-1] in ("x", "y")]
        unit = "m/s" if name == "cvm" else "m"
        value, ci95 = bootstrap.mean(np.abs(one.error[name][:, planar]), block)
        out[f"{name}.mae"] = metric(value, ci95, count, unit)
        held, ci95 = bootstrap.mean(one.inside[name][:, planar].astype(float), block)
        out[f"{name}.coverage90"] = metric(held, ci95, count, "1")
    return out


def _ahead(ahead: Ahead) -> dict[str, Metric]:
    out: dict[str, Metric] = {}
    count = len(ahead.start)
    block, bootstrap = blocks(count)
    for k in range(ahead.com.shape[1]):
        feet = np.abs(ahead.feet[:, k])
        value, ci95 = bootstrap.mean(feet, block)
        out[f"ahead.{k + 1}.touchdown.mae"] = metric(value, ci95, count, "m")
        inside = feet <= Z90 * ahead.spread[k][None, :, None]
        value, ci95 = bootstrap.mean(inside.astype(float), block)
        out[f"ahead.{k + 1}.touchdown.coverage90"] = metric(value, ci95, count, "1")
        value, ci95 = bootstrap.mean(np.abs(ahead.com[:, k]), block)
        out[f"ahead.{k + 1}.com.mae"] = metric(value, ci95, count, "m")
    return out


def blocks(count: int) -> tuple[NDArray[np.intp], BlockBootstrap]:
    """The block of each of ``count`` steps in a row, and a bootstrap over blocks."""
    block = np.arange(count) // max(1, min(_BLOCK, count // 8))
    return block, BlockBootstrap(int(block.max()) + 1, samples=_SAMPLES, seed=0)
