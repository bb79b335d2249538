"""One rendered walk through perception and its baseline, scored against the faces that are there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.configs.perception import PerceptionEvalSettings
from legtool.configs.robots import RobotSettings
from legtool.evaluation.suites import region_scores as columns
from legtool.evaluation.suites.plane_segmentation import segment_planes
from legtool.evaluation.suites.region_scores import Patches, covered, jitter, polygons, score
from legtool.sim.sensors.depth_camera import mount
from legtool.sim.sensors.sequence import SequenceFrame, walk_through
from legtool.sim.worlds.faces import FaceMap, face_map
from legtool_runtime.perception import STEPPABLE
from legtool_runtime.perception.chain import Perception, PerceptionSettings
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.perception.regions import Regions, RegionSettings, convex_regions
from legtool_runtime.perception.steppability import Segmenter
from legtool_runtime.terrain.elevation import ElevationGrid
from legtool_runtime.terrain.settings import ElevationSettings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: What the depth images are, and by what regions are made of them.
DEPTHS, METHODS = ("exact", "noisy"), ("warm", "cold", "baseline")
#: Faces beyond the walk that are looked at [m], in steps of which the map's corner is rounded.
_AROUND, _ROUND = 2.6, 0.1
#: Side of the squares within which one return says that the place was seen [cells].
_SEEN = 4
#: Height over range at the floor image's rim.
_RIM = float(np.tan(0.5 * EgocanSettings().vertical_field_of_view))


@dataclass
class Tally:
    """Sums over the scored frames of one walk, for one depth and method; shares and means are made of them later."""

    sums: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, value: float) -> None:
        """Add to one sum."""
        self.sums[name] = self.sums.get(name, 0.0) + float(value)

    def add_scores(self, group: str, scores: Array, cell_m2: float) -> None:
        """Add the scores (k, 7) of the patches of one group."""
        on_main, cells = scores[:, columns.ON_MAIN], scores[:, columns.CELLS]
        turned = scores[np.isfinite(scores[:, columns.NORMAL_ERROR]), columns.NORMAL_ERROR]
        for name, value in {
            "regions": len(scores),
            "pure": scores[:, columns.PURE].sum(),
            "area": cells.sum() * cell_m2,
            "pure_area": cells[scores[:, columns.PURE] > 0].sum() * cell_m2,
            "over": scores[:, columns.OVER].sum() * cell_m2,
            "height": np.nansum(scores[:, columns.HEIGHT_ERROR] * on_main) * cell_m2,
            "on_main": on_main.sum() * cell_m2,
            "normal": turned.sum(),
            "turned": len(turned),
        }.items():
            self.add(f"{group}.{name}", value)


@dataclass(frozen=True, eq=False)
class Picture:
    """The last scored frame of a walk, for the report.

    Attributes:
        regions: outlines (n, 2) world x, y [m].
        pure: (k,) whether each region lies on one face.
        assumed: (k,) whether its ground is only assumed.
        planes: of the baseline.
        robot: (2,) where it is [m].
    """

    regions: list[Array]
    pure: Mask
    assumed: Mask
    planes: Patches
    robot: Array


@dataclass(frozen=True, eq=False)
class ScoredWalk:
    """What came of one walk.

    Attributes:
        placement: of the scene's shapes.
        tallies: by depth and method.
        truth: the faces that there are.
        pictures: by depth, of the last scored frame.
    """

    placement: str
    tallies: dict[str, dict[str, Tally]]
    truth: FaceMap
    pictures: dict[str, Picture]


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame of a walk, and what is asked of it.

    Attributes:
        step: what the robot sees, and from where.
        time_s: when.
        goal: (2, nx, ny) cells of the face map that should be covered; None: the frame is not scored.
        follows: whether it is the one right after a scored frame, to which jitter is measured.
    """

    step: SequenceFrame
    time_s: float
    goal: Mask | None
    follows: bool


class _Methods:
    """Perception with and without warm start, and the baseline, on depth of one kind."""

    def __init__(self, robot: RobotSettings, settings: PerceptionEvalSettings) -> None:
        egocan = EgocanSettings(lift=settings.lift)
        self.chains = {
            name: Perception(
                robot.camera.camera(),
                mount(robot.camera),
                standing_height=robot.standing_height,
                settings=PerceptionSettings(egocan=egocan, warm_start=name == "warm"),
            )
            for name in ("warm", "cold")
        }
        # As wide as the egocan's floor image.
        reach = (robot.standing_height + settings.lift) / _RIM
        self.baseline = ElevationGrid(
            ElevationSettings(size_m=round(2 * reach + 0.2, 1), resolution_m=settings.baseline_resolution_m)
        )
        self.previous: dict[str, Patches] = {}

    def close(self) -> None:
        for chain in self.chains.values():
            chain.close()


def score_walk(
    settings: PerceptionEvalSettings, robot: RobotSettings, number: int, *, segmenter: Segmenter | None
) -> ScoredWalk:
    """Walk once through scene ``number``.

    Args:
        settings: of scenes and scores.
        robot: who walks.
        number: of the walk.
        segmenter: whose labels perception gets; None: the true ones.
    """
    drawn, steps = walk_through(settings.scenes(), robot, number)
    end = drawn.length * np.array([np.cos(drawn.heading), np.sin(drawn.heading)])
    low, high = np.minimum(end, 0) - _AROUND, np.maximum(end, 0) + _AROUND
    low, high = np.floor(low / _ROUND) * _ROUND, np.ceil(high / _ROUND) * _ROUND
    truth = face_map(drawn.world, (low[0], low[1]), (high[0], high[1]), settings.resolution_m)
    # In view within the floor image's reach, and in view at all.
    seen = np.zeros((2, *(-(-n // _SEEN) for n in truth.faces.shape)), dtype=bool)
    tallies = {depth: {method: Tally() for method in METHODS} for depth in DEPTHS}
    methods = {depth: _Methods(robot, settings) for depth in DEPTHS}
    pictures: dict[str, Picture] = {}
    try:
        for k, step in enumerate(steps):
            _remember(seen, step, robot, truth, settings.lift)
            scored = k >= settings.settle and (k - settings.settle) % settings.every == 0
            # Jitter is the way from a scored frame to the very next one.
            follows = k > settings.settle and (k - settings.settle) % settings.every == 1
            goal = _goal(step, settings, truth, seen) if scored else None
            frame = _Frame(step, k * settings.frame_s, goal, follows)
            for depth in DEPTHS:
                image = step.view.seen.depth if depth == "exact" else step.view.depth
                labels = step.view.label if segmenter is None else segmenter(image)
                picture = _see(methods[depth], tallies[depth], image, labels, frame, settings, truth)
                if picture is not None:
                    pictures[depth] = picture
    finally:
        for one in methods.values():
            one.close()
    return ScoredWalk(drawn.placement, tallies, truth, pictures)


def _see(
    methods: _Methods,
    tallies: Mapping[str, Tally],
    image: NDArray[np.float32],
    labels: NDArray[np.uint8],
    frame: _Frame,
    settings: PerceptionEvalSettings,
    truth: FaceMap,
) -> Picture | None:
    """Give one image to every method, and score what it makes of it where the frame is to be scored.

    Args:
        methods: which remember what they have seen.
        tallies: by method, which are added to.
        image: (height, width) the frame's depth, exact or noisy [m].
        labels: (height, width) index into LABELS.
        frame: the robot's place, and what is asked.
        settings: of the scores.
        truth: the faces that there are.

    Returns:
        What was found, of a scored frame.
    """
    step, goal, follows = frame.step, frame.goal, frame.follows
    shown: tuple[Regions, Mask] | None = None
    found: dict[str, Patches] = {}
    for name, chain in methods.chains.items():
        terrain = chain.update(image, step.base_to_world, labels=labels)
        if goal is None and not follows:
            continue
        regions = terrain.regions
        found[name] = region_patches(regions, truth)
        if goal is None:
            continue
        pure = _add(tallies[name], found[name], regions.assumed, settings, truth, goal)
        if name == "warm":
            shown = regions, pure
            whole = convex_regions(terrain.superpixels, RegionSettings(trim=False))
            before = score(region_patches(whole, truth), truth, settings.tolerance)[~whole.assumed]
            tallies[name].add_scores("untrimmed", before, truth.resolution_m**2)
    camera = methods.chains["warm"].camera
    methods.baseline.move_to(step.base_to_world[:2, 3])
    methods.baseline.update(
        image, camera.intrinsics, transform_camera_to_world=step.camera_to_world, time_s=frame.time_s
    )
    if goal is not None or follows:
        planes = segment_planes(methods.baseline.map(), truth, least_area=RegionSettings().least_area)
        found["baseline"] = planes
        if goal is not None:
            _add(tallies["baseline"], planes, np.zeros(len(planes), dtype=bool), settings, truth, goal)
    if follows:
        for name, patches in found.items():
            moved, shared = jitter(methods.previous[name], patches, truth)
            for key, value in {"moved": moved.sum(), "shared": shared.sum(), "matched": len(moved)}.items():
                tallies[name].add(key, value)
    if goal is None or shown is None:
        return None
    methods.previous = found
    regions, pure = shown
    outlines = [regions.corners_world(n)[:, :2] for n in range(len(regions))]
    return Picture(outlines, pure, regions.assumed, found["baseline"], step.base_to_world[:2, 3])


def region_patches(regions: Regions, truth: FaceMap) -> Patches:
    """Regions as patches of a face map."""
    return polygons([regions.corners_world(n) for n in range(len(regions))], regions.poses[:, :3, 2], truth)


def _add(
    tally: Tally, patches: Patches, assumed: Mask, settings: PerceptionEvalSettings, truth: FaceMap, goal: Mask
) -> Mask:
    """Add all that is to be known of one frame; which patches are pure."""
    scores = score(patches, truth, settings.tolerance)
    uneven = scores[:, columns.MAIN] == truth.surface
    cell_m2 = truth.resolution_m**2
    for group, members in {"planar": ~uneven & ~assumed, "uneven": uneven & ~assumed, "assumed": assumed}.items():
        tally.add_scores(group, scores[members], cell_m2)
    over = covered(patches, truth, settings.tolerance)
    for name, wanted in zip(("near", "any"), goal, strict=True):
        tally.add(f"{name}.goal", wanted.sum() * cell_m2)
        tally.add(f"{name}.covered", (over & wanted).sum() * cell_m2)
    return scores[:, columns.PURE] > 0


def _remember(seen: Mask, step: SequenceFrame, robot: RobotSettings, truth: FaceMap, lift: float) -> None:
    """Mark where a steppable face is in view: within the floor image's reach, and at any range."""
    camera, pose = robot.camera.camera(), step.camera_to_world
    v, u = np.nonzero((step.view.label == STEPPABLE) & ~np.isnan(step.view.seen.depth))
    z = step.view.seen.depth[v, u]
    rays = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    points = pose[:3, :3] @ rays + pose[:3, 3:]
    ix, iy = np.floor((points[:2] - truth.corner[:, None]) / (truth.resolution_m * _SEEN)).astype(int)
    inside = (ix >= 0) & (iy >= 0) & (ix < seen.shape[1]) & (iy < seen.shape[2])
    away = points - step.base_to_world[:3, 3:]
    near = np.hypot(away[0], away[1]) < (lift - away[2]) / _RIM
    seen[1, ix[inside], iy[inside]] = True
    seen[0, ix[inside & near], iy[inside & near]] = True


def _goal(step: SequenceFrame, settings: PerceptionEvalSettings, truth: FaceMap, seen: Mask) -> Mask:
    """(2, nx, ny) the steppable ground within the floor image's reach that was in view there, and at any range."""
    nx, ny = truth.faces.shape
    base = step.base_to_world[:3, 3]
    x = truth.corner[0] + (np.arange(nx) + 0.5) * truth.resolution_m - base[0]
    y = truth.corner[1] + (np.arange(ny) + 0.5) * truth.resolution_m - base[1]
    reach = (base[2] + settings.lift - truth.heights) / _RIM
    inside = truth.free & (np.hypot(x[:, None], y) < reach)
    return inside & seen.repeat(_SEEN, axis=1).repeat(_SEEN, axis=2)[:, :nx, :ny]


def tallies_to_dict(tallies: Mapping[str, Mapping[str, Tally]]) -> dict[str, Any]:
    """Plain JSON types."""
    return {depth: {name: dataclasses.asdict(t)["sums"] for name, t in of.items()} for depth, of in tallies.items()}
