"""The filter: what it must equal, what it must never do, and what it does when a replay is odd."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_arm import CONTEXT, COULOMB_NM, DAY_S, START_S, Arm, History, identification, weather

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.belief import LEVEL, OUTLIER, RATE, SLOPE, STEP, UNSEEN, WEAR, Belief, belief_from_document
from monitor.judge.drift import aged, begin, learn, referred
from monitor.judge.evidence import DriftSettings, observe
from monitor.judge.temperature import TemperatureSettings

LAWS = TemperatureSettings()


def fresh(settings: DriftSettings | None = None, temperature_c: float = 30.0) -> Belief:
    return begin("ur5", CONTEXT, Arm().replay(temperature_c), START_S, settings=settings or DriftSettings(), laws=LAWS)


@st.composite
def beliefs(draw: st.DrawFn) -> Belief:
    """Any mean, any covariance from nearly sure to nearly ignorant, correlated or singular."""
    dice = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([1.0, 0.01, 0.1, 1e-3]) * 10.0 ** dice.uniform(-2, 1, size=4)
    root = dice.normal(size=(6, 4, draw(st.integers(1, 4)))) * scale[:, None]  # rank 1…4
    return replace(fresh(), mean=dice.normal(size=(6, 4)) * scale, cov=root @ np.swapaxes(root, 1, 2))


def least_eigenvalue(cov: np.ndarray) -> np.ndarray:
    """(J,) of the covariances scaled to unit diagonals, so that rounding is the same for every unit."""
    d = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-300))
    return np.linalg.eigvalsh(cov / d[:, :, None] / d[:, None, :])[:, 0]


@given(belief=beliefs(), days=st.floats(0.0, 1000.0))
def test_silence_never_makes_us_surer(belief, days):
    """Ageing widens the variance of every combination of states that wear goes on in: the level's is untouched, w's and ẇ's grow."""
    after = aged(belief, belief.at_unix_s + days * DAY_S, DriftSettings())
    F = np.eye(4)
    F[WEAR, RATE] = days
    moved = F @ belief.cov @ F.T  # what certain motion alone would do
    rounding = 1e-9 * np.max(np.abs(moved), initial=1e-12)
    assert np.all(np.linalg.eigvalsh(after.cov - moved) >= -rounding)
    assert np.allclose(after.mean[:, [LEVEL, SLOPE, RATE]], belief.mean[:, [LEVEL, SLOPE, RATE]])


@given(belief=beliefs(), seed=st.integers(0, 1000), days=st.floats(0.01, 30.0))
def test_looking_never_makes_us_less_sure_unless_something_jumped(belief, seed, days):
    """An ordinary update shrinks every variance; the covariance stays symmetric and positive semi-definite whatever comes."""
    at = belief.at_unix_s + days * DAY_S
    before = aged(belief, at, DriftSettings())
    after, _ = learn(
        belief, Arm(seed=seed).replay(31.0, 0.1 * (seed % 7)), CONTEXT, at, settings=DriftSettings(settle_replays=0), laws=LAWS
    )
    assert np.array_equal(after.cov, np.swapaxes(after.cov, 1, 2))
    assert np.all(least_eigenvalue(after.cov) >= -1e-6)  # singular priors and 10 orders of magnitude leave that much rounding
    calm = after.event != STEP
    shrunk = np.diagonal(after.cov - before.cov, axis1=1, axis2=2)[calm]
    assert np.all(shrunk <= 1e-9 * np.diagonal(before.cov, axis1=1, axis2=2)[calm])


@given(belief=beliefs(), split=st.floats(0.05, 0.95))
def test_a_month_is_its_two_halves(belief, split):
    """Ageing composes: the noise of a wandering rate is integrated, not added a step."""
    end = belief.at_unix_s + 30 * DAY_S
    once = aged(belief, end, DriftSettings())
    twice = aged(aged(belief, belief.at_unix_s + split * 30 * DAY_S, DriftSettings()), end, DriftSettings())
    scale = np.sqrt(np.einsum("jaa,jbb->jab", once.cov, once.cov)) + 1e-30
    assert np.allclose(once.cov / scale, twice.cov / scale, atol=1e-9)  # rounding
    assert np.allclose(once.mean, twice.mean, rtol=1e-12, atol=1e-12)


def test_the_filter_is_the_joint_gaussian_of_all_replays():
    """After 15 irregular replays the filter's last state equals conditioning one big Gaussian on all of them at once."""
    settings = DriftSettings(gate_sigma=1e6, cusum_limit=1e6, settle_replays=0)
    dice, arm = np.random.default_rng(5), Arm(seed=5)
    days = np.cumsum(dice.uniform(0.2, 9.0, size=15))
    belief = fresh(settings)
    prior_mean, prior_cov = belief.mean[0].copy(), belief.cov[0].copy()
    rows, ys, Rs = [], [], []
    steps = []
    previous = 0.0
    q, walk = settings.rate_walk_per_sqrt_day**2, settings.wear_walk_per_sqrt_day**2
    for day in days:
        seen = arm.replay(weather(day, dice) * np.ones(6), 0.001 * day)
        rho = max(belief.autocorrelation[0], 0)
        Rs.append(observe(seen, settings).variance[0] + belief.noise_var[0] * (1 + rho) / (1 - rho))
        ys.append(observe(seen, settings).log_torque[0])
        rows.append([1.0, -(seen.temperature_c[0] - belief.reference_temperature_c[0]), 1.0, 0.0])
        steps.append(day - previous)
        previous = day
        belief = learn(belief, seen, CONTEXT, START_S + day * DAY_S, settings=settings, laws=LAWS).belief
    # all states as one vector: x_k = F_k x_{k−1} + noise, stacked
    n = len(days)
    mean, cov = np.zeros(4 * n), np.zeros((4 * n, 4 * n))
    x, P = prior_mean, prior_cov
    for k, dt in enumerate(steps):
        F = np.eye(4)
        F[2, 3] = dt
        Q = np.zeros((4, 4))
        Q[2:, 2:] = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) + np.diag([walk * dt, 0.0])
        x, P = F @ x, F @ P @ F.T + Q
        here = slice(4 * k, 4 * k + 4)
        mean[here], cov[here, here] = x, P
        if k:
            cross = F @ cov[4 * k - 4 : 4 * k, : 4 * k]
            cov[here, : 4 * k], cov[: 4 * k, here] = cross, cross.T
    H = np.zeros((n, 4 * n))
    for k, row in enumerate(rows):
        H[k, 4 * k : 4 * k + 4] = row
    S = H @ cov @ H.T + np.diag(Rs)
    K = np.linalg.solve(S, H @ cov).T
    mean, cov = mean + K @ (np.array(ys) - H @ mean), cov - K @ H @ cov
    std = np.sqrt(np.diag(cov)[-4:])
    assert np.allclose(belief.mean[0], mean[-4:], atol=1e-5 * std)  # the diffuse level costs the batch solution five digits
    assert np.allclose(belief.cov[0], cov[-4:, -4:], atol=1e-5 * np.outer(std, std))


def test_another_reference_temperature_tells_the_same():
    """T0 is a way of speaking: the foreseen torque at any temperature and its variance do not depend on it."""
    history = History()
    dice = np.random.default_rng(1)
    for day in range(12):
        history.add(day, Arm(seed=day).replay(weather(day, dice)))
    belief = history.last.belief
    other = referred(belief, belief.reference_temperature_c + 7.0)
    for T in (15.0, 30.0, 44.0):
        told = [
            (
                np.einsum("ja,ja->j", h, b.mean),
                np.einsum("ja,jab,jb->j", h, b.cov, h),
            )
            for b in (belief, other)
            for h in [np.stack([np.ones(6), b.reference_temperature_c - T, np.ones(6), np.zeros(6)], axis=1)]
        ]
        assert np.allclose(told[0], told[1], rtol=1e-9)  # rounding


def test_a_month_of_silence_moves_only_the_doubt():
    """30 days without a replay leave the level, slope and rate, and at least double the variance of wear."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    after = aged(before, before.at_unix_s + 30 * DAY_S, DriftSettings())
    assert np.array_equal(after.mean[:, LEVEL], before.mean[:, LEVEL])
    assert np.allclose(after.wear, before.wear + 30 * before.mean[:, RATE], atol=1e-15)  # goes on at its rate
    assert np.all(after.wear_std**2 > 2 * before.wear_std**2)


def test_a_belief_cannot_be_aged_backwards():
    """Time before the belief's is a broken promise, and said so."""
    with pytest.raises(BadInput, match="before it"):
        aged(fresh(), START_S - 1.0, DriftSettings())


def test_one_wild_replay_teaches_nothing_and_is_told():
    """A replay 40 % off (4σ is 8 %) leaves every mean where ageing put it; the joint is named."""
    history = History()
    for day in range(20):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    wild = history.add(20, Arm(seed=99).replay(30.0, np.array([0, 0.4, 0, 0, 0, 0])))
    assert wild.belief.event[1] == OUTLIER
    assert np.allclose(wild.belief.mean[1], aged(before, wild.belief.at_unix_s, DriftSettings()).mean[1])
    assert any(caveat.code == "outlier" and "joint 2" in caveat.text for caveat in wild.caveats)
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
    assert np.sqrt(np.mean(history.last.belief.noise_var)) == pytest.approx(noise, rel=0.3)


def test_noise_that_lasts_is_learnt_as_such():
    """ρ = 0.5 is told from ρ = 0 by the mean over the joints after 150 replays (σ of that mean is about 0.03)."""
    learnt = {}
    for rho in (0.0, 0.5):
        history, arm = History(), Arm(seed=4, autocorrelation=rho)
        for day in range(150):
            history.add(day, arm.replay(30.0))
        learnt[rho] = float(np.mean(history.last.belief.autocorrelation))
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
    error = np.abs(belief.mean[:, SLOPE] - truth)
    assert np.all(error < 3 * np.sqrt(belief.cov[:, SLOPE, SLOPE]))
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
    [caveat] = [caveat for caveat in after.caveats if caveat.code == "context_changed"]
    assert "payload_kg 0.0 → 3.0" in caveat.text
    assert [opened.replays for opened in after.belief.contexts] == [60, 1]
    again = history.add(61, Arm(seed=61, noise=0.005).replay(30.0, 0.3), heavier)
    assert not [caveat for caveat in again.caveats if caveat.code == "context_changed"]


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
    assert after.belief.event[3] == UNSEEN
    assert np.array_equal(after.belief.mean[3], aged(before, after.belief.at_unix_s, DriftSettings()).mean[3])
    assert after.health.joints[3].state == "CHECK_FUNCTION"


def test_without_temperatures_we_are_less_sure_and_raise_nothing():
    """No sensor: 15 % more friction could be a cold morning; it is learnt with doubt and told."""
    with_t, without = History(), History()
    for day in range(40):
        seen = Arm(seed=day).replay(30.0, 0.15 if day > 20 else 0.0)
        with_t.add(day, seen)
        blind = without.add(day, replace(seen, temperature_c=None))
        if day == 2:  # later the scatter that is seen decides how sure one may be
            assert np.all(blind.belief.reference_torque_nm()[1] > 1.2 * with_t.last.belief.reference_torque_nm()[1])
    assert with_t.told
    assert any(caveat.code == "temperature_unknown" for caveat in blind.caveats)
    assert not without.told


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
        ({"mean": [[0.0]]}, "mean has shape"),
        ({"cov": "much"}, "cov is not an array"),
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
    del document["noise_weight"]
    with pytest.raises(BadInput, match="'noise_weight' is missing"):
        belief_from_document(document)


@pytest.mark.parametrize("wrong", [{"reference_speed_rad_s": 1.5}, {"gate_run": 1}, {"autocorrelation": 0.9}, {"between_std": 0.0}])
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
