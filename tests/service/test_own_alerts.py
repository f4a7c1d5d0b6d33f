"""The alerts that the monitor raises about itself: stopped, stale, unheard; through their life, before and after the first verdict."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from test_backups_and_retention import configuration, lived, recordings  # noqa: F401 - a fixture

from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.judge.alerts.life_cycle import acknowledge
from monitor.publish.documents import Health
from monitor.publish.queries import AckRequest
from monitor.reason import Reason
from monitor.recording import DAY_S
from monitor.service.daemon import Daemon
from monitor.service.history.assess_and_store import load_state
from monitor.service.history.recompute import recompute
from monitor.service.history.status import status_document
from monitor.service.learning import ArmHeard, late_at
from monitor.service.publisher import event_document
from monitor.service.replay import UNREACHABLE
from monitor.service.scheduler import DISK_FULL, MISSED
from monitor.store.store import Store

NOON = 1.0e9  # 2001-09-09 01:46 UTC, as `lived` has it


class Cell:
    """A daemon whose clock the test sets; nothing moves in it."""

    def __init__(self, folder: Path, store: Store) -> None:
        self.folder, self.store, self.now = folder, store, NOON
        settings = configuration(folder / "history")
        self.settings = replace(settings, bus=replace(settings.bus, listen=("tcp/127.0.0.1:0",)))
        self.daemon = Daemon(self.settings, store, now=lambda: self.now, play=lambda *_: None)
        self.monotonic = 0.0
        self.daemon.heard = ArmHeard(store, lambda: self.now, lambda: self.monotonic)

    def skip(self, reason: str | Reason, days: int) -> None:
        """As many daily windows, each skipped for that reason."""
        for _ in range(days):
            self.store.ledger.end(self.store.ledger.claim(self.now, "scheduled", self.now), "skipped", reason, self.now)
            self.now += DAY_S

    def look(self) -> dict[str, str]:
        """Look; the active alerts of the arm with their texts."""
        self.daemon.look()
        return {alert.condition: alert.text.text for alert in self.daemon.state.alerts.active_alerts if alert.joint is None}

    def acknowledge(self, condition: str) -> None:
        request = AckRequest(joint=None, condition=condition, by="Ada", why="seen")
        self.daemon.alerts.by_person(
            "acknowledged", request, lambda health, at: acknowledge(health, None, condition, by="Ada", why="seen", at_unix_s=at)
        )

    def kinds(self, condition: str) -> list[str]:
        return [event.document["kind"] for event in self.store.events.rows() if event.document["condition"] == condition]

    def health(self) -> Health:
        """As it is published."""
        self.daemon.publisher.health()
        return self.daemon.bus.last_values()["health"]


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    with Store.open(tmp_path / "history") as store:
        made = Cell(tmp_path, store)
        with made.daemon:
            yield made


def learnt(cell: Cell, recordings) -> None:  # noqa: F811
    """Two verdicts."""
    lived(cell.store, cell.settings, recordings, range(2))
    cell.daemon.state.take(load_state(cell.store), None)
    cell.now = cell.daemon.state.estimator.belief.at_unix_s + 3600.0


def test_what_is_late_follows_the_windows_of_the_schedule_and_no_holiday_is_a_silence():
    """Three windows, and two days at least. Weekends and blackout days have no windows, and their days do not count."""
    daily = ScheduleSettings()
    assert 2.0 * DAY_S < late_at(daily, NOON, None) - NOON <= 3.1 * DAY_S
    assert late_at(ScheduleSettings(cron="", every_h=2.0), NOON, None) - NOON == 2.0 * DAY_S
    assert late_at(ScheduleSettings(learn_within_days=30.0), NOON, None) - NOON == 30.0 * DAY_S
    assert late_at(ScheduleSettings(cron=""), NOON, None) is None
    assert 14.0 * DAY_S < late_at(ScheduleSettings(cron="0 3 * * 1"), NOON, None) - NOON < 22.0 * DAY_S
    shut = ScheduleSettings(blackout=("2001-09-10..2001-10-03",))
    assert 26.0 * DAY_S < late_at(shut, NOON, None) - NOON < 28.1 * DAY_S


def test_thirty_five_days_without_a_verdict_are_no_green_normal(cell: Cell, recordings):  # noqa: F811
    """`stale` is raised with an event, and the state of the arm is no longer NORMAL: on the bus, in the history, and for `status`."""
    learnt(cell, recordings)
    assert cell.look() == {}
    assert cell.health().state == "NORMAL"
    cell.skip(MISSED(), 35)
    assert set(cell.look()) == {"stale"}
    assert "Nothing was learnt of this arm since 2001-" in cell.look()["stale"]
    health = cell.health()
    assert health.state == "CHECK_FUNCTION"
    assert health.why.startswith("stale: Nothing was learnt")
    assert cell.kinds("stale") == ["raised"]
    shown = status_document(cell.settings, cell.now)["health"]
    assert shown["state"] == "CHECK_FUNCTION"
    published = cell.daemon.bus.last_values()["alert/arm/stale"]
    assert published.active
    assert "joint-monitor status" in published.action


def test_a_stale_alert_clears_once_it_is_acknowledged_and_something_was_learnt_and_in_no_other_order(cell: Cell, recordings):  # noqa: F811
    """Acknowledged alone it stays; over alone it says so and stays; then it clears, and the arm is NORMAL again."""
    learnt(cell, recordings)
    cell.skip(MISSED(), 9)
    cell.look()
    cell.acknowledge("stale")
    assert "stale" in cell.look()
    lived(cell.store, cell.settings, recordings, range(12, 14))
    cell.daemon.state.take(load_state(cell.store), None)
    cell.now = cell.daemon.state.estimator.belief.at_unix_s + 3600.0
    assert cell.look() == {}
    assert cell.kinds("stale") == ["raised", "acknowledged", "cleared"]
    assert cell.health().state == "NORMAL"
    tally = recompute(cell.store)
    assert (tally["different"], tally["identical"]) == (0, 4)


def test_a_stop_is_an_alert_at_once_and_allowing_motion_clears_it_with_name_and_reason(cell: Cell):
    """Before any verdict too: a monitor that never learnt anything is the one that needs it most."""
    cell.store.stops.add("protective_stop", "the arm met something", cell.now)
    assert "Nothing moves since" in cell.look()["stopped"]
    assert "the arm met something" in cell.look()["stopped"]
    assert cell.health().state is None
    assert "the arm met something" in cell.health().why
    assert [alert.condition for alert in cell.health().alerts] == ["stopped"]
    cell.now += 3600.0
    cell.store.stops.allow("Grace", "looked at it", cell.now)
    assert cell.look() == {}
    assert cell.kinds("stopped") == ["raised", "cleared"]
    last = event_document(cell.store.events.rows()[-1])
    assert (last.acknowledged_by, last.acknowledged_why) == ("Grace", "looked at it")


def test_an_early_alert_survives_a_restart_and_the_first_verdict(tmp_path: Path, recordings):  # noqa: F811
    """It is raised once, whatever restarts; with the first verdict it stands beside it, and verdicts come out the same again."""
    for _ in range(2):
        with Store.open(tmp_path / "history") as store:
            cell = Cell(tmp_path, store)
            cell.now -= 3600.0
            with cell.daemon:
                if not store.stops.rows():
                    store.stops.add("protective_stop", "the arm met something", cell.now)
                assert set(cell.look()) == {"stopped"}
                assert cell.kinds("stopped") == ["raised"]
    with Store.open(tmp_path / "history") as store:
        cell = Cell(tmp_path, store)
        with cell.daemon:
            cell.now += 1.5 * DAY_S
            lived(store, cell.settings, recordings, range(2))
            cell.daemon.state.take(load_state(store), None)
            assert set(cell.look()) == {"stopped"}
            assert cell.kinds("stopped") == ["raised"]
            assert cell.health().state == "CHECK_FUNCTION"
        assert recompute(store)["different"] == 0


def test_endless_refusals_are_stopped_with_their_reason_and_since_when(cell: Cell):
    """Whatever refuses: after an abort the arm stands far away, motion is not allowed, the selector is at local. Two are no standstill."""
    began = cell.now
    cell.skip("approach_near: joint 2 is 1.20 rad from the start of the excitation; at most 0.8", 2)
    assert cell.look() == {}
    cell.skip("allow_motion: motion is not allowed: allow_motion is false", 2)
    text = cell.look()["stopped"]
    assert "every window since then was refused; the last one: allow_motion: motion is not allowed" in text
    assert "2001-09-09 01:46 UTC" in text, began
    cell.store.ledger.end(cell.store.ledger.claim(cell.now, "scheduled", cell.now), "rejected", "noise", cell.now)
    assert "This is over since" in cell.look()["stopped"]
    cell.acknowledge("stopped")
    assert "stopped" not in cell.look()
    assert cell.kinds("stopped") == ["raised", "updated", "acknowledged", "cleared"]


@pytest.mark.parametrize(
    "reason", [MISSED(), DISK_FULL(free_mb=3.0, folder="/x", least_mb=500.0), UNREACHABLE(why="10.0.0.7: no dashboard on port 29999")]
)
def test_what_is_no_refusal_of_the_arm_is_not_stopped(cell: Cell, reason: str):
    """It is `stale` after a while, and `unheard` where the arm does not answer."""
    cell.skip(reason, 9)
    assert set(cell.look()) == {"stale"}


def test_a_lasting_alert_does_not_flood_the_log_of_transitions(cell: Cell):
    """Its reason differs with every window: in a hundred days the text follows seven times at most."""
    for day in range(100):
        cell.skip(f"approach_near: joint 2 is {day / 100:.2f} rad from the start", 1)
        cell.look()
    assert 3 <= cell.kinds("stopped").count("updated") <= 8
    assert cell.kinds("stopped").count("raised") == 1


def test_an_arm_that_is_not_heard_is_an_alert_after_two_windows_and_it_survives_restarts(tmp_path: Path):
    """A night is no alert. Since when counts over a restart, and the first minute of a start accuses nobody."""
    with Store.open(tmp_path / "history") as store:
        cell = Cell(tmp_path, store)
        with cell.daemon:
            cell.daemon.heard.observe(True, None)
            cell.monotonic, cell.now = 3600.0, NOON + 0.5 * DAY_S
            cell.daemon.heard.observe(False, "10.0.0.7: no RTDE connection")
            assert cell.look() == {}
    with Store.open(tmp_path / "history") as store:
        cell = Cell(tmp_path, store)
        cell.now = NOON + 2.5 * DAY_S
        with cell.daemon:
            cell.daemon.heard.observe(False, "10.0.0.7: no RTDE connection")
            assert cell.look() == {}
            cell.monotonic = 61.0
            assert cell.look() == {"unheard": "The arm is not heard since 2001-09-09 01:46 UTC: 10.0.0.7: no RTDE connection."}
            cell.daemon.heard.observe(True, None)
            assert "This is over since" in cell.look()["unheard"]
            cell.acknowledge("unheard")
            assert cell.look() == {}
