"""The languages of page and report: every text and every sentence of a code is translated, and said in the reader's language."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from heard_documents import ALERT, FRICTION

from monitor.errors import BadInput
from monitor.judge.alerts.conditions import CAUSES, CONDITIONS, FRICTION_CHANGED, NOTHING_MOVES
from monitor.judge.alerts.states import ALERT_ACTIVE_BY, IN_PERIOD, OF_JOINT, stale_reason
from monitor.publish.documents import Alert, Friction
from monitor.reason import SENTENCES, Reason, reason_from, reason_of, together, with_reasons
from monitor.store.history.ledger import Kind
from monitor.store.history.motions import STOPPED
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.language.catalogue import ENGLISH, LANGUAGES, best_language, language, utc
from monitor.views.web.settings import PageSettings

ROOT = Path(__file__).parents[2]
OTHERS = [code for code in LANGUAGES if code != "en"]
NOVEMBER, DAY_S = 1_794_787_200.0, 86_400.0  # 2026-11-16


@pytest.mark.parametrize("code", OTHERS)
def test_a_translation_has_the_places_of_its_text(code):
    """A figure that is said in English is said in every language, and no other."""
    catalogue, sentences_of = language(code).catalogue, language(code).sentences
    assert len(catalogue) > 300
    assert len(sentences_of) > 300
    pairs = [*catalogue.items(), *((SENTENCES[one], said) for one, said in sentences_of.items() if one in SENTENCES)]
    place = re.compile(r"\{(\w+)")
    assert [text for text, said in pairs if set(place.findall(text)) != set(place.findall(said))] == []


def test_every_text_is_translated_and_compiled():
    """The catalogues have each text that Python, scripts and pages say, none without a translation; the compiled form is of these.

    In a process of its own: a test may have made sentences that no user meets."""
    pytest.importorskip("babel", reason="Babel is not installed: texts are not gathered anew")
    checked = subprocess.run([sys.executable, ROOT / "docs" / "site" / "texts.py", "--check"], capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stdout) == (0, ""), f"run: make texts\n{checked.stdout}{checked.stderr}"


@pytest.mark.parametrize("code", OTHERS)
def test_every_advice_of_an_alert_is_translated(code):
    """A new condition needs its advice in each language: run `make texts`, and translate it."""
    advice = {condition.action(tier).code for condition in CONDITIONS.values() for tier in condition.tiers}
    assert advice <= set(language(code).sentences)
    assert set(CONDITIONS) <= set(language(code).catalogue)


@pytest.mark.parametrize("code", OTHERS)
def test_every_kind_of_a_window_is_translated(code):
    assert set(get_args(Kind)) <= set(language(code).catalogue)


RISE = FRICTION_CHANGED(
    **{"joint": 3, "speed_rad_s": 0.4, "temperature_c": 30.6, "before_nm": 11.76, "now_nm": 14.29, "change": 0.216, "std": 0.017},
    slope=0.0043,
)


@pytest.mark.parametrize(
    ("reason", "english", "german"),
    [
        (
            together(RISE, CAUSES(whole=0.214, temperature=-0.006, payload=0.0, wear=0.216, rest=0.004)),
            "Elbow (joint 3): friction at 0.4 rad/s and 30.6 °C went from 11.76 to 14.29 N·m (+21.6% ± 1.7%), temperature taken out "
            "(it falls by 0.43%/K). Of the measured +21.4%, temperature makes -0.6%, payload and context +0.0%, "
            "wear +21.6%, chance +0.4%.",
            "Ellbogen (Gelenk 3): Die Reibung bei 0,4 rad/s und 30,6 °C ging von 11,76 auf 14,29 N·m (+21,6 % ± 1,7 %), Temperatur "
            "herausgerechnet (sie fällt um 0,43 %/K). Von den gemessenen +21,4 % kommen -0,6 % "
            "von der Temperatur, +0,0 % von Last und Umfeld, +21,6 % vom Verschleiß, +0,4 % vom Zufall.",
        ),
        (
            OF_JOINT(joint=3, why=ALERT_ACTIVE_BY(condition="wear_rising", tier="wear", change=0.216)),
            "Elbow (joint 3): wear rising (wear): +21.6%",
            "Ellbogen (Gelenk 3): zunehmender Verschleiß (Verschleiß): +21,6 %",
        ),
        (
            NOTHING_MOVES(since_unix_s=NOVEMBER, why=STOPPED(replay=7, cause="protective_stop", reason="safety mode 3")),
            "Nothing moves since 2026-11-16 00:00 UTC: replay 7 was ended by protective_stop: safety mode 3. It waits for a person.",
            "Seit 16.11.2026, 00:00 UTC bewegt sich nichts: Prüffahrt 7 wurde beendet durch Schutzstopp: safety mode 3. Es wartet auf "
            "einen Menschen.",
        ),
        (reason_of("the words of another program at 1.5 rad"), "the words of another program at 1.5 rad", None),
        (Reason("code_of_a_later_version", {}, "a later sentence"), "a later sentence", None),
    ],
)
def test_a_reason_is_said_in_german(reason, english, german):
    """Joint names, figures and dates are German too; what nobody knows stays English, also after the reason was a document."""
    for each in (reason, reason_from(json.loads(json.dumps(reason.document())))):
        assert ENGLISH.say(each) == english
        assert language("de").say(each).replace("\u00a0", " ") == (german or english)


def test_a_document_is_said_with_every_reason_in_it():
    """One object that is a reason, sentences under keys of their own, and both in lists; what a person wrote stays."""
    stale = stale_reason([3], 6, IN_PERIOD)
    document = {
        "by": "May",
        "state": "skipped",
        "acknowledged_why": "no temperature",
        "rows": [with_reasons({}, why=stale), stale.document()],
    }
    said = language("de").document(json.loads(json.dumps(document)))
    assert {name: said[name] for name in ("by", "state", "acknowledged_why")} == {
        name: document[name] for name in ("by", "state", "acknowledged_why")
    }
    german = "VERALTET: Ellbogen: in diesem Zeitraum wurde nichts gelernt: der Zustand ist von damals, nicht von jetzt"
    assert [said["rows"][0]["why"], said["rows"][1]["text"]] == [german, german]


@pytest.mark.parametrize(
    ("accepted", "setting", "code"),
    [
        ("de-AT,de;q=0.9,en;q=0.8", "browser", "de"),
        ("en-GB,de;q=0.3", "browser", "en"),
        ("fr,de;q=0.5", "browser", "de"),
        ("en;q=0.1, de;q=0.9", "browser", "de"),
        ("de;q=0, fr", "browser", "en"),
        ("", "browser", "en"),
        ("x;q=nonsense, ;;,,", "browser", "en"),
        ("en", "de", "de"),
    ],
)
def test_the_language_is_that_of_the_setting_else_of_the_browser(accepted, setting, code):
    """The header has an order by quality and by place; without a known language the page is English."""
    assert best_language(accepted, setting) == code


def test_an_unknown_language_is_refused_by_the_settings():
    """The message names the key and what would be right."""
    with pytest.raises(BadInput, match="language = 'xx'; expected browser, en, de"):
        PageSettings(language="xx")


def life(p10, p50, p90, verdict="trend"):
    left = {"trend_probability": 0.9, "p10_days": p10, "p50_days": p50, "p90_days": p90, "verdict": verdict}
    return Friction.model_validate({**FRICTION, "joint": 3, "remaining_life": left})


def alert_of(**more):
    return Alert.model_validate({**ALERT, "change": 0.09, "text": "", "action": "Plan.", **more})


@pytest.mark.parametrize(
    ("friction", "tier", "pace", "due"),
    [
        (
            life(140, 190, 270),
            "wear",
            "At this pace it meets its limit in late May 2027 (April to August).",
            "Inspect by 5 April 2027.",
        ),
        (
            life(10, 14, 20),
            "wear",
            "At this pace it meets its limit around 30 November (26 November to 6 December).",
            "Inspect by 26 November.",
        ),
        (life(1, 2, 3), "wear", "At this pace it meets its limit around 18 November (17 November to 19 November).", "Inspect now."),
        (life(0, 0, 0, "reached"), "wear", "It has met its limit.", "Inspect now."),
        (life(None, None, None, "no_trend"), "wear", "It shows no steady pace, so nobody can say when it meets its limit.", "Plan."),
        (life(200, 400, None), "advisory", "At this pace it meets its limit in late December 2027 (June or later).", "Plan."),
        (life(1000, 3000, 9000), "advisory", "At this pace it does not meet its limit before 2030.", "Plan."),
    ],
)
def test_an_alert_leads_with_what_when_and_by_when(friction, tier, pace, due):
    """Days where the date is near, parts of a month where it is far; nothing is claimed that the interval does not hold."""
    past = JointPast(friction, NOVEMBER - 365 * DAY_S, NOVEMBER)
    told = sentences(alert_of(tier=tier), past, NOVEMBER, ENGLISH)
    assert told.headline == "Elbow turns 9\u00a0% heavier than in November 2025."
    assert (told.pace, told.due) == (pace, due)
    german = sentences(alert_of(tier=tier), past, NOVEMBER, language("de"))
    assert german.headline == "Ellbogen dreht 9\u00a0% schwerer als im November 2025."
    assert not re.search(r"\b(the|at|in|by|it|May|to)\b", german.pace.replace(" in ", " "))


def test_a_rise_counts_from_the_lowest_friction_held():
    """After grease that took, the comparison is with the day on which friction was lowest."""
    alert = alert_of(lowest_at="2026-10-30T12:00:00Z")
    assert sentences(alert, JointPast(), NOVEMBER, ENGLISH).headline == "Elbow turns 9\u00a0% heavier than on 30 October."
    assert sentences(alert_of(), JointPast(), NOVEMBER, ENGLISH).headline == "Elbow turns 9\u00a0% heavier than at the beginning."


def test_every_condition_has_a_headline_in_every_language():
    """For joint and arm, risen and fallen: a sentence that ends as one, and no name with underscores."""
    for code in LANGUAGES:
        for name, condition in CONDITIONS.items():
            for joint in [3] * (condition.joint is not None) + [None] * (condition.joint is None or condition.arm is not None):
                tier = next(iter(condition.tiers))
                alert = alert_of(joint=joint, condition=name, tier=tier, text="Something is so. More.", change=-0.06)
                headline = sentences(alert, JointPast(), NOVEMBER, language(code)).headline
                assert headline.endswith(".")
                assert "_" not in headline
                assert code == "en" or headline != sentences(alert, JointPast(), NOVEMBER, ENGLISH).headline, name
    assert utc(NOVEMBER).month == 11
