"""Controllers by name: the built-in trot, a learned policy, or a Python class of the user's."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from legtool.configs.controller import TrotSettings
from legtool.configs.policies import load_policy_settings
from legtool.errors import SettingsError
from legtool.sim.controllers.controller import Controller
from legtool.sim.controllers.policy import PolicyController
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import SimRobot


def make_controller(robot: SimRobot, black_box: str | None = None, trot: TrotSettings | None = None) -> Controller:
    """The built-in trotting controller, or the user's own.

    Args:
        robot: what it controls.
        black_box: the YAML file that describes a policy; or ``module:Class``, found from the working directory too and
            called with the robot; None for the built-in one.
        trot: settings of the built-in one.

    Raises:
        SettingsError: nothing of that name, or something that is no controller.
    """
    if black_box is None:
        return TrotController(robot, trot)
    if black_box.endswith((".yaml", ".yml")):
        return PolicyController(load_policy_settings(Path(black_box)), robot.geometry)
    if ":" not in black_box:
        raise SettingsError(f"black box {black_box!r}: expected a policy's YAML file, or module:Class")
    made: Controller = make_named(
        "black box", black_box, robot, needs=("reset", "step", "accepts_command"), made_from="a robot",
        protocol="legtool.sim.controllers.controller.Controller",
    )  # fmt: skip
    return made


def make_named(what: str, where: str, given: object, *, needs: Sequence[str], made_from: str, protocol: str) -> Any:
    """An object of a class of the user's.

    Args:
        what: it is to be, in words.
        where: ``module:Class``, found from the working directory too.
        given: what the class is called with.
        needs: methods that it has to have.
        made_from: what ``given`` is, in words.
        protocol: where the methods are described.

    Raises:
        SettingsError: nothing of that name, or something that lacks a method; or whatever the class raises.
    """
    module, _, attribute = where.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        cls = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, SyntaxError, ValueError) as error:
        raise SettingsError(f"{what} {where!r}: cannot be imported ({error})") from error
    try:
        made = cls(given)
    except Exception as error:  # the user's own code may throw anything
        raise SettingsError(
            f"{what} {where!r}: cannot be made from {made_from} ({type(error).__name__}: {error})"
        ) from error
    missing = [method for method in needs if not callable(getattr(made, method, None))]
    if missing:
        raise SettingsError(f"{what} {where!r}: has no {', '.join(missing)}; see {protocol}")
    return made
