"""The monitor in a closed loop: it is told what the robot knows, and all of it is kept to judge the walk again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.mcap_writer import NamedColumns
from legtool.sim.controllers.tracked import measured
from legtool.sim.walks.environment import Observation
from legtool.sim.walks.recorder import EVERY
from legtool.sim.walks.stages import StageLog
from legtool_runtime.robot import Robot
from legtool_runtime.search.monitor import (
    CAUSES,
    COLUMNS,
    NAMES,
    Event,
    MonitorSettings,
    MonitorState,
    Phase,
    Reading,
    Verdict,
    watch,
)
from legtool_runtime.search.pips import PipsPlan
from legtool_runtime.search.readings import take_reading
from legtool_runtime.tracking.tracker import Tracker

Array = NDArray[np.float64]

EVENTS = tuple(Event)
#: Topics of a recording, and what a verdict's values are called.
READINGS, VERDICTS = "/monitor/reading", "/monitor/verdict"
SAID = (*(event.value for event in EVENTS), "reaction", "phase")


class WalkMonitor:
    """Looks at a walk at the rows of its recording.

    Attributes:
        settings: its limits.
        verdict: the latest.
        readings: of all rows; NaN before the first tick of the tracker.
        verdicts: of all rows, see :func:`verdict_row`.
    """

    def __init__(self, robot: Robot, stages: StageLog) -> None:
        """Take the robot, and where events are counted."""
        self.settings = MonitorSettings.of(robot)
        self.verdict = Verdict()
        self.readings: list[Array] = []
        self.verdicts: list[Array] = []
        self._stages, self._state = stages, MonitorState.begin()
        self._ticks, self._shift_s, self._came_s = 0, 0.0, 0.0
        self._new_frame = False

    def frame(self) -> None:
        """A frame was planned."""
        self._new_frame = True

    def came(self, time_s: float, shift_s: float) -> None:
        """A plan came to the tracker, and was shifted by so much."""
        self._came_s, self._shift_s = time_s, max(self._shift_s, shift_s)

    def columns(self) -> tuple[NamedColumns, NamedColumns]:
        """What it was told and what it said, at the rows of the walk's recording."""
        rows = np.array(self.readings).reshape(-1, COLUMNS)
        said = np.array(self.verdicts).reshape(-1, len(SAID))
        return NamedColumns(READINGS, NAMES, rows), NamedColumns(VERDICTS, SAID, said)

    def look(
        self, observation: Observation, tracker: Tracker | None, answer: PipsPlan | None, *, final: bool
    ) -> Verdict:
        """What has happened by now; nothing at ticks between rows.

        Args:
            observation: of this tick.
            tracker: of the walk.
            answer: of the last frame.
            final: whether the plan ends where the robot is to go.
        """
        self._ticks += 1
        if (self._ticks - 1) % EVERY:
            return Verdict(phase=self.verdict.phase)
        if tracker is None or tracker.wanted is None:
            self.readings.append(np.full(COLUMNS, np.nan))
            self.verdicts.append(verdict_row(Verdict()))
            return self.verdict
        reading = take_reading(
            tracker, measured(observation.state), observation.time_s,
            candidates=None if answer is None else answer.candidates, frame=self._new_frame,
            shift_s=self._shift_s, final=final, age_s=observation.time_s - self._came_s,
        )  # fmt: skip
        self._new_frame, self._shift_s = False, 0.0
        before = self.verdict.phase
        self._state, self.verdict = watch(self._state, reading, self.settings)
        self.readings.append(reading.row())
        self.verdicts.append(verdict_row(self.verdict))
        for event in self.verdict.events:
            self._stages.count(f"event_{event}")
            self._stages.told.append((observation.time_s, event.value, CAUSES.get(event, "")))
        if self.verdict.phase > Phase.WALKING and before == Phase.WALKING:
            self._stages.count("aborts")
        return self.verdict


def verdict_row(verdict: Verdict) -> Array:
    """(events + 2,) 1 for each event that begins, then the reaction and the phase."""
    told = [float(event in verdict.events) for event in EVENTS]
    return np.array([*told, float(verdict.reaction), float(verdict.phase)])


def judge_again(readings: Array, settings: MonitorSettings) -> Array:
    """(n, events + 2) the verdicts of recorded readings (n, columns); rows of NaN were before the first."""
    state, rows = MonitorState.begin(), []
    for row in readings:
        verdict = Verdict()
        if np.isfinite(row[0]):
            state, verdict = watch(state, Reading.of_row(row), settings)
        rows.append(verdict_row(verdict))
    return np.array(rows).reshape(-1, len(SAID))
