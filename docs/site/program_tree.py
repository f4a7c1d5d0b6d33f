"""Draw the picture of docs/hand-over.md: the node in a program's tree, and what happens at it. `make docs` runs this.

python docs/site/program_tree.py
"""

from html import escape
from pathlib import Path

PICTURE = Path(__file__).parent.parent / "hand-over.svg"
WIDTH, HEIGHT, ROW = 980, 452, 34
INK, DIM, LINE, OURS, GOOD, BAD, PAPER = "#1d2733", "#5a6775", "#c3ccd6", "#0b5cad", "#1d7a3e", "#b3261e", "#ffffff"

TREE = (  # depth, text, whether it is the node that lends the arm
    (0, "Robot Program", False),
    (1, "MoveJ  to_conveyor", False),
    (1, "Gripper  close", False),
    (1, "MoveJ  to_box", False),
    (1, "Gripper  open", False),
    (1, "MoveJ  clear_of_everything", False),
    (1, "External Control (or a Script node)", True),
    (1, "MoveJ  to_conveyor_again", False),
)
CASES = (  # title, colour, steps
    ("Nothing is due", GOOD, ("node reached", "nothing waits", "goes on, ≤ 0.1 s later")),
    ("Due, a condition fails", GOOD, ("node reached", "offered 0.08 s", "goes on: the monitor says why")),
    ("Due, all conditions hold", OURS, ("arm taken", "replay", "back within 1 mrad, goes on")),
    ("Contact lost meanwhile", BAD, ("no beat 0.12 s", "stopj", "halt: a person starts it again")),
)


def text(x: float, y: float, words: str, *, size: int = 14, colour: str = INK, weight: str = "normal", anchor: str = "start") -> str:
    """One line of text."""
    return f'<text x="{x}" y="{y}" font-size="{size}" fill="{colour}" font-weight="{weight}" text-anchor="{anchor}">{escape(words)}</text>'


def box(x: float, y: float, width: float, height: float, *, fill: str, line: str) -> str:
    """A box with round corners."""
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="5" fill="{fill}" stroke="{line}"/>'


def tree(x: float, y: float) -> list[str]:
    """The program as its programmer sees it."""
    parts = [text(x, y - 22, "The program", size=16, weight="bold")]
    begin, end = y + ROW, y + ROW * (len(TREE) - 1) + 13
    parts.append(f'<path d="M{x + 14} {begin - 6}V{end}" stroke="{LINE}" stroke-width="2" fill="none"/>')
    for k, (depth, words, ours) in enumerate(TREE):
        top, left = y + ROW * k, x + 34 * depth
        if depth:
            parts.append(f'<path d="M{x + 14} {top + 13}H{left - 2}" stroke="{LINE}" stroke-width="2"/>')
        parts.append(box(left, top, 300, 26, fill=OURS if ours else "#eef2f6", line=OURS if ours else LINE))
        parts.append(text(left + 10, top + 18, words, colour=PAPER if ours else INK, weight="bold" if ours else "normal"))
    below = y + ROW * len(TREE) + 14
    notes = (
        "Where no part is held, no other machine waits,",
        "and the way to the excitation is free: the",
        "programmer chooses the place of the node.",
    )
    return [*parts, *(text(x, below + 20 * k, note, size=13, colour=DIM) for k, note in enumerate(notes))]


def cases(x: float, y: float) -> list[str]:
    """What the node does, case by case."""
    parts = [text(x, y - 22, "At the node", size=16, weight="bold")]
    for k, (title, colour, steps) in enumerate(CASES):
        top = y + 92 * k
        parts += [text(x, top + 15, title, weight="bold", colour=colour)]
        left = x
        for n, step in enumerate(steps):
            width = (110, 118, 234)[n]
            parts += [
                box(left, top + 26, width, 34, fill=PAPER, line=colour),
                text(left + width / 2, top + 48, step, size=13, anchor="middle"),
            ]
            if n < len(steps) - 1:
                parts.append(f'<path d="M{left + width + 3} {top + 43}h14m-5 -5l5 5l-5 5" stroke="{colour}" stroke-width="2" fill="none"/>')
            left += width + 22
    return parts


def picture() -> str:
    """The whole as SVG."""
    parts = [f'<rect width="{WIDTH}" height="{HEIGHT}" fill="{PAPER}"/>', *tree(30, 62), *cases(450, 62)]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="DejaVu Sans, Segoe UI, Arial, sans-serif">'
    title = "<title>A node of the program lends the arm; what happens at it</title>"
    return "\n".join([head, title, *parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(picture(), "utf-8")
