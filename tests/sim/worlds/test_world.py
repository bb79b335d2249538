"""One world: physics, heights, ground and goal, as its file describes them."""

import json

import mujoco
import numpy as np
import pytest

from legtool.configs.settings import build
from legtool.configs.world_parts import Gap, Step
from legtool.configs.worlds import PRESETS, WorldSettings, is_world, load_world, random_world
from legtool.errors import SettingsError
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.heights import TrueHeights, elevation_map
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.raycast import box
from legtool.sim.worlds.world import CUBOID, World

COURSES = ("scenario_1", "scenario_2", "scenario_3", "gap_10", "gap_20", "stairs")
EVERY = sorted(path.stem for path in PRESETS.glob("*.yaml"))


def world(**values) -> World:
    return build_world(build(WorldSettings, {"name": "w", **values}))


def by_physics(built: World, x, y) -> np.ndarray:
    """Heights that MuJoCo's rays meet from above."""
    model = world_spec(built).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit, down = np.zeros(1, dtype=np.int32), np.array([0.0, 0.0, -1.0])
    out = []
    for place in zip(x, y, strict=True):
        distance = mujoco.mj_ray(model, data, np.array([*place, 5.0]), down, None, 1, -1, hit, None)
        out.append(5.0 - distance if distance >= 0 else -np.inf)
    return np.array(out)


def test_a_one_sided_gap_leaves_the_other_half_whole() -> None:
    course = build_world(WorldSettings(name="c", length=3, gaps=(Gap(x=1, width=0.15, side="left"),)))
    assert course.height(1.07, 0.2) == pytest.approx(-0.3)
    assert course.height(1.07, -0.2) == pytest.approx(0.0)
    assert course.height(0.99, 0.2) == pytest.approx(0.0)
    assert course.height(1.16, 0.2) == pytest.approx(0.0)


def test_steps_stack() -> None:
    steps = (Step(x=1, length=1, height=0.06), Step(x=1.5, length=0.5, height=0.04))
    course = build_world(WorldSettings(name="c", length=3, steps=steps))
    np.testing.assert_allclose(course.height([0.5, 1.2, 1.7, 2.2], [0.1, -0.1, 0.1, -0.1]), [0, 0.06, 0.1, 0])


#: One of each form, and boxes that are turned every way.
FORMS = {
    "course": {"length": 3, "gaps": [{"x": 1, "width": 0.1}], "stones": [{"x": 1.05, "top": -0.1, "side": 0.1}]},
    "stairs": {"stairs": [{"x": 0.5, "y": 0.1, "yaw": 0.3, "steps": 4, "riser": 0.1, "tread": 0.25, "landing": 0.5}]},
    "ramps": {"ramps": [{"x": 0.5, "length": 1, "height": 0.2}, {"x": 2.6, "yaw": 3.1, "length": 1, "height": 0.2}]},
    "beams": {"floor": "pit", "beams": [{"start": [-1, 0], "end": [1, 0.4], "width": 0.3}]},
    "stones": {"floor": "pit", "grids": [
        {"x": -0.5, "y": -0.5, "rows": 6, "columns": 5, "pitch": [0.3, 0.25], "side": 0.2, "top": [-0.05, 0.05],
         "present": 0.6, "shift": 0.03, "seed": 4},
        {"x": 1.5, "y": -0.5, "rows": 3, "columns": 5, "pitch": [0.3, 0.25], "radius": 0.1, "seed": 4},
    ]},
    "tilted": {"floor": "none", "boxes": [
        {"center": [0, 0, 0.1 * k], "size": [0.8, 0.5, 0.1], "rpy": [0.3 * k, -0.25 * k, k]} for k in range(1, 7)
    ], "cylinders": [{"center": [1.0, 0.5, 0.0], "radius": 0.3, "length": 0.6, "rpy": [0.2, 0.1, 0.0]}]},
}  # fmt: skip


@pytest.mark.parametrize("values", FORMS.values(), ids=FORMS)
def test_heights_are_those_of_the_simulated_world(values) -> None:
    built = world(**values)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1.2, 3.0, 800), rng.uniform(-1, 1, 800)
    np.testing.assert_allclose(built.height(x, y), by_physics(built, x, y), atol=1e-6)


@pytest.mark.parametrize("name", [*EVERY, "random:3:0.0", "random:3:1.0"])
def test_every_preset_is_simulated_where_it_says(name: str) -> None:
    built = build_world(load_world(name))
    end = built.goal if np.isfinite(built.goal).all() else [3.0, 0.0]
    rng = np.random.default_rng(0)
    ends = np.array([built.start[:2], end])
    around = np.array([1.0, 0.9])
    low, high = ends.min(axis=0) - around, ends.max(axis=0) + around
    x, y = (rng.uniform(low[k], high[k], 300) for k in range(2))
    np.testing.assert_allclose(built.height(x, y), by_physics(built, x, y), atol=1e-9)


def test_a_course_has_its_pit_first_and_its_floors_in_order() -> None:
    spec = world_spec(build_world(load_world("scenario_2"))).compile()
    names = [spec.geom(g).name for g in range(spec.ngeom)]
    assert names == ["pit", *(f"floor_{k}" for k in range(spec.ngeom - 1))]
    assert spec.geom("floor_0").size == pytest.approx([1.35, 0.5, 0.2])
    assert spec.geom_friction[:, 0] == pytest.approx(0.8)


def test_friction_is_taken_as_it_is_given() -> None:
    spec = world_spec(world(boxes=[{"center": [1, 0, 0.1], "size": [1, 1, 0.2], "friction": 100}], friction=0.5))
    assert spec.compile().geom_friction[:, 0].tolist() == [0.5, 100]


def test_a_foot_stands_on_ground_and_not_beside_it() -> None:
    built = world(length=3, gaps=[{"x": 1, "width": 0.2}], steps=[{"x": 2, "length": 0.5, "height": 0.1}])
    feet = {
        "on the floor": ((0.5, 0.1, 0.0), True),
        "sunk in a little, as physics has it": ((0.5, 0.1, -0.003), True),
        "on a seam between two floors": ((0.5, 0.0, 0.0), True),
        "in the air": ((0.5, 0.1, 0.03), False),
        "over the gap, level with the floor": ((1.1, 0.1, 0.0), False),
        "hung up on the gap's edge": ((1.002, 0.1, -0.01), False),
        "on the pit's floor": ((1.1, 0.1, -0.3), False),
        "beside the course": ((0.5, 1.3, -0.3), False),
        "on the step": ((2.2, 0.1, 0.1), True),
        "against the step's riser": ((1.999, 0.1, 0.05), False),
        "in the riser, half-way up": ((2.001, 0.1, 0.05), False),
        "at the riser's foot": ((1.999, 0.1, 0.01), True),
        "nowhere": ((np.nan, np.nan, np.nan), False),
    }
    stand = built.on_ground([point for point, _ in feet.values()])
    assert dict(zip(feet, stand.tolist(), strict=True)) == {what: answer for what, (_, answer) in feet.items()}


def test_a_foot_over_a_crack_between_two_boxes_stands_on_both() -> None:
    """The ramps of the hardware terrains end 1.7 mm before their platforms; a foot does not fall into that."""
    built = world(
        boxes=[
            {"center": [1, 0, 0.1], "size": [0.4, 1, 0.2]},
            {"center": [1.4017, 0, 0.1], "size": [0.4, 1, 0.2]},
            {"center": [2.0, 0, 0.1], "size": [0.4, 1, 0.2]},
        ],
        floor="none",
    )
    over_crack, over_gap = [1.2008, 0.1, 0.2], [1.7, 0.1, 0.2]
    beside_edge = [1.6022, 0.1, 0.2]
    at_the_cracks_end = [1.2008, 0.501, 0.2]
    stand = built.on_ground([over_crack, over_gap, beside_edge, at_the_cracks_end])
    assert stand.tolist() == [True, False, False, False]


def test_what_is_steep_labelled_or_said_to_be_none_is_no_ground() -> None:
    built = world(
        boxes=[
            {"center": [0, 0, 0.5], "size": [0.4, 0.4, 0.02], "rpy": [0, 0.3, 0]},
            {"center": [1, 0, 0.5], "size": [0.4, 0.4, 0.02], "rpy": [0, 1.2, 0]},
            {"center": [2, 0, 0.1], "size": [0.4, 0.4, 0.2], "label": "passable"},
            {"center": [3, 0, 0.1], "size": [0.4, 0.4, 0.2], "ground": False},
        ]
    )
    x = np.arange(4.0)
    points = np.column_stack([x, 0 * x, built.height(x, 0 * x)])
    assert built.on_ground(points).tolist() == [True, False, False, False]


def test_a_foot_under_a_floating_tread_stands_on_what_is_below() -> None:
    built = world(boxes=[{"center": [1, 0, 0.5], "size": [0.4, 0.4, 0.05]}])
    assert built.on_ground([[1, 0, 0], [1, 0, 0.525], [1, 0, 0.3]]).tolist() == [True, True, False]


def test_a_finish_line_runs_across_the_way_and_a_goal_has_a_circle() -> None:
    line = world(start=[1, 1, 0.0], goal=[1, 4])
    assert line.remaining([1, 1]) == pytest.approx(3.0)
    assert line.remaining([7, 3.5, 0.3]) == pytest.approx(0.5)
    assert line.remaining([-3, 4.0]) <= 0
    circle = world(goal=[3, 4], goal_radius=0.5)
    assert circle.remaining([0, 0]) == pytest.approx(4.5)
    assert circle.remaining([3, 3.5]) == pytest.approx(0.0)
    course = build_world(load_world("gap_10"))
    assert course.remaining([2.8, 0.4]) == 0.0 and course.remaining([2.79, 0]) == pytest.approx(0.01)


def test_a_walk_needs_a_goal() -> None:
    with pytest.raises(SettingsError, match=r"world staircase: it has no goal.* goal: \[x, y\]"):
        build_world(load_world("staircase")).remaining([0, 0])
    with pytest.raises(SettingsError, match="no goal"):
        Builder().world.require_goal()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"length": 3, "gaps": [{"x": 0, "width": 0.3}], "start": [0.1, 0, 0]}, "start .0.1, 0. lies -0.3 m high"),
        (
            {"goal": [3, 0], "boxes": [{"center": [3, 0, 0.1], "size": [1, 1, 0.2], "ground": False}]},
            "goal .3, 0. lies",
        ),
        ({"floor": "none", "goal": [3, 0]}, "start .0, 0. lies over nothing"),
        (
            {"floor": "none", "shapes": [{"shape": "sphere", "x": 1, "y": 0, "radius": 0.1}]},
            "shapes.0 lies over no floor",
        ),
        ({"boxes": [{"center": [0, 0, 0], "size": [1, 0, 1]}]}, "boxes.0.size.1"),
        ({"boxes": [{"center": [0, float("nan"), 0], "size": [1, 1, 1]}]}, "boxes.0.center.1.*finite"),
        ({"boxes": [{"center": [0, 0, 0], "size": [1, 1, 1], "colour": 3}]}, "unknown setting 'boxes.0.colour'"),
        ({"holes": []}, "unknown setting 'holes'"),
        ({"length": 1, "gaps": [{"x": 0.95, "width": 0.1}]}, "beyond the course"),
        ({"gaps": [{"x": 0.95, "width": 0.1}]}, "needs a length"),
        ({"length": 1, "floor": "ground"}, "either length or floor"),
        ({"stones": [{"x": 1, "top": 0.1}]}, "either its side"),
        ({"floor": "pit", "stones": [{"x": 1, "top": -0.4, "side": 0.1}]}, "stone at .1, 0..*below"),
        ({"beams": [{"start": [0, 0], "end": [0, 0], "width": 1}]}, "two different places"),
        ({"profile": {"stretches": [{"x": 1, "height": 0}], "end": 0}}, "ascending"),
    ],
)
def test_a_description_that_makes_no_world_is_refused_in_one_line(values, message) -> None:
    with pytest.raises(SettingsError, match=message) as error:
        world(**values)
    assert "\n" not in str(error.value)


def test_unknown_worlds_are_refused_with_the_names_there_are() -> None:
    with pytest.raises(SettingsError, match=r"no such preset.*scenario_1"):
        load_world("scenario_9")
    with pytest.raises(SettingsError, match="random:SEED:DIFFICULTY"):
        load_world("random:x")
    assert is_world("scenario_1") and is_world("random:3:0.5") and not is_world("nowhere")


def test_random_worlds_repeat_and_grow_with_difficulty() -> None:
    assert random_world(5, 0.5) == random_world(5, 0.5)
    easy = [gap.width for seed in range(20) for gap in random_world(seed, 0.0).gaps]
    hard = [gap.width for seed in range(20) for gap in random_world(seed, 1.0).gaps]
    assert max(easy) == pytest.approx(0.06)
    assert max(hard) > 0.15
    assert any(random_world(seed, 1.0).steps for seed in range(20))


def test_random_worlds_of_different_difficulties_have_different_names() -> None:
    difficulties = (0, 0.05, 0.5, 0.501, 0.504, 0.5001, 0.51, 0.9, 1, 1e-7)
    names = [random_world(3, difficulty).name for difficulty in difficulties]
    assert len(set(names)) == len(names)
    assert random_world(3, 0.5).name == "random_3_050" and random_world(3, 1.0).name == "random_3_100"


def test_true_heights_are_the_same_whether_cut_from_a_whole_or_made_anew() -> None:
    built = build_world(load_world("rubble"))
    whole = TrueHeights(built, [-0.3, 0.4], [1.9, 2.3], 0.02)
    for centre in ([0.8, 1.35], [0.413, 1.0071], [0.5, 1.2], [5.0, 1.0]):  # the last one reaches beyond the area
        cut, made = whole.around(centre, 1.0), elevation_map(built, centre, 1.0, 0.02)
        np.testing.assert_array_equal(cut.heights, made.heights)
        np.testing.assert_allclose(cut.center, made.center, atol=1e-12)


def test_the_elevation_map_is_aligned_with_the_world() -> None:
    built = build_world(load_world("gap_10"))
    here = elevation_map(built, [1.013, 0.003], 1.9, 0.02)
    there = elevation_map(built, [1.3, -0.1], (1.0, 0.5), 0.02)
    assert here.heights.shape == (95, 95) and there.heights.shape == (50, 25)
    for grid in (here, there):
        assert np.abs(grid.lower_corner / 0.02 - np.round(grid.lower_corner / 0.02)).max() < 1e-9
        x = grid.lower_corner[0] + 0.02 * (np.arange(len(grid.heights)) + 0.5)
        gap = (x > 1.2) & (x < 1.3)
        assert np.all(grid.heights[gap] == np.float32(-0.3)) and np.all(grid.heights[~gap] == 0)
    assert np.isnan(elevation_map(world(floor="none"), [0, 0], 1.0, 0.1).heights).all()


def test_a_robots_own_start_is_taken_for_it() -> None:
    settings = build(
        WorldSettings, {"name": "w", "goal": [3, 0], "robots": {"anymal": {"start": [1, 0, 0], "goal": [4, 0]}}}
    )
    assert build_world(settings, robot="anymal_c").goal.tolist() == [4, 0]
    assert build_world(settings, robot="go2").start[0] == 0


def environment(**changes):
    return {
        "name": "beam", "frame": "metres", "note": "a beam over a pit",
        "start": {"torso_xyz": [-2, 0, 0.3], "yaw": 0}, "goal": {"torso_xyz": [2, 0, 0.3], "yaw": 0},
        "anymal": {"start": {"torso_xyz": [-1.5, 0, 0.6], "yaw": 0}, "goal": {"torso_xyz": [2, 0, 0.6]},
                   "goal_radius_xy": 0.4, "source": "fork"},
        "boxes": [
            {"kind": "box", "center": [-2, 0, -0.05], "size": [2, 2, 0.1], "rpy": [0, 0, 0], "mu": 1, "name": "half/a"},
            {"kind": "box", "center": [2, 0, -0.05], "size": [2, 2, 0.1], "mu": 100, "name": "half/a", "cropped": True},
            {"kind": "box", "center": [0, 0, -0.05], "size": [2, 0.4, 0.1], "mu": 1.0, "name": "beam"},
            {"kind": "box", "center": [0, 0, 0.05], "size": [0.06, 0.4, 0.08], "rpy": [0.2, 0, 0], "mu": 1.0,
             "name": "barrier", "label": "passable"},
            {"kind": "box", "center": [0, 0, -1], "size": [4, 4, 0.1], "mu": 1.0, "name": "pit"},
            {"kind": "cylinder", "center": [0.5, 1, -0.5], "radius": 0.2, "length": 1.0, "mu": 1.0, "name": "stone"},
        ],
        **changes,
    }  # fmt: skip


def test_a_json_file_is_a_world(tmp_path) -> None:
    path = tmp_path / "beam.json"
    path.write_text(json.dumps(environment()))
    built = build_world(load_world(str(path)))
    assert (built.name, built.goal_radius_m, built.start.tolist()) == ("beam", 0.25, [-2, 0, 0])
    # A pit far below start and goal is off the course, and so is what is labelled passable.
    off = {name for name, ground in zip(built.names, built.ground, strict=True) if not ground}
    assert off == {"barrier", "pit"}
    assert built.height(0.9, 1.5) == pytest.approx(-0.95) and not built.on_ground([0.9, 1.5, -0.95])[0]
    assert built.on_ground([[0.5, 0.1, 0], [0.5, 1.1, 0]]).all()
    model = world_spec(built).compile()
    assert model.ngeom == 6 and model.geom_friction[1, 0] == 100
    other = build_world(load_world(str(path)), robot="anymal_c")
    assert other.start[0] == -1.5 and other.goal_radius_m == 0.4


def test_a_pit_is_ground_where_the_file_says_so(tmp_path) -> None:
    path, values = tmp_path / "beam.json", environment()
    values["boxes"][4]["ground"] = True
    path.write_text(json.dumps(values))
    assert build_world(load_world(str(path))).on_ground([0.9, 1.5, -0.95])[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "expected a JSON object with boxes, start and goal, got list"),
        ("{", "not valid JSON at line 1"),
        (json.dumps({"name": "a", "start": {"torso_xyz": [0, 0, 0]}}), "boxes: expected a list"),
        (json.dumps(environment(hills=[])), "unknown key 'hills'"),
        (json.dumps(environment(start={"xyz": [0, 0, 0]})), "start: expected an object with torso_xyz"),
        (json.dumps(environment(boxes=[{"kind": "cone"}])), "boxes.0: kind is 'cone'"),
        (json.dumps(environment(boxes=[{"center": [0, 0, 0], "size": [1, 1]}])), "boxes.0.size"),
        (json.dumps(environment(anymal=[])), "anymal: expected an object"),
        (json.dumps(environment(name="Über")), "setting 'name'"),
    ],
)
def test_json_that_describes_no_world_is_refused_in_one_line(tmp_path, text, message) -> None:
    path = tmp_path / "mine.json"
    path.write_text(text)
    with pytest.raises(SettingsError, match=message) as error:
        load_world(str(path))
    assert "\n" not in str(error.value) and str(error.value).startswith(str(path))


def test_primitives_of_one_name_are_told_apart() -> None:
    builder = Builder(floor=False)
    for x in range(3):
        builder.add(CUBOID, box([x, 0, 0], np.eye(3), [0.1, 0.1, 0.1]), 0.1, name="box")
    assert builder.build("w").names == ("box", "box_1", "box_2")
