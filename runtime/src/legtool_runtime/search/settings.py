"""Settings of the searches; they are read without numba."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import PlannerError
from legtool_runtime.robot import Robot

#: ``walkable``: rules with which a tracking controller walked the plans. ``paper``: equations 15 to 18 as printed.
Mode = Literal["walkable", "paper"]

#: Length of the straight leg that lengths below are written for [m]: ANYmal C's.
SIZE_M = 0.6125
_ANY = Bounds(0.0, math.inf)


@dataclass(frozen=True)
class CandidateSettings:
    """Where footholds are offered inside regions.

    Attributes:
        spacing: of candidates [m], fixed in the world; those in the middles of its squares are added where they are
            alone, line an edge, or are farther from edges than the others.
        cell: of the raster that margins are measured on [m].
        seam: gaps in one plane up to this wide are borders of superpixels, not edges [m].
        least_margin: candidates nearer to an edge are left out [m].
        wide_margin: up to which margins are measured [m].
        step: ground that is off a candidate's plane by more is an edge [m].
        steepest: regions that tilt more are left out [rad].
        assumed_within: ground that is only assumed counts up to this far from the robot [m].
        radius: candidates farther from the robot are left out [m].
        most: candidates that the foothold search takes, those nearest to the torso path.
        centroids: one candidate a region, in its pose, as in the paper.
    """

    spacing: float = 0.10
    cell: float = 0.02
    seam: float = 0.03
    least_margin: float = 0.02
    wide_margin: float = 0.10
    step: float = 0.02
    steepest: float = math.radians(35.0)
    assumed_within: float = 0.6
    radius: float = 2.4
    most: int = 800
    centroids: bool = False

    def __post_init__(self) -> None:
        bounds = {
            "spacing": Bounds(0.02, 0.5, "m"), "cell": Bounds(0.005, 0.05, "m"), "seam": Bounds(0.0, 0.1, "m"),
            "least_margin": Bounds(0.0, 0.1, "m"), "wide_margin": Bounds(0.0, 0.2, "m"), "step": Bounds(0.0, 0.1, "m"),
            "steepest": Bounds(0.0, 1.2, "rad"), "assumed_within": Bounds(0.0, 10.0, "m"),
            "radius": Bounds(0.5, 5.0, "m"), "most": Bounds(10, 4000),
        }  # fmt: skip
        within("candidates", self, bounds, PlannerError)


@dataclass(frozen=True)
class TorsoSettings:
    """The torso search (VI-B) and the cost-to-go field.

    Attributes:
        cell: of the lattice of poses [m]; headings are π/8 apart.
        reach: how far the search looks, and the longest path to a waypoint [m].
        least_way: a waypoint that is backed off to lies at least so far along the path [m].
        support: each foot of the ideal stance needs a candidate so near [m]; 0: none is asked for.
        uneven: how far the four may be off one plane [m].
        clearance: under the trunk [m].
        turn_m: what a radian of turning costs [m].
        unseen_m: what standing on ground costs that is only assumed [m].
        sideways: factor of ways that lead more than 45° off the heading, where no camera looks.
        greed: a frontier that is nearer to the goal by 1 m is worth a way of so many metres.
        kept_m: the end of the last path is worth so much more than others [m].
        field_cell: of the cost-to-go field [m].
        field_turn_m: what a radian costs in the field [m]: as footholds do, which turn by little in a transition.
    """

    cell: float = 0.15
    reach: float = 1.6
    least_way: float = 0.35
    support: float = 0.20
    uneven: float = 0.15
    clearance: float = 0.05
    turn_m: float = 0.3
    unseen_m: float = 0.3
    sideways: float = 1.3
    greed: float = 3.0
    kept_m: float = 0.15
    field_cell: float = 0.06
    field_turn_m: float = 0.25

    def __post_init__(self) -> None:
        bounds = {
            "cell": Bounds(0.05, 0.3, "m"), "reach": Bounds(0.3, 3.0, "m"), "least_way": Bounds(0.05, 1.0, "m"),
            "support": Bounds(0.0, 0.5, "m"),
            "uneven": Bounds(0.0, 1.0, "m"), "clearance": Bounds(0.0, 0.5, "m"), "turn_m": Bounds(0.0, 5.0, "m"),
            "unseen_m": Bounds(0.0, 10.0, "m"), "sideways": Bounds(1.0, 10.0), "greed": Bounds(1.0, 20.0),
            "kept_m": Bounds(0.0, 2.0, "m"), "field_cell": Bounds(0.03, 0.2, "m"),
            "field_turn_m": Bounds(0.01, 5.0, "m"),
        }  # fmt: skip
        within("torso search", self, bounds, PlannerError)


@dataclass(frozen=True)
class Walkability:
    """Which stances and transitions are taken, and what they cost [m of torso path].

    Limits of (15) to (18) hold in both modes; those that are infinite by :meth:`paper` are beyond the paper. All
    limits are inclusive.

    Attributes:
        width, width_off: ideal distance of left and right feet, and how far it may be off, equation 17 [m].
        length, length_off: of front and hind feet, equation 17 [m].
        signed: feet may not cross; the paper's norms let them.
        swing: longest swing, equation 18 [m].
        swing_up, swing_down: highest step up and down [m].
        semi_axes: a, b, c of the superquadrics, equation 15 [m].
        exponent: d = e = f of equation 15.
        centre: of the left front one in the torso's frame [m]; the others are mirrored.
        inverse_kinematics: legs must reach at the new pose, and those that bear half-way there.
        hip_offset, hip_offset_walk: farthest that a foot may stand before or behind its hip, which loads knee and
            hip joint, where pairs swing and where single legs do [m].
        off_line: farthest of the torso off the line through the two feet that bear, half-way (δ) [m].
        skew: farthest of one foot ahead of the one beside it [m].
        uneven: farthest of feet off their plane [m].
        tilt: steepest plane of the feet [rad].
        turn: largest turn in a transition [rad].
        apart: least distance of two feet [m].
        shank: distance of the shanks' axes from the ground, on all sides [m]; negative: not tested.
        support: least barycentric coordinate of the centre of mass over three feet.
        apex: how far above the higher end a swing may rise over what is in its way [m]; infinite: not tested.
        trunk: clearance under the trunk [m]; negative: not tested.
        per_step_m, turn_m, margin_m, climb_m, assumed_m, off_line_m, shape_m, hip_m, anew_m: costs of a transition;
            of a radian; of a foothold at an edge; of a metre of height; of assumed ground; of δ at its limit; of a
            stance at the limit of its shape; of a foot at the limit of hip_offset; of a foothold that the last plan
            lacks.
        wanted_margin: from here on a foothold's margin costs nothing [m].
    """

    width: float
    length: float
    width_off: float
    length_off: float
    swing: float
    signed: bool = True
    swing_up: float = 0.30
    swing_down: float = 0.35
    semi_axes: tuple[float, float, float] = (0.38, 0.27, 0.32)
    exponent: int = 5
    centre: tuple[float, float, float] = (0.37, 0.24, -0.50)
    inverse_kinematics: bool = True
    hip_offset: float = 0.22
    hip_offset_walk: float = 0.25
    off_line: float = 0.03
    skew: float = 0.35
    uneven: float = 0.12
    tilt: float = math.radians(30.0)
    turn: float = 0.20
    apart: float = 0.10
    shank: float = 0.03
    support: float = 0.10
    apex: float = 0.25
    trunk: float = 0.05
    per_step_m: float = 0.03
    turn_m: float = 0.1
    margin_m: float = 0.10
    climb_m: float = 0.02
    assumed_m: float = 0.1
    off_line_m: float = 0.02
    shape_m: float = 0.01
    hip_m: float = 0.01
    anew_m: float = 0.10
    wanted_margin: float = 0.05

    def __post_init__(self) -> None:
        lengths = (
            "width", "length", "width_off", "length_off", "swing", "swing_up", "swing_down", "hip_offset",
            "hip_offset_walk", "off_line", "skew", "uneven", "tilt", "turn", "apart", "apex", "per_step_m", "turn_m",
            "margin_m", "climb_m", "assumed_m", "off_line_m", "shape_m", "hip_m", "anew_m", "wanted_margin",
        )  # fmt: skip
        within("walkability", self, dict.fromkeys(lengths, _ANY), PlannerError)
        within("walkability", self, {"exponent": Bounds(1, 20), "support": Bounds(0.0, 0.33)}, PlannerError)
        if not (self.width > 0 and self.length > 0 and self.swing > 0 and min(self.semi_axes) > 0):
            raise PlannerError("walkability: width, length, swing and semi_axes must be more than 0")
        if self.signed and not self.width_off < self.width:
            raise PlannerError(
                f"walkability: width_off is {self.width_off:g} m, expected less than the width of {self.width:g} m, "
                "or feet cross"
            )

    @classmethod
    def walkable(cls, robot: Robot) -> Walkability:
        """Rules with which plans were walked by the tracking controller, in the robot's size."""
        size = size_of(robot)
        width, length = _rest(robot)
        scaled = {
            name: getattr(cls, name) * size
            for name in ("swing_up", "swing_down", "hip_offset", "hip_offset_walk", "off_line", "skew", "uneven",
                         "apart", "shank", "apex", "trunk")
        }  # fmt: skip
        return cls(
            width=0.75 * width, length=length, width_off=0.6 * 0.75 * width, length_off=0.5 * length,
            swing=0.625 * length, turn=cls.turn / math.sqrt(size), semi_axes=_scaled(cls.semi_axes, size),
            centre=_scaled(cls.centre, size), **scaled,
        )  # fmt: skip

    @classmethod
    def paper(cls, robot: Robot) -> Walkability:
        """Equations 15 to 18 and the Euclidean weight alone: no inverse kinematics, no support, nothing signed."""
        size, none = size_of(robot), math.inf
        return replace(
            cls.walkable(robot), signed=False, inverse_kinematics=False, tilt=1.2, apart=0.0, shank=-1.0, support=0.0,
            trunk=-1.0, semi_axes=_scaled((0.33, 0.25, 0.25), size), swing_up=none, swing_down=none, hip_offset=none,
            hip_offset_walk=none, off_line=none, skew=none, uneven=none, turn=none, apex=none, per_step_m=0.0,
            turn_m=0.0, margin_m=0.0, climb_m=0.0, assumed_m=0.0, off_line_m=0.0, shape_m=0.0, hip_m=0.0, anew_m=0.0,
        )  # fmt: skip


@dataclass(frozen=True)
class FootSettings:
    """The foothold search (VI-C).

    Attributes:
        weights: of the heuristic, one after the other while time is left; the best path counts.
        deadline_s: after which there is an answer.
        share: of the deadline that the first gait gets.
        expansions: stances that are expanded with one weight at most; None: as many as the deadline leaves.
        gaits: in the order in which they are tried.
        tolerance: of the waypoint [m].
        yaw_tolerance: of the waypoint's heading, where it counts [rad].
        progress: least that a partial path comes nearer [m].
        enough: a partial path that comes so much of the way is followed in its gait; below, the next gait is tried.
    """

    weights: tuple[float, ...] = (3.0, 2.0, 1.5)
    deadline_s: float = 0.010
    share: float = 0.5
    expansions: int | None = None
    gaits: tuple[str, ...] = ("trot", "walk")
    tolerance: float = 0.25
    yaw_tolerance: float = math.pi / 4
    progress: float = 0.05
    enough: float = 0.4

    def __post_init__(self) -> None:
        bounds = {
            "enough": Bounds(0.0, 1.0),
            "deadline_s": Bounds(0.0005, 60.0, "s"), "share": Bounds(0.1, 1.0), "tolerance": Bounds(0.01, 1.0, "m"),
            "yaw_tolerance": Bounds(0.05, 4.0, "rad"), "progress": Bounds(0.0, 1.0, "m"),
        }  # fmt: skip
        within("foothold search", self, bounds, PlannerError)
        if self.expansions is not None and self.expansions < 1:
            raise PlannerError(f"foothold search: expansions is {self.expansions}, expected 1 or more, or none")
        if not self.weights or not all(1.0 <= w <= 100.0 for w in self.weights):
            raise PlannerError(f"foothold search: weights {self.weights}, expected one or more from 1 to 100")
        unknown = [g for g in self.gaits if g not in GAITS]
        if unknown or not self.gaits:
            raise PlannerError(f"foothold search: gaits {self.gaits}, expected one or more of {', '.join(GAITS)}")


#: Gaits: for each phase the legs of which one set swings. In ``acyclic`` any single leg or diagonal pair may.
GAITS: dict[str, tuple[tuple[tuple[int, ...], ...], ...]] = {
    "trot": (((0, 3),), ((1, 2),)),
    "walk": (((2,),), ((0,),), ((3,),), ((1,),)),
    "acyclic": (((0, 3), (1, 2), (0,), (1,), (2,), (3,)),),
}


@dataclass(frozen=True)
class PipsSettings:
    """All of a planner's settings.

    Attributes:
        walkability: which transitions can be walked.
        candidates, torso, feet: of the three stages.
        commit_s: what lifts within this time after now is no longer changed [s].
        goal_tolerance: the robot has arrived when its base is so near to the goal, horizontally [m].
        height_m: of the base over the ground, as the tracker holds it; None: the robot's standing height.
        tabu_s: half-life of the penalty of waypoints that no footholds led to [s].
        refused_s: how long a refused transition stays refused [s].
        cost_to_go: whether the cost-to-go field guides the foothold search.
        sight: half of the camera's horizontal view: towards a goal that lies farther off the heading, beyond ground
            that is known, the robot turns first [rad]; None: only where no ground leads nearer.
        patience: a robot that stands has time: after searches that led nowhere, the next one may take up to so many
            times as long, and expand so many times as many stances; 1: it never does.
    """

    walkability: Walkability
    candidates: CandidateSettings = field(default_factory=CandidateSettings)
    torso: TorsoSettings = field(default_factory=TorsoSettings)
    feet: FootSettings = field(default_factory=FootSettings)
    commit_s: float = 0.20
    goal_tolerance: float = 0.30
    height_m: float | None = None
    tabu_s: float = 10.0
    refused_s: float = 5.0
    cost_to_go: bool = True
    sight: float | None = None
    patience: int = 64

    def __post_init__(self) -> None:
        bounds = {
            "patience": Bounds(1, 10_000),
            "commit_s": Bounds(0.0, 5.0, "s"), "goal_tolerance": Bounds(0.02, 2.0, "m"),
            "tabu_s": Bounds(0.0, 1000.0, "s", above=True), "refused_s": Bounds(0.0, 1000.0, "s"),
        }  # fmt: skip
        within("pips", self, bounds, PlannerError)
        if self.sight is not None and not 0.0 < self.sight <= math.pi:
            raise PlannerError(f"pips: sight is {self.sight!r}, expected more than 0 to {math.pi:.2f} rad, or none")

    @classmethod
    def of(cls, robot: Robot, mode: Mode = "walkable") -> PipsSettings:
        """The settings for a robot: ``walkable``, or those of the ``paper``.

        Raises:
            PlannerError: a mode of another name.
        """
        if mode not in get_args(Mode):
            raise PlannerError(f"pips: mode is {mode!r}, expected {' or '.join(get_args(Mode))}")
        size = size_of(robot)
        near = 0.5 + 0.5 * size  # what depends on the robot's speed and its camera shrinks less than its legs
        candidates = CandidateSettings(spacing=0.10 * size, radius=2.4 * near, centroids=mode == "paper")
        torso = TorsoSettings(
            cell=0.15 * size, reach=1.6 * near, least_way=0.35 * size, support=0.20 * size, uneven=0.15 * size
        )
        if mode == "paper":
            torso = replace(torso, support=0.0, turn_m=1.0, unseen_m=0.0, sideways=1.0, kept_m=0.0)
            # The paper's A* (weight 1) finds nothing in the paper's time; it comes last, while time is left.
            feet = FootSettings(gaits=("trot",), weights=(3.0, 1.5, 1.0), deadline_s=0.067, share=1.0)
            return cls(Walkability.paper(robot), candidates, torso, feet, cost_to_go=False, patience=1)
        return cls(Walkability.walkable(robot), candidates, torso)


def size_of(robot: Robot) -> float:
    """The robot's size over ANYmal C's, by the straight leg."""
    return float((robot.thigh_length + robot.shank_length).max()) / SIZE_M


def _rest(robot: Robot) -> tuple[float, float]:
    """Width and length of the stance at rest [m]."""
    feet = robot.stance
    width = 0.5 * float(feet[0, 1] - feet[1, 1] + feet[2, 1] - feet[3, 1])
    return width, 0.5 * float(feet[0, 0] - feet[2, 0] + feet[1, 0] - feet[3, 0])


def _scaled(values: tuple[float, float, float], by: float) -> tuple[float, float, float]:
    return values[0] * by, values[1] * by, values[2] * by
