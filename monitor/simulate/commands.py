"""The true state of an arm and its controller. Tests compare with it, and the terminal view shows it."""

import asyncio
import base64
import io
import json
import logging
import math
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from monitor.errors import BadInput, MonitorError
from monitor.model.fourier import excitation_from_document
from monitor.recording import Array, Recording
from monitor.simulate import stepped
from monitor.simulate.arm.damage import DAMAGES
from monitor.simulate.controller.controller import Controller
from monitor.simulate.wire.robot import ServedRobot


def truth(controller: Controller) -> dict[str, Any]:
    """The true state as JSON values. The robot's own wire publishes only a part of it, with noise."""
    arm, law, modes, journal = controller.arm, controller.arm.law, controller.modes, controller.journal
    program, watchdog = controller.programs.current, controller.machine.watchdog
    return {
        "robot": controller.robot.name,
        "clock_s": controller.clock.now_s,
        "q": arm.q.tolist(),
        "qd": arm.qd.tolist(),
        "torque_nm": arm.torque_nm.tolist(),
        "motor_temperature_c": arm.temperatures.motor_c.tolist(),
        "grease_temperature_c": arm.temperatures.grease_c.tolist(),
        "ambient_c": arm.ambient_c,
        "lived_days": controller.scenario.lived_s / 86_400.0,
        "scenario": controller.scenario.scenario.name,
        "happened": controller.scenario.happened[-50:],
        "joint_serials": controller.identity.joint_serials,
        "mounting_rad": list(arm.mounting.angles_rad),
        "declared_payload_kg": controller.installation.payload[0],
        "wear_coulomb": arm.wear.coulomb.tolist(),
        "wear_viscous": arm.wear.viscous.tolist(),
        "wear_per_revolution": arm.wear.per_revolution.tolist(),
        "revolutions": arm.wear.revolutions.tolist(),
        "run_in_factor": arm.run_in.factor.tolist(),
        "payload_kg": arm.payload_kg,
        "drive_gain_nm_per_a": arm.true_gain_nm_per_a.tolist(),
        "damage": {name: each.tolist() for name, each in arm.damage.severity.items() if each.any()},
        "rotor_kg_m2": arm.rotor_kg_m2.tolist(),
        "friction_law": {name: getattr(law, name).tolist() for name in law.__dataclass_fields__},
        "robot_mode": int(modes.robot),
        "safety_mode": int(modes.safety),
        "runtime_state": int(modes.runtime),
        "reference_mode": controller.reference.mode,
        "standing": controller.machine.standing,
        "program": type(program).__name__ if program else None,
        "popup": modes.popup,
        "scripts_started": journal.scripts_started,
        "stops": [asdict(stop) for stop in journal.stops],
        **journal.logbook.document(),
        "watchdog_trips": journal.watchdog_trips,
        "watchdog_s": None if watchdog.variable is None else watchdog.limit_s,
        "refused_commands": list(journal.refused_commands),
        "refused_scripts": list(journal.refused_scripts),
        "output_integers": controller.registers.output_ints[:24],
        "odd_inputs": controller.registers.odd_inputs,
    }


# --- The command port: every request and every reply is a line with one JSON object ---------------------

log = logging.getLogger(__name__)

LINE_MAX_BYTES = 32 << 20  # a request for torques with ROWS_MAX rows
ROWS_MAX = 20_000
HOURS_MAX = 24.0 * 366
WEAR_MAX = 100.0


@dataclass(slots=True)
class TickCounts:
    """How the server's timer keeps time."""

    tick_s: float  # the control period
    run: int = 0  # control periods computed
    late: int = 0  # expirations that came after more than one period
    dropped: int = 0  # control periods that were never computed


class Commands:
    """Answers requests about one robot. `stepping` tells whether a stepped replay is running."""

    def __init__(self, robot: ServedRobot, ticks: TickCounts, shut_down: Callable[[], None]) -> None:
        self._robot, self._ticks, self._shut_down = robot, ticks, shut_down
        self.stepping = False
        self.faults: list[str] = []  # that were made here since the last `clear`
        self._actions: dict[str, Callable[[dict[str, Any]], Awaitable[Any]]] = {
            "truth": self._truth,
            "advance": self._advance,
            "wear": self._wear,
            "play": self._play,
            "torque": self._torque,
            "friction": self._friction,
            "fault": self._fault,
            "shutdown": self._shutdown,
        }

    @property
    def _controller(self) -> Controller:
        return self._robot.controller

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until it ends."""
        try:
            while line := await reader.readline():
                writer.write(json.dumps(await self._answer(line)).encode() + b"\n")
                await writer.drain()
        except (ValueError, ConnectionError) as wrong:  # a line beyond the limit, or a client that went away
            log.info("command connection ended: %s", wrong)
        except asyncio.CancelledError:  # the simulator ends
            log.info("command connection ended with the simulator")
        finally:
            writer.close()

    async def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            do = request.get("do") if isinstance(request, dict) else None
            if not isinstance(do, str) or do not in self._actions:
                raise BadInput(f"request: expected an object whose 'do' is one of {', '.join(self._actions)}")
            return {"ok": True, "result": await self._actions[do](request)}
        except MonitorError as wrong:
            return {"ok": False, "error": str(wrong), "kind": type(wrong).__name__}
        except (ValueError, RecursionError) as wrong:  # no JSON, or no numbers
            return {"ok": False, "error": f"request: {wrong}", "kind": "BadInput"}

    async def _truth(self, _: dict[str, Any]) -> dict[str, Any]:
        state = {
            "ticks": asdict(self._ticks),
            "stepping": self.stepping,
            "faults": self.faults,
            "connections": self._robot.ports.connections(),
        }
        return {**truth(self._controller), **state}

    async def _advance(self, request: dict[str, Any]) -> dict[str, Any]:
        hours = _number(request, "hours", 0.0, HOURS_MAX)
        scenario = self._controller.settings.scenario
        duty = None if scenario and request.get("duty") is None else _number(request, "duty", 0.0, 1.0, default=0.0)
        ambient_c = None if request.get("ambient_c") is None else _number(request, "ambient_c", -20.0, 60.0)
        obstacle = self._controller.pass_time(hours, ambient_c, duty)
        if obstacle:
            raise BadInput(f"advance: {obstacle}")
        return {"clock_s": self._controller.clock.now_s, "lived_days": self._controller.scenario.lived_s / 86_400.0}

    async def _wear(self, request: dict[str, Any]) -> dict[str, Any]:
        wear, joints = self._controller.arm.wear, self._controller.robot.joints
        joint = _number(request, "joint", 1, joints)
        if joint != int(joint):
            raise BadInput(f"wear: joint = {joint:g}; expected 1 … {joints}")
        factors = {
            name: None if request.get(key) is None else _number(request, key, 0.0, WEAR_MAX)
            for name, key in (
                ("coulomb", "coulomb_factor"),
                ("viscous", "viscous_factor"),
                ("per_revolution", "per_revolution"),
            )
        }
        self._controller.arm.set_wear(int(joint) - 1, **factors)
        return {"wear_coulomb": wear.coulomb.tolist(), "wear_viscous": wear.viscous.tolist()}

    async def _play(self, request: dict[str, Any]) -> dict[str, Any]:
        excitation = excitation_from_document(request.get("excitation"))
        if self.stepping:
            raise BadInput("play: another stepped replay is running")
        self.stepping = True
        try:
            playing = stepped.play(self._controller, excitation, software=request.get("software"))
            while True:
                try:
                    next(playing)
                except StopIteration as done:
                    return packed(done.value)
                await asyncio.sleep(0)
        finally:
            self.stepping = False

    async def _torque(self, request: dict[str, Any]) -> dict[str, Any]:
        arm = self._controller.arm
        q, qd, qdd = (self._rows(request, name) for name in ("q", "qd", "qdd"))
        if not q.shape == qd.shape == qdd.shape:
            raise BadInput(f"torque: q is {q.shape}, qd {qd.shape}, qdd {qdd.shape}; expected equal shapes")
        rigid, load = arm.rigid_torque(q, qd, qdd)
        friction = arm.friction_torque(qd, load, self._temperature(request))
        return {"torque": (rigid + friction).tolist(), "rigid": rigid.tolist(), "friction": friction.tolist()}

    async def _friction(self, request: dict[str, Any]) -> list[list[float]]:
        qd = self._rows(request, "qd")
        load = self._rows(request, "load_nm") if request.get("load_nm") is not None else np.zeros_like(qd)
        if load.shape != qd.shape:
            raise BadInput(f"friction: qd is {qd.shape}, load_nm is {load.shape}; expected equal shapes")
        torque: list[list[float]] = self._controller.arm.friction_torque(qd, load, self._temperature(request)).tolist()
        return torque

    async def _fault(self, request: dict[str, Any]) -> str:
        name = str(request.get("name"))
        said = self._controller.inject(name, {key: value for key, value in request.items() if key not in {"do", "name"}})
        if name not in DAMAGES:  # a damaged joint moves on, and replays are stepped as before
            self.faults = [] if name in {"clear", "recover"} else [*self.faults, name]
        return said

    async def _shutdown(self, _: dict[str, Any]) -> str:
        asyncio.get_running_loop().call_later(0.05, self._shut_down)  # after the reply
        return "bye"

    def _rows(self, request: dict[str, Any], name: str) -> Array:
        rows = _array(request, name)
        joints = self._controller.robot.joints
        if rows.ndim != 2 or rows.shape[1] != joints or len(rows) > ROWS_MAX:
            raise BadInput(f"{name} is {rows.shape}; expected (N, {joints}) with N ≤ {ROWS_MAX}")
        return rows

    def _temperature(self, request: dict[str, Any]) -> Array | None:
        if request.get("temperature_c") is None:
            return None
        temperature = _array(request, "temperature_c")
        if temperature.ndim > 2 or (temperature.ndim and temperature.shape[-1] != self._controller.robot.joints):
            raise BadInput(f"temperature_c is {temperature.shape}; expected one number, ({self._controller.robot.joints},) or (N, J)")
        return temperature


def packed(recording: Recording) -> dict[str, Any]:
    """A recording as a JSON object; its signals are an npz file in base64."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **recording.signals)
    return {
        "signals": base64.b64encode(file.getvalue()).decode(),
        "context": asdict(recording.context),
        "quality": dict(recording.quality),
        "source": recording.source,
    }


def _number(request: dict[str, Any], name: str, low: float, high: float, *, default: float | None = None) -> float:
    value = request.get(name, default)
    value = default if value is None else value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) or not low <= value <= high:
        raise BadInput(f"{name} = {value!r}; expected a number from {low:g} to {high:g}")
    return float(value)


def _array(request: dict[str, Any], name: str) -> Array:
    try:
        array = np.array(request[name], dtype=float)
    except KeyError:
        raise BadInput(f"{name} is missing") from None
    except (TypeError, ValueError) as wrong:
        raise BadInput(f"{name}: {wrong}") from None
    if not np.isfinite(array).all():
        raise BadInput(f"{name} holds values that are not finite")
    return array
