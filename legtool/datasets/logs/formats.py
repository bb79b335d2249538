"""Which format a log has, by its name and by what lies in its directory."""

from __future__ import annotations

from pathlib import Path

from legtool.errors import LogError

#: Suffixes of bag files, and of tables.
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
TABLE_SUFFIXES = (".csv", ".tsv", ".parquet", ".npz", ".h5", ".hdf5")
#: Endings of files that are compressed as a whole.
_PACKED = (".zstd", ".zst")


def is_packed(path: Path) -> bool:
    """Whether a file is compressed as a whole, by its name."""
    return path.suffix.lower() in _PACKED


def bag_suffix(path: Path) -> str:
    """Suffix of a bag file, by its name and as it is once it is unpacked; empty of any other file."""
    suffix = Path(path.stem).suffix.lower() if is_packed(path) else path.suffix.lower()
    return suffix if suffix in BAG_SUFFIXES else ""


def is_log(path: Path) -> bool:
    """Whether :func:`kind_of` knows what a path is, by names alone."""
    try:
        kind_of(path)
    except LogError:
        return False
    return True


def kind_of(path: Path) -> str:
    """Return the kind of log at a path: ``csv``, ``ros1``, ``ros2`` (a bag directory), ``db3``, ``mcap`` or ``bags``.

    Raises:
        LogError: the path does not exist, or is none of these.
    """
    if not path.exists():
        raise LogError(f"{path}: no such file or directory")
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ros2"
        files = [item for item in path.iterdir() if item.is_file()]
        if any(map(bag_suffix, files)):
            return "bags"
        if {item.suffix.lower() for item in files} & set(TABLE_SUFFIXES):
            return "csv"
        raise LogError(f"{path}: holds neither a ROS 2 bag (metadata.yaml), nor bag files, nor CSV files")
    kinds = {".bag": "ros1", ".db3": "db3", ".mcap": "mcap", **dict.fromkeys(TABLE_SUFFIXES, "csv")}
    suffix = bag_suffix(path) or path.suffix.lower()
    if suffix not in kinds:
        raise LogError(
            f"{path}: not a log that legtool reads; expected .bag, .db3, .mcap, .csv, .parquet, .npz, .h5, a bag file "
            "as .zstd, a ROS 2 bag directory or a directory of CSV files"
        )
    return kinds[suffix]
