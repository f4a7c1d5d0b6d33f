"""The paper's tables and figures on the simulated arms, each beside the paper's own numbers: what `reproduce` does."""

import multiprocessing
import queue
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.errors import BadInput
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign, CampaignSettings, campaign
from monitor.studies.paper.section import Check, Section
from monitor.studies.paper.sections import sections
from monitor.views.report.html import Column, Markup, bullets, check_page, drawn, escaped, heading, page, paragraph, table

WORKERS = 2
Show = Callable[[str, str, float], None]
"""Robot, what is being done, which share of its campaign is behind it."""
_told: Any = None  # in a worker: the queue by which it tells its progress


def reproduce(robots: Sequence[str], settings: CampaignSettings, show: Show, output: Path | None = None) -> dict[str, Any]:
    """Play the campaign of each robot, two at a time; the report's document, and the report where `output` is given.

    Raises BadInput for a robot that the paper does not have, or a name that cannot be written.
    """
    for name in robots:
        if name not in paper.PRINTED:
            raise BadInput(f"--robot {name}: the paper has {' and '.join(paper.PRINTED)}")
    if output is not None:
        check_page(output)
    began = time.monotonic()
    found = _played(list(dict.fromkeys(robots)), settings, show)
    told = {one.robot.name: list(sections(one)) for one in found}
    took_s = round(time.monotonic() - began, 1)
    document = {
        "paper": paper.TITLE,
        "version": __version__,
        "seed": settings.seed,
        "passed": all(check.document["holds"] is not False for parts in told.values() for part in parts for check in part.checks),
        "robots": [{"robot": name, "sections": [_plain(part) for part in parts]} for name, parts in told.items()],
        "took_s": took_s,
    }
    if output is not None:
        try:
            output.write_text(_page(found, told, settings, took_s), encoding="utf-8")
        except OSError as wrong:
            raise BadInput(f"-o {output}: cannot be written: {wrong.strerror}") from None
    return document


def _played(robots: list[str], settings: CampaignSettings, show: Show) -> list[Campaign]:
    """One process a robot, two at a time."""
    if len(robots) == 1:  # nothing to share
        return [campaign(robots[0], settings, lambda text, share: show(robots[0], text, share))]
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager:
        told = manager.Queue()
        with ProcessPoolExecutor(WORKERS, mp_context=context, initializer=_begin, initargs=(told,)) as pool:
            futures = [pool.submit(_worker, name, settings) for name in robots]
            try:
                while not all(future.done() for future in futures):
                    try:
                        show(*told.get(timeout=0.2))
                    except queue.Empty:
                        continue
            except BaseException:
                for process in list(getattr(pool, "_processes", {}).values()):
                    process.terminate()  # Ctrl-C must not wait for minutes of simulation
                raise
            return [future.result() for future in futures]


def _begin(told: Any) -> None:
    global _told  # noqa: PLW0603 - set once, in the worker's own process
    _told = told


def _worker(name: str, settings: CampaignSettings) -> Campaign:
    return campaign(name, settings, lambda text, share: _told.put((name, text, share)))


# --- what is told ------------------------------------------------------------------------------------


def _plain(section: Section) -> dict[str, Any]:
    return {
        "section": section.key,
        "title": section.title,
        "checks": [check.document for check in section.checks],
        "tables": [{"title": title, "columns": list(rows.columns), "rows": rows.rows} for title, rows in section.tables],
    }


_MARKS = {True: ("good", "holds"), False: ("bad", "DOES NOT HOLD"), None: ("dim", "must differ")}


def _page(found: Sequence[Campaign], told: dict[str, list[Section]], settings: CampaignSettings, took_s: float) -> str:
    checks = [check for parts in told.values() for part in parts for check in part.checks]
    holds = [check.document["holds"] for check in checks]
    held, failed = holds.count(True), [check for check, one in zip(checks, holds, strict=True) if one is False]
    verdict = (
        f"All {held} statements that must agree hold."
        if not failed
        else f"{len(failed)} of {held + len(failed)} statements that must agree do not hold: {'; '.join(check.what for check in failed)}."
    )
    parts = [
        '<div class="box">',
        paragraph(verdict, "good" if not failed else "bad"),
        paragraph(
            "What must agree: structure, ranks, equations, signs, orders of magnitude. What must differ: every figure that belongs to the "
            "paper's own two arms, because these are simulated; their physics (concave, load-dependent friction with two thermal nodes a "
            "joint) shares no code with what identifies them."
        ),
        "</div>",
        heading("Errata of the paper that bear on the comparison", 3),
        bullets(paper.ERRATA),
        heading("At a glance", 3),
    ]
    parts.append(_overview(told))
    for one in found:
        parts.append(heading(one.robot.name.upper(), new_page=True))
        for section in told[one.robot.name]:
            parts += _section(one, section)
    at = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    subtitle = f"{paper.TITLE}; doi 10.3390/robotics10030083. joint-monitor {__version__}, seed {settings.seed}, {at}, {took_s:.0f} s"
    return page("The paper, on simulated arms", subtitle, parts)


def _overview(told: dict[str, list[Section]]) -> str:
    """Which of the paper's figures and tables hold, by robot."""

    def cell(section: Section) -> Markup:
        holds = [check.document["holds"] for check in section.checks]
        asked = len(holds) - holds.count(None)
        kind = "good" if not holds.count(False) else "bad"
        return Markup(f'<span class="{kind}">{holds.count(True)} of {asked} hold</span>')

    titles = [section.title for section in next(iter(told.values()))]
    rows = [
        [title.split(",")[0] if "Appendix" in title else title, *map(cell, of)] for title, *of in zip(titles, *told.values(), strict=True)
    ]
    return table(["", *(name.upper() for name in told)], rows)


def _section(found: Campaign, section: Section) -> list[str]:
    parts = [heading(section.title, 3), paragraph(section.text), _checks(section.checks)]
    for draw, caption in section.drawings:
        parts.append(drawn(draw(found), caption))
    for title, rows in section.tables:
        columns: list[Column | str] = [rows.columns[0], *(Column(name, figures=name != "combination") for name in rows.columns[1:])]
        long = len(rows.rows) > 20
        inner = table(columns, rows.rows)
        told = f"<details open><summary>{escaped(title)}</summary>{inner}</details>" if long else paragraph(title, "dim") + inner
        parts.append(told)
    return parts


def _checks(checks: Sequence[Check]) -> str:
    rows = []
    for check in checks:
        kind, word = _MARKS[check.document["holds"]]
        rows.append([Markup(f'<span class="{kind}">{word}</span>'), check.what, check.paper, check.ours, check.why])
    return table(["", "statement", "paper", "ours", "why"], rows)
