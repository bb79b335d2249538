"""The presets of QuadPiPS' worlds against the files that they were made from."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from legtool.configs.families import ENVIRONMENTS, FAMILIES, HARDWARE, PARALLEL_BEAMS
from legtool.configs.worlds import load_world
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec

FILES = Path(__file__).parents[3] / "shared" / "data" / "environments"
NAMES = {
    "quadpips_stairs": "stairs",
    "parallel_beams_axes": "parallel_beams_anymal_axes",
    "parallel_beams_edges": "parallel_beams_anymal_edges",
}
WORLDS = (*ENVIRONMENTS, *HARDWARE, *PARALLEL_BEAMS)


def file(name: str) -> Path:
    path = FILES / f"{NAMES.get(name, name)}.json"
    if not path.is_file():
        pytest.skip(f"{path} is not there: the worlds' JSON files are not part of the repository")
    return path


@pytest.mark.parametrize("name", WORLDS)
def test_a_preset_is_the_world_of_its_file(name: str) -> None:
    preset, given = build_world(load_world(name)), build_world(load_world(str(file(name))))
    box = json.loads(file(name).read_text())["boxes"]
    ends = np.array([part["center"] for part in box])
    rng = np.random.default_rng(0)
    x, y = (rng.uniform(ends[:, k].min() - 0.5, ends[:, k].max() + 0.5, 4000) for k in range(2))
    np.testing.assert_allclose(preset.height(x, y), given.height(x, y), atol=1e-6)
    points = np.column_stack([x, y, preset.height(x, y)])
    seen = np.isfinite(points[:, 2])
    np.testing.assert_array_equal(preset.on_ground(points[seen]), given.on_ground(points[seen]))
    np.testing.assert_array_equal(preset.labels, given.labels)


@pytest.mark.parametrize("name", WORLDS)
def test_mujoco_has_the_same_geoms(name: str) -> None:
    models = [world_spec(build_world(load_world(what))).compile() for what in (name, str(file(name)))]
    assert models[0].ngeom == models[1].ngeom > 0
    for field in ("geom_type", "geom_size", "geom_pos"):
        np.testing.assert_allclose(getattr(models[0], field), getattr(models[1], field), atol=1e-6)
    for a, b in zip(models[0].geom_quat, models[1].geom_quat, strict=True):
        rotations = [np.empty(9), np.empty(9)]
        for quaternion, rotation in zip((a, b), rotations, strict=True):
            mujoco.mju_quat2Mat(rotation, quaternion)
        np.testing.assert_allclose(rotations[0], rotations[1], atol=1e-6)
    assert (models[0].geom_friction[:, 0] == 1.0).all()


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("robot", ["anymal_c", "go2"])
def test_robots_start_and_end_where_the_file_says(name: str, robot: str) -> None:
    values = json.loads(file(name).read_text())
    values = values.get("anymal", values) if robot == "anymal_c" else values
    way = load_world(name).way(robot)
    start, goal = values["start"], values["goal"]
    np.testing.assert_allclose(way.start, [*start["torso_xyz"][:2], start["yaw"]], atol=1e-6)
    if name != "hw_flat":  # a circle there, whose goal would be its start
        np.testing.assert_allclose(way.goal, goal["torso_xyz"][:2], atol=1e-6)
    assert way.goal_radius == 0.25


def test_all_presets_are_families() -> None:
    assert set(WORLDS) == set(FAMILIES)
