from dataclasses import fields

import numpy as np
import pytest

from legtool.configs.settings import build
from legtool.configs.topics import TopicSettings, load_topics
from legtool.datasets.logs import tablefiles
from legtool.datasets.logs.log import describe_log, read_log
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.errors import LogError, SettingsError
from legtool_runtime.rotations import to_base, to_world


def read(path, topics, robot, **options) -> Recording:
    return concatenate(list(read_log(path, topics, robot, **options)))


def seconds(stamp: int) -> str:
    """Nanoseconds as a decimal, exactly."""
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"


@pytest.fixture
def aliengo_rows(robot) -> list[list[str]]:
    """Rows as in the Aliengo's logs: a straight walk at 0.3 m/s, a step each 0.3 s."""
    rows = []
    for i in range(40):
        feet = robot.stance + np.array([0.05, 0, 0]) * np.array([1, -1, -1, 1])[:, None] * (-1) ** i
        numbers = [0.01 * i, 0, 0, *feet.ravel(), 0.09 * i, 0, 0.38, 0.3, 0, 0, 0.0, *np.zeros(12)]
        numbers += [90, 80, 70, 60, 0, 0, 0, 1, 0, 0, 0]
        flags = ["False", "False"] if i == 0 else [str(i % 2 == 0), str(i % 2 == 1)]
        rows.append([seconds(1_675_616_120_150_000_000 + i * 300_000_000), *map(repr, map(float, numbers)), *flags])
    return rows


@pytest.fixture
def write(tmp_path):
    def put(rows: list[list[str]], name: str = "log.csv"):
        path = tmp_path / name
        path.write_text("".join(",".join(row) + "\n" for row in rows))
        return path

    return put


def test_the_aliengo_preset_reads_what_stands_there(robot, write, aliengo_rows):
    got = read(write(aliengo_rows), load_topics("aliengo_csv"), robot)
    assert got.events and len(got) == 40
    assert np.array_equal(got.stamps_ns, 1_675_616_120_150_000_000 + np.arange(40) * 300_000_000)
    assert np.allclose(got.position_world[:, 0], 0.09 * np.arange(40))
    assert got.swing_pair.tolist() == [-1] + [i % 2 for i in range(1, 40)]
    assert np.allclose(got.orientation, [1, 0, 0, 0])
    assert np.allclose(got.contact_force, [90, 80, 70, 60])


def test_a_command_that_stands_at_a_steps_end_governs_from_the_row_before(robot, write, aliengo_rows, monkeypatch):
    path = write(aliengo_rows)
    whole = read(path, load_topics("aliengo_csv"), robot)
    assert np.allclose(whole.command[:, 0], 0.01 * np.array([*range(1, 40), 39]))
    monkeypatch.setattr(tablefiles, "BLOCK", 7)  # block boundaries change nothing
    blocks = read(path, load_topics("aliengo_csv"), robot, chunk_s=1.0)
    for field in fields(whole):
        assert np.array_equal(getattr(whole, field.name), getattr(blocks, field.name)), field.name


def test_several_files_with_their_own_rates_equal_the_bag(tmp_path, topics, robot, motion, write_log):
    def table(name: str, signal, shift: int = 0) -> None:
        rows = zip(signal[0].tolist(), signal[1].tolist(), strict=True)
        text = "".join(";".join([str(t + shift), *map(repr, values)]) + "\n" for t, values in rows)
        (tmp_path / name).write_text(text)

    stamps, pose = motion.pose
    table("odometry.csv", (stamps, np.concatenate([pose, motion.twist[1]], axis=1)))
    table("command.csv", motion.command)
    angles = np.degrees(motion.joints[1].reshape(-1, 4, 3)[:, [1, 0, 3, 2]].reshape(-1, 12))
    table("joints.csv", (motion.joints[0], angles))
    table("force.csv", motion.force)
    settings = build(
        TopicSettings,
        {
            "name": "tables",
            "csv": {
                "files": {"odometry.csv": 14, "command.csv": 4, "joints.csv": 13, "force.csv": 5},
                "delimiter": ";",
                "stamp_unit": "ns",
            },
            "position": {"file": "odometry.csv", "columns": ["1-3"]},
            "orientation": {"file": "odometry.csv", "columns": ["4-7"], "order": "wxyz"},
            "velocity": {"file": "odometry.csv", "columns": ["8-10"]},
            "yaw_rate": {"file": "odometry.csv", "columns": [13]},
            "command": {"file": "command.csv", "columns": [1, 2, 3]},
            "joints": {"file": "joints.csv", "columns": ["1-12"], "unit": "deg", "legs": ["FR", "FL", "RR", "RL"]},
            "contact": {"file": "force.csv", "columns": ["1-4"]},
        },
    )
    csv = read(tmp_path, settings, robot)
    bag = read(write_log("mcap", tmp_path / "bag", motion), topics, robot)
    # The first row differs: the bag's first odometry comes before its first command.
    common = np.isin(csv.stamps_ns, bag.stamps_ns)
    csv = csv.rows(np.flatnonzero(common))
    assert len(csv) == len(bag) > 700
    for field in fields(bag):
        if field.name not in ("name", "swing_pair"):
            assert np.allclose(getattr(bag, field.name), getattr(csv, field.name), rtol=0, atol=1e-12), field.name


def test_columns_may_be_named_in_a_header(robot, write, aliengo_rows):
    topics = load_topics("aliengo_csv").to_dict()
    header = [f"c{i}" for i in range(48)]
    topics["csv"]["header"] = True
    topics["position"]["columns"] = ["c16", "c17", "c18"]
    got = read(write([header, *aliengo_rows]), build(TopicSettings, topics), robot)
    assert np.array_equal(
        got.position_world, read(write(aliengo_rows), load_topics("aliengo_csv"), robot).position_world
    )
    topics["position"]["columns"] = ["c16", "c17", "height"]
    with pytest.raises(LogError, match="no column 'height'; expected one of: c0, c1"):
        read(write([header, *aliengo_rows]), build(TopicSettings, topics), robot)


def test_a_row_of_66_columns_is_named_by_its_line(robot, write, aliengo_rows):
    aliengo_rows[22] += ["0"] * 18
    with pytest.raises(LogError, match=r"log\.csv: line 23 has 66 columns, expected 48"):
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("n/a", "line 8, column 17 is 'n/a', expected a number"),
        ("", "line 8, column 17 is empty, expected a number"),
        ("nan", "line 8, column 17 is nan, expected a finite number"),
        ("-inf", "line 8, column 17 is -inf, expected a finite number"),
    ],
)
def test_what_is_no_number_is_named_by_line_and_column(robot, write, aliengo_rows, text, expected):
    aliengo_rows[7][17] = text
    with pytest.raises(LogError, match=expected) as caught:
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)
    assert "\n" not in str(caught.value)


def test_text_in_a_column_that_is_not_read_does_no_harm(robot, write, aliengo_rows):
    aliengo_rows[7][25] = "broken"
    assert len(read(write(aliengo_rows), load_topics("aliengo_csv"), robot)) == 40


def test_a_flag_that_is_none_is_refused(robot, write, aliengo_rows):
    aliengo_rows[4][46:48] = ["True", "True"]
    with pytest.raises(LogError, match=r"line 5.*at most one of the two set"):
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)
    aliengo_rows[4][46:48] = ["maybe", "True"]
    with pytest.raises(LogError, match=r"line 5"):
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)


@pytest.mark.parametrize(
    ("shift", "expected"),
    [(-5, r"line 21: the time goes back by 4\.7 s"), (86400, r"line 21: the time jumps ahead by 86400")],
)
def test_times_that_go_back_or_jump_by_a_day_are_named_by_their_line(robot, write, aliengo_rows, shift, expected):
    for row in aliengo_rows[20:]:
        row[0] = seconds(int(row[0].replace(".", "")) + shift * 10**9)
    with pytest.raises(LogError, match=expected):
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)


def test_a_time_that_is_text_is_refused(robot, write, aliengo_rows):
    aliengo_rows[3][0] = "12:30"
    with pytest.raises(LogError, match="line 4, column 0 is '12:30', expected a time"):
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"", "is empty"), (b"\n\n", "is empty"), (b"\xff\xfe\x00\x80" * 50, "is not text"), (b"1,2,3\n", "3 columns")],
)
def test_a_file_without_data_is_refused(robot, tmp_path, content, expected):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(LogError, match=expected):
        read(path, load_topics("aliengo_csv"), robot)


def test_a_header_without_rows_is_refused(robot, write):
    topics = load_topics("aliengo_csv").to_dict()
    topics["csv"]["header"] = True
    with pytest.raises(LogError, match="holds no rows"):
        read(write([[f"c{i}" for i in range(48)]]), build(TopicSettings, topics), robot)


def test_another_presets_log_is_refused(robot, write, aliengo_rows):
    with pytest.raises(LogError, match="line 1 has 48 columns, expected 33"):
        read(write(aliengo_rows), load_topics("gazebo_csv"), robot)
    with pytest.raises(LogError, match="is CSV, but topics 'ros2_standard' describe a bag"):
        read(write(aliengo_rows), load_topics("ros2_standard"), robot)
    with pytest.raises(LogError, match="is one file, expected a directory with vicon"):
        read(write(aliengo_rows), load_topics("go2_csv"), robot)


def test_a_missing_file_is_named(robot, tmp_path, write, aliengo_rows):
    with pytest.raises(LogError, match="no such file or directory"):
        read(tmp_path / "none.csv", load_topics("aliengo_csv"), robot)
    write(aliengo_rows, "vicon_history.csv")
    with pytest.raises(LogError, match=r"has no policy_command_history.csv; CSV files there: vicon_history.csv"):
        read(tmp_path, load_topics("go2_csv"), robot)


def test_a_quaternion_that_is_not_unit_is_named_by_its_line(robot, write, aliengo_rows):
    aliengo_rows[5][42] = "0.5"
    with pytest.raises(LogError, match=r"line 6, orientation in columns 39-42: the quaternion has length 0\.5"):
        read(write(aliengo_rows), load_topics("aliengo_csv"), robot)


def test_settings_name_what_is_wrong_with_them():
    with pytest.raises(
        SettingsError, match=r"no such preset.*aliengo_csv, .*gazebo_csv, .*go2_csv, .*legtool, .*ros2_standard"
    ):
        load_topics("cheetah")
    good = load_topics("go2_csv").to_dict()
    for change, expected in (
        ({"position": {"columns": ["1-3"]}}, "position has no file"),
        ({"position": {"file": "imu.csv", "columns": ["1-3"]}}, "file 'imu.csv' is not one of"),
        ({"joints": None}, "neither feet nor joints"),
        ({"csv": None}, "position has no topic"),
        ({"max_gap_s": -1}, "max_gap_s"),
        ({"joints": {"colums": [1]}}, "unknown setting 'joints.colums'; expected one of: columns, field, file"),
    ):
        with pytest.raises(SettingsError, match=expected):
            build(TopicSettings, {**good, **change})


def test_the_real_aliengo_keeps_its_stance_feet_on_the_ground(shared_data, robot):
    got = read(shared_data / "aliengo/real_continuous.csv", load_topics("aliengo_csv"), robot)
    assert len(got) == 954
    world = got.position_world[:, None] + to_world(got.orientation, got.feet_base)
    moved = to_base(got.orientation[:-1], np.diff(world, axis=0))
    stance = np.where(got.swing_pair[1:, None] == 0, [[1, 2]], [[0, 3]])
    slip = np.take_along_axis(moved, stance[:, :, None], axis=1).reshape(-1, 3)
    assert (slip.std(axis=0) < 0.005).all()


def test_the_real_simulator_log_has_its_feet_below_the_trunk(shared_data, robot):
    got = read(shared_data / "aliengo/gazebo_sim.csv", load_topics("gazebo_csv"), robot)
    assert len(got) == 7397
    assert np.allclose(got.feet_base.mean(axis=0), robot.stance * [1.1, 0.9, 0.8], atol=0.05)
    assert got.velocity_base[:, 0].mean() == pytest.approx(got.command[:, 0].mean(), abs=0.1)


def test_the_real_go2_gets_velocity_from_motion_capture(shared_data):
    from legtool.configs.robots import load_robot

    got = read(shared_data / "go2", load_topics("go2_csv"), load_robot("go2").geometry())
    assert len(got) == 1000 and got.contact_force is None
    assert np.abs(got.position_world[:, 2]).max() < 0.5
    # The derivative integrates back to the path, and follows the commands.
    world = to_world(got.orientation, got.velocity_base)
    path = np.cumsum(world * 0.02, axis=0)
    assert np.abs(path - path[0] - (got.position_world - got.position_world[0])).max() < 0.02
    assert np.corrcoef(got.velocity_base[25:, 0], got.command[:-25, 0])[0, 1] > 0.8
    assert np.corrcoef(got.yaw_rate[15:], got.command[:-15, 2])[0, 1] > 0.8


def test_the_real_go2_stands_level_on_feet_that_stay_once_its_markers_are_placed(shared_data):
    from legtool.configs.robots import load_robot

    robot = load_robot("go2").geometry()
    placed = load_topics("go2_csv")
    bare = placed.to_dict()
    bare["position"]["offset"] = bare["orientation"]["mount"] = [0, 0, 0]
    slip = {}
    for name, topics in (("placed", placed), ("bare", build(TopicSettings, bare))):
        got = read(shared_data / "go2", topics, robot)
        world = got.position_world[:, None] + to_world(got.orientation, got.feet_base)
        height = world[:, :, 2]
        low = height < np.median(np.sort(height, axis=1)[:, :2]) + 0.012
        moved = np.linalg.norm(np.diff(world, axis=0), axis=2)
        slip[name] = np.median(moved[low[1:] & low[:-1]])
    assert slip["placed"] < 0.7 * slip["bare"] and slip["placed"] < 0.0035
    # The run begins at a stand.
    standing = to_world(got.orientation[:10], got.feet_base[:10])
    assert np.ptp(standing[:, :, 2].mean(axis=0)) > 0.03  # bare: it seems to lean
    got = read(shared_data / "go2", placed, robot)
    standing = to_world(got.orientation[:10], got.feet_base[:10])
    assert np.ptp(standing[:, :, 2].mean(axis=0)) < 0.015


def test_info_tells_rows_and_columns(robot, write, aliengo_rows):
    assert describe_log(write(aliengo_rows)) == {"kind": "csv", "files": {"log.csv": {"rows": 40, "columns": 48}}}
