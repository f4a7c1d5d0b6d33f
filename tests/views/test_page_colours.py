"""The page's colours can be read on each of its grounds, light and dark; the browser tests see only the states of their moment."""

import itertools
import re
from pathlib import Path

import pytest

CSS = (Path(__file__).parent.parent.parent / "monitor" / "views" / "web" / "static" / "page.css").read_text("utf-8")
STATES = ("normal", "check", "off", "maint", "fail", "unknown", "dim", "ink", "accent")
GROUNDS = ("bg", "card", "soft")
THEMES = [dict(re.findall(r"--([\w-]+):\s*(#[0-9a-f]{3,6})\b", block)) for block in re.findall(r":root[^{]*\{([^}]*)\}", CSS)]


def luminance(colour: str) -> float:
    """Relative luminance, WCAG 2.2."""
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


@pytest.mark.parametrize("theme", THEMES, ids=lambda theme: theme["bg"])
def test_every_state_has_a_contrast_of_4_5_on_every_ground(theme):
    """WCAG 2.2, 1.4.3, for text of ordinary size."""
    weak = {}
    for state, ground in itertools.product(STATES, GROUNDS):
        dark, light = sorted((luminance(theme[state]), luminance(theme[ground])))
        if (ratio := (light + 0.05) / (dark + 0.05)) < 4.5:
            weak[state, ground] = round(ratio, 2)
    assert not weak


def test_both_themes_are_read():
    """A light one and a dark one; the dark one stands twice, for a choice and for the system's."""
    assert {luminance(theme["bg"]) > 0.5 for theme in THEMES} == {True, False}
