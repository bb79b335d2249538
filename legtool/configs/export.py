"""Settings of export."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from legtool.configs.settings import Settings


class ExportSettings(Settings):
    """How frozen models are compared with the trained ones before a bundle is released, and what its card reports."""

    states: int = Field(
        2000,
        ge=1000,
        le=1_000_000,
        description="number of random states to compare on, within the range of the training data",
    )
    tolerance: float = Field(
        1e-9,
        gt=0,
        le=1e-6,
        description="largest allowed difference of motion models, relative to values above 1 [SI unit]",
    )
    results: tuple[Path, ...] = Field(
        (),
        description="results.json files of eval, whose figures the card reports; none: those in the runs",
    )
    seed: int = Field(0, ge=0, description="seed of the random states")

    @field_validator("results", mode="before")
    @classmethod
    def _one_or_several(cls, value: Any) -> Any:
        return value if value is None or isinstance(value, (list, tuple)) else (value,)
