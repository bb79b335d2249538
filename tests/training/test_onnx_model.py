"""What is exported tells nothing of the machine that exported it."""

from pathlib import Path

import numpy as np
import onnx
import torch

import legtool
from legtool.training.onnx_model import stripped, to_onnx


class Net(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(3, 2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.relu(self.layer(x))


def test_a_model_holds_no_path_of_its_exporter_and_computes_the_same() -> None:
    torch.manual_seed(0)
    net = Net().eval()
    model = to_onnx(net, {"x": torch.zeros(1, 3)}, outputs=["y"], batched=True)
    for place in (torch.__file__, legtool.__file__, __file__):
        assert str(Path(place).parent).encode() not in model
    proto = onnx.load_model_from_string(model)
    assert not proto.metadata_props and not any(node.metadata_props or node.doc_string for node in proto.graph.node)
    assert stripped(model) == model
    import onnxruntime

    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    x = np.arange(6, dtype=np.float32).reshape(2, 3)
    with torch.no_grad():
        np.testing.assert_allclose(session.run(None, {"x": x})[0], net(torch.from_numpy(x)).numpy(), rtol=1e-6)
