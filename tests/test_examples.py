"""What the documents show runs."""

import copy
import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
import types
from pathlib import Path
from typing import ClassVar

import nbclient
import nbformat
import numpy as np
import pytest

from legtool.sim.walks import scene
from legtool_runtime import load_bundle
from legtool_runtime.perception.camera import Camera

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("name", ["predict_step", "plan_walk"])
def test_an_example_runs_on_the_bundle_beside_it_and_tells_a_mistake_in_one_line(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) >= 4
    wrong = subprocess.run([*command, str(tmp_path / "none")], capture_output=True, text=True, check=False)
    assert wrong.returncode == 1 and len(wrong.stderr.splitlines()) == 1 and "no such directory" in wrong.stderr


def test_the_plan_of_the_example_steps_over_its_gap(walking_bundle: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "plan_walk.py"), str(walking_bundle)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    steps = [float(x) for x in re.findall(r"x (-?\d+\.\d+), (?:-?\d+\.\d+) m", shown)]
    assert steps
    assert not any(0.80 <= x <= 0.92 for x in steps)


def test_the_readme_s_runtime_code_runs(walking_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert code is not None
    (tmp_path / "bundle").symlink_to(walking_bundle)
    (tmp_path / "snippet.py").write_text(code.group(1))
    monkeypatch.chdir(tmp_path)
    result = runpy.run_path("snippet.py")
    assert result["step"].foot_displacement.shape == (11, 4, 3)


class Message:
    """Stands in for any ROS message: members come into being when they are touched."""

    LINE_STRIP, SPHERE_LIST, ADD, DELETE = 4, 7, 0, 2

    def __init__(self, **members):
        self.__dict__.update(members)

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        made = [] if name in ("markers", "points", "data") else Message()
        self.__dict__[name] = made
        return made


class Node:
    """Stands in for rclpy's node: keeps what is subscribed to and what is published."""

    given: ClassVar[dict] = {}

    def __init__(self, name):
        self.heard, self.published = {}, {}

    def declare_parameter(self, name, value):
        return Message(value=self.given.get(name, value))

    def create_subscription(self, kind, topic, callback, qos):
        self.heard[topic] = callback

    def create_publisher(self, kind, topic, depth):
        return Message(publish=self.published.setdefault(topic, []).append)


@pytest.fixture
def ros2(monkeypatch):
    """rclpy and its messages, made up for this test alone: no ROS is installed here, and none is needed."""
    names = {
        "rclpy": {}, "rclpy.node": {"Node": Node}, "rclpy.qos": {"qos_profile_sensor_data": 10},
        "geometry_msgs.msg": dict.fromkeys(("Point", "Twist"), Message),
        "nav_msgs.msg": dict.fromkeys(("OccupancyGrid", "Odometry"), Message),
        "sensor_msgs.msg": dict.fromkeys(("CameraInfo", "Image", "JointState"), Message),
        "std_msgs.msg": dict.fromkeys(("Float64", "Float64MultiArray"), Message),
        "visualization_msgs.msg": dict.fromkeys(("Marker", "MarkerArray"), Message),
    }  # fmt: skip
    for name, members in names.items():
        module = types.ModuleType(name)
        module.__dict__.update(members)
        monkeypatch.setitem(sys.modules, name, module)
        if "." in name:
            monkeypatch.setitem(sys.modules, name.partition(".")[0], sys.modules.get(name.partition(".")[0], module))
    spec = importlib.util.spec_from_file_location("ros2_node", ROOT / "examples" / "ros2_node.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def flat_depth(camera, mount, height):
    """Depth of level ground, seen by a camera whose base is ``height`` above it."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    down = rays @ mount[2, :3]
    with np.errstate(divide="ignore"):
        depth = -(height + mount[2, 3]) / down
    return np.where((depth > 0.2) & (depth < 5.0), depth, np.nan).astype(np.float32)


def test_the_ros_node_maps_plans_and_commands(ros2, walking_bundle: Path) -> None:
    """Against stand-ins for rclpy and its messages (above), of which the node knows nothing."""
    bundle = load_bundle(walking_bundle)
    robot, weight = bundle.robot, 200.0
    Node.given = {"bundle": str(walking_bundle), "weight": weight, "drive": True}
    node = ros2.Walker()
    camera = Camera.from_field_of_view(160, 120, 1.386)
    depth = flat_depth(camera, node.mount, robot.standing_height)
    stamp = Message(sec=3, nanosec=500_000_000)
    node.heard["camera/depth/camera_info"](Message(k=[camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]))
    node.heard["wish"](Message(linear=Message(x=0.4, y=0.0), angular=Message(z=0.0)))
    joints, _ = robot.joints(robot.stance)
    node.heard["joint_states"](Message(position=joints.ravel().tolist()))
    node.heard["foot_forces"](Message(data=[weight / 4] * 4))
    place = Message(
        position=Message(x=0.0, y=0.0, z=robot.standing_height), orientation=Message(w=1.0, x=0.0, y=0.0, z=0.0)
    )
    twist = Message(twist=Message(linear=Message(x=0.0, y=0.0), angular=Message(z=0.0)))
    odometry = Message(header=Message(stamp=stamp), pose=Message(pose=place), twist=twist)
    node.heard["odom"](odometry)
    assert not node.published["cmd_vel"]  # nothing is commanded before there is a map
    pixels = np.where(np.isnan(depth), 0, 1e3 * depth).round().astype("<u2")
    for encoding, data in (("32FC1", depth.tobytes()), ("16UC1", pixels.tobytes())):
        step = len(data) // camera.height
        node.heard["camera/depth/image"](
            Message(header=Message(stamp=stamp), encoding=encoding, height=120, width=160, step=step, data=data)
        )
    node.heard["odom"](odometry)
    (grid, _), (plan,), (told,) = (node.published[name] for name in ("map/steppable", "plan", "cmd_vel"))
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    assert (cells == 0).sum() > 2000 and (cells == 100).sum() < 0.2 * (cells == 0).sum()
    assert grid.header.frame_id == "odom" and grid.header.stamp is stamp
    assert told.linear.x == node.pilot.plan.command[0] and 0.1 <= told.linear.x <= 0.6  # as the operator wished
    way, touchdowns = plan.markers
    assert len(way.points) == 6 and len(touchdowns.points) == 10 and way.points[-1].x > 0.15
    assert node.published["times/plan"][0].data > 0.0


def test_the_layout_shows_the_topics_that_recordings_have() -> None:
    text = (ROOT / "examples" / "foxglove_layout.json").read_text()
    layout = json.loads(text)
    shown = layout["configById"]["3D!world"]["topics"]
    assert {scene.MAP, scene.HEIGHTS, scene.CLOUD, scene.REGIONS, scene.PLAN, scene.FEET} <= set(shown)
    assert scene.LABELS in text and scene.DEPTH in text and "/times/plan.data" in text
    names = re.findall(r'"((?:3D|Image|Plot)![a-z]+)"', json.dumps(layout["layout"]))
    assert sorted(names) == sorted(layout["configById"])


def test_the_notebook_runs_anew_and_is_stored_as_it_ran(monkeypatch: pytest.MonkeyPatch) -> None:
    path = ROOT / "examples" / "tour.ipynb"
    stored = nbformat.read(path, as_version=4)
    fresh = copy.deepcopy(stored)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(ROOT / "runtime" / "src")]))
    client = nbclient.NotebookClient(fresh, timeout=600, resources={"metadata": {"path": str(path.parent)}})
    client.execute()

    def told(notebook: nbformat.NotebookNode) -> list[list[str]]:
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        return [[entry["text"] for entry in cell.outputs if entry.output_type == "stream"] for cell in code]

    assert told(fresh) == told(stored)
    shown = [entry for cell in stored.cells for entry in cell.get("outputs", ())]
    assert sum("image/png" in entry.get("data", {}) for entry in shown) == 2
    text = path.read_text(encoding="utf-8")
    assert len(text) < 200_000 and not re.search(r"/(home|root|tmp|Users|work)/", text)
