"""Tests that run long, and a short sample of each for the ordinary suite: lost control periods, clients that do not read, random bytes."""

import socket
import struct
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from raw_rtde import RawRtde
from sim_process import Spawned

SERVICES = (30004, 29999, 30001, 30002, 30003, 30020)
DEAF_MEMORY_MB = 40.0  # what all deaf clients together may cost: buffers of 256 kB each, and Python's own


def memory_mb(simulator: Spawned) -> float:
    """Resident memory of the simulator's process [MB]."""
    pages = int(Path(f"/proc/{simulator.process.pid}/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def lost_ticks(simulator: Spawned, seconds: float) -> tuple[int, int]:
    """Read packets at 500 Hz. Returns their number, and how many timestamps are missing between them."""
    with RawRtde(simulator.address) as rtde:
        rtde.stream("timestamp,actual_q,actual_qd,actual_current,joint_temperatures", 500.0)
        stamps = np.array(rtde.timestamps(round(500 * seconds)))
    return len(stamps), int(np.sum(np.rint(np.diff(stamps) * 500.0) - 1))


def deaf(simulator: Spawned, count: int) -> list[socket.socket]:
    """Clients of RTDE and of the state ports that subscribe to everything and never read."""
    wires = []
    names = b"timestamp," + b",".join(b"output_double_register_%d" % i for i in range(48))
    for i in range(count):
        port = (30004, 30001, 30002, 30003)[i % 4]
        wire = socket.socket()
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wire.settimeout(5)
        wire.connect((simulator.address, port))
        if port == 30004:
            recipe = struct.pack(">d", 500.0) + names
            wire.sendall(struct.pack(">HB", len(recipe) + 3, 79) + recipe + b"\x00\x03S")
        wires.append(wire)
    return wires


class Vandal:
    """Sends random bytes and mutated messages from a seed, cut and joined, to every port."""

    SEEDS = (
        bytes.fromhex("0005560002"),
        bytes.fromhex("000376"),
        bytes.fromhex("000353"),
        bytes.fromhex("000350"),
        bytes.fromhex("00204f405f400000000000") + b"timestamp,robot_mode,",
        bytes.fromhex("001849") + b"input_int_register_0,",
        bytes.fromhex("000855010000000b"),
        b"robotmode\nsafetymode\nPolyscopeVersion\n",
        b"unlock protective stop\npower on\n",
        b"movej([0,-1.57,0,-1.57,0,0], a=1, v=1)\n",
        b"def x():\n  movel(p[0,0,0,0,0,0])\nend\n",
        b"def rtde_control():\n# NODE_CONTROL_LOOP_BEGINS\nend\n",
        b'{"do": "truth"}\n{"do": "fault", "name": "stall", "seconds": 0.001}\n',
        b'{"do": "torque", "q": [[0,0,0,0,0,0]], "qd": 1, "qdd": null}\n{"do": "play", "excitation": {}}\n',
    )

    def __init__(self, seed: int) -> None:
        self._dice = np.random.default_rng(seed)
        self.thrown_out = 0

    def message(self) -> bytes:
        rng = self._dice
        kind = rng.integers(4)
        if kind == 0:
            return rng.bytes(int(rng.integers(1, 60)))
        text = bytearray(self.SEEDS[rng.integers(len(self.SEEDS))])
        if kind >= 2:
            for _ in range(int(rng.integers(1, 5))):
                text[rng.integers(len(text))] = rng.integers(256)
        if kind == 3:
            del text[int(rng.integers(len(text))) :]
        return bytes(text)

    def rage(self, host: str, messages: int) -> int:
        """Send so many messages in bursts on new connections. Returns how many were sent."""
        sent = 0
        while sent < messages:
            burst = min(messages - sent, int(self._dice.integers(1, 400)))
            port = SERVICES[self._dice.integers(len(SERVICES))]
            try:
                with socket.create_connection((host, port), timeout=10) as wire:
                    wire.setblocking(True)
                    wire.settimeout(2.0)
                    wire.sendall(b"".join(self.message() for _ in range(burst)))
                    wire.setblocking(False)
                    with suppress(OSError):  # nothing to read, or thrown out
                        wire.recv(65536)
            except (ConnectionError, TimeoutError):
                self.thrown_out += 1  # in the middle of the burst
            sent += burst
        return sent


def still_well(simulator: Spawned) -> bool:
    """Check that the simulator runs, computes control periods and answers a handshake."""
    with simulator.remote() as remote:
        before = remote.truth()["ticks"]["run"]
        time.sleep(0.3)
        ticking = remote.truth()["ticks"]["run"] > before + 5
        remote.fault("clear")
    with RawRtde(simulator.address) as rtde:
        return simulator.process.poll() is None and ticking and rtde.ask(b"V", b"\x00\x02") == b"\x01"


def test_three_seconds_at_500_hz_lose_no_tick(spawn):
    """For a client that reads. The long test takes a minute."""
    assert lost_ticks(spawn("--robot", "ur5e"), 3.0) == (1500, 0)


def test_clients_that_do_not_read_cost_bounded_memory_and_disturb_nobody(spawn):
    """Twelve clients do not read for two seconds. A client that reads gets every control period."""
    simulator = spawn("--robot", "ur3e")
    before = memory_mb(simulator)
    wires = deaf(simulator, 12)
    _, lost = lost_ticks(simulator, 2.0)
    assert memory_mb(simulator) - before < DEAF_MEMORY_MB
    assert lost == 0
    for wire in wires:
        wire.close()


def test_after_five_thousand_random_messages_it_still_productions(spawn):
    """The long test sends a million."""
    simulator = spawn("--robot", "ur5")
    Vandal(1).rage(simulator.address, 5_000)
    assert still_well(simulator)


@pytest.mark.soak
@pytest.mark.timeout(200)
def test_a_minute_at_500_hz_loses_no_tick(spawn, soak_row):
    """30 000 packets arrive without a gap."""
    count, lost = lost_ticks(spawn("--robot", "ur5e"), 60.0)
    soak_row("500 Hz for 60 s to a client that reads", f"{count} packets, {lost} lost", "0 lost")
    assert lost == 0


@pytest.mark.soak
@pytest.mark.timeout(200)
def test_clients_that_do_not_read_cost_no_more_after_a_minute_than_at_its_start(spawn, soak_row):
    """Forty clients do not read. Those of RTDE are disconnected after ten seconds."""
    simulator = spawn("--robot", "ur3e")
    before = memory_mb(simulator)
    wires = deaf(simulator, 40)
    lost_ticks(simulator, 15.0)
    early = memory_mb(simulator)
    lost = lost_ticks(simulator, 45.0)[1]
    late = memory_mb(simulator)
    for wire in wires:
        wire.close()
    soak_row("40 clients that never read, 60 s", f"+{late - before:.1f} MB, {lost} lost", "bounded, 0 lost")
    assert early - before < DEAF_MEMORY_MB
    assert late - early < 2.0
    assert lost == 0


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_after_a_million_random_messages_it_still_productions(spawn, soak_row):
    """Random and mutated bytes on every port cause no crash, no hang and no growth of memory."""
    simulator = spawn("--robot", "ur5")
    vandal = Vandal(2)
    sent = vandal.rage(simulator.address, 100_000)  # warm: every cache that fills has filled
    early = memory_mb(simulator)
    sent += vandal.rage(simulator.address, 900_000)
    late = memory_mb(simulator)
    well = still_well(simulator)
    soak_row("messages of nonsense on every port", f"{sent}, {late - early:+.1f} MB", "no growth, well")
    assert well
    assert late - early < 15.0
