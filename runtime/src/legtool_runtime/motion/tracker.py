"""Follow a trot by its contact forces, and keep the history that the motion models need (equation 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.errors import StateError, shown
from legtool_runtime.motion.model import INSTANTS, MotionState
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]


class StepTracker:
    """Turns the measurements of a trotting robot, in time order, into the states that a planner plans from.

    Call :meth:`update` at every measurement. While :attr:`at_instant` is true, :meth:`state` returns the state from
    which a step would start now: plan from it, and send the first command of the plan. That is as long as all feet
    stand, or, for models of states at touchdown, at the measurement at which a pair has landed. Gaits without full
    stance have that instant alone.

    :attr:`steps` counts the steps that have started: the lift-offs of a pair, or the touchdowns. :attr:`landed` tells
    whether a pair has just landed, for models of states at touchdown.

    The history in a state is that of the previous step: the velocity at the last lift-off or touchdown, and the command
    that was in force while the last pair swung. For a robot that has stood still for longer than a step, the history is
    standing.
    """

    def __init__(
        self,
        *,
        contact_on: float,
        contact_off: float,
        standing_s: float = 0.4,
        first_pair: int = 0,
        instant: str = "full_stance_end",
    ) -> None:
        """Start with a robot that is standing.

        Args:
            contact_on: force above which a foot is in contact, in the robot's own unit.
            contact_off: force below which a foot is not in contact; lower than ``contact_on``.
            standing_s: a full stance that lasts longer than this counts as standing [s].
            first_pair: index into TROT_PAIRS of the pair that swings first after a start.
            instant: the moment at which states are taken, ``bundle.motion.instant``.

        Raises:
            StateError: the thresholds are not positive or are in the wrong order; no such pair, or no such instant.
        """
        for name, value in (("contact_on", contact_on), ("contact_off", contact_off), ("standing_s", standing_s)):
            checks.number(f"step tracker: {name}", value, StateError)
        if first_pair not in (0, 1):
            raise StateError(f"step tracker: first_pair is {shown(first_pair)}, expected 0 or 1")
        if instant not in INSTANTS:
            raise StateError(f"instant is {shown(instant)}, expected {' or '.join(INSTANTS)}")
        if not 0 < contact_off < contact_on:
            raise StateError(
                f"contact_off {shown(contact_off)} and contact_on {shown(contact_on)}: expected "
                "0 < contact_off < contact_on"
            )
        self._on, self._off, self._standing_s = contact_on, contact_off, standing_s
        self._lands = instant == "touchdown"
        self._airborne: int | None = None
        self.landed = False
        self._contact = np.ones(4, dtype=np.bool_)
        self._first_pair = first_pair
        self._swung = 1 - first_pair
        self._stance_since = -np.inf
        self.steps = 0
        self._stood = False
        self._stance_velocity = np.zeros(3)
        self._previous_velocity = np.zeros(3)
        self._swing_reference = np.zeros(3)
        self._velocity = np.zeros(3)
        self._reference = np.zeros(3)
        self._feet = np.zeros((4, 3))
        self._time_s = 0.0

    def update(
        self,
        time_s: float,
        *,
        velocity: ArrayLike,
        feet_base: ArrayLike,
        contact_force: ArrayLike,
        reference: ArrayLike,
    ) -> None:
        """Process one measurement.

        Args:
            time_s: time of the measurement, increasing [s].
            velocity: (3,) CoM velocity vx, vy [m/s], yaw rate [rad/s], base frame.
            feet_base: (4, 3) feet relative to the CoM, base frame [m].
            contact_force: (4,) force on each foot, in the unit of the thresholds.
            reference: (3,) the command in force: vx, vy [m/s], yaw rate [rad/s].

        Raises:
            StateError: the time is no finite number, or something has another shape; the measurement is not taken.
        """
        time_s = checks.number("step tracker: time_s", time_s, StateError, "s")
        force = checks.numeric("step tracker: contact_force", contact_force, (4,), StateError)
        moving = checks.numeric("step tracker: velocity", velocity, (3,), StateError)
        commanded = checks.numeric("step tracker: reference", reference, (3,), StateError)
        feet = checks.numeric("step tracker: feet_base", feet_base, (4, 3), StateError)
        was_full = self.full_stance
        self._stood |= self.standing
        self._contact = np.where(self._contact, force > self._off, force > self._on)
        self.landed = False
        if self._lands and self._airborne is not None and self._contact[list(TROT_PAIRS[self._airborne])].all():
            self._land(self._airborne)
        for pair, (front, hind) in enumerate(TROT_PAIRS):
            others = int(self._contact.sum()) - self._contact[front] - self._contact[hind]
            if others == 2 and not (self._contact[front] or self._contact[hind]):
                if not self._lands:
                    self._lift(pair)
                self._airborne = pair
                self._swing_reference = commanded
        if self.full_stance and not was_full:
            self._stance_since = time_s
        self._velocity = moving
        if self.landed or self.standing or (self.full_stance and not self._lands):
            self._stance_velocity = self._velocity
        self._reference = commanded
        self._feet = feet
        self._time_s = time_s

    def _lift(self, pair: int) -> None:
        """A pair is in the air while the other stands."""
        if pair != self._swung or self._stood:
            # At lift-off, the last measurement in full stance is the state at t, the history of the next step. A single
            # foot that bounces does not lift a pair and is not a step.
            self._previous_velocity = self._stance_velocity
            self.steps += 1
        self._stood = False
        self._swung = pair

    def _land(self, pair: int) -> None:
        """Both feet of a pair stand after it was in the air. One that bounces after its touchdown lands once."""
        self._airborne = None
        if pair != self._swung or self._stood:
            self._previous_velocity = self._stance_velocity
            self.steps += 1
            self.landed = True
        self._stood = False
        self._swung = pair

    @property
    def thresholds(self) -> dict[str, float]:
        """What it was made with: ``contact_on``, ``contact_off`` and ``first_pair``."""
        return {"contact_on": self._on, "contact_off": self._off, "first_pair": self._first_pair}

    @property
    def contact(self) -> NDArray[np.bool_]:
        """(4,) whether each foot is in contact."""
        return self._contact

    @property
    def at_instant(self) -> bool:
        """Whether a state can be taken now; for a robot that stands it can at any time."""
        return (self.landed or self.standing) if self._lands else self.full_stance

    @property
    def full_stance(self) -> bool:
        """Whether all four feet are in contact."""
        return bool(self._contact.all())

    @property
    def standing(self) -> bool:
        """Whether full stance has lasted longer than it does between two steps."""
        return self.full_stance and self._time_s - self._stance_since > self._standing_s

    @property
    def swing_pair(self) -> int:
        """Index into TROT_PAIRS of the pair that is expected to swing next: the one that did not swing last."""
        return 1 - self._swung

    def state(self) -> MotionState:
        """Return the state at the latest measurement.

        Raises:
            StateError: a measurement is not finite.
        """
        return MotionState(
            velocity=self._velocity,
            previous_velocity=self._velocity if self.standing else self._previous_velocity,
            previous_reference=self._reference if self.standing else self._swing_reference,
            feet_base=self._feet,
            swing_pair=self.swing_pair,
        )
