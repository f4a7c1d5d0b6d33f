"""`python -m tests.evidence.campaigns`: torque at 12 and 45 °C after one cold morning and one warm afternoon, as a campaign makes them.

Simulated arms whose friction law is none of the monitor's (dry and load-dependent, concave in speed, exponential in the temperature of a
grease that lags the sensor) are replayed from cold until they are steady, or MOST times, and again after an afternoon of work in a warm
room. Then the torque of a motion at 12 and at 45 °C is predicted, and compared with that of the simulated drives without noise.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.assessment import Assessment
from monitor.judge.settings import AssessSettings
from monitor.judge.torque.predictor import predict_torque
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.model.robot import Robot, load_robot
from monitor.service.campaign import Made, steady
from monitor.simulate.arm.friction import default_law
from monitor.simulate.arm.thermal import Temperatures
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.studies.figures import NINETY, SLIDING_RAD_S
from monitor.studies.rehearsal.fleet import various

from . import at_least_one
from .torque import judged

START_UNIX_S = 1_750_000_000.0
EVERY_S = 60.0  # from one replay of a campaign to the next: approach, 10 s of motion, assessment
MORNING_C, AFTERNOON_C = 8.0, 30.0  # of the room: joints at rest are 3 K warmer
MOST = 16  # replays of one campaign
TESTED_C = (12.0, 45.0)


def study_arm(seed: int, excitation: Excitation, robot: str = "ur5") -> dict[str, Any]:
    """Of each of TESTED_C: RMS of error and of ± of the torque in motion [N·m], the share within the 90 % interval, extrapolated joints."""
    arm, rng = load_robot(robot), np.random.default_rng(seed)
    law = various(default_law(arm), (), rng)
    noisy, quiet = (Controller(SimulateSettings(robot=robot, seed=seed, current_noise=noise), law=law) for noise in (1.0, 0.0))
    last: Assessment | None = None
    counts, spans, alerts = [], [], set()
    for hours, room_c, duty, at in ((14.0, MORNING_C, 0.0, START_UNIX_S), (6.0, AFTERNOON_C, 0.9, START_UNIX_S + 9 * 3600.0)):
        noisy.pass_time(hours, room_c, duty)
        made: list[Made] = []
        while len(made) < MOST and not (made and steady(made, 0.5)):
            recording = stepped_replay(noisy, excitation)
            now = at + EVERY_S * len(made)
            recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=now))
            last = judged(recording, arm, last, AssessSettings())
            alerts |= {(alert.joint, alert.condition) for alert in last.health.alerts if alert.active}
            made.append(Made(len(made), now, tuple(last.belief.temperature_c.tolist())))
            noisy.pass_time((EVERY_S - recording.duration_s) / 3600.0, room_c, 0.5)
        counts.append(len(made))
        spans.append([float(np.mean(each.temperature_c)) for each in (made[0], made[-1])])
    assert last is not None
    return {
        "seed": seed,
        "replays": counts,
        "mean_c": spans,
        "alerts": len(alerts),
        "tests": [_tested(quiet, arm, last, excitation, T) for T in TESTED_C],
    }


def _tested(controller: Controller, robot: Robot, last: Assessment, excitation: Excitation, T: float) -> dict[str, Any]:
    controller.arm.ambient_c = T - 3.0
    controller.arm.set_temperatures(Temperatures(*np.full((2, robot.joints), T)))
    recording = stepped_replay(controller, excitation)
    seen, q, qd, qdd = recording.mean_temperature_c, recording.target_q, recording.target_qd, recording.target_qdd
    if seen is None or q is None or qd is None or qdd is None or recording.current is None:
        raise BadInput("campaign study: the simulated recording lacks its targets, currents or temperatures")
    predicted = predict_torque(last.model, robot, q, qd, qdd, seen)
    error = predicted.torque - recording.current * controller.arm.gain_nm_per_a
    moving = np.abs(qd) > SLIDING_RAD_S
    n = moving.sum(axis=0)

    def rms(values: Any) -> list[float]:
        found: list[float] = np.sqrt(np.sum(np.where(moving, values, 0.0) ** 2, axis=0) / n).tolist()
        return found

    return {
        "temperature_c": float(np.mean(seen)),
        "error_nm": rms(error),
        "std_nm": rms(predicted.std),
        "torque_nm": rms(predicted.torque),
        "inside": (np.sum(moving & (np.abs(error) < NINETY * predicted.std), axis=0) / n).tolist(),
        "extrapolated": int(predicted.extrapolated.any(axis=0).sum()),
    }


def line(found: dict[str, Any]) -> str:
    """One arm as a row of the table."""
    cells = [
        str(found["seed"]),
        " + ".join(map(str, found["replays"])),
        ", ".join(f"{low:.0f} → {high:.0f}" for low, high in found["mean_c"]),
    ]
    for test in found["tests"]:
        ratio = np.array(test["error_nm"]) / np.array(test["std_nm"])
        cells += [f"{100 * np.mean(test['inside']):.0f} %", f"{ratio.mean():.2f} ({ratio.max():.2f})"]
    return f"| {' | '.join(cells)} | {found['alerts']} |"


TITLES = (
    "arm",
    "replays",
    "°C, morning, afternoon",
    *(f"{T:g} °C: {what}" for T in TESTED_C for what in ("inside 90 %", "error/±, worst")),
)
HEAD = f"| {' | '.join((*TITLES, 'alerts'))} |\n{'|---' * (len(TITLES) + 1)}|"


def main() -> None:
    """Print the table, an arm a row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=at_least_one, default=6)
    parser.add_argument("--json", action="store_true", help="one object a line")
    given = parser.parse_args()
    excitation = excitation_from_document(json.loads(Path("config/excitation/ur5-ground.json").read_text("utf-8")))
    excitation = replace(excitation, repetitions=1)
    if not given.json:
        sys.stdout.write(HEAD + "\n")
    for seed in range(given.arms):
        found = study_arm(seed, excitation)
        sys.stdout.write((json.dumps(found) if given.json else line(found)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
