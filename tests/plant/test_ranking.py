"""The worst first, and nobody is hidden: an arm that is silent, stale or not copied stands above those that are well."""

import re
from pathlib import Path

import pytest
from heard_documents import SAID_AT, whole

from monitor import __version__
from monitor.plant.arm import GONE, NO_WAY, NOT_SEEN, SAYS_NOTHING, SETTLED_S, Arm, ArmName, HeardArm, documents_of, worst_first
from monitor.plant.ingest import keep_last_values, known, set_arms
from monitor.plant.links import named
from monitor.plant.status import PlantStatus, as_document, as_lines, plant_status
from monitor.publish.documents import Monitor
from monitor.publish.shown import Grade
from monitor.publish.timestamps import rfc3339, unix_s
from monitor.reason import reason_of

HEARD_AT_UNIX_S = unix_s(SAID_AT)


def arm(name, site="lab", *, state="NORMAL", why=None, stale=False, alerts=0, troubles=(), version=None, clock_ahead_s=0.0, **more):
    """An arm as it was heard; more : fields of HeardArm."""
    said = {
        "health": whole(
            "health", state=state, why=why, stale=stale, alerts=[{"joint": 5, "tier": "advisory" if state == "NORMAL" else "wear"}] * alerts
        ),
        "monitor": whole("monitor", troubles=[{"name": name} for name in troubles]),
        "info": whole("info", robot={"model": "ur5"}, version=version or __version__),
    }
    heard = {"monitor": HEARD_AT_UNIX_S - clock_ahead_s}
    return HeardArm(name=ArmName(site, name), heard_at_unix_s=heard, **documents_of(said, HEARD_AT_UNIX_S), **more)


@pytest.mark.parametrize(
    ("more", "grade"),
    [
        ({}, Grade.WELL),
        ({"state": "FAILURE"}, Grade.SICK),
        ({"state": "MAINTENANCE_REQUIRED", "silent_since_unix_s": 1.0}, Grade.SICK),
        ({"silent_since_unix_s": 1.0}, Grade.UNSEEN),
        ({"stale": True}, Grade.UNSEEN),
        ({"state": None, "silent_since_unix_s": 1.0}, Grade.UNSEEN),
        ({"state": None}, Grade.DOUBTFUL),
        ({"state": "A_LATER_VERSION_S"}, Grade.DOUBTFUL),
        ({"problem": reason_of("too old")}, Grade.DOUBTFUL),
        ({"troubles": ("disk",)}, Grade.DOUBTFUL),
        ({"state": "OFF_SPEC"}, Grade.DOUBTFUL),
        ({"clock_ahead_s": 119.0}, Grade.WELL),
        ({"clock_ahead_s": -7200.0}, Grade.DOUBTFUL),
        ({"clock_ahead_s": -7200.0, "stale": True}, Grade.UNSEEN),
    ],
)
def test_the_grade_is_the_worst_that_holds(more, grade):
    """Each has its place in the order."""
    assert arm("a", **more).grade is grade
    assert [each.order for each in Grade] == [0, 1, 2, 3]


def test_the_list_begins_with_the_worst_and_counts_everybody():
    """The failed one before one that needs maintenance; of equals the one that waits for a person; then by name."""
    arms = [
        *(arm("well"), arm("silent", silent_since_unix_s=0.0, silent_why=GONE), arm("failed", state="FAILURE")),
        *(arm("b", state="MAINTENANCE_REQUIRED"), arm("a", state="MAINTENANCE_REQUIRED")),
        arm("waits", state="MAINTENANCE_REQUIRED", alerts=2),
    ]
    ranked = worst_first(arms, HEARD_AT_UNIX_S)
    assert [each.name.robot for each in ranked] == ["failed", "waits", "a", "b", "silent", "well"]
    status = PlantStatus(None, {}, 0, ranked, HEARD_AT_UNIX_S)
    other = as_lines(PlantStatus(None, {}, 0, [arm("old", version="0.0.1"), arm("same")], HEARD_AT_UNIX_S))
    assert other[1].endswith(f"its monitor is of version 0.0.1, the plant of {__version__}")
    assert "version" not in other[2]
    lines = as_lines(status, 3)
    assert lines[0] == "6 arms: 4 sick, 1 unseen, 0 doubtful, 1 well"
    assert "2 of 2 alerts wait for a person" in lines[2]
    assert lines[-1] == "… and 3 more; --all shows them"
    assert "SILENT since 1970-01-01T00:00:00Z: its monitor is gone" in as_lines(status)[5]
    assert as_document(status)["counts"] == {"arms": 6, "sick": 4, "unseen": 1, "doubtful": 0, "well": 1}


def test_a_clock_that_differs_from_the_plants_is_told(database):
    """All times that the arm says are wrong by as much, or all of the plant's. Of a silent arm the last word is only old."""
    at = 1_767_571_200.0
    for robot, ahead_s in (("right", 1.5), ("ahead", 5 * 3600.0), ("behind", -600.0), ("silent", -600.0)):
        number = known(database, "hall", robot, at).arm
        said = {(number, "monitor"): (at, whole("monitor", said_at=rfc3339(at + ahead_s))), (number, "health"): (at, whole("health"))}
        keep_last_values(database, said)
    set_arms(database, [{"number": number, "since": at, "why": GONE, "problem": None}])
    lines = {line.split()[1]: line for line in as_lines(plant_status(database, at)) if "hall/" in line}
    assert "its clock is 5 h ahead of the plant's" in lines["hall/ahead"]
    assert "its clock is 10 min behind the plant's" in lines["hall/behind"]
    assert [name for name, line in lines.items() if "clock" not in line] == ["hall/silent", "hall/right"]
    assert {each["robot"]: each["clock_ahead_s"] for each in as_document(plant_status(database, at))["arms"]} == {
        **{"ahead": 5 * 3600.0, "behind": -600.0, "silent": None, "right": None},
    }
    number = known(database, "hall", "right", at).arm
    for odd in ("yesterday", 7, "2026-01-01T00:00:00", None):
        keep_last_values(database, {(number, "monitor"): (at, whole("monitor", said_at=odd))})
        assert [each.clock_ahead_s for each in plant_status(database, at).arms if each.name.robot == "right"] == [None]


def test_why_an_arm_is_not_heard():
    """Its token, its way and its last word tell three cases apart; at the start it may still come."""
    new = Arm(since=100.0)
    assert new.silence(130.0, 60.0, []) is None
    assert new.silence(161.0, 60.0, []) == NOT_SEEN
    seen = Arm(since=100.0, ways={"a"}, last_ways={"a"}, heard=200.0)
    assert seen.silence(259.0, 60.0, []) is None
    assert "has said nothing for more than 60 s" in seen.silence(261.0, 60.0, []).text
    assert seen.silence(201.0, 60.0, ["a", "b"]) == NO_WAY(ways=["a"])
    seen.ways, seen.gone = set(), 210.0
    assert seen.silence(210.0 + SETTLED_S / 2.0, 60.0, []) is None
    assert seen.silence(211.0, 60.0, ["a"]) == NO_WAY(ways=["a"])
    assert seen.silence(220.0, 60.0, []) == GONE


def test_an_arm_that_cannot_be_copied_is_asked_more_and_more_seldom():
    """Half a minute, a minute, … a quarter of an hour; one success, and it is as any other."""
    failing, pauses = Arm(since=0.0), []
    for _ in range(8):
        failing.copied(reason_of("no answer"), 100.0)
        pauses.append(failing.due_again - 100.0)
    assert pauses == [30.0, 60.0, 120.0, 240.0, 480.0, 900.0, 900.0, 900.0]
    failing.copied(None, 100.0)
    assert failing.failures == 0


def test_a_document_says_whether_there_is_something_to_copy():
    """Numbers that go back, and another history, are something too; a document of an older monitor says nothing."""
    known = Arm(since=0.0, event=5, change=7, history_id="one")
    same = {"last_event": 5, "last_change": 7, "history_id": "one"}

    def monitor(**store):
        return Monitor.model_validate(whole("monitor", store=store))

    assert not known.behind(monitor(**same))
    for key, value in (("last_event", 6), ("last_change", 3), ("history_id", "two")):
        assert known.behind(monitor(**same | {key: value}))
    assert not known.behind(monitor())


def test_the_page_shows_lines_as_they_are_printed():
    """docs/plant.md: each line of the shown status has the shape of one that is printed for such an arm."""

    def shape(line):
        return re.sub(r"\s+", " ", re.sub(r"[+-]?\d[\d:TZ-]*", "#", line)).strip()

    maintained = arm("arm-0049", "site-1", state="MAINTENANCE_REQUIRED", alerts=1)
    silent = arm("arm-0038", "site-1", silent_since_unix_s=0.0, silent_why=SAYS_NOTHING(silent_s=60.0))
    arms = [maintained, silent, arm("arm-0030", "site-1", stale=True), arm("arm-0040", "site-1", alerts=1), arm("arm-0041", "site-1")]
    printed = {shape(line) for line in as_lines(PlantStatus(None, {}, 0, arms, HEARD_AT_UNIX_S), 4)}
    page = (Path(__file__).parents[2] / "docs/plant.md").read_text("utf-8")
    shown = [shape(line) for line in re.search(r"\$ joint-monitor plant status\n(.*?)```", page, re.DOTALL)[1].splitlines() if line != "…"]
    assert len(shown) == 6
    assert set(shown) <= printed


def test_what_an_arm_says_cannot_fill_or_steer_a_terminal():
    """Names without end are counted, sentences are cut, and a sign that moves the cursor is none."""
    loud = arm(
        "loud",
        state="FAILURE",
        why="\x1b[2J" + "x" * 10_000,
        problem=reason_of("y" * 10_000),
        troubles=tuple(f"t{k}\n" for k in range(5000)),
    )
    line = as_lines(PlantStatus(None, {}, 0, [loud], HEARD_AT_UNIX_S))[1]
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
