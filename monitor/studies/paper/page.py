"""The report of the reproduction as one self-contained HTML page."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from monitor import __version__
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign, CampaignSettings
from monitor.studies.paper.section import Check, Section
from monitor.views.report.html import Column, Markup, bullets, drawn, escaped, heading, page, paragraph, table

LONG_TABLE = 20  # rows; a longer table can be folded on a screen
# a check's outcome → class of the style sheet, word
_MARKS = {True: ("good", "holds"), False: ("bad", "DOES NOT HOLD"), None: ("dim", "must differ")}


def reproduction_page(
    found: Sequence[Campaign], by_robot: Mapping[str, Sequence[Section]], settings: CampaignSettings, took_s: float
) -> str:
    """The HTML page: verdict, errata, overview, and every section of each robot. by_robot : the sections of each campaign."""
    checks = [check for parts in by_robot.values() for part in parts for check in part.checks]
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
        kind, word = _MARKS[check.document["holds"]]
        rows.append([Markup(f'<span class="{kind}">{word}</span>'), check.what, check.paper, check.ours, check.why])
    return table(["", "statement", "paper", "ours", "why"], rows)
