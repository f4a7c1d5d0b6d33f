"""Ports 30001–30003 byte for byte. Lengths, offsets and expected bytes come from the manufacturer's guide."""

import socket
import struct
import time

import numpy as np
import pytest
from sim_pendant import Pendant

from monitor.acquire.ur.primary import reported_error
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.journal import ErrorMessage, ExceptionMessage, ProgramMessage, SafetyMessage, TextMessage
from monitor.simulate.machine.state import ASKED, SafetyMode
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import primary
from monitor.simulate.wire.variables import output_variables


@pytest.fixture
def ur5e() -> Controller:
    """A UR5e after one second, standing upright."""
    controller = Controller(SimulateSettings(robot="ur5e"))
    for _ in range(500):
        controller.step()
    return controller


def realtime_packet(controller: Controller) -> bytes:
    return primary.realtime_packing(controller, output_variables(controller), controller.settings.polyscope)()


def packages(message: bytes) -> dict[int, bytes]:
    """The packages of a robot state message: type → payload."""
    size, kind = struct.unpack_from(">iB", message)
    assert (size, kind) == (len(message), 16)
    found, rest = {}, message[5:]
    while rest:
        length, number = struct.unpack_from(">iB", rest)
        found[number], rest = rest[5:length], rest[length:]
    return found


def test_a_robot_state_message_has_the_published_packages(ur5e):
    """Package lengths of 5.x: mode 47, joints 251, tool 37, master board 75, tool pose 101, forces 61 bytes."""
    lengths = {kind: len(payload) + 5 for kind, payload in packages(primary.state(ur5e)).items()}
    assert lengths == {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 7: 61, 8: 9}
    assert len(packages(primary.state(Controller(SimulateSettings())))[0]) + 5 == 46  # CB3: without the reserved byte


def test_the_first_state_of_a_connection_holds_kinematics_and_configuration(ur5e):
    """225 bytes: six checksums, θ, a, d, α, status. 445 bytes: limits, defaults, a, d, α, θ, and the kind of arm at the end."""
    found = packages(primary.state(ur5e, first=True))
    assert {kind: len(found[kind]) + 5 for kind in (5, 6)} == {5: 225, 6: 445}
    robot = ur5e.robot
    *checksums, status = struct.unpack(">6I192x1I", found[5])
    assert len(set(checksums)) == 6
    assert status == 0
    assert struct.unpack_from(">24d", found[5], 24) == (*[0.0] * 6, *robot.a_m, *robot.d_m, *robot.alpha_rad)
    figures = struct.unpack(">53d4i", found[6])
    assert figures[:4] == (-robot.max_position_rad[0], robot.max_position_rad[0], -robot.max_position_rad[1], robot.max_position_rad[1])
    assert figures[12:14] == (robot.max_speed_rad_s[0], 40.0)
    assert figures[24:29] == (1.05, 1.4, 0.25, 1.2, 0.0)
    assert figures[29:53] == (*robot.a_m, *robot.d_m, *robot.alpha_rad, *[0.0] * 6)
    assert figures[55] == 1  # a UR5; the version tells that it is an e-Series


def test_robot_mode_data_byte_for_byte(ur5e):
    """One million microseconds; connected, enabled, powered; mode 7; full speed."""
    assert packages(primary.state(ur5e))[0] == bytes.fromhex(
        "00000000000f4240 01 01 01 00 00 00 00 07 00 3ff0000000000000 3ff0000000000000 3ff0000000000000 00"
    )


def test_joint_data_and_tool_pose_by_their_offsets(ur5e):
    """41 bytes per joint: actual q, target q, q̇, then current, voltage and twice the temperature as floats, and mode 253."""
    found = packages(primary.state(ur5e))
    for joint in range(6):
        q, target, qd = struct.unpack_from(">ddd", found[1], 41 * joint)
        current, voltage, motor, _ = struct.unpack_from(">ffff", found[1], 41 * joint + 24)
        assert (q, target, qd) == (ur5e.measurements.latest.q[joint], ur5e.reference.q[joint], ur5e.measurements.latest.qd[joint])
        assert current == pytest.approx(ur5e.measurements.latest.current[joint], abs=1e-6)
        assert (voltage, motor) == (48.0, ur5e.measurements.latest.temperature_c[joint])
        assert found[1][41 * joint + 40] == 253
    pose = struct.unpack(">12d", found[4])
    assert np.allclose(pose[:6], output_variables(ur5e)["actual_TCP_pose"].read())
    assert pose[6:] == (0.0,) * 6


def test_the_version_message_byte_for_byte(ur5e):
    """Type 20, one million microseconds, from the controller, subtype 3: URControl 5.11, bugfix 0, build 108249, date."""
    expected = (
        bytes.fromhex("0000002e 14 00000000000f4240 07 03 09") + b"URControl" + bytes.fromhex("05 0b 00000000 0001a6d9") + b"Mar 10 2021"
    )
    assert primary.version(ur5e.identity, ur5e.settings.build_date, ur5e.clock.now_s) == expected


def test_messages_of_safety_errors_keys_and_exceptions_byte_for_byte():
    """Each kind of message has its head and its content."""
    head = "14 00000000000f4240 07"
    for message, expected in (
        (ProgramMessage(1.0, "AB", "c"), bytes.fromhex(f"0000001b {head} 07 00000000 00000000 02") + b"ABc"),
        (SafetyMessage(1.0, SafetyMode.NORMAL), bytes.fromhex(f"00000020 {head} 05 00000000 00000000 01 00000000 00000000")),
        (ErrorMessage(1.0, "x"), bytes.fromhex(f"00000024 {head} 06 00000099 00000000 00000003 00000000 00000000") + b"x"),
        (ErrorMessage(1.0, "x", ASKED), bytes.fromhex(f"00000024 {head} 06 000000d1 00000000 00000002 00000000 00000000") + b"x"),
        (ExceptionMessage(1.0, "y"), bytes.fromhex(f"00000018 {head} 0a 00000001 00000001") + b"y"),
        (ExceptionMessage(1.0, "y", 2, 3), bytes.fromhex(f"00000018 {head} 0a 00000002 00000003") + b"y"),
        (TextMessage(1.0, "z"), bytes.fromhex(f"00000010 {head} 00") + b"z"),
    ):
        assert primary.encoded(message) == expected


REALTIME_5_10 = {  # offset in bytes → what the guide's table puts there
    4: "timestamp",
    12: "target_q",
    60: "target_qd",
    108: "target_qdd",
    156: "target_current",
    204: "target_moment",
    252: "actual_q",
    300: "actual_qd",
    348: "actual_current",
    396: "joint_control_output",
    444: "actual_TCP_pose",
    492: "actual_TCP_speed",
    540: "actual_TCP_force",
    588: "target_TCP_pose",
    636: "target_TCP_speed",
    684: "actual_digital_input_bits",
    692: "joint_temperatures",
    740: "actual_execution_time",
    756: "robot_mode",
    764: "joint_mode",
    812: "safety_mode",
    868: "actual_tool_accelerometer",
    940: "speed_scaling",
    948: "actual_momentum",
    972: "actual_main_voltage",
    980: "actual_robot_voltage",
    988: "actual_robot_current",
    996: "actual_joint_voltage",
    1044: "actual_digital_output_bits",
    1052: "runtime_state",
    1060: "elbow_position",
    1084: "elbow_velocity",
    1108: "safety_status",
    1140: "payload",
    1148: "payload_cog",
    1172: "payload_inertia",
}


def test_a_realtime_packet_has_every_field_at_its_published_place(ur5e):
    """1220 bytes, with each field where the table of RealTime 5.10 has it."""
    packet = realtime_packet(ur5e)
    assert struct.unpack_from(">i", packet) == (1220,)
    assert len(packet) == 1220
    for offset, name in REALTIME_5_10.items():
        values = tuple(map(float, output_variables(ur5e)[name].read()))
        assert struct.unpack_from(f">{len(values)}d", packet, offset) == values, name
    assert packet[:12] == bytes.fromhex("000004c4 3ff0000000000000")  # 1220, one second


@pytest.mark.parametrize(
    ("robot", "version", "size"),
    [
        ("ur5", "3.5.0", 1108),
        ("ur5", "3.10.0", 1116),
        ("ur5", "3.14.0", 1140),
        ("ur5", "3.15.0", 1220),
        ("ur5e", "5.4.0", 1116),
        ("ur5e", "5.9.0", 1140),
    ],
)
def test_a_realtime_packet_is_as_long_as_its_version_requires(robot, version, size):
    """The length field and the number of bytes agree with the version."""
    packet = realtime_packet(Controller(SimulateSettings(robot=robot, version=version)))
    assert struct.unpack_from(">i", packet)[0] == len(packet) == size


def test_state_comes_ten_times_a_second_and_realtime_with_every_tick(ur5):
    """On the wire, 30001 and 30002 begin with the version, 30003 with its length."""
    with (
        socket.create_connection((ur5.address, 30002), timeout=5) as slow,
        socket.create_connection((ur5.address, 30003), timeout=5) as fast,
        slow.makefile("rb") as slowly,
        fast.makefile("rb") as quickly,
    ):
        size, kind = struct.unpack(">iB", slowly.read(5))
        assert kind == 20
        slowly.read(size - 5)
        stamps = []
        for _ in range(6):
            size, kind = struct.unpack(">iB", slowly.read(5))
            assert kind == 16
            stamps.append(struct.unpack_from(">Q", slowly.read(size - 5), 5)[0])
        assert np.allclose(np.diff(stamps), 96_000, atol=8_001)  # a whole number of ticks of 8 ms, nearest to 100 ms
        ticks = [struct.unpack_from(">id", quickly.read(1220))[1] for _ in range(60)]
        assert np.allclose(np.diff(ticks), 0.008, atol=1e-9)


def test_a_protective_stop_is_reported_on_the_primary_port_and_not_on_the_secondary(ur5):
    """The primary port sends the safety mode and the error code once."""
    with (
        ur5.remote() as remote,
        socket.create_connection((ur5.address, 30001), timeout=5) as first,
        socket.create_connection((ur5.address, 30002), timeout=5) as second,
    ):
        time.sleep(0.2)
        remote.protective_stop()
        kinds = []
        for wire, last in ((first, 6), (second, None)):
            data, seen, until = b"", [], time.monotonic() + (3.0 if last else 0.3)
            wire.settimeout(0.05)
            while last not in seen and time.monotonic() < until:
                try:
                    data += wire.recv(65536)
                except TimeoutError:
                    continue
                while len(data) >= 5 and len(data) >= struct.unpack_from(">i", data)[0]:
                    size, kind = struct.unpack_from(">iB", data)
                    if kind == 20:
                        seen.append(data[14])
                    data = data[size:]
            kinds.append(seen)
        assert kinds == [[3, 5, 6], [3]]
        time.sleep(5.1)
        with socket.create_connection((ur5.address, 29999), timeout=5) as wire, wire.makefile("rw") as file:
            file.readline()
            answer, until = "", time.monotonic() + 10.0  # on a busy machine the controller's clock lags behind
            while answer != "Protective stop releasing" and time.monotonic() < until:
                time.sleep(0.1)
                file.write("unlock protective stop\n")
                file.flush()
                answer = file.readline().strip()
        assert answer == "Protective stop releasing"


def test_programs_are_reported_on_the_primary_port():
    """A key message reports the start and the end of a program. A runtime exception has a message of its own."""
    pendant = Pendant()
    messages = pendant.controller.journal.messages
    assert [primary.encoded(message)[14] for message in messages] == [7]
    pendant.controller.raise_exception("test")
    assert [primary.encoded(message)[14] for message in messages] == [7, 10, 7]


def test_a_protective_stop_names_the_joint_that_noticed_it(ur5e):
    """The argument of C153, from 0; as a listener of the monitor reads it."""
    for noticed, joint in ((4, 4), (None, 1)):
        ur5e.journal.messages.clear()
        ur5e.modes.safety = SafetyMode.NORMAL
        ur5e.safety.protective_stop("something was in the way", joint=noticed)
        [told] = [message for message in ur5e.journal.messages if isinstance(message, ErrorMessage)]
        assert reported_error(primary.encoded(told)[5:]) == (f"C153A{joint - 1}", joint)
