"""Replays faster than real time, with the same controller, servo, physics and sensors as on the wire.

A client on the wire sends a servoj packet every 8 ms. Here the replay gives the same targets to the reference directly.
"""

from collections.abc import Generator
from typing import Any

import numpy as np

from monitor.errors import BadInput, ReplayAborted
from monitor.model.fourier import Excitation
from monitor.recording import Array, Context, Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.state import SafetyMode
from monitor.simulate.wire.packing import reader
from monitor.simulate.wire.variables import output_variables

RATE_HZ = 125.0  # of targets and rows: that of a CB3 controller, at which the monitor replays
LOOKAHEAD_S, GAIN = 0.03, 500.0  # arguments of servoj, as in replays on the wire
APPROACH_RAD_S, APPROACH_RAD_S2 = 0.5, 0.5  # largest speed and acceleration on the way to the start: slow, as before a real replay
THERE_RAD = 1e-3  # nearer to the start than this, the arm needs no approach
SETTLE_S = 0.3  # time at standstill before the first sample
YIELD_EVERY = 25  # rows between two yields, so that the caller can serve its sockets

OF_JOINTS = {  # signal of a recording → variable of RTDE
    "q": "actual_q",
    "qd": "actual_qd",
    "current": "actual_current",
    "temperature_c": "joint_temperatures",
    **{name: name for name in ("target_q", "target_qd", "target_qdd", "target_current", "target_moment")},
}
STATUS = ("robot_mode", "safety_mode", "runtime_state")


def stepped_replay(controller: Controller, excitation: Excitation, *, software: str | None = None) -> Recording:
    """Approach the start, play all repetitions, and return what a client would have recorded.

    Raises BadInput if the excitation is for another arm or beyond its limits, ReplayAborted if the controller stopped the replay.
    """
    playing = play(controller, excitation, software=software)
    while True:
        try:
            next(playing)
        except StopIteration as done:
            recording: Recording = done.value
            return recording


def play(
    controller: Controller, excitation: Excitation, *, software: str | None = None, until_row: int | None = None
) -> Generator[None, None, Recording]:
    """`stepped_replay` as a generator that yields every `YIELD_EVERY` rows, so that the caller can do other work in between.

    until_row : the replay is ended there; at its end where None.
    """
    check(controller, excitation)
    obstacle = controller.programs.start_stepped()
    if obstacle:
        raise BadInput(f"stepped replay: {obstacle}")
    try:
        yield from _approach(controller, excitation.at(np.zeros(1)).q[0])
        rows = yield from _rows(controller, excitation, until_row)
    finally:
        controller.stop_program("the stepped replay is over", kind="program_end")
    return _recording(controller, excitation, rows, software)


def check(controller: Controller, excitation: Excitation) -> None:
    """Check an excitation. Raises BadInput with the robot, the mounting, or the joint and the limit that does not fit."""
    robot, settings = controller.robot, controller.settings
    if excitation.robot != robot.name:
        raise BadInput(f"excitation is for a {excitation.robot}; this arm is a {robot.name}")
    if not np.allclose(excitation.mounting.rotation, settings.mounting.rotation, atol=1e-6):
        degrees = np.degrees(excitation.mounting.angles_rad), np.degrees(settings.mounting.angles_rad)
        raise BadInput(f"excitation is for the mounting {degrees[0].round(3)}°; this arm's is {degrees[1].round(3)}°")
    _, state = excitation.sampled(RATE_HZ)
    for name, values, limit in (("|q|", state.q, robot.max_position_rad), ("|q̇|", state.qd, robot.max_speed_rad_s)):
        largest = np.max(np.abs(values), axis=0)
        joint = int(np.argmax(largest / limit))
        if largest[joint] > limit[joint]:
            raise BadInput(f"excitation: {name} of joint {joint + 1} reaches {largest[joint]:.3f}; at most {limit[joint]:.3f}")


def _approach(controller: Controller, start: Array) -> Generator[None, None, None]:
    if np.max(np.abs(controller.reference.q - start)) < THERE_RAD:
        return
    controller.reference.move(start, APPROACH_RAD_S, APPROACH_RAD_S2)
    settled = 0
    ticks = 0
    while settled < SETTLE_S / controller.clock.tick_s:
        controller.step()
        _still_playing(controller)
        settled = settled + 1 if controller.reference.at_rest else 0
        ticks += 1
        if ticks % (YIELD_EVERY * 4) == 0:
            yield


def _rows(controller: Controller, excitation: Excitation, until_row: int | None) -> Generator[None, None, dict[str, Array]]:
    _, path = excitation.sampled(RATE_HZ)
    ticks = round(1.0 / RATE_HZ / controller.clock.tick_s)
    N, J = path.q[:until_row].shape
    variables, joints = output_variables(controller), len(OF_JOINTS) * J
    read = reader(controller, [variables[name] for name in (*OF_JOINTS.values(), *STATUS)])
    t_s, rows = np.empty(N), np.empty((N, joints + len(STATUS)))
    for i in range(N):
        controller.reference.follow([path.q[i].tolist()], 1.0 / RATE_HZ, LOOKAHEAD_S, GAIN)
        for _ in range(ticks):
            controller.step()
        _still_playing(controller)
        t_s[i], rows[i] = controller.clock.now_s, read()
        if i % YIELD_EVERY == 0:
            yield
    signals = rows[:, :joints].reshape(N, -1, J).swapaxes(0, 1).copy()  # (signals, N, J)
    of_joints, status = zip(OF_JOINTS, signals, strict=True), zip(STATUS, rows[:, joints:].T.copy(), strict=True)
    return {"t_s": t_s, "speed_scaling": np.ones(N), **dict(of_joints), **dict(status)}


def _still_playing(controller: Controller) -> None:
    if controller.modes.safety != SafetyMode.NORMAL or controller.programs.current is None:
        stop = controller.journal.stops[-1]
        raise ReplayAborted(f"{stop.kind}: {stop.reason}")


def _recording(controller: Controller, excitation: Excitation, rows: dict[str, Any], software: str | None) -> Recording:
    settings = controller.settings
    context = Context(
        robot=settings.robot,
        serial=settings.serial,
        firmware=".".join(map(str, settings.polyscope)),
        mounting_rad=settings.mounting.angles_rad,
        payload_kg=settings.payload_kg,
        trajectory_digest=excitation.digest,
        software=software,
        note="stepped replay of the simulator",
    )
    return Recording(**rows, context=context, quality={"missed_ticks": 0, "duplicated_ticks": 0, "stepped": True}, source="simulator")
