"""What the joints of a fleet that wear say of the next one: along which path, and how soon."""

import functools
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from synthetic_arm import of_arm
from test_wear_paths import DRIFT, LIFE, PROGNOSIS, worn_fleet

from monitor.errors import BadInput
from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.document import plain
from monitor.judge.drift.filter_state import FilterState
from monitor.judge.drift.from_fleet import begin_from_fleet, noise_known
from monitor.judge.drift.from_production import begin_production, swapped
from monitor.judge.drift.noise.chance import MIDDLE, inflation_of, nothing_seen
from monitor.judge.drift.prior import BOUNDS, FleetPrior, WearPrior, prior_from_document
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.update.change_detection import JointNoise, thresholds
from monitor.judge.settings import AssessSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.service.history.recompute import settings_from_document
from monitor.studies.fleet_prior import Joint, LearntArm, learn_prior, learn_wear, rising

pytestmark = pytest.mark.xdist_group("worn fleets")  # one worker judges each fleet once

J, ARMS, ASKED = 4, 10, 4
DAYS = 260.0  # that the fleet has lived


@functools.cache
def fleet() -> list:
    """The filter states of arms whose second joint has worn to six tenths of the limit along a straight path."""
    state, _ = worn_fleet("straight", ARMS, 0.6)
    return [of_arm(state.filter_state, k, J) for k in range(ARMS)]


@functools.cache
def document_text() -> str:
    """What that fleet says, as it is written."""
    arms = [LearntArm(f"cell-{k}", "ur5", state, DAYS) for k, state in enumerate(fleet())]
    return json.dumps(learn_prior(arms, DRIFT, TemperatureSettings()))


def learnt() -> WearPrior:
    """The same as a new arm takes it."""
    found = prior_from_document(json.loads(document_text()), "ur5", J, 0.4, digest="0").wear
    assert found is not None
    return found


def with_wear(wear: WearPrior | None) -> DriftSettings:
    """Settings with a fleet's prior that says how joints wear; its other figures have no effect on a state that has lived."""
    columns = {name: np.full(J, low if low > 0 else 0.0) for name, (low, _) in BOUNDS.items()}
    return replace(DRIFT, prior=FleetPrior(model="ur5", arms=ARMS, digest="0", wear=wear, **columns))


def medians(path: str, asked_at: float, drift: DriftSettings, seed: int = 0) -> tuple[np.ndarray, float]:
    """P50 [days] of the arms that have a date, and the truth."""
    state, left = worn_fleet(path, ASKED, asked_at, seed=seed)
    lives = [remaining_life_of_joint(state, J * k + 1, drift, PROGNOSIS) for k in range(ASKED)]
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
    assert learn_wear([Joint(state, 1, 0) for state in fleet()[:9]], DRIFT) is None


def test_figures_of_wear_travel_by_document_and_provenance_and_are_checked():
    """They come back as they were written; a wrong figure is named with its place."""
    document = json.loads(document_text())
    prior = prior_from_document(document, "ur5", J, 0.4, digest="0")
    assert prior.wear is not None
    assert asdict(prior.wear) == document["models"]["ur5"]["wear"]
    settings = replace(AssessSettings(), drift=replace(DRIFT, prior=prior))
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


def test_the_memory_of_a_fleets_noise_is_known_to_a_new_arm():
    """Its noise averages out, which a new arm with the prior takes for likely and one without does not: inflation of steps a week ago."""
    document = json.loads(document_text())
    told = document["models"]["ur5"]["chance"]
    assert np.all(np.abs(np.array(told["step"][2:5]) - 1.0) < 0.35)
    assert told["replays"] == pytest.approx(12.0 * ARMS / (ARMS + 4.0), rel=1e-3)
    prior = prior_from_document(document, "ur5", J, 0.4, digest="0")
    young, _ = worn_fleet("straight", ARMS, -0.19)  # 24 replays, before the onset
    inflation = []
    for settings in (DRIFT, replace(DRIFT, prior=prior)):
        state = begin_from_fleet(young.filter_state, settings.prior) if settings.prior else None
        chance = nothing_seen(J * ARMS) if state is None else state.chance
        seen = young.filter_state.chance
        share = seen.replays / np.maximum(seen.replays + chance.replays, 1e-9)
        mean = share[:, None, None] * seen.mean + (1.0 - share)[:, None, None] * chance.mean
        both = replace(seen, mean=mean, replays=seen.replays + chance.replays)
        inflation.append(np.median(inflation_of(both, young.filter_state.ages[:, MIDDLE] + 1.0, J)[:, 0, 3]))
    assert inflation[0] > 1.2
    assert inflation[1] - 1.0 < 0.6 * (inflation[0] - 1.0)


def test_a_prior_without_the_memory_of_noise_begins_as_before():
    """A document of an earlier release does not say it; a wrong one is named with its place."""
    document = json.loads(document_text())
    del document["models"]["ur5"]["chance"]
    prior = prior_from_document(document, "ur5", J, 0.4, digest="0")
    young, _ = worn_fleet("straight", ARMS, 0.6)
    fresh = replace(young.filter_state, chance=nothing_seen(J * ARMS))
    assert np.array_equal(begin_from_fleet(fresh, prior).chance.replays, fresh.chance.replays)
    for wrong in ({"step": [1.0] * 8, "rate": [1.0] * 7, "replays": 30.0}, {"step": [1.0] * 8, "rate": [0.0] * 8, "replays": 30.0}, 3):
        document["models"]["ur5"]["chance"] = wrong
        with pytest.raises(BadInput, match=r"models\.ur5\.chance"):
            prior_from_document(document, "ur5", J, 0.4, digest="0")


def with_noise(prior: FleetPrior, rho: float, replays: float) -> FilterState:
    """A state of two arms after so many replays whose noise has the fleet's size and a correlation; joint 1 of each began to wear."""
    young, _ = worn_fleet("straight", 2, -0.19)
    step_var = np.tile(prior.noise_std**2, 2) * (1.0 - rho)
    product = np.tile(prior.noise_std**2, 2) * rho
    product[::J] *= 5.0
    weight = np.full(2 * J, prior.noise_replays.mean() / J + replays)
    return replace(young.filter_state, step_var=step_var, product=product, noise_weight=weight, replays=np.full(2 * J, replays))


def test_a_young_joint_whose_noise_the_fleet_knows_needs_less_evidence():
    """Thresholds fall from 5.15 to about 5.0 with ten arms. Not where noise is longer than the fleet's, nor in an older joint."""
    prior = prior_from_document(json.loads(document_text()), "ur5", J, 0.4, digest="0")
    rho = float(prior.noise_correlation.mean())
    known = noise_known(with_noise(prior, rho, 24.0), prior)
    assert known == pytest.approx(ARMS / (ARMS + 4.0))
    lower = thresholds(np.ones((1, 1)), DRIFT, JointNoise(known[:1], np.zeros(1), np.ones(1)))[0, 0, 0]
    assert np.sqrt(lower) == pytest.approx(np.sqrt(DRIFT.shift_sigma**2 - 2.5 * ARMS / (ARMS + 4.0)))
    assert not noise_known(with_noise(prior, min(rho + 0.35, 0.95), 24.0), prior).any()
    assert noise_known(with_noise(prior, rho - 0.2, 24.0), prior).all(), "noise that averages out sooner is no danger"
    assert noise_known(with_noise(prior, rho, 135.0), prior) == pytest.approx(0.5 * ARMS / (ARMS + 4.0))
    assert not noise_known(with_noise(prior, rho, 180.0), prior).any()
    assert not noise_known(with_noise(prior, rho, 24.0), None).any()
    assert not noise_known(with_noise(prior, rho, 24.0), replace(prior, chance=None)).any()


def test_a_joint_that_production_moves_needs_as_much_evidence_as_without_a_fleet():
    """The fleet has told of the noise of replays, and of none of work. A joint that work never moves keeps the lower thresholds."""
    prior = prior_from_document(json.loads(document_text()), "ur5", J, 0.4, digest="0")
    young = begin_production(with_noise(prior, float(prior.noise_correlation.mean()), 24.0), J, DRIFT)
    assert noise_known(young, prior).all(), "work has not told of anything yet"
    assert young.sources is not None
    moved = np.arange(2 * J) % J != 2
    in_production = replace(young, sources=replace(young.sources, other_number=np.where(moved, 9.0, 0.0)))
    for state in (
        in_production,
        swapped(replace(in_production, sources=replace(in_production.sources, other_product=0.1 * in_production.sources.other_product))),
    ):
        assert not noise_known(state, prior)[moved].any()
    assert noise_known(in_production, prior)[~moved] == pytest.approx(ARMS / (ARMS + 4.0))
