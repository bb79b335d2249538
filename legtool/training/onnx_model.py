"""Export networks as ONNX models."""

from __future__ import annotations

import contextlib
import io
import logging
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
from google.protobuf.message import Message
from torch import Tensor, nn

_OPSET = 18


def to_onnx(net: nn.Module, inputs: Mapping[str, Tensor], *, outputs: Sequence[str], batched: bool = False) -> bytes:
    """Return an ONNX model of a network that contains its weights.

    Args:
        net: the network, in evaluation mode.
        inputs: example inputs by name, in order.
        outputs: names of the outputs.
        batched: whether the first dimension of all inputs may have any length.
    """
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    batch = torch.export.Dim("batch", min=1, max=4096)
    with (
        tempfile.TemporaryDirectory() as place,
        warnings.catch_warnings(),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            net,
            tuple(inputs.values()),
            input_names=list(inputs),
            output_names=list(outputs),
            opset_version=_OPSET,
            dynamo=True,
            dynamic_shapes=tuple({0: batch} for _ in inputs) if batched else None,
        )
        assert program is not None
        path = Path(place) / "model.onnx"
        program.save(path, external_data=False)
        return stripped(path.read_bytes())


def stripped(model: bytes) -> bytes:
    """An ONNX model without what its exporter tells of itself: traces with paths of its machine, and documentation.

    The bytes depend on the network alone, and not on where its exporter is installed.
    """
    proto = onnx.load_model_from_string(model)
    pending: list[Any] = [proto]
    while pending:
        message = pending.pop()
        for name in ("metadata_props", "doc_string"):
            if name in message.DESCRIPTOR.fields_by_name:
                message.ClearField(name)
        for field, value in message.ListFields():
            if field.message_type is not None:
                pending += [value] if isinstance(value, Message) else value
    return bytes(proto.SerializeToString(deterministic=True))
