"""Read a bundle without our packages, and predict with it: what a reader in another language has to do.

python examples/read_bundle.py [BUNDLE]      # by default a small one of Go2 under the built-in trot, beside this file

NumPy is all that it needs, and onnxruntime for networks. docs/bundle_format.md describes the files.
"""

from __future__ import annotations

import hashlib
import json
import sys
import zipfile
from pathlib import Path

import numpy as np

#: Of the pair that swings, front leg first; legs are FL, FR, RL, RR.
PAIRS = ((0, 3), (1, 2))
#: The canonical input of each leg's three numbers, and the signs with which a step of FR+RL becomes one of FL+RR.
SWAPPED_LEGS = (1, 0, 3, 2)
PLANAR_SIGN, POINT_SIGN = np.array([1.0, -1.0, -1.0]), np.array([1.0, -1.0, 1.0])
SIGNS = {
    "fdm": np.tile(POINT_SIGN, 2),
    "cdm": np.array([1.0, -1.0, 1.0, -1.0]),
    "cvm": PLANAR_SIGN,
}


def read_manifest(path: Path) -> dict:
    """Read ``bundle.json`` and verify what it says of itself and of every other file.

    Args:
        path: the bundle's directory.

    Raises:
        ValueError: another kind or schema, or a file that is not the one that was exported.
    """
    manifest = json.loads((path / "bundle.json").read_text(encoding="utf-8"))
    if (manifest["kind"], manifest["schema_version"]) != ("bundle", 1):
        raise ValueError(f"{path}: {manifest['kind']} of schema {manifest['schema_version']}, expected bundle of 1")
    content = {key: value for key, value in manifest.items() if key != "content_sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    if hashlib.sha256(text.encode()).hexdigest() != manifest["content_sha256"]:
        raise ValueError(f"{path}: bundle.json was changed since it was written")
    for entry in manifest["files"]:
        data = (path / entry["name"]).read_bytes()
        if len(data) != entry["bytes"] or hashlib.sha256(data).hexdigest() != entry["sha256"]:
            raise ValueError(f"{path / entry['name']}: is not the file that was exported")
    return manifest


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an ``.npz``: a ZIP archive of ``.npy`` files, here all of version 1.0 and little-endian float64."""
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            data = archive.read(member)
            assert data[:8] == b"\x93NUMPY\x01\x00"
            length = int.from_bytes(data[8:10], "little")
            header = data[10 : 10 + length].decode("latin1")
            assert "'descr': '<f8'" in header and "'fortran_order': False" in header
            shape = header.partition("'shape': (")[2].partition(")")[0]
            sizes = [int(size) for size in shape.split(",") if size.strip()]
            arrays[member.removesuffix(".npy")] = np.frombuffer(data, "<f8", offset=10 + length).reshape(sizes)
    return arrays


def predict(arrays: dict[str, np.ndarray], degree: int, state: dict, command: np.ndarray) -> dict[str, np.ndarray]:
    """Mean and standard deviation of a robot's next step, for one command.

    Args:
        arrays: of ``motion.npz``.
        degree: of the motion line.
        state: ``velocity``, ``previous_velocity``, ``previous_reference`` (3,), ``feet_base`` (4, 3), ``swing_pair``.
        command: (3,) vx, vy [m/s], yaw rate [rad/s].

    Returns:
        ``foot_displacement`` (4, 3), ``com_displacement`` (4,), ``velocity`` (3,), and each with ``_std``.
    """
    feet, mirrored = np.asarray(state["feet_base"]), state["swing_pair"] == 1
    planar = [state["velocity"], state["previous_velocity"], command, state["previous_reference"]]
    if mirrored:
        planar = [PLANAR_SIGN * values for values in planar]
        feet = POINT_SIGN * feet[list(SWAPPED_LEGS)]
    x = np.concatenate([*planar, feet.ravel()])
    products = [x[i] * x[j] for i in range(x.size) for j in range(i, x.size)] if degree == 2 else []
    design = np.concatenate([[1.0], x, products])
    found = {}
    for name, sign in SIGNS.items():
        mean = arrays[f"{name}.intercept"] + arrays[f"{name}.coefficients"] @ design[1:]
        spread = 1.0 + design @ arrays[f"{name}.weights_covariance"] @ design
        found[name] = sign * mean if mirrored else mean
        found[f"{name}_std"] = np.sqrt(np.diag(arrays[f"{name}.noise_covariance"]) * spread)
    steps = np.zeros((2, 4, 3))  # stance feet stay
    for k, key in enumerate(("fdm", "fdm_std")):
        steps[k, list(PAIRS[state["swing_pair"]])] = found[key].reshape(2, 3)
    return {
        "foot_displacement": steps[0],
        "foot_displacement_std": steps[1],
        "com_displacement": found["cdm"],
        "com_displacement_std": found["cdm_std"],
        "velocity": found["cvm"],
        "velocity_std": found["cvm_std"],
    }


def prepare(depth: np.ndarray, steps: list[str]) -> np.ndarray:
    """What the steppability line's ``preparation`` names, done to a depth image (h, w) [m], NaN without return."""
    for step in steps:
        depth = {"decimate": _decimate, "fill_holes": _fill_holes}[step](depth)
    return depth


def _decimate(depth: np.ndarray) -> np.ndarray:
    """Of each block of 2 × 2 the nearer middle one of its returns."""
    h, w = depth.shape[0] // 2, depth.shape[1] // 2
    blocks = depth[: 2 * h, : 2 * w].reshape(h, 2, w, 2).swapaxes(1, 2).reshape(h, w, 4)
    ordered = np.sort(blocks, axis=-1)  # NaN last
    return np.where(np.isfinite(blocks).sum(axis=-1) >= 3, ordered[..., 1], ordered[..., 0])


def _fill_holes(depth: np.ndarray) -> np.ndarray:
    """Four times: where at least four of eight neighbours are known, the farthest of them."""
    for _ in range(4):
        padded = np.pad(depth, 1, constant_values=np.nan)
        h, w = depth.shape
        around = np.stack([padded[j : j + h, i : i + w] for j in range(3) for i in range(3) if (j, i) != (1, 1)])
        known = np.isfinite(around)
        farthest = np.where(known, around, -np.inf).max(axis=0)
        depth = np.where(np.isnan(depth) & (known.sum(axis=0) >= 4), farthest, depth).astype(np.float32)
    return depth


def segment(path: Path, line: dict, depth: np.ndarray) -> np.ndarray:
    """Labels of a depth image after its preparation: 0 unknown, 1 steppable, 2 passable, 3 non-passable.

    Args:
        path: the bundle's directory.
        line: its steppability line.
        depth: (h, w) float32 [m] of the line's ``sensor``, NaN where there is no return.
    """
    import onnxruntime

    prepared = prepare(depth, line["preparation"])
    fed = np.where(np.isfinite(prepared), prepared, 0).astype(np.float32)[None, None]
    session = onnxruntime.InferenceSession(path / "steppability.onnx", providers=["CPUExecutionProvider"])
    (labels,) = session.run(["label"], {"depth": fed})
    return labels[0]


def main(path: Path) -> None:
    """Print where the front left foot of a standing robot will land, for eleven forward commands."""
    manifest = read_manifest(path)
    line = manifest["lines"]["motion"]
    arrays = read_arrays(path / "motion.npz")
    rest = np.zeros(3)
    state = {
        "velocity": rest,
        "previous_velocity": rest,
        "previous_reference": rest,
        "feet_base": np.array(manifest["robot"]["stance"]),
        "swing_pair": 0,
    }
    print(f"{manifest['robot']['name']}, states at {line['instant']}\nvx [m/s]  foot [m]  ± 90 %  CoM [m]")
    for vx in np.arange(0.0, 1.01, 0.1):
        step = predict(arrays, line["degree"], state, np.array([vx, 0.0, 0.0]))
        foot, spread = step["foot_displacement"][0, 0], 1.645 * step["foot_displacement_std"][0, 0]
        print(f"{vx:8.1f}  {foot:8.3f}  {spread:6.3f}  {step['com_displacement'][0]:7.3f}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "bundle")
    except (OSError, ValueError, KeyError) as error:
        sys.exit(f"error: {error}")
