"""How a picture is written: as a PNG, or as SVG within one HTML file that needs no network."""

import html
import io
from pathlib import Path
from typing import TYPE_CHECKING

from monitor.errors import BadInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 110  # a figure 13 inches wide fills a screen of 1440 pixels


def check_target(path: Path) -> None:
    """Check that a picture can be written to `path`; a command calls this before it computes. Raises BadInput."""
    if path.suffix.lower() not in {".png", ".html"}:
        raise BadInput(f"--plot {path}: expected a name that ends in .png or .html")
    if path.is_dir():
        raise BadInput(f"--plot {path}: is a folder; expected the name of a file")
    if not path.parent.is_dir():
        raise BadInput(f"--plot {path}: the folder {path.parent} does not exist")


def lay_out(figure: "Figure") -> None:
    """Place the axes by the figure's layout engine, once. `savefig` would draw the whole figure once more for that alone."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def write_picture(path: Path, figure: "Figure", title: str, legend: str | None = None) -> None:
    """Write a figure as PNG, or as SVG within one HTML file.

    title : of the HTML document. legend : a paragraph below the picture, in HTML only. Raises BadInput where the disk refuses.
    """
    try:
        _write(path, figure, title, legend)
    except OSError as wrong:
        raise BadInput(f"--plot {path}: cannot be written: {wrong.strerror or wrong}") from None


def _write(path: Path, figure: "Figure", title: str, legend: str | None) -> None:
    lay_out(figure)
    if path.suffix.lower() == ".png":
        figure.savefig(path, dpi=DPI)
        return
    drawing = io.StringIO()
    figure.savefig(drawing, format="svg", dpi=DPI)  # the resolution is that of rasterised points: a browser cannot draw 100 000 circles
    picture = drawing.getvalue()
    margin, below = ("", "") if legend is None else (";margin:1em", f"<p>{html.escape(legend)}</p>\n")
    path.write_text(
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>\n'
        f"<style>body{{font-family:sans-serif{margin}}}svg{{width:100%;height:auto}}</style></head>\n"
        f"<body>\n{picture[picture.index('<svg') :]}\n{below}</body></html>\n",
        encoding="utf-8",
    )
