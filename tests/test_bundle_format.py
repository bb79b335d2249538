"""What docs/bundle_format.md says of a bundle is what the runtime reads."""

import copy
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from legtool_runtime import MotionState, load_bundle
from legtool_runtime.bundle import MANIFEST, content_sha256
from legtool_runtime.errors import LegtoolError
from legtool_runtime.motion.model import MotionModel, parameter_shapes

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "examples" / "bundle"
SCHEMA = json.loads((ROOT / "docs" / "bundle.schema.json").read_text())


@pytest.fixture(scope="module")
def reader(load_script: Callable[[str], ModuleType]) -> ModuleType:
    return load_script("examples/read_bundle.py")


def test_the_published_schema_is_the_one_that_the_code_makes(load_script: Callable[[str], ModuleType]) -> None:
    made = load_script("docs/bundle_schema.py").schema()
    assert json.loads(json.dumps(made)) == SCHEMA, "run python docs/bundle_schema.py"
    Draft202012Validator.check_schema(SCHEMA)


def test_the_shipped_bundle_is_as_the_schema_says(check_manifest: Callable[[Path], None]) -> None:
    check_manifest(SHIPPED)


def _required(schema: dict, instance: dict, at: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of all keys that the schema requires in an instance."""
    for name in schema.get("required", ()):
        yield (*at, name)
    for name, inner in schema.get("properties", {}).items():
        if isinstance(instance.get(name), dict):
            yield from _required(inner, instance[name], (*at, name))


def test_whatever_the_schema_requires_the_runtime_does(tmp_path: Path) -> None:
    manifest = json.loads((SHIPPED / MANIFEST).read_text())
    paths = [path for path in _required(SCHEMA, manifest) if "metrics" not in path[:-1]]
    assert {("robot", "stance"), ("lines", "motion", "degree"), ("files",)} <= set(paths)
    for item in SHIPPED.iterdir():
        (tmp_path / item.name).write_bytes(item.read_bytes())
    for path in paths:
        changed = copy.deepcopy(manifest)
        group = changed
        for part in path[:-1]:
            group = group[part]
        del group[path[-1]]
        if path != ("content_sha256",):
            changed["content_sha256"] = content_sha256(changed)
        assert not Draft202012Validator(SCHEMA).is_valid(changed), path
        (tmp_path / MANIFEST).write_text(json.dumps(changed))
        with pytest.raises(LegtoolError):
            load_bundle(tmp_path)


def test_the_reader_without_our_packages_predicts_what_the_runtime_does(reader: ModuleType) -> None:
    bundle = load_bundle(SHIPPED)
    assert reader.read_manifest(SHIPPED) == bundle.manifest
    _same_predictions(reader, reader.read_arrays(SHIPPED / "motion.npz"), bundle.motion, bundle.robot.stance)


@pytest.mark.parametrize("degree", [1, 2])
def test_so_it_does_with_models_of_either_degree(reader: ModuleType, degree: int) -> None:
    rng = np.random.default_rng(degree)
    arrays = {}
    for name, shape in parameter_shapes(degree).items():
        values = rng.normal(size=shape)
        arrays[name] = values @ values.T if name.endswith("covariance") else values
    _same_predictions(reader, arrays, MotionModel(arrays, degree=degree, instant="touchdown"), rng.normal(size=(4, 3)))


def _same_predictions(
    reader: ModuleType, arrays: dict[str, np.ndarray], model: MotionModel, stance: np.ndarray
) -> None:
    rng = np.random.default_rng(0)
    for pair in (0, 1):
        for _ in range(5):
            velocity, before, reference = rng.normal(scale=0.4, size=(3, 3))
            feet = stance + rng.normal(scale=0.05, size=(4, 3))
            commands = rng.normal(scale=0.4, size=(3, 3))
            expected = model.predict(MotionState(velocity, before, reference, feet, pair), commands)
            state = {
                "velocity": velocity, "previous_velocity": before, "previous_reference": reference,
                "feet_base": feet, "swing_pair": pair,
            }  # fmt: skip
            for k, command in enumerate(commands):
                found = reader.predict(arrays, model.degree, state, command)
                for name, value in expected._asdict().items():
                    np.testing.assert_allclose(found[name], value[k], rtol=1e-9, atol=1e-12, err_msg=name)


def test_the_reader_runs_where_our_packages_are_not() -> None:
    code = (
        "import sys; sys.modules['legtool'] = sys.modules['legtool_runtime'] = None\n"
        "import runpy; sys.argv = ['read_bundle.py']; runpy.run_path('read_bundle.py', run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT / "examples"
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 13


@pytest.mark.parametrize("name", ["motion.npz", "CARD.md", MANIFEST])
def test_the_reader_refuses_what_was_changed(reader: ModuleType, name: str, tmp_path: Path) -> None:
    for item in SHIPPED.iterdir():
        (tmp_path / item.name).write_bytes(item.read_bytes())
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data.replace(b"go2", b"go3", 1) if name != "motion.npz" else data[:-1] + b"x")
    with pytest.raises(ValueError, match=r"was changed|is not the file"):
        reader.read_manifest(tmp_path)
