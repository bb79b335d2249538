"""Settings of the motion line: how steps are cut, how the models are fitted, how they are measured."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from legtool.configs.settings import Settings

Formulation = Literal["full", "no_history", "no_feet", "poly2"]
Estimator = Literal["ols", "bayesian"]


class TransitionSettings(Settings):
    """How a recording is cut into full-stance transitions. Of these, recordings of step events use only the bounds."""

    instant: Literal["touchdown", "full_stance_end"] = Field(
        "full_stance_end",
        description="instant of the states: touchdown or full_stance_end; always touchdown for logs of step events",
    )
    contact_on: float = Field(
        0.25, gt=0, lt=1, description="a foot gets into contact above this share of its force range"
    )
    contact_off: float = Field(0.1, gt=0, lt=1, description="and gets out of contact below this share")
    hold_s: float = Field(0.015, ge=0, le=0.1, description="a change of contact must last this long [s]")
    calibration_s: float = Field(
        30.0, gt=0, le=300, description="length of the walking from which the force ranges are estimated [s]"
    )
    overlap_s: float = Field(
        0.1, ge=0, le=0.2, description="a pair of legs may lift off this long before the other pair has landed [s]"
    )
    standing_s: float = Field(0.4, gt=0, le=2, description="a longer full stance counts as standing [s]")
    gap_s: float = Field(0.2, gt=0, le=2, description="a longer time between samples counts as a gap [s]")
    min_step_s: float = Field(0.12, gt=0, le=1, description="a shorter step counts as a stumble [s]")
    max_step_s: float = Field(
        1.0, gt=0, le=3, description="a longer step counts as a stumble, or as a gap between step events [s]"
    )
    step_time_ratio: float = Field(
        2.0, gt=1, le=10, description="a step whose time is off the running median by this factor counts as a stumble"
    )
    max_slip_m: float = Field(
        0.1, gt=0, le=0.5, description="a step in which a stance foot slides further counts as a stumble [m]"
    )

    @model_validator(mode="after")
    def _check(self) -> TransitionSettings:
        if self.contact_off >= self.contact_on:
            raise ValueError(f"contact_off {self.contact_off} must be below contact_on {self.contact_on}")
        if self.min_step_s >= self.max_step_s:
            raise ValueError(f"min_step_s {self.min_step_s} must be below max_step_s {self.max_step_s}")
        return self


class MotionTrainSettings(Settings):
    """Fits of FDM, CDM and CVM. Every formulation and estimator is fitted; one is chosen to be exported."""

    formulation: Literal["full", "no_history", "no_feet", "poly2", "best"] = Field(
        "full", description="formulation to export; best: the one with the lowest cross-validated error"
    )
    estimator: Estimator = Field("bayesian", description="estimator to export; ols: least squares, as in the paper")
    min_steps: int = Field(
        30,
        ge=30,
        description="datasets with fewer usable steps are rejected; a model has 25 inputs, the intercept included",
    )
    folds: int = Field(
        10, ge=3, le=50, description="number of contiguous blocks for calibration and for the choice of a formulation"
    )


class MotionEvalSettings(Settings):
    """How the models are measured on data that they were not fitted to."""

    split: Literal["auto", "contiguous", "episode"] = Field(
        "auto",
        description="folds are contiguous blocks or whole episodes; auto: episodes if there are enough, or each "
        "of several logs in turn",
    )
    folds: int = Field(10, ge=2, le=50, description="number of folds of the cross-validation")
    block_steps: int = Field(20, ge=1, description="consecutive steps in one block of the bootstrap")
    bootstrap: int = Field(2000, ge=100, le=100_000, description="resamples for the 95 % intervals")
    seed: int = Field(0, ge=0, description="seed of the bootstrap and of the assignment of episodes to folds")
