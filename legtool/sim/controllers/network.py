"""Networks of policies, in ONNX or TorchScript: an observation in, an output out, states fed back between."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.configs.observation import NetworkSettings, RecurrentState
from legtool.errors import SettingsError
from legtool_runtime.onnx_session import OnnxSession, Port

Array = NDArray[np.float64]

#: Where any other network goes.
_OTHERWISE = (
    "a policy is ONNX or TorchScript; export it as one of them, or run it by a Python class of yours, "
    "black_box=module:Class (docs/motion.md)"
)
_FLOATS = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(float16)": np.float16}


class Network(Protocol):
    """A network that is ready to be asked."""

    def reset(self) -> None:
        """Forget all states."""

    def ask(self, observation: Array) -> Array:
        """What it answers to an observation (n,), flat; states go on."""


def load_network(settings: NetworkSettings, *, shown: int, gives: int, terms: str) -> Network:
    """A network, tried on an observation of zeros.

    Args:
        settings: which file, and which states are fed back.
        shown: numbers that it is shown.
        gives: numbers that it has to give.
        terms: what it is shown, for messages.

    Raises:
        SettingsError: no such file, neither ONNX nor TorchScript, or one that takes or gives something else.
    """
    path = settings.file
    if not path.is_file():
        key = "onnx" if settings.onnx is not None else "torchscript"
        raise SettingsError(f"{path}: no such policy; set {key!r} to the network's file")
    made: Network
    made = (_Onnx if settings.onnx is not None else _TorchScript)(settings, shown, terms)
    found = made.ask(np.zeros(shown)).size
    if found != gives:
        raise SettingsError(f"{path}: its output has {found} numbers, expected {gives}; choose another with 'output'")
    made.reset()
    return made


class _Onnx:
    """By onnxruntime, on one thread."""

    def __init__(self, settings: NetworkSettings, shown: int, terms: str) -> None:
        path = settings.file
        try:
            self._session = OnnxSession(path, what="policy", error=SettingsError)
        except SettingsError as error:
            raise SettingsError(f"{error}; {_OTHERWISE}") from error
        inputs = {port.name: port for port in self._session.inputs}
        outputs = [port.name for port in self._session.outputs]
        fed = {state.input: state for state in settings.recurrent}
        for state in settings.recurrent:
            _known(path, "input", state.input, list(inputs))
            _known(path, "output", state.output, outputs)
        port = _observed(path, [name for name in inputs if name not in fed])
        self._port = inputs[port]
        if self._port.type not in _FLOATS:
            raise SettingsError(f"{path}: its input {self._port} takes no floating-point numbers; {_OTHERWISE}")
        self._shape = _shape(self._port, shown, path, terms)
        self._answer = settings.output if isinstance(settings.output, str) else _at(path, settings.output, outputs)
        _known(path, "output", self._answer, outputs)
        self._outputs = [self._answer, *(_name(state.output, outputs) for state in settings.recurrent)]
        self._start = {name: _zeros(inputs[name], state, path) for name, state in fed.items()}
        self._states = self._start

    def reset(self) -> None:
        """Forget all states."""
        self._states = self._start

    def ask(self, observation: Array) -> Array:
        """What it answers, flat."""
        given = observation.astype(_FLOATS[self._port.type]).reshape(self._shape)
        answer, *states = self._session.run({self._port.name: given, **self._states}, self._outputs)
        self._states = dict(zip(self._start, states, strict=True))
        return np.asarray(answer, dtype=np.float64).ravel()


def _shape(port: Port, shown: int, path: Path, terms: str) -> tuple[int, ...]:
    """The shape that an observation is given in; a batch of one, where the network takes batches."""
    dims = port.shape
    known = [1 if place == 0 and len(dims) > 1 else size for place, size in enumerate(dims)]
    unknown = [place for place, size in enumerate(known) if size is None]
    rest = int(np.prod([size for size in known if size is not None], dtype=int))
    if len(unknown) > 1 or shown % max(rest, 1) or (not unknown and rest != shown):
        raise SettingsError(f"{path}: its input has shape {dims}, the description asks for {terms}")
    return tuple(shown // rest if size is None else size for size in known)


def _zeros(port: Port, state: RecurrentState, path: Path) -> NDArray[Any]:
    shape = state.shape or tuple(1 if size is None else size for size in port.shape)
    if port.type not in _FLOATS or not port.fits(shape):
        raise SettingsError(f"{path}: state {state.input} of shape {shape}, but the network takes {port}")
    return np.zeros(shape, dtype=_FLOATS[port.type])


def _observed(path: Path, inputs: list[str]) -> str:
    """The one input that no state feeds."""
    if len(inputs) != 1:
        given = ", ".join(inputs) or "none"
        raise SettingsError(
            f"{path}: inputs that no state feeds: {given}; expected one, for the observation. Name the others under "
            "'recurrent', with the outputs that feed them"
        )
    return inputs[0]


def _known(path: Path, what: str, name: str | int, all_of: list[str]) -> None:
    if name not in all_of and not (isinstance(name, int) and 0 <= name < len(all_of)):
        raise SettingsError(f"{path}: has no {what} {name!r}; it has {', '.join(all_of)}")


def _at(path: Path, place: int, all_of: list[str]) -> str:
    _known(path, "output", place, all_of)
    return all_of[place]


def _name(given: str | int, all_of: list[str]) -> str:
    return all_of[given] if isinstance(given, int) else given


class _TorchScript:
    """By torch, on one thread of the processor. States within the module are at each start as in its file."""

    def __init__(self, settings: NetworkSettings, shown: int, terms: str) -> None:
        self._settings, self._terms = settings, terms
        path = settings.file
        self._bytes = path.read_bytes()
        self._load()
        names = [argument.name for argument in self._module.forward.schema.arguments[1:]]
        fed = [state.input for state in settings.recurrent]
        for name in fed:
            _known(path, "input", name, names)
        self._observed = _observed(path, [name for name in names if name not in fed])
        for state in settings.recurrent:
            if state.shape is None:
                raise SettingsError(f"{path}: state {state.input} has no shape; TorchScript names none: give 'shape'")
            if isinstance(state.output, str):
                raise SettingsError(f"{path}: output {state.output!r}: outputs of TorchScript go by place, from 0")
        if isinstance(settings.output, str):
            raise SettingsError(f"{path}: output {settings.output!r}: outputs of TorchScript go by place, from 0")
        del shown

    def _load(self) -> None:
        import torch  # only who has TorchScript waits for it

        torch.set_num_threads(1)
        path, method = self._settings.file, self._settings.reset_method
        try:
            self._module = torch.jit.load(io.BytesIO(self._bytes), map_location="cpu").eval()
        except Exception as error:  # torch raises many kinds
            what = "is a checkpoint of weights, and no TorchScript" if _is_checkpoint(self._bytes) else "no TorchScript"
            raise SettingsError(f"{path}: {what} ({_last(error)}); {_OTHERWISE}") from error
        if method is not None:
            if not hasattr(self._module, method):
                raise SettingsError(f"{path}: has no method {method!r}; leave reset_method out, or name another")
            getattr(self._module, method)()
        self._states = {state.input: torch.zeros(state.shape or ()) for state in self._settings.recurrent}
        self._used = False

    def reset(self) -> None:
        """Forget all states, also those within the module."""
        if self._used:
            self._load()

    def ask(self, observation: Array) -> Array:
        """What it answers, flat."""
        import torch  # see _load

        self._used, settings = True, self._settings
        given = torch.from_numpy(observation.astype(np.float32))[None]
        try:
            with torch.inference_mode():
                answer = self._module(**{self._observed: given, **self._states})
        except Exception as error:  # torch raises many kinds
            raise SettingsError(
                f"{settings.file}: does not take what the description asks for, {self._terms} ({_last(error)})"
            ) from error
        outputs = list(answer) if isinstance(answer, (tuple, list)) else [answer]
        places = [settings.output, *(state.output for state in settings.recurrent)]
        for place in places:
            if not isinstance(place, int) or place >= len(outputs):
                raise SettingsError(f"{settings.file}: has no output {place!r}; it has {len(outputs)}")
        chosen = [outputs[place] for place in places if isinstance(place, int)]
        self._states = dict(zip(self._states, chosen[1:], strict=True))
        return np.asarray(chosen[0].numpy(), dtype=np.float64).ravel()


def _is_checkpoint(content: bytes) -> bool:
    """Whether a file holds tensors as torch.save writes them, and no code."""
    if not zipfile.is_zipfile(io.BytesIO(content)):
        return False
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        held = archive.namelist()
    return any(name.endswith("data.pkl") for name in held) and not any("/code/" in name for name in held)


def _last(error: Exception) -> str:
    lines = [line.strip() for line in str(error).strip().splitlines() if line.strip()]
    return lines[-1][:160] if lines else type(error).__name__
