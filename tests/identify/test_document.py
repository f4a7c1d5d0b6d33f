"""What `identify --json` prints."""

import json
from dataclasses import replace

import numpy as np
from oracle_arm import GROUND, recording, truth

from monitor.identify.document import document, payload_document
from monitor.identify.identify import identify
from monitor.identify.payload import identify_payload
from monitor.identify.validate import validate
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")


def test_the_document_has_the_promised_names():
    """Every name of the design's list is there, lists are as long as they must be, and files are those that were read."""
    first, second = recording(truth(UR5)), replace(recording(truth(UR5, seed=2), seed=2), source="other")
    found = identify([first], UR5, GROUND)
    printed = json.loads(json.dumps(document(found, [validate(found, second, UR5)]), allow_nan=False))
    names = {"robot", "mounting", "recordings", "method", "base_parameters", "friction", "fit", "validation", "ripple", "warnings"}
    assert names == set(printed)
    assert {"file", "samples", "rate_hz", "duration_s", "rejected_samples", "rejected_why"} == set(printed["recordings"][0])
    base = printed["base_parameters"]
    assert base["count"] == 52 == len(base["names"]) == len(base["values"]) == len(base["std"])
    for name in ("coulomb_nm", "coulomb_std_nm", "viscous_nm_s_per_rad", "viscous_std_nm_s_per_rad", "temperature_c"):
        assert len(printed["friction"][name]) == 6
    assert {"rms_nm", "relative_rms", "normalised_error_nm"} <= set(printed["fit"])
    (validation,) = printed["validation"]
    assert validation["file"] == "other"
    for name in ("rms_nm", "relative_rms", "r2", "rms_all_nm", "nominal_rms_nm"):
        assert len(validation[name]) == 6
    assert printed["friction"]["coulomb_nm"] == found.coulomb_nm.tolist()


def test_unknown_is_null_and_never_nan():
    """A joint at rest has null friction, a recording without temperatures has null there, and strict JSON takes it all."""
    sound = recording(truth(UR5))
    q, qd = sound.q.copy(), sound.qd.copy()
    q[:, 5], qd[:, 5] = 0.3, 0.0
    found = identify([replace(sound, q=q, qd=qd, temperature_c=None)], UR5, GROUND)
    printed = document(found, [validate(found, replace(sound, q=q, qd=qd), UR5)])
    json.dumps(printed, allow_nan=False)
    assert printed["friction"]["coulomb_nm"][5] is None
    assert printed["friction"]["coulomb_misfit_std_nm"][5] is None
    assert printed["friction"]["viscous_std_nm_s_per_rad"][5] is None
    assert printed["friction"]["temperature_c"] is None
    assert printed["fit"]["relative_rms"][5] is None
    assert printed["base_parameters"]["std"][-1] is None
    assert np.isfinite(printed["friction"]["coulomb_nm"][4])
    assert "not_excited" in {warning["code"] for warning in printed["warnings"]}


def test_a_richer_law_is_in_the_document_with_all_parameters():
    """Name, every parameter by joint with its std, and the error of the laws it was chosen from; a joint at rest has nulls."""
    found = identify([recording(truth(UR5))], UR5, GROUND, friction="concave")
    found = replace(found, held_out={"paper": 1.0, "load": 0.9, "concave": 0.8})
    law = json.loads(json.dumps(document(found), allow_nan=False))["friction"]["law"]
    assert law["name"] == "concave"
    assert set(law["values"]) == set(law["std"]) == {"fc", "fv", "fl", "fp"}
    assert law["values"]["fl"] == found.friction.values[:, 2].tolist()
    assert law["exponent"] == 0.5
    assert len(law["load_nm"]) == 6
    assert law["held_out"] == {"paper": 1.0, "load": 0.9, "concave": 0.8}
    assert document(identify([recording(truth(UR5))], UR5, GROUND))["friction"]["law"] == {"name": "paper", "parameters": ["fc", "fv"]}


def test_a_payload_is_in_the_document_with_its_uncertainty():
    """Mass, centre and all ten parameters; no centre where there is no payload."""
    first, second = recording(truth(UR5)), recording(truth(UR5, seed=2), seed=2)
    printed = payload_document(identify_payload([second], identify([first], UR5, GROUND), UR5))
    json.dumps(printed, allow_nan=False)
    assert set(printed["parameters"]) == set(printed["std"]) == {"m", "mx", "my", "mz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz"}
    assert abs(printed["mass_kg"]) < 5.0 * printed["mass_std_kg"] + 0.02  # 0.02 kg for what the first run did not know of the arm
