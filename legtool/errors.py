"""The errors of the offline toolkit. Each message is one line: what was given, what was expected, what to do."""

from legtool_runtime.errors import BundleError, LegtoolError, RobotError, StateError

__all__ = [
    "BundleError",
    "ControllerError",
    "DatasetError",
    "LegtoolError",
    "LogError",
    "OutputError",
    "PartsFailed",
    "RobotError",
    "SettingsError",
    "StateError",
]


class SettingsError(LegtoolError):
    """A setting that is unknown, of the wrong type or out of range."""


class LogError(LegtoolError):
    """A robot log that is damaged, empty, implausible, or lacks what is needed."""


class DatasetError(LegtoolError):
    """A dataset or run that is damaged, of another kind, or too small."""


class OutputError(LegtoolError):
    """An output path that holds something else, or cannot be written."""


class PartsFailed(LegtoolError):
    """Some parts of a piece of work failed again and again; all others are done, and kept."""

    exit_code = 3


class ControllerError(LegtoolError):
    """A black-box controller that returned something else than twelve finite torques, or nothing for too long."""
