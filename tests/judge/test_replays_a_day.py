"""The same noise of the same joints, replayed once, twice, four or eight times a day: the verdict hardly depends on how often."""

import numpy as np
import pytest
from evidence.lived import correlated
from test_friction_model import J, seen

from monitor.judge.friction.step import FrictionModel, initial_state, step
from monitor.recording import Array

DAYS, ONSET, LEARNING, OFTEN, ARMS, WORN = 130, 100, 60, 8, 8, 1
MODEL = FrictionModel()


def fading(rng: np.random.Generator, days: float, std: float) -> Array:
    """(R, A·J) noise that fades over so many days, at `OFTEN` replays a day."""
    return correlated(rng, DAYS * OFTEN, ARMS * J, std=std, rho=np.exp(-1.0 / (OFTEN * days)))


def of_replays(rng: np.random.Generator, std: float) -> Array:
    """(R, A·J) noise that belongs to each replay."""
    return std * rng.normal(size=(DAYS * OFTEN, ARMS * J))


class Lived:
    """When each joint's rise is first told [days], infinite: never; and the share of sound joints whose 90 % interval holds the truth."""

    def __init__(self, noise: Array, a_day: int, *, rise: float) -> None:
        y = noise[:: OFTEN // a_day].copy()
        y[ONSET * a_day :, WORN::J] += np.log1p(rise)
        sound = np.arange(ARMS * J) % J != WORN
        state, self.told, held = initial_state(seen(y[0]), J, MODEL), np.full(ARMS * J, np.inf), []
        for r, values in enumerate(y):
            state = step(state, seen(values), np.full(ARMS, (r > 0) / a_day), MODEL, in_place=True)
            day = r / a_day
            if day >= LEARNING:
                self.told = np.where(state.of_joints(state.risen), np.minimum(self.told, day), self.told)
            if day >= LEARNING and r % (5 * a_day) == 0:
                mixture = state.friction(state.reference_c, MODEL)
                low, high = (state.of_joints(mixture.quantile(share))[sound] for share in (0.05, 0.95))
                held.append(np.mean((low <= 0.0) & (high >= 0.0)))
        self.held, self.worn, self.sound = float(np.mean(held)), self.told[~sound], self.told[sound]


@pytest.mark.parametrize("a_day", [1, 2, 4, 8])
@pytest.mark.parametrize("law", ["hours", "replay and days"])
@pytest.mark.slow
def test_a_step_is_told_within_days_and_intervals_hold_however_often_the_same_noise_is_replayed(law: str, a_day: int) -> None:
    """No kind of noise that wanders may win only because none of the others is as short as noise of hours."""
    rng = np.random.default_rng(31)
    noise = fading(rng, 0.36, 0.02) if law == "hours" else fading(rng, 2.0, 0.014) + of_replays(rng, 0.014)
    lived = Lived(noise, a_day, rise=0.05)
    after = lived.worn[lived.worn >= ONSET] - ONSET
    assert len(after) >= ARMS - 1
    assert np.median(after) <= 11.0
    assert np.isfinite(lived.sound).sum() <= 1
    assert 0.85 <= lived.held <= 0.98


@pytest.mark.parametrize("a_day", [1, 4])
@pytest.mark.slow
def test_noise_that_wanders_beside_that_of_replays_raises_few_alerts_however_often_it_is_seen(a_day: int) -> None:
    """In every joint of every arm: of 48 joints three are told at most."""
    rng = np.random.default_rng(32)
    lived = Lived(fading(rng, 50.0, 0.02) + of_replays(rng, 0.02), a_day, rise=0.0)
    assert np.isfinite(lived.told).sum() <= 3
