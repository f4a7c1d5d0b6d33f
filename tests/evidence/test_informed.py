"""The observer who knows a world's noise: its evidence is that of a textbook's least squares, and it is asked where it knows enough."""

import json

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from evidence import informed
from evidence.informed import BEFORE, Seen, all_evidence, evidence, informed_documents, known_noise
from evidence.worlds_card import NOISE_KNOWN, noise_known_documents
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import fleets_of

REACHED = st.floats(-3.0, 3.0)


def drawn(rng, days, joints=2):
    """Noise of σ 2 % and ρ 0.5 over a level and a slope with temperature; every seventh replay is missing."""
    temperature = 25.0 + 5.0 * np.sin(np.arange(days) / 9.0)[:, None] + rng.normal(size=(days, joints))
    noise = np.zeros((days, joints))
    noise[0] = 0.02 * rng.normal(size=joints)
    for day in range(1, days):
        noise[day] = 0.5 * noise[day - 1] + 0.02 * np.sqrt(0.75) * rng.normal(size=joints)
    y = 1.0 - 0.01 * temperature + noise + 0.005 * rng.normal(size=(days, joints))
    y[5::7] = np.nan
    return Seen(y, np.full((days, joints), 0.005**2), temperature, 0.1 * rng.normal(size=(days, joints)))


def by_dense_matrices(seen, joint):
    """χ² of a rise on the last day: each candidate's regressor against y, weighed by the covariance of everything that is not known."""
    y, variance, temperature, warming = (each[:, joint] for each in seen)
    days = len(y)
    away = (temperature - temperature[:20].mean()) / 10.0
    rows = np.stack([np.ones(days), away, away**2, warming], axis=1)
    cov = (rows * np.square(informed.STD)) @ rows.T + np.diag(variance) + 0.02**2 * 0.5 ** scipy.linalg.toeplitz(np.arange(days))
    here = np.isfinite(y)
    whitener = np.linalg.inv(np.linalg.cholesky(cov[np.ix_(here, here)]))
    left = whitener @ (y - rows @ informed.MEAN)[here]
    z = []
    for start in range(BEFORE, days):
        age = np.arange(days) - start
        for change in (np.where(age >= 0, 1.0, 0.0), np.maximum(age, 0.0)):
            told = whitener @ change[here]
            if told @ told > 0.0:
                z.append(told @ left / np.sqrt(told @ told))
    return max(0.0, *z) ** 2


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), days=st.integers(15, 70), step=REACHED)
def test_its_evidence_is_that_of_generalised_least_squares(seed, days, step):
    """A filter with what a change would have left in it says what dense matrices say of the same replays."""
    seen = drawn(np.random.default_rng(seed), days)
    seen.log_torque[days // 2 :] += 0.02 * step
    found = evidence(seen, 0.02, 0.5)[-1]
    for joint in range(2):
        assert found[joint] == pytest.approx(by_dense_matrices(seen, joint), rel=2e-3, abs=2e-3)


def test_its_threshold_is_crossed_as_often_as_it_is_asked_to_be():
    """By the first rises of healthy joints: two a robot-year are 7 of 4 arms in 420 days less what is below the threshold."""
    healthy, _ = fleets_of(WORLDS["plain"], arms=4, days=480, seed=2, worn=1)
    highest = all_evidence(healthy, np.arange(24), (0.02, 0.5))[60:].max(axis=0)
    assert highest.shape == (24,)
    rows = informed_documents(WORLDS["plain"], arms=4, worn=1, days=480, seed=2, per_year=(2.0,))
    assert rows[0]["false_advisories"] == round(2.0 * 4 * 420 / 365) == int((highest > rows[0]["threshold"]).sum())


def test_where_several_joints_wear_any_of_them_tells():
    """Two and six at once are found no later than one."""
    one, two, six = (
        informed_documents(WORLDS[name], arms=3, worn=8, days=480, seed=2, per_year=(0.5,))[0]
        for name in ("plain", "two-joints", "all-six")
    )
    assert two["median_days"] <= one["median_days"] + 1
    assert six["median_days"] <= two["median_days"] + 1


def test_it_is_asked_where_two_numbers_are_all_that_must_be_known():
    """Not where tails are long, joints differ, friction moves by itself, time and replay have noise each, or wear shows elsewhere."""
    assert known_noise(WORLDS["noise-4"]) == (0.04, 0.5)
    assert known_noise(WORLDS["quiet"]) == (0.01, 0.0)
    others = ("student-t3", "noise-mixed", "one-over-f", "seasonal-noise", "running-in", "twice-a-day-time", "noise-shared")
    others += ("low-speed-wear", "local-wear", "paths")  # wear that shows elsewhere, or on another path
    assert [name for name in others if known_noise(WORLDS[name]) is not None] == []
    assert all(known_noise(WORLDS[name]) for name in NOISE_KNOWN)
    assert informed_documents(WORLDS["student-t3"], arms=1, worn=1, days=100, seed=1, per_year=(0.1,)) == []


def test_fewer_false_advisories_cost_it_days():
    """On the arms that the judge has too; days that never come are null, and every figure is JSON."""
    rows = informed_documents(WORLDS["plain"], arms=4, worn=6, days=480, seed=2, per_year=(2.0, 0.2))
    assert [(row["wear"], row["false_per_year"]) for row in json.loads(json.dumps(rows, allow_nan=False))] == [
        ("5 % step", 2.0),
        ("5 % step", 0.2),
        ("10 %/year", 2.0),
        ("10 %/year", 0.2),
    ]
    often, seldom = rows[:2]
    assert often["median_days"] <= seldom["median_days"] <= 15
    assert all(row["median_at_least_days"] <= row["median_days"] <= (row["median_at_most_days"] or np.inf) for row in rows[:2])


def test_the_card_asks_it_at_the_judges_share_and_at_the_goal():
    """For the worlds that it knows, and no other."""
    asked = []

    def each(one, documents):
        documents = list(documents)
        asked.extend(documents)
        return [one(document) for document in documents]

    false = {"counted": {"per_year": 2.5}}
    documents = [{"world": name, "false_advisories": false, "goal": {"false_advisories": 0.5}} for name in ("quiet", "ar-08")]
    found = noise_known_documents(documents, arms=1, seed=7, each=each)
    assert [document["world"] for document in asked] == ["quiet"]
    assert [(row["wear"], row["false_per_year"]) for row in found["quiet"]] == [
        ("5 % step", 2.5),
        ("5 % step", 0.5),
        ("10 %/year", 2.5),
        ("10 %/year", 0.5),
    ]
