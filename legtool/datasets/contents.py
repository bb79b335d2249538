"""The content of what a setting names: a file that was changed makes other work, though its name stayed the same.

Settings that are read into memory, such as a robot's or a world's, are their own content (``to_dict``).
"""

from __future__ import annotations

import ast
import importlib.util
import os
from collections.abc import Iterable, Iterator, Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from legtool.configs.mjcf import MjcfNames
from legtool.configs.observation import NetworkSettings
from legtool.configs.policies import load_policy_settings
from legtool.configs.robots import load_robot
from legtool.datasets.files import sha256
from legtool_runtime.bundle import CARD

#: Attributes of MJCF's compiler that say where the files of meshes and textures lie.
_DIRECTORIES = ("assetdir", "meshdir", "texturedir")
#: Parts of a bundle's lines that tell of their making and not of the models.
_CIRCUMSTANCES = ("provenance", "evaluation", "agreement")


def files_content(path: Path) -> list[dict[str, str]]:
    """Name and SHA-256 of a file, or of every file below a directory."""
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    return _hashes(files, path.parent)


def robot_content(robot: str, mjcf: Path | None = None, names: MjcfNames | None = None) -> Any:
    """A simulated robot: the YAML that it is built from, or its MJCF file with all that it is made of.

    Args:
        robot: preset or path of a YAML.
        mjcf: the robot's own MJCF file, which then takes the YAML's place.
        names: that say what is what in the MJCF file.

    Raises:
        RobotError, SettingsError: no such robot, or a YAML that is wrong.
        OSError: the MJCF file cannot be read.
    """
    if mjcf is None:
        return load_robot(robot).to_dict()
    return {"files": mjcf_content(mjcf), "names": None if names is None else names.to_dict()}


def mjcf_content(path: Path) -> list[dict[str, str]]:
    """Name and SHA-256 of an MJCF file and of the files that it includes: models, meshes, textures, height fields.

    Raises:
        OSError: the file cannot be read.
    """
    found, left = {path}, [path]
    places: set[Path] = set()
    names: set[str] = set()
    while left:
        file = left.pop()
        for element in _elements(file):
            inside = [element.get(key, ".") for key in _DIRECTORIES] if element.tag == "compiler" else ["."]
            places |= {base / name for base in (path.parent, file.parent) for name in inside}
            names |= {value for key, value in element.items() if key.startswith("file")}
        # A directory may be named after the files that lie in it, so that all names are looked up again.
        new = {place / name for place in places for name in names if (place / name).is_file()} - found
        found |= new
        left += [file for file in new if file.suffix.lower() in (".xml", ".mjcf")]
    return _hashes(found, path.parent)


def _elements(path: Path) -> Iterator[ElementTree.Element]:
    try:
        yield from ElementTree.fromstring(path.read_bytes()).iter()
    except ElementTree.ParseError:
        return  # MuJoCo says what is wrong with it


def controller_content(black_box: str | None) -> Any:
    """A controller: nothing for the built-in one, a policy's description and network, or a class's source.

    Of a class that is every module of its package, or its own module and those beside it that it imports. What else
    it reads when it runs is not known.

    Args:
        black_box: as :func:`legtool.sim.controllers.blackbox.make_controller` takes it.

    Raises:
        SettingsError: a policy's description is missing or wrong.
    """
    if black_box is None:
        return None
    if black_box.endswith((".yaml", ".yml")):
        settings = load_policy_settings(Path(black_box))
        content = {**settings.to_dict(), **_network_content(settings)}
        if settings.estimator is not None:
            content["estimator"] = {**content["estimator"], **_network_content(settings.estimator)}
        return content
    module, _, attribute = black_box.partition(":")
    return {"class": attribute, "module": module, "sources": _sources(module.partition(".")[0])}


def _network_content(network: NetworkSettings) -> dict[str, list[str]]:
    """Hashes of a network under its setting.

    Weights that do not fit into the file lie beside it, under its name with something added.
    """
    path = network.file
    hashes = [entry["sha256"] for entry in _hashes(sorted(path.parent.glob(f"{path.name}*")), path.parent)]
    return {"torchscript" if network.onnx is None else "onnx": hashes}


def bundle_content(manifest: Mapping[str, Any]) -> Any:
    """What two bundles of the same models share, whichever commit exported them.

    Args:
        manifest: of a bundle that was loaded, and so verified.
    """
    lines = {
        name: {key: value for key, value in line.items() if key not in _CIRCUMSTANCES}
        for name, line in manifest["lines"].items()
    }
    files = [entry for entry in manifest["files"] if entry["name"] != CARD]
    return {"robot": manifest["robot"], "lines": lines, "files": files}


def _sources(name: str) -> list[dict[str, str]]:
    try:
        spec = PathFinder.find_spec(name, [str(Path.cwd())]) or importlib.util.find_spec(name)
    except (ImportError, ValueError):
        spec = None
    if spec is None or spec.origin is None or not spec.has_location:
        return []
    origin = Path(spec.origin)
    if spec.submodule_search_locations is not None:
        return _hashes(origin.parent.rglob("*.py"), origin.parent.parent)
    found: set[Path] = set()
    left = [origin]
    while left:
        module = left.pop()
        if module not in found:
            found.add(module)
            installed = module.parent.name.endswith("-packages")
            for imported in () if installed else _imports(module):
                left += [beside] if (beside := module.parent / f"{imported}.py").is_file() else []
                found |= set((module.parent / imported).rglob("*.py"))
    return _hashes(found, origin.parent)


def _imports(module: Path) -> set[str]:
    """First parts of the names of what a module imports."""
    try:
        nodes = list(ast.walk(ast.parse(module.read_bytes())))
    except SyntaxError:
        return set()  # importing it says what is wrong
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module and not node.level]
    return {name.partition(".")[0] for name in names}


def _hashes(files: Iterable[Path], root: Path) -> list[dict[str, str]]:
    """Sorted; named from ``root``, so that no path of the machine is carried."""
    named = {Path(os.path.relpath(file, root)).as_posix(): file for file in files}
    return [{"name": name, "sha256": sha256(named[name])} for name in sorted(named)]
