"""Worlds to walk in: written as YAML or JSON, or drawn at random; short forms stand for many primitives."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from legtool.configs.settings import Settings, build, read_yaml
from legtool.configs.world_json import read_world_json
from legtool.configs.world_parts import (
    Angle,
    Beam,
    Box,
    Cobbles,
    Cylinder,
    Gap,
    Place,
    Point2,
    Profile,
    Ramp,
    Side,
    Stairs,
    Step,
    Stone,
    StoneGrid,
    WrittenShape,
)
from legtool.errors import SettingsError

PRESETS = Path(__file__).parent / "worlds"
Floor = Literal["ground", "pit", "none"]


class Way(Settings):
    """Where a walk starts and where it ends."""

    start: tuple[Place, Place, Angle] = Field((0.0, 0.0, 0.0), description="x, y [m], yaw [rad]")
    goal: Point2 | None = Field(None, description="x, y [m]")
    via: tuple[Point2, ...] = Field((), max_length=100, description="places to pass before the goal, in this order")
    goal_radius: float | None = Field(
        None, gt=0, le=100, description="the goal is reached this near to it [m]; none: at the line across the way"
    )


class WorldSettings(Way):
    """A world.

    With ``length`` it is a straight course from x = 0 to there: platforms of ``width`` over a pit, with ``gaps`` and
    ``steps``; the goal is its end. Otherwise it lies on an endless floor at z = 0, or on what ``floor`` says.
    """

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    source: str = Field("", description="where the figures come from")
    floor: Floor | None = Field(
        None, description="ground: endless at z = 0; pit: at -pit_depth, off the course; none: no floor but the parts"
    )
    length: float | None = Field(None, gt=0, le=100, description="of a straight course: distance to its end [m]")
    width: float = Field(2.0, gt=0.5, le=20, description="of a straight course [m]")
    run_in: float = Field(1.5, gt=0.5, le=10, description="floor behind the start and beyond the end [m]")
    pit_depth: float = Field(0.3, gt=0, le=2, description="depth of the pit below z = 0 [m]")
    friction: float = Field(0.8, gt=0, le=1000, description="of all that has none of its own")
    deepest: float | None = Field(
        None, gt=0, le=100, description="what lies farther than this below start and goal is off the course [m]"
    )
    gaps: tuple[Gap, ...] = ()
    steps: tuple[Step, ...] = ()
    profile: Profile | None = None
    cobbles: tuple[Cobbles, ...] = ()
    stairs: tuple[Stairs, ...] = ()
    ramps: tuple[Ramp, ...] = ()
    beams: tuple[Beam, ...] = ()
    stones: tuple[Stone, ...] = ()
    grids: tuple[StoneGrid, ...] = ()
    boxes: tuple[Box, ...] = Field((), max_length=10_000)
    cylinders: tuple[Cylinder, ...] = Field((), max_length=10_000)
    shapes: tuple[WrittenShape, ...] = Field((), max_length=500, description="a scene's shapes, in their order")
    robots: dict[str, Way] = Field({}, description="another start and goal for robots whose names begin with the key")

    @model_validator(mode="after")
    def _check(self) -> WorldSettings:
        if self.length is None:
            if self.gaps or self.steps:
                raise ValueError("gaps and steps are cut into a straight course, which needs a length")
        else:
            end = max([gap.end for gap in self.gaps] + [step.end for step in self.steps], default=0.0)
            if end > self.length:
                raise ValueError(f"an obstacle ends at {end:.2f} m, beyond the course's {self.length:.2f} m")
            if self.floor is not None:
                raise ValueError("a straight course lies over its pit: give either length or floor")
        return self

    def way(self, robot: str | None = None) -> Way:
        """Start and goal for a robot of this name."""
        for prefix, way in self.robots.items():
            if robot is not None and robot.startswith(prefix):
                return way
        goal = (self.length, 0.0) if self.goal is None and self.length is not None else self.goal
        return Way(start=self.start, goal=goal, via=self.via, goal_radius=self.goal_radius)


def load_world(name_or_path: str) -> WorldSettings:
    """A preset by name, a YAML or JSON file by path, or ``random:SEED:DIFFICULTY``.

    Raises:
        SettingsError: no such preset or file, with the list of presets; or a file that describes no world.
    """
    if name_or_path.startswith("random:"):
        try:
            seed, difficulty = name_or_path.split(":")[1:]
            return random_world(int(seed), float(difficulty))
        except ValueError as error:
            raise SettingsError(
                f"world {name_or_path!r}: expected random:SEED:DIFFICULTY, like random:3:0.5"
            ) from error
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml", ".json"):
        path = PRESETS / f"{name_or_path}.yaml"
    if not path.is_file():
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise SettingsError(f"world {name_or_path!r}: no such preset, YAML or JSON file; presets: {presets}")
    if path.suffix == ".json":
        return build(WorldSettings, read_world_json(path), source=str(path))
    values = read_yaml(path) or {}
    if not isinstance(values, dict):
        raise SettingsError(f"{path}: expected the settings of a world by name, got {type(values).__name__}")
    return build(WorldSettings, values, source=str(path))


def load_scene(name_or_path: str) -> WorldSettings:
    """A world whose ``shapes`` are the layout of a scene, see :func:`load_world`.

    Raises:
        SettingsError: no such world, or one without shapes.
    """
    settings = load_world(name_or_path)
    if not settings.shapes:
        raise SettingsError(f"layout {name_or_path!r}: a world without shapes; expected one that lists shapes")
    return settings


def is_world(name: str) -> bool:
    """Whether a name means a world without being a file: a preset, or one drawn at random."""
    return name.startswith("random:") or (PRESETS / f"{name}.yaml").is_file()


def random_world(seed: int, difficulty: float) -> WorldSettings:
    """A straight course drawn at random; its name tells seed and difficulty, so that no two share one.

    Args:
        seed: same seed and difficulty, same world.
        difficulty: 0 (two gaps of 6 cm far apart) to 1 (six obstacles, gaps up to 20 cm, steps up to 8 cm).

    Raises:
        SettingsError: the difficulty is outside 0 to 1.
    """
    if not 0 <= difficulty <= 1:
        raise SettingsError(f"difficulty is {difficulty}, expected 0 to 1")
    rng = np.random.default_rng([seed, round(difficulty * 1000)])
    gaps: list[Gap] = []
    steps: list[Step] = []
    x = 1.0
    for _ in range(2 + round(4 * difficulty)):
        x = round(x + rng.uniform(0.0, 0.4), 2)
        if rng.uniform() < 0.3 * difficulty:
            step = Step(x=x, length=round(rng.uniform(0.7, 1.2), 2), height=round(rng.uniform(0.03, 0.08), 3))
            steps.append(step)
            x += step.length
        else:
            width = round(rng.uniform(0.06, 0.06 + 0.14 * difficulty + 1e-9), 3)
            side: Side = ("left", "right")[rng.integers(2)] if rng.uniform() < 0.5 * difficulty else "both"
            gaps.append(Gap(x=x, width=width, side=side))
            x += width
        x += 1.2 - 0.6 * difficulty
    # All decimals, at least two: 0.5 is 050, 0.501 is 0501.
    whole, _, decimals = f"{Decimal(repr(float(difficulty))):f}".partition(".")
    name = f"random_{seed}_{whole}{decimals.ljust(2, '0') if decimals != '0' else '00'}"
    return WorldSettings(name=name, length=round(x + 0.5, 2), gaps=tuple(gaps), steps=tuple(steps))
