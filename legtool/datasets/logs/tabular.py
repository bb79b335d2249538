"""Read CSV logs, one wide file or several with their own rates, in blocks, so that memory use does not grow."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path

import numpy as np

from legtool.configs.topics import CommandSignal, Csv, Signal, TopicSettings
from legtool.datasets.logs.csvfiles import csv_files
from legtool.datasets.logs.facts import LogFacts, StreamFacts
from legtool.datasets.logs.signals import Array, Samples, Stamps, check_stamps, swing_pairs, to_si, width
from legtool.errors import LogError

#: Lines parsed at once.
BLOCK = 4096
_FLAGS = {"true": 1.0, "false": 0.0, "1": 1.0, "0": 0.0}
_TICKS_PER_S = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


class CsvLog:
    """A CSV log as streams of samples.

    Attributes:
        labels: by signal, the name of its stream in error messages.
    """

    def __init__(self, path: Path, topics: TopicSettings, facts: LogFacts) -> None:
        """Find the files and resolve the columns.

        Raises:
            LogError: a file is missing or empty, or its columns differ from the settings.
        """
        csv = topics.csv
        if csv is None:
            raise LogError(
                f"{path}: is CSV, but topics {topics.name!r} describe a bag; choose a CSV preset, such as aliengo_csv, "
                "or write a column map"
            )
        self.name = path.name
        self.tables: list[_Table] = []
        self.labels: dict[str, str] = {}
        for key, file in csv_files(path, csv).items():
            signals = {n: s for n, s in topics.signals().items() if s.file == key or len(csv.files) == 1}
            table = _Table(file, csv, csv.files[key], signals, int(topics.max_jump_s * 1e9))
            self.tables.append(table)
            self.labels.update({n: f"{n} ({file.name}, columns {_listed(table.columns[n])})" for n in signals})
        facts.streams.update({name: StreamFacts(label) for name, label in self.labels.items()})

    def batches(self, seconds: float) -> Iterator[dict[str, Samples]]:
        """Yield the samples of all streams, in pieces of about ``seconds`` each.

        Raises:
            LogError: a line is damaged; the message names it.
        """
        readers = [table.blocks() for table in self.tables]
        last: list[int | None] = [None] * len(readers)
        step = int(seconds * 1e9)
        until: int | None = None
        while readers:
            batch: dict[str, list[Samples]] = {}
            for index, reader in reversed(list(enumerate(readers))):
                while (seen := last[index]) is None or until is None or seen < until:
                    block = next(reader, None)
                    if block is None:
                        del readers[index], last[index]
                        break
                    for name, samples in block.items():
                        batch.setdefault(name, []).append(samples)
                        last[index] = int(samples.stamps_ns[-1])
                    if until is None:
                        until = int(next(iter(block.values())).stamps_ns[0]) + step
            yield {
                name: Samples(np.concatenate([p.stamps_ns for p in parts]), np.concatenate([p.values for p in parts]))
                for name, parts in batch.items()
            }
            behind = [stamp for stamp in last if stamp is not None]
            until = max(until + step, min(behind)) if until is not None and behind else until


class _Table:
    """One CSV file."""

    def __init__(self, path: Path, csv: Csv, count: int, signals: dict[str, Signal], max_jump_ns: int) -> None:
        self.path, self.csv, self.count, self.signals = path, csv, count, signals
        self.max_jump_ns = max_jump_ns
        self.latest: int | None = None
        try:
            with path.open(encoding="utf-8") as file:
                first = file.readline()
        except UnicodeDecodeError as error:
            raise LogError(f"{path}: is not text; expected CSV") from error
        except OSError as error:
            raise LogError(f"{path}: cannot be read ({error.strerror})") from error
        if not first.strip():
            raise LogError(f"{path}: is empty; expected {count} columns")
        cells = first.rstrip("\r\n").split(csv.delimiter)
        if len(cells) != count:
            raise LogError(
                f"{path}: line 1 has {len(cells)} columns, expected {count}; do the topics describe this log?"
            )
        names = [cell.strip().strip('"') for cell in cells] if csv.header else []
        self.stamp = self._resolve((csv.stamp,), names)[0]
        self.columns = {name: self._resolve(signal.columns, names) for name, signal in signals.items()}
        for name, columns in self.columns.items():
            if len(columns) != (expected := width(name, signals[name])):
                raise LogError(
                    f"{path}: {name} names {len(columns)} columns, expected {expected}; correct the column map"
                )

    def _resolve(self, columns: tuple[int | str, ...], names: list[str]) -> list[int]:
        out: list[int] = []
        for column in columns:
            if isinstance(column, str) and column in names:
                out.append(names.index(column))
            elif isinstance(column, int):
                out.append(column)
            elif (ends := re.fullmatch(r"(\d+)-(\d+)", column)) is not None:
                out.extend(range(int(ends[1]), int(ends[2]) + 1))
            else:
                known = ", ".join(names) if names else f"numbers 0 to {self.count - 1} (there is no header)"
                raise LogError(f"{self.path}: no column {column!r}; expected one of: {known}")
        if out and max(out) >= self.count:
            raise LogError(f"{self.path}: no column {max(out)}; the file has {self.count}, numbered from 0")
        return out

    def blocks(self) -> Iterator[dict[str, Samples]]:
        """Yield parsed stretches of the file. A command that governs up to its row is assigned to the row before."""
        self.latest = None
        late = {n for n, s in self.signals.items() if isinstance(s, CommandSignal) and s.governs == "to_row"}
        held: dict[str, Samples] = {}
        rows = 0
        for number, lines in self._lines():
            rows += len(lines)
            block = self._parse(number, lines)
            if not late:
                yield block
                continue
            joined = {n: _join(held[n], s) if n in held else s for n, s in block.items()}
            held = {n: Samples(s.stamps_ns[-1:], s.values[-1:]) for n, s in joined.items()}
            ready = {
                n: Samples(s.stamps_ns[:-1], s.values[1:] if n in late else s.values[:-1]) for n, s in joined.items()
            }
            if len(next(iter(ready.values())).stamps_ns):
                yield ready
        if not rows:
            raise LogError(f"{self.path}: holds no rows below its header; expected at least one row")
        if held:
            yield held

    def _lines(self) -> Iterator[tuple[int, list[str]]]:
        """Yield blocks of lines with the number of their first line; check their columns and drop blank last lines."""
        number = 1
        separators = self.count - 1
        try:
            with self.path.open(encoding="utf-8") as file:
                if self.csv.header:
                    number += len(list(islice(file, 1)))
                while lines := list(islice(file, BLOCK)):
                    if len(lines) < BLOCK:
                        while lines and not lines[-1].strip():
                            lines.pop()
                    for offset, line in enumerate(lines):
                        if line.count(self.csv.delimiter) != separators:
                            found = line.count(self.csv.delimiter) + 1 if line.strip() else 0
                            raise LogError(
                                f"{self.path}: line {number + offset} has {found} columns, expected {self.count}; "
                                "correct or remove that line"
                            )
                    if lines:
                        yield number, lines
                    number += len(lines)
        except UnicodeDecodeError as error:
            raise LogError(f"{self.path}: holds bytes that are not text after line {number}; expected CSV") from error

    def _parse(self, number: int, lines: list[str]) -> dict[str, Samples]:
        cells = [line.rstrip("\r\n").split(self.csv.delimiter) for line in lines]
        stamps = self._stamps(number, [row[self.stamp] for row in cells])
        out: dict[str, Samples] = {}
        for name, signal in self.signals.items():
            columns = self.columns[name]
            where = self._where(number, name, columns)
            if name == "swing":
                flags = [[_FLAGS.get(row[c].strip().lower(), np.nan) for c in columns] for row in cells]
                values = swing_pairs(np.array(flags), where)
            else:
                values = to_si(signal, self._numbers(number, cells, columns), where)
            out[name] = Samples(stamps, values)
        return out

    def _where(self, number: int, name: str, columns: list[int]) -> Callable[[int], str]:
        return lambda row: f"{self.path}: line {number + row}, {name} in columns {_listed(columns)}"

    def _numbers(self, number: int, cells: list[list[str]], columns: list[int]) -> Array:
        try:
            values = np.array([[float(row[column]) for column in columns] for row in cells])
        except ValueError as error:
            raise self._name_bad_number(number, cells, columns) from error
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, column = bad[0]
            raise LogError(
                f"{self.path}: line {number + row}, column {columns[column]} is {values[row, column]}, "
                "expected a finite number; correct or remove that line"
            )
        return values

    def _stamps(self, number: int, texts: list[str]) -> Stamps:
        """Convert decimal text to whole nanoseconds; a float of seconds since 1970 would resolve only 0.2 µs."""
        ticks = _TICKS_PER_S[self.csv.stamp_unit]
        out = np.empty(len(texts), dtype=np.int64)
        for row, text in enumerate(texts):
            try:
                out[row] = int((Decimal(text.strip()) * ticks).to_integral_value())
            except (InvalidOperation, ValueError, OverflowError) as error:
                raise LogError(
                    f"{self.path}: line {number + row}, column {self.stamp} is {text.strip()!r}, "
                    f"expected a time [{self.csv.stamp_unit}]; correct or remove that line"
                ) from error
        check_stamps(out, self.latest, self.max_jump_ns, lambda row: f"{self.path}: line {number + row}")
        self.latest = int(out[-1])
        return out

    def _name_bad_number(self, number: int, cells: list[list[str]], columns: list[int]) -> LogError:
        for offset, row in enumerate(cells):
            for column in columns:
                try:
                    float(row[column])
                except ValueError:
                    held = repr(row[column].strip()) if row[column].strip() else "empty"
                    return LogError(
                        f"{self.path}: line {number + offset}, column {column} is {held}, expected a number; "
                        "correct or remove that line"
                    )
        raise AssertionError("a number that could not be read can be read")


def _join(a: Samples, b: Samples) -> Samples:
    return Samples(np.concatenate([a.stamps_ns, b.stamps_ns]), np.concatenate([a.values, b.values]))


def _listed(columns: list[int]) -> str:
    contiguous = len(columns) > 2 and columns == list(range(columns[0], columns[-1] + 1))
    return f"{columns[0]}-{columns[-1]}" if contiguous else ", ".join(map(str, columns))
