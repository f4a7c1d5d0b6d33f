"""The proof of safety in a trajectory file, and how it is checked again.

`prove` samples the curve at the controller's rate or at 500 Hz, whichever is higher, and bounds the clearance between the samples too
(see `clearance`). It uses no result of the search.
"""

from typing import Any

import numpy as np

from monitor.design.cell import Cell, cell_from_document
from monitor.design.clearance import Clearance, Surroundings, surroundings
from monitor.design.curve import Limits
from monitor.design.objective import Information
from monitor.design.problem import Infeasible, bow
from monitor.errors import BadInput
from monitor.model.energy import flange_speed
from monitor.model.fourier import Excitation, State
from monitor.model.robot import Robot
from monitor.recording import Array

FINEST_HZ = 500.0
METHOD = (
    "capsules per link, larger than the arm; the sampled curve, and between samples the bound (c0 + c1 - travel)/2; "
    "straight approaches likewise"
)


def prove(
    excitation: Excitation,
    around: Surroundings,
    limits: Limits,
    information: Information,
    approaches_rad: tuple[Array, ...],
    software: str,
) -> dict[str, Any]:
    """The `proof` of a trajectory file.

    approaches_rad : poses (J,) from which the approach to the start is checked. software : its name and version.
    Raises Infeasible naming the limit that is broken, and by how much.
    """
    rate_hz = max(FINEST_HZ, around.robot.rate_hz)
    state = _one_pass(excitation, rate_hz)
    shares = _shares(state, limits, information.rows(*state)[1])
    for name, share in shares.items():
        j = int(np.argmax(share))
        if not share[j] <= 1.0:
            raise Infeasible(f"joint {j + 1} needs {100 * share[j]:.1f} % of its limit of {name}")
    fastest = float(np.max(flange_speed(around.robot, state.q, state.qd)))
    if fastest > limits.flange_speed_m_s:
        raise Infeasible(f"the flange moves at {fastest:.3f} m/s; at most {limits.flange_speed_m_s:g}")
    clearance = along(excitation, around)
    near = clearance.short_of(around.cell)
    if near is not None:
        raise Infeasible(near)
    lines = [around.line(pose, state.q[0]) for pose in approaches_rad]
    for pose, line in zip(approaches_rad, lines, strict=True):
        near = line.short_of(around.cell)
        if near is not None:
            raise Infeasible(f"on the straight way from {np.round(pose, 3).tolist()} rad to the start, {near}")
    ends = excitation.at(np.array([0.0, excitation.pass_s]))
    return {
        "path_digest": excitation.path_digest,
        "cell_digest": around.cell.digest,
        "rate_hz": rate_hz,
        "method": METHOD,
        "clearance": _clearance_document(clearance),
        "approaches": [{"from_rad": pose.tolist(), **_clearance_document(line)} for pose, line in zip(approaches_rad, lines, strict=True)],
        "end_speed_rad_s": float(np.max(np.abs(ends.qd))),
        "end_acceleration_rad_s2": float(np.max(np.abs(ends.qdd))),
        "flange_speed_m_s": _digits(fastest),
        **{f"{name}_share": [_digits(value) for value in share] for name, share in shares.items()},
        "software": software,
    }


def along(excitation: Excitation, around: Surroundings) -> Clearance:
    """Closest approaches along one whole pass of the trajectory, between its samples too."""
    rate_hz = max(FINEST_HZ, around.robot.rate_hz)
    state = _one_pass(excitation, rate_hz)
    return around.along(state.q, bow(state.qdd, 1.0 / rate_hz))


def cell_of(excitation: Excitation) -> Cell | None:
    """The cell of the proof in a trajectory file; None where the file has no cell.

    Raises BadInput where the file's cell is not valid, or not the one of its digest.
    """
    if excitation.cell is None:
        return None
    cell = cell_from_document(excitation.cell)
    if excitation.cell.get("digest") != cell.digest:
        raise BadInput(f"excitation: its cell has the digest {cell.digest}, but the file says {excitation.cell.get('digest')}")
    return cell


def recheck(excitation: Excitation, robot: Robot, cell: Cell) -> str | None:
    """The bodies that come too near along the path in this cell, as a clause; None where the whole path keeps the margins.

    Raises BadInput for a robot whose shape is not known.
    """
    return along(excitation, surroundings(robot, excitation.mounting, cell)).short_of(cell)


def _one_pass(excitation: Excitation, rate_hz: float) -> State:
    """The states of one pass, with samples for full speed. The path is the same at every time scale."""
    # at full speed the bound between samples is widest
    steps = int(np.ceil(excitation.period_s * rate_hz))
    return excitation.at(np.linspace(0.0, excitation.pass_s, steps + 1))


def _shares(state: State, limits: Limits, torque: Array) -> dict[str, Array]:
    """The largest use of each limit as a fraction of it, each (J,)."""
    return {
        "position": np.max(np.abs(state.q), axis=0) / limits.position_rad,
        "speed": np.max(np.abs(state.qd), axis=0) / limits.speed_rad_s,
        "acceleration": np.max(np.abs(state.qdd), axis=0) / limits.acceleration_rad_s2,
        "torque": np.max(np.abs(torque), axis=0) / limits.torque_nm,
    }


def _clearance_document(clearance: Clearance) -> dict[str, Any]:
    """The closest approaches as a JSON object."""
    document: dict[str, Any] = {"to_itself_m": _digits(clearance.itself.gap_m), "itself": clearance.itself.between}
    if clearance.cell is not None:
        document |= {"to_cell_m": _digits(clearance.cell.gap_m), "cell": clearance.cell.between}
    return document


def _digits(value: float) -> float:
    """A figure with the digits that do not differ between machines."""
    return float(f"{value:.5g}")
