"""Settings of export."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from legtool.configs.settings import Settings


class ExportSettings(Settings):
    """How a frozen model is compared with the trained one before a bundle is let out, and what its card reports."""

    states: int = Field(2000, ge=1000, le=1_000_000, description="random states, within the range of the training data")
    tolerance: float = Field(1e-9, gt=0, le=1e-6, description="largest difference allowed, relative above 1 [SI unit]")
    results: Path | None = Field(None, description="results.json of eval motion, for the card; none: RUN/results.json")
    seed: int = Field(0, ge=0, description="of the random states")
