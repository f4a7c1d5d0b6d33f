"""The first configuration of an arm, written from answers: a TOML file with a comment for what a person must know. I/O."""

import json
import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monitor.config.files import write_whole
from monitor.errors import BadInput

COMMENT_WIDTH = 120  # characters of a line that is only a comment


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What a configuration is written from. An empty text or tuple: nobody knows, and the key is left out."""

    model: str
    site: str
    id: str
    host: str
    robot_api_port: int  # of a PolyScope X; 80, where it always is, is left out
    mounting: str
    payload_kg: float
    payload_cog_m: tuple[float, ...]
    tcp_offset: tuple[float, ...]
    tcp_speed_limit_m_s: float
    tool: str
    serial: str
    gains_nm_per_a: tuple[float, ...]
    gains_source: str  # a sentence: whose gains these are; where there are none, why, and how they are found
    cell: str  # plain, or the name of the cell's file
    excitation: str  # empty: the shipped one of model and mounting
    designed: str  # the command that designs a trajectory for a cell of its own; empty: none is needed
    timezone: str
    cron: str
    windows_utc: tuple[str, ...]
    store: str
    bus_port: int
    page: str  # HOST:PORT; empty: no page
    allow_motion: bool
    written: str  # the date and the version that wrote the file


def configuration_text(answers: Answers) -> str:
    """The TOML file. Every line that a person may have to change says why it is so."""
    parts = [
        *_comment(
            f"The monitor of one arm, written by `joint-monitor init` {answers.written}. Change it as you like: what it leaves out has the "
            "default that docs/configuration.md gives, and `joint-monitor check` says what is wrong."
        ),
        "",
        *_robot(answers),
        "",
        *_replay(answers),
        "",
        "[schedule]",
        _line("timezone", answers.timezone, "of cron and of every time that is shown"),
        _line("cron", answers.cron, "when a window opens: minute hour day month weekday"),
        "",
        "[store]",
        _line("directory", answers.store, "where the history lives; relative to this file"),
        "",
        "[bus]",
        _line("listen", [f"tcp/127.0.0.1:{answers.bus_port}"], "one port for each arm of this machine"),
    ]
    if answers.page:
        parts += ["", "[page]", _line("listen", answers.page, f"the status page: http://{answers.page}/")]
    return "\n".join(parts) + "\n"


def _robot(answers: Answers) -> list[str]:
    lines = [
        "[robot]",
        _line("model", answers.model),
        _line("site", answers.site, "part of the bus's keys"),
        _line("id", answers.id, "likewise; unique within the site"),
        _line("host", answers.host, "the controller"),
        *([] if answers.robot_api_port == 80 else [_line("robot_api_port", answers.robot_api_port, "of its Robot API; 80 on a real arm")]),
        _line("mounting", answers.mounting, 'ground, ceiling, wall, or "ROLL,PITCH,YAW" in degrees'),
        _line("payload_kg", answers.payload_kg, "as set in the controller"),
    ]
    if answers.payload_cog_m:
        lines.append(_line("payload_cog_m", answers.payload_cog_m, "its centre in the flange's frame, as set in the controller"))
    if answers.tcp_offset:
        lines.append(_line("tcp_offset", answers.tcp_offset, "tool centre point as set in the controller: m, and rotation vector in rad"))
    if answers.tcp_speed_limit_m_s:
        lines.append(_line("tcp_speed_limit_m_s", answers.tcp_speed_limit_m_s, "of tool and elbow, as in the controller's safety settings"))
    lines.append(_line("tool", answers.tool, "in your words; a change of it begins a new baseline"))
    if answers.serial:
        lines.append(_line("serial", answers.serial, "another arm at this address is refused"))
    lines += _comment(f"Joint torque per ampere [N·m/A], joints 1 to 6: {answers.gains_source}.")
    if answers.gains_nm_per_a:
        lines.append(_line("gains_nm_per_a", answers.gains_nm_per_a))
    return lines


def _replay(answers: Answers) -> list[str]:
    lines = ["[replay]"]
    lines += _comment(
        "Nothing moves unless allow_motion is true and every condition of `joint-monitor check` holds. Before you set it to true: a motion "
        "that begins by the clock is in the cell's risk assessment, somebody holds the emergency stop at the first one, and the way of the "
        "trajectory is free. docs/real-robot-safety.md goes through it step by step."
    )
    lines += [
        _line("allow_motion", answers.allow_motion),
        _line("cell", answers.cell, "what stands around the arm: plain is the surface below its base and nothing else"),
    ]
    if answers.designed:
        lines += _comment(f"A cell of its own needs a trajectory of its own: {answers.designed}, then uncomment the next line.")
        lines.append(f"# {_line('excitation', answers.excitation)}")
    elif answers.excitation:
        lines.append(_line("excitation", answers.excitation))
    if answers.windows_utc:
        lines.append(_line("windows_utc", answers.windows_utc, "the arm moves at no other time, whoever asks"))
    return lines


def cell_text(document: Mapping[str, Any]) -> str:
    """The TOML file of a cell. document : `Cell.as_document`."""
    return toml_text(
        document,
        "What stands around the arm, written by `joint-monitor init`. The origin is the robot's base, z points up, metres and degrees. "
        "config/cell/example.toml shows everything that can be said.",
    )


def toml_text(document: Mapping[str, Any], about: str) -> str:
    """A document of tables, and of lists of tables, as a TOML file that begins with the comment `about`."""
    lines = _comment(about)
    for name, tables in document.items():
        for table in tables if isinstance(tables, list) else [tables]:
            lines += ["", f"[[{name}]]" if isinstance(tables, list) else f"[{name}]"]
            plain = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
            lines += [_line(key, value) for key, value in plain.items()]
            for key, value in table.items():
                if isinstance(value, Mapping):  # [identify.signals]
                    lines += ["", f"[{name}.{key}]", *(_line(inner, each) for inner, each in value.items())]
    return "\n".join(lines) + "\n"


def write_new(path: Path, text: str, *, force: bool) -> None:
    """Write a file as a whole or not at all. Raises BadInput where it exists and `force` is false, or where it cannot be written."""
    if path.exists() and not force:
        raise BadInput(f"{path} exists; nothing was written. Give another name, or --force to replace it")
    write_whole(path, text.encode(), mode=0o644 & ~_umask())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _line(key: str, value: object, comment: str = "") -> str:
    text = _value(value)
    return f"{key} = {text}" + (f"  # {comment}" if comment else "")


def _value(value: object) -> str:
    """A TOML value: a basic string of TOML and a string of JSON are written alike, but for DEL, which no answer holds."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Sequence):
        return f"[{', '.join(_value(each) for each in value)}]"
    return repr(value)


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(text, COMMENT_WIDTH - 2, break_long_words=False, break_on_hyphens=False)]
