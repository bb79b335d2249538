"""Courses to walk: platforms over a pit, with gaps and steps, written down as YAML or drawn at random."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import SettingsError

PRESETS = Path(__file__).parent / "courses"
Side = Literal["both", "left", "right"]


class Gap(Settings):
    """A slot in the floor down to the pit; ``left`` or ``right`` cuts one half of the width only (asymmetric)."""

    x: float = Field(ge=0, description="near edge [m]")
    width: float = Field(gt=0, le=1, description="along x [m]")
    side: Side = "both"

    @property
    def end(self) -> float:
        """Far edge [m]."""
        return self.x + self.width


class Step(Settings):
    """A raised stretch of floor: a step up, and a step down at its end."""

    x: float = Field(ge=0, description="near edge [m]")
    length: float = Field(gt=0, le=20, description="along x [m]")
    height: float = Field(gt=0, le=0.5, description="above the stretch it stands on [m]")
    side: Side = "both"

    @property
    def end(self) -> float:
        """Far edge [m]."""
        return self.x + self.length


class CourseSettings(Settings):
    """A straight course from x = 0 to ``length``; the robot starts at the origin, looking along x."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    source: str = Field("", description="where the figures come from")
    length: float = Field(gt=0, le=100, description="distance to the goal [m]")
    width: float = Field(2.0, gt=0.5, le=20, description="[m]")
    run_in: float = Field(1.5, gt=0.5, le=10, description="floor behind the start and beyond the goal [m]")
    pit_depth: float = Field(0.3, gt=0, le=2, description="depth of the gaps [m]")
    friction: float = Field(0.8, gt=0, le=2)
    gaps: tuple[Gap, ...] = ()
    steps: tuple[Step, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> CourseSettings:
        end = max([gap.end for gap in self.gaps] + [step.end for step in self.steps], default=0.0)
        if end > self.length:
            raise ValueError(f"an obstacle ends at {end:.2f} m, beyond the course's {self.length:.2f} m")
        return self


def load_course(name_or_path: str) -> CourseSettings:
    """A preset by name, the user's own YAML by path, or ``random:SEED:DIFFICULTY``.

    Raises:
        SettingsError: no such preset or file; the message lists the presets.
    """
    if name_or_path.startswith("random:"):
        try:
            seed, difficulty = name_or_path.split(":")[1:]
            return random_course(int(seed), float(difficulty))
        except ValueError as error:
            raise SettingsError(
                f"course {name_or_path!r}: expected random:SEED:DIFFICULTY, like random:3:0.5"
            ) from error
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
    if not path.is_file():
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise SettingsError(f"course {name_or_path!r}: no such preset or YAML file; presets: {presets}")
    return build(CourseSettings, read_yaml(path) or {}, source=str(path))


def is_course(name: str) -> bool:
    """Whether a name means a course without being a file: a preset, or one drawn at random."""
    return name.startswith("random:") or (PRESETS / f"{name}.yaml").is_file()


def random_course(seed: int, difficulty: float) -> CourseSettings:
    """A course drawn at random.

    Args:
        seed: same seed and difficulty, same course.
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
    name = f"random_{seed}_{round(difficulty * 100):03d}"
    return CourseSettings(name=name, length=round(x + 0.5, 2), gaps=tuple(gaps), steps=tuple(steps))
