"""Wear that F(v*) does not show: contrast, residual and friction at other speeds."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_arm import Arm, History, weather

from monitor.identify.signals.ripple import Ripple
from monitor.identify.validate import residual_peak
from monitor.judge.alerts.conditions import WEAR_RISING
from monitor.judge.alerts.evidence import SPEEDS_RAD_S, JointRiseBeside, joint_rise_beside, rise_beside, weigh_evidence
from monitor.judge.alerts.life_cycle import acknowledge
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction import step as friction
from monitor.judge.friction.beside import model_beside, observations_beside
from monitor.judge.friction.observation import NOT_MEASURED, RIPPLE_FLOOR, Observation, observe
from monitor.judge.friction.step import FrictionState
from monitor.judge.friction.stored import state_of, text_of
from monitor.judge.settings import AssessSettings
from monitor.reason import reason_of
from monitor.studies.worlds.table import WORLDS

SETTINGS = AssessSettings()
J, WORN, ONSET = 6, 2, 90
DRY, VISCOUS = 1.2, 0.82  # of wear at low speed: with as much dry as viscous friction, F(0.4 rad/s) rises by 1 %


def replays(
    days: int,
    *,
    arms: int = 2,
    seed: int = 1,
    swing_k: float = 5.0,
    std: float = 0.06,
    low: bool = False,
    place: bool = False,
    joint: slice = slice(WORN, None, J),
) -> Iterator[Observation]:
    """Healthy joints with anti-correlated fc and fv, and wear of one kind in some joints from ONSET on."""
    rng, N = np.random.default_rng(seed), arms * J
    turn, level = np.zeros(N), np.zeros(N)
    for day in range(days):
        turn = 0.5 * turn + 0.87 * std * rng.normal(size=N)
        level = 0.5 * level + 0.87 * 0.02 * rng.normal(size=N)
        T = 30.0 + swing_k * np.sin(2.0 * np.pi * day / 365.0) + rng.normal(size=N)
        fc, fv, residual = np.full(N, 4.0), 10.0 * np.exp(-0.015 * (T - 30.0)), 0.4 * np.exp(0.05 * rng.normal(size=N))
        if low and day >= ONSET:
            fc[joint], fv[joint] = DRY * fc[joint], VISCOUS * fv[joint]
        if place and day >= ONSET:
            residual[joint] *= 2.0
        F, contrast = (fc + 0.4 * fv) * np.exp(level), np.log(fc / fv) + turn
        fv = F / (np.exp(contrast) + 0.4)
        yield Observation(np.log(F), np.full(N, 2.5e-5), T, 0.4 * fv / F, np.zeros(N), F - 0.4 * fv, fv, residual_rms_nm=residual)


def lived(seen: Iterator[Observation], change: Callable[[Observation], Observation] = lambda each: each) -> list[dict[str, np.ndarray]]:
    """Which joints a series has found to have risen after each replay, (N,) by the series' name."""
    return [{name: state.of_joints(state.risen) for name, state in states.items()} for states in judged(map(change, seen))]


def judged(seen: Iterator[Observation]) -> Iterator[dict[str, FrictionState]]:
    """The series' states after each replay, in one context; they are used up by the next one."""
    states: dict[str, FrictionState] = {}
    for day, each in enumerate(seen):
        for name, observation in observations_beside(each).items():
            model = model_beside(name)
            state = states.get(name) or friction.initial_state(observation, J, model)
            arms = len(each.log_torque) // J
            states[name] = friction.step(state, observation, np.full(arms, float(day > 0)), model, in_place=True)
        yield states


def last_of(seen: Iterator[Observation]) -> dict[str, FrictionState]:
    """The series' states after the last replay."""
    *_, last = judged(seen)
    return last


def anything(found: list[dict[str, np.ndarray]]) -> bool:
    """Whether any series has ever found a rise."""
    return any(risen.any() for each in found for risen in each.values())


def first_found(found: list[dict[str, np.ndarray]], name: str) -> np.ndarray:
    """(N,) day on which a series found a rise for the first time; infinite for never."""
    risen = np.array([each[name] for each in found])
    return np.where(risen.any(axis=0), np.argmax(risen, axis=0), np.inf)


@pytest.mark.parametrize(("kind", "name"), [("low", "contrast"), ("place", "residual")])
def test_wear_that_leaves_friction_at_the_reference_speed_is_found_within_30_days(kind, name):
    """The worn joints are found, and no other."""
    found = lived(replays(ONSET + 35, low=kind == "low", place=kind == "place"))
    days = first_found(found, name) - ONSET
    worn = np.arange(len(days)) % J == WORN
    assert np.all((days[worn] >= 0) & (days[worn] < 30))
    assert not any(risen[~worn].any() for each in found for risen in each.values())


@pytest.mark.parametrize("swing_k", [5.0, 20.0])
@pytest.mark.soak
def test_a_healthy_year_is_quiet_though_contrast_follows_temperature(swing_k):
    """Viscous friction falls by 1.5 %/K: over 40 K the contrast moves by 0.6 and no joint is worn."""
    assert not anything(lived(replays(365, arms=1, swing_k=swing_k)))


def test_what_all_joints_do_together_is_wear_of_none():
    """A firmware that scales the residual, or a change of grease in all joints, names no joint."""
    assert not anything(lived(replays(ONSET + 30, low=True, place=True, joint=slice(None))))


def test_one_shock_that_decays_is_no_wear():
    """A replay 20 σ away, whose echo halves from replay to replay, as correlated noise of heavy tails has them."""

    def shocked() -> Iterator[Observation]:
        for day, seen in enumerate(replays(ONSET + 20)):
            echo = np.zeros(len(seen.log_torque))
            echo[WORN] = 1.2 * 0.5 ** (day - ONSET) if day >= ONSET else 0.0
            yield seen._replace(coulomb_nm=seen.coulomb_nm * np.exp(echo))

    assert not anything(lived(shocked()))


def through_the_step(seen: Iterator[Observation]) -> Iterator[DriftState]:
    """The state of arms after each replay, by the step that judges the daemon's."""
    state = None
    for day, each in enumerate(seen):
        state = initial_state(each, J, SETTINGS) if state is None else state
        days = np.full(len(each.log_torque) // J, float(day > 0))
        state = step(state, Replay(observation=each, days=days), SETTINGS, in_place=True).state
        yield state


def test_the_fleet_example_tells_low_speed_wear_with_its_speed():
    """Through the public step, without the optional fields: wear_rising's tiers rise, and the joint's record says why."""
    raised: dict[int, int] = {}
    every = (seen._replace(residual_rms_nm=NOT_MEASURED) for seen in replays(ONSET + 35, arms=1, low=True))
    for day, state in enumerate(through_the_step(every)):
        evidence = weigh_evidence(state, SETTINGS.health)
        for j in np.flatnonzero(evidence.raises >= 0):
            raised.setdefault(int(j), day)
    assert list(raised) == [WORN]
    assert ONSET < raised[WORN] <= ONSET + 30
    found = joint_rise_beside(evidence.beside, evidence.wear, WORN)
    assert found.speed_rad_s == SPEEDS_RAD_S[0]
    assert np.expm1(found.rise) == pytest.approx(0.10, abs=0.03)  # (1.2·4 + 0.82·1)/5 over (1.2·4 + 0.82·4)/8
    assert "0.1 rad/s" in found.finding.text


def test_wear_at_one_place_never_raises_the_limit():
    """What the fit does not explain is told up to the wear tier: the configured limit is one of friction at the reference speed."""
    much = (seen._replace(residual_rms_nm=10.0 * seen.residual_rms_nm) for seen in replays(ONSET + 35, arms=1, place=True))
    *_, state = through_the_step(much)
    beside = rise_beside(state)
    assert beside is not None
    assert SPEEDS_RAD_S[beside.at[WORN]] is None
    assert beside.rise[WORN] > np.log(1.3)
    assert weigh_evidence(state, SETTINGS.health).raises[WORN] == 1


def test_a_joint_that_was_replaced_begins_again_and_another_context_keeps_what_was_found():
    """What was found before the joint was replaced is no finding of the new one; wear is of the joint, whatever it carries."""
    *_, state = through_the_step(replays(ONSET + 35, low=True))
    *_, last = replays(ONSET + 36, low=True)
    one = np.arange(2 * J) == WORN
    before = state.beside["contrast"]
    assert before.of_joints(before.risen)[[WORN, WORN + J]].all()
    for changed, kept in (({"replaced": one}, False), ({"opened": np.array([True, False])}, True)):
        after = step(state, Replay(observation=last, days=np.ones(2), **changed), SETTINGS).state.beside
        risen = {name: series.of_joints(series.risen) for name, series in after.items()}
        assert risen["contrast"][WORN] == kept
        assert risen["contrast"][WORN + J]
        assert not risen["residual"].any()


@settings(max_examples=20, deadline=None)
@given(bad=st.sampled_from([np.nan, 0.0, -1.0, np.inf]), name=st.sampled_from(["coulomb_nm", "viscous_nm_s_per_rad", "residual_rms_nm"]))
def test_absurd_figures_silence_a_series(bad, name):
    """A figure that is no friction teaches nothing and finds nothing, and what was known stays."""
    healthy = list(replays(12, arms=1))
    states = last_of(each._replace(**{name: np.full(J, bad)}) if day >= 8 else each for day, each in enumerate(healthy))
    silent = "residual" if name == "residual_rms_nm" else "contrast"
    assert states[silent].replays[:J].tolist() == [8.0] * J
    assert np.isfinite(states[silent].x).all()
    assert not any(state.risen.any() for state in states.values())


def test_a_series_is_stored_exactly():
    """The text is the state, array by array."""
    for state in last_of(replays(50, arms=1)).values():
        again = state_of(text_of(state), "beside")
        assert text_of(again) == text_of(state)
        assert np.array_equal(again.x, state.x)
        assert np.array_equal(again.bank.r, state.bank.r)
        assert again.bank.r.dtype == state.bank.r.dtype
        assert np.array_equal(again.normalised, state.normalised, equal_nan=True)


def test_joints_of_other_arms_do_not_matter():
    """A fleet judged together is judged as its arms are alone."""
    together = last_of(replays(60, arms=2))
    alone = last_of(Observation(*(part[:J] if len(part) else part for part in seen)) for seen in replays(60, arms=2))
    assert together.keys() == alone.keys() == {"contrast", "residual"}
    for name, one in alone.items():
        assert together[name].x[..., : J + 1] == pytest.approx(one.x, abs=1e-9)
        assert together[name].odds[:, : J + 1] == pytest.approx(one.odds, rel=1e-4)


@pytest.mark.parametrize(
    ("kind", "words"), [("low", "friction at 0.1 rad/s rose by +1"), pytest.param("place", "wear at one place", marks=pytest.mark.soak)]
)
@pytest.mark.slow
def test_the_alert_of_an_arm_says_which_series_found_it(kind, words):
    """From identifications on, as the daemon judges them: one alert, wear_rising of joint 3, with the series in its text."""
    arm, history, texts = Arm(seed=3, autocorrelation=0.5), History(), []
    rng = np.random.default_rng(4)
    for day in range(ONSET + 30):
        seen = arm.replay(weather(day, rng))
        dry, viscous, residual = np.ones(J), np.ones(J), 0.5 * np.exp(0.05 * rng.normal(size=J))
        if day >= ONSET and kind == "low":
            dry[WORN], viscous[WORN] = 1.2, 0.65  # fc = 7 N·m, fv = 9 N·m·s/rad: F(0.4) stays
        if day >= ONSET and kind == "place":
            residual[WORN] *= 2.4
        worn = replace(seen, coulomb_nm=dry * seen.coulomb_nm, viscous_nm_s_per_rad=viscous * seen.viscous_nm_s_per_rad, rms_nm=residual)
        texts += [alert.text.text for _, alert in history.add(float(day), worn).transitions]
    assert [(joint, condition) for _, what, joint, condition, _ in history.transitions if what == "raised"] == [(WORN + 1, WEAR_RISING)]
    assert any(words in text for text in texts)


def noisy(days: int, *, factor: float, until: int = 10_000) -> Iterator[tuple[History, int]]:
    """An arm whose joint 3 has currents so many times as noisy from ONSET on, friction unchanged: the fit leaves more, and is less sure."""
    arm, history, rng = Arm(seed=3, autocorrelation=0.5), History(), np.random.default_rng(4)
    for day in range(days):
        seen, more = arm.replay(weather(day, rng)), np.ones(J)
        more[WORN] = factor if ONSET <= day < until else 1.0
        left = np.hypot(0.5, 0.3 * more / more.max() * (more - 1.0)) * np.exp(0.05 * rng.normal(size=J))
        noise = 0.06 * more * np.exp(0.05 * rng.normal(size=J))
        unsure = seen.friction_cov * more[:, None, None]
        history.add(float(day), replace(seen, rms_nm=left, current_noise_a=noise, friction_cov=unsure))
        yield history, day


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.5, 5.0, 20.0])
def test_a_noisier_current_is_told_as_noise_and_not_as_wear(factor):
    """Within three weeks, of its joint alone; it stays while it lasts, is acknowledged like any other, and ends with the noise."""
    end = ONSET + 45
    for history, day in noisy(end + 45, factor=factor, until=end):
        if day == ONSET + 21:
            [alert] = history.health.active_alerts
            assert (alert.joint, alert.condition, alert.tier) == (WORN + 1, "current_noise", "advisory")
            assert float(alert.text.parameters["ratio"]) == pytest.approx(factor, rel=0.15)
            assert history.health.joints[WORN].state == "CHECK_FUNCTION"
            assert "cable" in alert.action.text
        if day == ONSET + 22:
            history.health = acknowledge(
                history.health, WORN + 1, "current_noise", by="Ada", why="ordered", at_unix_s=alert.raised_at_unix_s
            )
            acknowledged = True
    assert acknowledged
    assert {(joint, condition) for _, _, joint, condition, _ in history.transitions} == {(WORN + 1, "current_noise")}
    kinds = [kind for _, kind, *_ in history.transitions]
    assert (kinds[0], kinds[-1], set(kinds[1:-1])) in (("raised", "cleared", set()), ("raised", "cleared", {"updated"}))
    assert len(kinds) <= 12  # the ratio is said anew where it was too low at first, and not from replay to replay
    assert abs(history.last.friction[WORN].wear) < 0.03


def rippled(days: int, *, grown_a: float) -> Iterator[History]:
    """An arm whose gears ripple by nothing to 5 mA; that of joint 3 has this amplitude from ONSET on, friction unchanged."""
    arm, history, rng, cycles = Arm(seed=3, autocorrelation=0.5), History(), np.random.default_rng(4), np.full((J, 3), 101.0)
    for day in range(days):
        amplitude = np.maximum(0.005 * rng.normal(size=(J, 3)), 0.0)
        if day >= ONSET:
            amplitude[WORN, 0] = grown_a * (1.0 + 0.1 * rng.normal())
        why: tuple[tuple[str | None, ...], ...] = ((None,) * 3,) * J
        ripple = Ripple(cycles, amplitude, np.full((J, 3), 0.008), why, cycles, np.full(J, 12.0))
        history.add(float(day), replace(arm.replay(weather(day, rng)), ripple=ripple))
        yield history


@pytest.mark.slow
def test_ripple_that_grows_is_told_of_its_joint_and_no_wear():
    """From nothing to a tenth of friction: one advisory, with its size and how often it comes a turn; no other condition."""
    *_, history = rippled(ONSET + 30, grown_a=0.1)
    assert {(joint, condition) for _, _, joint, condition, _ in history.transitions} == {(WORN + 1, "gear_ripple")}
    [alert] = history.health.active_alerts
    assert alert.tier == "advisory"
    says, friction_nm = alert.text.parameters, Arm(seed=3).replay(30.0).friction_at(SETTINGS.drift.reference_speed_rad_s)[0][WORN]
    assert says["cycles"] == 1
    assert float(says["before"]) < 0.01
    assert float(says["now"]) == pytest.approx(0.1 * 12.0 / friction_nm, rel=0.2)
    assert "encoder" in alert.action.text


def test_ripple_of_sound_gears_that_is_often_zero_is_quiet():
    """Readings of exactly zero in a row are no scatter of zero: those that follow are of the same gear."""
    rng, N, found = np.random.default_rng(6), 2 * J, []
    model, state = model_beside("ripple-1"), None
    for day in range(200):
        amplitude = np.where(rng.random(N) < 0.6, 0.0, 0.01 * np.abs(rng.normal(size=N))) if day > 40 else np.zeros(N)  # of friction
        one = np.ones(N)
        seen = Observation(np.log(amplitude + RIPPLE_FLOOR), np.full(N, 0.1), np.full(N, 30.0), one, 0.0 * one, one, one)
        state = state or friction.initial_state(seen, J, model)
        state = friction.step(state, seen, np.full(2, float(day > 0)), model, in_place=True)
        found.append(state.risen.any())
    assert not any(found)


def test_ripple_of_a_drive_whose_gain_nobody_knows_is_no_series():
    """Amperes are no share of friction: nothing is judged, and everything else is."""
    arm, cycles = Arm(seed=3), np.full((J, 3), 101.0)
    ripple = Ripple(cycles, 0.01 * np.ones((J, 3)), 0.008 * np.ones((J, 3)), ((None,) * 3,) * J, cycles)
    for gain, known in ((None, False), (np.full(J, 12.0), True)):
        seen = observe(replace(arm.replay(30.0), ripple=ripple._replace(gain_nm_per_a=gain)), SETTINGS.drift)
        assert ("ripple-1" in observations_beside(seen)) == known
        assert "contrast" in observations_beside(seen)


def test_noise_of_all_joints_names_none():
    """A firmware that measures otherwise is no cable of one joint."""
    rng = np.random.default_rng(8)
    noise_a = [0.06 * (5.0 if day >= ONSET else 1.0) * np.exp(0.05 * rng.normal(size=2 * J)) for day in range(ONSET + 30)]
    together = (seen._replace(current_noise_a=a) for seen, a in zip(replays(ONSET + 30), noise_a, strict=True))
    assert not anything([{"noise": each["noise"]} for each in lived(together)])


@pytest.mark.soak
@pytest.mark.parametrize("name", ["plain", "noise-mixed", "student-t3", "noise-swells", "rho-mixed", "ar-08"])
def test_the_noise_of_healthy_arms_is_quiet(name):
    """Its logarithm varies five times as much as that of friction in these worlds: 0.01 findings a robot-year."""
    arms, days = 40, 1095
    size = 5.0 * np.broadcast_to(WORLDS[name].noise(np.random.default_rng(7), (days, arms, J)), (days, arms, J)).reshape(days, -1)
    nothing = np.full(arms * J, np.nan)
    seen = Observation(np.ones(arms * J), nothing, np.full(arms * J, 30.0), nothing, nothing, nothing, nothing)
    found = np.array([each["noise"] for each in lived(seen._replace(current_noise_a=0.06 * np.exp(each)) for each in size)])
    assert np.count_nonzero(found[1:] & ~found[:-1]) <= 0.01 * arms * days / 365.0


def of_reference():
    """What is said of friction at the reference speed."""
    return reason_of("")


def test_the_text_names_the_place_where_the_residual_is_largest():
    """Wear over a tenth of a radian: the place is found from the samples of the motion, and a joint that stood still has none."""
    q = np.stack([np.linspace(-1.0, 2.0, 3000), np.zeros(3000)], axis=1)
    residual = np.where((q > 0.9) & (q < 1.0), 2.0, 1.0)
    peaks = residual_peak(q, residual, np.array([True, False]) & np.ones_like(q, dtype=bool))
    assert peaks[0] == pytest.approx(0.95)
    assert np.isnan(peaks[1])
    found = JointRiseBeside(rise=0.1, std=0.01, speed_rad_s=None, ratio=2.0)
    assert "between 0.9 and 1.0 rad" in found.text(0, of_reference, peaks).text
    assert "between" not in found.text(1, of_reference, peaks).text
