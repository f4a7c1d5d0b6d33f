"""Each window is used once, and only while it is open, whatever the clock, the calendar and the process do."""

import os
import random
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.acquire.schedule.needed import ColdStart, WarmUp
from monitor.acquire.schedule.windows import ScheduleSettings, Triggers, check_windows, evidence_window, reach_back_s, upcoming, windows
from monitor.errors import BadInput
from monitor.recording import DAY_S

BERLIN = ZoneInfo("Europe/Berlin")
ZONES = ("UTC", "Europe/Berlin", "America/New_York", "Australia/Lord_Howe", "Asia/Kathmandu", "America/Santiago")


def at(text: str, zone: ZoneInfo | None = None) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=zone or UTC).timestamp()


def local(unix_s: float, zone: str) -> str:
    return datetime.fromtimestamp(unix_s, tz=ZoneInfo(zone)).strftime("%m-%d %H:%M")


def keys(settings: ScheduleSettings, first: str, last: str) -> list[float]:
    return [window.key_unix_s for window in windows(settings, at(first), at(last), None)]


def test_an_hour_that_comes_twice_has_one_window_and_one_that_is_left_out_has_one_too():
    """In Berlin 02:30 comes twice on 25 October 2026 and never on 29 March; each day has one window all the same."""
    settings = ScheduleSettings(timezone="Europe/Berlin", cron="30 2 * * *")
    autumn = [local(key, "UTC") for key in keys(settings, "2026-10-24T12:00", "2026-10-26T12:00")]
    assert autumn == ["10-25 00:30", "10-26 01:30"]
    spring = [local(key, "Europe/Berlin") for key in keys(settings, "2026-03-28T12:00", "2026-03-30T12:00")]
    assert spring == ["03-29 03:30", "03-30 02:30"]


@settings(max_examples=15)
@given(zone=st.sampled_from(ZONES), minute=st.integers(0, 59), hour=st.integers(0, 23), year=st.integers(2024, 2037))
def test_a_daily_time_has_one_window_a_day_in_every_zone_and_year(zone, minute, hour, year):
    """Every local day has exactly one window, at the configured local time, except where that hour does not exist."""
    settings = ScheduleSettings(timezone=zone, cron=f"{minute} {hour} * * *")
    where = ZoneInfo(zone)
    found = keys(settings, f"{year}-01-02T00:00", f"{year}-12-30T00:00")
    days = [datetime.fromtimestamp(key, tz=where) for key in found]
    assert all((after.date() - before.date()).days == 1 for before, after in pairwise(days))
    odd = [day for day in days if (day.hour, day.minute) != (hour, minute)]
    assert len(odd) <= 2


class Host:
    """A machine whose clock jumps and whose process dies; it replays every window that its schedule has as due."""

    def __init__(self, settings: ScheduleSettings, began: float) -> None:
        self.settings, self.began = settings, began
        self.ledger: dict[float, str] = {}  # as in SQL: the key is unique
        self.replayed: list[tuple[float, float]] = []  # key, when
        self.watched = began

    def tick(self, now: float) -> None:
        since = min(self.watched, now)
        first = since - reach_back_s(self.settings)
        entered = [key for key in self.ledger if first <= key <= now + 1]
        found = check_windows(self.settings, now_unix_s=now, since_unix_s=since, entered=entered, began_unix_s=self.began)
        for window in (*found.missed, *found.merged):
            assert window.key_unix_s not in self.ledger
            self.ledger[window.key_unix_s] = "skipped"
        if found.due is not None:
            assert found.due.key_unix_s not in self.ledger
            assert found.due.opens_unix_s <= now < found.due.closes_unix_s
            self.ledger[found.due.key_unix_s] = "replayed"
            self.replayed.append((found.due.key_unix_s, now))
        self.watched = now


@pytest.mark.parametrize("zone", ZONES)
def test_over_a_year_with_crashes_and_jumps_no_window_is_replayed_twice_or_after_its_end(zone):
    """In a year the host sleeps, crashes, and has its clock set by up to a month; it asserts the claim at every step."""
    live(random.Random(zone), zone, years=1)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_over_three_hundred_years_no_window_is_replayed_twice_or_after_its_end(soak_row):
    """The same for 50 arms over six years each, in every zone."""
    replays = sum(live(random.Random(seed), ZONES[seed % len(ZONES)], years=6) for seed in range(50))
    soak_row("simulated years of schedule with crashes and clock jumps: 300", f"{replays} replays, 0 twice", "0 twice, 0 late")


def live(rng: random.Random, zone: str, years: float) -> int:
    """Run one host, and return the count of its replays."""
    settings = ScheduleSettings(
        timezone=zone, cron="15 2 * * *", every_h=rng.choice([0.0, 7.0]), grace_s=1800.0, jitter_s=rng.choice([0.0, 900.0])
    )
    began = at("2026-02-01T00:00")
    host, now, end = Host(settings, began), began, began + years * 365 * DAY_S
    while now < end:
        what = rng.random()
        if what < 0.02:
            now += rng.uniform(-30 * DAY_S, 10 * DAY_S)  # somebody sets the clock
        elif what < 0.1:
            now += rng.uniform(0, 20 * DAY_S)  # switched off
        else:
            now += rng.choice([60.0, 900.0, 3600.0, 6 * 3600.0, 12 * 3600.0])
        host.tick(now)
    replayed = [key for key, _ in host.replayed]
    assert len(replayed) == len(set(replayed))
    assert all(key <= when < key + settings.grace_s for key, when in host.replayed)
    return len(replayed)


def test_a_watched_schedule_replays_every_window_of_a_simulated_year():
    """A host that ticks around every window over both changes of the clock has 365 replays in 365 days, and misses none."""
    settings = ScheduleSettings(timezone="Europe/Berlin", cron="30 2 * * *", grace_s=600.0)
    host = Host(settings, at("2026-01-01T00:00"))
    window_ends = [window.key_unix_s for window in windows(settings, at("2026-01-01T00:00"), at("2027-01-01T00:00"), None)]
    for key in window_ends:
        for offset in (-60.0, 0.0, 60.0, 600.0, 3600.0):
            host.tick(key + offset)
    assert [key for key, _ in host.replayed] == window_ends
    assert set(host.ledger.values()) == {"replayed"}


def test_missed_windows_are_reported_once_and_overlapping_ones_share_a_replay():
    """A host that was off for three days reports three missed windows; four windows that are open at once get one replay."""
    settings = ScheduleSettings(cron="0 3 * * *", grace_s=600.0)
    now = at("2026-05-04T12:00")
    found = check_windows(settings, now_unix_s=now, since_unix_s=now - 3 * DAY_S, entered=(), began_unix_s=None)
    assert (found.due, len(found.missed)) == (None, 3)
    again = check_windows(settings, now_unix_s=now, since_unix_s=now, entered=(), began_unix_s=None)
    assert again.missed == ()
    often = ScheduleSettings(cron="*/10 * * * *", grace_s=2400.0)
    found = check_windows(often, now_unix_s=now, since_unix_s=now, entered=(), began_unix_s=None)
    assert found.due is not None
    assert found.due.key_unix_s == now
    assert len(found.merged) == 3


def test_a_thousand_missed_days_do_not_enter_a_thousand_rows():
    """The latest missed windows are reported; no replay makes up for them."""
    settings = ScheduleSettings(cron="0 * * * *", grace_s=600.0)
    now = at("2029-01-01T12:30")
    found = check_windows(settings, now_unix_s=now, since_unix_s=now - 1000 * DAY_S, entered=(), began_unix_s=None)
    assert found.due is None
    assert len(found.missed) == 60


def test_no_window_opens_on_a_blackout_day_of_the_sites_own_calendar():
    """A blackout is in local days and includes its first and its last day."""
    settings = ScheduleSettings(timezone="Europe/Berlin", cron="0 0 * * *", blackout=("2026-12-24..2026-12-26", "2027-01-01"))
    days = [local(key, "Europe/Berlin")[:5] for key in keys(settings, "2026-12-22T12:00", "2027-01-02T12:00")]
    assert days == ["12-23", "12-27", "12-28", "12-29", "12-30", "12-31", "01-02"]


def test_no_window_reaches_into_a_blackout():
    """A window that is open at midnight closes then; one whose jitter passes midnight is left out. So with cold starts and evidence."""
    settings = ScheduleSettings(
        timezone="Europe/Berlin", cron="30 23 * * *", grace_s=7200.0, jitter_s=3600.0,
        blackout=("2026-12-24..2026-12-26", "9999-12-31", "0001-01-01"),
        cold_start_after_h=4.0, evidence_windows=("22:00-05:00",),
    )  # fmt: skip
    eve = datetime(2026, 12, 24, tzinfo=BERLIN).timestamp()
    kept = 0
    for salt in map(str, range(20)):
        for window in windows(settings, eve - 2 * 86_400.0, eve + 5 * 86_400.0, None, salt):
            assert window.opens_unix_s < window.closes_unix_s
            assert window.closes_unix_s <= eve or window.opens_unix_s >= eve + 3 * 86_400.0
            kept += window.closes_unix_s == eve
    assert 0 < kept < 20  # some lots fall before midnight, some after it
    late = check_windows(
        settings, now_unix_s=eve + 1800.0, since_unix_s=eve - 60.0, entered=(), began_unix_s=None,
        triggers=Triggers(cold_start_unix_s=eve - 600.0, evidence_unix_s=eve - 900.0),
    )  # fmt: skip
    assert late.due is None


def test_learning_adds_windows_for_its_days_and_no_longer():
    """Windows come every six hours for two weeks from the first window, and then as usual."""
    settings = ScheduleSettings(cron="0 3 * * *", learning_every_h=6.0, learning_days=14.0)
    began = at("2026-03-01T03:00")
    first = windows(settings, began, began + 14 * DAY_S - 1, began)
    assert sum(window.why == "learning" for window in first) == 14 * 4
    assert sum(window.why == "cron" for window in first) == 14
    later = windows(settings, began + 15 * DAY_S, began + 20 * DAY_S, began)
    assert {window.why for window in later} == {"cron"}


@settings(max_examples=30)
@given(salt=st.text(max_size=10), minutes=st.integers(0, 10**6))
def test_jitter_is_each_windows_own_and_leaves_room_in_it(salt, minutes):
    """A window's jitter is the same after a restart, is at most jitter_s, and ends before the window."""
    settings = ScheduleSettings(cron="0 * * * *", jitter_s=500.0, grace_s=600.0)
    start = at("2026-01-01T00:00") + 60.0 * minutes
    one, two = (windows(settings, start, start + 7200.0, None, salt) for _ in range(2))
    assert one == two
    assert one
    assert all(window.key_unix_s <= window.opens_unix_s < window.key_unix_s + 500.0 < window.closes_unix_s for window in one)


def test_weekdays_are_counted_as_cron_counts_them():
    """0 and 7 are Sunday, 1-5 are the working days, */2 begins on Sunday; names work too."""

    def weekdays(field: str) -> set[str]:
        settings = ScheduleSettings(cron=f"0 3 * * {field}")
        return {datetime.fromtimestamp(key, tz=UTC).strftime("%a") for key in keys(settings, "2026-03-01T00:00", "2026-03-15T00:00")}

    assert weekdays("0") == weekdays("7") == weekdays("sun") == {"Sun"}
    assert weekdays("1-5") == weekdays("mon-fri") == {"Mon", "Tue", "Wed", "Thu", "Fri"}
    assert weekdays("*/2") == {"Sun", "Tue", "Thu", "Sat"}
    assert len(weekdays("*")) == 7


def test_a_cold_start_opens_a_window_once_a_day_and_only_after_a_rest_that_was_seen():
    """An arm that was off over night opens a window; one that was off over lunch, or that was not listened to, opens none."""
    settings = ScheduleSettings(cron="", cold_start_after_h=4.0, grace_s=900.0)
    morning = at("2026-03-02T06:00")
    arm = ColdStart(morning - 10 * 3600.0)
    arm.observe(True, morning - 60.0, 4.0)
    assert arm.at_unix_s is None  # we were away, not the arm
    arm = ColdStart(morning - 10 * 3600.0)
    arm.observe(False, morning - 60.0, 4.0)
    arm.observe(True, morning, 4.0)
    assert arm.at_unix_s == morning
    found = check_windows(
        settings, now_unix_s=morning + 5, since_unix_s=morning, entered=(), began_unix_s=None, triggers=Triggers(arm.at_unix_s)
    )
    assert found.due is not None
    again = check_windows(
        settings,
        now_unix_s=morning + 9,
        since_unix_s=morning,
        entered=[found.due.key_unix_s],
        began_unix_s=None,
        triggers=Triggers(arm.at_unix_s),
    )
    assert again.due is None
    arm.observe(False, morning + 3600, 4.0)
    arm.observe(True, morning + 7200, 4.0)
    assert arm.at_unix_s == morning


def test_evidence_advances_a_replay_into_the_configured_span_and_once_per_pause():
    """Evidence at noon opens a window at 22:00, evidence at one in the morning at once. Without a configured span it opens none."""
    settings = ScheduleSettings(timezone="Europe/Berlin", evidence_windows=("22:00-05:00",), evidence_pause_h=24.0)
    noon, night = at("2026-06-01T12:00", BERLIN), at("2026-06-02T01:00", BERLIN)
    made = evidence_window(settings, noon)
    assert made is not None
    assert (local(made.opens_unix_s, "Europe/Berlin"), local(made.closes_unix_s, "Europe/Berlin")) == ("06-01 22:00", "06-02 05:00")
    made = evidence_window(settings, night)
    assert made is not None
    assert made.opens_unix_s == night
    assert evidence_window(ScheduleSettings(), noon) is None
    same = {evidence_window(settings, noon + minutes * 60.0).key_unix_s for minutes in range(60)}
    assert len(same) == 1


def test_steady_is_ten_minutes_without_a_hole_and_without_a_drift():
    """A joint that warms by 1 K in ten minutes is not steady; nine minutes are too few; a gap of a minute starts the time again."""
    steady, drifting, short, holed = WarmUp(), WarmUp(), WarmUp(), WarmUp()
    for second in range(0, 700, 10):
        steady.observe((30.0, 31.0), float(second))
        drifting.observe((30.0, 31.0 + second / 600.0), float(second))
        if second > 200:
            short.observe((30.0, 31.0), float(second))
        if not 300 < second < 400:
            holed.observe((30.0, 31.0), float(second))
    assert steady.steady(700.0, 0.5)
    assert not drifting.steady(700.0, 0.5)
    assert not short.steady(700.0, 0.5)
    assert not holed.steady(700.0, 0.5)


def test_what_comes_next_is_what_will_be_due():
    """The list that people see and the decision that moves an arm come from one calculation."""
    settings = ScheduleSettings(timezone="America/New_York", cron="0 3 * * mon", jitter_s=300.0)
    now = at("2026-03-04T00:00")
    for window in upcoming(settings, now, 5, None, "cell-1"):
        found = check_windows(
            settings, now_unix_s=window.opens_unix_s, since_unix_s=window.opens_unix_s, entered=(), began_unix_s=None, salt="cell-1"
        )
        assert found.due == window
    rare = upcoming(ScheduleSettings(cron="0 0 29 2 *"), at("2027-03-01T00:00"), 1, None)
    assert [local(window.key_unix_s, "UTC") for window in rare] == ["02-29 00:00"]
    assert upcoming(ScheduleSettings(cron=""), now, 3, None) == []


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("timezone", "Berlin", "Europe/Berlin"),
        ("timezone", "../etc/passwd", "expected a name"),
        ("cron", "at noon", "five fields"),
        ("cron", "0 25 * * *", "five fields"),
        ("cron", "0 3 * * 8", "0 to 7"),
        ("jitter_s", 600.0, "less than grace_s"),
        ("blackout", ("2026-13-01",), "2026-12-25"),
        ("blackout", ("2026-05-02..2026-05-01",), "2026-12-25"),
        ("seek_temperatures", True, "expected evidence_windows"),
        ("evidence_windows", ("25:00-05:00",), "HH:MM"),
    ],
)
def test_an_invalid_schedule_is_refused_with_what_would_be_right(setting, value, message):
    """The mistake is reported when the configuration is read, not when the schedule needs it."""
    with pytest.raises(BadInput, match=message):
        ScheduleSettings(**{setting: value})
    assert timedelta(days=1).total_seconds() == DAY_S


WITHOUT_ZONES = """
import sys
from monitor.acquire.schedule.windows import ScheduleSettings, upcoming
from monitor.errors import BadInput
print(upcoming(ScheduleSettings(cron="0 3 * * *"), 0.0, 1, None)[0].opens_unix_s)
try:
    ScheduleSettings(timezone="Europe/Berlin")
except BadInput as wrong:
    print(wrong)
"""


def test_a_computer_without_zones_knows_utc_and_says_what_is_missing_for_another(tmp_path):
    """As in a slim container, with neither zones of the system nor the package: nobody wrote a wrong name."""
    (tmp_path / "tzdata").mkdir()
    (tmp_path / "tzdata" / "__init__.py").write_text('raise ImportError("no zones")')
    where = os.environ | {"PYTHONTZPATH": "/nonexistent", "PYTHONPATH": str(tmp_path)}
    found = subprocess.run([sys.executable, "-c", WITHOUT_ZONES], capture_output=True, text=True, env=where, check=True)
    opens, refused = found.stdout.splitlines()
    assert float(opens) == 3 * 3600.0
    assert refused.startswith(
        "schedule.timezone = 'Europe/Berlin': this computer knows no time zones but UTC; install them, by pip install"
    )
