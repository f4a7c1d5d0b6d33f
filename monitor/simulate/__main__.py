"""python -m monitor.simulate: one simulated robot on a loopback address, until SIGINT or SIGTERM.

It starts faster than `joint-monitor simulate`, whose help says what its options mean.
"""

import argparse
import logging
import sys

from monitor.errors import MonitorError
from monitor.simulate.launch import settings_of_options

OPTIONS: dict[str, tuple[str, type]] = {  # option → field of the settings, or an argument of `settings_of_options`
    **{name: (name.replace("-", "_"), str) for name in ("robot", "bind", "scenario", "mounting", "personality", "control-script", "cell")},
    **{name: (name.replace("-", "_"), str) for name in ("protective-runtime", "program", "home", "wear-per-revolution")},
    **{name: (name.replace("-", "_"), int) for name in ("seed", "command-port", "robot-api-port")},
    "polyscope": ("version", str),
    "ambient": ("ambient_c", float),
    "payload": ("payload_kg", float),
    "run-in": ("run_in", float),
}


def main(arguments: list[str] | None = None) -> int:
    """Parse the arguments and simulate. Returns 2 if the arguments or the ports are wrong."""
    parser = argparse.ArgumentParser(prog="python -m monitor.simulate", description=__doc__, argument_default=argparse.SUPPRESS)
    for option, (field, kind) in OPTIONS.items():
        parser.add_argument(f"--{option}", dest=field, type=kind)
    parser.add_argument("--local-control", dest="remote_control", action="store_false", help="say no to `is in remote control`")
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(name)s %(message)s", datefmt="%Y-%m-%dT%H:%M:%S%z", stream=sys.stderr)
    try:
        settings = settings_of_options(**vars(parser.parse_args(arguments)))
        from monitor.simulate.server import serve  # pinocchio is slow to import: only when the arguments are right

        line = f"listening {settings.bind} robot={settings.robot} rtde=30004 commands={settings.command_port}\n"

        def ready() -> None:
            sys.stdout.write(line)
            sys.stdout.flush()

        serve(settings, on_ready=ready)
    except MonitorError as wrong:
        sys.stderr.write(f"{wrong}\n")
        return wrong.exit_code
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
