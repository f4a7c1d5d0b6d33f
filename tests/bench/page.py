"""How long the page's data take with five years of history, four replays a day: `python -m tests.bench.page`."""

import http.client
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "views"))
from lived_monitor import grow, monitor

REPLAYS = 5 * 365 * 4
PATHS = ("/", "/static/page.js", "/static/uPlot.iife.min.js", "/api/about", "/api/history", "/api/schedule", "/api/monitor")


def main() -> None:
    """The first visit, with an empty cache, and later ones."""
    with (
        tempfile.TemporaryDirectory() as folder,
        monitor(folder, days=3, moving=False, before=lambda store: grow(store, REPLAYS)) as served,
    ):
        server = served[0]
        host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)

        parts: dict[str, list[float]] = {}

        def look() -> tuple[float, int]:
            began, size = time.perf_counter(), 0
            connection = http.client.HTTPConnection(host, int(port), timeout=10)
            for path in PATHS:
                at = time.perf_counter()
                connection.request("GET", path)
                size += len(connection.getresponse().read())
                parts.setdefault(path, []).append(1e3 * (time.perf_counter() - at))
            connection.close()
            return time.perf_counter() - began, size

        first, size = look()
        later = [look()[0] for _ in range(15)]
        print(f"{REPLAYS} replays of 6 joints; the whole page, {size / 1e3:.0f} kB, one request after the other")
        print(f"first look {1e3 * first:.0f} ms, later ones {1e3 * statistics.median(later):.0f} ms (asked: 300 ms)")
        for path, took in parts.items():
            print(f"  {path:<32} first {took[0]:5.1f} ms, later {statistics.median(took[1:]):5.1f} ms")


main()
