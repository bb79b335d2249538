"""The JSON schema of ``bundle.json``, made from what the runtime checks when it loads a bundle.

python docs/bundle_schema.py      # writes docs/bundle.schema.json, which the site offers
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from legtool_runtime.bundle import KIND, MANIFEST, SCHEMA_VERSION
from legtool_runtime.foothold.networks import KINDS, foothold_interface
from legtool_runtime.foothold.settings import CriteriaSettings
from legtool_runtime.lines import LINES, motion_interface
from legtool_runtime.motion.model import DEGREES, INSTANTS
from legtool_runtime.perception.depth import STEPS
from legtool_runtime.perception.steppability import steppability_interface

PATH = Path(__file__).parent / "bundle.schema.json"
_NUMBER: dict[str, Any] = {"type": "number"}
_TEXT: dict[str, Any] = {"type": "string"}
_OBJECT: dict[str, Any] = {"type": "object"}
_POSITIVE: dict[str, Any] = {"type": "number", "exclusiveMinimum": 0}
_SHA256 = {"type": "string", "pattern": "^[0-9a-f]{64}$"}


def _array(*shape: int, of: dict[str, Any] = _NUMBER) -> dict[str, Any]:
    """Nested lists of a shape."""
    for size in reversed(shape):
        of = {"type": "array", "minItems": size, "maxItems": size, "items": of}
    return of


def _object(required: dict[str, Any], optional: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """An object; other keys than those named may stand in it unless ``more`` forbids them."""
    return {**_OBJECT, "required": list(required), "properties": {**required, **(optional or {})}, **more}


def _told(text: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"description": text, **schema}


def _robot() -> dict[str, Any]:
    per_leg = "legs FL, FR, RL, RR"
    return _object(
        {
            "name": _TEXT,
            "hips": _told(f"origin of each abduction axis, {per_leg}, base frame [m]", _array(4, 3)),
            "abduction_offset": _told("from the abduction axis to the thigh axis, + to the left [m]", _array(4)),
            "thigh_length": _told("[m]", _array(4, of=_POSITIVE)),
            "shank_length": _told("knee to the centre of the foot sphere [m]", _array(4, of=_POSITIVE)),
            "knee_sign": _told("-1: knee behind the line from hip to foot, +1: before it", _array(4)),
            "joint_limits": _told(
                "lower and upper limit of hip (abduction), thigh and knee of each leg [rad]", _array(4, 3, 2)
            ),
            "foot_radius": _told("[m]", {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}),
            "stance": _told("centres of the feet when standing at rest, base frame [m]", _array(4, 3)),
        },
        additionalProperties=False,
    )


def _consts(interface: dict[str, Any]) -> dict[str, Any]:
    """What a line must say word for word, or it would be misread."""
    return {name: {"const": value} for name, value in interface.items()}


def _lines() -> dict[str, Any]:
    metric = _object(
        {"value": _NUMBER, "ci95": {"anyOf": [{"type": "null"}, _array(2)]}, "n": {"type": "integer"}, "unit": _TEXT}
    )
    metrics = _told("held-out figures by name; empty if none were", {**_OBJECT, "additionalProperties": metric})
    common = {"provenance": _OBJECT, "evaluation": _OBJECT, "agreement": {"type": ["object", "null"]}}
    interface = motion_interface()
    motion = _object(
        {
            "instant": _told("of a step at which states are to be taken", {"enum": list(INSTANTS)}),
            "degree": _told("of the polynomial in the inputs", {"enum": list(DEGREES)}),
            **_consts(interface),
            "metrics": metrics,
        },
        {
            "formulation": _TEXT,
            "estimator": _TEXT,
            "range": _told(
                "smallest and largest value of each input, canonical",
                {**_OBJECT, "properties": {name: _array(2) for name in interface["features"]}},
            ),
            "range_of": _told("what the range is that of", {"enum": ["training data", "a walking robot"]}),
            **common,
        },
    )
    criteria = _object({name: _NUMBER for name in CriteriaSettings.__dataclass_fields__}, additionalProperties=False)
    foothold = _object(
        {
            **_consts(foothold_interface()),
            "network": {"enum": list(KINDS)},
            "criteria": _told("thresholds that the labels were judged by", criteria),
            "metrics": metrics,
        },
        common,
    )
    camera = _object({name: _NUMBER for name in ("width", "height", "fx", "fy", "cx", "cy")})
    steppability = _object(
        {
            **_consts(steppability_interface()),
            "preparation": _told("done to each image, in order", {"type": "array", "items": {"enum": list(STEPS)}}),
            "sensor": _object(
                {
                    "camera": _told("intrinsics of the image before its preparation [pixel]", camera),
                    "transform_camera_to_base": _told("of the optical frame, x right, y down, z forward", _array(4, 4)),
                    "standing_height": _told("of the base above the ground [m]", _POSITIVE),
                }
            ),
            "metrics": metrics,
        },
        {"input": _OBJECT, "outputs": {"type": "array", "items": _TEXT}, "swing_height_max": _NUMBER, **common},
    )
    known = {"motion": motion, "vfa": foothold, "vpa": foothold, "steppability": steppability}
    return {**_OBJECT, "properties": {name: known[name] for name in LINES}, "additionalProperties": False}


def schema() -> dict[str, Any]:
    """The schema, draft 2020-12. Digests and the files themselves are beyond what a schema can check."""
    entry = _object(
        {
            "name": {"type": "string", "pattern": "^[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}$"},
            "bytes": {"type": "integer", "minimum": 0},
            "sha256": _SHA256,
        },
        additionalProperties=False,
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{MANIFEST} of a legtool bundle",
        **_object(
            {
                "schema_version": {"const": SCHEMA_VERSION},
                "kind": {"const": KIND},
                "robot": _robot(),
                "lines": _lines(),
                "provenance": _OBJECT,
                "files": _told(f"every file but {MANIFEST}", {"type": "array", "items": entry}),
                "content_sha256": _told("of all else in this file, see docs/bundle_format.md", _SHA256),
            }
        ),
    }


if __name__ == "__main__":
    PATH.write_text(json.dumps(schema(), indent=2) + "\n", encoding="utf-8")
