"""How large a plant may be: `python -m tests.bench.plant`, or some of its parts by name; `--full` for 1000 arms and five years.

paint    the screen of 1000 arms in a real Chromium, until it shows something and until it shows the worst arms
history  the five years of one joint among those of all arms, in PostgreSQL. Without `--full` 40 arms instead of 1000 have them: the same
         61 partitions are asked in the same way, which is printed, in an eighth of a minute instead of two
load     a plant that follows simulated arms behind three routers: its share of a core and its memory; then it is killed and away for a
         week, then its database is dropped. Without `--full` 100 arms

Each goal is a line with ✓ or ✗; one that is missed ends it with 1. With `--full`, on a quiet machine of two cores: eight minutes.
"""

import argparse
import os
import queue
import random
import re
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("", "views", "plant")]  # the tests import each other by their names

import psycopg
import sqlalchemy as sa
from browser_sizes import SIZES
from plant_screen import ALERT, PlantOfATest, documents
from postgres_server import Postgres, binaries

from monitor.plant.arm import ArmName
from monitor.plant.database import Database
from monitor.plant.screen.arm_page import ArmContent
from monitor.plant.tables import friction

ROUNDS, ASKED, DAYS, DAY_S = 9, 150, 5 * 365, 86_400.0
LIVED, AWAY = 40, 7  # days of the arms before the plant comes, and without it
PAINT_MS, COURSE_MS, STEADY_SHARE, AWAY_S = 300.0, 100.0, 50.0, 600.0  # what is asked; the share [% of a core] is ours: half of one
missed: list[str] = []
BEGIN_UNIX_S = 1_700_000_000.0
PORTS = (17_451, 17_452, 17_453)
SERVER = {"shared_buffers": "512MB", "max_wal_size": "4GB"}


def paint(full: bool) -> None:
    """The first look, with an empty cache; 1000 arms also without --full, as they cost no more."""
    from playwright.sync_api import sync_playwright

    for alerts in (200, 5000) if full else (200,):
        arms = {(f"hall-{k % 5 + 1}", f"cell-{k:04d}"): documents(model="ur5e" if k % 2 else "ur10e") for k in range(1000)}
        for k, name in enumerate(list(arms)[:: 1000 // min(alerts, 1000)]):
            several = [{**ALERT, "joint": j % 6 + 1, "condition": f"{ALERT['condition']}"} for j in range(max(alerts // 1000, 1))]
            arms[name] = documents("MAINTENANCE_REQUIRED" if k % 3 else "FAILURE", alerts=several)
        with tempfile.TemporaryDirectory() as folder, PlantOfATest(Path(folder), arms=arms) as plant, sync_playwright() as playwright:
            found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
            browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
            shown: dict[str, list[float]] = {"first paint": [], "the worst arms": [], "all rows": []}
            for _ in range(ROUNDS):
                context = browser.new_context(viewport=SIZES["desktop"])
                context.add_init_script(WATCH)
                page = context.new_page()
                page.goto(plant.url)
                page.wait_for_function("window.seen && window.seen.all && performance.getEntriesByType('paint').length > 1")
                first = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
                for name, value in zip(shown, page.evaluate(f"[{first}, window.seen.some, window.seen.all]"), strict=True):
                    shown[name].append(value)
                context.close()
            browser.close()
        _say(f"paint of 1000 arms with {alerts} alerts")
        for name, times in shown.items():
            print(f"  {name:<16} median {statistics.median(times):6.0f} ms, slowest {max(times):6.0f} ms")
        first_ms = statistics.median(shown["first paint"])
        _goal(f"first paint of 1000 arms, {alerts} alerts", first_ms, PAINT_MS, "ms")


WATCH = """
new MutationObserver(() => {
  const rows = document.querySelectorAll('#arms tbody tr').length, at = performance.now();
  window.seen = window.seen || {};
  if (rows && !window.seen.some) requestAnimationFrame(() => { window.seen.some = window.seen.some || performance.now(); });
  if (rows === 1000) window.seen.all = window.seen.all || at;
}).observe(document, { childList: true, subtree: true });
"""


def history(full: bool) -> None:
    """Rows as five years of a replay a day leave them: one of an arm, then those of all others."""
    arms = 1000 if full else 40
    with _postgres() as server:
        address = server.address()
        with closing(Database(address)) as database, psycopg.connect(address.replace("+psycopg", ""), autocommit=True) as connection:
            began = time.monotonic()
            database.migrate()
            database.make_partitions("friction", [BEGIN_UNIX_S + day * DAY_S for day in range(DAYS)])
            connection.execute("INSERT INTO arm (id, site, robot, first_seen, history) SELECT a, 'hall', 'cell-' || a, now(), 1 "
                               "FROM generate_series(1, %s) a", (arms,))  # fmt: skip
            _fill(address, arms)
            connection.execute("VACUUM (ANALYZE, PARALLEL 0) friction")
            ((count,),) = connection.execute("SELECT count(*) FROM friction").fetchall()
            _say(f"history: {count} rows of {arms} arms, made in {time.monotonic() - began:.0f} s")
            for what, ask in (("course of one joint", _course), ("page of one arm, 6 joints", _page)):
                rng, times = random.Random(1), []
                for _ in range(ASKED):
                    at = time.perf_counter()
                    ask(database, rng.randint(1, arms), rng.randint(1, 6))
                    times.append(1e3 * (time.perf_counter() - at))
                times.sort()
                median, p95 = statistics.median(times), times[int(0.95 * ASKED)]
                print(f"  {what:<26} median {median:6.1f} ms, p95 {p95:6.1f} ms, slowest {times[-1]:6.1f} ms")
                if ask is _course:
                    _goal(f"course of one joint over five years among {count} rows, p95", p95, COURSE_MS, "ms")
            plan = "\n".join(line for (line,) in connection.execute(f"EXPLAIN (ANALYZE, BUFFERS) {COURSE}").fetchall())
            scans = len(re.findall(r"Index Only Scan using friction_\d{4}_\d\d_pkey", plan))
            pages = re.search(r"Buffers: shared ([^\n]*)", plan)
            print(f"  the server: {scans} scans of an index alone; {pages[1] if pages else '?'}; {plan.splitlines()[-1].strip()}")


COURSE = "SELECT recorded_at, reference_torque_nm, wear FROM friction WHERE arm = 7 AND history = 1 AND joint = 3 ORDER BY recorded_at"
ROWS = """INSERT INTO friction (arm, history, joint, recorded_at, replay, coulomb_nm, viscous_nm_s_per_rad, temperature_c,
  reference_speed_rad_s, reference_temperature_c, reference_torque_nm, reference_torque_std_nm, wear, wear_std, wear_rate_per_day,
  wear_rate_std_per_day)
SELECT a, 1, j, to_timestamp(%s + d * 86400 + a), d + 1, 3.1, 2.2, 30.5, 0.4, 25, 4.0 + random(), 0.05, 0.01, 0.02, 0.0001, 0.0002
FROM generate_series(%s::int, %s::int) d, generate_series(1, %s) a, generate_series(1, 6) j"""


def _fill(address: str, arms: int) -> None:
    """The rows of five years, by a connection for each core: days in parts, so that each fills a month's index at once."""
    days = queue.SimpleQueue[int]()
    for day in range(0, DAYS, 30):
        days.put(day)

    def production() -> None:
        with psycopg.connect(address.replace("+psycopg", ""), autocommit=True) as connection, suppress(queue.Empty):
            connection.execute("SET synchronous_commit = off")
            while True:
                day = days.get_nowait()
                connection.execute(ROWS, (BEGIN_UNIX_S, day, min(day + 29, DAYS - 1), arms))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for each in [pool.submit(production) for _ in range(os.cpu_count() or 1)]:
            each.result()


def _course(database: Database, arm: int, joint: int) -> None:
    own = (friction.c.arm == arm, friction.c.history == 1, friction.c.joint == joint)
    shown = (friction.c.recorded_at, friction.c.reference_torque_nm, friction.c.wear)
    with database.read() as connection:
        assert len(connection.execute(sa.select(*shown).where(*own).order_by(friction.c.recorded_at)).all()) == DAYS


def _page(database: Database, arm: int, _: int) -> None:
    content = ArmContent(ArmName("hall", f"cell-{arm}"), database, lambda _: [], lambda *_: None, "en")
    assert content.history()["replays"] == DAYS


def load(full: bool, arms: int | None = None) -> None:
    """Simulated arms in one process with the routers, the plant in another one, PostgreSQL in its own; `arms` : instead of 1000 or 100."""
    arms, seconds = arms or (1000 if full else 100), 40.0 if full else 20.0
    routers = [f"tcp/127.0.0.1:{port}" for port in PORTS]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with _postgres() as server, tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        address = server.address()
        config = Path(folder) / "plant.toml"
        config.write_text(f'[plant]\nconnect = {routers}\ndatabase = "{address}"\n'.replace("'", '"'))
        words = [sys.executable, "-m", "tests.bench.plant_arms", str(arms), str(LIVED), *routers]
        simulator = subprocess.Popen(words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        stack.callback(_end, simulator)

        def plant() -> "subprocess.Popen[bytes]":
            log = stack.enter_context((Path(folder) / "log").open("ab"))
            started = subprocess.Popen([sys.executable, "-m", "monitor", "plant", "--config", str(config)], env=environment, stderr=log)
            stack.callback(_end, started)
            return started

        def copied(running: "subprocess.Popen[bytes]", held: tuple[int, int]) -> float:
            """Wait until all that the arms hold is in the database; the time that it took."""
            began = time.monotonic()
            while _counts(address) != held:
                assert running.poll() is None, (Path(folder) / "log").read_text()
                assert time.monotonic() - began < AWAY_S + 300.0, (_counts(address), held, (Path(folder) / "log").read_text()[-3000:])
                time.sleep(0.5)
            return time.monotonic() - began

        held = _held(simulator)
        running = plant()
        took = copied(running, held)
        _say(f"load: {arms} arms behind 3 routers")
        print(f"  {held[0]} rows copied in {took:.1f} s, the start included: {held[0] / took:.0f} a second")
        time.sleep(15.0)  # what came meanwhile is followed
        pids = {"plant": [running.pid], "arms and routers": [simulator.pid], "PostgreSQL": _family(server.process.pid)}
        before, at = {name: _cpu_s(of) for name, of in pids.items()}, time.monotonic()
        time.sleep(seconds)
        lasted = time.monotonic() - at
        shares = {name: 100.0 * (_cpu_s(of) - before[name]) / lasted for name, of in pids.items()}
        for name, of in pids.items():
            print(f"  {name:<16} {shares[name]:5.1f} % of a core, {_pss_mb(of):6.0f} MB")
        _goal(f"following {arms} arms, plant and PostgreSQL together", shares["plant"] + shares["PostgreSQL"], STEADY_SHARE, "% of a core")

        running.kill()
        running.wait()
        assert simulator.stdin is not None
        simulator.stdin.write(f"{AWAY}\n")
        simulator.stdin.flush()
        held, rows = _held(simulator), held[0]
        running = plant()
        _goal(f"a week without the plant caught up, {held[0] - rows} rows", copied(running, held), AWAY_S, "s")
        _goal("transitions and rows that are lost, doubled or out of order", _wrong(server, address), 0, "")

        with psycopg.connect(address.rpartition("/")[0].replace("+psycopg", "") + "/postgres", autocommit=True) as connection:
            name = address.rpartition("/")[2]
            connection.execute(f"DROP DATABASE {name} WITH (FORCE)")  # type: ignore[arg-type]
            connection.execute(f"CREATE DATABASE {name}")  # type: ignore[arg-type]
        took = copied(running, held)
        _goal(f"the dropped database back from the arms, {held[0]} rows", took, AWAY_S, "s")
        _goal("transitions and rows of it that are lost, doubled or out of order", _wrong(server, address), 0, "")


def _held(simulator: "subprocess.Popen[str]") -> tuple[int, int]:
    """Rows of friction and transitions that the arms hold, as they say next."""
    assert simulator.stdout is not None
    replays, transitions = map(int, simulator.stdout.readline().split())
    return 6 * replays, transitions


def _counts(address: str) -> tuple[int, int]:
    """Rows of friction and transitions in the database; none where it is not there yet."""
    try:
        with psycopg.connect(address.replace("+psycopg", ""), autocommit=True) as connection:
            ((rows, transitions),) = connection.execute("SELECT (SELECT count(*) FROM friction), (SELECT count(*) FROM transition)")
            return int(rows), int(transitions)
    except (psycopg.errors.UndefinedTable, psycopg.OperationalError):
        return 0, 0


def _wrong(server: Postgres, address: str) -> int:
    """Transitions whose number does not follow the one before, replays that are not a row a joint, and histories that began anew."""
    step = "SELECT seq - lag(seq, 1, 0::bigint) OVER (PARTITION BY arm, history ORDER BY seq) AS step FROM transition"
    joints = "SELECT 1 FROM friction GROUP BY arm, history, replay HAVING count(*) <> 6 OR count(DISTINCT joint) <> 6"
    asked = (f"SELECT count(*) FROM ({step}) AS s WHERE step <> 1", f"SELECT count(*) FROM ({joints}) AS j")
    return sum(int(server.asked(address, each)) for each in (*asked, "SELECT count(*) FROM history WHERE number > 1"))


def _end(process: "subprocess.Popen[Any]") -> None:
    process.terminate()
    try:
        process.wait(timeout=60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _family(pid: int) -> list[int]:
    children = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False).stdout.split()
    return [pid, *map(int, children)]


def _cpu_s(pids: list[int]) -> float:
    found = 0.0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() if Path(f"/proc/{pid}").exists() else []
        found += sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    return found


def _pss_mb(pids: list[int]) -> float:
    texts = [Path(f"/proc/{pid}/smaps_rollup").read_text() for pid in pids if Path(f"/proc/{pid}").exists()]
    return sum(int(re.search(r"^Pss:\s+(\d+)", text, re.MULTILINE)[1]) for text in texts) / 1024.0  # type: ignore[index]


@contextmanager
def _postgres() -> Iterator[Postgres]:
    place = binaries()
    if place is None:
        sys.exit("PostgreSQL is not installed: apt-get install postgresql")
    folder = Path(tempfile.mkdtemp(prefix="joint-monitor-bench-"))
    folder.chmod(0o755)
    server = Postgres(place, folder, **SERVER)
    try:
        yield server
    finally:
        server.process.terminate()
        server.process.wait(timeout=60.0)
        shutil.rmtree(folder)


def _goal(what: str, value: float, most: float, unit: str) -> None:
    """One goal, and whether it is reached."""
    sign = "✓" if value <= most else "✗"
    print(f"{sign} {what}: {value:.4g} {unit} (at most {most:g})".replace("  ", " "), flush=True)
    if value > most:
        missed.append(what)


def _say(what: str) -> None:
    one, five, _ = os.getloadavg()
    print(f"{what}   [load {one:.1f}, {five:.1f} in five minutes, {os.cpu_count()} cores]", flush=True)


PARTS: dict[str, Callable[..., None]] = {"paint": paint, "history": history, "load": load}


def main() -> None:
    """One part after the other."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.plant", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="default: all of them")
    parser.add_argument("--full", action="store_true", help="1000 arms and five years: eight minutes and 4 GB on the disk")
    parser.add_argument("--arms", type=int, help="of the part load: so many in place of 1000 or 100")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))  # and with it all that it has started
    for name in arguments.parts or PARTS:
        PARTS[name](arguments.full, *([arguments.arms] if name == "load" else []))
    if missed:
        sys.exit(f"missed: {'; '.join(missed)}")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0:.0f} MB at most in this process")


if __name__ == "__main__":
    main()
