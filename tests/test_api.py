"""The Python interface: what a program or a notebook gives and gets, and what it reads where it gives something wrong."""

import dataclasses
import json
import subprocess
import sys
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import monitor.api as jm
from monitor.identify.identify import identify
from monitor.model.robot import Mounting, load_robot
from monitor.store.formats.columns import named_columns

ROOT = Path(__file__).parents[1]
ROOMS_C = (12.0, 22.0, 32.0)


@pytest.fixture(scope="module")
def replays():
    """A simulated UR5 on three days."""
    return jm.simulated("ur5", ROOMS_C, seed=3)


@pytest.fixture(scope="module")
def course(replays):
    return jm.assess(replays, "ur5")


def frame(recording):
    """Its signals as a DataFrame with RTDE's names."""
    return pd.DataFrame(named_columns(recording))


def same(one, other):
    for name, signal in one.signals.items():
        assert np.array_equal(signal, other.signals[name], equal_nan=True), name


def test_a_recording_is_read_alike_from_a_file_a_frame_arrays_lists_and_lists_in_cells(replays, tmp_path):
    """The same signals, whichever way they come."""
    given = replays[0]
    table = frame(given)
    jm.write(tmp_path / "a.parquet", given)
    same(given, jm.read(tmp_path / "a.parquet"))
    same(given, jm.read(str(tmp_path / "a.parquet")))
    same(given, jm.read(table))
    same(given, jm.read(table.set_index("timestamp")))
    same(given, jm.read({name: values.tolist() for name, values in table.items()}))
    same(given, jm.read(given))
    few = jm.read({"timestamp": given.t_s, "actual_q": given.q.tolist(), "actual_current": given.current})
    assert np.array_equal(few.q, given.q)
    assert np.array_equal(few.current, given.current)
    masked = np.ma.array(given.current, mask=np.arange(given.current.size).reshape(given.current.shape) % 7 == 3).copy()
    masked.data[masked.mask] = 1e3  # what stands below the mask is no reading
    seen = jm.read({"timestamp": given.t_s, "actual_q": given.q, "actual_current": masked})
    assert np.array_equal(seen.current, np.ma.filled(masked, np.nan), equal_nan=True)
    in_cells = pd.DataFrame({"timestamp": given.t_s, "actual_q": list(given.q), "actual_current": list(given.current)})
    assert np.array_equal(jm.read(in_cells).q, given.q)
    table.columns = [f"c{k}" for k in range(table.shape[1])]
    columns = ",".join(named_columns(given))
    same(given, jm.read(table, columns=columns))


def test_times_as_dates_say_when_a_recording_was_made(replays):
    """A column of dates, or an index of dates; with a zone, and in UTC without one."""
    given = replays[0]
    at = pd.to_datetime(1_790_000_000.0 + given.t_s, unit="s")
    for stamped in (
        frame(given).assign(timestamp=at),
        frame(given).drop(columns="timestamp").set_index(at),
        frame(given).assign(timestamp=at.tz_localize("UTC").tz_convert("Europe/Berlin")),
    ):
        found = jm.read(stamped)
        assert found.context.recorded_at_unix_s == pytest.approx(1_790_000_000.0 + given.t_s[0], abs=1e-5)
        assert np.allclose(np.diff(found.t_s), np.diff(given.t_s), atol=1e-6)
    without_first = frame(given).assign(timestamp=at.where(np.arange(len(at)) > 0))
    assert jm.read(without_first).context.recorded_at_unix_s == pytest.approx(1_790_000_000.0 + given.t_s[1], abs=1e-5)
    for moment in ("2026-01-31T03:00:00Z", datetime(2026, 1, 31, 3, tzinfo=UTC), datetime(2026, 1, 31, 3), pd.Timestamp("2026-01-31 03:00"),  # noqa: DTZ001
                   np.datetime64("2026-01-31T03:00"), 1_769_828_400, 1_769_828_400.0):  # fmt: skip
        assert jm.read(given, recorded_at=moment).context.recorded_at_unix_s == 1_769_828_400.0
    assert jm.read(given, recorded_at=date(2026, 1, 31)).context.recorded_at_unix_s == 1_769_817_600.0


def test_an_identification_is_that_of_the_command_from_one_recording_or_several(replays):
    """One without a list, a list, a frame, the name of the arm or the arm."""
    known = identify([replays[0]], load_robot("ur5"), Mounting())
    for found in (
        jm.identify(replays[0], "ur5"),
        jm.identify([frame(replays[0])], jm.robot("ur5"), mounting=[0, 0, 0]),
        jm.identify(replays[0], load_robot("ur5"), mounting="ground", gains=load_robot("ur5").drive_gain_nm_per_a.tolist()),
    ):
        assert np.array_equal(found.coulomb_nm, known.coulomb_nm)
    both = jm.identify(replays[:2], "ur5")
    assert [source.samples for source in both.sources] == [each.samples for each in replays[:2]]


def test_a_course_gives_a_frame_and_torque_at_any_temperature_that_is_the_arms(replays, course):
    """Friction at 12 °C is larger than at 32 °C, and the torque of a replay at its temperature is what was measured, within 10 %."""
    rows = course.friction
    assert list(rows["joint"]) == [1, 2, 3, 4, 5, 6] * 3
    assert rows["recorded_at"].dt.tz is not None
    assert np.all(np.isfinite(rows[["wear", "wear_std", "temperature_c"]].to_numpy(dtype=float)))
    assert not course.alerts
    assert str(course.last.health.state) == "NORMAL"
    cold, warm = course.model.friction(15.0), course.model.friction([35.0] * 6)
    assert np.all(cold.viscous_nm_s_per_rad > 1.1 * warm.viscous_nm_s_per_rad)
    assert np.all(cold.viscous_std_nm_s_per_rad > 0.0)
    one = course.model.torque([0, -1, 1, 0, 0, 0], [0.5] * 6, temperature_c=12)
    assert one.torque.shape == (6,)
    assert np.all(one.std > 0.0)
    given = replays[1]
    several = course.model.torque(given.q, given.qd, given.target_qdd, given.temperature_c)
    assert several.torque.shape == given.q.shape
    measured = given.current * course.robot.drive_gain_nm_per_a
    wrong, size = (np.sqrt(np.mean(np.where(np.abs(given.qd) > 0.05, x, 0.0) ** 2, axis=0)) for x in (measured - several.torque, measured))
    assert np.all(wrong < 0.1 * size)  # half of it is the noise of single samples


def test_times_of_a_series_are_given_as_datetimes_or_an_interval(replays):
    """And a recording that says no time asks for one of these."""
    undated = [frame(each) for each in replays[:2]]
    days = [datetime(2026, 3, 1, tzinfo=UTC), pd.Timestamp("2026-03-02")]
    by_time, by_interval = jm.assess(undated, "ur5", recorded_at=days), jm.assess(undated, "ur5", interval="1d")
    assert [each.outcome.recorded_at_unix_s for each in by_time.verdicts] == [1_772_323_200.0, 1_772_409_600.0]
    assert np.array_equal(by_time.friction["wear"], by_interval.friction["wear"])
    assert len(jm.assess(replays[0], "ur5").verdicts) == 1


def test_pictures_are_figures_and_files(replays, course, tmp_path):
    """A panel a joint; written where a path is given."""
    figure = jm.plot_friction(course, tmp_path / "friction.png")
    assert [axes.get_title() for axes in figure.axes] == [f"joint {j}" for j in range(1, 7)]
    assert (tmp_path / "friction.png").read_bytes().startswith(b"\x89PNG")
    jm.plot_residuals(jm.identify(replays[0], "ur5"), replays[0], "ur5", tmp_path / "residuals.html")
    assert "<svg" in (tmp_path / "residuals.html").read_text("utf-8")


ROWS = {"timestamp": [0.0, 1.0], "actual_q": [[0.0] * 6] * 2}
WRONG = {
    "no file": (lambda _: jm.read("nowhere.csv"), "no such file"),
    "a number": (lambda _: jm.read(3), "expected a file, a DataFrame, or a mapping"),
    "a list": (lambda _: jm.read([1, 2]), "expected a file, a DataFrame, or a mapping"),
    "without positions": (lambda _: jm.read(pd.DataFrame({"timestamp": [0.0], "speed": [1.0]})), "no joint positions"),
    "texts": (lambda _: jm.identify(ROWS | {"actual_current": [["a"] * 6] * 2}, "ur5"), "table: "),
    "ragged": (lambda _: jm.read({"timestamp": [0.0, 1.0], "actual_q": [[0.0] * 6, [0.0] * 5]}), "table: "),
    "other lengths": (lambda _: jm.read(ROWS | {"timestamp": [0.0]}), "table: "),
    "mixed": (lambda _: jm.read(pd.DataFrame({"timestamp": ["a", 1.0]})), "table: "),
    "other robot": (lambda r: jm.identify(r[0], "ur9"), "ur9"),
    "no robot": (lambda r: jm.identify(r[0], None), "robot: NoneType given"),
    "a folder": (lambda r: jm.identify(r[0], Path("/")), "ur5"),
    "another arm": (lambda r: jm.identify(r[0], "ur3"), "recorded on a ur5"),
    "no recording": (lambda _: jm.identify([], "ur5"), "no recording was given"),
    "nothing": (lambda _: jm.identify(None, "ur5"), "NoneType given"),
    "gains": (lambda r: jm.identify(r[0], "ur5", gains=[1.0, 2.0]), "gains has shape (2,); expected (6,)"),
    "gains in words": (lambda r: jm.identify(r[0], "ur5", gains="many"), "gains is 'many'; expected numbers"),
    "mounting": (lambda r: jm.identify(r[0], "ur5", mounting="table"), "mounting 'table'"),
    "two angles": (lambda r: jm.identify(r[0], "ur5", mounting=[0.0, 1.0]), "mounting has shape (2,)"),
    "method": (lambda r: jm.identify(r[0], "ur5", method="magic"), "method 'magic' is not known"),
    "twice": (lambda r: jm.identify([r[0], r[0]], "ur5"), "once more"),
    "no time": (lambda r: jm.assess(frame(r[0]), "ur5"), "recording 1 does not say when it was made"),
    "times": (lambda r: jm.assess(r, "ur5", recorded_at=["2026-01-01"]), "1 times for 3 recordings"),
    "a time": (lambda r: jm.read(r[0], recorded_at="yesterday"), "recorded_at is 'yesterday'"),
    "not a time": (lambda r: jm.read(r[0], recorded_at=pd.NaT), "recorded_at"),
    "one moment": (lambda r: jm.assess(r[:2], "ur5", recorded_at=["2026-01-01"] * 2), "at the same time"),
    "interval": (lambda r: jm.assess(r, "ur5", interval="daily"), "--interval 'daily'"),
    "both times": (lambda r: jm.assess(r, "ur5", recorded_at=["2026-01-01"] * 3, interval="1d"), "recorded_at or interval, not both"),
    "an interval as a figure": (lambda r: jm.assess(r, "ur5", interval=5), "int given; expected an interval such as '1d'"),
    "after all calendars": (lambda r: jm.read(r[0], recorded_at=1e30), "recorded_at is 1e+30; expected a time"),
    "a rate in words": (lambda r: jm.read(frame(r[0]), rate_hz="fast"), "rate_hz is 'fast'; expected numbers"),
    "a payload in words": (lambda r: jm.read(r[0], payload_kg="heavy"), "payload_kg is 'heavy'; expected numbers"),
    "no payload": (lambda r: jm.read(r[0], payload_kg=np.nan), "payload_kg is nan; expected 0 … 1000 kg"),
    "less than nothing": (lambda r: jm.read(r[0], payload_kg=-1.0), "payload_kg is -1.0; expected 0 … 1000 kg"),
    "no angle": (
        lambda r: jm.identify(r[0], "ur5", mounting=[0.0, np.nan, 0.0]),
        "mounting is [0.0, nan, 0.0]; expected -360 … 360 degrees",
    ),
    "rigid": (lambda r: jm.identify(r[0], "ur5", rigid_from="x"), "str given; expected an identification"),
    "backwards": (lambda r: jm.identify(r[0], "ur5").friction_at(-0.4), "friction at -0.4 rad/s was asked for; expected a positive speed"),
    "nothing to draw": (lambda r: jm.plot_residuals(jm.identify(r[0], "ur5"), [], "ur5"), "no recording was given"),
    "nothing to write": (lambda _: jm.write("x.parquet", None), "NoneType given; expected a recording"),
    "a file of no disk": (
        lambda r: jm.plot_residuals(jm.identify(r[0], "ur5"), r[0], "ur5", "/proc/x.png"),
        "/proc/x.png: cannot be written",
    ),
    "no endpoint": (lambda _: jm.Client("x", "hall", "cell"), "Endpoints must be of the form"),
    "none given": (lambda _: jm.assess([], "ur5"), "none was given"),
    "no course": (lambda r: jm.plot_friction(jm.identify(r[0], "ur5")), "Identification given; expected a course"),
    "no identification": (lambda r: jm.plot_residuals(r[0], r, "ur5"), "Recording given; expected an identification"),
    "a room": (lambda _: jm.simulated("ur5", [99.0]), "ambient_c"),
    "a model": (lambda _: jm.simulated("ur9"), "ur9"),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_what_is_wrong_is_said_by_bad_input(replays, mistake):
    """One sentence that names it, and no error of numpy, pandas or pyarrow."""
    call, said = WRONG[mistake]
    with pytest.raises(jm.BadInput) as refused:
        call(replays)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([0] * 5, [0] * 6), "q has shape"),
        (([0] * 6, "fast"), "qd is 'fast'; expected numbers"),
        (([0] * 6, [np.nan] * 6), "not finite"),
        (([0] * 6, [0] * 6, None, [20, 30]), "temperature_c has shape (2,)"),
        (([[0] * 6] * 2, [[0] * 6] * 3), "qd has shape (3, 6)"),
        (([0] * 6, [0] * 6, None, -300), "temperature_c is -300; expected -40 … 120 °C"),
        (([0] * 6, [0] * 6, None, np.nan), "temperature_c is nan; expected -40 … 120 °C"),
    ],
)
def test_a_state_that_is_none_is_refused(course, arguments, said):
    """By name and shape."""
    with pytest.raises(jm.BadInput) as refused:
        course.model.torque(*arguments)
    assert said in str(refused.value)


def test_what_the_interface_names_exists_and_is_explained():
    """`__all__` has every public name, and each function and class has a docstring."""
    public = {name for name, value in vars(jm).items() if getattr(value, "__module__", "").startswith("monitor.api") and name[0] != "_"}
    assert public <= set(jm.__all__)
    assert all(getattr(jm, name).__doc__ for name in public)
    assert {field.name for field in dataclasses.fields(jm.Course)} == {"robot", "verdicts"}


USER = """
from datetime import UTC, datetime

import numpy as np
import pandas as pd

import monitor.api as jm

frame = pd.DataFrame({"timestamp": [0.0]})
try:
    recording: jm.Recording = jm.read(frame, recorded_at=datetime.now(UTC))
    found = jm.identify(recording, "ur5", gains=[1.0] * 6)
    fc: float = float(found.coulomb_nm[0])
    course = jm.assess([recording, "a.csv"], "ur5", interval="1d")
    torque = course.model.torque([0.0] * 6, np.zeros(6), temperature_c=12.0)
    print(torque.torque + torque.std, course.friction["wear"], fc)
    jm.plot_friction(course, "fv.png")
except jm.BadInput as wrong:
    print(wrong)
with jm.Client("tcp/127.0.0.1:7447", "hall", "cell") as client:
    print(client.torque(q=[0.0] * 6, qd=np.zeros(6)).torque_nm)
    reveal_type(client)
    client.no_such_method()
"""


@pytest.mark.slow
def test_a_users_script_is_checked_by_mypy_strict(tmp_path):
    """The package is typed for others: what is right passes, a method that does not exist is found."""
    (tmp_path / "script.py").write_text(USER)
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "script.py"]
    checked = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=110, check=False)
    errors = [line for line in checked.stdout.splitlines() if "error:" in line]
    assert len(errors) == 1, checked.stdout
    assert '"Client" has no attribute "no_such_method"' in errors[0]
    assert 'Revealed type is "monitor.publish.client.Client"' in checked.stdout


@pytest.mark.slow
def test_the_notebook_runs():
    """`docs/notebook.ipynb`, cell by cell in one process: from the replays of a simulated arm to fv(T) and to torque at 12 °C."""
    notebook = json.loads((ROOT / "docs/notebook.ipynb").read_text("utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    done = subprocess.run([sys.executable, "-c", "\n".join(cells)], cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr
    assert "12 °C" in done.stdout


def test_a_package_that_a_format_needs_and_is_absent_is_bad_input(tmp_path, monkeypatch):
    bag = tmp_path / "drive.db3"
    bag.write_bytes(b"SQLite format 3\0" + b"\0" * 100)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(jm.BadInput, match="needs the package rosbags, which is not installed here"):
        jm.read(bag)
