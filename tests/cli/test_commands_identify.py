"""The command `identify` with its options, run as a user runs it."""

import json
import struct
import tomllib
import zlib
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from command_line import ended, printed

from monitor.errors import BadInput, Unidentifiable
from monitor.model.friction import automatic_laws
from monitor.model.robot import load_robot
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.views.plots.residuals import Residuals, residual_plot

pytestmark = pytest.mark.xdist_group("replayed")  # one worker plays the replays of these files


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
    """The PNG has a row for each joint; the HTML file loads nothing from a network."""
    path, _ = replayed
    printed("identify", path, "--robot", "ur5", "--plot", tmp_path / "residuals.png", "--json")
    height, width, unpacked = pixels(tmp_path / "residuals.png")
    assert height > width > 1000
    assert unpacked > height * width  # a whole picture, not a header
    printed("identify", path, "--robot", "ur5", "--plot", tmp_path / "residuals.html", "--json")
    page = (tmp_path / "residuals.html").read_text("utf-8")
    assert page.startswith("<!doctype html>")
    assert "<svg" in page
    assert 'src="http' not in page
    assert "<script" not in page
    assert "replay.parquet" in page or "simulator" in page


def test_a_plot_that_cannot_be_written_is_refused_before_the_production(replayed, tmp_path):
    """A wrong ending and a missing folder are refused."""
    with pytest.raises(BadInput, match=r"ends in \.png or \.html"):
        printed("identify", replayed[0], "--robot", "ur5", "--plot", tmp_path / "residuals.pdf")
    with pytest.raises(BadInput, match="does not exist"):
        printed("identify", replayed[0], "--robot", "ur5", "--plot", tmp_path / "nowhere" / "residuals.png")


def test_a_joint_that_never_moves_is_drawn_too(tmp_path):
    """A joint without a moving sample has grey points, no line, and raises no error."""
    x = np.zeros((50, 2))
    moving = np.zeros((50, 2), dtype=bool)
    moving[:, 0] = True
    residual_plot(tmp_path / "still.png", "still", [Residuals("one", x, x, x, x + 0.1, moving)])
    assert pixels(tmp_path / "still.png")[0] > 100


# --- friction laws, methods, gains and arms of one's own ----------------------------------------------------


def test_identify_selects_a_law_and_prints_the_criterion(replayed):
    """The document has the law's parameters by joint, the held-out error of every law, and the paper's fc and fv."""
    friction = json.loads(printed("identify", replayed[0], "--robot", "ur5", "--friction", "auto", "--json"))["friction"]
    law = friction["law"]
    assert set(law["held_out"]) == {known.name for known in automatic_laws()}
    assert law["held_out"][law["name"]] <= law["held_out"]["paper"]
    if law["name"] != "paper":
        assert set(law["values"]) == set(law["parameters"])
    assert len(friction["coulomb_nm"]) == 6
    assert "chosen by the error on data left out" in printed("identify", replayed[0], "--robot", "ur5", "--friction", "auto")


def test_a_consistent_fit_is_exported_as_an_arm_that_pinocchio_loads(replayed, tmp_path):
    """Its mass matrix is positive definite at 100 random poses; the TOML has the same masses."""
    for name in ("arm.urdf", "arm.toml"):
        document = printed("identify", replayed[0], "--robot", "ur5", "--method", "consistent", "--export", tmp_path / name, "--json")
    physical = json.loads(document)["physical"]
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
    """`--urdf` has the same rank as `--robot`; the gains are given, because a URDF has no torque constants."""
    printed("identify", replayed[0], "--robot", "ur5", "--method", "consistent", "--export", tmp_path / "arm.urdf")
    assert json.loads(printed("base", "--urdf", tmp_path / "arm.urdf", "--json"))["count"] == 52
    printed("identify", replayed[0], "--robot", "ur5", "--method", "consistent", "--export", tmp_path / "arm.toml")
    assert json.loads(printed("base", "--robot", tmp_path / "arm.toml", "--json"))["count"] == 52
    recording = replayed[0]
    with pytest.raises(BadInput, match="give the joint gains"):
        printed("identify", unnamed(recording, tmp_path), "--urdf", tmp_path / "arm.urdf")
    gains = ",".join(str(gain) for gain in load_robot("ur5").drive_gain_nm_per_a)
    by_name = json.loads(printed("identify", recording, "--robot", "ur5", "--json"))
    by_urdf = json.loads(printed("identify", unnamed(recording, tmp_path), "--urdf", tmp_path / "arm.urdf", "--gains", gains, "--json"))
    assert by_urdf["friction"]["coulomb_nm"] == pytest.approx(by_name["friction"]["coulomb_nm"], rel=1e-6)


def unnamed(path, folder):
    """The same recording without the name of its arm."""
    recording = read_recording(path)
    write_recording(folder / "unnamed.parquet", replace(recording, context=replace(recording.context, robot=None)))
    return folder / "unnamed.parquet"


def test_a_payload_pair_gives_the_joint_gains(pair):
    """Gains of the joints that bear the payload are within 3 % of the simulator's, and have standard deviations."""
    empty, loaded = pair
    document = json.loads(
        printed("identify", empty, "--robot", "ur5", "--payload-pair", loaded, "--payload", "3", "--payload-com", "0,0,0", "--json")
    )
    values, std = document["gains"]["values_nm_per_a"], document["gains"]["std_nm_per_a"]
    truth = load_robot("ur5").drive_gain_nm_per_a
    for j in (1, 2):  # shoulder and elbow lift it
        assert values[j] == pytest.approx(truth[j], rel=0.03)
        assert 0.0 < std[j] < 0.05 * values[j]
    assert "joint gains from the payload pair" in printed("identify", empty, "--robot", "ur5", "--payload-pair", loaded, "--payload", "3")


def test_an_unknown_payload_is_weighed(pair):
    """3 kg are found within 5 %: arm and friction come from the empty run, only the payload from the loaded one."""
    empty, loaded = pair
    payload = json.loads(printed("identify", empty, "--robot", "ur5", "--friction", "load", "--loaded", loaded, "--json"))["payload"]
    assert payload["mass_kg"] == pytest.approx(3.0, rel=0.05)


def test_rigid_parameters_of_an_earlier_identification_stay(replayed, pair, tmp_path):
    """They are equal to the last digit, while friction is identified again."""
    earlier = tmp_path / "earlier.json"
    earlier.write_text(printed("identify", replayed[0], "--robot", "ur5", "--json"), "utf-8")
    document = json.loads(earlier.read_text("utf-8"))
    frozen = json.loads(printed("identify", pair[0], "--robot", "ur5", "--rigid-from", earlier, "--json"))
    names, before, after = document["base_parameters"]["names"], document["base_parameters"]["values"], frozen["base_parameters"]["values"]
    rigid = [k for k, name in enumerate(names) if not name.startswith("f")]
    assert [after[k] for k in rigid] == [before[k] for k in rigid]
    assert frozen["friction"]["coulomb_nm"] != document["friction"]["coulomb_nm"]


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
        (("--robot", "ur5", "--gains", "1e308,1,1,1,1,1"), "between 1e-06 and 10000"),
        (("--robot", "ur5", "--gains", "1e-300,1,1,1,1,1"), "between 1e-06 and 10000"),
        (("--robot", "ur5", "--gains", "1,2"), "2 given; expected 6 figures"),
    ],
)
def test_what_identify_cannot_do_is_refused_in_a_sentence(replayed, arguments, sentence):
    """The message says what was wrong, and what would be right."""
    with pytest.raises(BadInput, match=sentence):
        printed("identify", replayed[0], *arguments)


@pytest.mark.parametrize("text", ["", "[]", '{"robot": "ur5"}', "nonsense", "[" * 100_000, '{"robot": "ur3", "base_parameters": null}'])
def test_a_file_that_is_no_identification_is_refused(replayed, tmp_path, text):
    """The message says what is expected, whatever the file holds."""
    earlier = tmp_path / "earlier.json"
    earlier.write_text(text, "utf-8")
    with pytest.raises(BadInput, match="identify --json"):
        printed("identify", replayed[0], "--robot", "ur5", "--rigid-from", earlier)


def test_a_recording_of_another_arm_is_refused_wherever_it_comes_in(replayed, tmp_path):
    """It is refused as the loaded run, as half of a payload pair, and as the path of an energy."""
    recording = read_recording(replayed[0])
    other = tmp_path / "other.parquet"
    write_recording(other, replace(recording, t_s=recording.t_s + 1.0, context=replace(recording.context, robot="ur3")))
    for arguments in (
        ("identify", replayed[0], "--robot", "ur5", "--loaded", other),
        ("identify", replayed[0], "--robot", "ur5", "--payload-pair", other, "--payload", "3"),
        ("energy", replayed[0], "--robot", "ur5", "--along", other),
    ):
        with pytest.raises(BadInput, match="recorded on a ur3; the robot given is ur5"):
            printed(*arguments)


def test_a_joint_that_stands_still_has_dashes_in_the_table(replayed, tmp_path):
    """A figure that is unknown is a dash."""
    recording = read_recording(replayed[0])
    q, qd = recording.q.copy(), recording.qd.copy()
    q[:, 5], qd[:, 5] = 0.5, 0.0
    write_recording(tmp_path / "still.parquet", replace(recording, q=q, qd=qd))
    text = printed("identify", tmp_path / "still.parquet", "--robot", "ur5")
    assert "condition number –" in text
    assert "does not reveal" in text


def test_one_recording_given_twice_is_refused(replayed):
    """Otherwise the same data would count twice, and the standard deviations would shrink by √2."""
    with pytest.raises(BadInput, match="once more"):
        printed("identify", replayed[0], replayed[0], "--robot", "ur5")


def test_no_payload_has_no_centre_and_a_negative_one_has_a_warning(pair):
    """With the loaded run as the empty one, the payload has −3 kg: no centre is reported, and a warning is."""
    empty, loaded = pair
    document = json.loads(printed("identify", loaded, "--robot", "ur5", "--friction", "load", "--loaded", empty, "--json"))
    assert document["payload"]["com_m"] == [None] * 3
    assert "unphysical_payload" in [warning["code"] for warning in document["warnings"]]


def test_currents_that_are_zero_throughout_are_refused(replayed, tmp_path):
    """A dead sensor carries no information on friction."""
    recording = read_recording(replayed[0])
    write_recording(tmp_path / "dead.parquet", replace(recording, current=0.0 * recording.current))
    with pytest.raises(Unidentifiable, match="zero throughout"):
        printed("identify", tmp_path / "dead.parquet", "--robot", "ur5")


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
    """The message names the file."""
    document = json.loads(printed("identify", replayed[0], "--robot", "ur5", "--json"))
    for section, values in change.items():
        document[section] |= values
    (tmp_path / "earlier.json").write_text(json.dumps(document), "utf-8")
    with pytest.raises(BadInput, match=r"earlier\.json: "):
        printed("identify", replayed[0], "--robot", "ur5", "--rigid-from", tmp_path / "earlier.json")


def test_a_target_that_is_a_folder_is_refused_before_the_production(replayed, tmp_path):
    """A folder has the name of the picture, or of the arm."""
    for name, arguments in (("d.png", ("--plot",)), ("d.urdf", ("--method", "consistent", "--export"))):
        (tmp_path / name).mkdir()
        with pytest.raises(BadInput, match="is a folder"):
            printed("identify", replayed[0], "--robot", "ur5", *arguments, tmp_path / name)


def test_a_payload_that_the_arm_cannot_carry_is_refused(pair):
    """Its mass is too large, its centre too far away, or its centre is given without the pair."""
    empty, loaded = pair
    for arguments, says in (
        (("--payload-pair", loaded, "--payload", "500"), "a ur5 carries 5 kg"),
        (("--payload-pair", loaded, "--payload", "3", "--payload-com", "1e9,0,0"), "farther than 2 m"),
        (("--payload-com", "0,0,0"), "without the pair"),
    ):
        with pytest.raises(BadInput, match=says):
            printed("identify", empty, "--robot", "ur5", *arguments)


def test_six_joints_fit_a_screen_of_24_lines_and_the_rest_is_told_on_request(replayed):
    """What another motion may change stands beside fc and fv, friction at three speeds is a table; the gears' ripple comes with -v."""
    shown = ended("identify", replayed[0], "--robot", "ur5", "--validate", replayed[0]).stdout
    short = ended("identify", replayed[0], "--robot", "ur5").stdout
    assert len(short.splitlines()) <= 24
    assert "F at 0.4 rad/s, 90 % [Nm]" in short
    assert max(map(len, shown.splitlines())) <= 120
    assert "gear ripple" not in short
    assert "gear ripple" in ended("identify", replayed[0], "--robot", "ur5", "--verbose").stdout
