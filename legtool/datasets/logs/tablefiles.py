"""The tables of a log: CSV read by pyarrow in whatever encoding, Parquet, NumPy archives, HDF5, all block by block."""

from __future__ import annotations

import csv as plain_csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from legtool.configs.topics import Csv
from legtool.datasets.logs.formats import TABLE_SUFFIXES
from legtool.errors import LogError

#: Rows that are handed on at once, and bytes of text that are parsed at once.
BLOCK, BLOCK_BYTES = 4096, 2**20
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_HEAD = 65536


class Table(Protocol):
    """A table with named columns; values are text in CSV, numbers otherwise.

    Attributes:
        names: of its columns; empty if it has none.
        count: of its columns.
    """

    names: list[str]
    count: int

    def blocks(self, columns: Sequence[int]) -> Iterator[tuple[NDArray[np.int64], dict[int, pa.Array]]]:
        """Yield blocks of rows: the number of each row, as messages name it, and the columns that are asked for."""
        ...


class _Text:
    """A CSV file."""

    def __init__(self, path: Path, csv: Csv) -> None:
        self.path, self.csv = path, csv
        self.encoding = _encoding(path)
        with path.open(encoding=self.encoding, newline="") as file:
            rows = plain_csv.reader(file, delimiter=csv.delimiter)
            try:
                first = next((row for row in rows if any(cell.strip() for cell in row)), None)
            except (UnicodeDecodeError, plain_csv.Error) as error:
                raise LogError(f"{path}: is not text; expected CSV") from error
            self.skip = rows.line_num if csv.header else rows.line_num - 1
        if first is None:
            raise LogError(f"{path}: is empty; expected rows of comma-separated values")
        self.count = len(first)
        self.names = [cell.strip() for cell in first] if csv.header else []
        self.wrong: str | None = None
        self.blank: list[int] = []

    def blocks(self, columns: Sequence[int]) -> Iterator[tuple[NDArray[np.int64], dict[int, pa.Array]]]:
        """Yield blocks of rows, numbered by their lines; blank lines are skipped."""
        self.wrong, self.blank = None, []
        text = {f"f{column}": pa.string() for column in range(self.count)}
        try:
            reader = pacsv.open_csv(
                self.path,
                pacsv.ReadOptions(
                    use_threads=False,
                    block_size=BLOCK_BYTES,
                    skip_rows=self.skip,
                    column_names=list(text),
                    encoding=self.encoding,
                ),
                pacsv.ParseOptions(
                    delimiter=self.csv.delimiter, ignore_empty_lines=False, invalid_row_handler=self._odd
                ),
                pacsv.ConvertOptions(
                    column_types=text,
                    include_columns=[f"f{column}" for column in dict.fromkeys(columns)],
                    strings_can_be_null=False,
                ),
            )
        except pa.ArrowInvalid as error:
            if "Empty CSV file" in str(error):
                return
            raise self._explain(error) from error
        row = self.skip + 1
        while True:
            try:
                batch = reader.read_next_batch()
            except StopIteration:
                break
            except (pa.ArrowInvalid, UnicodeDecodeError) as error:
                raise self._explain(error) from error
            if self.wrong is not None:
                raise LogError(self.wrong)
            numbers, row = self._numbers(row, batch.num_rows)
            blank = np.ones(batch.num_rows, dtype=np.bool_)
            for column in batch.columns:
                blank &= pc.equal(column, "").to_numpy(zero_copy_only=False)
            if blank.any():
                numbers, batch = numbers[~blank], batch.filter(pa.array(~blank))
            for start in range(0, batch.num_rows, BLOCK):
                part = batch.slice(start, BLOCK)
                held = {column: part.column(f"f{column}") for column in dict.fromkeys(columns)}
                yield numbers[start : start + BLOCK], held
        if self.wrong is not None:
            raise LogError(self.wrong)

    def _numbers(self, row: int, count: int) -> tuple[NDArray[np.int64], int]:
        """Line numbers of the next rows, blank lines left out, and of the line after them."""
        numbers: list[int] = []
        blank = set(self.blank)
        while len(numbers) < count:
            if row not in blank:
                numbers.append(row)
            row += 1
        return np.array(numbers, dtype=np.int64), row

    def _odd(self, row: Any) -> str:
        """What to do with a row of another number of columns: blank lines are skipped, others are refused."""
        number = row.number + self.skip if row.number is not None else 0
        if not row.text.strip():
            self.blank.append(number)
        elif self.wrong is None:
            self.wrong = (
                f"{self.path}: line {number} has {row.actual_columns} columns, expected {self.count}; correct or "
                "remove that line"
            )
        return "skip"

    def _explain(self, error: Exception) -> LogError:
        if self.wrong is not None:
            return LogError(self.wrong)
        if "UTF" in str(error) or isinstance(error, UnicodeDecodeError):
            return LogError(f"{self.path}: holds bytes that are not text; expected CSV")
        return LogError(f"{self.path}: cannot be read as CSV: {' '.join(str(error).split())}")


class _Parquet:
    """A Parquet file; columns of lists are as many columns as the lists are long."""

    def __init__(self, path: Path) -> None:
        try:
            self.file = pq.ParquetFile(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise LogError(f"{path}: cannot be read as Parquet: {' '.join(str(error).split())}") from error
        self.path = path
        first = next(self.file.iter_batches(1), None)
        if first is None:
            raise LogError(f"{path}: holds no rows")
        self.places = _spread({name: _width(first.column(name)) for name in self.file.schema_arrow.names})
        self.names, self.count = [name for name, _, _ in self.places], len(self.places)

    def blocks(self, columns: Sequence[int]) -> Iterator[tuple[NDArray[np.int64], dict[int, pa.Array]]]:
        """Yield blocks of rows."""
        row = 1
        read = list(dict.fromkeys(self.places[column][1] for column in columns))
        for batch in self.file.iter_batches(BLOCK, columns=read):
            held = {}
            for column in dict.fromkeys(columns):
                _, name, index = self.places[column]
                values = batch.column(name)
                held[column] = values if index is None else pc.list_element(values, index)
            yield np.arange(row, row + batch.num_rows), held
            row += batch.num_rows


class _Arrays:
    """Arrays of equal length by name: a NumPy archive or an HDF5 file."""

    def __init__(self, path: Path, arrays: dict[str, Any]) -> None:
        lengths = {name: len(array) for name, array in arrays.items() if getattr(array, "ndim", 0)}
        if not lengths:
            raise LogError(f"{path}: holds no arrays")
        rows = max(lengths.values())
        self.arrays = {name: arrays[name] for name, length in lengths.items() if length == rows}
        self.rows = rows
        widths = {
            name: int(np.prod(array.shape[1:])) if array.ndim > 1 else None for name, array in self.arrays.items()
        }
        self.places = _spread(widths)
        self.names, self.count = [name for name, _, _ in self.places], len(self.places)

    def blocks(self, columns: Sequence[int]) -> Iterator[tuple[NDArray[np.int64], dict[int, pa.Array]]]:
        """Yield blocks of rows."""
        for start in range(0, self.rows, BLOCK):
            end = min(start + BLOCK, self.rows)
            read: dict[str, NDArray[Any]] = {}
            held = {}
            for column in dict.fromkeys(columns):
                _, name, index = self.places[column]
                if name not in read:
                    read[name] = np.asarray(self.arrays[name][start:end]).reshape(end - start, -1)
                held[column] = pa.array(np.ascontiguousarray(read[name][:, index or 0]))
            yield np.arange(start + 1, end + 1), held


def _spread(widths: dict[str, int | None]) -> list[tuple[str, str, int | None]]:
    """Columns by name, array and place in it: ``pose`` of width 3 is ``pose.0``, ``pose.1``, ``pose.2``."""
    out: list[tuple[str, str, int | None]] = []
    for name, width in widths.items():
        out += [(name, name, None)] if width is None else [(f"{name}.{i}", name, i) for i in range(width)]
    return out


def _width(column: Any) -> int | None:
    return len(column[0]) if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type) else None


def open_table(path: Path, csv: Csv) -> Table:
    """Open a table by its suffix.

    Raises:
        LogError: it is empty or damaged, or a library is missing.
    """
    suffix = path.suffix.lower()
    if suffix == ".parquet":
        return _Parquet(path)
    if suffix == ".npz":
        try:
            return _Arrays(path, dict(np.load(path, allow_pickle=False)))
        except (ValueError, OSError) as error:
            raise LogError(f"{path}: cannot be read as a NumPy archive: {' '.join(str(error).split())}") from error
    if suffix in (".h5", ".hdf5"):
        return _Arrays(path, _hdf5(path))
    return _Text(path, csv)


def _hdf5(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError as error:
        raise LogError(f"{path}: HDF5 needs h5py; install it with: pip install 'legtool[hdf5]'") from error
    found: dict[str, Any] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found[name.replace("/", ".")] = item

    try:
        h5py.File(path, "r").visititems(note)
    except OSError as error:
        raise LogError(f"{path}: cannot be read as HDF5: {' '.join(str(error).split())}") from error
    return found


def _encoding(path: Path) -> str:
    """The encoding of a text file: that of its byte order mark, UTF-8, or Latin-1 where it is not UTF-8."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head:
        raise LogError(f"{path}: is empty; expected rows of comma-separated values")
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if head.count(0) > len(head) // 3:  # every second byte of numbers in UTF-16
        return "utf-16" if head.startswith(_UTF16) else "utf-16-le" if head[1:2] == b"\0" else "utf-16-be"
    if b"\0" in head:
        raise LogError(f"{path}: is not text; expected CSV")
    try:
        io.TextIOWrapper(io.BytesIO(head), encoding="utf-8").read(len(head) - 4)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def describe_tables(path: Path) -> dict[str, Any]:
    """Return ``files``: the number of rows and columns of each table (a header counts as a row), and ``names``.

    Raises:
        LogError: a file is empty or damaged.
    """
    out: dict[str, dict[str, Any]] = {}
    for file in [path] if path.is_file() else tables_in(path):
        table = open_table(file, Csv(files={file.name: None}, header=has_header(file), delimiter=find_delimiter(file)))
        rows = sum(len(numbers) for numbers, _ in table.blocks([0])) + (
            1 if isinstance(table, _Text) and table.names else 0
        )
        out[file.name] = {"rows": rows, "columns": table.count, **({"names": table.names} if table.names else {})}
    return {"files": out}


def has_header(path: Path) -> bool:
    """Whether the first line of a CSV file names its columns: most of its cells are no numbers."""
    cells = _first_cells(path, find_delimiter(path))
    return sum(1 for cell in cells if re.search("[a-df-zA-DF-Z]", cell)) > len(cells) / 2


def find_delimiter(path: Path) -> str:
    """The character between the columns of a CSV file: the one that stands most often in its first line."""
    if path.suffix.lower() not in (".csv", ".tsv"):
        return ","
    with path.open(encoding=_encoding(path), errors="replace", newline="") as file:
        line = re.sub('"[^"]*"', "", file.readline())
    return max((";", "\t", ",", "|"), key=lambda mark: line.count(mark))


def _first_cells(path: Path, delimiter: str) -> list[str]:
    if path.suffix.lower() not in (".csv", ".tsv"):
        return []
    with path.open(encoding=_encoding(path), errors="replace", newline="") as file:
        return next(plain_csv.reader(file, delimiter=delimiter), [])


def tables_in(directory: Path) -> list[Path]:
    """All tables of a directory."""
    return sorted(file for file in directory.iterdir() if file.suffix.lower() in TABLE_SUFFIXES and file.is_file())


def table_files(path: Path, csv: Csv) -> dict[str, Path]:
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
            there = ", ".join(item.name for item in tables_in(path)) or "none"
            raise LogError(f"{path}: has no {pattern}; CSV files there: {there}")
        if len(found) > 1:
            raise LogError(
                f"{path}: {len(found)} files match {pattern} ({found[0].name}, {found[1].name}, …), expected one; "
                "give the files themselves"
            )
        out[pattern] = found[0]
    return out
