"""Families of worlds: those of QuadPiPS' experiments, and others that are drawn by the same rules, one by each seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import Field

from legtool.configs.settings import Settings, build
from legtool.configs.worlds import WorldSettings, load_world
from legtool.errors import SettingsError

Rng = np.random.Generator
Values = dict[str, Any]

#: Stones of the sparse field: side and share of those that are there. Its middles along x and y are whole multiples.
_STONE_M, _PRESENT, _COLUMNS = 0.15, 0.4, 20
#: Sides, turns about each axis, and places of rubble off its grid, at most.
_RUBBLE_SIDE_M, _RUBBLE_LARGER, _RUBBLE_TURN, _RUBBLE_SHIFT_M = 0.3, 1.5, 0.25, 0.03
#: Heights of pegs about the mean of their row, at most [m]; round stones out of their places, at most [m].
_PEG_M, _ROUND_SHIFT_M = 0.035, 0.03
#: Widths of beams, and amplitudes of the winding one [m].
_WIDTHS_M, _AMPLITUDES_M = (0.3, 0.5), (0.3, 0.6)
#: The winding beam: half its length, number of boxes, and by how much each is longer than its stretch [m].
_WINDING_HALF_M, _WINDING_BOXES, _WINDING_OVER_M = 1.5, 10, 0.12


class Family(Settings):
    """A world of an experiment, and its random members."""

    name: str = Field(pattern=r"^[a-z0-9_]+$", description="also that of the preset, if nothing else is said")
    world: str | None = Field(None, description="preset, which is the published world; None: that of the name")
    legs_m: float | None = Field(
        None,
        gt=0,
        le=5,
        description="straight legs that a straight course is as large as for [m]; None: for all",
    )
    goal_radius: float | None = Field(
        None, gt=0, le=10, description="the goal is reached this near to it, where the preset has a line [m]"
    )
    timeout_s: float = Field(180.0, gt=1, le=600, description="a trial is lost after this [s]")
    start: tuple[float, float, float] = Field(
        (0.03, 0.03, 0.052), description="largest offsets of the start ahead, to the side [m] and of its heading [rad]"
    )

    camera_pitch: float | None = Field(
        None, ge=-0.5, le=1.4,
        description="of the robot's camera below its trunk's forward axis [rad]; None: as the robot has it",
    )  # fmt: skip
    side_cameras: bool = Field(False, description="whether cameras look left and right, besides the one ahead")

    @property
    def preset(self) -> str:
        """Name of the published world."""
        return self.world or self.name

    @property
    def drawn(self) -> bool:
        """Whether there are members besides the published world."""
        return self.preset in _RULES

    def settings(self, seed: int | None = None, *, legs_m: float | None = None) -> WorldSettings:
        """A member.

        Args:
            seed: of what is drawn; None: the published world.
            legs_m: straight legs of the robot that walks, for courses that grow with them [m].
        """
        world = load_world(self.preset)
        values = world.to_dict()
        if self.world is not None:
            values["name"] = self.name
        if self.goal_radius is not None and world.goal_radius is None:
            values["goal_radius"] = self.goal_radius
        if self.legs_m is not None and legs_m is not None:
            _resize(values, legs_m / self.legs_m)
        rule = _RULES.get(self.preset)
        if seed is not None and rule is not None:
            rule(values, np.random.default_rng(seed))
            values["source"] = f"{world.source} Drawn by the same rule, seed {seed}."
        return build(WorldSettings, values, source=self.name)


def _resize(values: Values, scale: float) -> None:
    """Make a straight course larger: its gaps and steps, their places, and its own length, width and depth."""
    for key in ("length", "width", "run_in", "pit_depth"):
        values[key] = round(values[key] * scale, 4)
    for part in (*values["gaps"], *values["steps"]):
        for key in ("x", "width", "length", "height"):
            if key in part:
                part[key] = round(part[key] * scale, 4)
    values["source"] = f"{values['source']} All lengths times {scale:.3f}."


def member(name: str, seed: int) -> WorldSettings:
    """One member of a family, its name that of the family with the seed.

    Raises:
        SettingsError: no such family, or one without members, with the list of those that have some.
    """
    if name not in FAMILIES or not FAMILIES[name].drawn:
        raise SettingsError(f"member of {name!r}: expected one of {', '.join(_RULES)}")
    return FAMILIES[name].settings(seed).replace(name=f"{name}_{seed}")


def _parts(values: Values, prefix: str) -> list[Values]:
    """Boxes and cylinders whose names begin so."""
    return [part for kind in ("boxes", "cylinders") for part in values[kind] if part["name"].startswith(prefix)]


def _sparse(values: Values, rng: Rng) -> None:
    values["boxes"] = [part for part in values["boxes"] if not part["name"].startswith("stone_")]
    there = rng.random((_COLUMNS, _COLUMNS)) < _PRESENT
    for row, column in np.argwhere(there).tolist():
        x, y = _STONE_M * (column - 0.5 * (_COLUMNS - 1)), _STONE_M * row
        values["boxes"].append(
            {
                "name": f"stone_{row}_{column}",
                "center": [round(x, 4), round(y, 4), -0.05],
                "size": [_STONE_M, _STONE_M, 0.1],
            }
        )


def _rubble(values: Values, rng: Rng) -> None:
    for part in _parts(values, "rubble_"):
        x, y, z = part["center"]
        cell = np.round(np.array([x, y]) / _RUBBLE_SIDE_M) * _RUBBLE_SIDE_M
        shift = rng.uniform(-_RUBBLE_SHIFT_M, _RUBBLE_SHIFT_M, 2)
        sides = _RUBBLE_SIDE_M * rng.uniform(1.0, _RUBBLE_LARGER, 2)
        part["center"] = [*np.round(cell + shift, 5).tolist(), z]
        part["size"] = [*np.round(sides, 5).tolist(), part["size"][2]]
        part["rpy"] = np.round(rng.uniform(-_RUBBLE_TURN, _RUBBLE_TURN, 3), 5).tolist()


def _pegboard(values: Values, rng: Rng) -> None:
    """Rows rise to the middle and fall again as those of the published board do."""
    pegs = _parts(values, "peg_")
    rows: dict[float, list[float]] = {}
    for peg in pegs:
        rows.setdefault(peg["center"][0], []).append(peg["center"][2])
    for peg in pegs:
        x, y, _ = peg["center"]
        peg["center"] = [x, y, round(float(np.mean(rows[x]) + rng.uniform(-_PEG_M, _PEG_M)), 5)]


def _round_stones(values: Values, rng: Rng) -> None:
    for part in _parts(values, "stone_"):
        x, y, z = part["center"]
        dx, dy = rng.uniform(-_ROUND_SHIFT_M, _ROUND_SHIFT_M, 2)
        part["center"] = [round(x + dx, 5), round(y + dy, 5), z]


def _width(*prefixes: str) -> Callable[[Values, Rng], None]:
    """The rule that gives all parts of these names one width."""

    def rule(values: Values, rng: Rng) -> None:
        width = round(float(rng.uniform(*_WIDTHS_M)), 3)
        for prefix in prefixes:
            for part in _parts(values, prefix):
                part["size"] = [part["size"][0], width, part["size"][2]]

    return rule


def _winding(values: Values, rng: Rng) -> None:
    values["boxes"] = [part for part in values["boxes"] if part["name"] != "beam"]
    values["boxes"] += winding_beam(round(float(rng.uniform(*_AMPLITUDES_M)), 3))


def winding_beam(amplitude_m: float, *, width_m: float = 0.5) -> list[Values]:
    """Boxes along one period of a sine, whose tops are at z = 0.

    Args:
        amplitude_m: of the sine [m].
        width_m: of the beam [m].
    """
    stretch = 2.0 * _WINDING_HALF_M / _WINDING_BOXES
    edges = [k * stretch - _WINDING_HALF_M for k in range(_WINDING_BOXES + 1)]
    aside = [amplitude_m * math.sin(math.pi * (x + _WINDING_HALF_M) / _WINDING_HALF_M) for x in edges]
    boxes = []
    for k in range(_WINDING_BOXES):
        rise = aside[k + 1] - aside[k]
        boxes.append(
            {
                "name": "beam",
                "center": [round(edges[k] + 0.5 * stretch, 5), round(0.5 * (aside[k] + aside[k + 1]), 5), -0.05],
                "size": [round(math.hypot(stretch, rise) + _WINDING_OVER_M, 5), width_m, 0.1],
                "rpy": [0.0, 0.0, round(math.atan2(rise, stretch), 5)],
            }
        )
    return boxes


def _cobbles(values: Values, rng: Rng) -> None:
    for cobbles in values["cobbles"]:
        cobbles["seed"] = int(rng.integers(2**31))


#: How members are drawn; a family that is not here has none.
_RULES: dict[str, Callable[[Values, Rng], None]] = {
    "rubble": _rubble,
    "pegboard": _pegboard,
    "sparse_stepping_stones": _sparse,
    "ramped_stepping_stones": _round_stones,
    "balance_beam": _width("beam"),
    "ramped_balance_beam": _width("ramp_5"),
    "obstructed_balance_beam": _width("beam", "barrier_"),
    "winding_balance_beam": _winding,
    "vital_rough": _cobbles,
}
#: Of the camera on Go2's mount in the experiments on hardware (QuadPiPS, section VIII-E) [rad].
_HARDWARE_PITCH = math.radians(45.0)
#: Worlds of the suites ``quadpips``, ``quadpips_hardware`` and ``parallel_beams`` (QuadPiPS, sections VIII-B, C and E).
ENVIRONMENTS = (
    "ramp", "quadpips_stairs", "rubble", "pegboard", "balance_beam", "ramped_balance_beam", "ramped_stepping_stones",
    "sparse_stepping_stones", "obstructed_balance_beam", "winding_balance_beam",
)  # fmt: skip
HARDWARE = (
    "hw_flat", "hw_single_platform", "hw_double_platform", "hw_ramped_single_platform", "hw_triple_platform",
    "hw_ramped_stepping_stones",
)  # fmt: skip
PARALLEL_BEAMS = ("parallel_beams_axes", "parallel_beams_edges")
FAMILIES: dict[str, Family] = {
    name: Family(
        name=name,
        timeout_s=300.0 if name == "sparse_stepping_stones" else 180.0,
        camera_pitch=_HARDWARE_PITCH if name in HARDWARE else None,
        side_cameras=name in PARALLEL_BEAMS,
    )
    for name in (*ENVIRONMENTS, *HARDWARE, *PARALLEL_BEAMS)
}

#: The straight leg of Aliengo, for which the motion paper's scenarios are written [m].
_ALIENGO_M = 0.5
#: Worlds of the other papers that the suite ``arena`` walks besides: the motion paper's scenarios in the robot's size
#: (section IV-B), and ViTAL's stairs, gaps and rough ground (VI-A, F and I). Their goals have the radius of QuadPiPS'.
ARENA: dict[str, Family] = {
    family.name: family
    for family in (
        *(
            Family(name=f"arena_scenario_{k}", world=f"scenario_{k}", legs_m=_ALIENGO_M, goal_radius=0.25)
            for k in (1, 2, 3)
        ),
        *(
            Family(name=f"arena_{what}", world=f"vital_{what}", goal_radius=0.25)
            for what in ("stairs", "gapped_stairs", "rough")
        ),
    )
}
