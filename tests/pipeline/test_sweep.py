from __future__ import annotations

import hashlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from multiprocessing import get_context

import numpy as np
import pytest
import torch

from legtool.configs.policies import JOINT_NAMES
from legtool.configs.robots import PRESETS
from legtool.configs.sweep import SweepSettings
from legtool.errors import ControllerError, OutputError, RobotError, SettingsError
from legtool.pipeline.sweep import collect_sweep, simulate_episode

SETTINGS = SweepSettings(episodes=4, episode_s=8.0, push_rate_hz=0.5)


def fingerprint(settings: SweepSettings, index: int) -> str:
    episode = simulate_episode(settings, index)
    digest = hashlib.sha256()
    arrays = [getattr(episode.recording, field.name) for field in fields(episode.recording)]
    for value in (*arrays, episode.joint_positions, episode.joint_velocities, episode.joint_torques):
        if isinstance(value, np.ndarray):
            digest.update(value.tobytes())
    return digest.hexdigest()


def test_an_episode_is_the_same_bits_in_any_process_and_order() -> None:
    here = [fingerprint(SETTINGS, index) for index in (2, 0)]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        there = [pool.submit(fingerprint, SETTINGS, index).result() for index in (0, 2)]
    assert here == there[::-1]
    assert here[0] != here[1]
    assert fingerprint(SETTINGS.replace(seed=1), 0) != here[1]


def test_every_robot_gets_through_its_sweep() -> None:
    for robot in ("aliengo", "go2", "hyq"):
        for index in range(3):
            episode = simulate_episode(SETTINGS.replace(robot=robot), index)
            assert not episode.fell
            assert episode.recording.command.any()


def test_settings_that_cannot_be_swept_are_refused_by_name() -> None:
    for key, value in (("record_rate_hz", 150), ("hold_s", [2.0, 1.0]), ("vx", [0.5, 9.0]), ("vy", [0.1, 0.1])):
        with pytest.raises(SettingsError, match=key):
            SETTINGS.replace(**{key: value})
    with pytest.raises(RobotError, match="spider"):
        simulate_episode(SETTINGS.replace(robot="spider"), 0)
    with pytest.raises(RobotError, match=r"absent\.xml"):
        simulate_episode(SETTINGS.replace(mjcf="absent.xml"), 0)


def test_a_sweep_is_not_carried_on_with_a_robot_or_controller_that_changed(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot, text = tmp_path / "dog.yaml", (PRESETS / "aliengo.yaml").read_text()
    robot.write_text(text)
    (tmp_path / "mine.py").write_text(
        "from legtool.sim.controllers.trot.trot import TrotController\nclass Mine(TrotController):\n    speed = 1\n"
    )
    settings = SETTINGS.replace(robot=str(robot), black_box="mine:Mine", episodes=1)
    manifest = collect_sweep(settings, tmp_path / "data")
    assert collect_sweep(settings, tmp_path / "data") == manifest
    # Its geometry stays as it was, and so does the name of the file.
    robot.write_text(text.replace("trunk: {mass: 11.041", "trunk: {mass: 12.041"))
    with pytest.raises(OutputError, match=r"holds a dataset .*inputs\.0\.sha256"):
        collect_sweep(settings, tmp_path / "data")
    robot.write_text(text)
    mine = tmp_path / "mine.py"
    mine.write_text(mine.read_text().replace("speed = 1", "speed = 2"))
    with pytest.raises(OutputError, match=r"inputs\.1\.sha256"):
        collect_sweep(settings, tmp_path / "data")


def test_a_policy_that_gives_nan_ends_the_sweep_with_one_line(tmp_path) -> None:
    class Nan(torch.nn.Module):
        def forward(self, obs: torch.Tensor) -> torch.Tensor:
            return torch.log(obs[:, :1] - 10.0).expand(1, 12)

    torch.jit.script(Nan()).save(str(tmp_path / "net.pt"))
    (tmp_path / "policy.yaml").write_text(
        "torchscript: net.pt\nrate_hz: 50\nobservation: [command]\n"
        f"home: {[0, 0.9, -1.8] * 4}\njoint_order: [{', '.join(JOINT_NAMES)}]\n"
        "action_scale: 0.5\nstiffness: 25\ndamping: 2\n"
    )
    with pytest.raises(ControllerError, match=r"net\.pt: gave NaN or infinity at 0\.000 s") as ended:
        collect_sweep(SETTINGS.replace(black_box=str(tmp_path / "policy.yaml")), tmp_path / "data")
    assert "\n" not in str(ended.value)
