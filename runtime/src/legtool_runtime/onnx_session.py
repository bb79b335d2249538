"""An ONNX model: loaded with a fixed number of threads, its inputs and outputs known.

It runs on the processor, or where :func:`running_on` says.
"""

from __future__ import annotations

import contextlib
import contextvars
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from legtool_runtime.errors import LegtoolError

#: A model that computes longer at its first run is refused [s].
_LONGEST_S = 10.0
_PROCESSOR = ("CPUExecutionProvider",)
_PROVIDERS: contextvars.ContextVar[tuple[str, ...]] = contextvars.ContextVar("providers", default=_PROCESSOR)


class Port(NamedTuple):
    """An input or output: name, type as ONNX calls it (``tensor(float)``), and shape, None where it takes any size."""

    name: str
    type: str
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        return f"{self.name} {self.type} ({', '.join('any' if n is None else str(n) for n in self.shape)})"

    def fits(self, shape: Sequence[int | None]) -> bool:
        """Whether it may have a shape; None in that one stands for any size."""
        return len(self.shape) == len(shape) and all(
            own is None or wanted is None or own == wanted for own, wanted in zip(self.shape, shape, strict=True)
        )


@contextlib.contextmanager
def running_on(providers: Sequence[str]) -> Iterator[None]:
    """Models that are loaded inside run by these execution providers of onnxruntime.

    Args:
        providers: names like ``CUDAExecutionProvider``, the preferred one first; none: the processor's.
    """
    token = _PROVIDERS.set(tuple(providers) or _PROCESSOR)
    try:
        yield
    finally:
        _PROVIDERS.reset(token)


class OnnxSession:
    """A model that is ready to run.

    Attributes:
        inputs, outputs: what it takes and gives, in the model's order.
    """

    def __init__(
        self, model: bytes | str | os.PathLike[str], *, what: str, error: type[LegtoolError], threads: int = 1
    ) -> None:
        """Load a model.

        Args:
            model: its file, or the bytes of that.
            what: it is, for messages; of a file the path is named.
            error: class of what is raised.
            threads: processor threads that a run may use.

        Raises:
            error: no such file, not a model that onnxruntime can run, no onnxruntime, or one without the provider.
        """
        try:
            import onnxruntime  # 0.1 s that who has no network need not wait
        except ImportError as problem:
            raise error(f"{what}: needs onnxruntime, which is not installed; pip install onnxruntime") from problem
        providers = _PROVIDERS.get()
        available = onnxruntime.get_available_providers()
        if missing := [name for name in providers if name not in available]:
            raise error(f"{what}: this onnxruntime has no {missing[0]}; it has {', '.join(available)}")
        if not isinstance(model, bytes):
            # By its path, and not by its bytes: weights may lie in a file beside it.
            what = model = str(model)
            try:
                Path(model).open("rb").close()
            except OSError as problem:
                raise error(f"{what}: cannot be read ({problem.strerror or problem})") from problem
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=list(providers))
        except Exception as problem:  # onnxruntime's own exception classes are not public
            raise error(f"{what}: not an ONNX model that onnxruntime can run ({_short(problem)})") from problem
        self._what, self._error = what, error
        self.inputs, self.outputs = _ports(self._session.get_inputs()), _ports(self._session.get_outputs())

    def probe(self, inputs: Mapping[str, NDArray[Any]], outputs: Sequence[str] | None = None) -> list[NDArray[Any]]:
        """As :meth:`run`, for the first time: a model that does not come to an end within 10 s is refused.

        Raises:
            error: the class given when it was loaded; the model takes too long, or not these inputs.
        """
        from onnxruntime import RunOptions

        options, late = RunOptions(), threading.Event()

        def end() -> None:
            late.set()
            options.terminate = True

        timer = threading.Timer(_LONGEST_S, end)
        timer.daemon = True
        timer.start()
        try:
            return self.run(inputs, outputs, options)
        except LegtoolError as problem:
            if not late.is_set():
                raise
            raise self._error(
                f"{self._what}: has no answer after {_LONGEST_S:g} s; not a model for a robot"
            ) from problem
        finally:
            timer.cancel()

    def run(
        self, inputs: Mapping[str, NDArray[Any]], outputs: Sequence[str] | None = None, options: Any = None
    ) -> list[NDArray[Any]]:
        """The model's outputs, all or those named, for inputs by name; ``options``: onnxruntime's of the run.

        Raises:
            error: the class given when it was loaded; the model does not take these inputs.
        """
        try:
            found: list[NDArray[Any]] = self._session.run(outputs, inputs, options)
        except Exception as problem:
            given = ", ".join(f"{name} {x.shape}" for name, x in inputs.items())
            takes = "; ".join(str(port) for port in self.inputs)
            raise self._error(f"{self._what}: given {given}, this model takes {takes} ({_short(problem)})") from problem
        return found


def _ports(nodes: Sequence[Any]) -> tuple[Port, ...]:
    return tuple(Port(n.name, n.type, tuple(d if isinstance(d, int) else None for d in n.shape)) for n in nodes)


def _short(error: Exception) -> str:
    return " ".join((str(error).splitlines() or [type(error).__name__])[0].split())[:160]
