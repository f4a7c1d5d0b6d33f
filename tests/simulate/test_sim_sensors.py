"""The simulated sensors against the recordings of real arms that their figures come from."""

import numpy as np
import pandas as pd
import pytest

from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings


def standing(samples: int) -> dict[str, np.ndarray]:
    """(N, 6) measurements of an idle UR5."""
    controller = Controller(SimulateSettings(seed=4))
    rows = []
    for _ in range(samples):
        controller.step()
        rows.append(controller.measurements.latest)
    return {name: np.array([getattr(row, name) for row in rows]) for name in ("q", "qd", "current", "temperature_c")}


def test_a_standing_arm_is_as_noisy_as_the_recorded_one(real_data):
    """Standard deviations of current and position are within a third of the recorded ones, and both speeds are exactly zero."""
    real = pd.read_csv(real_data / "ur_standstill" / "real_10hz.csv", sep=" ")
    ours = standing(len(real))
    for name, signal in (("actual_current", "current"), ("actual_q", "q")):
        recorded = real[[f"{name}_{j}" for j in range(6)]].std().to_numpy()
        ratio = np.std(ours[signal], axis=0) / recorded
        assert np.all((ratio > 0.67) & (ratio < 1.5)), name  # 256 samples know a deviation to 5 %; joints of one size differ by 25 %
    assert not ours["qd"].any()
    assert not real[[f"actual_qd_{j}" for j in range(6)]].to_numpy().any()


def test_wrist_currents_are_correlated_from_tick_to_tick():
    """The correlation of successive samples is 0.3, as on the recorded wrists."""
    current = standing(4000)["current"]
    lag = [np.corrcoef(current[1:, j], current[:-1, j])[0, 1] for j in range(6)]
    assert np.mean(lag) == pytest.approx(0.3, abs=0.05)  # 4000 samples: 0.016 each


def test_equal_seeds_measure_equally_and_others_do_not():
    """Equal seeds give equal bits, also with more noise."""
    same = [Controller(SimulateSettings(seed=seed, current_noise=2.0)) for seed in (1, 1, 2)]
    for controller in same:
        for _ in range(300):  # more than one block of noise
            controller.step()
    assert np.array_equal(same[0].measurements.latest.current, same[1].measurements.latest.current)
    assert not np.array_equal(same[0].measurements.latest.current, same[2].measurements.latest.current)
