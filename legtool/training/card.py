"""Write ``CARD.md``: the contents of a bundle, its data, its results and its limitations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from legtool_runtime.motion.features import TARGETS
from legtool_runtime.perception import LABELS
from legtool_runtime.robot import TROT_PAIR_NAMES

_MODELS = {
    "fdm": "displacement of the swing feet in the next step",
    "cdm": "displacement of the CoM, and change of yaw",
    "cvm": "CoM velocity after the step",
}
_UNITS = {"m": ("mm", 1e3), "rad": ("rad", 1.0), "m/s": ("m/s", 1.0), "rad/s": ("rad/s", 1.0), "1": ("%", 100.0)}
_INSTANTS = {
    "touchdown": "the moment at which the pair that swung has landed",
    "full_stance_end": "the end of full stance, just before the next pair lifts",
}


def write_card(manifest: Mapping[str, Any], *, name: str) -> str:
    """Return the text of the card.

    Args:
        manifest: manifest of the bundle, with its lines, their metrics and agreement.
        name: name of the directory of the bundle, for the example.
    """
    robot = manifest["robot"]["name"]
    lines = [
        f"# Bundle for {robot}",
        "",
        f"Made by legtool {manifest['provenance']['versions'].get('legtool', '?')}, "
        f"schema {manifest['schema_version']}. `bundle.json` contains the same information and more for programs.",
        "",
    ]
    if "motion" in manifest["lines"]:
        lines += _motion(manifest["lines"]["motion"], robot)
    for task in ("vfa", "vpa"):
        if task in manifest["lines"]:
            lines += _foothold(task, manifest["lines"][task], robot)
    if "steppability" in manifest["lines"]:
        lines += _steppability(manifest["lines"]["steppability"], robot)
    example = [_EXAMPLE] + [text for line, text in _EXAMPLES.items() if line in manifest["lines"]]
    lines += [
        "## Load it",
        "",
        "```python",
        *"\n".join(example).format(name=name).splitlines(),
        "```",
        "",
        "Loading verifies the size and SHA-256 of every file. That detects damage, not forgery: use bundles from "
        "people you trust.",
    ]
    return "\n".join(lines) + "\n"


def _recalibrated(data: Mapping[str, Any]) -> list[str]:
    noted = data.get("recalibrated")
    if noted is None:
        return []
    text = "Intervals were scaled to hold 90 % of the steps of other logs (split conformal): "
    return [f"{text}{noted['steps']} steps, data hash `{noted['hash']}`.", ""]


def _motion(line: Mapping[str, Any], robot: str) -> list[str]:
    data = line["provenance"]["data"]
    degree = "a second-order polynomial" if line["degree"] == 2 else "linear"
    out = [
        "## Motion models",
        "",
        f"What {robot} does in its next step when it is commanded to walk at a velocity: {degree} in 24 inputs "
        f"(formulation `{line['formulation']}`, estimator `{line['estimator']}`).",
        "",
        f"**States must be taken at `{line['instant']}`**, {_INSTANTS[line['instant']]}. At any other moment the "
        "answers are wrong.",
        "",
        "| model | gives | outputs |",
        "|---|---|---|",
        *(f"| {model.upper()} | {_MODELS[model]} | {', '.join(TARGETS[model])} |" for model in TARGETS),
        "",
        f"One model serves both swing pairs ({' and '.join(TROT_PAIR_NAMES)}): steps of the second are mirrored.",
        "",
        "### Data",
        "",
        f"{data.get('steps', '?')} steps, data hash `{data.get('hash', 'not recorded')}`.",
        "",
        *(f"- {count.replace('_', ' ')}: {value:g}" for count, value in data.get("counts", {}).items()),
        "",
        *_recalibrated(data),
        "### Results",
        "",
        *_metrics(line, "motion"),
        "### Frozen against trained",
        "",
        f"{line['agreement']['states']} random states, both pairs; largest difference in mean or standard deviation:",
        "",
        *_differences(line),
        "",
        "### Limitations",
        "",
        f"- The models hold for {robot} with the controller, gait, payload and flat ground of the data, and no other.",
        "- Standard deviations describe how steps scatter about the prediction; they do not cover terrain or slip.",
        "- Results of cross-validation within one log do not show another day, ground or payload.",
        f"- Inputs beyond this range ({line['range_of']}) are extrapolation:",
        "",
        "| input | from | to |",
        "|---|---|---|",
    ]
    for feature, unit in zip(line["features"], line["feature_units"], strict=True):
        low, high = line["range"][feature]
        out.append(f"| {feature} [{unit}] | {low:.3f} | {high:.3f} |")
    return [*out, ""]


_TASKS = {
    "vfa": (
        "Foothold selection (VFA)",
        "which cell of the heightmap around a nominal foothold is the safe one nearest it",
    ),
    "vpa": (
        "Safe footholds over hip heights (VPA)",
        "how many cells of the heightmap below a hip are safe, by its height",
    ),
}
_NETWORKS = {"paper": "the CNN of ViTAL's appendix A", "dense": "a dense network, which predicts the safe map"}


def _foothold(task: str, line: Mapping[str, Any], robot: str) -> list[str]:
    title, gives = _TASKS[task]
    data = line["provenance"]["data"]
    return [
        f"## {title}",
        "",
        f"For {robot}, {gives}: {_NETWORKS[line['network']]}. {line['size']} × {line['size']} cells of "
        f"{line['resolution_m']} m in the horizontal frame.",
        "",
        "Its labels come from the exact criteria with "
        + ", ".join(f"{name} {value:g}" for name, value in line["criteria"].items())
        + ". A network makes errors: where a foot must be safe, use `verified`, which checks its choice exactly.",
        "",
        "### Data",
        "",
        f"{data.get('rows', '?')} labelled heightmaps, data hash "
        f"`{line['provenance'].get('data_hash', 'not recorded')}`.",
        "",
        "### Results",
        "",
        *_metrics(line, task, depth=3),
        "### Frozen against trained",
        "",
        f"{line['agreement']['inputs']} random inputs; largest difference:",
        "",
        *_differences(line),
        "",
    ]


def _steppability(line: Mapping[str, Any], robot: str) -> list[str]:
    camera, data = line["sensor"]["camera"], line["provenance"]["data"]
    network = line["provenance"]["settings"]["network"]
    return [
        "## Steppability",
        "",
        f"What a foot of {robot} may do on each pixel of a depth image ({', '.join(line['labels'])}): DeepLabV3+ with "
        f"a {network['encoder']} encoder, trained on scenes of primitive shapes.",
        "",
        f"**Its camera**: {camera['width']} × {camera['height']} pixels, focal length {camera['fx']:.1f}. Images of "
        "another camera are rejected; those of a camera with another mount are segmented less well. Before the "
        f"segmentation, the runtime prepares an image by: {', '.join(line['preparation']) or 'nothing'}.",
        "",
        "### Data",
        "",
        f"{data.get('rows', '?')} frames, data hash `{line['provenance'].get('data_hash', 'not recorded')}`.",
        "",
        "### Results",
        "",
        *_metrics(line, "steppability", chosen=_STEPPABILITY_METRICS),
        "### Frozen against trained",
        "",
        f"{line['agreement']['images']} random images; largest difference:",
        "",
        *_differences(line),
        "",
        "### Limitations",
        "",
        "- It was trained on primitive shapes with simulated sensor defects. No real frame is labelled, so there are "
        "no results on real frames.",
        f"- Passable is what a swing of {line['swing_height_max']:g} m clears, measured from what lies beside it.",
        "",
    ]


def _differences(line: Mapping[str, Any]) -> list[str]:
    return [f"- {value:.1e} to {what}" for what, value in line["agreement"]["largest_difference"].items()]


def _metrics(line: Mapping[str, Any], name: str, *, chosen: Sequence[str] = (), depth: int | None = None) -> list[str]:
    """Table of a line's metrics, only the ``chosen`` ones where some are, or those whose names have ``depth`` parts."""
    if not line["metrics"]:
        return [
            f"Not evaluated. `legtool eval {name} RUN --out DIR` evaluates the run; then export it again "
            "to the same place.",
            "",
        ]
    evaluation = line["evaluation"]
    out = [
        f"On data that the models were not fitted to: {evaluation.get('split', 'held out')}, data hash "
        f"`{evaluation.get('data_hash')}`, seed {evaluation.get('seed')}.",
        "",
        "| metric | value | 95 % interval | n |",
        "|---|---|---|---|",
    ]
    for metric_name, metric in line["metrics"].items():
        if (chosen and metric_name not in chosen) or (depth and len(metric_name.split(".")) != depth):
            continue
        unit, factor = _UNITS.get(metric["unit"], (metric["unit"], 1.0))
        interval = "" if metric["ci95"] is None else " to ".join(f"{factor * end:.4g}" for end in metric["ci95"])
        out.append(f"| {metric_name} | {factor * metric['value']:.4g} {unit} | {interval} | {metric['n']} |")
    return [*out, ""]


#: The metrics of a segmenter that the card shows.
_STEPPABILITY_METRICS = (
    "steppability.miou",
    *(f"steppability.iou.{name}" for name in LABELS[1:]),
    "steppability.boundary.miou",
    "steppability.interior.miou",
)

_EXAMPLE = """\
import numpy as np
import legtool_runtime

bundle = legtool_runtime.load_bundle("{name}")
bundle.warm_up()
"""
_EXAMPLES = {
    "motion": """\
state = legtool_runtime.MotionState(
    velocity=[0.3, 0.0, 0.0],  # vx, vy [m/s], yaw rate [rad/s], base frame
    previous_velocity=[0.3, 0.0, 0.0],  # one step ago
    previous_reference=[0.3, 0.0, 0.0],  # the command of the step that ends now
    feet_base=bundle.robot.stance,  # (4, 3) FL, FR, RL, RR relative to the CoM [m]
    swing_pair=0,  # FL+RR swings next
)
commands = np.array([[vx, 0.0, 0.0] for vx in np.linspace(0.0, 0.5, 6)])
step = bundle.motion.predict(state, commands)
print(step.com_displacement[:, 0], step.com_displacement_std[:, 0])
""",
    "vfa": """\
from legtool_runtime.foothold import Criteria, Gait, Tuple
from legtool_runtime.foothold.selection import FootholdSelector

selector = FootholdSelector(Criteria(bundle.robot, bundle.vfa.criteria), method="verified", network=bundle.vfa)
t = Tuple(
    np.zeros((33, 33)),  # heights around the nominal foothold [m]
    leg=0,
    hip_height=bundle.robot.standing_height,
    base_twist=(0.3, 0.0, 0.0, 0.0, 0.0, 0.0),
    gait=Gait(step_length_m=0.2),
    nominal=(0.0, 0.0),  # from below the hip [m]
    pitch=-0.1,  # of the trunk, nose up [rad]
)
print(selector.select(t))
""",
    "vpa": """\
from legtool_runtime.foothold import Gait, Tuple

twist = (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
below = [Tuple(np.zeros((33, 33)), leg=leg, base_twist=twist, gait=Gait()) for leg in range(4)]  # the hips
print(bundle.vpa.counts(below)[:, ::10])
""",
    "steppability": """\
from legtool_runtime.perception.chain import Perception

sensor = bundle.steppability.sensor
depth = np.full((sensor.camera.height, sensor.camera.width), 0.8)  # [m], or uint16 in millimetres
with Perception(
    sensor.camera,
    sensor.transform_camera_to_base,
    standing_height=sensor.standing_height,
    segment=bundle.steppability,  # on a background thread
) as perception:
    base_to_world = np.eye(4)
    base_to_world[2, 3] = sensor.standing_height
    terrain = perception.update(depth, base_to_world)
    print(len(terrain.regions), "regions")
""",
}
