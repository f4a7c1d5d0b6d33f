"""The command as a process: files, reports, mistakes, Ctrl-C."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import Result
from prepared import Process, run
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.config.files import shared_file
from monitor.errors import BadInput
from monitor.model.fourier import excitation_from_document

COMMAND = [sys.executable, "-m", "monitor", "design"]


def ran(*arguments: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = run([*COMMAND, *map(str, arguments)], 60.0)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done


def called(*arguments: str) -> Result:
    """The command in this process, which is faster."""
    result = CliRunner().invoke(app, ["design", *arguments])
    assert result.exception is None, result.exception
    return result


@pytest.mark.slow
def test_the_same_command_gives_the_same_bytes_and_a_picture(tmp_path: Path):
    """Another process with the same seed gives an equal file. The report names the clearances, and the picture is a valid image."""
    common = ("--robot", "ur3", "--mounting", "wall", "--evaluations", 20, "--seed", 5)
    result = ran(*common, "-o", tmp_path / "a.json", "--plot", tmp_path / "a.png")
    answer = json.loads(called(*map(str, common), "-o", str(tmp_path / "b.json"), "--json").stdout)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert "clear of itself by" in result.stdout
    assert "fv std" in result.stdout
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    excitation = excitation_from_document(json.loads((tmp_path / "a.json").read_text()))
    assert answer["digest"] == excitation.digest
    assert answer["stopped"] is False


@pytest.mark.slow
def test_a_random_trajectory_for_validation_is_another_for_another_seed(tmp_path: Path):
    """It is pseudo-random, proved and reproducible."""
    for name, seed, *more in (("a", 1, "--plot", str(tmp_path / "a.html")), ("b", 1), ("c", 2)):
        called("--robot", "ur5", "--random", str(seed), "-o", str(tmp_path / f"{name}.json"), *more)
    one, same, other = ((tmp_path / f"{name}.json").read_bytes() for name in "abc")
    assert one == same != other
    assert json.loads(one)["proof"]["clearance"]["to_cell_m"] >= 0.03
    assert "<svg" in (tmp_path / "a.html").read_text()


@pytest.mark.slow
def test_ctrl_c_keeps_the_best_so_far(tmp_path: Path):
    """SIGINT in the middle of a long search: exit 0, a file with its proof, and a message."""
    search = Process(
        [*COMMAND, "--robot", "ur5", "--evaluations", "1000000", "-o", str(tmp_path / "a.json")], stderr=subprocess.PIPE, text=True
    )
    try:
        assert search.stderr is not None
        assert "Ctrl-C keeps the best so far" in search.stderr.readline()
        search.send_signal(signal.SIGINT)
        _, rest = search.communicate(timeout=30)
    finally:
        search.kill()
        search.wait()
    assert search.returncode == 0, rest
    assert "stopped after" in rest
    document = json.loads((tmp_path / "a.json").read_text())
    assert "stopped" in document["source"]
    assert document["proof"]["clearance"]["to_itself_m"] >= 0.01


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--robot", "ur7"), "known are ur10"),
        (("--robot", "ur5", "--period", "0"), "period = 0.0 s"),
        (("--robot", "ur5", "--period", "nan"), "period = nan"),
        (("--robot", "ur5", "--offset", "0,0,0"), "--offset '0,0,0': 3 given; expected 6 figures"),
        (("--robot", "ur5", "--offset", "0,nan,0,0,0,0"), "not finite; expected 6 figures"),
        (("--robot", "ur5", "--offset", "0,0.3,0,0,0,0"), "short of the margin_m of 30 mm"),
        (("--robot", "ur5", "--offset", "0,-1.57,4,0,0,0"), "joint 3 is at 4 rad, beyond its limit of 3.142 rad by 0.858 rad"),
        (("--robot", "ur5", "--torque-share", "0.05", "--offset", "0,-0.6,0,0,0,0"), "beyond its limit of 7.5 N·m"),
        (("--robot", "ur5", "--mounting", "roof"), "expected ground, ceiling, wall"),
        (("--robot", "ur5", "--objective", "beauty"), "known are friction"),
        (("--robot", "ur5", "--optimiser", "luck"), "known are cma, ga"),
        (("--robot", "ur5", "--evaluations", "0"), "evaluations = 0"),
        (("--robot", "ur5", "--cell", "absent.toml"), "cannot be read"),
        (("--robot", "ur5", "--plot", "picture.bmp"), "ends in .png or .html"),
        (("--robot", "ur5", "--time", "-1"), "--time -1"),
    ],
)
def test_a_mistake_gives_a_message_and_exit_code_2(tmp_path: Path, arguments, words):
    """No file is written, and no traceback is printed."""
    result = CliRunner().invoke(app, ["design", *arguments, "-o", str(tmp_path / "a.json")])
    assert isinstance(result.exception, BadInput)
    assert result.exception.exit_code == 2
    assert words in str(result.exception)
    assert not (tmp_path / "a.json").exists()


@pytest.mark.slow
def test_mistakes_end_the_process_with_2_and_one_line(tmp_path: Path):
    """Through the real entry point: a cell around the arm, and a target that is no file."""
    (tmp_path / "full.toml").write_text('[[box]]\nname = "crate"\ncentre_m = [0, 0, 0.5]\nsize_m = [2, 2, 2]\n')
    done = ran("--robot", "ur5", "--cell", tmp_path / "full.toml", "-o", tmp_path / "a.json", code=2)
    assert "and crate come to be" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    called("--robot", "ur5", "--cell", str(shared_file("cell/example.toml")), "--random", "1", "-o", str(tmp_path / "b.json"))


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_make_excitations_gives_the_shipped_file_again(tmp_path: Path):
    """On the same kind of machine byte for byte. On another, a library's last digit may change the path of the search: figures only."""
    options = "--seed 1 --evaluations 3000 --speed-limit 2.2 --flange-speed-limit 1.5"
    assert options in (Path(__file__).parents[2] / "Makefile").read_text("utf-8")
    called("--robot", "ur3", "--mounting", "wall", *options.split(), "-o", str(tmp_path / "again.json"))
    shipped = shared_file("excitation/ur3-wall.json").read_bytes()
    again = (tmp_path / "again.json").read_bytes()
    if again != shipped:
        merits = [json.loads(content)["objectives"]["log_det_covariance_friction"] for content in (again, shipped)]
        assert abs(merits[0] - merits[1]) < 1.5  # as two seeds differ: another path of the search, an equally good end
        pytest.skip("this machine's arithmetic differs in a last digit from the one that made the shipped files")
