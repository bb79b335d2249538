"""Monitoring of a walk by contact plans (QuadPiPS, section VII-A): what is measured, in; what happened, out.

A state machine without a clock of its own: :func:`watch` takes the state that it gave before, one :class:`Reading` and
the limits, and returns the next state and a :class:`Verdict`. The same readings give the same verdicts, so that a walk
is judged again from its recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from enum import Enum, IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import PlannerError
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.search.settings import size_of

Doubles = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Event(str, Enum):
    """What a walk is watched for; as text it is its value, as of Python's own StrEnum, which 3.10 does not have."""

    __str__ = str.__str__
    __format__ = str.__format__  # type: ignore[assignment]  # as typeshed has it, without its own name

    FINISHED = "finished"
    TILT = "tilt"
    RATES = "rates"
    TORQUE = "torque"
    TORSO_OFF = "torso_off"
    FOOT_OFF = "foot_off"
    EARLY = "early"
    LATE = "late"
    SLIP = "slip"
    REGION_LOST = "region_lost"
    LATE_PLAN = "late_plan"
    STARVED = "starved"


class Reaction(IntEnum):
    """What the robot is to do, the mildest first.

    GO_ON: it is answered already, by the tracker, by the shift of a plan, or by a plan that ends in a stand. REPLAN:
    plan now, not at the next image. HOLD: land what is in the air, lift nothing, and plan again once the torso is over
    its feet. STAND: for good.
    """

    GO_ON = 0
    REPLAN = 1
    HOLD = 2
    STAND = 3


class Phase(IntEnum):
    """Of the monitored walk: it goes on, the robot stops at the next full stance, or it stands for good."""

    WALKING = 0
    HOLDING = 1
    STANDING = 2


class _Rule(NamedTuple):
    """An event, the name of the setting that says how long its condition has to last, and what is done then."""

    event: Event
    lasts: str
    reaction: Reaction


#: In the order of the rows of conditions.
_RULES = (
    _Rule(Event.FINISHED, "loaded_s", Reaction.REPLAN),
    _Rule(Event.TILT, "tilt_s", Reaction.HOLD),
    _Rule(Event.TILT, "at_once_s", Reaction.HOLD),
    _Rule(Event.RATES, "rates_s", Reaction.HOLD),
    _Rule(Event.TORQUE, "torque_s", Reaction.HOLD),
    _Rule(Event.TORSO_OFF, "torso_s", Reaction.REPLAN),
    _Rule(Event.FOOT_OFF, "at_once_s", Reaction.REPLAN),
    _Rule(Event.EARLY, "at_once_s", Reaction.REPLAN),
    _Rule(Event.LATE, "late_s", Reaction.GO_ON),
    _Rule(Event.LATE, "lost_s", Reaction.HOLD),
    _Rule(Event.SLIP, "slip_s", Reaction.HOLD),
    _Rule(Event.REGION_LOST, "at_once_s", Reaction.REPLAN),
    _Rule(Event.LATE_PLAN, "at_once_s", Reaction.GO_ON),
    _Rule(Event.STARVED, "at_once_s", Reaction.GO_ON),
)
_SLIP = next(k for k, rule in enumerate(_RULES) if rule.event == Event.SLIP)
#: Times are compared to within this [s].
_TINY_S = 1e-9
#: The stage of planning or walking that an event speaks against; none for those of a walk that goes as it should.
CAUSES = {
    Event.TILT: "tracking", Event.RATES: "tracking", Event.TORQUE: "tracking", Event.TORSO_OFF: "tracking",
    Event.FOOT_OFF: "tracking", Event.LATE: "tracking", Event.SLIP: "tracking", Event.REGION_LOST: "perception",
    Event.STARVED: "search",
}  # fmt: skip


@dataclass(frozen=True)
class MonitorSettings:
    """Limits of a walk; :meth:`of` scales them to a robot.

    Attributes:
        tilt, tilt_s: roll or pitch off the body's reference [rad], for so long [s].
        tilt_at_once: the same, at once [rad].
        turning: of the base [rad/s], for ``rates_s``.
        joint_speed: of any joint [rad/s], for ``rates_s``.
        torque, torque_s: of any joint, as a share of its limit, for so long [s].
        torso_xy, torso_z, torso_s: centre of mass off its reference [m], for so long [s].
        foot_off: a touchdown farther from its place [m],
        margin: and nearer to an edge [m].
        early_phase: a swing that bears load before this phase
        early_load: of so much of the weight has touched down early.
        late_s: a foot without load so long after its touchdown is late [s],
        lost_s: and one that searches for the ground for so long stops the robot [s].
        slip, slip_s: a loaded foot that has moved from where it came to stand [m], for so long [s].
        load: a foot bears load from this share of the weight on.
        lost_frames: a place to step on is lost after so many frames without a candidate there.
        tick_s: a plan that comes later than this after its start is late [s].
        starved_s: without a new plan for so long, at the last but one full stance [s].
        pushed: a robot whose c + v/ω is off its reference by more steps on, as only feet that go on could catch it [m].
        finished: the torso is so near to its reference at the end of a plan [m], with all feet loaded for ``loaded_s``.
        loaded_s: a foot that has been loaded for so long has come to stand; a touchdown told by a small force may be
            early by centimetres [s].
        settle_s: how long the torso may take to come over its feet before the robot walks on [s].
        settled: speed of the centre of mass at which it has come to rest [m/s].
        aborts: after so many holds
        within: so near to each other [m] the way is avoided,
        give_up: and after so many the robot stands for good.
    """

    tilt: float = 0.25
    tilt_s: float = 0.05
    tilt_at_once: float = 0.45
    turning: float = 3.0
    joint_speed: float = 20.0
    rates_s: float = 0.03
    torque: float = 0.98
    torque_s: float = 0.10
    torso_xy: float = 0.12
    torso_z: float = 0.08
    torso_s: float = 0.02
    foot_off: float = 0.04
    margin: float = 0.01
    early_phase: float = 0.80
    early_load: float = 0.075
    late_s: float = 0.06
    lost_s: float = 0.30
    slip: float = 0.03
    slip_s: float = 0.02
    load: float = 0.05
    lost_frames: int = 3
    tick_s: float = 0.005
    starved_s: float = 0.5
    pushed: float = 0.07
    finished: float = 0.10
    loaded_s: float = 0.05
    settle_s: float = 0.6
    settled: float = 0.10
    aborts: int = 3
    within: float = 0.3
    give_up: int = 5

    def __post_init__(self) -> None:
        bounds: dict[str, Bounds] = {}
        for field in fields(self):
            whole = field.type == "int"
            bounds[field.name] = Bounds(1, 1000) if whole else Bounds(0.0, 1000.0, above=True)
        within("monitor", self, bounds, PlannerError)

    @classmethod
    def of(cls, robot: Robot) -> MonitorSettings:
        """The limits for a robot: lengths go with its size, speeds and rates with the root of it (ANYmal C's is 1)."""
        size, usual = size_of(robot), cls()
        pace = math.sqrt(size)
        lengths = ("torso_xy", "torso_z", "foot_off", "slip", "pushed", "finished", "within")
        changed = {name: size * getattr(usual, name) for name in lengths}
        return replace(
            usual, **changed, turning=usual.turning / pace, joint_speed=usual.joint_speed / pace,
            settled=usual.settled * pace,
        )  # fmt: skip

    @property
    def at_once_s(self) -> float:
        """How long what is told at once has to last [s]."""
        return 0.0


class Reading(NamedTuple):
    """What the monitor is told at an instant, world frame.

    Attributes:
        time_s: by the robot's clock [s].
        clock_s: of the plan [s].
        lean: (2,) roll and pitch off the body's reference [rad].
        turning: (3,) angular velocity of the base, base frame [rad/s].
        joint_speeds: (12,) [rad/s].
        torques: (12,) as shares of their limits.
        off: (3,) centre of mass off its reference [m].
        capture: (2,) c + v/ω, where the body would come to rest, off the same of its reference [m].
        speed: of the centre of mass, horizontal [m/s].
        position: (3,) of the base [m].
        loads: (4,) normal forces as shares of the weight.
        stands: (4,) 1 for feet that stand by the tracker.
        late: (4,) 1 for feet that should stand and do not.
        phases: (4,) of the swings, 0 for feet that stand.
        feet: (4, 3) contact points as measured [m].
        places: (4, 3) where the feet stand or go to stand by the plan [m].
        margins: (4,) distance from the edge at the contact points, at least; NaN where nothing is known [m].
        seen: (4,) of a new frame: 1 where the place that a foot goes to has a candidate, 0 where not; NaN: no frame.
        shift_s: by how much a plan that came now was shifted, as it was late; 0 where none was [s].
        ahead: lift-offs of the plan that are still ahead.
        final: 1 where the plan ends where the robot is to go.
        age_s: how long ago the plan came [s].
    """

    time_s: float
    clock_s: float
    lean: Doubles
    turning: Doubles
    joint_speeds: Doubles
    torques: Doubles
    off: Doubles
    capture: Doubles
    speed: float
    position: Doubles
    loads: Doubles
    stands: Doubles
    late: Doubles
    phases: Doubles
    feet: Doubles
    places: Doubles
    margins: Doubles
    seen: Doubles
    shift_s: float
    ahead: float
    final: float
    age_s: float

    def row(self) -> Doubles:
        """(:data:`COLUMNS`,) all values in order."""
        return np.concatenate([np.ravel(value) for value in self]).astype(np.float64)

    @classmethod
    def of_row(cls, row: ArrayLike) -> Reading:
        """The reading of a row.

        Raises:
            PlannerError: a row of another length.
        """
        values = np.asarray(row, dtype=np.float64)
        if values.shape != (COLUMNS,):
            raise PlannerError(f"monitor: a reading of shape {values.shape}, expected ({COLUMNS},)")
        parts: list[Any] = []
        at = 0
        for shape in _SHAPES.values():
            size = math.prod(shape)
            part = values[at : at + size]
            parts.append(part.reshape(shape).copy() if shape else float(part[0]))
            at += size
        return cls(*parts)


_SHAPES: dict[str, tuple[int, ...]] = {
    "time_s": (), "clock_s": (), "lean": (2,), "turning": (3,), "joint_speeds": (12,), "torques": (12,), "off": (3,),
    "capture": (2,), "speed": (), "position": (3,), "loads": (4,), "stands": (4,), "late": (4,), "phases": (4,),
    "feet": (4, 3), "places": (4, 3), "margins": (4,), "seen": (4,), "shift_s": (), "ahead": (), "final": (),
    "age_s": (),
}  # fmt: skip
#: What the values of a row are called.
NAMES = tuple(
    name if not shape else f"{name}_{k}" for name, shape in _SHAPES.items() for k in range(math.prod(shape) or 1)
)
#: How many there are.
COLUMNS = len(NAMES)


@dataclass(frozen=True, eq=False)
class MonitorState:
    """All that the monitor remembers; a copy of it is a copy of the monitor.

    Attributes:
        phase: of the walk.
        time_s: of the last reading; NaN before the first.
        since_s: (rules, 4) when the condition of each rule became true, by leg, NaN where it is not; of what concerns
            the whole robot in the first column.
        told: (rules, 4) whether it has been told of since it began.
        stands: (4,) of the last reading.
        phases: (4,) of the last reading.
        places: (4, 3) where each foot went to stand, as of the last reading in which it was in the air.
        loaded_s: (4,) how long each standing foot has been loaded [s].
        stood: (4, 3) where each foot came to stand, or slipped to; NaN where that was not seen, or not yet.
        gone: (4,) frames in a row without a candidate.
        full_s: how long all feet have been loaded while the robot holds [s].
        holds: (k, 3) where it was stopped before, the last ones.
    """

    phase: Phase
    time_s: float
    since_s: Doubles
    told: Bools
    stands: Bools
    phases: Doubles
    places: Doubles
    loaded_s: Doubles
    stood: Doubles
    gone: NDArray[np.int64]
    full_s: float
    holds: Doubles

    @classmethod
    def begin(cls) -> MonitorState:
        """Of a robot that stands."""
        n = len(_RULES)
        nowhere = np.full((4, 3), np.nan)
        return cls(
            Phase.WALKING, math.nan, np.full((n, 4), np.nan), np.zeros((n, 4), bool), np.ones(4, bool), np.zeros(4),
            nowhere, np.full(4, np.inf), nowhere.copy(), np.zeros(4, np.int64), 0.0, np.zeros((0, 3)),
        )  # fmt: skip


@dataclass(frozen=True)
class Verdict:
    """What a reading comes to.

    Attributes:
        events: that begin with it, in the order of :class:`Event`.
        reaction: the strongest that they ask for.
        phase: of the walk from now on.
        reason: what happened, in one line; empty where nothing did.
        avoid: whether the way that is walked has stopped the robot so often that another should be taken.
        resumed: whether the robot, stopped before, may walk on.
    """

    events: tuple[Event, ...] = ()
    reaction: Reaction = Reaction.GO_ON
    phase: Phase = Phase.WALKING
    reason: str = ""
    avoid: bool = False
    resumed: bool = False


def watch(
    state: MonitorState, reading: Reading, settings: MonitorSettings | None = None
) -> tuple[MonitorState, Verdict]:
    """One reading more.

    Args:
        state: that the last reading left, :meth:`MonitorState.begin` before the first.
        reading: of now.
        settings: limits of the walk.

    Returns:
        the next state, and what is to be done.
    """
    s = settings or MonitorSettings()
    dt = reading.time_s - state.time_s if math.isfinite(state.time_s) else 0.0
    stands = reading.stands > 0.5
    loaded_s = np.where(stands & (reading.loads > s.load), state.loaded_s + dt, np.where(stands, state.loaded_s, 0.0))
    settled = stands & (state.loaded_s < s.loaded_s - _TINY_S) & (loaded_s >= s.loaded_s - _TINY_S)
    stood = np.where(settled[:, None], reading.feet, np.where(stands[:, None], state.stood, np.nan))
    seen = np.isfinite(reading.seen)
    gone = np.where(seen, np.where(reading.seen > 0.5, 0, state.gone + 1), state.gone)
    gone = np.where(stands, 0, gone)
    true = _conditions(state, reading, s, settled=settled, stood=stood, gone=gone)
    since = np.where(true, np.where(np.isnan(state.since_s), reading.time_s, state.since_s), np.nan)
    needs = np.array([getattr(s, rule.lasts) for rule in _RULES])
    fires = true & ~state.told & (reading.time_s - since >= needs[:, None] - _TINY_S)
    told = (state.told | fires) & true
    # A foot that has slipped stands where it is now: else noise about the limit would tell of one slip again and again.
    stood = np.where(fires[_SLIP][:, None], reading.feet, stood)
    new = replace(
        state, time_s=reading.time_s, since_s=since, told=told, stands=stands, phases=reading.phases.copy(),
        places=np.where(stands[:, None], state.places, reading.places), loaded_s=loaded_s, stood=stood, gone=gone,
    )  # fmt: skip
    found = [rule for rule, row in zip(_RULES, fires, strict=True) if row.any()]
    events = tuple(dict.fromkeys(rule.event for rule in found))
    reason = "; ".join(_words(rule, row) for rule, row in zip(_RULES, fires, strict=True) if row.any())
    if state.phase == Phase.STANDING:
        return new, Verdict(events, Reaction.STAND, Phase.STANDING, reason)
    if state.phase == Phase.HOLDING:
        return _held(new, reading, s, dt, events, reason)
    reaction = max((rule.reaction for rule in found), default=Reaction.GO_ON)
    if reaction == Reaction.HOLD and float(np.hypot(*reading.capture)) > s.pushed:
        reaction = Reaction.REPLAN  # only feet that go on could catch it
    if reaction < Reaction.HOLD:
        return new, Verdict(events, reaction, Phase.WALKING, reason)
    return _hold(new, reading, s, events, reason)


def _conditions(
    state: MonitorState, r: Reading, s: MonitorSettings, *, settled: Bools, stood: Doubles, gone: NDArray[np.int64]
) -> Bools:
    """(rules, 4) which conditions hold; of what concerns the whole robot in the first column."""
    loaded, stands = r.loads > s.load, r.stands > 0.5
    whole = np.zeros((len(_RULES), 4), bool)
    lean, off = float(np.abs(r.lean).max()), float(np.hypot(r.off[0], r.off[1]))
    whole[0, 0] = r.ahead == 0 and bool(stands.all() and loaded.all()) and off <= s.finished
    whole[1, 0], whole[2, 0] = s.tilt < lean <= s.tilt_at_once, lean > s.tilt_at_once
    whole[3, 0] = np.linalg.norm(r.turning) > s.turning or np.abs(r.joint_speeds).max() > s.joint_speed
    whole[4] = (np.abs(r.torques.reshape(4, 3)) > s.torque).any(axis=1)
    whole[5, 0] = off > s.torso_xy or abs(float(r.off[2])) > s.torso_z
    missed = np.hypot(*(r.feet - state.places)[:, :2].T) > s.foot_off
    whole[6] = settled & missed & (r.margins < s.margin)
    early = ~stands & (r.phases > 0.25) & (r.phases < s.early_phase) & (r.loads > s.early_load)
    whole[7] = early | (stands & ~state.stands & (state.phases < s.early_phase) & (state.phases > 0.0))
    whole[8] = whole[9] = r.late > 0.5
    moved = np.hypot(*(r.feet - stood)[:, :2].T)
    whole[10] = stands & loaded & (moved > s.slip)
    whole[11] = ~stands & (gone >= s.lost_frames)
    whole[12, 0] = r.shift_s > s.tick_s
    whole[13, 0] = r.ahead <= 1 and r.final < 0.5 and r.age_s > s.starved_s and not _idle(r)
    return whole


def _idle(r: Reading) -> bool:
    """Whether the plan has been walked to its end: nothing is left that could be stopped."""
    return r.ahead == 0 and bool((r.stands > 0.5).all())


def _hold(
    state: MonitorState, r: Reading, s: MonitorSettings, events: tuple[Event, ...], reason: str
) -> tuple[MonitorState, Verdict]:
    """Stop at the next full stance; for good where that has happened too often at one place."""
    holds = np.concatenate([state.holds, r.position[None]])[-s.give_up :]
    near = int((np.hypot(*(holds - r.position)[:, :2].T) <= s.within).sum())
    if near >= s.give_up:
        why = f"{reason}; stopped {near} times within {s.within:.2f} m"
        new = replace(state, phase=Phase.STANDING, holds=holds)
        return new, Verdict(events, Reaction.STAND, Phase.STANDING, why, avoid=True)
    new = replace(state, phase=Phase.HOLDING, full_s=0.0, holds=holds)
    return new, Verdict(events, Reaction.HOLD, Phase.HOLDING, reason, avoid=near >= s.aborts)


def _held(
    state: MonitorState, r: Reading, s: MonitorSettings, dt: float, events: tuple[Event, ...], reason: str
) -> tuple[MonitorState, Verdict]:
    """A robot that is to stand: it walks on when its torso rests over its feet, or has had its time to."""
    full = bool((r.stands > 0.5).all() and (r.loads > s.load).all())
    full_s = state.full_s + dt if full else 0.0
    rests = full_s >= s.loaded_s and r.speed <= s.settled and float(np.hypot(*r.off[:2])) <= s.finished
    if rests or full_s >= s.settle_s:
        new = replace(state, phase=Phase.WALKING, full_s=0.0)
        return new, Verdict(events, Reaction.REPLAN, Phase.WALKING, reason, resumed=True)
    return replace(state, full_s=full_s), Verdict(events, Reaction.HOLD, Phase.HOLDING, reason)


#: What is said of an event.
_SAID = {
    Event.FINISHED: "the plan is walked", Event.TILT: "the body tilts off its reference",
    Event.RATES: "the body or a joint turns too fast", Event.TORQUE: "torques at their limits:",
    Event.TORSO_OFF: "the torso is off its reference", Event.FOOT_OFF: "landed off its place and near an edge:",
    Event.EARLY: "touched down early:", Event.LATE: "found no ground in time:", Event.SLIP: "slips:",
    Event.REGION_LOST: "no candidate any more where it goes to stand:", Event.LATE_PLAN: "the plan came late",
    Event.STARVED: "no new plan at the last but one full stance",
}  # fmt: skip


def _words(rule: _Rule, legs: Bools) -> str:
    said = _SAID[rule.event]
    return said if not said.endswith(":") else f"{said} {', '.join(np.array(LEGS)[legs])}"
