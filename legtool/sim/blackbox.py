"""Controllers by name: the built-in trot, a learned policy, or a Python class of the user's."""

from __future__ import annotations

import importlib
from pathlib import Path

from legtool.configs.controller import TrotSettings
from legtool.configs.policies import load_policy_settings
from legtool.errors import SettingsError
from legtool.sim.controller import Controller
from legtool.sim.policy import PolicyController
from legtool.sim.robot import SimRobot
from legtool.sim.trot import TrotController


def make_controller(name: str, robot: SimRobot, trot: TrotSettings | None = None) -> Controller:
    """The controller that ``name`` means.

    Args:
        name: ``trot``; the YAML file that describes a policy; or ``module:Class``, called with the robot.
        robot: what it controls.
        trot: settings of the built-in one.

    Raises:
        SettingsError: nothing of that name, or something that is no controller.
    """
    if name == "trot":
        return TrotController(robot, trot)
    if name.endswith((".yaml", ".yml")):
        return PolicyController(load_policy_settings(Path(name)))
    module, separator, attribute = name.partition(":")
    if not separator:
        raise SettingsError(f"controller {name!r}: expected trot, a policy's YAML file, or module:Class")
    try:
        controller = getattr(importlib.import_module(module), attribute)(robot)
    except (ImportError, AttributeError) as error:
        raise SettingsError(f"controller {name!r}: cannot be imported ({error})") from error
    missing = [
        method for method in ("reset", "step", "accepts_command") if not callable(getattr(controller, method, None))
    ]
    if missing:
        raise SettingsError(f"controller {name!r}: has no {', '.join(missing)}; see legtool.sim.controller.Controller")
    made: Controller = controller
    return made
