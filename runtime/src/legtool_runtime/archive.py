"""Arrays from an ``.npz`` that nobody vouches for: only what is expected is read, and nothing of it is executed."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from legtool_runtime.errors import BundleError

#: numpy pads the header of an .npy to 64 bytes; one of ours is 128.
_MAX_HEADER = 1024


def read_arrays(data: bytes, shapes: Mapping[str, tuple[int, ...]], *, source: str) -> dict[str, NDArray[np.float64]]:
    """Read float64 arrays from the bytes of an ``.npz``.

    Args:
        data: the archive.
        shapes: name and shape of every array that must be there; no others may.
        source: for messages.

    Raises:
        BundleError: not an archive, damaged, a member missing, doubled or unexpected, a type other than float64, a
            shape or size other than expected. Objects (pickles) and compressed bombs are refused before they are read.
    """
    try:
        return _read(data, shapes, source)
    except BundleError:
        raise
    except Exception as error:  # zipfile, zlib and numpy each raise many kinds on forged input
        text = " ".join(f"{type(error).__name__}: {error}".split())[:120]
        raise BundleError(f"{source}: not readable as .npz ({text}); export the bundle again") from error


def _read(data: bytes, shapes: Mapping[str, tuple[int, ...]], source: str) -> dict[str, NDArray[np.float64]]:
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        names = [member.filename for member in members]
        expected = {f"{name}.npy" for name in shapes}
        if len(names) != len(set(names)) or set(names) != expected:
            odd = sorted(set(names) ^ expected) or sorted(name for name in names if names.count(name) > 1)
            what = "missing" if odd[0] in expected - set(names) else "unexpected or doubled"
            raise BundleError(f"{source}: {odd[0][:80]!r} is {what}; expected {', '.join(shapes)}")
        for member in members:
            name = member.filename.removesuffix(".npy")
            size = 8 * int(np.prod(shapes[name]))
            if not size < member.file_size <= size + _MAX_HEADER:
                raise BundleError(
                    f"{source}: {name} has {member.file_size} bytes, expected {size} and a header: shape {shapes[name]}"
                )
            with archive.open(member) as file:
                content = file.read(member.file_size + 1)
            arrays[name] = _array(content, shapes[name], f"{source}: {name}")
    return arrays


def _array(content: bytes, shape: tuple[int, ...], source: str) -> NDArray[np.float64]:
    file = io.BytesIO(content)
    version = npy.read_magic(file)
    if version != (1, 0):
        raise BundleError(f"{source} is .npy version {version}, expected (1, 0)")
    found, _, dtype = npy.read_array_header_1_0(file, max_header_size=_MAX_HEADER)
    if dtype != np.dtype("<f8"):
        raise BundleError(f"{source} is of type {dtype}, expected float64")
    if found != shape:
        raise BundleError(f"{source} has shape {found}, expected {shape}")
    if len(content) - file.tell() != 8 * int(np.prod(shape)):
        raise BundleError(f"{source} has {len(content) - file.tell()} bytes of data, too few or too many for {shape}")
    file.seek(0)
    return npy.read_array(file, allow_pickle=False)
