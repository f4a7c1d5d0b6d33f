"""`assess` over files gives the daemon's verdicts, `rehearse` plays a fleet with a configuration, and mistakes are named."""

import json
import subprocess
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import ended, printed

from monitor.errors import BadInput
from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.from_files.series import Entry, Series, assess_series, dated, interval_s, manifest
from monitor.studies.rehearsal import rehearse as detection
from monitor.studies.rehearsal import rehearse as rehearsal
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.play import LEARNING_DAYS

ROOT = Path(__file__).parents[2]
START_S = 1_750_032_000.0


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> list[Path]:
    """Three stepped replays of a simulated UR5, one a day, as Parquet files."""
    folder = tmp_path_factory.mktemp("series")
    controller = Controller(SimulateSettings(seed=4))
    text = (ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")
    excitation = replace(excitation_from_document(json.loads(text)), repetitions=1)
    paths = []
    for day in range(3):
        controller.pass_time(23.5, 20.0 + 3.0 * day, 0.3)
        recording = stepped_replay(controller, excitation)
        context = replace(recording.context, recorded_at_unix_s=START_S + day * 86_400.0)
        paths.append(folder / f"day-{day}.parquet")
        write_recording(paths[-1], replace(recording, context=context))
    return paths


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return ended(*arguments, cwd=ROOT)


@pytest.mark.slow
def test_a_series_gives_the_daemons_verdicts(recordings):
    """Files in any order are judged in time order with the previous belief, and every figure equals that of `assess` alone."""
    robot = load_robot("ur5")
    document = assess_series(Series(entries=[Entry(path) for path in reversed(recordings)], robot=robot))
    assert [row["file"] for row in document["recordings"]] == ["day-0.parquet", "day-1.parquet", "day-2.parquet"]
    last = None
    for path in recordings:
        last = assess(
            read_recording(path), robot=robot, mounting=Mounting(), belief=last and last.belief, health=last and last.health
        )  # fmt: skip
        assert isinstance(last, Assessment)
    torques = [row["reference_torque_nm"] for row in document["friction"] if row["file"] == "day-2.parquet"]
    assert torques == [joint.reference_torque_nm for joint in last.friction]
    assert document["health"] == {"arm": last.health.state, "joints": [joint.state for joint in last.health.joints]}
    assert set(document) >= {"health", "alerts", "temperature", "friction", "contexts", "warnings"}


@pytest.mark.slow
def test_assess_prints_one_object(recordings):
    """The command runs from a shell, and times are in RFC 3339."""
    done = run("assess", "--robot", "ur5", "--json", *map(str, recordings))
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["friction"][0]["recorded_at"] == "2025-06-16T00:00:00Z"
    assert len(document["friction"]) == 18
    assert document["health"]["arm"] in {"NORMAL", "OFF_SPEC"}


@pytest.mark.slow
def test_rehearse_answers_for_a_configuration(tmp_path, monkeypatch):
    """A small fleet gives false alarms, delays and remaining life in one object, and a picture.

    Wear begins within five days of the end of learning. That of 100 % a year is watched for 40 days more: by then it is found, which is
    asked here; the other kinds only until it has begun.
    That it may begin on any day of a year costs two years of each kind of wear, and `make soak` plays them. The fleet without wear is
    watched for twenty days. Lives are short ones, of some weeks, and every arm is asked on each path at each share of its life.
    """
    monkeypatch.setattr(rehearsal, "FleetSettings", partial(FleetSettings, days=LEARNING_DAYS + 20))
    monkeypatch.setattr(detection, "onsets", partial(detection.onsets, latest=LEARNING_DAYS + 5))
    monkeypatch.setattr(detection, "days_to_play", lambda step, per_year: LEARNING_DAYS + (45 if per_year == 1.0 else 7))
    monkeypatch.setattr(rehearsal, "life_jobs", partial(rehearsal.life_jobs, per_year=(4.0, 6.0)))
    picture = tmp_path / "delays.png"
    document = json.loads(printed("rehearse", "--config", ROOT / "config/monitor.toml", "--arms", 16, "--json", "--plot", picture))
    assert document["robot_years"] == pytest.approx(16 * 20 / 365)
    assert {row["wear"] for row in document["detection"]} >= {"5 % step", "10 %/year"}
    fast = next(row for row in document["detection"] if row["wear"] == "100 %/year")
    assert fast["median_days"] < 40
    asked = {(row["path"], row["at_share_of_life"]): row["asked"] for row in document["remaining_life"]["by_path"]}
    assert asked == {
        (path, share): 12 if path == "straight" else 6 for path in ("straight", "exponential", "root") for share in (0.5, 0.75)
    }
    assert picture.read_bytes()[:4] == b"\x89PNG"


def listed(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "runs.csv"
    path.write_text(text, "utf-8")
    return path


def test_a_manifest_gives_times_payloads_and_mountings(tmp_path):
    """File names are relative to the folder of the manifest, and a time without an offset is UTC."""
    [entry] = manifest(listed(tmp_path, "file,recorded_at,payload_kg,mounting,note\na.csv,2026-01-31T03:00:00,1.5,ceiling,first\n"))
    assert entry.file == tmp_path / "a.csv"
    assert entry.recorded_at_unix_s == 1_769_828_400.0
    assert (entry.payload_kg, entry.mounting.roll_rad, entry.note) == (1.5, pytest.approx(np.pi), "first")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("file,recorded_at\n", "names no recording"),
        ("file,time\na.csv,2026-01-01\n", "column 'time' is not known"),
        ("file\na.csv\n", "column 'recorded_at' is missing"),
        ("file,recorded_at\na.csv,yesterday\n", "line 2: recorded_at is 'yesterday'"),
        ("file,recorded_at,payload_kg\na.csv,2026-01-01,heavy\n", "line 2: payload_kg is 'heavy'"),
        ("file,recorded_at,payload_kg\na.csv,2026-01-01,-1\n", "line 2: payload_kg is '-1'"),
        ("file,recorded_at\n ,2026-01-01\n", "line 2: no file"),
    ],
)
def test_a_manifest_that_is_wrong_is_named_by_line_and_column(tmp_path, text, says):
    """The error comes before any recording is read."""
    with pytest.raises(BadInput, match=says):
        manifest(listed(tmp_path, text))


@pytest.mark.parametrize("text", ["", "1", "d", "0d", "1y", "-1d", "nan d"])
def test_an_invalid_interval_is_refused(text):
    """An interval needs a number and a unit."""
    with pytest.raises(BadInput, match="--interval"):
        interval_s(text)


@pytest.mark.slow
def test_the_mounting_of_a_recording_counts_unless_the_user_gives_another(recordings, tmp_path):
    """The file's mounting has precedence over the default of the series, and the manifest's over the file's."""
    hung = tmp_path / "hung.parquet"
    recording = read_recording(recordings[0])
    write_recording(hung, replace(recording, context=replace(recording.context, mounting_rad=(np.pi, 0.0, 0.0))))
    series = Series(entries=[Entry(hung)], robot=load_robot("ur5"))
    ((_, mounting),) = dated(series)
    assert mounting.roll_rad == np.pi
    ((_, mounting),) = dated(replace(series, entries=[Entry(hung, mounting=Mounting())]))
    assert mounting == Mounting()
    (tmp_path / "cell.toml").write_text('[robot]\nmodel = "ur5"\nsite = "hall-2"\nid = "cell-1"\n')
    refused = run("import", "--config", str(tmp_path / "cell.toml"), str(hung))
    assert refused.returncode == 2
    assert "hangs otherwise than [robot] mounting = 'ground'" in refused.stderr


def test_a_rejected_recording_is_in_the_json_with_its_reason(recordings, tmp_path):
    """Torques where currents stood: code, parameters and text, and the same text on the terminal."""
    wrong, recording = tmp_path / "wrong.parquet", read_recording(recordings[2])
    write_recording(wrong, replace(recording, current=recording.current * load_robot("ur5").drive_gain_nm_per_a, target_current=None))
    document = json.loads(run("assess", "--robot", "ur5", "--json", str(recordings[0]), str(wrong)).stdout)
    (first, second) = document["recordings"]
    assert (first["verdict"], first["reason"]) == ("assessed", None)
    assert second["verdict"] == "rejected"
    assert second["reason"]["code"] == "recording_not_trusted"
    assert "name them actual_torque" in second["reason"]["text"]
    shown = run("assess", "--robot", "ur5", str(recordings[0]), str(wrong)).stdout
    assert "rejected wrong.parquet: the recording is not to be trusted" in shown


def test_times_that_are_missing_or_the_same_are_refused(recordings):
    """One file has no time, or two files have the same."""
    robot = load_robot("ur5")
    with pytest.raises(BadInput, match="recorded at the same time"):
        assess_series(Series(entries=[Entry(recordings[0]), Entry(recordings[0])], robot=robot))
    undated = recordings[0].parent / "undated.parquet"
    recording = read_recording(recordings[0])
    write_recording(undated, replace(recording, context=replace(recording.context, recorded_at_unix_s=None)))
    with pytest.raises(BadInput, match="does not say when it was made"):
        assess_series(Series(entries=[Entry(undated)], robot=robot))
    assert assess_series(Series(entries=[Entry(undated, START_S)], robot=robot))["recordings"][0]["verdict"] == "assessed"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["assess", "--robot", "ur5"], "no recording was given"),
        (["assess", "--robot", "ur5", "--manifest", "a.csv", "b.csv"], "expected it alone"),
        (["assess", "--robot", "ur5", "--interval", "soon", "a.csv"], "--interval 'soon'"),
        (["assess", "--robot", "ur5", "--gains", "1,2", "--interval", "1d", "a.csv"], "2 given; expected 6 figures"),
        (["assess", "--robot", "ur5", "--config", "config/monitor.toml", "a.csv"], "both given"),
        (["rehearse", "--config", "config/monitor.toml", "--plot", "x.pdf"], "ends in .png or .html"),
    ],
)
def test_a_mistake_is_reported_with_exit_code_2(arguments, says):
    """There is a message and no traceback."""
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert says in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


def test_a_manifest_gives_serials_maintenance_and_revolutions(tmp_path):
    """There is one value for each joint, separated by blanks. Invalid figures are named with their line."""
    path = tmp_path / "runs.csv"
    head = "file,recorded_at,maintenance,joint_serials,revolutions\n"
    path.write_text(head + "a.csv,2026-01-01T00:00:00Z,joint 2 greased,A B C D E F,1 2 3 4 5 6.5\n", "utf-8")
    (entry,) = manifest(path)
    assert entry.maintenance == "joint 2 greased"
    assert entry.joint_serials == ("A", "B", "C", "D", "E", "F")
    assert entry.revolutions == (1.0, 2.0, 3.0, 4.0, 5.0, 6.5)
    path.write_text(head + "a.csv,2026-01-01T00:00:00Z,,,1 two 3\n", "utf-8")
    with pytest.raises(BadInput, match="line 2: revolutions is '1 two 3'"):
        manifest(path)


def test_why_a_joint_does_not_alert_is_printed_on_request(recordings):
    """--why prints sentences, and --json has them for every joint."""
    result = run("assess", "--robot", "ur5", "--why", "2", *map(str, recordings))
    assert result.returncode == 0, result.stderr
    assert "Shoulder (joint 2): no further alert, for" in result.stdout
    assert "next is the advisory tier, from +2%" in result.stdout
