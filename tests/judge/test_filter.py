"""Properties of the filter: what it equals, and what it must never do."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, History, fresh, identification, weather

from monitor.errors import BadConfiguration
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import (
    LEVELS,
    LOG_RISE,
    NOISE,
    RATE,
    SLOPE,
    STATES,
    STEP,
    WEAR,
    FilterState,
    predict_filter,
)
from monitor.judge.drift.observation import observe
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.learn import learn
from monitor.judge.temperature.laws import TemperatureSettings

LAWS = TemperatureSettings()


def predicted(state: FilterState, days: float) -> FilterState:
    """The filter of six joints after the given number of days, without a count of revolutions."""
    return predict_filter(state, np.full(6, days), 6, DriftSettings())


@st.composite
def beliefs(draw: st.DrawFn) -> Belief:
    """Any mean, and any covariance: nearly certain, nearly diffuse, correlated or singular."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([0.1, 1e-3, 0.02, 0.01, 1e-4, 0.01, 1.0, 1.0, 1.0, 1.0]) * 10.0 ** rng.uniform(-2, 1, size=STATES)
    root = rng.normal(size=(6, STATES, draw(st.integers(1, STATES)))) * scale[:, None]  # rank 1…S
    before = fresh()
    filter_state = replace(before.filter_state, mean=rng.normal(size=(6, STATES)) * scale, cov=root @ np.swapaxes(root, 1, 2))
    return replace(before, filter_state=filter_state)


def least_eigenvalue(cov: np.ndarray) -> np.ndarray:
    """(J,) smallest eigenvalue of covariances scaled to unit diagonals, so that rounding does not depend on units."""
    d = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-300))
    return np.linalg.eigvalsh(cov / d[:, :, None] / d[:, None, :])[:, 0]


def moved(days: float, rho_held: float) -> np.ndarray:
    F = np.eye(STATES)
    F[WEAR, RATE], F[NOISE, NOISE] = days, rho_held
    return F


@given(belief=beliefs(), days=st.floats(0.0, 1000.0))
def test_a_prediction_never_reduces_the_uncertainty(belief, days):
    """It adds to the variance of every combination of states; level and slopes stay, wear grows at its rate, noise decays."""
    after = predicted(belief.filter_state, days)
    # the autocorrelation before it is learnt; the same rise every day is less and less of its logarithm
    F = np.array([moved(days, 0.5**days)] * belief.joints)  # (J, S, S)
    grown = np.exp(np.clip(belief.wear, *LOG_RISE))
    later = np.clip(grown + days * belief.filter_state.mean[:, RATE], *np.exp(LOG_RISE))
    F[:, WEAR, RATE], F[:, WEAR, WEAR] = days / later, grown / later
    before = F @ belief.filter_state.cov @ np.swapaxes(F, 1, 2)  # what certain motion alone would do
    rounding = 1e-9 * np.max(np.abs(before), initial=1e-12)
    assert np.all(np.linalg.eigvalsh(after.cov - before) >= -rounding)
    expected = np.einsum("jab,jb->ja", F, belief.filter_state.mean)
    expected[:, WEAR] = np.log(later)
    assert np.allclose(after.mean, expected, rtol=1e-9, atol=1e-12)


@given(belief=beliefs(), seed=st.integers(0, 1000), days=st.floats(0.01, 30.0))
@pytest.mark.slow
def test_an_update_never_raises_the_uncertainty_unless_a_change_was_detected(belief, seed, days):
    """An ordinary update shrinks every variance; the covariance stays symmetric and positive semi-definite in every case.

    A fall that is moved out of wear into the levels is a detected change of the levels: they take over the variance of wear.
    """
    at = belief.at_unix_s + days * DAY_S
    before = predicted(belief.filter_state, (at - belief.at_unix_s) / DAY_S)
    after = learn(
        belief, Arm(seed=seed).replay(31.0, 0.1 * (seed % 7)), CONTEXT, at, settings=DriftSettings(settle_replays=0), laws=LAWS
    ).belief.filter_state
    assert np.array_equal(after.cov, np.swapaxes(after.cov, 1, 2))
    assert np.all(least_eigenvalue(after.cov) >= -1e-6)  # singular priors and 10 orders of magnitude leave that much rounding
    before_falls, falls = belief.filter_state.counted_from.moved, after.counted_from.moved
    calm = (after.event != STEP) & (falls == before_falls)
    shrunk = np.diagonal(after.cov - before.cov, axis1=1, axis2=2)[calm]
    assert np.all(shrunk <= 1e-9 * np.diagonal(before.cov, axis1=1, axis2=2)[calm])


@given(belief=beliefs(), split=st.floats(0.05, 0.95))
def test_predicting_a_month_equals_predicting_its_two_halves(belief, split):
    """The random walk of the rate is integrated over time, and not added once for each step."""
    once = predicted(belief.filter_state, 30.0)
    twice = predicted(predicted(belief.filter_state, split * 30.0), (1.0 - split) * 30.0)
    scale = np.sqrt(np.einsum("jaa,jbb->jab", once.cov, once.cov)) + 1e-30
    assert np.allclose(once.cov / scale, twice.cov / scale, atol=1e-9)  # rounding
    assert np.allclose(once.mean, twice.mean, rtol=1e-9, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), days=st.floats(0.0, 100.0))
def test_a_fleets_filter_equals_filterpys(seed, days):
    """The algebra on arrays for a fleet equals filterpy's predict and update for one arm, to rounding."""
    from monitor.judge.drift import kalman

    rng = np.random.default_rng(seed)
    N = 4 * kalman.ONE_ARM
    root = rng.normal(size=(N, STATES, STATES)) * 10.0 ** rng.uniform(-3, 0, size=STATES)[:, None]
    mean, cov = rng.normal(size=(N, STATES)), root @ np.swapaxes(root, 1, 2)
    F, Q = np.tile(moved(days, 0.7), (N, 1, 1)), np.tile(1e-4 * np.eye(STATES), (N, 1, 1))
    y, R, H = rng.normal(size=N), 10.0 ** rng.uniform(-6, 0, size=N), rng.normal(size=(N, STATES))
    one = slice(0, kalman.ONE_ARM)
    for many, few in (
        (kalman.predict(mean, cov, F, Q), kalman.predict(mean[one], cov[one], F[one], Q[one])),
        (kalman.update(mean, cov, y, R, H), kalman.update(mean[one], cov[one], y[one], R[one], H[one])),
    ):
        largest = np.max(np.abs(cov)) + np.max(np.abs(few[1]))
        assert np.allclose(many[0][one], few[0], rtol=1e-7, atol=1e-7)  # gains of up to 10⁶ lose as many digits
        assert np.allclose(many[1][one], few[1], atol=1e-9 * largest)


def test_the_filter_equals_the_joint_gaussian_of_all_replays():
    """After 15 irregular replays the filter's last state equals one large Gaussian conditioned on all of them at once."""
    settings = DriftSettings(gate_sigma=20.0, shift_sigma=20.0, pace_sigma=20.0, settle_replays=0, memory_replays=1e5, between_replays=1e4)
    rng, arm = np.random.default_rng(5), Arm(seed=5)
    days = np.cumsum(rng.uniform(0.8, 1.2, size=15))
    belief = fresh(settings)
    x, P = belief.filter_state.mean[0].copy(), belief.filter_state.cov[0].copy()
    rows, ys, Rs, means, blocks = [], [], [], [], {}
    previous = 0.0
    for k, day in enumerate(days):
        seen = arm.replay(weather(day, rng) * np.ones(6), 0.001 * day)
        before = belief.filter_state
        rho, var, dt = before.autocorrelation(6, settings)[0], before.noise_var(6, settings)[0], day - previous
        previous = day
        # the state at k in terms of that at k−1, and what is added
        F = moved(dt, rho ** (dt / before.interval_days[0]))
        Q = np.zeros((STATES, STATES))
        q, walk = settings.rate_walk_per_sqrt_day**2, settings.wear_walk_per_sqrt_day**2
        Q[:2, :2] = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) + np.diag([walk * dt, 0.0])
        Q[NOISE, NOISE] = var * (1 - F[NOISE, NOISE] ** 2)
        x, P = F @ x, F @ P @ F.T + Q
        means.append(x)
        blocks[k, k] = P
        for i in range(k):
            blocks[k, i] = F @ blocks[k - 1, i]
        observed, t = observe(seen, settings), seen.temperature_c[0] - before.origin_c[0]
        H = np.zeros(STATES)
        H[[WEAR, NOISE, LEVELS]], H[SLOPE], H[SLOPE + 1] = 1.0, -t, t * t
        rows.append(H)
        ys.append(observed.log_torque[0])
        Rs.append(observed.variance[0] + settings.between_floor**2)
        belief = learn(belief, seen, CONTEXT, START_S + day * DAY_S, settings=settings, laws=LAWS).belief
    n = len(days)
    mean, cov = np.concatenate(means), np.zeros((STATES * n, STATES * n))
    for (k, i), block in blocks.items():
        cov[STATES * k : STATES * (k + 1), STATES * i : STATES * (i + 1)] = block
        cov[STATES * i : STATES * (i + 1), STATES * k : STATES * (k + 1)] = block.T
    H = np.zeros((n, STATES * n))
    for k, row in enumerate(rows):
        H[k, STATES * k : STATES * (k + 1)] = row
    S = H @ cov @ H.T + np.diag(Rs)
    K = np.linalg.solve(S, H @ cov).T
    mean, cov = mean + K @ (np.array(ys) - H @ mean), cov - K @ H @ cov
    std = np.sqrt(np.diag(cov)[-STATES:])
    assert np.allclose(belief.filter_state.mean[0], mean[-STATES:], atol=1e-4 * std)  # a diffuse level costs the batch five digits
    assert np.allclose(belief.filter_state.cov[0], cov[-STATES:, -STATES:], atol=1e-4 * np.outer(std, std))


def test_a_month_without_replays_changes_only_the_uncertainty_and_the_wear_at_its_rate():
    """30 days without a replay leave level, slope and rate, and raise the uncertainty of wear."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    after = predicted(before.filter_state, 30.0)
    assert np.array_equal(after.mean[:, LEVELS], before.filter_state.mean[:, LEVELS])
    assert np.allclose(after.wear, before.wear + 30 * before.filter_state.mean[:, RATE], atol=1e-15)  # goes on at its rate
    assert np.all(after.wear_std**2 > 1.3 * before.wear_std**2)


@pytest.mark.parametrize("wrong", [{"reference_speed_rad_s": 1.5}, {"settle_replays": -1}, {"autocorrelation": 0.97}, {"between_std": 0.0}])
def test_settings_out_of_range_are_named(wrong):
    """The message begins with the key as it stands in the file."""
    with pytest.raises(BadConfiguration, match=f"drift.{next(iter(wrong))}"):
        DriftSettings(**wrong)


def test_unresolved_friction_is_nan():
    """Negative, uncertain and slow joints give NaN; the others give their logarithm."""
    cov = np.zeros((6, 2, 2))
    cov[:, 0, 0] = 0.01
    cov[1, 0, 0] = 4.0
    seen = replace(
        identification(np.array([5.0, 5.0, -1.0, 5.0, np.nan, 5.0]), np.ones(6), cov, np.full(6, 30.0)),
        max_speed_rad_s=np.array([1.0, 1.0, 1.0, 0.3, 1.0, 1.0]),
    )
    observed = observe(seen, DriftSettings())
    assert np.array_equal(np.isfinite(observed.log_torque), [True, False, False, False, False, True])
    assert observed.log_torque[0] == pytest.approx(np.log(5.4))
    assert observed.variance[0] == pytest.approx(0.01 / 5.4**2)


def test_replays_within_minutes_do_not_make_every_later_one_a_holiday():
    """Five replays within half an hour, as at commissioning, then one a day: the usual interval is a day again within weeks."""
    days = [*(5.0 * k / 1440.0 for k in range(5)), *np.arange(1.0, 41.0)]
    arm, history = Arm(seed=6), History()
    for day in days:
        history.add(day, arm.replay(30.0))
    assert history.last.belief.filter_state.interval_days == pytest.approx(1.0, rel=0.15)
