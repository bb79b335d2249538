"""Find the CSV files of a log and summarise what they contain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from legtool.configs.topics import Csv
from legtool.errors import LogError


def describe_csv(path: Path) -> dict[str, Any]:
    """Return ``files``: the number of rows and columns of each CSV file (a header counts as a row).

    Raises:
        LogError: a file is empty or is not text.
    """
    out: dict[str, dict[str, int]] = {}
    for file in [path] if path.is_file() else sorted(path.glob("*.csv")):
        try:
            with file.open(encoding="utf-8") as stream:
                columns = stream.readline().count(",") + 1
                rows = 1 + sum(1 for line in stream if line.strip())
        except UnicodeDecodeError as error:
            raise LogError(f"{file}: is not text; expected CSV") from error
        if not file.stat().st_size:
            raise LogError(f"{file}: is empty")
        out[file.name] = {"rows": rows, "columns": columns}
    return {"files": out}


def csv_files(path: Path, csv: Csv) -> dict[str, Path]:
    """Return the file for each key of ``csv.files``: the path itself, or the matching file in the directory.

    Raises:
        LogError: a file is missing, or several files match.
    """
    if path.is_file():
        if len(csv.files) > 1:
            raise LogError(f"{path}: is one file, expected a directory with {', '.join(csv.files)}")
        return {next(iter(csv.files)): path}
    out: dict[str, Path] = {}
    for pattern in csv.files:
        found = sorted(path.glob(pattern))
        if not found:
            there = ", ".join(sorted(item.name for item in path.glob("*.csv"))) or "none"
            raise LogError(f"{path}: has no {pattern}; CSV files there: {there}")
        if len(found) > 1:
            raise LogError(
                f"{path}: {len(found)} files match {pattern} ({found[0].name}, {found[1].name}, …), expected one; "
                "give the files themselves"
            )
        out[pattern] = found[0]
    return out
