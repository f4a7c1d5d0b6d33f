"""Parts of one self-contained HTML page, laid out for printing on A4: black on white, no row broken by a page end, no network."""

import html
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from monitor.errors import BadInput
from monitor.views.plots.picture import lay_out

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# sizes are those of paper: the report is printed for the maintenance file
_STYLE = """
@page { size: A4; margin: 12mm 14mm 13mm; @bottom-right { content: counter(page) " / " counter(pages); font: 8pt sans-serif } }
* { box-sizing: border-box }
html { color-scheme: light; -webkit-print-color-adjust: exact; print-color-adjust: exact }
body { font: 9.5pt/1.35 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1a1d21; background: #fff; margin: 0 auto;
  max-width: 190mm; padding: 8mm 5mm }
h1 { font-size: 15pt; line-height: 1.2; margin: 0 0 .5mm; letter-spacing: -.01em }
h2 { font-size: 12pt; margin: 3mm 0 1mm; padding-bottom: 1mm; border-bottom: 1.5pt solid #1b4d7a; break-after: avoid }
h3 { font-size: 10pt; margin: 2.5mm 0 .5mm; break-after: avoid }
p { margin: .7mm 0 }
p:has(+ table) { break-after: avoid }
.sub { color: #555; margin-bottom: 2mm; font-size: 8.5pt }
table { border-collapse: collapse; margin: .5mm 0 1.5mm; font-size: 8.5pt; font-variant-numeric: tabular-nums; width: 100% }
thead { display: table-header-group }
th { text-align: left; font-weight: 600; border-bottom: 1pt solid #555; padding: .4mm 1.5mm; vertical-align: bottom }
td { border-bottom: .4pt solid #d5d9de; padding: .4mm 1.5mm; vertical-align: top }
tr { break-inside: avoid }
td:first-child { white-space: nowrap }
.n { text-align: right; white-space: nowrap }
th.n { white-space: normal }
figure { margin: 1.5mm 0 2mm; break-inside: avoid }
figure svg, figure img { width: 100%; height: auto; display: block }
figcaption { font-size: 8pt; color: #444; margin-top: .5mm }
.box { border: .6pt solid #c3cad2; border-left: 3pt solid #1b4d7a; padding: 1mm 3.5mm; margin: 1.5mm 0; background: #f6f8fa;
  break-inside: avoid }
.lead { font-size: 11pt } .small { font-size: 8.5pt } .fine { font-size: 7.5pt; color: #444; break-inside: avoid }
.fine ul { columns: 2; column-gap: 8mm; margin: .5mm 0 }
h4 { font-size: 7.5pt; margin: 1.5mm 0 0 } .fine p { margin: .3mm 0 } .fine li { break-inside: avoid }
.sign { margin-top: 7mm; break-inside: avoid } .sign td { border: 0; border-top: .6pt solid #555; width: 50% }
.good { color: #14682f } .bad { color: #a3161c; font-weight: 600 } .warn { color: #85510a } .dim { color: #666 }
.mark { display: inline-block; min-width: 24mm; font-weight: 600 }
.chip { display: inline-block; padding: 0 2mm; border-radius: 3mm; border: .6pt solid currentColor; font-size: 8pt;
  font-weight: 600; white-space: nowrap }
ul { margin: 1mm 0 3mm; padding-left: 6mm }
details summary { cursor: pointer; font-weight: 600 }
@media print { body { padding: 0; max-width: none } details { display: block } .newpage { break-before: page } a { color: inherit } }
"""


class Markup(str):
    """Text that is HTML and is not escaped again."""

    __slots__ = ()


class Column(NamedTuple):
    """The title of a column, and whether it holds figures, which are aligned to the right."""

    title: str
    figures: bool = True


def check_page(path: Path) -> None:
    """Check that a page can be written to `path`; a command calls this before it computes. Raises BadInput."""
    if path.suffix.lower() not in {".html", ".htm"}:
        raise BadInput(f"-o {path}: expected a name that ends in .html")
    if path.is_dir() or not path.parent.is_dir():
        raise BadInput(f"-o {path}: expected the name of a file in a folder that exists")


def escaped(value: object) -> str:
    """A value as escaped HTML; a dash for None."""
    if isinstance(value, Markup):
        return value
    return "–" if value is None else html.escape(str(value))


def page(title: str, subtitle: str, parts: Iterable[str], language: str = "en") -> str:
    """The whole HTML document; `parts` are HTML."""
    head = f"<title>{escaped(title)}</title>\n<style>{_STYLE}</style>"
    return (
        f'<!doctype html>\n<html lang="{language}"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width,initial-scale=1">\n'
        f'{head}</head>\n<body>\n<h1>{escaped(title)}</h1>\n<p class="sub">{escaped(subtitle)}</p>\n'
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def heading(text: str, level: int = 2, *, new_page: bool = False) -> str:
    """A heading; `new_page` begins a new sheet in print."""
    return f"<h{level}{' class=newpage' if new_page else ''}>{escaped(text)}</h{level}>"


def paragraph(text: object, kind: str = "") -> str:
    """One paragraph; `kind` is a class of the style sheet, e.g. warn."""
    return f'<p class="{kind}">{escaped(text)}</p>' if kind else f"<p>{escaped(text)}</p>"


def table(columns: Sequence[Column | str], rows: Iterable[Sequence[object]]) -> str:
    """A table. A column that is given as a bare title holds words."""
    titled = [column if isinstance(column, Column) else Column(column, figures=False) for column in columns]

    def cell(tag: str, column: Column, value: object) -> str:
        return f"<{tag}{' class=n' if column.figures else ''}>{escaped(value)}</{tag}>"

    head = "".join(cell("th", column, column.title) for column in titled)
    body = "".join("<tr>" + "".join(cell("td", *pair) for pair in zip(titled, row, strict=True)) + "</tr>\n" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table>"


def bullets(items: Iterable[object]) -> str:
    """A list of items."""
    return "<ul>" + "".join(f"<li>{escaped(item)}</li>" for item in items) + "</ul>"


def drawn(figure: "Figure", caption: str) -> str:
    """A figure with its caption as SVG. The same figure gives the same bytes."""
    from matplotlib import rc_context

    drawing = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "joint-monitor", "font.family": "sans-serif"}):
        lay_out(figure)
        figure.savefig(drawing, format="svg", metadata={"Date": None})
    picture = drawing.getvalue()
    return f"<figure>{picture[picture.index('<svg') :]}<figcaption>{escaped(caption)}</figcaption></figure>"
