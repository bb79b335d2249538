"""What a learned network is shown: terms with scale, clip and history, described in YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from legtool.configs.settings import Settings

TermName = Literal[
    "base_linear_velocity",
    "base_angular_velocity",
    "gravity",
    "command",
    "joint_positions",
    "joint_velocities",
    "last_action",
    "gait_phase",
    "gait_phase_sin",
    "gait_phase_cos",
    "foot_contacts",
    "heights",
    "constant",
    "estimate",
]
#: Numbers of the terms that have as many for every policy.
TERM_SIZES: dict[str, int] = {
    "base_linear_velocity": 3,
    "base_angular_velocity": 3,
    "gravity": 3,
    "command": 3,
    "joint_positions": 12,
    "joint_velocities": 12,
    "last_action": 12,
    "foot_contacts": 4,
}
PHASE_TERMS = ("gait_phase", "gait_phase_sin", "gait_phase_cos")
#: Ticks of the policy that a history reaches back at most.
LONGEST_HISTORY = 100


def _ages(given: Any) -> Any:
    """A history as ages: of a number, so many ticks with the oldest first."""
    if isinstance(given, int) and not isinstance(given, bool):
        if not 1 <= given <= LONGEST_HISTORY:
            raise ValueError(f"a history of 1 to {LONGEST_HISTORY} ticks is possible")
        return tuple(reversed(range(given)))
    if isinstance(given, (list, tuple)):
        fits = [isinstance(age, int) and 0 <= age < LONGEST_HISTORY for age in given]
        if not fits or not all(fits):
            raise ValueError(f"expected a number of ticks, or ages from 0 (now) to {LONGEST_HISTORY - 1}, in order")
    return given


def _term(given: Any) -> Any:
    return {"term": given} if isinstance(given, str) else given


def _clip(given: Any) -> Any:
    return (-given, given) if isinstance(given, (int, float)) and not isinstance(given, bool) else given


def _values(given: Any) -> Any:
    return (given,) if isinstance(given, (int, float)) and not isinstance(given, bool) else given


Ages = Annotated[tuple[int, ...], BeforeValidator(_ages)]
#: Limits; one number is ± that.
Clip = Annotated[tuple[float, float], BeforeValidator(_clip)]
#: One number for all of a term, or one for each.
Values = Annotated[tuple[float, ...], BeforeValidator(_values)]


class ObservationTerm(Settings):
    """One term of an observation: scale × clip(value + offset)."""

    term: TermName
    offset: Values = Field((0.0,), description="is added first: one number, or one for each of the term's")
    clip: Clip | None = Field(None, description="then limits hold: ± one number, or the lowest and the highest")
    scale: Values = Field((1.0,), description="is multiplied last: one number, or one for each of the term's")
    history: Ages | None = Field(
        None, description="where history_by is term: ticks of this term, as for the history of all"
    )
    values: tuple[float, ...] = Field((), description="of the term constant")

    @model_validator(mode="after")
    def _check(self) -> ObservationTerm:
        if (self.term == "constant") != bool(self.values):
            raise ValueError("the term constant, and no other, has values")
        if self.clip is not None and not self.clip[0] < self.clip[1]:
            raise ValueError(f"clip {list(self.clip)}: expected ± one number, or the lowest and then the highest")
        return self


class GaitPhase(Settings):
    """The gait clock that the policy was trained with: a phase for each leg, or for what else has one."""

    start: tuple[float, ...] = Field(
        min_length=1, max_length=16, description="phases at the start, as FL, FR, RL, RR [cycles]"
    )
    frequency_hz: float = Field(gt=0, le=10, description="cycles in a second [1/s]")
    idle: float | None = Field(
        -1.0, description="value of every phase while the command is zero; null: phases are shown as they are"
    )
    advanced: Literal["after", "before"] = Field(
        "after", description="whether a tick's phases go on after it was observed, or before"
    )


class HeightSamples(Settings):
    """Places of height samples, which turn with the base's yaw."""

    x: tuple[float, ...] = Field(min_length=1, description="ahead of the base [m]")
    y: tuple[float, ...] = Field(min_length=1, description="to its left [m]")
    fastest: Literal["x", "y"] = Field("y", description="which of the two goes through its places first")


class RecurrentState(Settings):
    """A state that a network gives at one tick and takes at the next; zero at the start."""

    input: str = Field(description="name of the input")
    output: str | int = Field(description="name of the output; for TorchScript its place, from 0")
    shape: tuple[int, ...] | None = Field(
        None, description="of the state; null: as an ONNX file says, where it says all of it"
    )


class NetworkSettings(Settings):
    """A network in ONNX or TorchScript, and what it is shown."""

    onnx: Path | None = Field(
        None, description="file of the network; a relative path starts at the directory of this file"
    )
    torchscript: Path | None = Field(None, description="file of the network in TorchScript, instead of onnx")
    output: str | int = Field(0, description="which output counts: its place from 0, or its name")
    recurrent: tuple[RecurrentState, ...] = Field((), description="states that are fed back")
    reset_method: str | None = Field(
        None, description="method of a network in TorchScript that is called at the start of each walk"
    )
    observation: tuple[Annotated[ObservationTerm, BeforeValidator(_term)], ...] = Field(
        min_length=1, description="terms, in order: a name, or a mapping of term, offset, clip, scale, …"
    )
    history: Ages = Field(
        (0,),
        description="ticks of the policy that are shown: a number, oldest first, or their ages in order: [0, 1, 2] is "
        "newest first",
    )
    history_by: Literal["time", "term"] = Field(
        "time", description="time: all terms of one tick, then all of the next; term: all ticks of one term, then …"
    )
    history_start: Literal["first", "zero"] = Field(
        "first", description="what is shown of ticks before the first: the first, or zeros"
    )
    observation_clip: float | None = Field(None, gt=0, description="all that is shown is limited to ± this at last")

    @model_validator(mode="after")
    def _check_network(self) -> NetworkSettings:
        if (self.onnx is None) == (self.torchscript is None):
            raise ValueError("name the network's file under either onnx or torchscript")
        if self.reset_method is not None and self.torchscript is None:
            raise ValueError("reset_method is of a network in TorchScript; states of ONNX are named under recurrent")
        if self.history_by == "time" and any(term.history is not None for term in self.observation):
            raise ValueError("a term has a history of its own: set history_by to term")
        return self

    @property
    def file(self) -> Path:
        """Of the network."""
        path = self.onnx or self.torchscript
        assert path is not None
        return path

    def ages_of(self, term: ObservationTerm) -> tuple[int, ...]:
        """Ages of the ticks that are shown of a term [ticks of the policy]."""
        return self.history if term.history is None else term.history
