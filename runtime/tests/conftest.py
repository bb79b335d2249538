"""What the runtime's tests share: a robot, models of random parameters, and a plain writer of bundles."""

from __future__ import annotations

import hashlib
import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from legtool_runtime import MotionModel, MotionState, Robot
from legtool_runtime.bundle import KIND, MANIFEST, SCHEMA_VERSION, content_sha256
from legtool_runtime.lines import motion_interface
from legtool_runtime.motion.features import REFERENCE, TARGET_SIGN, TARGETS, canonical_features
from legtool_runtime.motion.kernels import design
from legtool_runtime.motion.model import parameter_shapes
from legtool_runtime.robot import TROT_PAIRS

# Tests import the modules that they share (onnx_writer): importlib mode puts no folder on the path.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def robot() -> Robot:
    side = np.array([1.0, -1.0, 1.0, -1.0])
    hips = np.stack([[0.24, 0.24, -0.24, -0.24], 0.05 * side, np.zeros(4)], axis=1)
    return Robot(
        name="testdog",
        hips=hips,
        abduction_offset=0.083 * side,
        thigh_length=np.full(4, 0.25),
        shank_length=np.full(4, 0.25),
        knee_sign=np.full(4, -1.0),
        joint_limits=np.tile([[-1.0, 1.0], [-1.0, 4.0], [-2.7, -0.6]], (4, 1, 1)),
        foot_radius=0.02,
        stance=hips + np.stack([np.zeros(4), 0.083 * side, np.full(4, -0.38)], axis=1),
    )


@pytest.fixture(scope="session")
def parameters() -> Callable[[int], dict[str, np.ndarray]]:
    def make(degree: int) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(degree)
        out = {}
        for name, shape in parameter_shapes(degree).items():
            value = rng.normal(size=shape)
            out[name] = value @ value.T / shape[0] if name.endswith("covariance") else value
        return out

    return make


@pytest.fixture(scope="session")
def model(parameters: Callable[[int], dict[str, np.ndarray]]) -> Callable[[int], MotionModel]:
    models = {d: MotionModel(parameters(d), degree=d, instant="full_stance_end") for d in (1, 2)}
    return lambda degree: models[degree]


@pytest.fixture(scope="session")
def random_state() -> Callable[[np.random.Generator], MotionState]:
    def make(rng: np.random.Generator) -> MotionState:
        return MotionState(*rng.normal(size=(3, 3)), rng.normal(size=(4, 3)), int(rng.integers(2)))

    return make


@pytest.fixture(scope="session")
def reference() -> Callable[..., dict[str, Any]]:
    """Means and covariances by the formulas of the model's docstring, one command after another, in plain numpy."""

    def predict(
        parameters: dict[str, np.ndarray], degree: int, state: MotionState, commands: np.ndarray
    ) -> dict[str, Any]:
        features = np.tile(state.features, (len(commands), 1))
        features[:, REFERENCE] = commands
        pair = np.full(len(commands), state.swing_pair, dtype=np.int8)
        phi = design(canonical_features(features, pair), degree)
        out: dict[str, Any] = {"swing": list(TROT_PAIRS[state.swing_pair])}
        for name in TARGETS:
            sign = TARGET_SIGN[name] if state.swing_pair == 1 else 1.0
            mean = phi[:, 1:] @ parameters[f"{name}.coefficients"].T + parameters[f"{name}.intercept"]
            spread = np.einsum("ni,ij,nj->n", phi, parameters[f"{name}.weights_covariance"], phi)
            noise = parameters[f"{name}.noise_covariance"] * np.outer(sign, sign)
            out[name] = (mean * sign, (1 + spread)[:, None, None] * noise)
        return out

    return predict


@pytest.fixture
def write_bundle(
    tmp_path: Path, robot: Robot, parameters: Callable[[int], dict[str, np.ndarray]]
) -> Callable[..., Path]:
    """Write a bundle; keyword arguments replace parts of it, and the digests are made to fit."""

    def write(
        *,
        degree: int = 1,
        arrays: dict[str, Any] | None = None,
        npz: bytes | None = None,
        files: list[Any] | None = None,
        motion: dict[str, Any] | None = None,
        **manifest_changes: Any,
    ) -> Path:
        path = tmp_path / "bundle"
        path.mkdir(exist_ok=True)
        if npz is None:
            buffer = io.BytesIO()
            np.savez(buffer, **{**parameters(degree), **(arrays or {})})
            npz = buffer.getvalue()
        (path / "motion.npz").write_bytes(npz)
        (path / "CARD.md").write_text("# testdog\n")
        listed = [
            {"name": f.name, "bytes": f.stat().st_size, "sha256": hashlib.sha256(f.read_bytes()).hexdigest()}
            for f in (path / "CARD.md", path / "motion.npz")
        ]
        description = {"instant": "full_stance_end", "degree": degree, "metrics": {}, **motion_interface()}
        manifest = {
            "schema_version": SCHEMA_VERSION,
            "kind": KIND,
            "robot": robot.to_dict(),
            "lines": {"motion": {**description, **(motion or {})}},
            "provenance": {},
            "files": listed if files is None else files,
            **manifest_changes,
        }
        manifest["content_sha256"] = content_sha256(manifest)
        (path / MANIFEST).write_text(json.dumps(manifest, indent=2))
        return path

    return write
