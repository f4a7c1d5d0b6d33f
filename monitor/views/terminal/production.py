"""What the command `listen` prints."""

from typing import Any

from rich.markup import escape

from monitor.identify.document import NINETY
from monitor.views.terminal.figures import number, standard_output, table_of


def print_listened(document: dict[str, Any]) -> None:
    """Print what recordings of production tell: each file, friction of every joint, what was left out, and what they cannot tell."""
    console = standard_output(120)
    for file in document["files"]:
        size = f"{file['duration_s']:.0f} s at {number(file['rate_hz'], '.0f')} Hz, {file['counted_s']:.0f} s of motion counted"
        console.print(f"{escape(file['file'])}: {size}", highlight=False)
    seen = max(document["seen_s"], 1e-9)
    for cause, seconds in sorted(document["left_out_s"].items(), key=lambda each: -each[1]):
        console.print(f"  left out {100 * seconds / seen:.1f} %, {seconds:.0f} s: {document['causes'][cause]} ({cause})", highlight=False)
    speed = document["reference_speed_rad_s"]
    titles = ["joint", f"F({speed:g} rad/s), 90 % [Nm]", "replay [Nm]", "change", "T [°C]", "speed [rad/s]", "moved [s]", "held/needed"]
    table = table_of(titles)
    for joint, change, replay in zip(document["joints"], document["changes"], document["replay"]["friction_nm"], strict=True):
        known = joint["friction_nm"] is not None
        table.add_row(
            str(joint["joint"]),
            f"{joint['friction_nm']:.2f} ± {NINETY * joint['deviation_nm']:.2f}" if known else "–",
            number(replay, ".2f"),
            "–" if change["change"] is None else f"{100 * change['change']:+.1f} %{'' if change['clear'] else ' (not clear)'}",
            number(joint["temperature_c"], ".1f"),
            number(joint["speed_rad_s"], ".2f"),
            number(joint["moving_s"], ".0f"),
            number(joint["share"], ".2g"),
        )
    console.print(table)
    for reason in document["reasons"]:
        console.print(reason, highlight=False, markup=False)
    for warning in document["warnings"]:
        console.print(f"[yellow]{warning['code']}[/]: {escape(warning['text'])}", highlight=False)
