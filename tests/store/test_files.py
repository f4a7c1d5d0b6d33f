"""Recordings as files: written ones are read back exactly, files of others are read or refused with the reason."""

import bz2
import gzip
import lzma
from dataclasses import fields

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

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


def test_names_may_hold_blanks_and_units(tmp_path):
    """Names that are not RTDE's, but the separator is seen, so that --columns can say what they mean."""
    names = ["time [s]", *(f"position {j} [rad]" for j in range(1, 7))]
    rows = "\n".join(",".join(f"{k + 0.1 * j:.1f}" for j in range(7)) for k in range(3))
    (tmp_path / "a.csv").write_text(",".join(names) + "\n" + rows)
    recording = read_recording(tmp_path / "a.csv", "timestamp=time [s],actual_q=position {1..6} [rad]")
    assert recording.t_s.tolist() == [0.0, 1.0, 2.0]
    assert recording.q[2].tolist() == [2.1, 2.2, 2.3, 2.4, 2.5, 2.6]


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
        (text().replace("actual_q_", "joint_"), None, "holds no joint positions .* it names timestamp, joint_{0..1}"),
        (text().replace("timestamp", "when"), None, "holds no column timestamp"),
        (text().replace("actual_qd_1", "actual_qd_3"), None, "actual_qd has the indices 0, 3; expected 0 … 1"),
        (
            "\n".join([text().splitlines()[0], *("at " + line for line in text(header=False).splitlines())]),
            None,
            "the times are no numbers, such as 'at -1.000'; expected seconds",
        ),
        (b"PAR1 and then nothing", None, "not readable Parquet"),
        (b"\x7fELF\0\0\0", None, "is binary, and not Parquet.* export it as CSV"),
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
    with pytest.raises(BadInput, match="actual_q of joint 1 holds no number in any row"):
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


def test_columns_say_what_parquet_holds_whatever_its_names(tmp_path):
    """By their order, as in text: whoever says so knows that the measured current is in iq, and what actual_current is."""
    table = pd.DataFrame(ROWS, columns=list("tabcdef"))
    table.to_parquet(tmp_path / "a.parquet")
    assert_is_rows(read_recording(tmp_path / "a.parquet", SPEC))
    with pytest.raises(BadInput, match=r"has 7 columns, --columns timestamp,actual_q:2 names 3"):
        read_recording(tmp_path / "a.parquet", "timestamp,actual_q:2")
    table.columns = HEADER
    for name in ("b.parquet", "b.csv"):
        table.to_csv(tmp_path / name, index=False) if name.endswith("csv") else table.to_parquet(tmp_path / name)
        found = read_recording(tmp_path / name, "timestamp,actual_q:2,skip:2,actual_torque:2")
        assert set(found.signals) == {"t_s", "q", "torque"}
        with pytest.raises(BadInput, match="'foo' is not known"):
            read_recording(tmp_path / name, "foo,bar")


def test_columns_for_other_files_leave_our_own_as_they_were_written(tmp_path):
    """A command may name a log of a foreign layout beside a replay of this program; what fits no file is refused."""
    write_recording(tmp_path / "own.parquet", full(0, 9))
    found = read_recording(tmp_path / "own.parquet", SPEC)
    assert found.signals.keys() == full(0, 9).signals.keys()
    assert [reason.code for reason in found.told] == ["columns_as_written"]
    with pytest.raises(BadInput, match="'foo' is not known"):
        read_recording(tmp_path / "own.parquet", "foo,bar")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_columns_are_named_instead_of_counted(tmp_path, kind):
    """With {1..6} as a shell has it; what the file names itself in RTDE's names needs no mention, and NAME= is not read."""
    names = ["time", "pos_1", "pos_2", "x", "vel_1", "vel_2", "i_elbow", "i_wrist", "actual_torque_0", "actual_torque_1"]
    table = pd.DataFrame(np.column_stack([ROWS[:, :3], ROWS[:, 0], ROWS[:, 3:], ROWS[:, 1:3]]), columns=names)
    file = tmp_path / f"a.{kind}"
    table.to_csv(file, index=False) if kind == "csv" else table.to_parquet(file)
    spec = "timestamp=time, actual_q=pos_{1..2},actual_qd=vel_{1,2},actual_current=i_{elbow,wrist}"
    found = read_recording(file, spec)
    assert_is_rows(found)
    np.testing.assert_array_equal(found.torque, ROWS[:, 1:3])
    assert read_recording(file, f"{spec},actual_torque=").torque is None
    np.testing.assert_array_equal(read_recording(file, spec.replace("pos_{1..2}", "pos_{2..1}")).q, ROWS[:, [2, 1]])


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("timestamp=time,actual_q=poss_{1..2}", r"the column 'poss_1' is not there; most like it are pos_1"),
        ("timestamp=time,actual_q=pos_{1..2},actual_qd", "'actual_qd' stands beside parts with ="),
        ("timestamp=time,actual_q=pos_{1..2},speed=vel_{1..2}", "'speed' is not known"),
        ("timestamp=time,actual_q=pos_{1..2},actual_qd=vel_1", "actual_qd has the indices 0; expected 0 … 1"),
        ("timestamp=time,actual_q=pos_{1..2},actual_current=target_current_{0..1}", "is what the controller wanted"),
        ("timestamp=time,actual_q=twice", "the column 'twice' is there twice"),
        ("timestamp=time", r"holds no joint positions"),
        ("actual_q=pos_{1..2}", r"holds no column timestamp; it names time, .*--columns timestamp=time; .*--rate 125"),
        ("timestamp=time,actual_q=pos_{1..99999}", "are too many"),
    ],
)
def test_names_that_are_wrong_are_refused(tmp_path, spec, message):
    """With what is there, and what would be right."""
    names = ["time", "pos_1", "pos_2", "vel_1", "vel_2", "twice", "twice", "target_current_0", "target_current_1"]
    (tmp_path / "a.csv").write_text(",".join(names) + "\n0,1,2,3,4,5,6,7,8\n")
    with pytest.raises(BadInput, match=message):
        read_recording(tmp_path / "a.csv", spec)


def written_twice(tmp_path, kind, names):
    rows = np.column_stack([ROWS, 0.9 * ROWS[:, 5:7]])
    file = tmp_path / f"a.{kind}"
    if kind == "csv":
        file.write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in rows.tolist())]))
    else:
        pq.write_table(pa.Table.from_arrays([pa.array(column) for column in rows.T], names=names), file)
    return file


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("again", ["actual_current_{}", "actual_current[{}]", "actual_current{}"])
def test_a_name_that_stands_twice_is_refused(tmp_path, kind, again):
    """Whichever is read would be a guess. The columns may be said in order."""
    file = written_twice(tmp_path, kind, [*HEADER, again.format(0), again.format(1)])
    with pytest.raises(BadInput, match=r"names actual_current.?0.? twice, in the columns 6 and 8"):
        read_recording(file)
    assert_is_rows(read_recording(file, f"{SPEC},skip:2"))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_two_names_of_one_signal_are_refused(tmp_path, kind):
    """Torque is actual_torque or actual_current_as_torque: one of them is left out by name."""
    names = [*HEADER[:5], "actual_torque_0", "actual_torque_1", "actual_current_as_torque_0", "actual_current_as_torque_1"]
    file = written_twice(tmp_path, kind, names)
    with pytest.raises(BadInput, match="actual_torque and actual_current_as_torque, which are one signal; leave one out"):
        read_recording(file)
    np.testing.assert_array_equal(read_recording(file, "actual_torque=").torque, 0.9 * ROWS[:, 5:7])


def test_a_time_that_stands_twice_is_refused(tmp_path):
    """As any other name."""
    (tmp_path / "a.csv").write_text("timestamp,actual_q_0,timestamp\n0,1,2\n")
    with pytest.raises(BadInput, match="names timestamp twice, in the columns 1 and 3"):
        read_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("named", ["actual_dq_{}", "qd_actual_{}", "Actual_QD_{}"])
def test_columns_with_the_letters_of_the_speeds_are_taken_for_them_and_this_is_told(tmp_path, named):
    """So that a wrong clock is seen; the sentence says how to leave them out."""
    names = [named.format(name[-1]) if "_qd_" in name else name for name in HEADER]
    (tmp_path / "a.csv").write_text(text().replace(",".join(HEADER), ",".join(names)))
    found = read_recording(tmp_path / "a.csv")
    (reason,) = found.told
    assert reason.code == "names_taken"
    assert_is_rows(found)
    assert read_recording(tmp_path / "a.csv", reason.text.split("--columns ")[1]).qd is None


@pytest.mark.parametrize("named", ["actual_qvel_{}", "speed{}", "joint_{}_velocity", "V_{}"])
def test_columns_that_may_be_the_speeds_are_told_as_not_read(tmp_path, named):
    """Without speeds nobody would see a wrong clock; the sentence says what to type."""
    names = [named.format(name[-1]) if "_qd_" in name else name for name in HEADER]
    (tmp_path / "a.csv").write_text(text().replace(",".join(HEADER), ",".join(names)))
    (reason,) = read_recording(tmp_path / "a.csv").told
    assert reason.code == "names_not_read"
    option = reason.text.split("--columns ")[1]
    assert option == f"actual_qd={named.format('{0..1}')}"
    assert_is_rows(read_recording(tmp_path / "a.csv", option))


def test_a_temperature_and_a_torque_of_near_names_are_told_and_other_columns_are_not(tmp_path):
    """A file may hold anything beside what is read."""
    extra = ["joint_temperature_0", "joint_temperature_1", "actual_TCP_pose_0", "actual_TCP_pose_1", "din_0", "din_1"]
    lines = text().splitlines()
    (tmp_path / "a.csv").write_text("\n".join([",".join([lines[0], *extra]), *(f"{line},30,31,0,0,1,0" for line in lines[1:])]))
    (reason,) = read_recording(tmp_path / "a.csv").told
    assert reason.parameters["names"] == ("joint_temperature_{0..1}",)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_rows_without_a_time_are_read_at_a_rate(tmp_path, kind):
    """Only where no time is there, or it is left out by name."""
    file = tmp_path / f"a.{kind}"
    table = pd.DataFrame(ROWS, columns=HEADER)
    write = table.to_csv if kind == "csv" else table.to_parquet
    write(file, index=False)
    with pytest.raises(BadInput, match="tells times, and --rate is for rows without one"):
        read_recording(file, rate_hz=125.0)
    np.testing.assert_array_equal(read_recording(file, "timestamp=", 125.0).t_s, np.arange(3) / 125.0)
    np.testing.assert_array_equal(read_recording(file, "skip,actual_q:2,skip:4", 100.0).t_s, np.arange(3) / 100.0)
    for rate_hz in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(BadInput, match="expected the rows a second"):
            read_recording(file, "timestamp=", rate_hz)


def test_columns_of_text_in_parquet_are_read_as_those_of_csv(tmp_path):
    """A mode in words is no number, and no reason to refuse; numbers, categories and times that are written as text are what they say."""
    table = pd.DataFrame(ROWS, columns=HEADER)
    table["actual_q_0"] = [f"{value:.3f}".replace(".", ",") for value in table["actual_q_0"]]
    table["actual_q_1"] = table["actual_q_1"].astype(str).astype("category")
    table["robot_mode"], table["payload"] = "RUNNING", "none"
    table["safety_mode"] = [True, None, False]
    table.to_parquet(tmp_path / "a.parquet")
    found = read_recording(tmp_path / "a.parquet")
    assert_is_rows(found)
    assert np.isnan(found.robot_mode).all()
    np.testing.assert_array_equal(found.safety_mode, [1.0, np.nan, 0.0])
    table["timestamp"] = [f"2026-11-23T06:04:{15 + second}Z" for second in range(3)]
    table.to_parquet(tmp_path / "b.parquet")
    np.testing.assert_array_equal(np.diff(read_recording(tmp_path / "b.parquet").t_s), 1.0)


PACK = {"gz": gzip.compress, "bz2": bz2.compress, "xz": lzma.compress, "zst": lambda content: pa.compress(content, "zstd", asbytes=True)}


@pytest.mark.parametrize("packed", PACK)
def test_what_is_packed_is_read(tmp_path, packed):
    """CSV and Parquet, by what the file holds and whatever its name."""
    pd.DataFrame(ROWS, columns=HEADER).to_parquet(tmp_path / "a.parquet")
    for content in (text().encode(), (tmp_path / "a.parquet").read_bytes()):
        (tmp_path / "a").write_bytes(PACK[packed](content))
        assert_is_rows(read_recording(tmp_path / "a"))
        (tmp_path / "a").write_bytes(PACK[packed](content)[:-9])
        with pytest.raises(BadInput, match="is packed and damaged"):
            read_recording(tmp_path / "a")


@pytest.mark.parametrize("packed", PACK)
def test_what_unpacks_to_more_than_a_recording_is_refused(tmp_path, packed):
    """Before it fills the memory."""
    line = b"0,0,0,0,0,0,0\n"
    (tmp_path / "a").write_bytes(PACK[packed](text().encode() + line * 1_000_000))
    with pytest.raises(BadInput, match="unpacks to more than 32 times"):
        read_recording(tmp_path / "a")


def test_parquet_that_unpacks_to_more_than_a_recording_is_refused(tmp_path):
    """Ten million rows of one value are a few kilobytes."""
    zeros = pa.array(np.zeros(2_000_000))
    pq.write_table(pa.table(dict.fromkeys(HEADER, zeros)), tmp_path / "a.parquet", compression="zstd")
    assert (tmp_path / "a.parquet").stat().st_size < 1e6
    with pytest.raises(BadInput, match="unpacks to more than 32 times"):
        read_recording(tmp_path / "a.parquet")


ARRAYS = {"t": ROWS[:, 0], "pos": ROWS[:, 1:3], "vel": ROWS[:, 3:5].T, "cur": ROWS[:, 5:7]}
OF_ARRAYS = "timestamp=t,actual_q=pos_{0..1},actual_qd=vel_{0..1},actual_current=cur_{0..1}"


def test_arrays_of_numpy_and_matlab_are_read(tmp_path):
    """An array with a row a sample, or a column a sample, is one column a joint of its name; the rest is passed over."""
    np.savez_compressed(tmp_path / "a.npz", **ARRAYS, names=np.array(["a", "b"], dtype=object), gain=3.0)
    assert_is_rows(read_recording(tmp_path / "a.npz", OF_ARRAYS))
    savemat(tmp_path / "a.mat", {**ARRAYS, "name": "run 3"}, do_compression=True)
    assert_is_rows(read_recording(tmp_path / "a.mat", OF_ARRAYS))
    savemat(tmp_path / "b.mat", {"log": {"timestamp": ROWS[:, 0], "actual_q": ROWS[:, 1:3]}})
    np.testing.assert_array_equal(
        read_recording(tmp_path / "b.mat", "timestamp=log.timestamp,actual_q=log.actual_q_{0..1}").q, ROWS[:, 1:3]
    )
    np.savez(tmp_path / "c.npz", timestamp=ROWS[:, 0], actual_q=ROWS[:, 1:3], actual_qd=ROWS[:, 3:5], actual_current=ROWS[:, 5:7])
    assert_is_rows(read_recording(tmp_path / "c.npz"))
    np.save(tmp_path / "d.npy", np.tile(ROWS, (3, 1)))
    np.testing.assert_array_equal(read_recording(tmp_path / "d.npy", SPEC).current[:3], ROWS[:, 5:7])
    with pytest.raises(BadInput, match=r"holds no joint positions .* it names t, pos_\{0..1\}, vel_\{0..1\}"):
        read_recording(tmp_path / "a.npz")
    (tmp_path / "e.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-40])
    with pytest.raises(BadInput, match="is not readable"):
        read_recording(tmp_path / "e.npz")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89HDF\r\n\x1a\n", "is HDF5, or MATLAB 7.3.*save.'recording.mat', '-v7'"),
        (b"MATLAB 7.3 MAT-file" + b"\0" * 500, "is MATLAB 7.3.*-v7"),
        (b"ARROW1\0\0", "is Arrow or Feather.*pandas.read_feather"),
        (b"\x80\x04\x95", "is a pickle.*pandas.read_pickle"),
        (b"PK\x03\x04[Content_Types].xml", "a spreadsheet: .*pandas.read_excel"),
    ],
)
def test_what_is_not_read_is_refused_with_the_command_that_converts_it(tmp_path, content, message):
    """One sentence that can be copied."""
    with pytest.raises(BadInput, match=message):
        read_recording(make(tmp_path, content))
