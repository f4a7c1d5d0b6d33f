"""`python -m tests.evidence.worlds NAME [NAME…|all]`: one line a world."""

import argparse
import json
import sys
from typing import Any

from monitor.judge.settings import AssessSettings
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import play_world

from . import at_least_one
from .informed import informed_beside

COUNTED = """What is counted. The first 60 days of every arm are for learning and left out. False advisories are those of healthy arms (N of
them), over all days after learning: of each joint the first rise to any tier and the first alert of fallen friction, of each arm the first
common alert (of all joints together). In some worlds a kind is the right word for what happens and not counted: the line names what is.
"again" counts those that come back after 30 days without; "day 60–120" and the like are the counted ones a robot-year at that age of the
arm, those of weights left out. Every kind of wear of the world is put into further arms (half as many of each),
from a day between 60 and 425 on; days to detection run from the onset to the first tier of the joint that wears (of any of them, or the
common alert, where three or more wear), the onset's day included; arms in which that was raised before the onset are left out. Right joint:
no other joint's tier came between onset and detection, of the arms where anything was found. Coverage: share of days on which the 90 %
interval of friction at T0 (with the undetected-change mixture) holds the truth, of healthy joints, of worn ones from the onset on, of these
until the detection. Remaining life is asked at 50 and 75 % of the time from the onset to the limit, where wear has such a time: P10–P90
holds, P50 within 20 %, median of P50 over the truth. The judge's functions are the daemon's (`step`, `weigh_evidence`);
nobody counts revolutions."""


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


def world_line(document: dict[str, Any]) -> str:
    """The figures in one line."""
    false, goal = document["false_advisories"], document["goal"]
    each = " ".join(f"{name} {false[name]['per_year']:.2f}" for name in ("rising", "falling", "common"))
    again = sum(false[name]["again"] for name in ("rising", "falling", "common"))
    counted, kinds = false["counted"], "+".join(false["counted"]["kinds"])
    line = (
        f"{document['world']:20s} {counted['per_year']:.3f}/y (≤ {counted['at_most']:.3f}, asked {goal['false_advisories']:g}, {kinds}): "
        f"{each} again {again} in {document['robot_years']:.0f} y; "
        + ", ".join(f"day {part['from_day']:.0f}–{part['to_day']:.0f} {part['per_year']:.2f}" for part in false["by_life"])
    )
    for row in document["detection"]:
        median, p90 = ("never" if row[key] is None else f"{row[key]:.0f}" for key in ("median_days", "p90_days"))
        asked = f" asked {goal['median_days'][row['wear']]:g}" if row["wear"] in goal["median_days"] else ""
        right = row["right_joint"]["share"]
        line += (
            f" | {row['wear']}: {median}/{p90} d{asked}, ≤30 d {_whole(row['within_30_days']['share'])}, "
            f"never {_whole(row['never']['share'])}, 90 % until then {_whole(row['interval_90_undetected'])}, right {_whole(right)}, "
            f"before {row['raised_before']}/{row['arms'] + row['raised_before']}"
        )
        for life in row["remaining_life"]:
            ratio = "–" if life["p50_over_truth"] is None else f"{life['p50_over_truth']:.2f}"
            line += (
                f", at {life['at_share_of_life']:g} of life: holds {_whole(life['p10_p90_holds']['share'])}, "
                f"near {_whole(life['p50_near']['share'])}, P50/truth {ratio}, no date {life['without_date']}/{life['asked']}"
            )
    cover = document["interval_90"]
    return f"{line} | 90 %: {_whole(cover['healthy'])} worn {_whole(cover['worn'])} | {document['processor_s']:.0f} s"


def _whole(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


if __name__ == "__main__":
    main()
