"""A plan that comes later than the instant it was made for: joined to what the feet did meanwhile, its clock shifted.

QuadPiPS' fall on stairs was a reference that was late and a robot that leapt after it. Here a foot whose lift-off comes
before the body can have moved for it lifts off later, and all later events wait as long: no event of a plan is ever
left out or hurried.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from legtool_runtime.robot import LEGS
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance

#: Lift-offs nearer to each other than this are one [s].
_SAME_S = 1e-9


@dataclass(frozen=True, eq=False)
class Arrival:
    """A plan as it can be followed from now on.

    Attributes:
        plan: joined to what the feet have done; None where it can no longer be joined.
        shift_s: by how much its events were put off.
        reason: why it cannot be joined; empty where it can.
    """

    plan: ContactPlan | None
    shift_s: float = 0.0
    reason: str = ""


def arrive(late: ContactPlan, now: ContactPlan, clock_s: float, *, lead_s: float = 0.2) -> Arrival:
    """Join a plan that was made from an earlier state of the plan that is walked.

    Swings are known by their lift-offs, which keep their time on the plan's clock: what has landed since stays where it
    landed, and what is in the air goes where the late plan, too, wants it.

    Args:
        late: that comes now; its events until some instant are those of the plan that it was made from.
        now: that is walked, changed by what feet did (``Tracker.plan``).
        clock_s: of the plan that is walked.
        lead_s: the body is given so long before a foot lifts off that stands on by the plan that is walked.

    Returns:
        the plan to follow; none where a foot has begun a swing that the late plan does not know.
    """
    rows: list[list[Stance]] = []
    ahead, due = [], math.inf  # of each leg the first stance that is not over
    for leg, name in enumerate(LEGS):
        row = now.stances[leg]
        k = next((k for k, s in enumerate(row) if clock_s < s.end_s), len(row) - 1)
        j = _same(late.stances[leg], row, k)
        if j is None:
            return Arrival(None, reason=f"{name} has begun a swing that the late plan does not know")
        known = late.stances[leg][j]
        if row[k].begin_s <= clock_s:  # it stands where it has landed
            if abs(known.end_s - row[k].end_s) > _SAME_S:  # else the body knows of it
                due = min(due, known.end_s)
            known = replace(row[k], end_s=known.end_s)
        rows.append([*row[:k], known, *late.stances[leg][j + 1 :]])
        ahead.append(k)
    shift = max(clock_s + lead_s - due, 0.0)
    if shift > 0.0:
        rows = [_put_off(row, k, shift) for row, k in zip(rows, ahead, strict=True)]
    return Arrival(ContactPlan(rows), shift)


def _same(late: tuple[Stance, ...], row: tuple[Stance, ...], k: int) -> int | None:
    """Which stance of a late plan is the k-th of the row that is walked; None if none is."""
    if k == 0:  # what came before is forgotten, or never was
        return next((j for j, s in enumerate(late) if s.begin_s == row[0].begin_s), None)
    lifted = row[k - 1].end_s
    return next((j for j in range(1, len(late)) if abs(late[j - 1].end_s - lifted) <= _SAME_S), None)


def _put_off(row: list[Stance], ahead: int, shift_s: float) -> list[Stance]:
    """What has not happened happens later; a swing that has begun keeps its touchdown."""
    return [
        stance if k < ahead else replace(
            stance, begin_s=stance.begin_s + shift_s * (k > ahead), end_s=stance.end_s + shift_s
        )
        for k, stance in enumerate(row)
    ]  # fmt: skip
