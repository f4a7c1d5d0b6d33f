"""Temperatures, accelerations and bases that must not fool an identification; and what is said of held-out recordings."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import printed
from oracle_arm import GROUND
from own_physics import UR5, productioned_arm

from monitor.identify.detectors import warnings_of
from monitor.identify.identify import identify
from monitor.identify.signals.motion import motion
from monitor.identify.signals.temperature import mean_temperature, warming
from monitor.identify.validate import validate
from monitor.store.formats.recordings import write_recording

HEALTHY = productioned_arm()


def one_joint_moves(recording, joint):
    """The recording with every other joint at rest where it begins, and the torque that it had."""
    others = np.arange(6) != joint
    q, qd = recording.q.copy(), recording.qd.copy()
    q[:, others], qd[:, others] = recording.q[0, others], 0.0
    return replace(recording, q=q, qd=qd, source="sweep")


def test_a_sensor_that_says_zero_has_no_temperature():
    """Zero throughout is unknown, and told."""
    silent = replace(HEALTHY, temperature_c=np.zeros_like(HEALTHY.temperature_c))
    found = identify([silent], UR5, GROUND)
    assert np.all(np.isnan(found.temperature_c))
    assert "temperature_doubtful" in {warning.code for warning in found.warnings}


def test_temperatures_in_fahrenheit_are_doubted():
    """An arm whose joints are all hotter than 65 °C is likelier at 86 °F."""
    hot = replace(HEALTHY, temperature_c=1.8 * HEALTHY.temperature_c + 32.0)
    assert "if these are °F" in warnings_of(motion(hot))[0].text


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda c: c + 273.15, r"3\d\d is no temperature of joint 1, 2, 3, 4, 5, 6 in °C: .* if it is in kelvin, subtract 273.15"),
        (lambda c: np.where(np.arange(6) == 4, -40.0, c), "joint 5 says -40 °C, the median joint"),
        (lambda c: np.where(np.arange(6) == 5, 85.0, c), "joint 6 says 85 °C, the median joint"),
    ],
)
def test_temperatures_of_another_unit_or_a_broken_sensor_are_doubted(change, text):
    """Kelvin, a sensor that says −40 °C, one joint far from the others."""
    found = warnings_of(motion(replace(HEALTHY, temperature_c=change(HEALTHY.temperature_c))))
    assert [warning.code for warning in found] == ["temperature_doubtful"]
    assert re.search(text, found[0].text), found[0].text


@pytest.mark.parametrize("reading", [math.nan, math.inf])
def test_a_sensor_without_a_number_is_as_one_that_says_zero(reading):
    """It has no reading that could be of another unit."""
    without, zero = HEALTHY.temperature_c.copy(), HEALTHY.temperature_c.copy()
    without[:, 2], zero[:, 2] = reading, 0.0
    told = [warnings_of(motion(replace(HEALTHY, temperature_c=readings))) for readings in (without, zero)]
    assert told[0] == told[1]
    assert [warning.code for warning in told[0]] == ["temperature_doubtful"]


def test_one_torn_temperature_moves_neither_mean_nor_warming():
    """One reading of 253 °C is left out and told."""
    torn = HEALTHY.temperature_c.copy()
    torn[-3, 2] = 253.0
    recording = replace(HEALTHY, temperature_c=torn)
    np.testing.assert_allclose(
        mean_temperature([motion(recording).temperature_c]), mean_temperature([motion(HEALTHY).temperature_c]), atol=1e-3
    )
    np.testing.assert_allclose(warming([recording]), warming([HEALTHY]), atol=1e-3)
    assert [warning.code for warning in warnings_of(motion(recording))] == ["temperature_torn"]


@pytest.mark.parametrize("wrong", ["noise", "sign", "zero"])
def test_accelerations_that_are_not_those_of_the_speeds_are_replaced(wrong):
    """Noise in the place of q̈, the opposite sign or zeros: friction is that without the column, to the last bit, and it is told."""
    right = np.gradient(HEALTHY.qd, 0.008, axis=0)
    noise = 5.0 * np.random.default_rng(0).normal(size=right.shape)
    found = identify([replace(HEALTHY, qdd={"noise": noise, "sign": -right, "zero": 0.0 * right}[wrong])], UR5, GROUND)
    np.testing.assert_array_equal(found.coulomb_nm, identify([HEALTHY], UR5, GROUND).coulomb_nm)
    assert {warning.code for warning in found.warnings} == {"accelerations_replaced"}


def test_a_recording_of_one_joint_can_be_held_out():
    """It would not do for a fit; a prediction says how good it is for this joint, and nothing for the others."""
    found = identify([HEALTHY], UR5, GROUND)
    held = validate(found, one_joint_moves(productioned_arm(2), 5), UR5)
    assert np.isfinite(held.relative_rms[5])
    assert np.all(np.isnan(held.relative_rms[:5]))


def test_the_prediction_rounds_friction_as_the_filter_rounds_the_torque():
    """On the fitted recording itself, the error of validation is the residual of the fit, to 1e-9."""
    for law in ("paper", "concave"):
        found = identify([HEALTHY], UR5, GROUND, friction=law)
        np.testing.assert_allclose(validate(found, HEALTHY, UR5).rms_nm, found.rms_nm, rtol=0.01 if law == "concave" else 1e-9)


def test_what_is_fitted_and_what_is_held_out_is_said(tmp_path):
    """A file behind that of --validate is fitted, and a fitted file that is held out says nothing: both are told."""
    paths = [tmp_path / f"{name}.parquet" for name in ("first", "second", "third")]
    for seed, path in enumerate(paths):
        write_recording(path, productioned_arm(seed, repetitions=1))
    first, second, third = paths
    document = json.loads(printed("identify", first, "--validate", second, third, "--robot", "ur5", "--json"))
    told = {warning["code"]: warning["text"] for warning in document["warnings"]}
    assert "first.parquet, third.parquet are fitted together; held out of the fit: second.parquet" in told["fitted_together"]
    document = json.loads(printed("identify", first, "--validate", first, "--robot", "ur5", "--json"))
    assert "validated_on_fitted" in {warning["code"] for warning in document["warnings"]}
