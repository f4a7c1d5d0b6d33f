"""The commands `base` and `energy`, and arms that a user describes, run as a user runs them."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import printed

from monitor.config.files import find_excitation
from monitor.errors import BadInput
from monitor.model.robot import load_robot

pytestmark = pytest.mark.xdist_group("replayed")  # one worker plays the replays of these files, and those of `identify`


def test_base_prints_the_whole_object():
    """JSON has all keys, the counts by columns and as in the paper, coefficients in full precision, singular values with their energy."""
    document = json.loads(printed("base", "--robot", "ur3", "--mounting", "wall", "--json"))
    assert {"count", "singular_values", "cumulative_energy", "combinations", "classification"} <= set(document)
    assert document["count"] == len(document["combinations"]) == 54
    assert len(document["singular_values"]) == len(document["cumulative_energy"]) == 78
    second = document["combinations"][1]
    assert second["name"] == "m1z1 − 4.104·J2xz"
    assert second["terms"] == pytest.approx({"m1z1": 1.0, "J2xz": -1 / 0.24365}, rel=1e-9)
    counts = {way: [row[k] for k in ("fully", "in_combination", "not_identifiable")] for way, row in document["classification"].items()}
    assert counts == {"by_column": [37, 34, 7], "as_in_paper": [30, 42, 6]}
    assert "m5y5" not in document["quotable"]["parameters"]["fully"]


def test_base_without_json_is_a_table_to_read():
    """The table shows the combinations in full, both ways of counting, and the parameters that are identifiable alone."""
    text = printed("base", "--robot", "ur5")
    assert "m3 − 6.499·J3zz + m4 + m5 + m6" in text  # 1/0.39225²
    assert "as the paper counts" in text
    assert "may be quoted alone, in standard-dh frames: fc1, fv1, m2y2" in text


def test_energy_of_a_simulated_arm_is_its_own(replayed):
    """The largest kinetic energy along the replay's own path differs from the simulator's by less than 6 % and 3 σ.

    The simulator's friction is concave in speed. What the paper's law cannot describe of it goes into the inertia, and σ includes that.
    """
    path, controller = replayed
    document = json.loads(printed("energy", path, "--robot", "ur5", "--along", "ur5-ground", "--json"))
    found = document["kinetic_energy_j"]
    model = controller.arm.model
    data = model.createData()
    state = find_excitation("ur5-ground", Path()).at(np.array([found["at_s"]]))
    M = pin.crba(model, data, state.q[0])
    M = np.triu(M) + np.triu(M, 1).T
    truth = 0.5 * state.qd[0] @ M @ state.qd[0]
    assert found["max"] == pytest.approx(truth, rel=0.06)
    assert abs(found["max"] - truth) < 3.0 * found["std_at_max"] < 0.15 * found["max"]
    assert document["along"] == "ur5-ground"


def test_energy_with_limits_gives_its_verdict_and_that_it_is_no_safety_function(replayed):
    """One region is far above its limit, one far below; JSON and table both say that this is not a safety function."""
    path, _ = replayed
    arguments = ("energy", path, "--robot", "ur5", "--limit", "hand=0.01@0.6", "--limit", "wall=1000", "--payload", "1.5")
    document = json.loads(printed(*arguments, "--json"))
    hand, wall = document["regions"]
    assert (hand["transfer_energy_below_limit"], hand["whole_arm_below_limit"]) == (False, False)
    assert (wall["transfer_energy_below_limit"], wall["whole_arm_below_limit"]) == (True, True)
    assert wall["body_mass_kg"] is None
    arm = load_robot("ur5")
    assert document["effective_mass"]["robot_kg"] == pytest.approx(0.5 * arm.mass_kg.sum() + 1.5)
    assert wall["transfer_energy_max_j"] == pytest.approx(0.5 * (0.5 * arm.mass_kg.sum() + 1.5) * document["flange_speed_m_s"]["max"] ** 2)
    assert "not a safety function" in document["statement"]
    assert "not a safety function" in printed(*arguments)


def test_energy_along_another_arms_trajectory_is_refused(replayed):
    """The message names both arms; nothing is identified."""
    with pytest.raises(BadInput, match="is for a ur3; the robot is ur5"):
        printed("energy", replayed[0], "--robot", "ur5", "--along", "ur3-ground")


def test_a_payload_is_part_of_the_kinetic_energy(replayed):
    """½·m·v² of the flange is added for a payload that the arm was identified without; the document names the mass."""
    path, _ = replayed
    empty = json.loads(printed("energy", path, "--robot", "ur5", "--payload", "0", "--json"))
    loaded = json.loads(printed("energy", path, "--robot", "ur5", "--payload", "5", "--json"))
    more = np.array(loaded["series"]["kinetic_energy_j"]) - np.array(empty["series"]["kinetic_energy_j"])
    np.testing.assert_allclose(more, 2.5 * np.array(empty["series"]["flange_speed_m_s"]) ** 2, rtol=1e-9, atol=1e-12)
    assert loaded["payload_kg"] == 5.0
    for absurd in ("inf", "-1", "nan"):
        with pytest.raises(BadInput, match="expected 0 or more"):
            printed("energy", path, "--robot", "ur5", "--payload", absurd, "--limit", "hand=1")
    assert "[/x]" in printed("energy", path, "--robot", "ur5", "--limit", "[/x]=1")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (("mass_kg = 3.7", 'mass_kg = "x"'), "ValueError"),
        (("mass_kg = 3.7", "mass_kg = -3.7"), "mass_kg"),
        (("rate_hz = 125.0", "rate_hz = 0.0"), "rate_hz"),
        (("rate_hz = 125.0", "rate_hz = -5.0"), "rate_hz"),
        (("gear_ratio = [101.0, ", "gear_ratio = ["), "gear_ratio"),
        (("max_torque_nm = [150.0, ", 'max_torque_nm = ["a", '), "ValueError"),
        (("d_m = 0.089159", "d_m = nan"), "d_m"),
        (("d_m = 0.089159", "d_m = 1e200"), "d_m"),
        (('name = "ur5"', 'name = "ur5"\nbase_rotation = [[2, 0, 0], [0, 2, 0], [0, 0, 2]]'), "base_rotation"),
        (("inertia_kg_m2 = { xx = ", "inertia_kg_m2 = { xx = -"), "principal moment"),
    ],
)
def test_an_impossible_arm_is_refused_with_the_key(tmp_path, edit, message):
    """The message names the file and the key, whatever the TOML holds."""
    text = files("monitor.model.robots").joinpath("ur5.toml").read_text("utf-8")
    assert edit[0] in text
    (tmp_path / "mine.toml").write_text(text.replace(*edit, 1), "utf-8")
    with pytest.raises(BadInput, match=rf"mine\.toml: .*{message}"):
        printed("base", "--robot", tmp_path / "mine.toml")
