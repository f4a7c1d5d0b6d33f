"""One replay after another: what noise is learnt from, which changes are looked for, and what a change of the baseline is."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, weather

from monitor.identify.identification import Identification
from monitor.judge.belief import Belief
from monitor.judge.drift import begin, learn
from monitor.judge.evidence import DriftSettings
from monitor.judge.temperature import TemperatureSettings
from monitor.judge.track import OUTLIER

DRIFT, LAWS = DriftSettings(), TemperatureSettings()


def lived(replays: list[Identification]) -> list[Belief]:
    """One replay a day; the belief after each."""
    belief, beliefs = begin("ur5", CONTEXT, replays[0], START_S, settings=DRIFT, laws=LAWS), []
    for day, seen in enumerate(replays):
        belief = learn(belief, seen, CONTEXT, START_S + day * DAY_S, settings=DRIFT, laws=LAWS).belief
        beliefs.append(belief)
    return beliefs


def a_year(seed: int, *, days: int = 150, wear: dict[int, np.ndarray] | None = None) -> list[Identification]:
    """Daily replays in the weather; `wear` (6,) on single days."""
    arm, dice = Arm(seed=seed, autocorrelation=0.5), np.random.default_rng(seed)
    return [arm.replay(weather(day, dice), (wear or {}).get(day, 0.0)) for day in range(days)]


def test_wild_replays_teach_no_noise():
    """Joint 3 is 35 % off every 15 days: the noise learnt of it is that of the same days without, within a twelfth."""
    wild = {day: np.array([0, 0, 0.35, 0, 0, 0]) for day in range(30, 150, 15)}
    calm, shaken = lived(a_year(3))[-1], lived(a_year(3, wear=wild))
    assert sum(belief.event[2] == OUTLIER for belief in shaken) == len(wild)
    ratio = shaken[-1].noise_std(DRIFT)[2] / calm.noise_std(DRIFT)[2]
    assert ratio == pytest.approx(1.0, abs=0.08)


def test_replays_without_a_temperature_teach_no_noise():
    """Every tenth replay is 15 K colder and its sensor is silent: the noise learnt is that of the others, within a twelfth."""
    seen = a_year(4)
    arm = Arm(seed=40, autocorrelation=0.0)
    dark = [replace(arm.replay(16.0), temperature_c=None) if day > 20 and day % 10 == 0 else one for day, one in enumerate(seen)]
    calm, blind = lived(seen)[-1], lived(dark)[-1]
    assert np.allclose(blind.noise_std(DRIFT) / calm.noise_std(DRIFT), 1.0, atol=0.08)


def test_a_step_among_the_first_replays_is_of_the_baseline():
    """+7 % from the third replay on: taken for wear weeks later it would be in doubt by 4 % for ever, and what comes after unseen."""
    settled = {day: np.full(6, 0.07) * (np.arange(6) == 1) for day in range(2, 150)}
    later = {day: wear if day < 90 else wear + 0.05 * 1.07 * (np.arange(6) == 1) for day, wear in settled.items()}
    for seed in range(3):
        beliefs = lived(a_year(seed, wear=later))
        before, after = beliefs[85], beliefs[-1]
        assert before.wear[1] == pytest.approx(0.0, abs=0.015), seed
        assert before.wear_std[1] < 0.01, seed
        assert after.wear[1] == pytest.approx(np.log(1.05), abs=0.025), seed
        assert after.wear_std[1] < 0.015, seed
