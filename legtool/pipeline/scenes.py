"""Labelled scenes: drawn, seen along a walk by the ray caster, labelled, and corrupted as a sensor would."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from legtool.configs.robots import SeeingRobot
from legtool.configs.scenes import SceneSettings
from legtool.configs.worlds import load_scene
from legtool.datasets.steppability.scenes import KIND, SceneFrame, frames_table, split_scenes
from legtool.datasets.store import Store, part_path, write_part
from legtool.pipeline.parts import run_parts
from legtool.provenance import commit
from legtool.sim.robots.named import mjcf_inputs, seeing_robot
from legtool.sim.sensors.sequence import walk_through
from legtool.sim.worlds.colour import colour_image
from legtool.sim.worlds.labels import class_image
from legtool.workers import Workers
from legtool_runtime.perception import LABELS

#: Scenes in one part.
SCENES_PER_PART = 10


def collect_scenes(settings: SceneSettings, out: Path, *, workers: int | Workers = 1) -> dict[str, Any]:
    """Draw scenes and write their frames as a dataset.

    Args:
        settings: robot, shapes, placements, camera, corruptions.
        out: the dataset's directory; a collection that was interrupted there carries on.
        workers: processes; the dataset does not depend on it.

    Returns:
        the dataset's manifest; ``counts`` tells the share of pixels with each label.

    Raises:
        RobotError, SettingsError: no such robot or layout.
        OutputError: ``out`` holds something else, or cannot be written.
    """
    robot = _robot(settings)
    layouts = [load_scene(name).model_dump(mode="json", include={"name", "shapes"}) for name in settings.layouts]
    header = {
        "kind": KIND,
        "robot": robot.to_dict(),
        "settings": {**settings.to_dict(), "layouts": layouts},
        "seed": settings.seed,
        "inputs": mjcf_inputs(settings.mjcf, settings.mjcf_names),
        "commit": commit(),
    }
    parts = -(-settings.scenes // SCENES_PER_PART)
    with Store(out, header, shard=Workers.of(workers).name) as store:
        write = functools.partial(write_scenes_part, store.path, settings)
        return run_parts(store, write, total=parts, workers=workers, description="drawing scenes", unit="parts")


def write_scenes_part(root: Path, settings: SceneSettings, index: int) -> None:
    """Draw the scenes of part ``index`` and write them below ``root``."""
    cv2.setNumThreads(1)  # one process to a core does more than threads that wait for each other
    robot, first = _robot(settings), index * SCENES_PER_PART
    scenes = range(first, min(first + SCENES_PER_PART, settings.scenes))
    frames = [frame for scene in scenes for frame in scene_frames(settings, scene, robot=robot)]
    pixels = np.sum([np.bincount(frame.label.ravel(), minlength=len(LABELS)) for frame in frames], axis=0)
    counts = {"scenes": len(scenes), "frames": len(frames)}
    counts |= {f"pixels_{name}": int(n) for name, n in zip(LABELS, pixels, strict=True)}
    write_part(part_path(root, index), frames_table(frames), counts=counts)


def _robot(settings: SceneSettings) -> SeeingRobot:
    return seeing_robot(settings.robot, settings.mjcf, settings.mjcf_names, settings.depth_camera)


def scene_frames(settings: SceneSettings, scene: int, *, robot: SeeingRobot | None = None) -> list[SceneFrame]:
    """The frames of one scene: the same bits for the same settings and number, in any process.

    Args:
        settings: of the dataset.
        scene: its number.
        robot: that the settings name, where it is at hand.

    Raises:
        RobotError, SettingsError: no such robot or layout.
    """
    robot = robot or _robot(settings)
    camera = robot.camera.camera()
    drawn, steps = walk_through(settings, robot, scene)
    split = split_scenes(settings.scenes, settings.seed)[scene]
    return [
        SceneFrame(
            scene=scene,
            frame=k,
            split=split,
            placement=drawn.placement,
            indoor=drawn.indoor,
            pose=step.camera_to_world,
            depth=step.view.depth,
            label=step.view.label,
            shape=class_image(drawn.world, step.view.seen),
            colour=colour_image(drawn.world, step.view.seen, camera, step.camera_to_world),
        )
        for k, step in enumerate(steps)
    ]
