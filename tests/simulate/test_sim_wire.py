"""The unmodified ur-rtde, in processes of its own, against a simulator in a process of its own."""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from raw_rtde import RawRtde
from sim_process import eventually, excitation, fresh_address, result_of

from monitor.errors import BadInput, RobotUnreachable
from monitor.simulate.controller.controller import Controller
from monitor.simulate.remote import Remote
from monitor.simulate.settings import SimulateSettings

RECEIVE = """
import json, sys, time
from rtde_receive import RTDEReceiveInterface
r = RTDEReceiveInterface(sys.argv[1])
first = r.getTimestamp(); seen = {first}; end = time.monotonic() + 1.0
while time.monotonic() < end:
    seen.add(r.getTimestamp()); time.sleep(0.0003)
ticks = sorted(seen)
print(json.dumps(dict(
    q=r.getActualQ(), qd=r.getActualQd(), current=r.getActualCurrent(), temperature=r.getJointTemperatures(), moment=r.getTargetMoment(),
    target_q=r.getTargetQ(), robot_mode=r.getRobotMode(), safety_mode=r.getSafetyMode(), runtime=r.getRuntimeState(),
    status=r.getRobotStatus(), safety=r.getSafetyStatusBits(), pose=r.getActualTCPPose(), scaling=r.getSpeedScaling(),
    joint_mode=r.getJointMode(), main_voltage=r.getActualMainVoltage(), protective=r.isProtectiveStopped(),
    seconds=ticks[-1] - ticks[0], packets=len(ticks))))
"""

MOVE_AND_STREAM = """
import json, math, sys, time
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
r, c = RTDEReceiveInterface(sys.argv[1]), RTDEControlInterface(sys.argv[1], 125.0)
goal = r.getActualQ(); goal[0] += 0.2; goal[3] -= 0.1
moved = c.moveJ(goal, 1.0, 1.5)
at = r.getActualQ()
watched = c.setWatchdog(5.0)
start, begun = r.getTargetQ(), r.getTimestamp()
errors, beside = [], []  # while this client was in time, and while it had been asleep just before
last = late = begun
while last - begun < 3.0:
    deadline = time.monotonic() + 1.0
    while r.getTimestamp() == last and time.monotonic() < deadline:
        time.sleep(0.0003)
    now = r.getTimestamp()
    late = now if now - last > 0.012 else late
    last = now
    swing = 0.2 * (1 - math.cos(math.pi * (now - begun)))
    if now - begun > 0.1:
        (errors if now - late > 0.2 else beside).append(max(abs(a - s - swing) for a, s in zip(r.getActualQ(), start)))
    assert c.servoJ([s + swing for s in start], 0.0, 0.0, 0.008, 0.03, 500.0)
stopped = c.servoStop(10.0)
deadline = time.monotonic() + 1.0
while not (steady := c.isSteady()) and time.monotonic() < deadline:  # the arm settles; asking feeds the watchdog
    time.sleep(0.02)
answers = dict(moved=moved, watched=watched, stopped=stopped, steady=steady, payload=c.setPayload(1.0, [0, 0, 0.1]),
               within=c.isJointsWithinSafetyLimits([0.0] * 6), beyond=c.isJointsWithinSafetyLimits([0.0, 0, 4.0, 0, 0, 0]))
c.stopScript()
deadline = time.monotonic() + 1.0
while (runtime := r.getRuntimeState()) != 1 and time.monotonic() < deadline:  # what c was told r hears a packet later
    time.sleep(0.002)
print(json.dumps(dict(goal=goal, at=at, errors=errors, beside=beside, runtime=runtime, **answers)), flush=True)
"""

STREAM_FOR_EVER = """
import math, sys, time
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
r, c = RTDEReceiveInterface(sys.argv[1]), RTDEControlInterface(sys.argv[1], 125.0)
c.setWatchdog(10.0)
start, begun = r.getTargetQ(), r.getTimestamp()
print("streaming", flush=True)
while True:
    swing = 0.3 * (1 - math.cos(math.pi * (r.getTimestamp() - begun)))
    c.servoJ([s + swing for s in start], 0.0, 0.0, 0.008, 0.03, 500.0)
    time.sleep(0.008)
"""

HOLD_CONTROL = """
import sys, time
from rtde_control import RTDEControlInterface
c = RTDEControlInterface(sys.argv[1])
print("controlling", flush=True)
time.sleep(60)
"""

CONSTRUCT_CONTROL = """
import json, sys
from rtde_control import RTDEControlInterface
try:
    c = RTDEControlInterface(sys.argv[1]); c.stopScript(); answer = "constructed"
except RuntimeError as wrong:
    answer = str(wrong)
print(json.dumps(dict(answer=answer)), flush=True)
"""

DASHBOARD = """
import json, sys
from dashboard_client import DashboardClient
d = DashboardClient(sys.argv[1]); d.connect()
answers = dict(version=d.polyscopeVersion(), mode=d.robotmode(), safety=d.safetymode(), running=d.running(), state=d.programState())
for name in sys.argv[2:]:
    try:
        answers[name] = getattr(d, name)()
    except RuntimeError as wrong:
        answers[name] = str(wrong)
print(json.dumps(answers), flush=True)
"""


def wait_for(process: subprocess.Popen[str], word: str) -> None:
    """Until the client says so; ur-rtde prints to the same stream."""
    while line := process.stdout.readline():
        if word in line:
            return
    raise AssertionError(process.stderr.read())


def drain(wire: socket.socket) -> None:
    """Until the other side ends the connection."""
    while wire.recv(4096):
        pass


@pytest.mark.parametrize(("robot", "rate_hz"), [("ur5", 125), ("ur3e", 500)])
def test_the_default_recipe_gives_sane_values_on_both_generations(spawn, client, robot, rate_hz):
    """RTDEReceive as shipped: 57 variables on CB3, 58 on e-Series, all in their places."""
    simulator = spawn("--robot", robot)
    seen = result_of(client(RECEIVE, simulator.address))
    assert np.allclose(seen["q"], [0, -np.pi / 2, 0, -np.pi / 2, 0, 0], atol=1e-3)
    assert np.allclose(seen["target_q"], seen["q"], atol=1e-3)
    assert seen["qd"] == [0.0] * 6
    assert np.allclose(seen["temperature"], 25.0, atol=0.2)
    assert np.abs(seen["current"]).max() < 0.3  # upright: no load, noise of 0.03 A
    assert np.allclose(seen["moment"], 0.0, atol=0.5)  # upright: no gravity but the wrist's offset
    assert (seen["robot_mode"], seen["safety_mode"], seen["runtime"], seen["status"], seen["safety"]) == (7, 1, 1, 1, 1)
    assert seen["joint_mode"] == [253] * 6
    assert seen["main_voltage"] == 48.0
    assert seen["scaling"] == 1.0
    assert not seen["protective"]
    assert 0.6 < seen["pose"][2] < 1.1  # the flange of an upright arm, in metres
    assert seen["packets"] > 0.5 * rate_hz * seen["seconds"]  # a poll every 0.3 ms misses some on a busy machine
    assert 0.9 < seen["seconds"] < 1.1  # the controller's clock is the wall's


@pytest.mark.parametrize("robot", ["ur5", "ur5e"])
def test_control_moves_streams_and_answers(spawn, client, robot):
    """moveJ reaches; servoJ at 125 Hz follows a sine of 0.6 rad/s to a few mrad; queries answer; stopScript ends it."""
    simulator = spawn("--robot", robot)
    told = result_of(client(MOVE_AND_STREAM, simulator.address))
    assert told["moved"]
    assert told["watched"]
    assert told["stopped"]
    assert told["steady"]
    assert told["payload"]
    assert told["within"]
    assert not told["beyond"]
    assert np.allclose(told["at"], told["goal"], atol=2e-3)
    assert told["runtime"] == 1
    with simulator.remote() as remote:
        truth = remote.truth()
    # 2 mrad of servo and filter, and a target that is one period late: 8 ms · 0.63 rad/s = 5 mrad; on a busy machine client and controller
    # are asleep for 60 ms at most, and what the one sends then the arm has yet to reach
    in_time, ticks = sorted(told["errors"]), truth["ticks"]
    assert max(in_time + told["beside"]) < 8e-3 + 0.06 * 0.63
    busy = ticks["late"] + ticks["dropped"] > 0.05 * ticks["run"]
    if len(in_time) >= 20:  # a client that was never in time for 0.2 s proves nothing here
        assert in_time[int(0.9 * len(in_time))] < (16e-3 if busy else 8e-3)  # an arm that only knows the last target is 20 behind
    assert truth["watchdog_trips"] == 0
    assert truth["refused_commands"] == []
    assert truth["scripts_started"] == 1


def test_a_killed_client_leaves_an_arm_that_stands(ur5, client):
    """SIGKILL in mid-stream: the 10 Hz watchdog ends the program, the arm stands within 0.3 s on the arm's clock."""
    streaming = client(STREAM_FOR_EVER, ur5.address)
    wait_for(streaming, "streaming")
    with ur5.remote() as remote:
        assert eventually(lambda: max(map(abs, remote.truth()["qd"])) > 0.5, 5.0)
        trips = remote.truth()["watchdog_trips"]
        os.kill(streaming.pid, signal.SIGKILL)
        killed_at_s = remote.truth()["clock_s"]
        assert eventually(lambda: remote.truth()["standing"], 2.0)
        truth = remote.truth()
    stop = truth["stops"][-1]
    assert stop["kind"] == "watchdog"
    assert truth["watchdog_trips"] == trips + 1
    assert truth["runtime_state"] == 1
    assert stop["stood_at_s"] - killed_at_s < 0.35  # 0.1 s of watchdog, 0.15 s of braking, two ticks, one question to the simulator


def test_a_second_client_hears_that_the_registers_are_in_use(ur5, client):
    """And once the first is gone, it may."""
    first = client(HOLD_CONTROL, ur5.address)
    wait_for(first, "controlling")
    refused = result_of(client(CONSTRUCT_CONTROL, ur5.address))
    assert "already in use" in refused["answer"]
    with ur5.remote() as remote:
        assert remote.truth()["runtime_state"] == 2  # the first keeps its program
    first.kill()
    first.wait()
    # its program is still playing: the constructor stops it by command and dashboard, and uploads its own
    assert result_of(client(CONSTRUCT_CONTROL, ur5.address))["answer"] == "constructed"


def test_the_dashboard_client_understands_the_replies(spawn, client):
    """States, and the commands that ur-rtde compares word by word; on an e-Series, of which it knows more commands."""
    queries = ("getRobotModel", "getSerialNumber", "isInRemoteControl")
    commands = ("stop", "closeSafetyPopup", "unlockProtectiveStop", "brakeRelease")
    told = result_of(client(DASHBOARD, spawn("--robot", "ur5e").address, *queries, *commands, "play"))
    assert told["version"].startswith("5.11.0")
    assert told["mode"] == "Robotmode: RUNNING"
    assert "NORMAL" in told["safety"]
    assert told["running"] is False
    assert told["state"].startswith("STOPPED")
    assert told["getRobotModel"] == "UR5"
    assert told["getSerialNumber"] == "20180500001"
    assert told["isInRemoteControl"] is True
    for name in commands:
        assert told[name] is None, name  # no error
    assert told["play"] == "Failed to execute: play"  # there is no program to play


def test_a_protective_stop_is_reported_and_unlocks_only_after_five_seconds(ur5, client):
    """Through the wire: bits of the receive interface, the dashboard's refusal, then its consent."""
    with ur5.remote() as remote:
        remote.protective_stop()
        begun = time.monotonic()
        seen = result_of(client(RECEIVE, ur5.address))
        assert (seen["safety_mode"], seen["robot_mode"], seen["protective"]) == (3, 7, True)
        assert seen["safety"] == (1 << 2) | (1 << 10)
        if time.monotonic() - begun < 4.0:  # a machine too busy for it proves nothing here
            early = result_of(client(DASHBOARD, ur5.address, "unlockProtectiveStop"))
            assert early["unlockProtectiveStop"].startswith("Unlock protective stop failure: Cannot unlock")
        time.sleep(max(0.0, 5.3 - (time.monotonic() - begun)))
        assert result_of(client(DASHBOARD, ur5.address, "unlockProtectiveStop"))["unlockProtectiveStop"] is None
        assert remote.truth()["safety_mode"] == 1


def test_local_control_is_refused_by_the_client(spawn, client):
    """An e-Series on an address other than 127.0.0.1 is asked whether it is in remote control."""
    simulator = spawn("--robot", "ur3e", "--local-control")
    assert "remote control" in result_of(client(CONSTRUCT_CONTROL, simulator.address))["answer"]


def test_garbage_on_every_port_disturbs_nobody(ur5, client):
    """Seeded noise, enormous headers, half packets, endless lines: afterwards everything still answers."""
    dice = np.random.default_rng(0)
    junk = [dice.bytes(2000), b"\xff" * 70_000, b"\x00" * 3000, b"\x00\x05V", b"def x():\n" * 1000, b"{" * 5000 + b"\n", b"[1]\n\n\x80\n"]
    for port in (30004, 29999, 30003, 30002, 30001, 30020):
        for noise in junk:
            with socket.create_connection((ur5.address, port), timeout=5) as wire:
                try:
                    wire.sendall(noise)
                    wire.settimeout(0.02)
                    wire.recv(100)
                except OSError:  # closed on us, or silent: both are answers
                    pass
    assert ur5.process.poll() is None
    assert result_of(client(RECEIVE, ur5.address))["robot_mode"] == 7
    with ur5.remote() as remote:
        assert remote.truth()["standing"]


def test_clients_that_never_read_do_not_hold_the_others_up(ur5, client):
    """Two deaf RTDE clients at full rate: the tick goes on."""
    deaf = []
    for _ in range(2):
        wire = socket.create_connection((ur5.address, 30004), timeout=5)
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wire.sendall(bytes.fromhex("0014 4f 405f400000000000") + b"timestamp" + bytes.fromhex("0003 53"))
        deaf.append(wire)
    seen = result_of(client(RECEIVE, ur5.address))
    assert 0.9 < seen["seconds"] < 1.1
    for wire in deaf:
        wire.close()


def test_faults_reach_the_wire(ur5):
    """stall: silence for so long; close and reset: FIN and RST; an unknown one is named."""

    def listener() -> socket.socket:
        wire = socket.create_connection((ur5.address, 30004), timeout=5)
        wire.sendall(bytes.fromhex("0014 4f 405f400000000000") + b"timestamp" + bytes.fromhex("0003 53"))
        assert wire.recv(100)
        return wire

    with ur5.remote() as remote:
        with listener() as wire:
            remote.fault("stall", seconds=0.6)
            wire.settimeout(0.02)
            silent_since = last = time.monotonic()
            while time.monotonic() - last < 0.4 and last - silent_since < 5.0:
                try:
                    wire.recv(4096)  # what is in the buffers comes first
                    last = time.monotonic()
                except TimeoutError:
                    pass
            assert time.monotonic() - last >= 0.4  # at 125 Hz packets come every 8 ms
            wire.settimeout(5)
            assert wire.recv(100)  # and they come back
        with listener() as wire:
            remote.fault("close")
            drain(wire)
        with listener() as wire:
            remote.fault("reset")
            with pytest.raises(ConnectionResetError):
                drain(wire)
        with pytest.raises(BadInput, match="known are clear"):
            remote.fault("earthquake")


def test_the_back_door_plays_ages_and_tells(ur5):
    """Remote: a stepped replay arrives whole; heat, wear and torque are what the laws say; wrong questions are refused."""
    with ur5.remote() as remote:
        recording = remote.play(excitation(), software="test")
        assert recording.samples == 501
        assert recording.context.robot == "ur5"
        assert recording.context.trajectory_digest == excitation().digest
        assert not remote.truth()["stepping"]
        before = remote.truth()
        remote.advance(12.0, ambient_c=30.0, duty=0.5)
        remote.wear(3, coulomb_factor=1.4, viscous_factor=1.2)
        after = remote.truth()
        assert after["clock_s"] - before["clock_s"] == pytest.approx(12 * 3600, abs=5)
        assert min(after["motor_temperature_c"]) > 30.0
        assert after["wear_coulomb"][2] == 1.4
        qd = np.full((3, 6), 0.5)
        cold, warm = remote.friction(qd, 20.0), remote.friction(qd, 40.0)
        assert np.all(warm < cold)
        still = np.zeros((1, 6))
        assert remote.torque(still, still, still)[0, 1] == pytest.approx(-53.8, abs=0.2)  # the outstretched arm on joint 2
        for wrong in (
            lambda: remote.wear(7, coulomb_factor=1.0),
            lambda: remote.advance(-1.0),
            lambda: remote.torque(still, still[:, :5], still),
            lambda: remote.friction([[float("nan")] * 6]),
            lambda: remote.play(excitation("ur3")),
            lambda: remote.ask("dance"),
        ):
            with pytest.raises(BadInput):
                wrong()
        remote.wear(3, coulomb_factor=1.0, viscous_factor=1.0)


def test_a_taken_port_is_named(ur5):
    """A second simulator on the same address: exit 2, the port in the message, no traceback."""
    second = subprocess.run(
        [sys.executable, "-m", "monitor.simulate", "--bind", ur5.address], capture_output=True, text=True, timeout=30, check=False
    )
    assert second.returncode == 2
    assert "30004" in second.stderr
    assert "in use" in second.stderr
    assert "Traceback" not in second.stderr


def test_an_address_of_the_network_is_refused():
    """Exit 2 before anything is opened."""
    wrong = subprocess.run(
        [sys.executable, "-m", "monitor.simulate", "--bind", "0.0.0.0"], capture_output=True, text=True, timeout=30, check=False
    )
    assert wrong.returncode == 2
    assert "loopback" in wrong.stderr


def test_it_ends_on_sigterm_and_on_command_and_leaves_the_ports_free(spawn):
    """Exit 0; the same address can be used again at once; nobody there is RobotUnreachable."""
    first = spawn()
    assert first.end() == 0
    again = subprocess.Popen([sys.executable, "-m", "monitor.simulate", "--bind", first.address], stdout=subprocess.PIPE, text=True)
    try:
        assert again.stdout.readline().startswith("listening")
        with Remote(first.address) as remote:
            remote.shutdown()
        assert again.wait(timeout=5) == 0
    finally:
        again.kill()
        again.communicate()
    with pytest.raises(RobotUnreachable, match=first.address):
        Remote(first.address)


def test_it_ends_without_a_word_while_somebody_is_connected_to_every_port(spawn):
    """No traceback for whoever presses Ctrl-C with a view open elsewhere."""
    simulator = spawn("--robot", "ur5")
    wires = [socket.create_connection((simulator.address, port), timeout=5) for port in (29999, 30001, 30002, 30003, 30004, 30020)]
    wires[-1].sendall(b'{"do": "truth"}\n')
    assert wires[-1].recv(10)
    simulator.process.send_signal(signal.SIGINT)
    assert simulator.process.communicate(timeout=10)[1] == ""
    assert simulator.process.returncode == 0
    for wire in wires:
        wire.close()


def test_a_shutdown_by_the_dashboard_is_the_end_of_the_controller(spawn, client):
    """As somebody who turns it off from afar: answered, then gone, exit 0."""
    simulator = spawn()
    code = "import sys; from dashboard_client import DashboardClient; d = DashboardClient(sys.argv[1]); d.connect(); d.shutdown()"
    assert client(code, simulator.address).wait(timeout=20) == 0
    assert simulator.process.wait(timeout=5) == 0


def test_requests_are_json_lines(ur5):
    """By hand, without Remote: a question, an answer; an error says what would be right."""
    with socket.create_connection((ur5.address, 30020), timeout=5) as wire, wire.makefile("rwb") as file:
        for line, ok in ((b'{"do": "truth"}\n', True), (b'{"do": "nothing"}\n', False), (b'{"do": ["truth"]}\n', False), (b"no\n", False)):
            file.write(line)
            file.flush()
            answer = json.loads(file.readline())
            assert answer["ok"] is ok
        assert answer["kind"] == "BadInput"


def test_in_real_time_it_is_what_it_is_when_stepped(spawn):
    """A second of noise over the wire, tick by tick, bit for bit what a stepped controller with the same seed measures."""
    simulator = spawn("--seed", "7")
    with RawRtde(simulator.address) as rtde:
        rtde.stream("timestamp,actual_q,actual_current,joint_temperatures")
        rows = [struct.unpack_from(">19d", rtde.packet()[1], 1) for _ in range(125)]
    stepped = Controller(SimulateSettings(seed=7))
    for row in rows:
        while stepped.clock.now_s < row[0] - 1e-6:
            stepped.step()
        measured = stepped.measurements.latest
        assert row == (stepped.clock.now_s, *measured.q, *measured.current, *measured.temperature_c)


def test_several_arms_stand_side_by_side(spawn, client):
    """Two generations on two addresses, read at once."""
    arms = [spawn("--robot", robot) for robot in ("ur5", "ur10e")]
    seen = [result_of(one) for one in [client(RECEIVE, arm.address) for arm in arms]]
    assert all(one["robot_mode"] == 7 and 0.2 < one["seconds"] < 1.2 for one in seen)  # a busy machine may take time from both
    assert seen[0]["pose"] != seen[1]["pose"]


def test_the_view_shows_the_arm_and_ends_with_it(tmp_path):
    """`simulate --view` in a process of its own: a table of joints, then SIGINT ends both."""
    address = fresh_address()
    heard = ["env", "--default-signal=INT"]  # what runs in the background of a script has inherited that SIGINT is ignored
    command = [*heard, sys.executable, "-m", "monitor", "simulate", "--bind", address, "--scenario", "hot-summer", "--view"]
    with (tmp_path / "screen").open("w") as screen:
        view = subprocess.Popen(command, stdout=screen, stderr=subprocess.PIPE, text=True)
        try:
            assert eventually(lambda: _answers(address), 30.0)
            time.sleep(1.0)
            view.send_signal(signal.SIGINT)
            assert view.wait(timeout=15) == 0, view.stderr.read()
        finally:
            view.kill()
            view.communicate()
    assert not _answers(address)
    shown = (tmp_path / "screen").read_text()
    assert "hot-summer" in shown
    assert "grease" in shown
    assert "running" in shown


def test_a_view_into_a_pipe_shows_one_picture_after_the_other_and_ends_with_its_reader():
    """As `--view | head` does it; the simulator ends too."""
    address = fresh_address()
    command = [sys.executable, "-m", "monitor", "simulate", "--bind", address, "--view"]
    view = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert "running, normal" in view.stdout.readline()
        assert _answers(address)
        view.stdout.close()
        assert view.wait(timeout=15) in {0, 1}  # as of every command whose reader has gone
        assert view.stderr.read() == ""
    finally:
        view.kill()
        view.wait()
    assert not _answers(address)


def test_a_view_of_an_address_in_use_says_so(spawn):
    """One line and exit 2, as without the view."""
    command = [sys.executable, "-m", "monitor", "simulate", "--bind", spawn().address, "--view"]
    second = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert second.returncode == 2, second.stderr
    assert "in use" in second.stderr
    assert len(second.stderr.strip().splitlines()) == 1


def _answers(address: str) -> bool:
    try:
        Remote(address).close()
    except RobotUnreachable:
        return False
    return True


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--command-port", "30004"], "own ports"),
        (["--seed", "-1"], "seed = -1"),
        (["--scenario", "sunshine"], "cold-mondays"),
        (["--fault", "stall"], "seconds is missing"),
        (["--mounting", "sideways"], "sideways"),
        (["--payload", "500"], "payload_kg"),
        (["--polyscope", "5.11.0"], "for a ur5"),
        (["--robot", "ur5e", "--polyscope", "3.15"], "for a ur5e"),
        (["--protective-runtime", "shrugs"], "protective_runtime"),
    ],
)
def test_wrong_options_are_sentences(arguments, named):
    """Exit 2, no traceback."""
    command = [sys.executable, "-m", "monitor", "simulate", "--bind", fresh_address(), *arguments]
    wrong = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert wrong.returncode == 2
    assert named in wrong.stderr
    assert "Traceback" not in wrong.stderr
