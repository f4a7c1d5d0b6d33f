"""The torque query: right answers, and errors that name what is wrong with a request."""

import math
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.config.files import find_excitation
from monitor.errors import BadInput
from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.model.robot import Mounting, load_robot
from monitor.publish.documents import Torque, as_json
from monitor.publish.torque import torque_answer
from monitor.recording import Recording

UR5 = load_robot("ur5")
STATE = {"q": [0, -1.5, 0.5, 0, 0, 0], "qd": [0.5] * 6, "qdd": [0.1] * 6, "temperature_c": [30.0] * 6}


def _model():
    """A model fitted to torque of pinocchio with linear friction on the shipped excitation, without simulator and noise."""
    import pinocchio as pin

    arm = UR5.pinocchio_model(Mounting())
    data = arm.createData()
    t_s, motion = find_excitation("ur5-ground", Path()).sampled(125.0)
    t_s, (q, qd, qdd) = t_s[:1251], (signal[:1251] for signal in motion)
    rigid = np.array([pin.rnea(arm, data, *row) for row in zip(q, qd, qdd, strict=True)])
    torque = rigid + np.array([8, 9, 7, 2, 2, 2]) * np.tanh(qd / 0.001) + np.array([9, 10, 8, 1.5, 1.5, 1.5]) * qd
    recording = Recording(t_s=t_s, q=q, qd=qd, torque=torque, temperature_c=np.full_like(q, 30.0))
    recording = recording.__class__(
        **recording.signals, context=recording.context.__class__(robot="ur5", recorded_at_unix_s=1.0), source="oracle"
    )
    outcome = assess(recording, robot=UR5, mounting=Mounting(), belief=None, health=None)
    assert isinstance(outcome, Assessment), outcome
    return outcome.model


MODEL = _model()


def ask(**changes: object) -> Torque:
    request = {key: value for key, value in (STATE | changes).items() if value is not None}
    return torque_answer(MODEL, UR5, None, request)


def test_the_answer_has_the_shape_of_the_request():
    """Six numbers give six, and N rows give N, equal row by row."""
    one = ask()
    many = ask(q=[STATE["q"]] * 3, qd=[STATE["qd"]] * 3)
    assert np.shape(one.torque_nm) == (6,)
    assert np.shape(many.torque_nm) == (3, 6)
    assert many.torque_nm[2] == pytest.approx(one.torque_nm)
    assert one.torque_nm == pytest.approx(np.add(one.rigid_nm, one.friction_nm))


def test_the_answer_is_the_torque_of_the_law_behind_the_data():
    """At the temperature of the replay the torque is that of the law behind the data, to 2 % of the friction or 0.2 N·m."""
    import pinocchio as pin

    arm = UR5.pinocchio_model(Mounting())
    rigid = pin.rnea(arm, arm.createData(), *(np.array(STATE[name], dtype=float) for name in ("q", "qd", "qdd")))
    friction = np.array([8, 9, 7, 2, 2, 2]) + np.array([9, 10, 8, 1.5, 1.5, 1.5]) * 0.5
    assert ask().friction_nm == pytest.approx(friction, rel=0.02, abs=0.2)
    assert ask().torque_nm == pytest.approx(rigid + friction, rel=0.02, abs=0.3)


def test_far_from_the_learnt_temperature_the_answer_is_flagged():
    """After one replay at 30 °C, the answer at 60 °C is flagged and has a larger standard deviation."""
    near, far = ask(), ask(temperature_c=[60.0] * 6)
    assert not any(near.extrapolated)
    assert all(far.extrapolated)
    assert np.all(np.array(far.std_nm) > near.std_nm)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q": None}, "q is missing"),
        ({"q": [0.0] * 5}, "q is not 6 numbers"),
        ({"q": []}, "q is not 6 numbers"),
        ({"q": [[0.0] * 6, [0.0] * 5]}, "q is not 6 numbers"),
        ({"q": ["a"] * 6}, "q is not 6 numbers"),
        ({"q": [True] * 6}, "q is not 6 numbers"),
        ({"q": {"a": 1}}, "q is not 6 numbers"),
        ({"qd": [math.inf] * 6}, "qd of joint 1 is inf; expected -10 … 10"),
        ({"qd": [0, 0, 99, 0, 0, 0]}, "qd of joint 3 is 99"),
        ({"qd": [[0.0] * 6] * 2, "q": [[0.0] * 6] * 3}, "qd has 2 rows but q has 3"),
        ({"temperature_c": None}, "temperature_c is missing"),
        ({"temperature_c": [300.0] * 6}, "temperature_c of joint 1 is 300"),
        ({"torque": 1}, "unknown argument 'torque'"),
        ({"q": [[0.0] * 6] * 10_001}, "at most 10000"),
    ],
)
def test_a_wrong_request_is_named(changes: dict, message: str):
    """The error names the argument and what would be right."""
    with pytest.raises(BadInput, match=message):
        ask(**changes)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5), lambda inner: st.lists(inner, max_size=7), max_leaves=20
)


@given(q=JSON, qd=JSON, temperature_c=JSON)
def test_any_json_is_answered_or_refused(q, qd, temperature_c):
    """Any JSON gives an answer of the right shape or BadInput."""
    try:
        answer = torque_answer(MODEL, UR5, None, {"q": q, "qd": qd, "temperature_c": temperature_c})
    except BadInput:
        return
    assert np.shape(answer.torque_nm)[-1] == 6


FIGURES = {"q": 6.0, "qd": 3.0, "qdd": 20.0, "temperature_c": 35.0}


@given(st.data())
def test_one_sample_and_rows_give_the_same_figures(data):
    """One sample is computed with plain numbers, many with arrays: the figures are equal to the rounding of sums of ten terms."""
    state = {name: data.draw(st.lists(st.floats(-span, span), min_size=6, max_size=6)) for name, span in FIGURES.items()}
    one = torque_answer(MODEL, UR5, None, state)
    (many,) = [torque_answer(MODEL, UR5, None, {name: [value] for name, value in state.items()})]
    for name in ("torque_nm", "rigid_nm", "friction_nm", "std_nm"):
        assert getattr(one, name) == pytest.approx(getattr(many, name)[0], rel=1e-9, abs=1e-9)
    assert list(one.extrapolated) == list(many.extrapolated[0])


def test_threads_that_query_at_the_same_time_get_their_own_answers():
    """The answering threads share the workspace of the dynamics, and each returns its own figures."""
    draw = np.random.default_rng(1)
    questions = [{name: draw.uniform(-1, 1, 6).tolist() for name in FIGURES} for _ in range(4)]
    alone = [ask(**question).torque_nm for question in questions]

    def keep_asking(n: int) -> bool:
        return all(ask(**questions[n]).torque_nm == alone[n] for _ in range(2000))

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads switch as often as possible
    try:
        with ThreadPoolExecutor(4) as pool:
            assert all(pool.map(keep_asking, range(4)))
    finally:
        sys.setswitchinterval(before)


def test_null_means_that_an_argument_is_not_given():
    """The schema allows it: acceleration is 0, and temperatures are the present ones."""
    present = np.full(6, 30.0)
    for rows in ([STATE["q"]] * 2, STATE["q"]):
        asked = {"q": rows, "qd": STATE["qd"], "qdd": None, "temperature_c": None}
        given = {"q": rows, "qd": STATE["qd"], "qdd": [0.0] * 6, "temperature_c": [30.0] * 6}
        assert np.array_equal(torque_answer(MODEL, UR5, present, asked).torque_nm, torque_answer(MODEL, UR5, None, given).torque_nm)


def test_one_temperature_for_many_samples_is_answered_in_json():
    """Figures travel also where one row stands for all samples, as the same rows given one by one."""
    q, temperature_c = [[0.1] * 6, [0.2] * 6, [0.3] * 6], [30.0 + j for j in range(6)]
    one = torque_answer(MODEL, UR5, None, {"q": q, "qd": q, "temperature_c": [temperature_c]})
    many = torque_answer(MODEL, UR5, None, {"q": q, "qd": q, "temperature_c": [temperature_c] * 3})
    assert as_json(one) == as_json(many)
    assert as_json(one)["temperature_c"] == [temperature_c] * 3
