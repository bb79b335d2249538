"""Planners in closed loop: worlds walked by each planner from the same starts, and what came of it.

The motion paper's experiments (IV-B, Table II) are the suite ``scenarios``.
"""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from legtool.configs.climbs import CLIMBS, Climb
from legtool.configs.courses import COURSES, Course, any_world
from legtool.configs.families import FAMILIES, Family
from legtool.configs.planner import PlannerEvalSettings
from legtool.datasets.contents import bundle_content, controller_content
from legtool.datasets.files import replacing
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.work import RESULTS
from legtool.errors import SettingsError
from legtool.evaluation.report.film import write_animation, write_mp4
from legtool.evaluation.report.results import provenance, write_results
from legtool.evaluation.suites.planner_metrics import describe_row, summarise
from legtool.evaluation.suites.planner_plots import filmstrip, world_view
from legtool.evaluation.suites.planner_report import Drawings, write_planner_report
from legtool.evaluation.suites.suite_robot import SuiteRobot, suite_robot
from legtool.evaluation.suites.trial import Walked, record_of, walk_trial
from legtool.evaluation.suites.trials import TrialKey, Trials, trial_key
from legtool.evaluation.suites.walkers import (
    BLIND,
    HEURISTIC,
    POSES,
    REGIONS,
    SCRIPTED,
    Place,
    motion_planner,
    world_settings,
)
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.worlds.build import build_world
from legtool_runtime import Bundle, load_bundle
from legtool_runtime.foothold import Criteria
from legtool_runtime.tracking.gaits import GaitTiming

RECORDINGS, FILMS = "recordings", "films"
#: Name of the metadata in which a recording says how its walk was planned.
RECORDED = "replay"
#: Settings that say which trials there are, not how one goes; and those that a blind planner does not look at.
_WHICH = (
    "suite", "planners", "trials", "horizons", "films", "records", "record_images", "deadline_s", "robot", "mjcf",
    "mjcf_names", "black_box",
)  # fmt: skip
_SIGHT = (
    "map", "regions", "swing", "lift", "expansions", "camera", "camera_size", "actions", "cruise_speed", "planner",
    "elevation", "costmap", "pose", "criteria", "speed", "latency_s", "monitor",
)  # fmt: skip


class Suite(NamedTuple):
    """All that the trials of a suite are made from.

    Attributes:
        settings: of the suite.
        bundle_path: that planners plan with, None where all are blind.
        robot: who walks.
        worlds: by the name that they have in results; of a course each trial draws its own.
    """

    settings: PlannerEvalSettings
    bundle_path: Path | None
    robot: SuiteRobot
    worlds: dict[str, Place]

    def robot_in(self, world: str) -> SuiteRobot:
        """Who walks a world: the suite's robot, or the one that a climb names."""
        where = self.worlds[world]
        if not isinstance(where, Climb) or where.robot is None:
            return self.robot
        return suite_robot(self.settings.replace(robot=where.robot, mjcf=None, camera=None), None)


def eval_planner(
    bundle_path: Path | None, settings: PlannerEvalSettings, out: Path, *, workers: int = 1
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
    worlds = _worlds(settings)
    if bundle_path is None and "velocity" in settings.planners:
        raise SettingsError("--bundle is missing: the planner velocity needs a bundle with a motion line")
    bundle = None if bundle_path is None else load_bundle(bundle_path)
    suite = Suite(settings, bundle_path, suite_robot(settings, bundle), worlds)
    _check(suite, bundle)
    decides = _decides(suite, bundle)
    keys = [
        trial_key(name, row, k, decides[name, row])
        for k in range(settings.trials)  # a suite that is looked at half-way has as many trials of each kind
        for name in suite.worlds
        for row in settings.rows
    ]
    with Trials(out, "planner") as trials:
        trials.run(
            keys,
            functools.partial(run_trial, trials, suite),
            workers=workers,
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
            for key, value in summarise(found, settings.deadline_s).items()
        }
        origin = provenance(
            settings.to_dict(), seed=settings.seed, data_hash=_bundle_hash(bundle), suite=settings.suite,
            robot=suite.robot.name,
        )  # fmt: skip
        write_results(out / RESULTS.marker, metrics, origin)
        _publish(trials, out, keys, settings)
        drawings = {(key.world, key.planner): _drawings(trials, key) for key in keys if key.number == 0}
        write_planner_report(out / "report.html", metrics, records, drawings, origin)
    for (name, row), found in records.items():
        yield describe_row(name, row, found)


def run_trial(trials: Trials, suite: Suite, key: TrialKey) -> None:
    """Walk one trial and write its record; of the first ones a film, and of the very first a recording and drawings."""
    bundle = None if suite.bundle_path is None else load_bundle(suite.bundle_path)
    name = f"{key.world}.{key.planner}.{key.number}"
    walked = walk_trial(
        bundle, suite.robot_in(key.world), suite.worlds[key.world], suite.settings, key.planner, key.number, name=name
    )
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
    trials.write(key, record_of(walked, bundle))  # last: a trial that is there is whole


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


def _worlds(settings: PlannerEvalSettings) -> dict[str, Place]:
    """Worlds by name; of several with one name the later ones are numbered."""
    worlds: dict[str, Place] = {}
    for given in settings.worlds:
        world = COURSES.get(given) or CLIMBS.get(given) or FAMILIES.get(given) or any_world(given)
        name, number = world.name, 2
        while name in worlds:
            name, number = f"{world.name}_{number}", number + 1
        worlds[name] = world
    return worlds


def _check(suite: Suite, bundle: Bundle | None) -> None:
    """Refuse at once what cannot plan or walk: models of another instant, a policy that is not as described."""
    settings = suite.settings
    if bundle is not None and "velocity" in settings.planners:
        motion_planner(bundle, settings, next(row for row in settings.rows if row.startswith("h")))
    robots = {name: suite.robot_in(name) for name in suite.worlds}
    for name, world in suite.worlds.items():
        build_world(world_settings(world, robots[name], settings, 0), robot=robots[name].name).require_goal()
    on_feet = (SCRIPTED, *POSES, *REGIONS, *HEURISTIC)
    tracked = [planner for planner in settings.planners if planner in on_feet]
    if tracked and settings.black_box is not None:
        raise SettingsError(
            f"planner {tracked[0]}: it plans feet, which the controller {settings.black_box} does not take; leave "
            "black_box out, or choose other planners"
        )
    if SCRIPTED in tracked:
        others = [name for name, world in suite.worlds.items() if not isinstance(world, Course)]
        if others:
            raise SettingsError(
                f"planner scripted: world {others[0]} has no script; expected courses, any of {', '.join(COURSES)}"
            )
        TrackedController(suite.robot.build(), settings.tracker)
    if any(row in (*POSES, *HEURISTIC) for row in tracked):
        _check_poses(suite, bundle, robots)
    if any(row in REGIONS or HEURISTIC.get(row, 0.0) is None for row in tracked):
        _check_regions(suite, bundle)
    make_controller(suite.robot.build(), settings.black_box)


def _check_poses(suite: Suite, bundle: Bundle | None, robots: dict[str, SuiteRobot]) -> None:
    """Refuse worlds and robots in which no feet can be chosen on the way."""
    for name, world in suite.worlds.items():
        if isinstance(world, Course):
            raise SettingsError(
                f"world {name}: its feet go by script; planners that choose footholds expect climbs, any of "
                f"{', '.join(CLIMBS)}, or other worlds"
            )
        robot = robots[name].build()
        GuidedController(robot, GaitTiming.trot())
        if suite.settings.criteria == "networks":
            if bundle is None:
                raise SettingsError("--bundle is missing: criteria=networks needs a bundle with a foothold line")
            Criteria(robot.geometry).refuse_other(bundle.vfa.robot, bundle.vfa)


def _check_regions(suite: Suite, bundle: Bundle | None) -> None:
    """Refuse worlds whose feet go by script, and a segmenter that was trained for another camera."""
    for name, world in suite.worlds.items():
        if isinstance(world, Course):
            raise SettingsError(
                f"world {name}: its feet go by script; planners on regions expect other worlds, like --suite quadpips"
            )
    if suite.settings.regions != "camera" or bundle is None or "steppability" not in bundle.lines:
        return
    sensor = bundle.steppability.sensor
    if sensor is not None and sensor.camera != suite.robot.camera.camera():
        width, height = sensor.camera.width, sensor.camera.height
        raise SettingsError(
            f"the bundle's segmenter was trained for another camera, with images of {width} x {height}; set "
            f"camera_size=[{width},{height}] and the camera that it was trained for"
        )


def _decides(suite: Suite, bundle: Bundle | None) -> dict[tuple[str, str], dict[str, Any]]:
    """By world and planner all that decides its trials, but their number."""
    every = suite.settings.to_dict()
    shared = {
        "settings": {name: value for name, value in every.items() if name not in (*_WHICH, *_SIGHT)},
        "controller": controller_content(suite.settings.black_box),
    }
    sight = {"sight": {name: every[name] for name in _SIGHT}}
    if bundle is not None:
        sight["bundle"] = bundle_content(bundle.manifest)
    return {
        (name, row): {
            **shared,
            "robot": suite.robot_in(name).content(),
            "world": _content(world),
            **({} if row in (BLIND, SCRIPTED) else sight),
        }
        for name, world in suite.worlds.items()
        for row in suite.settings.rows
    }


def _content(world: Place) -> dict[str, Any]:
    """All that a world is made from."""
    if isinstance(world, Climb):
        return {"climb": world.to_dict(), "world": world.settings().to_dict()}
    if isinstance(world, Family):
        # One member stands for the rule by which all are drawn.
        return {"family": world.to_dict(), "world": world.settings().to_dict(), "drawn": world.settings(0).to_dict()}
    return world.to_dict()


def _bundle_hash(bundle: Bundle | None) -> str:
    return "no bundle" if bundle is None else str(bundle.manifest["content_sha256"])
