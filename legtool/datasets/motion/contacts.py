"""Detect which feet stand: from contact forces with hysteresis, or from foot kinematics if there are no forces.

In either case each leg has one load signal, which is high in contact, with an upper and a lower threshold. Both are
scaled to the recording itself, because force sensors differ in offset and unit, and robots differ in speed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.motion import TransitionSettings
from legtool.datasets.logs.recording import Recording
from legtool_runtime.cache import kernel
from legtool_runtime.robot import TROT_PAIRS
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]

#: Percentiles that represent an unloaded and a loaded foot, free of spikes and impacts.
_UNLOADED, _LOADED = 2.0, 90.0
#: Without forces, a foot stands if it is slower than this share of its swing speed and its pair is lower than this
#: share of its swing height. Both are half way, on a logarithmic scale, between stance and swing on the real Go2.
_SPEED_SHARE, _HEIGHT_SHARE = 0.2, 0.3
#: The lower threshold of the kinematic load, in units of the upper one.
_KINEMATIC_RELEASE = 1.6


class Scale(NamedTuple):
    """Thresholds of one recording's load signals.

    Attributes:
        on: (4,) load above which a foot is in contact.
        off: (4,) load below which it is not.
        speed: speed threshold of a foot [m/s]; used where there are no forces.
        height: height threshold of a pair above the other [m]; used where there are no forces.
    """

    on: Array
    off: Array
    speed: float
    height: float


def calibrate(rows: Recording, settings: TransitionSettings) -> Scale:
    """Derive the thresholds from a stretch of walking.

    Args:
        rows: sampled rows, some of them walking.
        settings: the shares of the range.

    Returns:
        Thresholds for :func:`load_signal`.
    """
    if rows.contact_force is not None:
        low, high = np.percentile(rows.contact_force, [_UNLOADED, _LOADED], axis=0)
        low = np.where(low > 0.5 * high, 0.0, low)  # this foot never swung: an unloaded sensor should read nothing
        on, off = (low + share * (high - low) for share in (settings.contact_on, settings.contact_off))
        return Scale(on, off, 1.0, 1.0)
    speed = float(np.percentile(_foot_speed(rows), 95.0)) * _SPEED_SHARE
    height = float(np.percentile(np.abs(_pair_height(rows)), 95.0)) * _HEIGHT_SHARE
    return Scale(np.full(4, -1.0), np.full(4, -_KINEMATIC_RELEASE), max(speed, 1e-6), max(height, 1e-6))


def load_signal(rows: Recording, scale: Scale) -> Array:
    """Return the signal (n, 4) that is compared with the thresholds to detect contact.

    It is the contact force if there is one. Otherwise it is the negated larger value of the foot speed in the world
    and the height of the foot's pair above the plane of the other pair, each in units of its threshold.
    """
    if rows.contact_force is not None:
        return np.ascontiguousarray(rows.contact_force)
    height = _pair_height(rows) / scale.height
    raised = np.empty((len(rows), 4))
    for sign, pair in zip((1.0, -1.0), TROT_PAIRS, strict=True):
        raised[:, pair] = sign * height[:, None]
    return -np.maximum(_foot_speed(rows) / scale.speed, raised)


def feet_world(rows: Recording) -> Array:
    """Return the feet in the world frame: (n, 4, 3) [m]."""
    rotation = rotation_of(rows.orientation)
    return rows.position_world[:, None] + np.einsum("nij,nkj->nki", rotation, rows.feet_base)


def _foot_speed(rows: Recording) -> Array:
    """Speed of the feet in the world by central differences, one-sided at the ends: (n, 4) [m/s]."""
    n = len(rows)
    if n < 2:
        return np.zeros((n, 4))
    feet = feet_world(rows)
    after, before = np.minimum(np.arange(n) + 1, n - 1), np.maximum(np.arange(n) - 1, 0)
    seconds = (rows.stamps_ns[after] - rows.stamps_ns[before]) * 1e-9
    return np.linalg.norm(feet[after] - feet[before], axis=2) / seconds[:, None]


def _pair_height(rows: Recording) -> Array:
    """Mean height of the first trot pair above that of the second: (n,) [m].

    The diagonals of the stance rectangle share their centre, so that neither a slope nor a constant error of the
    attitude affects this difference; only feet that leave the common plane do.
    """
    z = feet_world(rows)[:, :, 2]
    first, second = (z[:, pair].mean(axis=1) for pair in TROT_PAIRS)
    return first - second


class ContactState:
    """Contact of the four feet, carried from one stretch of rows to the next."""

    def __init__(self) -> None:
        self._contact = np.full(4, -1, dtype=np.int8)  # -1: not known yet
        self._candidate = np.full(4, -1, dtype=np.int64)
        self._candidate_ns = np.zeros(4, dtype=np.int64)

    @property
    def settled(self) -> bool:
        """Whether no change of contact is pending."""
        return bool((self._candidate < 0).all())

    def initial(self, load: Array, scale: Scale) -> NDArray[np.int8]:
        """Set contact from a first row's load (4,) and return it: (4,) of 0 and 1."""
        self._contact[:] = load > 0.5 * (scale.on + scale.off)
        return self._contact.copy()

    def edges(
        self, load: Array, stamps_ns: NDArray[np.int64], start: int, *, scale: Scale, hold_s: float
    ) -> NDArray[np.int64]:
        """Find changes of contact that persist.

        Args:
            load: (n, 4) from :func:`load_signal`.
            stamps_ns: (n,) of the same rows [ns].
            start: absolute number of the first of these rows.
            scale: thresholds.
            hold_s: a change counts, from the row where it began, once it has persisted for this long [s].

        Returns:
            (m, 3) absolute row number, leg, and 1 for touchdown or 0 for lift-off; in the order of row numbers.
        """
        found = np.empty((load.shape[0] * 4, 3), dtype=np.int64)
        hold_ns = round(hold_s * 1e9)
        count = _edges(
            load, stamps_ns, start, scale.on, scale.off, hold_ns,
            self._contact, self._candidate, self._candidate_ns, found,
        )  # fmt: skip
        return found[:count]


@kernel
def _edges(
    load: Array,
    stamps: NDArray[np.int64],
    start: int,
    on: Array,
    off: Array,
    hold: int,
    contact: NDArray[np.int8],
    candidate: NDArray[np.int64],
    candidate_ns: NDArray[np.int64],
    found: NDArray[np.int64],
) -> int:
    count = 0
    for i in range(load.shape[0]):
        for leg in range(4):
            crossed = load[i, leg] < off[leg] if contact[leg] == 1 else load[i, leg] > on[leg]
            if not crossed:
                candidate[leg] = -1
                continue
            if candidate[leg] < 0:
                candidate[leg] = start + i
                candidate_ns[leg] = stamps[i]
            if stamps[i] - candidate_ns[leg] >= hold:
                contact[leg] = 1 - contact[leg]
                found[count, 0] = candidate[leg]
                found[count, 1] = leg
                found[count, 2] = contact[leg]
                count += 1
                candidate[leg] = -1
    return count
