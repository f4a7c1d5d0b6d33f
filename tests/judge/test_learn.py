"""The filter: what it must equal, what it must never do, and what it does when a replay is odd."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_arm import CONTEXT, COULOMB_NM, DAY_S, START_S, Arm, History, identification, weather

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.alerts.why_not import why_not_alerting
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.drift.filter_state import (
    LEVELS,
    LOG_RISE,
    NOISE,
    OUTLIER,
    RATE,
    SLOPE,
    STATES,
    STEP,
    UNRESOLVED,
    WEAR,
    FilterState,
    predict_filter,
)
from monitor.judge.drift.observation import observe
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.learn import begin, learn
from monitor.judge.temperature.laws import TemperatureSettings

LAWS = TemperatureSettings()


def fresh(settings: DriftSettings | None = None, temperature_c: float = 30.0) -> Belief:
    return begin("ur5", CONTEXT, Arm().replay(temperature_c), START_S, settings=settings or DriftSettings(), laws=LAWS)


def predicted(state: FilterState, days: float) -> FilterState:
    """The filter of six joints so many days later, where nobody counts revolutions."""
    return predict_filter(state, np.full(6, days), 6, DriftSettings())


@st.composite
def beliefs(draw: st.DrawFn) -> Belief:
    """Any mean, any covariance from nearly sure to nearly ignorant, correlated or singular."""
    dice = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([0.1, 1e-3, 0.02, 0.01, 1e-4, 0.01, 1.0, 1.0, 1.0, 1.0]) * 10.0 ** dice.uniform(-2, 1, size=STATES)
    root = dice.normal(size=(6, STATES, draw(st.integers(1, STATES)))) * scale[:, None]  # rank 1…S
    before = fresh()
    filter_state = replace(before.filter_state, mean=dice.normal(size=(6, STATES)) * scale, cov=root @ np.swapaxes(root, 1, 2))
    return replace(before, filter_state=filter_state)


def least_eigenvalue(cov: np.ndarray) -> np.ndarray:
    """(J,) of the covariances scaled to unit diagonals, so that rounding is the same for every unit."""
    d = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-300))
    return np.linalg.eigvalsh(cov / d[:, :, None] / d[:, None, :])[:, 0]


def moved(days: float, rho_held: float) -> np.ndarray:
    F = np.eye(STATES)
    F[WEAR, RATE], F[NOISE, NOISE] = days, rho_held
    return F


@given(belief=beliefs(), days=st.floats(0.0, 1000.0))
def test_silence_never_makes_us_surer(belief, days):
    """Ageing adds to the variance of every combination of states; level, slopes and rate stay, wear goes on, noise fades."""
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
def test_looking_never_makes_us_less_sure_unless_something_jumped(belief, seed, days):
    """An ordinary update shrinks every variance; the covariance stays symmetric and positive semi-definite whatever comes."""
    at = belief.at_unix_s + days * DAY_S
    before = predicted(belief.filter_state, (at - belief.at_unix_s) / DAY_S)
    after = learn(
        belief, Arm(seed=seed).replay(31.0, 0.1 * (seed % 7)), CONTEXT, at, settings=DriftSettings(settle_replays=0), laws=LAWS
    ).belief.filter_state
    assert np.array_equal(after.cov, np.swapaxes(after.cov, 1, 2))
    assert np.all(least_eigenvalue(after.cov) >= -1e-6)  # singular priors and 10 orders of magnitude leave that much rounding
    calm = after.event != STEP
    shrunk = np.diagonal(after.cov - before.cov, axis1=1, axis2=2)[calm]
    assert np.all(shrunk <= 1e-9 * np.diagonal(before.cov, axis1=1, axis2=2)[calm])


@given(belief=beliefs(), split=st.floats(0.05, 0.95))
def test_a_month_is_its_two_halves(belief, split):
    """Ageing composes: the noise of a wandering rate is integrated, not added a step."""
    once = predicted(belief.filter_state, 30.0)
    twice = predicted(predicted(belief.filter_state, split * 30.0), (1.0 - split) * 30.0)
    scale = np.sqrt(np.einsum("jaa,jbb->jab", once.cov, once.cov)) + 1e-30
    assert np.allclose(once.cov / scale, twice.cov / scale, atol=1e-9)  # rounding
    assert np.allclose(once.mean, twice.mean, rtol=1e-9, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), days=st.floats(0.0, 100.0))
def test_a_fleets_filter_is_filterpys(seed, days):
    """The algebra on arrays that a fleet goes through gives filterpy's predict and update, of one arm or of many, to rounding."""
    from monitor.judge.drift import kalman

    dice = np.random.default_rng(seed)
    N = 4 * kalman.ONE_ARM
    root = dice.normal(size=(N, STATES, STATES)) * 10.0 ** dice.uniform(-3, 0, size=STATES)[:, None]
    mean, cov = dice.normal(size=(N, STATES)), root @ np.swapaxes(root, 1, 2)
    F, Q = np.tile(moved(days, 0.7), (N, 1, 1)), np.tile(1e-4 * np.eye(STATES), (N, 1, 1))
    y, R, H = dice.normal(size=N), 10.0 ** dice.uniform(-6, 0, size=N), dice.normal(size=(N, STATES))
    one = slice(0, kalman.ONE_ARM)
    for many, few in (
        (kalman.predict(mean, cov, F, Q), kalman.predict(mean[one], cov[one], F[one], Q[one])),
        (kalman.update(mean, cov, y, R, H), kalman.update(mean[one], cov[one], y[one], R[one], H[one])),
    ):
        largest = np.max(np.abs(cov)) + np.max(np.abs(few[1]))
        assert np.allclose(many[0][one], few[0], rtol=1e-7, atol=1e-7)  # gains of up to 10⁶ lose as many digits
        assert np.allclose(many[1][one], few[1], atol=1e-9 * largest)


def test_the_filter_is_the_joint_gaussian_of_all_replays():
    """After 15 irregular replays the filter's last state equals conditioning one big Gaussian on all of them at once."""
    settings = DriftSettings(gate_sigma=20.0, shift_sigma=20.0, pace_sigma=20.0, settle_replays=0, memory_replays=1e5, between_replays=1e4)
    dice, arm = np.random.default_rng(5), Arm(seed=5)
    days = np.cumsum(dice.uniform(0.8, 1.2, size=15))
    belief = fresh(settings)
    x, P = belief.filter_state.mean[0].copy(), belief.filter_state.cov[0].copy()
    rows, ys, Rs, means, blocks = [], [], [], [], {}
    previous = 0.0
    for k, day in enumerate(days):
        seen = arm.replay(weather(day, dice) * np.ones(6), 0.001 * day)
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


def test_a_month_of_silence_moves_only_the_doubt():
    """30 days without a replay leave the level, slope and rate, and widen the doubt of wear."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    after = predicted(before.filter_state, 30.0)
    assert np.array_equal(after.mean[:, LEVELS], before.filter_state.mean[:, LEVELS])
    assert np.allclose(after.wear, before.wear + 30 * before.filter_state.mean[:, RATE], atol=1e-15)  # goes on at its rate
    assert np.all(after.wear_std**2 > 1.3 * before.wear_std**2)


def test_a_belief_cannot_be_aged_backwards():
    """Time before the belief's is a broken promise, and said so."""
    with pytest.raises(BadInput, match="before it"):
        learn(fresh(), Arm().replay(30.0), CONTEXT, START_S - 1.0, settings=DriftSettings(), laws=LAWS)


def test_one_wild_replay_teaches_nothing_and_is_told():
    """A replay 40 % off (4σ is 8 %) leaves every mean where ageing put it; the joint is named."""
    history = History()
    for day in range(20):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    wild = history.add(20, Arm(seed=99).replay(30.0, np.array([0, 0.4, 0, 0, 0, 0])))
    assert wild.belief.event[1] == OUTLIER
    assert np.allclose(wild.belief.filter_state.mean[1], predicted(before.filter_state, 1.0).mean[1])
    assert any(warning.code == "outlier" and "joint 2" in warning.text for warning in wild.warnings)
    assert wild.health.joints[1].state == "CHECK_FUNCTION"
    calm = history.add(21, Arm(seed=21).replay(30.0))
    assert calm.health.joints[1].state == "NORMAL"
    assert not history.told


def test_three_wild_replays_on_one_side_are_a_step():
    """A 40 % jump that stays is believed at the third replay, to within 3 σ of one replay (6 %)."""
    history = History()
    for day in range(20):
        history.add(day, Arm(seed=day).replay(30.0))
    for day in range(20, 23):
        last = history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0.4, 0, 0, 0, 0])))
    assert last.belief.event[1] == STEP
    assert abs(last.friction[1].wear - 0.4) < 0.4 * 0.06 + 0.06
    assert all(abs(joint.wear) < 0.03 for joint in last.friction if joint.joint != 2)  # nobody else moved


def test_wild_replays_on_both_sides_are_no_step():
    """Up, down, up: bad data, and the joint stays where it was."""
    history = History()
    for day in range(20):
        history.add(day, Arm(seed=day).replay(30.0))
    for day, wear in enumerate((0.4, -0.3, 0.4, -0.3), start=20):
        last = history.add(day, Arm(seed=day).replay(30.0, np.array([0, wear, 0, 0, 0, 0])))
        assert last.belief.event[1] == OUTLIER
    assert abs(last.friction[1].wear) < 0.03


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_the_noise_between_replays_is_learnt(noise):
    """After 150 quiet replays the noise believed is the noise there is, to 30 % averaged over the joints (it started at 2 %)."""
    history, arm = History(), Arm(seed=3, noise=noise)
    for day in range(150):
        history.add(day, arm.replay(30.0))
    assert np.mean(history.last.belief.noise_std(DriftSettings())) == pytest.approx(noise, rel=0.3)


def test_noise_that_lasts_is_learnt_as_such():
    """ρ = 0.5 is told from ρ = 0 by the mean over the joints after 150 replays (σ of that mean is about 0.03)."""
    learnt = {}
    for rho in (0.0, 0.5):
        history, arm = History(), Arm(seed=4, autocorrelation=rho)
        for day in range(150):
            history.add(day, arm.replay(30.0))
        learnt[rho] = float(np.mean(history.last.belief.filter_state.autocorrelation(6, DriftSettings())))
    assert learnt[0.0] < 0.2
    assert learnt[0.5] > 0.3


def test_the_temperature_slope_is_learnt():
    """A year's weather shows how joint 1's friction falls, within 3 σ as believed and 0.15 %/K."""
    history, arm, dice = History(), Arm(seed=7), np.random.default_rng(7)
    for day in range(0, 365, 2):
        history.add(day, arm.replay(weather(day, dice)))
    belief = history.last.belief
    fv = arm.viscous * np.exp(-0.015 * (belief.reference_temperature_c - 25.0)) * 0.4
    truth = 0.015 * fv / (COULOMB_NM + fv)
    error = np.abs(belief.slope - truth)
    assert np.all(error < 3 * np.sqrt(belief.filter_state.cov[:, SLOPE, SLOPE]))
    assert np.all(error < 0.0015)


def test_a_new_payload_keeps_the_wear_and_says_so():
    """A changed context forgets the level, not the wear; the next wear is seen against the new level."""
    history = History()
    for day in range(60):
        history.add(day, Arm(seed=day, noise=0.005).replay(30.0, np.array([0, 0, 0.002 * day, 0, 0, 0])))
    before = history.last.friction[2].wear
    assert before > 0.08  # 11.8 % were there
    heavier = replace(CONTEXT, payload_kg=3.0)
    loaded = Arm(seed=60, noise=0.005).replay(30.0, 0.3 + 0.0 * COULOMB_NM)  # a payload that raises friction by 30 %
    after = history.add(60, loaded, heavier)
    assert after.friction[2].wear == pytest.approx(before, abs=0.01)
    assert all(abs(joint.wear) < 0.02 for joint in after.friction if joint.joint != 3)
    [warning] = [warning for warning in after.warnings if warning.code == "context_changed"]
    assert "payload_kg 0.0 → 3.0" in warning.text
    assert [opened.replays for opened in after.belief.contexts] == [60, 1]
    again = history.add(61, Arm(seed=61, noise=0.005).replay(30.0, 0.3), heavier)
    assert not [warning for warning in again.warnings if warning.code == "context_changed"]


def test_a_context_known_to_the_gram_is_the_same():
    """The same payload read back with rounding opens no new context; an unknown one does."""
    history = History()
    history.add(0, Arm().replay(30.0), replace(CONTEXT, payload_kg=1.2))
    same = history.add(1, Arm().replay(30.0), replace(CONTEXT, payload_kg=1.2000001))
    other = history.add(2, Arm().replay(30.0), replace(CONTEXT, payload_kg=None))
    assert len(same.belief.contexts) == 1
    assert len(other.belief.contexts) == 2


def test_a_joint_that_says_nothing_is_left_as_it_was():
    """A joint that did not reach the reference speed is aged, not learnt, and checked."""
    history = History()
    for day in range(5):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    slow = replace(Arm(seed=5).replay(30.0), max_speed_rad_s=np.array([2.0, 2.0, 2.0, 0.1, 2.0, 2.0]))
    after = history.add(5, slow)
    assert after.belief.event[3] == UNRESOLVED
    assert np.array_equal(after.belief.filter_state.mean[3], predicted(before.filter_state, 1.0).mean[3])
    assert after.health.joints[3].state == "CHECK_FUNCTION"


def test_without_temperatures_we_are_less_sure_and_raise_nothing():
    """No sensor: 15 % more friction could be a cold morning; it is learnt with doubt and told."""
    with_t, without = History(), History()
    for day in range(40):
        seen = Arm(seed=day).replay(30.0, 0.15 if day > 20 else 0.0)
        with_t.add(day, seen)
        blind = without.add(day, replace(seen, temperature_c=None))
        if day == 2:  # later the scatter that is seen decides how sure one may be
            assert np.all(
                blind.belief.reference_torque_nm(DriftSettings())[1] > 1.2 * with_t.last.belief.reference_torque_nm(DriftSettings())[1]
            )
    assert with_t.told
    assert any(warning.code == "temperature_unknown" for warning in blind.warnings)
    # but that nothing can be told is told, once, of the arm; and asked for a joint, the reason is the right one
    assert [(kind, joint, condition) for _, kind, joint, condition, _ in without.told] == [("raised", None, "temperature_sensor")]
    assert without.health.state == "CHECK_FUNCTION"
    reasons = " ".join(why_not_alerting(without.health, blind.belief, 3, HealthSettings()))
    assert "does not tell this joint's temperature" in reasons
    assert "outside the temperatures" not in reasons


def test_the_belief_survives_as_json():
    """Through JSON text and back, the belief gives bit for bit the same next assessment."""
    import json

    history, dice = History(), np.random.default_rng(2)
    for day in range(8):
        history.add(day, Arm(seed=day).replay(weather(day, dice)))
    kept = history.last.belief
    history.last = replace(history.last, belief=belief_from_document(json.loads(json.dumps(kept.as_document(), allow_nan=False))))
    there = history.add(8, Arm(seed=8).replay(28.0)).belief
    history.last = replace(history.last, belief=kept)
    straight = history.add(8, Arm(seed=8).replay(28.0)).belief
    assert json.dumps(there.as_document()) == json.dumps(straight.as_document())


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        ({"schema_version": 99}, "schema_version is 99"),
        ({"track": {}}, "track: the key"),
        ({"temperature_c": "much"}, "temperature_c is not an array"),
        ({"viscous": {}}, "viscous: the key"),
        ({"replays": "many"}, "many"),
    ],
)
def test_a_spoilt_belief_is_refused_by_the_name_of_its_key(spoil, says):
    """No half-read state: what is wrong is said."""
    document = {**fresh().as_document(), **spoil}
    with pytest.raises(BadInput, match=says):
        belief_from_document(document)


def test_a_belief_without_a_key_is_refused():
    """A missing key is named."""
    document = fresh().as_document()
    del document["track"]["noise_weight"]
    with pytest.raises(BadInput, match="'noise_weight' is missing"):
        belief_from_document(document)


@pytest.mark.parametrize("wrong", [{"reference_speed_rad_s": 1.5}, {"gate_run": 1}, {"autocorrelation": 0.85}, {"between_std": 0.0}])
def test_settings_out_of_range_are_named(wrong):
    """The message begins with the key as it stands in the file."""
    with pytest.raises(BadConfiguration, match=f"drift.{next(iter(wrong))}"):
        DriftSettings(**wrong)


def test_friction_that_is_not_resolved_is_not_seen():
    """Negative, uncertain and slow joints give NaN; the others their logarithm."""
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


def test_a_context_seen_before_has_its_baseline_back():
    """Two payloads in turn: 30 % more friction under the second is neither wear nor learnt twice; wear that came meanwhile is seen."""
    history, heavier = History(), replace(CONTEXT, payload_kg=3.0)
    for day in range(60):
        loaded = day % 20 >= 10
        wear = np.array([0, 0, 0.1 * (day >= 45), 0, 0, 0])
        history.add(day, Arm(seed=day, noise=0.005).replay(30.0, 1.3 * (1 + wear) - 1 if loaded else wear), heavier if loaded else CONTEXT)
    assert [opened.replays for opened in history.last.belief.contexts] == [30, 30]
    assert history.last.friction[2].wear == pytest.approx(0.1, abs=0.02)
    assert all(abs(joint.wear) < 0.02 for joint in history.last.friction if joint.joint != 3)
    level = np.exp(history.last.belief.level())
    back = history.add(60, Arm(seed=60, noise=0.005).replay(30.0, np.array([0, 0, 0.1, 0, 0, 0])))
    assert np.allclose(np.exp(back.belief.level()), level / 1.3, rtol=0.02)
    [warning] = [warning for warning in back.warnings if warning.code == "context_changed"]
    assert "known from before" in warning.text


def test_a_fifth_context_takes_the_place_of_the_one_longest_away():
    """Four baselines are kept; the ledger remembers all, and says which have lost theirs."""
    history = History()
    for day, payload in enumerate([0.0, 1.0, 2.0, 3.0, 0.0, 4.0, 0.0]):
        last = history.add(day, Arm(seed=day).replay(30.0), replace(CONTEXT, payload_kg=payload))
    assert [(opened.context.payload_kg, opened.slot) for opened in last.belief.contexts] == [
        (1.0, None),
        (2.0, 2),
        (3.0, 3),
        (4.0, 1),
        (0.0, 0),
    ]


@pytest.mark.parametrize("firmware", ["URSoftware 5.11.0.108249 (Feb 2021)", "5.11.00.108249", " 5.11.0.108249 "])
def test_a_firmware_is_its_version_however_it_is_spelt(firmware):
    """One differing blank or word opens no context; another version does."""
    history = History()
    history.add(0, Arm().replay(30.0), replace(CONTEXT, firmware="5.11.0.108249"))
    assert len(history.add(1, Arm().replay(30.0), replace(CONTEXT, firmware=firmware)).belief.contexts) == 1
    assert len(history.add(2, Arm().replay(30.0), replace(CONTEXT, firmware="5.12.0.108249")).belief.contexts) == 2


def test_a_wild_first_replay_is_no_wear_of_all_that_follow():
    """The first replay 40 % low, the rest as they should be: the baseline begins again, no joint is called worn."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, -0.4 * (day == 0), 0, 0, 0, 0])))
    assert abs(history.last.friction[1].wear) < 0.03
    assert history.told == []


def test_a_fast_warm_up_is_told_from_wear():
    """The grease lags behind the sensor by 3 minutes: replays that warm at 1 K/min show 2 % more friction, and none of it is wear."""
    history, dice = History(), np.random.default_rng(4)
    for day in range(60):
        warming = 1.2 * (day >= 30) * dice.uniform(0.5, 1.0)
        colder = Arm(seed=day, noise=0.005).replay(32.0 - 3.0 * warming)
        seen = replace(colder, temperature_c=np.full(6, 32.0), warming_k_per_min=np.full(6, warming))
        last = history.add(day, seen)
    assert any(warning.code == "warming_fast" for warning in last.warnings)
    assert np.max(np.abs(last.belief.wear)) < 0.01
    assert history.told == []


@pytest.mark.parametrize("seed", range(3))
def test_fast_wear_is_followed(seed):
    """2 % a day from day 40 on: ten days later the wear told is within 2.5 of its standard deviations, and within 4 %."""
    history, arm, dice = History(), Arm(seed=seed, noise=0.01), np.random.default_rng(seed)
    for day in range(51):
        history.add(day, arm.replay(weather(day, dice), np.array([0, 0, 0.02 * max(0, day - 40), 0, 0, 0])))
    told = history.last.friction[2]
    assert told.wear == pytest.approx(0.20, abs=0.04)
    assert abs(told.wear - 0.20) < 2.5 * told.wear_std


def test_a_belief_of_the_last_release_is_carried_over():
    """Schema 2 knew no use and no bins, and the rate of the logarithm: wear, level and rate of friction are what they were."""
    belief = fresh()
    for day in range(12):
        at = belief.at_unix_s + DAY_S
        belief = learn(belief, Arm(seed=day).replay(30.0, 0.1 * (day > 8)), CONTEXT, at, settings=DriftSettings(), laws=LAWS).belief
    old = copy.deepcopy(belief.as_document())
    for law in ("viscous", "coulomb"):
        del old[law]["bins"]
    del old["usage"]
    for opened in old["contexts"]:
        for added in ("joint_serials", "maintenance", "revolutions"):
            del opened["context"][added]
    for mean in old["track"]["mean"]:
        mean[RATE] /= np.exp(mean[WEAR])
    carried = belief_from_document({**old, "schema_version": 2})
    assert np.allclose(carried.rate()[0], belief.rate()[0], rtol=1e-12)
    assert np.array_equal(carried.wear, belief.wear)
    assert carried.contexts == belief.contexts
    assert np.isnan(carried.usage.per_day).all()
    onwards = learn(carried, Arm(seed=99).replay(30.0, 0.1), CONTEXT, carried.at_unix_s + DAY_S, settings=DriftSettings(), laws=LAWS).belief
    assert onwards.as_document()["schema_version"] == 4
    with pytest.raises(BadInput, match="not what schema_version 2 wrote"):
        belief_from_document({**old, "schema_version": 2, "track": {}})


def test_a_belief_of_an_older_release_is_refused_with_what_to_do():
    """Schema 1 cannot be carried over; the message says how the history is kept."""
    with pytest.raises(BadInput, match=r"schema_version is 1; this release reads 2 to 4\. .*joint-monitor assess"):
        belief_from_document({**fresh().as_document(), "schema_version": 1})
