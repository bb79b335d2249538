"""Times perception's stages on one core: normals, egocan, superpixels and regions, and the whole chain.

The scene is a room with boxes, 640 × 480 depth. Run: OMP_NUM_THREADS=1 python benchmarks/perception.py [BUNDLE]
With a bundle its segmenter is timed too, on one and on two threads, wall-clock time. scikit-image and fast-slic are
timed on the same image where they are installed; nothing needs them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legtool_runtime import load_bundle
from legtool_runtime.perception import STEPPABLE
from legtool_runtime.perception.camera import Camera, as_metres
from legtool_runtime.perception.chain import Perception, PerceptionSettings
from legtool_runtime.perception.egocan import Egocan, EgocanSettings
from legtool_runtime.perception.normals import normals
from legtool_runtime.perception.regions import convex_regions
from legtool_runtime.perception.steppability import Segmenter
from legtool_runtime.perception.superpixels import Superpixels, SuperpixelSettings, oversegment

CAMERA = Camera.from_field_of_view(640, 480, np.deg2rad(75))
REACH = 3
MOUNT = np.array([0.3, 0.0, 0.1])
#: Boxes as centre and half size [m], the room (seen from inside) first.
BOXES = np.array(
    [
        [[0, 0, 1.3], [3, 3, 1.3]],
        *(
            [[1.2 * np.cos(a), 1.2 * np.sin(a), h], [0.2, 0.15, h]]
            for a, h in zip(np.arange(10) * 0.63, np.tile([0.03, 0.06, 0.1, 0.04, 0.08], 2), strict=True)
        ),
        *([[x, y, 0.04], [0.14, 0.14, 0.04]] for x in (-0.3, 0.1, 0.5) for y in (-0.5, 0.5)),
    ]
)


def report(name: str, function: Callable[[], object], *, repeats: int = 100) -> None:
    """Print the median and two percentiles of a call's processor time, and the median of its time on the wall."""
    function()
    times, wall = [], []
    for _ in range(repeats):
        start, wall_start = time.thread_time(), time.perf_counter()
        function()
        times.append((time.thread_time() - start) * 1e3)
        wall.append((time.perf_counter() - wall_start) * 1e3)
    median, p95, p99 = np.percentile(times, [50, 95, 99])
    print(f"{name:62} {median:7.2f} ms   p95 {p95:7.2f}   p99 {p99:7.2f}   wall {np.median(wall):7.2f}")


def base_pose(x: float, yaw: float) -> NDArray[np.float64]:
    """(4, 4) base to world, 0.4 m above the floor."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, 0], [0, 0, 1, 0.4], [0, 0, 0, 1.0]])


def camera_pose(base: NDArray[np.float64], pitch: float = 0.6) -> NDArray[np.float64]:
    """(4, 4) optical frame to world of the camera on the robot's front."""
    c, s = np.cos(pitch), np.sin(pitch)
    mount = np.eye(4)
    mount[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
    mount[:3, 3] = MOUNT
    return base @ mount


def render(pose: NDArray[np.float64], rng: np.random.Generator | None = None) -> NDArray[np.float32]:
    """Depth of the room [m], with noise of 2 mm at 1 m where ``rng`` is given."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1) @ pose[:3, :3].T
    depth = np.full(u.shape, np.inf)
    for index, (centre, half) in enumerate(BOXES):
        with np.errstate(divide="ignore"):
            ends = (centre + np.array([[-1], [1]]) * half - pose[:3, 3])[:, None, None, :] / rays
        enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
        hit = leave if index == 0 else np.where((enter < leave) & (enter > 0), enter, np.inf)
        depth = np.minimum(depth, hit)
    if rng is not None:
        depth += 0.002 * depth**2 * rng.standard_normal(depth.shape)
    return depth.astype(np.float32)


def walk(can: Egocan, frames: int, rng: np.random.Generator | None = None) -> None:
    """Fill the can: turn once about, then walk ahead. Every label is steppable."""
    labels = np.full((CAMERA.height, CAMERA.width), STEPPABLE, dtype=np.uint8)
    for k in range(frames):
        base = base_pose(0.3 * max(0.0, k / frames - 0.7), 2 * np.pi * min(1.0, k / (0.7 * frames)))
        pose = camera_pose(base)
        depth = as_metres(render(pose, rng), CAMERA)
        can.move(base)
        can.insert(
            depth, normals(depth, CAMERA, reach=REACH), camera=CAMERA, transform_camera_to_world=pose, labels=labels
        )


def time_segmenter(path: Path) -> None:
    """The segmenter of a bundle on an image of its own camera, preparation included (the paper: 200 ms on a GPU)."""
    bundle = load_bundle(path)
    sensor = bundle.steppability.sensor
    assert sensor is not None
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 4.0, (sensor.camera.height, sensor.camera.width)).astype(np.float32)
    for threads in (1, 2):
        segmenter = Segmenter(
            path / "steppability.onnx", steps=bundle.steppability.steps, sensor=sensor, threads=threads
        )
        height, width = segmenter.size
        segmenter.warm_up()
        wall = []
        for _ in range(50):
            start = time.perf_counter()
            segmenter(depth)
            wall.append((time.perf_counter() - start) * 1e3)
        median, p95, p99 = np.percentile(wall, [50, 95, 99])
        name = f"segmentation, {width} × {height}, {threads} threads (≤ 60 ms on two)"
        print(f"{name:62} {median:7.2f} ms   p95 {p95:7.2f}   p99 {p99:7.2f}   wall")


def main() -> None:
    if len(sys.argv) > 1:
        time_segmenter(Path(sys.argv[1]))
    can = Egocan(EgocanSettings(lift=0.3))
    walk(can, 36)
    base = base_pose(0.1, 0.0)
    pose = camera_pose(base)
    raw = render(pose)
    depth = as_metres(raw, CAMERA)
    found = normals(depth, CAMERA, reach=REACH)
    print(f"floor cells known {can.floor().known.mean():.0%}, cylinder {can.cylinder().known.mean():.0%}")
    report("depth image checked, in metres", lambda: as_metres(raw, CAMERA))
    report("normals by differences (≤ 3 ms)", lambda: normals(depth, CAMERA))
    report(f"normals by fits, reach {REACH} (≤ 3 ms)", lambda: normals(depth, CAMERA, reach=REACH))
    steps = iter(np.tile([0.001, -0.001], 10_000).cumsum())

    def propagate() -> None:
        can.move(base_pose(0.1 + next(steps), 0.0))

    def insert() -> None:
        can.insert(depth, found, camera=CAMERA, transform_camera_to_world=pose)

    def both() -> None:
        propagate()
        insert()

    can.move(base)
    report("egocan propagate", propagate)
    report("egocan insert, labels not yet known", insert)
    report("egocan insert + propagate (≤ 4 ms)", both)
    time_superpixels(can)


def time_superpixels(can: Egocan) -> None:
    """Superpixels and regions of a floor image that is full but for its corners, which the can never fills."""
    overhead = np.array([[0.0, -1, 0, 0.1], [-1, 0, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]])
    depth = as_metres(render(overhead), CAMERA)
    labels = np.full(depth.shape, STEPPABLE, dtype=np.uint8)
    can.reset()
    can.move(base_pose(0.1, 0.0))
    can.insert(
        depth, normals(depth, CAMERA, reach=REACH), camera=CAMERA, transform_camera_to_world=overhead, labels=labels
    )
    floor = can.floor()
    settings = SuperpixelSettings(number=225)
    last = oversegment(floor, settings)
    can.move(base_pose(0.11, 0.01))
    can.insert(
        depth, normals(depth, CAMERA, reach=REACH), camera=CAMERA, transform_camera_to_world=overhead, labels=labels
    )
    floor = can.floor()
    regions = convex_regions(last)
    print(
        f"floor cells known {floor.known.mean():.0%}; {len(last)} superpixels, {len(regions)} regions; over edges "
        f"{regions.trimmed.sum() / regions.areas.sum():.2%} before, "
        f"{regions.overhang.sum() / regions.areas.sum():.2%} after cutting"
    )

    def chain(previous: Superpixels | None) -> None:
        convex_regions(oversegment(floor, settings, previous=previous))

    report("the floor image", can.floor)
    report("superpixels, cold, 5 iterations", lambda: oversegment(floor, settings))
    report("superpixels, warm", lambda: oversegment(floor, settings, previous=last))
    report("regions", lambda: convex_regions(last))
    report("superpixels + regions, cold (≤ 12 ms)", lambda: chain(None))
    report("superpixels + regions, warm (≤ 5 ms)", lambda: chain(last))
    time_peers(last)
    time_chain()


def mixed(assignment: NDArray[np.int32], heights: NDArray[np.float32]) -> float:
    """Share of superpixels whose points spread over more than 3 cm of height: more than one of the scene's faces."""
    spread = [np.ptp(heights[assignment == label]) for label in np.unique(assignment[assignment >= 0])]
    return float(np.mean(np.array(spread) > 0.03))


def time_peers(superpixels: Superpixels) -> None:
    """Other superpixels on the same floor image: points and normals as channels, healthy pixels as mask."""
    side = len(superpixels.state)
    mask = superpixels.assignment >= 0
    image = np.nan_to_num(superpixels.channels[:6].T.reshape(side, side, 6)).astype(np.float64)
    heights = image[..., 2].astype(np.float32)
    print(f"superpixels that hold more than one face: ours {mixed(superpixels.assignment, heights):.1%}")
    try:
        from skimage.segmentation import slic
    except ImportError:
        print("scikit-image is not installed: no comparison with its masked SLIC")
    else:

        def masked() -> NDArray[np.int32]:
            return slic(  # metres, with height ten times as dear: its one knob is compactness
                image * [1, 1, 10, 1, 1, 1],
                n_segments=len(superpixels),
                compactness=0.1,
                max_num_iter=5,
                mask=mask,
                channel_axis=-1,
                start_label=0,
                enforce_connectivity=False,
            )

        report("scikit-image, masked SLIC, 5 iterations", masked, repeats=5)
        found = np.where(mask, masked(), -1)
        print(f"  {len(np.unique(found)) - 1} superpixels; {mixed(found, heights):.1%} hold more than one face")
    try:
        from fast_slic import Slic
    except ImportError:
        print("fast-slic is not installed: no comparison with it")
    else:
        low, high = np.percentile(image[mask], [1, 99], axis=0)
        three = np.ascontiguousarray(
            (np.clip((image - low) / (high - low + 1e-6), 0, 1) * 255)[..., 2:5].astype(np.uint8)
        )
        peer = Slic(num_components=len(superpixels), compactness=10)
        report("fast-slic (8 bit, 3 channels, no mask), 5 iterations", lambda: peer.iterate(three, 5), repeats=30)
        found = np.where(mask, peer.iterate(three, 5), -1)
        print(f"  {len(np.unique(found)) - 1} superpixels; {mixed(found, heights):.1%} hold more than one face")


def time_chain() -> None:
    """Everything that a frame costs, of a robot that walks; labels are given."""
    labels = np.full((CAMERA.height, CAMERA.width), STEPPABLE, dtype=np.uint8)
    settings = PerceptionSettings(egocan=EgocanSettings(lift=0.3))
    mount = np.linalg.inv(base_pose(0.0, 0.0)) @ camera_pose(base_pose(0.0, 0.0))
    poses = [base_pose(0.01 * k, 0.0) for k in range(30)]
    images = [render(camera_pose(pose), np.random.default_rng(k)) for k, pose in enumerate(poses)]
    with Perception(CAMERA, mount, standing_height=0.4, settings=settings) as chain:
        frame = iter([*range(30), *range(29, -1, -1)] * 10)

        def step() -> None:
            k = next(frame)
            chain.update(images[k], poses[k], labels=labels)

        report("the whole chain, depth image to regions", step)


if __name__ == "__main__":
    main()
