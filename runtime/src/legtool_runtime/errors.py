"""Errors that a user can act on: each message says what was given, what was expected and what to do."""


class LegtoolError(Exception):
    """Base of every error that is the user's to mend. The command line prints it in one line and exits with 2."""


class RobotError(LegtoolError):
    """A robot description that is incomplete, contradictory, or not the one a bundle or log was made for."""


class BundleError(LegtoolError):
    """A bundle that is missing, damaged, altered, of another kind, or newer than this runtime."""


class StateError(LegtoolError):
    """A robot state that cannot be planned from: wrong shape, NaN, or taken at another instant than the model's."""


class PerceptionError(LegtoolError):
    """A depth image, camera, pose or label image that cannot be used, or a segmenter of another kind."""


class MapError(LegtoolError):
    """A depth image, camera pose or map that cannot be used: wrong shape, not finite, or without the robot in it."""


class PlannerError(LegtoolError):
    """Planner settings, a command set or a goal that cannot be planned with."""


class TrackingError(LegtoolError):
    """A contact plan, body reference, gait or setting that a robot's feet cannot be tracked with."""


def shown(value: object) -> str:
    """A value, or what an error says, in a message: one line, and not more than 80 characters of it."""
    return one_line(str(value) if isinstance(value, Exception) else repr(value))


def one_line(text: str, most: int = 80) -> str:
    """A text in a message: on one line, and not more than so many characters of it."""
    line = " ".join(text.split())
    return line if len(line) <= most else line[: most - 3] + "..."
