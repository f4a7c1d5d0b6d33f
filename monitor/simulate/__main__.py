"""python -m monitor.simulate: one simulated robot on a loopback address, until SIGINT or SIGTERM."""

import argparse
import logging
import sys
from pathlib import Path

from monitor.errors import MonitorError
from monitor.model.robot import robot_names
from monitor.simulate.launch import numbers, settings_from
from monitor.simulate.program_tree import load_tree
from monitor.simulate.scenario import load_scenario
from monitor.simulate.settings import CONTROL_SCRIPTS, PERSONALITIES, SimulateSettings


def main(arguments: list[str] | None = None) -> int:
    """Parse the arguments and simulate. Returns 2 if the arguments or the ports are wrong."""
    defaults = SimulateSettings()
    parser = argparse.ArgumentParser(prog="python -m monitor.simulate", description=__doc__)
    parser.add_argument("--robot", help=f"one of {', '.join(robot_names())}")
    parser.add_argument("--bind", default=defaults.bind, help="loopback address; one robot an address")
    parser.add_argument("--seed", type=int, default=defaults.seed, help="of the measurement noise")
    parser.add_argument("--scenario", metavar="NAME|FILE", help="what happens in this arm's life; a shipped one or one's own TOML")
    parser.add_argument("--ambient", type=float, metavar="C", help="room temperature [°C]")
    parser.add_argument("--mounting", help="ground, ceiling, wall or ROLL,PITCH,YAW in degrees")
    parser.add_argument("--payload", type=float, metavar="KG")
    parser.add_argument("--command-port", type=int, default=defaults.command_port)
    parser.add_argument("--robot-api-port", type=int, default=defaults.robot_api_port, help="of a PolyScope X; 80 may need rights")
    parser.add_argument("--polyscope", default=None, metavar="VERSION", help="version to report, e.g. 5.11.0")
    parser.add_argument("--protective-runtime", default=defaults.protective_runtime, choices=["paused", "stopped", "playing"])
    parser.add_argument("--personality", default=defaults.personality, choices=PERSONALITIES, help="what is published beside the motion")
    parser.add_argument("--run-in", type=float, metavar="SHARE", help="what rest adds to friction, gone after some 15 s of motion")
    parser.add_argument("--program", metavar="FILE", help="production program that is loaded, as TOML")
    parser.add_argument("--cell", metavar="NAME", help="production cell around the arm, whose program plays")
    parser.add_argument("--control-script", default=defaults.control_script, choices=CONTROL_SCRIPTS, help="how ur-rtde's script is played")
    parser.add_argument(
        "--home", metavar="Q1,…,Q6", help="joint positions at the start [rad]; as --home=…, since they may begin with a minus"
    )
    parser.add_argument("--wear-per-revolution", metavar="W1,…,W6", help="growth of friction a turn at rated load, per joint")
    parser.add_argument("--local-control", action="store_true", help="say no to `is in remote control`")
    parser.add_argument("--verbose", action="store_true")
    given = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO if given.verbose else logging.WARNING, format="%(name)s %(message)s", stream=sys.stderr)
    try:
        settings = settings_from(
            None if given.scenario is None else load_scenario(given.scenario),
            robot=given.robot,
            bind=given.bind,
            seed=given.seed,
            ambient_c=given.ambient,
            mounting=given.mounting,
            payload_kg=given.payload,
            command_port=given.command_port,
            robot_api_port=given.robot_api_port,
            version=given.polyscope,
            protective_runtime=given.protective_runtime,
            personality=given.personality,
            control_script=given.control_script,
            run_in=given.run_in,
            cell=given.cell,
            program=None if given.program is None else load_tree(Path(given.program)),
            home_rad=numbers("--home", given.home),
            remote_control=not given.local_control,
            wear_per_revolution=numbers("--wear-per-revolution", given.wear_per_revolution),
        )
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
