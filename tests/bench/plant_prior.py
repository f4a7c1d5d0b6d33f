"""How long a plant's priors take, and what of an arm's rows it holds: `python -m tests.bench.plant_prior`. SQLite, in a folder of its own.

One arm lives for so many days; the others have its belief under their own names. Quoted are seconds by the clock, and bytes a row.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import sqlalchemy as sa

from monitor.judge.settings import AssessSettings
from monitor.plant.database import Database
from monitor.plant.tables import arm, history, stored
from monitor.store.store import Store
from monitor.studies.fleet_prior import priors_of_plant

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "views"), str(ROOT / "plant"), str(ROOT)]  # as pytest has them

from lived_monitor import identified, live_through  # noqa: E402
from simulated import copy  # noqa: E402


def main() -> None:
    """Make the plant, and its priors."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.plant_prior", description=__doc__)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--days", type=int, default=60)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="joint-monitor-prior-bench-") as folder:
        with Store.open(Path(folder) / "arms/north/press") as store:
            live_through(store, AssessSettings(), *identified(), given.days)
        path = Path(folder) / "plant.sqlite"
        database = Database(path)
        database.migrate()
        copy(database, Path(folder) / "arms", ["north/press"])
        with database.write() as connection:
            sizes = sa.select(stored.c.of_table, sa.func.count(), sa.func.avg(sa.func.length(stored.c.content))).group_by(stored.c.of_table)
            for table, count, mean in connection.execute(sizes):
                print(f"{table:<12} {count:5d} rows of {mean:9.0f} bytes")
            one = connection.execute(sa.select(stored).where(stored.c.of_table == "state")).one()._asdict()
            of = connection.execute(sa.select(history)).one()._asdict()
            for number in range(2, given.arms + 1):
                about = {"id": number, "site": f"site-{number % 5}", "robot": f"arm-{number}", "first_seen": 0.0, "history": 1}
                connection.execute(arm.insert().values(**about))
                connection.execute(history.insert().values(**of | {"arm": number}))
                connection.execute(stored.insert().values(**one | {"arm": number}))
        database.close()
        began = time.perf_counter()
        found = priors_of_plant(path)
        took = time.perf_counter() - began
        print(f"{given.arms} arms: {len(found)} priors in {took:.1f} s, {1e3 * took / given.arms:.0f} ms an arm")


if __name__ == "__main__":
    main()
