"""Prediction error: the model's error and the noise of a measurement, after a restart and from older histories too."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from synthetic_arm import Arm, History

from monitor.config.files import find_excitation
from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.judge.belief import belief_from_document
from monitor.judge.prediction_error import FIT_REPLAYS, MAX_RATIO, PredictionError, PredictionErrorStatistics, rms, update
from monitor.judge.torque.evaluation import measure_prediction_error
from monitor.judge.torque.model import CompensatedModel, model_from_document
from monitor.judge.torque.predictor import predict_torque
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context, Recording
from monitor.service.history.assess_and_store import load_state
from monitor.store.store import Store

UR5 = load_robot("ur5")
GAIN = np.array(UR5.drive_gain_nm_per_a)
DAY_S = 86_400.0


def _motion():
    t_s, state = find_excitation("ur5-ground", Path()).sampled(125.0)
    return t_s[:1251], *(signal[:1251] for signal in state)


@pytest.fixture(scope="module")
def model() -> CompensatedModel:
    """The model after 12 replays between 20 and 40 °C."""
    history, rng, arm = History(), np.random.default_rng(1), Arm(seed=1, noise=0.01)
    for day in range(12):
        history.add(day, arm.replay(rng.uniform(20, 40)))
    return history.last.model


def recording(model: CompensatedModel, *, error_nm: float, noise_nm: float, seed: int, temperature_c: float = 30.0) -> Recording:
    """The model's torque plus two errors of given RMS: a sine with a period of 0.7 s, and noise with a correlation of 0.3 a sample."""
    rng = np.random.default_rng(seed)
    t_s, q, qd, qdd = _motion()
    T = np.full_like(q, temperature_c)
    wave = error_nm * np.sqrt(2.0) * np.sin(2 * np.pi * t_s[:, None] / 0.7 + rng.uniform(0, 6, 6))
    noise = noise_nm * np.sqrt(1.0 - 0.3**2) * lfilter([1.0], [1.0, -0.3], rng.normal(size=q.shape), axis=0)
    torque = predict_torque(model, UR5, q, qd, qdd, T).torque + wave + noise
    context = Context(robot="ur5", recorded_at_unix_s=1.75e9 + seed * DAY_S)
    return Recording(t_s=t_s, q=q, qd=qd, target_qdd=qdd, current=torque / GAIN, temperature_c=T, context=context, source=f"day {seed}")


def test_the_models_error_is_separated_from_the_noise_of_the_measurement(model):
    """Fifteen replays with an error of 0.4 N·m and noise of 1.2 N·m, after a fit with a residual of 0.7 N·m.

    The covariance of the sine falls by a quarter in 80 ms, and the fit has the weight of 3 replays of 18. The expected error is
    √(0.75·0.16·15/18 + 0.49·3/18) = 0.43 N·m, to 15 %. The residual of a sample contains error and noise, to 3 %.
    """
    statistics, own = None, np.full(6, 0.7)
    for k in range(15):
        measured = measure_prediction_error(recording(model, error_nm=0.4, noise_nm=1.2, seed=k), model, UR5, None)
        assert measured is not None
        statistics = update(statistics, measured, own)
    error, sample = rms(statistics, own)
    assert error == pytest.approx(np.full(6, 0.43), rel=0.15)
    assert sample == pytest.approx(np.full(6, np.hypot(0.4, 1.2)), rel=0.03)


def test_the_motion_of_the_servo_after_a_reversal_is_no_error_of_the_model(model):
    """The servo overshoots and swings back for longer than 80 ms; the estimate of the model's error does not change."""
    own, doubts = np.full(6, 0.7), [None, None]
    catching_up_nm = 2.0 * np.array([12.6, 2.6, 0.0, -3.4, -2.7, -1.8, -0.5, -0.5, -0.5, 0.4, 0.4, 0.4])
    for k in range(15):
        seen = recording(model, error_nm=0.4, noise_nm=0.5, seed=k)
        late = np.zeros_like(seen.qd)
        for n, joint in np.argwhere(np.diff(np.sign(seen.qd), axis=0) != 0):
            part = catching_up_nm[: len(late) - n - 1]
            late[n + 1 : n + 1 + len(part), joint] += part
        for which, one in enumerate((seen, replace(seen, current=seen.current + late / GAIN))):
            doubts[which] = update(doubts[which], measure_prediction_error(one, model, UR5, None), own)
    (alone, _), (beside, sample) = (rms(statistics, own) for statistics in doubts)
    assert beside == pytest.approx(alone, rel=0.05)
    assert np.all(sample > 0.65)  # √(0.4² + 0.5²) = 0.64 without the servo, whose motion is part of a measurement


def test_a_recording_that_cannot_be_compared_changes_no_statistics(model):
    """It has no accelerations, or is at a temperature outside the range of the model."""
    sound = recording(model, error_nm=0.1, noise_nm=0.1, seed=1)
    assert measure_prediction_error(replace(sound, target_qdd=None), model, UR5, None) is None
    measured = measure_prediction_error(recording(model, error_nm=0.1, noise_nm=0.1, seed=1, temperature_c=80.0), model, UR5, None)
    assert measured is not None
    assert np.all(np.isnan(measured.error_nm2))
    before = PredictionErrorStatistics(*(np.full(6, x) for x in (5.0, 0.2, 1.0)))
    assert all(np.array_equal(a, b) for a, b in zip(update(before, measured, np.ones(6)), before, strict=True))


def test_an_outlier_replay_counts_for_four_times_the_present_mean_square_at_most():
    """A person leant on the arm: both figures stay bounded, and the error stays positive after a negative estimate."""
    own, before = np.full(6, 0.5), PredictionErrorStatistics(*(np.full(6, x) for x in (9.0, 0.09, 1.0)))
    error, sample = rms(update(before, PredictionError(np.full(6, 1e6), np.full(6, 1e6)), own), own)
    was, was_sample = rms(before, own)
    limit = np.sqrt(was**2 * (1.0 + MAX_RATIO / (FIT_REPLAYS + 10.0)))
    assert np.all(error <= limit + 1e-12)
    assert np.all(sample <= was_sample * np.sqrt(1.0 + MAX_RATIO / 10.0))
    gone, _ = rms(update(None, PredictionError(np.full(6, -1e6), np.full(6, 1.0)), own), own)
    assert np.all(gone >= 0.1)


@pytest.fixture(scope="module")
def lived(model) -> Assessment:
    """The assessment of the third of three recordings, each assessed with the state after the one before."""
    last = None
    for seed, temperature_c in enumerate((26.0, 30.0, 31.0)):
        seen = recording(model, error_nm=0.3, noise_nm=0.5, seed=seed, temperature_c=temperature_c)
        state = {} if last is None else {"model": last.model}
        belief, health = (None, None) if last is None else (last.belief, last.health)
        last = assess(seen, robot=UR5, mounting=Mounting(), belief=belief, health=health, **state)
        assert isinstance(last, Assessment), last
    return last


def asked(model: CompensatedModel) -> list[np.ndarray]:
    _, q, qd, qdd = _motion()
    return list(predict_torque(model, UR5, q[::50], qd[::50], qdd[::50], np.full(6, 29.0)))


def stored(folder: Path, belief: dict, health: dict, model: dict) -> None:
    with Store.open(folder) as store:
        ledger_id = store.ledger.claim(1.0, "scheduled", 1.0)
        store.recordings.path(ledger_id).write_bytes(b"PAR1")
        store.ledger.mark_recorded(ledger_id)
        rest = {"at_unix_s": 10.0, "recorded_at_unix_s": 5.0, "assessment": {}, "friction": [], "events": []}
        store.assessments.commit(ledger_id, belief=belief, health=health, model=model, **rest)


def test_torque_is_the_same_to_the_last_bit_after_a_restart(lived, tmp_path):
    """Residual friction and the statistics of the prediction error come back from the history with the rest."""
    assert lived.model.residual_friction is not None
    assert lived.model.error_rms_nm is not None
    stored(tmp_path, lived.belief.as_document(), lived.health.as_document(), lived.model.as_document())
    with Store.open(tmp_path) as store:
        back = load_state(store)
    assert all(np.array_equal(a, b) for a, b in zip(asked(lived.model), asked(back.model), strict=True))
    assert json.dumps(back.belief.as_document()) == json.dumps(lived.belief.as_document())


def test_verdicts_do_not_depend_on_the_model_of_the_replay_before(lived, model):
    """A recomputation that begins at a checkpoint has no such model, and its document is the same."""
    seen = recording(model, error_nm=0.3, noise_nm=0.5, seed=9)
    state = {"robot": UR5, "mounting": Mounting(), "belief": lived.belief, "health": lived.health}
    with_model, without = (assess(seen, **state, model=known) for known in (lived.model, None))
    assert with_model.as_document() == without.as_document()


def test_another_payload_is_no_error_of_the_model(lived, model):
    """A replay whose declared context has changed does not count for the prediction error."""
    seen = recording(model, error_nm=0.3, noise_nm=0.5, seed=9)
    heavier = replace(seen, context=replace(seen.context, payload_kg=2.0))
    after = assess(heavier, robot=UR5, mounting=Mounting(), belief=lived.belief, health=lived.health, model=lived.model)
    assert isinstance(after, Assessment)
    assert np.array_equal(after.belief.prediction_error.replays, lived.belief.prediction_error.replays)


def test_unknown_statistics_survive_as_json(lived):
    """NaN is null in JSON."""
    odd = replace(lived.belief, prediction_error=lived.belief.prediction_error._replace(error_nm2=np.array([np.nan, 1, 2, 3, 4, 5])))
    back = belief_from_document(json.loads(json.dumps(odd.as_document(), allow_nan=False)))
    assert np.array_equal(back.prediction_error.error_nm2, odd.prediction_error.error_nm2, equal_nan=True)
    assert np.array_equal(model_from_document(lived.model.as_document()).error_rms_nm, lived.model.error_rms_nm)
