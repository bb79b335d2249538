"""Where a log holds each signal, and in which unit, order and frame: one YAML file for each kind of log."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import SettingsError

PRESETS = Path(__file__).parent / "topics"

Vector3 = tuple[float, float, float]
Leg = Literal["FL", "FR", "RL", "RR"]
Length = Literal["m", "cm", "mm"]
#: The signals that a log may hold, in the order in which errors name them.
SIGNALS = ("position", "orientation", "velocity", "yaw_rate", "command", "feet", "joints", "contact", "swing")


class Signal(Settings):
    """Where one signal is: a topic and field of a bag, or columns of a CSV file."""

    topic: str | tuple[str, ...] | None = Field(
        None, description="for bags: the topic, or four topics, one for each leg"
    )
    field: str | tuple[str, ...] | None = Field(
        None,
        description="for bags: dotted path in the message, or a list of them side by side; null: derived from the "
        "message's type",
    )
    stamps: Literal["header", "log"] | None = Field(
        None, description="for bags: stamps of this signal's topic; null: as for all"
    )
    optional: bool = Field(False, description="whether a log without it is accepted")
    file: str | None = Field(None, description="for CSV: the key in csv.files; null: the only file")
    columns: tuple[int | str, ...] = Field(
        (), description="for CSV: column numbers from 0 on, ranges such as 4-15, or names in the header"
    )

    @property
    def topics(self) -> frozenset[str]:
        """The topics that are named."""
        return frozenset((self.topic,) if isinstance(self.topic, str) else self.topic or ())


class LegSignal(Signal):
    """A signal with values for each leg."""

    legs: tuple[Leg, Leg, Leg, Leg] = Field(("FL", "FR", "RL", "RR"), description="order of the legs")

    @model_validator(mode="after")
    def _each_leg_once(self) -> Self:
        if len(set(self.legs)) != 4:
            raise ValueError(f"legs {list(self.legs)} name a leg twice")
        return self


class Position(Signal):
    """Position of the trunk in the world."""

    unit: Length = Field("m", description="unit of length: m, cm or mm")
    offset: Vector3 = Field((0.0, 0.0, 0.0), description="the trunk's origin in the tracked body's frame [m]")


class Orientation(Signal):
    """Orientation of the trunk, base to world."""

    order: Literal["wxyz", "xyzw", "matrix", "rpy", "ypr"] = Field(
        "xyzw",
        description="order of the quaternion; matrix for a row-major matrix; rpy or ypr for roll, pitch and yaw, with "
        "R = Rz(yaw) Ry(pitch) Rx(roll)",
    )
    unit: Literal["rad", "deg"] = Field("rad", description="unit of roll, pitch and yaw: rad or deg")
    mount: Vector3 = Field(
        (0.0, 0.0, 0.0),
        description="roll, pitch, yaw of the trunk in the tracked body's frame, for a tilted tracker [rad]",
    )


class Velocity(Signal):
    """Linear velocity of the trunk."""

    unit: Literal["m/s", "cm/s", "mm/s"] = Field("m/s", description="unit of velocity: m/s, cm/s or mm/s")
    frame: Literal["base", "world"] = Field("base", description="frame of the velocity: base or world")


class YawRate(Signal):
    """Angular velocity about the trunk's z axis."""

    unit: Literal["rad/s", "deg/s"] = Field("rad/s", description="unit of angular velocity: rad/s or deg/s")


class CommandSignal(Signal):
    """The velocity command: vx, vy [m/s], yaw rate [rad/s]."""

    governs: Literal["from_row", "to_row"] = Field(
        "from_row",
        description="for CSV: whether the command of a row is in force from that row on, or was in force up to it",
    )
    yaw_unit: Literal["rad/s", "deg/s"] = Field("rad/s", description="unit of the yaw rate: rad/s or deg/s")
    max_age_s: float | None = Field(
        None,
        gt=0,
        description="longest time for which a command is held [s]; null: without end, but for 1 s if it came steadily",
    )


class Feet(LegSignal):
    """Foot positions x, y, z of each leg."""

    unit: Length = Field("m", description="unit of length: m, cm or mm")
    frame: Literal["base", "world"] = Field(
        "base", description="base: relative to the trunk in its own frame; world: in the world frame"
    )


class Joints(LegSignal):
    """Joint angles hip, thigh, knee of each leg."""

    unit: Literal["rad", "deg"] = Field("rad", description="unit of angle: rad or deg")
    names: tuple[str, ...] = Field(
        (),
        description="for bags: the 12 names in JointState, by legs as above; none: names like FL_hip_joint",
    )
    order: Literal["leg", "joint"] | tuple[str, ...] = Field(
        "leg",
        description="leg: hip, thigh, knee of each leg; joint: all hips, all thighs, all knees, each by legs; or the "
        "twelve names in the order of the log, such as FL_hip",
    )
    zero: Literal["robot", "model"] = Field(
        "robot", description="angles as the robot's own description counts them, or as legtool's simulation does"
    )


class Contact(LegSignal):
    """Contact force of each foot, or any reading that grows with it."""


class SwingSignal(Signal):
    """Two flags that say whether FL+RR and FR+RL have just swung. Each row is then the instant of a step."""


class DepthSignal(Settings):
    """Images of a depth camera, which ``replay`` reads; other commands leave them out."""

    topic: str = Field(description="for bags: depth images, in metres (32FC1) or millimetres (16UC1, compressedDepth)")
    info: str | None = Field(None, description="topic of the camera info; null: camera_info beside the images")
    stamps: Literal["header", "log"] | None = Field(None, description="stamps of the images; null: as for all")
    optional: bool = Field(False, description="whether a log without it is accepted")
    base: str | None = Field(None, description="the trunk's frame in transforms; null: base, base_link, trunk or body")
    position: Vector3 | None = Field(
        None, description="of the camera in the trunk's frame [m]; null: by the transforms of the log"
    )
    pitch: float = Field(0.0, ge=-1.6, le=1.6, description="with position: how far it looks down [rad]")

    @property
    def camera_info(self) -> str:
        """Topic of the camera info."""
        return self.info if self.info is not None else f"{self.topic.rpartition('/')[0]}/camera_info"


class Csv(Settings):
    """The shape of a log of tables: CSV, Parquet, NumPy archives or HDF5."""

    files: dict[str, Annotated[int, Field(gt=0)] | None] = Field(
        min_length=1,
        description="number of columns of each file, or null for any, by file name or pattern; several files make the "
        "log a directory",
    )
    header: bool = Field(False, description="for CSV: whether the first line names the columns")
    delimiter: str = Field(",", min_length=1, max_length=1, description="for CSV: character between columns")
    decimal: Literal[".", ","] | None = Field(
        None, description="for CSV: decimal point or comma; null: a comma too where columns are divided otherwise"
    )
    stamp: int | str | None = Field(0, description="column of each file that holds the time; null: none, see rate_hz")
    stamp_unit: Literal["s", "ms", "us", "ns"] = Field("s", description="unit of time: s, ms, us or ns")
    rate_hz: float | None = Field(None, gt=0, description="rate of the rows where they have no time [Hz]")

    @model_validator(mode="after")
    def _timed(self) -> Self:
        if (self.stamp is None) == (self.rate_hz is None):
            raise ValueError("give either stamp, the column of the time, or stamp: null and rate_hz")
        return self


class TopicSettings(Settings):
    """Where a log holds its signals, and how they are brought onto one clock, that of ``position``."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    source: str = Field("", description="description of these logs")
    csv: Csv | None = Field(None, description="files of a CSV log; null: a bag")
    position: Position
    orientation: Orientation
    velocity: Velocity | None = Field(None, description="null: the derivative of position")
    yaw_rate: YawRate | None = Field(None, description="null: the derivative of orientation")
    command: CommandSignal
    feet: Feet | None = Field(None, description="null: from the joints, by the kinematics of the robot")
    joints: Joints | None = Field(None, description="null: none; feet must then be logged")
    contact: Contact | None = Field(None, description="null: stance is found from the motion of the feet")
    swing: SwingSignal | None = Field(None, description="for CSV, if each row is the instant of a step; null otherwise")
    depth: DepthSignal | None = Field(None, description="for bags: images of a depth camera, for replay; null: none")
    alternatives: tuple[dict[str, Any], ...] = Field(
        (), description="for bags: other places of signals, in order, for logs without the topics that are named above"
    )
    stamps: Literal["header", "log"] = Field(
        "header", description="for bags: header for the stamps of the messages, log for the time of logging"
    )
    max_gap_s: float = Field(0.05, gt=0, le=10, description="longest time between samples that is interpolated [s]")
    max_jump_s: float = Field(3600.0, gt=0, description="logs with a longer jump of the stamps are rejected [s]")
    derivative_window_s: float = Field(
        0.06, gt=0, le=0.5, description="derivatives are fitted over this time to each side [s]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.feet is None and self.joints is None:
            raise ValueError("neither feet nor joints are given; one of them is needed")
        for alternative in self.alternatives:
            if unknown := alternative.keys() - set(SIGNALS):
                raise ValueError(f"alternatives: {min(unknown)} is no signal; expected some of: {', '.join(SIGNALS)}")
        for name, signal in self.signals().items():
            if self.csv is None and signal.topic is None:
                raise ValueError(f"{name} has no topic; a bag's signals need one (or csv is missing)")
            if self.csv is None and name == "swing":
                raise ValueError("swing is for CSV logs only")
            if self.csv is not None and not signal.columns:
                raise ValueError(f"{name} has no columns; a CSV log's signals need them")
            if self.csv is not None and signal.file is None and len(self.csv.files) > 1:
                raise ValueError(f"{name} has no file; expected one of: {', '.join(self.csv.files)}")
            if self.csv is not None and signal.file is not None and signal.file not in self.csv.files:
                raise ValueError(f"{name}: file {signal.file!r} is not one of: {', '.join(self.csv.files)}")
        return self

    @property
    def events(self) -> bool:
        """Whether each row of the log is the instant of a step already."""
        return self.swing is not None

    def choose(self, there: Set[str]) -> Self:
        """These settings for a log that has some topics: an alternative takes the place of signals that it lacks."""
        chosen = self
        for alternative in self.alternatives:
            offered = build(type(self), {**self.to_dict(), **alternative, "alternatives": []}).signals()
            held = chosen.signals()
            better = {
                name: offered[name]
                for name in alternative
                if (name not in held or not held[name].topics <= there) and offered[name].topics <= there
            }
            if better:
                chosen = chosen.model_copy(update=better)
        return chosen.model_copy(update={"alternatives": ()})

    def signals(self) -> dict[str, Signal]:
        """The signals that are given, by name."""
        return {name: signal for name in SIGNALS if (signal := getattr(self, name)) is not None}


def load_topics(name_or_path: str) -> TopicSettings:
    """A preset by name, or the user's own YAML by path.

    Raises:
        SettingsError: no such preset or file (the message lists them); a key is unknown, missing or out of range.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
    if not path.is_file():
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise SettingsError(f"topics {name_or_path!r}: no such preset or YAML file; presets: {presets}")
    return build(TopicSettings, read_yaml(path) or {}, source=str(path))
