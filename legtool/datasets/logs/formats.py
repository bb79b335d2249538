"""Which format a log has, by its name and by what lies in its directory."""

from __future__ import annotations

from pathlib import Path

from legtool.errors import LogError

#: Suffixes of bag files, and of tables.
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
TABLE_SUFFIXES = (".csv", ".tsv", ".parquet", ".npz", ".h5", ".hdf5")


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
        suffixes = {item.suffix.lower() for item in path.iterdir() if item.is_file()}
        if suffixes & set(BAG_SUFFIXES):
            return "bags"
        if suffixes & set(TABLE_SUFFIXES):
            return "csv"
        raise LogError(f"{path}: holds neither a ROS 2 bag (metadata.yaml), nor bag files, nor CSV files")
    kinds = {".bag": "ros1", ".db3": "db3", ".mcap": "mcap", **dict.fromkeys(TABLE_SUFFIXES, "csv")}
    if path.suffix.lower() not in kinds:
        raise LogError(
            f"{path}: not a log that legtool reads; expected .bag, .db3, .mcap, .csv, .parquet, .npz, .h5, a ROS 2 bag "
            "directory or a directory of CSV files"
        )
    return kinds[path.suffix.lower()]
