"""Planners in closed loop: worlds walked by each planner from the same starts, and what came of it.

The motion paper's experiments (IV-B, Table II) are the suite ``scenarios``.
"""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.rows import is_horizon
from legtool.datasets.files import replacing
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.work import RESULTS
from legtool.errors import SettingsError
from legtool.evaluation.judges import judge_planner
from legtool.evaluation.report.film import write_animation, write_mp4
from legtool.evaluation.report.results import provenance, write_results
from legtool.evaluation.suites.comparison import causes_of, compare
from legtool.evaluation.suites.planner_metrics import describe_row, summarise
from legtool.evaluation.suites.planner_plots import filmstrip, world_view
from legtool.evaluation.suites.planner_report import Drawings, write_planner_report
from legtool.evaluation.suites.suite import Suite, decides_of, worlds_of
from legtool.evaluation.suites.suite_checks import check
from legtool.evaluation.suites.suite_robot import suite_robot
from legtool.evaluation.suites.trial import Walked, record_of, walk_trial
from legtool.evaluation.suites.trials import TrialKey, Trials, trial_key
from legtool.evaluation.suites.walkers import BLIND
from legtool.workers import Workers
from legtool_runtime import Bundle, load_bundle

RECORDINGS, FILMS = "recordings", "films"
#: Name of the metadata in which a recording says how its walk was planned.
RECORDED = "replay"


def eval_planner(
    bundle_path: Path | None, settings: PlannerEvalSettings, out: Path, *, workers: int | Workers = 1
) -> Iterator[str]:
    """Walk every world by every planner, and write results.json and report.html.

    Trials that an earlier run finished in ``out`` are kept, where nothing that decides them has changed: contents of
    world, robot, controller and bundle, and settings.

    Args:
        bundle_path: with a motion line; None where no planner needs one.
        settings: worlds, planners, trials, map, and the planners' own.
        out: directory of the results.
        workers: processes; outcomes do not depend on it, planning times may.

    Yields:
        the table, line by line.

    Raises:
        BundleError: the bundle is damaged, or has no motion line.
        RobotError: it was made for another robot.
        SettingsError: a world, robot or controller that does not exist; a planner without the bundle that it needs.
        OutputError: ``out`` holds something else.
    """
    worlds = worlds_of(settings)
    if bundle_path is None and any(settings.of_row(name)[0] == "velocity" for name in settings.planners):
        raise SettingsError("--bundle is missing: the planner velocity needs a bundle with a motion line")
    bundle = None if bundle_path is None else load_bundle(bundle_path)
    suite = Suite(settings, bundle_path, suite_robot(settings, bundle), worlds)
    check(suite, bundle)
    decides = decides_of(suite, bundle)
    keys = [
        trial_key(name, row, k, decides[name, row])
        for k in range(settings.trials)  # a suite that is looked at half-way has as many trials of each kind
        for name in suite.worlds
        for row in settings.rows
    ]
    with Trials(out, "planner", workers=workers) as trials:
        trials.run(
            keys,
            functools.partial(run_trial, trials, suite),
            wanted=lambda key: _wanted(key, settings),
        )
        records: dict[tuple[str, str], list[dict[str, Any]]] = {
            (name, row): [] for name in suite.worlds for row in settings.rows
        }
        for key in keys:
            records[key.world, key.planner].append(trials.read(key))
        metrics = {
            f"{name}.{row}.{key}": value
            for (name, row), found in records.items()
            for key, value in {**summarise(found, settings.deadline_s), **causes_of(found)}.items()
        } | compare(records)
        origin = provenance(
            settings.to_dict(), seed=settings.seed, data_hash=_bundle_hash(bundle), suite=settings.suite,
            robot=suite.robot.name,
        )  # fmt: skip
        verdict = judge_planner(metrics, list(suite.worlds), settings.rows)
        write_results(out / RESULTS.marker, metrics, origin, verdict=verdict.to_dict())
        _publish(trials, out, keys, settings)
        drawings = {(key.world, key.planner): _drawings(trials, key) for key in keys if key.number == 0}
        write_planner_report(out / "report.html", metrics, records, drawings, origin, verdict)
    for (name, row), found in records.items():
        yield describe_row(name, row, found)
    yield from verdict.lines()
    for key in keys:
        if left_out := decides[key.world, key.planner].get("left_out"):
            yield (
                f"the planner left out {len(left_out)} commands outside the range that its models were fitted to, such "
                f"as vx, vy, yaw rate {left_out[0]}; collect data with such commands, or plan with them all the same "
                "by --set extrapolate=true"
            )
            break


def run_trial(trials: Trials, suite: Suite, key: TrialKey) -> None:
    """Walk one trial and write its record; of the first ones a film, and of the very first a recording and drawings."""
    bundle = None if suite.bundle_path is None else load_bundle(suite.bundle_path)
    name = f"{key.world}.{key.planner}.{key.number}"
    who, where = suite.robot_in(key.world, key.planner), suite.worlds[key.world]
    row, settings = suite.settings.of_row(key.planner)
    walked = walk_trial(bundle, who, where, settings, row, key.number, name=name)
    if len(walked.recording) > 1:
        if key.number < suite.settings.records:
            path = trials.beside(key, _recorded(suite.settings))
            write_recording(path, walked, suite.settings, world=key.world, planner=key.planner)
        if key.number == 0:
            _draw(trials, key, walked)
    if walked.film is not None:
        frames = list(walked.film.frames(swing_height_max=suite.robot.swing_height_max))
        write_mp4(trials.beside(key, "mp4"), frames, rate_hz=walked.film.rate_hz)
        if key.number == 0:
            write_animation(trials.beside(key, "webp"), frames, rate_hz=walked.film.rate_hz)
    commanded = row == BLIND or is_horizon(row)  # models of the commanded controller say nothing of other gaits
    trials.write(key, record_of(walked, bundle if commanded else None))  # last: a trial that is there is whole


def _wanted(key: TrialKey, settings: PlannerEvalSettings) -> tuple[str, ...]:
    """Endings of what is to lie beside a trial's record."""
    recorded = (_recorded(settings),) if key.number < settings.records else ()
    return (*recorded, "mp4") if key.number < settings.films else recorded


def _recorded(settings: PlannerEvalSettings) -> str:
    """Ending of a trial's recording."""
    return "images.mcap" if settings.record_images else "mcap"


def write_recording(path: Path, walked: Walked, settings: PlannerEvalSettings, **metadata: str) -> None:
    """Write what a robot measured, saw, knew and planned on a trial that is recorded.

    With ``record_images`` the recording holds every tick and all images, and what a replay needs to plan the same.
    """
    replayable = {} if walked.replay is None else {RECORDED: json.dumps(walked.replay)}
    held = walked.every_tick if settings.record_images else None
    rows = (walked.recording, walked.joint_positions, walked.joint_velocities) if held is None else held
    write_mcap(
        path,
        rows[0],
        joint_positions=rows[1],
        joint_velocities=rows[2],
        plan=walked.plan if held is None else None,
        beside=walked.beside if held is None else (),
        frames=True,
        more=walked.messages,
        metadata={"robot": walked.robot.geometry.name, **metadata, **replayable},
    )


def _draw(trials: Trials, key: TrialKey, walked: Walked) -> None:
    for what, drawing in (
        ("above.svg", world_view(walked)),
        ("strip.svg", filmstrip(walked)),
    ):
        with replacing(trials.beside(key, what)) as temporary:
            temporary.write_text(drawing, encoding="utf-8")


def _publish(trials: Trials, out: Path, keys: Sequence[TrialKey], settings: PlannerEvalSettings) -> None:
    """Recordings and films of first trials under names that people look for; those of later ones have a number."""
    for folder, ending in ((RECORDINGS, _recorded(settings)), (FILMS, "mp4")):
        for key in keys:
            wanted = key.number < settings.records if folder == RECORDINGS else key.number == 0
            if wanted and (source := trials.beside(key, ending)).is_file():
                (out / folder).mkdir(exist_ok=True)
                number = f".{key.number}" if key.number else ""
                suffix = ending.rpartition(".")[2]
                with replacing(out / folder / f"{key.world}.{key.planner}{number}.{suffix}") as temporary:
                    shutil.copyfile(source, temporary)


def _drawings(trials: Trials, key: TrialKey) -> Drawings:
    above, strip, film = (trials.beside(key, ending) for ending in ("above.svg", "strip.svg", "webp"))
    return Drawings(
        above.read_text(encoding="utf-8") if above.is_file() else "",
        strip.read_text(encoding="utf-8") if strip.is_file() else "",
        film.read_bytes() if film.is_file() else b"",
    )


def _bundle_hash(bundle: Bundle | None) -> str:
    return "no bundle" if bundle is None else str(bundle.manifest["content_sha256"])
