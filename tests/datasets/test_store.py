import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from legtool.datasets import store as store_module
from legtool.datasets.files import sha256
from legtool.datasets.store import Store, data_hash, load_dataset, part_path, write_part
from legtool.errors import DatasetError, OutputError

HEADER = {"kind": "motion", "robot": {"name": "a"}, "settings": {"x": 1}, "seed": 0, "inputs": [], "commit": None}


def part_table(index: int) -> pa.Table:
    return pa.table({"value": [float(index), float(index) + 0.5]})


def fill(path: Path, total: int = 3, header: dict = HEADER) -> dict:
    with Store(path, header) as store:
        for index in store.pending(total):
            write_part(part_path(path, index), part_table(index), counts={"steps": 2})
        return store.finish(total)


def contents(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}


def test_a_finished_dataset_loads_with_counts_summed(tmp_path: Path) -> None:
    manifest = fill(tmp_path / "d")
    dataset = load_dataset(tmp_path / "d", "motion")
    assert dataset.table["value"].to_pylist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert manifest["counts"] == {"steps": 6}
    assert manifest["rows"] == 6
    assert len(data_hash(manifest)) == 64


def test_an_interrupted_dataset_is_carried_on_to_the_same_bytes(tmp_path: Path) -> None:
    fill(tmp_path / "whole")
    with Store(tmp_path / "cut", HEADER):
        write_part(part_path(tmp_path / "cut", 1), part_table(1), counts={"steps": 2})
    (tmp_path / "cut" / ".part-00000.parquet.99.tmp").write_bytes(b"half")
    with pytest.raises(DatasetError, match="not finished"):
        load_dataset(tmp_path / "cut")
    fill(tmp_path / "cut")
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def test_other_settings_are_refused_and_named(tmp_path: Path) -> None:
    fill(tmp_path / "d")
    before = contents(tmp_path / "d")
    with pytest.raises(OutputError, match=r"settings\.x is 1 there, 2 here"):
        fill(tmp_path / "d", header={**HEADER, "settings": {"x": 2}})
    assert contents(tmp_path / "d") == before


def test_two_writers_do_not_share_a_directory(tmp_path: Path) -> None:
    with Store(tmp_path / "d", HEADER), pytest.raises(OutputError, match="another legtool process"):
        Store(tmp_path / "d", HEADER)


def test_an_altered_part_is_noticed(tmp_path: Path) -> None:
    fill(tmp_path / "d")
    part = tmp_path / "d" / "part-00001.parquet"
    pq.write_table(part_table(7), part)
    with pytest.raises(DatasetError, match=r"part-00001.parquet: its bytes differ"):
        load_dataset(tmp_path / "d")
    part.unlink()
    with pytest.raises(DatasetError, match="missing"):
        load_dataset(tmp_path / "d")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"schema_version": 99}, "newer than 1; upgrade legtool"),
        ({"kind": "footholds"}, "holds a footholds dataset, expected a motion dataset"),
        ({"parts": [{"name": "../../etc/passwd", "sha256": "0"}]}, "lies outside"),
    ],
)
def test_a_wrong_manifest_is_refused(tmp_path: Path, change: dict, expected: str) -> None:
    fill(tmp_path / "d")
    path = tmp_path / "d" / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(DatasetError, match=expected):
        load_dataset(tmp_path / "d", "motion")


def test_not_a_dataset(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not a dataset"):
        store_module.load_manifest(tmp_path)


def forge(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Something else in a manifest."""
    manifest = json.loads((path / "manifest.json").read_text())
    change(manifest)
    (path / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    "change",
    [
        {"parts": None}, {"parts": [1]}, {"parts": [{"name": 1}]}, {"parts": [{"name": "part-00000.parquet"}]},
        {"parts": [{"name": "\0", "sha256": ""}]}, {"robot": []}, {"robot": {}}, {"robot": {"name": 1}},
        {"counts": {"steps": "many"}}, {"rows": "all"}, {"settings": 1}, {"kind": [1]}, {"schema_version": 10**4000},
    ],
)  # fmt: skip
def test_a_forged_manifest_is_a_damaged_dataset(change: dict[str, Any], tmp_path: Path) -> None:
    fill(tmp_path / "d")
    forge(tmp_path / "d", lambda manifest: manifest.update(change))
    with pytest.raises(DatasetError) as told:
        load_dataset(tmp_path / "d")
    assert len(str(told.value)) < 600


@pytest.mark.parametrize("damage", ["cut", "pages", "other columns"])
def test_a_damaged_part_with_a_matching_hash_is_named(damage: str, tmp_path: Path) -> None:
    fill(tmp_path / "d")
    part = tmp_path / "d" / "part-00000.parquet"
    data = bytearray(part.read_bytes())
    if damage == "cut":
        part.write_bytes(data[: len(data) // 2])
    elif damage == "pages":
        data[4 : len(data) // 3] = bytes(len(data) // 3 - 4)
        part.write_bytes(data)
    else:
        pq.write_table(pa.table({"other": [1]}), part)
    forge(tmp_path / "d", lambda manifest: manifest["parts"][0].update(sha256=sha256(part)))
    with pytest.raises(DatasetError, match=r"part-00000\.parquet"):
        load_dataset(tmp_path / "d", schema=pa.schema([("value", pa.float64())]))
