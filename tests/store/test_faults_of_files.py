"""Faults of files, made of one sound recording: what is read is right, or refused, or the cause is the first or second that is said.

A fault is a function from the sound table to a faulty one. The friction found in the sound table is what that of the faulty one is compared
with.
"""

import csv
import gzip
import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import ended, printed
from once import once

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.columns import named_columns
from monitor.store.formats.recordings import read_recording

ROOT = Path(__file__).parents[2]
UR5 = load_robot("ur5")
SPEED_RAD_S = 0.4
RIGHT = 0.02  # of F(0.4 rad/s): what the same motion scatters by
RATE_HZ = 125.0


class Sound(NamedTuple):
    """The sound recording."""

    table: pd.DataFrame  # 20 s of a simulated UR5 in the names of RTDE, rounded as loggers do
    friction_nm: Array  # (J,) F(0.4 rad/s)


def friction_nm(found: Identification) -> Array:
    """(J,) F(0.4 rad/s) [N·m]."""
    return found.coulomb_nm + SPEED_RAD_S * found.viscous_nm_s_per_rad


def identified(path: Path, columns: str | None = None, **how) -> Identification:
    return identify([read_recording(path, columns, **how)], UR5, Mounting())


def made(folder: Path) -> Sound:
    excitation = excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")))
    played = stepped_replay(Controller(SimulateSettings(robot="ur5", seed=7)), replace(excitation, repetitions=2))
    columns = named_columns(played)
    wanted = ["timestamp", *(f"{name}_{j}" for name in ("actual_q", "actual_qd", "actual_current") for j in range(6))]
    table = pd.DataFrame({name: columns[name] for name in wanted}).round(6)
    table.to_csv(folder / "sound.csv", index=False)
    return Sound(table, friction_nm(identified(folder / "sound.csv")))


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Sound:
    return once(tmp_path_factory, "sound-file", made)


def off(found: Identification, sound: Sound) -> float:
    """By how much the friction of the worst joint is off."""
    return float(np.max(np.abs(friction_nm(found) / sound.friction_nm - 1.0)))


def said(found: Identification) -> list[str]:
    return [warning.code for warning in found.warnings]


# --- Clocks ------------------------------------------------------------------------------------------------------


def without_speeds(table: pd.DataFrame) -> pd.DataFrame:
    return table[[name for name in table if "_qd_" not in name]]


def in_bursts(table: pd.DataFrame, sizes: Callable[[], int], apart_s: float, late_s: float = 0.0, lost: float = 0.0) -> pd.DataFrame:
    """Times of a host that receives `sizes()` rows at once, each `apart_s` after the one before, up to `late_s` late; some are lost."""
    rng = np.random.default_rng(1)
    table = table[rng.random(len(table)) >= lost].copy()
    t_s = table["timestamp"].to_numpy().copy()
    first = 0
    while first < len(t_s):
        last = min(first + int(sizes()), len(t_s))
        t_s[first:last] = t_s[last - 1] + apart_s * np.arange(last - first) + late_s * rng.random()
        first = last
    return table.assign(timestamp=np.round(np.maximum.accumulate(t_s), 7))


def several(most: int) -> Callable[[], int]:
    rng = np.random.default_rng(2)
    return lambda: int(rng.integers(1, most + 1))


BURSTS: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "2, 0.1 ms apart": lambda table: in_bursts(table, lambda: 2, 1e-4),
    "2, 3 ms apart": lambda table: in_bursts(table, lambda: 2, 3e-3),
    "3, 1 µs apart": lambda table: in_bursts(table, lambda: 3, 1e-6),
    "3, 20 µs apart": lambda table: in_bursts(table, lambda: 3, 2e-5),
    "3, some rows lost": lambda table: in_bursts(table, lambda: 3, 1e-4, lost=0.02),
    "5, without speeds": lambda table: without_speeds(in_bursts(table, lambda: 5, 1e-4)),
    "1 to 6, late": lambda table: in_bursts(table, several(6), 1e-4, late_s=4e-3),
    "7 at one time": lambda table: in_bursts(table, lambda: 7, 0.0),
    "50": lambda table: in_bursts(table, lambda: 50, 1e-4),
}


@pytest.mark.slow
@pytest.mark.parametrize("burst", BURSTS)
def test_times_of_arrival_in_bursts_become_an_even_clock(tmp_path, sound, burst):
    """A host writes when rows arrived; the controller measured them evenly."""
    BURSTS[burst](sound.table).to_csv(tmp_path / "bursts.csv", index=False)
    found = identified(tmp_path / "bursts.csv")
    assert off(found, sound) < RIGHT
    assert said(found)[0] in ({"clock_restored"} if "one time" in burst else {"clock_of_arrivals"})


def test_rows_that_were_measured_unevenly_keep_their_times(tmp_path, sound):
    """A logger that reads whenever it is awake: the positions are those of its times, and an even clock would be wrong."""
    rng = np.random.default_rng(3)
    kept = np.sort(np.concatenate([np.arange(0, len(sound.table), 4), np.arange(1, len(sound.table), 4)]))
    uneven = sound.table.iloc[kept[rng.random(len(kept)) < 0.98]]
    uneven.to_csv(tmp_path / "uneven.csv", index=False)
    found = identified(tmp_path / "uneven.csv")
    assert off(found, sound) < RIGHT
    assert "clock_of_arrivals" not in said(found)


def test_nothing_is_made_of_a_file_that_is_larger_than_itself(tmp_path, sound):
    """Most rows measured 20 µs after another: refused before it is resampled to 50 kHz."""
    rng, whole = np.random.default_rng(4), sound.table
    step = np.where(rng.random(len(whole)) < 0.6, 2e-5, rng.exponential(0.02, len(whole)))
    t_s = whole["timestamp"][0] + np.cumsum(step)
    uneven = pd.DataFrame({name: np.interp(t_s, whole["timestamp"], column) for name, column in whole.items()})
    uneven.assign(timestamp=t_s).pipe(without_speeds).to_csv(tmp_path / "uneven.csv", index=False)
    with pytest.raises(BadInput, match="times are uneven: most rows are 2e-05 s apart"):
        identified(tmp_path / "uneven.csv")


# --- Faults of columns, rows, units and rates ----------------------------------------------------------------------


class Expected(NamedTuple):
    """What is made of a fault: right, with this code first or second; or wrong by some per cent, with it first; or refused."""

    make: Callable[[pd.DataFrame], pd.DataFrame]
    code: str | None = None  # None: nothing is said
    right: bool = True
    refused: str | None = None
    columns: str | None = None
    rate_hz: float | None = None


def scaled_time(factor: float, begin: float = 0.0) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Times in another unit, as whole numbers where they are large."""
    return lambda table: table.assign(
        timestamp=(begin + factor * (table["timestamp"] - table["timestamp"][0])).round(6 if factor > 1 else 12)
    )


def interpolated_from(rate_hz: float, digits: int = 6) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def make(table: pd.DataFrame) -> pd.DataFrame:
        t_s = table["timestamp"].to_numpy()
        seldom = np.arange(t_s[0], t_s[-1], 1.0 / rate_hz)
        even = {name: np.interp(t_s, seldom, np.interp(seldom, t_s, column)) for name, column in table.items() if name != "timestamp"}
        return pd.DataFrame({"timestamp": t_s, **even}).round(digits)

    return make


def with_columns(name: str, values: Callable[[pd.DataFrame, int], object]) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """The columns of one signal replaced or added."""
    return lambda table: table.assign(**{f"{name}_{j}": values(table, j) for j in range(6)})


def renamed(before: str, after: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda table: table.rename(columns={f"{before}_{j}": after.format(j) for j in range(6)})


def held(times: int, jitter_s: float = 0.0) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """A log at so many times the rate of the signal."""

    def make(table: pd.DataFrame) -> pd.DataFrame:
        rows = np.repeat(np.arange(len(table)), times)
        t_s = table["timestamp"][0] + np.arange(len(rows)) / (RATE_HZ * times)
        return table.iloc[rows].assign(timestamp=np.round(t_s + jitter_s * np.random.default_rng(5).random(len(rows)), 6))

    return make


def clock_of_the_day(begin: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Times as text, such as 08:53:23.125."""

    def make(table: pd.DataFrame) -> pd.DataFrame:
        at = pd.Timestamp(f"2026-11-23 {begin}") + pd.to_timedelta(table["timestamp"] - table["timestamp"][0], unit="s")
        return table.assign(timestamp=at.dt.strftime("%H:%M:%S.%f"))

    return make


def in_blocks(rows: int) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Blocks of so many rows, the newest block first."""
    return lambda table: pd.concat([table.iloc[first : first + rows] for first in range(0, len(table), rows)][::-1], ignore_index=True)


def sparse(table: pd.DataFrame) -> pd.DataFrame:
    """Speeds in every second row."""
    return table.where(np.array([["_qd_" not in name for name in table]]) | (np.arange(len(table))[:, None] % 2 == 0))


FAULTS: dict[str, Expected] = {
    "milliseconds since 1970, no speeds": Expected(lambda t: without_speeds(scaled_time(1e3, 1.764e12)(t)), "unit_repaired"),
    "nanoseconds since 1970": Expected(scaled_time(1e9, 1.764e18), "unit_repaired"),
    "nanoseconds since 1970, no speeds": Expected(lambda t: without_speeds(scaled_time(1e9, 1.764e18)(t)), "unit_repaired"),
    "microseconds, no speeds": Expected(lambda t: without_speeds(scaled_time(1e6)(t)), "unit_repaired"),
    "days of a spreadsheet": Expected(scaled_time(1.0 / 86400.0, 45000.0), "unit_repaired"),
    "days of a spreadsheet, no speeds": Expected(lambda t: without_speeds(scaled_time(1.0 / 86400.0, 45000.0)(t)), "unit_repaired"),
    "minutes": Expected(scaled_time(1.0 / 60.0), "unit_repaired"),
    "minutes, no speeds": Expected(lambda t: without_speeds(scaled_time(1.0 / 60.0)(t)), "unit_repaired"),
    "hours, no speeds": Expected(lambda t: without_speeds(scaled_time(1.0 / 3600.0)(t)), "unit_repaired"),
    "clock of the day": Expected(clock_of_the_day("08:53:23")),
    "clock of the day, past midnight": Expected(clock_of_the_day("23:59:55"), "clock_jump"),
    "units of 100 ns": Expected(scaled_time(1e7, 1.3e17), "unit_repaired"),
    "newest first": Expected(lambda t: t.iloc[::-1], "rows_sorted"),
    "newest first, whole seconds": Expected(lambda t: t.assign(timestamp=np.floor(t["timestamp"])).iloc[::-1], "rows_sorted"),
    "blocks of 100 rows, newest first": Expected(in_blocks(100), "rows_sorted"),
    "halves exchanged": Expected(lambda t: in_blocks(len(t) // 2 + 1)(t), "rows_sorted"),
    "times late by up to two ticks": Expected(
        lambda t: t.assign(timestamp=(t["timestamp"] + 0.016 * np.random.default_rng(7).random(len(t))).round(4)), "clock_of_arrivals"
    ),
    "spaces around names": Expected(lambda t: t.rename(columns=lambda name: f"{name} ")),
    "in no order": Expected(lambda t: t.sample(frac=1.0, random_state=1), "rows_sorted"),
    "every row four times": Expected(held(4), "rejected_rows"),
    "every row three times, jitter": Expected(held(3, 5e-4), "rejected_rows"),
    "every row four times, at rest too": Expected(
        lambda t: held(4)(pd.concat([t, *[t.tail(1)] * 400], ignore_index=True)), "rejected_rows"
    ),
    "speeds empty": Expected(with_columns("actual_qd", lambda t, j: np.nan), "signal_empty"),
    "speeds of one joint empty": Expected(lambda t: t.assign(actual_qd_2=np.nan), "signal_empty"),
    "speeds in every second row": Expected(sparse, "signal_empty"),
    "speeds zero": Expected(with_columns("actual_qd", lambda t, j: 0.0), "signal_constant"),
    "torque zero": Expected(with_columns("actual_torque", lambda t, j: 0.0), "signal_constant"),
    "torque empty": Expected(with_columns("actual_torque", lambda t, j: np.nan), "signal_empty"),
    "torque -1": Expected(with_columns("actual_torque", lambda t, j: -1.0), "signal_constant"),
    "positions empty": Expected(with_columns("actual_q", lambda t, j: np.nan), refused="actual_q of joint 1 holds no number"),
    "currents empty": Expected(with_columns("actual_current", lambda t, j: np.nan), refused="current of joints .* holds no number"),
    "interpolated from 10 Hz": Expected(interpolated_from(10.0), "interpolated", right=False),
    "interpolated from 5 Hz, 4 digits": Expected(interpolated_from(5.0, 4), "interpolated", right=False),
    "near name of speeds": Expected(renamed("actual_qd", "actual_qvel_{}"), "names_not_read"),
    "speeds in other letters": Expected(renamed("actual_qd", "actual_dq_{}"), "names_taken"),
    "speeds in other letters, wrong clock": Expected(
        lambda t: renamed("actual_qd", "Actual_QD_{}")(t.assign(timestamp=1.6 * t["timestamp"])), refused="check the columns and the clock"
    ),
    "speeds in other letters, left out": Expected(renamed("actual_qd", "actual_dq_{}"), "names_not_read", columns="actual_qd="),
    "near name of speeds, wrong clock": Expected(
        lambda t: renamed("actual_qd", "joint_{}_velocity")(t.assign(timestamp=1.6 * t["timestamp"])), "names_not_read", right=False
    ),
    "wrong clock, no speeds": Expected(lambda t: without_speeds(t.assign(timestamp=1.6 * t["timestamp"])), "clock_unchecked", right=False),
    "near name of currents": Expected(renamed("actual_current", "actual_currents_{}"), refused=r"actual_currents_\{0..5\}"),
    "no time": Expected(lambda t: t.drop(columns="timestamp"), refused="--rate 125"),
    "no time, with its rate": Expected(lambda t: t.drop(columns="timestamp"), rate_hz=125.0),
    "no time, with a wrong rate": Expected(lambda t: t.drop(columns="timestamp"), rate_hz=100.0, refused="check the columns and the clock"),
    "a counter for a time": Expected(lambda t: t.assign(timestamp=np.arange(len(t))), refused="count the rows.*--rate 125"),
    "a counter, left out": Expected(lambda t: t.assign(timestamp=np.arange(len(t))), columns="timestamp=", rate_hz=125.0),
    "whole seconds, rows lost": Expected(
        lambda t: t.assign(timestamp=np.floor(t["timestamp"])).sample(frac=0.98, random_state=1).sort_index(), "clock_restored"
    ),
    "modes in words": Expected(lambda t: t.assign(robot_mode="RUNNING", payload="none", safety_mode="NORMAL")),
    "columns by names": Expected(
        lambda t: renamed("actual_q", "joint_position_{}")(renamed("actual_qd", "v{}")(t)).rename(columns={"timestamp": "zeit"}),
        columns="timestamp=zeit,actual_q=joint_position_{0..5},actual_qd=v{0..5}",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_file_is_right_or_refused_or_the_cause_is_said_first(tmp_path, sound, fault, kind):
    """No figure that is off by more than 2 % stands alone."""
    expected = FAULTS[fault]
    table, file = expected.make(sound.table), tmp_path / f"file.{kind}"
    table.to_csv(file, index=False) if kind == "csv" else table.to_parquet(file, index=False)
    if expected.refused is not None:
        with pytest.raises(BadInput, match=expected.refused):
            identified(file, expected.columns, rate_hz=expected.rate_hz)
        return
    found = identified(file, expected.columns, rate_hz=expected.rate_hz)
    assert (off(found, sound) < RIGHT) == expected.right
    assert said(found)[:2] == [] if expected.code is None else expected.code in said(found)[:2]


QUOTED: dict[str, Callable[[pd.DataFrame], str]] = {
    "decimal commas in quotes": lambda t: t.to_csv(index=False, decimal=",", sep=",", quoting=csv.QUOTE_NONNUMERIC, float_format="%.6f"),
    "all in quotes": lambda t: t.to_csv(index=False, quoting=csv.QUOTE_ALL),
    "semicolons, decimal commas, all in quotes": lambda t: t.to_csv(index=False, sep=";", decimal=",", quoting=csv.QUOTE_ALL),
    "spaces, in quotes": lambda t: t.to_csv(index=False, sep=" ", quoting=csv.QUOTE_ALL),
    "single quotes": lambda t: t.to_csv(index=False, quoting=csv.QUOTE_ALL, quotechar="'"),
    "quotes around whole lines": lambda t: "".join(f'"{line}"\n' for line in t.to_csv(index=False).splitlines()),
    "commas and spaces": lambda t: t.to_csv(index=False).replace(",", ", "),
    "bars": lambda t: t.to_csv(index=False, sep="|"),
}


@pytest.mark.slow
@pytest.mark.parametrize("quoted", QUOTED)
def test_quotes_and_separators_are_those_of_csv(tmp_path, sound, quoted):
    """As spreadsheets and data frames write it."""
    (tmp_path / "a.csv").write_text(QUOTED[quoted](sound.table))
    found = read_recording(tmp_path / "a.csv")
    np.testing.assert_allclose(found.current[:, 5], sound.table["actual_current_5"], atol=1e-6)
    np.testing.assert_allclose(found.t_s, sound.table["timestamp"], atol=1e-6)


@pytest.mark.slow
def test_every_command_that_reads_recordings_takes_names_and_a_rate(tmp_path, sound):
    """The friction is that of the sound file, in each of them."""
    renamed("actual_q", "pos_{}")(sound.table.drop(columns="timestamp")).to_csv(tmp_path / "a.csv", index=False)
    sound.table.to_csv(tmp_path / "replay.csv", index=False)
    how = ("--robot", "ur5", "--columns", "actual_q=pos_{0..5}", "--rate", "125", "--json")
    found = json.loads(printed("identify", tmp_path / "a.csv", *how))["friction"]["at_speeds"][1]
    assert found["speed_rad_s"] == SPEED_RAD_S
    np.testing.assert_allclose(found["torque_nm"], sound.friction_nm, rtol=RIGHT)
    assert json.loads(printed("energy", tmp_path / "a.csv", *how))["warnings"] == []
    rigid = tmp_path / "rigid.json"
    rigid.write_text(printed("identify", tmp_path / "replay.csv", "--robot", "ur5", "--json"))
    heard = json.loads(printed("listen", tmp_path / "a.csv", "--rigid", rigid, *how))
    assert heard["files"][0]["rate_hz"] == pytest.approx(125.0)
    judged = json.loads(printed("assess", tmp_path / "a.csv", "--interval", "1d", *how))
    assert [warning["code"] for warning in judged["warnings"]] == ["temperature_unknown"]
    refused = ended("identify", tmp_path / "replay.csv", "--robot", "ur5", "--rate", "125")
    assert refused.returncode == 2
    assert "--rate is for rows without one" in refused.stderr


def test_a_file_of_other_names_and_targets_is_told_what_it_holds(tmp_path):
    """Targets are the reason only where nothing else could be the positions."""
    (tmp_path / "a.csv").write_text("time,target_position_1,target_position_2,joint_position_1,joint_position_2\n0,1,2,3,4\n")
    with pytest.raises(BadInput, match=r"it names time, target_position_\{1..2\}, joint_position_\{1..2\}"):
        read_recording(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("timestamp,target_q_0,target_q_1\n0,1,2\n")
    with pytest.raises(BadInput, match="only targets such as target_q_0: these are what the controller wanted"):
        read_recording(tmp_path / "b.csv")


# --- What a file may cost ------------------------------------------------------------------------------------------

MOST_BYTES, MOST_CPU_S = 500e6, 10.0  # for a file of 1 MB


def text_of(table: pd.DataFrame, size: float = 1e6) -> bytes:
    """The table again and again as CSV, up to a size."""
    whole = table.to_csv(index=False)
    header, body = whole.split("\n", 1)
    return (header + "\n" + body * int(1 + size / len(body))).encode()[: int(size)]


def many_rows(table: pd.DataFrame, t_s: Callable[[int, np.random.Generator], Array]) -> bytes:
    """As many rows as 1 MB holds, at times that are made for so many rows."""
    rounded = pd.concat([table.round(2)] * 5, ignore_index=True)
    times = t_s(len(rounded), np.random.default_rng(6))
    return rounded.assign(timestamp=times).to_csv(index=False, float_format="%.6g").encode()[: int(1e6)]


def constant_parquet() -> bytes:
    columns = ["timestamp", *(f"{name}_{j}" for name in ("actual_q", "actual_qd", "actual_current") for j in range(6))]
    sink = io.BytesIO()
    pq.write_table(pa.table(dict.fromkeys(columns, pa.array(np.zeros(3_000_000)))), sink, compression="zstd")
    return sink.getvalue()


COSTLY: dict[str, Callable[[pd.DataFrame], bytes]] = {
    "sound rows": lambda t: many_rows(t, lambda n, rng: np.arange(n) / RATE_HZ),
    "threes, 20 µs apart": lambda t: many_rows(
        t, lambda n, rng: np.repeat(np.arange(0, n, 3), 3)[:n] / RATE_HZ + 2e-5 * (np.arange(n) % 3)
    ),
    "times at random": lambda t: many_rows(t, lambda n, rng: np.sort(rng.random(n)) * 60.0),
    "a leap at every row": lambda t: many_rows(t, lambda n, rng: np.cumsum(rng.choice([-100.0, 100.0, 0.008], n))),
    "a saw": lambda t: many_rows(t, lambda n, rng: np.arange(n) % 40 / RATE_HZ),
    "one short line after another": lambda t: (t.head(1000).to_csv(index=False) + "1\n" * 400_000).encode()[: int(1e6)],
    "70000 names": lambda t: (",".join(f"a_{k}" for k in range(70_000)) + "\n" + "0," * 69_999 + "0\n").encode(),
    "Parquet of one number": lambda t: constant_parquet(),
    "gzip of one line": lambda t: gzip.compress(text_of(t, 1e5) + b"0\n" * 50_000_000),
}


# what `wait` says of a child's memory is at least that of the process which made it: the child says its own
MEASURED = """
import atexit, pathlib, re, sys
to, sys.argv = pathlib.Path(sys.argv[1]), ["joint-monitor", *sys.argv[2:]]
atexit.register(lambda: to.write_text(re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1]))
from monitor.cli.main import main
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("command", ["identify", "listen"])
@pytest.mark.parametrize("costly", COSTLY)
def test_no_file_of_a_megabyte_takes_half_a_gigabyte_or_ten_seconds(tmp_path, sound, costly, command):
    """In a process of its own, under a limit of its memory; it ends as any other file does, with figures or with a sentence."""
    file = tmp_path / "file"
    file.write_bytes(COSTLY[costly](sound.table))
    assert file.stat().st_size <= 1.1e6
    arguments = [command, str(file), "--robot", "ur5"]
    if command == "listen":
        sound.table.to_csv(tmp_path / "replay.csv", index=False)
        arguments += ["--rigid", str(tmp_path / "replay.csv")]
    with (tmp_path / "said").open("w+") as said_by:
        process = subprocess.Popen(
            [sys.executable, "-c", MEASURED, str(tmp_path / "most"), *arguments],
            stdout=subprocess.DEVNULL,
            stderr=said_by,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 * int(MOST_BYTES), 4 * int(MOST_BYTES))),  # noqa: PLW1509
        )
        _, status, used = os.wait4(process.pid, 0)
        said_by.seek(0)
        assert os.waitstatus_to_exitcode(status) in {0, 2}, said_by.read()
        said_by.seek(0)
        assert "Traceback" not in said_by.read()
    assert float((tmp_path / "most").read_text()) * 1024 < MOST_BYTES
    assert used.ru_utime < MOST_CPU_S
