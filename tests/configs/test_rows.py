"""Names of planners in a suite: built in, the user's own, and with settings of their own."""

import pytest

from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.robots import load_robot
from legtool.configs.rows import SHARED, dataclass_with, is_horizon, parse_row, split_planners
from legtool.errors import SettingsError
from legtool_runtime.search.settings import PipsSettings


def settings(planners: str, **changes: object) -> PlannerEvalSettings:
    return PlannerEvalSettings(planners=planners, robot="anymal_c", **changes)  # type: ignore[arg-type]


def test_commas_in_brackets_part_no_planners() -> None:
    text = "quadpips, quadpips[pips.feet.gaits=[trot,walk]], my.module:Planner[map=truth]"
    with pytest.raises(ValueError, match="expected a name, or name"):
        parse_row(split_planners(text)[1])  # brackets in brackets are none of ours
    assert split_planners("a,b[x=1,2;y=3],c:D") == ["a", "b[x=1,2;y=3]", "c:D"]


def test_a_row_changes_settings_for_itself_alone() -> None:
    whole = settings("quadpips,quadpips[regions=truth;pips.cost_to_go=false;tracker.reassign_m=0.07]", seed=7)
    assert whole.rows == whole.planners and whole.of_row("quadpips") == ("quadpips", whole)
    planner, changed = whole.of_row(whole.rows[1])
    assert planner == "quadpips" and (changed.regions, changed.seed) == ("truth", 7)
    assert changed.pips == {"cost_to_go": False} and changed.tracker.reassign_m == 0.07
    assert whole.regions == "camera" and whole.pips == {}


def test_a_name_that_begins_with_h_is_no_horizon() -> None:
    assert is_horizon("h5") and not is_horizon("high_ground:HighGround") and not is_horizon("h")


def test_each_horizon_of_a_changed_velocity_planner_is_a_row() -> None:
    assert settings("velocity[map=truth],blind", horizons="3,5").rows == ("h3[map=truth]", "h5[map=truth]", "blind")
    assert settings("velocity[map=truth]").of_row("h3[map=truth]")[0] == "h3"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("quadpips[regions]", "expected key=value"),
        ("quadpips[regions=truth", "expected a name, or name"),
        ("quadpips[seed=3]", "seed is a setting of the whole suite"),
        ("quadpips[start_x=0]", "start_x is a setting of the whole suite"),
        ("quadpip[regions=truth]", "expected different ones of"),
        ("quadpips,quadpips", "expected different ones of"),
    ],
)
def test_names_that_mean_nothing_are_refused(name: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        settings(name)


def test_changes_are_checked_like_any_setting() -> None:
    with pytest.raises(SettingsError, match=r"planner quadpips\[regions=moon\]: setting 'regions' is 'moon'"):
        settings("quadpips[regions=moon]").of_row("quadpips[regions=moon]")
    with pytest.raises(SettingsError, match="unknown setting 'region'"):
        settings("quadpips[region=truth]").of_row("quadpips[region=truth]")
    assert set(SHARED) <= set(PlannerEvalSettings.model_fields)


def test_settings_of_the_runtime_are_changed_by_name_and_checked() -> None:
    plain = PipsSettings.of(load_robot("anymal_c").geometry())
    changes = {"candidates": {"centroids": True}, "walkability": {"margin_m": 0.0}, "feet": {"gaits": ["trot"]}}
    changed = dataclass_with(plain, changes, "pips")
    assert changed.candidates.centroids and changed.walkability.margin_m == 0.0 and changed.feet.gaits == ("trot",)
    assert changed.candidates.spacing == plain.candidates.spacing and not plain.candidates.centroids
    with pytest.raises(SettingsError, match=r"unknown setting 'pips\.candidates\.space'"):
        dataclass_with(plain, {"candidates": {"space": 1}}, "pips")
    with pytest.raises(SettingsError, match="spacing"):
        dataclass_with(plain, {"candidates": {"spacing": 9.0}}, "pips")
    with pytest.raises(SettingsError, match=r"unknown setting 'pips\.sigth'"):
        dataclass_with(plain, {"sigth": 1.0}, "pips")
