"""A copy of the history that asks by cursor misses nothing: not a late verdict, not one that was taken back, not another history."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from test_store import DAY, replayed
from test_store import commit as commit_verdict

from monitor.errors import BadInput
from monitor.publish.documents import Events
from monitor.service.handlers import Handlers
from monitor.store.store import Store

ALERT = {
    **{"kind": "raised", "joint": 1, "condition": "wear_rising", "tier": "wear", "active": True, "text": "", "action": ""},
    **{"raised_at_unix_s": 1.0, "updated_at_unix_s": 1.0, "change": 0.1, "probability": 0.99},
}


FIGURES = (
    *("coulomb_nm", "coulomb_std_nm", "viscous_nm_s_per_rad", "viscous_std_nm_s_per_rad", "temperature_c", "reference_speed_rad_s"),
    *("reference_temperature_c", "reference_torque_nm", "reference_torque_std_nm", "wear", "wear_std", "wear_rate_per_day"),
    "wear_rate_std_per_day",
)
LIFE = {"verdict": "no_trend", "trend_probability": 0.5, "p10_days": None, "p50_days": None, "p90_days": None}
JOINT = {**dict.fromkeys(FIGURES, 1.0), "remaining_life": LIFE}


def commit(store: Store, ledger_id: int, **changes: object) -> None:
    """A verdict whose figures a reader of the bus takes."""
    commit_verdict(store, ledger_id, friction=[JOINT, JOINT], **changes)


def handlers(store: Store) -> Handlers:
    return Handlers(SimpleNamespace(robot=SimpleNamespace(joints=2), store=store), None)


def copied(store: Store, after: int = 0, limit: int = 2) -> tuple[list[tuple[int, int]], int]:
    """All changes after a number, page by page, as (replay, rows), and the number of the last one."""
    found: list[tuple[int, int]] = []
    following: int | None = after
    while following is not None:
        page = handlers(store).history({"changed_after": str(following), "limit": str(limit)})
        found += [(change.replay, len(change.rows)) for change in page.changes]
        after = page.changes[-1].seq if page.changes else after
        following = page.next
    return found, after


def test_a_recording_that_waits_for_its_verdict_is_copied_after_later_ones(tmp_path: Path):
    """By the numbers of replays it would be skipped: the third is judged before the second."""
    with Store.open(tmp_path) as store:
        first, second, third = (replayed(store, DAY * day) for day in (1, 2, 3))
        for replay in (first, third):
            commit(store, replay, recorded_at_unix_s=DAY * replay)
        found, cursor = copied(store)
        assert found == [(first, 2), (third, 2)]
        commit(store, second, recorded_at_unix_s=DAY * second)
        assert copied(store, cursor)[0] == [(second, 2)]


def test_verdicts_that_are_taken_back_are_changes_without_rows(tmp_path: Path):
    """And the same window, judged again, is one more change."""
    with Store.open(tmp_path) as store:
        for day in (1, 2):
            commit(store, replayed(store, DAY * day), recorded_at_unix_s=DAY * day)
        _, cursor = copied(store)
        store.assessments.roll_back(1.5 * DAY, ({}, {}, {}))
        assert copied(store, cursor)[0] == [(2, 0)]
        assert store.changes.last() == 3
    with Store.open(tmp_path) as store:  # numbers go on after a restart
        commit(store, replayed(store, DAY * 3), recorded_at_unix_s=DAY * 3)
        assert store.changes.last() == 4


def test_a_restored_history_is_another_one_and_an_untouched_one_stays_itself(tmp_path: Path):
    """A restart keeps its identity; a backup in its place has another."""
    with Store.open(tmp_path) as store:
        commit(store, replayed(store, DAY))
        before = store.changes.history_id()
        store.back_up(3)
    with Store.open(tmp_path) as store:
        assert before
        assert store.changes.history_id() == before
    (tmp_path / "history.sqlite").write_bytes(b"no database" * 1000)
    with Store.open(tmp_path) as store:
        assert store.restored is not None
        assert store.changes.history_id() not in {None, before}


def test_transitions_come_in_pages_from_the_oldest_where_a_limit_is_asked(tmp_path: Path):
    """Without a limit the newest 100 are answered, and what lies between would be skipped."""
    with Store.open(tmp_path) as store:
        store.events.revise({"alerts": []}, [ALERT] * 250, 1.0)
        ask = handlers(store).events
        assert [event.seq for event in ask({"after": "10"}).events] == list(range(151, 251))
        seen, after = [], 10
        while after is not None:
            page = ask({"after": str(after), "limit": "100"})
            assert isinstance(page, Events)
            seen += [event.seq for event in page.events]
            after = page.next
        assert seen == list(range(11, 251))
        with pytest.raises(BadInput, match="limit = '0'; expected a whole number from 1 to 10000"):
            ask({"limit": "0"})
        with pytest.raises(BadInput, match="changed_after and joint exclude each other"):
            handlers(store).history({"changed_after": "1", "joint": "1"})
