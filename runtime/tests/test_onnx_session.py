import sys

import numpy as np
import onnxruntime
import pytest
from onnx_writer import FLOAT, model, node

from legtool_runtime.errors import BundleError, PerceptionError
from legtool_runtime.onnx_session import OnnxSession, Port, running_on

SUM = model(
    [node("Add", ["a", "b"], "sum"), node("Sub", ["a", "b"], "difference")],
    {"a": ("n", 3), "b": ("n", 3)},
    {"sum": (FLOAT, ("n", 3)), "difference": (FLOAT, ("n", 3))},
)
ONES = np.ones((2, 3), np.float32)
BOTH = ["CUDAExecutionProvider", "CPUExecutionProvider"]


def test_a_model_says_what_it_takes_and_gives():
    session = OnnxSession(SUM, what="sum", error=BundleError)
    assert session.inputs == (Port("a", "tensor(float)", (None, 3)), Port("b", "tensor(float)", (None, 3)))
    assert [port.name for port in session.outputs] == ["sum", "difference"]
    assert str(session.inputs[0]) == "a tensor(float) (any, 3)"
    assert session.inputs[0].fits((7, 3)) and session.inputs[0].fits((None, 3))
    assert not session.inputs[0].fits((7, 4)) and not session.inputs[0].fits((3,))


def test_outputs_come_in_order_all_or_those_asked_for(tmp_path):
    path = tmp_path / "sum.onnx"
    path.write_bytes(SUM)
    session = OnnxSession(path, what="sum", error=BundleError)
    total, difference = session.run({"a": ONES, "b": ONES})
    assert (total == 2).all() and (difference == 0).all()
    (difference,) = session.run({"a": ONES, "b": -ONES}, ["difference"])
    assert (difference == 2).all()


def test_what_does_not_fit_is_told_with_what_the_model_takes():
    session = OnnxSession(SUM, what="sum", error=BundleError)
    with pytest.raises(
        BundleError, match=r"sum: given a \(3, 2\), b \(2, 3\), .* takes a tensor\(float\) \(any, 3\); b"
    ):
        session.run({"a": ONES.T, "b": ONES})


@pytest.mark.parametrize("content", [b"", b"not a model", SUM[:60]])
def test_what_is_no_model_is_refused_with_the_callers_error(tmp_path, content):
    path = tmp_path / "sum.onnx"
    path.write_bytes(content)
    with pytest.raises(PerceptionError, match=r"sum\.onnx: not an ONNX model that onnxruntime can run"):
        OnnxSession(path, what="sum", error=PerceptionError)
    with pytest.raises(BundleError, match=r"^sum: not an ONNX model"):
        OnnxSession(content, what="sum", error=BundleError)
    with pytest.raises(BundleError, match=r"missing\.onnx: cannot be read \(No such file"):
        OnnxSession(tmp_path / "missing.onnx", what="sum", error=BundleError)


def test_a_provider_that_onnxruntime_lacks_is_told_with_those_that_it_has():
    with running_on(["TensorrtExecutionProvider"]), pytest.raises(BundleError, match=r"has no Tensorrt.*has .*CPUExec"):
        OnnxSession(SUM, what="sum", error=BundleError)
    with running_on(["CPUExecutionProvider"]):
        assert OnnxSession(SUM, what="sum", error=BundleError).inputs
    with running_on([]):
        assert OnnxSession(SUM, what="sum", error=BundleError).inputs


def test_the_providers_are_handed_to_onnxruntime_in_their_order(monkeypatch):
    given = []
    original = onnxruntime.InferenceSession

    def session(*arguments, providers):
        given.append(providers)
        return original(*arguments, providers=["CPUExecutionProvider"])

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: list(BOTH))
    with running_on(BOTH):
        OnnxSession(SUM, what="sum", error=BundleError)
    OnnxSession(SUM, what="sum", error=BundleError)
    assert given == [BOTH, ["CPUExecutionProvider"]]


def test_without_onnxruntime_a_network_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(BundleError, match="sum: needs onnxruntime, which is not installed; pip install onnxruntime"):
        OnnxSession(SUM, what="sum", error=BundleError)
