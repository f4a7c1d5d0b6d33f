"""A walk through: a new friction law is registered, fitted, printed, validated and used as residual friction, then removed again.

The test makes the one edit that a developer makes in `monitor/model/friction.py`. It registers a law with a quadratic viscous term.
"""

import json
import re
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracle_arm import GROUND, recording, truth
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadInput
from monitor.identify.identify import identify
from monitor.judge.assess import judge_identification
from monitor.judge.assessment import Assessment
from monitor.judge.torque.model import model_from_document
from monitor.judge.torque.predictor import predict_torque, predictor_for
from monitor.model import friction
from monitor.model.friction import FC, FV, LAWS, FrictionLaw, FrictionTerm, Quantity
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.store.formats.recordings import write_recording

UR5 = load_robot("ur5")
QUADRATIC = np.array([9.0, 8.0, 7.0, 3.0, 2.5, 2.0])  # fq of each joint [N·m·s²/rad²]


def _squared(speed: Quantity, _load: Quantity) -> Quantity:
    return speed * speed


FQ = FrictionTerm(name="fq", magnitude=_squared, smooth=False)  # [N·m·s²/rad²] turbulent friction


@pytest.fixture
def law(monkeypatch):
    """The law, as long as one test runs."""
    new = FrictionLaw(name="quadratic", terms=(FC, FV, FQ))
    with monkeypatch.context() as registry:
        registry.setitem(LAWS, new.name, new)
        yield new
    with pytest.raises(BadInput, match=f"known are {', '.join(LAWS)}, and auto"):
        friction.friction_law("quadratic")


def arm(seed=0):
    """The oracle's arm with a quadratic viscous term."""
    known = truth(UR5, seed=seed)
    return replace(known, torque=known.torque + QUADRATIC * np.abs(known.qd) * known.qd)


def test_identify_prints_and_validates_the_new_law(law, tmp_path):
    """fq comes back to 5 % and 4 σ. On a motion that was not fitted, the error is under half of the paper's. Help and `auto` name it."""
    for seed in (0, 1):
        write_recording(tmp_path / f"{seed}.parquet", recording(arm(seed), seed=seed))
    options = ["identify", str(tmp_path / "0.parquet"), "--robot", "ur5", "--json", "--validate", str(tmp_path / "1.parquet")]
    quadratic, paper, auto = (
        json.loads(CliRunner().invoke(app, [*options, "--friction", name]).stdout) for name in ("quadratic", "paper", "auto")
    )
    fitted = quadratic["friction"]["law"]
    assert fitted["name"] == "quadratic"
    assert fitted["parameters"] == ["fc", "fv", "fq"]
    found, std = (np.array(fitted[key]["fq"]) for key in ("values", "std"))
    np.testing.assert_allclose(found, QUADRATIC, rtol=0.05)
    assert np.all(np.abs(found - QUADRATIC) < 4.0 * std)
    rms = [np.linalg.norm(document["validation"][0]["rms_nm"]) for document in (quadratic, paper)]
    assert rms[0] < 0.5 * rms[1]
    assert auto["friction"]["law"]["name"] == "quadratic"
    assert "quadratic" in auto["friction"]["law"]["held_out"]
    assert ", quadratic, or auto" in " ".join(CliRunner().invoke(app, ["identify", "--help"]).stdout.split())


def test_the_new_law_may_be_the_residual_friction(law, monkeypatch):
    """The compensated model carries its terms, its document names it, and the error of prediction is less than half of that without it."""
    with monkeypatch.context() as registry:
        registry.setattr(friction, "RESIDUAL_LAW", law.name)
        found = identify([recording(arm())], UR5, GROUND, residual_friction=True)
    assert found.residual_friction.law == law
    outcome = judge_identification(found, Context(robot="ur5", recorded_at_unix_s=1.0), belief=None, health=None)
    assert isinstance(outcome, Assessment)
    model = outcome.model
    assert model.residual_friction.terms.shape == (6, 3)
    np.testing.assert_allclose(model.residual_friction.terms[:, 2], QUADRATIC, rtol=0.05)

    document = json.loads(json.dumps(model.as_document(), allow_nan=False))
    assert document["residual_friction"]["law_name"] == "quadratic"
    other = arm(seed=3)
    states, T = (other.q, other.qd, other.qdd), np.full(6, 31.25)
    predicted = predict_torque(model, UR5, *states, T).torque
    np.testing.assert_array_equal(predict_torque(model_from_document(document), UR5, *states, T).torque, predicted)
    for n in (100, 1234):
        sample = predictor_for(model, UR5).sample(*(state[n] for state in states), T)
        np.testing.assert_allclose(sample.torque, predicted[n], rtol=1e-9)
    without = predict_torque(replace(model, residual_friction=None), UR5, *states, T).torque
    moving = np.abs(other.qd) > 0.02
    errors = [np.sqrt(np.mean((torque - other.torque)[moving] ** 2)) for torque in (predicted, without)]
    assert errors[0] < 0.5 * errors[1]


def test_a_stored_model_of_an_unknown_law_is_refused(law, monkeypatch):
    """The message names the law and the laws that are known."""
    with monkeypatch.context() as registry:
        registry.setattr(friction, "RESIDUAL_LAW", law.name)
        found = identify([recording(arm())], UR5, GROUND, residual_friction=True)
    model = judge_identification(found, Context(robot="ur5", recorded_at_unix_s=1.0), belief=None, health=None).model
    document = json.loads(json.dumps(model.as_document(), allow_nan=False))
    with monkeypatch.context() as registry:
        registry.delitem(LAWS, law.name)
        with pytest.raises(BadInput, match="friction law 'quadratic' is not known"):
            model_from_document(document)


@pytest.mark.soak
def test_the_pages_code_has_the_approval_of_ruff_and_mypy(tmp_path):
    """The blocks of the page, written into `friction.py` at the places that the page names."""
    root = Path(__file__).parents[2]
    page = (root / "docs" / "CONTRIBUTING.md").read_text("utf-8").partition("\n## Add a friction law\n")[2].partition("\n## ")[0]
    term, entry = (textwrap.dedent(block).strip() for block in re.findall(r"^ *```python\n(.*?)^ *```", page, re.MULTILINE | re.DOTALL))
    source = (root / "monitor" / "model" / "friction.py").read_text("utf-8")
    function, constant = term.split("\n\n\n")
    for before, new in (
        ("FC = FrictionTerm(", f"{function}\n\n\n"),
        ("\n\n@dataclass(frozen=True, slots=True, kw_only=True)\nclass FrictionLaw", f"{constant}\n"),
    ):
        assert source.count(before) == 1
        source = source.replace(before, new + before)
    source = source.replace("terms=(FC, FV, FL, FS)),\n", f"terms=(FC, FV, FL, FS)),\n        {entry},\n")
    file = tmp_path / "friction.py"
    file.write_text(source, "utf-8")
    settings = str(root / "pyproject.toml")
    for tool in (
        ["ruff", "check", "--config", settings],
        ["ruff", "format", "--check", "--config", settings],
        ["mypy", "--config-file", settings, "--cache-dir", str(tmp_path / "cache")],
    ):
        pytest.importorskip(tool[0], reason=f"{tool[0]} is absent: it comes with the extra `dev`")
        done = subprocess.run([sys.executable, "-m", *tool, str(file)], capture_output=True, text=True, timeout=250, check=False, cwd=root)
        assert done.returncode == 0, done.stdout + done.stderr
