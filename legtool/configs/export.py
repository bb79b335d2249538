"""Settings of export."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from legtool.configs.settings import Settings


class ExportSettings(Settings):
    """How a frozen model is compared with the trained one before a bundle is let out, and what its card reports."""

    states: int = Field(2000, ge=1000, le=1_000_000, description="random states, within the range of the training data")
    tolerance: float = Field(
        1e-9, gt=0, le=1e-6, description="largest difference allowed of motion models, relative above 1 [SI unit]"
    )
    results: tuple[Path, ...] = Field(
        (), description="results.json of eval for the card, of one line or several; none: each run's own"
    )
    seed: int = Field(0, ge=0, description="of the random states")

    @field_validator("results", mode="before")
    @classmethod
    def _one_or_several(cls, value: Any) -> Any:
        return value if value is None or isinstance(value, (list, tuple)) else (value,)
