"""Listening by a plain socket, against a controller of bytes: what it reads, what it does without, and how a bad answer ends it."""

import socket
import struct
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from monitor.acquire.driver import SessionEnded
from monitor.acquire.ur.rtde import COLUMN, ROWS, SIGNALS, WIDTH, Listening, observe

TYPE = {1: "DOUBLE", 3: "VECTOR3D", 6: "VECTOR6D"}
WHOLE_NUMBERS = {
    "robot_mode": ("INT32", "i"),
    "safety_mode": ("INT32", "i"),
    "runtime_state": ("UINT32", "I"),
    "safety_status_bits": ("UINT32", "I"),
    "robot_status_bits": ("UINT32", "I"),
    "actual_digital_input_bits": ("UINT64", "Q"),
    "joint_mode": ("VECTOR6INT32", "6i"),
}


def package(kind, payload=b""):
    return struct.pack(">HB", len(payload) + 3, ord(kind)) + payload


def types(names, **other):
    """What a controller says of these variables."""
    width = {signal.variable: signal.width for signal in SIGNALS}
    known = {name: WHOLE_NUMBERS[name][0] if name in WHOLE_NUMBERS else TYPE[width[name]] for name in names}
    return ",".join((known | {name: kind for name, kind in other.items() if name in known}).values())


def values_of(name, tick):
    """What `row` sends of one variable."""
    width = next(signal.width for signal in SIGNALS if signal.variable == name)
    return [float(hash_of(name) + tick + k) for k in range(width)]


def hash_of(name):
    return sum(name.encode()) % 97


def row(names, tick, **other):
    body = b"\x01"
    for name in names:
        values = other.get(name, values_of(name, tick))
        if name in WHOLE_NUMBERS:
            body += struct.pack(f">{WHOLE_NUMBERS[name][1]}", *(int(value) for value in values))
        else:
            body += struct.pack(f">{len(values)}d", *values)
    return package("U", body)


class Bytes:
    """A controller that answers each request by a function of the variables asked for, and then sends `after`."""

    def __init__(self, *, version=b"\x01", outputs=types, start=b"\x01", after=lambda names: b"", pieces=None):
        self.version, self.outputs, self.start, self.after, self.pieces = version, outputs, start, after, pieces
        self.asked, self.rates = [], []

    def talk(self, peer):
        names = []
        with peer, peer.makefile("rb") as wire:
            while head := wire.read(3):
                size, kind = struct.unpack(">HB", head)
                payload = wire.read(size - 3)
                if kind == ord("V"):
                    self.say(peer, package("V", self.version))
                elif kind == ord("O"):
                    self.rates.append(struct.unpack_from(">d", payload)[0])
                    names = payload[8:].decode().split(",")
                    self.asked.append(names)
                    self.say(peer, package("M", b"a text for people") + package("O", b"\x01" + self.outputs(names).encode()))
                elif kind == ord("S"):
                    self.say(peer, package("S", self.start) + self.after(names))

    def say(self, peer, data):
        for at in range(0, len(data), self.pieces or len(data)):
            peer.sendall(data[at : at + (self.pieces or len(data))])


@contextmanager
def listening_to(controller, name="127.0.0.1"):
    """A session that listens to it, on a port of the kernel's choice."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            try:
                while True:
                    controller.talk(server.accept()[0])
            except OSError:
                return  # the test has ended

        threading.Thread(target=serve, daemon=True).start()
        session = Listening(name, 10.0, server.getsockname()[1])
        try:
            yield session
        finally:
            session.end()
            server.shutdown(socket.SHUT_RDWR)


def received(session, count):
    """So many frames, however long they take."""
    frames, until = [], time.monotonic() + 30.0
    while len(frames) < count:
        assert time.monotonic() < until, frames
        frames += session.frames(0.2)
    return frames


@pytest.mark.parametrize("pieces", [None, 7])
def test_rows_are_read_as_they_were_sent_in_whatever_pieces_they_come(pieces):
    """Each value stands in its column; what nobody sends is NaN; the time of reading is the host's."""
    after = lambda names: b"".join(row(names, tick) for tick in range(3))  # noqa: E731
    controller = Bytes(after=after, pieces=pieces)
    with listening_to(controller) as session:
        rows = received(session, 3)
    for tick, found in enumerate(rows):
        assert found.shape == (WIDTH,)
        for signal in SIGNALS:
            assert np.atleast_1d(found[COLUMN[signal.variable]]).tolist() == values_of(signal.variable, tick)
        assert np.isnan(found[COLUMN["commanded_q"]]).all()
        assert 0.0 <= time.monotonic() - found[COLUMN["host_monotonic_s"]][0] < 60.0
    assert controller.rates == [10.0]


def test_what_a_controller_does_not_report_is_left_out_and_what_is_no_number_is_not_missing():
    """The recipe is asked for once more without it. In a row NaN means "not reported", so that a NaN of the controller's becomes inf."""

    def outputs(names):
        return types(names, payload="NOT_FOUND", joint_mode="NOT_FOUND")

    controller = Bytes(outputs=outputs, after=lambda names: row(names, 5, speed_scaling=[np.nan], actual_q=[np.nan] * 6))
    with listening_to(controller) as session:
        (found,) = received(session, 1)
    assert len(controller.asked) == 2
    assert set(controller.asked[0]) - set(controller.asked[1]) == {"payload", "joint_mode"}
    assert np.isnan(found[COLUMN["payload"]]).all()
    assert np.isnan(found[COLUMN["joint_mode"]]).all()
    assert found[COLUMN["speed_scaling"]].tolist() == [np.inf]
    assert np.isnan(found[COLUMN["actual_q"]]).all()


@pytest.mark.parametrize(
    ("controller", "why"),
    [
        (Bytes(version=b"\x00"), "version 2"),
        (Bytes(outputs=lambda names: types(names, actual_q="NOT_FOUND")), "does not report actual_q"),
        (Bytes(outputs=lambda names: types(names, actual_q="VECTOR3D")), "actual_q is VECTOR3D; expected 6 numbers"),
        (Bytes(outputs=lambda names: types(names, actual_q="STRING")), "actual_q is STRING"),
        (Bytes(outputs=lambda _: "DOUBLE"), "1 types for"),
        (Bytes(start=b"\x00"), "does not start"),
        (Bytes(after=lambda _: package("U", b"\x01short")), "a row of 6 bytes"),
        (Bytes(after=lambda _: b"\x00\x00U"), "a package without a head"),
    ],
)
def test_an_answer_that_is_not_of_the_protocol_ends_the_session_with_a_reason(controller, why):
    """One message, which names the arm; then nothing more comes, and no row was made of it."""
    with listening_to(controller) as session:
        *rows, last = received(session, 1)
        assert rows == []
        assert last["kind"] == "lost"
        assert last["reason"]["text"].startswith("127.0.0.1: RTDE: ")
        assert why in last["reason"]["text"]
        with pytest.raises(SessionEnded):
            list(session.frames(0.0))


def test_a_controller_that_goes_away_and_one_that_never_was_are_told():
    """Rows that came before are delivered first."""

    class Leaving(Bytes):
        def say(self, peer, data):
            super().say(peer, data)
            if b"U" in data[2:3] or data[2:3] == b"S":
                peer.shutdown(socket.SHUT_RDWR)

    with listening_to(Leaving(after=lambda names: row(names, 1))) as session:
        first, last = received(session, 2)
    assert first.shape == (WIDTH,)
    assert "closed the connection" in last["reason"]["text"]
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    absent = Listening("127.0.0.1", 10.0, port)
    (message,) = received(absent, 1)
    assert message["reason"]["text"] == "127.0.0.1: RTDE: Connection refused"


def test_it_wakes_for_a_row_and_not_before():
    """`wait` ends with what has come, so that a daemon needs no clock to look for it; without anything it lasts as long as it may."""
    go = threading.Event()

    class Later(Bytes):
        def say(self, peer, data):
            super().say(peer, data)
            if data[2:3] == b"S":
                go.wait(30.0)
                super().say(peer, row(self.asked[-1], 3))

    with listening_to(Later()) as session:
        until = time.monotonic() + 30.0
        while session._expected != -1 and time.monotonic() < until:
            assert list(session.frames(0.2)) == []
        began = time.monotonic()
        session.wait(0.05)
        assert time.monotonic() - began >= 0.05
        assert list(session.frames(0.0)) == []
        go.set()
        session.wait(30.0)
        assert len(list(session.frames(0.0))) == 1


def test_a_name_is_looked_up_beside_and_one_that_nobody_knows_is_told():
    """Who only listens may give a name; a name server that takes long holds nobody up."""
    with listening_to(Bytes(after=lambda names: row(names, 2)), "localhost") as session:
        (found,) = received(session, 1)
    assert found.shape == (WIDTH,)
    for name in ("no-such-arm.invalid", "a" * 70 + ".invalid", "..", ""):
        (message,) = received(Listening(name, 10.0, 1), 1)
        assert message["kind"] == "lost"
        assert message["reason"]["text"].startswith(f"{name}: RTDE: ")


def test_a_look_at_an_arm_is_its_last_of_thirteen_ticks_with_the_mean_of_the_accelerometer():
    """The other values are those of the last tick; the connection is closed."""
    after = lambda names: b"".join(row(names, tick) for tick in range(ROWS))  # noqa: E731
    with listening_to(Bytes(after=after)) as session:
        state = observe(session, 30.0)
        with pytest.raises(SessionEnded):
            list(session.frames(0.0))
    assert list(state.q) == values_of("actual_q", ROWS - 1)
    assert list(state.accelerometer_m_s2) == values_of("actual_tool_accelerometer", (ROWS - 1) / 2)


@pytest.mark.parametrize(
    "after",
    [
        lambda names: row(names, 1) * (2 * ROWS),  # a controller that hangs repeats its last tick
        lambda names: b"".join(row(names, tick) for tick in range(ROWS - 1)),  # and then says nothing
        lambda names: b"".join(row(names, tick) for tick in range(ROWS - 1)) + b"\x00\x00U",
    ],
)
def test_no_look_at_an_arm_is_had_from_too_few_ticks(after):
    """Nothing is known of such an arm, within the time that was given."""
    with listening_to(Bytes(after=after)) as session:
        assert observe(session, 0.3) is None
