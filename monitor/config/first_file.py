"""The first configuration of an arm, written from answers: a TOML file with a comment for what a person must know. I/O."""

import os
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Table
from tomlkit.toml_document import TOMLDocument

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
    document = tomlkit.document()
    _comment(
        document,
        f"The monitor of one arm, written by `joint-monitor init` {answers.written}. Change it as you like: what it leaves out has the "
        "default that docs/configuration.md gives, and `joint-monitor check` says what is wrong. Where you have no docs, "
        "`joint-monitor deploy-files DIR` writes them.",
    )
    document.add(tomlkit.nl())
    document.add("robot", _robot(answers))
    document.add("replay", _replay(answers))
    schedule = tomlkit.table()
    _add(schedule, "timezone", answers.timezone, "of cron and of every time that is shown")
    _add(schedule, "cron", answers.cron, "when a window opens: minute hour day month weekday")
    document.add("schedule", _spaced(schedule))
    store = tomlkit.table()
    _add(store, "directory", answers.store, "where the history lives; relative to this file")
    document.add("store", _spaced(store))
    bus = tomlkit.table()
    _add(bus, "listen", [f"tcp/127.0.0.1:{answers.bus_port}"], "one port for each arm of this machine")
    document.add("bus", bus)
    if answers.page:
        page = tomlkit.table()
        _add(page, "listen", answers.page, f"the status page: http://{answers.page}/")
        bus.add(tomlkit.nl())
        document.add("page", page)
    return tomlkit.dumps(document)


def _robot(answers: Answers) -> Table:
    table = tomlkit.table()
    _add(table, "model", answers.model)
    _add(table, "site", answers.site, "part of the bus's keys")
    _add(table, "id", answers.id, "likewise; unique within the site")
    here = answers.host.startswith("127.")
    _add(table, "host", answers.host, "the controller" + (": a simulated one on this machine; else put its address here" if here else ""))
    if answers.robot_api_port != 80:
        _add(table, "robot_api_port", answers.robot_api_port, "of its Robot API; 80 on a real arm")
    _add(table, "mounting", answers.mounting, 'ground, ceiling, wall, or "ROLL,PITCH,YAW" in degrees')
    _add(table, "payload_kg", answers.payload_kg, "as set in the controller")
    if answers.payload_cog_m:
        _add(table, "payload_cog_m", answers.payload_cog_m, "its centre in the flange's frame, as set in the controller")
    if answers.tcp_offset:
        _add(table, "tcp_offset", answers.tcp_offset, "tool centre point as set in the controller: m, and rotation vector in rad")
    if answers.tcp_speed_limit_m_s:
        _add(table, "tcp_speed_limit_m_s", answers.tcp_speed_limit_m_s, "of tool and elbow, as in the controller's safety settings")
    _add(table, "tool", answers.tool, "in your words; a change of it begins a new baseline")
    if answers.serial:
        _add(table, "serial", answers.serial, "another arm at this address is refused")
    _comment(table, f"Joint torque per ampere [N·m/A], joints 1 to 6: {answers.gains_source}.")
    if answers.gains_nm_per_a:
        _add(table, "gains_nm_per_a", answers.gains_nm_per_a)
    return _spaced(table)


def _replay(answers: Answers) -> Table:
    table = tomlkit.table()
    _comment(
        table,
        "Nothing moves unless allow_motion is true and every condition of `joint-monitor check` holds. Before you set it to true: a motion "
        "that begins by the clock is in the cell's risk assessment, somebody holds the emergency stop at the first one, and the way of the "
        "trajectory is free. docs/real-robot-safety.md goes through it step by step.",
    )
    _add(table, "allow_motion", answers.allow_motion)
    _add(table, "cell", answers.cell, "what stands around the arm: plain is the surface below its base and nothing else")
    if answers.designed:
        _comment(table, f"A cell of its own needs a trajectory of its own: {answers.designed}, then uncomment the next line.")
        table.add(tomlkit.comment(f"excitation = {tomlkit.item(answers.excitation).as_string()}"))
    elif answers.excitation:
        _add(table, "excitation", answers.excitation)
    if answers.windows_utc:
        _add(table, "windows_utc", answers.windows_utc, "the arm moves at no other time, whoever asks")
    return _spaced(table)


def cell_text(document: Mapping[str, Any]) -> str:
    """The TOML file of a cell. document : `Cell.as_document`."""
    return toml_text(
        document,
        "What stands around the arm, written by `joint-monitor init`. The origin is the robot's base, z points up, metres and degrees. "
        "config/cell/example.toml shows everything that can be said.",
    )


def toml_text(document: Mapping[str, Any], about: str) -> str:
    """A document of tables, and of lists of tables, as a TOML file that begins with the comment `about`."""
    made = tomlkit.document()
    _comment(made, about)
    made.add(tomlkit.nl())
    made.update(document)
    return tomlkit.dumps(made)


def _add(table: Table, key: str, value: object, comment: str = "") -> None:
    """A key with its value, and the comment behind it."""
    item = tomlkit.item(list(value) if isinstance(value, tuple) else value)
    if comment:
        item.comment(comment)
    table.add(key, item)


def _comment(to: TOMLDocument | Table, text: str) -> None:
    """Lines that are only a comment."""
    for line in textwrap.wrap(text, COMMENT_WIDTH - 2, break_long_words=False, break_on_hyphens=False):
        to.add(tomlkit.comment(line))


def _spaced(table: Table) -> Table:
    """The table with an empty line after it."""
    table.add(tomlkit.nl())
    return table


def write_new(path: Path, text: str, *, force: bool) -> None:
    """Write a file as a whole or not at all. Raises BadInput where it exists and `force` is false, or where it cannot be written."""
    if path.exists() and not force:
        raise BadInput(f"{path} exists; nothing was written. Give another name, or --force to replace it")
    write_whole(path, text.encode(), mode=0o644 & ~_umask())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
