"""What a foot may step on: a segmenter's labels, in a thread of its own (QuadPiPS, sections V-B and VIII-B3)."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import LABELS, UNKNOWN
from legtool_runtime.perception.camera import Camera, Depth
from legtool_runtime.perception.depth import FACTOR, PREPARATION, prepare

LabelImage = NDArray[np.uint8]
Tag = TypeVar("Tag")

#: What a segmenter tells apart, in the order of its outputs.
CLASSES = LABELS[1:]


def steppability_interface() -> dict[str, Any]:
    """What a segmenter's labels mean: part of its line's description in a bundle, and to be the same."""
    return {"labels": list(LABELS)}


@dataclass(frozen=True, eq=False)
class Sensor:
    """The depth camera that a segmenter was trained for, and where it sits.

    Attributes:
        camera: intrinsics of the images as the sensor sends them.
        transform_camera_to_base: (4, 4) nominal mount of its optical frame.
        standing_height: nominal, of the base above the ground [m].
    """

    camera: Camera
    transform_camera_to_base: NDArray[np.float64]
    standing_height: float

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, as a bundle holds them."""
        return {
            "camera": dataclasses.asdict(self.camera),
            "transform_camera_to_base": self.transform_camera_to_base.tolist(),
            "standing_height": self.standing_height,
        }

    @classmethod
    def from_dict(cls, values: Any) -> Sensor:
        """The sensor of :meth:`to_dict`.

        Raises:
            PerceptionError: a value is missing or makes no sense.
        """
        try:
            camera = Camera(**values["camera"])
            mount = np.array(values["transform_camera_to_base"], dtype=np.float64)
            height = float(values["standing_height"])
        except (KeyError, TypeError, ValueError) as error:
            raise PerceptionError(
                "sensor: expected camera, transform_camera_to_base (4, 4) and standing_height"
            ) from error
        if mount.shape != (4, 4) or not np.isfinite(mount).all() or not 0 < height < 10:
            raise PerceptionError(f"sensor: mount of shape {mount.shape}, standing height {height} m; expected (4, 4)")
        return cls(camera, mount, height)


class Segmenter:
    """An exported segmenter: depth image in, label image out.

    Attributes:
        steps: of preparation, that it was trained with.
        sensor: the camera that it was trained for; None where that is not known.
        size: height and width that the model takes after preparation, None where it takes any.
    """

    def __init__(
        self,
        model: bytes | str | os.PathLike[str],
        *,
        classes: Sequence[str] = CLASSES,
        steps: Sequence[str] = PREPARATION,
        sensor: Sensor | None = None,
        threads: int = 1,
    ) -> None:
        """Load a model.

        Args:
            model: the ONNX file, or its bytes. Input: depth (1, 1, h, w) [m], 0 without return. Output: labels
                (1, h, w) uint8, index into LABELS, or logits (1, classes, h, w).
            classes: what the model was trained to tell apart, in order.
            steps: the preparation that it was trained with, see :mod:`depth`.
            sensor: the camera that it was trained for.
            threads: processor threads that it may use.

        Raises:
            PerceptionError: no such model, one with other inputs or outputs, or with another class list.
        """
        if tuple(classes) != CLASSES:
            raise PerceptionError(
                f"segmenter: tells apart {', '.join(classes) or 'nothing'}; this runtime expects {', '.join(CLASSES)} "
                "in this order; export a model with these classes"
            )
        self.steps = tuple(steps)
        self.sensor = sensor
        self._session = _load(model, threads)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        shape = inputs[0].shape if len(inputs) == 1 else []
        if len(shape) != 4 or inputs[0].type != "tensor(float)" or not _fits(shape[1], 1) or not _fits(shape[0], 1):
            given = "; ".join(f"{i.name} {i.type} {i.shape}" for i in inputs)
            raise PerceptionError(f"segmenter: inputs {given}, expected one: depth (1, 1, height, width) of float32")
        self._input = inputs[0].name
        self.size = tuple(n if isinstance(n, int) else None for n in shape[2:])
        labels = [o.name for o in outputs if o.type == "tensor(uint8)" and len(o.shape) == 3]
        logits = [
            o.name
            for o in outputs
            if o.type == "tensor(float)" and len(o.shape) == 4 and _fits(o.shape[1], len(CLASSES))
        ]
        if not labels and not logits:
            given = "; ".join(f"{o.name} {o.type} {o.shape}" for o in outputs)
            raise PerceptionError(
                f"segmenter: outputs {given}, expected labels (1, height, width) of uint8 "
                f"or logits (1, {len(CLASSES)}, height, width) of float32"
            )
        self._output, self._gives_labels = (labels or logits)[0], bool(labels)

    def warm_up(self) -> None:
        """Compile what segmenting needs, and let the model plan its memory, so that the first image costs no more."""
        height, width = (64 if n is None else n for n in self.size)
        factor = FACTOR ** self.steps.count("decimate")
        self(np.ones((height * factor, width * factor), dtype=np.float32))

    def __str__(self) -> str:
        size = " × ".join("any" if n is None else str(n) for n in reversed(self.size))
        return f"steppability of {size} depth images after {', '.join(self.steps) or 'no preparation'}"

    def __call__(self, depth: Depth) -> LabelImage:
        """Labels of a depth image.

        Args:
            depth: (h, w) [m], NaN where there is no return, as the camera took it.

        Returns:
            (h, w) index into LABELS, unknown where there is no return.

        Raises:
            PerceptionError: an image of another size than the model was made for.
        """
        prepared = prepare(depth, self.steps)
        size = prepared.shape
        if not all(_fits(expected, given) for expected, given in zip(self.size, size, strict=True)):
            raise PerceptionError(
                f"segmenter: made for images of {self.size[1]} × {self.size[0]} after preparation "
                f"({', '.join(self.steps) or 'none'}); this camera gives {size[1]} × {size[0]}: train for this camera"
            )
        labels = self.predict(prepared)
        # Preparation may have halved the image: each pixel takes the label of the block it went into.
        rows, columns = (
            np.minimum(np.arange(n) * m // n, m - 1) for n, m in zip(_even(depth, size), size, strict=True)
        )
        full = np.full(depth.shape, UNKNOWN, dtype=np.uint8)
        full[: rows.size, : columns.size] = labels[np.ix_(rows, columns)]
        full[np.isnan(depth)] = UNKNOWN
        return full

    def predict(self, prepared: Depth) -> LabelImage:
        """Labels of an image that is prepared already: (h, w) of LABELS from depth (h, w) [m], NaN without return."""
        known = np.isfinite(prepared) & (prepared > 0)
        (out,) = self._session.run([self._output], {self._input: np.where(known, prepared, 0.0)[None, None]})
        labels = out[0] if self._gives_labels else (out[0].argmax(axis=0) + 1).astype(np.uint8)
        return np.where(known & (labels < len(LABELS)), labels, np.uint8(UNKNOWN))


class Labelled(NamedTuple, Generic[Tag]):
    """Labels and what was given along with the image that they belong to."""

    tag: Tag
    labels: LabelImage


class LabelThread(Generic[Tag]):
    """Segments the newest image in a thread of its own, so that no one waits for it.

    A new image replaces one that still waits; the one being segmented is finished.
    """

    def __init__(self, segment: Callable[[Depth], LabelImage]) -> None:
        self._segment = segment
        self._waiting: tuple[Tag, Depth] | None = None
        self._done: Labelled[Tag] | None = None
        self._error: Exception | None = None
        self._closed = False
        self._dropped = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="steppability", daemon=True)
        self._thread.start()

    def submit(self, tag: Tag, depth: Depth) -> None:
        """Hand in an image [m]; it must not be written to afterwards.

        Raises:
            PerceptionError: the thread was closed.
        """
        with self._changed:
            if self._closed:
                raise PerceptionError("segmenter: its thread was closed; make a new one")
            self._waiting = (tag, depth)
            self._changed.notify_all()

    def take(self) -> Labelled[Tag] | None:
        """The newest labels that were not taken yet, at once; None if there are none.

        Raises:
            Exception: what segmenting an image raised.
        """
        with self._changed:
            error, self._error = self._error, None
            done, self._done = self._done, None
        if error is not None:
            raise error
        return done

    def drop(self) -> None:
        """Forget what was handed in, also the image being segmented."""
        with self._changed:
            self._waiting, self._done, self._error, self._dropped = None, None, None, True

    def close(self) -> None:
        """End the thread, after the image that it is at."""
        with self._changed:
            self._closed = True
            self._waiting = None
            self._changed.notify_all()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting is not None)
                if self._waiting is None:
                    return
                (tag, depth), self._waiting, self._dropped = self._waiting, None, False
            try:
                done, error = Labelled(tag, self._segment(depth)), None
            except Exception as problem:  # handed to whoever takes the labels, and the thread lives on
                done, error = None, problem
            with self._changed:
                if not self._dropped:
                    self._done, self._error = done, error


def _load(model: bytes | str | os.PathLike[str], threads: int) -> Any:
    import onnxruntime  # 0.1 s that who has no segmenter need not wait

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    name = "segmenter" if isinstance(model, bytes) else str(model)
    if not isinstance(model, bytes):
        try:
            model = Path(model).read_bytes()
        except OSError as error:
            raise PerceptionError(f"{name}: cannot be read ({error.strerror or error})") from error
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own exception classes are not public
        raise PerceptionError(f"{name}: is no ONNX model that onnxruntime can load ({_first_line(error)})") from error


def _fits(expected: int | str | None, given: int) -> bool:
    """Whether a size fits one that the model names by a number, or leaves open."""
    return not isinstance(expected, int) or expected == given


def _even(depth: Depth, size: tuple[int, ...]) -> tuple[int, int]:
    """The part of an image that its preparation kept, as rows and columns."""
    return (depth.shape[0] // size[0]) * size[0], (depth.shape[1] // size[1]) * size[1]


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
