"""`python -m tests.evidence.worlds NAME [NAME…|all]`: one line a world."""

import argparse
import json
import sys

from monitor.judge.settings import AssessSettings
from monitor.studies.figures import at_least_one
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import COUNTED, play_world, world_line

from .informed import informed_beside


def main() -> None:
    """Play the worlds that the command line names."""
    listed = "\n".join(f"  {name:22s}{world.sentence}" for name, world in WORLDS.items())
    parser = argparse.ArgumentParser(
        prog="python -m tests.evidence.worlds",
        description=__doc__,
        epilog=f"{COUNTED}\n\nWorlds:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="+", metavar="NAME", help="worlds, or: all")
    parser.add_argument("--arms", type=at_least_one, default=60, help="healthy arms; half as many of each kind of wear (default 60)")
    parser.add_argument("--days", type=at_least_one, default=1095, help="of every arm's life (default 1095)")
    parser.add_argument("--seed", type=int, default=1, help="1 to 99 are for development; larger ones nobody looks at before the end")
    parser.add_argument("--informed", action="store_true", help="also what an observer who knows the noise reaches, of days to detection")
    parser.add_argument("--json", action="store_true", help="one object a line")
    arguments = parser.parse_args()
    names = list(WORLDS) if arguments.names == ["all"] else arguments.names
    if unknown := [name for name in names if name not in WORLDS]:
        parser.error(f"no world {', '.join(unknown)}; expected of: {', '.join(WORLDS)}, all")
    for name in names:
        document = play_world(WORLDS[name], AssessSettings(), arms=arguments.arms, days=arguments.days, seed=arguments.seed)
        sys.stdout.write((json.dumps(document, allow_nan=False) if arguments.json else world_line(document)) + "\n")
        if arguments.informed:
            for row in informed_beside(document, arms=arguments.arms, days=arguments.days, seed=arguments.seed):
                sys.stdout.write(json.dumps({"world": name, "observer": "informed", **row}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
