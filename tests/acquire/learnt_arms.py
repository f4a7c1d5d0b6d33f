"""Simulated arms whose torque was learnt, and what is normal for them."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from simulated_arm import known_gains

from monitor.acquire.safety.torque_band import TorqueBand, learn_profile, phases, recorded_rows
from monitor.acquire.safety.torque_basis import BandBasis
from monitor.acquire.settings import ReplaySettings
from monitor.config.files import find_excitation
from monitor.judge.assess import assess
from monitor.model.fourier import Excitation
from monitor.model.robot import load_robot
from monitor.recording import Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

ROOT = Path(__file__).parent.parent.parent
SHIPPED_NAMES = sorted(path.stem for path in (ROOT / "config" / "excitation").glob("*.json"))
SETTINGS = ReplaySettings(host="127.0.0.1")
NORMAL = {  # what is normal: settings of the arm, wear of Coulomb and viscous friction
    "as learnt": ({}, 1.0, 1.0),
    "worn, friction doubled": ({}, 2.0, 2.0),
    "worn, dry friction doubled": ({}, 2.0, 1.0),
    "cold, 15 K below": ({"ambient_c": 7.0}, 1.0, 1.0),
    "cold and worn": ({"ambient_c": 7.0}, 2.0, 2.0),
    "noisy currents": ({"current_noise": 3.0}, 1.0, 1.0),
    "payload wrong by 0.05 kg": ({"payload_kg": 0.05}, 1.0, 1.0),
}


def shipped(name: str) -> Excitation:
    return replace(find_excitation(name, ROOT), repetitions=1)


def arm_of(excitation: Excitation, normal: str = "as learnt", **settings) -> Controller:
    """A simulated arm for the excitation, in one of the NORMAL circumstances."""
    changes, coulomb, viscous = NORMAL[normal]
    arm = Controller(SimulateSettings(**{"robot": excitation.robot, "mounting": excitation.mounting, **changes, **settings}))
    for joint in range(6):
        arm.arm.set_wear(joint, coulomb, viscous)
    return arm


def first_outside(band: TorqueBand, recording: Recording, pass_s: float | None = None):
    """Index and text of the first row with which the band ends the motion; None where it does not."""
    at = [None] * recording.samples if pass_s is None else phases(recording.t_s, SETTINGS.rate_hz, pass_s).tolist()
    for i, row in enumerate(recorded_rows(recording)):
        if outside := band.outside(row, at[i]):
            return i, outside[1].text
    return None


class Learnt:
    """Two replays of a simulated arm, a day apart and 9 K apart, and what follows from them."""

    def __init__(self, name: str) -> None:
        self.excitation, self.robot = shipped(name), load_robot(name.split("-", maxsplit=1)[0])
        self.gains = known_gains(self.robot.name)
        arm, self.recordings, last = arm_of(self.excitation, seed=3), [], None
        for day in (0, 1):
            arm.pass_time(2.0, 22.0, 0.7 * day)
            seen = stepped_replay(arm, self.excitation)
            seen = replace(seen, context=replace(seen.context, recorded_at_unix_s=1.75e9 + day * 86_400.0))
            known = {} if last is None else {"model": last.model}
            belief, health = (None, None) if last is None else (last.belief, last.health)
            last = assess(
                seen,
                robot=self.robot,
                mounting=self.excitation.mounting,
                belief=belief,
                health=health,
                gains=np.array(self.gains.gains_nm_per_a),
                **known,
            )
            self.recordings.append(seen)
        self.basis = BandBasis(model=last.model.as_document())
        profile = learn_profile(self.recordings, self.robot, self.excitation, SETTINGS, self.gains, self.basis)
        self.with_profile = replace(self.basis, profile=profile)

    def band(self, basis: BandBasis | None = None) -> TorqueBand:
        return TorqueBand(self.robot, self.excitation.mounting, SETTINGS, self.gains, basis or self.with_profile)


@lru_cache
def learnt_arm(name: str) -> Learnt:
    """The learnt arm for a trajectory of the package; each is computed once."""
    return Learnt(name)
