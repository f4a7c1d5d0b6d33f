"""Every mechanism that the ablation names is one of the judge: without it, the judge says something else of the same arms."""

import json
import pkgutil
from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest

from evidence import ablation
from evidence.ablation import CORE, HEAD, MECHANISMS, played, table, without
from monitor.judge.drift.filter_state import WEAR
from monitor.judge.drift.update.lowest_level import count_from_lowest
from monitor.studies.rehearsal import play
from monitor.studies.worlds.fleet import WorldFleet
from monitor.studies.worlds.laws import (
    RATE_10,
    STEP_5,
    Correlated,
    Heat,
    bad_days,
    modulated,
    payload,
    regrease,
    running_in,
    sensor_silence,
    swelling_std,
    together,
    yearly,
)
from monitor.studies.worlds.table import LOW_SPEED, WORLDS

EARLY = {"earliest_day": 30.0, "latest_day": 60.0}
STEP, RATE = (replace(wear, path=lambda t, path=wear.path: 6.0 * path(t), joints=2, **EARLY) for wear in (STEP_5, RATE_10))
PLAIN = replace(WORLDS["plain"], wear=(STEP, RATE))
EVENTFUL = replace(  # as much as fits into some months
    PLAIN,
    noise=together(Correlated(std=(0.01, 0.04), rho=(0.0, 0.8), degrees=4.0), modulated(swelling_std(0.02, 20.0, 0.8))),
    changes=(
        regrease(days=(60.0, 100.0)),
        yearly(),
        bad_days(a_year=8.0),
        sensor_silence(),
        payload(mass_kg=0.6, days=(110.0, 130.0)),
    ),
    heat=Heat(lag_min=(3.0, 20.0), started_min=(2.0, 60.0), warm_up_k=(6.0, 12.0)),
    wear=(replace(LOW_SPEED, **EARLY), RATE),
)


def slow(rate, **onset):
    """A step of 5 % and a rate of 10 % a year times `rate`."""
    paths = (STEP_5, STEP_5.path), (RATE_10, lambda t: rate * RATE_10.path(t))
    return tuple(replace(wear, path=path, joints=3, **onset) for wear, path in paths)


def load(rng, shape):
    """A payload that nobody weighs."""
    change = payload(rise=(0.0, 0.04, 0.04, 0.0, 0.0, 0.0), days=(60.0, 70.0))(rng, shape)
    return change._replace(undeclared_kg=0.0, declared=0.0)


LIVES = {  # that have what a mechanism is for, and their days
    "eventful": (EVENTFUL, 200),
    "frequent": (replace(PLAIN, replays_a_day=4), 75),
    "quiet": (replace(PLAIN, noise=Correlated(std=0.01), wear=slow(1.0, **EARLY)), 160),
    "noisy": (replace(PLAIN, noise=Correlated(std=0.035), wear=slow(3.0, **EARLY)), 250),
    "running in": (replace(PLAIN, changes=(running_in(fall=(0.1, 0.2)),), wear=slow(3.0, **EARLY)), 120),
    "loaded": (replace(PLAIN, noise=Correlated(std=0.01), changes=(load,), wear=slow(1.0, earliest_day=90.0)), 100),
}
SELDOM = "_rise_suspected"
OTHERS = {
    **dict.fromkeys(("OF_OLD_STEP", "OF_NOISE", "required_of_joints"), "noisy"),
    **dict.fromkeys(("rates", "OLD_REPLAYS"), "quiet"),
    "falls_by_chance": "running in",
    "OF_FREQUENT": "frequent",
    "_loaded": "loaded",
}


@cache
def life(name):
    """Three arms of which two wear, and what the judge of today says of them."""
    world, days = LIVES[name]
    fleet = WorldFleet(world, healthy=1, worn=1, days=days, seed=7)
    return fleet, list(judged(fleet))


def judged(fleet):
    """What the judge says after each replay, and what it goes on from."""
    for day in play.judged_days(fleet, fleet.days, ablation.SETTINGS, count_use=False):
        state, evidence = day.result.state, day.evidence
        filtered = state.filter_state
        truth = fleet.log_torque_at(day.number, state.reference_temperature_c.reshape(fleet.arms, fleet.joints)).ravel()
        said = (*evidence[1:11], evidence.counts.replays, evidence.counts.arm_replays, day.undeclared)
        held = play.interval_holds(truth, state, ablation.SETTINGS.drift)
        yield (*said, held, filtered.wear_std, filtered.noise_var(fleet.joints, ablation.SETTINGS.drift), filtered.replays)


def differs(one, other):
    return not all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in zip(one, other, strict=True))


@pytest.mark.soak  # two minutes together
@pytest.mark.parametrize("name", [name for name in MECHANISMS if name != SELDOM])
def test_without_a_mechanism_the_judge_says_something_else(name):
    """Of wear, its ±, its noise, alerts or intervals, of the same arms; and afterwards the judge is the one of before."""
    fleet, today = life(OTHERS.get(name, "eventful"))
    with without(name):
        assert any(differs(each, then) for each, then in zip(judged(fleet), today, strict=True))
    assert not any(differs(each, then) for each, then in zip(islice(judged(fleet), 3), today, strict=False))


def test_without_a_suspicion_wear_counts_from_a_fall_at_once():
    """What is so seldom that no short life has it: a fall that is sure, in joints of which young replays speak for a rise."""
    fleet, _ = life("loaded")
    state = next(play.judged_days(fleet, 1, ablation.SETTINGS)).result.state.filter_state
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[:, WEAR], cov[:, WEAR, WEAR] = -0.05, 1e-6
    scores = np.full_like(state.glr_scores, 9.0)
    fallen = replace(state, mean=mean, cov=cov, glr_scores=scores, glr_informations=scores)
    day, drift = np.ones(state.joints), ablation.SETTINGS.drift
    assert np.allclose(count_from_lowest(fallen, day, drift).wear, -0.05)
    with without(SELDOM):
        assert np.allclose(count_from_lowest(fallen, day, drift).wear, 0.0)


@pytest.mark.parametrize("name", MECHANISMS)
def test_every_mechanism_has_its_name_in_the_judge(name):
    """`patch` refuses a function or constant that does not exist; afterwards each is the one of before."""
    modules = {target: pkgutil.resolve_name(target) for target in MECHANISMS[name].off}
    with without(name):
        assert all(pkgutil.resolve_name(target) is not before for target, before in modules.items())
    assert all(pkgutil.resolve_name(target) is before for target, before in modules.items())


def test_every_mechanism_is_tried_in_worlds_that_exist():
    """And together in those of every kind: noise, seasons, falls, payloads, heat, sensors."""
    tried = {world for each in MECHANISMS.values() for world in each.worlds}
    assert tried <= set(WORLDS)
    assert tried >= {*CORE, "ar-08", "slow-common", "running-in", "regrease-then-wear", "payload-03", "summer-24", "sensor-silent"}


@pytest.mark.slow
def test_the_table_has_the_price_of_each_mechanism():
    """Without changes by likelihood ratio a step is found later or never; a mechanism that does nothing there has no price."""
    documents = list(played(["changes", "OF_FREQUENT"], ["plain"], arms=3, worn=2, days=150, seed=3))
    assert [each["off"] for each in documents] == [None, "changes", "OF_FREQUENT"]
    rows = table(json.loads(json.dumps(documents))).removeprefix(HEAD).splitlines()
    changes, frequent = ([cell.strip() for cell in row.removeprefix("|").removesuffix("|").split("|")] for row in rows)
    assert (changes[0], frequent[0]) == ("`changes`", "`OF_FREQUENT`")
    assert (changes[4], frequent[4]) == ("never", "× 1.00")
    assert "plain 5 % step" in changes[-1]
    assert frequent[-1] == ""
