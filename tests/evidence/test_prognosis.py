"""Metrics of prognosis on a trace whose figures are known, and that the monitor's lives reach what its page says."""

import numpy as np
import pytest

from .prognosis import Trace, alpha_lambda, convergence, cumulative_relative_accuracy, prognostic_horizon, relative_accuracy

SHARE = np.array([0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9])
TRACE = Trace(SHARE, np.array([2.0, 0.40, 0.52, 0.61, 0.38, 0.27, 0.105]))


def test_horizon_and_alpha_lambda_are_those_of_progpy():
    # progpy 1.9.0, ToEPredictionProfile of ScalarData: alpha_lambda(…, α = 0.2, β = 0.5), prognostic_horizon(within 0.2 of the event)
    assert [alpha_lambda(TRACE, at) for at in (0.25, 0.5, 0.75, 0.9)] == [False, False, True, True]
    assert prognostic_horizon(TRACE) == pytest.approx(0.6)


def test_the_horizon_begins_where_predictions_come_near_for_good():
    left = TRACE.left.copy()
    left[4] = 0.9  # far off once more
    assert prognostic_horizon(Trace(SHARE, left)) == pytest.approx(0.25)
    left[-1] = np.inf
    assert prognostic_horizon(Trace(SHARE, left)) == 0.0


def test_relative_accuracy_counts_what_was_left_and_only_where_a_date_was_given():
    left = TRACE.left.copy()
    left[0] = np.nan
    accuracy = relative_accuracy(Trace(SHARE, left))
    assert np.isnan(accuracy[0])
    assert accuracy[3] == pytest.approx(1.0 - 0.11 / 0.5)
    assert cumulative_relative_accuracy(Trace(SHARE, left)) == pytest.approx(accuracy[1:].mean())
    assert np.isnan(cumulative_relative_accuracy(Trace(SHARE, np.full(7, np.nan))))


def test_an_error_that_vanishes_at_once_converges_sooner_than_one_that_stays():
    soon, late = 1.0 - SHARE, 1.0 - SHARE
    soon[0] += 0.3
    late += 0.3
    assert convergence(Trace(SHARE, soon)) == pytest.approx(np.hypot(0.075, 0.15))  # the centre of one box, 0.15 wide and 0.3 high
    assert convergence(Trace(SHARE, late)) == pytest.approx(np.hypot(0.4, 0.15))
