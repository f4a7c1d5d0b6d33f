"""The commands `base`, `energy` and `identify --plot`, run as a user runs them."""

import json
import struct
import zlib
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.config.files import find_excitation
from monitor.errors import BadInput
from monitor.model.robot import load_robot
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.recordings import write_recording
from monitor.views.plots.residuals import Residuals, residual_plot


def ran(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """One replay of the simulated UR5 with nothing in its hand, as a file, and the arm that made it."""
    from pathlib import Path

    controller = Controller(SimulateSettings(robot="ur5"))
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=2)
    path = tmp_path_factory.mktemp("replay") / "replay.parquet"
    write_recording(path, stepped_replay(controller, excitation))
    return path, controller


def test_base_prints_the_whole_object():
    """The keys of the design; counts both ways; coefficients in full precision; singular values with their energy."""
    document = json.loads(ran("base", "--robot", "ur3", "--mounting", "wall", "--json"))
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
    """Combinations in full, both counts, what may be quoted."""
    text = ran("base", "--robot", "ur5")
    assert "m3 − 6.499·J3zz + m4 + m5 + m6" in text  # 1/0.39225²
    assert "as the paper counts" in text
    assert "may be quoted alone, in standard-dh frames: fc1, fv1, m2y2" in text


def test_energy_of_a_simulated_arm_is_its_own(replayed):
    """From one replay, along its own path: within 3 of its standard deviations and 6 % of what the simulator's own dynamics hold.

    The simulator's friction is concave: what the paper's law lacks leaks into inertia, and the deviation says so.
    """
    path, controller = replayed
    document = json.loads(ran("energy", path, "--robot", "ur5", "--along", "ur5-ground", "--json"))
    from pathlib import Path

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


def test_energy_beside_limits_says_yes_no_and_what_it_is(replayed):
    """One region far above, one far below; the statement that this is no safety function in both forms."""
    path, _ = replayed
    arguments = ("energy", path, "--robot", "ur5", "--limit", "hand=0.01@0.6", "--limit", "wall=1000", "--payload", "1.5")
    document = json.loads(ran(*arguments, "--json"))
    hand, wall = document["regions"]
    assert (hand["transfer_energy_below_limit"], hand["whole_arm_below_limit"]) == (False, False)
    assert (wall["transfer_energy_below_limit"], wall["whole_arm_below_limit"]) == (True, True)
    assert wall["body_mass_kg"] is None
    arm = load_robot("ur5")
    assert document["effective_mass"]["robot_kg"] == pytest.approx(0.5 * arm.mass_kg.sum() + 1.5)
    assert wall["transfer_energy_max_j"] == pytest.approx(0.5 * (0.5 * arm.mass_kg.sum() + 1.5) * document["flange_speed_m_s"]["max"] ** 2)
    assert "not a safety function" in document["statement"]
    assert "not a safety function" in ran(*arguments)


def test_energy_along_another_arms_trajectory_is_refused(replayed):
    """By name, before anything is identified."""
    with pytest.raises(BadInput, match="is for a ur3; the robot is ur5"):
        ran("energy", replayed[0], "--robot", "ur5", "--along", "ur3-ground")


def pixels(path):
    """(height, width, unpacked bytes) of a PNG, read without the library that wrote it."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    at, packed = 8, b""
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        packed += data[at + 8 : at + 8 + length] if data[at + 4 : at + 8] == b"IDAT" else b""
        at += 12 + length
    return height, width, len(zlib.decompress(packed))


def test_identify_draws_its_residuals(replayed, tmp_path):
    """A PNG of six rows and a HTML file that fetches nothing from anywhere."""
    path, _ = replayed
    ran("identify", path, "--robot", "ur5", "--plot", tmp_path / "residuals.png", "--json")
    height, width, unpacked = pixels(tmp_path / "residuals.png")
    assert height > width > 1000
    assert unpacked > height * width  # a whole picture, not a header
    ran("identify", path, "--robot", "ur5", "--plot", tmp_path / "residuals.html", "--json")
    page = (tmp_path / "residuals.html").read_text("utf-8")
    assert page.startswith("<!doctype html>")
    assert "<svg" in page
    assert 'src="http' not in page
    assert "<script" not in page
    assert "replay.parquet" in page or "simulator" in page


def test_a_plot_that_cannot_be_written_is_refused_before_the_work(replayed, tmp_path):
    """Wrong ending, missing folder."""
    with pytest.raises(BadInput, match=r"ends in \.png or \.html"):
        ran("identify", replayed[0], "--robot", "ur5", "--plot", tmp_path / "residuals.pdf")
    with pytest.raises(BadInput, match="does not exist"):
        ran("identify", replayed[0], "--robot", "ur5", "--plot", tmp_path / "nowhere" / "residuals.png")


def test_a_joint_that_never_moves_is_drawn_too(tmp_path):
    """No moving sample: grey points, no line, no error."""
    x = np.zeros((50, 2))
    moving = np.zeros((50, 2), dtype=bool)
    moving[:, 0] = True
    residual_plot(tmp_path / "still.png", "still", [Residuals("one", x, x, x, x + 0.1, moving)])
    assert pixels(tmp_path / "still.png")[0] > 100


# --- friction laws, methods, gains and arms of one's own ----------------------------------------------------


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """The same arm without and with 3 kg at the flange, as files."""
    from pathlib import Path

    folder, excitation = tmp_path_factory.mktemp("pair"), replace(find_excitation("ur5-ground", Path()), repetitions=2)
    paths = []
    for name, payload_kg in (("empty", 0.0), ("loaded", 3.0)):
        paths.append(folder / f"{name}.parquet")
        write_recording(paths[-1], stepped_replay(Controller(SimulateSettings(robot="ur5", payload_kg=payload_kg)), excitation))
    return paths


def test_identify_chooses_a_law_and_says_by_what(replayed):
    """The law's parameters by joint, the held-out error of every law there is, and fc, fv as the paper has them."""
    friction = json.loads(ran("identify", replayed[0], "--robot", "ur5", "--friction", "auto", "--json"))["friction"]
    law = friction["law"]
    assert set(law["held_out"]) == {"paper", "load", "concave", "stribeck"}
    assert law["held_out"][law["name"]] <= law["held_out"]["paper"]
    if law["name"] != "paper":
        assert set(law["values"]) == set(law["parameters"])
    assert len(friction["coulomb_nm"]) == 6
    assert "chosen by the error on data left out" in ran("identify", replayed[0], "--robot", "ur5", "--friction", "auto")


def test_a_consistent_fit_is_exported_as_an_arm_that_pinocchio_loads(replayed, tmp_path):
    """Its mass matrix is positive definite wherever it is tried; the TOML reads back as the same masses."""
    import tomllib

    for name in ("arm.urdf", "arm.toml"):
        told = ran("identify", replayed[0], "--robot", "ur5", "--method", "consistent", "--export", tmp_path / name, "--json")
    physical = json.loads(told)["physical"]
    assert 1.0 <= physical["residual_ratio"] <= 1.02
    assert min(physical["coulomb_nm"] + physical["viscous_nm_s_per_rad"] + physical["rotor_kg_m2"]) >= 0.0
    model = pin.buildModelFromXML((tmp_path / "arm.urdf").read_text())
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(100):
        M = pin.crba(model, data, rng.uniform(-np.pi, np.pi, 6))
        assert np.linalg.eigvalsh(np.triu(M) + np.triu(M, 1).T)[0] > 0.0
    links = tomllib.loads((tmp_path / "arm.toml").read_text())["link"]
    assert [link["mass_kg"] for link in links] == pytest.approx([link["mass_kg"] for link in physical["links"]])


def test_an_exported_arm_is_an_arm_to_identify(replayed, tmp_path):
    """`--urdf` instead of `--robot`: the same rank; a URDF has no torque constants, so the gains are given."""
    ran("identify", replayed[0], "--robot", "ur5", "--method", "consistent", "--export", tmp_path / "arm.urdf")
    assert json.loads(ran("base", "--urdf", tmp_path / "arm.urdf", "--json"))["count"] == 52
    ran("identify", replayed[0], "--robot", "ur5", "--method", "consistent", "--export", tmp_path / "arm.toml")
    assert json.loads(ran("base", "--robot", tmp_path / "arm.toml", "--json"))["count"] == 52
    recording = replayed[0]
    with pytest.raises(BadInput, match="give the joint gains"):
        ran("identify", strange(recording, tmp_path), "--urdf", tmp_path / "arm.urdf")
    gains = ",".join(str(gain) for gain in load_robot("ur5").drive_gain_nm_per_a)
    by_name = json.loads(ran("identify", recording, "--robot", "ur5", "--json"))
    by_urdf = json.loads(ran("identify", strange(recording, tmp_path), "--urdf", tmp_path / "arm.urdf", "--gains", gains, "--json"))
    assert by_urdf["friction"]["coulomb_nm"] == pytest.approx(by_name["friction"]["coulomb_nm"], rel=1e-6)


def strange(path, folder):
    """The same recording as of an arm nobody has named."""
    from monitor.store.recordings import read_recording

    recording = read_recording(path)
    write_recording(folder / "strange.parquet", replace(recording, context=replace(recording.context, robot=None)))
    return folder / "strange.parquet"


def test_a_payload_pair_tells_the_joint_gains(pair):
    """Within 3 % of those the simulator has, on the joints that bear the payload, with their standard deviations."""
    empty, loaded = pair
    told = json.loads(
        ran("identify", empty, "--robot", "ur5", "--payload-pair", loaded, "--payload", "3", "--payload-com", "0,0,0", "--json")
    )
    values, std = told["gains"]["values_nm_per_a"], told["gains"]["std_nm_per_a"]
    truth = load_robot("ur5").drive_gain_nm_per_a
    for j in (1, 2):  # shoulder and elbow lift it
        assert values[j] == pytest.approx(truth[j], rel=0.03)
        assert 0.0 < std[j] < 0.05 * values[j]
    assert "joint gains from the payload pair" in ran("identify", empty, "--robot", "ur5", "--payload-pair", loaded, "--payload", "3")


def test_an_unknown_payload_is_weighed(pair):
    """3 kg within 5 %: arm and friction from the empty run, nothing but the payload from the loaded one."""
    empty, loaded = pair
    payload = json.loads(ran("identify", empty, "--robot", "ur5", "--friction", "load", "--loaded", loaded, "--json"))["payload"]
    assert payload["mass_kg"] == pytest.approx(3.0, rel=0.05)


def test_rigid_parameters_of_an_earlier_identification_stay(replayed, pair, tmp_path):
    """To the last digit, while friction is found anew."""
    earlier = tmp_path / "earlier.json"
    earlier.write_text(ran("identify", replayed[0], "--robot", "ur5", "--json"), "utf-8")
    told = json.loads(earlier.read_text("utf-8"))
    frozen = json.loads(ran("identify", pair[0], "--robot", "ur5", "--rigid-from", earlier, "--json"))
    names, before, after = told["base_parameters"]["names"], told["base_parameters"]["values"], frozen["base_parameters"]["values"]
    rigid = [k for k, name in enumerate(names) if not name.startswith("f")]
    assert [after[k] for k in rigid] == [before[k] for k in rigid]
    assert frozen["friction"]["coulomb_nm"] != told["friction"]["coulomb_nm"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--robot", "ur5", "--urdf", "x.urdf"), "both of --robot and --urdf"),
        ((), "neither of --robot and --urdf"),
        (("--robot", "ur5", "--payload", "3"), "belong together"),
        (("--robot", "ur5", "--method", "magic"), "method 'magic' is not known; known are ls, wls, robust, consistent"),
        (("--robot", "ur5", "--friction", "dahl"), "known are paper, load, concave, stribeck"),
        (("--robot", "ur5", "--export", "arm.urdf"), "expected --method consistent"),
        (("--robot", "ur5", "--method", "consistent", "--export", "arm.step"), r"ends in \.urdf or \.toml"),
        (("--robot", "ur5", "--rigid-from", "nowhere.json"), "cannot be read"),
        (("--robot", "ur5", "--gains", "1e308,1,1,1,1,1"), "between 0.001 and 10000"),
        (("--robot", "ur5", "--gains", "1e-300,1,1,1,1,1"), "between 0.001 and 10000"),
        (("--robot", "ur5", "--gains", "1,2"), "2 given; expected 6 figures"),
    ],
)
def test_what_identify_cannot_do_is_refused_in_a_sentence(replayed, arguments, sentence):
    """What was wrong, and what would be right."""
    with pytest.raises(BadInput, match=sentence):
        ran("identify", replayed[0], *arguments)


@pytest.mark.parametrize("text", ["", "[]", '{"robot": "ur5"}', "nonsense", "[" * 100_000, '{"robot": "ur3", "base_parameters": null}'])
def test_what_is_no_earlier_identification_is_refused(replayed, tmp_path, text):
    """Whatever stands in the file, the answer is a sentence."""
    earlier = tmp_path / "earlier.json"
    earlier.write_text(text, "utf-8")
    with pytest.raises(BadInput, match="identify --json"):
        ran("identify", replayed[0], "--robot", "ur5", "--rigid-from", earlier)


# --- what an independent tester broke ------------------------------------------------------------------------


def test_a_payload_is_part_of_the_kinetic_energy(replayed):
    """½·m·v² of the flange is added where the arm was identified without it, and the figure says with how much."""
    path, _ = replayed
    empty = json.loads(ran("energy", path, "--robot", "ur5", "--payload", "0", "--json"))
    loaded = json.loads(ran("energy", path, "--robot", "ur5", "--payload", "5", "--json"))
    more = np.array(loaded["series"]["kinetic_energy_j"]) - np.array(empty["series"]["kinetic_energy_j"])
    np.testing.assert_allclose(more, 2.5 * np.array(empty["series"]["flange_speed_m_s"]) ** 2, rtol=1e-9, atol=1e-12)
    assert loaded["payload_kg"] == 5.0
    for absurd in ("inf", "-1", "nan"):
        with pytest.raises(BadInput, match="expected 0 or more"):
            ran("energy", path, "--robot", "ur5", "--payload", absurd, "--limit", "hand=1")
    assert "[/x]" in ran("energy", path, "--robot", "ur5", "--limit", "[/x]=1")


def test_a_recording_of_another_arm_is_refused_wherever_it_comes_in(replayed, tmp_path):
    """As the loaded run, as half of a payload pair, as the path of an energy."""
    from monitor.store.recordings import read_recording

    recording = read_recording(replayed[0])
    other = tmp_path / "other.parquet"
    write_recording(other, replace(recording, t_s=recording.t_s + 1.0, context=replace(recording.context, robot="ur3")))
    for arguments in (
        ("identify", replayed[0], "--robot", "ur5", "--loaded", other),
        ("identify", replayed[0], "--robot", "ur5", "--payload-pair", other, "--payload", "3"),
        ("energy", replayed[0], "--robot", "ur5", "--along", other),
    ):
        with pytest.raises(BadInput, match="recorded on a ur3; the robot given is ur5"):
            ran(*arguments)


def test_a_joint_that_stands_still_is_told_in_the_table_too(replayed, tmp_path):
    """What is unknown is a dash, not a traceback."""
    from monitor.store.recordings import read_recording

    recording = read_recording(replayed[0])
    q, qd = recording.q.copy(), recording.qd.copy()
    q[:, 5], qd[:, 5] = 0.5, 0.0
    write_recording(tmp_path / "still.parquet", replace(recording, q=q, qd=qd))
    text = ran("identify", tmp_path / "still.parquet", "--robot", "ur5")
    assert "condition number –" in text
    assert "does not reveal" in text


def test_one_recording_given_twice_is_refused(replayed):
    """It would be believed twice: the standard deviations would shrink by √2 for nothing."""
    with pytest.raises(BadInput, match="once more"):
        ran("identify", replayed[0], replayed[0], "--robot", "ur5")


def test_no_payload_has_no_centre_and_a_negative_one_is_doubted(pair):
    """Empty against empty: nothing shows. Loaded first, empty as loaded: a mass of −3 kg is told as what it is."""
    empty, loaded = pair
    told = json.loads(ran("identify", loaded, "--robot", "ur5", "--friction", "load", "--loaded", empty, "--json"))
    assert told["payload"]["com_m"] == [None] * 3
    assert "unphysical_payload" in [warning["code"] for warning in told["warnings"]]


def test_currents_of_nothing_are_refused(replayed, tmp_path):
    """A sensor that is dead says nothing of friction."""
    from monitor.errors import Unidentifiable
    from monitor.store.recordings import read_recording

    recording = read_recording(replayed[0])
    write_recording(tmp_path / "dead.parquet", replace(recording, current=0.0 * recording.current))
    with pytest.raises(Unidentifiable, match="zero throughout"):
        ran("identify", tmp_path / "dead.parquet", "--robot", "ur5")


@pytest.mark.parametrize(
    ("edit", "says"),
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
def test_an_arm_that_cannot_be_is_refused_by_the_key(tmp_path, edit, says):
    """Whatever stands in the TOML, the answer is a sentence that names the file and the key."""
    from importlib.resources import files

    text = files("monitor.model.robots").joinpath("ur5.toml").read_text("utf-8")
    assert edit[0] in text
    (tmp_path / "mine.toml").write_text(text.replace(*edit, 1), "utf-8")
    with pytest.raises(BadInput, match=rf"mine\.toml: .*{says}"):
        ran("base", "--robot", tmp_path / "mine.toml")


@pytest.mark.parametrize(
    "change",
    [
        {"base_parameters": {"condition_number": "x"}},
        {"base_parameters": {"condition_number": [1]}},
        {"base_parameters": {"names": 5}},
        {"base_parameters": {"names": None}},
        {"base_parameters": {"values": [1e300] * 52}},
        {"fit": {"samples": float("inf")}},
    ],
)
def test_an_earlier_identification_with_a_wrong_value_is_refused(replayed, tmp_path, change):
    """A sentence that names the file."""
    told = json.loads(ran("identify", replayed[0], "--robot", "ur5", "--json"))
    for section, values in change.items():
        told[section] |= values
    (tmp_path / "earlier.json").write_text(json.dumps(told), "utf-8")
    with pytest.raises(BadInput, match=r"earlier\.json: "):
        ran("identify", replayed[0], "--robot", "ur5", "--rigid-from", tmp_path / "earlier.json")


def test_what_is_no_place_to_write_is_refused_before_the_work(replayed, tmp_path):
    """A folder of that name, for the picture and for the arm."""
    for name, arguments in (("d.png", ("--plot",)), ("d.urdf", ("--method", "consistent", "--export"))):
        (tmp_path / name).mkdir()
        with pytest.raises(BadInput, match="is a folder"):
            ran("identify", replayed[0], "--robot", "ur5", *arguments, tmp_path / name)


def test_a_payload_that_the_arm_cannot_carry_is_refused(pair):
    """By its mass, by its place, and where it is named without the pair."""
    empty, loaded = pair
    for arguments, says in (
        (("--payload-pair", loaded, "--payload", "500"), "a ur5 carries 5 kg"),
        (("--payload-pair", loaded, "--payload", "3", "--payload-com", "1e9,0,0"), "farther than 2 m"),
        (("--payload-com", "0,0,0"), "without the pair"),
    ):
        with pytest.raises(BadInput, match=says):
            ran("identify", empty, "--robot", "ur5", *arguments)
