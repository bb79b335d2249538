"""What a foot may step on: a segmenter's labels, in a thread of its own (QuadPiPS, sections V-B and VIII-B3)."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from legtool_runtime import checks
from legtool_runtime.errors import PerceptionError
from legtool_runtime.onnx_session import OnnxSession
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
            mount, height = values["transform_camera_to_base"], float(values["standing_height"])
        except (KeyError, TypeError, ValueError) as error:
            raise PerceptionError(
                "sensor: expected camera, transform_camera_to_base (4, 4) and standing_height"
            ) from error
        if not 0 < height < 10:
            raise PerceptionError(f"sensor: standing_height is {height} m, expected 0 to 10 m")
        return cls(camera, checks.pose("sensor: transform_camera_to_base", mount, PerceptionError), height)


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
                (1, h, w) uint8, index into LABELS, or logits (1, classes, h, w), or both.
            classes: what the model was trained to tell apart, in order.
            steps: the preparation that it was trained with, see :mod:`depth`.
            sensor: the camera that it was trained for.
            threads: processor threads that it may use.

        Raises:
            PerceptionError: no such model, one with other inputs or outputs, with another class list, or with logits
                that are not finite.
        """
        if tuple(classes) != CLASSES:
            raise PerceptionError(
                f"segmenter: tells apart {', '.join(classes) or 'nothing'}; this runtime expects {', '.join(CLASSES)} "
                "in this order; export a model with these classes"
            )
        self.steps = tuple(steps)
        self.sensor = sensor
        self._session = OnnxSession(model, what="segmenter", error=PerceptionError, threads=threads)
        inputs, outputs = self._session.inputs, self._session.outputs
        if len(inputs) != 1 or inputs[0].type != "tensor(float)" or not inputs[0].fits((1, 1, None, None)):
            given = "; ".join(str(port) for port in inputs)
            raise PerceptionError(f"segmenter: inputs {given}, expected one: depth (1, 1, height, width) of float32")
        self._input = inputs[0].name
        self.size = inputs[0].shape[2:]
        labels = [o.name for o in outputs if o.type == "tensor(uint8)" and o.fits((None, None, None))]
        logits = [o.name for o in outputs if o.type == "tensor(float)" and o.fits((None, len(CLASSES), None, None))]
        if not labels and not logits:
            given = "; ".join(str(port) for port in outputs)
            raise PerceptionError(
                f"segmenter: outputs {given}, expected labels (1, height, width) of uint8 "
                f"or logits (1, {len(CLASSES)}, height, width) of float32"
            )
        self._gives_labels, self._gives_logits = bool(labels), bool(logits)
        self._outputs = [*labels[:1], *logits[:1]]
        self._probe()

    def _probe(self) -> None:
        """Refuse a model that has no labels, or logits that are not finite, for each pixel of level ground."""
        height, width = (64 if n is None else n for n in self.size)
        depth = np.repeat(np.linspace(3.0, 0.6, height, dtype=np.float32)[:, None], width, axis=1)
        _, finite = self._look(depth, first=True)
        if not finite.all():
            raise PerceptionError(
                "segmenter: its logits for level ground are not finite: its training diverged, or its file is damaged; "
                "train it anew and export that run"
            )

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
        """Labels of an image that is prepared already: (h, w) of LABELS from depth (h, w) [m], NaN without return.

        Pixels whose logits are not finite are unknown.
        """
        known = np.isfinite(prepared) & (prepared > 0)
        labels, finite = self._look(np.where(known, prepared, np.float32(0.0)))
        return np.where(known & finite & (labels < len(LABELS)), labels, np.uint8(UNKNOWN))

    def _look(self, depth: Depth, *, first: bool = False) -> tuple[LabelImage, NDArray[np.bool_]]:
        """Labels (h, w) as the model gives them for depth (h, w), 0 without return; and where its logits are finite."""
        run = self._session.probe if first else self._session.run
        out = run({self._input: depth[None, None]}, self._outputs)
        for name, found in zip(self._outputs, out, strict=True):
            if found.shape[:1] + found.shape[-2:] != (1, *depth.shape):
                raise PerceptionError(
                    f"segmenter: its {name} have shape {found.shape} for an image of {depth.shape}; expected one for "
                    "each pixel"
                )
        finite = np.isfinite(out[-1][0]).all(axis=0) if self._gives_logits else np.ones(depth.shape, np.bool_)
        # The index of the greatest of NaNs is 0, the first class: whoever takes labels asks for `finite` as well.
        labels = out[0][0] if self._gives_labels else (out[0][0].argmax(axis=0) + 1).astype(np.uint8)
        return labels, finite


@dataclass(frozen=True, eq=False)
class Labelled(Generic[Tag]):
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


def _fits(expected: int | None, given: int) -> bool:
    """Whether a size fits one that the model names by a number, or leaves open."""
    return expected is None or expected == given


def _even(depth: Depth, size: tuple[int, ...]) -> tuple[int, int]:
    """The part of an image that its preparation kept, as rows and columns."""
    return (depth.shape[0] // size[0]) * size[0], (depth.shape[1] // size[1]) * size[1]
