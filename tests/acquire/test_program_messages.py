"""The names of programs on the primary port: bytes as the manufacturer's guide lays them out, in pieces, broken, and of nobody."""

import socket
import struct

import pytest

from monitor.acquire.ur.primary import HEAD, ProgramMessage, ProgramMessages, program_message


def robot_message(kind: int, payload: bytes) -> bytes:
    body = struct.pack(">QbB", 123_456, -2, kind) + payload
    return HEAD.pack(HEAD.size + len(body), 20) + body


def key_message(title: bytes, text: bytes) -> bytes:
    return robot_message(7, struct.pack(">iiB", 0, 0, len(title)) + title + text)


STATE = HEAD.pack(HEAD.size + 4, 16) + bytes(4)
BEGAN, ENDED = b"PROGRAM_XXX_STARTED", b"PROGRAM_XXX_STOPPED"


@pytest.fixture
def wire():
    """A function: bytes go to the reader. And the reader."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        messages = ProgramMessages(ours)
        yield theirs, messages


def test_programs_are_told_by_name_in_their_order_whatever_comes_between(wire):
    """A name is whatever the controller sends, also one that is no UTF-8."""
    controller, messages = wire
    controller.sendall(STATE + key_message(BEGAN, b"welding") + robot_message(0, b"a text") + STATE)
    assert messages.started() == ["welding"]
    assert messages.running == "welding"
    controller.sendall(key_message(ENDED, b"another") + key_message(b"SOMETHING_ELSE", b"x"))
    assert messages.started() == []
    assert messages.running == "welding"
    controller.sendall(key_message(ENDED, b"welding") + key_message(BEGAN, b"\xff"))
    assert messages.started() == ["�"]


def test_a_message_in_pieces_is_told_once_it_is_whole(wire):
    controller, messages = wire
    data = key_message(BEGAN, "Schweißen 2".encode())
    for n in range(len(data)):
        assert messages.started() == []
        controller.sendall(data[n : n + 1])
    assert messages.started() == ["Schweißen 2"]


@pytest.mark.parametrize("data", [b"", b"\0\0\0\0\0", b"\xff\xff\xff\xff\x14", b"HTTP/1.0 400 Bad Request\r\n"])
def test_an_end_and_what_is_no_such_protocol_tell_nothing_more_and_break_nothing(wire, data):
    controller, messages = wire
    controller.sendall(key_message(BEGAN, b"welding") + data)
    controller.shutdown(socket.SHUT_WR)
    assert messages.started() == ["welding"]
    assert not messages.open
    assert messages.started() == []


@pytest.mark.parametrize("payload", [b"", bytes(9), bytes(8) + b"\xff" + BEGAN, bytes(8) + b"\x05" + BEGAN])
def test_a_key_message_that_is_cut_off_or_has_a_wrong_length_names_no_program(payload):
    """A length beyond the message's end takes the rest for the title."""
    assert program_message(robot_message(7, payload)[HEAD.size :]) in (None, ProgramMessage(started=True, name=""))


def test_the_mistake_that_ended_a_program_is_kept_with_its_place(wire):
    """One that is cut off is none."""
    controller, messages = wire
    controller.sendall(key_message(BEGAN, b"welding") + robot_message(10, struct.pack(">ii", 3, 5) + b"division by zero"))
    assert messages.started() == ["welding"]
    assert messages.mistake == "line 3, column 5: division by zero"
    controller.sendall(robot_message(10, b"\0\0\0") + STATE)
    messages.started()
    assert messages.mistake == "line 3, column 5: division by zero"


def test_where_nobody_listens_nothing_is_told():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        messages = ProgramMessages.of("127.0.0.1", free.getsockname()[1])
    assert not messages.open
    assert messages.started() == []
