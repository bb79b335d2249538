"""What others read: the viewer Rerun takes recordings, and finds transforms, clouds, maps and markers in them.

Its command comes with the development extra alone (rerun-sdk); without it this is skipped.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from legtool.datasets.logs import scene_messages as scene
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.logs.recording import Recording
from legtool_runtime.perception.camera import Camera
from legtool_runtime.terrain.costmap import FootCostmap
from legtool_runtime.terrain.elevation import HeightMap

RERUN = shutil.which("rerun") or shutil.which("rerun", path=str(Path(sys.executable).parent))


def rerun(folder, *arguments):
    """Run Rerun's command with nothing of the user's, and without analytics."""
    environment = {**os.environ, "HOME": str(folder), "RERUN_ANALYTICS_ENABLED": "false", "NO_COLOR": "1"}
    done = subprocess.run(
        [RERUN, *arguments], capture_output=True, text=True, env=environment, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.skipif(RERUN is None, reason="rerun-sdk is not installed (pip install 'legtool[dev]')")
def test_rerun_takes_a_recording_and_finds_what_is_in_it(tmp_path, robot):
    n = 50
    stamps = np.arange(n) * 5_000_000
    forward = np.tile([0.4, 0.0, 0.0], (n, 1))
    recording = Recording(
        name="walk", stamps_ns=stamps, position_world=forward * stamps[:, None] * 1e-9,
        orientation=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), velocity_base=forward, yaw_rate=np.zeros(n), command=forward,
        feet_base=np.tile(robot.stance, (n, 1, 1)),
    )  # fmt: skip
    camera = Camera.from_field_of_view(32, 24, 1.2)
    costmap = FootCostmap(np.ones((9, 9), np.float32), np.ones((9, 9), np.bool_), 0.02, np.zeros(2), True)
    shape = scene.Shape("touchdowns", scene.SPHERE_LIST, np.eye(3), scene.BLUE, 0.04)
    more = [
        scene.occupancy(5_000_000, "/map/steppable", costmap),
        scene.grid_map(5_000_000, "/map/elevation", HeightMap(np.zeros((9, 9), np.float32), 0.02, np.zeros(2))),
        scene.points(5_000_000, "/camera/points", np.eye(3, dtype=np.float32)),
        scene.markers(5_000_000, "/plan", [shape]),
        scene.image(5_000_000, "/camera/depth/image", np.ones((24, 32), np.float32)),
        scene.camera_info(5_000_000, "/camera/depth/camera_info", camera),
        scene.fixed_frame(5_000_000, np.eye(4)),
    ]
    path = tmp_path / "walk.mcap"
    write_mcap(path, recording, frames=True, more=more, metadata={})
    checked = rerun(tmp_path, "mcap", "check", str(path))
    for topic in ("/tf", "/tf_static", "/odom", *(message.topic for message in more)):
        assert any(line.startswith("ok") and f" {topic} " in f"{line} " for line in checked.splitlines()), checked
    rerun(tmp_path, "mcap", "convert", str(path), "-o", str(tmp_path / "walk.rrd"))
    shown = rerun(tmp_path, "rrd", "print", str(tmp_path / "walk.rrd"))
    for topic, what in (
        ("/tf", "Transform3D:translation"), ("/tf_static", "Transform3D:quaternion"),
        ("/camera/points", "Points3D:positions"), ("/map/steppable", "GridMap:data"),
        ("/camera/depth/image", "DepthImage:buffer"), ("/camera/depth/camera_info", "Pinhole:image_from_camera"),
        ("/plan", "visualization_msgs.msg.MarkerArray"),
    ):  # fmt: skip
        assert any(f" {topic} - " in line and what in line for line in shown.splitlines()), (topic, what)
