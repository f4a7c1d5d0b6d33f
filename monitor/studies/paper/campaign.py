"""The paper's campaign on one simulated arm: design, replay cold, identify, validate, warm up, mount elsewhere.

The simulator's physics is stepped faster than real time; what is identified from is a Recording as the wire would give it. Between two
replays of the warm-up the arm plays on: the heat of that is computed from the last replay's own losses, not replayed.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor import __version__
from monitor.design.trajectory import Task, design
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.signals.motion import Motion, motion
from monitor.identify.signals.torque import joint_torque
from monitor.identify.validate import errors_of, predict_torque
from monitor.model.base import Base, base_parameters
from monitor.model.fourier import Excitation
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import PER_JOINT, Mounting, Robot, load_robot
from monitor.recording import Array, Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.studies.paper.printed import PRINTED, WARM_UP_MIN

AMBIENT_C = 21.0  # an idle arm stands 3 K above it: where the paper's UR5 started
LEAP_S = 60.0
Show = Callable[[str, float], None]
"""What is being done, and which share of the campaign is behind it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignSettings:
    """How much is played."""

    seed: int = 0
    replays: int = 13  # of the warm-up: one every two and a half minutes
    evaluations: int = 1600  # of each search for a trajectory
    repetitions: int = 3  # of the 10 s period in every run, as in the paper


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Error:
    """e_N over all joints and samples, and RMS of each joint over all samples."""

    normalised_nm: float
    rms_nm: Array  # (J,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Campaign:
    """Everything the report draws and compares; joints along the last axis."""

    robot: Robot
    settings: CampaignSettings
    bases: dict[str, Base]  # ground, ceiling, wall
    trajectories: dict[str, Excitation]  # ground, ceiling, validation
    identified: Identification  # cold, ground, LS as in the paper
    weighted: Array  # (B,) by the paper's W
    truth: Array  # (B,) rigid base parameters of the simulated arm; NaN for friction
    ls_s: float
    wls_s: float
    samples: int
    validation_t_s: Array  # (N,)
    validation_nm: dict[str, Array]  # measured, before, LS: (N, J)
    validation: dict[str, Error]  # before, LS, WLS, and the monitor's own method
    warm_up_min: Array  # (R,)
    temperature_c: Array  # (R, J) means of the replays
    coulomb_nm: Array  # (R, J)
    viscous: Array  # (R, J)
    rigid_drift_std: Array  # (B,) change of every parameter cold → warm over its deviation; NaN for friction
    rigid_std_of_torque: float  # RMS torque of that change over the torque's own
    cold_warm_t_s: Array  # (N,)
    cold_nm: Array  # (N, J) along the excitation, by the cold identification
    warm_nm: Array
    transfer: dict[str, Error]  # ground, ceiling, ceiling with the ground's regressor
    transfer_nm: dict[str, Array]  # measured, ceiling, ground regressor: (N, J)
    transfer_t_s: Array


def campaign(name: str, settings: CampaignSettings, show: Show) -> Campaign:
    """Play it. Deterministic but for the times of LS and WLS."""
    robot = load_robot(name)
    steps = 3 + 1 + settings.replays + 3 + 3
    done = 0

    def step(text: str) -> None:
        nonlocal done
        show(text, done / steps)
        done += 1

    trajectories = {}
    for mounting in ("ground", "ceiling"):
        step(f"searching a trajectory on the {mounting}")
        trajectories[mounting] = _designed(robot, mounting, settings)
    step("a pseudo-random trajectory for validation")
    trajectories["validation"] = _designed(robot, "ground", settings, random=True)
    step("identifiability on three mountings")
    bases = {mounting: base_parameters(robot, Mounting.parse(mounting)) for mounting in ("ground", "ceiling", "wall")}

    step("the validation, cold")
    # validated as cold as identified: a second arm from the same start, with other noise
    held_out = motion(stepped_replay(_arm(name, settings.seed + 1), trajectories["validation"]))
    arm = _arm(name, settings.seed)
    recordings: list[Recording] = []
    found: list[Identification] = []
    minutes = np.linspace(0.0, WARM_UP_MIN, settings.replays)
    for k, minute in enumerate(minutes):
        step(f"warm-up, minute {minute:.1f}: a replay of 30 s")
        if k:
            _play_on(arm, recordings[-1], 60.0 * (minute - minutes[k - 1]) - trajectories["ground"].duration_s)
        recordings.append(stepped_replay(arm, trajectories["ground"]))
        found.append(identify([recordings[-1]], robot, Mounting(), method="ls"))

    step("least squares and its weights")
    cold = motion(recordings[0])
    ls_s, _ = _solved(cold, robot, np.ones(robot.joints))
    wls_s, weighted = _solved(cold, robot, 1.0 / robot.max_torque_nm)  # the paper's W: 1/(G·τ_max), G being the same for all joints
    own = identify([recordings[0]], robot, Mounting(), method="wls")
    predictions = _predictions(held_out, robot, found[0], weighted, own)
    measured = joint_torque(held_out, robot)
    step("cold beside warm")
    t_s, path = replace(trajectories["ground"], repetitions=1).sampled(robot.rate_hz)
    cold_nm, warm_nm = (predict_torque(one, robot, *path).torque for one in (found[0], found[-1]))
    drift, share = _rigid_drift(found[0], found[-1], robot, path)

    transfer, transfer_nm, transfer_t_s = _mounting_transfer(name, trajectories, settings, step)
    show("done", 1.0)
    return Campaign(
        robot=robot,
        settings=settings,
        bases=bases,
        trajectories=trajectories,
        identified=found[0],
        weighted=weighted,
        truth=_truth(robot, bases["ground"], arm),
        ls_s=ls_s,
        wls_s=wls_s,
        samples=held_out.samples,
        validation_t_s=held_out.t_s - held_out.t_s[0],
        validation_nm={"measured": measured, "before": predictions["before"], "LS": predictions["LS"]},
        validation={key: _error(measured, predicted) for key, predicted in predictions.items()},
        warm_up_min=minutes,
        temperature_c=np.array([one.temperature_c for one in found]),
        coulomb_nm=np.array([one.coulomb_nm for one in found]),
        viscous=np.array([one.viscous_nm_s_per_rad for one in found]),
        rigid_drift_std=drift,
        rigid_std_of_torque=share,
        cold_warm_t_s=t_s,
        cold_nm=cold_nm,
        warm_nm=warm_nm,
        transfer=transfer,
        transfer_nm=transfer_nm,
        transfer_t_s=transfer_t_s,
    )


def _designed(robot: Robot, mounting: str, settings: CampaignSettings, *, random: bool = False) -> Excitation:
    """By the paper's criterion, cond(Ȳ_B), or pseudo-random; |q̇| ≤ π and |q̈| ≤ 5.5π as there."""
    task = Task(
        robot=robot, mounting=Mounting.parse(mounting), objective="condition", repetitions=settings.repetitions, speed_limit_rad_s=math.pi
    )
    seed = settings.seed + 2  # with seed 0 of the campaign the UR3's search leaves the first valley it meets
    excitation, _ = design(task, software=f"joint-monitor {__version__}", seed=seed, evaluations=settings.evaluations, random=random)
    return excitation


def _arm(name: str, seed: int, mounting: str = "ground") -> Controller:
    """A simulated arm as cold as the paper's."""
    cold = PRINTED[name].cold_c
    attitude = Mounting.parse(mounting)
    return Controller(SimulateSettings(robot=name, seed=seed, ambient_c=AMBIENT_C, mounting=attitude, initial_temperature_c=cold))


def _play_on(controller: Controller, last: Recording, duration_s: float) -> None:
    """Heat of playing the same trajectory over and over for so long: over whole periods the drives' work is friction's heat."""
    arm = controller.arm
    assert last.current is not None  # the simulator records them
    assert last.qd is not None
    torque = last.current * arm.gain_nm_per_a  # (N, J)
    motor_w = arm.thermal.idle_w + arm.thermal.winding_ohm * np.mean(last.current**2, axis=0)
    grease_w = np.maximum(np.mean(torque * last.qd, axis=0), 0.0)
    left = max(duration_s, 0.0)
    while left > 0.0:
        dt = min(LEAP_S, left)
        arm.set_temperatures(arm.thermal.leap(arm.temperatures, motor_w, grease_w, controller.settings.ambient_c, dt))
        left -= dt


# --- least squares as the paper does it ----------------------------------------------------------------


def _solved(moved: Motion, robot: Robot, weight: Array) -> tuple[float, Array]:
    """Seconds to solve, and the base parameters (B,), of the rows of each joint times its weight (J,)."""
    base = base_parameters(robot, Mounting())
    rows = (_regressor(moved, robot) * weight[:, None]).reshape(-1, base.count)  # (N·J, B)
    torque = (joint_torque(moved, robot) * weight).ravel()
    began = time.perf_counter()
    values = np.linalg.lstsq(rows, torque, rcond=None)[0].astype(float)
    return time.perf_counter() - began, values


def _regressor(moved: Motion, robot: Robot) -> Array:
    """(N, J, B) with Coulomb's step as round as the filtered torque's."""
    base = base_parameters(robot, Mounting())
    Y = regressor(robot, Mounting(), moved.q, moved.qd, moved.qdd)  # (N, J, P)
    Y[:, np.arange(robot.joints), friction_columns(robot.joints)[0]] = moved.direction
    return Y[:, :, list(base.columns)]


def _predictions(moved: Motion, robot: Robot, ls: Identification, weighted: Array, own: Identification) -> dict[str, Array]:
    """(N, J) torque along a motion: from the manufacturer's data alone, LS, the paper's WLS, the monitor's own method."""
    nominal = regressor(robot, Mounting(), moved.q, moved.qd, moved.qdd) @ robot.nominal_parameters()
    Y = _regressor(moved, robot)
    return {"before": nominal, "LS": Y @ ls.values, "WLS": Y @ weighted, "own": Y @ own.values}


def _error(measured: Array, predicted: Array) -> Error:
    found = errors_of(measured, predicted, np.ones(measured.shape, dtype=bool))
    return Error(normalised_nm=found.normalised_error_nm, rms_nm=found.rms_all_nm)


def _truth(robot: Robot, base: Base, arm: Controller) -> Array:
    """(B,) what the simulated arm really has; its friction follows another law, so it has no fc and fv."""
    standard = robot.nominal_parameters(with_inertia=True).reshape(robot.joints, PER_JOINT)
    standard[:, PER_JOINT - 1] = arm.arm.rotor_kg_m2
    values: Array = base.combination @ standard.ravel()
    friction = np.isin(np.array(base.columns), np.concatenate(friction_columns(robot.joints)))
    return np.where(friction, np.nan, values)


def _rigid_drift(cold: Identification, warm: Identification, robot: Robot, path: Any) -> tuple[Array, float]:
    """Change of the rigid parameters: each over its deviation (B,), and all as torque along the path, RMS over the torque's own."""
    friction = np.isin(np.array(cold.columns), np.concatenate(friction_columns(robot.joints)))
    change = np.where(friction, 0.0, warm.values - cold.values)
    deviation = np.sqrt(np.diag(cold.covariance) + np.diag(warm.covariance))
    Y = regressor(robot, cold.mounting, *path)[:, :, list(cold.columns)]
    moved, whole = Y @ change, Y @ cold.values
    return np.where(friction, np.nan, change / deviation), float(np.sqrt(np.mean(moved**2) / np.mean(whole**2)))


# --- the same parameters on another mounting ---------------------------------------------------------------


def _mounting_transfer(
    name: str, trajectories: dict[str, Excitation], settings: CampaignSettings, step: Callable[[str], None]
) -> tuple[dict[str, Error], dict[str, Array], Array]:
    """Without friction, as the paper's own simulator: parameters from the ground on the ceiling, with either regressor."""
    played = {}
    for mounting in ("ground", "ceiling"):
        step(f"without friction on the {mounting}")
        arm = _arm(name, settings.seed, mounting)
        law = arm.arm.law
        none = np.zeros_like(law.coulomb_nm)
        arm.arm.law = replace(law, coulomb_nm=none, load_factor=none, concave_nm=none, linear_nm_s_per_rad=none)
        arm.arm.set_temperatures(arm.arm.temperatures)  # what friction owes to temperature is worked out anew
        played[mounting] = stepped_replay(arm, trajectories[mounting])
    step("the ground's parameters on the ceiling")
    robot = load_robot(name)
    found = identify([played["ground"]], robot, Mounting(), method="ls")
    ground, ceiling = motion(played["ground"]), motion(played["ceiling"])
    measured = joint_torque(ceiling, robot)
    hung = replace(found, mounting=Mounting.parse("ceiling"))
    curves = {
        "measured": measured,
        "ceiling": predict_torque(hung, robot, ceiling.q, ceiling.qd, ceiling.qdd).torque,
        "ground regressor": predict_torque(found, robot, ceiling.q, ceiling.qd, ceiling.qdd).torque,
    }
    errors = {
        "ground": _error(joint_torque(ground, robot), predict_torque(found, robot, ground.q, ground.qd, ground.qdd).torque),
        "ceiling": _error(measured, curves["ceiling"]),
        "ground regressor": _error(measured, curves["ground regressor"]),
    }
    return errors, curves, ceiling.t_s - ceiling.t_s[0]
