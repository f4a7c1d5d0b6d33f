"""The event loop that wakes once in each control period: no event is lost or delayed beyond the next period."""

import os
import socket
import time

import pytest

from monitor.simulate.wire.ticking import REST_S, TickSelector, expirations, periodic_timer

TICK_S = 0.05


@pytest.fixture
def resting():
    """Not empty while nobody watches."""
    return []


@pytest.fixture
def followed(resting):
    selector, timer = TickSelector(), periodic_timer(TICK_S)
    here, there = socket.socketpair()
    selector.register(timer, 1)
    selector.register(here, 1)
    streaming = []
    selector.follow(timer, lambda: bool(streaming), lambda: bool(resting))
    yield selector, timer, here, there, streaming
    selector.close()
    os.close(timer)
    here.close()
    there.close()


def test_what_comes_between_ticks_is_seen_with_the_next_and_before_it(followed):
    """The loop wakes once for both events, and the timer's own event comes last."""
    selector, timer, here, there, streaming = followed
    streaming.append(True)
    selector.select(1.0)
    expirations(timer)
    there.send(b"target")
    assert [key.fd for key, _ in selector.select(1.0)] == [here.fileno(), timer]


def test_without_streams_everything_is_seen_at_once(followed):
    """A handshake does not wait for the timer."""
    selector, timer, here, there, _ = followed
    expirations(timer)
    there.send(b"hello")
    assert [key.fd for key, _ in selector.select(1.0)] == [here.fileno()]


def test_a_timeout_that_ends_before_the_tick_is_kept(followed):
    """Faults with a delay act in time, and `select` does not poll without rest."""
    selector, timer, _, _, streaming = followed
    streaming.append(True)
    selector.select(1.0)
    expirations(timer)
    began = time.monotonic()
    assert selector.select(0.01) == []
    assert 0.01 <= time.monotonic() - began < TICK_S
    assert selector.select(0) == []


def test_a_closed_timer_is_not_waited_for(followed):
    """The loop does not wait for the timer when the service ends."""
    selector, _, here, there, streaming = followed
    streaming.append(True)
    selector.forget()
    there.send(b"shutdown")
    assert here.fileno() in [key.fd for key, _ in selector.select(1.0)]


def test_while_nobody_watches_several_ticks_are_one_event(followed, resting):
    """The timer wakes nobody before REST_S, and none of its expirations is lost."""
    selector, timer, _, _, _ = followed
    resting.append(True)
    expirations(timer)
    began = time.monotonic()
    assert [key.fd for key, _ in selector.select(1.0)] == [timer]
    assert time.monotonic() - began >= REST_S - 0.001  # epoll rounds to milliseconds
    assert expirations(timer) >= 2
    assert selector.get_key(timer).events == 1


def test_whoever_connects_in_a_rest_finds_the_ticks_done(followed, resting):
    """An event ends the rest at once, and the timer's own event comes before it."""
    selector, timer, here, there, _ = followed
    resting.append(True)
    expirations(timer)
    time.sleep(1.2 * TICK_S)
    there.send(b"hello")
    began = time.monotonic()
    assert [key.fd for key, _ in selector.select(1.0)] == [timer, here.fileno()]
    assert time.monotonic() - began < REST_S


def test_a_timeout_that_ends_before_the_rest_is_kept(followed, resting):
    """What the loop itself has planned happens in time."""
    selector, timer, _, _, _ = followed
    resting.append(True)
    expirations(timer)
    began = time.monotonic()
    selector.select(0.01)
    assert 0.01 <= time.monotonic() - began < REST_S
