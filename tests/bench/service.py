"""What a service that lasts costs: `python -m tests.bench.service`.

Five years of four replays a day in the store: how soon it is open, how soon a joint's history is answered. And a daemon that only listens,
to a simulated arm, and says live torque ten times a second: its share of a core and its memory, children included. At an ordinary
priority, or a raised one by `nice`: in real time (`chrt`) the kernel lets no sleep last longer, and listening costs half as much again.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import orjson
import zenoh

from monitor.config.load import load
from monitor.publish.session import session_config
from monitor.publish.timestamps import rfc3339
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording
from monitor.store.store import Store
from tests.bench.idle import core_s, family, pss_mib

YEARS, A_DAY, JOINTS = 5, 4, 6
LISTEN_S = 20.0
ADDRESS = "127.0.89.91"
JOINT = {
    "joint": 1, "coulomb_nm": 9.241234567, "coulomb_std_nm": 0.4612345, "viscous_nm_s_per_rad": 9.1112345,
    "viscous_std_nm_s_per_rad": 0.46123,
    "temperature_c": 31.21, "reference_speed_rad_s": 0.4, "reference_temperature_c": 30.1, "reference_torque_nm": 12.1234567,
    "reference_torque_std_nm": 0.1234567, "replay_torque_nm": 12.2234567, "replay_torque_std_nm": 0.1234567,
    "wear": 0.0123456789, "wear_std": 0.00123456, "wear_rate_per_day": 1.234e-5,
    "wear_rate_std_per_day": 1.2e-6,
    "remaining_life": {"trend_probability": 0.97, "p10_days": 100.0, "p50_days": 200.0, "p90_days": None, "verdict": "trend"},
}  # fmt: skip


def five_years(folder: Path) -> None:
    """Documents of the size that real ones have; where there is a state already, it stays, and the daemon can start on it."""
    began = time.time() - YEARS * 365 * 86_400.0
    with Store.open(folder) as store:
        store.database.connection.execute("PRAGMA synchronous = OFF")
        state = store.assessments.state()
        held = (state.belief, state.health, state.model) if state else ({"text": "y" * 50_000}, {}, {})
        for n in range(YEARS * 365 * A_DAY):
            at = began + n * 86_400.0 / A_DAY
            ledger_id = store.ledger.claim(at, "scheduled", at)
            assert ledger_id is not None
            store.ledger.mark_recorded(ledger_id)
            store.assessments.commit(
                ledger_id, at_unix_s=at, recorded_at_unix_s=at, assessment={"text": "x" * 8000}, friction=[JOINT] * JOINTS,
                belief=held[0], health=held[1], model=held[2], events=[],
            )  # fmt: skip


def timed(title: str, what: Callable[[], object], rounds: int = 15) -> None:
    taken, used = [], []
    for _ in range(rounds):
        began, cpu = time.perf_counter(), time.process_time()
        what()
        taken.append(1000 * (time.perf_counter() - began))
        used.append(1000 * (time.process_time() - cpu))
    print(f"{title:<64} median {statistics.median(taken):7.1f} ms, {min(used):6.1f} ms of a core")


def history(folder: Path) -> None:
    five_years(folder)

    def opened() -> None:
        with Store.open(folder) as store:
            store.ledger.repair(0.0)
            store.assessments.friction(limit=JOINTS)

    def answered() -> None:
        rows, _ = store.assessments.history(joint=3, limit=10_000)
        for row in rows:
            row["recorded_at"] = rfc3339(row.pop("recorded_at_unix_s"))

    size = (folder / "history.sqlite").stat().st_size / 1e6
    timed(f"open {YEARS} years, {A_DAY} a day, {JOINTS} joints ({size:.0f} MB): check, repair, newest", opened, 5)
    with Store.open(folder) as store:
        timed(f"history of one joint, {YEARS} years ({YEARS * 365 * A_DAY} rows)", answered)
        timed("backup, checked", lambda: store.back_up(3), 3)


def share_and_memory(process: "subprocess.Popen[str]", seconds: float) -> tuple[float, float]:
    """[% of a core] and proportional memory [MiB], children included."""
    before, began = core_s(process.pid), time.monotonic()
    time.sleep(seconds)
    share = 100 * (core_s(process.pid) - before) / (time.monotonic() - began)
    return share, pss_mib(process.pid)


def asked(endpoint: str) -> None:
    """What a client waits for five years of one joint, over the bus, from the running daemon."""
    with zenoh.open(session_config(mode="client", connect=(endpoint,))) as session:

        def answered() -> None:
            (reply,) = session.get("joint-monitor/v1/bench/ur5/history?joint=3;limit=10000", timeout=10.0)
            rows = orjson.loads(reply.ok.payload.to_bytes())["rows"]
            assert len(rows) >= YEARS * 365 * A_DAY, len(rows)

        timed(f"  history of one joint, {YEARS} years, over the bus and read", answered)


def idle(folder: Path, listen_hz: float, *, old: bool = False) -> None:
    config = folder / "cell.toml"
    config.write_text(
        f'[robot]\nmodel = "ur5"\nsite = "bench"\nid = "ur5"\nhost = "{ADDRESS}"\nlisten_hz = {listen_hz}\n'
        f'[bus]\nlisten = ["tcp/{ADDRESS}:7447"]\nlive_rate_hz = 10.0\n'
    )
    loaded = load(config)
    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(loaded.excitation, repetitions=1))
    write_recording(folder / "one.parquet", replace(recording, context=replace(loaded.context, recorded_at_unix_s=time.time() - 3600)))
    command = [sys.executable, "-m", "monitor"]
    subprocess.run([*command, "import", "--config", str(config), str(folder / "one.parquet")], check=True, stdout=subprocess.DEVNULL)
    if old:
        five_years(loaded.state_directory)
    simulator = subprocess.Popen([*command, "simulate", "--bind", ADDRESS], stdout=subprocess.PIPE, text=True)
    daemon = None
    try:
        assert simulator.stdout is not None
        simulator.stdout.readline()
        began = time.monotonic()
        daemon = subprocess.Popen([*command, "run", "--config", str(config)], stderr=subprocess.PIPE, text=True)
        assert daemon.stderr is not None
        while "watching" not in daemon.stderr.readline():
            pass
        ready_s = time.monotonic() - began
        print(f"{'daemon ready after' + (f', {YEARS} years in its store' if old else ''):<64} {ready_s:.1f} s")
        if old:
            asked(f"tcp/{ADDRESS}:7447")
            return
        time.sleep(8.0)
        share, memory = share_and_memory(daemon, LISTEN_S)
        document = json.loads((loaded.state_directory / "monitor.json").read_text())
        about, figures = document["process"], f"{share:.1f} % of a core, {memory:.0f} MiB, its {len(family(daemon.pid)) - 1} child included"
        print(f"{f'daemon that listens at {listen_hz:g} Hz, live torque at 10 Hz':<64} {figures}")
        print(f"{'  as it says itself':<64} heard {document['arm']['heard']}, {about['threads']} threads, {document['bus']}")
    finally:
        for process in (daemon, simulator):
            if process is not None:
                process.terminate()
                process.communicate(timeout=20)


def main() -> None:
    """All of it, about two minutes."""
    with tempfile.TemporaryDirectory() as folder:
        history(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        idle(Path(folder), 10.0, old=True)
    for listen_hz in (10.0, 125.0):
        with tempfile.TemporaryDirectory() as folder:
            idle(Path(folder), listen_hz)


if __name__ == "__main__":
    main()
