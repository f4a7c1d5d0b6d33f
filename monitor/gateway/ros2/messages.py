"""An arm as diagnostic_msgs/msg/DiagnosticArray, in CDR by the library rosbags. No I/O, no clock."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from typing import Any, NamedTuple

from zenoh.ext import Int64, z_serialize

from monitor.plant.arm import HeardArm, HeardJoint, Silence
from monitor.publish.shown import Age, Shown, unacknowledged
from monitor.publish.timestamps import written
from monitor.reason import joint_text

MESSAGE = "diagnostic_msgs/msg/DiagnosticArray"
OK, WARN, ERROR, STALE = range(4)  # of diagnostic_msgs/msg/DiagnosticStatus
LEVELS = {"NORMAL": OK, "CHECK_FUNCTION": WARN, "OFF_SPEC": WARN, "MAINTENANCE_REQUIRED": WARN, "FAILURE": ERROR}
NAME = "joint-monitor"
NS = 1_000_000_000


class Status(NamedTuple):
    """One status of an array."""

    level: int
    name: str  # component and what it is of, by the convention of diagnostics
    message: str
    hardware_id: str
    values: Sequence[tuple[str, str]]


def statuses(arm: HeardArm, now_unix_s: float) -> list[Status]:
    """The arm, then each of its joints. What is not heard, or too old, is STALE, whatever it was then."""
    hardware, health, shown = arm.serial or str(arm.name), arm.health, arm.shown
    silence = arm.silence(now_unix_s)
    message = _state(shown)
    if silence is not None:
        message = f"not heard: {silence.why.text}; then: {message}"
    elif shown.age is not Age.NOW:
        message = f"nothing was learnt of it for too long; then: {message}"
    values = [
        *_values(state=shown.state, model=arm.model, firmware=arm.firmware, monitor_version=arm.version, troubles=", ".join(arm.troubles)),
        ("active_alerts", str(len(arm.alerts))),
        ("unacknowledged_alerts", str(len(unacknowledged(arm.alerts)))),
        *_times(last_replay=None if arm.last_replay is None else arm.last_replay.ended_at),
    ]
    if health is not None:
        values += _times(since=health.since, said_at=health.said_at, next_replay=health.next_replay_due)
    found = [Status(_level(shown, silence), f"{NAME}: {arm.name}", message, hardware, values)]
    return found + [_joint(each, arm, hardware, silence) for each in arm.joints]


def _joint(joint: HeardJoint, arm: HeardArm, hardware: str, silence: Silence | None) -> Status:
    values: list[tuple[str, str]] = _values(state=joint.shown.state)
    if (of := joint.friction) is not None:
        life = of.remaining_life
        values += _values(
            wear=_figure(of.wear),
            wear_std=_figure(of.wear_std),
            wear_rate_per_day=_figure(of.wear_rate_per_day),
            remaining_life_p10_days=_figure(life.p10_days),
            remaining_life_p50_days=_figure(life.p50_days),
            remaining_life_p90_days=_figure(life.p90_days),
            friction_nm=_figure(of.reference_torque_nm),
            temperature_c=_figure(of.temperature_c),
        )
        values += _times(measured_at=of.recorded_at)
    values += [(f"alert {each.condition}", f"{each.tier}: {each.text}") for each in joint.alerts]
    if joint.said is not None:
        values += _times(since=joint.said.since, learnt_at=joint.said.learnt_at)
    name = f"{NAME}: {arm.name} {joint_text(joint.joint)}"
    return Status(_level(joint.shown, silence), name, _state(joint.shown), hardware, values)


def _level(shown: Shown, silence: Silence | None) -> int:
    """Nothing is known before the first verdict: that is no OK."""
    return STALE if silence is not None or shown.age is not Age.NOW else LEVELS.get(shown.state or "", STALE)


def _state(shown: Shown) -> str:
    return shown.why.text if shown.state is None else f"{shown.state}: {shown.said.text}"


def _figure(value: float | None) -> str | None:
    return None if value is None else f"{value:.6g}"


def _values(**values: str | None) -> list[tuple[str, str]]:
    return [(key, value) for key, value in values.items() if value]


def _times(**times: datetime | None) -> list[tuple[str, str]]:
    return [(key, written(at)) for key, at in times.items() if at is not None]


@cache
def _types() -> Any:
    """ROS 2's own definitions, as rosbags carries them: 0.1 s, once."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def type_hash(message: str = MESSAGE) -> str:
    """The hash of a message's type by REP-2016, RIHS01_…"""
    return str(_types().hash_rihs01(message))


def encoded(found: Sequence[Status], now_unix_s: float) -> bytes:
    """The array in CDR."""
    types = _types().types
    status, pair = types["diagnostic_msgs/msg/DiagnosticStatus"], types["diagnostic_msgs/msg/KeyValue"]
    nanoseconds = round(now_unix_s * NS)
    stamp = types["builtin_interfaces/msg/Time"](sec=nanoseconds // NS, nanosec=nanoseconds % NS)
    array = types[MESSAGE](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        status=[
            status(
                level=each.level,
                name=_clean(each.name),
                message=_clean(each.message),
                hardware_id=_clean(each.hardware_id),
                values=[pair(key=_clean(key), value=_clean(value)) for key, value in each.values],
            )
            for each in found
        ],
    )
    return bytes(_types().serialize_cdr(array, MESSAGE))


def _clean(text: str) -> str:
    """A string of CDR ends with NUL, so none may be inside of it: what an arm says may hold anything."""
    return text.replace("\0", " ")


# --- What rmw_zenoh makes of a topic: the key of its messages, what travels beside each, and the tokens by which nodes see each other

NODE, PUBLISHER = "NN", "MP"  # kinds of entities
NO_HASH = "TypeHashNotSupported"  # in the place of a hash, where the ROS 2 distribution has none
DEPTH = 10  # messages that are kept for a slow subscriber, as diagnostic_updater keeps
GID_BYTES = 16
NODE_ID, PUBLISHER_ID = 0, 1  # within the session


def mangled(name: str) -> str:
    """A name as one chunk of a key: an empty one is `%`."""
    return name.replace("/", "%") or "%"


def type_name(name: str) -> str:
    """A message's type as DDS declares it: `diagnostic_msgs/msg/DiagnosticArray` → `diagnostic_msgs::msg::dds_::DiagnosticArray_`."""
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


@dataclass(frozen=True, slots=True, kw_only=True)
class Publication:
    """One topic of one node in one session."""

    domain: int  # ROS_DOMAIN_ID
    session_id: str  # of Zenoh
    node: str
    topic: str  # the whole name, with its slash
    message: str  # e.g. diagnostic_msgs/msg/DiagnosticArray
    type_hash: str  # RIHS01_…, or NO_HASH

    @property
    def key(self) -> str:
        """Where its messages are published: `<domain_id>/<fully_qualified_name>/<type_name>/<type_hash>`."""
        return f"{self.domain}/{self.topic.strip('/')}/{type_name(self.message)}/{self.type_hash}"

    @property
    def node_token(self) -> str:
        """The liveliness token of its node."""
        return self._token(NODE_ID, NODE)

    @property
    def token(self) -> str:
        """The liveliness token of the publisher: what `ros2 topic list` and `info` show of it."""
        # reliable, volatile and keep-last are defaults, which are left out; depth is not the default of 42
        qos = f"::,{DEPTH}:,:,:,,"
        topic = f"{mangled(self.topic)}/{mangled(type_name(self.message))}/{mangled(self.type_hash)}"
        return f"{self._token(PUBLISHER_ID, PUBLISHER)}/{topic}/{qos}"

    @property
    def gid(self) -> bytes:
        """Sixteen bytes that tell this publisher from every other: a digest of its token. rmw_zenoh takes another digest of the same."""
        return hashlib.blake2b(self.token.encode(), digest_size=GID_BYTES).digest()

    def _token(self, entity: int, kind: str) -> str:
        root = mangled("/")  # of enclave and namespace
        return f"@ros2_lv/{self.domain}/{self.session_id}/{NODE_ID}/{entity}/{kind}/{root}/{root}/{self.node}"

    def attachment(self, sequence: int, at_ns: int) -> bytes:
        """What travels beside a message: its number from 1, the time when it was sent [ns since 1970], and who sent it."""
        return bytes(z_serialize((Int64(sequence), Int64(at_ns), self.gid)))
