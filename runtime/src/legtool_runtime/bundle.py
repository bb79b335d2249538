"""A bundle: the directory that carries trained models from ``legtool export`` to the robot.

``bundle.json`` names every other file with its size and SHA-256, and carries a digest of its own content. All of it is
verified before any of it is used, and each file is read once: what was verified is what is used. The digests protect
against damage, and against files of several exports mixed up in one directory. They do not say who made the bundle:
whoever can write into it can recompute them. Nothing in a bundle is code, and no pickle is ever read.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from legtool_runtime.errors import BundleError, LegtoolError, shown
from legtool_runtime.lines import LINES, UPGRADE, read_line
from legtool_runtime.onnx_session import running_on
from legtool_runtime.robot import Robot

if TYPE_CHECKING:
    from legtool_runtime.foothold.networks import CountNetwork, FootholdNetwork
    from legtool_runtime.motion.model import MotionModel
    from legtool_runtime.perception.steppability import Segmenter

#: Raised whenever a runtime of the version before could misread what is written.
SCHEMA_VERSION = 1
KIND = "bundle"
MANIFEST = "bundle.json"
CARD = "CARD.md"

_MANIFEST_TYPES: dict[str, type] = {"robot": dict, "lines": dict, "provenance": dict, "files": list}
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_MAX_BYTES = 256 * 1024 * 1024
_MAX_MANIFEST_BYTES = 16 * 1024 * 1024
#: What else legtool writes, told apart by the file that describes it.
_OTHER_KINDS = {
    "manifest.json": "a dataset: train a run on it, then export the run",
    "run.json": "a training run: make a bundle of it with legtool export",
    "results.json": "the results of an evaluation: name the bundle instead",
}


class Bundle:
    """Verified models of one robot. Any line of work may be absent: ``lines`` says which are there.

    Attributes:
        path: the directory it was loaded from.
        robot: the geometry of the robot that it was made for.
        lines: names of the lines that it holds.
        manifest: ``bundle.json``: robot, lines with their metrics, provenance, files.
    """

    def __init__(self, path: Path, robot: Robot, models: Mapping[str, Any], manifest: Mapping[str, Any]) -> None:
        self.path = path
        self.robot = robot
        self.lines = tuple(models)
        self.manifest = manifest
        self._models = dict(models)

    @property
    def motion(self) -> MotionModel:
        """The motion models.

        Raises:
            BundleError: the bundle holds no motion line.
        """
        model: MotionModel = self._line("motion")
        return model

    @property
    def vfa(self) -> FootholdNetwork:
        """The network that proposes footholds.

        Raises:
            BundleError: the bundle holds no vfa line.
        """
        network: FootholdNetwork = self._line("vfa")
        return network

    @property
    def vpa(self) -> CountNetwork:
        """The network that predicts numbers of safe footholds over hip heights.

        Raises:
            BundleError: the bundle holds no vpa line.
        """
        network: CountNetwork = self._line("vpa")
        return network

    @property
    def steppability(self) -> Segmenter:
        """The segmenter, with the depth camera that it was trained for.

        Raises:
            BundleError: the bundle holds no steppability line.
        """
        segmenter: Segmenter = self._line("steppability")
        return segmenter

    def _line(self, name: str) -> Any:
        if name not in self._models:
            held = ", ".join(self.lines) or "no line at all"
            raise BundleError(f"{self.path}: holds no {name} line, only {held}; export a {name} run with it")
        return self._models[name]

    def metrics(self, line: str) -> Mapping[str, Any]:
        """What was measured when a line was evaluated: name to value, interval, count and unit; empty if it was not.

        Raises:
            BundleError: the bundle does not hold the line.
        """
        self._line(line)
        metrics: Mapping[str, Any] = self.manifest["lines"][line]["metrics"]
        return metrics

    def warm_up(self) -> None:
        """Compile every kernel, or load it from the user's cache, so that the first call is as fast as any other.

        Call it once before the robot moves. Where the cache of :mod:`legtool_runtime.cache` cannot be written, each
        process compiles anew; nothing else changes.
        """
        self.robot.feet(self.robot.joints(self.robot.stance)[0])
        for model in self._models.values():
            model.warm_up()

    def __str__(self) -> str:
        parts = [str(model) for model in self._models.values()]
        return f"bundle for {self.robot.name}: {'; '.join(parts)}"


def load_bundle(path: str | os.PathLike[str], *, providers: Sequence[str] = ()) -> Bundle:
    """Verify and load a bundle.

    Args:
        path: its directory.
        providers: execution providers of onnxruntime for the networks, the preferred one first, such as
            ``["CUDAExecutionProvider", "CPUExecutionProvider"]``; none: the processor. A bundle without networks is
            loaded without onnxruntime.

    Raises:
        BundleError: missing, damaged, altered, of another kind, made for another or newer runtime, or with networks
            for which onnxruntime is missing or lacks a provider.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise BundleError(f"{shown(path)}: expected the path of a bundle, the directory that legtool export wrote")
    path = Path(path)
    try:
        with running_on(providers):
            return _load(path)
    except OSError as error:
        raise BundleError(f"{path}: cannot be read ({error.strerror or error})") from error


def _load(path: Path) -> Bundle:
    manifest = _read_manifest(path)
    try:
        robot = Robot.from_dict(manifest["robot"])
    except (LegtoolError, OverflowError) as error:
        raise BundleError(f"{path}: {error}") from error
    contents = _read_files(path, manifest["files"])
    models = {}
    for line, description in manifest["lines"].items():
        if line not in LINES:
            raise BundleError(f"{path}: holds a line {line!r}; this runtime reads {', '.join(LINES)}; {UPGRADE}")
        files = {}
        for name in LINES[line]:
            if name not in contents:
                raise BundleError(f"{path}: {MANIFEST} lists no {name}, which its {line} line needs; {_AGAIN}")
            files[name] = contents[name]
        try:
            models[line] = read_line(line, robot, description, files)
        except BundleError as error:
            raise BundleError(f"{path}: {error}") from error
    return Bundle(path, robot, models, manifest)


def content_sha256(manifest: Mapping[str, Any]) -> str:
    """Digest of all that ``bundle.json`` says, apart from the digest itself and the layout of its text."""
    content = {key: value for key, value in manifest.items() if key != "content_sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


_AGAIN = "export the bundle again, or copy it again as a whole"


def _read_manifest(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise BundleError(f"{path}: no such directory; make a bundle with legtool export")
    if not path.is_dir():
        raise BundleError(f"{path}: is a file; expected a bundle, the directory that legtool export wrote")
    if not os.path.lexists(path / MANIFEST):
        for marker, kind in _OTHER_KINDS.items():
            if (path / marker).exists():
                raise BundleError(f"{path}: is no bundle but {kind}")
        raise BundleError(f"{path}: is no bundle (it has no {MANIFEST}); make one with legtool export")
    data = _read_file(path, MANIFEST, limit=_MAX_MANIFEST_BYTES)
    try:
        manifest = json.loads(data.decode("utf-8"), object_pairs_hook=_no_duplicates, parse_constant=_no_constant)
        digest = content_sha256(manifest) if isinstance(manifest, dict) else ""
    except (ValueError, RecursionError) as error:
        raise BundleError(f"{path / MANIFEST}: damaged, not readable as JSON ({shown(error)}); {_AGAIN}") from error
    if not isinstance(manifest, dict) or manifest.get("kind") != KIND:
        found = manifest.get("kind") if isinstance(manifest, dict) else manifest
        raise BundleError(f"{path / MANIFEST}: describes {shown(found)}, expected kind {KIND!r}")
    version = manifest.get("schema_version")
    if type(version) is not int or version < 1:
        raise BundleError(f"{path / MANIFEST}: schema_version is {shown(version)}, expected a whole number from 1 up")
    if version > SCHEMA_VERSION:
        raise BundleError(
            f"{path}: made by a newer legtool: needs schema {shown(version)}, this runtime reads {SCHEMA_VERSION}; "
            f"{UPGRADE}"
        )
    if manifest.get("content_sha256") != digest:
        raise BundleError(f"{path / MANIFEST}: was altered since it was written (its own SHA-256 differs); {_AGAIN}")
    for key, expected in _MANIFEST_TYPES.items():
        if type(manifest.get(key)) is not expected:
            raise BundleError(
                f"{path / MANIFEST}: {key} is {shown(manifest.get(key))}, expected a {expected.__name__}; {_AGAIN}"
            )
    return manifest


def _read_files(path: Path, entries: list[Any]) -> dict[str, bytes]:
    contents: dict[str, bytes] = {}
    for entry in entries:
        if not isinstance(entry, dict) or entry.keys() != {"name", "bytes", "sha256"}:
            raise BundleError(f"{path / MANIFEST}: files holds {shown(entry)}, expected name, bytes and sha256")
        name, size = entry["name"], entry["bytes"]
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise BundleError(
                f"{path / MANIFEST}: names a file {shown(name)}; expected a plain file name, inside the bundle"
            )
        if name == MANIFEST or name in contents:
            raise BundleError(f"{path / MANIFEST}: lists {name} {'twice' if name in contents else 'itself'}; {_AGAIN}")
        data = _read_file(path, name, limit=_MAX_BYTES)
        if len(data) != size:
            raise BundleError(f"{path / name}: has {len(data)} bytes, {MANIFEST} says {shown(size)}; {_AGAIN}")
        if hashlib.sha256(data).hexdigest() != entry["sha256"]:
            raise BundleError(f"{path / name}: its bytes differ from the SHA-256 in {MANIFEST}; {_AGAIN}")
        contents[name] = data
    for item in sorted(path.iterdir()):
        if item.name not in contents and item.name != MANIFEST and not item.name.startswith("."):
            raise BundleError(f"{item}: is not listed in {MANIFEST}; move it out of the bundle")
    return contents


def _read_file(path: Path, name: str, *, limit: int) -> bytes:
    """All bytes of a plain file; a link is not followed, a pipe or device not waited for."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    if (path / name).is_symlink():
        raise BundleError(f"{path / name}: is a link; a bundle holds plain files only")
    try:
        with os.fdopen(os.open(path / name, flags), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise BundleError(f"{path / name}: is not a plain file")
            if status.st_size > limit:
                raise BundleError(f"{path / name}: has {status.st_size} bytes, expected at most {limit}")
            return file.read(limit + 1)
    except FileNotFoundError as error:
        raise BundleError(f"{path / name}: missing; {_AGAIN}") from error
    except OSError as error:
        raise BundleError(f"{path / name}: cannot be read ({error.strerror or error})") from error


def _no_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        raise ValueError("a key stands twice in one object")
    return out


def _no_constant(text: str) -> None:
    raise ValueError(f"{text} is not a number")
