import pytest

from legtool.configs.settings import build
from legtool.configs.world_parts import Gap
from legtool.configs.worlds import PRESETS, WorldSettings, load_world
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.drawing import draw_world


def drawn(columns=81, **values):
    return draw_world(build_world(build(WorldSettings, {"name": "w", **values})), columns=columns)


def test_a_course_is_drawn_with_its_gaps_where_they_are() -> None:
    course = build_world(WorldSettings(name="c", length=3, gaps=(Gap(x=1, width=0.15, side="left"),)))
    lines = draw_world(course, columns=81)  # 5 cm each, from -0.5 m
    rows = [line[2:] for line in lines if set(line[2:]) <= set(". SG") and len(line) > 50]
    assert len(rows) == 10
    assert rows[0][30:33] == "   " and rows[0][28] == "." and rows[0][34] == "."
    assert " " not in rows[-1]
    assert sum("S" in row for row in rows) == sum("G" in row for row in rows) == 1


def test_heights_pits_and_what_is_no_ground_are_told_apart() -> None:
    lines = drawn(
        floor="none",
        goal=[4, 0],
        goal_radius=0.3,
        boxes=[
            {"center": [0, 0, -0.05], "size": [3, 4, 0.1]},
            {"center": [2, 0, 0.05], "size": [1, 4, 0.1]},
            {"center": [4, 0, -0.1], "size": [2, 4, 0.1]},
            {"center": [0.5, 0.5, 0.1], "size": [0.2, 0.2, 0.2], "ground": False, "name": "post"},
            {"center": [2, 0, -1.0], "size": [8, 1.6, 0.1], "ground": False, "name": "pit"},
        ],
    )
    text = "\n".join(lines)
    assert "4.00 m to the goal" in text and "within 0.3 m" in text
    assert "post: cuboid, friction 0.8, off the course, top 20 cm" in text
    row = next(line for line in lines if "S" in line and "G" in line and "start" not in line)[2:]
    assert row[20] == "." and row[40] == "a" and row[75] == "_" and row[52] == " "
    assert any("#" in line for line in lines)


def test_many_primitives_are_listed_by_kind() -> None:
    grid = {"x": 0.5, "y": -0.5, "rows": 5, "columns": 4, "pitch": [0.3, 0.3], "side": 0.2, "top": [0.05, 0.1]}
    assert any("20 × cuboid, friction 0.8, tops" in line for line in drawn(goal=[3, 0], grids=[grid]))


@pytest.mark.parametrize("name", sorted(path.stem for path in PRESETS.glob("*.yaml")))
def test_every_preset_is_drawn(name) -> None:
    lines = draw_world(build_world(load_world(name)))
    assert sum("S" in line for line in lines[3:]) >= 1 and max(map(len, lines[-5:])) == 102
