"""A network's training run on disk: ``run.json``, the best weights, and the state to carry on from."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from legtool.datasets.files import read_json, replacing
from legtool.datasets.work import RUN, claim
from legtool.errors import DatasetError

if TYPE_CHECKING:
    from torch import nn

BEST, LAST = "best.pt", "last.pt"
SCHEMA_VERSION = 1
#: What ``run.json`` calls each line's runs: the foothold line's by task.
FOOTHOLD_KINDS = {"vfa": "foothold_vfa", "vpa": "foothold_vpa"}
STEPPABILITY_KIND = "steppability"


@contextmanager
def claim_run(path: Path, identity: Mapping[str, Any], **more: Any) -> Iterator[dict[str, Any]]:
    """Begin a run, or take up the one that the same command left there, and hold its directory meanwhile.

    Args:
        path: its directory.
        identity: all that decides the training: kind, robot, settings, data.
        more: what ``run.json`` tells besides.

    Yields:
        its ``run.json``.

    Raises:
        OutputError: the directory holds something else, or a run of other settings or data.
    """
    begun = {**more, "history": [], "best": None, "complete": False}
    with claim(path, RUN, {"schema_version": SCHEMA_VERSION, **identity}, **begun) as run:
        yield run


def save_tensors(path: Path, state: Mapping[str, Any]) -> None:
    """Write tensors atomically.

    Raises:
        OutputError: the disk is full or the place cannot be written.
    """
    import torch  # here: what only reads run.json does without

    # To an open file: to a path, its temporary name would be written into the archive.
    with replacing(path) as temporary, temporary.open("wb") as file:
        torch.save(dict(state), file)


def load_tensors(path: Path) -> dict[str, Any]:
    """Read tensors; nothing in the file is run.

    Raises:
        DatasetError: missing or damaged.
    """
    import torch

    try:
        loaded: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: missing; train again") from error
    except Exception as error:
        raise DatasetError(f"{path}: damaged, cannot be read; remove the run and train again") from error
    return loaded


def read_run(path: Path, kinds: Collection[str], made_by: str) -> dict[str, Any]:
    """``run.json`` of a run, finished or not.

    Args:
        path: its directory.
        kinds: that it may be of.
        made_by: the command that makes one.

    Raises:
        DatasetError: not a run of these kinds, damaged, newer than this legtool, or without a finished epoch.
    """
    if not (path / RUN.marker).is_file():
        raise DatasetError(f"{path}: not a run (no {RUN.marker}); make one with {made_by}")
    description = read_json(path / RUN.marker)
    if description.get("kind") not in kinds:
        raise DatasetError(f"{path}: a run of kind {description.get('kind')!r}, expected {' or '.join(kinds)}")
    version = description.get("schema_version")
    if not isinstance(version, int) or version > SCHEMA_VERSION:
        raise DatasetError(f"{path}: schema {version} is newer than {SCHEMA_VERSION}; upgrade legtool")
    if description.get("best") is None:
        raise DatasetError(f"{path}: no epoch is finished; run its train command again to carry on")
    return description


def load_best(path: Path, net: nn.Module) -> None:
    """Load a run's best weights into its network, and put that in evaluation mode.

    Raises:
        DatasetError: missing, damaged, or another network's.
    """
    try:
        net.load_state_dict(load_tensors(path / BEST))
    except RuntimeError as error:
        raise DatasetError(f"{path / BEST}: not the weights of this run's network; train again") from error
    net.eval()
