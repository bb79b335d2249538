"""A film of a walk, shaded by the ray caster: terrain by label, links, where feet stood, plans and missteps.

It needs no display and no GL. What the robot did is kept while it walks; pictures are made when all is over.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.skeleton import leg_points
from legtool.sim.walks.environment import Answer, Observation, PlannedContacts
from legtool.sim.walks.missteps import LOADED, Missteps
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.worlds.labels import label_image
from legtool.sim.worlds.raycast import Primitive, Scene, box, camera_pose, capsule, cast, cylinder, sphere
from legtool.sim.worlds.world import World
from legtool_runtime.cache import kernel
from legtool_runtime.perception import LABELS
from legtool_runtime.perception.camera import Camera
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Frames per second of simulated time, and the size of each [pixel].
RATE_HZ, WIDTH, HEIGHT = 16, 400, 300
#: Where the camera is, in standing heights behind, to the right of and above the trunk, and its horizontal view [rad].
_FROM, _VIEW = (-1.6, -3.4, 1.9), 0.9
#: The camera follows the trunk with this delay [s].
_LAG_S = 0.5
_TRUNK, _LEFT, _RIGHT = (55, 65, 81), (31, 95, 168), (196, 81, 28)
_PLANNED, _MISSTEP, _SKY, _PIT = (43, 125, 79), (180, 35, 47), (232, 238, 245), (74, 78, 86)
#: Of unknown, steppable, passable and non-passable terrain.
_TERRAIN = np.array([(150, 150, 150), (202, 208, 198), (214, 188, 128), (200, 140, 130)], dtype=np.float32)
assert len(_TERRAIN) == len(LABELS)
_SIDES = (_LEFT, _RIGHT, _LEFT, _RIGHT)
#: Towards the light, in the camera's optical frame, and the share of light that comes from everywhere.
_LIGHT, _AMBIENT = np.array([-0.42, -0.8, -0.43]), 0.45
#: Links shorter than this are not drawn [m].
_SHORTEST_M = 1e-3
#: Footholds of a contact plan are shown for so long before they are due [s].
_AHEAD_S = 3.0
#: Radius of the marks of feet, in foot radii, and how far they stand out of the ground [m].
_MARK, _THICK = 1.2, 0.004


class _Moment(NamedTuple):
    time_s: float
    position: Array
    rotation: Array
    joints: Array
    planned: Array


class Film:
    """Keeps what a film shows; a :class:`.Subscriber`."""

    def __init__(self, environment: SimulatedRobot, missteps: Missteps, planner: object) -> None:
        """Look on.

        Args:
            environment: the walk.
            missteps: marked where they happen.
            planner: whose ``plan``, if it makes one, shows where feet are to go; the answers of one that plans
                contacts do.
        """
        assert environment.world is not None
        self._environment, self._missteps, self._planner = environment, missteps, planner
        self._world = environment.world
        self.rate_hz = RATE_HZ
        self._every = CONTROL_RATE_HZ // RATE_HZ
        self._loaded = LOADED * environment.simulation.robot.mass * GRAVITY
        self._stood = np.ones(4, dtype=np.bool_)
        self._moments: list[_Moment] = []
        self._prints: list[tuple[float, Array, int]] = []

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Keep the true pose at the film's rate, and a mark where a foot comes to stand."""
        simulation = self._environment.simulation
        if (simulation.tick - 1) % self._every:
            return
        feet, forces = self._environment.feet()
        stands = forces > self._loaded
        for leg in np.flatnonzero(stands & ~self._stood):
            self._prints.append((observation.time_s, feet[leg], int(leg)))
        self._stood = stands
        robot, data = simulation.robot, simulation.data
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        planned = self._planned(observation.time_s, answer)
        joints = robot.joint_sign * data.qpos[robot.qpos] + robot.joint_offset
        self._moments.append(_Moment(observation.time_s, base[:3].copy(), rotation_of(base[3:]), joints, planned))

    def end(self) -> None:
        """Nothing to close."""

    def _planned(self, time_s: float, answer: Answer) -> Array:
        """(n, 3) where feet are to come to stand, of a contact plan within the next seconds."""
        if isinstance(answer, PlannedContacts):
            stances = [stance for leg in answer.plan.stances for stance in leg]
            ahead = [stance.place for stance in stances if time_s < stance.begin_s < time_s + _AHEAD_S]
            return np.array(ahead).reshape(-1, 3)
        plan = getattr(self._planner, "plan", None)
        return np.zeros((0, 3)) if plan is None else plan.touchdowns.reshape(-1, 3).copy()

    def frames(self, *, swing_height_max: float) -> Iterator[Image]:
        """(h, w, 3) red, green, blue, one at each 1 / RATE_HZ seconds.

        Args:
            swing_height_max: by which terrain is labelled [m].
        """
        world, robot = self._world, self._environment.simulation.robot.geometry
        camera = Camera.from_field_of_view(WIDTH, HEIGHT, _VIEW)
        keep = np.exp(-1.0 / (RATE_HZ * _LAG_S))
        at = None if not self._moments else self._moments[0].position.copy()
        for moment in self._moments:
            at = keep * at + (1.0 - keep) * moment.position
            pose = _camera(at, float(world.start[2]), robot.standing_height)
            yield _shade(world, self._things(moment, robot), camera, pose, swing_height_max)

    def _things(self, moment: _Moment, robot: Robot) -> list[tuple[Primitive, tuple[int, int, int]]]:
        things = robot_parts(robot, moment.position, moment.rotation, moment.joints)
        radius, flat = _MARK * robot.foot_radius, np.eye(3)
        for time_s, place, leg in self._prints:
            if time_s <= moment.time_s:
                things.append((cylinder(place, flat, radius, _THICK), _SIDES[leg]))
        for place in moment.planned:
            at = (place[0], place[1], float(self._world.height(place[0], place[1])))
            things.append((cylinder(at, flat, 0.7 * radius, 2 * _THICK), _PLANNED))
        for time_s, x, y, _ in self._missteps.found:
            if time_s <= moment.time_s:
                z = float(self._world.height(x, y))
                things.append((sphere((x, y, z), 1.5 * radius), _MISSTEP))
        return things


def robot_parts(
    robot: Robot, position: Array, rotation: Array, joints: Array
) -> list[tuple[Primitive, tuple[int, int, int]]]:
    """Trunk, links and feet as primitives with their colours.

    Args:
        robot: lengths.
        position: (3,) of the base, world frame [m].
        rotation: (3, 3) base to world.
        joints: (4, 3) [rad].
    """
    x, y, _ = np.abs(robot.hips).max(axis=0)
    half = (float(x) + 0.05, float(y) + 0.03, 0.12 * robot.standing_height)
    parts = [(box(position, rotation, half), _TRUNK)]
    chain = np.stack([robot.hips, *leg_points(robot, joints)], axis=1) @ rotation.T + position
    for leg, points in enumerate(chain):
        for k, radius in enumerate((0.9, 1.1, 0.7)):
            if np.linalg.norm(points[k + 1] - points[k]) < _SHORTEST_M:
                continue  # no offset between abduction and thigh axis
            parts.append((_link(points[k], points[k + 1], radius * robot.foot_radius), _SIDES[leg]))
        parts.append((sphere(points[3], robot.foot_radius), _TRUNK))
    return parts


def _link(start: Array, end: Array, radius: float) -> Primitive:
    """A capsule between two joints."""
    along = end - start
    length = float(np.linalg.norm(along))
    z = along / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, [0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return capsule(0.5 * (start + end), np.stack([x, np.cross(z, x), z], axis=1), radius, 0.5 * length)


def _camera(at: Array, yaw: float, height: float) -> Array:
    """(4, 4) optical frame to world of a camera that looks at the trunk from behind its right side."""
    c, s = np.cos(yaw), np.sin(yaw)
    back, side, up = (height * share for share in _FROM)
    offset = np.array([c * back - s * side, s * back + c * side, up])
    pitch = float(np.arctan2(up + 0.35 * height, np.hypot(back, side)))
    return camera_pose(at + offset, pitch=pitch, yaw=float(np.arctan2(-offset[1], -offset[0])))


def _shade(
    world: World,
    things: Sequence[tuple[Primitive, tuple[int, int, int]]],
    camera: Camera,
    pose: ArrayLike,
    swing_height_max: float,
) -> Image:
    terrain, n = world.scene, len(world.scene.kinds)
    others = Scene.of([thing for thing, _ in things])
    whole = Scene(
        np.concatenate([terrain.kinds, others.kinds]),
        np.concatenate([terrain.sizes, others.sizes]),
        np.concatenate([terrain.positions, others.positions]),
        np.concatenate([terrain.rotations, others.rotations]),
        terrain.surface,
    )
    seen = cast(whole, camera, pose)
    # The number of a surface follows those of all primitives: give terrain its own numbers back.
    is_thing = (seen.geom >= n) & (seen.geom < len(whole.kinds))
    geom = np.where(is_thing, -1, np.minimum(seen.geom, n)).astype(np.int32)
    label = label_image(world, seen._replace(geom=geom), camera, pose, swing_height_max=swing_height_max)
    colours = np.array([colour for _, colour in things], dtype=np.float32).reshape(-1, 3)
    # The light comes from behind the camera's left shoulder.
    light = (np.asarray(pose)[:3, :3] @ _LIGHT).astype(np.float32)
    picture = np.empty((*geom.shape, 3), dtype=np.uint8)
    _paint(seen.geom, geom, label, seen.normal, world.ground, colours, n, light, picture)
    return picture


@kernel
def _paint(
    seen: NDArray[np.int32],
    terrain: NDArray[np.int32],
    label: NDArray[np.uint8],
    normal: NDArray[np.float32],
    ground: NDArray[np.bool_],
    colours: NDArray[np.float32],
    first: int,
    light: NDArray[np.float32],
    picture: Image,
) -> None:
    """Colour each pixel: sky, a thing by its own colour, terrain by label or as a pit, in the light."""
    for v in range(seen.shape[0]):
        for u in range(seen.shape[1]):
            n = normal[v, u]
            shade = _AMBIENT + (1.0 - _AMBIENT) * max(0.0, n[0] * light[0] + n[1] * light[1] + n[2] * light[2])
            for k in range(3):
                if seen[v, u] < 0:
                    picture[v, u, k] = _SKY[k]
                elif terrain[v, u] < 0:
                    picture[v, u, k] = np.uint8(shade * colours[seen[v, u] - first, k])
                elif not ground[terrain[v, u]]:
                    picture[v, u, k] = np.uint8(shade * _PIT[k])
                else:
                    picture[v, u, k] = np.uint8(shade * _TERRAIN[label[v, u], k])
