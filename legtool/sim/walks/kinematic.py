"""A trunk's path walked step by step, and checked by MuJoCo's own geometry: no foothold criterion has a say in it.

The trunk follows planned poses; each leg swings in turn to the foothold that the exact selection gives it. At every
tick MuJoCo places the links from joint angles and looks for contacts of trunk, thighs and shanks with the terrain,
and of a swinging foot that goes too deep; feet that are not where they should be, and joints
beyond their limits, are violations of the workspace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import RobotSettings
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.trunk_path import TrunkPath, vital_map
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.world import World
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.foothold.swing import Swing
from legtool_runtime.robot import LEGS
from legtool_runtime.rotations import from_angles
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
#: Time between looks [s]; depth from which a contact of a link counts, and of a foot in the middle of its swing [m].
TICK_S, LINK_DEPTH_M, FOOT_DEPTH_M = 0.01, 0.002, 0.005
#: How far a foot may be from where it should be [m], and a joint beyond its limit [rad].
_FOOT_OFF_M, _JOINT_OFF = 0.005, 0.01
_MIDDLE = (0.1, 0.9)


@dataclass(frozen=True, eq=False)
class Posture:
    """The robot at one instant, world frame [m]: (4, 4, 3) hip, thigh axis, knee and foot of each leg; trunk (2, 3)."""

    legs: Array
    trunk: Array


@dataclass
class StepCount:
    """What happened on the steps of a walk, from each lift-off to the next.

    Attributes:
        steps: of all legs.
        blind: steps for which no safe foothold was found, and the nominal one was taken.
        collided: steps on which trunk, thigh, shank or swinging foot met the terrain.
        violated: steps on which a foot could not follow, or a joint left its limits.
        excess: farthest that a joint was beyond its limits [rad].
        frames: the robot at the asked places.
    """

    steps: int = 0
    blind: int = 0
    collided: int = 0
    violated: int = 0
    excess: float = 0.0
    frames: list[Posture] = field(default_factory=list)


def walk_steps(
    settings: RobotSettings,
    world: World,
    path: TrunkPath,
    x: Array,
    pose: Array,
    *,
    frames_at: Sequence[float] = (),
) -> StepCount:
    """Walk a trunk's path.

    Args:
        settings: the robot.
        world: of ViTAL's.
        path: the way through it.
        x: (n,) places of the trunk, ascending [m].
        pose: (n, 3) height in the world [m], roll, pitch [rad] there.
        frames_at: places at which to keep a frame [m].
    """
    sim, elevation = build_robot(settings, world_spec(world)), vital_map(world)
    robot, data, gait = sim.geometry, mujoco.MjData(sim.model), path.gait
    selector = FootholdSelector(Criteria(robot))
    swinging = Gait(gait.step_length_m, gait.step_frequency_hz, gait.duty_factor, gait.swing_s)
    period, count = gait.swing_s + gait.stance_s, StepCount()
    offsets = np.array([0.0, 0.5, 0.5, 0.0])
    feet = np.zeros((4, 3))
    swings: list[Swing | None] = [None] * 4
    bad = np.zeros((4, 2), bool)
    started = np.zeros(4, bool)
    pending = list(frames_at)

    def base(place: float) -> tuple[Array, Array]:
        height, roll, pitch = (np.interp(place, x, pose[:, k]) for k in range(3))
        return np.array([place, 0.0, height]), from_angles(roll, pitch, path.yaw(place))

    origin, turn = base(x[0])
    for leg in range(4):
        feet[leg] = origin + turn @ robot.stance[leg]
        feet[leg, 2] = _ground(elevation, feet[leg]) + robot.foot_radius
    for t in np.arange(0.0, (x[-1] - x[0]) / path.speed, TICK_S):
        place = x[0] + path.speed * t
        origin, turn = base(place)
        phases = (t / period + offsets) % 1.0
        middle = np.zeros(4, bool)
        for leg in range(4):
            swing = swings[leg]
            if phases[leg] < gait.duty_factor:
                if swing is not None:
                    feet[leg], swings[leg] = swing.foothold, None
                continue
            if swing is None:
                if started[leg]:
                    _close(count, bad, leg)
                started[leg] = True
                swing, found = _aim(selector, elevation, path, leg, place, x, pose, feet[leg], swinging)
                swings[leg] = swing
                count.blind += not found
            phase = (phases[leg] - gait.duty_factor) / (1.0 - gait.duty_factor)
            feet[leg] = swing.position(phase)
            middle[leg] = _MIDDLE[0] < phase < _MIDDLE[1]
        _place(sim, data, origin, turn, feet)
        collided, violated, excess = look(sim, data, feet, middle)
        count.excess = max(count.excess, excess)
        bad[:, 0] |= collided
        bad[:, 1] |= violated
        while pending and place >= pending[0]:
            pending.pop(0)
            count.frames.append(_frame(sim, data))
    for leg in range(4):
        if started[leg]:
            _close(count, bad, leg)
    return count


def _close(count: StepCount, bad: NDArray[np.bool_], leg: int) -> None:
    count.steps += 1
    count.collided += int(bad[leg, 0])
    count.violated += int(bad[leg, 1])
    bad[leg] = False


def _aim(
    selector: FootholdSelector,
    elevation: HeightMap,
    path: TrunkPath,
    leg: int,
    place: float,
    x: Array,
    pose: Array,
    foot: Array,
    gait: Gait,
) -> tuple[Swing, bool]:
    """The swing to the safe foothold nearest to the nominal one, by the pose that the trunk will have at touchdown."""
    robot = selector.criteria.robot
    landing = min(place + path.speed * gait.swing_s, float(x[-1]))
    height, roll, pitch = (float(np.interp(landing, x, pose[:, k])) for k in range(3))
    found = selector.select_in(
        elevation,
        leg=leg,
        base_position=(place, 0.0, height),
        attitude=(roll, pitch, path.yaw(place)),
        base_twist=path.twist(place),
        gait=gait,
    )
    if found.position is not None:
        return Swing(foot.copy(), found.position, selector.criteria.settings.swing_height_m), True
    nominal = np.array([*found.nominal, 0.0])
    nominal[2] = _ground(elevation, nominal) + robot.foot_radius
    return Swing(foot.copy(), nominal, selector.criteria.settings.swing_height_m), False


def look(
    sim: SimRobot, data: mujoco.MjData, feet: Array, middle: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], float]:
    """Which legs (4,) meet the terrain now, which are not where they should be, and the farthest joint [rad].

    The trunk counts for all legs.

    Args:
        sim: the robot in its terrain.
        data: placed.
        feet: (4, 3) where the feet should be, world frame [m].
        middle: (4,) feet in the middle of their swings.
    """
    collided, violated, farthest = np.zeros(4, bool), np.zeros(4, bool), 0.0
    for k in range(data.ncon):
        contact = data.contact[k]
        for geom in (contact.geom1, contact.geom2):
            body = sim.model.body(sim.model.geom_bodyid[geom]).name
            leg, part = body[:2], body[3:]
            if body == "trunk" and contact.dist < -LINK_DEPTH_M:
                collided[:] = True
            elif leg in LEGS and part == "foot":
                collided[LEGS.index(leg)] |= bool(middle[LEGS.index(leg)] and contact.dist < -FOOT_DEPTH_M)
            elif leg in LEGS and contact.dist < -LINK_DEPTH_M:
                collided[LEGS.index(leg)] = True
    for leg, name in enumerate(LEGS):
        off = np.linalg.norm(data.geom(f"{name}_foot").xpos - feet[leg])
        low, high = sim.geometry.joint_limits[leg].T
        angles = data.qpos[sim.qpos[leg]]
        beyond = np.maximum(low - angles, angles - high).max()
        violated[leg] = off > _FOOT_OFF_M or beyond > _JOINT_OFF
        farthest = max(farthest, float(beyond))
    return collided, violated, farthest


def _place(sim: SimRobot, data: mujoco.MjData, origin: Array, turn: Array, feet: Array) -> None:
    angles, _ = sim.geometry.joints((feet - origin) @ turn)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    data.qpos[sim.base_qpos : sim.base_qpos + 3] = origin
    data.qpos[sim.base_qpos + 3 : sim.base_qpos + 7] = quaternion
    data.qpos[sim.qpos] = sim.joints_to_qpos(angles)
    mujoco.mj_kinematics(sim.model, data)
    mujoco.mj_comPos(sim.model, data)
    mujoco.mj_collision(sim.model, data)


def _frame(sim: SimRobot, data: mujoco.MjData) -> Posture:
    legs = np.array([[data.body(f"{name}_{part}").xpos for part in ("hip", "thigh", "knee", "foot")] for name in LEGS])
    trunk = data.body("trunk")
    half = sim.model.geom("trunk").size[0]
    ends = np.array([[-half, 0, 0], [half, 0, 0]]) @ trunk.xmat.reshape(3, 3).T + trunk.xpos
    return Posture(legs, ends)


def _ground(elevation: HeightMap, point: Array) -> float:
    i, j = np.floor((point[:2] - elevation.lower_corner) / elevation.resolution_m).astype(int)
    return float(elevation.heights[i, j])
