"""Diagnostics for ROS 2: a subscriber that follows rmw_zenoh's published format hears them, and a library of others decodes them."""

import json
import time
from types import SimpleNamespace

import pytest
import zenoh
from told_arms import NOW_UNIX_S, alert, arm, health
from zenoh.ext import Int64, z_deserialize

from monitor.errors import BadInput
from monitor.gateway.connection import NotReached
from monitor.gateway.ros2.channel import Ros2Channel, Ros2Settings, check
from monitor.gateway.ros2.messages import ERROR, MESSAGE, OK, STALE, WARN, Publication, encoded, statuses, type_hash
from monitor.plant.arm import GONE

rosbags = pytest.importorskip("rosbags.typesys", reason="pip install 'joint-monitor[gateway]'")
# of std_msgs/String in rmw_zenoh's docs/design.md, and of DiagnosticArray in the C header that rosidl generates for diagnostic_msgs
TOPIC = "std_msgs::msg::dds_::String_"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
DIAGNOSTICS_HASH = "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"


def decoded(payload):
    return rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE).deserialize_cdr(payload, MESSAGE)


def test_keys_and_tokens_are_those_of_rmw_zenohs_own_page():
    """The examples of docs/design.md, from their node, topic and type."""
    talker = Publication(
        domain=2, session_id="8b20917502ee955ac4476e0266340d5c", node="talker", topic="/chatter", message="std_msgs/msg/String",
        type_hash=STRING_HASH,
    )  # fmt: skip
    assert talker.key == f"2/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert talker.node_token == "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/0/NN/%/%/talker"
    shown = f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/{TOPIC}/{STRING_HASH}/::,7:,:,:,,"
    assert talker.token == shown.replace("/0/10/MP/", "/0/1/MP/").replace("::,7:", "::,10:"), "number and depth are our own"


def test_the_hash_of_a_type_is_that_of_ros():
    """By REP-2016."""
    assert type_hash("std_msgs/msg/String") == STRING_HASH
    assert type_hash() == DIAGNOSTICS_HASH


def test_an_arm_is_a_status_and_one_for_each_joint():
    """Levels follow NE 107, and what is not heard or not known is STALE and never OK."""
    said = health(count=3, alerts=[alert()], joints={3: {"state": "FAILURE", "why": "limit reached"}})
    found = statuses(arm(health=said, count=4), NOW_UNIX_S)
    assert [each.level for each in found] == [WARN, OK, OK, ERROR, STALE]
    assert found[0].name == "joint-monitor: lab/cell-3"
    assert found[3].name == "joint-monitor: lab/cell-3 Elbow (joint 3)"
    assert found[3].message == "FAILURE: limit reached"
    assert {each.hardware_id for each in found} == {"20195500001"}
    values = dict(found[3].values)
    assert (values["wear"], values["remaining_life_p50_days"]) == ("0.03", "80.5")
    assert values["alert wear_rising"] == "wear: Joint 3 wears."
    assert dict(found[0].values)["unacknowledged_alerts"] == "1"
    silent = statuses(arm(silent_since_unix_s=1.0, silent_why=GONE), NOW_UNIX_S)
    assert {each.level for each in silent} == {STALE}
    assert silent[0].message.startswith("not heard: its monitor is gone; then: NORMAL")


def test_the_library_reads_what_was_written_whatever_an_arm_says():
    """Umlauts, a sign NUL, nothing at all: decoded with the definitions of another distribution."""
    state = arm(health=health(why="Grüße\0aus dem Ellbogen"))
    array = decoded(encoded(statuses(state, 12.25), 12.25))
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (12, 250_000_000)
    assert "Grüße aus dem Ellbogen" in array.status[0].message
    assert len(array.status) == 7
    empty = arm(health=None, monitor=None, info=None, friction={}, heard_at_unix_s={})
    array = decoded(encoded(statuses(empty, NOW_UNIX_S), NOW_UNIX_S))
    assert [(each.level, each.hardware_id) for each in array.status] == [(STALE, "lab/cell-3")]


@pytest.mark.parametrize(
    ("settings", "says"),
    [({"connect": "router"}, "is no endpoint"), ({"node": "a b"}, "node = 'a b'"), ({"topic": "diagnostics"}, "topic = 'diagnostics'"),
     ({"topic": "/a//b"}, "topic = '/a//b'")],
)  # fmt: skip
def test_a_mistake_in_the_settings_is_named(settings, says):
    """With what would be right."""
    with pytest.raises(BadInput, match="ros2: ") as refused:
        Ros2Settings(**settings)
    assert says in str(refused.value)


def session(**values):
    config = zenoh.Config()
    for key, value in ({"scouting/multicast/enabled": False} | values).items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Router:
    """A Zenoh router, and a node behind it that has subscribed as rmw_zenoh's page says; both set up as rmw_zenoh does."""

    def __init__(self, port):
        self.endpoint = f"tcp/127.0.0.1:{port}"
        # DEFAULT_RMW_ZENOH_ROUTER_CONFIG.json5 and DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5, as far as they differ from Zenoh's own
        failover = {"routing/router/peers_failover_brokering": False}
        self.router = session(mode="router", **{"listen/endpoints": [self.endpoint]}, **failover)
        listens = {"listen/endpoints": ["tcp/127.0.0.1:0"], "connect/endpoints": [self.endpoint]}
        self.session = session(mode="peer", **listens, **failover)
        self.heard, self.tokens = [], {}
        key = f"0/diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_/{DIAGNOSTICS_HASH}"
        self.held = [
            self.session.declare_subscriber(key, self.heard.append),
            self.session.liveliness().declare_subscriber("@ros2_lv/0/**", self._token, history=True),
        ]

    @property
    def newest(self):
        """The number of the newest message."""
        return int(z_deserialize(tuple[Int64, Int64, bytes], self.heard[-1].attachment)[0])

    def _token(self, sample):
        self.tokens[str(sample.key_expr)] = sample.kind == zenoh.SampleKind.PUT

    def close(self):
        self.session.close()
        self.router.close()


def until(condition):
    deadline = time.monotonic() + 30.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert condition()


@pytest.fixture
def router(free_port):
    router = Router(free_port)
    yield router
    router.close()


def channel_of(folder, endpoint, *arms, **settings):
    about = SimpleNamespace(plant=SimpleNamespace(folder=folder), arms=lambda: {each.name: each for each in arms})
    return Ros2Channel(Ros2Settings(connect=endpoint, **settings), about)


def test_a_node_with_rmw_zenoh_hears_every_arm_and_sees_who_speaks(router, tmp_path):
    """Messages with number, time and sender; tokens of node and publisher, which go when the channel ends."""
    channel = channel_of(tmp_path, router.endpoint, arm("a"), arm("b", silent_since_unix_s=1.0), arm("c", site="elsewhere"), sites=("lab",))
    try:
        until(lambda: channel.step(NOW_UNIX_S) == 2.0 and len(router.heard) > 0 and len(router.tokens) == 2)
        until(lambda: router.newest == channel._sequence)
        first = len(router.heard)
        channel.step(NOW_UNIX_S + 2.0)
        until(lambda: len(router.heard) == first + 2)
        arrays = [decoded(bytes(sample.payload)) for sample in router.heard]
        assert [array.status[0].name for array in arrays] == ["joint-monitor: lab/a", "joint-monitor: lab/b"] * (first // 2 + 1)
        assert [array.status[0].level for array in arrays[:2]] == [OK, STALE]
        beside = [z_deserialize(tuple[Int64, Int64, bytes], sample.attachment) for sample in router.heard]
        assert [int(number) - int(beside[0][0]) for number, _, _ in beside] == list(range(first + 2)), "none is skipped or doubled"
        assert int(beside[0][1]) == round(NOW_UNIX_S * 1e9)
        assert {len(gid) for *_, gid in beside} == {16}
        assert len({gid for *_, gid in beside}) == 1
        node, publisher = sorted(router.tokens, key=len)
        assert node.split("/")[0] == "@ros2_lv"
        assert node.split("/")[5:] == ["NN", "%", "%", "joint_monitor"]
        assert publisher.split("/")[5:9] == ["MP", "%", "%", "joint_monitor"]
        topic = ["%diagnostics", "diagnostic_msgs::msg::dds_::DiagnosticArray_", DIAGNOSTICS_HASH, "::,10:,:,:,,"]
        assert publisher.split("/")[9:] == topic
        assert channel.status() == f"2 arms on /diagnostics of domain 0 at {router.endpoint}"
    finally:
        channel.close()
    until(lambda: not any(router.tokens.values()))


def test_a_router_that_is_away_is_told_and_waited_for(free_port, tmp_path):
    """Before the first session, and after it was lost: the node comes back by itself."""
    channel = channel_of(tmp_path, f"tcp/127.0.0.1:{free_port}", arm())
    try:
        with pytest.raises(NotReached, match="no Zenoh router answers"):
            channel.step(NOW_UNIX_S)
        assert channel.status() == "not connected"
        router = Router(free_port)
        until(lambda: channel.step(NOW_UNIX_S) and router.heard)
        router.close()

        def away():
            try:
                channel.step(NOW_UNIX_S)
            except NotReached as error:
                return "is away" in str(error)
            return False

        until(away)
        router = Router(free_port)

        def heard():
            try:
                channel.step(NOW_UNIX_S)
            except NotReached:
                return False
            return router.heard and sum(router.tokens.values()) == 2

        until(heard)
        router.close()
    finally:
        channel.close()


def test_a_check_tells_how_far_it_gets_and_who_listens(router, tmp_path):
    """Nobody, then a node with another type; a port where nobody is."""
    plant = SimpleNamespace(folder=tmp_path)
    settings = Ros2Settings(connect=router.endpoint)
    assert [(each.step, each.ok) for each in check(settings, plant)] == [("name", True), ("tcp", True), ("zenoh", True), ("nodes", True)]
    base = "@ros2_lv/0/aa/0/10/MS/%/%/aggregator/%diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_"
    with router.session.liveliness().declare_token(f"{base}/{DIAGNOSTICS_HASH}/::,10:,:,:,,"):
        assert check(settings, plant)[-1].text.endswith("/diagnostics is heard by aggregator")
        other = check(Ros2Settings(connect=router.endpoint, type_hash=False), plant)[-1]
        assert not other.ok
        assert "type_hash = true" in other.text
    nowhere = check(Ros2Settings(connect="tcp/127.0.0.1:1"), plant)
    assert [each.ok for each in nowhere] == [True, False]
    assert router.heard == []
