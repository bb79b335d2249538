"""Small worlds rendered by ray formulas: a floor, boxes and spheres, with depth, true normals and true faces."""

from types import SimpleNamespace

import numpy as np
import pytest

from legtool_runtime.perception import NON_PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception.camera import Camera, as_metres
from legtool_runtime.perception.egocan import Egocan, EgocanSettings
from legtool_runtime.perception.normals import normals


def _rays(camera):
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def _box(origin, rays, centre, half, yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    start, direction = (origin - centre) @ rotation, rays @ rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-half - start) / direction, (half - start) / direction
    near, far = np.minimum(one, two), np.maximum(one, two)
    axis = near.argmax(axis=-1)
    enter = near.max(axis=-1)
    hit = (enter < far.min(axis=-1)) & (enter > 0)
    normal = -np.sign(np.take_along_axis(direction, axis[..., None], axis=-1)) * np.eye(3)[axis]
    return np.where(hit, enter, np.inf), normal @ rotation.T, axis


def _sphere(origin, rays, centre, radius):
    offset = origin - centre
    a, b, c = (rays**2).sum(-1), 2 * rays @ offset, offset @ offset - radius**2
    root = b * b - 4 * a * c
    distance = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / (2 * a), np.inf)
    distance = np.where(distance > 0, distance, np.inf)
    point = origin + np.where(np.isfinite(distance), distance, 0)[..., None] * rays
    return distance, (point - centre) / radius


def render(camera, pose, *, floor=0.0, boxes=(), spheres=()):
    """Depth (h, w) [m], normals in the optical frame (h, w, 3) and the face hit (h, w).

    Faces: -1 nothing, 0 floor, 10 · (box + 1) + axis (axis 2 is the top), 1000 + sphere. A box is (centre, half size,
    yaw), a sphere (centre, radius), both in the world; ``pose`` (4, 4) optical frame to world; ``floor`` is the height
    of the ground [m], None for none.
    """
    rays = _rays(camera) @ pose[:3, :3].T
    origin = pose[:3, 3]
    depth, normal, face = np.full(rays.shape[:2], np.inf), np.zeros(rays.shape), np.full(rays.shape[:2], -1)

    def put(distance, normals, faces):
        nearer = distance < depth
        depth[nearer] = distance[nearer]
        normal[nearer] = np.broadcast_to(normals, rays.shape)[nearer]
        face[nearer] = np.broadcast_to(faces, depth.shape)[nearer]

    if floor is not None:
        with np.errstate(divide="ignore"):
            distance = (floor - origin[2]) / rays[..., 2]
        put(np.where(distance > 0, distance, np.inf), np.array([0, 0, 1.0]), 0)
    for n, (centre, half, yaw) in enumerate(boxes):
        distance, normals, axis = _box(origin, rays, np.array(centre), np.array(half), yaw)
        put(distance, normals, 10 * (n + 1) + axis)
    for n, (centre, radius) in enumerate(spheres):
        distance, normals = _sphere(origin, rays, np.array(centre), radius)
        put(distance, normals, 1000 + n)
    return depth.astype(np.float32), (normal @ pose[:3, :3]), face


def camera_pose(position, pitch=0.0, yaw=0.0):
    """(4, 4) optical frame to world of a camera at ``position`` [m], looking along ``yaw``, down by ``pitch`` [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    yawing = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    c, s = np.cos(pitch), np.sin(pitch)
    pitching = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    pose = np.eye(4)
    pose[:3, :3] = yawing @ pitching @ np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
    pose[:3, 3] = position
    return pose


def true_labels(face):
    """Floors and tops of boxes are steppable, all else is not."""
    top = (face == 0) | ((face % 10 == 2) & (face > 0) & (face < 1000))
    return np.where(top, STEPPABLE, np.where(face == -1, UNKNOWN, NON_PASSABLE)).astype(np.uint8)


def floor_image(*, side=128, at=(0.0, 0.0), yaw=0.0, noise=0.0, labels=true_labels, can=None, **scene):
    """The floor image of a can 0.8 m above the ground at ``at``, seen by a camera from above."""
    camera = Camera.from_field_of_view(320, 320, np.deg2rad(90))
    can = can or Egocan(EgocanSettings(side=side))
    base = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    base[:2, :2], base[:3, 3] = [[c, -s], [s, c]], [*at, 0.8]
    pose = camera_pose([*at, 1.6], np.pi / 2)
    depth, _, face = render(camera, pose, **scene)
    depth = as_metres(depth, camera)
    depth = depth + np.random.default_rng(0).normal(0, noise, depth.shape).astype(np.float32) if noise else depth
    can.move(base)
    can.insert(depth, normals(depth, camera), camera=camera, transform_camera_to_world=pose, labels=labels(face))
    return can.floor()


@pytest.fixture
def seen_from_above():
    """Floor images of small worlds: ``seen_from_above(boxes=…)``."""
    return floor_image


@pytest.fixture
def world():
    """The ray formulas as ``world.render`` and ``world.camera_pose``, and a camera of 160 × 120 pixels."""
    return SimpleNamespace(
        render=render, camera_pose=camera_pose, camera=Camera.from_field_of_view(160, 120, np.deg2rad(80))
    )
