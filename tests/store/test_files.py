"""Recordings as files: written ones are read back exactly, files of others are read or refused with the reason."""

import gzip
from dataclasses import fields

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from monitor.errors import BadInput, StoreError
from monitor.recording import Context, Recording
from monitor.store.formats.recordings import read_recording, write_recording

SPEC = "timestamp,actual_q:2,actual_qd:2,actual_current:2"
HEADER = ["timestamp", "actual_q_0", "actual_q_1", "actual_qd_0", "actual_qd_1", "actual_current_0", "actual_current_1"]
ROWS = np.arange(21.0).reshape(3, 7) / 8.0 - 1.0  # eighths are exact in binary and short in decimal


def text(separator=",", decimal=".", header=True, end="\n"):
    lines = [separator.join(HEADER)] if header else []
    lines += [separator.join(f"{value:.3f}".replace(".", decimal) for value in row) for row in ROWS]
    return end.join(lines) + end


def assert_is_rows(recording):
    np.testing.assert_array_equal(recording.t_s, ROWS[:, 0])
    np.testing.assert_array_equal(recording.q, ROWS[:, 1:3])
    np.testing.assert_array_equal(recording.qd, ROWS[:, 3:5])
    np.testing.assert_array_equal(recording.current, ROWS[:, 5:7])


def full(seed: int, samples: int) -> Recording:
    """A recording with every signal and every field of the context, and with torn values."""
    rng = np.random.default_rng(seed)
    joint = {name: rng.normal(size=(samples, 3)) for name in ("q", "qd", "qdd", "current", "torque", "temperature_c")}
    joint |= {f"target_{name}": rng.normal(size=(samples, 3)) for name in ("q", "qd", "qdd", "current", "moment")}
    joint["current"][rng.integers(samples), 1] = np.nan
    scalar = {name: rng.normal(size=samples) for name in ("t_s", "robot_mode", "safety_mode", "runtime_state", "speed_scaling")}
    context = Context(
        robot="ur5", serial="2015350000", firmware="3.15.8", mounting_rad=(np.pi, 0.1, 1 / 3), payload_kg=0.1 + 0.2, tool="Greifer ß",
        trajectory_digest="0123", software="0.1.0", recorded_at_unix_s=1750032000.123456, note="after \"service\"",
    )  # fmt: skip
    return Recording(**joint, **scalar, context=context, quality={"missed_ticks": 3, "latency_s": [0.1, 0.2]}, source="replay 7")


@given(seed=st.integers(0, 2**32 - 1), samples=st.integers(1, 50))
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_our_parquet_comes_back_exactly(tmp_path, seed, samples):
    """Signals (with NaN), context, quality and source are equal bit for bit after a way over the disk."""
    before = full(seed, samples)
    write_recording(tmp_path / "one.parquet", before)
    after = read_recording(tmp_path / "one.parquet")
    for field in fields(Recording):
        old, new = getattr(before, field.name), getattr(after, field.name)
        if isinstance(old, np.ndarray):
            assert old.tobytes() == np.ascontiguousarray(new).tobytes()
        else:
            assert old == new


def test_what_was_not_recorded_stays_unrecorded(tmp_path):
    """Signals and facts that are None are None when read back."""
    write_recording(tmp_path / "a.parquet", Recording(t_s=np.arange(3.0), q=np.zeros((3, 6))))
    after = read_recording(tmp_path / "a.parquet")
    assert set(after.signals) == {"t_s", "q"}
    assert after.context == Context()


def test_anyone_can_read_our_parquet(tmp_path):
    """The columns carry RTDE's names, compressed with zstd."""
    write_recording(tmp_path / "a.parquet", full(0, 9))
    assert {"timestamp", "actual_q_0", "actual_torque_2", "joint_temperatures_1", "target_moment_2"} <= set(
        pd.read_parquet(tmp_path / "a.parquet").columns
    )
    assert pq.ParquetFile(tmp_path / "a.parquet").metadata.row_group(0).column(0).compression == "ZSTD"


def test_parquet_of_others_is_read_by_its_names(tmp_path):
    """The file has the names of columns and no metadata."""
    pd.DataFrame(ROWS, columns=HEADER).to_parquet(tmp_path / "theirs.parquet")
    assert_is_rows(read_recording(tmp_path / "theirs.parquet"))


def test_writing_is_atomic(tmp_path):
    """A failing disk raises StoreError, and neither a partial nor a temporary file is left."""
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "inside").touch()
    with pytest.raises(StoreError, match="taken: the recording cannot be written"):
        write_recording(tmp_path / "taken", full(0, 5))
    with pytest.raises(StoreError, match="cannot be written"):
        write_recording(tmp_path / "absent" / "a.parquet", full(0, 5))
    assert [entry.name for entry in tmp_path.iterdir()] == ["taken"]


def test_writing_again_replaces(tmp_path):
    """The later recording is read, and it is the only file in the folder."""
    write_recording(tmp_path / "a.parquet", full(0, 5))
    write_recording(tmp_path / "a.parquet", full(1, 7))
    assert read_recording(tmp_path / "a.parquet").samples == 7
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (", ", "."), (";", "."), (";", ","), (" ", "."), ("  ", ","), ("\t", "."), ("\t", ",")]
)
@pytest.mark.parametrize("header", [True, False])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_every_usual_separator_and_decimal_sign_is_understood(tmp_path, separator, decimal, header, end):
    """The names are in a header, or --columns gives them."""
    file = tmp_path / "a.csv"
    file.write_bytes(text(separator, decimal, header, end).encode())
    assert_is_rows(read_recording(file, None if header else SPEC))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("first", ["", "sep=;\n", '"sep=;"\n'])
def test_what_excel_writes_is_read(tmp_path, encoding, first):
    """A byte order mark, UTF-16 as of its Unicode text, a first line that names the separator."""
    file = tmp_path / "a.csv"
    file.write_bytes((first + text(";", ",")).encode(encoding))
    assert_is_rows(read_recording(file))


def test_a_header_is_skipped_where_columns_are_described(tmp_path):
    """The names in the header are unknown, and --columns explains the columns. Quotes and a byte order mark are accepted."""
    file = tmp_path / "a.csv"
    file.write_text("\ufeff" + '"t","a","b","c","d","e","f"\n' + text(header=False))
    assert_is_rows(read_recording(file, SPEC))


def test_columns_may_be_single_skipped_or_out_of_order(tmp_path):
    """Positions one by one, two columns without use, and speeds last."""
    file = tmp_path / "a.csv"
    file.write_text(text(header=False))
    recording = read_recording(file, "timestamp, actual_q_0, actual_q_1, skip:2, actual_qd:2")
    np.testing.assert_array_equal(recording.qd, ROWS[:, 5:7])
    assert recording.current is None


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("decimal", [",", "."])
def test_fields_in_quotes_are_fields(tmp_path, separator, decimal):
    """A decimal comma in quotes separates no columns, whatever does; a quote that a torn row left open costs that row alone."""
    file = tmp_path / "a.csv"
    lines = [separator.join(f'"{field}"' for field in line.split(";")) for line in text(";", decimal).splitlines()]
    lines.insert(2, lines[1].replace('"', "", 1) + separator + '"torn')
    file.write_text("\n".join(lines))
    found = read_recording(file)
    assert np.isnan(found.t_s[1])
    assert found.samples == len(ROWS) + 1
    np.testing.assert_array_equal(np.delete(found.t_s, 1), np.array(ROWS)[:, 0])
    np.testing.assert_array_equal(np.delete(found.q, 1, axis=0), np.array(ROWS)[:, 1:3])


def test_separators_left_at_the_end_are_no_columns(tmp_path):
    """Spreadsheets write such separators, with a header and without."""
    file = tmp_path / "a.csv"
    file.write_text("\n".join(line + ";;;" for line in text(";", ",").splitlines()))
    assert_is_rows(read_recording(file))
    file.write_text("\n".join(line + ";;;" for line in text(";", ",", header=False).splitlines()))
    assert_is_rows(read_recording(file, SPEC))


def test_other_columns_may_hold_anything(tmp_path):
    """Columns that are not read may have times of day, words and empty fields."""
    file = tmp_path / "a.csv"
    lines = text().splitlines()
    file.write_text("\n".join([f"{lines[0]},when,payload,ok", *(f"{line},2022-10-26T08:17:21Z,1.5,True" for line in lines[1:])]))
    recording = read_recording(file)
    assert_is_rows(recording)
    assert recording.context.payload_kg == 1.5


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
@pytest.mark.parametrize("between", [" ", "T"])
def test_a_date_and_time_is_a_time(tmp_path, zone, between):
    """Databases and data frames export such a column. A row whose date is torn stays, and counts as torn."""
    lines = text().splitlines()
    at = [f"2026-11-23{between}06:04:{15 + row[0]:09.6f}{zone}" for row in ROWS]
    torn = "2026-11-2" + lines[1][lines[1].index(",") :]
    file = tmp_path / "a.csv"
    file.write_text("\n".join([lines[0], *(when + line[line.index(",") :] for when, line in zip(at, lines[1:], strict=True)), torn]))
    recording = read_recording(file)
    np.testing.assert_allclose(np.diff(recording.t_s[:-1]), np.diff(ROWS[:, 0]), atol=1e-6)
    assert np.isnan(recording.t_s[-1])
    np.testing.assert_array_equal(recording.q[:-1], ROWS[:, 1:3])


def test_torn_rows_survive_reading_as_nan(tmp_path):
    """A row is too short, too long, or has a word or an empty field. It stays, so that it can be counted, and other rows are unchanged."""
    good = text(header=False).splitlines()
    torn = ["0.1,0.2,0.3", "0,0,0,0,0,0,0,0,0", "0,0,zero,0,0,0,0", "0,0,,0,0,0,0"]
    file = tmp_path / "a.csv"
    file.write_text("\n".join([good[0], *torn, good[1], good[2], "2.0,0.1"]))
    recording = read_recording(file, SPEC)
    assert recording.samples == 8
    assert np.isnan(recording.q).any(axis=1).tolist() == [False, True, True, True, True, False, False, True]
    np.testing.assert_array_equal(recording.q[[0, 5, 6]], ROWS[:, 1:3])


def make(tmp_path, content):
    file = tmp_path / "bad"
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif content is not None:
        file.write_text(content)
    return file


@pytest.mark.parametrize(
    ("content", "columns", "message"),
    [
        (None, None, "no such file"),
        ("", None, "is empty"),
        (",".join(HEADER), None, "holds a header and no rows"),
        (text(header=False), None, r"no header; say what its 7 columns are, e.g. --columns"),
        (text(header=False), "timestamp,actual_q:2", r"rows have 7 columns, --columns timestamp,actual_q:2 names 3"),
        (text(header=False), SPEC + ",skip:9", r"rows have 7 columns, --columns .* names 16"),
        (text(), "timestamp,actual_q:2,speed:2,skip:2", r"'speed' is not known; known are timestamp, .*actual_q, .*skip"),
        (text(), "actual_q:2,skip:5", "timestamp and actual_q:N are needed"),
        (text(), "timestamp,actual_qd:6", "timestamp and actual_q:N are needed"),
        (text(), "timestamp,actual_q:2,actual_qd:1,skip:3", "actual_qd has 1 columns, actual_q has 2"),
        (text(), "timestamp,actual_q:two", r"'actual_q:two'; expected NAME or NAME:COUNT"),
        (text(), "timestamp:2,actual_q:2,skip:3", "timestamp is one column, once"),
        (text().replace("actual_q_", "joint_"), None, "holds no joint positions .* it names timestamp, joint_0"),
        (text().replace("timestamp", "when"), None, "holds no column timestamp"),
        (text().replace("actual_qd_1", "actual_qd_3"), None, "actual_qd has the indices 0, 3; expected 0 … 1"),
        (
            "\n".join([text().splitlines()[0], *("08:15:0" + line for line in text(header=False).splitlines())]),
            None,
            "the times are no numbers, such as '08:15:0-1.000'; expected seconds",
        ),
        (b"PAR1 and then nothing", None, "not readable Parquet"),
        (b"\x7fELF\0\0\0", None, "is binary, and not Parquet.* export it as CSV"),
        pytest.param(
            gzip.compress(text().encode()), None, "is binary, and not Parquet.* unpack it first", id="gzip"
        ),  # its bytes hold the time
    ],
)
def test_a_file_that_is_no_recording_is_refused_with_the_reason(tmp_path, content, columns, message):
    """BadInput with exit code 2 names the mistake, its place, and what would be right."""
    with pytest.raises(BadInput, match=message) as refusal:
        read_recording(make(tmp_path, content), columns)
    assert refusal.value.exit_code == 2


def test_a_folder_is_no_recording(tmp_path):
    """The message says that it is a folder."""
    with pytest.raises(BadInput, match="is a folder"):
        read_recording(tmp_path)


def test_parquet_without_positions_or_numbers_is_refused(tmp_path):
    """The message names what is missing."""
    pd.DataFrame({"a": [1.0]}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(BadInput, match="holds no joint positions"):
        read_recording(tmp_path / "a.parquet")
    pd.DataFrame({"timestamp": [0.0], "actual_q_0": ["zero"]}).to_parquet(tmp_path / "b.parquet")
    with pytest.raises(BadInput, match="column actual_q_0 does not hold numbers"):
        read_recording(tmp_path / "b.parquet")


def test_parquet_with_a_list_in_each_row_is_read_as_one_column_a_joint(tmp_path):
    """Loggers write RTDE's vectors so; a row without a list stays, as NaN."""
    lists = [row.tolist() for row in ROWS[:, 1:3]]
    pd.DataFrame({"timestamp": ROWS[:, 0], "actual_q": [*lists[:-1], None], "names": [["a", "b"]] * len(ROWS)}).to_parquet(
        tmp_path / "a.parquet"
    )
    recording = read_recording(tmp_path / "a.parquet")
    np.testing.assert_array_equal(recording.q[:-1], ROWS[:-1, 1:3])
    assert np.isnan(recording.q[-1]).all()


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize(("begin", "zone"), [(None, None), ("2026-11-23T06:04:15", None), ("2026-11-23T06:04:15", "UTC")])
def test_times_of_parquet_are_seconds_whatever_their_unit(tmp_path, unit, zone, begin):
    """Data frames and databases write dates or spans so; where one is missing, the row stays, as NaN."""
    spans = np.round(1e3 * ROWS[:, 0]).astype("timedelta64[ms]").astype(f"timedelta64[{unit}]")
    spans[-1] = np.timedelta64("NaT")
    times = pd.Series(spans) if begin is None else pd.Series(np.datetime64(begin) + spans).dt.tz_localize(zone)
    pd.DataFrame({"timestamp": times, "actual_q_0": ROWS[:, 1]}).to_parquet(tmp_path / "a.parquet")
    t_s = read_recording(tmp_path / "a.parquet").t_s
    began_s = 0.0 if begin is None else 1_795_413_855.0
    np.testing.assert_allclose(t_s[:-1] - began_s, ROWS[:-1, 0], atol=5e-4)
    assert np.isnan(t_s[-1])


def test_columns_name_those_of_parquet_too_where_its_names_do_not(tmp_path):
    """By their order, as in text. Parquet in RTDE's names is read by these: beside it, the same `--columns` may be for another file."""
    table = pd.DataFrame(ROWS, columns=list("tabcdef"))
    table.to_parquet(tmp_path / "a.parquet")
    assert_is_rows(read_recording(tmp_path / "a.parquet", SPEC))
    with pytest.raises(BadInput, match=r"has 7 columns, --columns timestamp,actual_q:2 names 3"):
        read_recording(tmp_path / "a.parquet", "timestamp,actual_q:2")
    table.columns = HEADER
    table.to_parquet(tmp_path / "b.parquet")
    assert_is_rows(read_recording(tmp_path / "b.parquet", "timestamp,actual_q:6"))
