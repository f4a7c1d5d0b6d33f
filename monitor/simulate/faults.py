"""What can go wrong, on command."""

from collections.abc import Callable

from monitor.errors import BadInput
from monitor.simulate.controller import Controller
from monitor.simulate.ports import Ports

STALL_MAX_S = 3600.0


def inject(name: str, argument: float | None, controller: Controller, ports: Ports, now_s: float) -> str:
    """Make one fault happen; what was done.

    Raises BadInput for an unknown name or argument.
    """

    def stall() -> str:
        if argument is None or not 0.0 < argument <= STALL_MAX_S:
            raise BadInput(f"fault stall: seconds = {argument}; expected 0 … {STALL_MAX_S:g}")
        ports.muted_until_s = now_s + argument
        return f"no RTDE data for {argument:g} s"

    def program_stop() -> str:
        return "program stopped" if controller.stop_program("fault: program_stop") else "no program was running"

    def done(act: Callable[[], object], said: str) -> Callable[[], str]:
        def run() -> str:
            act()
            return said

        return run

    known: dict[str, Callable[[], str]] = {
        "stall": stall,
        "close": lambda: f"closed {ports.drop_rtde(reset=False)} RTDE connections",
        "reset": lambda: f"reset {ports.drop_rtde(reset=True)} RTDE connections",
        "program_stop": program_stop,
        "protective_stop": done(lambda: controller.protective_stop("fault: protective_stop"), "protective stop"),
        "emergency_stop": done(controller.emergency_stop, "emergency stop"),
        "emergency_release": done(controller.release_emergency_stop, "emergency stop released, power is off"),
    }
    if name not in known:
        raise BadInput(f"fault {name!r} is not known; known are {', '.join(sorted(known))}")
    return known[name]()
