"""Settings of labelled scenes: which shapes, how they are placed, and how the camera moves (QuadPiPS, section V-B)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from legtool.configs.camera import Corruption
from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import SettingsError

PRESETS = Path(__file__).parent / "scenes"

#: The classes of primitive shapes, in the order of their numbers in ``shape`` images (1, 2, …; 0 is no return).
SHAPES = ("cuboid", "ramp", "cylinder", "sphere", "semisphere", "pole", "pipe", "tube", "floor", "wall")
#: Shapes that stand on their own; floor and walls belong to the environment.
Shape = Literal["cuboid", "ramp", "cylinder", "sphere", "semisphere", "pole", "pipe", "tube"]
Placement = Literal["clustered", "scattered", "staircase", "stepping_stones", "written"]

Length = Annotated[float, Field(gt=0, le=5)]
Range = tuple[Length, Length]


class WrittenShape(Settings):
    """One shape of a layout that is written by hand; its sizes mean what its class says."""

    shape: Shape
    x: float = Field(ge=-20, le=20, description="ahead of the start [m]")
    y: float = Field(ge=-20, le=20, description="left of the start [m]")
    z: float = Field(0.0, ge=0, le=5, description="its lowest point above the ground [m]")
    yaw: float = Field(0.0, description="[rad]")
    length: Length | None = Field(None, description="cuboid, ramp (uphill); pole, pipe, tube: axis [m]")
    width: Length | None = Field(None, description="cuboid, ramp [m]")
    height: Length | None = Field(None, description="cuboid, ramp, cylinder [m]")
    radius: Length | None = Field(None, description="cylinder, sphere, semisphere, pole, pipe, tube [m]")

    @model_validator(mode="after")
    def _check(self) -> WrittenShape:
        needed = NEEDED[self.shape]
        given = {name for name in ("length", "width", "height", "radius") if getattr(self, name) is not None}
        if given != set(needed):
            raise ValueError(f"a {self.shape} takes {', '.join(needed)}; given: {', '.join(sorted(given)) or 'none'}")
        return self


#: Parameters of each class (QuadPiPS, section V-B1).
NEEDED: dict[Shape, tuple[str, ...]] = {
    "cuboid": ("length", "width", "height"),
    "ramp": ("length", "width", "height"),
    "cylinder": ("radius", "height"),
    "sphere": ("radius",),
    "semisphere": ("radius",),
    "pole": ("length", "radius"),
    "pipe": ("length", "radius"),
    "tube": ("length", "radius"),
}


class Layout(Settings):
    """A layout written by hand."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    shapes: tuple[WrittenShape, ...] = Field(min_length=1, max_length=500)


class CameraMotion(Settings):
    """How the camera rides on the trunk. Deviations are normal, in all six dimensions of its pose."""

    frame_s: float = Field(0.5, gt=0, le=10, description="time between frames [s]")
    speed: Range = Field((0.2, 0.8), description="slowest and fastest walk [m/s]")
    jitter_position: float = Field(0.02, ge=0, le=0.2, description="standard deviation per axis [m]")
    jitter_angle: float = Field(0.03, ge=0, le=0.3, description="standard deviation per axis [rad]")
    height_spread: float = Field(0.08, ge=0, le=0.3, description="a scene's mount is up to this higher or lower [m]")
    pitch_spread: float = Field(
        0.12, ge=0, le=0.6, description="a scene's mount looks up to this further up, down [rad]"
    )


class SceneSettings(Settings):
    """A dataset of labelled scenes."""

    robot: str = Field("go2", description="preset or path of a YAML: camera, mount, highest swing")
    seed: int = Field(0, ge=0)
    scenes: int = Field(600, ge=1, le=100_000)
    frames: int = Field(5, ge=1, le=100, description="in each scene")
    placements: dict[Placement, float] = Field(
        {"clustered": 0.3, "scattered": 0.35, "staircase": 0.2, "stepping_stones": 0.15},
        min_length=1,
        description="share of scenes with each placement",
    )
    layouts: tuple[str, ...] = Field((), description="presets or paths of layouts for the placement 'written'")
    shapes: tuple[int, int] = Field((6, 24), description="fewest and most shapes in a scene")
    indoor: float = Field(0.5, ge=0, le=1, description="share of scenes with walls and a ceiling")
    flat_floor: float = Field(
        0.5, ge=0, le=1, description="share of scenes with a flat floor; others have a 3-D surface"
    )
    stacked: float = Field(0.15, ge=0, le=1, description="share of shapes that stand on another")
    hanging: float = Field(0.25, ge=0, le=1, description="share of pipes and tubes that hang in the air")
    camera: CameraMotion = Field(default_factory=CameraMotion)
    corruptions: tuple[Corruption, ...] | None = Field(
        None, description="errors of the camera, in this order ([]: exact depth); null: as the robot's camera has them"
    )

    @model_validator(mode="after")
    def _check(self) -> SceneSettings:
        if not 0 <= self.shapes[0] <= self.shapes[1] <= 200:
            raise ValueError(f"shapes {self.shapes}: expected the fewest, then the most, at most 200")
        if min(self.placements.values()) < 0 or sum(self.placements.values()) <= 0:
            raise ValueError(f"placements {self.placements}: expected shares of 0 or more, one above 0")
        if (self.placements.get("written", 0) > 0) != bool(self.layouts):
            raise ValueError("layouts are for the placement 'written', and it needs them: give both or none")
        if self.camera.speed[0] > self.camera.speed[1]:
            raise ValueError(f"camera.speed {self.camera.speed}: expected the slowest walk, then the fastest")
        return self


def load_layout(name_or_path: str) -> Layout:
    """A preset by name, or the user's own YAML by path.

    Raises:
        SettingsError: no such preset or file, or a shape that is not complete.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
    if not path.is_file():
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise SettingsError(f"layout {name_or_path!r}: no such preset or YAML file; presets: {presets}")
    return build(Layout, read_yaml(path) or {}, source=str(path))
