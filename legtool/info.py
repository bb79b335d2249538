"""What a path holds: a recording, dataset, run, bundle, results or world, with counts, its hashes verified."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from legtool.errors import DatasetError, LegtoolError
from legtool.pipeline.guess import NOT_COMPARED
from legtool.verdict import Verdict


def describe(*paths: Path, every: bool = False) -> list[str]:
    """Describe anything that legtool reads or writes.

    Args:
        paths: files or directories; recordings of which one lacks signals are compared as bags of one run.
        every: whether all metrics of results and bundles are shown, and not those of the exported models alone.

    Returns:
        lines for a terminal.

    Raises:
        LegtoolError: nothing there, or not something legtool knows, or its hashes do not match.
    """
    if len(paths) > 1 and all(map(_is_recording, paths)):
        alone = [_compared([path]) for path in paths]
        if any(lines[0].startswith(f"  {NOT_COMPARED}") for lines in alone):  # one lacks what another may hold
            return [line for path in paths for line in _recording(path)] + _compared(paths)
        return [line for path, lines in zip(paths, alone, strict=True) for line in (*_recording(path), *lines)]
    return [line for path in paths for line in _describe(path, every)]


def describe_json(*paths: Path) -> str:
    """The same as JSON: what a dataset, run, bundle or results say of themselves, and the lines of :func:`describe`.

    Args:
        paths: files or directories; one gives an object, several give a list of them.

    Raises:
        LegtoolError: as :func:`describe`.
    """
    from legtool.datasets.files import read_json

    said = []
    for path in paths:
        lines = _describe(path, every=True)  # which verifies hashes
        home = path.parent if path.name == "results.json" else path
        marker = next((home / name for name in _MARKERS if (home / name).is_file()), None)
        held = None if marker is None else read_json(marker)
        kind = None if marker is None else marker.stem
        said.append({"path": str(path), "kind": kind, "content": held, "text": lines})
    return json.dumps(said if len(said) > 1 else said[0], indent=2, ensure_ascii=False)


def _is_recording(path: Path) -> bool:
    from legtool.datasets.logs.formats import is_log

    return is_log(path) and not any((path / marker).is_file() for marker in _MARKERS) and not _inner(path)


def _describe(path: Path, every: bool) -> list[str]:
    from legtool.pipeline.folders import inner_logs

    if not path.exists() or path.suffix in (".yaml", ".yml") or _is_world_json(path):
        return _world(path)
    for marker, describer in _MARKERS.items():
        if (path / marker).is_file():
            return describer(path, every)
    if path.name == "results.json":
        return _results(path.parent, every)
    if inner := _inner(path):
        return [line for found in inner for line in _describe(found, every)]
    return [line for log in inner_logs(path) or [path] for line in (*_recording(log), *_compared([log]))]


def format_counts(counts: Mapping[str, Any]) -> str:
    """Counts on one line, in the order in which they came; zeros are left out."""
    parts = [f"{name.replace('_', ' ')} {value:g}" for name, value in counts.items() if value]
    return "  " + ", ".join(parts) if parts else "  all counts are 0"


def format_held(manifest: Mapping[str, Any]) -> list[str]:
    """The joints of a simulated robot that are no leg's, on a line."""
    given = manifest.get("held_joints")
    held = [str(name) for name in given] if isinstance(given, list) else []
    return [f"  joints that are no leg's are held at their pose: {', '.join(held)}"] if held else []


def format_verdict(manifest: Mapping[str, Any]) -> list[str]:
    """What the verdict on a dataset is, and what it is by, where there is one."""
    if "verdict" not in manifest:
        return []
    try:
        return [f"  {line}" for line in Verdict.from_dict(manifest["verdict"]).lines()]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError("the verdict on the dataset is damaged; collect it again") from error


def format_notes(manifest: Mapping[str, Any]) -> list[str]:
    """What is doubtful about a dataset, a line each."""
    return [f"  warning: {note}" for note in manifest.get("notes", ())]


def _dataset(path: Path, _: bool) -> list[str]:
    from legtool.datasets.motion.lost_steps import lost_steps
    from legtool.datasets.store import data_hash, load_manifest, verify

    manifest = load_manifest(path)
    title = f"{path}: {manifest['kind']} dataset of {manifest['robot']['name']}"
    if not manifest.get("complete"):
        return [f"{title}, not finished; run its collect command again to continue"]
    verify(path, [*manifest["parts"], *manifest["files"]])
    if manifest["kind"] == "scenes":
        from legtool.datasets.steppability.contact_sheet import describe_scenes

        return describe_scenes(path)
    instant = f", states at {manifest['instant']}" if "instant" in manifest else ""
    seed = f"seed {manifest['seed']}, " if "seed" in manifest else ""  # nothing is drawn where logs are cut
    return [
        f"{title}{instant}",
        f"  {manifest['rows']} rows in {len(manifest['parts'])} parts, {len(manifest['files'])} recordings, "
        f"{seed}commit {manifest['commit']}",
        *_parents(manifest),
        format_counts(manifest["counts"]),
        *format_held(manifest),
        *lost_steps(manifest["counts"]),
        *format_notes(manifest),
        *format_verdict(manifest),
        f"  data hash {data_hash(manifest)}, every file's SHA-256 verified",
    ]


def _parents(manifest: Mapping[str, Any]) -> list[str]:
    """Which datasets a derived one was made of."""
    made = manifest["settings"].get("derived")
    if made is None:
        return []
    named = ", ".join(f"{entry['name']} ({entry['sha256'][:12]})" for entry in manifest["inputs"])
    return [f"  made by {made} of {len(manifest['inputs'])} datasets: {named}"]


def _run(path: Path, _: bool) -> list[str]:
    from legtool.datasets.files import read_json
    from legtool.datasets.motion.run import load_run

    description = read_json(path / "run.json")
    if description.get("kind") != "motion":
        robot = description.get("robot", {}).get("name", "an unknown robot")
        lines = [f"{path}: {description.get('kind')} run of {robot}", f"  data hash {description.get('data_hash')}"]
        if best := description.get("best"):
            done = "" if description.get("complete") else ", not finished; run its train command again to continue"
            held = {name: value for name, value in best.items() if isinstance(value, float) and name != "seconds"}
            found = ", ".join(f"{name.replace('_', ' ')} {value:.4f}" for name, value in held.items())
            lines.append(f"  best epoch {best['epoch']} of {len(description['history'])}: {found}{done}")
        return lines
    run = load_run(path)
    return [
        f"{path}: {run.kind} run of {run.robot.name}, states at {run.instant}",
        f"  fitted to {run.data['steps']} steps of {', '.join(run.data['paths'])}",
        f"  chosen for export: {run.formulation}, {run.estimator}",
        f"  data hash {run.data['hash']}, every file's SHA-256 verified",
    ]


def _bundle(path: Path, every: bool) -> list[str]:
    from legtool_runtime import load_bundle

    bundle = load_bundle(path)
    lines = [str(line) for name in bundle.lines for line in _metrics(bundle.metrics(name), every)]
    return [f"{path}: {bundle}", *lines, "  every file's SHA-256 verified"]


def _results(path: Path, every: bool) -> list[str]:
    from legtool.datasets.files import read_json

    results = read_json(path / "results.json")
    if not isinstance(results.get("metrics"), dict):
        raise LegtoolError(f"{path / 'results.json'}: holds no metrics; expected a file written by legtool eval")
    level = results.get("verdict", {}).get("level")
    judged = "" if level is None else f", verdict {level}"
    return [f"{path}: results, {len(results['metrics'])} metrics{judged}", *_metrics(results["metrics"], every)]


def _metrics(metrics: Mapping[str, Any], every: bool) -> list[str]:
    """The metrics of the exported formulation, one on each line, or all metrics if there are few."""
    few = every or len(metrics) <= 40
    chosen = {name: value for name, value in metrics.items() if ".full." in name or few}
    # In the other lines, general metrics have few dots in their names.
    chosen = chosen or {name: value for name, value in metrics.items() if name.count(".") <= 2}
    left = len(metrics) - len(chosen)
    more = [f"  {left} metrics more: legtool info --all"] if left else []
    return [f"  {name} {_value(entry)}" for name, entry in chosen.items()] + more


def _value(entry: Mapping[str, Any]) -> str:
    interval = "" if entry["ci95"] is None else " [{:.4g}, {:.4g}]".format(*entry["ci95"])
    return f"{entry['value']:.4g}{interval} {entry['unit']}, n {entry['n']}"


def _recording(path: Path) -> list[str]:
    from legtool.datasets.logs.log import describe_log

    described = describe_log(path)
    if "topics" in described:
        from legtool.datasets.logs.survey import describe_survey, survey

        title = f"{path}: {described['kind']}, {described['messages']} messages in {described['duration_s']:.1f} s"
        if not described["messages"]:
            return [title]
        return [title, *describe_survey(survey(path))]
    from legtool.pipeline.columns import guess_columns, rate_of

    held = []
    for name, file in described["files"].items():
        serves, stamp = guess_columns(file.get("names", ()))
        if stamp is not None:
            rate = rate_of(path if path.is_file() else path / name, stamp)
            file = {**file, "stamp": stamp, "serves": list(serves), **rate}
        held.append(f"  {name}: {file['rows']} rows of {file['columns']} columns")
        if file.get("rate_hz"):
            held.append(f"    {file['stamp']}: {file['rate_hz']:.4g} Hz, longest gap {file['longest_gap_s']:.3g} s")
        if file.get("serves"):
            held.append(f"    could be {', '.join(file['serves'])}")
        held += textwrap.wrap(", ".join(file.get("names", ())), 116, initial_indent="    ", subsequent_indent="    ")
    return [f"{path}: {described['kind']}", *held]


def _compared(paths: Sequence[Path]) -> list[str]:
    """What the signals of a log say of each other, as collect log would tell it."""
    from legtool.configs.log import LogSettings
    from legtool.pipeline.guess import compared

    return [f"  {line}" for line in compared(paths, LogSettings())]


def _inner(path: Path) -> list[Path]:
    """Datasets, runs, bundles and results in a directory, such as that of a demo."""
    if not path.is_dir():
        return []
    there = [path / name for pattern in ("*/", "*/*/") for name in sorted(path.glob(pattern))]
    return [found for found in there if any((found / marker).is_file() for marker in _MARKERS)]


def _is_world_json(path: Path) -> bool:
    """Whether a JSON file is none of those that legtool writes itself, and so describes a world."""
    return path.suffix == ".json" and path.is_file() and path.name not in (*_MARKERS, "results.json")


def _world(path: Path) -> list[str]:
    from legtool.configs.courses import any_world, is_walk
    from legtool.configs.worlds import is_world
    from legtool.sim.worlds.build import build_world
    from legtool.sim.worlds.drawing import draw_world

    if not path.exists() and not (is_world(str(path)) or is_walk(str(path))):
        raise LegtoolError(f"{path}: no such file or directory, and no world of that name")
    return draw_world(build_world(any_world(str(path))))


_MARKERS = {"manifest.json": _dataset, "run.json": _run, "bundle.json": _bundle, "results.json": _results}
