"""A fleet's prior: pooled as it should be, written, refused where it is none, taken by an arm, and let go by an arm that is another."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from command_line import ended
from hypothesis import given
from hypothesis import strategies as st
from lived_monitor import configuration, identified, live_through
from synthetic_arm import of_arm

from monitor.config.load import from_document
from monitor.config.reload import reloaded
from monitor.errors import BadConfiguration, BadInput
from monitor.judge.document import plain
from monitor.judge.friction.noise import NoisePriors
from monitor.judge.friction.prior import BOUNDS, prior_from_document
from monitor.judge.friction.states import SLOPE
from monitor.judge.settings import AssessSettings
from monitor.service.history.recompute import settings_from_document
from monitor.simulate.arm.friction import default_law
from monitor.store.store import Store
from monitor.studies.fleet_prior import LearntArm, learn_prior, pool
from monitor.studies.rehearsal.fleet import Fleet, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, interval_holds, judged_days

ASSESS = AssessSettings()
SCENARIOS = ("steady", "seasons", "cold_mornings")


def lived(arms, days, *, seed=1, assess=ASSESS, steeper=1.0, **settings):
    """The state after so many days of a fleet, and the share of its intervals that held the truth from day 10 on; NaN before."""
    fleet = Fleet(FleetSettings(arms=arms, days=days, seed=seed, scenarios=SCENARIOS, **settings))
    fleet.law = replace(fleet.law, viscous_per_k=steeper * fleet.law.viscous_per_k)
    held = []
    for one in judged_days(fleet, days, assess):
        state = one.result.state
        if one.day >= 10:
            truth = np.log(fleet.torque(state.reference_temperature_c.reshape(arms, -1), np.ones((arms, fleet.joints))))
            held.append(interval_holds(truth.ravel(), state, assess.friction))
    return state.friction, float(np.mean(held)) if held else math.nan


def slopes(friction):
    """(A, 6) how steeply the friction of each joint falls [1/K]."""
    return -friction.of_joints((friction.p * friction.x[:, SLOPE]).sum(axis=0)).reshape(-1, 6)


@pytest.fixture(scope="module")
def document():
    """What 24 arms say after 120 days."""
    return learnt(24, 120)


def learnt(number, days, **settings):
    """The document of so many arms."""
    state, _ = lived(number, days, **settings)
    arms = [LearntArm(f"cell-{k}", "ur5", of_arm(state, k), float(days)) for k in range(number)]
    return learn_prior(arms, ASSESS.drift, ASSESS.temperature)


def prior_of(document):
    return prior_from_document(document, "ur5", 6, ASSESS.drift.reference_speed_rad_s, digest="0")


def with_prior(document):
    return replace(ASSESS, drift=replace(ASSESS.drift, prior=prior_of(document)))


@given(st.integers(0, 10**6), st.floats(0.2, 3.0), st.floats(-3.0, 3.0))
def test_pooling_finds_the_mean_and_the_spread_of_many_arms(seed, spread, mean):
    """Of 200 arms with known doubt: the mean to 5 standard errors, the spread to 30 % beside the family's small share."""
    rng = np.random.default_rng(seed)
    doubt = rng.uniform(0.05, 0.3, (200, 1))
    value = mean + spread * rng.normal(size=(200, 1)) + doubt * rng.normal(size=(200, 1))
    found = pool(value, doubt**2, np.zeros(1), np.full(1, 3.0))
    assert abs(found.mean[0] - mean) < 5.0 * math.hypot(spread, 0.3) / math.sqrt(200)
    expected = math.sqrt((200 * spread**2 + 4 * 9.0) / 204)
    assert found.between_std[0] == pytest.approx(expected, rel=0.3)
    assert found.std[0] >= found.between_std[0]


@given(st.integers(0, 10**6), st.floats(3.0, 1000.0))
def test_one_arm_that_is_broken_moves_the_prior_no_further_than_the_bound(seed, away):
    """However far the one of 41 arms is, the mean moves by less than 0.15 of the spread."""
    rng = np.random.default_rng(seed)
    value = rng.normal(size=(41, 1))
    usual = pool(value[1:], np.full((40, 1), 0.01), np.zeros(1), np.full(1, 3.0))
    value[0] = away
    broken = pool(value, np.full((41, 1), 0.01), np.zeros(1), np.full(1, 3.0))
    assert abs(broken.mean[0] - usual.mean[0]) < 0.15 * usual.between_std[0] + 0.02
    assert broken.std[0] < 1.35 * usual.std[0]


def test_few_arms_stay_near_the_family_and_none_is_the_family():
    """Without arms the prior is the family's; two arms narrow it little."""
    none = pool(np.full((1, 1), np.nan), np.full((1, 1), np.nan), np.full(1, 0.5), np.full(1, 2.0))
    assert none.mean[0] == 0.5
    assert none.between_std[0] == pytest.approx(2.0)
    two = pool(np.array([[1.0], [1.1]]), np.full((2, 1), 1e-4), np.full(1, 0.5), np.full(1, 2.0))
    assert 1.5 < two.between_std[0] < 2.0


def test_the_prior_is_narrower_than_the_family_and_holds_the_fleet(document):
    """The slope's standard deviations are below 0.6 of the family's, and twelve arms that it was not learnt from lie within."""
    prior = prior_of(document)
    assert np.all(prior.slope_std_per_k < 0.6 * 0.0046)
    others, _ = lived(12, 100, seed=99)
    away = (slopes(others) - prior.slope_per_k) / prior.slope_std_per_k
    assert 0.8 < np.mean(np.abs(away) < 1.645) <= 1.0
    assert prior.noise_std == pytest.approx(0.02, rel=0.1)
    rho = np.array([kind.rho for kind in NoisePriors().kinds])
    assert prior.noise_weights @ rho == pytest.approx(0.5, abs=0.1)
    wanders = np.array([kind.kappa > 0.0 for kind in NoisePriors().kinds])
    assert prior.noise_weights[wanders].sum() < NoisePriors().column("weight")[wanders].sum()


def test_intervals_with_a_prior_cover_as_they_say_in_the_first_weeks(document):
    """Days 10 to 60 of arms of the fleet: between 85 and 97 % of the 90 % intervals of friction hold the truth."""
    _, covered = lived(24, 60, seed=7, assess=with_prior(document))
    assert 0.85 < covered < 0.97


@pytest.mark.soak
def test_an_arm_of_another_kind_is_not_held_to_the_fleet(document):
    """Friction falls twice as steeply as in the fleet: intervals still hold, and the slope is found as without the prior."""
    assess = with_prior(document)
    state, covered = lived(24, 90, seed=5, assess=assess, steeper=2.0)
    found = slopes(state)
    free, _ = lived(24, 90, seed=5, steeper=2.0)
    expected = slopes(free)
    assert covered > 0.82
    assert np.median(np.abs(found - expected)) < 0.25 * np.median(expected)
    assert np.median(found) > 1.5 * np.median(assess.drift.prior.slope_per_k)


def test_without_a_prior_nothing_is_different():
    """The state with `prior = None` is that of a program without it, to the bit."""
    state, _ = lived(2, 3)
    again, _ = lived(2, 3, assess=replace(ASSESS, drift=replace(ASSESS.drift, prior=None)))
    assert np.array_equal(state.x, again.x)
    assert np.array_equal(state.P, again.P)


def test_arms_that_say_too_little_or_of_different_speeds_are_refused(document):
    """No arm with forty replays, and two reference speeds: each is said with the figures."""
    state, _ = lived(2, 5)
    young = LearntArm("cell-9", "ur5", of_arm(state, 0), 5.0)
    with pytest.raises(BadInput, match="no arm with 40 replays"):
        learn_prior([young], ASSESS.drift, ASSESS.temperature)
    old, _ = lived(2, 60)
    arms = [LearntArm(f"cell-{k}", "ur5", of_arm(old, k), 60.0, 0.4 + 0.1 * k) for k in range(2)]
    with pytest.raises(BadInput, match=r"0\.4 rad/s in cell-0; 0\.5 rad/s in cell-1"):
        learn_prior(arms, ASSESS.drift, ASSESS.temperature)


def spoilt(document, **changes):
    """The document with other figures in joint 3 or of its noise, or another head."""
    copy = json.loads(json.dumps(document))
    own = copy["models"]["ur5"]
    for key, value in changes.items():
        part = own["joints"][2] if key in BOUNDS else own["noise"] if key in own["noise"] else copy
        part[key] = value
    return copy


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": "else"}, "is no fleet prior"),
        ({"version": 1}, "version 1 of a fleet prior; this program reads version 2"),
        ({"reference_speed_rad_s": 0.3}, "0.3 rad/s"),
        ({"models": {"ur10": {}}}, "holds no prior of a ur5; it holds ur10"),
        ({"models": []}, "holds no prior of a ur5"),
        ({"slope_std_per_k": 0.0}, "joint 3: slope_std_per_k = 0.0"),
        ({"std": math.nan}, "models.ur5.noise: std = nan"),
        ({"weights": [0.5, 0.5]}, "weights, one a kind of noise"),
        ({"weights": [1.0] * len(NoisePriors().kinds)}, "numbers that make 1 together"),
        ({"lag": None}, "joint 3: lag = None"),
    ],
)
def test_a_document_that_is_no_prior_of_this_arm_is_refused_with_the_reason(document, tmp_path, changes, words):
    """In a configuration each is a mistake with its key and its file."""
    (tmp_path / "fleet.json").write_text(json.dumps(spoilt(document, **changes)))
    with pytest.raises(BadConfiguration, match=r"drift\.prior: .*fleet\.json") as refused:
        configured(tmp_path, "fleet.json")
    assert words in str(refused.value)


def configured(folder, prior):
    """The configuration of a new UR5 that takes a prior."""
    document = {"robot": {"model": "ur5", "site": "hall-2", "id": "new"}, "drift": {"prior": prior}}
    return from_document(document, folder / "new.toml")


@pytest.mark.parametrize("prior", ["absent.json", 7, "new.toml"])
def test_a_prior_that_is_no_file_or_no_json_is_a_mistake_of_the_configuration(tmp_path, prior):
    """Named with its key."""
    (tmp_path / "new.toml").write_text("no JSON")
    with pytest.raises(BadConfiguration, match=r"drift\.prior"):
        configured(tmp_path, prior)


def test_the_command_learns_from_histories_and_a_new_arm_takes_what_it_writes(tmp_path):
    """`joint-monitor prior FOLDER -o FILE` of a daemon's history, beside an empty one; the file is refused to be replaced unasked."""
    settings = configuration(tmp_path).assess
    found, context = identified()
    with Store.open(tmp_path / "plant" / "cell-1") as store:
        live_through(store, settings, found, context, 46)
    with Store.open(tmp_path / "plant" / "cell-2"):
        pass
    said = ended("prior", tmp_path / "plant", "-o", tmp_path / "fleet.json")
    assert said.returncode == 0, said.stderr
    assert "ur5: 1 arm" in said.stdout
    assert "cell-2: nothing was assessed yet" in said.stdout
    assert 'prior = "' in said.stdout
    taken = configured(tmp_path, "fleet.json").assess.drift.prior
    assert taken.arms == 1
    law = default_law(configuration(tmp_path).robot_description)
    assert np.all(taken.slope_per_k < law.viscous_per_k)
    assert ended("prior", tmp_path / "plant", "-o", tmp_path / "fleet.json").returncode == 2
    again = json.loads(ended("prior", tmp_path / "plant", "--json").stdout)
    assert again["models"] == json.loads((tmp_path / "fleet.json").read_text())["models"]
    nothing = ended("prior", tmp_path)
    assert nothing.returncode == 2
    assert "holds no history.sqlite" in nothing.stderr


def test_a_reload_says_whether_the_prior_is_another_one(document, tmp_path):
    """The same file, read once more, has changed nothing; another one has changed one key of the file."""
    (tmp_path / "fleet.json").write_text(json.dumps(document))
    old, same = (configured(tmp_path, "fleet.json") for _ in range(2))
    assert reloaded(old, same).text == "nothing has changed"
    assert old.assess.drift == same.assess.drift
    (tmp_path / "fleet.json").write_text(json.dumps(spoilt(document, lag=0.001)))
    found = reloaded(old, configured(tmp_path, "fleet.json"))
    assert found.text == "changed drift.prior"
    assert found.configuration.assess.drift.prior.lag[2] == 0.001
    assert reloaded(old, configured(tmp_path, "")).changed == ("drift.prior",)


def test_a_verdict_with_a_prior_is_recomputed_with_the_same_prior(document):
    """The provenance holds the prior; the settings made of it judge a fleet to the same last bit."""
    assess = with_prior(document)
    again = settings_from_document(AssessSettings, json.loads(json.dumps(plain(assess))))
    assert again.drift.prior.digest == "0"
    one, other = (lived(2, 20, assess=each)[0] for each in (assess, again))
    assert np.array_equal(one.x, other.x)
    assert np.array_equal(one.P, other.P)


ONSETS = (10, 60)  # [day] the change begins so soon after the first replay


def found_early(assess, *, arms, seed, step=0.0, per_year=0.0, steeper=1.0, **settings):
    """Days from the onset of wear in one joint to its first tier, (A,), and the number of alerts that mean nothing in 130 days."""
    rng = np.random.default_rng(seed)
    joint, onset = rng.integers(0, 6, arms), rng.integers(*ONSETS, arms).astype(float)
    wear = Wear(joint=joint.astype(float), onset_day=onset, step=np.full(arms, step), per_day=np.full(arms, per_year / 365.0))
    fleet = Fleet(FleetSettings(arms=arms, days=130, seed=seed + 1, scenarios=COMPARABLE, **settings), wear)
    fleet.law = replace(fleet.law, viscous_per_k=steeper * fleet.law.viscous_per_k)
    tier, other = np.full(arms * 6, np.inf), np.zeros(arms * 6 + arms, dtype=bool)
    for one in judged_days(fleet, 130, assess):
        seen = one.evidence
        tier[(seen.raises >= 0) & np.isinf(tier)] = one.day
        other |= np.concatenate([seen.falls, seen.together])
    own = tier.reshape(arms, 6)[np.arange(arms), joint]
    early = own < onset
    beside = np.isfinite(tier).sum() - np.isfinite(own).sum() + early.sum() + other.sum()
    return np.where(early, np.nan, own - onset + 1.0), int(beside)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("name", "settings", "steeper"),
    [("as assumed", {}, 1.0), ("quiet", {"between_std": 0.01, "autocorrelation": 0.2}, 1.0), ("steep", {"between_std": 0.03}, 2.0)],
)
def test_what_a_prior_is_worth_in_the_first_months(soak_row, name, settings, steeper):
    """400 arms that the prior was not learnt from: a prior delays nothing, and adds no alerts that mean nothing, beyond chance."""
    document = learnt(120, 300, seed=71, steeper=steeper, **settings)
    for step, per_year in ((0.05, 0.0), (0.0, 0.3)):
        days, alerts = zip(
            *(
                found_early(assess, arms=400, seed=72, step=step, per_year=per_year, steeper=steeper, **settings)
                for assess in (ASSESS, with_prior(document))
            ),
            strict=True,
        )
        quarters = [np.nanquantile(each, [0.25, 0.5, 0.75], method="higher") for each in days]
        text = " / ".join(f"{each[0]:.0f} {each[1]:.0f} {each[2]:.0f} d" for each in quarters)
        soak_row(f"{name}, {'5 % step' if step else '30 % a year'}: without / with prior", f"{text}, {alerts[0]} / {alerts[1]}", "no later")
        assert quarters[1][0] <= 1.1 * quarters[0][0] + 1.0  # in quiet arms it changes nothing, but for chance
        assert alerts[1] <= alerts[0] + 3.0 * np.sqrt(alerts[0] + 3.0)
