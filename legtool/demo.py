"""All three lines once, on a small scale: collect, train, evaluate, export, load, use what was loaded, and walk."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import legtool_runtime
from legtool.configs.export import ExportSettings
from legtool.configs.footholds import FootholdEvalSettings, FootholdSettings, FootholdTrainSettings
from legtool.configs.motion import MotionEvalSettings, MotionTrainSettings
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.robots import load_robot
from legtool.configs.scenes import SceneSettings
from legtool.configs.steppability import NetworkSettings, SteppabilityEvalSettings, SteppabilityTrainSettings
from legtool.configs.sweep import SweepSettings
from legtool.datasets.files import replacing
from legtool.datasets.work import check_free
from legtool.evaluation.foothold import eval_foothold
from legtool.evaluation.motion import eval_motion
from legtool.evaluation.steppability import eval_steppability
from legtool.evaluation.suites.planner import eval_planner
from legtool.info import format_counts
from legtool.models.motion import Z90
from legtool.pipeline.footholds import collect_footholds
from legtool.pipeline.scenes import collect_scenes
from legtool.pipeline.sweep import collect_sweep
from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.robots.robot import build_robot
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.raycast import box, cast
from legtool.sim.worlds.world import CUBOID
from legtool.training.export import export_bundle
from legtool.training.foothold import train_foothold
from legtool.training.motion import train_motion
from legtool.training.steppability import train_steppability
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.pose import PosePlanner
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.foothold.settings import RESOLUTION_M
from legtool_runtime.perception import chain as perception
from legtool_runtime.perception.chain import Perception, PerceptionSettings
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.search.pips import Pips
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.gaits import GaitTiming

DATA, RUN, REPORT, BUNDLE, CLIMB, STONES = "data", "run", "report", "bundle", "climb", "stones"
#: Who climbs stairs, and who crosses stones.
CLIMBER, CROSSER = "hyq", "anymal_c"
#: Directories of the other lines below ``out``, and the networks of the foothold line.
FOOTHOLDS, STEPPABILITY = "footholds", "steppability"
TASKS = ("vfa", "vpa")
#: Enough heightmaps to see that the networks begin to learn; docs/foothold.md has figures of fully trained ones.
MAPS, PASSES = 12_000, 8
#: Ten simulated minutes: enough steps for every formulation, few enough for a minute's work.
EPISODES = 20
#: Enough scenes to see that a segmenter begins to learn, at a quarter of the pixels; docs/steppability.md has figures
#: of a fully trained one.
SCENES = 40
EPOCHS = 8
_SMALL = {"width": 320, "height": 240}


def run_demo(out: Path, *, seed: int, workers: int) -> Iterator[str]:
    """Run every stage of the three lines below ``out``; stages that an earlier run finished are kept.

    Yields:
        what was done, line by line.

    Raises:
        LegtoolError: ``out`` holds something else, or a stage rejects its input.
    """
    check_free(out, DATA)
    sweep = SweepSettings(seed=seed, episodes=EPISODES)
    yield f"1/12 collect: {sweep.episodes} episodes of {sweep.episode_s:g} s with a simulated {sweep.robot}"
    manifest = collect_sweep(sweep, out / DATA, workers=workers)
    yield format_counts(manifest["counts"])
    # What the last stage calls takes minutes to compile, for the first time: beside stages that leave a core idle.
    beside = multiprocessing.get_context("spawn").Process(target=_warm_up_walks, daemon=True)
    beside.start()
    yield "2/12 train: FDM, CDM and CVM in four formulations"
    yield from train_motion([out / DATA], MotionTrainSettings(), out / RUN)
    yield "3/12 eval: on episodes that the fit never saw"
    yield from eval_motion(out / RUN, MotionEvalSettings(seed=seed), out / REPORT)
    yield from _footholds(out / FOOTHOLDS, seed=seed, workers=workers)
    yield from _steppability(out / STEPPABILITY, seed=seed, workers=workers)
    yield "10/12 export: all models in one bundle, then a question to each in the runtime"
    if not (out / BUNDLE).exists():
        lines = [(out / RUN, out / REPORT), (out / STEPPABILITY / RUN, out / STEPPABILITY / REPORT)]
        lines += [(out / FOOTHOLDS / task, out / FOOTHOLDS / f"{task}_report") for task in TASKS]
        runs, measured = [run for run, _ in lines], tuple(report / "results.json" for _, report in lines)
        export_bundle(runs, out / BUNDLE, ExportSettings(seed=seed, results=measured))
    yield from _predict(out / BUNDLE)
    yield from _step_up(out / BUNDLE)
    yield from _perceive(out / BUNDLE)
    beside.join()
    yield from _climb(out / CLIMB, seed=seed)
    yield from _cross(out / STONES, seed=seed)
    reports = (
        *out.glob("*report/report.html"),
        *sorted(out.glob("*/*report/report.html")),
        out / CLIMB / "report.html",
        out / STONES / "report.html",
    )
    yield f"reports: {', '.join(str(report) for report in reports)}"
    yield f"bundle: {out / BUNDLE}"


def _footholds(out: Path, *, seed: int, workers: int) -> Iterator[str]:
    """Labelled heightmaps, the two networks of the paper, and their evaluation."""
    check_free(out, DATA)
    maps = FootholdSettings(robot=SweepSettings().robot, seed=seed, samples=MAPS)
    yield f"4/12 collect: {maps.samples} heightmaps, labelled by the exact criteria for the legs of {maps.robot}"
    manifest = collect_footholds(maps, out / DATA, workers=workers)
    yield format_counts(manifest["counts"])
    yield "5/12 train: foothold selection (VFA) and safe footholds over hip heights (VPA)"
    training = FootholdTrainSettings(seed=seed, epochs=PASSES)
    for task in TASKS:
        yield from train_foothold(task, [out / DATA], training, out / task, workers=workers)
    yield "6/12 eval: on terrain that the networks never saw"
    evaluation = FootholdEvalSettings(vfa_samples=2000, vpa_samples=1000, bootstrap=200)
    for task in TASKS:
        yield from eval_foothold(task, out / task, None, evaluation, out / f"{task}_report", workers=workers)


def _steppability(out: Path, *, seed: int, workers: int) -> Iterator[str]:
    """Scenes, a small segmenter, and its evaluation."""
    check_free(out, DATA)
    robot = load_robot(SweepSettings().robot)
    small = out / "robot.yaml"
    if not small.is_file():
        out.mkdir(parents=True, exist_ok=True)
        with replacing(small) as temporary:
            temporary.write_text(robot.replace(camera={**robot.camera.to_dict(), **_SMALL}).to_yaml())
    scenes = SceneSettings(robot=str(small), seed=seed, scenes=SCENES, frames=4)
    yield f"7/12 collect: {scenes.scenes} scenes of primitive shapes, seen by the depth camera of {robot.name}"
    manifest = collect_scenes(scenes, out / DATA, workers=workers)
    yield format_counts({key: n for key, n in manifest["counts"].items() if not key.startswith("pixels")})
    yield "8/12 train: a segmenter that labels where a foot may step"
    network = NetworkSettings(width=16, depth=10)
    training = SteppabilityTrainSettings(seed=seed, network=network, epochs=EPOCHS, coarse_epochs=0, device="cpu")
    # For images this small a second thread would mostly wait.
    yield from train_steppability([out / DATA], training, out / RUN, workers=1)
    yield "9/12 eval: on scenes that the segmenter never saw"
    evaluation = SteppabilityEvalSettings(seed=seed, bootstrap=200)
    yield from eval_steppability(out / RUN, evaluation, out / REPORT, workers=workers)


def _warm_up_walks() -> None:
    """Compile all that :func:`_climb` and :func:`_cross` call, into the user's cache, behind all else that runs."""
    os.nice(10)
    robot = build_robot(load_robot(CLIMBER))
    GuidedController(robot, GaitTiming.trot()).warm_up()
    PosePlanner(Criteria(robot.geometry)).warm_up()
    crosser = TrackedController(build_robot(load_robot(CROSSER)))
    crosser.warm_up()
    Pips(crosser.robot.geometry).warm_up()
    perception.warm_up()


def _climb(out: Path, *, seed: int) -> Iterator[str]:
    """One climb of stairs in closed loop, filmed."""
    settings = PlannerEvalSettings(suite="stairs_04", planners=("vital",), robot=CLIMBER, trials=1, seed=seed)
    yield f"11/12 walk: {CLIMBER} climbs stairs of 10 cm on its own map, feet and poses chosen on the way"
    yield from eval_planner(None, settings, out)
    yield f"  film: {out / 'films' / 'stairs_04.vital.mp4'}"


def _cross(out: Path, *, seed: int) -> Iterator[str]:
    """One walk over sparse stones in closed loop, filmed."""
    world = "sparse_stepping_stones"
    settings = PlannerEvalSettings(suite=world, planners=("quadpips",), robot=CROSSER, trials=1, seed=seed)
    yield f"12/12 walk: {CROSSER} crosses sparse stones over a pit, its feet planned on regions that its camera sees"
    yield from eval_planner(None, settings, out)
    yield f"  film: {out / 'films' / f'{world}.quadpips.mp4'}"


def _predict(path: Path) -> Iterator[str]:
    """One prediction as on a robot that stands and is commanded to walk."""
    bundle = legtool_runtime.load_bundle(path)
    rest = np.zeros(3)
    state = legtool_runtime.MotionState(rest, rest, rest, bundle.robot.stance, swing_pair=0)
    speeds = (0.2, 0.5)
    step = bundle.motion.predict(state, [[speed, 0.0, 0.0] for speed in speeds])
    for index, speed in enumerate(speeds):
        foot = 1e3 * step.foot_displacement[index, 0, 0]
        half = 1e3 * Z90 * step.foot_displacement_std[index, 0, 0]
        yield f"  from rest at {speed} m/s the front left foot goes {foot:.0f} mm ± {half:.0f} mm (90 %)"


def _step_up(path: Path) -> Iterator[str]:
    """One foothold as on a robot whose front left foot is about to land on the edge of a step of 10 cm."""
    bundle = legtool_runtime.load_bundle(path)
    criteria, gait = Criteria(bundle.robot, bundle.vfa.criteria), Gait(time_to_touchdown_s=0.2)
    selector = FootholdSelector(criteria, method="verified", network=bundle.vfa)
    position, twist = (0.0, 0.0, bundle.robot.standing_height), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    walking: dict[str, Any] = {
        "leg": 0,
        "base_position": position,
        "attitude": (0.0, 0.0, 0.0),
        "base_twist": twist,
        "gait": gait,
    }
    heights, x = np.zeros((101, 101), np.float32), RESOLUTION_M * (np.arange(101) - 50)
    edge = selector.select_in(HeightMap(heights, RESOLUTION_M, np.zeros(2)), **walking).nominal[0]
    heights[x > edge] = 0.1
    found = selector.select_in(HeightMap(heights, RESOLUTION_M, np.zeros(2)), **walking)
    moved = "" if found.position is None else f", {1e2 * (found.position[0] - edge):+.0f} cm from the edge"
    yield f"  front left foot at a step of 10 cm: {found.selection}{moved}, chosen by {found.selection.by}"


def _perceive(path: Path) -> Iterator[str]:
    """One frame as on a robot that stands in front of a slab of 8 cm."""
    segmenter = legtool_runtime.load_bundle(path).steppability
    sensor = segmenter.sensor
    assert sensor is not None
    base = np.eye(4)
    base[2, 3] = sensor.standing_height
    builder = Builder()
    builder.add(CUBOID, box([1.0, 0.0, 0.04], np.eye(3), (0.3, 0.5, 0.04)), 0.08)
    depth = cast(builder.world.scene, sensor.camera, base @ sensor.transform_camera_to_base, far=6.0).depth
    with Perception(
        sensor.camera,
        sensor.transform_camera_to_base,
        standing_height=sensor.standing_height,
        settings=PerceptionSettings(egocan=EgocanSettings(lift=0.5)),
    ) as perception:
        regions = perception.update(depth, base, labels=segmenter(depth)).regions
    heights = regions.poses[~regions.assumed, 2, 3]
    on_slab = int((np.abs(heights - 0.08) < 0.01).sum())
    yield f"  in front of a slab of 8 cm: {len(regions)} planar regions, {on_slab} of them on the slab"
