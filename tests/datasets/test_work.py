import json
import signal
import subprocess
import sys

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.datasets.work import DATASET, LOCK, RESULTS, RUN, check_free, claim, digest
from legtool.errors import DatasetError, OutputError

IDENTITY = {"kind": "motion", "settings": {"x": 1, "grid": [1.0, 2.0]}, "inputs": [{"name": "a", "sha256": "0"}]}


def names(path):
    return sorted(item.name for item in path.iterdir())


def test_equal_content_has_one_digest_and_a_change_of_anything_another():
    robot = load_robot("aliengo")
    content = {"robot": robot, "map": np.arange(6.0).reshape(2, 3), "speeds": (0.1, np.float64(0.2)), "name": None}
    again = dict(reversed([*content.items(), ("robot", robot.to_dict())]))
    assert digest(content) == digest(again)
    for change in (
        {"robot": robot.replace(foot_radius=robot.foot_radius + 1e-9)},
        {"map": np.arange(6.0).reshape(3, 2)},
        {"map": np.arange(6.0, dtype=np.float32).reshape(2, 3)},
        {"speeds": [0.1, 0.2000001]},
        {"name": ""},
    ):
        assert digest({**content, **change}) != digest(content)
    with pytest.raises(TypeError, match="object has no content"):
        digest({"what": object()})
    with pytest.raises(ValueError, match="not JSON compliant"):
        digest(float("nan"))


def test_the_same_work_carries_on_and_other_work_is_refused_by_its_first_difference(tmp_path):
    out = tmp_path / "new" / "out"
    with claim(out, RUN, IDENTITY, commit="first") as begun:
        assert begun == {**IDENTITY, "commit": "first"}
        assert json.loads((out / "run.json").read_text()) == begun
        (out / "models.npz").write_bytes(b"made")
    with claim(out, RUN, IDENTITY, commit="second") as there:
        assert there["commit"] == "first"
    for change, message in (
        ({"settings": {"x": 2, "grid": [1.0, 2.0]}}, r"settings\.x is 1 there, 2 here"),
        ({"settings": {"x": 1, "grid": [1.0, 3.0]}}, r"settings\.grid\.1 is 2\.0 there, 3\.0 here"),
        ({"settings": {"x": 1, "grid": [1.0]}}, r"settings\.grid is \[1\.0, 2\.0\] there, \[1\.0\] here"),
        ({"inputs": [{"name": "a", "sha256": "1"}]}, r'inputs\.0\.sha256 is "0" there, "1" here'),
        ({"robot": "go2"}, r'robot is null there, "go2" here'),
    ):
        refusal = rf"out: holds a run .*\({message}\); choose another --out, or remove it"
        with pytest.raises(OutputError, match=refusal), claim(out, RUN, IDENTITY | change):
            pytest.fail("other work was let in")
    assert names(out) == ["models.npz", "run.json"]


def test_a_marker_alone_is_nothing_that_could_be_lost(tmp_path):
    with claim(tmp_path, DATASET, IDENTITY):
        pass
    with claim(tmp_path, DATASET, {**IDENTITY, "kind": "scenes"}) as begun:
        assert begun["kind"] == "scenes"
    (tmp_path / "manifest.json").write_text('{"name": "of a web page"}')
    with pytest.raises(OutputError, match="kind is null there"), claim(tmp_path, DATASET, IDENTITY):
        pytest.fail("a file of someone else's was claimed")


def test_results_are_written_anew_whatever_they_came_from(tmp_path):
    (tmp_path / "results.json").write_text("{}")
    (tmp_path / "report.html").write_text("old")
    with claim(tmp_path, RESULTS):
        assert names(tmp_path) == [LOCK, "report.html", "results.json"]
    assert names(tmp_path) == ["report.html", "results.json"]


def test_a_directory_that_holds_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    for out, message in ((tmp_path, r"holds something else \(thesis.tex"), (tmp_path / "thesis.tex", "is a file")):
        with pytest.raises(OutputError, match=message), claim(out, RUN, IDENTITY):
            pytest.fail("a directory of someone else's was claimed")
    assert names(tmp_path) == ["thesis.tex"]
    (tmp_path / "nowhere").symlink_to("missing")
    with pytest.raises(OutputError, match="is a file"):
        check_free(tmp_path / "nowhere", "run.json")


def test_a_damaged_marker_is_named(tmp_path):
    (tmp_path / "run.json").write_text('{"kind": "mo')
    (tmp_path / "best.pt").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"run\.json: not readable as JSON"), claim(tmp_path, RUN, IDENTITY):
        pytest.fail("it was claimed")
    assert LOCK not in names(tmp_path)


def test_one_process_at_a_time_holds_a_directory(tmp_path):
    refused = pytest.raises(OutputError, match="another legtool process is writing here; wait for it to end")
    with claim(tmp_path, RUN, IDENTITY), refused, claim(tmp_path, RUN, IDENTITY):
        pytest.fail("two hold it")
    with claim(tmp_path, RUN, IDENTITY):
        pass
    assert LOCK not in names(tmp_path)


def test_a_link_in_the_lock_s_place_is_not_followed(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    out = tmp_path / "out"
    out.mkdir()
    (out / LOCK).symlink_to(tmp_path / "thesis.tex")
    with pytest.raises(OutputError, match="cannot be written"), claim(out, RUN, IDENTITY):
        pytest.fail("it was claimed")
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


#: Claims and lets go again and again; a file that only one can hold at a time tells of two at once.
_CONTEND = """
import os, sys, time
from pathlib import Path
from legtool.datasets.work import RUN, claim
from legtool.errors import OutputError
out, end, held = Path(sys.argv[1]), time.monotonic() + 3, 0
while time.monotonic() < end:
    try:
        with claim(out, RUN, {"x": 1}):
            os.close(os.open(out.parent / "inside", os.O_CREAT | os.O_EXCL))
            os.unlink(out.parent / "inside")
            held += 1
    except OutputError:
        pass
print(held)
"""


def test_a_lock_that_is_taken_and_let_go_in_quick_turns_never_has_two_holders(tmp_path):
    command = [sys.executable, "-c", _CONTEND, str(tmp_path / "out")]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    for process in processes:
        out, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
        assert int(out) > 0


_WRITE = """
import sys
from pathlib import Path
from legtool.datasets.files import write_text
from legtool.datasets.work import RUN, claim
out = Path(sys.argv[1])
with claim(out, RUN, {"x": 1}):
    write_text(out / "models.npz", "made")
"""


def test_killed_it_holds_nothing_any_more_and_its_half_written_files_are_swept(tmp_path, legtool):
    killed = legtool(str(tmp_path / "out"), code=_WRITE, kill_at_rename=2)
    assert killed.returncode == -signal.SIGKILL
    assert len(names(tmp_path / "out")) == 3  # the lock's file, half a file under a temporary name, the marker
    done = legtool(str(tmp_path / "out"), code=_WRITE)
    assert done.returncode == 0, done.stderr
    assert names(tmp_path / "out") == ["models.npz", "run.json"]
