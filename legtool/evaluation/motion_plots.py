"""Figures of the motion report."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import norm

from legtool.evaluation.held_out import AXES, HeldOut, axis_unit
from legtool.evaluation.report.drawing import GREY, RED, draw
from legtool.evaluation.report.results import Metric

Array = NDArray[np.float64]

COLOURS = {"fdm": "#1f5fa8", "cdm": "#c4511c", "cvm": "#2b7d4f"}
#: Points of a scatter beyond this say nothing new and make the page heavy.
_MOST_POINTS = 1500
#: Longest stretch of the velocity-tracking plot, and the part of it that is shown enlarged [s].
_TRACKING_S, _ENLARGED_S = 300.0, 30.0


def scale_of(model: str, axis: str) -> tuple[float, str]:
    """Factor and unit in which an axis is shown: millimetres and degrees for displacements."""
    unit = axis_unit(model, axis)
    return {"m": (1e3, "mm"), "rad": (180 / np.pi, "°"), "rad/s": (1.0, "rad/s")}.get(unit, (1.0, unit))


def velocity_tracking(held_out: HeldOut) -> str:
    """Commanded and measured velocity over time (the paper's Fig. 3), of the longest episode."""
    steps = held_out.steps
    longest = int(np.argmax(np.bincount(steps.group)))
    rows = np.flatnonzero((steps.group == longest) & (steps.time_s <= _TRACKING_S))
    names = ("vx [m/s]", "vy [m/s]", "yaw rate [rad/s]")
    shown = [i for i in range(3) if i == 0 or np.ptp(steps.command[:, i]) > 1e-6]
    time = steps.time_s[rows]
    breaks = np.flatnonzero(np.diff(time) > 1.5) + 1

    enlarged = bool(time[-1] > 2 * _ENLARGED_S)
    panels = [0, *shown] if enlarged else shown

    def paint(figure: Figure) -> None:
        for ax, i in zip(np.atleast_1d(figure.subplots(len(panels), 1)), panels, strict=True):
            command, velocity, at = (
                np.insert(values.astype(float), breaks, np.nan)
                for values in (steps.command[rows, i], steps.velocity[rows, i], time)
            )
            ax.plot(at, velocity, color=COLOURS["cvm"], lw=0.9, label="measured at the step's instant")
            ax.step(at, command, where="post", color=RED, lw=1.3, label="commanded")
            ax.set_ylabel(names[i])
            ax.margins(x=0.01)
        if enlarged:
            middle = 0.5 * time[-1]
            figure.axes[0].set_xlim(middle - 0.5 * _ENLARGED_S, middle + 0.5 * _ENLARGED_S)
        figure.axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
        figure.axes[-1].set_xlabel("time [s]")

    return draw(paint, 8.6, 1.0 + 1.7 * len(panels))


def predicted_against_measured(held_out: HeldOut) -> str:
    """One scatter for each model and axis; on the diagonal the prediction was right."""
    pick = np.linspace(0, len(held_out.steps) - 1, min(len(held_out.steps), _MOST_POINTS)).astype(int)

    def cell(ax: Axes, model: str, axis: str, columns: tuple[int, ...]) -> None:
        scale, unit = scale_of(model, axis)
        measured = scale * held_out.steps.targets[model][pick][:, columns].ravel()
        predicted = scale * held_out.means["full"][model][pick][:, columns].ravel()
        low, high = np.percentile(measured, [0, 100])
        margin = 0.05 * max(high - low, 1e-9)
        ends = np.array([low - margin, high + margin])
        ax.plot(ends, ends, color=GREY, lw=0.8)
        ax.scatter(measured, predicted, s=4, color=COLOURS[model], alpha=0.35, linewidths=0, rasterized=True)
        ax.set(xlim=ends, ylim=ends, title=f"{model.upper()} {axis} [{unit}]")
        ax.set_aspect("equal")

    return _grid(cell, x="measured", y="predicted", height=2.35)


def residuals_by_axis(held_out: HeldOut) -> str:
    """Histogram of the residuals of each model and axis, with the width that the Bayesian models expect."""

    def cell(ax: Axes, model: str, axis: str, columns: tuple[int, ...]) -> None:
        scale, unit = scale_of(model, axis)
        error = scale * held_out.error("full", model)[:, columns].ravel()
        std = scale * float(np.sqrt((held_out.std[model][:, columns] ** 2).mean())) + 1e-12
        reach = float(np.percentile(np.abs(error), 99.5)) * 1.15 + 1e-12
        ax.hist(error, bins=np.linspace(-reach, reach, 41).tolist(), density=True, color=COLOURS[model], alpha=0.55)
        grid = np.linspace(-reach, reach, 200)
        ax.plot(grid, norm.pdf(grid, scale=std), color="#111827", lw=1)
        ax.axvline(0, color=GREY, lw=0.7)
        ax.set(title=f"{model.upper()} {axis} [{unit}]", yticks=[], xlim=(-reach, reach))

    return _grid(cell, x="predicted − measured", y="density", height=1.7)


def residuals_by_command(held_out: HeldOut) -> str:
    """Median and spread of the residuals on x, over the commanded forward velocity."""
    command = held_out.steps.command[:, 0]
    bins = np.round(command / 0.1).astype(int)

    def paint(figure: Figure) -> None:
        for ax, model in zip(_column(figure, 3), AXES, strict=True):
            scale, unit = scale_of(model, "x")
            error = scale * held_out.error("full", model)[:, AXES[model]["x"]]
            for number in np.unique(bins):
                low, first, middle, third, high = np.percentile(error[bins == number], [5, 25, 50, 75, 95])
                at = 0.1 * number
                ax.plot([at, at], [low, high], color=COLOURS[model], lw=1)
                ax.plot([at, at], [first, third], color=COLOURS[model], lw=7, alpha=0.5, solid_capstyle="butt")
                ax.plot([at], [middle], "o", ms=3.5, color="#111827")
            ax.axhline(0, color=GREY, lw=0.7)
            ax.set_ylabel(f"{model.upper()} x [{unit}]")
        figure.axes[-1].set_xlabel("commanded vx [m/s]")

    return draw(paint, 8.6, 5.4)


def coverage(held_out: HeldOut, metrics: Mapping[str, Metric]) -> str:
    """Held-out coverage of 90 % intervals by axis, and of all nominal levels."""
    entries = [(model, axis) for model in AXES for axis in AXES[model]]
    levels = np.linspace(0.0, 0.99, 34)

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=[1.35, 1])
        for row, (model, axis) in enumerate(entries):
            entry = metrics[f"{model}.bayesian.{axis}.coverage90"]
            low, high = entry["ci95"] or (entry["value"], entry["value"])
            left.plot([100 * low, 100 * high], [row, row], color=COLOURS[model], lw=2)
            left.plot([100 * entry["value"]], [row], "o", ms=5, color=COLOURS[model])
        left.axvspan(85, 95, color="#e5e7eb", zorder=0)
        left.axvline(90, color=GREY, lw=0.8)
        left.set_yticks(range(len(entries)), [f"{model.upper()} {axis}" for model, axis in entries])
        left.invert_yaxis()
        left.set(title="held-out steps inside the 90 % interval", xlabel="share [%]")
        left.grid(axis="y", visible=False)
        right.plot([0, 100], [0, 100], color=GREY, lw=0.8)
        for model in AXES:
            ratio = np.abs(held_out.error("bayesian", model)) / np.maximum(held_out.std[model], 1e-12)
            inside = [100 * float((ratio <= norm.ppf(0.5 + level / 2)).mean()) for level in levels]
            right.plot(100 * levels, inside, color=COLOURS[model], label=model.upper())
        right.set(
            title="of intervals of every level", xlabel="nominal level [%]", ylabel="inside [%]", xlim=(0, 100),
            ylim=(0, 100),
        )  # fmt: skip
        right.legend(frameon=False, loc="upper left")

    return draw(paint, 8.6, 3.6)


def _column(figure: Figure, rows: int) -> list[Axes]:
    return list(np.atleast_1d(figure.subplots(rows, 1, sharex=True)))


def _grid(cell: Callable[[Axes, str, str, tuple[int, ...]], None], *, x: str, y: str, height: float) -> str:
    """Models down, axes across."""
    columns = max(len(axes) for axes in AXES.values())

    def paint(figure: Figure) -> None:
        grid = figure.subplots(len(AXES), columns)
        for row, (model, axes) in zip(grid, AXES.items(), strict=True):
            for ax, (axis, pooled) in zip(row, axes.items(), strict=False):
                cell(ax, model, axis, pooled)
            for ax in row[len(axes) :]:
                ax.set_axis_off()
        figure.supxlabel(x, fontsize=9)
        figure.supylabel(y, fontsize=9)

    return draw(paint, 8.6, height * len(AXES))
