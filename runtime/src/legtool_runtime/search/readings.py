"""What the monitor is told: taken from the tracker, the measured state, and the candidates of the last frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.search.candidates import Candidates
from legtool_runtime.search.monitor import Reading
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.tracker import MeasuredState, Tracker

Doubles = NDArray[np.float64]

#: A candidate is of the same ground as a place that is so near to it in height, and off the ground's edge [m].
_SAME_M = 0.03
#: Candidates tell of the ground as far as this from them [m].
_NEAR_M = 0.10


def take_reading(
    tracker: Tracker,
    state: MeasuredState,
    time_s: float,
    *,
    candidates: Candidates | None = None,
    frame: bool = False,
    shift_s: float = 0.0,
    final: bool = False,
    age_s: float = 0.0,
) -> Reading:
    """The reading of an instant.

    Args:
        tracker: that has run its first tick; its dynamics are those of its last one.
        state: measured now.
        time_s: by the robot's clock.
        candidates: of the last frame; None before the first.
        frame: whether they are new.
        shift_s: by how much a plan that came now was shifted.
        final: whether the plan ends where the robot is to go.
        age_s: how long ago the plan came.
    """
    plan, now, terms = tracker.plan, tracker.clock_s, tracker.terms
    off, capture, lean = np.zeros(3), np.zeros(2), np.zeros(2)
    if tracker.reference is not None:
        point = tracker.reference.at(now)
        off = terms.com - point.position
        height = max(float(terms.com[2] - terms.feet[:, 2].mean()), 0.1)
        capture = off[:2] + (terms.com_velocity - point.velocity)[:2] / math.sqrt(GRAVITY / height)
        turn = point.rotation.T @ terms.rotation  # of the body off its reference
        lean = np.array([math.atan2(turn[2, 1], turn[2, 2]), math.asin(min(max(-turn[2, 0], -1.0), 1.0))])
    answer = tracker.answer
    torques = np.zeros(12) if answer is None else answer.torques / tracker.robot.torque_limit.ravel()
    feet, places, ahead = np.empty((4, 3)), np.empty((4, 3)), set()
    for leg, row in enumerate(plan.stances):
        k = next((k for k, s in enumerate(row) if now < s.end_s), len(row) - 1)
        feet[leg] = terms.feet[leg] - tracker.robot.geometry.foot_radius * row[k].normal
        places[leg] = row[k].place
        ahead |= {s.end_s for s in row[k:-1] if s.end_s >= now}
    forces = np.asarray(state.forces, dtype=np.float64)
    return Reading(
        time_s=float(time_s),
        clock_s=float(now),
        lean=lean,
        turning=np.array(state.velocity[3:6], dtype=np.float64),
        joint_speeds=np.array(state.velocity[6:18], dtype=np.float64),
        torques=torques,
        off=off,
        capture=capture,
        speed=float(np.hypot(terms.com_velocity[0], terms.com_velocity[1])),
        position=np.array(state.position, dtype=np.float64),
        loads=np.where(np.isfinite(forces), forces, 0.0) / (tracker.robot.mass * GRAVITY),
        stands=tracker.contact.astype(np.float64),
        late=tracker.late().astype(np.float64),
        phases=np.array([tracker.phase(leg) for leg in range(4)]),
        feet=feet,
        places=places,
        margins=_margins(feet, candidates),
        seen=_seen(places, candidates if frame else None),
        shift_s=float(shift_s),
        ahead=float(len(ahead)),
        final=float(final),
        age_s=float(age_s),
    )


def _margins(places: Doubles, candidates: Candidates | None) -> Doubles:
    """(4,) how far from the edge places (4, 3) lie, at least: what candidates about them have, less the way to these.

    Where there are none, they are taken to lie beside the ground by as far as was looked for them.
    """
    if candidates is None or not len(candidates):
        return np.full(4, np.nan)
    out, points = np.full(4, -_NEAR_M), candidates.points
    for leg in range(4):
        way = np.hypot(points[:, 0] - places[leg, 0], points[:, 1] - places[leg, 1])
        near = (way <= _NEAR_M) & (np.abs(points[:, 2] - places[leg, 2]) <= _SAME_M)
        if near.any():
            out[leg] = float((candidates.margins[near] - way[near]).max())
    return out


def _seen(places: Doubles, candidates: Candidates | None) -> Doubles:
    """(4,) 1 where a place lies on ground that has candidates, 0 where not; NaN without any frame."""
    if candidates is None:
        return np.full(4, np.nan)
    return (_margins(places, candidates) >= -_SAME_M).astype(np.float64)
