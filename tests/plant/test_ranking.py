"""The worst first, and nobody is hidden: an arm that is silent, stale or not copied stands above those that are well."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from monitor import __version__
from monitor.plant.arm import DOUBTFUL, GRADES, SETTLED_S, SICK, UNSEEN, WELL, Arm, ArmStatus, worst_first
from monitor.plant.ingest import keep_last_values, known, set_arms
from monitor.plant.links import ArmName, named
from monitor.plant.status import PlantStatus, as_document, as_lines, plant_status
from monitor.publish.timestamps import rfc3339

QUIET = {
    **{"site": "lab", "model": "ur5", "why": None, "since": None, "silent_why": None, "troubles": (), "last_replay": None, "version": None},
    **{"state": "NORMAL", "stale": False, "silent_since_unix_s": None, "problem": None, "alerts": 0, "unacknowledged": 0, "histories": 1},
}


def arm(name, **more):
    return ArmStatus(**{**QUIET, "robot": name, **more})


@pytest.mark.parametrize(
    ("more", "grade"),
    [
        ({}, WELL),
        ({"state": "FAILURE"}, SICK),
        ({"state": "MAINTENANCE_REQUIRED", "silent_since_unix_s": 1.0}, SICK),
        ({"silent_since_unix_s": 1.0}, UNSEEN),
        ({"stale": True}, UNSEEN),
        ({"state": None, "silent_since_unix_s": 1.0}, UNSEEN),
        ({"state": None}, DOUBTFUL),
        ({"state": "A_LATER_VERSION_S"}, DOUBTFUL),
        ({"problem": "too old"}, DOUBTFUL),
        ({"troubles": ("disk",)}, DOUBTFUL),
        ({"state": "OFF_SPEC"}, DOUBTFUL),
        ({"clock_ahead_s": 119.0}, WELL),
        ({"clock_ahead_s": -7200.0}, DOUBTFUL),
        ({"clock_ahead_s": -7200.0, "stale": True}, UNSEEN),
    ],
)
def test_the_grade_is_the_worst_that_holds(more, grade):
    """And each has a word."""
    assert arm("a", **more).grade == grade
    assert GRADES[arm("a", **more).grade]


def test_the_list_begins_with_the_worst_and_counts_everybody():
    """The failed one before one that needs maintenance; of equals the one that waits for a person; then by name."""
    arms = [
        *(arm("well"), arm("silent", silent_since_unix_s=0.0, silent_why="its monitor is gone"), arm("failed", state="FAILURE")),
        *(arm("b", state="MAINTENANCE_REQUIRED"), arm("a", state="MAINTENANCE_REQUIRED")),
        arm("waits", state="MAINTENANCE_REQUIRED", alerts=2, unacknowledged=1),
    ]
    ranked = worst_first(arms)
    assert [each.robot for each in ranked] == ["failed", "waits", "a", "b", "silent", "well"]
    status = PlantStatus(None, {}, 0, ranked)
    other = as_lines(PlantStatus(None, {}, 0, [arm("old", version="0.0.1"), arm("same", version=__version__)]))
    assert other[1].endswith(f"its monitor is of version 0.0.1, the plant of {__version__}")
    assert "version" not in other[2]
    lines = as_lines(status, 3)
    assert lines[0] == "6 arms: 4 sick, 1 unseen, 0 doubtful, 1 well"
    assert "1 of 2 alerts wait for a person" in lines[2]
    assert lines[-1] == "… and 3 more; --all shows them"
    assert "SILENT since 1970-01-01T00:00:00Z: its monitor is gone" in as_lines(status)[5]
    assert as_document(status)["counts"] == {"arms": 6, "sick": 4, "unseen": 1, "doubtful": 0, "well": 1}


def test_a_clock_that_differs_from_the_plants_is_told(database):
    """All times that the arm says are wrong by as much, or all of the plant's. Of a silent arm the last word is only old."""
    at = 1_767_571_200.0
    for robot, ahead_s in (("right", 1.5), ("ahead", 5 * 3600.0), ("behind", -600.0), ("silent", -600.0)):
        number = known(database, "hall", robot, at).arm
        said = {(number, "monitor"): (at, {"said_at": rfc3339(at + ahead_s)}), (number, "health"): (at, {"state": "NORMAL"})}
        keep_last_values(database, said)
    set_arms(database, [{"number": number, "since": at, "why": "its monitor is gone", "problem": None}])
    lines = {line.split()[1]: line for line in as_lines(plant_status(database, at)) if "hall/" in line}
    assert "its clock is 5 h ahead of the plant's" in lines["hall/ahead"]
    assert "its clock is 10 min behind the plant's" in lines["hall/behind"]
    assert [name for name, line in lines.items() if "clock" not in line] == ["hall/silent", "hall/right"]
    assert {each["robot"]: each["clock_ahead_s"] for each in as_document(plant_status(database, at))["arms"]} == {
        **{"ahead": 5 * 3600.0, "behind": -600.0, "silent": None, "right": None},
    }
    number = known(database, "hall", "right", at).arm
    for odd in ("yesterday", 7, "2026-01-01T00:00:00", None):
        keep_last_values(database, {(number, "monitor"): (at, {"said_at": odd})})
        assert [each.clock_ahead_s for each in plant_status(database, at).arms if each.robot == "right"] == [None]


def test_why_an_arm_is_not_heard():
    """Its token, its way and its last word tell three cases apart; at the start it may still come."""
    new = Arm(since=100.0)
    assert new.silence(130.0, 60.0, []) is None
    assert new.silence(161.0, 60.0, []) == "not seen since the plant was started"
    seen = Arm(since=100.0, ways={"a"}, last_ways={"a"}, heard=200.0)
    assert seen.silence(259.0, 60.0, []) is None
    assert "has said nothing for more than 60 s" in seen.silence(261.0, 60.0, [])
    assert seen.silence(201.0, 60.0, ["a", "b"]) == "no way to it: a does not answer"
    seen.ways, seen.gone = set(), 210.0
    assert seen.silence(210.0 + SETTLED_S / 2.0, 60.0, []) is None
    assert seen.silence(211.0, 60.0, ["a"]) == "no way to it: a does not answer"
    assert seen.silence(220.0, 60.0, []) == "its monitor is gone"


def test_an_arm_that_cannot_be_copied_is_asked_more_and_more_seldom():
    """Half a minute, a minute, … a quarter of an hour; one success, and it is as any other."""
    failing, pauses = Arm(since=0.0), []
    for _ in range(8):
        failing.copied("no answer", 100.0)
        pauses.append(failing.due_again - 100.0)
    assert pauses == [30.0, 60.0, 120.0, 240.0, 480.0, 900.0, 900.0, 900.0]
    failing.copied(None, 100.0)
    assert failing.failures == 0


def test_a_document_says_whether_there_is_something_to_copy():
    """Numbers that go back, and another history, are something too; a document of an older monitor says nothing."""
    known = Arm(since=0.0, event=5, change=7, history_id="one")
    same = {"store": {"last_event": 5, "last_change": 7, "history_id": "one"}}
    assert not known.behind(same)
    for key, value in (("last_event", 6), ("last_change", 3), ("history_id", "two")):
        assert known.behind({"store": same["store"] | {key: value}})
    assert not known.behind({"store": {"history_bytes": 1}})
    assert not known.behind({})


def test_the_page_shows_lines_as_they_are_printed():
    """docs/plant.md: each line of the shown status has the shape of one that is printed for such an arm."""

    def shape(line):
        return re.sub(r"\s+", " ", re.sub(r"[+-]?\d[\d:TZ-]*", "#", line)).strip()

    maintained = arm(
        "arm-0049", state="MAINTENANCE_REQUIRED", why="Friction of joint 5 is +10 % against its beginning.", alerts=1, unacknowledged=1
    )
    hangs = "its monitor is there, and has said nothing for more than 60 s"
    arms = [maintained, arm("arm-0038", silent_since_unix_s=0.0, silent_why=hangs), arm("arm-0030", stale=True)]
    arms = [replace(each, site="site-1") for each in (*arms, arm("arm-0040", alerts=1, unacknowledged=1), arm("arm-0041"))]
    printed = {shape(line) for line in as_lines(PlantStatus(None, {}, 0, arms), 4)}
    page = (Path(__file__).parents[2] / "docs/plant.md").read_text("utf-8")
    shown = [shape(line) for line in re.search(r"\$ joint-monitor plant status\n(.*?)```", page, re.DOTALL)[1].splitlines() if line != "…"]
    assert len(shown) == 6
    assert set(shown) <= printed


def test_what_an_arm_says_cannot_fill_or_steer_a_terminal():
    """Names without end are counted, sentences are cut, and a sign that moves the cursor is none."""
    loud = arm("loud", state="FAILURE", why="\x1b[2J" + "x" * 10_000, problem="y" * 10_000, troubles=tuple(f"t{k}\n" for k in range(5000)))
    line = as_lines(PlantStatus(None, {}, 0, [loud]))[1]
    assert "troubles of its monitor: t0 , t1 , t2  and 4997 more" in line
    assert line.isprintable()
    assert len(line) < 1200


@pytest.mark.parametrize(
    ("key", "found"),
    [
        ("joint-monitor/v1/hall-1/cell_1/alert/j1/wear", (ArmName("hall-1", "cell_1"), "alert/j1/wear")),
        ("joint-monitor/v1/hall-1/cell-1", None),
        ("joint-monitor/v2/hall-1/cell-1/health", None),
        ("joint-monitor/v1/hall-1/<b>/health", None),
        ("joint-monitor/v1/Hall 1/cell-1/health", None),
        ("joint-monitor/v1/hall-1/a\0b/health", None),
        (f"joint-monitor/v1/hall-1/{'x' * 101}/health", None),
    ],
)
def test_a_name_that_no_monitor_can_have_is_no_arm(key, found):
    """Anybody may say anything on a bus without access control, and no database takes a NUL."""
    assert named(key) == found
