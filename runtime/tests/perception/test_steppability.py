import base64
import threading
import time

import numpy as np
import pytest
from onnx_writer import FLOAT, UINT8, model, node

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import LABELS, NON_PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception.steppability import LabelThread, Segmenter

# ONNX models of one or three nodes. Labels: non-passable beyond 1 m, else steppable, (1, h, w) uint8.
BY_DEPTH = base64.b64decode(
    "CAg6xQEKGgoFZGVwdGgKA29uZRIDZmFyIgdHcmVhdGVyChYKA2ZhcgoBYQoBYhICbDQiBVdoZXJlChkKAmw0CgJheBIGbGFiZWxzIgdTcXVlZXplEgFn"
    "Kg0QASIEAACAP0IDb25lKggQAioBA0IBYSoIEAIqAQFCAWIqCwgBEAc6AQFCAmF4WiEKBWRlcHRoEhgKFggBEhIKAggBCgIIAQoDEgFoCgMSAXdiHgoG"
    "bGFiZWxzEhQKEggCEg4KAggBCgMSAWgKAxIBd0IECgAQDQ=="
)
# The same, for images of 60 × 80 alone.
BY_DEPTH_60_80 = base64.b64decode(
    "CAg6wQEKGgoFZGVwdGgKA29uZRIDZmFyIgdHcmVhdGVyChYKA2ZhcgoBYQoBYhICbDQiBVdoZXJlChkKAmw0CgJheBIGbGFiZWxzIgdTcXVlZXplEgFn"
    "Kg0QASIEAACAP0IDb25lKggQAioBA0IBYSoIEAIqAQFCAWIqCwgBEAc6AQFCAmF4Wh8KBWRlcHRoEhYKFAgBEhAKAggBCgIIAQoCCDwKAghQYhwKBmxh"
    "YmVscxISChAIAhIMCgIIAQoCCDwKAghQQgQKABAN"
)
# Logits (depth, -depth, -depth), and with four classes.
LOGITS = base64.b64decode(
    "CAg6hAEKGQoFZGVwdGgKA29uZRIGbG9naXRzIgNNdWwSAWcqHQgBCAMIAQgBEAEiDAAAgD8AAIC/AACAv0IDb25lWiEKBWRlcHRoEhgKFggBEhIKAggB"
    "CgIIAQoDEgFoCgMSAXdiIgoGbG9naXRzEhgKFggBEhIKAggBCgIIAwoDEgFoCgMSAXdCBAoAEA0="
)
FOUR_CLASSES = base64.b64decode(
    "CAg6iAEKGQoFZGVwdGgKA29uZRIGbG9naXRzIgNNdWwSAWcqIQgBCAQIAQgBEAEiEAAAgD8AAIC/AACAvwAAgL9CA29uZVohCgVkZXB0aBIYChYIARIS"
    "CgIIAQoCCAEKAxIBaAoDEgF3YiIKBmxvZ2l0cxIYChYIARISCgIIAQoCCAQKAxIBaAoDEgF3QgQKABAN"
)


@pytest.mark.parametrize("steps", [(), ("decimate", "fill_holes")])
@pytest.mark.parametrize("size", [(120, 160), (121, 161)])
def test_labels_lie_on_the_pixels_they_belong_to(size, steps):
    depth = np.full(size, 0.5, dtype=np.float32)
    depth[:, 60:] = 2.0
    depth[10:20, 10:20] = np.nan
    labels = Segmenter(BY_DEPTH, steps=steps)(depth)
    expected = np.where(depth > 1, NON_PASSABLE, STEPPABLE)
    expected[np.isnan(depth)] = UNKNOWN
    expected[120:], expected[:, 160:] = (UNKNOWN, UNKNOWN) if steps else (expected[120:], expected[:, 160:])
    assert labels.dtype == np.uint8
    np.testing.assert_array_equal(labels, expected)


def test_logits_become_labels():
    labels = Segmenter(LOGITS, steps=())(np.full((48, 64), 0.5, dtype=np.float32))
    assert (labels == STEPPABLE).all()


def segmenter_of(logits, *, labels=False):
    """A model for any image: nodes that make ``logits`` (1, 3, h, w); ``labels``: it gives their argmax, too."""
    nodes, outputs = list(logits), {"logits": (FLOAT, (1, 3, "h", "w"))}
    constants = {
        "weights": np.array([1, -1, -2], np.float32).reshape(1, 3, 1, 1),
        "four": np.array(4, np.float32),
        "hundred": np.array(100, np.float32),
        "one": np.array(1, np.int64),
    }
    if labels:
        nodes += [
            node("ArgMax", ["logits"], "best", axis=1, keepdims=0),
            node("Add", ["best", "one"], "number"),
            node("Cast", ["number"], "label", to=UINT8),
        ]
        outputs = {"label": (UINT8, (1, "h", "w")), **outputs}
    return model(nodes, {"depth": (1, 1, "h", "w")}, outputs, constants)


#: Logits that are finite up to 4 m: roots of 4 - depth, NaN beyond; powers of e that overflow.
NAN_BEYOND_FOUR = [
    node("Sub", ["four", "depth"], "left"),
    node("Sqrt", ["left"], "root"),
    node("Mul", ["root", "weights"], "logits"),
]
INFINITE_BEYOND_FOUR = [
    node("Sub", ["depth", "four"], "over"),
    node("Mul", ["over", "hundred"], "power"),
    node("Exp", ["power"], "large"),
    node("Mul", ["large", "weights"], "logits"),
]


@pytest.mark.parametrize("labels", [False, True])
@pytest.mark.parametrize("logits", [NAN_BEYOND_FOUR, INFINITE_BEYOND_FOUR])
def test_pixels_whose_logits_are_not_finite_are_unknown(logits, labels):
    depth = np.full((48, 64), 2.0, dtype=np.float32)
    depth[:, 30:] = 6.0
    seen = Segmenter(segmenter_of(logits, labels=labels), steps=())(depth)
    assert (seen[:, :30] == STEPPABLE).all()
    assert (seen[:, 30:] == UNKNOWN).all()


@pytest.mark.parametrize("labels", [False, True])
@pytest.mark.parametrize("sign", ["zero", "below_zero"])
def test_a_segmenter_whose_logits_are_never_finite_is_refused(sign, labels):
    # Roots of what is below zero are NaN, quotients by zero infinite.
    damaged = [
        node("Sub", ["depth", "depth"], "zero"),
        node("Sub", ["zero", "depth"], "below_zero"),
        node("Div", ["depth", "zero"], "x") if sign == "zero" else node("Sqrt", ["below_zero"], "x"),
        node("Mul", ["x", "weights"], "logits"),
    ]
    with pytest.raises(PerceptionError, match=r"logits for level ground are not finite.*train it anew"):
        Segmenter(segmenter_of(damaged, labels=labels), steps=())


def test_a_model_is_read_from_a_file(tmp_path):
    path = tmp_path / "steppability.onnx"
    path.write_bytes(LOGITS)
    assert Segmenter(path, steps=())(np.ones((48, 64), dtype=np.float32)).shape == (48, 64)


def test_a_model_with_another_class_list_is_refused():
    with pytest.raises(PerceptionError, match="tells apart steppable, lava; this runtime expects steppable, passable"):
        Segmenter(LOGITS, classes=("steppable", "lava"))
    with pytest.raises(PerceptionError, match="in this order"):
        Segmenter(LOGITS, classes=LABELS[:0:-1])
    with pytest.raises(PerceptionError, match=r"outputs logits .*\(1, 4, any, any\), expected labels"):
        Segmenter(FOUR_CLASSES)


def test_a_model_for_images_of_another_size_is_refused():
    depth = np.ones((120, 160), dtype=np.float32)
    assert (Segmenter(BY_DEPTH_60_80)(depth) == STEPPABLE).all()
    with pytest.raises(
        PerceptionError, match=r"made for images of 80 × 60 after preparation \(none\).*gives 160 × 120"
    ):
        Segmenter(BY_DEPTH_60_80, steps=())(depth)


@pytest.mark.parametrize("content", [b"", b"not a model", BY_DEPTH[:100]])
def test_what_is_no_model_is_refused(tmp_path, content):
    path = tmp_path / "steppability.onnx"
    path.write_bytes(content)
    with pytest.raises(PerceptionError, match=r"steppability\.onnx: not an ONNX model"):
        Segmenter(path)
    with pytest.raises(PerceptionError, match=r"missing\.onnx: cannot be read"):
        Segmenter(tmp_path / "missing.onnx")


class Slow:
    """A segmenter that finishes an image when told to."""

    def __init__(self):
        self.seen, self.go = [], threading.Semaphore(0)

    def __call__(self, depth):
        self.seen.append(depth)
        assert self.go.acquire(timeout=10)
        return np.full(depth.shape, STEPPABLE, dtype=np.uint8)


def wait_for(condition):
    """Wait until a condition gives something, and return that."""
    end = time.monotonic() + 10
    while not (result := condition()):
        assert time.monotonic() < end
        time.sleep(0.001)
    return result


def image(value):
    return np.full((4, 4), value, dtype=np.float32)


def test_no_one_waits_for_labels_and_the_newest_image_is_next():
    slow = Slow()
    thread = LabelThread(slow)
    start = time.perf_counter()
    for n in range(5):
        thread.submit(n, image(n))
        if n == 0:
            wait_for(lambda: slow.seen)
        assert thread.take() is None
    assert time.perf_counter() - start < 5
    done = []
    for _ in range(2):
        slow.go.release()
        done.append(wait_for(thread.take))
    thread.close()
    assert [d.tag for d in done] == [0, 4]
    assert [int(d[0, 0]) for d in slow.seen] == [0, 4]


def test_what_goes_wrong_in_the_thread_reaches_whoever_takes_the_labels():
    def fails(depth):
        raise PerceptionError("of another size")

    thread = LabelThread(fails)
    thread.submit(0, image(1))
    with pytest.raises(PerceptionError, match="of another size"):
        wait_for(thread.take)
    assert thread.take() is None
    thread.close()
    with pytest.raises(PerceptionError, match="was closed"):
        thread.submit(1, image(1))


def test_dropped_images_give_no_labels():
    slow = Slow()
    thread = LabelThread(slow)
    thread.submit(0, image(0))
    wait_for(lambda: slow.seen)
    thread.drop()
    slow.go.release()
    thread.submit(1, image(1))
    slow.go.release()
    assert wait_for(thread.take).tag == 1
    thread.close()
