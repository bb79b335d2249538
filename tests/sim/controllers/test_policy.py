"""Policies as they were trained: what networks made here are shown, and what becomes of their answers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor, nn

from legtool.configs.policies import JOINT_NAMES, load_policy_settings
from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.errors import ControllerError, SettingsError
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.controllers.policy import PolicyController
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import RobotState
from legtool.training.onnx_model import to_onnx
from legtool_runtime.rotations import from_angles
from legtool_runtime.terrain.elevation import HeightMap

TWELVE = 12 * (0.0,)


class Linear(nn.Module):
    """Twelve numbers: weights times what it is shown, plus a bias."""

    def __init__(self, weights: np.ndarray, bias: Sequence[float] = TWELVE) -> None:
        super().__init__()
        self.weights = nn.Buffer(torch.tensor(weights, dtype=torch.float32))
        self.bias = nn.Buffer(torch.tensor(bias, dtype=torch.float32))

    def forward(self, obs: Tensor) -> Tensor:
        return obs @ self.weights.T + self.bias


def shows(*numbers: int, of: int) -> Linear:
    """A network whose first actions are these of the numbers that it is shown, in order."""
    weights = np.zeros((12, of))
    for action, number in enumerate(numbers):
        weights[action, number] = 1.0
    return Linear(weights)


class Sum(nn.Module):
    """A recurrent network: every action is the sum of all first numbers that it was ever shown."""

    def forward(self, obs: Tensor, total: Tensor) -> tuple[Tensor, Tensor]:
        total = total + obs[:, :1]
        return total.expand(1, 12) * 1.0, total


class Inside(nn.Module):
    """The same sum, kept within the module."""

    def __init__(self) -> None:
        super().__init__()
        self.total = nn.Buffer(torch.zeros(1, 1))

    def forward(self, obs: Tensor) -> Tensor:
        self.total += obs[:, :1]
        return self.total.expand(1, 12) * 1.0

    @torch.jit.export
    def begin_at_seven(self) -> None:
        self.total.fill_(7.0)


def described(folder: Path, net: nn.Module | str, observation: Sequence[Any], **changes: Any) -> Path:
    """A policy's YAML beside its network in TorchScript; torques of its actions are 1 Nm for each unit."""
    if isinstance(net, nn.Module):
        torch.jit.script(net).save(str(folder / "net.pt"))
    description = {
        "torchscript": net if isinstance(net, str) else "net.pt",
        "rate_hz": 50,
        "observation": list(observation),
        "joint_order": list(JOINT_NAMES),
        "home": [0.0] * 12,
        "action_scale": 1.0,
        "stiffness": 1.0,
        "damping": 0.0,
        **changes,
    }
    path = folder / "policy.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in description.items() if value is not None}))
    return path


def made(folder: Path, robot: SimRobot, net: nn.Module | str, observation: Sequence[Any], **changes: Any) -> Any:
    controller = make_controller(robot, str(described(folder, net, observation, **changes)))
    assert isinstance(controller, PolicyController)
    controller.reset(RobotState())
    return controller


def level() -> RobotState:
    state = RobotState()
    state.orientation[0] = 1.0
    return state


def answers(controller: PolicyController, commands: Sequence[float], state: RobotState | None = None) -> np.ndarray:
    """(n, 12) torques at each answer of a policy at 50 Hz, commanded ahead."""
    state, out = state or level(), []
    for vx in commands:
        out.append(controller.step(state, np.array([vx, 0.0, 0.0])).copy())
        for _ in range(7):
            controller.step(state, np.array([vx, 0.0, 0.0]))
    return np.array(out)


def test_a_term_is_moved_limited_and_scaled_in_that_order(tmp_path: Path, aliengo: SimRobot) -> None:
    term = {"term": "command", "offset": 0.5, "clip": [-1.0, 2.0], "scale": [2.0, 1.0, 0.25]}
    controller = made(tmp_path, aliengo, shows(0, 1, 2, of=3), [term])
    given = np.array([3.0, -4.0, 0.3])
    assert controller.step(level(), given)[:3] == pytest.approx([4.0, -1.0, 0.2])


def test_all_that_is_shown_can_be_limited_at_last(tmp_path: Path, aliengo: SimRobot) -> None:
    controller = made(tmp_path, aliengo, shows(0, of=3), [{"term": "command", "scale": 10.0}], observation_clip=5.0)
    assert answers(controller, [0.3, 0.9])[:, 0] == pytest.approx([3.0, 5.0])


@pytest.mark.parametrize(
    ("changes", "shown"),
    [
        ({"history": 3}, [2, 2, 3, 3, 4, 4]),
        ({"history": [0, 1, 2]}, [4, 4, 3, 3, 2, 2]),
        ({"history": 3, "history_by": "term"}, [2, 3, 4, 2, 3, 4]),
        ({"history": [1, 3, 2]}, [3, 3, 1, 1, 2, 2]),  # earlier ticks alone, as from a ring buffer
    ],
)
def test_history_goes_by_time_or_by_term_in_any_order(
    tmp_path: Path, aliengo: SimRobot, changes: dict[str, Any], shown: list[float]
) -> None:
    first = {"term": "command", "scale": [1.0, 0.0, 0.0]}
    net = shows(*[3 * place for place in range(6)], of=18)
    controller = made(tmp_path, aliengo, net, [first, first], **changes)
    assert answers(controller, [1, 2, 3, 4])[-1, :6] == pytest.approx(shown)


def test_terms_may_have_histories_of_their_own(tmp_path: Path, aliengo: SimRobot) -> None:
    terms = [{"term": "command", "history": [0, 2]}, {"term": "constant", "values": [9.0]}]
    controller = made(tmp_path, aliengo, shows(0, 3, 6, of=7), terms, history_by="term")
    assert answers(controller, [1, 2, 3])[-1, :3] == pytest.approx([3, 1, 9])


@pytest.mark.parametrize(("start", "shown"), [("first", [5, 5, 5]), ("zero", [0, 0, 5])])
def test_before_the_first_tick_the_first_is_shown_or_zeros(
    tmp_path: Path, aliengo: SimRobot, start: str, shown: list[float]
) -> None:
    controller = made(tmp_path, aliengo, shows(0, 3, 6, of=9), ["command"], history=3, history_start=start)
    for _ in range(2):  # a new walk begins anew
        assert answers(controller, [5, 6])[0, :3] == pytest.approx(shown)
        controller.reset(level())


def test_states_of_onnx_are_fed_back_and_are_zero_at_each_start(tmp_path: Path, aliengo: SimRobot) -> None:
    model = to_onnx(Sum(), {"obs": torch.zeros(1, 3), "h_in": torch.zeros(1, 1)}, outputs=["actions", "h_out"])
    (tmp_path / "net.onnx").write_bytes(model)
    fed = [{"input": "h_in", "output": "h_out"}]
    controller = made(tmp_path, aliengo, "", ["command"], torchscript=None, onnx="net.onnx", recurrent=fed)
    for _ in range(2):
        assert answers(controller, [1, 2, 4])[:, 11] == pytest.approx([1, 3, 7])
        controller.reset(level())
    with pytest.raises(SettingsError, match=r"inputs that no state feeds: obs, h_in; expected one, .*'recurrent'"):
        made(tmp_path, aliengo, "", ["command"], torchscript=None, onnx="net.onnx")
    fed = [{"input": "hidden", "output": "h_out"}]
    with pytest.raises(SettingsError, match="has no input 'hidden'; it has obs, h_in"):
        made(tmp_path, aliengo, "", ["command"], torchscript=None, onnx="net.onnx", recurrent=fed)


def test_states_of_torchscript_are_fed_back_by_their_place(tmp_path: Path, aliengo: SimRobot) -> None:
    fed = [{"input": "total", "output": 1, "shape": [1, 1]}]
    controller = made(tmp_path, aliengo, Sum(), ["command"], recurrent=fed)
    for _ in range(2):
        assert answers(controller, [1, 2, 4])[:, 0] == pytest.approx([1, 3, 7])
        controller.reset(level())
    with pytest.raises(SettingsError, match="state total has no shape"):
        made(tmp_path, aliengo, Sum(), ["command"], recurrent=[{"input": "total", "output": 1}])


def test_states_within_a_module_are_as_in_its_file_at_each_start(tmp_path: Path, aliengo: SimRobot) -> None:
    controller = made(tmp_path, aliengo, Inside(), ["command"])
    for _ in range(2):
        assert answers(controller, [1, 2, 4])[:, 0] == pytest.approx([1, 3, 7])
        controller.reset(level())
    controller = made(tmp_path, aliengo, Inside(), ["command"], reset_method="begin_at_seven")
    for _ in range(2):
        assert answers(controller, [1, 2])[:, 0] == pytest.approx([8, 10])
        controller.reset(level())
    with pytest.raises(SettingsError, match="has no method 'forget'"):
        made(tmp_path, aliengo, Inside(), ["command"], reset_method="forget")


def test_an_estimator_is_asked_first(tmp_path: Path, aliengo: SimRobot) -> None:
    torch.jit.script(Linear(np.array([[2.0, 0, 0, 2.0, 0, 0]]), [0.5])).save(str(tmp_path / "estimator.pt"))
    estimator = {"torchscript": "estimator.pt", "observation": ["command"], "history": 2, "outputs": 1}
    controller = made(tmp_path, aliengo, shows(0, 3, of=4), ["command", "estimate"], estimator=estimator)
    assert answers(controller, [1, 4])[:, :2] == pytest.approx(np.array([[1, 4.5], [4, 10.5]]))
    with pytest.raises(SettingsError, match=r"estimator\.pt: its output has 1 numbers, expected 2"):
        made(tmp_path, aliengo, shows(of=5), ["command", "estimate"], estimator={**estimator, "outputs": 2})


@pytest.mark.parametrize(
    ("previous", "observed", "expected"),
    [
        # Actions 1, then 0: by 0.8 new and 0.2 before.
        ("filtered", "filtered", [0.8, 0.16, 0.032]),
        ("raw", "filtered", [0.8, 0.2, 0.0]),
    ],
)
def test_the_filter_adds_what_it_gave_or_what_the_network_gave(
    tmp_path: Path, aliengo: SimRobot, previous: str, observed: str, expected: list[float]
) -> None:
    net = shows(0, of=3)
    controller = made(
        tmp_path, aliengo, net, ["command"], action_filter=0.8, filter_previous=previous, last_action=observed
    )
    assert answers(controller, [1, 0, 0])[:, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("observed", "expected"), [("filtered", 0.5), ("raw", 1.0)])
def test_the_network_is_shown_its_own_action_or_the_filtered_one(
    tmp_path: Path, aliengo: SimRobot, observed: str, expected: float
) -> None:
    """The second action is half the command and what is shown of the first."""
    net = shows(0, of=15)
    net.weights[1, 3] = 1.0
    controller = made(
        tmp_path, aliengo, net, ["command", "last_action"], action_filter=0.5, last_action=observed, stiffness=2.0
    )
    assert answers(controller, [1, 0])[1, 1] == pytest.approx(expected)


def test_actions_are_limited_scaled_and_held_joint_by_joint(tmp_path: Path, aliengo: SimRobot) -> None:
    net = Linear(np.zeros((12, 3)), [2.0] * 12)
    scales = {"hip": 0.125, "thigh": 0.25, "knee": -0.5}
    order = [*JOINT_NAMES[3:], *JOINT_NAMES[:3]]
    controller = made(
        tmp_path, aliengo, net, ["command"], joint_order=order, action_clip=[1.0] * 11 + [3.0], action_scale=scales,
        stiffness=list(range(1, 13)), damping=0.5, torque_limit={"hip": 1.0, "thigh": 1.0, "knee": 4.0},
    )  # fmt: skip
    state = level()
    state.joint_velocities[:] = 0.1
    hips, knees = controller.step(state, np.zeros(3)).reshape(4, 3)[:, [0, 2]].T
    # The first leg of the robot is the network's last: stiffness 10, 11, 12, and the clip of its knee is 3.
    assert hips == pytest.approx([1.0, 0.075, 0.45, 0.825])
    assert knees == pytest.approx([-4.0, -1.55, -3.05, -4.0])


def test_a_joint_may_have_a_velocity_as_its_target(tmp_path: Path, aliengo: SimRobot) -> None:
    net = Linear(np.zeros((12, 3)), [2.0] * 12)
    controller = made(
        tmp_path, aliengo, net, ["command"], velocity_targets=["FL_knee"], damping=0.5, stiffness=3.0, home=[0.1] * 12
    )
    state = level()
    state.joint_velocities[:] = 0.4
    torque = controller.step(state, np.zeros(3))
    assert torque[2] == pytest.approx(0.5 * (2.0 - 0.4))
    assert torque[5] == pytest.approx(3.0 * (2.0 + 0.1) - 0.5 * 0.4)


@pytest.mark.parametrize(
    ("changes", "first", "second"),
    [
        ({"advanced": "after"}, [0.0, 0.25], [0.1, 0.35]),
        ({"advanced": "before"}, [0.1, 0.35], [0.2, 0.45]),
    ],
)
def test_phases_go_on_before_or_after_they_are_observed(
    tmp_path: Path, aliengo: SimRobot, changes: dict[str, Any], first: list[float], second: list[float]
) -> None:
    phase = {"start": [0.0, 0.25], "frequency_hz": 5.0, **changes}
    terms = ["gait_phase", "gait_phase_sin", "gait_phase_cos"]
    controller = made(tmp_path, aliengo, shows(*range(6), of=6), terms, phase=phase)
    found = answers(controller, [1, 1])[:, :6]
    for shown, phases in zip(found, (first, second), strict=True):
        angles = 2 * np.pi * np.array(phases)
        assert shown == pytest.approx([*phases, *np.sin(angles), *np.cos(angles)], abs=1e-6)


@pytest.mark.parametrize(("idle", "shown"), [(-1.0, [-1.0, -1.0]), (None, [0.0, 0.1])])
def test_without_a_command_phases_are_idle_or_go_on(
    tmp_path: Path, aliengo: SimRobot, idle: float | None, shown: list[float]
) -> None:
    phase = {"start": [0.0], "frequency_hz": 5.0, "idle": idle}
    controller = made(tmp_path, aliengo, shows(0, of=1), ["gait_phase"], phase=phase)
    assert answers(controller, [0, 0])[:, 0] == pytest.approx(shown)


def test_contacts_and_constants_are_shown_in_the_order_of_the_networks_legs(tmp_path: Path, aliengo: SimRobot) -> None:
    order = [f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "knee")]
    terms = [{"term": "foot_contacts", "offset": -0.5}, {"term": "constant", "values": [0.3, 0.7]}]
    net = shows(*range(6), of=6)
    state = level()
    state.foot_forces[:] = [100.0, 0.0, 20.0, 29.0]
    controller = made(tmp_path, aliengo, net, terms, joint_order=order, contact_force=25.0)
    found = controller.step(state, np.zeros(3))[[3, 4, 5, 0, 1, 2]]
    assert found == pytest.approx([-0.5, 0.5, 0.5, -0.5, 0.3, 0.7])
    controller = made(tmp_path, aliengo, net, terms, contact_force=25.0, leg_order=["RR", "RL", "FR", "FL"])
    assert controller.step(state, np.zeros(3))[:4] == pytest.approx([0.5, -0.5, -0.5, 0.5])


@pytest.mark.parametrize("fastest", ["x", "y"])
def test_heights_are_sampled_about_the_base_and_level_where_nothing_is_known(
    tmp_path: Path, aliengo: SimRobot, fastest: str
) -> None:
    heights = {"x": [0.0, 0.4], "y": [-0.2, 0.2], "fastest": fastest}
    term = {"term": "heights", "offset": -0.4}
    controller = made(tmp_path, aliengo, shows(*range(4), of=4), [term], heights=heights, home=[0.0, 0.9, -1.8] * 4)
    state = level()
    state.orientation[:] = [np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)]  # it looks along y
    state.position_world[:] = [1.0, 2.0, 0.5]
    state.joint_positions[:] = [0.0, 0.9, -1.8]
    feet = aliengo.geometry.feet(state.joint_positions)[:, 2].min() - aliengo.geometry.foot_radius
    assert controller.step(state, np.zeros(3))[:4] == pytest.approx([-feet - 0.4] * 4, rel=1e-4)
    ground = np.zeros((40, 40), np.float32)
    ground[:, 22:] = 0.2  # from y = 2.2 on, 0.2 m ahead of the robot
    ground[:19, :] += 0.1  # up to x = 0.9, to its left
    controller.reset(state)
    controller.see(HeightMap(ground, 0.1, np.array([1.0, 2.0])))
    grid = {"x": [(0, -0.2), (0.4, -0.2), (0, 0.2), (0.4, 0.2)], "y": [(0, -0.2), (0, 0.2), (0.4, -0.2), (0.4, 0.2)]}
    expected = [0.5 - 0.4 - (0.2 if x > 0.2 else 0.0) - (0.1 if y > 0.1 else 0.0) for x, y in grid[fastest]]
    assert controller.step(state, np.zeros(3))[:4] == pytest.approx(expected, abs=1e-6)


def test_what_the_body_feels_is_in_its_frame(tmp_path: Path, aliengo: SimRobot) -> None:
    terms = ["base_linear_velocity", "base_angular_velocity", "gravity"]
    controller = made(tmp_path, aliengo, shows(*range(9), of=9), terms)
    state = level()
    state.orientation[:] = [np.cos(np.pi / 4), 0.0, np.sin(np.pi / 4), 0.0]  # nose down
    rotation = from_angles(0.0, np.pi / 2, 0.0)
    state.velocity_world[:], state.angular_velocity_base[:] = [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]
    expected = [*(rotation.T @ [1, 2, 3]), 4, 5, 6, *(rotation.T @ [0, 0, -1])]
    assert controller.step(state, np.zeros(3))[:9] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("rate_hz", "expected"), [(50, [0, 8, 16, 24, 32]), (60, [0, 7, 14, 20, 27, 34])])
def test_a_rate_that_does_not_divide_that_of_the_control_loop_is_kept_on_average(
    tmp_path: Path, aliengo: SimRobot, rate_hz: int, expected: list[int]
) -> None:
    phase = {"start": [0.0], "frequency_hz": 1.0}
    controller = made(tmp_path, aliengo, shows(0, of=1), ["gait_phase"], phase=phase, rate_hz=rate_hz)
    asked, command = [], np.array([1.0, 0.0, 0.0])
    for tick in range(CONTROL_RATE_HZ):
        if controller.accepts_command():
            asked.append(tick)
        controller.step(level(), command)
    assert asked[: len(expected)] == expected
    assert len(asked) == rate_hz


def test_a_policy_faster_than_the_control_loop_is_refused(tmp_path: Path, aliengo: SimRobot) -> None:
    with pytest.raises(SettingsError, match=r"rate_hz 500: a policy runs at most at the rate of the control loop, 400"):
        made(tmp_path, aliengo, shows(of=3), ["command"], rate_hz=500)


def test_sizes_that_do_not_fit_are_refused_with_the_terms(tmp_path: Path, aliengo: SimRobot) -> None:
    with pytest.raises(SettingsError, match=r"net\.pt: does not take .* 12 numbers \(2 frames of 6: command 3, gravit"):
        made(tmp_path, aliengo, shows(of=11), ["command", "gravity"], history=2)
    (tmp_path / "net.onnx").write_bytes(to_onnx(shows(of=6), {"obs": torch.zeros(1, 6)}, outputs=["actions"]))
    changes = {"torchscript": None, "onnx": "net.onnx", "history_by": "term", "history": 2}
    expected = r"its input has shape \(1, 6\), the description asks for 7 numbers \(command 3 × 2, constant 1 × 1\)"
    terms = ["command", {"term": "constant", "values": [1.0], "history": 1}]
    with pytest.raises(SettingsError, match=expected):
        made(tmp_path, aliengo, "", terms, **changes)
    with pytest.raises(SettingsError, match=r"its output has 11 numbers, expected 12"):
        made(tmp_path, aliengo, Linear(np.zeros((11, 3)), [0.0] * 11), ["command"])


def test_an_output_that_is_not_finite_ends_the_walk_with_one_line(tmp_path: Path, aliengo: SimRobot) -> None:
    class Root(nn.Module):
        def forward(self, obs: Tensor) -> Tensor:
            return torch.sqrt(obs[:, :1]).expand(1, 12)

    controller = made(tmp_path, aliengo, Root(), ["command", "gravity"])
    expected = r"net\.pt: gave NaN or infinity at 0\.020 s, expected finite numbers; all that it was shown was finite"
    with pytest.raises(ControllerError, match=expected):
        answers(controller, [1, -1])
    controller.reset(level())
    broken = level()
    broken.velocity_world[0] = np.nan
    controller = made(tmp_path, aliengo, shows(3, of=6), ["command", "base_linear_velocity"])
    with pytest.raises(ControllerError, match="its term base_linear_velocity was not finite"):
        controller.step(broken, np.zeros(3))


def test_any_other_network_is_sent_to_a_class(tmp_path: Path, aliengo: SimRobot) -> None:
    torch.save(shows(of=3).state_dict(), tmp_path / "weights.pt")
    with pytest.raises(SettingsError, match=r"is a checkpoint of weights, and no TorchScript .*black_box=module:Class"):
        made(tmp_path, aliengo, "weights.pt", ["command"])
    (tmp_path / "net.onnx").write_bytes(b"no network")
    with pytest.raises(SettingsError, match=r"not an ONNX model .*black_box=module:Class"):
        made(tmp_path, aliengo, "", ["command"], torchscript=None, onnx="net.onnx")
    path = tmp_path / "policy.yaml"
    path.write_text("tensorflow: net.pb\nrate_hz: 50\n")
    with pytest.raises(SettingsError, match=r"names a network under onnx or torchscript; .*black_box=module:Class"):
        load_policy_settings(path)


@pytest.mark.parametrize(
    ("observation", "changes", "expected"),
    [
        (["command"], {"onnx": "too.onnx"}, "either onnx or torchscript"),
        (["gait_phase_sin"], {}, "say how it runs under 'phase'"),
        (["heights"], {}, "say where they are under 'heights'"),
        (["estimate"], {}, "describe the network that gives it under 'estimator'"),
        (["constant"], {}, "the term constant, and no other, has values"),
        ([{"term": "gravity", "scale": [1.0, 2.0]}], {}, "scale of gravity has 2 numbers, expected 1 or 3"),
        ([{"term": "gravity", "clip": [1.0, -1.0]}], {}, "expected ± one number, or the lowest"),
        ([{"term": "gravity", "history": 2}], {}, "set history_by to term"),
        (["command"], {"history": 0}, "a history of 1 to 100 ticks"),
        (["command"], {"history": [0, -1]}, "or ages from 0"),
        (["command"], {"action_scale": [1.0, 2.0]}, "expected one number, twelve in the order of joint_order, or"),
        (["command"], {"stiffness": {"hip": 1.0, "thigh": 1.0, "knee": 0.0}}, "stiffness must be above 0"),
        (["command"], {"damping": -1.0}, "damping must be at least 0"),
        (["command"], {"velocity_targets": ["FL_wheel"]}, "velocity_targets names FL_wheel"),
        (["command"], {"leg_order": ["FL", "FL", "RL", "RR"]}, "leg_order must name each of FL, FR, RL, RR once"),
        (["command"], {"output": 1}, "has no output 1; it has 1"),
    ],
)
def test_what_cannot_be_is_refused_by_name(
    tmp_path: Path, aliengo: SimRobot, observation: list[Any], changes: dict[str, Any], expected: str
) -> None:
    with pytest.raises(SettingsError, match=expected) as refused:
        made(tmp_path, aliengo, shows(of=3), observation, **changes)
    assert "\n" not in str(refused.value)
