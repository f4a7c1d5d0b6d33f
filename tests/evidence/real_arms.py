"""`python -m tests.evidence.real_arms TABLE…|all`: the tables of docs/real-arms-tables.md, from recordings that are not ours to ship.

They are looked for in the folder `JOINT_MONITOR_DATA`, or `../shared/data` beside the checkout; which file is whose is in `ARMS`. What is
missing is left out and named. What some files need before `identify` reads them is done here, in `put_right`, and stands on the page.

Shapes: N samples, J joints, P parameters.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.document import NINETY
from monitor.identify.identification import QUOTED_SPEEDS_RAD_S, Identification
from monitor.identify.identify import identify
from monitor.identify.settings import IdentifySettings, SignalSettings
from monitor.identify.signals.arm import joint_torque, motion_of
from monitor.identify.signals.motion import Motion
from monitor.identify.signals.ripple import LEAST_CYCLES, LEAST_HZ, MOST_OF_RATE, ORDERS, WINDOW_S
from monitor.identify.validate import held_out_settings, predict_motion
from monitor.judge.friction.noise import NoisePriors
from monitor.model.friction import automatic_laws
from monitor.model.regressor import regressor
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.recording import Array, Recording
from monitor.store.formats.recordings import read_recording
from monitor.store.identify_files import robot_from_urdf
from tests.bench.figaroh_fit import Figaroh

GROUND = Mounting()
SPEED_RAD_S = 0.4  # at which runs are compared, as the judge does
ASSUMED_RHO = 0.5  # a day, of the noise to which `NoisePriors.std` belongs
ROUNDS = 3  # of each timed fit; the median counts
FALL_PER_K = 0.015  # of viscous friction: the judge's prior of a robot family

# figures of Raviola et al. (2021), from cold to warm, with which the first table begins
PAPER = {"UR3, paper": (-10.6, -11.6, -19.5, -26.4, -25.5, -23.9), "UR5, paper": (-8.8, -21.0, -13.6, -23.5, -21.1, -15.5)}


class Missing(Exception):
    """A file is not there; the text names it."""


class RealArm(NamedTuple):
    """An arm of which there are recordings."""

    robot: Callable[[Path], Robot]  # from the folder of recordings
    runs: Mapping[str, str]  # label → file below that folder
    columns: str | None = None
    gains_nm_per_a: tuple[float, ...] | None = None
    put_right: Callable[[Recording], Recording] = lambda recording: recording


def model(name: str) -> Callable[[Path], Robot]:
    """A shipped model."""
    return lambda _: load_robot(name)


def urdf(file: str) -> Callable[[Path], Robot]:
    """The arm of a URDF in the folder. Raises Missing."""
    return lambda folder: robot_from_urdf(found_in(folder, file))


def shanghai(folder: Path) -> Robot:
    """UR5's build with lengths of its own, as its authors give them (modified DH; a UR5's twists)."""
    lengths = {"a_m": np.array([0.0, -0.416, -0.4208, 0.0, 0.0, 0.0]), "d_m": np.array([0.1181, 0.0, 0.0, 0.1301, 0.1021, 0.0568])}
    return replace(load_robot("ur5"), name="shanghai", **lengths)


def of_shanghai(recording: Recording) -> Recording:
    """Distinct rows alone (each stands three times), speeds divided by three, drive units as N·m, axis 3 with its sign turned."""
    distinct = np.append(True, np.any(np.diff(recording.q, axis=0) != 0.0, axis=1))
    kept = rows(recording, distinct)
    per_unit = np.array([0.034768, 0.034768, -0.034768, 0.013562, 0.013562, 0.013562])
    assert kept.qd is not None
    assert kept.current is not None
    return replace(kept, qd=kept.qd / 3.0, torque=kept.current * per_unit, current=None)


ARMS: Mapping[str, RealArm] = {
    "UR3 Brasilia": RealArm(
        model("ur3"),
        {
            run: f"arms/ur3_brasilia/ur3_brasilia_{file}.csv"
            for run, file in {
                "A": "traj1_runA_stopped_12s",
                "B": "traj1_runB_stopped_10s",
                "C": "traj1_runC_stopped_20s",
                "D": "traj1_runD_full",
                "another": "20191018_all_joints",
            }.items()
        },
    ),
    "UR5 2014": RealArm(
        model("ur5"),
        {
            "6": "arms/ur5_kufieta/ur5_kufieta_move6_cycle26.94s_x3.csv",
            "7": "arms/ur5_kufieta/ur5_kufieta_move7_same_as_move6_once_free.csv",
        },
    ),
    "UR5 NIST": RealArm(model("ur5"), {"run": "arms/nist_ur5/nist_ur5_halfspeed_payload1.6lb_1_rtde.csv"}),
    "UR10 Salerno": RealArm(model("ur10"), {"run": "arms/ur10_unisa/unisa_ur10_exciting_trajectory.csv"}),
    "UR10e": RealArm(
        model("ur10e"),
        {
            "1st": "ur10e/ur-20_02_10-30sec_12harm.csv",
            "2nd": "ur10e/ur-20_02_12-50sec_12harm.csv",
            "3rd": "ur10e/ur-20_02_19_14harm50sec.csv",
        },
        columns="timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6",
        gains_nm_per_a=(14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
    ),
    "UR3e wrist 2": RealArm(
        model("ur3e"),
        {"run": "arms/ur3e_dtur/ur3e_dtur_wrist2_swing_twice.csv"},
        gains_nm_per_a=(10.0, 10.0, 8.0, 5.0, 5.0, 5.0),  # nobody published them: only ratios between its cycles are told
    ),
    "Shanghai": RealArm(
        shanghai,
        {run: f"arms/shanghai/shanghai_electric_arm_traj{run}_held_rows_raw_torque.csv" for run in ("1", "3")},
        put_right=of_shanghai,
    ),
    "AIRBOT": RealArm(
        urdf("models/airbot.urdf"),
        {f"{path} {run}": f"arms/airbot/airbot_{path}_run{run}.csv" for path in ("N7QR5", "opt") for run in "AB"},
        columns="timestamp,actual_q:6,actual_qd:6,actual_torque:6,skip:12",
    ),
    "KUKA LWR4": RealArm(
        urdf("arms/kuka_lwr4/flobaroid_kuka_lwr4.urdf"),
        {run: f"arms/kuka_lwr4/flobaroid_kuka_lwr4_measurements_{run}.csv" for run in ("1", "3")},
    ),
    "Gen3": RealArm(
        urdf("models/gen3.urdf"),
        {"cold": "arms/gen3/gen3_quadratic_cold.csv", **{f"warm {run}": f"arms/gen3/gen3_traj1_run{run}.csv" for run in "AB"}},
        gains_nm_per_a=(1.0,) * 7,  # nobody published them: what comes out is amperes
    ),
}
AGGREGATES = "arms/nist_ur5/nist_ur5_all18_2s_window_aggregates.parquet"

HELD_OUT: Sequence[tuple[str, str, str]] = (  # arm, fitted run, held-out run
    ("UR3 Brasilia", "D", "another"),
    ("UR3 Brasilia", "another", "D"),
    ("UR3 Brasilia", "A", "D"),
    ("UR5 2014", "6", "7"),
    ("UR5 2014", "7", "6"),
    ("UR10e", "2nd", "1st"),
    ("UR10e", "2nd", "3rd"),
    ("Shanghai", "1", "3"),
    ("Shanghai", "3", "1"),
    ("AIRBOT", "N7QR5 A", "N7QR5 B"),
    ("AIRBOT", "N7QR5 A", "opt A"),
    ("AIRBOT", "opt A", "N7QR5 A"),
    ("KUKA LWR4", "1", "3"),
    ("KUKA LWR4", "3", "1"),
)
PAIRS: Sequence[tuple[str, str, str, str]] = (  # arm, runs, time between them
    ("UR3 Brasilia", "A", "B", "5 min"),
    ("UR3 Brasilia", "B", "C", "21 min"),
    ("UR3 Brasilia", "C", "D", "9 min"),
    ("UR3 Brasilia", "A", "another", "another day, another motion"),
    ("UR3 Brasilia", "D", "another", "another day, another motion"),
    ("UR5 2014", "6", "7", "not known"),
    ("UR10e", "1st", "2nd", "2 days, another motion"),
    ("UR10e", "2nd", "3rd", "7 days, another motion"),
    ("AIRBOT", "N7QR5 A", "N7QR5 B", "not known"),
    ("AIRBOT", "opt A", "opt B", "not known"),
    ("AIRBOT", "N7QR5 A", "opt A", "not known, another motion"),
    ("Shanghai", "1", "3", "not known, another motion"),
)
CYCLES: Sequence[tuple[str, str, float, int]] = (  # one motion some times in a recording: arm, run, seconds of a cycle, cycles
    ("UR5 2014", "6", 26.94, 3),
    ("UR3e wrist 2", "run", 7.97, 2),
)
OF_LITTLE = SignalSettings(min_duration_s=2.0, min_moving_share=1e-6)  # one joint that moves is enough, where others do not count


# --- Recordings ---------------------------------------------------------------------------------


def found_in(folder: Path, file: str) -> Path:
    """The path of a file. Raises Missing."""
    if not (folder / file).is_file():
        raise Missing(f"{file} is not in the folder of recordings")
    return folder / file


def rows(recording: Recording, which: np.ndarray) -> Recording:
    """Some rows of a recording; which : (N,) true for those that stay."""
    kept: dict[str, Any] = {name: signal[which] for name, signal in recording.signals.items()}
    return replace(recording, **kept)


class Run(NamedTuple):
    """A recording with all that its identification needs."""

    robot: Robot
    recording: Recording
    gains: Array | None = None  # (J,) [N·m/A]

    def identified(self, friction: str = "paper", method: str = "wls", signals: SignalSettings | None = None) -> Identification:
        """Raises BadInput and Unidentifiable as `identify`."""
        settings = IdentifySettings(signals=signals or SignalSettings())
        return identify([self.recording], self.robot, GROUND, friction=friction, gains=self.gains, method=method, settings=settings)

    def cut(self, first_s: float, last_s: float) -> "Run":
        """The rows between two times from its begin [s]."""
        t_s = self.recording.t_s - self.recording.t_s[0]
        return self._replace(recording=rows(self.recording, (t_s >= first_s) & (t_s < last_s)))

    def motion(self, settings: SignalSettings | None = None) -> tuple[Motion, Array]:
        """The filtered motion and its measured joint torque (N, J) [N·m]."""
        moved = motion_of(self.recording, self.robot, settings)
        return moved, joint_torque(moved, self.robot, self.gains)


@cache
def run_of(folder: Path, arm: str, label: str) -> Run:
    """Raises Missing where the file, or the arm's URDF, is not there."""
    real = ARMS[arm]
    path = found_in(folder, real.runs[label])
    gains = None if real.gains_nm_per_a is None else np.array(real.gains_nm_per_a)
    return Run(real.robot(folder), real.put_right(read_recording(path, real.columns)), gains)


@cache
def identified(folder: Path, arm: str, label: str) -> Identification:
    """By the law of the paper. Raises Missing, BadInput and Unidentifiable."""
    return run_of(folder, arm, label).identified()


def runs(folder: Path) -> Iterator[str]:
    """What `identify` says of each recording."""
    yield head("arm, run", "rate, length", "joints with friction", "RMS left, of the torque", "warnings")
    for arm, real in ARMS.items():
        for label in real.runs:
            try:
                found = identified(folder, arm, label)
            except (Missing, BadInput, Unidentifiable) as why:
                yield line(f"{arm}, {label}", f"left out: {why}", *[""] * 3)
                continue
            (source,) = found.sources
            codes = sorted({warning.code for warning in found.warnings} - {"rejected_rows"})
            told = np.count_nonzero(np.isfinite(found.coulomb_nm))
            left = f"{100 * np.nanmedian(found.relative_rms):.1f} %, worst {100 * np.nanmax(found.relative_rms):.0f} %"
            sizes = f"{source.rate_hz:.0f} Hz, {source.duration_s:.0f} s"
            yield line(
                f"{arm}, {label}", sizes, f"{told} of {len(found.coulomb_nm)}", left, ", ".join(f"`{code}`" for code in codes) or "none"
            )


# --- Warm-up: Table 4 of the paper ------------------------------------------------------------------


def viscous_change(cold: Identification, warm: Identification) -> tuple[Array, Array]:
    """(J,) change of fv, and its standard deviation by the noise of both fits; fractions."""
    before, after = cold.viscous_nm_s_per_rad, warm.viscous_nm_s_per_rad
    spread = [np.sqrt(each.friction_cov[:, 1, 1]) / np.abs(each.viscous_nm_s_per_rad) for each in (cold, warm)]
    return after / before - 1.0, after / before * np.hypot(*spread)


def warm_up(folder: Path) -> Iterator[str]:
    """Change of fv from cold to warm."""
    yield head("arm, from → to", *[f"fv{j}" for j in range(1, 7)], "F(0.4 rad/s), mean of joints")
    for name, changes in PAPER.items():
        yield line(name, *[f"{change:.1f} %" for change in changes], "–")
    for arm, cold, warm in (
        *[("UR3 Brasilia", "A", run) for run in "BCD"],
        ("UR10e", "1st", "2nd"),
        ("UR5 2014", "6", "7"),
        ("Gen3", "cold", "warm A"),
    ):
        try:
            one, other = (identified(folder, arm, each) for each in (cold, warm))
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(f"{arm}, {cold} → {warm}", f"left out: {why}", *[""] * 6)
            continue
        changes, std = viscous_change(one, other)
        friction = np.expm1(difference(one, other).each)
        cells = [f"{100 * change:+.1f} ± {100 * noise:.1f} %" for change, noise in zip(changes, std, strict=True)]
        yield line(f"{arm}, {cold} → {warm}", *cells, f"{100 * np.nanmean(friction):+.1f} %")


def aggregates(folder: Path) -> Iterator[str]:
    """NIST's UR5 cold and warm: the mean load of its motors, window by window of one program."""
    import pandas as pd

    try:
        windows = pd.read_parquet(found_in(folder, AGGREGATES))
    except Missing as why:
        yield f"left out: {why}\n"
        return
    yield head("program", "cold", "warm", "mean motor load, cold → warm", "by runs, lowest and highest", "change a kelvin")
    heavy = windows[windows["payload_lb"] == windows["payload_lb"].max()]
    for speed, of_speed in heavy.groupby("speed"):
        runs = of_speed.groupby(["coldstart", "run_idx"])[["joint_temp_mean_C", "motor_load_ratio_mean"]].mean()
        cold, warm = runs.loc[True], runs.loc[False]
        temperature, load = ([each[name].mean() for each in (cold, warm)] for name in runs.columns)
        each_run = [f"{x['motor_load_ratio_mean'].min():.4f}–{x['motor_load_ratio_mean'].max():.4f}" for x in (cold, warm)]
        change = load[1] / load[0] - 1.0
        per_kelvin = f"{100 * change / (temperature[1] - temperature[0]):+.2f} %"
        cells = [f"{temperature[0]:.1f} °C", f"{temperature[1]:.1f} °C", f"{100 * change:+.1f} %", " → ".join(each_run), per_kelvin]
        yield line(f"{speed}, 4.5 lb, {len(cold)} and {len(warm)} runs", *cells)


# --- Friction at three speeds -------------------------------------------------------------------------


def speeds(folder: Path) -> Iterator[str]:
    """F at three speeds with the 90 % interval for another run."""
    yield head("arm, run", "speed [rad/s]", *[f"joint {j}" for j in range(1, 7)])
    for arm, label in (("UR3 Brasilia", "A"), ("UR3 Brasilia", "D"), ("UR5 2014", "6"), ("UR10 Salerno", "run"), ("UR10e", "2nd")):
        try:
            found = identified(folder, arm, label)
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(f"{arm}, {label}", f"left out: {why}", *[""] * 6)
            continue
        for speed in QUOTED_SPEEDS_RAD_S:
            torque, std = found.line_at(speed)
            on = as_fast(speed, found)
            cells = [f"{nm:.2f} ± {NINETY * sd:.2f}" if known else "–" for nm, sd, known in zip(torque, std, on, strict=True)]
            yield line(f"{arm}, {label}" if speed == QUOTED_SPEEDS_RAD_S[0] else "", f"{speed:g}", *cells)


def as_fast(speed_rad_s: float, *found: Identification) -> np.ndarray:
    """(J,) whether a joint was as fast in each of these runs: what a fit says beyond is no measurement."""
    return np.all([each.max_speed_rad_s >= speed_rad_s for each in found], axis=0)


class Held(NamedTuple):
    """Intervals of one speed, each counted both ways."""

    held: int
    counted: int
    half_width: Array  # of each interval, as a fraction of friction


def held_by(one: Identification, other: Identification, speed: float) -> Held:
    """Whether the interval of each run holds what the other finds at a speed; joints that were slower do not count."""
    on = as_fast(speed, one, other)
    (a, std_a), (b, std_b) = one.line_at(speed), other.line_at(speed)
    apart = np.abs(a - b)
    held = [apart[on] <= NINETY * std[on] for std in (std_a, std_b)]
    return Held(
        int(np.sum(held)), 2 * int(on.sum()), np.concatenate([NINETY * std_a[on] / np.abs(a[on]), NINETY * std_b[on] / np.abs(b[on])])
    )


def intervals(folder: Path) -> Iterator[str]:
    """Whether these intervals hold what another run finds."""
    yield head("arm, runs", "time between", *[f"at {speed:g} rad/s" for speed in QUOTED_SPEEDS_RAD_S], "half width, median")
    total: list[list[Held]] = []
    for arm, one, other, gap in PAIRS:
        try:
            a, b = (identified(folder, arm, each) for each in (one, other))
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(f"{arm}, {one}–{other}", gap, f"left out: {why}", *[""] * 3)
            continue
        total.append([held_by(a, b, speed) for speed in QUOTED_SPEEDS_RAD_S])
        yield line(f"{arm}, {one}–{other}", gap, *of_speeds(total[-1:]))
    if total:
        yield line("all", "", *of_speeds(total))


def of_speeds(pairs: Sequence[Sequence[Held]]) -> list[str]:
    """The cells of a row: how many are held at each speed, and how wide they are."""
    cells = [f"{sum(each.held for each in of)} of {sum(each.counted for each in of)}" for of in zip(*pairs, strict=True)]
    return [*cells, f"{100 * np.median(np.concatenate([each.half_width for pair in pairs for each in pair])):.0f} %"]


# --- Held-out error -----------------------------------------------------------------------------------


class Plain:
    """Least squares over pinocchio's own regressor with Coulomb and viscous friction and rotor inertia: what a user would write first."""

    def __init__(self, robot: Robot) -> None:
        self._model = robot.pinocchio_model(GROUND)
        self._data = self._model.createData()

    def _columns(self, moved: Motion) -> Array:
        """(N·J, 13·J)."""
        import pinocchio as pin

        N, J = moved.q.shape
        W = np.zeros((N, J, 13 * J))
        for n in range(N):
            W[n, :, : 10 * J] = pin.computeJointTorqueRegressor(self._model, self._data, moved.q[n], moved.qd[n], moved.qdd[n])
        for k, signal in enumerate((np.sign(moved.qd), moved.qd, moved.qdd)):
            W[:, np.arange(J), (10 + k) * J + np.arange(J)] = signal
        return W.reshape(N * J, 13 * J)

    def fit(self, moved: Motion, torque: Array) -> Array:
        """(13·J,) the solution of least length."""
        x: Array = np.linalg.lstsq(self._columns(moved), torque.ravel())[0]
        return x

    def predict(self, fitted: Array, moved: Motion) -> Array:
        """Torque (N, J) [N·m] along another motion."""
        return (self._columns(moved) @ fitted).reshape(moved.q.shape)


class Predicted(NamedTuple):
    """What is said of one held-out run, by name of who says it. Errors are RMS over all joints [N·m]."""

    torque_nm: float  # measured, RMS over all joints and samples in which that joint moves
    moving: Mapping[str, float]  # over these samples
    everywhere: Mapping[str, float]  # over all samples
    seconds: Mapping[str, float]  # of processor time, of a fit: `identify` from the recording, the others from filtered signals
    chosen: str  # by `auto`


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What the work makes, and the median of its processor time [s]."""
    taken = []
    for _ in range(ROUNDS):
        began = time.process_time()
        made = work()
        taken.append(time.process_time() - began)
    return made, statistics.median(taken)


def predicted(fitted: Run, other: Run) -> Predicted:
    """The errors of all on one held-out run. Without figaroh, where that is not installed."""
    robot = fitted.robot
    moved, torque = fitted.motion()
    along, measured = other.motion(held_out_settings().signals)
    says = {"manufacturer": regressor(robot, GROUND, along.q, along.qd, along.qdd) @ robot.nominal_parameters()}
    made, seconds = timed(fitted.identified)
    chosen = fitted.identified("auto")
    fits = {"paper": made, "auto": chosen, "ls": fitted.identified(method="ls")}
    fits |= {law.name: fitted.identified(law.name) for law in automatic_laws()[1:]}
    says |= {name: predict_motion(fit, robot, along).torque for name, fit in fits.items()}
    taken, tools = {"paper": seconds}, {"plain": Plain(robot), **with_figaroh(robot)}
    for name, tool in tools.items():
        solution, taken[name] = timed(partial(tool.fit, moved, torque))
        says[name] = tool.predict(solution, along)
    on = along.moving()
    errors = [{name: rms((each - measured)[which]) for name, each in says.items()} for which in (on, np.ones_like(on))]
    return Predicted(rms(measured[on]), *errors, taken, chosen.law.name)


@cache
def figaroh_is_here() -> bool:
    """Whether figaroh can be imported; says once that it is left out."""
    try:
        Figaroh(load_robot("ur5").pinocchio_model(GROUND))
    except ImportError:
        sys.stderr.write("figaroh is not installed: its column is left out (pip install figaroh)\n")
        return False
    return True


def with_figaroh(robot: Robot) -> dict[str, Any]:
    """figaroh for an arm, where it is installed."""
    return {"figaroh": Figaroh(robot.pinocchio_model(GROUND))} if figaroh_is_here() else {}


def rms(x: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(x**2)))


@cache
def predictions(folder: Path) -> Mapping[str, Predicted | str]:
    """Of each pair, or why it is left out."""
    result: dict[str, Predicted | str] = {}
    for arm, one, other in HELD_OUT:
        name = f"{arm}, {one} → {other}"
        try:
            result[name] = predicted(run_of(folder, arm, one), run_of(folder, arm, other))
        except (Missing, BadInput, Unidentifiable) as why:
            result[name] = f"left out: {why}"
    return result


def held_out(folder: Path) -> Iterator[str]:
    """Held-out error in motion: `paper`, and the others as multiples of it."""
    names = ("auto", "ls", "manufacturer", "plain", "figaroh")
    yield head("arm, fitted → held out", "torque", "`paper`", *[f"{each} / `paper`" for each in names], "time: figaroh / `identify`")
    for pair, found in predictions(folder).items():
        if isinstance(found, str):
            yield line(pair, found, *[""] * (2 + len(names)))
            continue
        of, seconds = found.moving, found.seconds
        cells = [f"{of[each] / of['paper']:.2f}" if each in of else "–" for each in names]
        cells[0] += f" ({found.chosen})"
        ratio = f"{seconds['figaroh'] / seconds['paper']:.1f}" if "figaroh" in seconds else "–"
        yield line(pair, f"{found.torque_nm:.3g} N·m", f"{of['paper']:.3g} N·m", *cells, ratio)


def at_rest_too(folder: Path) -> Iterator[str]:
    """The same over all samples, those at standstill too [N·m]."""
    names = ("paper", "auto", "ls", "plain", "figaroh")
    yield head("arm, fitted → held out", *[f"`{each}`" for each in names[:3]], *names[3:])
    for pair, found in predictions(folder).items():
        if not isinstance(found, str):
            yield line(pair, *[f"{found.everywhere[each]:.3g}" if each in found.everywhere else "–" for each in names])


def laws(folder: Path) -> Iterator[str]:
    """Which law predicts best where: each law's held-out error in motion as a multiple of the paper's."""
    names = [law.name for law in automatic_laws()][1:]
    yield head("arm, fitted → held out", *names, "best", "`auto` took")
    for pair, found in predictions(folder).items():
        if not isinstance(found, str):
            of = found.moving
            best = min(("paper", *names), key=lambda name: of[name])
            yield line(pair, *[f"{of[name] / of['paper']:.2f}" for name in names], best, found.chosen)


# --- Temperature --------------------------------------------------------------------------------------


def temperature(folder: Path) -> Iterator[str]:
    """Torque predicted at another temperature: by the model as it was fitted, and with friction as it is at that temperature."""
    yield head("arm, fitted → held out", "warmer by", "RMS error, as fitted", "with friction of that temperature", "ratio")
    for name, errors in (("UR5 NIST, first half → second", within_nist), ("UR3 Brasilia, A → D, friction of C", other_friction)):
        try:
            warmer, plain, corrected = errors(folder)
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(name, f"left out: {why}", *[""] * 3)
            continue
        yield line(name, warmer, f"{plain:.3f} N·m", f"{corrected:.3f} N·m", f"{corrected / plain:.4f}")
    for label in ARMS["Gen3"].runs:
        try:
            found = run_of(folder, "Gen3", label).identified(signals=OF_LITTLE)
            one_way = sum(warning.code == "one_direction" for warning in found.warnings)
            yield line(f"Gen3, {label}", f"no friction: {one_way} of 7 joints move one way only", *[""] * 3)
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(f"Gen3, {label}", f"left out: {why}", *[""] * 3)


def within_nist(folder: Path) -> tuple[str, float, float]:
    """How much warmer, and both errors in motion [N·m]: viscous friction falls by `FALL_PER_K`."""
    whole = run_of(folder, "UR5 NIST", "run")
    half_s = 0.5 * whole.recording.duration_s
    early, late = whole.cut(0.0, half_s), whole.cut(half_s, np.inf)
    found = early.identified()
    along, measured = late.motion(held_out_settings().signals)
    assert late.recording.mean_temperature_c is not None
    warmer = late.recording.mean_temperature_c - found.temperature_c
    said = predict_motion(found, whole.robot, along).torque
    corrected = said + along.qd * np.nan_to_num(found.viscous_nm_s_per_rad) * np.expm1(-FALL_PER_K * warmer)
    on = along.moving()
    return f"{warmer.min():.2f}–{warmer.max():.2f} K", rms((said - measured)[on]), rms((corrected - measured)[on])


def other_friction(folder: Path) -> tuple[str, float, float]:
    """Nobody recorded its temperatures: run C, nearly as warm as D, tells the friction, and A the masses."""
    cold, warm, last = (run_of(folder, "UR3 Brasilia", label) for label in "ACD")
    found = identified(folder, "UR3 Brasilia", "A")
    refitted = identify([warm.recording], cold.robot, GROUND, rigid_from=found)
    along, measured = last.motion(held_out_settings().signals)
    on = along.moving()
    errors = [rms((predict_motion(each, cold.robot, along).torque - measured)[on]) for each in (found, refitted)]
    return "not recorded", errors[0], errors[1]


# --- Scatter ------------------------------------------------------------------------------------------


class Difference(NamedTuple):
    """How friction at 0.4 rad/s differs between two runs; all are fractions of it."""

    each: Array  # (J,) of ln F; NaN for a joint that was slower
    noise: Array  # (J,) its standard deviation by the noise of both fits

    @property
    def scatter(self) -> float:
        """Standard deviation of one run that this difference shows, RMS of the joints."""
        return float(np.sqrt(np.nanmean(self.each**2) / 2.0))

    @property
    def own(self) -> float:
        """The same without what all joints share; NaN of one joint."""
        each = self.each[np.isfinite(self.each)]
        return float(np.std(each, ddof=1) / np.sqrt(2.0)) if len(each) > 1 else np.nan


def difference(one: Identification, other: Identification) -> Difference:
    """Between two runs of one arm, of the joints that were as fast. Raises Unidentifiable where none was."""
    (a, std_a), (b, std_b) = one.friction_at(SPEED_RAD_S), other.friction_at(SPEED_RAD_S)
    on = as_fast(SPEED_RAD_S, one, other)
    if not on.any():
        raise Unidentifiable(f"no joint was as fast as {SPEED_RAD_S:g} rad/s in both runs")
    ratio = np.divide(b, a, out=np.full_like(a, np.nan), where=on)
    noise = np.where(on, np.hypot(std_a / a, std_b / b), np.nan)
    return Difference(np.log(ratio), noise)


def scatter(folder: Path) -> Iterator[str]:
    """Friction at 0.4 rad/s from run to run."""
    columns = ("change, joint by joint [%]", "of it noise of both fits [%]", "σ of a run", "σ without what all joints share")
    yield head("arm, runs", "time between", *columns)
    for name, gap, both in compared(folder):
        try:
            found = difference(*both())
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(name, gap, f"left out: {why}", *[""] * 3)
            continue
        spread = ["–" if np.isnan(each) else f"{100 * each:.1f} %" for each in (found.scatter, found.own)]
        yield line(name, gap, in_percent(found.each, "+.1f"), in_percent(found.noise, ".1f"), *spread)
    std = NoisePriors().std
    for days, text in ((27.0 / 86_400, "27 s"), (10.0 / 1440, "10 min"), (2.0, "2 days"), (7.0, "7 days")):
        assumed = f"{100 * std * np.sqrt(1.0 - ASSUMED_RHO**days):.1f} %"
        yield line(f"the judge's first belief: σ {100 * std:g} %, ρ {ASSUMED_RHO:g} a day", text, "", "", assumed, "")


def in_percent(each: Array, form: str) -> str:
    """The figures of the joints in one cell."""
    return " ".join("–" if np.isnan(x) else f"{100 * x:{form}}" for x in each)


def compared(folder: Path) -> Iterator[tuple[str, str, Callable[[], tuple[Identification, Identification]]]]:
    """Name, time between and fits of two runs each: `PAIRS`, and those within `CYCLES`."""
    for arm, one, other, gap in PAIRS:
        yield f"{arm}, {one}–{other}", gap, lambda a=arm, x=one, y=other: (identified(folder, a, x), identified(folder, a, y))
    for arm, label, cycle_s, cycles in CYCLES:
        for first, second in combinations(range(cycles), 2):
            name, gap = f"{arm}, {label}, cycles {first + 1}–{second + 1}", f"{(second - first) * cycle_s:.0f} s"
            both = [partial(of_cycle, folder, arm, label, cycle_s, number) for number in (first, second)]
            yield name, gap, lambda both=both: (both[0](), both[1]())


@cache
def of_cycle(folder: Path, arm: str, label: str, cycle_s: float, number: int) -> Identification:
    """One cycle of a run, from 0. Raises as `identified`."""
    return run_of(folder, arm, label).cut(number * cycle_s, (number + 1) * cycle_s).identified(signals=OF_LITTLE)


# --- Gear ripple --------------------------------------------------------------------------------------


def waves(run: Run) -> Array:
    """(J, H, 2) complex amplitude of the ripple [A] at each order and in each direction; NaN where too few cycles show it.

    I ≈ Re(z·e^(−i·c·q)) after the same high-pass on both sides (Frisch and Waugh, 1933). |z| is the amplitude, arg z the phase.
    """
    from scipy.ndimage import uniform_filter1d

    moved = run.motion()[0]
    found = np.full((run.robot.joints, len(ORDERS), 2), np.nan, dtype=complex)
    if moved.unfiltered is None:
        return found
    raw, rate = moved.unfiltered, moved.rate_hz
    width = max(3, 2 * round(0.5 * WINDOW_S * rate) + 1)

    def high(x: np.ndarray) -> np.ndarray:
        return x - uniform_filter1d(x, width)

    for j, h, way in np.ndindex(found.shape):
        cycles, turning = run.robot.gear_ratio[j] * ORDERS[h], np.sign(raw.qd[:, j]) * (1 - 2 * way)
        hz = np.abs(raw.qd[:, j]) * cycles / (2.0 * np.pi)
        on = (uniform_filter1d(turning, width) > 1.0 - 0.5 / width) & (hz >= LEAST_HZ) & (hz <= MOST_OF_RATE * rate)
        if not np.isfinite(cycles) or np.sum(hz[on]) < LEAST_CYCLES * rate:
            continue
        angle = cycles * raw.q[:, j]
        X = np.stack([high(np.cos(angle)), high(np.sin(angle))], axis=1)[on]
        c, s = np.linalg.lstsq(X, high(raw.current[:, j])[on])[0]
        found[j, h, way] = c + 1j * s
    return found


def ripple(folder: Path) -> Iterator[str]:
    """Amplitude and phase of the gear ripple from run to run."""
    yield head(
        "arm, runs",
        "amplitudes that are clear in both",
        "ratio of amplitudes, median, lowest–highest",
        "phase differs by, median",
        "within 45°",
    )
    for arm, one, other, _ in PAIRS:
        try:
            runs, fits = zip(*[(run_of(folder, arm, each), identified(folder, arm, each)) for each in (one, other)], strict=True)
        except (Missing, BadInput, Unidentifiable) as why:
            yield line(f"{arm}, {one}–{other}", f"left out: {why}", *[""] * 3)
            continue
        if any(fit.ripple is None for fit in fits):
            yield line(f"{arm}, {one}–{other}", "no current, or no gear ratio", *[""] * 3)
            continue
        size = [fit.ripple.amplitude_a for fit in fits if fit.ripple is not None]
        clear = np.all([fit.ripple.amplitude_a > 3.0 * fit.ripple.std_a for fit in fits if fit.ripple is not None], axis=0)
        a, b = (waves(run)[clear] for run in runs)
        apart = np.degrees(np.abs(np.angle(b * np.conj(a))))
        apart = apart[np.isfinite(apart)]
        ratio = size[1][clear] / size[0][clear]
        if not len(ratio) or not len(apart):
            yield line(f"{arm}, {one}–{other}", f"{len(ratio)}", *[""] * 3)
            continue
        of_size = f"{np.median(ratio):.2f}, {ratio.min():.2f}–{ratio.max():.2f}"
        yield line(
            f"{arm}, {one}–{other}",
            f"{len(ratio)} of {clear.size}",
            of_size,
            f"{np.median(apart):.0f}°",
            f"{np.sum(apart < 45.0)} of {len(apart)}",
        )


# --- The command --------------------------------------------------------------------------------------


def head(*cells: str) -> str:
    """The head of a table."""
    return line(*cells) + "|---" * len(cells) + "|\n"


def line(*cells: str) -> str:
    """A row of a table."""
    return f"| {' | '.join(cells)} |\n"


TABLES: Mapping[str, Callable[[Path], Iterator[str]]] = {
    "runs": runs,
    "warm-up": warm_up,
    "aggregates": aggregates,
    "speeds": speeds,
    "intervals": intervals,
    "held-out": held_out,
    "at-rest-too": at_rest_too,
    "laws": laws,
    "temperature": temperature,
    "scatter": scatter,
    "ripple": ripple,
}


def main() -> int:
    """Print tables; 2 where there is no folder of recordings."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.evidence.real_arms", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tables", nargs="+", choices=(*TABLES, "all"), metavar="TABLE", help=", ".join((*TABLES, "all")))
    parser.add_argument("--data", type=Path, default=None, metavar="DIR", help="the folder of recordings")
    given = parser.parse_args()
    folder = given.data or Path(os.environ.get("JOINT_MONITOR_DATA", Path(__file__).parents[3] / "shared" / "data"))
    if not folder.is_dir():
        sys.stderr.write(f"the recordings of real arms are missing: {folder} is no folder; set JOINT_MONITOR_DATA to theirs\n")
        return 2
    for name in TABLES if "all" in given.tables else given.tables:
        sys.stdout.write(f"\n{name}\n\n")
        for text in TABLES[name](folder):
            sys.stdout.write(text)
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
