"""How long the streaming cycle sleeps, from arrival times alone: no clock, no process."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.acquire.ur.receive import LARGEST_MARGIN_SHARE, MARGIN_S, POLL_S, PacketTiming

TICK_S = 0.008


def played(timing, arrivals_s, timestamps_s, late_s, now_s):
    """A cycle on a simulated clock: (pace, polls for each packet, delays [s] from arrival to sight).

    `late_s` says how much longer each sleep lasts than asked for.
    """
    looks, delays = [], []
    for arrival_s, timestamp_s in zip(arrivals_s, timestamps_s, strict=True):
        count = 1
        while now_s < arrival_s:
            planned_s = timing.sleep_s(now_s, TICK_S)
            late = late_s()
            now_s += planned_s + late
            timing = timing.woke(late)
            count += 1
        timing = timing.arrived(timestamp_s, now_s)
        looks.append(count)
        delays.append(now_s - arrival_s)
    return timing, looks, delays


def packets(count, offset_s, jitter_s=0.0, seed=1):
    """Timestamps and arrival times of successive packets."""
    rng = random.Random(seed)
    timestamps = [5.0 + TICK_S * n for n in range(count)]
    return timestamps, [t + offset_s + rng.uniform(0.0, jitter_s) for t in timestamps]


def test_a_regular_stream_is_read_with_few_polls_and_no_later_than_by_constant_polling():
    """After a second it needs at most six polls for a packet, where polling takes more than twenty; no packet waits longer than a poll."""
    timestamps, arrivals = packets(500, offset_s=100.0)
    timing = PacketTiming(timestamp_s=timestamps[0] - TICK_S, offset_s=arrivals[0] - timestamps[0])
    _, looks, delays = played(timing, arrivals, timestamps, lambda: 0.0001, arrivals[0] - TICK_S)
    assert max(looks[125:]) <= 6
    assert max(delays) <= POLL_S + 0.0001
    assert TICK_S / POLL_S > 20


def test_packets_that_begin_to_come_earlier_are_read_in_time_again_after_a_few_ticks():
    """The phase of the stream changes by 3 ms: what was slept through is noticed, and the next wake-ups come earlier."""
    timestamps, arrivals = packets(200, offset_s=100.0)
    arrivals = [arrival - (0.003 if n >= 100 else 0.0) for n, arrival in enumerate(arrivals)]
    timing = PacketTiming(timestamp_s=timestamps[0] - TICK_S, offset_s=arrivals[0] - timestamps[0])
    _, _, delays = played(timing, arrivals, timestamps, lambda: 0.0001, arrivals[0] - TICK_S)
    assert max(delays[100:]) <= 0.003
    assert max(delays[110:]) <= POLL_S + 0.0001


def test_packets_that_begin_to_come_later_cause_more_polls_and_no_delay():
    """The estimate rises slowly: meanwhile the cycle wakes early and polls."""
    timestamps, arrivals = packets(2000, offset_s=100.0)
    arrivals = [arrival + (0.003 if n >= 100 else 0.0) for n, arrival in enumerate(arrivals)]
    timing = PacketTiming(timestamp_s=timestamps[0] - TICK_S, offset_s=arrivals[0] - timestamps[0])
    _, looks, delays = played(timing, arrivals, timestamps, lambda: 0.0001, arrivals[0] - TICK_S)
    assert max(delays) <= POLL_S + 0.0001
    assert max(looks[-125:]) <= 6


def test_a_machine_with_late_wake_ups_gets_earlier_ones():
    """Delays of 1 to 3 ms: the margin grows with them, and nearly every wake-up comes before the packet, none after the next one."""
    rng = random.Random(3)
    timestamps, arrivals = packets(1000, offset_s=100.0)
    timing = PacketTiming(timestamp_s=timestamps[0] - TICK_S, offset_s=arrivals[0] - timestamps[0])
    timing, _, delays = played(timing, arrivals, timestamps, lambda: rng.uniform(0.001, 0.003), arrivals[0] - TICK_S)
    assert timing.late_s > 0.0015
    # a sleep that began before the arrival ends at most a poll and a delay after it, as it would with polling alone
    assert max(delays[125:]) <= POLL_S + 0.003
    assert max(delays) < TICK_S


@given(
    now_s=st.floats(0.0, 1e6),
    due_s=st.floats(-1.0, 1.0),
    late_s=st.floats(0.0, 1.0),
    deviation_s=st.floats(0.0, 1.0),
    tick_s=st.sampled_from([0.002, 0.008, 0.04]),
)
def test_a_sleep_is_never_shorter_than_a_poll_nor_longer_than_8_ms_nor_past_the_margin(now_s, due_s, late_s, deviation_s, tick_s):
    """Whatever the estimates say; an overdue packet is looked for at every poll."""
    timing = PacketTiming(timestamp_s=now_s + due_s - tick_s, offset_s=0.0, late_s=late_s, late_deviation_s=deviation_s)
    slept_s = timing.sleep_s(now_s, tick_s)
    assert POLL_S <= slept_s <= 0.008
    if due_s <= MARGIN_S:
        assert slept_s == POLL_S
    else:
        assert slept_s <= max(due_s - min(MARGIN_S, LARGEST_MARGIN_SHARE * tick_s), POLL_S) + 1e-9  # rounding at 1e6 s


@pytest.mark.parametrize("step_s", [TICK_S, 2 * TICK_S])
def test_a_packet_that_was_left_out_does_not_move_the_estimate(step_s):
    """The offset belongs to the timestamp, not to the count of packets."""
    timing = PacketTiming(timestamp_s=5.0, offset_s=100.0).arrived(5.0 + step_s, 105.0 + step_s)
    assert timing.sleep_s(105.0 + step_s, TICK_S) == pytest.approx(TICK_S - MARGIN_S)
