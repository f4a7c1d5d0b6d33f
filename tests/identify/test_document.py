"""What `identify --json` prints."""

import json
from dataclasses import replace

import numpy as np
from oracle_arm import GROUND, recording, truth

from monitor.identify.document import document
from monitor.identify.solve import identify, validate
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")


def test_the_document_has_the_promised_names():
    """Every name of the design's list is there, lists are as long as they must be, and files are those that were read."""
    first, second = recording(truth(UR5)), replace(recording(truth(UR5, seed=2), seed=2), source="other")
    found = identify([first], UR5, GROUND)
    printed = json.loads(json.dumps(document(found, [validate(found, second, UR5)]), allow_nan=False))
    assert {"robot", "mounting", "recordings", "method", "base_parameters", "friction", "fit", "validation", "warnings"} == set(printed)
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
    assert printed["friction"]["viscous_std_nm_s_per_rad"][5] is None
    assert printed["friction"]["temperature_c"] is None
    assert printed["fit"]["relative_rms"][5] is None
    assert printed["base_parameters"]["std"][-1] is None
    assert np.isfinite(printed["friction"]["coulomb_nm"][4])
    assert "not_excited" in {warning["code"] for warning in printed["warnings"]}
