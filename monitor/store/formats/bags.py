"""Recordings as bags of ROS: rosbag2 (.db3, .mcap, or their folder) and ROS 1 (.bag), messages of sensor_msgs/JointState. I/O."""

import re
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.production.arm import ProductionRows
from monitor.reason import Sentence
from monitor.recording import Array
from monitor.store.formats.columns import layout_of_table, recorded
from monitor.store.formats.others import refuse_much, refuse_unpacked

MCAP = b"\x89MCAP0\r\n"
CHUNK = 6  # the number of its kind of record; 0 is of none
CHUNK_NAME = 28  # bytes of a chunk's record before the name of its compression
_RECORD = struct.Struct("<BQ")  # its kind, and its length
BAGS = {b"SQLite format 3\0": ".db3", MCAP: ".mcap", b"#ROSBAG V2.0": ".bag"}  # how a bag begins → how its name must end
JOINT_STATE = "sensor_msgs/msg/JointState"
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")  # from the base on, as ROS names them
_NUMBER = re.compile(r"\d+")

EFFORT_AS_TORQUE = Sentence(
    "effort_as_torque",
    "{source}: effort is taken as N·m, as sensor_msgs/JointState defines it; the drivers of UR write amperes there: then say "
    "--columns actual_current=effort_{braces}",
)


class _States(NamedTuple):
    """Messages of one topic."""

    names: tuple[str, ...]  # of the joints, as in a message
    stamps_s: Array  # (N,) of the header
    logged_s: Array  # (N,) when they were recorded
    signals: dict[str, Array]  # position, velocity, effort → (N, J), where they are there


def bag_ends(content: bytes) -> str | None:
    """How the name of a bag must end that begins so; None for what is no bag."""
    return next((ending for begin, ending in BAGS.items() if content.startswith(begin)), None)


def read_bag(path: Path, columns: str | None, rate_hz: float | None) -> ProductionRows:
    """A recording from a bag, joints from the base on. columns, rate_hz : as `layout_of` takes them.

    Its columns are timestamp, actual_q_0 …, actual_qd_0 …, effort_0 …; effort is torque unless `columns` says otherwise. Raises BadInput
    where the bag is damaged, holds none or several topics of JointState, or joints whose order is not known, and ModuleNotFoundError
    where the extra `ros` is absent.
    """
    states = _states(path)
    order = from_the_base(states.names, str(path))
    by_header = bool(np.all(np.diff(states.stamps_s) > 0.0))  # a header that nobody stamped is 0
    table = {"timestamp": states.stamps_s if by_header else states.logged_s}
    for signal, name in (("position", "actual_q"), ("velocity", "actual_qd"), ("effort", "effort")):
        if signal in states.signals:
            table |= {f"{name}_{j}": states.signals[signal][:, k] for j, k in enumerate(order)}
    names, values = list(table), list(table.values())
    braces = f"{{0..{len(order) - 1}}}"
    guessed = "effort" in states.signals and not any(name in (columns or "") for name in ("effort", "actual_torque"))
    spec = ",".join([*([columns] if columns else []), *([f"actual_torque=effort_{braces}"] if guessed else [])]) or None
    layout = layout_of_table(str(path), names, spec if columns is None or "=" in columns else columns, rate_hz)
    if guessed:
        layout = layout._replace(told=(EFFORT_AS_TORQUE(source=path.name, braces=braces), *layout.told))
    return recorded(layout, lambda k: values[k], len(values[0]), path.name)


def _states(path: Path) -> _States:
    """The joint states of a bag. Raises BadInput."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        for file in path.glob("*.mcap") if path.is_dir() else [path]:
            refuse_much(_packed_chunks(file), file.stat().st_size, str(path))
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            topics = sorted({connection.topic for connection in bag.connections if connection.msgtype == JOINT_STATE})
            if len(topics) != 1:
                held = ", ".join(topics) or ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections}))[:200] or "nothing"
                raise BadInput(
                    f"{path}: holds {held}; expected one topic of {JOINT_STATE}: ros2 bag filter or rosbags-convert --include-topic TOPIC"
                )
            chosen = [connection for connection in bag.connections if connection.topic == topics[0]]
            refuse_unpacked(sum(c.msgcount for c in chosen) * 8.0 * 19, _size(path), str(path))
            messages = list(_messages(bag, chosen))
    except BadInput:
        raise
    except Exception as wrong:  # readers of three formats, which raise whatever a damaged file makes of their numbers
        raise BadInput(f"{path}: is no readable bag: {wrong or type(wrong).__name__}; expected it closed, with its metadata") from None
    usual = Counter(names for names, *_ in messages).most_common(1)
    if not usual:
        raise BadInput(f"{path}: the topic {topics[0]} holds no message")
    names = usual[0][0]
    rows = [message for message in messages if message[0] == names]  # a gripper may publish on the same topic
    signals = {}
    for signal, values in zip(("position", "velocity", "effort"), zip(*(row[3:] for row in rows), strict=True), strict=True):
        whole = [len(value) == len(names) for value in values]
        if any(whole):
            none = np.full(len(names), np.nan)
            signals[signal] = np.array([value if there else none for value, there in zip(values, whole, strict=True)], dtype=float)
    return _States(names, np.array([row[1] for row in rows]), np.array([row[2] for row in rows]), signals)


def _packed_chunks(path: Path) -> Iterator[tuple[str, bytes]]:
    """How each chunk of an .mcap is packed, and its content; none of other files and of chunks as they are. mcap.dev/spec."""
    with path.open("rb") as file:
        kind, length = CHUNK if file.read(len(MCAP)) == MCAP else 0, 0
        while kind:
            file.seek(length, 1)
            kind, length = _RECORD.unpack(head) if len(head := file.read(_RECORD.size)) == _RECORD.size else (0, 0)
            if kind == CHUNK:
                record = file.read(length)
                (name,) = struct.unpack_from("<I", record, CHUNK_NAME)
                begin, length = CHUNK_NAME + 4 + name, 0
                if name:
                    yield record[CHUNK_NAME + 4 : begin].decode(), record[begin + 8 :]


def _messages(bag: Any, connections: Sequence[Any]) -> Iterator[tuple[tuple[str, ...], float, float, Array, Array, Array]]:
    for connection, logged_ns, raw in bag.messages(connections=connections):
        state = bag.deserialize(raw, connection.msgtype)
        stamp = state.header.stamp
        yield (
            tuple(state.name), stamp.sec + 1e-9 * stamp.nanosec, 1e-9 * logged_ns, state.position, state.velocity, state.effort
        )  # fmt: skip


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.iterdir()) if path.is_dir() else path.stat().st_size


def from_the_base(names: Sequence[str], where: str) -> list[int]:
    """The places of the joints in a message, from the base on: by UR's names, else by their one number. Messages have any order.

    Raises BadInput where the names tell none.
    """
    ur = [[k for k, name in enumerate(names) if joint in name] for joint in UR_JOINTS]
    if all(len(places) == 1 for places in ur):
        return [places[0] for places in ur]
    numbers = [found[-1] if (found := _NUMBER.findall(name)) else None for name in names]
    told = {int(number): k for k, number in enumerate(numbers) if number is not None}
    if len(told) != len(names) or max(told) - min(told) != len(names) - 1:
        raise BadInput(
            f"{where}: the order of the joints {', '.join(names)} is not known; expected the names of UR, or one number in each; write the "
            f"columns as CSV in the order from the base on"
        )
    return [told[number] for number in sorted(told)]
