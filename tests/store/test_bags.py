"""Bags of ROS as recordings: rosbag2 in both storages, ROS 1, joints in any order, and what is refused."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from monitor.errors import BadInput
from monitor.store.formats.bags import UR_JOINTS, from_the_base
from monitor.store.formats.recordings import read_recording

rosbags = pytest.importorskip("rosbags.rosbag2", reason="pip install 'joint-monitor[ros]'")
rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="pip install 'joint-monitor[ros]'")
typesys = pytest.importorskip("rosbags.typesys", reason="pip install 'joint-monitor[ros]'")

TYPES = "sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
N = 40
RNG = np.random.default_rng(0)
Q, QD, EFFORT = RNG.normal(size=(3, N, 6))
ALPHABETICAL = ("elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3")
STORAGES = {"sqlite3": ".db3", "mcap": ".mcap"}


def bag(folder: Path, storage: str, names=ALPHABETICAL, topic="/joint_states", stamped=True, velocity=True, gripper=False) -> Path:
    """A rosbag2 whose messages have the joints in this order; the joints of the arm are those of Q."""
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    state, header, stamp = (store.types[name] for name in TYPES)
    order = [UR_JOINTS.index(name) for name in names]
    plugin = rosbags.StoragePlugin.SQLITE3 if storage == "sqlite3" else rosbags.StoragePlugin.MCAP
    full_names = [f"left_{name}_joint" for name in names]
    with rosbags.Writer(folder / "bag", version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection(topic, state.__msgtype__, typestore=store)
        for k in range(N):
            at_ns = 1_764_000_000_000_000_000 + 8_000_000 * k
            when = stamp(sec=at_ns // 10**9 if stamped else 0, nanosec=at_ns % 10**9 if stamped else 0)
            none = np.zeros(0)
            message = state(header(when, ""), full_names, Q[k, order], QD[k, order] if velocity else none, EFFORT[k, order])
            writer.write(connection, at_ns + 500, store.serialize_cdr(message, state.__msgtype__))
            if gripper:
                message = state(header(when, ""), ["finger"], np.zeros(1), np.zeros(1), np.zeros(1))
                writer.write(connection, at_ns + 900, store.serialize_cdr(message, state.__msgtype__))
    return folder / "bag"


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("stamped", [True, False])
def test_a_bag_is_read_with_its_jointsfrom_the_base_on(tmp_path, storage, stamped):
    """UR's driver names them in the order of the alphabet: joints 1 and 3 would be exchanged. The folder and its one file are the same."""
    folder = bag(tmp_path, storage, stamped=stamped, gripper=True)
    (file,) = folder.glob(f"*{STORAGES[storage]}")
    for path in (folder, file):
        found = read_recording(path)
        np.testing.assert_array_equal(found.q, Q)
        np.testing.assert_array_equal(found.qd, QD)
        np.testing.assert_array_equal(found.torque, EFFORT)
        assert [reason.code for reason in found.told] == ["effort_as_torque"]
        np.testing.assert_allclose(np.diff(found.t_s), 0.008, atol=1e-6)


def test_effort_is_current_where_it_is_said(tmp_path):
    """The sentence names the option, as it can be typed."""
    folder = bag(tmp_path, "mcap", velocity=False)
    option = read_recording(folder).told[0].text.split("--columns ")[1]
    found = read_recording(folder, option)
    np.testing.assert_array_equal(found.current, EFFORT)
    assert found.torque is None
    assert found.qd is None


def test_numbered_joints_are_in_the_order_of_their_numbers(tmp_path):
    """Other arms name them joint_1 to joint_7; names that tell no order are refused."""
    assert from_the_base(["joint_2", "joint_0", "joint_1"], "bag") == [1, 2, 0]
    for names in (["base", "arm"], ["joint_1", "joint_1"], ["joint_1", "joint_3"]):
        with pytest.raises(BadInput, match="the order of the joints"):
            from_the_base(names, "bag")


def test_a_bag_of_ros_1_is_read(tmp_path):
    """As the older recordings of the same drivers."""
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    state, header, stamp = (store.types[name] for name in TYPES)
    with rosbag1.Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/arm", state.__msgtype__, typestore=store)
        for k in range(N):
            message = state(header(k, stamp(100, 8_000_000 * k), ""), [f"{name}_joint" for name in UR_JOINTS], Q[k], QD[k], EFFORT[k])
            writer.write(connection, 10**11 + 8_000_000 * k, store.serialize_ros1(message, state.__msgtype__))
    np.testing.assert_array_equal(read_recording(tmp_path / "a.bag").q, Q)


@pytest.mark.parametrize("packed", ["zstd", "lz4"])
def test_a_chunk_that_unpacks_to_much_more_than_its_file_is_refused_in_little_memory(tmp_path, packed):
    """A gigabyte of zeros in 100 kB or 4 MB, whatever the chunk says of its size; as an honest chunk it is read."""
    (file,) = bag(tmp_path, "mcap").glob("*.mcap")
    content = file.read_bytes()
    records = list(records_of(content))
    begin = next(at for at, kind, _ in records if kind in {5, 6})  # message or chunk
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, packed) as stream:
        for _ in range(1000):
            stream.write(bytes(1_000_000))
    inside = bytes(sink.getvalue())
    chunk = struct.pack("<QQQII", 0, 0, 10**9, 0, len(packed)) + packed.encode() + struct.pack("<Q", len(inside)) + inside
    (tmp_path / "bomb.mcap").write_bytes(content[:begin] + struct.pack("<BQ", 6, len(chunk)) + chunk + content[begin:])
    tracemalloc.start()
    with pytest.raises(BadInput, match="unpacks to more than 32 times its"):
        read_recording(tmp_path / "bomb.mcap")
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def records_of(content: bytes):
    """Place, kind and length of each record of an .mcap."""
    at = 8
    while at + 9 <= len(content) - 8:
        kind, length = struct.unpack_from("<BQ", content, at)
        yield at, kind, length
        at += 9 + length


@pytest.mark.parametrize("storage", STORAGES)
def test_a_damaged_or_misnamed_bag_is_refused(tmp_path, storage):
    """Cut off, as after a full disk, or given another name."""
    ending = STORAGES[storage]
    (file,) = bag(tmp_path, storage).glob(f"*{ending}")
    content = file.read_bytes()
    for length in (60, len(content) // 2, len(content) - 200):
        (tmp_path / f"cut{ending}").write_bytes(content[:length])
        with pytest.raises(BadInput, match="is no readable bag"):
            read_recording(tmp_path / f"cut{ending}")
    (tmp_path / "a.log").write_bytes(content)
    with pytest.raises(BadInput, match=f"a name that ends in {ending}"):
        read_recording(tmp_path / "a.log")


def test_another_topic_is_refused_with_what_is_there(tmp_path):
    """A bag of images has no joints."""
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    with rosbags.Writer(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/chatter", text.__msgtype__, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(text("hello"), text.__msgtype__))
    with pytest.raises(BadInput, match=r"holds /chatter \(std_msgs/msg/String\); expected one topic of sensor_msgs/msg/JointState"):
        read_recording(tmp_path / "bag")
