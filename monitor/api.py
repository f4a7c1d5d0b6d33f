"""joint-monitor from Python, in one module: recordings, identification, verdicts, torque at any temperature, pictures, the bus.

    import monitor.api as jm

    recording = jm.read("replay.parquet")  # or a DataFrame, or a mapping of arrays, with RTDE's names
    found = jm.identify(recording, "ur5")  # found.coulomb_nm, found.viscous_nm_s_per_rad, found.friction_at(0.4), found.warnings
    course = jm.assess([first, second, third], "ur5")
    course.friction  # a DataFrame: a row a recording and joint
    predicted = course.model.torque(q, qd, qdd, temperature_c=12.0)
    predicted.torque, predicted.std  # N·m, ± one standard deviation

An arm is the name of a model, e.g. "ur5", the path of a TOML or URDF file, or a `Robot`. A mounting is `ground`, `ceiling`, `wall`, roll,
pitch and yaw in degrees, or a `Mounting`; where none is given, that of the recording, else `ground`. Numbers are lists or arrays. Standard
deviations are one σ. What is wrong with an argument is said by `BadInput`; `Unidentifiable`, a kind of it, says that a recording holds too
little motion.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd

from monitor.config.extras import absent
from monitor.errors import BadInput, BusError, MonitorError, Unidentifiable
from monitor.identify.identification import Identification
from monitor.identify.identify import identify as _identify
from monitor.judge.alerts.health import Alert
from monitor.judge.assess import Rejected
from monitor.judge.assessment import Assessment
from monitor.judge.document import plain
from monitor.judge.settings import AssessSettings
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import TorquePrediction, predict_torque
from monitor.model.robot import Mounting, Robot
from monitor.publish.client import Client
from monitor.publish.timestamps import utc
from monitor.publish.torque import RANGES
from monitor.recording import DAY_S, Array, Recording
from monitor.store.formats.recordings import read_recording, rows_of_table, table_of, write_recording
from monitor.store.from_files.series import UNDATED_START_UNIX_S, in_order, interval_s, judged, when
from monitor.store.identify_files import arm as _arm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Arm",
    "Attitude",
    "BadInput",
    "BusError",
    "Client",
    "Course",
    "Data",
    "Friction",
    "Identification",
    "Moment",
    "MonitorError",
    "Mounting",
    "Recording",
    "Rejected",
    "Robot",
    "TorqueModel",
    "TorquePrediction",
    "Unidentifiable",
    "Verdict",
    "assess",
    "identify",
    "plot_friction",
    "plot_residuals",
    "read",
    "robot",
    "simulated",
    "write",
]

Data: TypeAlias = str | Path | pd.DataFrame | Mapping[str, npt.ArrayLike] | Recording
Arm: TypeAlias = str | Path | Robot
Attitude: TypeAlias = str | Sequence[float] | Mounting
Moment: TypeAlias = str | float | date | np.datetime64
LATEST_UNIX_S = 253_402_300_799.0  # the end of the year 9999, and of the calendars of Python
FIRST_SIMULATED_UNIX_S = 1_767_582_000.0  # Monday 2026-01-05 03:00 UTC


def robot(arm: Arm) -> Robot:
    """An arm: by the name of its model, e.g. "ur5" or "ur5e", from a TOML file of an arm of yours, or from a URDF.

    Raises BadInput where it is not known or cannot be read.
    """
    if isinstance(arm, Robot):
        return arm
    if not isinstance(arm, str | Path):
        raise BadInput(f"robot: {type(arm).__name__} given; expected a model such as 'ur5', the path of a .toml or .urdf, or a Robot")
    urdf = Path(arm) if Path(arm).suffix.lower() == ".urdf" else None
    return _arm(None if urdf else str(arm), urdf)


def read(
    data: Data,
    *,
    columns: str | None = None,
    rate_hz: float | None = None,
    recorded_at: Moment | None = None,
    payload_kg: float | None = None,
    mounting: Attitude | None = None,
    maintenance: str | None = None,
) -> Recording:
    """A recording, from a file (CSV or Parquet), a DataFrame, a mapping of arrays, or another recording.

    A table has RTDE's names: `timestamp` [s], or times as dates, or its index; `actual_q_0` … `actual_q_5` [rad], and where there are such
    `actual_qd_0` … [rad/s], `actual_current_0` … [A] or `actual_torque_0` … [N·m], `joint_temperatures_0` … [°C] and more. A mapping may
    have one array (N, J) for all joints instead: `{"timestamp": t, "actual_q": q, …}`.
    columns : where the table has other names, as the command's `--columns`: `"timestamp=time,actual_q=position_{1..6}"`, or RTDE's
    names in the order of the columns.
    rate_hz : rows a second, where it tells no time.
    recorded_at : when it was made; UTC where it names no zone. payload_kg, mounting, maintenance : what is declared of it; where nothing is
    declared, what the recording says itself. Raises BadInput.
    """
    dated_s = None
    if rate_hz is not None:
        rate_hz = float(_numbers(rate_hz, "rate_hz", ()))
    if isinstance(data, Recording):
        recording = data
    elif isinstance(data, str | Path):
        try:
            recording = read_recording(data, columns, rate_hz)
        except ModuleNotFoundError as error:  # of an extra, such as that of ROS
            raise BadInput(absent(str(error.name).partition(".")[0], f"{data}")) from None
    else:
        import pyarrow as pa

        table = table_of(data)
        recording = rows_of_table(table, "table", columns, rate_hz).recording
        if "timestamp" in table.column_names and recording.samples and pa.types.is_timestamp(table.schema.field("timestamp").type):
            dated_s = float(np.nanmin(recording.t_s))  # the rows may have any order
    said = recording.context
    return replace(
        recording,
        context=replace(
            said,
            recorded_at_unix_s=_unix_s(recorded_at) if recorded_at is not None else said.recorded_at_unix_s or dated_s,
            payload_kg=said.payload_kg if payload_kg is None else float(_within(payload_kg, "payload_kg", (0.0, 1000.0), "kg", ())),
            mounting_rad=said.mounting_rad if mounting is None else _mounting(mounting).angles_rad,
            maintenance=maintenance or said.maintenance,
        ),
    )


def write(path: str | Path, recording: Recording) -> None:
    """Write a recording as Parquet, with its context; `read` reads it. Raises MonitorError where the disk refuses."""
    _is(recording, Recording, "a recording, as read gives it")
    write_recording(path, recording)


def identify(
    recordings: Data | Sequence[Data],
    arm: Arm,
    *,
    mounting: Attitude | None = None,
    method: str = "wls",
    friction: str = "paper",
    gains: npt.ArrayLike | None = None,
    rigid_from: Identification | None = None,
) -> Identification:
    """Base parameters and friction of an arm, with their uncertainty, from one recording or several together.

    method : `wls`, `ls` (as the paper), `robust` or `consistent`. friction : the law, or `auto`. gains : (J,) torque per ampere at the
    joint [N·m/A], where they are not published. rigid_from : an earlier identification whose rigid parameters are taken as known.
    The page Identification explains all of these. Raises BadInput, and Unidentifiable where there is too little motion.
    """
    if rigid_from is not None:
        _is(rigid_from, Identification, "an identification, as identify gives it")
    of, given = robot(arm), [read(each) for each in _several(recordings)]
    attitudes = {_attitude(recording, mounting) for recording in given} or {Mounting()}
    if len(attitudes) > 1:
        raise BadInput("identify: the recordings are of different mountings; expected recordings of one mounting")
    return _identify(given, of, attitudes.pop(), method=method, friction=friction, gains=_gains(gains, of), rigid_from=rigid_from)


class Verdict(NamedTuple):
    """What one recording of a series led to."""

    recording: Recording
    outcome: Assessment | Rejected  # `Rejected.reason` says why a recording was not learned from


class Friction(NamedTuple):
    """Friction of every joint at a temperature, (J,) or (N, J) each as the temperatures; standard deviations are one σ."""

    coulomb_nm: Array
    coulomb_std_nm: Array
    viscous_nm_s_per_rad: Array
    viscous_std_nm_s_per_rad: Array
    extrapolated: npt.NDArray[np.bool_]  # whether the temperature is outside those that were seen


@dataclass(frozen=True, slots=True, eq=False)
class TorqueModel:
    """Torque of one arm at any state and joint temperature."""

    robot: Robot
    parameters: CompensatedModel

    def torque(
        self, q: npt.ArrayLike, qd: npt.ArrayLike, qdd: npt.ArrayLike | None = None, temperature_c: npt.ArrayLike | None = None
    ) -> TorquePrediction:
        """Joint torque and its parts [N·m], of one state or of N.

        q, qd, qdd : (J,) or (N, J) [rad, rad/s, rad/s²]; qdd is 0 where it is not given. temperature_c : one for all joints, (J,) or
        (N, J) [°C]; where not given, the reference temperature. The result has the shape of q: `torque`, its one-σ `std`, `rigid`,
        `friction`, `extrapolated`, and `measured_std` of one measured sample. Raises BadInput.
        """
        at = _numbers(q, "q")
        accelerations = np.zeros_like(at) if qdd is None else _numbers(qdd, "qdd")
        predicted = predict_torque(self.parameters, self.robot, at, _numbers(qd, "qd"), accelerations, self._temperature(temperature_c))
        return TorquePrediction(*(part[0] for part in predicted)) if at.ndim == 1 else predicted

    def friction(self, temperature_c: npt.ArrayLike | None = None) -> Friction:
        """Fc and fv with present wear. temperature_c : as for `torque`. Raises BadInput."""
        T = self._temperature(temperature_c)
        T = self.parameters.viscous.reference_c if T is None else T
        coulomb, viscous = self.parameters.coulomb_at(T), self.parameters.viscous_at(T)
        return Friction(coulomb.value, coulomb.std, viscous.value, viscous.std, viscous.extrapolated)

    def _temperature(self, given: npt.ArrayLike | None) -> Array | None:
        if given is None:
            return None
        T = _within(given, "temperature_c", RANGES["temperature_c"], "°C")
        if T.ndim and T.shape[-1] != self.robot.joints:
            raise BadInput(f"temperature_c has shape {T.shape}; expected one number, ({self.robot.joints},) or (N, {self.robot.joints})")
        return np.full(self.robot.joints, float(T)) if not T.ndim else T


@dataclass(frozen=True, eq=False)
class Course:
    """The verdicts of a series of recordings, in the order of their times."""

    robot: Robot
    verdicts: tuple[Verdict, ...]

    @cached_property
    def last(self) -> Assessment:
        """The last assessment: `health`, `warnings`, `identification`, `belief` and more."""
        return [verdict.outcome for verdict in self.verdicts if isinstance(verdict.outcome, Assessment)][-1]

    @property
    def alerts(self) -> tuple[Alert, ...]:
        """The alerts that are active at the end."""
        return self.last.health.alerts

    @cached_property
    def model(self) -> TorqueModel:
        """Torque at any temperature, as it is known at the end."""
        return TorqueModel(self.robot, self.last.model)

    @cached_property
    def friction(self) -> pd.DataFrame:
        """A row a recording that was judged and joint: `recorded_at`, `joint` and the published figures, e.g. `wear` and `wear_std`."""
        rows = [
            {"recorded_at": utc(outcome.recorded_at_unix_s), "source": outcome.source, **plain(joint)}
            for _, outcome in self.verdicts
            if isinstance(outcome, Assessment)
            for joint in outcome.friction
        ]
        return pd.DataFrame(rows).drop(columns=["remaining_life", "remaining_revolutions", "ripple"])


def assess(
    recordings: Data | Sequence[Data],
    arm: Arm,
    *,
    mounting: Attitude | None = None,
    gains: npt.ArrayLike | None = None,
    recorded_at: Sequence[Moment] | None = None,
    interval: str | None = None,
) -> Course:
    """Judge a series of recordings of one arm in the order of their times, as the daemon would.

    recorded_at : when each was made, where the recordings do not say it. interval : instead, how far they are apart, e.g. "1d".
    gains : (J,) [N·m/A]. Raises BadInput where a recording says no time, two have the same, or none could be judged.
    """
    of, given = robot(arm), [read(each) for each in _several(recordings)]
    if recorded_at is not None and interval is not None:
        raise BadInput("assess: expected recorded_at or interval, not both")
    times: Sequence[Moment | None] = [None] * len(given)
    if recorded_at is not None:
        times = [recorded_at] if isinstance(recorded_at, str) else list(recorded_at)
    elif interval is not None:
        _is(interval, str, "an interval such as '1d'")
        times = [UNDATED_START_UNIX_S + number * interval_s(interval) for number in range(len(given))]
    if len(times) != len(given):
        raise BadInput(f"recorded_at has {len(times)} times for {len(given)} recordings; expected one for each")
    dated = []
    for number, (each, at) in enumerate(zip(given, times, strict=True), start=1):
        recording = read(each, recorded_at=at)
        if recording.context.recorded_at_unix_s is None:
            raise BadInput(f"recording {number} does not say when it was made; give recorded_at, or interval='1d'")
        attitude = _attitude(recording, mounting)
        context = replace(recording.context, robot=recording.context.robot or of.name, mounting_rad=attitude.angles_rad)
        dated.append((replace(recording, context=context), attitude))
    verdicts = tuple(Verdict(*each) for each in judged(in_order(dated), of, _gains(gains, of), AssessSettings()))
    reasons = [str(verdict.outcome.reason) for verdict in verdicts if isinstance(verdict.outcome, Rejected)]
    if len(reasons) == len(verdicts):
        raise BadInput(f"assess: no recording could be judged: {'; '.join(reasons) or 'none was given'}")
    return Course(of, verdicts)


def plot_friction(course: Course, path: str | Path | None = None) -> "Figure":
    """fv(T) of every joint: the learned law with a band of two standard deviations, and the replays, wear divided out.

    path : also write it there, as .png or .html. Raises BadInput where that cannot be written, or no course is given.
    """
    _is(course, Course, "a course, as assess gives it")
    from monitor.views.plots.friction_law import friction_figure

    verdicts = [verdict.outcome for verdict in course.verdicts if isinstance(verdict.outcome, Assessment)]
    title = f"{course.robot.name}: viscous friction by temperature"
    return _drawn(friction_figure(title, verdicts), path, title)


def plot_residuals(
    found: Identification,
    recordings: Data | Sequence[Data],
    arm: Arm,
    path: str | Path | None = None,
    *,
    gains: npt.ArrayLike | None = None,
) -> "Figure":
    """What the identified model does not explain of these recordings, over speed, load and position. path : as for `plot_friction`."""
    _is(found, Identification, "an identification, as identify gives it")
    from monitor.views.plots.residuals import residual_figure, residuals_of

    of = robot(arm)
    title = f"{of.name}: measured − modelled torque ({found.method})"
    given = [read(each) for each in _several(recordings)]
    if not given:
        raise BadInput("plot_residuals: no recording was given")
    shown = residuals_of(found, of, given, _gains(gains, of))
    return _drawn(residual_figure(title, shown), path, title)


def simulated(model: str = "ur5", ambient_c: Sequence[float] = (22.0,), *, seed: int = 0) -> list[Recording]:
    """Replays of a simulated arm, for trying things without one: one a day, in rooms of these temperatures. Some seconds each.

    The same seed, the same recordings. Raises BadInput where the model is not known or a temperature is not between −20 and 60 °C.
    """
    from monitor.config.files import find_excitation
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.settings import SimulateSettings
    from monitor.simulate.stepped import stepped_replay

    excitation = find_excitation(f"{robot(model).name}-ground", Path())
    rooms = _numbers(ambient_c, "ambient_c").reshape(-1).tolist()
    arms = [Controller(SimulateSettings(robot=model, ambient_c=room, seed=seed + day)) for day, room in enumerate(rooms)]
    replays = [stepped_replay(each, excitation) for each in arms]
    return [read(each, recorded_at=FIRST_SIMULATED_UNIX_S + day * DAY_S) for day, each in enumerate(replays)]


# --- what arguments may be -------------------------------------------------------------------------------


def _is(value: object, kind: type, expected: str) -> None:
    if not isinstance(value, kind):
        raise BadInput(f"{type(value).__name__} given; expected {expected}")


def _several(recordings: Data | Sequence[Data]) -> list[Data]:
    """One recording or several, as a list. Raises BadInput."""
    if isinstance(recordings, list | tuple):
        return list(recordings)
    if isinstance(recordings, str | Path | Recording | Mapping) or hasattr(recordings, "columns"):
        return [recordings]  # type: ignore[list-item]  # no table is a list of recordings
    try:
        return list(recordings)
    except TypeError:
        raise BadInput(f"{type(recordings).__name__} given; expected a recording, a file, a table, or a list of these") from None


def _unix_s(at: Moment) -> float:
    """Seconds since 1970. Raises BadInput."""
    if isinstance(at, str):
        return when(at, "recorded_at")
    if isinstance(at, date | np.datetime64):  # a datetime is a date
        stamp = pd.Timestamp(at)
        seconds = float("nan") if pd.isna(stamp) else (stamp if stamp.tzinfo else stamp.tz_localize("UTC")).timestamp()
    else:
        seconds = float(_numbers(at, "recorded_at", ()))
    if not 0.0 <= seconds <= LATEST_UNIX_S:
        raise BadInput(f"recorded_at is {at!r}; expected a time like 2026-01-31T03:00:00Z")
    return seconds


def _numbers(values: npt.ArrayLike, name: str, shape: tuple[int, ...] | None = None) -> Array:
    """An array of numbers. Raises BadInput where it is none, or of another shape."""
    try:
        array: Array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise BadInput(f"{name} is {values!r}; expected numbers") from None
    if shape is not None and array.shape != shape:
        raise BadInput(f"{name} has shape {array.shape}; expected {shape}")
    return array


def _within(values: npt.ArrayLike, name: str, bounds: tuple[float, float], unit: str, shape: tuple[int, ...] | None = None) -> Array:
    """An array of numbers between two bounds. Raises BadInput."""
    low, high = bounds
    array = _numbers(values, name, shape)
    if not np.all((array >= low) & (array <= high)):
        raise BadInput(f"{name} is {values!r}; expected {low:g} … {high:g} {unit}")
    return array


def _gains(gains: npt.ArrayLike | None, of: Robot) -> Array | None:
    return None if gains is None else _numbers(gains, "gains", (of.joints,))


def _mounting(attitude: Attitude) -> Mounting:
    if isinstance(attitude, Mounting):
        return attitude
    if isinstance(attitude, str):
        return Mounting.parse(attitude)
    return Mounting.of(np.radians(_within(attitude, "mounting", (-360.0, 360.0), "degrees", (3,))).tolist())


def _attitude(recording: Recording, mounting: Attitude | None) -> Mounting:
    """The mounting that is given, else that of the recording, else upright."""
    if mounting is not None:
        return _mounting(mounting)
    said = recording.context.mounting_rad
    return Mounting() if said is None else Mounting.of(said)


def _drawn(figure: "Figure", path: str | Path | None, title: str) -> "Figure":
    """The figure, written to `path` where one is given. Raises BadInput."""
    from monitor.views.plots.picture import check_target, write_picture

    if path is not None:
        check_target(Path(path))
        write_picture(Path(path), figure, title)
    return figure
