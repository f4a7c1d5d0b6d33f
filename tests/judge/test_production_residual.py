"""Production residuals: the evidence of normal work may ask for an earlier replay and has no other effect."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from monitor.judge.drift.usage import no_usage
from monitor.judge.settings import ResidualSettings
from monitor.judge.torque.predictor import TorquePrediction
from monitor.judge.torque.production_residual import ProductionSample, earlier_replay_reason, production_evidence, update
from monitor.service.production_motion import ProductionMotion, Sample

SETTINGS = ResidualSettings(span_s=60.0, min_samples=50)
J = 6


def in_production(rise, *, spans: int, so_far=None, revision: int = 1, bias: float = 0.0, seed: int = 0, settings=SETTINGS):
    """Residuals after so many spans of work at 5 Hz, with unknown loads as noise of 10 N·m on 8 N·m of friction.

    rise : (J,) of friction, as a fraction; bias : error of all joints, as a fraction of friction.
    """
    rng = np.random.default_rng(seed)
    for _ in range(int(spans * settings.span_s * 5) + 1):
        qd = rng.choice([-1.0, 1.0], J) * rng.uniform(0.1, 1.0, J)
        friction = np.sign(qd) * (6.0 + 2.0 * np.abs(qd))
        rigid = rng.normal(size=J) * 20.0
        predicted = TorquePrediction(
            (rigid + friction)[None], rigid[None], friction[None], np.ones((1, J)), np.zeros((1, J), dtype=bool), np.ones((1, J))
        )
        measured = rigid + friction * (1.0 + rise + bias) + 10.0 * rng.normal(size=J)
        so_far = update(so_far, revision, predicted, ProductionSample(measured, qd, np.zeros(J), 0.2), settings)
    return so_far


def test_a_joint_whose_friction_rose_asks_for_an_earlier_replay():
    """Joint 3 rises by 50 % after the baseline, and the work has a bias of 10 % in all joints: joint 3 alone is named."""
    before = in_production(0.0, spans=3, bias=0.1)
    assert earlier_replay_reason(before, SETTINGS) is None
    after = in_production(np.array([0, 0, 0.5, 0, 0, 0]), spans=4, so_far=before, bias=0.1, seed=1)
    why = earlier_replay_reason(after, SETTINGS)
    assert why is not None
    assert why.startswith("Elbow (joint 3): at work, friction is +4")
    found = {each.joint: each for each in production_evidence(after, SETTINGS)}
    assert found[3].change == pytest.approx(0.5, abs=0.1)
    assert all(abs(found[j].change) < 2 * found[j].std for j in (1, 2, 4, 5, 6))


def test_the_standard_deviation_keeps_the_bias_of_other_production():
    """After many observations it is still above 5 % of friction; that of one observation is 8 %."""
    long = in_production(0.0, spans=40, settings=ResidualSettings(span_s=20.0, min_samples=50))
    assert min(each.std for each in production_evidence(long, SETTINGS)) > 0.05


def test_a_new_model_begins_anew_and_unsuitable_samples_do_not_count():
    """Samples that are slow, strongly accelerated, extrapolated or without a measurement."""
    heard_before = in_production(0.5, spans=5)
    assert in_production(0.0, spans=0, so_far=heard_before, revision=2).observations.max() == 0
    predicted = TorquePrediction(
        np.ones((1, J)), np.zeros((1, J)), np.ones((1, J)), np.ones((1, J)), np.zeros((1, J), dtype=bool), np.ones((1, J))
    )
    fit = (np.full(J, 2.0), np.full(J, 0.5), np.zeros(J))
    for measured, qd, qdd, extrapolated in (
        (np.full(J, np.nan), *fit[1:], False),
        (fit[0], np.full(J, 0.01), fit[2], False),
        (*fit[:2], np.full(J, 50.0), False),
        (*fit, True),
    ):
        odd = predicted._replace(extrapolated=np.full((1, J), extrapolated))
        assert update(None, 1, odd, ProductionSample(measured, qd, qdd, 0.2), SETTINGS).samples.max() == 0
    assert update(None, 1, predicted, ProductionSample(*fit, 0.2), SETTINGS).samples.min() == 1


def test_revolutions_are_counted_while_the_arm_is_observed():
    """2π rad/s for 100 s is 100 revolutions. A long gap counts as the observed time does; too little observed time gives no count."""
    production = ProductionMotion(SETTINGS)
    assert production.revolutions(0.0) is None
    for k in range(101):
        production.moved(float(k), np.full(J, 2.0 * np.pi))
    assert production.revolutions(100.0) == pytest.approx([100.0] * J)
    for k in range(101):
        production.moved(1000.0 + k, np.full(J, -2.0 * np.pi))
    assert production.revolutions(1200.0) == pytest.approx([300.0] * J)  # half of the time was observed, so the count is doubled
    production.moved(5000.0, np.zeros(J))
    assert production.revolutions(9000.0) is None
    production.continue_from(no_usage(J)._replace(revolutions=np.full(J, 7.0)))


def test_an_earlier_replay_is_asked_for_once_a_model():
    """The next request comes only after the replay, with its new model."""
    production = ProductionMotion(SETTINGS)
    rng, model = np.random.default_rng(2), SimpleNamespace(revision=4)
    asked = []
    for k in range(3000):
        qd = rng.choice([-1.0, 1.0], J) * 0.5
        friction = 7.0 * np.sign(qd)
        predicted = TorquePrediction(
            friction[None], 0 * qd[None], friction[None], np.ones((1, J)), np.zeros((1, J), dtype=bool), np.ones((1, J))
        )
        production.worked(model, predicted, Sample(0.2 * k, qd, 0 * qd, friction * (1.0 + 0.6 * (k > 1000))), 0.2)
        why = production.pull_forward()
        asked += [why] if why else []
    assert len(asked) == 1


class Interrupting(np.ndarray):
    """A speed that runs a function at the moment when it is read."""

    happens = None

    def __array_ufunc__(self, ufunc, method, *inputs, **kwargs):
        if Interrupting.happens is not None:
            happens, Interrupting.happens = Interrupting.happens, None
            happens()
        return getattr(ufunc, method)(*(np.asarray(x) for x in inputs), **kwargs)


def test_a_count_that_is_taken_during_a_sample_contains_each_turn_once():
    """The thread of the replay asks while the listener adds. Without a lock the listener would count the taken turns again."""
    production, taken = ProductionMotion(SETTINGS), []
    replay = threading.Thread(target=lambda: taken.append(production.revolutions(100.0)))

    def ask():
        replay.start()
        replay.join(0.2)  # it has to wait for the sample's end; it would have been done in far less

    for k in range(100):
        production.moved(float(k), np.full(J, 2.0 * np.pi))
    Interrupting.happens = ask
    production.moved(100.0, np.full(J, 2.0 * np.pi).view(Interrupting))
    replay.join()
    assert taken == [pytest.approx([100.0] * J)]
    assert production.revolutions(100.0) is None  # nothing is left of what was taken


def test_other_settings_begin_the_looks_anew_and_the_same_ones_do_not():
    """After a reload that changes [residual] the observations begin anew; after other reloads they continue."""
    short = replace(SETTINGS, span_s=60.0, min_samples=10)
    production, model = ProductionMotion(short), SimpleNamespace(revision=1)
    qd = np.full(J, 0.5)
    predicted = TorquePrediction(qd[None], 0 * qd[None], qd[None], np.ones((1, J)), np.zeros((1, J), dtype=bool), np.ones((1, J)))

    def a_while():
        for k in range(400):
            production.worked(model, predicted, Sample(float(k), qd, 0 * qd, 1.2 * qd), 1.0)
        return [each.observations for each in production.evidence()]

    assert a_while() == [400 // 60 - short.baseline_observations] * J
    production.use(replace(short))
    assert production.evidence() != ()
    production.use(replace(short, rise=0.2))
    assert production.evidence() == ()
    assert a_while() == [400 // 60 - short.baseline_observations] * J
