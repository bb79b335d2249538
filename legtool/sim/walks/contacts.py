"""What meets the terrain and should not: links, and feet in the middle of their swings, on the true state."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.simulated import SimulatedRobot
from legtool_runtime.tracking.tracker import Tracker

Array = NDArray[np.float64]

#: Contacts of one body nearer in time than this are one [s].
_APART_S = 0.15
#: A shank that touches level ground so near to its own foot's centre, in foot radii, is the ankle over a foot that has
#: sunk into MuJoCo's soft ground: no collision.
_ANKLE, _LEVEL = 2.5, 0.9
#: Phases of a swing between which a foot should touch nothing.
_MIDDLE = (0.12, 0.60)


class LinkContacts:
    """Notes contacts of trunk and links with the terrain, and of swinging feet; a :class:`.Subscriber`.

    Attributes:
        found: when [s] and which body: each time that one begins to touch.
        ankles: the same of shanks that touch the level ground on which their own foot stands.
        hits: when [s] and which leg: each swing in whose middle the foot touched; empty where no controller tells of
            swings.
    """

    def __init__(self, environment: SimulatedRobot, controller: object) -> None:
        """Look on.

        Args:
            environment: the walk.
            controller: whose tracker tells the phases of swings, if it has one.
        """
        self.found: list[tuple[float, str]] = []
        self.ankles: list[tuple[float, str]] = []
        self.hits: list[tuple[float, int]] = []
        self._data, self._model = environment.simulation.data, environment.simulation.robot.model
        self._controller = controller if isinstance(controller, (GuidedController, TrackedController)) else None
        self._body, self._foot = _parts(environment.simulation.robot)
        self._feet = [int(np.flatnonzero(self._foot == leg)[0]) for leg in range(4)]
        self._radius = environment.simulation.robot.geometry.foot_radius
        #: Whose shank a body is: the parent of the foot's body, or the foot's own where both are one.
        self._leg = np.full(self._model.nbody, -1, np.int64)
        for leg, geom in enumerate(self._feet):
            of_foot = int(self._model.geom_bodyid[geom])
            several = int((self._model.geom_bodyid == of_foot).sum()) > 1
            self._leg[of_foot if several else self._model.body_parentid[of_foot]] = leg
        self._last = np.full(self._model.nbody, -np.inf)
        self._hit = np.zeros(4, np.bool_)

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Look at MuJoCo's contacts."""
        del answer
        tracker = None if self._controller is None else self._controller.tracker
        if tracker is not None:
            self._hit &= ~tracker.contact
        if not self._data.ncon:
            return
        contacts = self._data.contact
        for k in np.flatnonzero(contacts.dist <= 0.0):
            a, b = contacts.geom[k]
            geom = a if self._body[a] >= 0 else b
            if (self._body[a] >= 0) == (self._body[b] >= 0):
                continue  # two links of the robot, or of the terrain
            leg = int(self._foot[geom])
            if leg < 0:
                body = int(self._body[geom])
                ankle = self._is_ankle(body, contacts.pos[k], contacts.frame[k, :3])
                self._note(observation.time_s, body, self.ankles if ankle else self.found)
            elif tracker is not None and not self._hit[leg] and _in_middle(tracker, leg):
                self._hit[leg] = True
                self.hits.append((observation.time_s, leg))

    def end(self) -> None:
        """Nothing to close."""

    def _is_ankle(self, body: int, place: Array, normal: Array) -> bool:
        leg = int(self._leg[body])
        if leg < 0 or abs(normal[2]) < _LEVEL:
            return False
        foot = self._data.geom_xpos[self._feet[leg]]
        return bool(np.linalg.norm(place - foot) < _ANKLE * self._radius)

    def _note(self, time_s: float, body: int, found: list[tuple[float, str]]) -> None:
        if time_s - self._last[body] > _APART_S:
            found.append((time_s, self._model.body(body).name))
        self._last[body] = time_s


def _in_middle(tracker: Tracker, leg: int) -> bool:
    return not tracker.contact[leg] and _MIDDLE[0] < tracker.phase(leg) < _MIDDLE[1]


def _parts(robot: SimRobot) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of each geom the robot's body that it belongs to, -1 for terrain; and whose foot it is, -1 for none."""
    model = robot.model
    root = model.body_rootid[model.dof_bodyid[robot.base_dof]]
    bodies = model.geom_bodyid.astype(np.int64)
    body = np.where(model.body_rootid[bodies] == root, bodies, -1)
    foot = np.full(model.ngeom, -1, np.int64)
    for leg in range(4):
        sensor = int(np.flatnonzero(model.sensor_adr == robot.force_sensor[leg])[0])
        assert model.sensor_objtype[sensor] == mujoco.mjtObj.mjOBJ_SITE
        site = int(model.sensor_objid[sensor])
        # The geom of the site's body that is nearest to the site.
        own = np.flatnonzero(bodies == model.site_bodyid[site])
        away = np.linalg.norm(model.geom_pos[own] - model.site_pos[site], axis=1)
        foot[own[np.argmin(away)]] = leg
    return body, foot
