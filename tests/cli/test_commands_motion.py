"""`check`, `replay`, `record` and `allow` on a simulated arm, with the output that a person reads."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import jsonschema
import pytest
import zenoh
from command_line import ended, program
from excitations import short
from prepared import Process, run
from sim_process import Spawned, eventually
from simulated_arm import AT_START
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import MotionRefused
from monitor.publish.registry import schema
from monitor.publish.session import session_config
from monitor.store.formats.recordings import read_recording
from monitor.store.store import Store

pytestmark = pytest.mark.real_time

PROGRAM = (sys.executable, "-m", "monitor")
HOST = f"127.0.6.{10 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}"


@pytest.fixture(scope="module")
def remote():
    """A simulated UR5 that stands where `short()` begins."""
    spawned = Spawned(HOST, AT_START)
    try:
        with spawned.remote() as remote:
            yield remote
    finally:
        spawned.end()


@pytest.fixture
def config(tmp_path: Path, free_port: int):
    """Writes a configuration; keyword arguments replace or add lines of [replay]."""
    (tmp_path / "short.json").write_text(json.dumps(short().as_document()))

    def write(robot: str = "", **replay: object) -> Path:
        settings = {"allow_motion": True, "excitation": "short.json", "cell": "unchecked", "first_pass": False, **replay}
        lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
        path = tmp_path / "cell.toml"
        path.write_text(
            f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "{HOST}"\n{robot}\n[replay]\n' + "\n".join(lines) + "\n"
            f'[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
        )
        return path

    return write


def checked(path: Path) -> tuple[int, dict]:
    """Exit code and conditions of `check --json`, run in this process, which saves the second that another takes to start."""
    done = CliRunner().invoke(app, ["check", "--config", str(path), "--json"])
    return done.exit_code, {each["name"]: each for each in json.loads(done.stdout)["conditions"]}


def test_check_looks_and_neither_uploads_nor_moves_anything(remote, config):
    """Where every condition holds the exit code is 0 and each is named; the arm, its program and its registers are as they were."""
    before = remote.truth()
    code, found = checked(config())
    assert code == 0, found
    assert found["gravity"]["checked"]
    assert found["payload"]["checked"]
    done = program("check", "--config", config())
    table = done.stdout
    assert done.returncode == 0, done.stderr
    assert "the arm may move" in table
    assert all(name in table for name in found)
    after = remote.truth()
    assert after["scripts_started"] == before["scripts_started"]
    assert after["q"] == pytest.approx(before["q"], abs=1e-5)  # rad: an arm held by friction does not creep
    assert len(after["stops"]) == len(before["stops"])


def test_check_reports_who_answers_on_the_bus(remote, config, free_port):
    """An endpoint where nobody listens does not forbid a motion, and is reported; a router without a daemon is reported as such."""
    path = config()
    done = ended("check", "--config", path)
    assert done.returncode == 0
    assert f"bus, commands at tcp/127.0.0.1:{free_port}: nobody: nobody listens there" in " ".join(done.stdout.split())
    router = zenoh.open(session_config(mode="router", listen=(f"tcp/127.0.0.1:{free_port}",)))
    with router:
        found = json.loads(CliRunner().invoke(app, ["check", "--config", str(path), "--json"]).stdout)["bus"]
    assert [(row["who"], row["cause"]) for row in found] == [("commands", "nothing_said")]


@pytest.mark.parametrize(
    ("fault", "undone", "robot", "names"),
    [
        (("remote", {"state": "off"}), ("clear", {}), "", {"remote_control"}),
        (None, None, "payload_kg = 2.0", {"payload"}),
        (None, None, 'serial = "1"', {"serial"}),
        (None, None, 'mounting = "wall"', {"trajectory", "gravity"}),
    ],
)
def test_check_names_each_obstacle_to_a_motion_and_ends_with_three(remote, config, fault, undone, robot, names):
    """One thing is wrong: `check` names it, and a replay is refused with the same words."""
    if fault:
        remote.fault(fault[0], **fault[1])
    try:
        path = config(robot)
        code, found = checked(path)
        assert code == 3
        assert {name for name, each in found.items() if not each["holds"]} == names
        refused = CliRunner().invoke(app, ["replay", "--config", str(path), "-o", str(path.with_suffix(".parquet"))])
        first = next(each for each in found.values() if not each["holds"])
        assert isinstance(refused.exception, MotionRefused)
        assert first["name"] in str(refused.exception)
        assert not path.with_suffix(".parquet").exists()
    finally:
        if undone:
            remote.fault(undone[0], **undone[1])


def test_an_old_controller_that_lacks_variables_is_reported_without_a_crash(remote, config):
    """Such a controller refuses the whole request and names the variables; the others are asked for again."""
    remote.fault("not_found", names="payload,payload_cog,actual_tool_accelerometer")
    try:
        code, found = checked(config())
    finally:
        remote.fault("clear")
    assert code == 0
    for name in ("payload", "gravity"):
        assert found[name]["text"].startswith("not reported")
        assert not found[name]["checked"]


def test_an_arm_that_is_not_there_fails_its_conditions(config):
    """There is no traceback, and no condition on the arm counts as fulfilled."""
    path = config()
    path.write_text(path.read_text().replace(HOST, "127.0.6.250"))
    code, found = checked(path)
    assert code == 3
    assert "unknown" in found["safety_mode"]["text"]
    assert "unknown" in found["remote_control"]["text"]


def test_a_bad_configuration_ends_check_with_two(tmp_path):
    """The exit code is not 3, because no condition was checked."""
    (tmp_path / "bad.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[replay]\npermit = "perhaps"\nstartup_timeout_s = 1e9\n'
    )
    done = ended("check", "--config", tmp_path / "bad.toml")
    assert done.returncode == 2
    assert "startup_timeout_s" in done.stderr


def test_a_protective_stop_waits_for_a_person_with_name_and_reason(remote, config):
    """The stop ends the replay and is stored. It refuses the next replay also after the unlock, until a person allows motion by name."""
    path = config(approach_speed_rad_s=1.0)
    output = path.parent / "r.parquet"
    command = [*PROGRAM, "replay", "--config", str(path), "-o", str(output)]
    moving = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)  # as a person starts it: no other test does
    try:
        assert eventually(lambda: max(abs(speed) for speed in remote.truth()["qd"]) > 0.1, 20.0)
        remote.protective_stop()
        stopped_s = time.monotonic()
        _, printed = moving.communicate(timeout=20)
    finally:
        moving.kill()
    assert moving.returncode == 1
    assert "protective_stop" in printed
    assert "Traceback" not in printed
    time.sleep(max(5.1 - (time.monotonic() - stopped_s), 0.0))  # the controller refuses to unlock earlier
    from monitor.acquire.ur.dashboard import Dashboard

    with Dashboard(HOST) as dashboard:
        dashboard.ask("close safety popup")
        assert "releasing" in dashboard.ask("unlock protective stop")
    assert eventually(lambda: remote.truth()["standing"], 5.0)
    code, found = checked(path)
    assert code == 3
    assert "joint-monitor allow" in found["previous_stop"]["text"]
    refused = ended("replay", "--config", path, "-o", output)
    assert refused.returncode == 2
    assert "previous_stop" in refused.stderr

    assert ended("allow", "--config", path, "--by", " ", "--why", "x").returncode == 2
    allowed = ended("allow", "--config", path, "--by", "Ada", "--why", "a box stood in the way; it is gone", "--json")
    assert json.loads(allowed.stdout)["allowed"][0]["cause"] == "protective_stop"
    assert checked(path)[0] == 0
    assert "no stop is waiting" in ended("allow", "--config", path, "--by", "Ada", "--why", "again").stdout
    with Store.reader(path.parent / "history") as store:
        assert store.stops.waiting() == []


def test_record_only_listens_while_another_program_moves_the_arm(remote, config):
    """The recording has every tick of another program's motion, the context and both clocks; nothing is uploaded by us."""
    path = config()
    client = subprocess.Popen([sys.executable, "-c", MOVE, HOST], stdout=subprocess.PIPE, text=True)
    try:
        assert "moving" in client.stdout.readline()
        scripts = remote.truth()["scripts_started"]
        done = ended("record", "--config", path, "--seconds", 2, "-o", path.parent / "r.parquet", "--json")
        assert done.returncode == 0, done.stderr
        assert remote.truth()["scripts_started"] == scripts
    finally:
        client.kill()
        client.wait()
        remote.fault("program_stop")
    facts = json.loads(done.stdout)
    recording = read_recording(path.parent / "r.parquet")
    assert abs(recording.duration_s - 2.0) < 0.02
    assert abs(recording.qd).max() > 0.1
    assert facts["quality"]["duplicated_ticks"] == 0
    assert recording.samples + facts["quality"]["missed_ticks"] == round(recording.duration_s * 125) + 1  # every tick accounted for
    context = recording.context
    assert context.serial
    assert context.software.startswith("joint-monitor")
    assert context.payload_kg == 0.0
    assert abs(recording.quality["host_clock_at_start_unix_s"] - time.time()) < 60
    assert recording.quality["controller_clock_at_start_s"] == recording.t_s[0]
    assert eventually(lambda: remote.truth()["standing"], 5.0)


MOVE = """
import sys, time
from rtde_control import RTDEControlInterface
c = RTDEControlInterface(sys.argv[1])
print("moving", flush=True)
while True:
    c.moveJ([0, -1.4, 0.2, -1.4, 0, 0], 0.5, 1.0)
    c.moveJ([0, -1.57, 0, -1.57, 0, 0], 0.5, 1.0)
"""


def test_a_digital_input_is_a_permit(remote, config):
    """Off: the replay is refused after the configured time. On: the arm moves. Off in between: it slows down, with the cause."""
    path = config(permit="digital_input:3", permit_timeout_s=0.5)
    output = path.parent / "r.parquet"
    refused = ended("replay", "--config", path, "-o", output)
    assert refused.returncode == 2
    assert "digital input 3 is off" in refused.stderr
    remote.fault("digital_input", number=3, state="on")
    moving = Process(
        [sys.executable, "-m", "monitor", "replay", "--config", str(path), "-o", str(output)], stderr=subprocess.PIPE, text=True
    )
    try:
        assert eventually(lambda: max(abs(speed) for speed in remote.truth()["qd"]) > 0.2, 20.0)
        remote.fault("digital_input", number=3, state="off")
        _, printed = moving.communicate(timeout=20)
    finally:
        moving.kill()
        remote.fault("clear")
    assert "permit_withdrawn" in printed
    assert remote.truth()["standing"]
    assert checked(config())[0] == 0  # harmless: nobody has to acknowledge it


@pytest.mark.parametrize(
    ("answer", "code"), [({"allow": True, "why": "parked"}, 0), ({"allow": False, "why": "the press is open"}, 2), (None, 2)]
)
def test_the_cells_own_program_permits_over_zenoh(remote, config, answer, code):
    """It agrees, refuses, or does not answer; only its agreement moves the arm, and its reason is printed."""
    import zenoh

    path = config(permit="zenoh", permit_timeout_s=5.0 if answer else 1.0, announce_s=0.5, approach_speed_rad_s=1.0)
    output = path.parent / "r.parquet"
    endpoint = path.read_text().partition("listen = ")[2].split('"')[1]
    asked: list[dict] = []
    done: list = []
    runner = threading.Thread(target=lambda: done.append(run([*PROGRAM, "replay", "--config", str(path), "-o", str(output)], 100.0)))
    runner.start()
    if answer is not None:
        with zenoh.open(session_config(mode="peer", connect=(endpoint,), wait_for_peer=False)) as session:

            def reply(query: zenoh.Query) -> None:
                with query:
                    asked.append(json.loads(query.payload.to_bytes()))
                    query.reply(query.key_expr, json.dumps(answer))

            queryable = session.declare_queryable("joint-monitor/v1/lab/cell-1/permit/replay", reply)
            runner.join(60)
            queryable.undeclare()
    else:
        runner.join(60)
    assert done[0].returncode == code, done[0].stderr
    assert "the arm moves in" in done[0].stderr
    if answer is None:
        assert "no answer within 1 s" in done[0].stderr
        return
    jsonschema.validate(asked[0], schema("permit"), format_checker=jsonschema.FormatChecker())
    jsonschema.validate(answer, schema("permit-answer"))
    assert asked[0]["robot"] == "ur5"
    assert asked[0]["duration_s"] == pytest.approx(3.0)
    assert code == 0 or "the press is open" in done[0].stderr


def test_the_first_pass_after_a_change_is_slow_and_kept_and_the_next_replay_needs_none(remote, config):
    """The first pass takes twice the time at half the speed, in a file of its own; the next replay needs none."""
    path = config(first_pass=True, first_pass_time_scale=0.5, approach_speed_rad_s=1.0)
    (path.parent / "short.json").write_text(json.dumps(short(period_s=2.0).as_document()))
    output, first = path.parent / "r.parquet", path.parent / "r-first-pass.parquet"
    done = ended("replay", "--config", path, "-o", output, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["first_pass"] == str(first)
    slow, normal = read_recording(first), read_recording(output)
    for recording, expected_s in ((slow, 4.0), (normal, 2.0)):  # where targets are sent late the motion waits for them
        assert recording.duration_s - recording.quality["slipped_s"] == pytest.approx(expected_s, abs=0.05)
    assert slow.quality["time_scale"] == 0.5
    assert "first pass" in slow.context.note
    assert abs(slow.qd).max() == pytest.approx(0.5 * abs(normal.qd).max(), rel=0.1)
    first.unlink()
    done = ended("replay", "--config", path, "-o", output, "--force")
    assert done.returncode == 0, done.stderr
    assert not first.exists()


def test_torque_outside_the_band_ends_a_first_pass_and_waits_for_a_person(remote, config):
    """The configured gains are wrong by a factor of five, so measured torque differs from that of the manufacturer's parameters."""
    path = config("gains_nm_per_a = [60.0, 60.0, 60.0, 50.0, 50.0, 50.0]", first_pass=True, first_pass_time_scale=0.5)
    done = ended("replay", "--config", path, "-o", path.parent / "r.parquet")
    assert done.returncode == 1
    assert "torque_band" in done.stderr
    assert "were expected" in done.stderr
    assert eventually(lambda: remote.truth()["standing"], 2.0)
    assert remote.truth()["program"] is None
    assert list(path.parent.glob("*.parquet")) == []
    code, found = checked(path)
    assert code == 3
    assert not found["previous_stop"]["holds"]


@pytest.mark.parametrize(
    "numbers", [(signal.SIGTERM, signal.SIGTERM, signal.SIGINT, signal.SIGHUP), pytest.param((signal.SIGHUP,), marks=pytest.mark.soak)]
)
def test_a_signal_in_the_middle_of_a_replay_stops_the_arm_along_its_way(remote, config, numbers):
    """So do a closed terminal and several signals at once: the program ends by itself; neither the watchdog nor a kill is needed."""
    path = config(approach_speed_rad_s=1.0)
    stops = len(remote.truth()["stops"])
    command = [sys.executable, "-m", "monitor", "replay", "--config", str(path), "-o", str(path.parent / "r.parquet")]
    moving = Process(command, stderr=subprocess.PIPE, text=True)
    try:
        assert eventually(lambda: max(abs(speed) for speed in remote.truth()["qd"]) > 0.2, 20.0)
        for number in numbers:
            moving.send_signal(number)
        _, printed = moving.communicate(timeout=20)
    finally:
        moving.kill()
    assert moving.returncode == 1, printed
    assert "parent_asked_to_stop" in printed
    assert "Traceback" not in printed
    truth = remote.truth()
    assert truth["program"] is None
    assert truth["standing"]
    # the watchdog is tested at standstill, before the motion
    assert [stop["kind"] for stop in truth["stops"][stops:]] == ["watchdog", "program_end"]
    assert not (path.parent / "r.parquet").exists()


def test_a_signal_during_the_handler_of_another_is_no_deadlock():
    """A signal handler of Python can be interrupted by itself; an event of `threading` would then wait for its own lock."""
    code = (
        "import signal, sys\nfrom monitor.cli.options import stop_on\n"
        "with stop_on(signal.SIGTERM, signal.SIGINT) as stopping:\n"
        "    def trace(frame, event, _):\n"
        "        if frame.f_code.co_name in ('set', 'ask') and event == 'line': signal.raise_signal(signal.SIGINT)\n"
        "        return trace\n"
        "    sys.settrace(trace)\n    signal.raise_signal(signal.SIGTERM)\n    sys.settrace(None)\n"
        "    print(stopping.is_set())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=20, check=False)
    assert done.stdout == "True\n", done.stderr[-300:]
