"""A permit that is answered by two clients, late, or with malformed text: all must agree."""

import json
from collections.abc import Iterator

import pytest
import zenoh

from monitor.publish.permit import KEY, ask_permit
from monitor.publish.session import session_config

PREFIX = "joint-monitor/v1/lab/arm"


@pytest.fixture
def sessions(free_port: int) -> Iterator[tuple[zenoh.Session, zenoh.Session, zenoh.Session]]:
    """One session that asks, and two that answer."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with (
        zenoh.open(session_config(mode="router", listen=(endpoint,))) as asking,
        zenoh.open(session_config(mode="client", connect=(endpoint,))) as one,
        zenoh.open(session_config(mode="client", connect=(endpoint,))) as two,
    ):
        yield asking, one, two


def answering(session: zenoh.Session, payload: bytes) -> "zenoh.Queryable[None]":
    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, payload)

    queryable = session.declare_queryable(f"{PREFIX}/{KEY}", reply)
    assert list(session.get(f"{PREFIX}/nothing", timeout=10.0)) == []  # once that is answered the router knows the queryable
    return queryable


def yes(why: str = "parked") -> bytes:
    return json.dumps({"allow": True, "why": why}).encode()


@pytest.mark.parametrize(
    "payload",
    [
        b"[" * 100_000,
        b"yes",
        b"",
        b"\xff\xfe",
        b"true",
        b'{"allow": "true"}',
        b'{"allow": 1}',
        b'{"allow": ' + b"9" * 5000 + b"}",
        b"[true]",
    ],
)
def test_a_malformed_answer_is_no_permit_and_no_exception(sessions, payload):
    """The same holds for JSON nested deeper than Python reads, and beside a valid permit."""
    asking, one, two = sessions
    with answering(one, payload), answering(two, yes()):
        answer = ask_permit(asking, PREFIX, {}, 1.0)
    assert answer is not None
    assert not answer.allowed


def test_a_missing_answer_is_no_permit(sessions):
    """The permit of the other client does not suffice."""
    asking, one, two = sessions
    held: list[zenoh.Query] = []
    with two.declare_queryable(f"{PREFIX}/{KEY}", held.append), answering(one, yes()):
        answer = ask_permit(asking, PREFIX, {}, 0.4)
        assert held
    assert answer is None or not answer.allowed


def test_the_text_of_a_client_stays_in_one_line_of_the_log(sessions):
    """The text has no line break and no escape sequence."""
    asking, one, _ = sessions
    with answering(one, yes("parked\nWARNING forged \x1b[2J")):
        answer = ask_permit(asking, PREFIX, {}, 1.0)
    assert answer is not None
    assert answer.text.isprintable()


def test_a_bus_that_is_closed_gives_no_permit(free_port):
    """The window is skipped with a reason, and the scheduler gets no exception."""
    session = zenoh.open(session_config(mode="router", listen=(f"tcp/127.0.0.1:{free_port}",)))
    session.close()
    answer = ask_permit(session, PREFIX, {}, 0.2)
    assert answer is not None
    assert not answer.allowed
    assert "cannot be asked" in answer.text
