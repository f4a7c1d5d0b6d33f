"""`joint-monitor listen`: what it prints, and what it refuses."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from command_line import printed

from monitor.errors import BadInput, StoreError
from monitor.identify.production.arm import ProductionRows
from monitor.model.robot import Mounting, load_robot
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.from_files.production_files import ListenRequest, listen_to_files
from monitor.store.store import Store


@pytest.fixture(scope="module")
def arm_and_production(replayed, tmp_path_factory):
    """A replay, and the second time of the motion as if it were work."""
    path = tmp_path_factory.mktemp("production") / "production.parquet"
    write_recording(path, ProductionRows(recording=read_recording(replayed[0])).part(slice(1250, None)).recording)
    return replayed[0], path


def asked(*files, **others):
    """The document of a request."""
    request = {"rigid": None, "history": None, "robot": None, "mounting": None} | others
    return listen_to_files(ListenRequest(files=files, **request), load_robot)


def test_listen_tells_friction_of_every_joint_by_a_recording_and_by_json(arm_and_production, tmp_path):
    """The replay as a recording or as `identify --json`: the same friction within the deviation; the table has six joints."""
    replay, production = arm_and_production
    document = asked(production, rigid=replay)
    identified = tmp_path / "replay.json"
    identified.write_text(printed("identify", replay, "--robot", "ur5", "--json"))
    by_json = asked(production, rigid=identified)
    for one, other in zip(document["joints"], by_json["joints"], strict=True):
        assert abs(one["friction_nm"] - other["friction_nm"]) < 2.0 * (one["deviation_nm"] + other["deviation_nm"])
    text = printed("listen", production, "--rigid", replay)
    assert sum(line.startswith("│") for line in text.splitlines()) == 6
    assert "of motion counted" in text


def test_columns_of_production_are_read_from_files(arm_and_production, tmp_path):
    """A CSV with RTDE's names: the payload's register marks where something else is carried."""
    replay, production = arm_and_production
    recording = read_recording(production)
    N = recording.samples
    names = ["timestamp", *(f"{name}_{j}" for name in ("actual_q", "actual_qd", "actual_current") for j in range(6)), "payload"]
    payload = np.zeros(N)
    payload[N // 2 :] = np.nan
    table = np.column_stack([recording.t_s, recording.q, recording.qd, recording.current, payload])
    path = tmp_path / "production.csv"
    path.write_text("\n".join([",".join(names), *(",".join(map(repr, row)) for row in table.tolist())]))
    left = asked(path, rigid=replay, robot=load_robot("ur5"))["left_out_s"]
    assert left["payload_unknown"] > 0.4 * N / 125.0


def test_the_last_replay_of_a_history_stands_for_the_replay(arm_and_production, tmp_path):
    """`--history` reads its recording; a history without one is refused."""
    replay, production = arm_and_production
    with pytest.raises(StoreError, match="no history yet"):
        asked(production, history=tmp_path)
    with Store.open(tmp_path) as store:
        number = store.ledger.claim(1e9, "scheduled", 1e9)
        shutil.copy(replay, store.recordings.path(number))
        store.ledger.mark_recorded(number)
        empty = {"assessment": {}, "friction": [], "belief": {}, "health": {}, "model": {}, "events": []}
        store.assessments.commit(number, at_unix_s=1e9, recorded_at_unix_s=1e9, **empty)
    assert asked(production, history=tmp_path)["joints"] == asked(production, rigid=replay)["joints"]
    store.recordings.path(number).unlink()
    with pytest.raises(BadInput, match="has no recording of an assessed replay"):
        asked(production, history=tmp_path)


def test_rows_that_are_written_again_are_told_beside_the_rate_of_the_file(arm_and_production, tmp_path):
    """A log at twice the rate of its signals: no time is lost, and half of its rows are no readings."""
    replay, production = arm_and_production
    recording = read_recording(production)
    twice = {name: np.repeat(signal, 2, axis=0) for name, signal in recording.signals.items()}
    twice["t_s"] = np.linspace(recording.t_s[0], recording.t_s[-1], 2 * recording.samples)
    write_recording(tmp_path / "held.parquet", replace(recording, **twice))
    (told,) = [warning for warning in asked(tmp_path / "held.parquet", rigid=replay)["warnings"] if warning["code"] == "rejected_rows"]
    assert told["parameters"]["why"] == [f"{recording.samples} held"]
    assert "rejected_rows" not in {warning["code"] for warning in asked(production, rigid=replay)["warnings"]}


def test_what_does_not_belong_together_is_refused(arm_and_production, tmp_path):
    """Each with what would be right."""
    (replay, production), arm = arm_and_production, load_robot("ur5")
    with pytest.raises(BadInput, match="neither of --rigid and --history given"):
        asked(production)
    with pytest.raises(BadInput, match="both of --rigid and --history given"):
        asked(production, rigid=replay, history=tmp_path)
    with pytest.raises(BadInput, match="recorded on a ur5; the robot given is ur3"):
        asked(production, rigid=replay, robot=load_robot("ur3"))
    with pytest.raises(BadInput, match="once more"):
        asked(production, production, rigid=replay)
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    with pytest.raises(BadInput, match=r"broken.json: is not JSON"):
        asked(production, rigid=broken)
    broken.write_text('{"robot": "ur5"}')
    with pytest.raises(BadInput, match="is no identification"):
        asked(production, rigid=broken)
    with pytest.raises(BadInput, match="no such file"):
        asked(tmp_path / "none.parquet", rigid=replay)
    unnamed = tmp_path / "unnamed.parquet"
    recording = read_recording(replay)
    write_recording(unnamed, replace(recording, context=replace(recording.context, robot=None)))
    with pytest.raises(BadInput, match="does not say of which robot"):
        asked(production, rigid=unnamed)
    broken.write_text(json.dumps(json.loads(printed("identify", replay, "--robot", "ur5", "--json")) | {"robot": "ur3"}))
    with pytest.raises(BadInput, match="holds 52 base parameters of ur3"):
        asked(production, rigid=broken, robot=arm, mounting=Mounting())


def test_gains_that_are_not_those_of_the_arm_are_refused(arm_and_production, tmp_path):
    """Beside an `identify --json`, whose arm is not known when the gains are read: one gain is not taken for those of all joints."""
    replay, production = arm_and_production
    identified = tmp_path / "replay.json"
    identified.write_text(printed("identify", replay, "--robot", "ur5", "--json"))
    for gains in ([10.0], [10.0, 10.0, 10.0], [10.0, 10.0, 10.0, 10.0, 10.0, np.nan], [0.0] * 6):
        with pytest.raises(BadInput, match=r"--gains: .*expected 6 numbers between 1e-06 and 10000"):
            asked(production, rigid=identified, gains=np.array(gains))
