"""The arithmetic of cursors: every entry once and in order, and another log is never taken for the same."""

from hypothesis import given
from hypothesis import strategies as st

from monitor.plant.cursor import AnotherLog, Continues, Cursor, Disordered, Entry, step

LOGS = st.lists(st.integers(1, 400), unique=True, min_size=1, max_size=20).map(sorted)


def answer(log, cursor, limit, name="a"):
    return [Entry(seq, f"{name}{seq}", seq) for seq in log if seq > cursor.asks_after][:limit]


@given(log=LOGS, limits=st.lists(st.integers(2, 7), min_size=30, max_size=30), lost=st.sets(st.integers(0, 29)))
def test_every_entry_comes_once_and_in_order_whatever_the_pages_and_whatever_was_lost(log, limits, lost):
    """A page that is lost before its transaction leaves the cursor where it was, and is asked for again."""
    cursor, copied, gaps = Cursor(), [], []
    for number, limit in enumerate([*limits, *[7] * len(log)]):
        found = step(cursor, "one", "one", answer(log, cursor, limit))
        assert isinstance(found, Continues)
        if number in lost:
            continue
        copied += [entry.content for entry in found.new]
        gaps += [number for first, last in found.missing for number in range(first, last + 1)]
        cursor = found.cursor
    assert copied == log
    assert gaps == sorted(set(range(1, log[-1])) - set(log))  # what nobody numbered is named, and once


@given(log=LOGS, kept=st.integers(0, 19), more=st.integers(0, 60))
def test_a_log_that_was_restored_is_another_one_however_far_it_has_come_since(log, kept, more):
    """Also where nothing says so: its numbers went back and were given out again, to other entries."""
    copied = step(Cursor(), None, None, answer(log, Cursor(), 1000))
    back = [Entry(seq, f"a{seq}", seq) for seq in log[:kept]]
    if kept >= len(log):
        return
    first = (log[kept - 1] if kept else 0) + 1
    again = [*back, *(Entry(seq, f"b{seq}", seq) for seq in range(first, first + more))]
    found = step(copied.cursor, None, None, [entry for entry in again if entry.seq > copied.cursor.asks_after])
    assert isinstance(found, AnotherLog)


def test_another_identity_is_another_log_although_the_entries_agree():
    """And an unknown identity leaves the entries to decide."""
    entries = [Entry(3, "x", 3)]
    assert isinstance(step(Cursor(3, "x"), "one", "two", entries), AnotherLog)
    assert step(Cursor(3, "x"), None, "two", entries) == Continues((), Cursor(3, "x"))


def test_an_answer_whose_numbers_do_not_rise_is_no_log():
    """Nothing of it is taken: a page twice, a number twice, or one from before the question."""
    for numbers in ([2, 1], [2, 2], [1, 2, 1]):
        assert isinstance(step(Cursor(), None, None, [Entry(n, str(n), n) for n in numbers]), Disordered)
    assert isinstance(step(Cursor(9, "9"), None, None, [Entry(4, "4", 4)]), Disordered)
