"""The depth camera on a robot's trunk: where it is, what it sees, and how far that is from the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator

from legtool.configs.settings import Settings

if TYPE_CHECKING:
    from legtool_runtime.perception.camera import Camera

#: Errors of a real sensor, that an exact depth image is put through (QuadPiPS, section V-B6).
Corruption = Literal["oil_painting", "gaussian_noise", "void_blobs", "blur"]

Positive = Annotated[float, Field(gt=0)]


class DepthNoise(Settings):
    """Errors of the depth camera."""

    steps: tuple[Corruption, ...] = Field(
        ("oil_painting", "gaussian_noise", "void_blobs", "blur"), description="in this order; none: exact depth"
    )
    surface_sigma: float = Field(
        0.0015, ge=0, le=0.1, description="gaussian_noise over surfaces: standard deviation per squared depth [1/m]"
    )
    boundary_sigma: float = Field(
        0.012, ge=0, le=0.5, description="gaussian_noise on boundaries of objects: standard deviation per depth [1]"
    )


class DepthCamera(Settings):
    """The depth camera on a robot's trunk; its images have square pixels and no distortion."""

    width: int = Field(640, ge=64, le=2048, multiple_of=2, description="width of the image [pixel]")
    height: int = Field(480, ge=48, le=2048, multiple_of=2, description="height of the image [pixel]")
    horizontal_view: float = Field(
        1.386, gt=0.2, lt=2.4, description="angle of view across the width of the image [rad]"
    )
    position: tuple[float, float, float] = Field((0.28, 0.0, 0.06), description="position in the base frame [m]")
    pitch: float = Field(
        0.5, ge=-0.5, le=1.4, description="angle of the optical axis below the trunk's forward axis [rad]"
    )
    range_m: tuple[Positive, Positive] = Field(
        (0.2, 6.0), description="smallest and largest depth that is measured [m]"
    )
    rate_hz: float = Field(15.0, gt=0, le=100, description="images per second of a walking robot [Hz]")
    noise: DepthNoise = Field(default_factory=DepthNoise)

    @model_validator(mode="after")
    def _check(self) -> DepthCamera:
        if self.range_m[0] >= self.range_m[1]:
            raise ValueError(f"range_m {self.range_m}: expected the smallest depth, then the largest")
        return self

    def camera(self) -> Camera:
        """Its intrinsics, as the runtime has them."""
        from legtool_runtime.perception.camera import Camera  # with numba: settings are shown without it

        return Camera.from_field_of_view(self.width, self.height, self.horizontal_view)
