import pickle
import signal

import pytest

from legtool.errors import DatasetError, OutputError
from legtool.evaluation.suites.trials import TrialKey, Trials, trial_key

DECIDES = {"world": {"gap": 0.1}, "robot": {"mass": 20.0}}


def test_a_file_is_named_by_world_planner_number_and_digest(tmp_path):
    key = trial_key("gap 10/a", "h3", 7, DECIDES)
    assert Trials(tmp_path, "planner").path(key) == tmp_path / "trials" / f"gap_10_a.h3.0007-{key.digest[:12]}.json"
    assert Trials(tmp_path, "vital", ".npz").path(key).suffix == ".npz"


def test_whatever_decides_a_trial_gives_it_a_file_of_its_own():
    changes = [{"world": {"gap": 0.2}}, {"robot": {"mass": 20.1}}, {"bundle": None}]
    keys = [trial_key("gap", "h3", 0, DECIDES | change) for change in ({}, *changes)]
    keys += [trial_key("gap", "h5", 0, DECIDES), trial_key("gap", "h3", 1, DECIDES)]
    assert len({key.digest for key in keys}) == len(keys)
    assert trial_key("gap", "h3", 0, dict(reversed(DECIDES.items()))) == keys[0]


def test_what_is_finished_is_kept_and_only_what_is_missing_is_pending(tmp_path):
    keys = [trial_key("gap", "h3", k, DECIDES) for k in range(3)]
    with Trials(tmp_path / "out", "planner") as trials:
        assert trials.pending([*keys, keys[0]]) == keys
        trials.write(keys[1], {"success": True})
    with Trials(tmp_path / "out", "planner") as trials:
        assert trials.pending(keys) == [keys[0], keys[2]]
        assert trials.read(keys[1]) == {"success": True}
        with pytest.raises(DatasetError, match="no such file"):
            trials.read(keys[0])
        assert trials.pending([trial_key("gap", "h3", 1, {**DECIDES, "robot": {}})])


def test_another_suite_something_else_and_a_second_process_are_refused(tmp_path):
    with Trials(tmp_path / "out", "planner") as trials:
        trials.write(TrialKey("a", "b", 0, "0" * 64), {})
        with pytest.raises(OutputError, match="another legtool process"), Trials(tmp_path / "out", "planner"):
            pass
    with pytest.raises(OutputError, match='suite is "planner" there, "vital" here'), Trials(tmp_path / "out", "vital"):
        pass
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match=r"holds something else"), Trials(tmp_path, "planner"):
        pass


def test_other_processes_write_under_the_lock_of_the_one_that_holds_it(tmp_path):
    key = trial_key("gap", "h3", 0, DECIDES)
    with Trials(tmp_path / "out", "planner") as trials:
        pickle.loads(pickle.dumps(trials)).write(key, {"success": False})
        assert trials.read(key) == {"success": False}


_SUITE = """
import sys
from pathlib import Path
from legtool.evaluation.suites.trials import Trials, trial_key
with Trials(Path(sys.argv[1]), "planner") as trials:
    for key in trials.pending(trial_key("gap", "h3", k, {}) for k in range(3)):
        trials.write(key, {"number": key.number})
        print(key.number)
"""


def test_killed_between_two_trials_a_suite_carries_on_with_the_next(tmp_path, legtool):
    assert legtool(str(tmp_path / "out"), code=_SUITE, kill_at_rename=3).returncode == -signal.SIGKILL
    done = legtool(str(tmp_path / "out"), code=_SUITE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "2"]
    assert len(list((tmp_path / "out" / "trials").iterdir())) == 3
