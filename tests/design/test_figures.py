"""Does a trajectory made for friction show friction better on an arm? On the simulated one, which does not know the monitor's model."""

import numpy as np
import pytest
from tasks import task

from monitor.design.trajectory import design
from monitor.identify.identify import identify
from monitor.model.robot import Mounting, load_robot
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

REPLAYS = 200
EVALUATIONS = 5000


def viscous(excitation, count):
    """(count, J) fv of that many replays; the arm, its heat and its wear are the same every time, only the noise is another."""
    start = tuple(excitation.at(np.zeros(1)).q[0].tolist())
    found = []
    for seed in range(count):
        controller = Controller(SimulateSettings(robot="ur5", seed=seed, home_rad=start))
        found.append(identify([stepped_replay(controller, excitation)], load_robot("ur5"), Mounting()).viscous_nm_s_per_rad)
    return np.array(found)


@pytest.mark.soak
@pytest.mark.timeout(3000)
def test_the_friction_objective_beats_the_condition_number_on_the_simulated_arm(capsys):
    """200 stepped noisy replays each: the variance of fv, pooled over joints, and the upper 95 % bound of the ratio."""
    made = {
        name: design(task(objective=name, repetitions=1), software="test", seed=1, evaluations=EVALUATIONS)[0]
        for name in ("friction", "condition")
    }
    seen = {name: viscous(excitation, REPLAYS) for name, excitation in made.items()}
    std = {name: np.array(excitation.objectives["viscous_std_nm_s_per_rad"]) for name, excitation in made.items()}
    expected = (std["friction"] / std["condition"]) ** 2
    ratio = np.var(seen["friction"], axis=0, ddof=1) / np.var(seen["condition"], axis=0, ddof=1)

    # pooled: the mean of the joints' ratios, so that the large joints do not drown the wrists; resampled replays give its scatter
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(2000):
        one, other = (values[rng.integers(0, REPLAYS, REPLAYS)].var(axis=0, ddof=1) for values in (seen["friction"], seen["condition"]))
        draws.append(np.mean(one / other))
    upper = float(np.quantile(draws, 0.95))
    with capsys.disabled():
        print(f"\nvariance of fv, friction over condition objective, {REPLAYS} replays each, UR5 ground, {EVALUATIONS} evaluations each")
        print(f"  condition numbers: {[round(made[name].objectives['condition_number'], 1) for name in made]}")
        print(f"  expected {np.round(expected, 2).tolist()}, mean {np.mean(expected):.2f}")
        print(f"  seen     {np.round(ratio, 2).tolist()}, mean {np.mean(ratio):.2f}, upper 95 % bound {upper:.2f}")
    assert upper <= 0.75
