import errno

import pytest

from legtool.datasets.files import replacing, sweep_temporaries, write_text
from legtool.errors import OutputError


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    target = tmp_path / "f"
    target.write_text("old")
    with pytest.raises(OutputError, match="no space left"), replacing(target) as temporary:
        temporary.write_text("new, but ha")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["f"]


def test_two_writers_of_one_process_have_names_of_their_own(tmp_path):
    with replacing(tmp_path / "f") as one, replacing(tmp_path / "f") as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
    assert (tmp_path / "f").read_text() == "one"


def test_a_link_is_replaced_and_what_it_points_to_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    (tmp_path / "f").symlink_to("thesis.tex")
    write_text(tmp_path / "f", "new")
    assert (tmp_path / "thesis.tex").read_text() == "years of work"
    assert not (tmp_path / "f").is_symlink() and (tmp_path / "f").read_text() == "new"


def test_what_killed_writers_left_is_removed_at_any_depth_and_nothing_else(tmp_path):
    keep = ["part.tmp", ".hidden", ".notes.tmp", "inner/.x.12.tmp~"]
    gone = [".part-00000.parquet.99.tmp", "inner/.a.json.4711.0123abcd.tmp"]
    for name in (*keep, *gone):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    elsewhere = tmp_path.parent / f"{tmp_path.name}_elsewhere"
    elsewhere.mkdir()
    (elsewhere / ".f.1.0123abcd.tmp").write_text("x")
    (tmp_path / "link").symlink_to(elsewhere)
    sweep_temporaries(tmp_path)
    assert all((tmp_path / name).exists() for name in keep)
    assert not any((tmp_path / name).exists() for name in gone)
    assert (elsewhere / ".f.1.0123abcd.tmp").exists()


def test_beside_one_name_only_its_own_leftovers_are_removed(tmp_path):
    for name in (".bundle.7.0123abcd.tmp", ".bundle.2.7.0123abcd.tmp", ".other.7.0123abcd.tmp"):
        (tmp_path / name).mkdir()
    sweep_temporaries(tmp_path, "bundle")
    assert sorted(item.name for item in tmp_path.iterdir()) == [".bundle.2.7.0123abcd.tmp", ".other.7.0123abcd.tmp"]
