"""The tables of real arms: what they say of simulated arms, whose truth is known; and, where the recordings are, of the real ones."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.config.files import find_excitation
from monitor.model.robot import load_robot
from monitor.recording import Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording
from monitor.studies.paper.printed import PRINTED
from tests.evidence import real_arms
from tests.evidence.real_arms import ARMS, Run, difference, held_by, of_shanghai, predicted, viscous_change, waves

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def simulated():
    """One replay of a simulated UR5 in the cold, and one in the warm."""
    controller, excitation = (
        Controller(SimulateSettings(robot="ur5", seed=5)),
        replace(find_excitation("ur5-ground", Path()), repetitions=1),
    )
    found = []
    for room_c in (10.0, 30.0):
        controller.pass_time(23.5, room_c, 0.3)
        found.append(Run(load_robot("ur5"), stepped_replay(controller, excitation)))
    return found


@pytest.fixture(scope="module")
def identified(simulated):
    return [run.identified() for run in simulated]


def table(folder: Path, *names: str) -> str:
    """What the command prints of a folder of recordings."""
    command = [sys.executable, "-m", "tests.evidence.real_arms", *names, "--data", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_without_the_recordings_one_sentence_says_what_is_missing(tmp_path):
    command = [sys.executable, "-m", "tests.evidence.real_arms", "all", "--data", str(tmp_path / "none")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("the recordings of real arms are missing: ")
    assert done.stderr.count("\n") == 1


def test_what_is_there_is_counted_and_what_is_missing_is_named(tmp_path, simulated):
    """The arm of the folder has its row, and every other row names its file."""
    for run, file in zip(simulated, ARMS["UR5 2014"].runs.values(), strict=True):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        write_recording(tmp_path / file, run.recording)
    rows = table(tmp_path, "warm-up", "aggregates").splitlines()
    (ours,) = [row for row in rows if row.startswith("| UR5 2014, 6 → 7 |")]
    assert len(re.findall(r"-\d+\.\d ± \d+\.\d %", ours)) == 6
    (other,) = [row for row in rows if row.startswith("| UR10e, ")]
    assert "left out: ur10e/ur-20_02_10-30sec_12harm.csv is not in the folder of recordings" in other
    assert rows[-1].startswith("left out: arms/nist_ur5/")


def test_a_warm_arms_viscous_friction_is_lower_in_every_joint(identified):
    change, std = viscous_change(*identified)
    assert np.all(change < -3.0 * std)


def test_identify_predicts_a_held_out_run_better_than_plain_least_squares_and_the_manufacturer(simulated):
    """In motion; figaroh, where it is installed, agrees with the plain one, as both solve the same equations."""
    found = predicted(*simulated)
    error = found.moving
    assert error["paper"] < error["plain"] < error["manufacturer"]
    assert error["auto"] == pytest.approx(error[found.chosen])
    assert error["paper"] < 0.2 * found.torque_nm
    assert "figaroh" not in error or error["figaroh"] == pytest.approx(error["plain"], rel=0.02)


def test_a_joint_that_was_slower_than_the_speed_is_not_compared_there(identified):
    cold, warm = identified
    slow = replace(warm, max_speed_rad_s=np.array([0.3, *warm.max_speed_rad_s[1:]]))
    assert held_by(cold, warm, 0.4).counted == 12
    assert held_by(cold, slow, 0.4).counted == 10
    assert np.isnan(difference(cold, slow).each).tolist() == [True] + 5 * [False]


def test_scatter_is_that_of_one_run_and_what_all_joints_share_is_taken_out(identified):
    """Two runs of which one has 2 % more friction differ by √2·σ; without what is common, by nothing."""
    (one, _), more = identified, np.sqrt(2.0) * 0.02
    other = replace(one, coulomb_nm=one.coulomb_nm * np.exp(more), viscous_nm_s_per_rad=one.viscous_nm_s_per_rad * np.exp(more))
    found = difference(one, other)
    assert found.scatter == pytest.approx(0.02)
    assert found.own == pytest.approx(0.0, abs=1e-12)


def test_the_phase_of_a_ripple_is_found_in_both_directions():
    """0.1·cos(101·q − 1) in joint 1 beside the torque of the motion: amplitude within 2 %, phase within 0.02 rad."""
    t_s = np.arange(0.0, 40.0, 0.008)
    q = 1.5 * np.sin(0.4 * t_s)[:, None] * np.ones(6)
    qd = 0.6 * np.cos(0.4 * t_s)[:, None] * np.ones(6)
    current = 0.5 * np.sign(qd) + 0.3 * q
    current[:, 0] += 0.1 * np.cos(101.0 * q[:, 0] - 1.0)
    found = waves(Run(load_robot("ur5"), Recording(t_s=t_s, q=q, qd=qd, current=current)))
    assert np.abs(found[0, 0]) == pytest.approx([0.1, 0.1], rel=0.02)
    assert np.angle(found[0, 0]) == pytest.approx([1.0, 1.0], abs=0.02)
    assert np.all(np.abs(found[1:, 0]) < 0.005)


def test_rows_that_stand_three_times_become_one():
    """And speeds, units and the sign of the third axis are put right."""
    q = np.repeat(np.arange(4.0), 3)[:, None] * np.ones(6)
    held = Recording(t_s=np.arange(12.0), q=q, qd=np.full((12, 6), 3.0), current=np.full((12, 6), 1000.0))
    found = of_shanghai(held)
    assert found.t_s.tolist() == [0.0, 3.0, 6.0, 9.0]
    assert np.all(found.qd == 1.0)
    assert found.torque[0].tolist() == pytest.approx([34.768, 34.768, -34.768, 13.562, 13.562, 13.562])


@pytest.fixture(scope="module")
def arms(real_data):
    if not (real_data / "arms").is_dir():
        pytest.skip("the recordings of other arms are absent: expected the folder arms beside ur10e")
    return real_data


def test_a_real_ur3_warms_up_as_the_papers_does(arms):
    """Four runs of one trajectory within 35 minutes: fv falls from run to run, and in the end as in the paper, within 7 points a joint."""
    runs = [real_arms.identified(arms, "UR3 Brasilia", label) for label in "ABCD"]
    falls = np.array([[viscous_change(runs[0], run)[0][joint] for joint in range(6)] for run in runs])
    assert np.all(np.diff(falls, axis=0) < 0.0)
    assert 100.0 * falls[-1] == pytest.approx(real_arms.PAPER["UR3, paper"], abs=7.0)
    assert falls[-1] == pytest.approx(PRINTED["ur3"].elsewhere_change, abs=0.002)  # what `reproduce` shows of it


def test_the_ripple_of_a_real_ur3_keeps_its_phase_from_run_to_run(arms):
    (row,) = [each for each in real_arms.ripple(arms) if each.startswith("| UR3 Brasilia, C–D")]
    within, of = re.search(r"(\d+) of (\d+) \|$", row.strip()).groups()
    assert int(of) >= 16
    assert int(within) >= 0.9 * int(of)


def test_one_row_less_of_the_shanghai_arm_does_not_change_its_uncertainty(arms):
    """Without its speeds, as it is and less its first rows: ± within a fifth on every joint. They were 5 and 292 N·m once."""
    run = real_arms.run_of(arms, "Shanghai", "1")
    recording = replace(run.recording, qd=None)
    fewer = [run._replace(recording=real_arms.rows(recording, np.arange(recording.samples) >= first)) for first in range(4)]
    std = np.array([each.identified().line_at(0.4)[1] for each in fewer])
    assert np.all(np.max(std, axis=0) < 1.2 * np.min(std, axis=0))


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_the_page_shows_what_the_command_prints(arms):
    """Row by row, of the recordings that are here. The ratio of times is another in each run, and so is a row without figaroh."""
    page = (ROOT / "docs" / "real-arms-tables.md").read_text("utf-8")
    for name in (name for name in real_arms.TABLES if name not in {"held-out", "at-rest-too"}):
        for row in table(arms, name).splitlines():
            assert not row.startswith("|") or "left out" in row or row.startswith("| all ") or row in page, row
