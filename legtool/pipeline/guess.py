"""Propose a topics YAML for a log: by presets, by message types, by column names, corrected by what the checks say."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from legtool.configs.log import LogSettings
from legtool.configs.robots import PRESETS as ROBOTS
from legtool.configs.robots import load_geometry
from legtool.configs.settings import build
from legtool.configs.topics import PRESETS, SIGNALS, TopicSettings, load_topics
from legtool.datasets.files import replacing
from legtool.datasets.logs.bag import lacking_of
from legtool.datasets.logs.checks.finding import refused, warnings
from legtool.datasets.logs.formats import kind_of
from legtool.datasets.logs.survey import TopicSurvey, survey
from legtool.datasets.logs.tablefiles import find_delimiter, has_header, open_table, tables_in
from legtool.datasets.motion.from_log import cut_filled, cut_log
from legtool.errors import LegtoolError, LogError, OutputError, SettingsError
from legtool.pipeline.columns import guess_columns

_OF_MODELS = {
    "position": "pose.{}.position",
    "orientation": "pose.{}.orientation",
    "velocity": "twist.{}.linear",
    "yaw_rate": "twist.{}.angular.z",
}
#: Whose messages a package holds.
_USED_BY = {"unitree_go": ("go2",), "unitree_legged_msgs": ("a1", "go1"), "anymal_msgs": ("anymal_c",)}
#: So much of a log is read to see whose it is [s].
_FIRST_S = 60.0
#: What begins the line on a log whose signals are not all there.
NOT_COMPARED = "not compared"
#: How often a proposal is corrected by what the checks say of it.
ROUNDS = 8


def guess_topics(paths: Sequence[Path], settings: LogSettings, out: Path) -> Iterator[str]:
    """Write a topics YAML for a log, for the user to look at and edit.

    Args:
        paths: one log, or several bags of one run.
        settings: whose robot the log should be of; where none is named, it is told by messages or legs.
        out: file to write.

    Yields:
        what was found, line by line.

    Raises:
        LogError: nothing that could be a log of a walk was found, the message says what is lacking; or no robot was
            named, and it could be that of several, or of none.
        OutputError: there is such a file already.
    """
    if out.exists():
        raise OutputError(f"{out}: is there already; name another file with --out, or remove it")
    proposed = _propose(paths, settings)
    named = (settings.robot,) if "robot" in settings.model_fields_set else proposed.robots
    if len(named) > 1:
        try_as = {robot: settings.replace(robot=robot) for robot in named}
        tried = {robot: _correct(paths, proposed.topics, each, most_s=_FIRST_S) for robot, each in try_as.items()}
        named = (_whose(paths[0], tried),)
    robot = named[0]
    best = _correct(paths, proposed.topics, settings.replace(robot=robot))
    lines = [f"proposed from {proposed.origin}: {best.figure}", *(f"corrected {line}" for line in best.changes)]
    lines += best.told if best.reason is None else [best.reason]
    if "robot" not in settings.model_fields_set:
        lines.append(f"the robot is {robot}, by {proposed.told_by or 'its legs: no other preset fits'}")
    text = "".join(f"# {line}\n" for line in lines)
    with replacing(out) as temporary:
        temporary.write_text(text + yaml.safe_dump(best.topics, sort_keys=False, default_flow_style=None, width=110))
    yield from (f"  {line}" for line in lines)
    logs = " ".join(map(str, paths))
    run = f"legtool collect log {logs} --robot {robot} --topics {out} --out DATA"
    yield f"wrote {out}; look at it, then run: {run}"


def compared(paths: Sequence[Path], settings: LogSettings) -> list[str]:
    """What ``collect log`` would say of a log, where its topics can be told; a line each.

    Without a robot in ``settings`` the log is compared with the one that its messages belong to, or the first whose
    legs fit.
    """
    try:
        proposed = _propose(paths, settings)
        topics = build(TopicSettings, proposed.topics, source="the proposal")
    except LegtoolError as error:
        return [f"{NOT_COMPARED}: {_without(paths[0], str(error))}"]
    robots = (settings.robot,) if "robot" in settings.model_fields_set else proposed.robots
    robot = robots[0]
    if len(robots) > 1:
        fits = (one for one in robots if _cut(paths, topics, settings.replace(robot=one), _FIRST_S).fits)
        robot = next(fits, robot)
    others = " (others' legs may fit too)" if len(robots) > 1 else ""
    title = f"compared by {proposed.origin}, as a log of {robot}{others}"
    try:
        cut, notes = cut_filled(paths, topics, load_geometry(robot), settings.replace(robot=robot), 0)
    except LegtoolError as error:
        return [title, f"refused: {_without(paths[0], str(error))}"]
    lines = [f"{title}: {cut.counts.get('steps', 0):g} usable steps"]
    if (reason := refused(cut.findings)) is not None:
        lines.append(f"refused: {_without(paths[0], reason)}")
    return lines + [f"warning: {text}" for text in (*notes, *warnings(cut.findings))]


class Proposed(NamedTuple):
    """Topics that a log could have.

    Attributes:
        topics: as in a YAML file.
        origin: what they were told by.
        robots: whose log it could be.
        told_by: what says so; empty where nothing does, and all presets are tried.
    """

    topics: dict[str, Any]
    origin: str
    robots: tuple[str, ...]
    told_by: str = ""


class _Attempt(NamedTuple):
    """What a log is, read by some topics: why it is refused, what is told of it, and how many steps there are."""

    topics: dict[str, Any]
    changes: list[str]
    reason: str | None
    told: list[str]
    figure: str

    @property
    def fits(self) -> bool:
        """Whether nothing says that it is another robot's."""
        return self.reason is None and not any(text.startswith(("feet", "joints")) for text in self.told)


def _correct(
    paths: Sequence[Path], proposal: dict[str, Any], settings: LogSettings, *, most_s: float | None = None
) -> _Attempt:
    """Read a log by a proposal, and correct that by what the checks say, for as long as they know better."""
    proposal, changes = copy.deepcopy(proposal), list[str]()
    for _ in range(ROUNDS):
        found = _cut(paths, build(TopicSettings, proposal, source="the proposal"), settings, most_s)
        if found.reason is None or (change := _correction(found.reason, proposal)) is None:
            break
        changes.append(f"{change}: {found.reason}")
    return found._replace(topics=proposal, changes=changes)


def _cut(paths: Sequence[Path], topics: TopicSettings, settings: LogSettings, most_s: float | None) -> _Attempt:
    try:
        cut = cut_log(paths, topics, load_geometry(settings.robot), settings, 0, most_s=most_s)
    except LogError as error:
        return _Attempt({}, [], str(error), [], "no steps")
    figure = f"{cut.counts.get('steps', 0):g} usable steps"
    return _Attempt({}, [], refused(cut.findings), warnings(cut.findings), figure)


def _whose(path: Path, tried: Mapping[str, _Attempt]) -> str:
    """The one robot whose legs fit a log.

    Raises:
        LogError: none does, or several do; the message names them.
    """
    fitting = [robot for robot, attempt in tried.items() if attempt.fits]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise LogError(f"{path}: could be a log of {', '.join(fitting)}; name the robot with --robot")
    robot, attempt = next(iter(tried.items()))
    reason = attempt.reason or "; ".join(attempt.told)
    raise LogError(
        f"{path}: fits none of {', '.join(tried)} (as {robot}: {_without(path, reason)}); name the robot with --robot"
    )


def _without(path: Path, text: str) -> str:
    return text.removeprefix(f"{path}: ")


def _propose(paths: Sequence[Path], settings: LogSettings) -> Proposed:
    if kind_of(paths[0]) == "csv":
        return Proposed(*_propose_columns(paths[0]), _presets())
    surveyed = survey(*paths, messages=settings.msgs)
    robots, told_by = _told(surveyed)
    there = {topic.name for topic in surveyed}
    found: list[tuple[int, str, TopicSettings]] = []
    for preset in sorted(PRESETS.glob("*.yaml")):
        topics = load_topics(preset.stem)
        if topics.csv is None and not lacking_of(there, topics):
            chosen = topics.choose(there)
            if chosen.depth is not None and chosen.depth.topic not in there:
                chosen = chosen.replace(depth=None)
            held = sum(signal.topics <= there for signal in chosen.signals().values())
            found.append((-held, preset.stem, chosen))
    if not found:
        return Proposed(_by_types(surveyed, paths[0]), "the types of messages", robots, told_by)
    _, name, chosen = min(found, key=lambda entry: (entry[0], entry[1] != "ros2_standard"))
    return Proposed(_plain(chosen, paths[0]), f"the preset {name}", robots, told_by)


def _presets() -> tuple[str, ...]:
    return tuple(sorted(preset.stem for preset in ROBOTS.glob("*.yaml")))


def _told(surveyed: Sequence[TopicSurvey]) -> tuple[tuple[str, ...], str]:
    """The robots that use messages or names of joints like these, and what says so; all presets where nothing does."""
    for topic in surveyed:
        package = topic.msgtype.partition("/")[0]
        if package in _USED_BY:
            return _USED_BY[package], f"messages of {package}"
        if any(re.match(r"(front|rear)_(left|right)_hip_x$|[fh][lr]\.hx$", name) for name in topic.elements):
            return ("spot",), f"the names of joints on {topic.name}"
    return _presets(), ""


def _by_types(topics: list[TopicSurvey], path: Path) -> dict[str, Any]:
    """A topic for each signal: odometry first, then whatever could serve, the fastest of them."""
    proposal: dict[str, Any] = {"name": _name(path)}
    fast = sorted(topics, key=lambda topic: ("Odometry" not in topic.msgtype, -topic.rate_hz))
    types = {topic.name: topic.msgtype for topic in topics}
    for signal in SIGNALS:
        serving = [topic.name for topic in fast if signal in topic.serves]
        if signal == "contact" and len(serving) >= 4:
            legs = [next((name for name in serving if leg in name.upper()), None) for leg in ("FL", "FR", "RL", "RR")]
            if None not in legs:
                proposal[signal] = {"topic": legs}
                continue
        if not serving and signal in _OF_MODELS and (model := _model(topics)) is not None:
            proposal[signal] = {"topic": model[0], "field": _OF_MODELS[signal].format(model[1])}
            if signal == "velocity":
                proposal[signal]["frame"] = "world"
        if serving and (signal != "feet" or "joints" not in proposal):
            proposal[signal] = {"topic": serving[0]}
            if signal in ("joints", "contact") and types[serving[0]].startswith("unitree_go/"):
                proposal[signal]["legs"] = ["FR", "FL", "RR", "RL"]
    needed = [name for name in ("position", "orientation", "command") if name not in proposal]
    if not {"feet", "joints"} & proposal.keys():
        needed.append("feet or joints")
    if needed:
        listed = ", ".join(f"{topic.name} ({topic.msgtype})" for topic in topics)
        raise LogError(f"{path}: no topic is known to hold {', '.join(needed)}; topics there: {listed}")
    return proposal


def _model(topics: list[TopicSurvey]) -> tuple[str, str] | None:
    """Topic and name of the model of a simulator that is most likely the robot."""
    for topic in topics:
        if topic.msgtype == "gazebo_msgs/msg/ModelStates" and (names := _robots(topic.elements)):
            return topic.name, names[0]
    return None


def _robots(names: Sequence[str]) -> list[str]:
    """The names of models that are no part of the world."""
    return [name for name in names if not re.search("ground|plane|world|box|wall|floor|crate", name)]


def _propose_columns(path: Path) -> tuple[dict[str, Any], str]:
    file = path if path.is_file() else tables_in(path)[0]
    if path.is_dir() and len(tables_in(path)) > 1:
        raise LogError(f"{path}: holds several tables; write a column map for them (see docs/logs.md)")
    shape = {"files": {"*": None}, "header": has_header(file), "delimiter": find_delimiter(file)}
    names = open_table(file, build(TopicSettings, {**_ANY, "csv": shape}).csv or _none(file)).names
    if not names:
        raise LogError(f"{file}: its columns have no names, so that nothing can be guessed; write a column map")
    signals, stamp = guess_columns(names)
    needed = [name for name in ("position", "orientation", "command") if name not in signals]
    needed += [] if {"feet", "joints"} & signals.keys() else ["feet or joints"]
    if needed or stamp is None:
        missing = ", ".join([*needed, *([] if stamp else ["time"])])
        raise LogError(f"{file}: no columns are known to hold {missing}; columns there: {', '.join(names)}")
    return {"name": _name(path), "csv": {**shape, "stamp": stamp}, **signals}, "the names of columns"


_ANY: dict[str, Any] = {
    "name": "any",
    **{name: {"columns": [0]} for name in ("position", "orientation", "command", "feet")},
}


def _none(file: Path) -> Any:
    raise LogError(f"{file}: is no table")


def _correction(reason: str, proposal: dict[str, Any]) -> str | None:
    """Make the change that a check advises; what was changed, or None if it advises none."""
    if found := re.search(r"set (\w+): \{(\w+): ([\w/]+)\}", reason):
        signal, key, value = found.groups()
        if signal in proposal and proposal[signal].get(key) != value:
            proposal[signal] = {**proposal[signal], key: value}
            return f"{signal}: {{{key}: {value}}}"
    if found := re.search(r"set (feet|joints): \{legs: \[([A-Z, ]+)\]\}", reason):
        proposal[found[1]] = {**proposal[found[1]], "legs": found[2].split(", ")}
        return f"{found[1]}: {{legs: [{found[2]}]}}"
    if found := re.search(r"has no field \w+\.(\w+)\.\w+.*elements there: (.+)", reason):
        return _rename_model(proposal, found[1], _robots(found[2].split(", ")))
    if found := re.search(r"legs: \[([A-Z, ]+)\]", reason):
        legs = found[1].split(", ")
        for signal in ("feet", "joints", "contact"):
            if signal in proposal and proposal[signal].get("legs") != legs:
                proposal[signal] = {**proposal[signal], "legs": legs}
        return f"legs: [{found[1]}]"
    if found := re.search(r"set stamps: log", reason):
        if proposal.get("stamps") == "log":
            return None
        proposal["stamps"] = "log"
        return "stamps: log"
    if "unit: mm" in reason and (found := re.search(r"(position|feet|velocity) \(", reason)):
        unit = "mm/s" if found[1] == "velocity" else "mm"
        if proposal[found[1]].get("unit") == unit:
            return None
        proposal[found[1]] = {**proposal[found[1]], "unit": unit}
        return f"{found[1]}: {{unit: {unit}}}"
    if (found := re.search(r"(velocity|yaw_rate) \(", reason)) and found[1] in proposal:
        del proposal[found[1]]
        return f"{found[1]}: left out"
    return None


def _rename_model(proposal: dict[str, Any], model: str, names: list[str]) -> str | None:
    if not names or names[0] == model:
        return None
    for signal in _OF_MODELS.keys() & proposal.keys():
        field = proposal[signal].get("field")
        if isinstance(field, str):
            proposal[signal] = {**proposal[signal], "field": field.replace(f".{model}.", f".{names[0]}.")}
    return f"model: {names[0]}"


def _plain(topics: TopicSettings, path: Path) -> dict[str, Any]:
    """What differs from the defaults, as plain YAML."""
    held: Mapping[str, Any] = topics.model_dump(mode="json", exclude_defaults=True)
    return {**held, "name": _name(path), "source": ""}


def _name(path: Path) -> str:
    name = re.sub(r"[^a-z0-9]+", "_", path.resolve().stem.lower()).strip("_")
    if not name:
        raise SettingsError(f"{path}: gives no name for topics; rename it")
    return name
