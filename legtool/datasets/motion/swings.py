"""Combine changes of contact into swings of the diagonal pairs of a trot, and recognise irregular ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from numpy.typing import NDArray

from legtool_runtime.robot import TROT_PAIRS

_PAIR_OF_LEG = {leg: number for number, pair in enumerate(TROT_PAIRS) for leg in pair}


class SwingInterval(NamedTuple):
    """A pair that was off the ground.

    Attributes:
        pair: index into TROT_PAIRS.
        lift: first row without full contact, the row in which its first foot lifted.
        land: row in which its last foot touched down.
        stumble: the reason why this is not a regular swing; empty if it is one.
    """

    pair: int
    lift: int
    land: int
    stumble: str


@dataclass
class _Airborne:
    lift: int
    legs: set[int] = field(default_factory=set)
    up: set[int] = field(default_factory=set)
    stumble: str = ""


class SwingTracker:
    """Combines lift-offs and touchdowns of single feet into swings of pairs."""

    def __init__(self, contact: NDArray, row: int) -> None:
        """Start with ``contact`` (4,) of 0 and 1 at ``row``; swings of feet already in the air count as cut off."""
        self._airborne: list[_Airborne | None] = [None, None]
        for leg in range(4):
            if not contact[leg]:
                self._lift(row, leg, "cut_off")

    @property
    def full_stance(self) -> bool:
        """Whether all feet stand."""
        return self._airborne == [None, None]

    def feed(self, row: int, leg: int, down: bool) -> SwingInterval | None:
        """Process a change of contact of one foot; return the swing that it completes, if any.

        A swing that began and ended while the other pair was in the air is not a step. It turns the swing of the other
        pair into a stumble, which is returned when it ends.
        """
        if not down:
            self._lift(row, leg, "")
            return None
        pair = _PAIR_OF_LEG[leg]
        swing = self._airborne[pair]
        if swing is None or leg not in swing.up:
            return None
        swing.up.discard(leg)
        if swing.up:
            return None
        self._airborne[pair] = None
        other = self._airborne[1 - pair]
        if other is not None and other.lift < swing.lift:
            other.stumble = other.stumble or "extra_foot"
            return None
        stumble = swing.stumble or ("" if len(swing.legs) == 2 else "single_foot")
        return SwingInterval(pair, swing.lift, row, stumble)

    def _lift(self, row: int, leg: int, stumble: str) -> None:
        pair = _PAIR_OF_LEG[leg]
        swing = self._airborne[pair]
        if swing is None:
            swing = self._airborne[pair] = _Airborne(row, stumble=stumble)
        swing.legs.add(leg)
        swing.up.add(leg)
