"""The simulated plant speaks as monitors do: its documents are those of the registry, and a seed is a life."""

import threading

import jsonschema
import orjson
import pytest
from simulated import BEGIN_UNIX_S
from test_backup import Answers

from monitor.errors import BadInput
from monitor.publish.documents import Answer, Event, Events, Health, History
from monitor.publish.registry import schema
from monitor.studies.plant import Lives, SimulatedPlant


@pytest.fixture(scope="module")
def lives():
    made = Lives(12, 1, BEGIN_UNIX_S)
    made.live(130)
    return made


def test_its_documents_are_those_of_monitors(lives):
    """Every arm's answers, read by the types of the bus; some joints wear, and alerts come and go."""
    arms = Answers(lives)
    arms.names, arms._began_unix_s, arms._now = [("lab", f"arm-{k}") for k in range(12)], BEGIN_UNIX_S, lambda: BEGIN_UNIX_S
    arms.settings = SimulatedPlant(arms=12, connect=("tcp/127.0.0.1:1",))
    for arm in range(12):
        for kind, document in (("monitor", arms.monitor(arm)), ("info", arms.info(arm)), ("health", arms.health(arm))):
            jsonschema.validate(document, schema(kind))
        health = Health.model_validate(arms.health(arm))
        events = Events.model_validate(arms._events(arm, {"after": "0", "limit": "1000"}))
        raised = [event.joint for event in events.events if event.kind == "raised"]
        assert sum(event.kind == "cleared" for event in events.events) == len(raised) - len(health.alerts)
        history = History.model_validate(arms._history(arm, {"changed_after": "0", "limit": "60"}))
        assert [change.seq for change in history.changes] == list(range(1, 11))
        assert history.next == 10
        assert len(history.changes[0].rows) == 6
    assert sum(map(len, lives.transitions)) > 0


def test_the_same_seed_lives_the_same_life(lives):
    """Another seed another one."""
    again = Lives(12, 1, BEGIN_UNIX_S)
    again.live(20)
    assert [again.change(3, seq) for seq in range(1, 15)] == [lives.change(3, seq) for seq in range(1, 15)]
    other = Lives(30, 2, BEGIN_UNIX_S)
    other.live(2)
    assert other.change(3, 1) != again.change(3, 1)


def test_a_plant_without_arms_or_bus_is_refused():
    """With what would be right."""
    for wrong in ({"arms": 0}, {"speed": -1.0}, {}):
        with pytest.raises(BadInput, match="expected"):
            SimulatedPlant(**({"connect": ("tcp/a:1",)} if wrong else {}) | wrong)


def test_its_alerts_are_acknowledged_and_shelved_and_nothing_else_is_done(lives):
    """As a monitor answers: the alert, its health and a transition with the person's name; what arms do is refused."""
    arms, said = Answers(lives), []
    arms.names, arms._now, arms._lock = [("lab", f"arm-{k}") for k in range(12)], lambda: BEGIN_UNIX_S + 131 * 86_400.0, threading.Lock()
    arms.say = lambda arm, key, document: said.append((key, document))
    arm = next(k for k in range(12) if lives.health(k)["alerts"])
    alert = lives.health(arm)["alerts"][0]
    asked = {"joint": alert["joint"], "condition": alert["condition"], "by": "ada", "why": "parts are ordered"}
    for command, more, kind, changed in (
        ("ack", {}, "acknowledged", {"acknowledged_by": "ada"}),
        ("shelve", {"hours": 8.0}, "shelved", {"shelved_until": "2026-05-16T08:00:00Z"}),
        ("unack", {}, "unacknowledged", {"acknowledged_by": None}),
        ("unshelve", {}, "unshelved", {"shelved_until": None}),
    ):
        answer = Answer.model_validate(arms.command(arm, f"cmd/{command}", orjson.dumps(asked | more)))
        assert (answer.done, {name: answer.alert.model_dump(mode="json")[name] for name in changed}) == (kind, changed)
        event = Event.model_validate(said[-1][1])
        assert (event.seq, event.kind, event.by, event.why) == (len(lives.transitions[arm]), kind, "ada", "parts are ordered")
    for command, payload, says in (
        ("replay", b"{}", "it does not move"),
        ("serviced", b"{}", "knows no work"),
        ("ack", b"{}", "cmd/ack: joint: Field required"),
        ("ack", b"[", "is no JSON"),
        ("ack", b"[]", "expected a JSON object"),
        ("ack", orjson.dumps(asked | {"condition": "stopped"}), "no active alert"),
        ("ack", orjson.dumps(asked | {"joint": None}), "no active alert arm/"),
    ):
        with pytest.raises(BadInput, match=says):
            arms.command(arm, f"cmd/{command}", payload)
