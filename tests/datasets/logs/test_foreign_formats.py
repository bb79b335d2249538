"""Formats as they come: what other tools write of the same walk gives the same steps."""

import itertools
import json
import shutil
import sqlite3

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard

from legtool.datasets.logs.bagfile import opened
from legtool.info import describe


@pytest.fixture
def mcap(tmp_path, walk, as_motion, write_log):
    """An MCAP file of ROS 2, as a recorder writes it."""
    return next(write_log("mcap", tmp_path / "recorded", as_motion(walk)).glob("*.mcap"))


def rewrite(source, target, *, profile="ros2", foreign=(), schemas=None, ros1=False):
    """Write the messages of a bag into an MCAP file of another making."""
    from mcap.writer import Writer

    with opened(source) as bag, target.open("wb") as file:
        writer = Writer(file)
        writer.start(profile, "another tool")
        for topic, encoding, schema, data in foreign:
            number = writer.register_schema("Foreign", schema, b"{}")
            channel = writer.register_channel(topic, encoding, number)
            for n in range(3):
                writer.add_message(channel, bag.start_time + n, data, bag.start_time + n)
        channels = {}
        for connection in bag.connections:
            text, encoding = (schemas or (lambda c: (c.msgdef.data, "ros1msg" if ros1 else "ros2msg")))(connection)
            number = writer.register_schema(
                connection.msgtype.replace("/msg/", "/" if ros1 else "/msg/"), encoding, text.encode()
            )
            channels[connection.id] = writer.register_channel(connection.topic, "ros1" if ros1 else "cdr", number)
        for connection, stamp, raw in bag.messages(bag.connections):
            writer.add_message(channels[connection.id], stamp, bytes(raw), stamp)
        writer.finish()
    return target


BAG = {
    "name": "bag",
    **{name: {"topic": "/odom"} for name in ("position", "orientation", "velocity", "yaw_rate")},
    "command": {"topic": "/cmd_vel"},
    "joints": {"topic": "/joint_states"},
    "contact": {"topic": "/foot_readings", "field": "force"},
}


def same(collect, steps_of, a, b, **options):
    """Both logs give the same steps, to the last bit."""
    one, two = collect(a, topics=BAG, **options), collect(b, topics=BAG, **options)
    assert isinstance(one, dict) and isinstance(two, dict), (one, two)
    first, second = steps_of(one), steps_of(two)
    assert len(first) >= 35
    assert first.drop(columns="recording").equals(second.drop(columns="recording"))


@pytest.mark.parametrize("profile", ["", "x-other"])
@pytest.mark.parametrize(
    "foreign",
    [(), (("/ui", "json", "jsonschema", b'{"a": 1}'),), (("/blob", "protobuf", "protobuf", b"\x08\x01"),)],
)
def test_mcap_of_any_profile_with_foreign_channels(tmp_path, mcap, collect, steps_of, profile, foreign):
    if not profile and foreign:
        profile = "ros2"
    other = rewrite(mcap, tmp_path / "other.mcap", profile=profile, foreign=foreign)
    same(collect, steps_of, mcap, other)
    assert any("/odom: 2400 nav_msgs" in line for line in describe(other))


@pytest.mark.parametrize("profile", ["ros1", ""])
def test_ros1_messages_in_mcap(tmp_path, walk, as_motion, write_log, collect, steps_of, profile):
    bag = write_log("ros1", tmp_path / "ros1", as_motion(walk))
    other = rewrite(bag, tmp_path / "other.mcap", profile=profile, ros1=True)
    same(collect, steps_of, bag, other)


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [
        ("json", "topic /odom (Odometry, JSON): this type does not say where position is; give the field"),
        (
            "protobuf",
            "holds messages in protobuf, which legtool does not read; decode them in Python with mcap-protobuf",
        ),
        ("flatbuffer", "holds messages in flatbuffer, which legtool does not read; write"),
    ],
)
def test_other_encodings_are_named_and_not_called_damaged(tmp_path, mcap, collect, encoding, expected):
    from mcap.writer import Writer

    path = tmp_path / "json.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("")
        number = writer.register_schema("Odometry", "jsonschema", b"{}")
        for topic in ("/odom", "/cmd_vel", "/joint_states", "/foot_readings"):
            channel = writer.register_channel(topic, encoding, number)
            writer.add_message(channel, 10, json.dumps({"x": 1}).encode(), 10)
        writer.finish()
    told = collect(path, topics=BAG)
    assert expected in told and "damaged" not in told
    assert encoding == "json" or any(f"messages in {encoding}" in line for line in describe(path))


def test_empty_schema_text_leaves_the_standard_types(tmp_path, mcap, collect):
    def schemas(connection):
        return ("" if "test_msgs" not in connection.msgtype else connection.msgdef.data), "ros2msg"

    other = rewrite(mcap, tmp_path / "other.mcap", schemas=schemas)
    assert collect(other, topics=BAG)["counts"]["steps"] >= 35
    assert collect(rewrite(mcap, tmp_path / "b.mcap", profile="", schemas=schemas), topics=BAG)["counts"]["steps"] >= 35


@pytest.mark.parametrize("msgs", [False, True])
def test_idl_with_preprocessor_lines(tmp_path, mcap, collect, msgs):
    idl = """// generated from test_msgs/msg/FootReadings.msg
#include "std_msgs/msg/Header.idl"
#define NOTHING
module test_msgs {
  module msg {
    struct FootReadings {
      std_msgs::msg::Header header;
      string source;
      uint16 raw[4];
      sequence<double> force;
    };
  };
};
"""
    if msgs:
        idl = "#include <\nthis is no IDL {"
        (tmp_path / "test_msgs" / "msg").mkdir(parents=True)
        text = "std_msgs/Header header\nstring source\nuint16[4] raw\nfloat64[] force\n"
        (tmp_path / "test_msgs" / "msg" / "FootReadings.msg").write_text(text)

    def schemas(connection):
        return (idl, "ros2idl") if "test_msgs" in connection.msgtype else (connection.msgdef.data, "ros2msg")

    other = rewrite(mcap, tmp_path / "other.mcap", schemas=schemas)
    manifest = collect(other, topics=BAG, msgs=tmp_path / "test_msgs" if msgs else None)
    assert isinstance(manifest, dict) and manifest["counts"]["steps"] >= 35


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_files_of_one_recording_without_metadata_are_read_in_order(
    tmp_path, walk, as_motion, write_log, collect, steps_of, kind
):
    whole = write_log(kind, tmp_path / "whole", as_motion(walk))
    parts = tmp_path / "parts.bag"  # whatever the directory is called
    parts.mkdir()
    for number, chosen in ((2, slice(0, 1000)), (10, slice(1000, None))):
        part = {name: values[chosen] for name, values in walk.items()}
        made = write_log(kind, tmp_path / f"part{number}", as_motion(part))
        shutil.copy(next(made.glob(f"*.{kind}")), parts / f"bag_{number}.{kind}")
    one, two = collect(whole, topics=BAG), collect(parts, topics=BAG)
    assert isinstance(two, dict), two
    assert abs(two["counts"]["steps"] - one["counts"]["steps"]) <= 1
    assert "2400 nav_msgs/msg/Odometry" in "\n".join(describe(parts))


def test_a_directory_named_like_a_file_is_read(tmp_path, walk, as_motion, write_log, collect):
    made = write_log("db3", tmp_path / "made", as_motion(walk))
    made.rename(tmp_path / "walk.mcap")
    assert collect(tmp_path / "walk.mcap", topics=BAG)["counts"]["steps"] >= 35


@pytest.mark.parametrize("change", ["none", "sign", "unfilled"])
def test_info_compares_the_signals_of_a_log(tmp_path, walk, as_motion, write_log, write_csv, change):
    if change == "sign":
        walk["velocity"] *= -1
    elif change == "unfilled":
        walk["velocity"] *= 0
    told = "\n".join(describe(write_csv(walk)))
    expected = {
        "none": "compared by the names of columns, as a log of",
        "sign": "refused: velocity",
        "unfilled": "warning: velocity",
    }
    assert expected[change] in told and ("usable steps" in told)
    assert change != "none" or ("refused" not in told and "warning" not in told)


def test_info_says_why_signals_are_not_compared(tmp_path, walk, as_motion, write_log):
    bag = write_log("mcap", tmp_path / "capture", as_motion(walk), topics={"/odom"})
    assert "not compared: no topic is known to hold command, feet or joints" in "\n".join(describe(bag))


def killed_recorder(made, killed, *, whole):
    """A copy of a bag whose second half waits in the journal, as a recorder leaves it that is killed."""
    file = next(made.glob("*.db3"))
    killed.mkdir()
    database = sqlite3.connect(file)
    late = database.execute("SELECT * FROM messages ORDER BY timestamp").fetchall()
    late = late[len(late) // 2 :]
    database.execute("DELETE FROM messages WHERE timestamp >= ?", (late[0][2],))
    database.commit()
    database.execute("PRAGMA journal_mode=WAL")
    held = database.execute("SELECT count(*) FROM messages").fetchone()[0]
    late = [row for row in late if row[0] is not None]
    database.executemany(f"INSERT INTO messages VALUES ({','.join('?' * len(late[0]))})", late)
    database.commit()
    for part in made.iterdir():
        if whole or part.suffix != ".yaml":
            shutil.copy(part, killed / part.name)
    database.close()
    alone = sqlite3.connect(f"file:{killed / file.name}?immutable=1", uri=True)
    assert alone.execute("SELECT count(*) FROM messages").fetchone()[0] == held  # all else is in the journal
    alone.close()
    return killed if whole else killed / file.name


@pytest.mark.parametrize("whole", [True, False])
def test_messages_that_wait_in_a_journal_are_read_and_left_where_they_are(
    tmp_path, walk, as_motion, write_log, collect, steps_of, whole
):
    motion = as_motion(walk)
    sound = write_log("db3", tmp_path / "sound", motion)
    log = killed_recorder(write_log("db3", tmp_path / "made", motion), tmp_path / "killed", whole=whole)
    before = {part.name: part.read_bytes() for part in (tmp_path / "killed").iterdir()}
    same(collect, steps_of, sound, log)
    assert "2400 nav_msgs/msg/Odometry" in "\n".join(describe(log))
    assert {part.name: part.read_bytes() for part in (tmp_path / "killed").iterdir()} == before


@pytest.mark.parametrize("journal", [b"", b"\x00" * 4096])
def test_a_journal_without_messages_is_no_obstacle(tmp_path, walk, as_motion, write_log, collect, journal):
    made = write_log("db3", tmp_path / "made", as_motion(walk))
    file = next(made.glob("*.db3"))
    file.with_name(f"{file.name}-wal").write_bytes(journal)
    assert collect(file, topics=BAG)["counts"]["steps"] >= 35


@pytest.mark.parametrize("ending", ["zstd", "zst"])
@pytest.mark.parametrize("kind", ["mcap", "db3"])
@pytest.mark.parametrize("frames", [1, 3])
def test_a_file_that_is_compressed_as_a_whole_is_read(
    tmp_path, walk, as_motion, write_log, collect, steps_of, kind, ending, frames
):
    made = next(write_log(kind, tmp_path / "made", as_motion(walk)).glob(f"*.{kind}"))
    packed, text = tmp_path / f"walk.{kind}.{ending}", made.read_bytes()
    cut = [len(text) * k // frames for k in range(frames + 1)]
    parts = [text[low:high] for low, high in itertools.pairwise(cut)]
    packed.write_bytes(b"".join(zstandard.ZstdCompressor().compress(part) for part in parts))
    same(collect, steps_of, made, packed)
    assert "2400 nav_msgs/msg/Odometry" in "\n".join(describe(packed))


@pytest.mark.parametrize(("name", "content"), [("walk.mcap.zstd", b"no zstd at all"), ("walk.db3.zst", b"")])
def test_what_cannot_be_unpacked_is_refused_in_one_line(tmp_path, collect, name, content):
    (tmp_path / name).write_bytes(content)
    told = collect(tmp_path / name, topics=BAG)
    assert isinstance(told, str) and f"{name}: " in told and ("cannot be unpacked" in told or "is empty" in told)


def as_json(value):
    """A message as JSON holds it."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [as_json(one) for one in value]
    if hasattr(value, "__dataclass_fields__"):
        held = {name: as_json(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__"}
        return dict(sorted(held.items()))  # another order than ROS has
    return value


@pytest.mark.parametrize("profile", ["", "ros2"])
@pytest.mark.parametrize("chosen", [{"/cmd_vel"}, {"/odom", "/cmd_vel", "/joint_states", "/foot_readings"}])
def test_json_is_read_where_it_holds_what_is_asked_for(tmp_path, mcap, collect, steps_of, profile, chosen):
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store, path = get_typestore(Stores.ROS2_HUMBLE), tmp_path / "json.mcap"
    with opened(mcap) as bag, path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile)
        channels = {}
        for c in bag.connections:
            if "test_msgs" in c.msgtype:
                store.register(get_types_from_msg(c.msgdef.data, c.msgtype))
            encoding = ("ros2msg", c.msgdef.data, "cdr") if c.topic not in chosen else ("jsonschema", "{}", "json")
            number = writer.register_schema(c.msgtype, encoding[0], encoding[1].encode())
            channels[c.id] = writer.register_channel(c.topic, encoding[2], number)
        for c, stamp, raw in bag.messages(bag.connections):
            data = bytes(raw)
            if c.topic in chosen:
                data = json.dumps(as_json(store.deserialize_cdr(data, c.msgtype))).encode()
            writer.add_message(channels[c.id], stamp, data, stamp)
        writer.finish()
    same(collect, steps_of, mcap, path)
    named = {**BAG, "command": {"topic": "/cmd_vel", "field": ["linear.x", "linear.y", "angular.z"]}}
    assert collect(path, topics=named)["counts"]["steps"] >= 35
    assert any("nav_msgs/msg/Odometry" in line and "could be position" in line for line in describe(path))


@pytest.mark.parametrize("mode", ["file", "message"])
def test_compressed_bags(tmp_path, walk, as_motion, collect, mode, topics, write_log):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    source = write_log("db3", tmp_path / "source", as_motion(walk))
    writer = Writer(tmp_path / "packed", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.FILE if mode == "file" else CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with opened(source) as bag, writer:
        made = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest)
            for c in bag.connections
        }
        for connection, stamp, raw in bag.messages(bag.connections):
            writer.write(made[connection.id], stamp, bytes(raw))
    assert collect(tmp_path / "packed", topics=BAG)["counts"]["steps"] >= 35
    if mode == "message":
        told = collect(next((tmp_path / "packed").glob("*.db3")), topics=BAG)
        assert "compressed one by one (zstd); give the bag's directory" in told


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_two_bags_of_one_run_are_joined(tmp_path, walk, as_motion, write_log, collect, steps_of, order):
    motion = as_motion(walk)
    whole = write_log("mcap", tmp_path / "whole", motion)
    bags = [
        write_log("mcap", tmp_path / "capture", motion, topics={"/odom"}),
        write_log("db3", tmp_path / "robot", motion, topics={"/cmd_vel", "/joint_states", "/foot_readings"}),
    ]
    joined = collect(*(bags[i] for i in order), topics=BAG)
    assert isinstance(joined, dict) and joined["counts"]["logs"] == 1
    assert len(steps_of(joined)) == len(steps_of(collect(whole, topics=BAG)))


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 2, 1, 3), (3, 0, 2, 1)])
def test_bags_of_two_runs_are_joined_by_their_time(tmp_path, make_walk, as_motion, write_log, collect, steps_of, order):
    bags, alone = [], []
    for number in range(2):
        walk = make_walk(seed=number)
        walk["stamps"] += number * 100 * 10**9
        motion = as_motion(walk)
        alone.append(collect(write_log("mcap", tmp_path / f"whole{number}", motion), topics=BAG)["counts"]["steps"])
        bags.append(write_log("mcap", tmp_path / f"capture{number}", motion, topics={"/odom"}))
        rest = {"/cmd_vel", "/joint_states", "/foot_readings"}
        bags.append(write_log("mcap", tmp_path / f"robot{number}", motion, topics=rest))
    joined = collect(*(bags[i] for i in order), topics=BAG)
    assert isinstance(joined, dict), joined
    assert joined["counts"]["logs"] == 2 and joined["counts"]["steps"] == sum(alone)


def test_a_bag_that_nothing_completes_says_what_is_lacking(tmp_path, walk, as_motion, write_log, collect):
    motion = as_motion(walk)
    one = write_log("mcap", tmp_path / "one", motion, topics={"/odom"})
    two = write_log("mcap", tmp_path / "two", motion, topics={"/odom", "/cmd_vel"})
    assert "holds nothing on a topic for command (/cmd_vel)" in collect(one, two, topics=BAG)


CELLS = {
    "bom": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "utf16": lambda text: text.encode("utf-16"),
    "utf16-le": lambda text: text.encode("utf-16-le"),
    "latin1": lambda text: text.replace("px", "größe_µ").encode("latin-1"),
    "quotes": lambda text: "\n".join(
        ",".join(f'"{c}"' for c in row.split(",")) for row in text.split("\n")[:-1]
    ).encode(),
    "comma in a name": lambda text: text.replace("px", '"position, x"', 1).encode(),
    "blank lines": lambda text: text.replace("\n", "\n\n", 900).encode() + b"\n\n",
    "crlf": lambda text: text.replace("\n", "\r\n").encode(),
    "spaces": lambda text: text.replace(",", ", ").encode(),
}


@pytest.mark.parametrize("kind", CELLS)
def test_csv_as_other_programs_write_it(walk, write_csv, collect, topics_of, steps_of, kind):
    plain = write_csv(walk)
    expected = steps_of(collect(plain, topics=topics_of()))
    other = plain.with_name("other.csv")
    other.write_bytes(CELLS[kind](plain.read_text()))
    topics = topics_of(csv={"stamp": "time"})
    manifest = collect(other, topics=topics)
    assert isinstance(manifest, dict), manifest
    assert steps_of(manifest).drop(columns="recording").equals(expected.drop(columns="recording"))
    assert any("43 columns" in line for line in describe(other))


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", None), ("\t", ",")])
def test_decimal_commas(walk, write_csv, collect, topics_of, steps_of, delimiter, decimal):
    plain = write_csv(walk)
    expected = steps_of(collect(plain, topics=topics_of()))
    other = plain.with_name("other.csv")
    other.write_text(plain.read_text().replace(",", delimiter).replace(".", ","))
    manifest = collect(other, topics=topics_of(csv={"delimiter": delimiter, "decimal": decimal}))
    assert steps_of(manifest).drop(columns="recording").equals(expected.drop(columns="recording"))


@pytest.mark.parametrize("every", [2, 4])
def test_empty_cells_where_signals_have_their_own_rates(walk, write_csv, collect, topics_of, every):
    plain = write_csv(walk)
    lines = plain.read_text().split("\n")
    for number in range(1, len(lines) - 1):
        cells = lines[number].split(",")
        if number % every:
            cells[12:15] = [""] * 3  # the command
        if number % 2:
            cells[15:31] = [""] * 16  # feet and contact
        if number % 400 == 7:
            cells[1:12] = [""] * 11  # lost odometry
        lines[number] = ",".join(cells)
    other = plain.with_name("sparse.csv")
    other.write_text("\n".join(lines))
    manifest = collect(other, topics=topics_of())
    assert manifest["counts"]["steps"] >= 35 and "notes" not in manifest
    assert manifest["counts"]["rows"] >= 2390


def test_a_cell_of_text_is_still_named_by_its_line(walk, write_csv, collect, topics_of):
    plain = write_csv(walk)
    lines = plain.read_text().split("\n")
    lines.insert(100, "")  # blank lines count as lines
    lines[200] = lines[200].replace(",", ",x", 1)
    plain.write_text("\n".join(lines))
    assert "line 201, column 1 is 'x" in collect(plain, topics=topics_of())


@pytest.mark.parametrize("kind", ["npz", "parquet", "h5"])
def test_tables_of_simulators(tmp_path, walk, write_csv, collect, topics_of, steps_of, kind):
    expected = steps_of(collect(write_csv(walk), topics=topics_of()))
    path = tmp_path / f"walk.{kind}"
    arrays = {**walk, "feet": walk["feet"].reshape(-1, 4, 3)}
    if kind == "npz":
        np.savez(path, **arrays)
    elif kind == "parquet":
        pq.write_table(pa.table({n: v.tolist() if v.ndim > 1 else v for n, v in walk.items()}), path)
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            for name, values in arrays.items():
                file[name] = values
    names = ("position", "orientation", "velocity", "yaw_rate", "command", "feet", "contact")
    topics = {"name": "arrays", "csv": {"files": {"*": None}, "stamp": "stamps", "stamp_unit": "ns"}}
    topics |= {name: {"columns": [name if kind != "parquet" or name != "yaw_rate" else "yaw_rate.0"]} for name in names}
    manifest = collect(path, topics=topics)
    assert isinstance(manifest, dict), manifest
    got = steps_of(manifest)
    assert len(got) == len(expected)
    assert np.allclose(got["velocity_x"], expected["velocity_x"], atol=1e-6)
    assert any("position.0" in line for line in describe(path))


def test_rows_without_time_need_their_rate(tmp_path, walk, collect):
    path = tmp_path / "walk.npz"
    np.savez(path, **{name: values for name, values in walk.items() if name != "stamps"})
    topics = {"name": "arrays", "csv": {"files": {"*": None}, "stamp": None, "rate_hz": 200.0}}
    topics |= {name: {"columns": [name]} for name in ("position", "orientation", "command", "feet", "contact")}
    assert collect(path, topics=topics)["counts"]["steps"] >= 35
    assert "give either stamp" in collect(path, topics={**topics, "csv": {"files": {"*": None}, "stamp": None}})
