"""What `identify --json` finds in real recordings, saved and compared: `python -m tests.house.identify_results --save DIR | --compare A B`.

The recordings are not part of this repository: `JOINT_MONITOR_DATA`, or `../shared/data` beside the checkout. Nothing of them is kept here.
Two sets are the same where every figure agrees to 1e-9 of its size; keys that only one of them has, and texts, are told apart.
"""

import argparse
import json
import math
import os
import subprocess
import sys
from pathlib import Path

DATA = Path(os.environ.get("JOINT_MONITOR_DATA", Path(__file__).parents[3] / "shared" / "data"))
SAME = 1e-9  # of a figure's size
UR10E = (
    "--robot",
    "ur10e",
    "--columns",
    "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6",
    "--gains",
    "14.87,13.26,11.13,10.62,11.03,11.47",
)
RUNS = {
    **{
        f"ur10e {name} {method}": (f"ur10e/{name}", *UR10E, "--method", method)
        for name in ("ur-20_02_12-50sec_12harm.csv", "ur-20_02_19_14harm50sec.csv", "ur-20_02_19_14harm50secLoad.csv")
        for method in ("ls", "wls", "robust", "consistent")
    },
    "ur10e auto": ("ur10e/ur-20_02_10-30sec_12harm.csv", *UR10E, "--friction", "auto"),
    "ur10e staircase": ("ur10e/ur-20_01_22-joint_2.csv", *UR10E),
    "ur3e": ("ur3e/rtde_25hz.csv", "--robot", "ur3e", "--gains", "10,10,8,5,5,5"),
    "ur3 warm-up": ("ur3_warmup/dataset_02052023.csv", "--robot", "ur3"),
    "standstill": ("ur_standstill/real_10hz.csv", "--robot", "ur5"),
    "ursim": ("ur_standstill/ursim_125hz.csv", "--robot", "ur5"),
    **{
        f"ur3 {run}": (f"arms/ur3_brasilia/ur3_brasilia_{run}.csv", "--robot", "ur3")
        for run in ("traj1_runA_stopped_12s", "traj1_runD_full", "20191018_all_joints")
    },
    "ur5 kufieta 6": ("arms/ur5_kufieta/ur5_kufieta_move6_cycle26.94s_x3.csv", "--robot", "ur5"),
    "ur5 kufieta 7": ("arms/ur5_kufieta/ur5_kufieta_move7_same_as_move6_once_free.csv", "--robot", "ur5"),
    "ur5 kufieta 4": ("arms/ur5_kufieta/ur5_kufieta_move4_fast_jitter_clock.csv", "--robot", "ur5"),
    "ur10 unisa": ("arms/ur10_unisa/unisa_ur10_exciting_trajectory.csv", "--robot", "ur10"),
    "ur5 nist": ("arms/nist_ur5/nist_ur5_halfspeed_payload1.6lb_1_rtde.csv", "--robot", "ur5"),
    "ur3e aurt": ("arms/ur3e_aurt/one_direction_torque.csv", "--robot", "ur3e"),
    "shanghai": ("arms/shanghai/shanghai_electric_arm_traj1_held_rows_raw_torque.csv", "--robot", "ur5"),
}


def save(folder: Path) -> None:
    """Every run's document, or its refusal, as one file each."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (file, *options) in RUNS.items():
        if not (DATA / file).exists():
            sys.stdout.write(f"skipped, not here: {file}\n")
            continue
        command = [sys.executable, "-m", "monitor", "identify", str(DATA / file), *options, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        found = (
            json.loads(done.stdout) if done.returncode == 0 else {"exit": done.returncode, "says": done.stderr.strip().splitlines()[-1:]}
        )
        (folder / f"{name}.json").write_text(json.dumps(found))
        sys.stdout.write(f"{name}: exit {done.returncode}\n")


def differences(a: object, b: object, at: str = "") -> list[str]:
    """What differs, each with its place."""
    if isinstance(a, dict) and isinstance(b, dict):
        only = [f"{at}.{key}: only in the {'first' if key in a else 'second'}" for key in a.keys() ^ b.keys()]
        return only + [line for key in a.keys() & b.keys() for line in differences(a[key], b[key], f"{at}.{key}")]
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return [line for k, (one, other) in enumerate(zip(a, b, strict=True)) for line in differences(one, other, f"{at}[{k}]")]
    number = isinstance(a, int | float) and isinstance(b, int | float)
    same = math.isclose(a, b, rel_tol=SAME, abs_tol=1e-12) if number else a == b
    return [] if same else [f"{at}: {str(a)[:80]} → {str(b)[:80]}"]


def main() -> int:
    """1 where two sets differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--save", type=Path)
    parser.add_argument("--compare", type=Path, nargs=2)
    given = parser.parse_args()
    if given.save:
        save(given.save)
        return 0
    before, after = given.compare
    wrong = 0
    for path in sorted(before.glob("*.json")):
        found = differences(json.loads(path.read_text()), json.loads((after / path.name).read_text()))
        figures = [line for line in found if "only in" not in line and ".text" not in line]
        wrong += bool(figures)
        sys.stdout.write(f"{path.stem}: {len(figures)} figures differ, {len(found) - len(figures)} names or texts\n")
        sys.stdout.writelines(f"  {line}\n" for line in found[:20])
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
