"""Remote: the command port of a running simulator, as an object."""

import base64
import binascii
import io
import json
import socket
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np

from monitor.errors import BadInput, MonitorError, ReplayAborted, RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.recording import Array, Context, Recording
from monitor.simulate.settings import DEFAULT_COMMAND_PORT

KINDS: dict[str, type[MonitorError]] = {"BadInput": BadInput, "ReplayAborted": ReplayAborted}
Rows = Array | Sequence[Sequence[float]]


class Remote:
    """Ask the simulator for the truth, and make its time, wear and faults. Context manager; connects at once.

    Raises RobotUnreachable where nobody answers, BadInput or ReplayAborted as the simulator says.
    """

    def __init__(self, host: str, port: int = DEFAULT_COMMAND_PORT, timeout_s: float = 120.0) -> None:
        self._where = f"{host}:{port}"
        try:
            self._wire = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as wrong:
            raise RobotUnreachable(f"{self._where}: no simulator answers ({wrong}); is `joint-monitor simulate` running there?") from None
        self._wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._file = self._wire.makefile("rb")

    def __enter__(self) -> "Remote":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the connection; the simulator goes on."""
        self._file.close()
        self._wire.close()

    def ask(self, do: str, **arguments: Any) -> Any:
        """One request, its result."""
        try:
            self._wire.sendall(json.dumps({"do": do, **arguments}).encode() + b"\n")
            line = self._file.readline()
        except OSError as wrong:
            raise RobotUnreachable(f"{self._where}: the simulator does not answer ({wrong})") from None
        if not line:
            raise RobotUnreachable(f"{self._where}: the simulator closed the connection")
        reply = json.loads(line)
        if not reply["ok"]:
            raise KINDS.get(reply["kind"], MonitorError)(reply["error"])
        return reply["result"]

    def truth(self) -> dict[str, Any]:
        """Everything that the robot's own wire does not tell: true state, temperatures, wear, law of friction, stops."""
        result: dict[str, Any] = self.ask("truth")
        return result

    def advance(self, hours: float, ambient_c: float | None = None, duty: float | None = None) -> float:
        """Let hours pass, `duty` (0 … 1) of them a typical job, in a room at `ambient_c`; the controller's clock afterwards [s].

        What is not given is as the scenario has it; without a scenario no work, and the room as it was.
        """
        return float(self.ask("advance", hours=hours, ambient_c=ambient_c, duty=duty)["clock_s"])

    def wear(
        self,
        joint: int,
        *,
        coulomb_factor: float | None = None,
        viscous_factor: float | None = None,
        per_revolution: float | None = None,
    ) -> None:
        """Set the friction multipliers of joint 1 … J, or how much they grow from now on with a revolution under rated load."""
        self.ask("wear", joint=joint, coulomb_factor=coulomb_factor, viscous_factor=viscous_factor, per_revolution=per_revolution)

    def play(self, excitation: Excitation, *, software: str | None = None) -> Recording:
        """A replay stepped faster than real time inside the simulator."""
        result = self.ask("play", excitation=excitation.as_document(), software=software)
        try:
            with np.load(io.BytesIO(base64.b64decode(result["signals"], validate=True)), allow_pickle=False) as file:
                signals = {name: file[name] for name in file.files}
        except (binascii.Error, ValueError, OSError) as wrong:
            raise MonitorError(f"{self._where}: the recording did not arrive whole ({wrong})") from None
        context = result["context"]
        context["mounting_rad"] = tuple(context["mounting_rad"])
        return Recording(**signals, context=Context(**context), quality=result["quality"], source=result["source"])

    def torque(self, q: Rows, qd: Rows, qdd: Rows, temperature_c: float | Array | None = None) -> Array:
        """(N, J) noise-free motor-side torque [N·m] at states (N, J): rigid body, rotors, friction; temperature of the grease."""
        return np.array(self._states("torque", q=q, qd=qd, qdd=qdd, temperature_c=temperature_c)["torque"])

    def friction(self, qd: Rows, temperature_c: float | Array | None = None, load_nm: Rows | None = None) -> Array:
        """(N, J) friction torque [N·m] at speeds (N, J), with today's wear; load through the gear defaults to none."""
        return np.array(self._states("friction", qd=qd, temperature_c=temperature_c, load_nm=load_nm))

    def _states(self, do: str, **arrays: Any) -> Any:
        return self.ask(do, **{name: None if value is None else np.asarray(value, dtype=float).tolist() for name, value in arrays.items()})

    def fault(self, name: str, **arguments: Any) -> str:
        """Make one of `faults.FAULTS` happen, e.g. `fault("stall", seconds=2)`; what was done."""
        return str(self.ask("fault", name=name, **arguments))

    def protective_stop(self) -> None:
        """As if the arm had hit something."""
        self.fault("protective_stop")

    def shutdown(self) -> None:
        """End the simulator."""
        self.ask("shutdown")
