"""Freeze runs into a bundle for ``legtool_runtime``, released only if it agrees with the trained models."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from legtool.configs.export import ExportSettings
from legtool.datasets.foothold.run import KINDS
from legtool.datasets.motion.run import RUN
from legtool.datasets.provenance import commit, versions
from legtool.datasets.store import explain_os_error, fsync_directory, read_json
from legtool.errors import BundleError, DatasetError, OutputError
from legtool.training.card import write_card
from legtool.training.freeze import Line, freeze_motion
from legtool.training.freeze_foothold import freeze_foothold
from legtool.training.freeze_steppability import freeze_steppability
from legtool_runtime.bundle import CARD, KIND, MANIFEST, SCHEMA_VERSION, Bundle, content_sha256, load_bundle

#: Parts of a line's description that tell of its making.
_CIRCUMSTANCES = ("provenance", "evaluation", "agreement")
#: What a run's ``kind`` is frozen by.
_FREEZERS: dict[str, Callable[[Path, ExportSettings], list[Line]]] = {
    "motion": lambda run, settings: [freeze_motion(run, settings)],
    **dict.fromkeys(KINDS.values(), freeze_foothold),
    "steppability": lambda run, settings: [freeze_steppability(run, settings)],
}


def export_bundle(runs: Sequence[Path], out: Path, settings: ExportSettings | None = None) -> Path:
    """Freeze runs into one bundle.

    The bundle is written beside ``out`` and moved there once it is complete, has been loaded back, and agrees with the
    trained models. Repeating the same export leaves the bundle unchanged.

    Args:
        runs: training runs, at most one of each line, all of one robot and instant.
        out: the bundle's directory: new, empty, or holding the same bundle.
        settings: settings of the comparison and the card.

    Returns:
        ``out``.

    Raises:
        DatasetError: there is no run, one is damaged, two are of one line, or robots or instants differ.
        OutputError: ``out`` holds something else or cannot be written, or frozen and trained models differ.
    """
    settings = settings or ExportSettings()
    lines = [line for run in runs for line in _freeze(run, settings)]
    _check_together(lines)
    _check_free(out)
    temporary = out.absolute().with_name(f".{out.absolute().name}.export.tmp")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(temporary, ignore_errors=True)  # left by an export that was killed
        temporary.mkdir()
        _write(temporary, lines, name=out.absolute().name, agreement={})
        loaded = _load_back(temporary, out)
        agreement = {line.name: _agreement(line, line.compare(loaded)) for line in lines}
        manifest = _write(temporary, lines, name=out.absolute().name, agreement=agreement)
        _load_back(temporary, out)
        _place(temporary, out, manifest)
    except OSError as error:
        raise explain_os_error(error, out) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return out


def _freeze(run: Path, settings: ExportSettings) -> list[Line]:
    if not (run / RUN).is_file():
        raise DatasetError(f"{run}: not a run (no {RUN}); make one with legtool train")
    kind = read_json(run / RUN).get("kind")
    if kind not in _FREEZERS:
        raise DatasetError(f"{run}: a run of kind {kind!r}, expected one of: {', '.join(_FREEZERS)}")
    return _FREEZERS[kind](run, settings)


def _check_together(lines: Sequence[Line]) -> None:
    if not lines:
        raise DatasetError("no run was given; name one or more directories made by legtool train")
    first = lines[0]
    for index, line in enumerate(lines):
        for other in lines[:index]:
            if other.name == line.name:
                raise DatasetError(
                    f"{other.run} and {line.run} are both runs of the {line.name} line; a bundle holds one of each"
                )
        if line.robot.to_dict() != first.robot.to_dict():
            same = line.robot.name == first.robot.name
            what = f"another geometry of {line.robot.name}" if same else line.robot.name
            raise DatasetError(
                f"{line.run}: made for {what}, {first.run} for {first.robot.name}; export them separately"
            )
    dated = [line for line in lines if line.instant is not None]
    for line in dated[1:]:
        if line.instant != dated[0].instant:
            raise DatasetError(
                f"{line.run}: states at {line.instant}, {dated[0].run} at {dated[0].instant}; export them separately"
            )


def _check_free(out: Path) -> None:
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise OutputError(f"{out}: is a file or a link; --out expects a directory that is new or empty")
    if out.is_dir() and any(out.iterdir()) and not (out / MANIFEST).is_file():
        held = sorted(item.name for item in out.iterdir())[0]
        raise OutputError(f"{out}: holds something else ({held}, …); choose another --out")


def _load_back(temporary: Path, out: Path) -> Bundle:
    try:
        return load_bundle(temporary)
    except BundleError as error:
        raise OutputError(f"{out}: not exported, because the runtime would reject it ({error})") from error


def _agreement(line: Line, differences: dict[str, float]) -> dict[str, Any]:
    for what, difference in differences.items():
        if not difference <= line.tolerance:
            raise OutputError(
                f"{line.run}: not exported: the frozen {line.name} models differ from {what} by {difference:.2e}, "
                f"expected at most {line.tolerance:.0e}; train again, or with fewer or better-conditioned inputs"
            )
    return {**line.compared, "largest_difference": differences}


def _write(path: Path, lines: Sequence[Line], *, name: str, agreement: dict[str, Any]) -> dict[str, Any]:
    """Write all files of a bundle; the card is written only once the agreement is known."""
    files = {file: content for line in lines for file, content in line.files.items()}
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "robot": lines[0].robot.to_dict(),
        "lines": {line.name: {**line.description, "agreement": agreement.get(line.name)} for line in lines},
        "provenance": {"commit": commit(), "versions": versions()},
    }
    if agreement:
        files[CARD] = write_card(manifest, name=name).encode()
    manifest["files"] = [
        {"name": file, "bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for file, content in sorted(files.items())
    ]
    manifest = json.loads(json.dumps(manifest))
    manifest["content_sha256"] = content_sha256(manifest)
    files[MANIFEST] = (json.dumps(manifest, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()
    for file, content in files.items():
        with (path / file).open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    return manifest


def _place(temporary: Path, out: Path, manifest: dict[str, Any]) -> None:
    fsync_directory(temporary)
    if (out / MANIFEST).is_file():
        try:
            there = load_bundle(out).manifest
        except BundleError as error:
            raise OutputError(f"{out}: holds a damaged bundle; remove it, or choose another --out") from error
        if _identity(there) != _identity(manifest):
            raise OutputError(f"{out}: holds another bundle; remove it, or choose another --out")
        return
    temporary.rename(out)
    fsync_directory(out.absolute().parent)


def _identity(manifest: Mapping[str, Any]) -> Any:
    """What two bundles of the same models share, whichever commit exported them."""
    lines = {
        name: {key: value for key, value in line.items() if key not in _CIRCUMSTANCES}
        for name, line in manifest["lines"].items()
    }
    return manifest["robot"], lines, [entry for entry in manifest["files"] if entry["name"] != CARD]
