"""What the joints of a fleet that wear say of the next one: along which path, and how soon."""

import functools
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from synthetic_arm import of_arm
from test_wear_paths import LIFE, MODEL, PROGNOSIS, worn_fleet

from monitor.errors import BadInput
from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.document import plain
from monitor.judge.friction.noise import NoisePriors
from monitor.judge.friction.prior import WearPrior, prior_from_document
from monitor.judge.settings import AssessSettings
from monitor.service.history.recompute import settings_from_document
from monitor.studies.fleet_prior import Joint, LearntArm, learn_prior, learn_wear, rising

pytestmark = pytest.mark.xdist_group("worn fleets")  # one worker judges each fleet once

SETTINGS = AssessSettings()
J, ARMS, ASKED = 4, 10, 4
DAYS = 260.0  # that the fleet has lived


@functools.cache
def fleet() -> list:
    """The states of arms whose second joint has worn to six tenths of the limit along a straight path."""
    state, _ = worn_fleet("straight", ARMS, 0.6)
    return [of_arm(state, k) for k in range(ARMS)]


@functools.cache
def document_text() -> str:
    """What that fleet says, as it is written."""
    arms = [LearntArm(f"cell-{k}", "ur5", state, DAYS) for k, state in enumerate(fleet())]
    return json.dumps(learn_prior(arms, SETTINGS.drift, SETTINGS.temperature))


def learnt() -> WearPrior:
    """The same as a new arm takes it."""
    found = prior_from_document(json.loads(document_text()), "ur5", J, 0.4, digest="0").wear
    assert found is not None
    return found


def medians(path: str, asked_at: float, prior: WearPrior | None, seed: int = 0) -> tuple[np.ndarray, float]:
    """P50 [days] of the arms that have a date, and the truth."""
    state, left = worn_fleet(path, ASKED, asked_at, seed=seed)
    lives = [remaining_life_of_joint(state, (J + 1) * k + 1, MODEL, PROGNOSIS, prior) for k in range(ASKED)]
    return np.array([life.p50_days for life in lives if life.p50_days is not None]), left


@pytest.mark.slow
def test_a_fleet_that_wears_along_one_path_says_so_and_how_long_it_takes():
    """The ten are alike: the straight path has seven tenths of the weight, and the life is found to 15 %."""
    found = learnt()
    assert found.joints == ARMS
    assert found.straight > 0.7
    assert found.life_days == pytest.approx(LIFE, rel=0.15)
    assert found.life_spread < 0.5


@pytest.mark.slow
def test_joints_that_rise_slowly_are_counted_as_beginnings_of_wear():
    """Ten joints of 40 began to wear in 28 joint-years, and no healthy one is among them."""
    model = json.loads(document_text())["models"]["ur5"]
    assert [np.flatnonzero(rising(state)).tolist() for state in fleet()] == [[1]] * ARMS
    assert model["onsets_per_year"] == pytest.approx(ARMS / (DAYS * ARMS * J / 365.0), rel=0.2)
    assert model["wear_per_year"] == pytest.approx(365.0 * 0.3 / LIFE, rel=0.25)


def test_few_joints_that_wear_say_nothing_of_the_next_one():
    """Nine are too few."""
    assert learn_wear([Joint(state, 1) for state in fleet()[:9]], MODEL) is None


def test_figures_of_wear_travel_by_document_and_provenance_and_are_checked():
    """They come back as they were written; a wrong figure is named with its place."""
    document = json.loads(document_text())
    prior = prior_from_document(document, "ur5", J, 0.4, digest="0")
    assert prior.wear is not None
    assert asdict(prior.wear) == document["models"]["ur5"]["wear"]
    settings = replace(SETTINGS, drift=replace(SETTINGS.drift, prior=prior))
    again = settings_from_document(AssessSettings, json.loads(json.dumps(plain(settings))))
    assert again.drift.prior.wear == prior.wear
    for name, value, words in (
        ("life_days", 0.0, "life_days = 0"),
        ("straight", 0.01, "make 1 together"),
        ("joints", True, "number of joints"),
        ("life_spread", None, "life_spread = None"),
    ):
        wrong = json.loads(json.dumps(document))
        wrong["models"]["ur5"]["wear"][name] = value
        with pytest.raises(BadInput, match=words):
            prior_from_document(wrong, "ur5", J, 0.4, digest="0")
    document["models"]["ur5"]["wear"] = None
    assert prior_from_document(document, "ur5", J, 0.4, digest="0").wear is None


@pytest.mark.slow
def test_a_new_arm_takes_the_fleets_figures_of_wear_into_its_remaining_life():
    """A joint of the same path that is asked early: with the fleet's prior its life is nearer to the truth, and its interval no wider."""
    (without, left), (with_prior, _) = medians("straight", 0.35, None, seed=3), medians("straight", 0.35, learnt(), seed=3)
    assert len(with_prior) >= len(without) > 0
    assert np.median(np.abs(with_prior / left - 1.0)) <= np.median(np.abs(without / left - 1.0)) + 0.05


def test_the_noise_of_a_fleet_is_known_to_a_new_arm():
    """Its size, and which kinds of it are likely: noise of ρ 0.5 here."""
    document = json.loads(document_text())
    told = document["models"]["ur5"]["noise"]
    prior = prior_from_document(document, "ur5", J, 0.4, digest="0")
    assert prior.noise_std == told["std"] == pytest.approx(0.02, rel=0.15)
    rho = NoisePriors().column("rho")[:, 0]
    assert prior.noise_weights @ rho == pytest.approx(0.5, abs=0.1)
    settings = replace(SETTINGS, drift=replace(SETTINGS.drift, prior=prior))
    assert settings.friction.noise.std == prior.noise_std
    assert [kind.weight for kind in settings.friction.noise.kinds] == pytest.approx(told["weights"])


def test_a_document_whose_noise_is_none_is_refused_with_its_place():
    """Sizes and weights that no noise has, and those of another list of kinds."""
    document = json.loads(document_text())
    right = document["models"]["ur5"]["noise"]
    weights = right["weights"]
    for wrong in (
        3,
        {"std": 0.02},
        {"std": 0.02, "weights": weights[:-1]},
        {"std": 0.0, "weights": weights},
        {"std": 0.02, "weights": [0.5] * len(weights)},
    ):
        document["models"]["ur5"]["noise"] = wrong
        with pytest.raises(BadInput, match=r"models\.ur5\.noise"):
            prior_from_document(document, "ur5", J, 0.4, digest="0")
