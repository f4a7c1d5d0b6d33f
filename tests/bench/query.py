"""How long a question to a plant takes: `python -m tests.bench.query`. A thousand arms, a year of daily replays, PostgreSQL.

Friction is random: what is asked for costs the same. Quoted are seconds by the clock, and which months PostgreSQL has read.
"""

import argparse
import tempfile
import time
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import dialect

from monitor.plant.database import Database
from monitor.plant.tables import FIGURES, LIFE_FIGURES
from monitor.recording import DAY_S
from monitor.studies.query import PlantSource, ask
from tests.plant.postgres_server import Postgres, binaries

BEGIN_UNIX_S = 1_767_225_600.0  # 2026-01-01
QUESTIONS = (
    "SELECT count(*), max(wear) FROM friction",
    "SELECT robot, joint, max(wear) - min(wear) AS rise FROM friction GROUP BY ALL ORDER BY rise DESC LIMIT 3",
    "SELECT robot, joint, max(wear) FROM friction WHERE recorded_at >= '2026-12-01' GROUP BY ALL ORDER BY 3 DESC LIMIT 3",
    "SELECT recorded_at, wear FROM friction WHERE robot = 'arm-0500' AND joint = 3 ORDER BY recorded_at",
    "SELECT * FROM friction ORDER BY wear DESC LIMIT 3",
)


def fill(database: Database, arms: int, days: int) -> None:
    """The rows of the arms, made by the server itself."""
    database.migrate()
    database.make_partitions("friction", (BEGIN_UNIX_S + day * DAY_S for day in range(days)))
    names = ", ".join((*FIGURES, *LIFE_FIGURES))
    figures = ", ".join(["random()"] * len((*FIGURES, *LIFE_FIGURES)))
    with database.write() as connection:
        connection.execute(
            sa.text(
                "INSERT INTO arm (site, robot, first_seen, history) "
                "SELECT 'site-' || a % 10, 'arm-' || to_char(a, 'FM0000'), now(), 1 FROM generate_series(1, :arms) a"
            ),
            {"arms": arms},
        )
        connection.execute(
            sa.text(
                f"INSERT INTO friction (arm, history, joint, recorded_at, replay, {names}) "
                f"SELECT a, 1, j, to_timestamp(:begin) + d * interval '1 day', d + 1, {figures} "
                "FROM generate_series(0, :days - 1) d, generate_series(1, :arms) a, generate_series(1, 6) j"
            ),
            {"arms": arms, "days": days, "begin": BEGIN_UNIX_S},
        )
    with database.write() as connection:
        connection.execute(sa.text("ANALYZE friction"))


def main() -> None:
    """Fill a server of its own, and ask it."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.query", description=__doc__)
    parser.add_argument("--arms", type=int, default=1000)
    parser.add_argument("--days", type=int, default=365)
    given = parser.parse_args()
    place = binaries()
    assert place is not None, "PostgreSQL is not installed"
    with tempfile.TemporaryDirectory(prefix="joint-monitor-query-bench-") as folder:
        Path(folder).chmod(0o755)
        server = Postgres(place, Path(folder), shared_buffers="128MB")
        try:
            database = Database(server.address())
            began = time.perf_counter()
            fill(database, given.arms, given.days)
            print(f"{given.arms * given.days * 6} rows of friction, filled in {time.perf_counter() - began:.0f} s")
            for sql in QUESTIONS:
                began = time.perf_counter()
                found = ask(sql, [PlantSource(database)], 10)
                print(f"{time.perf_counter() - began:7.2f} s  {len(found.rows)} rows  {sql}", flush=True)
            began = time.perf_counter()
            source = PlantSource(database, BEGIN_UNIX_S + 334 * DAY_S)
            ask(QUESTIONS[1], [source], 10)
            print(f"{time.perf_counter() - began:7.2f} s  the same of December alone, by --from; PostgreSQL reads:")
            asked = source.friction(("robot", "joint", "wear")).compile(dialect=dialect(), compile_kwargs={"literal_binds": True})
            with database.read() as connection:
                plan = connection.execute(sa.text(f"EXPLAIN {asked}".replace(":", r"\:"))).scalars()
                print("\n".join(f"           {line.strip()}" for line in plan if "Scan" in line))
            database.close()
        finally:
            server.process.kill()
            server.process.wait()


if __name__ == "__main__":
    main()
