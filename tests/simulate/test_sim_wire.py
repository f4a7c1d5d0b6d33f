"""The unmodified ur-rtde, in processes of its own, against a simulator in a process of its own."""

import json
import socket
import struct
import time

import numpy as np
import pytest
from raw_rtde import RawRtde
from sim_clients import CONSTRUCT_CONTROL, DASHBOARD, HOLD_CONTROL, RECEIVE
from sim_process import excitation, result_of, wait_for

from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings


def drain(wire: socket.socket) -> None:
    """Read until the other side ends the connection."""
    while wire.recv(4096):
        pass


@pytest.mark.parametrize(("robot", "rate_hz"), [("ur5", 125), ("ur3e", 500)])
def test_the_default_recipe_gives_sane_values_on_both_generations(spawn, client, robot, rate_hz):
    """RTDEReceive subscribes to 57 variables on CB3 and 58 on the e-Series, and all have sensible values."""
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
    assert seen["scaling"] == 0.0  # no program plays
    assert not seen["protective"]
    assert 0.6 < seen["pose"][2] < 1.1  # the flange of an upright arm, in metres
    assert 0.9 < seen["seconds"] < 1.1  # the controller's clock is the wall's
    with RawRtde(simulator.address) as rtde:  # the kernel keeps every packet, however busy the machine; a client that polls misses some
        assert rtde.stream("timestamp", rate_hz) == "DOUBLE"
        between_s = np.diff(rtde.timestamps(rate_hz))
    assert np.mean(np.abs(rate_hz * between_s - 1.0) < 0.01) > 0.9  # one every period


def test_a_second_client_learns_that_the_registers_are_in_use(ur5, client):
    """When the first client has gone, the second may use the registers."""
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
    """ur-rtde compares states and replies word by word; on an e-Series it knows more commands."""
    queries = ("getRobotModel", "getSerialNumber", "isInRemoteControl")
    commands = ("stop", "closeSafetyPopup", "unlockProtectiveStop", "brakeRelease")
    result = result_of(client(DASHBOARD, spawn("--robot", "ur5e").address, *queries, *commands, "play"))
    assert result["version"].startswith("5.11.0")
    assert result["mode"] == "Robotmode: RUNNING"
    assert "NORMAL" in result["safety"]
    assert result["running"] is False
    assert result["state"].startswith("STOPPED")
    assert result["getRobotModel"] == "UR5"
    assert result["getSerialNumber"] == "20180500001"
    assert result["isInRemoteControl"] is True
    for name in commands:
        assert result[name] is None, name  # no error
    assert result["play"] == "Failed to execute: play"  # there is no program to play


def test_a_protective_stop_is_reported_and_unlocks_only_after_five_seconds(ur5, client):
    """The receive interface shows the bits. The dashboard refuses first and unlocks later."""
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
    """ur-rtde asks an e-Series on an address other than 127.0.0.1 whether it is in remote control."""
    simulator = spawn("--robot", "ur3e", "--local-control")
    assert "remote control" in result_of(client(CONSTRUCT_CONTROL, simulator.address))["answer"]


def test_garbage_on_every_port_disturbs_nobody(ur5, client):
    """After random bytes, enormous headers, half packets and endless lines, everything still answers."""
    rng = np.random.default_rng(0)
    junk = [rng.bytes(2000), b"\xff" * 70_000, b"\x00" * 3000, b"\x00\x05V", b"def x():\n" * 1000, b"{" * 5000 + b"\n", b"[1]\n\n\x80\n"]
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
    """Two RTDE clients at full rate do not read, and the control periods continue."""
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
    """`stall` stops the data for a time, `close` and `reset` end connections, and an unknown fault is an error."""

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
        with pytest.raises(BadInput, match="known are aged_lubricant"):
            remote.fault("earthquake")


def test_the_command_port_plays_advances_and_answers(ur5):
    """Remote gets a whole stepped replay and torques that follow the laws; it advances time and sets wear. Wrong requests are errors."""
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


def test_requests_are_json_lines(ur5):
    """Requests and replies without Remote. An error says what is expected."""
    with socket.create_connection((ur5.address, 30020), timeout=5) as wire, wire.makefile("rwb") as file:
        for line, ok in ((b'{"do": "truth"}\n', True), (b'{"do": "nothing"}\n', False), (b'{"do": ["truth"]}\n', False), (b"no\n", False)):
            file.write(line)
            file.flush()
            answer = json.loads(file.readline())
            assert answer["ok"] is ok
        assert answer["kind"] == "BadInput"


def test_real_time_and_stepped_measurements_are_equal(spawn):
    """A second of noise over the wire equals, bit for bit, what a stepped controller with the same seed measures."""
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
    """Two arms of two generations run on two addresses at once."""
    arms = [spawn("--robot", robot) for robot in ("ur5", "ur10e")]
    seen = [result_of(one) for one in [client(RECEIVE, arm.address) for arm in arms]]
    assert all(one["robot_mode"] == 7 and 0.2 < one["seconds"] < 1.2 for one in seen)  # a busy machine may take time from both
    assert seen[0]["pose"] != seen[1]["pose"]
