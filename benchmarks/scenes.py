"""Time the labelled scenes: stage by stage for one frame of 640 × 480, and a whole collection by frames a second.

    python benchmarks/scenes.py [--scenes 40] [--workers 2]

Stages are processor time, the median and the least of many frames, for other processes take the core away; the
collection is wall-clock time, writing included, and wants an idle machine.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from legtool.configs.robots import load_robot
from legtool.configs.scenes import SceneSettings
from legtool.datasets.steppability.scenes import frames_table
from legtool.pipeline.scenes import collect_scenes, scene_frames
from legtool.sim.sensors.camera_motion import camera_poses
from legtool.sim.sensors.depth_noise import corrupt
from legtool.sim.worlds.colour import colour_image
from legtool.sim.worlds.labels import label_image
from legtool.sim.worlds.placement import draw_scene
from legtool.sim.worlds.raycast import cast

SCENES = 20


def stages() -> None:
    robot = load_robot("go2")
    settings = SceneSettings()
    camera = robot.camera.camera()
    times: dict[str, list[float]] = {}

    def timed(name: str, call: Callable[[], Any]) -> Any:
        start = time.process_time_ns()
        result = call()
        times.setdefault(name, []).append((time.process_time_ns() - start) * 1e-6)
        return result

    for scene in range(SCENES + 1):
        rng = np.random.default_rng(scene)
        drawn = draw_scene(settings, robot, rng)
        pose = camera_poses(drawn, robot, settings.camera, 2, rng)[0]
        world = drawn.world
        seen = timed("cast", lambda w=world, p=pose: cast(w.scene, camera, p, far=robot.camera.range_m[1]))
        timed("label", lambda w=world, s=seen, p=pose: label_image(w, s, camera, p, swing_height_max=0.15))
        timed("corrupt", lambda s=seen, r=rng: corrupt(s.depth, s.geom, robot.camera.noise, r))
        timed("colour", lambda w=world, s=seen, p=pose: colour_image(w, s, camera, p))
        frames = timed("whole scene of 5 frames", lambda n=scene: scene_frames(settings, n))
        timed("encode 5 frames", lambda f=frames: frames_table(f))
        if scene == 0:
            times.clear()  # compiling
    print(f"{'stage, ms':28} median   least")
    for name, values in times.items():
        print(f"{name:28} {np.median(values):6.1f}  {min(values):6.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    stages()
    with tempfile.TemporaryDirectory() as place:
        settings = SceneSettings(scenes=arguments.scenes)
        start = time.perf_counter()
        manifest = collect_scenes(settings, Path(place) / "scenes", workers=arguments.workers)
        elapsed = time.perf_counter() - start
    size = sum(part["bytes"] for part in manifest["parts"]) / manifest["rows"] / 1000
    print(
        f"collected {manifest['rows']} frames with {arguments.workers} workers in {elapsed:.1f} s: "
        f"{manifest['rows'] / elapsed:.1f} frames/s, {size:.0f} kB a frame"
    )


if __name__ == "__main__":
    main()
