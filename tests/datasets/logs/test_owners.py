"""What owners of robots have: messages of Unitree, Gazebo, ANYmal and Spot, by preset, by name, and by guess."""

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import legtool.configs
from legtool.configs.log import LogSettings
from legtool.configs.topics import load_topics
from legtool.errors import LogError, OutputError
from legtool.pipeline.guess import guess_topics
from legtool.pipeline.log import collect_log
from legtool_runtime.robot import LEGS

UNITREE = [1, 0, 3, 2]  # FR, FL, RR, RL
GAZEBO = """string[] name
geometry_msgs/Pose[] pose
geometry_msgs/Twist[] twist
"""
CONTACTS = "std_msgs/Header header\ntest_gazebo/ContactState[] states\n"
CONTACT = "string info\ngeometry_msgs/Wrench total_wrench\n"
ANYMAL = """std_msgs/Header header
geometry_msgs/PoseStamped pose
geometry_msgs/TwistStamped twist
test_anymal/Joints joints
test_anymal/Foot[] contacts
"""
HIGH_IMU = "float32[4] quaternion\nfloat32[3] gyroscope\n"
HIGH_MOTOR = "uint8 mode\nfloat32 q\nfloat32 dq\n"
HIGH = """uint8[2] head
uint8 levelFlag
unitree_legged_msgs/IMU imu
unitree_legged_msgs/MotorState[20] motorState
int16[4] footForce
uint8 mode
float32[3] position
float32[3] velocity
float32 yawSpeed
"""
JOINTS = "string[] name\nfloat64[] position\n"
FOOT = "string name\nuint8 state\n"


def typestore(ros1=False):
    from pathlib import Path

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for file in (Path(legtool.configs.__file__).parent / "messages").rglob("*.msg"):
        store.register(get_types_from_msg(file.read_text(), f"{file.parent.parent.name}/msg/{file.stem}"))
    for text, name in (
        (GAZEBO, "gazebo_msgs/msg/ModelStates"),
        (CONTACT, "test_gazebo/msg/ContactState"),
        (CONTACTS, "test_gazebo/msg/ContactsState"),
        (HIGH_IMU, "unitree_legged_msgs/msg/IMU"),
        (HIGH_MOTOR, "unitree_legged_msgs/msg/MotorState"),
        (HIGH, "unitree_legged_msgs/msg/HighState"),
        (JOINTS, "test_anymal/msg/Joints"),
        (FOOT, "test_anymal/msg/Foot"),
        (ANYMAL, "test_anymal/msg/AnymalState"),
    ):
        store.register(get_types_from_msg(text, name))
    return store


class Maker:
    """Writes messages of nested dictionaries as a bag."""

    def __init__(self, ros1=False):
        self.store, self.ros1, self.events = typestore(ros1), ros1, []

    def fill(self, name, values):
        """A message with some of its fields given, and zeros elsewhere."""
        fields = {}
        for member, (kind, detail) in self.store.fielddefs[name][1]:
            given = values.get(member)
            if kind.name == "NAME":
                fields[member] = self.fill(detail, given or {})
            elif kind.name == "BASE":
                fields[member] = (
                    given
                    if given is not None
                    else ("" if detail[0] == "string" else (detail[0] == "bool" and False) or 0)
                )
            else:
                inner, count = detail
                if inner[0].name == "NAME":
                    fields[member] = [
                        self.fill(inner[1], item) for item in (given if given is not None else [{}] * (count or 0))
                    ]
                elif inner[1][0] == "string":
                    fields[member] = list(given or [])
                else:
                    kinds = {"byte": "uint8", "char": "uint8", "bool": "bool"}
                    dtype = kinds.get(inner[1][0], inner[1][0])
                    fields[member] = np.array(given if given is not None else np.zeros(count or 0), dtype=dtype)
        return self.store.types[name](**fields)

    def add(self, topic, kind, stamp, /, **values):
        self.events.append((int(stamp), topic, kind, self.fill(kind, values)))

    def write(self, path, define=True):
        if self.ros1:
            writer = Writer1(path)
        else:
            writer = Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
        serialise = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        with writer:
            made = {}
            for stamp, topic, name, message in sorted(self.events, key=lambda event: event[0]):
                if topic not in made:
                    known = {"typestore": self.store} if define else {"msgdef": "", "rihs01": "RIHS01_0"}
                    made[topic] = writer.add_connection(topic, name, **known)
                writer.write(made[topic], stamp, serialise(message, name))
        return path


def header(stamp):
    return {"stamp": {"sec": int(stamp // 10**9), "nanosec": int(stamp % 10**9)}}


def vector(values, letters="xyz"):
    return dict(zip(letters, map(float, values), strict=True))


def go2_bag(maker, walk, path, *, sport=True, low="/lowstate", command="twist"):
    q = walk["joints"].reshape(-1, 4, 3)[:, UNITREE].reshape(-1, 12)
    for i, stamp in enumerate(walk["stamps"].tolist()):
        motors = [{"q": float(value)} for value in q[i]] + [{}] * 8
        maker.add(low, "unitree_go/msg/LowState", stamp, motor_state=motors, foot_force=walk["contact"][i, UNITREE])
        pose, quaternion = walk["position"][i], walk["orientation"][i]
        if sport and i % 2 == 0:
            imu = {"quaternion": quaternion[[3, 0, 1, 2]]}
            speed = {"velocity": walk["velocity"][i], "yaw_speed": float(walk["yaw_rate"][i, 0])}
            maker.add("/sportmodestate", "unitree_go/msg/SportModeState", stamp, imu_state=imu, position=pose, **speed)
        elif not sport:
            twist = {"linear": vector(walk["velocity"][i]), "angular": {"z": float(walk["yaw_rate"][i, 0])}}
            place = {"position": vector(pose), "orientation": vector(quaternion, "xyzw")}
            maker.add(
                "/odom",
                "nav_msgs/msg/Odometry",
                stamp,
                header=header(stamp),
                pose={"pose": place},
                twist={"twist": twist},
            )
        vx, vy, w = walk["command"][i].tolist()
        if i % 4 == 0 and command == "twist":
            maker.add("/cmd_vel", "geometry_msgs/msg/Twist", stamp, linear={"x": vx, "y": vy}, angular={"z": w})
        elif i % 4 == 0:
            text = json.dumps({"x": vx, "y": vy, "z": w})
            identity = {"identity": {"api_id": 1008}}
            maker.add("/api/sport/request", "unitree_api/msg/Request", stamp, header=identity, parameter=text)
            if i % 40 == 0:  # other requests say nothing of the command
                maker.add(
                    "/api/sport/request", "unitree_api/msg/Request", stamp + 1, header={"identity": {"api_id": 1}}
                )
    return maker.write(path, define=False)


@pytest.mark.parametrize(
    "options",
    [{}, {"sport": False}, {"command": "request"}, {"low": "/lf/lowstate", "command": "request"}],
)
def test_a_go2_owner_needs_one_command(tmp_path, walk, collect, options):
    bag = go2_bag(Maker(), walk, tmp_path / "go2", **options)
    manifest = collect(bag, topics="go2_unitree")
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


def gazebo_bag(maker, walk, path, *, models=("ground_plane", "spotty"), added=None, contacts=True):
    yaw = 2 * np.arctan2(walk["orientation"][:, 2], walk["orientation"][:, 3])
    c, s = np.cos(yaw), np.sin(yaw)
    vx, vy = walk["velocity"][:, 0], walk["velocity"][:, 1]
    world = np.column_stack([c * vx - s * vy, s * vx + c * vy, 0 * vx])
    names = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")]
    for i, stamp in enumerate(walk["stamps"].tolist()):
        held = list(models) if added is None or i < added else ["crate", *models]
        mine = {"position": vector(walk["position"][i]), "orientation": vector(walk["orientation"][i], "xyzw")}
        twist = {"linear": vector(world[i]), "angular": {"z": float(walk["yaw_rate"][i, 0])}}
        other = {"position": {"x": 9.0}, "orientation": {"w": 1.0}}
        poses, twists = zip(*[(mine, twist) if name == models[1] else (other, {}) for name in held], strict=True)
        maker.add("/gazebo/model_states", "gazebo_msgs/msg/ModelStates", stamp, name=held, pose=poses, twist=twists)
        maker.add(
            "/joint_states",
            "sensor_msgs/msg/JointState",
            stamp,
            header=header(stamp),
            name=names,
            position=walk["joints"][i],
        )
        for leg, force in zip(LEGS, walk["contact"][i].tolist(), strict=True) if contacts else ():
            state = [{"total_wrench": {"force": {"z": force}}}] if force else []
            maker.add(
                f"/visual/{leg}_foot_contact",
                "test_gazebo/msg/ContactsState",
                stamp,
                header=header(stamp),
                states=state,
            )
        if i % 4 == 0:
            vx, vy, w = walk["command"][i].tolist()
            maker.add("/cmd_vel", "geometry_msgs/msg/Twist", stamp, linear={"x": vx, "y": vy}, angular={"z": w})
    return maker.write(path)


def gazebo_topics(model, **changes):
    topics = yaml.safe_load((load_topics.__globals__["PRESETS"] / "gazebo.yaml").read_text())
    text = yaml.safe_dump(topics["alternatives"][-1]).replace(".robot.", f".{model}.")
    return {**topics, **yaml.safe_load(text), "alternatives": [], **changes}


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("added", [None, 1000])
def test_gazebo_models_are_chosen_by_name_and_empty_contacts_are_no_force(tmp_path, walk, collect, ros1, added):
    bag = gazebo_bag(Maker(ros1), walk, tmp_path / "gazebo.bag", added=added)
    manifest = collect(bag, topics=gazebo_topics("spotty"))
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest
    by_index = gazebo_topics("1")
    told = collect(bag, topics=by_index)
    if added is None:
        assert told["counts"]["steps"] == manifest["counts"]["steps"]
    else:
        assert "pose.1.position is 'spotty' at first and 'ground_plane' later" in told
        assert "position: {field: pose.spotty.position}" in told
    assert "elements there: ground_plane, spotty" in collect(bag, topics=gazebo_topics("nobody"))


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("named", [True, False])
def test_names_beside_nested_arrays_are_used_whatever_their_order(tmp_path, walk, collect, seed, named):
    maker = Maker()
    names = [f"{leg}_{joint}" for leg in ("LF", "RF", "LH", "RH") for joint in ("HAA", "HFE", "KFE")]
    order = np.random.default_rng(seed).permutation(12)
    for i, stamp in enumerate(walk["stamps"].tolist()):
        place = {"position": vector(walk["position"][i]), "orientation": vector(walk["orientation"][i], "xyzw")}
        twist = {"linear": vector(walk["velocity"][i]), "angular": {"z": float(walk["yaw_rate"][i, 0])}}
        feet = [
            {"name": f"{leg}_FOOT", "state": int(force > 0)}
            for leg, force in zip(LEGS, walk["contact"][i], strict=True)
        ]
        maker.add(
            "/state_estimator/anymal_state", "test_anymal/msg/AnymalState", stamp, header=header(stamp),
            pose={"pose": place}, contacts=feet,
            twist={"twist": twist}, joints={"name": [names[k] for k in order], "position": walk["joints"][i][order]},
        )  # fmt: skip
        if i % 4 == 0:
            vx, vy, w = walk["command"][i].tolist()
            told = {"linear": {"x": vx, "y": vy}, "angular": {"z": w}}
            maker.add(
                "/motion_reference/command_twist",
                "geometry_msgs/msg/TwistStamped",
                stamp,
                header=header(stamp),
                twist=told,
            )
    bag = maker.write(tmp_path / "anymal")
    topics = "anymal"
    if named:
        preset = load_topics("anymal").to_dict()
        topics = {**{n: v for n, v in preset.items() if v is not None}, "joints": {**preset["joints"], "names": names}}
    manifest = collect(bag, topics=topics)
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


@pytest.mark.parametrize("names", ["front_left_hip_x", "fl.hx"])
def test_spot_s_joints_are_recognised(names):
    from legtool.datasets.logs.jointnames import joint_order

    words = (
        {"hip": "hip_x", "thigh": "hip_y", "knee": "knee"}
        if "_" in names
        else {"hip": "hx", "thigh": "hy", "knee": "kn"}
    )
    legs = ["front_left", "front_right", "rear_left", "rear_right"] if "_" in names else ["fl", "fr", "hl", "hr"]
    mark = "_" if "_" in names else "."
    listed = [f"{leg}{mark}{words[joint]}" for joint in ("knee", "hip", "thigh") for leg in legs]
    order = joint_order(["arm_sh0", *listed], ())
    assert [listed[i - 1] for i in order] == [
        f"{leg}{mark}{words[j]}" for leg in legs for j in ("hip", "thigh", "knee")
    ]


@pytest.mark.parametrize("order", ["joint", "listed"])
def test_twelve_joints_in_another_order(walk, write_csv, collect, topics_of, order):
    signals = ("position", "orientation", "command", "joints", "contact")
    expected = collect(write_csv(walk), topics=topics_of(*signals))["counts"]["steps"]
    joints = walk["joints"].reshape(-1, 4, 3)
    if order == "joint":
        walk["joints"] = joints.swapaxes(1, 2).reshape(-1, 12)
        declared = "joint"
    else:
        mixed = np.random.default_rng(2).permutation(12)
        walk["joints"] = walk["joints"][:, mixed]
        declared = [[f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "knee")][i] for i in mixed]
    manifest = collect(write_csv(walk), topics=topics_of(*signals, joints={"order": declared}))
    assert manifest["counts"]["steps"] == expected


@pytest.mark.parametrize(("order", "unit"), [("rpy", "rad"), ("ypr", "deg")])
def test_orientation_as_angles(walk, write_csv, collect, topics_of, order, unit):
    expected = collect(write_csv(walk), topics=topics_of())["counts"]["steps"]
    yaw = 2 * np.arctan2(walk["orientation"][:, 2], walk["orientation"][:, 3]) * (180 / np.pi if unit == "deg" else 1)
    angles = np.column_stack([0 * yaw, 0 * yaw, yaw])
    walk["orientation"][:, :3] = angles if order == "rpy" else angles[:, ::-1]
    topics = topics_of(orientation={"columns": [4, 5, 6], "order": order, "unit": unit})
    assert collect(write_csv(walk), topics=topics)["counts"]["steps"] == expected


def high_bag(walk, path, *, ros1=True):
    """Go1 or A1: one message with all of it, without a stamp, and a Twist."""
    maker = Maker(ros1)
    q = walk["joints"].reshape(-1, 4, 3)[:, UNITREE].reshape(-1, 12)
    for i, stamp in enumerate(walk["stamps"].tolist()):
        motors = [{"q": float(value)} for value in q[i]] + [{}] * 8
        maker.add(
            "/high_state", "unitree_legged_msgs/msg/HighState", stamp, motorState=motors,
            imu={"quaternion": walk["orientation"][i][[3, 0, 1, 2]]}, footForce=walk["contact"][i, UNITREE],
            position=walk["position"][i], velocity=walk["velocity"][i], yawSpeed=float(walk["yaw_rate"][i, 0]),
        )  # fmt: skip
        if i % 4 == 0:
            vx, vy, w = walk["command"][i].tolist()
            maker.add("/cmd_vel", "geometry_msgs/msg/Twist", stamp, linear={"x": vx, "y": vy}, angular={"z": w})
    return maker.write(path)


@pytest.mark.parametrize(("robot", "ros1"), [("go1", True), ("go1", False), ("a1", True)])
def test_high_state_of_go1_and_a1(tmp_path, make_walk, collect, robot, ros1):
    bag = high_bag(make_walk(robot=robot), tmp_path / "high.bag", ros1=ros1)
    manifest = collect(bag, topics=f"{robot}_unitree", robot=robot)
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


@pytest.mark.parametrize("driver", ["hip_x", "hx"])
def test_spot_as_its_drivers_publish_it(tmp_path, make_walk, collect, driver):
    walk, maker = make_walk(robot="spot"), Maker()
    legs, words, mark, root = (
        ("front_left", "front_right", "rear_left", "rear_right"),
        ("hip_x", "hip_y", "knee"),
        "_",
        "",
    )
    if driver == "hx":
        legs, words, mark, root = ("fl", "fr", "hl", "hr"), ("hx", "hy", "kn"), ".", "/spot"
    names = [f"{leg}{mark}{word}" for leg in legs for word in words]
    for i, stamp in enumerate(walk["stamps"].tolist()):
        twist = {"linear": vector(walk["velocity"][i]), "angular": {"z": float(walk["yaw_rate"][i, 0])}}
        place = {"position": vector(walk["position"][i]), "orientation": vector(walk["orientation"][i], "xyzw")}
        odometry = {"header": header(stamp), "pose": {"pose": place}, "twist": {"twist": twist}}
        maker.add(f"{root}/odometry", "nav_msgs/msg/Odometry", stamp, **odometry)
        joints = {"header": header(stamp), "name": ["arm_sh0", *names[::-1]]}
        maker.add(
            f"{root}/joint_states", "sensor_msgs/msg/JointState", stamp, **joints,
            position=np.concatenate([[0.3], walk["joints"][i][::-1]]),
        )  # fmt: skip
        if i % 4 == 0:
            vx, vy, w = walk["command"][i].tolist()
            maker.add(f"{root}/cmd_vel", "geometry_msgs/msg/Twist", stamp, linear={"x": vx, "y": vy}, angular={"z": w})
    bag = maker.write(tmp_path / "spot")
    manifest = collect(bag, topics="spot", robot="spot")
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest
    _out, lines = guess(tmp_path, bag)  # whose it is, the joints' names tell
    assert any("the robot is spot, by the names of joints" in line for line in lines), lines


@pytest.mark.parametrize("contact", [True, False])
@pytest.mark.parametrize("ending", ["csv", "npz", "parquet"])
def test_tables_of_isaac(tmp_path, walk, collect, contact, ending):
    held = {
        "root_pos_w": walk["position"],
        "root_quat_w": walk["orientation"][:, [3, 0, 1, 2]],
        "root_lin_vel_b": walk["velocity"],
        "root_ang_vel_b": np.column_stack([0 * walk["yaw_rate"], 0 * walk["yaw_rate"], walk["yaw_rate"]]),
        "commands": walk["command"],
        "joint_pos": walk["joints"].reshape(-1, 4, 3).swapaxes(1, 2).reshape(-1, 12),
    }
    if contact:
        held["contact_forces"] = walk["contact"]
    times = (walk["stamps"] - walk["stamps"][0]) * 1e-9
    table = {"time": times, **{f"{k}.{i}": v[:, i] for k, v in held.items() for i in range(v.shape[1])}}
    log = tmp_path / f"isaac.{ending}"
    if ending == "npz":
        np.savez(log, time=times, **held)
    elif ending == "csv":
        pd.DataFrame(table).to_csv(log, index=False)
    else:
        pd.DataFrame(table).to_parquet(log)
    manifest = collect(log, topics="isaac_csv")
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


@pytest.mark.parametrize("late_ns", [0, 1_300_000])
def test_an_export_of_plotjuggler(tmp_path, walk, collect, late_ns):
    """Each topic has rows of its own, with empty cells for all others."""
    names = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")]
    pose, twist = "/odom/pose/pose", "/odom/twist/twist"
    odometry = {
        **{f"{pose}/position/{a}": walk["position"][:, k] for k, a in enumerate("xyz")},
        **{f"{pose}/orientation/{a}": walk["orientation"][:, k] for k, a in enumerate("xyzw")},
        **{f"{twist}/linear/{a}": walk["velocity"][:, k] for k, a in enumerate("xyz")},
        f"{twist}/angular/z": walk["yaw_rate"][:, 0],
    }
    joints = {f"/joint_states/{name}/position": walk["joints"][:, k] for k, name in enumerate(names)}
    command = {
        f"/cmd_vel/{name}": walk["command"][:, k] for k, name in enumerate(("linear/x", "linear/y", "angular/z"))
    }
    streams = [(0, odometry), (late_ns, joints), (2 * late_ns, command)]
    if not late_ns:
        streams = [(0, {**odometry, **joints, **command})]
    parts = [pd.DataFrame(held).assign(__time=(walk["stamps"] + late) * 1e-9) for late, held in streams]
    table = pd.concat(parts).sort_values("__time", kind="stable")
    log = tmp_path / "export.csv"
    table[["__time", *(name for name in table if name != "__time")]].to_csv(log, index=False)
    manifest = collect(log, topics="plotjuggler_csv")
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest


def guess(tmp_path, *logs, **settings):
    out = tmp_path / "guess.yaml"
    lines = list(guess_topics(list(logs), LogSettings(**settings), out))
    return out, lines


def test_whose_a_log_is_the_messages_tell(tmp_path, walk, collect):
    bag = go2_bag(Maker(), walk, tmp_path / "go2")
    _out, lines = guess(tmp_path, bag)
    assert any("the robot is go2, by messages of unitree_go" in line for line in lines)
    assert "--robot go2 " in lines[-1]


def joints_alone(tmp_path, table):
    """A CSV of a walk without its feet and forces."""
    kept = [name for name in table if not name.endswith(("_x", "_y", "_z")) and not name.startswith("f_")]
    table[kept].to_csv(tmp_path / "joints.csv", index=False)


def test_the_one_robot_whose_legs_fit_is_named(tmp_path, make_walk, write_csv):
    joints_alone(tmp_path, pd.read_csv(write_csv(make_walk(robot="anymal_c", seed=3))))
    _out, lines = guess(tmp_path, tmp_path / "joints.csv")
    assert any("the robot is anymal_c, by its legs: no other preset fits" in line for line in lines)


def test_robots_whose_legs_fit_are_named_and_none_is_chosen(tmp_path, make_walk, write_csv):
    robot, never = "go2", {"aliengo", "hyq", "hyqreal", "spot", "anymal_c"}
    joints_alone(tmp_path, pd.read_csv(write_csv(make_walk(robot=robot, seed=3))))
    with pytest.raises(LogError, match=r"could be a log of .*; name the robot with --robot") as told:
        guess(tmp_path, tmp_path / "joints.csv")
    named = set(str(told.value).partition("log of ")[2].partition(";")[0].split(", "))
    assert robot in named and not named & never
    _out, lines = guess(tmp_path, tmp_path / "joints.csv", robot=robot)
    assert f"--robot {robot} " in lines[-1]


def test_joints_without_a_named_robot_are_refused(tmp_path, walk):
    bag = go2_bag(Maker(), walk, tmp_path / "go2")
    with pytest.raises(LogError, match="no robot is named; name it with --robot"):
        collect_log([bag], LogSettings(topics="go2_unitree"), tmp_path / "data")


@pytest.mark.parametrize("robot", ["aliengo", "hyq"])
def test_legs_that_are_too_long_are_told(tmp_path, walk, collect, robot):
    told = collect(go2_bag(Maker(), walk, tmp_path / "go2"), topics="go2_unitree", robot=robot)
    text = told if isinstance(told, str) else "\n".join(told["notes"])
    assert "stance feet move by -" in text and f"check the lengths of {robot}" in text


@pytest.mark.parametrize("robot", ["go2", "a1", "go1"])
def test_legs_that_are_too_short_are_told(tmp_path, make_walk, collect, robot):
    bag = go2_bag(Maker(), make_walk(robot="aliengo", seed=3), tmp_path / "aliengo")
    told = collect(bag, topics="go2_unitree", robot=robot)
    text = told if isinstance(told, str) else "\n".join(told["notes"])
    assert f"as of legs that are too short; check the lengths of {robot}" in text
    assert "notes" not in collect(bag, topics="go2_unitree", robot="aliengo")


def test_bags_of_one_run_are_guessed_together(tmp_path, walk, collect):
    maker = Maker()
    go2_bag(maker, walk, tmp_path / "whole", sport=False)
    parts = {"robot": [], "capture": []}
    for event in maker.events:
        parts["capture" if event[1] == "/odom" else "robot"].append(event)
    bags = []
    for name, events in parts.items():
        part = Maker()
        part.events = events
        bags.append(part.write(tmp_path / name, define=False))
    out, lines = guess(tmp_path, *bags)
    assert f"{bags[0]} {bags[1]} --robot go2" in lines[-1]
    assert collect(*bags, topics=str(out))["counts"] == collect(tmp_path / "whole", topics=str(out))["counts"]


@pytest.mark.parametrize("change", ["none", "deg/s", "legs", "world"])
def test_columns_are_guessed_and_corrected_by_the_checks(tmp_path, walk, write_csv, collect, change):
    if change == "deg/s":
        walk["yaw_rate"] *= 180 / np.pi
    elif change == "legs":
        walk["feet"] = walk["feet"].reshape(-1, 4, 3)[:, UNITREE].reshape(-1, 12)
    elif change == "world":
        yaw = 2 * np.arctan2(walk["orientation"][:, 2], walk["orientation"][:, 3])
        c, s = np.cos(yaw), np.sin(yaw)
        vx, vy = walk["velocity"][:, 0].copy(), walk["velocity"][:, 1].copy()
        walk["velocity"] = np.column_stack([c * vx - s * vy, s * vx + c * vy, 0 * vx])
    log = write_csv(walk)
    out, lines = guess(tmp_path, log, robot="go2")
    expected = {
        "deg/s": "yaw_rate: {unit: deg/s}",
        "legs": "feet: {legs: [FR, FL, RR, RL]}",
        "world": "velocity: {frame: world}",
    }
    assert change == "none" or any(f"corrected {expected[change]}" in line for line in lines), lines
    manifest = collect(log, topics=str(out))
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest
    with pytest.raises(OutputError, match="is there already"):
        guess(tmp_path, log, robot="go2")


def test_a_gazebo_bag_is_guessed_by_types_and_models(tmp_path, walk, collect):
    bag = gazebo_bag(Maker(), walk, tmp_path / "sim", contacts=False)
    out, lines = guess(tmp_path, bag, robot="go2")
    assert "pose.spotty.position" in out.read_text()
    assert collect(bag, topics=str(out))["counts"]["steps"] >= 35, lines


@pytest.mark.parametrize("sport", [True, False])
def test_a_go2_bag_is_guessed_as_one(tmp_path, walk, collect, sport):
    bag = go2_bag(Maker(), walk, tmp_path / "go2", sport=sport)
    out, lines = guess(tmp_path, bag, robot="go2")
    assert any("the preset go2_unitree" in line for line in lines)
    assert collect(bag, topics=str(out))["counts"]["steps"] >= 35


@pytest.mark.parametrize("seconds", [1.0, 2.5])
def test_headers_without_a_stamp_are_left_out_and_counted(tmp_path, walk, collect, seconds):
    """A driver that stamps nothing before its clock is set."""
    maker, none = Maker(), int(seconds * 200)
    names = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")]
    for i, stamp in enumerate(walk["stamps"].tolist()):
        head = header(stamp) if i >= none else {}
        twist = {"linear": vector(walk["velocity"][i]), "angular": {"z": float(walk["yaw_rate"][i, 0])}}
        place = {"position": vector(walk["position"][i]), "orientation": vector(walk["orientation"][i], "xyzw")}
        maker.add("/odom", "nav_msgs/msg/Odometry", stamp, header=head, pose={"pose": place}, twist={"twist": twist})
        joints = {"name": names, "position": walk["joints"][i]}
        maker.add("/joint_states", "sensor_msgs/msg/JointState", stamp, header=header(stamp), **joints)
        if i % 4 == 0:
            vx, vy, w = walk["command"][i].tolist()
            maker.add("/cmd_vel", "geometry_msgs/msg/Twist", stamp, linear={"x": vx, "y": vy}, angular={"z": w})
    manifest = collect(maker.write(tmp_path / "bag"))
    assert isinstance(manifest, dict), manifest
    assert manifest["counts"]["unstamped_position"] == none
    assert manifest["counts"]["recorded_s"] == pytest.approx(12.0 - seconds, abs=0.1)
