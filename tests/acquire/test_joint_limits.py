"""The joint limits of a controller's installation: read from its primary port, and kept by the trajectory."""

import math
import socket
import struct
import threading
from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from hypothesis import given
from hypothesis import strategies as st
from simulated_arm import simulated_arm
from test_guard import inputs, ready_state

from monitor.acquire.safety.conditions import named_conditions
from monitor.acquire.state import Identity, JointLimits
from monitor.acquire.ur import primary
from monitor.acquire.ur.driver import understood
from monitor.model.robot import load_robot

pytestmark = pytest.mark.real_time

WIDE = JointLimits((-6.3,) * 6, (6.3,) * 6, (3.4,) * 6)


def package(kind: int, payload: bytes) -> bytes:
    return struct.pack(">iB", len(payload) + 5, kind) + payload


def configuration_data(limits: JointLimits) -> bytes:
    """Configuration data as the manufacturer's guide lays them out: 445 bytes."""
    positions = [each for pair in zip(limits.lowest_rad, limits.highest_rad, strict=True) for each in pair]
    motion = [each for speed in limits.speed_rad_s for each in (speed, 40.0)]
    rest = struct.pack(">29d4i", *range(29), 3, 2, 1, 0)  # defaults of speed and acceleration, DH parameters, types
    return package(6, struct.pack(">24d", *positions, *motion) + rest)


def state_with(*packages: bytes) -> bytes:
    return package(16, b"".join(packages))


class PrimaryPort:
    """A server that sends given pieces to whoever connects, and then nothing."""

    def __init__(self, host: str, pieces: list[bytes]) -> None:
        self.listener = socket.create_server((host, primary.PORT))
        self.pieces, self.received = pieces, b""
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        connection, _ = self.listener.accept()
        with connection:
            for piece in self.pieces:
                connection.sendall(piece)
            connection.settimeout(2.0)
            try:
                while data := connection.recv(1024):
                    self.received += data
            except OSError:
                pass

    def close(self) -> None:
        self.listener.close()
        self.thread.join(3.0)


def test_the_limits_come_with_the_configuration_data_and_nothing_is_sent():
    """A version message comes first, then a state whose last package they are; it arrives in two pieces."""
    data = configuration_data(WIDE)
    assert len(data) == 445
    message = package(20, bytes(40)) + state_with(package(0, bytes(42)), package(1, bytes(246)), data)
    server = PrimaryPort("127.0.93.11", [message[:100], message[100:]])
    try:
        assert primary.configured("127.0.93.11", 1.0).limits == WIDE
    finally:
        server.close()
    assert server.received == b""


@pytest.mark.parametrize(
    "pieces",
    [
        [],
        [b"\0"],
        [struct.pack(">iB", 2**31 - 1, 16)],
        [struct.pack(">iB", 0, 16)],
        [state_with(package(0, bytes(42)))],
        [state_with(b"\0\0\0\1")],
    ],
)
def test_a_port_without_configuration_data_is_no_limit_and_is_not_waited_for(pieces):
    """Silence, a fragment, an absurd length, a state without them, a package that is no package."""
    server = PrimaryPort("127.0.93.12", pieces)
    try:
        assert primary.configured("127.0.93.12", 0.2).limits is None
    finally:
        server.close()
    assert primary.configured("127.0.93.12", 0.2).limits is None  # and nobody there


@given(st.binary(max_size=600))
def test_no_bytes_from_the_port_raise(data):
    """Whatever a port sends, the answer is limits that make sense or none."""
    found = (primary.configured_in_state(data) or primary.Configured()).limits
    assert found is None or min(found.speed_rad_s) > 0.0


@pytest.mark.parametrize(
    "wrong", [WIDE._replace(lowest_rad=(math.nan,) * 6), WIDE._replace(highest_rad=(-7.0,) * 6), WIDE._replace(speed_rad_s=(0.0,) * 6)]
)
def test_limits_that_make_no_sense_do_not_count_as_reported(wrong):
    """An arm without any range or speed cannot be meant."""
    assert primary.configured_in_state(configuration_data(wrong)).limits is None


def found(limits, **changes):
    identity = understood(Identity("UR5", "1", "3.15.8", True, limits))
    (result,) = named_conditions(inputs(ready_state(), identity=identity, **changes), ("joint_limits",))
    return result


def test_a_trajectory_beyond_the_installations_joint_limits_is_refused():
    """By the joint, its range and the limit; likewise its speed. What is not reported is not checked."""
    assert found(WIDE).checked
    assert found(WIDE).holds
    assert not found(None).checked
    narrow = found(WIDE._replace(highest_rad=(6.3, 6.3, 0.1, 6.3, 6.3, 6.3)))
    assert not narrow.holds
    assert "Elbow (joint 3) moves from" in narrow.text
    slow = found(WIDE._replace(speed_rad_s=(3.4, 3.4, 3.4, 0.1, 3.4, 3.4)))
    assert not slow.holds
    assert "Wrist 1 (joint 4) moves at" in slow.text


def test_an_endless_wrist_beyond_its_reported_limits_shows_that_they_are_not_in_force():
    """A UR3e's wrist 3 at two turns; the limits of the other joints hold all the same."""
    q = short().at(np.zeros(1)).q[0].copy()
    q[5] += 4.0 * np.pi
    on = {"robot": load_robot("ur3e"), "excitation": short(robot="ur3e"), "state": ready_state(q=q, target_q=q)}
    identity = understood(Identity("UR3", "1", "5.11.0", True, WIDE))
    known = replace(inputs(ready_state(), identity=identity), **on)
    assert named_conditions(known, ("joint_limits",))[0].holds
    narrow = replace(known, identity=identity._replace(joint_limits=WIDE._replace(highest_rad=(0.0,) * 6)))
    assert not named_conditions(narrow, ("joint_limits",))[0].holds


def test_a_simulated_controller_tells_the_limits_of_its_model():
    """Its wire is built after the manufacturer's library; the limits of a UR5 are the published ones."""
    with simulated_arm("127.0.93.13") as host:
        limits = primary.configured(host, 2.0).limits
    assert limits is not None
    robot = load_robot("ur5")
    np.testing.assert_allclose(limits.highest_rad, robot.max_position_rad, atol=0.1)  # rad: an installation allows three degrees more
    assert np.all(np.array(limits.speed_rad_s) >= robot.max_speed_rad_s - 1e-6)
