"""Propose a topics YAML for a log: by presets, by message types, by column names, corrected by what the checks say."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from legtool.configs.log import LogSettings
from legtool.configs.robots import load_geometry
from legtool.configs.settings import build
from legtool.configs.topics import PRESETS, SIGNALS, TopicSettings, load_topics
from legtool.datasets.files import replacing
from legtool.datasets.logs.bag import lacking
from legtool.datasets.logs.checks.finding import refused, warnings
from legtool.datasets.logs.formats import kind_of
from legtool.datasets.logs.survey import TopicSurvey, survey
from legtool.datasets.logs.tablefiles import find_delimiter, has_header, open_table, tables_in
from legtool.errors import LogError, OutputError, SettingsError
from legtool.pipeline.columns import guess_columns
from legtool.pipeline.log import cut_log

_OF_MODELS = {
    "position": "pose.{}.position",
    "orientation": "pose.{}.orientation",
    "velocity": "twist.{}.linear",
    "yaw_rate": "twist.{}.angular.z",
}
#: How often a proposal is corrected by what the checks say of it.
ROUNDS = 8


def guess_topics(paths: Sequence[Path], settings: LogSettings, out: Path) -> Iterator[str]:
    """Write a topics YAML for a log, for the user to look at and edit.

    Args:
        paths: one log, or several bags of one run.
        settings: whose robot the log should be of.
        out: file to write.

    Yields:
        what was found, line by line.

    Raises:
        LogError: nothing that could be a log of a walk was found; the message says what is lacking.
        OutputError: there is such a file already.
    """
    if out.exists():
        raise OutputError(f"{out}: is there already; name another file with --out, or remove it")
    proposal, origin = _propose(paths, settings)
    changes: list[str] = []
    told: list[str] = []
    for _ in range(ROUNDS):
        topics = build(TopicSettings, proposal, source="the proposal")
        try:
            cut = cut_log(paths, topics, load_geometry(settings.robot), settings, 0)
            reason, told = refused(cut.findings), warnings(cut.findings)
            figure = f"{cut.counts.get('steps', 0):g} usable steps"
        except LogError as error:
            reason, figure = str(error), "no steps"
        if reason is None:
            break
        change = _correction(reason, proposal)
        if change is None:
            told = [reason]
            break
        changes.append(f"{change}: {reason}")
    lines = [f"proposed from {origin}: {figure}", *(f"corrected {line}" for line in changes), *told]
    text = "".join(f"# {line}\n" for line in lines)
    with replacing(out) as temporary:
        temporary.write_text(text + yaml.safe_dump(proposal, sort_keys=False, default_flow_style=None, width=110))
    yield from (f"  {line}" for line in lines)
    run = f"legtool collect log {paths[0]} --robot {settings.robot} --topics {out} --out DATA"
    yield f"wrote {out}; look at it, then run: {run}"


def _propose(paths: Sequence[Path], settings: LogSettings) -> tuple[dict[str, Any], str]:
    if kind_of(paths[0]) == "csv":
        return _propose_columns(paths[0])
    surveyed = survey(*paths, messages=settings.msgs)
    there = {topic.name for topic in surveyed}
    found: list[tuple[int, str, TopicSettings]] = []
    for preset in sorted(PRESETS.glob("*.yaml")):
        topics = load_topics(preset.stem)
        if topics.csv is None and not lacking(paths, topics):
            chosen = topics.choose(there)
            held = sum(signal.topics <= there for signal in chosen.signals().values())
            found.append((-held, preset.stem, chosen))
    if not found:
        return _by_types(surveyed, paths[0]), "the types of messages"
    _, name, chosen = min(found, key=lambda entry: (entry[0], entry[1] != "ros2_standard"))
    return _plain(chosen, paths[0]), f"the preset {name}"


def _by_types(topics: list[TopicSurvey], path: Path) -> dict[str, Any]:
    """A topic for each signal: odometry first, then whatever could serve, the fastest of them."""
    proposal: dict[str, Any] = {"name": _name(path)}
    fast = sorted(topics, key=lambda topic: ("Odometry" not in topic.msgtype, -topic.rate_hz))
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
