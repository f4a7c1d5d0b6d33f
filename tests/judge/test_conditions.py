"""One record is enough for a further alert condition: rules, schema, texts, page and documentation read it."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import Arm, History

from monitor.judge.alerts.condition import AlertCondition, AlertTier, Headlines, Rule, repeated
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.alerts.health import OFF_SPEC, STATES, TIERS, alert_document, health_from_document
from monitor.judge.alerts.life_cycle import acknowledge
from monitor.reason import Sentence

# Everything that a developer writes for a further condition: one record. In the program it stands in `CONDITIONS`.
OVERHEATED = AlertCondition(
    name="overheated",
    headlines=Headlines(joint="{joint:name} is too hot."),
    joint=repeated(
        lambda situation: situation.belief.temperature_c[situation.j] > 70.0,
        Sentence("hot_joint", "{joint:joint} is hotter than 70 °C, in {replays} replays in a row."),
    ),
    tiers={"advisory": AlertTier(OFF_SPEC, "Let the arm cool down.", "a joint is hotter than 70 °C in three replays in a row")},
)


@pytest.fixture
def overheated(monkeypatch):
    """The condition, registered until the test ends."""
    monkeypatch.setitem(CONDITIONS, OVERHEATED.name, OVERHEATED)


def lived(temperatures_c) -> History:
    """One replay a day in which joint 2 has these temperatures and the others 30 °C."""
    history, arm = History(), Arm(seed=1)
    for day, temperature_c in enumerate(temperatures_c):
        history.add(day, arm.replay(np.array([30.0, temperature_c, 30.0, 30.0, 30.0, 30.0])))
    return history


def test_a_registered_condition_is_raised_acknowledged_and_cleared(overheated):
    """Three hot replays raise it with its text, advice and state; acknowledged, it clears after the first replay that is not hot."""
    history = lived([75.0] * 3)
    assert history.transitions == [(2, "raised", 2, "overheated", "advisory")]
    [alert] = history.health.active_alerts
    assert alert.text.text == "Shoulder (joint 2) is hotter than 70 °C, in 3 replays in a row."
    assert (alert.action.text, alert.severity) == ("Let the arm cool down.", "low")
    assert (history.health.state, history.health.joints[1].state) == (OFF_SPEC, OFF_SPEC)
    assert history.health.joints[1].why.text == "overheated (advisory)"

    history.health = acknowledge(history.health, 2, "overheated", by="Ada", why="seen", at_unix_s=alert.raised_at_unix_s + 60.0)
    history.add(3, Arm(seed=2).replay(30.0))
    assert history.transitions[1:] == [(3, "cleared", 2, "overheated", "advisory")]
    assert history.health.active_alerts == ()
    assert history.health.state == "NORMAL"


@pytest.mark.parametrize(("new_c", "raised"), [([60.0] * 5, []), ([40.0, 50.0, 60.0], [(14, "raised", 2, "outside_range", "advisory")])])
def test_a_new_temperature_that_stays_is_learnt_and_raises_nothing(new_c, raised):
    """After 12 replays at 30 °C: each replay widens the learnt range, so only temperatures that go on growing raise the alert."""
    assert lived([30.0] * 12 + new_c).transitions == raised


def test_a_registered_condition_travels_and_survives(overheated):
    """Its alert fits the schema of the bus, its confirmations come back from the history, and a release without it still reads both."""
    from monitor.publish.documents import Alert
    from monitor.publish.timestamps import outside

    health = lived([75.0] * 3).health
    [alert] = health.active_alerts
    published = Alert.model_validate(outside(alert_document(alert)))
    assert (published.condition, published.text, published.action) == (alert.condition, alert.text.text, alert.action.text)
    stored = json.loads(json.dumps(health.as_document()))
    back = health_from_document(stored)
    assert back == health
    assert dict(back.joints[1].confirmations)["overheated"].replays == 3


def test_an_alert_of_a_condition_that_this_release_does_not_know_is_to_be_checked(monkeypatch):
    """Another release raised it: the alert stays active, and its joint's state is CHECK_FUNCTION."""
    with monkeypatch.context() as registered:
        registered.setitem(CONDITIONS, OVERHEATED.name, OVERHEATED)
        history = lived([75.0] * 3)
    history.add(3, Arm(seed=2).replay(30.0))
    assert [alert.condition for alert in history.health.active_alerts] == ["overheated"]
    assert history.health.joints[1].state == "CHECK_FUNCTION"


def test_a_registered_condition_is_on_the_page_and_in_the_documentation(overheated, tmp_path):
    """The page's facts name it, the documentation's table its meaning and its advice."""
    import importlib.util
    from pathlib import Path

    from monitor.config.load import from_document
    from monitor.service.page import about

    configuration = from_document({"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}}, tmp_path / "cell.toml")
    assert about(configuration)["conditions"]["overheated"] == {"probability_of": None}
    spec = importlib.util.spec_from_file_location("docs_reference", Path(__file__).parents[2] / "docs" / "site" / "reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    row = "| `overheated` | advisory | Let the arm cool down. | a joint is hotter than 70 °C in three replays in a row | `OFF_SPEC` |"
    assert row in reference.alerts_page().splitlines()


@pytest.mark.parametrize("condition", CONDITIONS.values(), ids=CONDITIONS)
def test_every_record_is_complete(condition):
    """Known tiers in ascending order, known states, texts that are sentences; what the rules count is raised as an advisory."""
    tiers = list(condition.tiers)
    assert tiers == sorted(tiers, key=TIERS.index)
    for tier in condition.tiers.values():
        assert tier.state in STATES
        assert tier.advice.endswith(".")
        assert tier.meaning
    for rule in (condition.joint, condition.arm):
        if rule is not None and rule.shows is not None:
            assert tiers == ["advisory"]


@pytest.mark.parametrize(
    ("record", "says"),
    [
        ({"name": ""}, "name is empty"),
        ({"tiers": ("grave",)}, "unknown tiers ['grave']; expected some of advisory, wear, limit"),
        ({"tiers": ("wear", "advisory")}, "tiers in the order wear, advisory; expected the order advisory, wear, limit"),
        ({"tiers": ("wear",)}, "raises advisory, which its tiers ['wear'] do not have"),
        ({"tiers": ("advisory", "wear"), "joint": Rule(lambda *_: None, raises=TIERS)}, "raises limit, which its tiers"),
        ({"tiers": (), "joint": None}, "raises advisory, which its tiers [] do not have"),
    ],
)
def test_a_record_whose_first_alert_would_fail_is_refused_when_it_is_made(record, says):
    """The message names the condition and what is wrong."""
    tier = OVERHEATED.tiers["advisory"]
    change = {**record, **({"tiers": dict.fromkeys(record["tiers"], tier)} if "tiers" in record else {})}
    with pytest.raises(ValueError, match=re.escape(says)):
        replace(OVERHEATED, **change)
