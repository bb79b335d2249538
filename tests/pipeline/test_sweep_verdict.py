"""The verdict on a sweep: what it is by, the causes it names, and what follows from it on the command line."""

import json
import re
from pathlib import Path

import mujoco
import pytest

from legtool.cli import COMMANDS, GROUPS
from legtool.command import call
from legtool.datasets.store import load_manifest
from legtool.info import describe
from legtool.pipeline.reshape import split
from legtool.pipeline.sweep_verdict import judge_sweep

WALKS = {"velocity_error": 0.04, "yaw_rate_error": 0.02, "sliding": 0.001, "flight": 0.0, "load.trunk": 0.0}


def manifest(counts: dict | None = None, measured: dict | None = None, **settings: object) -> dict:
    return {
        "counts": {"episodes": 40, "falls": 0, **(counts or {})},
        "measured": {**WALKS, **(measured or {})},
        "settings": {"mjcf": "dog.xml", "black_box": None, **settings},
    }


def test_a_robot_that_walks_as_it_is_told_is_green() -> None:
    assert judge_sweep(manifest()).lines() == ["verdict: green, use it (3 criteria)"]


@pytest.mark.parametrize(
    ("counts", "measured", "level", "said"),
    [
        ({"falls": 2}, {}, "amber", "fell in 2 of 40 episodes.*no limit was met: the trot's settings"),
        ({"falls": 3}, {}, "red", "fell in 3 of 40 episodes"),
        ({}, {"velocity_error": 0.061}, "amber", r"0\.061 m/s off the command, expected at most 0\.06"),
        ({}, {"velocity_error": 0.2}, "red", "0.200 m/s off the command"),
        ({}, {"yaw_rate_error": 0.4}, "red", "yaw rate is 0.400 rad/s off"),
        ({"falls": 9}, {"at_torque_limit.knee": 0.3}, "red", "because the knees' torque is at its limit for 30 %"),
        ({"falls": 9}, {"at_joint_limit.hip": 0.1}, "red", "the hips are at the end of their range for 10 %"),
        ({"falls": 9}, {"straight": 0.4}, "red", "a leg is straight for 40 % of the time: stand lower"),
        ({"falls": 9}, {"sliding": 0.3}, "red", "feet slide under 30 % of the load: the ground's friction"),
        ({"falls": 9}, {"flight": 0.2}, "red", "no foot is on the ground for 20 %.*duty"),
        ({"falls": 9, "mujoco_badqacc": 9}, {}, "red", "the physics diverged"),
        ({"mujoco_inertia": 3}, {}, "amber", "MuJoCo warned: inertia 3, expected no warning; see the log"),
        (
            {"falls": 9}, {"load.shank FL_calf (mesh leg)": 0.3, "touching.shank FL_calf (mesh leg)": 0.5}, "red",
            r"FL_calf \(mesh leg\) \(30 % of the load, 50 % of the time\).*--set mjcf_names.no_contact=\[FL_calf\]",
        ),
        ({}, {"load.trunk": 0.02}, "amber", "trunk .*raise the trunk"),
    ],
)  # fmt: skip
def test_falls_and_errors_are_told_with_their_likely_cause(counts, measured, level: str, said: str) -> None:
    verdict = judge_sweep(manifest(counts, measured))
    assert verdict.level == level
    assert any(re.search(said, line) for line in verdict.lines()), verdict.lines()


def test_masses_that_cannot_be_are_a_cause_and_so_is_the_users_controller() -> None:
    light = judge_sweep(manifest({"falls": 40}), ["the thigh of FL weighs 0.1 g"]).lines()[1]
    assert "missing or wrong (the thigh of FL weighs 0.1 g" in light
    own = judge_sweep(manifest({"falls": 40}, black_box="policy.yaml")).lines()[1]
    assert "check the controller's gains, scales, order of joints" in own


def test_commands_that_are_never_held_leave_the_velocity_open() -> None:
    short = manifest()
    del short["measured"]["velocity_error"]
    assert judge_sweep(short).level == "amber"


def test_a_robot_that_falls_is_told_so_and_is_not_to_be_trained_on(
    written, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def weak(spec: mujoco.MjSpec) -> None:
        for leg in ("FL", "FR", "RL", "RR"):
            joint = spec.joint(f"{leg}_knee_joint")
            joint.actfrclimited, joint.actfrcrange = mujoco.mjtLimited.mjLIMITED_TRUE, [-6, 6]

    out = tmp_path / "data"
    words = ["collect", "sweep", "--mjcf", str(written(weak)), "--set", "episodes=2", "--set", "episode_s=5"]
    assert call(COMMANDS, GROUPS, [*words, "--out", str(out), "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "verdict: red" in said and "knees' torque is at its limit" in said
    assert "train" not in said and "next: mend what the verdict names" in said
    verdict = json.loads((out / "manifest.json").read_text())["verdict"]
    assert (
        verdict["level"] == "red"
        and verdict["findings"][0]["text"] == "the robot fell in 2 of 2 episodes, expected none"
    )
    assert any("verdict: red" in line for line in describe(out))
    with pytest.raises(SystemExit, match="1"):
        call(COMMANDS, GROUPS, [*words, "--out", str(out), "--workers", "1", "--check"])


def test_a_robot_that_walks_is_to_be_trained_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["collect", "sweep", "--set", "episodes=2", "--set", "episode_s=8", "--check", "--workers", "1"]
    assert call(COMMANDS, GROUPS, [*words, "--out", str(tmp_path / "data")]) == 0
    assert "next: legtool train motion" in capsys.readouterr().out
    made = load_manifest(tmp_path / "data")
    assert made["measured"]["velocity_error"] < 0.06 and made["verdict"]["level"] == "green"
    parts = split(tmp_path / "data", [0.5, 0.5], tmp_path / "parts")
    assert all(part["verdict"] == made["verdict"] and "measured" not in part for part in parts)
