"""What `reproduce` does: play the campaign of each robot, compare it with the paper, and write the report."""

import multiprocessing
import queue
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Protocol

from monitor import __version__
from monitor.errors import BadInput
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign, CampaignSettings, campaign
from monitor.studies.paper.page import reproduction_page
from monitor.studies.paper.sections import sections
from monitor.views.report.html import check_page

WORKERS = 2  # processes: the paper has two robots
POLL_S = 0.2  # how long the parent waits for progress before it checks whether the workers have ended
Show = Callable[[str, str, float], None]
"""Shows progress: the robot, what is done now, and the fraction of its campaign that is done."""


class ProgressQueue(Protocol):
    """What a worker needs of the queue by which it sends its progress to the parent."""

    def put(self, item: tuple[str, str, float], /) -> None:
        """Send robot, activity and fraction done."""


_progress: ProgressQueue | None = None  # set in a worker's own process


def reproduce(robots: Sequence[str], settings: CampaignSettings, show: Show, output: Path | None = None) -> dict[str, Any]:
    """Play the campaign of each robot and compare it with the paper. Returns the document; writes the report where `output` is given.

    Raises BadInput for a robot that the paper does not have, and where the report cannot be written.
    """
    for name in robots:
        if name not in paper.PRINTED:
            raise BadInput(f"--robot {name}: the paper has {' and '.join(paper.PRINTED)}")
    if output is not None:
        check_page(output)
    began = time.monotonic()
    found = _played(list(dict.fromkeys(robots)), settings, show)
    by_robot = {one.robot.name: list(sections(one)) for one in found}
    took_s = round(time.monotonic() - began, 1)
    document = {
        "paper": paper.TITLE,
        "version": __version__,
        "seed": settings.seed,
        "passed": all(check.document["holds"] is not False for parts in by_robot.values() for part in parts for check in part.checks),
        "robots": [{"robot": name, "sections": [part.as_document() for part in parts]} for name, parts in by_robot.items()],
        "took_s": took_s,
    }
    if output is not None:
        try:
            output.write_text(reproduction_page(found, by_robot, settings, took_s), encoding="utf-8")
        except OSError as wrong:
            raise BadInput(f"-o {output}: cannot be written: {wrong.strerror}") from None
    return document


def _played(robots: list[str], settings: CampaignSettings, show: Show) -> list[Campaign]:
    """The campaigns in processes of their own, WORKERS at a time; in this process where there is one robot only."""
    if len(robots) == 1:
        return [campaign(robots[0], settings, lambda text, share: show(robots[0], text, share))]
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager:
        progress = manager.Queue()
        with ProcessPoolExecutor(WORKERS, mp_context=context, initializer=_begin, initargs=(progress,)) as pool:
            futures = [pool.submit(_worker, name, settings) for name in robots]
            try:
                while not all(future.done() for future in futures):
                    try:
                        show(*progress.get(timeout=POLL_S))
                    except queue.Empty:
                        continue
            except BaseException:
                for process in list(getattr(pool, "_processes", {}).values()):
                    process.terminate()  # Ctrl-C would otherwise wait for minutes of simulation
                raise
            return [future.result() for future in futures]


def _begin(progress: ProgressQueue) -> None:
    """Give a worker the queue; the pool calls this once in each worker."""
    global _progress  # noqa: PLW0603 - the pool gives a worker no other place for it
    _progress = progress


def _worker(name: str, settings: CampaignSettings) -> Campaign:
    assert _progress is not None  # the pool has called _begin
    send = _progress.put
    return campaign(name, settings, lambda text, share: send((name, text, share)))
