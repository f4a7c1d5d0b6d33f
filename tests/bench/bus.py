"""How fast the bus answers beside an empty queryable: `python -m tests.bench.bus [--rounds 2000] [--seconds 2]`.

One process answers, as the daemon does: its own bus with the real model on one endpoint, and an empty queryable, which replies nothing
from its callback, on another. Other processes ask both in turn, with the same question, so that a noisy machine is noisy for both.
"""

import argparse
import json
import multiprocessing as mp
import statistics
import tempfile
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from monitor.publish.session import prefix, session_config

DAEMON, EMPTY = "tcp/127.0.88.1:7448", "tcp/127.0.88.2:7448"
PREFIX = prefix("lab", "cell-1")
CLIENTS = 4
WARM_UP = 300
Question = tuple[str, bytes]


def answer(asked: Connection) -> None:
    """The answering process: a daemon after one replay, and an empty queryable in a session of its own."""
    from monitor.config.load import from_document
    from monitor.service.daemon import Daemon
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay
    from monitor.store.store import Store

    def play(excitation: Any, context: Any, *_: Any) -> Any:
        recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(excitation, repetitions=1))
        return replace(recording, context=replace(context, firmware=recording.context.firmware))

    with tempfile.TemporaryDirectory() as folder:
        document = {
            "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
            "store": {"directory": str(Path(folder) / "history")},
            "bus": {"listen": [DAEMON]},
        }
        configuration = from_document(document, Path(folder) / "cell.toml")
        with (
            Store.open(Path(folder) / "history") as store,
            Daemon(configuration, store, now=lambda: 1.0e9, play=play) as daemon,
            zenoh.open(session_config(mode="peer", listen=(EMPTY,), wait_for_peer=False)) as session,
        ):
            row = daemon.monitor.perform(1.0e9)
            assert row is not None
            assert row.state == "assessed", row

            def reply_nothing(query: zenoh.Query) -> None:
                with query:
                    query.reply(query.key_expr, b"")

            session.declare_queryable(f"{PREFIX}/**", reply_nothing)
            asked.send("up")
            asked.recv()


def one(session: zenoh.Session, question: Question) -> float:
    """One query until its last reply [s]."""
    key, payload = question
    began = time.perf_counter()
    replies = list(session.get(key, payload=payload, timeout=10.0))
    took = time.perf_counter() - began
    assert len(replies) == 1
    assert replies[0].ok is not None, replies[0].err.payload.to_bytes()
    return took


def connected(endpoint: str) -> zenoh.Session:
    """A client of one endpoint."""
    return zenoh.open(session_config(mode="client", connect=(endpoint,)))


def alternate(question: Question, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Daemon and empty queryable in turn, in blocks of ten; (rounds,) of seconds each."""
    with connected(DAEMON) as daemon, connected(EMPTY) as empty:
        for session in (daemon, empty):
            for _ in range(WARM_UP if rounds > WARM_UP else 5):
                one(session, question)
        times: tuple[list[float], list[float]] = ([], [])
        for n in range(rounds):
            for session, taken in ((daemon, times[0]), (empty, times[1]))[:: 1 if n % 2 else -1]:
                taken.append(one(session, question))
        return np.array(times[0]), np.array(times[1])


def keep_asking(endpoints: tuple[str, ...], question: Question, seconds: float, connection: Connection) -> None:
    """A client process: on request it queries an endpoint for the given time, and sends the rate."""
    sessions = [connected(endpoint) for endpoint in endpoints]
    for session in sessions:
        one(session, question)
    connection.send("up")
    while (which := connection.recv()) is not None:
        end, count = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            one(sessions[which], question)
            count += 1
        connection.send(count / seconds)
    for session in sessions:
        session.close()


def rates(question: Question, seconds: float, rounds: int = 6) -> list[list[float]]:
    """Queries a second of all clients together, daemon and empty queryable in turn."""
    clients = []
    for _ in range(CLIENTS):
        ours, theirs = mp.Pipe()
        process = mp.Process(target=keep_asking, args=((DAEMON, EMPTY), question, seconds, theirs))
        process.start()
        clients.append((process, ours))
    for _, ours in clients:
        ours.recv()
    found: list[list[float]] = [[], []]
    for n in range(rounds):
        for which in (0, 1) if n % 2 else (1, 0):
            for _, ours in clients:
                ours.send(which)
            found[which].append(sum(ours.recv() for _, ours in clients))
    for process, ours in clients:
        ours.send(None)
        process.join()
    return found


def questions(samples: int | None) -> Question:
    """A `torque` question: one sample, or so many rows."""
    draw = np.random.default_rng(1)
    shape: tuple[int, ...] = (6,) if samples is None else (samples, 6)
    q, qd, qdd = (draw.uniform(-span, span, shape).round(6).tolist() for span in (3.0, 1.5, 5.0))
    document = {"q": q, "qd": qd, "qdd": qdd, "temperature_c": np.full(shape, 30.0).tolist()}
    return f"{PREFIX}/torque", json.dumps(document).encode()


def main() -> None:
    """The figures of the bus."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.bus", description=__doc__)
    parser.add_argument("--rounds", type=int, default=2000, help="single questions to each")
    parser.add_argument("--seconds", type=float, default=2.0, help="of a round with four clients")
    arguments = parser.parse_args()
    mp.set_start_method("spawn")
    ours, theirs = mp.Pipe()
    server = mp.Process(target=answer, args=(theirs,))
    server.start()
    ours.recv()
    try:
        torque, empty = alternate(questions(None), arguments.rounds)
        for name, share, asked in (("p50", 50, 1.5), ("p99", 99, 2.0)):
            a, b = (1000.0 * float(np.percentile(times, share)) for times in (torque, empty))
            print(
                f"one sample, {name}: torque {a:.3f} ms, empty queryable {b:.3f} ms, ratio {a / b:.2f} (at most {asked} is asked)",
                flush=True,
            )
        batch, nothing = alternate(questions(1000), 40)
        a, b = (1000.0 * float(np.median(times)) for times in (batch, nothing))
        print(f"1000 samples as JSON, p50: torque {a:.1f} ms, empty queryable {b:.1f} ms (at most 40 ms is asked)", flush=True)
        by_torque, by_empty = (statistics.median(found) for found in rates(questions(None), arguments.seconds))
        print(
            f"{CLIENTS} clients at once: torque {by_torque:.0f}/s, empty queryable {by_empty:.0f}/s, share {by_torque / by_empty:.2f} "
            "(3000/s or 0.60 is asked)"
        )
    finally:
        ours.send(None)
        server.join(timeout=20)
        server.kill()


if __name__ == "__main__":
    main()
