"""The report on a period: what was found and what was not monitored, from the history alone, on one page that needs no network."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from lived_monitor import DAY_S, FIRST_UNIX_S, ONSET, PER_DAY, WEARING, configuration, identified, live_through
from typer.testing import CliRunner

from monitor.acquire.ending import CAUSED
from monitor.acquire.safety.of_state import FARTHEST_JOINT
from monitor.cli.main import app
from monitor.errors import DOES_NOT_HOLD, BadInput
from monitor.publish.timestamps import rfc3339
from monitor.reason import reason_of, with_reasons
from monitor.service.history.report import report
from monitor.store.store import Store
from monitor.views.language.catalogue import language
from monitor.views.report.charts import friction_over_time, law_points, single_replay_change
from monitor.views.report.page import report_page
from monitor.views.report.sections import groups

pytestmark = pytest.mark.xdist_group("page")
DAYS = 40
END = FIRST_UNIX_S + DAYS * DAY_S


@pytest.fixture(scope="module")
def lived(tmp_path_factory):
    """Forty days of history: joint 3 wears from day 21 on, two windows were skipped, and a week after the last one was rejected."""
    folder = tmp_path_factory.mktemp("report")
    settings = configuration(folder)
    (folder / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "hall-2"\nid = "cell-1"\npayload_kg = 1.2\ntool = "gripper"\n[store]\ndirectory = "history"\n'
    )
    found, context = identified()
    with Store.open(settings.state_directory) as store:
        context = replace(settings.context, firmware=context.firmware)
        live_through(store, settings.assess, found, context, DAYS)
        ledger = store.ledger.claim(END + 7 * DAY_S, "scheduled", END + 7 * DAY_S)
        store.ledger.end(ledger, "rejected", "torn <rows>", END + 7 * DAY_S)
    return folder, settings


def report_of(lived, begin=None, end=None):
    _, settings = lived
    with Store.reader(settings.state_directory) as store:
        return report(settings, store, begin, end, END + 8 * DAY_S)


@pytest.fixture(scope="module")
def both(lived):
    """The page of two robots: the whole life, with its drawings, which take time, and a period without a verdict."""
    return report_page([report_of(lived), report_of(lived, END + 6 * DAY_S, END + 8 * DAY_S)])


def test_everything_that_happened_is_reported_with_its_evidence(lived):
    """The document has the verdict, the joints, the alert with text and transitions, and the thresholds in force."""
    whole = report_of(lived)
    assert whole["verdict"]["health"]["joints"][2] == "MAINTENANCE_REQUIRED"
    assert [joint["joint"] for joint in whole["joints"]] == [1, 2, 3, 4, 5, 6]
    (alert,) = [alert for alert in whole["alerts"] if alert["condition"] == "wear_rising"]
    assert alert["joint"] == 3
    assert alert["active"]
    assert "chance alone shows as much in a sound joint" in alert["text"]
    assert whole["events"][0]["kind"] == "raised"
    assert whole["thresholds"]["wear_rise"] == 0.05
    assert whole["contexts"][0]["changed"]["tool"] == [None, "gripper"]


def test_every_replay_has_its_own_figure_of_friction_with_its_own_interval(lived):
    """On nine days of ten the truth is within 2σ of the day's own figure, on all within 4σ; the filter's estimate is another."""
    history = report_of(lived)["history"]
    for joint in range(1, 7):
        rows = [row for row in history if row["joint"] == joint]
        day = np.array([row["replay"] - 1 for row in rows])
        truth = 100 * PER_DAY * np.maximum(day - ONSET, 0) * (joint == WEARING)
        alone, std = single_replay_change(rows)
        off = np.abs(alone - truth) / std
        assert np.max(off) < 4.0
        assert np.mean(off < 2.0) >= 0.9
        estimate = np.array([100 * row["wear"] for row in rows])
        # the simulated replays differ by 0.6 %; the estimate smooths that away
        assert np.std(np.diff(alone - truth)) > 1.5 * np.std(np.diff(estimate - truth)) or joint == WEARING


def test_a_history_without_figures_of_single_replays_states_it(lived, both):
    """For a history of an early release the drawing has the line and its band, and the caption says why there is no point."""
    whole = report_of(lived)
    assert "no point" not in both
    for row in whole["history"]:
        del row["replay_torque_nm"], row["replay_torque_std_nm"]
    assert f"Of {len(whole['history'])} of {len(whole['history'])} figures" in report_page([whole])


def test_what_was_not_monitored_is_reported_with_the_reason(lived):
    """The report lists skipped and rejected windows with their reasons, and the days after the last replay as a gap."""
    unwatched = report_of(lived)["unwatched"]
    assert unwatched["windows"] == DAYS + 1
    assert unwatched["assessed"] == DAYS - 2
    assert [row["state"] for row in unwatched["failed"]] == ["skipped", "skipped", "rejected"]
    assert "door" in unwatched["failed"][0]["reason"]
    assert len(unwatched["gaps"]) == 1
    assert unwatched["gaps"][0]["to"] == rfc3339(END + 8 * DAY_S)


def test_a_period_holds_only_what_is_in_it(lived):
    """The weeks before the onset have no alert and no transition, and joint 3 is normal; the end of a period does not belong to it."""
    quiet = report_of(lived, FIRST_UNIX_S, FIRST_UNIX_S + 14 * DAY_S)
    assert not quiet["alerts"]
    assert not quiet["events"]
    assert set(quiet["verdict"]["health"]["joints"]) == {"NORMAL"}
    assert len({row["replay"] for row in quiet["history"]}) == 13  # one of the fourteen windows was skipped
    assert quiet["unwatched"]["windows"] == 14
    with pytest.raises(BadInput, match="nothing was attempted"):
        report_of(lived, FIRST_UNIX_S - 30 * DAY_S, FIRST_UNIX_S - 20 * DAY_S)
    with pytest.raises(BadInput, match="before it begins"):
        report_of(lived, FIRST_UNIX_S, FIRST_UNIX_S - DAY_S)


def test_a_period_without_assessments_states_it(lived):
    """A period with only a rejected window has no verdict and no drawing; the reason is escaped text."""
    text = report_page([report_of(lived, END + 6 * DAY_S, END + 8 * DAY_S)])
    assert "nothing can be said of this arm" in text
    assert "torn &lt;rows&gt;" in text
    assert "<svg" not in text


def test_the_page_needs_no_network_and_holds_what_the_document_holds(both):
    """With two robots the page has both states, the alert's text, the reasons, the limits of the method, and a line to sign."""
    assert not re.search(r"<script|<link|<img|src=", both)
    assert both.count("<svg") == 2
    for part in ("Maintenance required", "Elbow: Wear rising", "door is open", "flexspline", "Reviewed by", "gripper", "Not acknowledged"):
        assert part in both, part
    assert both.count("class=newpage") == 1


def test_friction_over_temperature_is_drawn_as_the_law_that_was_chosen():
    """The law is drawn by its points; a verdict of an early release, which has none, by its straight line."""
    line = {"viscous_nm_s_per_rad": 8.0, "slope_nm_s_per_rad_k": -0.1, "reference_temperature_c": 25.0, "range_c": (15.0, 35.0)}
    assert np.allclose(law_points(line, []), [[15.0, 35.0], [9.0, 7.0], [0.0, 0.0]])
    assert np.allclose(law_points({**line, "range_c": None}, [20.0, 30.0])[1], [8.5, 7.5])
    points = [[15.0, 9.3, 0.1], [25.0, 8.0, 0.05], [35.0, 6.9, 0.1]]
    assert np.allclose(law_points({**line, "viscous_by_temperature": points}, []), np.array(points).T)


@pytest.mark.parametrize("apart_h", [1, 6, 24, 24 * 60])
def test_no_two_marks_along_the_time_of_a_chart_read_alike(lived, apart_h):
    told = report_of(lived)
    rows = [row for row in told["history"] if row["joint"] == 3][:8]
    begin = END + 7 * 3600.0
    again = [row | {"recorded_at": rfc3339(begin + k * 3600 * apart_h)} for k, row in enumerate(rows)]
    panel = friction_over_time({**told, "history": again}, language("en")).axes[2]
    marks = [label.get_text() for label in panel.get_xticklabels()]
    assert len(marks) > 1
    assert len(set(marks)) == len(marks)


def test_the_command_writes_the_page_and_the_document(lived, tmp_path):
    """One command writes both; a mistake gives one sentence."""
    folder, _ = lived
    page = tmp_path / "report.html"
    ran = CliRunner().invoke(
        app, ["report", "-c", str(folder / "cell.toml"), "--from", "2026-06-01", "--to", "2026-07-01", "-o", str(page), "--json"]
    )
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["reports"][0]["robot"]["id"] == "cell-1"
    assert page.read_text("utf-8").startswith("<!doctype html>")
    for arguments, why in (
        (["-c", str(folder / "cell.toml")], "expected -o"),
        (["-c", str(folder / "cell.toml"), "-o", str(tmp_path / "report.pdf")], "ends in .html"),
        (["-c", str(folder / "cell.toml"), "-o", str(page), "--from", "yesterday"], "expected a day"),
        (["-c", str(folder / "absent.toml"), "-o", str(page), "--force"], "cannot be read"),
    ):
        ran = CliRunner().invoke(app, ["report", *arguments])
        assert isinstance(ran.exception, BadInput)
        assert why in str(ran.exception)


def test_a_report_made_long_after_the_last_replay_marks_the_state_as_stale(lived):
    """Eight days after the last replay all six joints are STALE with their times; in a period that ends with the last replay none is."""
    whole = report_of(lived)
    assert [one["joint"] for one in whole["stale"]] == [1, 2, 3, 4, 5, 6]
    assert "STALE: all joints" in report_page([whole | {"history": []}])  # without drawings, which take time
    fresh = report_of(lived, FIRST_UNIX_S, END)
    assert fresh["stale"] == []
    assert "OUT OF DATE" not in report_page([fresh | {"history": []}])


def test_an_alert_is_reported_as_it_was_at_the_end_of_the_period(lived):
    """On the last day of the period friction had risen less and fewer replays agreed than later."""
    early = report_of(lived, FIRST_UNIX_S, FIRST_UNIX_S + 29 * DAY_S)
    (then,), (now,) = early["alerts"], report_of(lived)["alerts"]
    assert then["change"] < 0.5 * now["change"]
    assert then["text"] != now["text"]
    assert then["updated_at"] < early["to"] < now["updated_at"]
    assert "Active alerts at the end of the period: 1" in report_page([early | {"history": []}])


def test_a_period_in_which_nothing_was_attempted_is_reported_as_that(lived):
    """A plant that was shut has a report too; a period before the first window, in the future, or without a history is refused."""
    idle = report_of(lived, END + DAY_S, END + 6 * DAY_S)
    assert idle["unwatched"]["gaps"] == [{"from": rfc3339(END + DAY_S), "to": rfc3339(END + 6 * DAY_S)}]
    assert "No window was attempted" in report_page([idle])
    assert report_of(lived, END, END + 99 * DAY_S)["unwatched"]["gaps"][0]["to"] == rfc3339(END + 8 * DAY_S)  # now
    with pytest.raises(BadInput, match="nothing was attempted"):
        report_of(lived, END + 9 * DAY_S, END + 10 * DAY_S)


def test_a_history_without_any_window_has_nothing_to_report(tmp_path):
    """The message says so."""
    settings = configuration(tmp_path)
    with Store.open(settings.state_directory) as store, pytest.raises(BadInput, match="no replay was attempted yet"):
        report(settings, store, None, None, END)


def test_no_figure_is_minus_zero_and_levels_differ_in_grey(both):
    """A figure that rounds to zero has no minus sign; the lines of tier and limit have different dashes."""
    words = re.sub(r"<svg.*?</svg>|<style.*?</style>", "", both, flags=re.DOTALL)
    assert not re.search(r"[-\u2212]0(\.0+)?(?![\d.])", words)
    assert len(set(re.findall(r"stroke-dasharray: ([\d., ]+)", both))) >= 3  # tier, limit, P50
    assert "5 % dashed, the limit at 30 % dash-dotted" in words


def test_a_condition_of_the_data_claims_no_probability(lived):
    """The report gives no probability for a condition of the data, and for falling friction that of a fall."""
    whole = report_of(lived) | {"history": []}  # without drawings, which take time
    (alert,) = whole["alerts"]
    for condition, words in (("temperature_sensor", None), ("friction_falling", "has fallen by"), ("wear_rising", "has risen by")):
        text = report_page([{**whole, "alerts": [{**alert, "condition": condition, "probability": 1.0}]}])
        assert "100.00 %" not in text
        assert text.count("Probability") == (words is not None)
        assert words is None or words in text


def test_a_stop_is_in_the_file_with_who_allowed_motion_again(tmp_path):
    """Of two stops a person allowed motion after one within the period, after the other later; names are escaped text."""
    settings = configuration(tmp_path)
    with Store.open(settings.state_directory) as store:
        ledger = store.ledger.claim(FIRST_UNIX_S, "scheduled", FIRST_UNIX_S)
        store.ledger.end(ledger, "skipped", "no permission", FIRST_UNIX_S)
        store.stops.add("protective_stop", "safety mode 3", FIRST_UNIX_S + 10)
        store.stops.allow("<i>Ada</i>", "a box stood in the way", FIRST_UNIX_S + 20)
        store.stops.add("torque_band", "joint 2", FIRST_UNIX_S + 30)
        store.stops.allow("Grace", "looked at", FIRST_UNIX_S + 2 * DAY_S)
        whole = report(settings, store, None, FIRST_UNIX_S + DAY_S, END)
        later = report(settings, store, None, FIRST_UNIX_S + 3 * DAY_S, END)
    assert [stop["allowed_by"] for stop in whole["stops"]] == ["<i>Ada</i>", None]
    assert [stop["allowed_by"] for stop in later["stops"]] == ["<i>Ada</i>", "Grace"]
    text = report_page([whole])
    for part in ("protective stop: safety mode 3", "&lt;i&gt;Ada&lt;/i&gt;", "a box stood in the way", "nobody: nothing moves"):
        assert part in text, part
    assert "nobody: nothing moves" not in report_page([later])


def test_the_report_leads_with_the_sentence_that_decides(both):
    """What decides stands before what it rests on: headline, dates and inspection, then joints, charts and what was not monitored."""
    places = [
        both.index(part) for part in ("Elbow turns 2", "At this pace it meets its limit", "Inspect", "went from", "<svg", "Reviewed by")
    ]
    assert places == sorted(places)


def test_windows_that_ended_alike_are_one_line_the_gravest_first(lived):
    """Of 219 windows that were refused for three causes, the table has a line each, with how many and from when to when."""
    whole = report_of(lived) | {"history": []}
    at = [rfc3339(FIRST_UNIX_S + k * DAY_S / 8) for k in range(219)]
    reasons = [DOES_NOT_HOLD(condition="approach_near", why=FARTHEST_JOINT(joint=6, far_rad=2 + k / 1000)) for k in range(210)]
    reasons += [reason_of("no permission: the door is open")] * 8 + [CAUSED(cause="protective_stop", why="safety mode 3")]
    states = ["skipped"] * 218 + ["aborted"]
    failed = [with_reasons({"replay": k, "window": at[k], "state": states[k]}, reason=reason) for k, reason in enumerate(reasons)]
    assert [(group.state, group.cause, len(group.windows)) for group in groups(failed)] == [
        ("aborted", "protective_stop", 1),
        ("skipped", "approach_near", 210),
        ("skipped", "no permission: the door is open", 8),
    ]
    text = report_page([whole | {"unwatched": whole["unwatched"] | {"failed": failed}}])
    assert text.count("has farthest to go") == 1
    assert "210 ×" in text
    assert "1 June – 27 June" in text


@pytest.mark.parametrize("code", ["en", "de"])
def test_a_month_in_which_nothing_happened_is_one_sheet_of_paper(lived, tabs, code):
    """Chromium prints one page for one arm; a quiet month with one refused window has the chart, the joints and the line to sign on it."""
    quiet = report_of(lived, FIRST_UNIX_S, FIRST_UNIX_S + 19 * DAY_S)
    assert sheets(tabs, report_page([quiet], language(code))) == 1


def test_a_refusal_of_219_windows_does_not_make_the_report_long(lived, tabs):
    """With an alert, its charts and 219 windows of five causes, the report is three sheets at most."""
    whole = report_of(lived)
    failed = [
        {"replay": k, "window": rfc3339(FIRST_UNIX_S + k * DAY_S / 8), "state": "skipped", "reason": f"cause_{k % 5}: at {k} of 219"}
        for k in range(219)
    ]
    assert sheets(tabs, report_page([whole | {"unwatched": whole["unwatched"] | {"failed": failed}}])) <= 3


def sheets(tabs, text):
    """The sheets of paper on which Chromium prints a page."""
    page = tabs.open()
    page.set_content(text)
    printed = page.pdf(prefer_css_page_size=True)
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", printed))


def test_the_report_is_written_in_the_language_that_is_asked_for(lived, tmp_path):
    """The option decides; another language is refused by name."""
    folder, _ = lived
    page = tmp_path / "report.html"
    arguments = ["report", "-c", str(folder / "cell.toml"), "--to", "2026-06-03", "-o", str(page), "--language"]
    assert CliRunner().invoke(app, [*arguments, "de"]).exit_code == 0
    assert "Bericht über den Reibungszustand" in page.read_text("utf-8")
    assert "expected one of en, de" in str(CliRunner().invoke(app, [*arguments, "xx"]).exception)


def test_a_row_or_an_alert_that_is_none_does_not_keep_the_page_from_people(lived):
    """A remaining life beyond its bounds, half an alert and none at all: each is said, and the rest is there."""
    document = json.loads(json.dumps(report_of(lived)))
    document["joints"][2]["remaining_life"]["before_service_probability"] = 1.5
    document["alerts"] = [{**document["alerts"][0], "change": None, "text": "It turns heavier."}, {"joint": "x"}]
    page = report_page([document])
    assert "A part of what its arm says of this alert cannot be read (change: " in page
    assert "1 alerts cannot be read." in page
    assert "What happened" in page
