"""One replay, supervised from outside: check the conditions, start a session, follow it, end it → Recording.

The session moves the arm; this side only watches, ends the session, and stops the robot. Whatever ends a replay early, the session has
ended and the robot has been told to stop before `replay` raises.
"""

import dataclasses
import hashlib
import json
import time

import numpy as np

from monitor import __version__
from monitor.acquire.driver import Driver, ReplayTask, Witness, usual_driver
from monitor.acquire.ending import end_program, how_it_ended
from monitor.acquire.rows import columns, latency_p99_ms, recording_from_columns, tick_quality
from monitor.acquire.safety.conditions import OF_CONFIGURATION, OF_CONTROLLER, conditions, named_conditions, refuse_unless
from monitor.acquire.safety.gate import PERMIT_NO_ANSWER, AskPermit, Gate
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult, LastMotion, Permit
from monitor.acquire.safety.oversight import Oversight, Question, permit_kept, remote_control_kept
from monitor.acquire.safety.torque_basis import BandBasis
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.state import ArmState
from monitor.acquire.watch import Caller, Watch
from monitor.errors import RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Context, Recording


def check(
    settings: ReplaySettings,
    excitation: Excitation,
    robot: Robot,
    context: Context,
    *,
    installation: Installation | None = None,
    last: LastMotion | None = None,
    ask: AskPermit | None = None,
    driver: Driver | None = None,
) -> tuple[ConditionResult, ...]:
    """Every condition as it is now.

    last : how the last motion ended; None: there was none. `ask` asks for somebody else's permit. An arm that does not answer fails the
    conditions that need its answer; nothing is raised for it.
    """
    driver = driver or usual_driver()
    identity, unreachable = None, None
    try:
        identity = driver.identity(settings.host)
    except RobotUnreachable as error:
        unreachable = error.reason
    permit: Permit | None = None
    if settings.permit == "zenoh" and ask is not None:
        permit = ask({"robot": robot.name, "only_a_check": True}, settings.permit_timeout_s)
        permit = permit or Permit(False, PERMIT_NO_ANSWER(limit_s=settings.permit_timeout_s))
    return conditions(
        ConditionInputs(
            settings=settings,
            excitation=excitation,
            robot=robot,
            context=context,
            now_unix_s=time.time(),
            identity=identity,
            services=driver.services(settings.host),
            unreachable=unreachable,
            state=driver.state(settings.host, settings.rate_hz, settings.startup_timeout_s),
            last=last or LastMotion(),
            permit=permit,
            installation=installation or Installation(),
        )
    )


LEAVING_S = 1.0  # from the session's last message to the end of its process


def slowed(excitation: Excitation, settings: ReplaySettings) -> Excitation:
    """One repetition of the same trajectory, at the configured fraction of its speed."""
    return dataclasses.replace(excitation, repetitions=1, time_scale=settings.first_pass_time_scale * excitation.time_scale)


def first_pass_key(excitation: Excitation, settings: ReplaySettings, context: Context) -> str:
    """Digest of everything whose change asks for a first pass: arm, trajectory and time scale, cell, mounting, payload, tool."""
    relevant = [
        context.robot,
        context.serial,
        excitation.digest,
        None if settings.cell is None else settings.cell.digest,
        context.mounting_rad,
        context.payload_kg,
        context.tool,
    ]
    return hashlib.sha256(json.dumps(relevant).encode()).hexdigest()[:16]


def replay(
    excitation: Excitation,
    robot: Robot,
    settings: ReplaySettings,
    *,
    context: Context | None = None,
    installation: Installation | None = None,
    last: LastMotion | None = None,
    basis: BandBasis | None = None,
    caller: Caller | None = None,
    driver: Driver | None = None,
    witness: Witness | None = None,
) -> Recording:
    """Move to the start, play every repetition once, and come back; the recording has the rows of the play alone, one a tick.

    context : what the caller knows of the arm; what the controller says of itself is added to it. installation : what the configuration
    says of the controller's installation and of the drives. last : how the motion before this one ended; None: there was none. basis : what
    was learnt for the torque band, which ends the motion; None: nothing was. caller : whom to ask and to tell meanwhile; None: nobody.
    witness : of what happens to the arm, which begins here; None: there is none. The calling thread blocks until the arm is back, and must
    not end before.

    Where `settings.lent`, the arm is borrowed from the program that plays: the call waits at most `wait_s` for the program's node, in the
    phase `node` of the progress, takes the arm at the first node at which every condition holds, brings it back to within 1 mrad of where
    it took it, and returns once the program goes on. `Caller.begin`, the announcement and the permit come after the arm was taken; what
    refuses then gives it back at once. Any other end of a borrowed arm ends the program, and asks for a person (`ReplayAborted.borrowed`).

    Raises MotionRefused (nothing was moved), RobotUnreachable (nothing was moved), ReplayAborted with its `cause`.
    """
    last, caller, driver = last or LastMotion(), caller or Caller(), driver or usual_driver()
    inputs = ConditionInputs(
        settings=settings,
        excitation=excitation,
        robot=robot,
        context=context or Context(),
        now_unix_s=time.time(),
        # a lent arm is given back where it was taken, wherever another motion has left it
        last=dataclasses.replace(last, left=None) if settings.lent else last,
        installation=installation or Installation(),
    )
    refuse_unless(named_conditions(inputs, OF_CONFIGURATION))
    identity = driver.identity(settings.host)
    inputs = dataclasses.replace(inputs, identity=identity)
    caller.met(identity)
    refuse_unless(named_conditions(inputs, OF_CONTROLLER))
    task = ReplayTask(
        settings=settings,
        excitation=excitation,
        robot=robot,
        context=inputs.context,
        installation=inputs.installation,
        basis=basis or BandBasis(),
        left=inputs.last.left,
        software=identity.firmware,
    )
    gate = Gate(inputs, ask=caller.ask, announce=caller.announce)
    questions: tuple[Question, ...] = (permit_kept(gate.ask_again),) if gate.asks_over_zenoh else ()
    if identity.remote_control is not None and (identity.remote_control or settings.lent is None):
        questions += (remote_control_kept(lambda: driver.remote_control(settings.host)),)
    oversight = Oversight(questions, playing_program=lambda: driver.playing_program(settings.host))
    watch = Watch(settings, identity, gate, caller, oversight)
    if witness is not None:
        witness.begin()
    session = driver.stream(task)
    try:
        watch.follow(session)
    finally:
        # also when a callback raised: first the session, then the arm, then the exception
        oversight.cancel()
        exit_code = session.end(LEAVING_S if watch.last_word else 0.0)
        end = end_program(watch, driver, witness)
        oversight.join()
    if watch.refusal is not None and not watch.state.lent:
        raise watch.refusal
    if not watch.done:
        home_q = () if watch.arm is None else tuple(inputs.way_from(watch.arm).home_q.tolist())
        death = driver.cause_of_death(exit_code, watch.silent_before_end_s, session.printed, watch.call)
        raise how_it_ended(watch, driver, end, death, session.printed, home_q)
    return _recording(watch, _full_context(inputs, watch.arm), excitation)


def _full_context(inputs: ConditionInputs, state: ArmState | None) -> Context:
    """The context with what the controller says of itself."""
    identity, context = inputs.identity, inputs.context
    assert identity is not None
    payload_kg = context.payload_kg
    if payload_kg is None and state is not None and not np.isnan(state.payload_kg):
        payload_kg = state.payload_kg
    return dataclasses.replace(
        context,
        robot=inputs.robot.name,
        serial=identity.serial or context.serial,
        firmware=identity.firmware or context.firmware,
        mounting_rad=inputs.excitation.mounting.angles_rad,
        payload_kg=payload_kg,
        trajectory_digest=inputs.excitation.digest,
        software=f"joint-monitor {__version__}",
    )


def _recording(watch: Watch, context: Context, excitation: Excitation) -> Recording:
    """The rows as signals, with the quality of their acquisition."""
    message, settings = watch.last_word, watch.settings
    assert message is not None
    table = columns(np.array(watch.rows))
    t_s, host_s = table["timestamp"], table["host_monotonic_s"]
    ticks = np.diff(t_s) * settings.rate_hz  # (N−1,)
    pacing_ms = 1000.0 * np.abs(np.diff(host_s) - np.diff(t_s))  # (N−1,) how far the host's steps differ from the controller's
    following = np.abs(table["actual_q"] - table["target_q"])  # (N, J)
    quality = {
        **tick_quality(table, settings.rate_hz),
        "torn_reads": int(message["torn_reads"]),
        "slipped_s": float(message["slipped_s"]),
        "max_following_error_rad": float(np.max(following)),
        "min_speed_scaling": float(np.min(table["speed_scaling"])),
        "latency_p99_ms": latency_p99_ms(table),
        "pacing_p99_ms": float(np.quantile(pacing_ms, 0.99)),
        "pacing_max_ms": float(np.max(pacing_ms)),
        "rate_hz": settings.rate_hz,
        "repetitions": excitation.repetitions,
        "time_scale": excitation.time_scale,
        "late_share": float(np.mean((ticks > 1.5) | (pacing_ms > 500.0 / settings.rate_hz))),  # of the rows, late by half a tick or more
        "longest_gap_ms": 1000.0 * float(message["longest_gap_s"]),
        "real_time_priority": bool(message["real_time"]),
        "controller_clock_at_start_s": float(t_s[0]),
        "host_clock_at_start_unix_s": watch.first_row_unix_s,
    }
    return recording_from_columns(
        table,
        context=dataclasses.replace(context, recorded_at_unix_s=watch.first_row_unix_s),
        quality=quality,
        source=f"replay on {settings.host}",
    )
