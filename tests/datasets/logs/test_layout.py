"""Numbers taken from messages in bulk, against rosbags' own decoder."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from legtool.datasets.logs.jointnames import joint_order
from legtool.datasets.logs.layout import groups, walk
from legtool.errors import LogError

NESTED = "test_msgs/msg/Nested"
DEFINITION = (
    "uint8 flag\nstring note\nfloat64[3] fixed\nInner[] inners\nbool[] bits\nint16 last\n"
    "================================================================================\nMSG: test_msgs/Inner\n"
    "float32 a\nstring label\nuint64 big\nfloat64[] tail\n"
)


def store_of(ros1: bool):
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DEFINITION, NESTED))
    return store


def nested(store, rng: np.random.Generator, note: str, lengths: list[int]):
    inner = store.types["test_msgs/msg/Inner"]
    return store.types[NESTED](
        flag=int(rng.integers(256)),
        note=note,
        fixed=rng.normal(size=3),
        inners=[
            inner(
                a=float(np.float32(rng.normal())), label="x" * n, big=int(rng.integers(2**40)), tail=rng.normal(size=n)
            )
            for n in lengths
        ],
        bits=rng.integers(0, 2, 5).astype(np.bool_),
        last=int(rng.integers(-(2**15), 2**15)),
    )


@pytest.mark.parametrize("form", ["ros1", "little", "big"])
def test_every_number_is_where_rosbags_finds_it(form):
    ros1 = form == "ros1"
    store, rng = store_of(ros1), np.random.default_rng(0)
    shapes = [("", []), ("note", [1]), ("four", [2]), ("no", [0, 3]), ("note", [1])]
    messages = [nested(store, rng, *shapes[i % 5]) for i in range(60)]
    if ros1:
        raws = [bytes(store.serialize_ros1(m, NESTED)) for m in messages]
    else:
        raws = [bytes(store.serialize_cdr(m, NESTED, little_endian=form == "little")) for m in messages]
    seen = []
    for index, layout, rows in groups(raws, store.fielddefs, NESTED, ros1=ros1):
        seen += index.tolist()
        for row, i in enumerate(index.tolist()):
            m = messages[i]
            one = rows[row : row + 1]
            assert layout.take(one, "flag")[0, 0] == m.flag and layout.take(one, "last")[0, 0] == m.last
            assert np.array_equal(layout.values(one, ["fixed"])[0], m.fixed)
            assert np.array_equal(layout.take(one, "bits")[0], m.bits)
            assert layout.text(rows[row], "note") == m.note
            for k, inner in enumerate(m.inners):
                assert layout.take(one, f"inners.{k}.big")[0, 0] == inner.big
                assert layout.take(one, f"inners.{k}.a")[0, 0] == np.float32(inner.a)
                assert np.array_equal(layout.take(one, f"inners.{k}.tail")[0], inner.tail)
            assert layout.find("inners.*.big") == [f"inners.{k}.big" for k in range(len(m.inners))]
    assert sorted(seen) == list(range(60))


def test_names_that_are_pinned_belong_to_the_layout():
    store = get_typestore(Stores.ROS2_HUMBLE)
    t = store.types
    header = t["std_msgs/msg/Header"](stamp=t["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="")
    none = np.zeros(0)
    raws = [
        bytes(
            store.serialize_cdr(
                t["sensor_msgs/msg/JointState"](
                    header=header, name=names, position=np.arange(2.0), velocity=none, effort=none
                ),
                "sensor_msgs/msg/JointState",
            )
        )
        for names in (["ab", "cd"], ["cd", "ab"], ["ab", "cd"])
    ]
    kind = "sensor_msgs/msg/JointState"
    found = [i.tolist() for i, _, _ in groups(raws, store.fielddefs, kind, ros1=False)]
    assert found == [[0, 2], [1]]


def test_a_message_that_does_not_fit_its_definition_is_refused():
    store = store_of(False)
    raw = bytes(store.serialize_cdr(nested(store, np.random.default_rng(0), "note", [1, 2]), NESTED))
    with pytest.raises(LogError, match="shorter than its definition says"):
        walk(raw[:-20], store.fielddefs, NESTED, ros1=False)
    with pytest.raises(LogError, match="bytes, its definition describes"):
        walk(raw + bytes(8), store.fielddefs, NESTED, ros1=False)
    with pytest.raises(LogError, match="expected plain CDR"):
        walk(b"\x00\x07" + raw[2:], store.fielddefs, NESTED, ros1=False)
    with pytest.raises(LogError, match="has no definition in the log"):
        walk(raw, {}, NESTED, ros1=False)


@pytest.mark.parametrize(
    "pattern",
    [
        [f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")],
        [f"{leg}_{joint}" for leg in ("LF", "RF", "LH", "RH") for joint in ("HAA", "HFE", "KFE")],
        [f"{leg}.{joint}" for leg in ("fl", "fr", "hl", "hr") for joint in ("hip_x", "hip_y", "knee")],
        [f"robot/{leg}_{joint}" for leg in ("lf", "rf", "lh", "rh") for joint in ("haa", "hfe", "kfe")],
    ],
)
def test_joints_are_recognised_by_their_usual_names(pattern):
    shuffle = np.random.default_rng(0).permutation(12)
    names = ["head_pan", *[pattern[i] for i in shuffle]]
    assert [names[i] for i in joint_order(names, ())] == pattern


def test_joints_that_are_missing_or_twice_there_are_not_guessed():
    names = [f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "knee")]
    assert joint_order(names[:-1], ()) is None
    assert joint_order([*names, "LF_hip"], ()) is None
    assert joint_order([f"j{i}" for i in range(12)], tuple(f"j{11 - i}" for i in range(12))) == list(range(11, -1, -1))
