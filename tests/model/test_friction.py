"""The friction laws as columns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.errors import BadInput
from monitor.model.friction import FC, FV, LAWS, PAPER, FrictionLaw, FrictionTerm, automatic_laws, friction_law, smooth_sign


@given(v=st.floats(-10, 10))
def test_friction_is_odd_and_never_drives(v):
    """With positive parameters friction opposes motion equally both ways: F(−v) = −F(v) and F(v)·v ≥ 0."""
    qd = np.array([[v, -v]])
    torque = PAPER.torque(np.array([[2.0, 3.0], [2.0, 3.0]]), qd)
    assert torque[0, 0] == -torque[0, 1]
    assert torque[0, 0] * v >= 0.0


def test_the_sign_is_one_above_the_standstill_threshold():
    """At 0.02 rad/s, from where samples are fitted, tanh is 1 to rounding: the smoothing's width biases nothing."""
    assert smooth_sign(np.array(0.02)) == pytest.approx(1.0, abs=1e-15)


def test_an_unknown_law_is_refused_with_the_known_ones():
    """The message lists what may be chosen."""
    assert friction_law("paper").parameters == ("fc", "fv")
    with pytest.raises(BadInput, match="'dahl' is not known; known are paper, load, concave, stribeck"):
        friction_law("dahl")


@pytest.mark.parametrize("name", LAWS)
@given(v=st.floats(0.001, 10), load=st.floats(-200, 200))
@pytest.mark.slow
def test_every_law_opposes_motion_and_begins_with_fc_and_fv(name, v, load):
    """Each column is odd in the motion, and has the sign of the speed; all but those of braking do not depend on the load's sign."""
    law, loads = LAWS[name], np.array([load, -load])
    columns = law.columns(np.array([v, -v]), loads)
    assert columns.shape == (2, len(law.parameters))
    np.testing.assert_array_equal(columns[0], -columns[1])
    either = [not term.braking for term in law.terms]
    np.testing.assert_array_equal(columns[:, either], law.columns(np.array([v, -v]), -loads)[:, either])
    assert np.all(columns[0] >= 0.0)
    assert law.parameters[:2] == ("fc", "fv")
    np.testing.assert_array_equal(columns[:, :2], PAPER.columns(np.array([v, -v])))


def test_the_share_of_braking_counts_where_the_load_drives_the_joint():
    """fb·|τ| against the motion while τ·q̇ < 0, and nothing while the motor drives."""
    law = friction_law("braking")
    columns = law.columns(np.array([0.5, -0.5, 0.5, -0.5]), np.array([10.0, -10.0, -10.0, 10.0]))
    np.testing.assert_allclose(columns[:, law.parameters.index("fb")], [0.0, 0.0, 10.0, -10.0])


def test_a_law_with_load_refuses_a_missing_load():
    """The message names the torque through the gear."""
    with pytest.raises(BadInput, match="'load' needs the torque"):
        friction_law("load").columns(np.ones((3, 6)))


@pytest.mark.parametrize("name", LAWS)
@given(v=st.floats(0.0, 10), load=st.floats(0, 200))
def test_a_law_gives_one_torque_by_columns_by_sums_and_at_a_point(name, v, load):
    """Against the motion, with one parameter of each term: to 1e-12 of the torque, or 1e-200 N·m where numbers underflow."""
    law, qd, loads = LAWS[name], np.array([[v]]), np.array([[load]])
    values = np.linspace(0.3, 0.9, len(law.terms))
    fitted = law.torque(values[None], qd, loads)
    s = np.abs(smooth_sign(qd))
    np.testing.assert_allclose(law.opposing_torque(values[:, None, None], s, qd, loads), fitted, rtol=1e-12, atol=1e-200)
    np.testing.assert_allclose(law.opposing_torque(values.tolist(), float(s[0, 0]), v, load), fitted[0, 0], rtol=1e-12, atol=1e-200)


def test_a_law_that_does_not_begin_with_fc_and_fv_is_refused():
    """All rooms that compare friction read the first two parameters as fc and fv."""
    with pytest.raises(ValueError, match="'odd' begins with fv, fc; expected fc, fv"):
        FrictionLaw(name="odd", terms=(FV, FC))


def test_a_term_that_depends_on_the_load_without_saying_so_is_refused():
    """With `loaded=True` it is a term; its law then refuses a call without the load."""

    def product(speed, load):
        return speed * load

    with pytest.raises(ValueError, match="'fx': its magnitude depends on the load; expected loaded=True"):
        FrictionTerm(name="fx", magnitude=product, smooth=False)
    law = FrictionLaw(name="product", terms=(FC, FV, FrictionTerm(name="fx", magnitude=product, smooth=False, loaded=True)))
    with pytest.raises(BadInput, match="needs the torque that the gear passes on"):
        law.columns(np.ones((2, 1)))


def test_auto_begins_with_the_paper_and_leaves_out_what_is_not_automatic(monkeypatch):
    """A law with `automatic=False` may be named, but is not chosen."""
    monkeypatch.setitem(LAWS, "by name", FrictionLaw(name="by name", terms=PAPER.terms, automatic=False))
    assert friction_law("by name").parameters == ("fc", "fv")
    names = [law.name for law in automatic_laws()]
    assert names[:5] == ["paper", "load", "concave", "stribeck", "braking"]
    assert "by name" not in names
