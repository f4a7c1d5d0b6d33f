"""The command `reproduce`: the campaign of each robot compared with the paper, as a document and as one self-contained HTML page."""

import multiprocessing
import queue
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from monitor import __version__
from monitor.errors import BadInput
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign, CampaignSettings, campaign
from monitor.studies.paper.statements import Check, Section, sections
from monitor.views.report.html import Column, Markup, bullets, check_page, drawn, escaped, heading, page, paragraph, table

LONG_TABLE = 20  # rows; a longer table can be folded on a screen
_CLASSES = {"holds": "good", "missed": "warn", "DOES NOT HOLD": "bad"}  # a check's verdict → class of the style sheet; "dim" for others


def reproduction_page(
    found: Sequence[Campaign], by_robot: Mapping[str, Sequence[Section]], settings: CampaignSettings, took_s: float
) -> str:
    """The HTML page: verdict, errata, overview, and every section of each robot. by_robot : the sections of each campaign."""
    checks = [check for parts in by_robot.values() for part in parts for check in part.checks]
    failed = [check for check in checks if check.verdict == "DOES NOT HOLD"]
    must = sum(check.expected in {"agree", "alike"} and check.holds is not None for check in checks)
    near = [check for check in checks if check.expected == "near" and check.holds is not None]
    verdict = (
        f"All {must} statements that must agree hold."
        if not failed
        else f"{len(failed)} of {must} statements that must agree do not hold: {'; '.join(check.what for check in failed)}."
    )
    within = sum(check.holds is True for check in near)
    verdict += f" Of {len(near)} figures of the paper's own arms {within} are within the bound set before; each of the others says why."
    parts = [
        '<div class="box">',
        paragraph(verdict, "good" if not failed else "bad"),
        paragraph(
            "What must agree: structure, ranks, equations, signs, orders of magnitude. What need not: every figure that belongs to the "
            "paper's own two arms, because these are simulated. Such a figure is held within a factor of two, joint by joint. The arms' "
            "physics (concave, load-dependent friction with two thermal nodes a joint) shares no code with what identifies them."
        ),
        "</div>",
        heading("Errata of the paper that bear on the comparison", 3),
        bullets(paper.ERRATA),
        heading("At a glance", 3),
    ]
    parts.append(_overview(by_robot))
    for one in found:
        parts.append(heading(one.robot.name.upper(), new_page=True))
        for section in by_robot[one.robot.name]:
            parts += _section(one, section)
    at = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    subtitle = f"{paper.TITLE}; doi 10.3390/robotics10030083. joint-monitor {__version__}, seed {settings.seed}, {at}, {took_s:.0f} s"
    return page("The paper, on simulated arms", subtitle, parts)


def _overview(by_robot: Mapping[str, Sequence[Section]]) -> str:
    """A table of the paper's figures and tables: how many statements of each hold, by robot."""

    def cell(section: Section) -> Markup:
        holds = [check.document["holds"] for check in section.checks]
        comparable = len(holds) - holds.count(None)
        kind = "good" if not holds.count(False) else "bad"
        return Markup(f'<span class="{kind}">{holds.count(True)} of {comparable} hold</span>')

    titles = [section.title for section in next(iter(by_robot.values()))]
    rows = [
        [title.split(",")[0] if "Appendix" in title else title, *map(cell, of)]
        for title, *of in zip(titles, *by_robot.values(), strict=True)
    ]
    return table(["", *(name.upper() for name in by_robot)], rows)


def _section(found: Campaign, section: Section) -> list[str]:
    """Heading, checks, drawings and tables of one section."""
    parts = [heading(section.title, 3), paragraph(section.text), _checks(section.checks)]
    for draw, caption in section.drawings:
        parts.append(drawn(draw(found), caption))
    for title, rows in section.tables:
        columns: list[Column | str] = [rows.columns[0], *(Column(name, figures=name != "combination") for name in rows.columns[1:])]
        inner = table(columns, rows.rows)
        folding = f"<details open><summary>{escaped(title)}</summary>{inner}</details>"
        parts.append(folding if len(rows.rows) > LONG_TABLE else paragraph(title, "dim") + inner)
    return parts


def _checks(checks: Sequence[Check]) -> str:
    """A table with one row for each check."""
    rows = []
    for check in checks:
        kind = _CLASSES.get(check.verdict, "dim")
        rows.append([Markup(f'<span class="{kind}">{check.verdict}</span>'), check.what, check.paper, check.ours, check.why])
    return table(["", "statement", "paper", "ours", "why"], rows)


# --- What `reproduce` does: play the campaign of each robot, compare it with the paper, and write the report ---

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
    by_robot = {one.robot.name: sections(one) for one in found}
    took_s = round(time.monotonic() - began, 1)
    document = {
        "paper": paper.TITLE,
        "version": __version__,
        "seed": settings.seed,
        "passed": all(check.verdict != "DOES NOT HOLD" for parts in by_robot.values() for part in parts for check in part.checks),
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
