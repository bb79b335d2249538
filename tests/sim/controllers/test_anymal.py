"""ANYmal's public policies: clocks, heights, and walks of the real files where they are at hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.errors import SettingsError
from legtool.sim.controllers.anymal.em_dtc import PHASE_S, EmDtcController
from legtool.sim.controllers.anymal.em_rl import EmRlController, clock_joints, phases_at
from legtool.sim.controllers.anymal.heights import along_steps, around_feet, heights_at, rings
from legtool.sim.controllers.anymal.senses import LEGS, Drives
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.simulation import Simulation
from legtool_runtime.rotations import from_angles, rotation_of, yaw_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.selectors import Place, Selector, Wish, any_place

FILES = Path(__file__).parents[4] / "shared" / "data" / "controllers" / "anymal"
EM_RL, EM_DTC = FILES / "anymal_c_em_rl.pt", FILES / "anymal_d_dtc_stones.pt"
#: ANYmal C's FOOT frame from the knee, and the knee from the thigh's axis, with all joints at 0 [m].
FOOT, KNEE = np.array([0.08795, 0.01305, -0.33797]), np.array([0.0, 0.1003, -0.285])
HFE = np.array([0.0599, 0.08381, 0.0])


@pytest.fixture(scope="module")
def anymal() -> SimRobot:
    return build_robot(load_robot("anymal_c"))


def has(path: Path) -> Path:
    if not path.is_file():
        pytest.skip(f"{path.name} is not at hand")
    return path


def foot_below_abduction(leg: int, joints: np.ndarray) -> np.ndarray:
    """A foot (LF, LH, RF, RH) in the frame of its abduction joint moved to the thigh's axis, by the URDF's lengths."""
    mirror = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]])[leg]
    hip, thigh, knee = joints.reshape(4, 3)[leg]
    below = mirror * KNEE + from_angles(0, knee, 0) @ (mirror * FOOT)
    return from_angles(hip, 0, 0) @ (mirror * [0, 1, 1] * HFE + from_angles(0, thigh, 0) @ below)


@pytest.mark.parametrize(("time_s", "up"), [(0.0, [0, 0, 0, 0]), (0.15, [0.2, 0, 0, 0.2]), (0.45, [0, 0.2, 0.2, 0])])
def test_the_foot_clock_puts_anymals_feet_where_it_says(time_s: float, up: list[float]) -> None:
    joints = clock_joints(time_s)
    for leg, (ahead, side) in enumerate(((1, 1), (-1, 1), (1, -1), (-1, -1))):
        wanted = [ahead * 0.0079, side * 0.0572, -0.573 + up[leg]]
        assert foot_below_abduction(leg, joints) == pytest.approx(wanted, abs=1e-3)


def test_diagonal_legs_swing_in_turn() -> None:
    assert phases_at(0.0) == pytest.approx([0, np.pi, np.pi, 0])
    assert phases_at(0.6 + 0.06) == pytest.approx(phases_at(0.06))
    assert np.sin(phases_at(0.1)) == pytest.approx(np.sin(np.pi / 3) * np.array([1, -1, -1, 1]))


def test_heights_are_those_of_cells_and_the_given_one_where_nothing_is_known() -> None:
    heights = np.zeros((10, 10), np.float32)
    heights[7, 2], heights[0, 0] = 0.3, np.nan
    known = HeightMap(heights, 0.1, np.zeros(2))
    places = np.array([[0.25, -0.25], [0.2001, -0.2001], [-0.45, -0.45], [0.51, 0.0], [0.0, 0.0]])
    assert heights_at(known, places, -1.0) == pytest.approx([0.3, 0.3, -1, -1, 0])
    assert heights_at(None, places, 0.5) == pytest.approx(np.full(5, 0.5))


def test_rings_turn_with_the_robot_about_each_foot() -> None:
    assert (
        rings().shape == (52, 2) and rings()[0] == pytest.approx([0.1, 0]) and rings()[-16] == pytest.approx([0.9, 0])
    )
    assert rings()[7] == pytest.approx(0.3 * np.array([np.cos(np.pi / 4), np.sin(np.pi / 4)]))
    x = 0.05 * (np.arange(100) - 49.5)
    slope = HeightMap(np.repeat(x[:, None], 100, axis=1), 0.05, np.zeros(2))
    feet = np.array([[0.4, 0.3, 0], [0.4, -0.3, 0], [-0.4, 0.3, 0], [-0.4, -0.3, 0]])
    ahead, turned = (around_feet(slope, feet, yaw, 0.0) for yaw in (0.0, np.pi))
    assert ahead == pytest.approx(feet[:, :1] + rings()[:, 0], abs=0.026)
    assert turned == pytest.approx(feet[:, :1] - rings()[:, 0], abs=0.026)
    way = along_steps(slope, feet, feet[:, :2] + [0.2, 0.0], 10, 0.0)
    assert way == pytest.approx(feet[:, :1] + np.linspace(0, 0.2, 10), abs=0.026)


def test_drives_pull_towards_the_target_and_no_harder_than_the_real_ones(anymal: SimRobot) -> None:
    drives, simulation = Drives(anymal), Simulation(anymal, None, ticks=1)  # type: ignore[arg-type]
    felt = drives.feel(simulation.state)
    knees = felt.joints.reshape(4, 3)[:, 2] - simulation.state.joint_positions[LEGS, 2]
    assert knees == pytest.approx(
        [0.2719, -0.2719, 0.2719, -0.2719], abs=1e-4
    )  # a foot of the URDF stands off its shank
    assert felt.gravity == pytest.approx([0, 0, -1]) and felt.soles[:, 2] == pytest.approx(np.zeros(4), abs=1e-9)
    assert np.abs(drives.torques(simulation.state, felt.joints)).max() == pytest.approx(0.0)
    target = felt.joints.copy()
    target[3], target[11] = target[3] + 0.1, target[11] - 5.0  # the left hind hip, the right hind knee
    torques = drives.torques(simulation.state, target).reshape(4, 3)
    assert torques[2, 0] == pytest.approx(8.0) and torques[3, 2] == pytest.approx(-80.0)
    assert np.count_nonzero(np.abs(torques) > 1e-9) == 2 and LEGS == [0, 2, 1, 3]


def test_a_robot_that_is_not_anymal_is_refused() -> None:
    with pytest.raises(SettingsError, match="em_rl and em_dtc are ANYmal's"):
        Drives(build_robot(load_robot("go2")))


@pytest.mark.parametrize(("make", "row"), [(EmRlController, "em_rl"), (EmDtcController, "em_dtc")])
def test_a_missing_or_wrong_policy_is_told_in_one_line(
    make: Callable[..., object], row: str, anymal: SimRobot, tmp_path: Path
) -> None:
    with pytest.raises(SettingsError, match=rf"^policies\.{row} is missing; set policies\.{row}"):
        make(anymal, None)
    with pytest.raises(SettingsError, match="no such file"):
        make(anymal, tmp_path / "nothing.pt")
    wrong = tmp_path / "wrong.pt"
    wrong.write_bytes(b"no network")
    with pytest.raises(SettingsError, match="no TorchScript policy with"):
        make(anymal, wrong)
    if EM_RL.is_file():
        with pytest.raises(SettingsError, match="no TorchScript policy with"):
            make(anymal, EM_DTC if row == "em_rl" else EM_RL)


def walk(
    robot: SimRobot, controller: object, seconds: float, select: Selector | None = None, speed: float = 0.4
) -> tuple[Simulation, float]:
    """A walk ahead on flat ground, and its speed over the last half [m/s]."""
    simulation = Simulation(robot, controller, ticks=round(seconds * CONTROL_RATE_HZ) + 1)  # type: ignore[arg-type]
    simulation.begin()
    middle = np.zeros(3)
    for k in range(round(seconds * CONTROL_RATE_HZ)):
        simulation.observe()
        simulation.act(Guidance((speed, 0.0, 0.0), select or any_place(None)))
        assert not simulation.fallen()
        if 2 * k == round(seconds * CONTROL_RATE_HZ):
            middle = simulation.state.position_world.copy()
    way = (simulation.state.position_world - middle)[:2]
    return simulation, float(np.hypot(*way)) / (0.5 * seconds)


def test_em_rl_walks_as_commanded_and_forgets_at_reset(anymal: SimRobot) -> None:
    controller = EmRlController(anymal, has(EM_RL))
    first, speed = walk(anymal, controller, 6.0)
    assert speed == pytest.approx(0.4, abs=0.03)
    assert abs(float(yaw_of(rotation_of(first.state.orientation)))) < 0.1
    again, _ = walk(anymal, controller, 6.0)
    assert again.state.position_world == pytest.approx(first.state.position_world, abs=1e-9)


def test_em_rl_looks_at_the_map(anymal: SimRobot) -> None:
    targets = []
    for height in (0.0, 0.2):
        heights = np.zeros((100, 100), np.float32)
        heights[60:] = height
        controller = EmRlController(anymal, has(EM_RL))
        simulation = Simulation(anymal, controller, ticks=2)
        simulation.begin()
        simulation.act(Guidance((0.3, 0.0, 0.0), any_place(None), None, HeightMap(heights, 0.05, np.zeros(2))))
        targets.append(controller._target.copy())
    assert np.abs(targets[1] - targets[0]).max() > 0.01


def test_em_dtc_walks_and_its_feet_follow_the_selector_in_part(anymal: SimRobot) -> None:
    def wider(wish: Wish) -> Place:
        out = 0.05 if wish.leg in (0, 2) else -0.05
        return Place(np.array([wish.nominal[0], wish.nominal[1] + out, 0.0]), np.array([0.0, 0.0, 1.0]))

    widths = []
    for select in (any_place(None), wider):
        simulation, speed = walk(anymal, EmDtcController(anymal, has(EM_DTC)), 4.0, select)
        assert speed == pytest.approx(0.43, abs=0.06)  # it walks faster than commanded
        feet = anymal.geometry.feet(simulation.state.joint_positions)[:, 1]
        widths.append(float(np.abs(feet).mean()))
    assert 0.005 < widths[1] - widths[0] < 0.045


def test_em_dtc_plans_each_pairs_footholds_ahead_of_where_it_stands(anymal: SimRobot) -> None:
    controller = EmDtcController(anymal, has(EM_DTC))
    walk(anymal, controller, 0.02)
    plan = controller.plan
    assert (
        plan is not None
        and plan.left_s == pytest.approx(PHASE_S)
        and plan.stands.tolist() == [True, False, False, True]
    )
    assert plan.footholds[1] == pytest.approx([0.4 * 1.5 * PHASE_S + 0.41, -0.26, 0.0], abs=0.01)
    walk(anymal, controller, PHASE_S + 0.05)
    assert controller.plan is not None and controller.plan.stands.tolist() == [False, True, True, False]
