"""The languages of page and report: every text is translated, and stored English sentences are said in the reader's language."""

import importlib.util
import re
import time
from pathlib import Path

import pytest

from monitor.errors import BadInput
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.language.catalogue import ENGLISH, LANGUAGES, best_language, language
from monitor.views.language.dates import utc
from monitor.views.web.settings import PageSettings

ROOT = Path(__file__).parents[2]
OTHERS = [code for code in LANGUAGES if code != "en"]
NOVEMBER, DAY_S = 1_794_787_200.0, 86_400.0  # 2026-11-16
ALERT = {"joint": 3, "condition": "wear_rising", "tier": "wear", "active": True, "change": 0.09, "text": "", "action": "Plan."}


@pytest.mark.parametrize("code", OTHERS)
def test_a_translation_has_the_places_of_its_text(code):
    """A figure that is said in English is said in every language, and no other."""
    catalogue = language(code).catalogue
    assert len(catalogue) > 300
    wrong = [text for text, said in catalogue.items() if set(re.findall(r"\{\w+\}", text)) != set(re.findall(r"\{\w+\}", said))]
    assert not wrong


@pytest.mark.parametrize("code", OTHERS)
def test_every_text_is_translated_and_compiled(code):
    """The catalogue has each text that Python, scripts and pages say, none without a translation; the compiled form is of these."""
    pytest.importorskip("babel", reason="Babel is not installed: texts are not gathered anew")
    spec = importlib.util.spec_from_file_location("texts", ROOT / "docs" / "site" / "texts.py")
    texts = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(texts)
    stored = {message.id: message.string for message in texts.read(code) if message.id}
    assert {message.id for message in texts.template() if message.id} == set(stored), "run: make texts"
    assert [text for text, said in stored.items() if not said] == []
    assert language(code).catalogue == stored, "run: make texts"


@pytest.mark.parametrize("code", OTHERS)
def test_every_advice_of_an_alert_is_translated(code):
    """A new condition needs its advice in each language: run `make texts`, and translate it."""
    advice = {tier.advice for condition in CONDITIONS.values() for tier in condition.tiers.values()}
    assert advice <= set(language(code).catalogue)
    assert set(CONDITIONS) <= set(language(code).catalogue)


@pytest.mark.parametrize(
    ("english", "german"),
    [
        (
            "Elbow (joint 3): friction at 0.4 rad/s and 30.6 °C went from 11.76 to 14.29 N·m (+21.6% ± 1.7%), temperature taken out "
            "(0.43%/K); 17 replays on 17 days in a row agree. Of the measured +21.4%, temperature makes -0.6%, payload and context +0.0%, "
            "wear +21.6%, chance +0.4%.",
            "Ellbogen (Gelenk 3): Die Reibung bei 0,4 rad/s und 30,6 °C ging von 11,76 auf 14,29 N·m (+21,6 % ± 1,7 %), Temperatur "
            "herausgerechnet (0,43 %/K); 17 Prüffahrten an 17 Tagen nacheinander stimmen überein. Von den gemessenen +21,4 % kommen -0,6 % "
            "von der Temperatur, +0,0 % von Last und Umfeld, +21,6 % vom Verschleiß, +0,4 % vom Zufall.",
        ),
        ("Elbow (joint 3): wear_rising (wear): +21.6%", "Ellbogen (Gelenk 3): zunehmender Verschleiß (Verschleiß): +21,6 %"),
        (
            "Nothing moves since 2026-11-20T10:00:00Z: replay 7 was ended by protective_stop: safety mode 3. It waits for a person.",
            "Seit 20.11.2026, 10:00 bewegt sich nichts: Prüffahrt 7 wurde beendet durch Schutzstopp: safety mode 3. Es wartet auf "
            "einen Menschen.",
        ),
        (
            "payload: the controller reckons with 0.900 kg, the configuration says 1.000 kg; at most 0.05 kg apart",
            "Last: die Steuerung rechnet mit 0,900 kg, die Konfiguration sagt 1,000 kg; höchstens 0,05 kg Unterschied",
        ),
        ("What is known of Elbow (joint 3) is what it was before the work was declared; 3 replays since then were judged once more.",
         "Von Ellbogen (Gelenk 3) ist wieder bekannt, was vor der Eintragung der Arbeit bekannt war; 3 Prüffahrten seither wurden noch "
         "einmal ausgewertet."),
        ("at '2030-01-01': that is yet to come; declare work when it is done",
         "am '01.01.2030': das liegt in der Zukunft; Arbeit eintragen, wenn sie getan ist"),
        ("127.0.0.1: RTDE answers but sends no data", "127.0.0.1: RTDE antwortet, sendet aber keine Daten"),
        ("no permission: the cell's door is open", "keine Freigabe: the cell's door is open"),  # the words of another program stay
        ("approach_near: Wrist 3 (joint 6) is 2.60 rad from the start of the excitation; at most 1.5",
         "Arm zu weit vom Start: Handgelenk 3 (Gelenk 6) ist 2,60 rad vom Start der Prüffahrt entfernt; höchstens 1,5"),
        ("a sentence of a later version at 1.5 rad on 2026-06-30", "a sentence of a later version at 1,5 rad on 30.06.2026"),
    ],
)  # fmt: skip
def test_a_stored_sentence_is_said_in_german(english, german):
    """Joint names, figures and dates are German too; what nobody knows stays English, and English stays as it is."""
    assert language("de").retell(english).replace("\u00a0", " ") == german
    assert ENGLISH.retell(english) == english


def test_a_long_text_of_another_program_is_no_burden():
    """A reason of many thousand letters is passed on at once."""
    began = time.process_time()
    for text in ("x: " * 20_000, "joint is at " * 5_000, "W " * 10_000):
        assert language("de").retell(text).strip() == text.strip()
    assert time.process_time() - began < 2.0


def test_what_a_person_wrote_is_never_translated():
    """A reason of a person that happens to be a known text stays; so do names, and texts under other keys."""
    document = {"text": "no permission", "acknowledged_why": "no permission", "by": "May", "state": "skipped", "rows": [{"why": "missed"}]}
    assert language("de").document(document) == document | {"text": "keine Freigabe", "rows": [{"why": "versäumt"}]}


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
    return {"remaining_life": {"p10_days": p10, "p50_days": p50, "p90_days": p90, "verdict": verdict}}


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
    told = sentences(ALERT | {"tier": tier}, past, NOVEMBER, ENGLISH)
    assert told.headline == "Elbow turns 9\u00a0% heavier than in November 2025."
    assert (told.pace, told.due) == (pace, due)
    german = sentences(ALERT | {"tier": tier}, past, NOVEMBER, language("de"))
    assert german.headline == "Ellbogen dreht 9\u00a0% schwerer als im November 2025."
    assert not re.search(r"\b(the|at|in|by|it|May|to)\b", german.pace.replace(" in ", " "))


def test_a_rise_counts_from_the_lowest_friction_that_its_text_names():
    """After grease that took, the comparison is with the day that the text names."""
    alert = ALERT | {"text": "… above the lowest level held, -8.0% from the beginning, reached by 2026-10-30), …"}
    assert sentences(alert, JointPast(), NOVEMBER, ENGLISH).headline == "Elbow turns 9\u00a0% heavier than on 30 October."
    assert sentences(ALERT, JointPast(), NOVEMBER, ENGLISH).headline == "Elbow turns 9\u00a0% heavier than at the beginning."


def test_every_condition_has_a_headline_in_every_language():
    """For joint and arm, risen and fallen: a sentence that ends as one, and no name with underscores."""
    for code in LANGUAGES:
        for name, condition in CONDITIONS.items():
            for joint in [3] * (condition.joint is not None) + [None] * (condition.joint is None or condition.arm is not None):
                tier = next(iter(condition.tiers))
                alert = ALERT | {"joint": joint, "condition": name, "tier": tier, "text": "Something is so. More.", "change": -0.06}
                headline = sentences(alert, JointPast(), NOVEMBER, language(code)).headline
                assert headline.endswith(".")
                assert "_" not in headline
                assert code == "en" or headline != sentences(alert, JointPast(), NOVEMBER, ENGLISH).headline, name
    assert utc(NOVEMBER).month == 11
