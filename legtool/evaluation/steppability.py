"""Measure the segmenter on scenes that it never saw, and show where it errs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import torch

from legtool.configs.steppability import SteppabilityEvalSettings
from legtool.datasets.steppability.images import load_scene_images
from legtool.datasets.steppability.scenes import SPLITS, check_scenes
from legtool.datasets.store import data_hash
from legtool.datasets.work import RESULTS, claim
from legtool.errors import DatasetError
from legtool.evaluation.judges import judge_steppability
from legtool.evaluation.report.results import Metric, keep_with_run, provenance, write_results
from legtool.evaluation.segmentation_scores import measure, steppability_metrics
from legtool.evaluation.steppability_report import write_steppability_report
from legtool.models.steppability import CLASSES
from legtool.models.steppability_run import load_steppability_run


def eval_steppability(
    run_path: Path, settings: SteppabilityEvalSettings, out: Path, *, data: Path | None = None, workers: int = 1
) -> Iterator[str]:
    """Measure a run and write ``results.json`` and ``report.html``.

    Args:
        run_path: of ``train steppability``.
        settings: of intervals and report.
        out: directory for both files.
        data: another dataset of scenes, all of it measured; otherwise the test scenes of the run's own data.
        workers: threads.

    Yields:
        the main figures, line by line.

    Raises:
        DatasetError: no run, no dataset, or one that was altered since training.
        OutputError: ``out`` holds something else.
    """
    torch.set_num_threads(workers)
    run = load_steppability_run(run_path)
    path = data or Path(run.description["data"]["path"])
    manifest = check_scenes(path)
    own = data_hash(manifest) == run.description["data_hash"]
    if data is None and not own:
        raise DatasetError(f"{path}: is not the data that {run_path} was trained on; name it with --data")
    images = load_scene_images(path, ["test"] if own else SPLITS, steps=run.description["preparation"])
    if images.depth.shape[1:] != (run.camera.height, run.camera.width):
        raise DatasetError(f"{path}: its images are of another camera than those that {run_path} was trained on")
    with claim(out, RESULTS):
        measured = measure(run.net, images, settings)
        metrics = steppability_metrics(measured, settings)
        facts = provenance(
            settings.to_dict(), seed=settings.seed, data_hash=data_hash(manifest), run=str(run_path), data=[str(path)],
            trained_on=run.description["data_hash"], robot=run.robot.name,
            split="test scenes" if own else "all scenes of another dataset",
        )  # fmt: skip
        verdict = judge_steppability(metrics)
        write_results(out / RESULTS.marker, metrics, facts, verdict=verdict.to_dict())
        write_steppability_report(out / "report.html", metrics, measured, run, facts, settings, verdict)
    yield from keep_with_run(out / RESULTS.marker, run_path, "steppability")
    yield from summary(metrics)
    yield from verdict.lines()


def summary(metrics: dict[str, Metric]) -> Iterator[str]:
    """The main figures, for a terminal."""
    for name in ("miou", *(f"iou.{label}" for label in CLASSES), "boundary.miou", "interior.miou"):
        if entry := metrics.get(f"steppability.{name}"):
            interval = "" if entry["ci95"] is None else "  ({:.3f} to {:.3f})".format(*entry["ci95"])
            yield f"{name:20} {entry['value']:.3f}{interval}"
