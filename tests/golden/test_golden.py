"""A few replays, a small fleet, a small search and a continued history give what they gave when `expected/` was written.

After a change that is meant to change figures: `python -m tests.golden expected` prints what has changed and writes it anew.
"""

from itertools import islice

import pytest

from . import small
from .compare import differences

# Another processor's linear algebra adds in another order: the last bits of a figure, and what becomes of them, may differ. Figures that
# are a difference of nearly equal ones, such as the wear of a healthy joint, consist of such bits only: they are held to an absolute
# figure, far below what any unit here can mean. Everything else, words and counts, is the same.
RELATIVE, ABSOLUTE = 1e-6, 1e-9
SHOWN = 10


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One scratch folder and one set of recordings; commands run in this process."""
    run = small.run_in(tmp_path_factory.mktemp("golden"))
    yield run
    run.close()


def assert_as_expected(name: str, found: object) -> None:
    """Compare two documents; an error shows the first differences."""
    before = small.expected(name)
    assert before is not None, f"nothing is expected of {name}: python -m tests.golden expected"
    first_differences = list(islice(differences(before, found, relative=RELATIVE, absolute=ABSOLUTE), SHOWN))
    assert first_differences == []


def test_the_verdicts_of_two_weeks_are_unchanged(run):
    """Thirteen stepped replays of a simulated arm with damage of joint 3, through the command line."""
    assert_as_expected("assess", small.assessed(run))


def test_the_figures_of_a_small_fleet_are_unchanged(run):
    """Every arm's days of alerts, coverage and wear."""
    assert_as_expected("rehearse", small.rehearsed(run))


def test_a_small_search_finds_the_same_trajectory(run):
    """Coefficients, proof and figures of merit; a random one beside it."""
    assert_as_expected("design", small.designed(run))


def test_a_history_is_continued_and_every_verdict_is_recomputed(run):
    """Status, history and report before and after a restart with three more replays; then every verdict once more from its recording."""
    assert_as_expected("history", small.continued(run))
    again = small.recomputed(run)
    assert (again["assessments"], again["not_recomputable"], again["unknown_circumstances"]) == (small.CONTINUED, 0, 0)
    assert (again["changed_since"], again["differing"]) == ([], [])
