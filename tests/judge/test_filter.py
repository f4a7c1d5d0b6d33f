"""Properties of the filters of friction: what they equal, and what they must never do."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, History, fresh, identification

from monitor.errors import BadConfiguration
from monitor.judge.friction.decision import DecisionSettings
from monitor.judge.friction.noise import Kind, NoisePriors
from monitor.judge.friction.observation import Observation, observe
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.friction.states import LEVEL, NOISE, RATE, SLOPE, WEAR, row, viscous_distance
from monitor.judge.friction.step import FrictionState, initial_state, step
from monitor.judge.learn import learn
from monitor.judge.settings import AssessSettings

SETTINGS = AssessSettings()
MODEL = SETTINGS.friction
J = 6


def observation(seed: int = 0, *, silent: bool = False) -> Observation:
    """One replay of six joints; silent: it resolves none of them."""
    rng = np.random.default_rng(seed)
    y = 2.0 + 0.05 * rng.normal(size=J)
    return Observation(
        log_torque=np.full(J, np.nan) if silent else y,
        variance=np.full(J, 1e-5),
        temperature_c=30.0 + 3.0 * rng.normal(size=J),
        viscous_share=np.full(J, 0.4),
        warming_k_per_min=np.zeros(J),
        coulomb_nm=0.6 * np.exp(y),
        viscous_nm_s_per_rad=np.exp(y),
    )


@st.composite
def states(draw: st.DrawFn) -> FrictionState:
    """Any means, and any covariances: nearly certain, nearly diffuse, correlated or singular."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    state = initial_state(observation(), J, MODEL)
    state = step(state, observation(), np.zeros(1), MODEL)
    H, D, N = state.x.shape
    scale = np.array([0.1, 1e-3, 0.02, 1e-4, 1e-6, 0.05, 1e-3, 0.05, 0.02, 0.02, 0.02, 1.0]) * 10.0 ** rng.uniform(-2, 0.5, size=D)
    root = rng.normal(size=(H, D, draw(st.integers(1, D)), N)) * scale[:, None, None]  # rank 1…D
    state.P = np.einsum("hikn,hjkn->hijn", root, root)
    state.x = rng.normal(size=state.x.shape) * scale[:, None]
    state.replays[:] = 50.0
    return state


def least_eigenvalue(P: np.ndarray) -> np.ndarray:
    """(H, N) smallest eigenvalue of covariances scaled to unit diagonals, so that rounding does not depend on units."""
    cov = np.moveaxis(P, -1, 1)
    d = np.sqrt(np.maximum(np.diagonal(cov, axis1=2, axis2=3), 1e-300))
    return np.linalg.eigvalsh(cov / d[..., :, None] / d[..., None, :])[..., 0]


def later(state: FrictionState, days: float) -> FrictionState:
    """The state after so many days, and a replay that resolved nothing."""
    return step(state, observation(silent=True), np.array([days]), MODEL)


@given(state=states(), days=st.floats(0.0, 1000.0))
@settings(max_examples=25, deadline=None)
def test_time_alone_never_makes_the_joint_better_known(state, days):
    """Levels and slopes stay, wear goes on at its rate, and no level, slope or rate is surer than before."""
    after = later(state, days)
    kept = [RATE, *range(SLOPE, NOISE)]
    assert np.array_equal(after.x[:, kept], state.x[:, kept])
    assert np.array_equal(after.x[:, LEVEL:], state.x[:, LEVEL:])
    variance, before = (np.einsum("hiin->hin", each.P)[:, [*kept, LEVEL]] for each in (after, state))
    assert np.all(variance >= before * (1.0 - 1e-12))
    slowed = np.exp(-np.clip(state.x[:, WEAR], -3.0, 3.0)) * days
    assert after.x[:, WEAR] == pytest.approx(state.x[:, WEAR] + state.x[:, RATE] * slowed)
    assert np.all(least_eigenvalue(after.P) >= -1e-6)


@given(state=states(), seed=st.integers(0, 1000), days=st.floats(0.01, 30.0))
@settings(max_examples=25, deadline=None)
def test_a_replay_in_which_no_change_was_found_never_makes_a_joint_less_known(state, seed, days):
    """Every variance shrinks, and the covariances stay symmetric and positive semi-definite."""
    before = later(state, days)
    after = step(before, observation(seed), np.zeros(1), MODEL)
    assert np.allclose(after.P, after.P.swapaxes(1, 2), rtol=1e-9, atol=1e-12)
    assert np.all(least_eigenvalue(after.P) >= -1e-6)  # singular priors and 10 orders of magnitude leave that much rounding
    calm = ~(after.told.rises | after.told.falls | np.repeat(after.told.common.any(axis=0), J + 1)) & state.joints
    was, now = (np.einsum("hiin->hin", each.P)[:, :, calm] for each in (before, after))
    assert np.all(now <= was * (1.0 + 1e-9) + 1e-15)


@given(state=states(), split=st.floats(0.05, 0.95))
@settings(max_examples=25, deadline=None)
def test_a_month_is_its_two_halves(state, split):
    """What walks is integrated over time, and not added once for each step. Joints whose wear goes on are left out: it slows down."""
    state.x[:, [WEAR, RATE]] = state.P[:, WEAR] = state.P[:, RATE] = state.P[:, :, WEAR] = state.P[:, :, RATE] = 0.0
    once, twice = later(state, 30.0), later(later(state, split * 30.0), (1.0 - split) * 30.0)
    variance = np.einsum("hiin->hin", once.P) + 1e-30
    scale = np.sqrt(variance[:, :, None] * variance[:, None])
    assert np.allclose(once.P / scale, twice.P / scale, atol=1e-9)  # rounding
    assert np.allclose(once.x, twice.x, rtol=1e-9, atol=1e-12)


def test_the_filter_equals_the_joint_gaussian_of_all_replays():
    """After 15 irregular replays the last state equals one large Gaussian conditioned on all of them at once; noise is known here."""
    kind = Kind(0.5, steady_replays=1e9, arm_steady_replays=1e9, weight=1.0)
    noise, never = NoisePriors(kinds=(kind,), std_replays=1e9, clip=1e9), DecisionSettings(learning_replays=1000, suspicions_per_year=1e-9)
    model = replace(MODEL, noise=noise, decision=never)
    rng = np.random.default_rng(5)
    days = np.cumsum(rng.uniform(0.3, 3.0, size=15))
    seen = [observation(k) for k in range(15)]
    state, previous = initial_state(seen[0], J, model), days[0]
    first, j, scale = deepcopy(state), 2, state.scale[0, 2]
    for day, each in zip(days, seen, strict=True):
        state = step(state, each, np.array([day - previous]), model)
        previous = day
    t = np.array([viscous_distance(each.temperature_c[j], first.origin_c[j]) for each in seen])
    age = days - days[0]
    H = np.array([row(t[k : k + 1], np.zeros(1), age[k : k + 1], np.zeros(1, int), 1, model.states)[:, 0] for k in range(15)])
    P0 = first.P[0, :, :, j].copy()
    P0[NOISE, NOISE] = 0.0
    apart = np.minimum(age[:, None], age)
    within = scale * 0.5 ** np.abs(age[:, None] - age) + model.states.level_walk**2 * apart + 1e-5 * np.eye(15)
    S = H @ P0 @ H.T + within
    x0 = first.x[0, :, j].copy()
    x0[LEVEL] = seen[0].log_torque[j]
    y = np.array([each.log_torque[j] for each in seen])
    kept = [SLOPE, SLOPE + 1]  # the level walks, and the noise fades: slope and curve are as they were
    gain = np.linalg.solve(S, H @ P0[:, kept]).T
    mean, cov = x0[kept] + gain @ (y - H @ x0), P0[np.ix_(kept, kept)] - gain @ H @ P0[:, kept]
    assert state.x[0, kept, j] == pytest.approx(mean, rel=1e-3)  # a diffuse level costs the batch some digits
    assert state.P[0][np.ix_(kept, kept)][..., j] == pytest.approx(cov, rel=1e-3, abs=1e-9 * cov[0, 0])


def test_a_month_without_replays_changes_only_the_uncertainty_and_the_wear_at_its_rate():
    """30 days without a replay leave level and slope, let wear go on at its rate, and make wear less certain."""
    history = History()
    for day in range(150):
        history.add(day, Arm(seed=day, noise=0.01).replay(30.0, np.array([0, 0.002 * max(day - 60, 0), 0, 0, 0, 0])))
    before = history.last.belief.friction
    assert before.risen[1]
    after = later(before, 30.0)
    assert np.array_equal(after.x[:, LEVEL:], before.x[:, LEVEL:])
    assert np.array_equal(after.x[:, RATE], before.x[:, RATE])
    grown, was = ((each.p * each.x[:, WEAR]).sum(axis=0)[1] for each in (after, before))
    assert grown - was == pytest.approx(np.log1p(0.060 / (1.0 + 0.002 * 89)), abs=0.02)
    assert np.all(after.P[:, WEAR, WEAR, 1] > before.P[:, WEAR, WEAR, 1])  # by the rate's doubt: wear has no walk beside it


@pytest.mark.parametrize("wrong", [{"reference_speed_rad_s": 1.5}, {"baseline_replays": 0}, {"between_std": 0.0}])
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


def test_replays_within_minutes_prove_no_more_than_one_of_them():
    """Thirty within half an hour, as at commissioning, all 6 % up: what lasts for minutes is noise that lasts, and no rise."""
    arm, history = Arm(seed=6, noise=0.01), History()
    for day in range(60):
        history.add(day, arm.replay(30.0))
    for k in range(30):
        history.add(60.0 + k / 1440.0, arm.replay(30.0, np.array([0, 0, 0.06, 0, 0, 0])))
    for day in range(61, 70):
        history.add(day, arm.replay(30.0))
    told = [(day, kind, joint) for day, kind, joint, *_ in history.transitions]
    assert not [one for one in told if one[0] > 61.0 and one[1] == "raised"]
    assert abs(history.last.belief.wear[2]) < 0.02


def test_a_belief_learns_alike_from_a_copy_of_itself():
    """Nothing of a state is used up by learning from it."""
    belief, arm = fresh(), Arm(seed=1)
    for day in range(5):
        belief = learn(belief, arm.replay(30.0), CONTEXT, START_S + day * DAY_S, SETTINGS).belief
    seen = arm.replay(31.0, 0.1)
    one, other = (learn(belief, seen, CONTEXT, START_S + 5 * DAY_S, SETTINGS).belief for _ in range(2))
    assert one.as_document() == other.as_document()
