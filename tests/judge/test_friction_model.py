"""The model that judges friction: its algebra against dense linear algebra and filterpy, its promise of false alarms, its cases."""

import doctest
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import monitor.judge.friction.step as friction
from monitor.judge.friction.beside import model_beside, observations_beside
from monitor.judge.friction.decision import DecisionSettings
from monitor.judge.friction.noise import Kind, NoisePriors, noise_of_fleet
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.posterior import Mixture
from monitor.judge.friction.states import LEVEL, NOISE, RATE, WEAR, Priors, row, viscous_distance
from monitor.judge.friction.step import FrictionModel, initial_state, may_have_moved, refer, rescale_use, step

STEADY = Kind(0.5, kappa=0.0, steady_replays=1e9, arm_steady_replays=1e9, weight=1.0)
J = 6
KNOWN = NoisePriors(kinds=(STEADY,), std_replays=1e9, clip=1e9)  # σ 2 %, ρ 0.5, and nothing to learn of them


def seen(log_torque, *, temperature_c=30.0, warming=0.0, std=0.004):
    """An observation of joints (A·J,)."""
    N = len(log_torque)
    torque = np.exp(np.nan_to_num(log_torque))
    return Observation(
        log_torque=np.asarray(log_torque, dtype=float),
        variance=np.full(N, std**2),
        temperature_c=np.broadcast_to(np.asarray(temperature_c, dtype=float), N).copy(),
        viscous_share=np.full(N, 0.5),
        warming_k_per_min=np.broadcast_to(np.asarray(warming, dtype=float), N).copy(),
        coulomb_nm=0.5 * torque,
        viscous_nm_s_per_rad=torque,
    )


def noise(rng, days, joints, *, std=0.02, rho=0.5):
    """(D, N) first-order noise, stationary from the first day."""
    x = std * rng.normal(size=(days, joints))
    for k in range(1, days):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * x[k]
    return x


def lived(y, model, *, temperature_c=30.0, every=None, **options):
    """The state after all replays of y (D, A·J), once a day."""
    A = y.shape[1] // J
    temperature_c = np.broadcast_to(np.asarray(temperature_c, dtype=float), y.shape)
    state = initial_state(seen(y[0], temperature_c=temperature_c[0]), J, model)
    for day, values in enumerate(y):
        replay = seen(values, temperature_c=temperature_c[day])
        state = step(state, replay, np.full(A, float(day > 0)), model, in_place=True, **options)
        if every:
            every(day, state)
    return state


def test_the_example_of_the_step_runs():
    assert doctest.testmod(friction).attempted > 5
    assert doctest.testmod(friction).failed == 0


def test_the_evidence_of_a_change_is_that_of_the_whole_series_with_and_without_it():
    """Of every candidate: the density of all replays with a change of unknown size over that without one, by dense covariances."""
    rng = np.random.default_rng(4)
    D = 14
    y = noise(rng, D, J) + 1.0
    y[8:, 2] += 0.05
    model = FrictionModel(noise=KNOWN, states=Priors(level_walk=0.0), decision=DecisionSettings(false_alarms_per_year=1e-9))
    temperature = 30.0 + rng.normal(size=(D, J))
    state = lived(y, model, temperature_c=temperature)
    lr = state.bank.evidence(np.full(len(state.replays), 1e9), model.changes)
    lr -= (np.log(np.maximum(state.bank.days, 1e-30))[:, None] + np.log(model.changes.shares)[:, None]).astype(
        np.float32
    )  # what is left is LR alone
    first, at = initial_state(seen(y[0], temperature_c=temperature[0]), J, model), 2
    t = viscous_distance(temperature[:, at], first.origin_c[at])
    H = np.array([row(t[d : d + 1], np.zeros(1), np.full(1, float(d)), np.zeros(1, int), 1, model.states)[:, 0] for d in range(D)])
    P0 = first.P[0, :, :, at].copy()
    P0[NOISE, NOISE] = 0.0
    days = np.arange(D)
    of_noise = first.scale[0, at] * 0.5 ** np.abs(days[:, None] - days)
    base = H @ P0 @ H.T + of_noise + 0.004**2 * np.eye(D)
    mean = H @ np.where(np.arange(len(P0)) == LEVEL, y[0, at], first.x[0, :, at])
    alike = 0
    for place, born in enumerate(state.bank.born):
        for sort, shape in enumerate(((days >= born) * 1.0, (days >= born) * 1.0, np.maximum(days - born, 0.0))):
            if born < 0 or not shape.any():
                continue
            changed = base + model.changes.variances[sort, 0] * np.outer(shape, shape)
            dense = log_density(y[:, at] - mean, changed) - log_density(y[:, at] - mean, base)
            assert lr[0, place, sort, at] == pytest.approx(dense, abs=2e-2)
            alike += 1
    assert alike == 3 * D - 1


def log_density(e, S):
    """Of a Gaussian, up to a constant."""
    return -0.5 * (np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e))


PEAKS = st.lists(st.floats(0.0, 1e9), min_size=2 * J, max_size=2 * J)


@given(PEAKS, PEAKS, st.integers(0, J - 1), st.lists(st.booleans(), min_size=J, max_size=J))
def test_a_change_is_to_stand_out_from_what_chance_did_to_the_other_joints_and_in_the_other_direction(less, more, j, counted):
    decision, age = DecisionSettings(), np.full((1, 1, J), 100.0)
    before, counted = np.array(less).reshape(2, 1, J), np.array([counted])
    factors = decision.by_chance(before, counted, age)
    assert (factors >= 1.0).all()
    own = before.copy()
    own[0, 0, j] = 1e12  # its own rise
    assert decision.by_chance(own, counted, age)[0, 0, j] == factors[0, 0, j]
    after = np.maximum(before, np.array(more).reshape(2, 1, J))
    assert (decision.by_chance(after, counted, age) >= factors).all()
    assert (decision.by_chance(before, np.zeros_like(counted), age) == 1.0).all()  # of joints that are known to be worn nothing is chance


def test_the_first_winter_is_no_wear_though_grease_thickens_as_no_law_of_the_model_says():
    rng, days, A = np.random.default_rng(3), 300, 12
    season = 34.0 - 20.0 * np.sin(np.pi * np.clip(np.arange(days) - 150, 0, 150) / 150)  # °C: summer, then down to 14 in the first winter
    T = season[:, None] + 3.0 * rng.normal(size=(days, A * J))
    thickness = np.exp(4500.0 * (1.0 / (273.0 + T) - 1.0 / 303.0))  # Arrhenius: 5 % a kelvin
    share = rng.uniform(0.3, 0.6, A * J)
    y = np.log(1.0 - share + share * thickness) + noise(rng, days, A * J, std=0.006)
    told = np.zeros(A * (J + 1), dtype=bool)

    def every(day, state):
        told[:] |= state.risen

    lived(y, FrictionModel(), temperature_c=T, every=every)
    assert told.sum() <= 1


def test_a_kinds_filter_is_that_of_filterpy():
    from filterpy.kalman import predict, update

    rng = np.random.default_rng(5)
    D = 30
    y, temperature = noise(rng, D, J) + 2.0, 30.0 + 3.0 * rng.normal(size=(D, J))
    model = FrictionModel(noise=KNOWN, decision=DecisionSettings(false_alarms_per_year=1e-9))
    state = lived(y, model, temperature_c=temperature)
    first, j = initial_state(seen(y[0], temperature_c=temperature[0]), J, model), 3
    x, P = first.x[0, :, j].copy(), first.P[0, :, :, j].copy()
    x[LEVEL] = y[0, j]
    F, Q = np.eye(len(x)), np.zeros_like(P)
    F[WEAR, RATE], F[NOISE, NOISE], Q[NOISE, NOISE] = 1.0, 0.5, 0.75 * first.scale[0, j]
    Q[LEVEL, LEVEL] = model.states.level_walk**2
    t = viscous_distance(temperature[:, j], first.origin_c[j])
    for d in range(D):
        if d:
            x, P = predict(x, P, F, Q)
        H = row(t[d : d + 1], np.zeros(1), np.full(1, float(d)), np.zeros(1, int), 1, model.states)[:, 0]
        x, P = update(x, P, np.array([y[d, j]]), np.array([[0.004**2]]), H[None])
    assert state.x[0, :, j] == pytest.approx(x, rel=1e-6, abs=1e-9)
    assert state.P[0, :, :, j] == pytest.approx(P, rel=1e-5, abs=1e-10)


def test_while_nothing_changes_the_odds_are_no_larger_than_the_days_that_have_passed():
    """Pollak (1985): R less the days is a martingale, so its mean over many joints cannot exceed them, where σ and ρ are known."""
    rng = np.random.default_rng(6)
    A, D = 160, 60
    model = FrictionModel(noise=KNOWN, states=Priors(level_walk=0.0), decision=DecisionSettings(false_alarms_per_year=1e-9))
    state = lived(noise(rng, D, A * J), model)
    lr = state.bank.evidence(np.full(len(state.replays), 1e9), model.changes)
    R = np.exp(lr[0]).sum(axis=(0, 1))[state.joints]
    assert len(R) == A * J
    assert 0.5 * D < R.mean() < D + 4.0 * R.std() / np.sqrt(len(R))


def test_a_step_is_found_in_its_joint_and_its_size_is_known():
    rng = np.random.default_rng(7)
    y = noise(rng, 160, 4 * J)
    y[100:, 9] += np.log(1.08)
    found = []
    model = FrictionModel()
    state = lived(y, model, every=lambda day, s: found.append(s.risen.copy()))
    risen = np.array(found).reshape(-1, 4, J + 1)
    assert [tuple(each) for each in np.argwhere(risen[-1])] == [(1, 3)]
    assert not risen[:100].any()
    assert risen[112].any()
    wear, var = state.wear(model).moments()
    assert wear.reshape(4, J + 1)[1, 3] == pytest.approx(np.log(1.08), abs=3.0 * np.sqrt(var.reshape(4, J + 1)[1, 3]))


def test_what_all_joints_share_is_no_wear_of_any():
    y = noise(np.random.default_rng(8), 160, 3 * J)
    y[100:, J : 2 * J] += 0.06
    common = []
    state = lived(y, FrictionModel(), every=lambda day, s: common.append(s.told.common[0].copy()))
    assert np.array(common).any(axis=0).tolist() == [False, True, False]
    assert not state.risen.reshape(3, J + 1)[:, :J].any()


def test_wear_counts_from_the_friction_after_new_grease():
    """A fall moves exactly into the base: the rise that follows is told though friction is still below that of the beginning."""
    y = noise(np.random.default_rng(9), 260, 2 * J)
    y[80:, 4] -= 0.10
    y[160:, 4] += 0.06
    fell, risen = [], []
    model = FrictionModel()
    state = lived(y, model, every=lambda day, s: (fell.append(s.fell[4]), risen.append(s.risen[4])))
    assert fell[95]
    assert not any(risen[:160])
    assert risen[185]
    assert state.moved[4] == pytest.approx(-0.10, abs=0.025)


def test_one_arm_is_judged_alike_alone_and_in_a_fleet():
    y = noise(np.random.default_rng(10), 60, 3 * J)
    together, alone = lived(y, FrictionModel()), lived(y[:, J : 2 * J], FrictionModel())
    of = slice(J + 1, 2 * (J + 1))
    assert together.x[..., of] == pytest.approx(alone.x, abs=1e-12)
    assert together.odds[:, of] == pytest.approx(alone.odds, rel=1e-5)


def test_a_joint_that_was_not_resolved_and_an_arm_that_did_not_replay_keep_what_they_know():
    rng = np.random.default_rng(11)
    y, model = noise(rng, 40, 2 * J), FrictionModel()
    state = lived(y, model)
    values = y[-1].copy()
    values[2] = np.nan
    after = step(state, seen(values), np.array([1.0, 5.0]), model, replayed=np.array([True, False]))
    assert after.replays.tolist() == [41, 41, 40, 41, 41, 41, 41] + [40] * 7
    assert after.x[..., 7:] == pytest.approx(state.x[..., 7:])
    assert after.P[..., 7:] == pytest.approx(state.P[..., 7:])
    assert state.replays.max() == 40  # the state that was given is as it was
    assert np.isfinite(after.x).all()


def test_a_temperature_that_nobody_measured_makes_the_replay_less_sure():
    rng = np.random.default_rng(12)
    y, temperature, model = noise(rng, 60, J), 30.0 + 5.0 * rng.normal(size=(60, J)), FrictionModel()
    state = lived(y, model, temperature_c=temperature)
    both = [step(state, seen(y[-1], temperature_c=T), np.ones(1), model) for T in (30.0, np.nan)]
    var = [each.friction(each.reference_c, model).moments()[1][:J] for each in both]
    assert np.isfinite(both[1].x).all()
    assert var[1].mean() > var[0].mean()


def test_a_joint_that_was_replaced_begins_anew_and_no_other_does():
    y, model = noise(np.random.default_rng(13), 60, J), FrictionModel()
    y[40:, 1] += 0.2
    state = lived(y, model)
    assert state.risen[1]
    new = np.arange(J) == 1
    after = step(state, seen(np.where(new, 5.0, y[-1])), np.ones(1), model, replaced=new)
    assert not after.risen[1]
    assert after.replays[1] == 1
    assert after.replays[0] == 61


def test_a_context_that_returns_has_its_level():
    """The level of the second context is 30 % higher; nothing is wear, neither there nor back."""
    y, model = noise(np.random.default_rng(14), 150, J), FrictionModel()
    state, seen_before = initial_state(seen(y[0]), J, model, levels=2), False
    for day in range(150):
        second = 60 <= day < 100
        values = y[day] + 0.3 * second
        opened = np.array([second and not seen_before])
        seen_before |= second
        state = step(state, seen(values), np.full(1, float(day > 0)), model, slot=np.array([int(second)]), opened=opened)
        assert not state.risen.any()
        assert not state.fell.any()
    mean, _ = state.friction(state.reference_c, model).moments()
    assert mean[:J] == pytest.approx(np.zeros(J), abs=0.02)


def test_a_level_of_another_context_is_as_sure_as_it_was_where_no_production_was_observed():
    model, y = FrictionModel(), noise(np.random.default_rng(18), 60, J)
    state = initial_state(seen(y[0]), J, model, levels=2)
    for day in range(60):
        state = step(state, seen(y[day]), np.array([float(day > 0)]), model, slot=np.array([int(day < 30)]), in_place=True)
        if day == 30:
            before = state.P[:, -1, -1].copy()
    assert (state.P[:, -1, -1] <= before + 1e-12).all()  # the walk of a production that there is not would add 3e-5


def test_days_that_go_backwards_are_refused():
    model = FrictionModel()
    state = initial_state(seen(np.zeros(J)), J, model)
    with pytest.raises(ValueError, match=r"arm 0 of 1: -1\.0; expected 0 or more"):
        step(state, seen(np.zeros(J)), np.array([-1.0]), model)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 12), st.floats(0.02, 0.98), st.integers(0, 10_000))
def test_a_quantile_of_a_mixture_is_where_so_much_of_it_lies_below(parts, share, seed):
    rng = np.random.default_rng(seed)
    weight = rng.random((parts, 3)) + 1e-3
    mixture = Mixture(weight=weight / weight.sum(axis=0), mean=rng.normal(size=(parts, 3)), var=rng.random((parts, 3)) + 1e-4)
    assert mixture.below(mixture.quantile(share)) == pytest.approx(np.full(3, share), abs=1e-9)
    draws = rng.choice(parts, 40_000, p=mixture.weight[:, 0] / mixture.weight[:, 0].sum())
    sample = mixture.mean[draws, 0] + np.sqrt(mixture.var[draws, 0]) * rng.normal(size=len(draws))
    assert mixture.moments()[0][0] == pytest.approx(sample.mean(), abs=5.0 * sample.std() / 200.0)


def test_noise_that_wanders_in_every_joint_is_believed_and_in_one_joint_it_is_not():
    rng = np.random.default_rng(15)
    model = FrictionModel(decision=replace(DecisionSettings(), false_alarms_per_year=1e-9))
    slow = np.array([kind.kappa > 0 and not np.isfinite(kind.period_days) for kind in model.noise.kinds])
    wandering = noise(rng, 250, J, rho=np.exp(-1 / 50.0))
    white = noise(rng, 250, J, rho=0.1)
    all_wander, one = lived(white + wandering, model), lived(white + wandering * (np.arange(J) == 0), model)
    assert all_wander.p[slow][:, :J].sum(axis=0).min() > 0.8
    assert one.p[slow][:, 1:J].sum(axis=0).max() < 0.2


@pytest.mark.parametrize("joints", [1, 2, 7])
def test_whatever_a_replay_holds_the_state_stays_finite(joints):
    """Unresolved joints, temperatures unknown or absurd, variances of nothing, pauses of any length, gross outliers, contexts in turn."""
    rng, model = np.random.default_rng(16), FrictionModel()
    A, N = 2, 2 * joints
    state = None
    for replay in range(150):
        y = 0.02 * rng.normal(size=N) + np.where(rng.random(N) < 0.05, rng.choice([-3.0, np.nan, 3.0], N), 0.0)
        observation = seen(y, temperature_c=rng.choice([-10.0, 30.0, 31.0, 90.0, np.nan], N), warming=rng.choice([0.0, 1.0, np.nan], N))
        observation = observation._replace(
            variance=rng.choice([0.0, 1e-12, 1e-5, np.nan], N), viscous_share=rng.choice([0.0, 0.5, np.nan], N)
        )
        state = state or initial_state(observation, joints, model, levels=3)
        replaced = rng.random(N) < 0.005
        contexts = {"slot": rng.integers(0, 3, A), "opened": np.full(A, replay < 3), "replayed": rng.random(A) < 0.9}
        state = step(state, observation, rng.choice([0.0, 1e-4, 1.0, 200.0], A), model, replaced=replaced, in_place=True, **contexts)
    assert np.isfinite(state.x).all()
    assert (np.einsum("hiin->hin", state.P) > -1e-9).all()
    assert state.p.sum(axis=0) == pytest.approx(np.ones(A * (joints + 1)))
    mean, var = state.friction(state.reference_c, model).moments()
    assert np.isfinite(mean).all()
    assert (var[state.joints] > 0.0).all()


def worked(rng, *, wear=0.0, of_production=0.0, days=260, onset=200, every=30):
    """Four arms that replay every 30 days and work every day, and what was told of the first joint of the first, day by day."""
    A, model = 4, FrictionModel()
    replays, work = noise(rng, days, A * J, std=0.012), noise(rng, days, A * J, std=0.015) + 0.3
    for each, more in ((replays, wear), (work, wear + of_production)):
        each[onset:, 0] += more
    state, told, last = initial_state(seen(replays[0]), J, model, levels=2), [], 0
    for day in range(days):
        if day < 30 or day % every == 0:
            state = step(state, seen(replays[day]), np.full(A, float(day - last)), model, in_place=True)
            last = day
        state = step(
            state, seen(work[day]), np.full(A, 0.5 if last == day else float(day + 0.5 - last)), model, production=True, in_place=True
        )
        last = day + 0.5
        told.append((bool(state.risen[0]), bool(state.unconfirmed[0]), bool(np.delete(state.risen, 0).any())))
    return np.array(told)


def test_production_finds_between_rare_replays_what_a_joint_has_lost_and_says_that_no_replay_has_confirmed_it():
    told = worked(np.random.default_rng(5), wear=0.08)
    first = int(np.argmax(told[:, 0]))
    assert 200 <= first <= 210  # the next replay is on day 210
    assert told[first, 1]
    assert told[-1, 0]
    assert not told[-1, 1]
    assert not told[:, 2].any()


def test_a_replay_takes_back_what_production_alone_has_found():
    told = worked(np.random.default_rng(6), of_production=0.08)
    assert told[205:210, 0].any()
    assert not told[-1, 0]
    assert not told[:, 2].any()


def test_what_was_found_says_when_it_began_whether_at_once_and_by_which_odds():
    rng, days = np.random.default_rng(8), 260
    y = noise(rng, days, 2 * J, std=0.01)
    y[150:, 2] += 0.10
    y[60:, J + 3] += 0.30 / 365.0 * np.arange(days - 60)
    found = {}

    def every(day, state):
        for n in np.flatnonzero(state.told.rises):
            found.setdefault(int(n), (day, deepcopy(state.found)))

    lived(y, FrictionModel(), every=every)
    (day, step_), (later, slow) = found[2], found[J + 1 + 3]
    assert abs(day - step_.began_days[2] - 150) <= 3.0 * step_.began_std[2] + 1.0 < 30.0
    assert step_.at_once[2] > 0.7
    assert step_.odds[2] >= step_.needed[2] >= DecisionSettings().limits(J)[0]
    n = J + 1 + 3
    assert abs(later - slow.began_days[n] - 60) <= 3.0 * slow.began_std[n] + 5.0
    assert slow.at_once[n] < 0.5


def test_of_a_joint_that_was_worked_on_nothing_is_told_until_its_friction_is_known_and_what_it_was_before_proves_nothing():
    rng, days, model = np.random.default_rng(9), 140, FrictionModel()
    y = noise(rng, days, J, std=0.01)
    y[100:, 1] -= 0.20
    y[130:, 1] += 0.10
    state = initial_state(seen(y[0]), J, model)
    for day in range(days):
        if day == 100:
            may_have_moved(state, np.array([1]), model)
        waiting = np.arange(J) == 1 if 100 <= day < 105 else None
        state = step(state, seen(y[day]), np.array([float(day > 0)]), model, awaiting_proof=waiting, in_place=True)
        if day == 104:
            assert not state.risen.any()
            wear, var = state.wear(model).moments()
            assert abs(wear[1] + 0.20) < 3.0 * np.sqrt(var[1])
            refer(state, np.array([1]))
    assert np.flatnonzero(state.risen).tolist() == [1]  # it counts from the friction after the work
    wear, var = state.wear(model).moments()
    assert abs(wear[1] - 0.10) < 3.0 * np.sqrt(var[1])


@given(st.floats(0.2, 5.0))
@settings(max_examples=10, deadline=None)
def test_a_usual_day_of_twice_the_use_wears_twice_as_much(factor):
    rng, model = np.random.default_rng(10), FrictionModel()
    y = noise(rng, 200, J, std=0.005)
    y[60:, 0] += 0.3 / 365.0 * np.arange(140)
    state = lived(y, model)
    ahead, other = deepcopy(state), deepcopy(state)
    rescale_use(other, np.full(J + 1, factor))
    nothing = seen(np.full(J, np.nan))
    ahead = step(ahead, nothing, np.array([10.0]), model)
    other = step(other, nothing, np.array([10.0]), model, use=np.full(J, 10.0 / factor))
    np.testing.assert_allclose(other.x[:, WEAR], ahead.x[:, WEAR], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(other.P[:, WEAR, WEAR], ahead.P[:, WEAR, WEAR], rtol=1e-5, atol=1e-12)


def test_wear_that_only_other_speeds_or_one_place_show_is_found_by_the_same_model_on_other_series():
    rng, days, A = np.random.default_rng(12), 140, 3
    y, at_slow, rest = noise(rng, days, A * J), noise(rng, days, A * J, std=0.01), noise(rng, days, A * J, std=0.05)
    at_slow[100:, 1] += 0.15
    rest[100:, J + 4] += 0.7
    states, first = {}, {}
    for day in range(days):
        replay = seen(y[day])._replace(log_torque_slow=y[day] + at_slow[day] + 0.3, residual_rms_nm=np.exp(rest[day] - 2.0))
        for name, observation in observations_beside(replay).items():
            model = model_beside(name)
            state = states.get(name) or initial_state(observation, J, model)
            states[name] = step(state, observation, np.full(A, float(day > 0)), model, in_place=True)
            for n in np.flatnonzero(states[name].risen):
                first.setdefault((name, int(n)), day)
    assert set(first) == {("slow", 1), ("residual", J + 1 + 4)}  # contrast is what it was
    assert all(100 <= day <= 112 for day in first.values())


def test_a_fleet_teaches_the_noise_of_its_next_arm():
    rng, model, days = np.random.default_rng(14), FrictionModel(), 200
    fleet = lived(noise(rng, days, 30 * J, std=0.04, rho=0.82), model)
    learnt = noise_of_fleet(fleet.p, fleet.scale, J, model.noise)
    assert learnt.std == pytest.approx(0.04 * np.sqrt((1.0 - 0.82**2) / 0.75), rel=0.35)
    weights, before = (np.array([kind.weight for kind in priors.kinds]) for priors in (learnt, model.noise))
    lasting = [kind.rho >= 0.6 for kind in model.noise.kinds]
    assert weights.sum() == pytest.approx(1.0)
    assert weights[lasting].sum() > 0.6 > (before / before.sum())[lasting].sum()
    nothing = noise_of_fleet(fleet.p[:, :0], fleet.scale[:, :0], J, model.noise)
    assert nothing.std == pytest.approx(model.noise.std)


@pytest.mark.parametrize("wear", [0.08, 0.15])
def test_two_joints_that_wear_at_once_are_both_found(wear):
    rng, days = np.random.default_rng(16), 200
    y = noise(rng, days, J, std=0.01)
    y[150:, [1, 2]] += wear
    first = {}

    def every(day, state):
        for n in np.flatnonzero(state.risen):
            first.setdefault(int(n), day)

    lived(y, FrictionModel(), every=every)
    assert set(first) == {1, 2}
    assert max(first.values()) <= 175
