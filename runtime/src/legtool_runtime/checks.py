"""Checks of what comes in: arrays, rotations, poses, and settings within their bounds. Each fails in one clear line."""

from __future__ import annotations

import math
import numbers
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import LegtoolError, shown

Array = NDArray[np.float64]

#: No place in the world, and no goal, lies farther from the origin: 10,000 km [m].
FARTHEST_M = 1e7
#: How far the products of a rotation's rows may be from those of an orthonormal matrix: what comes through single
#: precision, or text of four digits, stays below.
ROTATION_TOLERANCE = 1e-3


def array(name: str, value: ArrayLike, error: type[LegtoolError], dtype: Any = np.float64) -> NDArray[Any]:
    """``value`` as a fresh array of real numbers in C order, of any shape.

    Raises:
        error: not numbers, or complex ones.
    """
    try:
        if np.iscomplexobj(value):
            raise error(f"{name} is complex, expected real numbers")
        with np.errstate(over="ignore"):  # what float32 cannot hold is infinite
            return np.array(value, dtype=dtype, order="C")
    except (TypeError, ValueError, OverflowError) as problem:
        raise error(f"{name} is not an array of numbers ({shown(problem)})") from problem


def number(name: str, value: object, error: type[LegtoolError], unit: str = "") -> float:
    """``value`` as a float.

    Raises:
        error: no finite real number.
    """
    if not _ANY.hold(value):
        raise error(f"{name} is {shown(value)}, expected a finite number{f' [{unit}]' if unit else ''}")
    return float(value)  # type: ignore[arg-type]  # a real number, as was just seen


def instance(name: str, value: object, kind: type, error: type[LegtoolError]) -> None:
    """Refuse what is not of a class.

    Raises:
        error: it is something else; the message says what.
    """
    if not isinstance(value, kind):
        raise error(f"{name} is {shown(value)}, expected a {kind.__name__}")


def numeric(name: str, value: ArrayLike, shape: tuple[int, ...], error: type[LegtoolError]) -> Array:
    """``value`` as a fresh float64 array in C order of a given shape; its values may be NaN or infinite.

    Args:
        name: of the value, to begin the message with: ``state: velocity``.
        value: anything that NumPy takes for numbers.
        shape: that it must have.
        error: class of what is raised.

    Raises:
        error: not numbers, or another shape.
    """
    found = array(name, value, error)
    if found.shape != shape:
        raise error(f"{name} has shape {found.shape}, expected {shape}")
    return found


def finite(
    name: str, value: ArrayLike, shape: tuple[int, ...], error: type[LegtoolError], *, advice: str = ""
) -> Array:
    """As :func:`numeric`, and all values finite; ``advice`` ends the message where one is not.

    Raises:
        error: not numbers, another shape, or a value that is NaN or infinite.
    """
    found = numeric(name, value, shape, error)
    if not np.isfinite(found).all():
        raise error(f"{name} holds a value that is not finite{advice}")
    return found


def pose(name: str, value: ArrayLike, error: type[LegtoolError]) -> Array:
    """A rigid transform as a fresh (4, 4) array: a rotation, a translation, and 0, 0, 0, 1 in the last row.

    Raises:
        error: another shape, a value that is not finite, or no rigid transform.
    """
    transform = finite(name, value, (4, 4), error)
    rotation = transform[:3, :3]
    if not is_rotation(rotation) or np.abs(transform[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise error(f"{name} is no rigid transform: expected a rotation, a translation, and 0, 0, 0, 1 in the last row")
    return transform


def is_rotation(matrix: Array) -> bool:
    """Whether a finite matrix (3, 3) is a rotation: orthonormal to ROTATION_TOLERANCE, and no mirror image."""
    if np.abs(matrix).max() > 2.0:  # whose products could overflow
        return False
    skew = np.abs(matrix @ matrix.T - np.eye(3)).max()
    return bool(skew <= ROTATION_TOLERANCE and np.linalg.det(matrix) > 0)


class Bounds(NamedTuple):
    """What values a setting can have.

    Attributes:
        low, high: the least and the greatest; given as ints, only whole numbers are.
        unit: for messages.
        above: whether ``low`` itself is left out.
    """

    low: float
    high: float
    unit: str = ""
    above: bool = False

    @property
    def whole(self) -> bool:
        """Whether only whole numbers are taken."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def hold(self, value: Any) -> bool:
        """Whether a value lies within them."""
        kind = numbers.Integral if self.whole else numbers.Real
        if isinstance(value, bool) or not isinstance(value, kind):
            return False
        try:
            number = float(value)
        except OverflowError:  # a whole number of hundreds of digits
            return False
        return (self.low < number if self.above else self.low <= number) and number <= self.high

    def __str__(self) -> str:
        low, unit = f"{self.low:g}", f" {self.unit}" if self.unit else ""
        if math.isinf(self.high):
            return f"{'above' if self.above else 'at least'} {low}{unit}"
        if self.above:
            return f"above {low}, up to {self.high:g}{unit}"
        return f"{'a whole number ' if self.whole else ''}{low} to {self.high:g}{unit}"


#: Any finite real number.
_ANY = Bounds(-sys.float_info.max, sys.float_info.max)


def within(what: str, settings: object, bounds: Mapping[str, Bounds], error: type[LegtoolError]) -> None:
    """Refuse settings of which one is out of bounds.

    Args:
        what: they are, to begin the message with: ``gait``.
        settings: the object whose attributes they are.
        bounds: by the attribute's name.
        error: class of what is raised.

    Raises:
        error: the first that is; the message says which, what it is, and what was expected.
    """
    for name, allowed in bounds.items():
        value = getattr(settings, name)
        if not allowed.hold(value):
            raise error(f"{what}: {name} is {shown(value)}, expected {allowed}")
