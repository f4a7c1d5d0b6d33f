"""What MQTT tells of an arm: topics that no two arms share, figures that are never invented, and Home Assistant's conventions."""

import json
from dataclasses import replace

import home_assistant
import orjson
import page
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from told_arms import NOW_UNIX_S, alert, arm

from monitor.errors import BadInput
from monitor.gateway.mqtt.broker import MqttSettings
from monitor.gateway.mqtt.messages import ArmTopics, discovery, messages, named
from monitor.plant.arm import GONE

PREFIX = "homeassistant"
ODD = ["a_b", "a", "_-", "__", "%2F", "/", "a/b", "+", "#", "$SYS", "ä", "_5f"]
NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12) | st.sampled_from(ODD)
KEYS = ["joint", "state", "alerts", "joints", "robot", "active", "condition", "last_replay", "ended_at", "since"]
LEAVES = st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.integers()
DOCUMENTS = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4), max_leaves=12
)


def told(state, now=NOW_UNIX_S):
    topics = ArmTopics("joint-monitor", state.name.site, state.name.robot)
    return topics, messages(state, topics, now)


def announced(state, **options):
    topics = ArmTopics("joint-monitor", state.name.site, state.name.robot)
    return topics, discovery(state, topics, **{"acknowledge": False} | options)


@settings(max_examples=60)
@given(st.lists(st.tuples(NAMES, NAMES), min_size=2, max_size=2, unique=True))
def test_no_two_arms_share_a_topic_or_a_name(arms):
    """Whatever sites and robots are called, their topics are legal and differ, and so do their names in Home Assistant."""
    first, second = (ArmTopics("root", site, robot) for site, robot in arms)
    assert first.base != second.base
    assert first.identity != second.identity
    for topics in (first, second):
        assert not set(topics.base) & set("+#\0")
        assert topics.base.count("/") == 2
        assert home_assistant.discovered(PREFIX, topics.discovery(PREFIX)) == topics.identity
        assert named("root", topics.availability) == topics


def test_a_topic_of_another_root_or_of_another_spelling_is_of_no_arm():
    """Only the one way to write a name is read."""
    assert named("root", "root/lab/cell%2d3/availability") is None
    assert named("root", "other/lab/cell-3/availability") is None
    assert named("root", "root/availability") is None


@pytest.mark.parametrize("acknowledge", [False, True])
@pytest.mark.parametrize("state", [arm(), arm(alerts=[alert()]), arm(count=7), arm(health={}, info={}, friction={})])
def test_discovery_follows_home_assistants_conventions(state, acknowledge):
    """The judge of its documentation has nothing to say, whatever is known of the arm."""
    topics, payload = announced(state, acknowledge=acknowledge)
    assert home_assistant.mistakes(payload) == []
    assert home_assistant.discovered(PREFIX, topics.discovery(PREFIX))


@pytest.mark.parametrize(
    ("own", "change", "says"),
    [
        ("j1_temperature_c", {"unit_of_measurement": "C"}, "unit 'C' is none of temperature"),
        ("j1_temperature_c", {"state_class": "total"}, "does not go with temperature"),
        ("j1_remaining_life_p50_days", {"unit_of_measurement": "days"}, "unit 'days' is none of duration"),
        ("j1_wear_percent", {"device_class": "wear"}, "'wear': unknown"),
        ("j1_wear_percent", {"device_class": "temperature"}, "unit '%' is none of temperature"),
        ("state", {"options": None}, "options"),
        ("state", {"state_class": "measurement"}, "an enum has neither"),
        ("last_replay", {"state_class": "measurement"}, "does not go with timestamp"),
        ("state", {"unique_id": None}, "unique_id"),
        ("state", {"state_topic": "a/#"}, "no topic"),
        ("state", {"entity_category": "config"}, "not for a sensor"),
        ("state", {"colour": "red"}, "colour: unknown"),
        ("acknowledge", {"device_class": "press"}, "none of a button"),
        ("acknowledge", {"command_topic": None}, "without command_topic"),
    ],
)
def test_the_judge_of_discovery_finds_what_is_wrong(own, change, says):
    """A message that is changed in one place is refused: else the judge would prove nothing."""
    message = json.loads(announced(arm(), acknowledge=True)[1])
    about = message["components"][own] | change
    message["components"][own] = {key: value for key, value in about.items() if value is not None}
    assert any(says in each for each in home_assistant.mistakes(json.dumps(message)))


def test_every_entity_finds_its_figure():
    """Each sensor's template names a key of the message on its topic, and an enum shows one of its options."""
    payload = announced(arm(alerts=[alert()]))[1]
    sent = told(arm(alerts=[alert()]))[1]
    values = {}
    for own, about in json.loads(payload)["components"].items():
        if about["platform"] == "sensor":
            values[own] = home_assistant.shown(about, sent[about["state_topic"]])
            assert "options" not in about or values[own] in about["options"]
    assert values["state"] == "MAINTENANCE_REQUIRED"
    assert (values["j3_wear_percent"], values["j3_temperature_c"], values["j3_remaining_life_p50_days"]) == (3.0, 33.0, 80.5)
    assert (values["alerts"], values["unacknowledged"], values["last_replay"]) == (1, 1, "2026-11-18T10:06:40Z")
    assert len(values) == 5 + 6 * 7


def test_what_is_not_known_is_unknown():
    """An arm that has said nothing yet has entities without a value, and no figure stands for a missing one."""
    nothing = arm(health={"joints": [{"joint": 2}]}, monitor={}, info={}, friction={})
    payload = announced(nothing)[1]
    sent = told(nothing)[1]
    sensors = [about for about in json.loads(payload)["components"].values() if about["platform"] == "sensor"]
    assert {home_assistant.shown(about, sent[about["state_topic"]]) for about in sensors} == {"unknown", 0}  # 0 alerts
    assert "model" not in json.loads(payload)["device"]


@settings(max_examples=40)
@given(DOCUMENTS)
def test_no_document_brings_the_gateway_down(document):
    """Documents came from elsewhere: whatever they hold, the messages are JSON, and discovery keeps the conventions."""
    table = document if isinstance(document, dict) else {"joints": document, "alerts": document, "robot": document}
    state = arm(health=table, monitor=table, info=table)
    topics, sent = told(state)
    assert all(isinstance(orjson.loads(payload), dict) for topic, payload in sent.items() if topic != topics.availability)
    assert home_assistant.mistakes(announced(state, acknowledge=True)[1]) == []


def test_silence_is_told_with_its_reason():
    """An arm that nobody hears is offline: the plant noted it, or the plant itself does not run."""
    topics, sent = told(arm())
    assert sent[topics.availability] == b"online"
    topics, sent = told(arm(silent_since_unix_s=NOW_UNIX_S - 600.0, silent_why=GONE))
    assert sent[topics.availability] == b"offline"
    assert json.loads(sent[topics.state])["silent_why"] == "its monitor is gone"
    topics, sent = told(arm(), now=NOW_UNIX_S + 3600.0)
    assert sent[topics.availability] == b"offline"
    assert "joint-monitor plant" in json.loads(sent[topics.state])["silent_why"]
    assert list(sent)[-1] == topics.availability


def test_buttons_are_taken_back_where_nobody_may_acknowledge():
    """Home Assistant removes an entity whose component holds its platform alone."""
    components = json.loads(announced(arm(count=1))[1])["components"]
    assert components["acknowledge"] == components["j1_acknowledge"] == {"platform": "button"}
    components = json.loads(announced(arm(count=1), acknowledge=True)[1])["components"]
    assert json.loads(components["j1_acknowledge"]["payload_press"]) == {"joint": 1, "by": "Home Assistant"}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"root": "a/+/b"}, "root = 'a/+/b'"),
        ({"root": ""}, "root"),
        ({"root": "$SYS"}, "root"),
        ({"home_assistant": "home//assistant"}, "home_assistant"),
        ({"password": "x"}, "no user"),
        ({"cert_file": "a.pem"}, "belong together"),
        ({"tls": False, "ca_file": "a.pem"}, "tls = false"),
        ({"host": "mqtt://broker"}, "a name or an address alone"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(changes, says):
    """The sentence names the key."""
    with pytest.raises(BadInput, match=says.replace("+", r"\+").replace("$", r"\$")):
        MqttSettings(**changes)


def test_a_password_never_shows_itself():
    """Not in the text of the settings."""
    given_ones = MqttSettings(host="broker.example", user="gateway", password="s3cret")
    assert "s3cret" not in repr(given_ones)
    assert given_ones.address == ("broker.example", 8883)
    assert replace(given_ones, tls=False).address == ("broker.example", 1883)


def test_the_page_shows_each_key_each_topic_and_a_joint_as_it_is():
    """Nothing that is told is missing on the page, and nothing there is invented."""
    title = "MQTT and Home Assistant"
    assert sorted(page.first_cells(title, "key of `[mqtt]`")) == sorted(page.keys(MqttSettings))
    topics, sent = told(arm(alerts=[alert()]))
    cells = page.first_cells(title, "topic")
    shown = {each.replace("ROOT/SITE/ROBOT", topics.base).replace("ROOT", topics.root).replace("/N", "/3") for each in cells}
    assert shown == {f"{topics.root}/availability"} | {each for each in sent if "/joint/" not in each or each.endswith("/3")}
    assert json.loads(page.blocks(title, "json")[0]) == json.loads(told(arm())[1][topics.joint(3)])
