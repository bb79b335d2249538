"""Perception on rendered walks with ground truth: what regions are worth, against planes cut from an elevation map."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from legtool.configs.perception import PerceptionEvalSettings
from legtool.configs.robots import RobotSettings, load_robot
from legtool.datasets.contents import bundle_content
from legtool.datasets.files import write_text
from legtool.datasets.work import RESULTS
from legtool.errors import RobotError
from legtool.evaluation.judges import judge_perception
from legtool.evaluation.report.intervals import BlockBootstrap
from legtool.evaluation.report.results import Metric, metric, provenance, write_results
from legtool.evaluation.suites.perception_report import draw_walk, write_perception_report
from legtool.evaluation.suites.perception_walk import DEPTHS, METHODS, score_walk, tallies_to_dict
from legtool.evaluation.suites.trials import TrialKey, Trials, trial_key
from legtool.workers import Workers
from legtool_runtime import Bundle, load_bundle

#: Walks that the report draws.
DRAWN = 6
#: What is made of the sums of a tally: numerator, denominator, unit.
_RATIOS: dict[str, tuple[str, str, str]] = {
    "region_purity": ("planar.pure", "planar.regions", "1"),
    "area_purity": ("planar.pure_area", "planar.area", "1"),
    "overhang": ("planar.over", "planar.area", "1"),
    "overhang_untrimmed": ("untrimmed.over", "untrimmed.area", "1"),
    "coverage": ("near.covered", "near.goal", "1"),
    "coverage_any_range": ("any.covered", "any.goal", "1"),
    "height_error": ("planar.height", "planar.on_main", "m"),
    "normal_error": ("planar.normal", "planar.turned", "rad"),
    "region_area": ("planar.area", "planar.regions", "m^2"),
    "uneven.region_purity": ("uneven.pure", "uneven.regions", "1"),
    "uneven.height_error": ("uneven.height", "uneven.on_main", "m"),
    "uneven.normal_error": ("uneven.normal", "uneven.turned", "rad"),
    "assumed.region_purity": ("assumed.pure", "assumed.regions", "1"),
}
_JITTER = {"jitter": ("moved", "matched", "m"), "overlap": ("shared", "matched", "1")}


def eval_perception(
    bundle_path: Path | None, settings: PerceptionEvalSettings, out: Path, *, workers: int | Workers = 1
) -> Iterator[str]:
    """Render walks and score perception on each; write ``results.json`` and ``report.html``.

    Walks that are finished in ``out``, of the same robot, bundle and scenes, are kept.

    Args:
        bundle_path: whose segmenter labels the images; None: they get their true labels.
        settings: of scenes, walks and scores.
        out: directory of the results.
        workers: processes; the results do not depend on it.

    Yields:
        the main figures, line by line.

    Raises:
        BundleError: the bundle is damaged, or has no steppability line.
        RobotError: it was made for another robot or camera, or there is no such robot.
        OutputError: ``out`` holds something else.
    """
    robot, bundle = _robot(bundle_path, settings)
    keys = [_key(settings, robot, bundle, number) for number in range(settings.sequences)]
    with Trials(out, "perception", workers=workers) as trials:
        trials.run(keys, functools.partial(run_walk, trials, bundle_path, settings))
        records = [trials.read(key) for key in keys]
        metrics = perception_metrics([record["tallies"] for record in records], settings)
        facts = provenance(
            settings.to_dict(), seed=settings.seed, robot=robot.name,
            data_hash="true labels" if bundle is None else str(bundle.manifest["content_sha256"]),
            labels="true" if bundle_path is None else f"from the segmenter of {bundle_path.name}",
        )  # fmt: skip
        verdict = judge_perception(metrics)
        write_results(out / RESULTS.marker, metrics, facts, verdict=verdict.to_dict())
        drawings = [
            (f"walk {key.number}, {record['placement']}", path.read_text(encoding="utf-8"))
            for key, record in zip(keys, records, strict=True)
            if (path := _drawing(trials, key)).is_file()
        ]
        write_perception_report(out / "report.html", metrics, facts, drawings, verdict)
    yield from summary(metrics)
    yield from verdict.lines()


def run_walk(trials: Trials, bundle_path: Path | None, settings: PerceptionEvalSettings, key: TrialKey) -> None:
    """Score one walk and write its record, and of the first ones a drawing."""
    robot, bundle = _robot(bundle_path, settings)
    walk = score_walk(settings, robot, key.number, segmenter=None if bundle is None else bundle.steppability)
    if key.number < DRAWN:
        write_text(_drawing(trials, key), draw_walk(walk))
    trials.write(key, {"placement": walk.placement, "tallies": tallies_to_dict(walk.tallies)})


def perception_metrics(walks: Sequence[Mapping[str, Any]], settings: PerceptionEvalSettings) -> dict[str, Metric]:
    """All metrics with 95 % intervals from a bootstrap over walks.

    Plain names are on exact depth with a warm start; ``noisy`` and ``baseline`` stand before the name where they apply.

    Args:
        walks: tallies of each walk, as :func:`perception_walk.tallies_to_dict` gives them.
        settings: seed and resamples.
    """
    bootstrap = BlockBootstrap(len(walks), samples=settings.bootstrap, seed=settings.seed)
    metrics: dict[str, Metric] = {}

    def add(name: str, depth: str, method: str, top: str, bottom: str, unit: str) -> None:
        above, below = (np.array([walk[depth][method].get(key, 0.0) for walk in walks]) for key in (top, bottom))
        if below.sum() <= 0:
            return
        counted = below.sum() if bottom.split(".")[-1] in ("regions", "turned", "matched") else len(walks)
        metrics[f"perception.{name}"] = metric(
            above.sum() / below.sum(), bootstrap.ratio(above, below), int(counted), unit
        )

    for depth in DEPTHS:
        prefix = "" if depth == "exact" else f"{depth}."
        for name, (top, bottom, unit) in _RATIOS.items():
            add(f"{prefix}{name}", depth, "warm", top, bottom, unit)
            if not name.startswith("assumed") and name != "overhang_untrimmed":
                add(f"{prefix}baseline.{name}", depth, "baseline", top, bottom, unit)
        for name, (top, bottom, unit) in _JITTER.items():
            for method in METHODS:
                add(f"{prefix}{name}_{method}", depth, method, top, bottom, unit)
        regions = sum(walk[depth]["warm"].get("planar.regions", 0.0) for walk in walks)
        metrics[f"perception.{prefix}regions"] = metric(regions, None, len(walks), "1")
    metrics["perception.walks"] = metric(len(walks), None, len(walks), "1")
    return metrics


def summary(metrics: Mapping[str, Metric]) -> Iterator[str]:
    """The main figures, for a terminal: exact and noisy depth, and the baseline."""
    names = ("region_purity", "coverage", "overhang", "height_error", "normal_error")
    for name in (*names, "jitter_warm", "jitter_cold", "overlap_warm", "overlap_cold"):
        parts = []
        for title, key in (
            ("exact", f"perception.{name}"),
            ("noisy", f"perception.noisy.{name}"),
            ("baseline on noisy", f"perception.noisy.baseline.{name}"),
        ):
            if entry := metrics.get(key):
                interval = "" if entry["ci95"] is None else " ({:.4f} to {:.4f})".format(*entry["ci95"])
                parts.append(f"{title} {entry['value']:.4f}{interval}")
        if parts:
            yield f"{name:14} {', '.join(parts)}"


def _robot(bundle_path: Path | None, settings: PerceptionEvalSettings) -> tuple[RobotSettings, Bundle | None]:
    """Who walks, and the bundle whose segmenter labels what it sees."""
    if bundle_path is None:
        return load_robot(settings.robot or "go2"), None
    bundle = load_bundle(bundle_path)
    segmenter = bundle.steppability
    robot = load_robot(settings.robot or bundle.robot.name)
    if robot.name != bundle.robot.name:
        raise RobotError(f"{bundle_path}: made for {bundle.robot.name}, asked for {robot.name}; leave --robot out")
    if segmenter.sensor is not None and segmenter.sensor.camera != robot.camera.camera():
        raise RobotError(
            f"{bundle_path}: its segmenter was trained for another camera than {settings.robot or robot.name} has; "
            "name the robot's own YAML with --robot"
        )
    return robot, bundle


def _key(settings: PerceptionEvalSettings, robot: RobotSettings, bundle: Bundle | None, number: int) -> TrialKey:
    # How many walks there are and how they are resampled changes none of them.
    matter = {key: value for key, value in settings.to_dict().items() if key not in ("robot", "sequences", "bootstrap")}
    models = None if bundle is None else bundle_content(bundle.manifest)
    decides = {"robot": robot, "settings": matter, "bundle": models}
    return trial_key("scene", "true_labels" if bundle is None else "segmenter", number, decides)


def _drawing(trials: Trials, key: TrialKey) -> Path:
    return trials.beside(key, "svg")
