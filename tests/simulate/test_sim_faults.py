"""Every fault happens on command, seen from outside."""

import math
import socket
import time
from functools import partial

import numpy as np
import pytest
from raw_rtde import RawRtde
from sim_clients import DASHBOARD
from sim_pendant import Pendant
from sim_process import eventually, result_of

from monitor.errors import BadInput
from monitor.simulate.arm.physics import Contact
from monitor.simulate.controller.controller import Controller
from monitor.simulate.faults import FAULTS, parse
from monitor.simulate.machine.state import Runtime, SafetyMode
from monitor.simulate.settings import SimulateSettings

PORTS = {"rtde": 30004, "dashboard": 29999, "primary": 30001, "secondary": 30002, "realtime": 30003}


def ended(wire: socket.socket) -> str:
    """How the other side ended the connection: `reset` or `closed`."""
    wire.settimeout(5)
    try:
        while wire.recv(65536):
            pass
    except ConnectionResetError:
        return "reset"
    return "closed"


def dropped(remote, name: str, service: str) -> bool:
    """Whether the fault dropped a connection. The server may notice a new connection a moment after the client."""
    return "0 connections" not in remote.fault(name, service=service)


def refused(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=2).close()
    except ConnectionRefusedError:
        return True
    return False


# --- without a wire -------------------------------------------------------------------------------------------


@pytest.fixture
def controller() -> Controller:
    controller = Controller(SimulateSettings())
    controller.step()
    return controller


def test_every_fault_names_its_arguments_and_refuses_others(controller):
    """Unknown faults and arguments, values out of range, missing arguments and faults of a missing wire are errors with a reason."""
    for name, given, named in [
        ("earthquake", {}, "known are"),
        ("stall", {"joint": 1}, "joint"),
        ("stall", {}, "seconds is missing"),
        ("stall", {"seconds": -1}, "seconds = -1"),
        ("stall", {"seconds": float("nan")}, "seconds = nan"),
        ("stall", {"seconds": True}, "seconds = True"),
        ("encoder_offset", {"joint": 7, "value": 0.1}, "joint = 7"),
        ("encoder_offset", {"joint": 1.5, "value": 0.1}, "whole number"),
        ("protective_stop", {"runtime": "shrugs"}, "shrugs"),
        ("close", {"service": "telnet"}, "telnet"),
        ("version", {"version": "new"}, "MAJOR.MINOR"),
        ("not_found", {"names": "nonsense"}, "nonsense"),
        ("stall", {"seconds": 1.0}, "of the wire"),
        ("restart", {}, "of the wire"),
    ]:
        with pytest.raises(BadInput, match=named):
            controller.inject(name, given)
    with pytest.raises(BadInput, match="key=value"):
        parse("stall 2")
    assert parse("late seconds=0.02 share=0.5") == ("late", {"seconds": "0.02", "share": "0.5"})
    assert all(fault.about for fault in FAULTS.values())


def test_the_controller_makes_every_fault_happen_that_the_wire_does_not():
    """Without a wire, each fault of the catalogue happens or is refused because it belongs to the wire."""
    examples = {
        "joint": 1,
        "answer": "silent",
        "value": 0.1,
        "seconds": 1.0,
        "names": "actual_q",
        "version": "5.11",
        "factor": 1.0,
        "number": 1,
        "fraction": 0.5,
    }
    refused = set()
    for name, fault in FAULTS.items():
        controller = Controller(SimulateSettings())
        try:
            assert controller.inject(name, {key: value for key, value in examples.items() if key in fault.arguments})
        except BadInput as wrong:
            refused.add(name if "of the wire" in str(wrong) else str(wrong))
    assert refused == {
        "stall",
        "close",
        "reset",
        "listener_gone",
        "restart",
        "power_cut",
        "freeze",
        "late",
        "skip",
        "mute",
        "robot_api",
        "text_at_connect",
    }


def test_frozen_temperatures_stay_until_clear(controller):
    """The sensors show the same temperatures while the joints warm, until `clear`."""
    controller.inject("temperatures_frozen", {})
    before = controller.measurements.latest.temperature_c
    controller.pass_time(1.0, 35.0, 1.0)
    controller.step()
    assert np.array_equal(controller.measurements.latest.temperature_c, before)
    controller.inject("clear", {})
    controller.step()
    assert np.all(controller.measurements.latest.temperature_c > before + 1.0)


def test_a_glitching_temperature_is_wrong_now_and_then(controller):
    """One joint is wrong in one of 32 control periods."""
    controller.inject("temperature_glitch", {"joint": 2, "value": 0.0})
    seen = []
    for _ in range(64):
        controller.step()
        seen.append(controller.measurements.latest.temperature_c)
    wrong = np.array(seen) == 0.0
    assert wrong.sum(axis=0).tolist() == [0, 2, 0, 0, 0, 0]


def test_an_obstacle_is_borne_by_the_drive_until_it_is_gone(controller):
    """A standing joint's drive takes 60 N·m more against the torque from outside, and holds its place; after its time nothing presses."""
    gain = controller.arm.gain_nm_per_a[1]

    def driven(seconds: float) -> float:
        for _ in range(round(seconds / controller.clock.tick_s)):
            controller.step()
        return float(controller.arm.torque_nm[1])

    before, q = driven(0.5), controller.arm.q[1]
    assert "60 N·m" in controller.inject("obstacle", {"joint": 2, "torque": 60.0, "seconds": 1.0})
    pressed = driven(0.8)
    assert abs(controller.measurements.latest.current[1] * gain - pressed) < 2.0  # noise of the current
    assert pressed - before > 60.0 - 25.0  # friction holds a part of it
    assert abs(controller.arm.q[1] - q) < 0.01
    driven(0.5)
    assert controller.arm.contact is None
    assert driven(0.5) < pressed - 10.0


def test_a_wall_stops_nothing_but_a_joint_that_goes_on():
    """An elastic wall pushes a joint back in proportion to the way that it has gone into the wall, and never pulls it."""
    contact = Contact(joint=1, left_s=math.inf, stiffness_nm_per_rad=1000.0, wall_rad=0.5, side=-1.0)
    assert contact.torque_nm(np.array([0.0, 0.6, 0.0])).tolist() == [0.0, 0.0, 0.0]
    assert contact.torque_nm(np.array([0.0, 0.48, 0.0])) == pytest.approx([0.0, 20.0, 0.0])


def test_a_stuck_current_sensor_shows_the_same_current():
    """The current of one joint stays the same while the arm moves; those of the other joints change."""
    pendant = Pendant()
    pendant.controller.inject("current_stuck", {"joint": 3})
    currents = []
    for _ in range(10):
        pendant.stream(0.05)
        currents.append(pendant.controller.measurements.latest.current)
    assert len(set(np.array(currents)[:, 2])) == 1
    assert len(set(np.array(currents)[:, 1])) > 5


def test_an_encoder_offset_shifts_what_is_measured_and_moves_nothing(controller):
    """The arm stays and gravity acts on its true position. The measured position and the reference shift."""
    true, measured_before, moment = controller.arm.q.copy(), controller.measurements.latest.q, controller.arm.torque_nm.copy()
    controller.inject("encoder_offset", {"joint": 2, "value": 0.05})
    for _ in range(100):
        controller.step()
    assert np.allclose(controller.arm.q, true, atol=1e-5)
    assert controller.measurements.latest.q[1] - measured_before[1] == pytest.approx(0.05, abs=2e-4)
    assert controller.reference.q[1] - true[1] == pytest.approx(0.05, abs=1e-3)
    assert np.allclose(controller.arm.torque_nm, moment, atol=1.0)
    assert controller.modes.safety == SafetyMode.NORMAL
    controller.inject("clear", {})
    controller.step()
    assert controller.measurements.latest.q[1] == pytest.approx(measured_before[1], abs=2e-4)


def test_noisier_currents_are_noisier(controller):
    """The standard deviation is four times as large with the fault, and normal after `clear`."""

    def spread() -> float:
        values = []
        for _ in range(400):
            controller.step()
            values.append(controller.measurements.latest.current)
        return float(np.std(values, axis=0)[0])

    usual = spread()
    controller.inject("current_noise", {"factor": 4.0})
    assert spread() == pytest.approx(4.0 * usual, rel=0.2)  # 400 draws: 3.5 % each, correlated
    controller.inject("clear", {})
    assert spread() == pytest.approx(usual, rel=0.2)


@pytest.mark.parametrize(("runtime", "state"), [("paused", 4), ("stopped", 1), ("playing", 2)])
def test_a_protective_stop_comes_in_each_observed_variant(runtime, state):
    """The argument of the fault decides what becomes of the program, whatever the settings say."""
    pendant = Pendant()
    pendant.controller.inject("protective_stop", {"runtime": runtime})
    pendant.run(0.2)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert pendant.controller.modes.runtime == state


def test_somebody_else_stops_the_program(controller):
    """The reply says whether a program was running."""
    assert controller.inject("program_stop", {}) == "no program was running"
    pendant = Pendant()
    assert pendant.controller.inject("program_stop", {}) == "program stopped"
    assert pendant.controller.modes.runtime == Runtime.STOPPED


# --- through the wire -----------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def healed(request):
    """Every test leaves the shared simulator without a fault."""
    yield
    if "ur5" in request.fixturenames:
        with request.getfixturevalue("ur5").remote() as remote:
            remote.fault("clear")
            if remote.truth()["safety_mode"] == 7:
                remote.fault("emergency_release")


@pytest.mark.parametrize("service", list(PORTS))
def test_connections_of_each_service_can_be_closed_and_reset(ur5, service):
    """They end with FIN or RST, and connections of other services stay."""
    other = "dashboard" if service != "dashboard" else "secondary"
    with ur5.remote() as remote, socket.create_connection((ur5.address, PORTS[other]), timeout=5) as bystander:
        for name, how in (("close", "closed"), ("reset", "reset")):
            with socket.create_connection((ur5.address, PORTS[service]), timeout=5) as wire:
                assert eventually(partial(dropped, remote, name, service), 2.0)
                assert ended(wire) == how
        assert bystander.recv(10)


def test_a_listener_goes_away_and_comes_back(ur5):
    """New connections are refused, and open ones continue."""
    with ur5.remote() as remote, RawRtde(ur5.address) as standing:
        standing.stream("timestamp")
        remote.fault("listener_gone", service="rtde")
        assert refused(ur5.address, 30004)
        assert not refused(ur5.address, 29999)
        standing.timestamps(5)
        remote.fault("clear")
        assert eventually(lambda: not refused(ur5.address, 30004), 2.0)


def alive(wire: socket.socket) -> bool:
    """Whether the other side has not ended the connection."""
    wire.settimeout(0.2)
    try:
        return wire.recv(65536) != b""
    except TimeoutError:
        return True


@pytest.mark.parametrize(("fault", "end"), [("close", "closed"), ("reset", "reset")])
def test_one_connection_alone_ends_and_the_others_stay(ur5, fault, end):
    """Connections are numbered from the oldest. The truth tells which of them control the arm."""
    with ur5.remote() as remote, RawRtde(ur5.address) as receive, RawRtde(ur5.address) as control:
        receive.stream("timestamp")
        assert control.ask(b"I", b"input_int_register_0") == b"\x01INT32"
        with socket.create_connection((ur5.address, 30003), timeout=5) as script:
            assert eventually(lambda: len(remote.truth()["connections"]) == 3, 2.0)
            connections = remote.truth()["connections"]
            assert [(each["service"], each["controls"]) for each in connections] == [("rtde", False), ("rtde", True), ("realtime", False)]
            assert connections[2]["client_port"] == script.getsockname()[1]
            assert "1 connections" in remote.fault(fault, service="rtde", connection=2)
            assert ended(control.wire) == end
            assert alive(receive.wire)
            assert alive(script)
            assert "0 connections" in remote.fault(fault, service="rtde", connection=2)
            assert "1 connections" in remote.fault(fault, service="realtime", connection=1)
            assert ended(script) == end
            assert alive(receive.wire)


def test_a_restarted_controller_begins_its_clock_anew(ur5):
    """All connections are reset. Half a second later the controller is back with the same arm and without power."""
    with ur5.remote() as remote, RawRtde(ur5.address) as before:
        before.stream("timestamp")
        old = before.timestamps(1)[0]
        remote.wear(2, coulomb_factor=1.25)
        remote.fault("restart", seconds=0.5)
        assert ended(before.wire) == "reset"
        assert refused(ur5.address, 30004)
        assert eventually(lambda: not refused(ur5.address, 30004), 3.0)
        with RawRtde(ur5.address) as after:
            after.stream("timestamp,robot_mode")
            assert after.timestamps(1)[0] < 2.5 < 2.5 + old
        truth = remote.truth()
        assert truth["robot_mode"] == 3
        assert truth["wear_coulomb"][1] == 1.25
        with socket.create_connection((ur5.address, 29999), timeout=5) as wire, wire.makefile("rw") as file:
            file.readline()
            for command, answer in (("power on", "Powering on"), ("brake release", "Brake releasing")):
                file.write(command + "\n")
                file.flush()
                assert file.readline().strip() == answer
        assert remote.truth()["robot_mode"] == 7
        remote.wear(2, coulomb_factor=1.0)


@pytest.mark.parametrize("connections", ["silent", "reset"])
def test_a_controller_without_power_is_gone_and_comes_back_without_power(spawn, connections):
    """Silent connections stay open without a word until the controller is back; new ones get no word either. The arm is braked at once."""
    simulator = spawn("--robot", "ur5")
    with simulator.remote() as remote, RawRtde(simulator.address) as rtde:
        rtde.stream("timestamp")
        rtde.timestamps(5)
        remote.fault("power_cut", seconds=1.5, connections=connections)
        truth = remote.truth()
        assert (truth["robot_mode"], truth["boot"]) == (3, 1)
        if connections == "reset":
            assert ended(rtde.wire) == "reset"
            assert refused(simulator.address, 29999)
        else:
            rtde.wire.settimeout(0.3)
            with pytest.raises(TimeoutError):
                rtde.timestamps(50)
            with socket.create_connection((simulator.address, 29999), timeout=0.3) as wire, pytest.raises(TimeoutError):
                wire.recv(100)
            assert ended(rtde.wire) == "reset"
        assert eventually(lambda: remote.truth()["boot"] == 2, 3.0)
        assert remote.truth()["robot_mode"] == 3
        assert eventually(lambda: not refused(simulator.address, 30004), 2.0)


def test_the_dashboard_ends_its_connections_when_local_control_is_taken(spawn):
    """A new connection is served, and refuses what acts."""
    simulator = spawn("--robot", "ur5e")
    with simulator.remote() as remote, socket.create_connection((simulator.address, 29999), timeout=5) as wire:
        wire.recv(100)
        remote.fault("remote", state="off")
        assert ended(wire) == "closed"
        with socket.create_connection((simulator.address, 29999), timeout=5) as again, again.makefile("rw") as file:
            file.readline()
            file.write("stop\n")
            file.flush()
            assert "Remote Control" in file.readline()


def test_late_packets_come_in_a_bunch_and_in_order(ur5):
    """Half of the packets are 50 ms late. None is lost, their order is kept, and there are gaps on the wall clock."""
    with ur5.remote() as remote, RawRtde(ur5.address) as rtde:
        rtde.stream("timestamp")
        remote.fault("late", seconds=0.05, share=0.5)
        stamps, arrivals = [], []
        for _ in range(100):
            stamps += rtde.timestamps(1)
            arrivals.append(time.monotonic())
        assert np.allclose(np.diff(stamps), 0.008, atol=1e-9)
        assert max(np.diff(arrivals)) > 0.03
        assert min(np.diff(arrivals)) < 0.002


def test_packets_that_are_all_late_still_come(ur5):
    """Packets are held back for more than half a second, and none is lost."""
    with ur5.remote() as remote, RawRtde(ur5.address) as rtde:
        rtde.stream("timestamp")
        remote.fault("late", seconds=0.7, share=1.0)
        stamps = rtde.timestamps(180)
        assert np.allclose(np.diff(stamps), 0.008, atol=1e-9)


def test_a_controller_that_is_killed_twice_restarts_once(spawn):
    """Otherwise a client that connects after the first restart would be connected to a dead controller."""
    simulator = spawn("--robot", "ur5")
    with simulator.remote() as remote:
        remote.fault("restart", seconds=0.2)
        remote.fault("restart", seconds=0.6)
        begun = time.monotonic()
        assert eventually(lambda: not refused(simulator.address, 30004), 3.0)
        assert time.monotonic() - begun > 0.4
        with RawRtde(simulator.address) as rtde:
            rtde.stream("timestamp")
            assert np.all(np.diff(rtde.timestamps(60)) > 0)


def test_a_listener_that_is_gone_for_good_does_not_come_back_with_another(ur5):
    """One listener is away for a time, another until `clear`."""
    with ur5.remote() as remote:
        remote.fault("listener_gone", service="rtde", seconds=0.2)
        remote.fault("listener_gone", service="dashboard")
        assert eventually(lambda: not refused(ur5.address, 30004), 2.0)
        time.sleep(0.1)
        assert refused(ur5.address, 29999)
        remote.fault("clear")
        assert eventually(lambda: not refused(ur5.address, 29999), 2.0)


def test_skipped_packets_are_missing_from_the_clock(ur5):
    """A fifth of the control periods is never sent."""
    with ur5.remote() as remote, RawRtde(ur5.address) as rtde:
        rtde.stream("timestamp")
        remote.fault("skip", share=0.2)
        rtde.timestamps(20)
        steps = np.rint(np.diff(rtde.timestamps(200)) / 0.008)
        assert 0.05 < np.mean(steps > 1) < 0.4  # 0.2 ± 0.03


def test_a_mute_controller_accepts_and_sends_nothing(ur5):
    """The handshake gets no reply, so a constructor of ur-rtde would hang."""
    with ur5.remote() as remote:
        remote.fault("mute")
        with RawRtde(ur5.address, timeout_s=0.3) as rtde, pytest.raises(TimeoutError):
            rtde.ask(b"V", b"\x00\x02")
        remote.fault("clear")
        with RawRtde(ur5.address) as rtde:
            assert rtde.ask(b"V", b"\x00\x02") == b"\x01"


def test_a_text_message_at_connect_comes_before_the_first_reply(ur5):
    """A client that reads one packet after each request takes the text message for the first reply."""
    with ur5.remote() as remote:
        remote.fault("text_at_connect")
        with RawRtde(ur5.address) as rtde:
            rtde.send(b"V", b"\x00\x02")
            kind, payload = rtde.packet()
            assert kind == b"M"
            assert payload[1 : 1 + payload[0]] == b"Safety setup has not been confirmed yet"
            assert rtde.packet() == (b"V", b"\x01")


def test_registers_are_held_by_somebody_who_is_gone(ur5):
    """Clients get IN_USE until `clear`."""
    with ur5.remote() as remote:
        remote.fault("registers_in_use")
        with RawRtde(ur5.address) as rtde:
            assert rtde.ask(b"I", b"input_int_register_0") == b"\x00IN_USE"
            remote.fault("clear")
            assert rtde.ask(b"I", b"input_int_register_0") == b"\x01INT32"


def test_another_version_and_missing_outputs_are_reported(ur5):
    """RTDE and the dashboard report the version; a missing output is NOT_FOUND."""
    with ur5.remote() as remote, RawRtde(ur5.address) as rtde:
        remote.fault("version", version="5.3.1")
        assert rtde.ask(b"v") == bytes.fromhex("00000005 00000003 00000001 00000000")
        remote.fault("not_found", names="joint_temperatures,actual_current")
        assert rtde.ask(b"O", bytes.fromhex("405f400000000000") + b"timestamp,joint_temperatures") == b"\x00DOUBLE,NOT_FOUND"


def test_remote_control_off_is_reported(spawn, client):
    """On an e-Series, ur-rtde asks whether remote control is on."""
    simulator = spawn("--robot", "ur5e")
    with simulator.remote() as remote:
        remote.fault("remote", state="off")
    assert result_of(client(DASHBOARD, simulator.address, "isInRemoteControl"))["isInRemoteControl"] is False


def test_a_frozen_controller_keeps_its_connections_and_loses_time(ur5):
    """For half a second no control period is computed. Then the clock continues where it was."""
    with ur5.remote() as remote, RawRtde(ur5.address) as rtde:
        rtde.stream("timestamp")
        rtde.timestamps(3)
        dropped = remote.truth()["ticks"]["dropped"]
        remote.fault("freeze", seconds=0.5)
        begun, stamp = time.monotonic(), rtde.timestamps(1)[0]
        stamps = rtde.timestamps(30)
        assert time.monotonic() - begun > 0.45
        assert stamps[-1] - stamp < 0.35
        assert remote.truth()["ticks"]["dropped"] - dropped > 40


def test_an_emergency_stop_through_the_command_line(ur5, capsys):
    """The command injects a fault. For an unknown fault it names the known ones."""
    from monitor.cli.main import app

    app(["simulate", "--bind", ur5.address, "--fault", "emergency_stop"], standalone_mode=False)
    assert "emergency stop" in capsys.readouterr().out
    with ur5.remote() as remote:
        assert eventually(lambda: remote.truth()["robot_mode"] == 3, 2.0)
        with pytest.raises(BadInput, match="known are"):
            app(["simulate", "--bind", ur5.address, "--fault", "earthquake"], standalone_mode=False)
        remote.fault("emergency_release")
