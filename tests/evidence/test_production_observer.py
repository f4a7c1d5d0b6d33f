"""The observer who knows the world of work: its noise is that of the fleet, and its evidence that of a textbook."""

import numpy as np
import pytest

from evidence.production import Plan, ProductionSettings, observed_days
from evidence.production_observer import (
    EVERY_DAYS,
    KnownFleet,
    Seen,
    covariance,
    evidence,
    median_delay,
    nothing_seen,
    recorded,
    threshold,
)
from monitor.judge.settings import AssessSettings
from monitor.studies.figures import DAYS_A_YEAR
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.play import COMPARABLE

ARMS, DAYS = 12, 120


@pytest.fixture(scope="module")
def healthy():
    """A fleet without wear by a plan with replays and work, and what was seen of it."""
    settings = FleetSettings(arms=ARMS, days=DAYS, seed=12, scenarios=COMPARABLE)
    fleet = KnownFleet(settings, None, ProductionSettings())
    seen = nothing_seen(fleet, DAYS)
    judged = list(recorded(fleet, observed_days(fleet, DAYS, Plan(every_days=7, production=True), AssessSettings()), seen))
    return fleet, seen, judged


@pytest.mark.soak
def test_the_noise_that_the_observer_assumes_is_that_of_the_fleet(healthy):
    """White by the assumed covariance, the residuals of 72 joints have variance 1 and no correlation from one to the next, within 5 %."""
    fleet, seen, _ = healthy
    white, pairs = [], []
    for n in range(ARMS * fleet.joints):
        replays, production = (np.flatnonzero(np.isfinite(each[:, n])) for each in (seen.replay, seen.production))
        noise = covariance(
            replays.astype(float),
            seen.replay_var[replays, n],
            production.astype(float),
            float(seen.production_var[n]),
            fleet.settings,
            fleet.production,
        )
        y = np.concatenate([seen.replay[replays, n], seen.production[production, n] - seen.offset[n]])
        z = np.linalg.solve(np.linalg.cholesky(noise), y)
        white.append(z)
        pairs.append(z[1:] * z[:-1])
    z = np.concatenate(white)
    assert len(z) > 8000
    assert abs(np.mean(z**2) - 1.0) < 0.05
    assert abs(np.mean(np.concatenate(pairs))) < 0.05


@pytest.mark.soak
def test_the_observer_sees_what_the_judge_sees(healthy):
    """As many replays and days of work of each joint, but for the wild replays that it leaves out."""
    fleet, seen, judged = healthy
    for from_production, column in ((True, seen.production), (False, seen.replay)):
        of_judge = sum(np.isfinite(one.result.observation.log_torque).sum() for one in judged if one.from_production == from_production)
        assert 0.98 * of_judge <= np.isfinite(column).sum() <= of_judge
    blind = ~fleet.seen_at_work.ravel()
    assert np.isnan(seen.production[:, blind]).all()


def test_the_evidence_of_one_who_is_told_all_is_the_likelihood_ratio():
    """White noise, a replay a day and a joint that wears from day 20 on: log Σ over the starts of exp(Σ g·y/σ² − Σ g²/2σ²)."""
    days, per_day, fleet = 41, 0.4 / DAYS_A_YEAR, FleetSettings(autocorrelation=0.0, between_std=0.02)
    use = np.arange(days, dtype=float)[:, None]
    y = np.log1p(per_day * np.maximum(use - 20.0, 0.0))
    nothing = np.full((days, 1), np.nan)
    seen = Seen(y, np.zeros((days, 1)), nothing, np.zeros(1), use, use, use, use, np.zeros(1))
    found = evidence(seen, 0, fleet, ProductionSettings(), per_day).told
    g = np.log1p(per_day * np.maximum(use - np.arange(0, days, EVERY_DAYS), 0.0))
    ratio = (g * y - 0.5 * g * g).sum(axis=0) / 0.02**2
    assert found[-1] == pytest.approx(np.log(np.exp(ratio[g.any(axis=0)]).sum()))
    assert found[-1] > found[20]


def test_a_threshold_is_crossed_by_so_many_healthy_joints_and_delays_count_from_the_onset():
    statistics = np.zeros((5, 100))
    statistics[:, 80] = [1.0, 2.0, 3.0, 4.0, 5.0]
    statistics[:, 10] = 9.0  # while the arm is learnt
    above = threshold(statistics, 3)
    assert (statistics[:, 60:].max(axis=1) > above).sum() == 3
    assert median_delay(statistics, above, np.array([70.0, 70.0, 70.0, 70.0, 75.0])) == 11.0
    assert median_delay(statistics, above, np.array([70.0, 70.0, 70.0, 90.0, 75.0])) == np.inf
