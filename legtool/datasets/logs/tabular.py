"""Read logs of tables, one wide one or several with their own rates, in blocks, so that memory use does not grow."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from legtool.configs.topics import CommandSignal, Csv, Signal, TopicSettings
from legtool.datasets.logs.facts import LogFacts, StreamFacts
from legtool.datasets.logs.signals import MAX_LATE_NS, Array, Samples, Stamps, check_stamps, swing_pairs, to_si, width
from legtool.datasets.logs.tablefiles import open_table, table_files
from legtool.errors import LogError

_FLAGS = {"true": 1.0, "false": 0.0, "1": 1.0, "0": 0.0, "1.0": 1.0, "0.0": 0.0}
_TICKS_PER_S = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
Numbers = NDArray[np.int64]
#: A block of rows: their numbers and stamps, and by signal the values, in which NaN stands for an empty cell.
_Block = tuple[Numbers, Stamps, dict[str, Array]]


class TableLog:
    """A log of tables as streams of samples.

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
        for key, file in table_files(path, csv).items():
            signals = {n: s for n, s in topics.signals().items() if s.file == key or len(csv.files) == 1}
            table = _Table(file, csv, csv.files[key], signals, topics, facts)
            self.tables.append(table)
            self.labels.update({n: f"{n} ({file.name}, columns {_listed(table.columns[n])})" for n in table.columns})
        self.facts = facts
        facts.streams.update({name: StreamFacts(label) for name, label in self.labels.items()})
        if facts.split and len(self.tables) > 1:
            raise LogError(f"{path}: split_at_jumps is for logs of one table; this one has {len(self.tables)}")
        if not self.labels.keys() & {"feet", "joints"}:
            raise LogError(f"{path}: has columns for neither feet nor joints; one of them is needed")

    def batches(self, seconds: float) -> Iterator[dict[str, Samples] | None]:
        """Yield the samples of all streams, in pieces of about ``seconds`` each; None where time begins anew.

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
                    latest, streams = block
                    if (seen := last[index]) is not None and self.facts.split and latest < seen:
                        yield _joined(batch)
                        yield None
                        batch, until = {}, latest + step
                    for name, samples in streams.items():
                        batch.setdefault(name, []).append(samples)
                    last[index] = latest
                    if until is None:
                        until = latest + step
            yield _joined(batch)
            behind = [stamp for stamp in last if stamp is not None]
            until = max(until + step, min(behind)) if until is not None and behind else until


class _Table:
    """One table, of which some columns are signals."""

    def __init__(
        self,
        path: Path,
        csv: Csv,
        count: int | None,
        signals: dict[str, Signal],
        topics: TopicSettings,
        facts: LogFacts,
    ) -> None:
        self.path, self.csv, self.signals, self.facts = path, csv, signals, facts
        self.max_jump_ns, self.events = int(topics.max_jump_s * 1e9), topics.events
        self.latest: int | None = None
        self.begins: list[int] = []  # rows of the block at which time begins anew
        try:
            self.table = open_table(path, csv)
        except OSError as error:
            raise LogError(f"{path}: cannot be read ({error.strerror})") from error
        if count is not None and self.table.count != count:
            raise LogError(
                f"{path}: line 1 has {self.table.count} columns, expected {count}; do the topics describe this log?"
            )
        self.stamp = self._resolve((csv.stamp,))[0] if csv.stamp is not None else None
        self.columns: dict[str, list[int]] = {}
        for name, signal in signals.items():
            try:
                columns = self._resolve(signal.columns)
            except LogError:
                if not signal.optional:
                    raise
                continue
            if len(columns) != (expected := width(name, signal)):
                raise LogError(
                    f"{path}: {name} names {len(columns)} columns, expected {expected}; correct the column map"
                )
            self.columns[name] = columns

    def _resolve(self, columns: tuple[int | str, ...]) -> list[int]:
        names, out = self.table.names, []
        for column in columns:
            spread = [i for i, name in enumerate(names) if re.fullmatch(re.escape(str(column)) + r"\.\d+", name)]
            if isinstance(column, str) and column in names:
                out.append(names.index(column))
            elif isinstance(column, int):
                out.append(column)
            elif spread:
                out.extend(spread)
            elif (ends := re.fullmatch(r"(\d+)-(\d+)", column)) is not None:
                out.extend(range(int(ends[1]), int(ends[2]) + 1))
            else:
                known = ", ".join(names) if names else f"numbers 0 to {self.table.count - 1} (there is no header)"
                raise LogError(f"{self.path}: no column {column!r}; expected one of: {known}")
        if out and max(out) >= self.table.count:
            raise LogError(f"{self.path}: no column {max(out)}; the file has {self.table.count}, numbered from 0")
        return out

    def blocks(self) -> Iterator[tuple[int, dict[str, Samples]]]:
        """Yield the latest stamp and the samples of stretches of the file.

        A command that governs up to its row is assigned to the row before.
        """
        self.latest = None
        late = {n for n, s in self.signals.items() if isinstance(s, CommandSignal) and s.governs == "to_row"}
        held: _Block | None = None
        rows = 0
        for block in self._parsed():
            rows += len(block[0])
            if not late:
                yield self._samples(block)
                continue
            if held is not None and block[1][0] < held[1][0] - MAX_LATE_NS:
                yield self._samples(held)
                held = None
            numbers, stamps, values = block if held is None else _join(held, block)
            held = (numbers[-1:], stamps[-1:], {n: v[-1:] for n, v in values.items()})
            if len(numbers) > 1:
                shifted = {n: v[1:] if n in late else v[:-1] for n, v in values.items()}
                yield self._samples((numbers[:-1], stamps[:-1], shifted))
        if not rows:
            raise LogError(f"{self.path}: holds no rows below its header; expected at least one row")
        if held is not None:
            yield self._samples(held)

    def _samples(self, block: _Block) -> tuple[int, dict[str, Samples]]:
        """Samples of each signal; a row in which all its cells are empty is none of its samples."""
        numbers, stamps, values = block
        out: dict[str, Samples] = {}
        for name, held in values.items():
            empty = np.isnan(held)
            there = ~empty.any(axis=1)
            self.facts.streams[name].incomplete += int((empty.any(axis=1) & ~empty.all(axis=1)).sum())
            chosen, lines = held[there], numbers[there]
            where = self._where(lines, name)
            samples = chosen if name == "swing" else to_si(self.signals[name], chosen, where)
            out[name] = Samples(stamps[there], samples)
        return int(stamps.max()), out

    def _parsed(self) -> Iterator[_Block]:
        wanted = [column for columns in self.columns.values() for column in columns]
        if self.stamp is not None:
            wanted.append(self.stamp)
        row = 0
        for numbers, columns in self.table.blocks(wanted):
            stamps = self._stamps(numbers, columns, row)
            row += len(numbers)
            values: dict[str, Array] = {}
            for name, chosen in self.columns.items():
                if name == "swing":
                    flags = [
                        [_FLAGS.get(str(cell).strip().lower(), np.nan) for cell in columns[c].to_pylist()]
                        for c in chosen
                    ]
                    values[name] = swing_pairs(np.array(flags).T, self._where(numbers, name))
                else:
                    values[name] = np.column_stack([self._numbers(numbers, c, columns[c]) for c in chosen])
            begin = 0
            for end in [*self.begins, len(numbers)]:
                if end > begin:
                    yield numbers[begin:end], stamps[begin:end], {n: v[begin:end] for n, v in values.items()}
                begin = end

    def _where(self, numbers: Numbers, name: str) -> Callable[[int], str]:
        columns = _listed(self.columns[name])
        return lambda row: f"{self.path}: line {numbers[row]}, {name} in columns {columns}"

    def _numbers(self, numbers: Numbers, column: int, cells: Any) -> Array:
        """Numbers of a column, NaN where a cell is empty; at step instants each row needs all of them."""
        if not pa.types.is_string(cells.type):
            values = np.asarray(cells.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
        else:
            text = pc.utf8_trim_whitespace(cells)
            if self._decimal_comma:
                text = pc.replace_substring(text, ",", ".")
            text = pc.if_else(pc.equal(text, ""), pa.scalar(None, pa.string()), text)
            try:
                values = np.asarray(text.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
            except pa.ArrowInvalid as error:
                raise self._bad_number(numbers, column, cells.to_pylist()) from error
        if (self.events and np.isnan(values).any()) or np.isinf(values).any():
            raise self._bad_number(numbers, column, cells.to_pylist())
        return values

    @property
    def _decimal_comma(self) -> bool:
        return self.csv.decimal == "," or (self.csv.decimal is None and self.csv.delimiter != ",")

    def _bad_number(self, numbers: Numbers, column: int, cells: list[Any]) -> LogError:
        for number, cell in zip(numbers.tolist(), cells, strict=True):
            text = str(cell).strip().replace(",", "." if self._decimal_comma else ",")
            what = f"{self.path}: line {number}, column {column} is"
            try:
                value = float(text)
            except ValueError:
                held = repr(text) if text else "empty"
                return LogError(f"{what} {held}, expected a number; correct or remove that line")
            if np.isinf(value) or (self.events and np.isnan(value)):
                return LogError(f"{what} {value}, expected a finite number; correct or remove that line")
        raise AssertionError("a number that could not be read can be read")

    def _stamps(self, numbers: Numbers, columns: dict[int, Any], row: int) -> Stamps:
        """Convert times to whole nanoseconds; a float of seconds since 1970 would resolve only 0.2 µs."""
        if self.stamp is None:
            out = np.round(np.arange(row, row + len(numbers)) * (1e9 / (self.csv.rate_hz or 1.0))).astype(np.int64)
        elif pa.types.is_string(columns[self.stamp].type):
            out = self._decimals(numbers, columns[self.stamp].to_pylist())
        elif pa.types.is_timestamp(columns[self.stamp].type):
            out = columns[self.stamp].cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy(zero_copy_only=False)
        else:
            held = columns[self.stamp].to_numpy(zero_copy_only=False)
            ticks = _TICKS_PER_S[self.csv.stamp_unit]
            out = held.astype(np.int64) * ticks if held.dtype.kind in "iu" else np.round(held * ticks).astype(np.int64)
        self.begins = []
        if self.facts.split and len(out):
            steps = np.diff(out, prepend=out[:1] if self.latest is None else np.int64(self.latest))
            self.begins = np.flatnonzero(steps < -MAX_LATE_NS).tolist()
            self.latest = int(out[-1])
            return np.asarray(out, dtype=np.int64)
        check_stamps(out, self.latest, self.max_jump_ns, lambda row: f"{self.path}: line {numbers[row]}")
        self.latest = max(int(out.max()), self.latest or int(out[0])) if len(out) else self.latest
        return np.asarray(out, dtype=np.int64)

    def _decimals(self, numbers: Numbers, texts: list[str]) -> Stamps:
        ticks = _TICKS_PER_S[self.csv.stamp_unit]
        out = np.empty(len(texts), dtype=np.int64)
        for row, text in enumerate(texts):
            try:
                number = text.strip().replace(",", ".") if self._decimal_comma else text.strip()
                out[row] = int((Decimal(number) * ticks).to_integral_value())
            except (InvalidOperation, ValueError, OverflowError) as error:
                hint = "; is the time in a finer unit (stamp_unit)?" if isinstance(error, OverflowError) else ""
                raise LogError(
                    f"{self.path}: line {numbers[row]}, column {self.stamp} is {text.strip()!r}, "
                    f"expected a time [{self.csv.stamp_unit}]{hint}; correct or remove that line"
                ) from error
        return out


def _joined(batch: dict[str, list[Samples]]) -> dict[str, Samples]:
    return {
        name: Samples(np.concatenate([p.stamps_ns for p in parts]), np.concatenate([p.values for p in parts]))
        for name, parts in batch.items()
    }


def _join(a: _Block, b: _Block) -> _Block:
    values = {name: np.concatenate([value, b[2][name]]) for name, value in a[2].items()}
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]]), values


def _listed(columns: list[int]) -> str:
    contiguous = len(columns) > 2 and columns == list(range(columns[0], columns[-1] + 1))
    return f"{columns[0]}-{columns[-1]}" if contiguous else ", ".join(map(str, columns))
