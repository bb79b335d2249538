"""Controllers by name: the built-in trot, a learned policy, or a Python class of the user's."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

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
        return PolicyController(load_policy_settings(Path(black_box)))
    module, separator, attribute = black_box.partition(":")
    if not separator:
        raise SettingsError(f"black box {black_box!r}: expected a policy's YAML file, or module:Class")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        cls = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, SyntaxError) as error:
        raise SettingsError(f"black box {black_box!r}: cannot be imported ({error})") from error
    try:
        controller = cls(robot)
    except Exception as error:  # the user's own code may throw anything
        kind = type(error).__name__
        raise SettingsError(f"black box {black_box!r}: cannot be made from a robot ({kind}: {error})") from error
    missing = [
        method for method in ("reset", "step", "accepts_command") if not callable(getattr(controller, method, None))
    ]
    if missing:
        raise SettingsError(
            f"black box {black_box!r}: has no {', '.join(missing)}; see legtool.sim.controllers.controller.Controller"
        )
    made: Controller = controller
    return made
