"""A simulated robot: a MuJoCo model whose joints, feet and masses are known by leg.

It is built from :class:`RobotSettings` out of primitives, or found in the user's own MJCF file (``mjcf.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import RobotSettings
from legtool.sim.robots.physics import ROBOT_CONTACT, flat_world
from legtool_runtime.robot import JOINTS, LEGS, Robot
from legtool_runtime.rotations import quaternion_about_z

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SimRobot:
    """A compiled model and where the robot is in it.

    A joint angle of the chain in ``legtool_runtime.robot`` is ``joint_sign * qpos + joint_offset``.

    Attributes:
        model: the compiled world with the robot in it.
        geometry: the robot's kinematics.
        qpos: (4, 3) address of each joint's position in ``data.qpos``; the base's seven start at ``base_qpos``.
        dof: (4, 3) address of each joint in ``data.qvel``; the base's six start at ``base_dof``.
        joint_sign: (4, 3) ±1.
        joint_offset: (4, 3) [rad].
        force_sensor: (4,) address of each foot's touch sensor in ``data.sensordata``.
        torque_limit: (4, 3) [Nm].
        joint_friction: (4, 3) dry friction in the joints [Nm].
        joint_damping: (4, 3) [Nm s/rad].
        armature: (4, 3) rotor inertia [kg m²].
        mass: whole robot [kg].
        trunk_mass: [kg]; ``trunk_com`` (3,) its centre [m], ``trunk_inertia`` (3, 3) about it [kg m²], base frame.
        com: (3,) centre of mass of the whole robot standing at rest, base frame [m].
        inertia: (3, 3) whole robot standing at rest, about its centre of mass, base frame [kg m²].
        link_mass: (4, 3) hip, thigh and shank with foot [kg].
        link_com: (4, 3, 3) centre of mass from the link's joint, link axes (base axes when all joints are 0) [m].
        link_inertia: (4, 3, 3, 3) about the centre of mass, link axes [kg m²].
        held: joints of its file that are no leg's, and were taken out.
    """

    model: mujoco.MjModel
    geometry: Robot
    base_qpos: int
    base_dof: int
    qpos: NDArray[np.int64]
    dof: NDArray[np.int64]
    joint_sign: Array
    joint_offset: Array
    force_sensor: NDArray[np.int64]
    torque_limit: Array
    joint_friction: Array
    joint_damping: Array
    armature: Array
    mass: float
    trunk_mass: float
    trunk_com: Array
    trunk_inertia: Array
    com: Array
    inertia: Array
    link_mass: Array
    link_com: Array
    link_inertia: Array
    held: tuple[str, ...] = ()

    def joints_to_qpos(self, angles: Array) -> Array:
        """(4, 3) chain angles [rad] as the model's own joint positions."""
        return (angles - self.joint_offset) * self.joint_sign

    @cached_property
    def foot_geoms(self) -> NDArray[np.int64]:
        """(4,) the shape of each foot: of those that touch, and belong to its body, that nearest to its centre."""
        model, found = self.model, np.full(4, -1, np.int64)
        touching = (model.geom_contype | model.geom_conaffinity) != 0
        for leg in range(4):
            sensor = int(np.flatnonzero(model.sensor_adr == self.force_sensor[leg])[0])
            site = int(model.sensor_objid[sensor])
            own = np.flatnonzero(touching & (model.geom_bodyid == model.site_bodyid[site]))
            if len(own):
                away = np.linalg.norm(model.geom_pos[own] - model.site_pos[site], axis=1)
                found[leg] = own[np.argmin(away)]
        return found

    def place(self, data: mujoco.MjData, position: Array | None = None, yaw: float = 0.0) -> None:
        """Stand the robot at rest with its base at ``position`` (3,) [m], by default at the origin, floor at 0."""
        mujoco.mj_resetData(self.model, data)
        base = np.array([0.0, 0.0, self.geometry.standing_height]) if position is None else position
        angles, _ = self.geometry.joints(self.geometry.stance)
        data.qpos[self.base_qpos : self.base_qpos + 3] = base
        data.qpos[self.base_qpos + 3 : self.base_qpos + 7] = quaternion_about_z(yaw)
        data.qpos[self.qpos] = self.joints_to_qpos(angles)
        mujoco.mj_forward(self.model, data)


def build_robot(settings: RobotSettings, world: mujoco.MjSpec | None = None) -> SimRobot:
    """Put a robot of primitives into a world (a flat floor if none is given) and compile it.

    ``world`` is changed: its terrain geoms should carry ``world.TERRAIN_CONTACT``.
    """
    spec = flat_world() if world is None else world
    add_robot(spec, settings)
    geometry = settings.geometry()
    return describe(
        spec.compile(),
        geometry,
        base="trunk",
        joints=[[f"{leg}_{joint}_joint" for joint in JOINTS] for leg in LEGS],
        sensors=[f"{leg}_force" for leg in LEGS],
        joint_sign=np.ones((4, 3)),
        joint_offset=np.zeros((4, 3)),
        torque_limit=np.tile(settings.torque_limits, (4, 1)),
    )


def add_robot(spec: mujoco.MjSpec, settings: RobotSettings) -> None:
    """Add the robot's bodies to a world: a box trunk, capsule links, sphere feet with touch sensors."""
    robot = settings.geometry()
    trunk = spec.worldbody.add_body(name="trunk", pos=[0, 0, robot.standing_height])
    trunk.add_freejoint()
    size = settings.trunk.size or (2 * abs(settings.hip_x[0]), 2 * settings.hip_y, 0.1)
    _set_mass(trunk, settings.trunk.mass, np.array(settings.trunk.com), settings.trunk.inertia, _box_inertia(size))
    trunk.add_geom(name="trunk", type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array(size) / 2, **ROBOT_CONTACT)
    for leg, name in enumerate(LEGS):
        side = np.sign(robot.hips[leg, 1])
        front = 1.0 if robot.hips[leg, 0] > 0 else -1.0
        ends = np.zeros((3, 3))
        ends[0, 1] = robot.abduction_offset[leg]
        ends[1, 2] = -robot.thigh_length[leg]
        ends[2, 2] = -robot.shank_length[leg]
        parent, origin = trunk, robot.hips[leg]
        for joint, link in enumerate((settings.hip, settings.thigh, settings.shank)):
            body = parent.add_body(name=f"{name}_{JOINTS[joint]}", pos=origin)
            body.add_joint(
                name=f"{name}_{JOINTS[joint]}_joint",
                axis=[1, 0, 0] if joint == 0 else [0, 1, 0],
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                range=robot.joint_limits[leg, joint],
                damping=settings.joint_damping,
                frictionloss=settings.joint_friction,
                armature=settings.joint_armature,
            )
            com = np.array(link.com) * [front if joint == 0 else 1.0, side, 1.0]
            radius = link.radius or 0.02
            length = float(np.linalg.norm(ends[joint])) or 2 * radius
            _set_mass(body, link.mass, com, link.inertia, _rod_inertia(length, radius))
            if joint > 0:
                # The shank's capsule ends short of the foot, so that only the foot's sphere touches the ground.
                end = ends[joint] * (1.0 if joint == 1 else 1.0 - 1.5 * settings.foot_radius / length)
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                    fromto=[0.0, 0.0, 0.0, *end],
                    size=[radius, 0, 0],
                    **ROBOT_CONTACT,
                )
            parent, origin = body, ends[joint]
        foot = parent.add_body(name=f"{name}_foot", pos=origin)
        radius = settings.foot_radius
        _set_mass(foot, max(settings.foot_mass, 1e-4), np.zeros(3), None, (0.4 * radius**2,) * 3)
        foot.add_geom(
            name=f"{name}_foot",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            **ROBOT_CONTACT,
        )
        add_force_sensor(spec, foot, np.zeros(3), radius, f"{name}_force")


def add_force_sensor(spec: mujoco.MjSpec, body: mujoco.MjsBody, centre: Array, radius: float, name: str) -> None:
    """A touch sensor that sums the normal forces of contacts inside a sphere a little larger than the foot."""
    body.add_site(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre, size=[1.3 * radius, 0, 0])
    spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TOUCH, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)


def describe(
    model: mujoco.MjModel,
    geometry: Robot,
    *,
    base: str,
    joints: list[list[str]],
    sensors: list[str],
    joint_sign: Array,
    joint_offset: Array,
    torque_limit: Array,
    held: tuple[str, ...] = (),
) -> SimRobot:
    """Read addresses, masses and inertias of a robot out of a compiled model."""
    ids = np.array([[model.joint(name).id for name in leg] for leg in joints])
    base_joint = model.body(base).jntadr[0]
    base_qpos, base_dof = int(model.jnt_qposadr[base_joint]), int(model.jnt_dofadr[base_joint])
    qpos, dof = model.jnt_qposadr[ids].astype(np.int64), model.jnt_dofadr[ids].astype(np.int64)

    data = mujoco.MjData(model)
    data.qpos[base_qpos : base_qpos + 7] = [0, 0, 0, 1, 0, 0, 0]
    data.qpos[qpos] = -joint_offset * joint_sign
    mujoco.mj_kinematics(model, data)
    owner = _owners(model, model.body(base).id, model.jnt_bodyid[ids])
    anchors = _chain_origins(geometry)
    link_mass, link_com, link_inertia = np.zeros((4, 3)), np.zeros((4, 3, 3)), np.zeros((4, 3, 3, 3))
    for leg in range(4):
        for joint in range(3):
            mass, com, inertia = _lump(model, data, np.flatnonzero(owner == 3 * leg + joint))
            link_mass[leg, joint], link_com[leg, joint] = mass, com - anchors[leg, joint]
            link_inertia[leg, joint] = inertia
    trunk_mass, trunk_com, trunk_inertia = _lump(model, data, np.flatnonzero(owner == 12))

    angles, _ = geometry.joints(geometry.stance)
    data.qpos[qpos] = (angles - joint_offset) * joint_sign
    mujoco.mj_kinematics(model, data)
    mass, com, inertia = _lump(model, data, np.flatnonzero(owner >= 0))
    return SimRobot(
        model=model,
        geometry=geometry,
        base_qpos=base_qpos,
        base_dof=base_dof,
        qpos=qpos,
        dof=dof,
        joint_sign=joint_sign,
        joint_offset=joint_offset,
        force_sensor=np.array([int(model.sensor(name).adr[0]) for name in sensors]),
        torque_limit=torque_limit,
        joint_friction=model.dof_frictionloss[dof].copy(),
        joint_damping=model.dof_damping[dof].copy(),
        armature=model.dof_armature[dof].copy(),
        mass=mass,
        trunk_mass=trunk_mass,
        trunk_com=trunk_com,
        trunk_inertia=trunk_inertia,
        com=com,
        inertia=inertia,
        link_mass=link_mass,
        link_com=link_com,
        link_inertia=link_inertia,
        held=held,
    )


def _chain_origins(geometry: Robot) -> Array:
    """(4, 3, 3) joint origins with all joints at 0, base frame [m]."""
    origins = np.repeat(geometry.hips[:, None], 3, axis=1)
    origins[:, 1:, 1] += geometry.abduction_offset[:, None]
    origins[:, 2, 2] -= geometry.thigh_length
    return origins


def _owners(model: mujoco.MjModel, base: int, link_bodies: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each body the link (3 * leg + joint) that carries it, 12 for the trunk, -1 for what is not the robot."""
    owner = np.full(model.nbody, -1)
    owner[base] = 12
    links = {int(body): index for index, body in enumerate(link_bodies.ravel())}
    for body in range(1, model.nbody):  # parents come first
        if body in links:
            owner[body] = links[body]
        elif body != base:
            owner[body] = owner[model.body_parentid[body]]
    return owner


def _lump(model: mujoco.MjModel, data: mujoco.MjData, bodies: NDArray[np.int64]) -> tuple[float, Array, Array]:
    """Mass, centre (3,) and inertia (3, 3) about it of some bodies taken as one, world axes."""
    masses = model.body_mass[bodies]
    mass = float(masses.sum())
    com = (masses[:, None] * data.xipos[bodies]).sum(axis=0) / max(mass, 1e-12)
    inertia = np.zeros((3, 3))
    for body, body_mass in zip(bodies, masses, strict=True):
        axes = data.ximat[body].reshape(3, 3)
        arm = data.xipos[body] - com
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += body_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, com, inertia


def _set_mass(
    body: mujoco.MjsBody,
    mass: float,
    com: Array,
    inertia: tuple[float, float, float] | None,
    unit_inertia: tuple[float, float, float],
) -> None:
    body.mass = mass
    body.ipos = com
    body.inertia = mass * np.array(unit_inertia) if inertia is None else np.array(inertia)
    body.explicitinertial = True


def _box_inertia(size: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (edge**2 / 12 for edge in size)
    return y + z, x + z, x + y


def _rod_inertia(length: float, radius: float) -> tuple[float, float, float]:
    across = length**2 / 12 + radius**2 / 4
    return across, across, radius**2 / 2
