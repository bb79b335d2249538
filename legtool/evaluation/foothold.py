"""Measure foothold networks on terrain that they never saw: the paper's measures, and what trusting them costs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from legtool.configs.footholds import TERRAINS, FootholdEvalSettings, FootholdSettings
from legtool.datasets.foothold.heightmaps import FootholdData, load_footholds
from legtool.datasets.store import data_hash
from legtool.datasets.work import RESULTS, claim
from legtool.errors import DatasetError
from legtool.evaluation.foothold_report import write_foothold_report
from legtool.evaluation.judges import judge_foothold
from legtool.evaluation.report.intervals import BlockBootstrap
from legtool.evaluation.report.results import Metric, keep_with_run, metric, provenance, write_results
from legtool.models.foothold import CELLS, Dense, basis_matrix
from legtool.models.foothold_run import FootholdRun, load_foothold_run
from legtool.progress import progress
from legtool.sim.worlds.foothold_samples import foothold_samples
from legtool_runtime.foothold.features import encode, unmirror
from legtool_runtime.foothold.gait import hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.networks import SAFE_FROM
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, hip_heights
from legtool_runtime.robot import LEGS

Array = NDArray[np.float64]
#: What a foothold counts as off [m] where network or criteria see none and the other does: half a map.
_MISSED_M = 0.5 * SIZE * RESOLUTION_M
#: From this roll or pitch on a trunk is steep [rad].
STEEP = 0.2


def eval_foothold(
    task: str, run_path: Path, data: Path | None, settings: FootholdEvalSettings, out: Path, *, workers: int = 1
) -> Iterator[str]:
    """Measure a run on terrain that it never saw and write ``results.json`` and ``report.html``.

    Args:
        task: ``vfa`` or ``vpa``; a dense network is measured at both.
        run_path: of ``train vfa`` or ``train vpa``.
        data: dataset of ``collect footholds`` with another seed than the training's; None: fresh terrain is drawn.
        settings: of fresh terrain and of intervals.
        out: directory for both files.
        workers: threads.

    Yields:
        the main figures, line by line.

    Raises:
        DatasetError: no run or dataset, of another task or robot, or the data that the run was trained on.
        OutputError: ``out`` holds something else.
    """
    torch.set_num_threads(workers)
    run = load_foothold_run(run_path)
    tasks = ("vfa", "vpa") if isinstance(run.net, Dense) else (run.task,)
    if task not in tasks:
        raise DatasetError(f"{run_path}: a run of train {run.task}; measure it with legtool eval {run.task}")
    samples, hashed, kinds = _fresh(run, tasks, settings) if data is None else _given(run, data)
    metrics: dict[str, Metric] = {}
    with claim(out, RESULTS):
        for measured in (run, run.untrained()):
            if "vfa" in tasks:
                metrics |= vfa_metrics(measured, samples.take(samples.vpa == 0), settings, kinds)
            if "vpa" in tasks:
                metrics |= vpa_metrics(measured, samples.take(samples.vpa == 1), settings)
        facts = provenance(
            settings.to_dict(),
            seed=settings.seed,
            data_hash=hashed,
            run=str(run_path),
            trained_on=run.description["data_hash"],
            data=["fresh terrain"] if data is None else [str(data)],
        )
        verdict = judge_foothold(metrics, run.network)
        write_results(out / RESULTS.marker, metrics, facts, verdict=verdict.to_dict())
        write_foothold_report(out / "report.html", metrics, run, facts, verdict)
    yield from keep_with_run(out / RESULTS.marker, run_path, task)
    for name, entry in metrics.items():
        if name.count(".") == 2:
            interval = "" if entry["ci95"] is None else " [{:.4f}, {:.4f}]".format(*entry["ci95"])
            yield f"{name}: {entry['value']:.4f}{interval} ({entry['n']} samples)"
    yield from verdict.lines()


def _given(run: FootholdRun, path: Path) -> tuple[FootholdData, str, Sequence[str]]:
    """A dataset that the run was not trained on, its hash, and its kinds of terrain."""
    samples, manifest = load_footholds([path])
    hashed = data_hash(manifest)
    if hashed == run.description["data_hash"]:
        raise DatasetError(
            f"{path}: is the data that {run.path} was trained on; collect fresh terrain with another seed"
        )
    if manifest["robot"] != run.robot.to_dict() or manifest["criteria"] != run.description["criteria"]:
        raise DatasetError(f"{path}: made for another robot or with other criteria than {run.path}")
    return samples, hashed, manifest["settings"]["terrains"]


def _fresh(
    run: FootholdRun, tasks: Sequence[str], settings: FootholdEvalSettings
) -> tuple[FootholdData, str, Sequence[str]]:
    """Samples of fresh terrain for some tasks, their hash, and their kinds of terrain."""
    wanted = {"vfa": settings.vfa_samples, "vpa": settings.vpa_samples}
    jobs = [(task, index) for task in tasks for index in range(-(-wanted[task] // 1000))]
    parts = []
    with progress("labelling", len(jobs), "thousands") as advance:
        for task, index in jobs:
            drawn = FootholdSettings(seed=settings.seed, vpa_share=float(task == "vpa"), tilt=settings.tilt)
            parts.append(foothold_samples(drawn, index, run.criteria))
            advance(1)
    samples = FootholdData(
        **{field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(FootholdData)}
    )
    digest = hashlib.sha256()
    for field in fields(FootholdData):
        digest.update(np.ascontiguousarray(getattr(samples, field.name)).tobytes())
    return samples, digest.hexdigest(), TERRAINS


def vfa_metrics(
    run: FootholdRun, data: FootholdData, settings: FootholdEvalSettings, kinds: Sequence[str] = TERRAINS
) -> dict[str, Metric]:
    """The paper's three measures (appendix G): over all samples, where the nominal is unsafe, where the trunk is tilted
    by more than ``STEEP``, by leg and by terrain.

    ``perfect``: the exact answer, none where none is safe; ``safe``: that, or another safe cell; ``mean_distance_m``:
    to the exact foothold, over all samples, half a map where only one of both sees a foothold.
    """
    got = proposals(run, data)
    exact = data.optimal.astype(np.int64)
    perfect = got == exact
    flat = (data.reasons == 0).reshape(len(data), -1)
    safe = perfect | ((got >= 0) & flat[np.arange(len(data)), np.maximum(got, 0)])
    here, there = (np.stack(np.divmod(np.maximum(cells, 0), SIZE), axis=1) for cells in (got, exact))
    distance = np.linalg.norm((here - there) * RESOLUTION_M, axis=1)
    distance = np.where((got >= 0) & (exact >= 0), distance, np.where((got < 0) & (exact < 0), 0.0, _MISSED_M))
    values = {"perfect": perfect.astype(float), "safe": safe.astype(float), "mean_distance_m": distance}
    unsafe = data.reasons[:, SIZE // 2, SIZE // 2] != 0
    steep = np.maximum(np.abs(data.roll), np.abs(data.pitch)) > STEEP
    groups = {"": np.ones(len(data), bool), "nominal_unsafe.": unsafe, "steep.": steep}
    groups |= {f"leg.{name}.": data.leg == leg for leg, name in enumerate(LEGS)}
    groups |= {f"terrain.{name}.": data.terrain_kind == k for k, name in enumerate(kinds)}
    out = {}
    for group, rows in groups.items():
        if not rows.any():
            continue
        bootstrap, block = _over_terrains(data.terrain[rows], settings)
        for name, value in values.items():
            unit = "m" if name.endswith("_m") else "1"
            key = f"vfa.{run.network}.{group}{name}"
            out[key] = metric(*bootstrap.mean(value[rows], block), int(rows.sum()), unit)
    return out


def vpa_metrics(run: FootholdRun, data: FootholdData, settings: FootholdEvalSettings) -> dict[str, Metric]:
    """The paper's ratio of means, and per sample: median relative error, and regret.

    A sample's error is the mean absolute error of its counts over their mean; its regret the share of safe footholds
    lost by the hip height that the predicted counts favour, instead of the one that the exact counts do.
    """
    predicted, exact = predicted_counts(run, data), data.counts.astype(float)
    some = exact.max(axis=1) > 0
    error = np.abs(predicted - exact).mean(axis=1)[some] / exact.mean(axis=1)[some]
    best = exact.max(axis=1)
    chosen = exact[np.arange(len(exact)), predicted.argmax(axis=1)]
    regret = (best - chosen)[some] / best[some]
    name, n = f"vpa.{run.network}", int(some.sum())
    bootstrap, block = _over_terrains(data.terrain[some], settings)
    return {
        f"{name}.ratio": metric(predicted.mean() / exact.mean(), None, len(data), "1"),
        f"{name}.median_error": metric(*bootstrap.statistic(error, block, np.median), n, "1"),
        f"{name}.regret": metric(*bootstrap.mean(regret, block), n, "1"),
    }


def _over_terrains(
    terrain: NDArray[np.int32], settings: FootholdEvalSettings
) -> tuple[BlockBootstrap, NDArray[np.intp]]:
    """Resamples of whole terrains, whose samples are alike, and the number of each sample's."""
    numbers, block = np.unique(terrain, return_inverse=True)
    return BlockBootstrap(len(numbers), samples=settings.bootstrap, seed=settings.seed), block


@torch.no_grad()
def proposals(run: FootholdRun, data: FootholdData, *, batch: int = 256) -> NDArray[np.int64]:
    """(n,) cell ix · 33 + iy that the network proposes for each sample, -1 for none."""
    found = []
    for first in range(0, len(data), batch):
        part = data.take(slice(first, first + batch))
        out = run.net(*_inputs(run, part)).numpy()
        if not isinstance(run.net, Dense):
            best = out.argmax(axis=1)
            found.append(unmirror(np.where(best == CELLS, -1, best), part.leg))
            continue
        for n, probability in enumerate(out):
            likely = probability[:, ::-1] if part.leg[n] % 2 == 1 else probability
            likely = (likely >= SAFE_FROM) & ~np.isnan(part.heights[n])
            tilt = {"roll": float(part.roll[n]), "pitch": float(part.pitch[n])}
            velocity = hip_velocity(run.robot, int(part.leg[n]), part.base_twist[n].tolist(), **tilt)
            cell = nearest_safe(likely, velocity)
            found.append(np.array([-1 if cell is None else cell[0] * SIZE + cell[1]]))
    return np.concatenate(found)


@torch.no_grad()
def predicted_counts(run: FootholdRun, data: FootholdData, *, batch: int = 256) -> Array:
    """(n, 31) counts that the network predicts over the set of hip heights."""
    hips = hip_heights(run.robot)
    found = []
    for first in range(0, len(data), batch):
        inputs = _inputs(run, data.take(slice(first, first + batch)))
        if isinstance(run.net, Dense):
            z = torch.tensor(hips, dtype=torch.float32)[None]
            found.append(run.net.counts(run.net.bounds(*inputs), z).numpy())
        else:
            found.append((run.net(*inputs) @ basis_matrix(hips).T).numpy())
    return np.clip(np.concatenate(found), 0, CELLS).astype(np.float64)


def _inputs(run: FootholdRun, data: FootholdData) -> list[torch.Tensor]:
    """What the run's network takes, in order."""
    return [torch.from_numpy(values) for values in encode(run.criteria, run.kind, data.tuples()).fed().values()]
