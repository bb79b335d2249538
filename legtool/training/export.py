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
from legtool.configs.robots import read_seeing_robot
from legtool.datasets.contents import bundle_content
from legtool.datasets.files import explain_os_error, fsync_directory, read_json, sweep_temporaries, temporary_beside
from legtool.datasets.motion.transitions import TOUCHDOWN
from legtool.datasets.network_run import FOOTHOLD_KINDS, STEPPABILITY_KIND
from legtool.datasets.work import BUNDLE, RUN, check_free, check_same, locked
from legtool.errors import BundleError, DatasetError, OutputError
from legtool.provenance import commit, versions
from legtool.training.card import write_card
from legtool.training.freeze import Line, freeze_motion
from legtool_runtime.bundle import CARD, KIND, MANIFEST, SCHEMA_VERSION, Bundle, content_sha256, load_bundle


def _motion(run: Path, settings: ExportSettings) -> list[Line]:
    return [freeze_motion(run, settings)]


def _foothold(run: Path, settings: ExportSettings) -> list[Line]:
    from legtool.training.freeze_foothold import freeze_foothold  # here: a motion run is exported without torch

    return freeze_foothold(run, settings)


def _steppability(run: Path, settings: ExportSettings) -> list[Line]:
    from legtool.training.freeze_steppability import freeze_steppability

    return [freeze_steppability(run, settings)]


#: What a run's ``kind`` is frozen by.
_FREEZERS: dict[str, Callable[[Path, ExportSettings], list[Line]]] = {
    "motion": _motion,
    **dict.fromkeys(FOOTHOLD_KINDS.values(), _foothold),
    STEPPABILITY_KIND: _steppability,
}


def export_bundle(runs: Sequence[Path], out: Path, settings: ExportSettings | None = None) -> Path:
    """Freeze runs into one bundle.

    The bundle is written beside ``out`` and moved there once it is complete, has been loaded back, and agrees with the
    trained models. Repeating the same export leaves the bundle unchanged.

    Args:
        runs: training runs, at most one of each line, all of one robot and instant.
        out: the bundle's directory: new, empty, or holding the same models. Figures that were measured since are added.
        settings: settings of the comparison and the card.

    Returns:
        ``out``.

    Raises:
        DatasetError: there is no run, one is damaged, two are of one line, or robots or instants differ.
        OutputError: ``out`` holds something else or cannot be written, or frozen and trained models differ.
    """
    settings = settings or ExportSettings()
    _refuse_two_of_a_line(runs)
    _refuse_two_robots(runs)
    lines = [line for run in runs for line in _freeze(run, settings)]
    _check_together(lines)
    _check_free(out)
    place = out.absolute()
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with locked(place.with_name(f".{place.name}.lock"), out):
            _check_free(out)
            sweep_temporaries(place.parent, place.name)
            _export(lines, out)
    except OSError as error:
        raise explain_os_error(error, out) from error
    return out


def _export(lines: Sequence[Line], out: Path) -> None:
    temporary = temporary_beside(out.absolute())
    try:
        temporary.mkdir()
        _write(temporary, lines, name=out.absolute().name, agreement={})
        loaded = _load_back(temporary, out)
        agreement = {line.name: _agreement(line, line.compare(loaded)) for line in lines}
        manifest = _write(temporary, lines, name=out.absolute().name, agreement=agreement)
        _load_back(temporary, out)
        _place(temporary, out, manifest)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _refuse_two_of_a_line(runs: Sequence[Path]) -> None:
    """Before any is frozen: that takes minutes."""
    seen: dict[str, Path] = {}
    for run in runs:
        description = _description(run)
        kinds = [description["kind"]]
        # The dense network serves both tasks of its line.
        if kinds[0] in FOOTHOLD_KINDS.values() and description.get("settings", {}).get("network") == "dense":
            kinds = list(FOOTHOLD_KINDS.values())
        for kind in kinds:
            if kind in seen:
                name = kind.removeprefix("foothold_")
                raise DatasetError(
                    f"{seen[kind]} and {run} are both runs of the {name} line; a bundle holds one of each"
                )
            seen[kind] = run


def _refuse_two_robots(runs: Sequence[Path]) -> None:
    """Likewise before any is frozen."""
    robots = {run: _robot_of(run) for run in runs}
    for run, robot in robots.items():
        _check_one_robot(run, robot, runs[0], robots[runs[0]])


def _robot_of(run: Path) -> dict[str, Any]:
    """Geometry of the robot that a run was trained for, as the runtime writes it."""
    robot = _description(run).get("robot")
    if not isinstance(robot, dict):
        raise DatasetError(f"{run / RUN.marker}: names no robot; train again")
    geometry = read_seeing_robot(robot, str(run)).geometry().to_dict() if "camera" in robot else robot
    return dict(json.loads(json.dumps(geometry)))


def _check_one_robot(run: Path, robot: Mapping[str, Any], first_run: Path, first: Mapping[str, Any]) -> None:
    if robot != first:
        same = robot["name"] == first["name"]
        what = f"another geometry of {robot['name']}" if same else robot["name"]
        raise DatasetError(
            f"{run}: made for {what}, {first_run} for {first['name']}; export them separately, or collect and train "
            "all for one robot (--robot, --mjcf)"
        )


def _description(run: Path) -> dict[str, Any]:
    if not (run / RUN.marker).is_file():
        raise DatasetError(f"{run}: not a run (no {RUN.marker}); make one with legtool train")
    description = read_json(run / RUN.marker)
    if description.get("kind") not in _FREEZERS:
        raise DatasetError(f"{run}: a run of kind {description.get('kind')!r}, expected one of: {', '.join(_FREEZERS)}")
    return description


def _freeze(run: Path, settings: ExportSettings) -> list[Line]:
    return _FREEZERS[_description(run)["kind"]](run, settings)


def _check_together(lines: Sequence[Line]) -> None:
    if not lines:
        raise DatasetError("no run was given; name one or more directories made by legtool train")
    first = lines[0]
    for line in lines:
        _check_one_robot(line.run, line.robot.to_dict(), first.run, first.robot.to_dict())
    dated = [line for line in lines if line.instant is not None]
    for line in dated[1:]:
        if line.instant != dated[0].instant:
            raise DatasetError(
                f"{line.run}: states at {line.instant}, {dated[0].run} at {dated[0].instant}; export them separately"
            )


def _check_free(out: Path) -> None:
    if out.is_symlink():
        raise OutputError(f"{out}: is a link; --out expects a directory that is new or empty")
    check_free(out, BUNDLE.marker)


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


def _models(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a bundle but for the figures: models that were measured since are the same models."""
    content = dict(bundle_content(manifest))
    lines = {name: {**line, "metrics": {}} for name, line in content["lines"].items()}
    return {**content, "lines": lines}


def _figures(manifest: Mapping[str, Any]) -> dict[str, Any]:
    return {name: line["metrics"] for name, line in manifest["lines"].items()}


def describe_export(out: Path) -> list[str]:
    """What a bundle's user should know of it at once: what was not measured, and what cannot plan.

    Args:
        out: the bundle.
    """
    lines: dict[str, Any] = read_json(out / MANIFEST)["lines"]
    said = [
        f"{name}: {len(line['metrics'])} figures on the card, measured by {line['evaluation'].get('split', 'eval')}"
        if line["metrics"]
        else f"{name}: not measured; run legtool eval {name} RUN --out REPORT, then the same export again"
        for name, line in lines.items()
    ]
    if lines.get("motion", {}).get("instant") == "touchdown":
        said.append(TOUCHDOWN)
    return said


def _place(temporary: Path, out: Path, manifest: dict[str, Any]) -> None:
    fsync_directory(temporary)
    if (out / MANIFEST).is_file():
        try:
            there = load_bundle(out).manifest
        except BundleError as error:
            raise OutputError(f"{out}: holds a damaged bundle; remove it, or choose another --out") from error
        check_same(out, BUNDLE.what, _models(there), _models(manifest))
        if _figures(there) == _figures(manifest):
            return
        before = temporary_beside(out.absolute())
        out.rename(before)
        temporary.rename(out)
        shutil.rmtree(before, ignore_errors=True)
    else:
        temporary.rename(out)
    fsync_directory(out.absolute().parent)
