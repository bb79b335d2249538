"""Labelled heightmaps: a robot moved over random terrain, its tuples judged by the exact criteria."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from legtool.configs.footholds import FootholdSettings
from legtool.datasets.foothold.heightmaps import KIND, FootholdData, to_table
from legtool.datasets.store import Store, part_path, write_part
from legtool.pipeline.parts import run_parts
from legtool.provenance import commit
from legtool.sim.robots.named import mjcf_inputs, named_geometry
from legtool.sim.worlds.foothold_samples import foothold_samples
from legtool.workers import Workers
from legtool_runtime.foothold import SIZE, Criteria, hip_heights


def collect_footholds(settings: FootholdSettings, out: Path, *, workers: int | Workers = 1) -> dict[str, Any]:
    """Draw heightmaps and label them: every criterion, the optimal foothold, counts over hip heights.

    Args:
        settings: robot, terrain, motion, flaws of the maps.
        out: the dataset's directory; one that was interrupted there carries on.
        workers: processes; the dataset does not depend on it.

    Returns:
        the dataset's manifest.

    Raises:
        RobotError: no such robot, or an MJCF file that it cannot be found in.
        OutputError: ``out`` holds something else, or cannot be written.
    """
    robot = named_geometry(settings.robot, settings.mjcf, settings.mjcf_names)
    header = {
        "kind": KIND,
        "robot": robot.to_dict(),
        "settings": settings.to_dict(),
        "seed": settings.seed,
        "inputs": mjcf_inputs(settings.mjcf, settings.mjcf_names),
        "criteria": Criteria(robot).settings.to_dict(),
        "hip_heights": hip_heights(robot).tolist(),
        "commit": commit(),
    }
    with Store(out, header, shard=Workers.of(workers).name) as store:
        write = functools.partial(write_footholds_part, store.path, settings)
        return run_parts(
            store, write, total=settings.parts, workers=workers, description="labelling", unit="parts of 1000"
        )


def write_footholds_part(root: Path, settings: FootholdSettings, index: int) -> None:
    """Draw and label one part of the dataset below ``root``."""
    robot = named_geometry(settings.robot, settings.mjcf, settings.mjcf_names)
    data = foothold_samples(settings, index, Criteria(robot))
    write_part(part_path(root, index), to_table(data), counts=_counts(data))


def _counts(data: FootholdData) -> dict[str, int]:
    return {
        "samples": len(data),
        "without_safe_foothold": int((data.optimal < 0).sum()),
        "nominal_unsafe": int((data.reasons[:, SIZE // 2, SIZE // 2] != 0).sum()),
    }
