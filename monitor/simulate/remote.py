"""The client of a simulator's command port."""

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
    """Reads the true state of a running simulator, and changes its time, wear and faults. A context manager that connects at once.

    Every method raises RobotUnreachable if the simulator does not answer, and the simulator's own errors: BadInput, ReplayAborted.
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
        """Close the connection. The simulator keeps running."""
        self._file.close()
        self._wire.close()

    def ask(self, do: str, **arguments: Any) -> Any:
        """Send one request. Returns its result."""
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
        """The true state: motion, temperatures, wear, friction law, modes and stops."""
        result: dict[str, Any] = self.ask("truth")
        return result

    def advance(self, hours: float, ambient_c: float | None = None, duty: float | None = None) -> float:
        """Let hours pass in a room at `ambient_c`, with the share `duty` (0 … 1) of work. Returns the controller's clock afterwards [s].

        None means as in the scenario; without a scenario it means no work and the present temperature.
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
        """Set the wear factors of one joint (1 … J), or their growth per revolution at rated load."""
        self.ask("wear", joint=joint, coulomb_factor=coulomb_factor, viscous_factor=viscous_factor, per_revolution=per_revolution)

    def play(self, excitation: Excitation, *, software: str | None = None) -> Recording:
        """Make the simulator play an excitation faster than real time. Returns the recording."""
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
        """(N, J) drive torque without noise at states (N, J): rigid body, rotors and friction at a grease temperature [N·m]."""
        return np.array(self._states("torque", q=q, qd=qd, qdd=qdd, temperature_c=temperature_c)["torque"])

    def friction(self, qd: Rows, temperature_c: float | Array | None = None, load_nm: Rows | None = None) -> Array:
        """(N, J) friction torque at speeds (N, J) with the present wear [N·m]. The load through the gears is zero if it is None."""
        return np.array(self._states("friction", qd=qd, temperature_c=temperature_c, load_nm=load_nm))

    def _states(self, do: str, **arrays: Any) -> Any:
        return self.ask(do, **{name: None if value is None else np.asarray(value, dtype=float).tolist() for name, value in arrays.items()})

    def fault(self, name: str, **arguments: Any) -> str:
        """Inject one of `faults.FAULTS`, for example `fault("stall", seconds=2)`. Returns a sentence that says what was done."""
        return str(self.ask("fault", name=name, **arguments))

    def protective_stop(self) -> None:
        """Make a protective stop, as if the arm had hit something."""
        self.fault("protective_stop")

    def shutdown(self) -> None:
        """End the simulator."""
        self.ask("shutdown")
