"""The event loop that wakes once a tick: nothing is lost or later than the tick, and a target counts in the tick it came before."""

import os
import socket
import time

import pytest

from monitor.simulate.wire.ticking import TickSelector
from monitor.simulate.wire.timer import expirations, periodic_timer

TICK_S = 0.05


@pytest.fixture
def followed():
    selector, timer = TickSelector(), periodic_timer(TICK_S)
    here, there = socket.socketpair()
    selector.register(timer, 1)
    selector.register(here, 1)
    streaming = []
    selector.follow(timer, lambda: bool(streaming))
    yield selector, timer, here, there, streaming
    selector.close()
    os.close(timer)
    here.close()
    there.close()


def test_what_comes_between_ticks_is_seen_with_the_next_and_before_it(followed):
    """One wake for both, the timer's own event last."""
    selector, timer, here, there, streaming = followed
    streaming.append(True)
    selector.select(1.0)
    expirations(timer)
    there.send(b"target")
    assert [key.fd for key, _ in selector.select(1.0)] == [here.fileno(), timer]


def test_without_streams_everything_is_seen_at_once(followed):
    """A handshake does not wait for ticks."""
    selector, timer, here, there, _ = followed
    expirations(timer)
    there.send(b"hello")
    assert [key.fd for key, _ in selector.select(1.0)] == [here.fileno()]


def test_a_timeout_that_ends_before_the_tick_is_kept(followed):
    """Faults that act after a while act then, not a tick later; no select spins."""
    selector, timer, _, _, streaming = followed
    streaming.append(True)
    selector.select(1.0)
    expirations(timer)
    began = time.monotonic()
    assert selector.select(0.01) == []
    assert 0.01 <= time.monotonic() - began < TICK_S
    assert selector.select(0) == []


def test_a_timer_that_is_gone_is_waited_for_no_longer(followed):
    """The end of the service is no tick."""
    selector, _, here, there, streaming = followed
    streaming.append(True)
    selector.forget()
    there.send(b"shutdown")
    assert here.fileno() in [key.fd for key, _ in selector.select(1.0)]
