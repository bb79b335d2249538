"""What a path holds: a recording, dataset, run, bundle or results, with counts, its hashes verified."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from legtool.errors import LegtoolError


def describe(path: Path) -> list[str]:
    """Describe anything that legtool reads or writes.

    Args:
        path: a file or directory.

    Returns:
        lines for a terminal.

    Raises:
        LegtoolError: nothing there, or not something legtool knows, or its hashes do not match.
    """
    if not path.exists():
        raise LegtoolError(f"{path}: no such file or directory")
    for marker, describer in _MARKERS.items():
        if (path / marker).is_file():
            return describer(path)
    if path.name == "results.json":
        return _results(path.parent)
    return _recording(path)


def format_counts(counts: Mapping[str, Any]) -> str:
    """Counts on one line, largest first apart from the order they came in."""
    parts = [f"{name.replace('_', ' ')} {value:g}" for name, value in counts.items() if value]
    return "  " + ", ".join(parts) if parts else "  nothing counted"


def _dataset(path: Path) -> list[str]:
    from legtool.datasets.store import data_hash, load_manifest, verify

    manifest = load_manifest(path)
    title = f"{path}: {manifest['kind']} dataset of {manifest['robot']['name']}"
    if not manifest.get("complete"):
        return [f"{title}, not finished: run its collect command again to carry on"]
    verify(path, [*manifest["parts"], *manifest["files"]])
    return [
        f"{title}, states at {manifest['instant']}",
        f"  {manifest['rows']} rows in {len(manifest['parts'])} parts, {len(manifest['files'])} recordings, "
        f"seed {manifest['seed']}, commit {manifest['commit']}",
        format_counts(manifest["counts"]),
        f"  data hash {data_hash(manifest)}, every file's SHA-256 verified",
    ]


def _run(path: Path) -> list[str]:
    from legtool.training.motion import load_run

    run = load_run(path)
    return [f"{path}: run of {run.kind}, robot {run.robot.name}"]


def _bundle(path: Path) -> list[str]:
    from legtool_runtime import load_bundle

    bundle = load_bundle(path)
    return [f"{path}: {bundle}", "  every file's SHA-256 verified"]


def _results(path: Path) -> list[str]:
    results = json.loads((path / "results.json").read_text())
    lines = [f"{path}: results, {len(results['metrics'])} metrics, data hash {results['provenance']['data_hash']}"]
    return lines


def _recording(path: Path) -> list[str]:
    from legtool.datasets.log import describe_log

    described = describe_log(path)
    lines = [f"{path}: {described['kind']}"]
    return lines


_MARKERS = {"manifest.json": _dataset, "run.json": _run, "bundle.json": _bundle, "results.json": _results}
