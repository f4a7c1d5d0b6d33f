"""10 000 replays through the daemon, four a day for seven years: its memory does not grow, and the history grows evenly.

The service is real: ledger, recording written and read again, judge, commit, bus with a client of every document, model for
live torque, backups, retention. Only two things are fed in: the recording is a second of a simulated one under a new time, and what
`identify` would return comes from an arm made of laws and random numbers, since a fit of each takes half a second.
"""

import gc
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from synthetic_arm import CONTEXT, START_S
from synthetic_arm import Arm as Laws
from test_daemon_on_the_bus import settled

import monitor.judge.assess
from monitor.model.robot import load_robot
from monitor.publish.session import session_config
from monitor.recording import Recording
from monitor.service.daemon import Daemon
from monitor.store.store import Store

REPLAYS, APART_S = 10_000, 21_600.0
SPAN = 1000  # replays that are compared with each other
UPKEEP_EVERY = 250
MOST_GROWTH_MIB = 10.0  # of about 150; a leak of 1.2 kB a replay, 9000 times, is detected


def own_mib() -> float:
    """The private memory of this process. Pages of programs and libraries are shared among all processes: their part changes
    by tens of MiB when another Python starts or ends.
    """
    gc.collect()
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith(("Pss_Anon:", "Pss_Shmem:", "SwapPss:"))) / 1024


class Cell:
    """A clock that advances by six hours, and an arm that is recorded for a second."""

    def __init__(self) -> None:
        self.clock_unix_s = START_S
        self.rng = np.random.default_rng(9)
        self.gain_nm_per_a = load_robot("ur5").drive_gain_nm_per_a

    def now(self) -> float:
        return self.clock_unix_s

    def play(self, excitation, context, should_stop, window) -> Recording:
        t = np.arange(125) * 0.008
        q = self.rng.normal(size=(125, 6))
        return Recording(
            t_s=t, q=q, qd=q * 0.1, target_qd=q * 0.1, target_qdd=q * 0.01, current=q / self.gain_nm_per_a,
            temperature_c=np.full((125, 6), 30.0), context=replace(context, serial=CONTEXT.serial), quality={}, source="cell",
        )  # fmt: skip


@pytest.mark.soak
@pytest.mark.timeout(1500)
def test_ten_thousand_replays_do_not_grow_memory(tmp_path: Path, free_port: int, monkeypatch, soak_row):
    endpoint = f"tcp/127.0.0.1:{free_port}"
    laws, cell, received = Laws(seed=9), Cell(), [0]
    wear = np.zeros(6)

    def identified(recordings, *_, **__):
        day = (cell.clock_unix_s - START_S) / 86_400.0
        wear[1] = 0.3 * ((day / 600.0) % 1.0)  # it wears, alerts come, it is repaired, alerts clear
        return laws.replay(28.0 + 4.0 * np.sin(day) + 3.0 * np.sin(day / 58.0), wear)

    def count(_: zenoh.Sample) -> None:
        received[0] += 1

    monkeypatch.setattr(monitor.judge.assess, "identify", identified)
    memory, sizes, states = [], [], []
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(settled(tmp_path, endpoint), store, now=cell.now, play=cell.play) as daemon,
        zenoh.open(session_config(mode="client", connect=(endpoint,))) as session,
    ):
        session.declare_subscriber("joint-monitor/v1/**", count)
        began = time.monotonic()
        for n in range(REPLAYS):
            cell.clock_unix_s += APART_S
            row = daemon.monitor.perform(cell.clock_unix_s)
            assert row is not None
            assert row.state == "assessed", row.reason
            states.append(daemon.monitor.health_state)
            if n % UPKEEP_EVERY == UPKEEP_EVERY - 1:
                store.retention.prune(days=30.0, most_bytes=0.0, at_unix_s=cell.clock_unix_s)
                store.back_up(3)
                print(f"{n + 1} replays, {time.monotonic() - began:.0f} s, {own_mib():.1f} MiB", flush=True)
            if n % 50 == 49:
                memory.append(own_mib())
            if n % SPAN == SPAN - 1:
                sizes.append((tmp_path / "history" / "history.sqlite").stat().st_size)
        events = len(store.events.rows())
        recordings = len(list((tmp_path / "history" / "recordings").glob("*.parquet")))
        dropped = daemon.bus.dropped
    a_span = SPAN // 50
    early, late = float(np.median(memory[a_span : 2 * a_span])), float(np.median(memory[-a_span:]))
    a_replay = np.diff(sizes) / SPAN
    soak_row(f"{REPLAYS} replays: memory after 1000–2000 and at the end", f"{early:.1f} and {late:.1f} MiB", f"+{MOST_GROWTH_MIB:g} MiB")
    soak_row("history a replay, first and last thousand", f"{a_replay[0]:.0f} and {a_replay[-1]:.0f} B", "the same")
    soak_row("documents heard on the bus, dropped; transitions", f"{received[0]}, {dropped}; {events}", "0 dropped")
    assert late - early <= MOST_GROWTH_MIB
    assert a_replay[-1] <= 1.1 * a_replay[0]  # the number of transitions is random
    assert recordings <= 30 * 4 + UPKEEP_EVERY
    assert dropped == 0
    assert received[0] > 7 * REPLAYS  # six joints' friction and health at least
    assert len(set(states)) > 1  # there were verdicts to tell
