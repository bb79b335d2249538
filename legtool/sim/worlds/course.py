"""A course as boxes: for the simulator, the ray caster, the ground truth, and a drawing."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.configs.courses import CourseSettings
from legtool.sim.robots.physics import FLOOR_FRICTION, TERRAIN_CONTACT, empty_world

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Course:
    """A course's floor.

    Attributes:
        settings: what it was built from.
        lower: (n, 3) lower corner of each box, world frame [m].
        upper: (n, 3) upper corner; the top face is floor.
    """

    settings: CourseSettings
    lower: Array
    upper: Array

    @property
    def goal(self) -> Array:
        """(2,) goal of the CoM, world frame [m]."""
        return np.array([self.settings.length, 0.0])

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height of the floor, ``-pit_depth`` in a gap or beside the course.

        Args:
            x, y: broadcastable world coordinates [m].

        Returns:
            their broadcast shape [m].
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        out = np.full(x.shape, -self.settings.pit_depth)
        for low, high in zip(self.lower, self.upper, strict=True):
            inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
            out[inside] = np.maximum(out[inside], high[2])
        return out


def build_course(settings: CourseSettings) -> Course:
    """Cut the floor into boxes: for each half of the width, stretches between gaps at their heights."""
    half = settings.width / 2
    boxes: list[tuple[float, ...]] = []
    for side, y_low, y_high in (("left", 0.0, half), ("right", -half, 0.0)):
        gaps = [gap for gap in settings.gaps if gap.side in ("both", side)]
        steps = [step for step in settings.steps if step.side in ("both", side)]
        edges = {-settings.run_in, settings.length + settings.run_in}
        edges |= {edge for gap in gaps for edge in (gap.x, gap.end)}
        edges |= {edge for step in steps for edge in (step.x, step.end)}
        ordered = sorted(edges)
        for x_low, x_high in pairwise(ordered):
            middle = (x_low + x_high) / 2
            if any(gap.x < middle < gap.end for gap in gaps):
                continue
            top = sum(step.height for step in steps if step.x < middle < step.end)
            boxes.append((x_low, y_low, -settings.pit_depth - 0.1, x_high, y_high, top))
    corners = np.array(boxes)
    return Course(settings, corners[:, :3], corners[:, 3:])


def draw_course(course: Course, columns: int = 100) -> list[str]:
    """The course in words and as text: from above, one line for each 20 cm of its width.

    Args:
        course: what to draw.
        columns: of the drawing, from 0.5 m before the start to 0.5 m beyond the goal.

    Returns:
        lines for a terminal: ``.`` floor, a digit or letter the floor's height in cm (a is 10), a space the pit.
    """
    s = course.settings
    x = np.linspace(-0.5, s.length + 0.5, columns)
    cell = x[1] - x[0]
    y = np.arange(s.width / 2 - 0.1, -s.width / 2, -0.2)
    # A gap narrower than a column is to be seen: a column shows the lowest floor in it.
    within = x[:, None] + np.linspace(-0.5, 0.5, 9) * cell
    heights = np.stack([course.height(within, np.full(within.shape, row)).min(axis=1) for row in y])
    lines = [f"{s.name}: {s.length:g} m to the goal, {s.width:g} m wide, gaps {s.pit_depth:g} m deep"]
    lines += [f"  {s.source}"] if s.source else []
    lines += [f"  gap  x {gap.x:.2f} to {gap.end:.2f} m, {100 * gap.width:.0f} cm, {gap.side}" for gap in s.gaps]
    lines += [
        f"  step x {step.x:.2f} to {step.end:.2f} m, {100 * step.height:.0f} cm up, {step.side}" for step in s.steps
    ]
    ruler = [" "] * (columns + 4)
    for metre in range(int(np.ceil(x[0])), int(x[-1]) + 1):
        at = round((metre - x[0]) / cell)
        ruler[at : at + len(str(metre))] = str(metre)
    lines += ["  from above, left side up; S start, G goal, floor in cm (a = 10)", "  " + "".join(ruler).rstrip()]
    middle = int(np.argmin(np.abs(y)))
    for number, row in enumerate(heights):
        text = [_symbol(height) for height in row]
        if number == middle:
            for mark, place in (("S", 0.0), ("G", s.length)):
                text[round((place - x[0]) / cell)] = mark
        lines.append("  " + "".join(text))
    return lines


def _symbol(height: float) -> str:
    if height < -1e-6:
        return " "
    centimetres = round(100 * height)
    return "." if centimetres == 0 else "0123456789abcdefghijklmnopqrstuvwxyz"[min(centimetres, 35)]


def course_world(course: Course) -> mujoco.MjSpec:
    """The course as a MuJoCo world: its boxes over the pit's floor."""
    spec = empty_world()
    friction = [course.settings.friction, *FLOOR_FRICTION[1:]]
    spec.worldbody.add_geom(
        name="pit",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        pos=[0, 0, -course.settings.pit_depth],
        friction=friction,
        **TERRAIN_CONTACT,
    )
    for index, (low, high) in enumerate(zip(course.lower, course.upper, strict=True)):
        spec.worldbody.add_geom(
            name=f"floor_{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(high - low) / 2,
            pos=(high + low) / 2,
            friction=friction,
            **TERRAIN_CONTACT,
        )
    return spec
