"""The performance card: its rows, its marks and its explanations; and commands of the evidence that cannot be played."""

import importlib
import json
from functools import cache

import pytest

from evidence.card import END, card, notes, with_worlds
from evidence.worlds_card import WORLDS_HEAD, arms_of, worlds_section
from monitor.judge.alerts.remaining_life import RemainingLife
from monitor.judge.settings import AssessSettings
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.play import COMPARABLE, play
from monitor.studies.rehearsal.rehearse import Covered, LifeAnswer, Reported, delay, detection_row, life_documents, onsets
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import play_world

ASSESS = AssessSettings()


@cache
def judged(name):
    """A document of six healthy arms, and of three with each kind of wear."""
    return json.loads(json.dumps(play_world(WORLDS[name], ASSESS, arms=6, days=480, seed=2), allow_nan=False))


def said(days):
    """A prediction whose P10 and P90 are ten per cent off its P50; None: no date."""
    return RemainingLife(1.0, None if days is None else 0.9 * days, days, None if days is None else 1.1 * days, "trend")


@pytest.mark.soak
def test_the_card_has_a_row_a_world_with_its_goals():
    """With what is not counted in a world told beside it, and remaining life in a table of its own."""
    plain = judged("plain")
    kinds = {
        "kinds": ["rising", "falling"],
        **{key: plain["false_advisories"]["counted"][key] for key in ("events", "per_year", "at_most")},
    }
    told = {**plain, "world": "told", "false_advisories": {**plain["false_advisories"], "counted": kinds}}
    life = [{**row, "remaining_life": life_documents([LifeAnswer(0, 0.5, said(100.0), 100.0)])} for row in plain["detection"]]
    observer = [{**row, "false_per_year": rate, "median_days": 9.0} for row in plain["detection"] for rate in (0.07, 0.1)]
    documents = [plain, told, {**plain, "world": "lives", "detection": life}]
    text = worlds_section(documents, arms=64, seed=7, noise_known={"plain": observer})
    assert len([line for line in text.splitlines() if line.startswith("| plain | ") and line.count(" | 9 (≥ ") == 2]) == 2
    text = worlds_section(documents, arms=64, seed=7)
    assert "not to know the noise" not in text
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert all(line.count("|") == 8 for line in rows)
    assert "told: common in" in rows[2]
    assert "asked ≤ 11 " in rows[1]
    assert sum("P50 within" in line or "5 % step | 50 %" in line for line in rows) == 2
    assert "from seed 7" in text
    assert "- 64 healthy arms live three years, 16 from " in text


@pytest.mark.parametrize(
    ("low", "median", "high", "mark"),
    [(8, 10, 11, "✓"), (8, 11, 13, "(✓)"), (11, 12, 13, "(✗)"), (12, 13, 14, "✗ not reached"), (9, None, None, "(✗)")],
)
def test_a_median_is_marked_by_its_bounds(low, median, high, mark):
    """What chance alone may have missed is marked apart from what is not reached; never is later than any day."""
    plain = judged("plain")
    step = {**plain["detection"][0], "median_at_least_days": low, "median_days": median, "median_at_most_days": high}
    text = worlds_section([{**plain, "detection": [step]}], arms=64, seed=7)
    shown = "never" if high is None else high
    assert f"≤ {shown}; asked ≤ 11 {mark}), " in text


def test_the_worlds_alone_are_written_anew():
    """What stands above and below their section stays; a page without the section gets it."""
    page = f"# Figures\n\nold\n{END}rest"
    first = with_worlds(page, f"{WORLDS_HEAD}one\n")
    assert first == f"# Figures\n\nold\n{WORLDS_HEAD}one\n{END}rest"
    assert with_worlds(first, f"{WORLDS_HEAD}two\n") == first.replace("one", "two")


def test_every_world_of_the_card_has_arms():
    """Fewer where nobody set a goal beforehand."""
    assert arms_of("slow-joint", 64) == (64, 24)
    assert arms_of("plain", 64)[0] > 64 > arms_of("weekdays", 64)[0] >= 12
    assert arms_of("plain", 64)[1] > arms_of("slow-joint", 64)[1]  # a median that lies near what is asked for


def test_the_card_marks_what_was_not_reached():
    """It contains every figure, and marks one beyond its limit."""
    share = {"hits": 10.0, "of": 10.0}
    wear = onsets(12, 1, step=0.05, latest=70)
    delays = delay(Reported.of(play(FleetSettings(arms=12, days=80, seed=3, scenarios=COMPARABLE), ASSESS, wear), wear))
    rows = [detection_row(name, 0.05, 0.1, delays, Covered(0.9, 0.9)) for name in ("5 % step", "10 %/year")]
    document = {
        "robot_years": 100.0,
        "learning_days": 60,
        "between_std": 0.02,
        "autocorrelation": 0.5,
        "false_alarms": {"all": {"events": 30, "robot_years": 100.0, "per_year": 0.3, "at_most": 0.41}},
        "false_wear_alerts": 1,
        "while_learning": {"events": 2, "robot_years": 16.4, "per_year": 0.122, "at_most": 0.38},
        "friction_interval_90": {"value": 0.9, "at_least": 0.898, "at_most": 0.902},
        "slope_left_per_k": {"value": 0.0002, "at_least": 0.00018, "at_most": 0.00022, "nine_of_ten": 0.0005},
        "detection": rows,
        "remaining_life": {
            "p10_p90_holds": {**share, "share": 1.0, "at_least": 0.74, "at_most": 1.0},
            "alpha_lambda_at_half_life": {**share, "share": 1.0, "at_least": 0.74},
            "by_path": [
                {
                    "path": "exponential",
                    "at_share_of_life": 0.75,
                    "asked": 12,
                    "without_date": 2,
                    "p10_p90_holds": {**share, "share": 1.0, "at_least": 0.74, "at_most": 1.0},
                    "p50_over_truth": 1.2,
                }
            ],
        },
    }
    torque = {
        "arms": 5,
        "ratio": {"value": 0.32, "at_least": 0.3, "at_most": 0.34},
        "ratio_by_joint": [0.3, 0.6],
        "ratio_of_worst_arm": 0.43,
        "ratio_of_friction": {"value": 0.1, "at_least": 0.09, "at_most": 0.11},
        "slope_per_k": {"value": 0.0004, "at_least": 0.0003, "at_most": 0.0005, "nine_of_ten": 0.0009},
        "covered_90_by_joint": [0.95, 0.93],
        "covered_90": {"value": 0.94, "at_least": 0.93, "at_most": 0.96},
        "range_c": [8.0, 37.0],
        "replays": 40,
        "assess_s": 0.2,
    }
    physics = {"replays": 200, "std": [0.003, 0.008], "surrogate_std": 0.0056, "distance": 0.1, "p": 0.004, "slope_per_k": 0.0002}
    text = card(document, [{"between_std": 0.01, **rows[0]}], torque, physics, seed=1, arm_days_a_minute=1e5)
    assert "| 100.0 % (≥ 74.1 %, ≤ 100.0 %) | 75–88 % ✗ not reached |" in text
    assert "exponential path, at 75 % of life (2 of 12 have no date) | 100.0 % (≥ 74.1 %, ≤ 100.0 %) | 75–88 % ✗ not reached |" in text
    assert "| median of P50 over the truth, the same | 1.20 | 0.7–1.4 ✓ |" in text
    low, high, early = delays.by_baseline[0]
    assert f"{low}–{high - 1} days {early.hits} of {early.of}" in text
    assert "by joint 0.30, 0.60, worst arm 0.43 | 0.320 (≤ 0.340) | ≤ 0.33 ✗ not reached |" in text
    assert "94.0 % (≥ 93.0 %, ≤ 96.0 %) | 85–95 % ✗ not reached |" in text
    assert "200 replays of the full physics" in text
    assert "0.30 to 0.80 %" in text
    assert "0.020 %/K, ≤ 0.1 is asked) ✗ not reached" in text
    assert "there were 2 more (0.122 a robot-year" in text
    assert "| all | 100 | 30 | 0.300 | 0.410 | ≤ 0.1 ✗ not reached |" in text
    assert "90.0 % (≥ 89.8 %, ≤ 90.2 %) | 85–95 % ✓" in text
    assert "0.020 %/K (≤ 0.022) | ≤ 0.1 %/K ✓" in text


def test_the_card_explains_what_was_not_reached_and_nothing_else():
    """One row that was not reached has one explanation; without one there is no heading."""
    row = "| P10–P90 of remaining life hold the truth | 90 % | 75–85 % {} |\n"
    assert notes(row.format("✓")) == ""
    explanations = notes(row.format("✗ not reached"))
    assert "P10–P90" in explanations
    assert explanations.count("- **") == 1


@pytest.mark.parametrize("module", ["production", "production_observer", "worlds"])
def test_a_study_of_no_arms_is_refused_before_it_begins(module, monkeypatch, capsys):
    """It was a traceback, for plans after minutes."""
    monkeypatch.setattr("sys.argv", ["study", *(("plain", "--arms") if module == "worlds" else ("--slow",)), "0"])
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(f"evidence.{module}").main()
    assert ended.value.code == 2
    assert "0: expected a whole number from 1 on" in capsys.readouterr().err
