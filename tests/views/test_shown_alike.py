"""One arm is shown alike everywhere: page, list, report, mail, MQTT, OPC UA, ROS 2 and terminal give one state and one sentence."""

import asyncio
import html
import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from zoneinfo import ZoneInfo

import orjson
import pytest
from heard_documents import ALERT, JOINT, SAID_AT, whole

from monitor.gateway.mqtt.messages import ArmTopics, messages
from monitor.gateway.notify.messages import alert_message, plant_page
from monitor.gateway.opcua.nodes import NE107, readings
from monitor.gateway.ros2.messages import LEVELS, STALE, statuses
from monitor.gateway.values import active, document_of, transition_of
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.plant.arm import GONE, ArmName, HeardArm, documents_of
from monitor.plant.screen.fleet import shown_arm
from monitor.plant.status import PlantStatus, as_lines
from monitor.publish.documents import as_json, encoded
from monitor.publish.shown import TIER_WORDS, WORDS, Age, Person, Pill, alert_pill, person
from monitor.publish.timestamps import unix_s
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.language.catalogue import language
from monitor.views.report.alerts import alert_boxes, chip
from monitor.views.web.worded import Told

NOW_UNIX_S = unix_s(SAID_AT) + 60.0
NAME = ArmName("hall", "cell-1")
EACH = [(name, tier) for name, condition in CONDITIONS.items() for tier in condition.tiers]
SAYS = [language("en"), language("de")]


def alert_of(condition, tier, **more):
    of_arm = CONDITIONS[condition].headline(3, 0.1, "10 %", "then") is None
    return {**ALERT, "joint": None if of_arm else 3, "condition": condition, "tier": tier, **more}


def arm(alerts=(), *, state="NORMAL", stale=False, **more):
    joints = [{**JOINT, "joint": joint, "stale": stale} for joint in range(1, 7)]
    health = whole("health", state=state, why="all is well", joints=joints, alerts=list(alerts), stale=stale)
    heard = {"health": NOW_UNIX_S, "monitor": NOW_UNIX_S}
    return HeardArm(name=NAME, heard_at_unix_s=heard, **documents_of({"health": health}, NOW_UNIX_S), **more)


def on_page(heard, say):
    """What the page of the arm gets: of the arm, and of each alert."""
    content = SimpleNamespace(began_unix_s=lambda _=None: None, newest_unix_s=lambda: None, now=lambda: NOW_UNIX_S)
    said = {"health": encoded(heard.health)} | {f"alert/x/{each.condition}": encoded(each) for each in heard.alerts}
    with ThreadPoolExecutor(1) as thread:  # a browser of another test may keep an event loop running in this one
        told = dict(thread.submit(asyncio.run, Told(content).tell(list(said.items()), said, say)).result())
    return {key: json.loads(payload) for key, payload in told.items()}


def chips(written):
    return re.findall(r'class="chip"[^>]*>([^<]*)<', written)


@pytest.mark.parametrize("say", SAYS, ids=lambda say: say.code)
@pytest.mark.parametrize(("condition", "tier"), EACH)
def test_every_alert_has_one_pill_one_state_and_one_sentence(condition, tier, say):
    """Also where the arm's last verdict is milder than an alert that has come since."""
    heard = arm([alert_of(condition, tier)])
    (alert,) = heard.alerts
    pill, state = alert_pill(alert), heard.shown.state
    headline = sentences(alert, JointPast(), NOW_UNIX_S, say).headline
    assert state == (pill.value if pill is not Pill.NOTICE else "NORMAL")

    listed = shown_arm(heard, {}, NOW_UNIX_S, say)
    assert (listed["pill"], listed["state"], listed["alerts"][0]["pill"]) == (state, state, pill.value)
    page = on_page(heard, say)
    assert page["health"]["shown"]["pill"] == listed["pill"]
    assert page["health"]["shown"]["text"] == listed["why"]
    assert page[f"alert/x/{condition}"]["pill"] == pill.value
    assert page[f"alert/x/{condition}"]["said"]["headline"] == headline
    if pill is not Pill.NOTICE:
        assert listed["why"] == headline

    when = {"from": SAID_AT, "to": SAID_AT, "made_at": SAID_AT}
    report = {"alerts": [as_json(alert)], "joints": [], "history": [], **when}
    (box,) = alert_boxes(report, say)
    assert chips(box) == [say.say(pill.word)]
    since_then = sentences(alert, JointPast(began_unix_s=unix_s(SAID_AT)), unix_s(SAID_AT), say).headline  # the report names the day
    assert since_then in html.unescape(box)
    summary = plant_page([heard], [], 0.0, NOW_UNIX_S, NOW_UNIX_S, say, ZoneInfo("UTC"))
    assert chips(summary.html) == [say.say(Pill(state).word)]
    assert summary.sick == (state in ("MAINTENANCE_REQUIRED", "FAILURE"))

    (raised,) = [active(heard, each) for each in heard.alerts]
    subject, _ = alert_message("alert", [raised], say, ZoneInfo("UTC"), "")
    assert subject == f"[{say.say(TIER_WORDS[tier])}] {NAME}: {headline}".replace("\u00a0", " ")[:200]
    assert transition_of(orjson.loads(orjson.dumps(document_of(raised)))) == raised

    topics = ArmTopics("root", *NAME)
    assert json.loads(messages(heard, topics, NOW_UNIX_S)[topics.state])["state"] == state
    assert readings(heard, NOW_UNIX_S, 86_400.0)["device/hall/cell-1/DeviceHealth"].value == NE107[state]
    assert statuses(heard, NOW_UNIX_S)[0].level == LEVELS[state]
    assert f"  {state} " in as_lines(PlantStatus(None, {}, 0, [heard], NOW_UNIX_S))[1] + " "


@pytest.mark.parametrize(
    ("more", "age", "says"),
    [({"stale": True}, Age.OUT_OF_DATE, "out of date"), ({"silent_since_unix_s": 1.0, "silent_why": GONE}, Age.NOT_HEARD, "is gone")],
)
def test_what_is_of_then_is_normal_nowhere(more, age, says):
    """People see that it is to be checked, and why; programs get the state with its quality."""
    heard = arm(**more)
    listed = shown_arm(heard, {}, NOW_UNIX_S)
    assert (heard.shown.age, listed["pill"], listed["age"], listed["grade"]) == (age, "CHECK_FUNCTION", age.value, "unseen")
    assert says in listed["why"]
    assert {*listed["joints"]} == {"CHECK_FUNCTION"}
    if age is Age.OUT_OF_DATE:
        assert on_page(heard, SAYS[0])["health"]["shown"]["pill"] == "CHECK_FUNCTION"
    assert chips(plant_page([heard], [], 0.0, NOW_UNIX_S, NOW_UNIX_S, SAYS[0], ZoneInfo("UTC")).html) == ["Check function"]
    assert statuses(heard, NOW_UNIX_S)[0].level == STALE
    assert readings(heard, NOW_UNIX_S, 86_400.0)["device/hall/cell-1/DeviceHealth"].status.startswith(("Uncertain", "Bad"))
    sick = arm(state="FAILURE", **more)
    assert (sick.shown.pill, sick.grade.value) == (Pill.FAILURE, "sick"), "what was grave then stays so until a replay says otherwise"


def test_nothing_moves_is_never_beside_normal():
    """Before the first verdict, too."""
    for state in (None, "NORMAL"):
        shown = arm([alert_of("stopped", "advisory")], state=state).shown
        assert (shown.pill, shown.alert.condition) == (Pill.CHECK_FUNCTION, "stopped")
    assert arm(state=None).shown.pill is Pill.UNKNOWN


def test_a_person_has_done_one_thing_with_an_alert():
    """Shelved ends by itself; a cleared one asks for nothing."""
    later, before = "2026-11-18T12:00:00Z", "2026-11-18T11:00:00Z"
    for more, done in (
        ({}, Person.WAITS),
        ({"acknowledged_at": before}, Person.ACKNOWLEDGED),
        ({"shelved_until": later}, Person.SHELVED),
        ({"shelved_until": before}, Person.WAITS),
        ({"acknowledged_at": before, "shelved_until": later}, Person.SHELVED),
    ):
        (alert,) = arm([alert_of("wear_rising", "wear", **more)]).alerts
        assert person(alert, NOW_UNIX_S) is done
        assert person(alert.model_copy(update={"active": False}), NOW_UNIX_S) is Person.CLEARED


def test_the_scripts_have_the_same_words_and_colours():
    """The table of the pages is that of the module, and each pill has a colour."""
    static = Path("monitor/views/web/static")
    table = dict(re.findall(r'(\w+): \["[^"]+", N_\("([^"]+)"\)\]', (static / "elements.js").read_text("utf-8")))
    assert table == {str(pill.value or "null"): word for pill, word in WORDS.items()}
    styled = re.findall(r'\[data-state="(\w+)"\] \{ --c', (static / "page.css").read_text("utf-8"))
    assert set(styled) == set(table)
    assert {chip(pill, SAYS[0]) for pill in Pill} == {chip(pill, SAYS[0]) for pill in WORDS}
