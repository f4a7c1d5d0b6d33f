"""Friction given back to control: the terms of the document are those of the predicted torque, and say what is not known."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_arm import COULOMB_NM, Arm, History
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadInput
from monitor.judge.torque.predictor import predict_torque
from monitor.model.robot import load_robot
from monitor.publish.client import Client
from monitor.publish.compensation import NODES_C, compensation, compensation_at, missing_row, model_of
from monitor.publish.documents import Model, as_json, made
from monitor.simulate.program.language import parsed

UR5 = load_robot("ur5")


@pytest.fixture(scope="module")
def learnt():
    """Model and belief after 40 replays between 20 and 40 °C."""
    history, rng, arm = History(), np.random.default_rng(1), Arm(seed=1, noise=0.01)
    for day in range(40):
        history.add(day, arm.replay(rng.uniform(20, 40)))
    return history.last.model, history.last.belief


@pytest.mark.parametrize("wear", [0.0, 0.2])
def test_the_terms_are_the_friction_of_the_predicted_torque_with_its_doubt(learnt, wear):
    """At one temperature a joint: fc·s + fv·q̇ is the predictor's friction, and ± of both with their correlation and wear is its ±."""
    model = replace(
        learnt[0],
        residual_friction=None,
        wear=np.full(6, wear),
        error_rms_nm=np.zeros(6),
        measured_rms_nm=np.zeros(6),
        wear_std=np.zeros(6),
    )
    T, v = np.array([22.0, 25.0, 28.0, 31.0, 34.0, 38.0]), np.full(6, 0.7)
    predicted = predict_torque(model, UR5, np.zeros(6), v, np.zeros(6), T)
    terms = compensation_at(model, T.tolist())
    fc, fv = (np.array([getattr(row, name) for row in terms]) for name in ("coulomb_nm", "viscous_nm_s_per_rad"))
    assert fc + fv * v == pytest.approx(predicted.friction[0])
    of_fc = np.array([row.coulomb_std_nm for row in terms])
    of_fv = v * np.array([row.viscous_std_nm_s_per_rad for row in terms])
    correlation = np.array([row.friction_correlation for row in terms])
    assert np.sqrt(of_fc**2 + of_fv**2 + 2 * correlation * of_fc * of_fv) == pytest.approx(predicted.std[0])
    assert terms[2].wear == pytest.approx(np.expm1(wear))


def test_the_terms_are_those_of_the_arm_that_was_replayed(learnt):
    """fc within 5 % and fv within 5 % of the simulated arm's own law at 25 °C."""
    terms = compensation_at(learnt[0], [25.0] * 6)
    assert np.array([row.coulomb_nm for row in terms]) == pytest.approx(np.broadcast_to(COULOMB_NM, 6), rel=0.05)
    assert np.array([row.viscous_nm_s_per_rad for row in terms]) == pytest.approx(np.broadcast_to(Arm().viscous, 6), rel=0.05)


def test_wear_that_is_not_sure_widens_both_terms(learnt):
    """A doubt of 10 % of friction is a doubt of 10 % of either term."""
    sure, unsure = (compensation_at(replace(learnt[0], wear_std=np.full(6, std)), [30.0] * 6)[2] for std in (0.0, 0.1))
    assert unsure.coulomb_std_nm == pytest.approx(np.hypot(sure.coulomb_std_nm, 0.1 * sure.coulomb_nm))
    assert unsure.viscous_std_nm_s_per_rad > sure.viscous_std_nm_s_per_rad


def test_every_replay_counts_at_one_temperature_and_those_without_any_are_extrapolated(learnt):
    """40 replays between 20 and 40 °C: each in one row of each joint; 0 to 15 and 45 to 50 °C are missing, and less sure."""
    document = compensation(*learnt)
    for joint in document.joints:
        rows = joint.by_temperature
        assert [row.temperature_c for row in rows] == NODES_C.tolist()
        assert sum(row.replays for row in rows) == 40
        assert [row.extrapolated for row in rows] == [T < 18 or T > 42 for T in NODES_C]
        assert rows[0].viscous_std_nm_s_per_rad > 1.5 * rows[6].viscous_std_nm_s_per_rad


def test_a_temperature_is_missing_where_half_of_the_joints_have_no_replay_there():
    """12 and 45 °C are, 30 °C is not; joints that are unheard, and temperatures beyond the working range, ask for nothing."""
    replayed_c = [np.array([21.0, 31.0, np.nan])] * 6
    assert [missing_row(replayed_c, np.full(6, T)) for T in (12.0, 30.0, 45.0, 60.0, -10.0, np.nan)] == [2, None, 9, None, None, None]
    assert missing_row(replayed_c, np.array([12.0, 12.0, 30.0, 30.0, 30.0, 30.0])) is None
    assert missing_row(replayed_c, np.array([12.0, 12.0, 12.0, 30.0, 30.0, 30.0])) == 2
    assert missing_row([np.empty(0)] * 6, np.full(6, 30.0)) == 6


def test_the_model_that_travels_gives_the_terms_of_the_one_that_was_learnt(learnt):
    """Through the document `model` and its JSON."""
    travelled = model_of(Model.model_validate(as_json(made(Model, learnt[0].as_document()))))
    assert compensation_at(travelled, [30.0] * 6) == compensation_at(learnt[0], [30.0] * 6)


@pytest.mark.parametrize(
    ("temperature_c", "says"), [([30.0, None, 30.0, 30.0, 30.0, 30.0], "not known"), ([], "not known"), ([300.0] * 6, "expected -40 … 120")]
)
def test_a_temperature_that_is_none_is_named(learnt, temperature_c, says):
    with pytest.raises(BadInput, match=says):
        compensation_at(learnt[0], temperature_c)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--compensation", "--q=0,0,0,0,0,0"), "--compensation is of no motion; expected no --q beside it"),
        (("--q=0,0,0,0,0,0",), "expected --q and --qd, one figure a joint each; or --compensation"),
        (("--compensation", "--temperature=1,2"), "--temperature '1,2': 2 given; expected 6"),
    ],
)
def test_predict_says_what_it_needs(arguments, says, tmp_path):
    """Exit 2 and one line."""
    config = tmp_path / "cell.toml"
    config.write_text('[robot]\nmodel = "ur5"\nid = "a"\nsite = "lab"\n[store]\ndirectory = "history"\n', "utf-8")
    result = CliRunner().invoke(app, ["predict", "--config", str(config), "--local", *arguments])
    assert isinstance(result.exception, BadInput)
    assert says in str(result.exception)


def test_the_example_writes_a_program_that_is_one_and_compensates_less_than_the_friction(learnt, monkeypatch, capsys):
    """The code of the page, with a client that has this model: URScript by the simulated controller's reader, with both scales 0."""
    model = made(Model, learnt[0].as_document())

    class Answering(Client):
        def __init__(self, *_: str) -> None:
            pass

        def __exit__(self, *_: object) -> None:
            pass

        def model(self) -> Model:
            return model

        def friction(self) -> list[SimpleNamespace]:
            return [SimpleNamespace(temperature_c=30.0)] * 6

    monkeypatch.setattr("monitor.publish.client.Client", Answering)
    page = (Path(__file__).parents[2] / "docs/torque-model.md").read_text("utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    exec(compile(code, "torque-model.md", "exec"), {})  # the page's own
    script = capsys.readouterr().out
    parsed(script, "hand_guiding", {"direct_torque", "get_actual_joint_speeds"})
    assert "direct_torque(torque, viscous_scale=none, coulomb_scale=none)" in script
    given = np.array(json.loads(re.search(r"fc = (\[.*\])", script)[1]))
    assert np.all(given > 0.8 * np.broadcast_to(COULOMB_NM, 6))
    assert np.all(given < np.broadcast_to(COULOMB_NM, 6))
