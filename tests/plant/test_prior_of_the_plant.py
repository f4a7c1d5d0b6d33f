"""A new arm begins with its plant's prior: asked for on a real bus before its first verdict, kept, and never another one afterwards."""

import json
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pytest
import zenoh
from command_line import printed
from lived_monitor import identified, live_through
from simulated import copy
from test_on_the_bus import until

from monitor.config.files import find_excitation
from monitor.config.load import load
from monitor.config.reload import reloaded
from monitor.errors import BadInput
from monitor.judge.friction.prior import prior_from_document, prior_from_plain
from monitor.judge.settings import AssessSettings
from monitor.plant.database import Database
from monitor.plant.priors import ModelPrior, Priors
from monitor.plant.run import Plant
from monitor.plant.settings import PlantConfiguration, PlantSettings
from monitor.publish.client import Client
from monitor.publish.session import PLANT, session_config
from monitor.service.daemon import Daemon
from monitor.service.history.recompute import recompute
from monitor.service.plant_prior import prior_taken
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store
from monitor.studies import fleet_prior
from monitor.studies.fleet_prior import priors_of_plant

DAY_S = 86_400.0
NAMES = ("north/press", "south/saw")


@lru_cache
def recorded():
    """One replay of a UR5, for every arm of these tests; nothing changes it."""
    return stepped_replay(Controller(SimulateSettings(robot="ur5", seed=5)), replace(find_excitation("ur5-ground", Path()), repetitions=1))


@pytest.fixture
def plant_file(tmp_path, free_port):
    """The embedded database of a plant whose two arms lived 46 days, and its settings."""
    for seed, name in enumerate(NAMES):
        with Store.open(tmp_path / "arms" / name) as store:
            live_through(store, AssessSettings(), *identified(), 46, seed=seed)
    settings = PlantConfiguration(
        path=None, plant=PlantSettings(connect=(f"tcp/127.0.0.1:{free_port}",), database=f"sqlite:///{tmp_path / 'plant.sqlite'}")
    )
    database = Database(settings.database)
    database.migrate()
    copy(database, tmp_path / "arms", NAMES)
    database.close()
    return settings


@contextmanager
def router(settings):
    with zenoh.open(session_config(mode="router", listen=settings.plant.connect)) as opened:
        yield opened


class NewArm:
    """The daemon of a new arm of the site north, whose replays are those of the simulator."""

    def __init__(self, folder, endpoint, port, prior="plant"):
        self.path, self.clock, self.endpoint = folder / "new.toml", 1_790_000_000.0, f"tcp/127.0.0.1:{port}"
        bus = f'listen = ["{self.endpoint}"]\nconnect = ["{endpoint}"]'
        self.path.write_text(
            f'[robot]\nmodel = "ur5"\nsite = "north"\nid = "lathe"\n[store]\ndirectory = "new"\n[bus]\n{bus}\n[drift]\nprior = "{prior}"\n'
        )
        self.rows = []

    def live(self, days, reached=lambda daemon: True):
        """One replay a day; the last word on its bus of what it began with."""
        configuration = load(self.path)
        with (
            Store.open(configuration.state_directory) as store,
            Daemon(configuration, store, now=lambda: self.clock, play=self.play) as daemon,
        ):
            deadline = time.monotonic() + 20.0
            while not reached(daemon):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            for _ in range(days):
                self.clock += DAY_S
                self.rows.append(daemon.monitor.perform(self.clock))
            with Client(self.endpoint, "north", "lathe") as client:
                return client.info().prior

    def play(self, *_):
        return recorded()

    def verdicts(self):
        """The priors that stand in the provenance of its verdicts."""
        with Store.reader(load(self.path).state_directory) as store:
            return [store.assessments.provenance(each.made_with)["settings"]["drift"]["prior"] for each in store.assessments.judged()]


def answers(daemon):
    try:
        return daemon.bus.ask_plant("prior/north/ur5", 2.0) is not None
    except BadInput:  # it makes them now
        return False


def test_a_new_arm_takes_the_prior_that_the_plant_has_made_and_keeps_it(plant_file, tmp_path, free_tcp_port_factory):
    """Made in a process of its own, from what was copied; the same figures as `prior --plant`. A later prior changes nothing any more."""
    arm = NewArm(tmp_path, plant_file.plant.connect[0], free_tcp_port_factory())
    (tmp_path / "plant.toml").write_text(f'[plant]\ndatabase = "{plant_file.plant.database}"\n')
    by_hand = json.loads(printed("prior", "--plant", tmp_path / "plant.toml", "--json"))
    with router(plant_file):
        with Plant(plant_file, priors_of_plant) as plant:
            until(plant, lambda: plant.trouble is None)
            said = arm.live(2, answers)
        assert (said.state, said.arms, said.model, said.site) == ("taken", 2, "ur5", None)
        assert said.text.startswith("joints began with the prior of 2 ur5 of the plant, made ")
        first, second = arm.verdicts()
        assert first == second
        assert first["digest"] == said.digest
        own = prior_from_plain(first)
        expected = prior_from_document(by_hand, "ur5", 6, 0.4, digest=said.digest)
        assert own == expected
        assert own.slope_per_k.tolist() == expected.slope_per_k.tolist()
        later = Priors()
        later.take([ModelPrior(None, "ur5", 9, "2026-01-01T00:00:00Z", json.dumps(by_hand | {"software": "another"}))])
        with zenoh.open(session_config(mode="client", connect=plant_file.plant.connect)) as another:
            queryable = another.declare_queryable(f"{PLANT}/prior/*/*", later.answer)
            assert arm.live(1, answers) == said
            queryable.undeclare()
    assert arm.live(1) == said, "the plant is gone, and the arm goes on"
    assert [row.state for row in arm.rows] == ["assessed"] * 4
    assert {each["digest"] for each in arm.verdicts()} == {said.digest}
    status = printed("status", "--config", arm.path)
    assert said.text in status
    with Store.reader(load(arm.path).state_directory) as store:
        again = recompute(store)
    assert (again["identical"], again["different"]) == (4, 0)
    assert reloaded(load(arm.path), load(arm.path)).text == "nothing has changed"


def test_where_no_plant_answers_the_arm_learns_alone_and_says_so(plant_file, tmp_path, free_tcp_port_factory):
    """A plant that comes after the first verdict is not asked any more; one that comes before it is."""
    arm = NewArm(tmp_path, plant_file.plant.connect[0], free_tcp_port_factory())
    with router(plant_file), ExitStack() as plant:
        assert (waits := arm.live(0)).state == "waits"
        assert (waits.text, waits.at) == ("the plant is asked for a prior at the first replay", None)
        refused = Priors()
        session = plant.enter_context(zenoh.open(session_config(mode="client", connect=plant_file.plant.connect)))
        queryable = session.declare_queryable(f"{PLANT}/prior/*/*", refused.answer)
        assert arm.live(1).state == "refused"
        assert "has no prior of a ur5" in arm.live(0).text
        assert arm.verdicts() == [None]
        refused.take(priors_of_plant(plant_file.database))
        assert arm.live(1, answers).state == "refused"
        assert arm.verdicts() == [None, None]
        queryable.undeclare()
    assert "joints begin with what holds for every arm" in printed("status", "--config", arm.path)


def test_a_replay_without_a_verdict_leaves_the_question_open(plant_file, tmp_path, free_tcp_port_factory):
    """Nobody answered, and the recording was refused: the next replay asks again, and takes the plant's prior before the first verdict."""
    arm = NewArm(tmp_path, plant_file.plant.connect[0], free_tcp_port_factory())
    whole = recorded()
    broken = replace(whole, current=whole.current * float("nan"))
    arm.play = lambda *_: broken
    with router(plant_file):
        said = arm.live(1)
        assert (arm.rows[-1].state, said.state) == ("rejected", "no_answer")
        del arm.play
        priors = Priors()
        priors.take(priors_of_plant(plant_file.database))
        with zenoh.open(session_config(mode="client", connect=plant_file.plant.connect)) as session:
            queryable = session.declare_queryable(f"{PLANT}/prior/*/*", priors.answer)
            assert arm.live(1, answers).state == "taken"
            queryable.undeclare()


def test_an_arm_that_had_verdicts_before_takes_none(plant_file, tmp_path, free_tcp_port_factory):
    """The setting came too late, and that is its value."""
    arm = NewArm(tmp_path, plant_file.plant.connect[0], free_tcp_port_factory(), prior="")
    with router(plant_file):
        assert arm.live(1) is None
        arm.path.write_text(arm.path.read_text().replace('prior = ""', 'prior = "plant"'))
        assert arm.live(1).state == "too_late"
    configuration = load(arm.path)
    with Store.reader(configuration.state_directory) as store:
        assert prior_taken(configuration, store).text.startswith("no prior of the plant was taken")
    assert arm.verdicts() == [None, None]


def test_a_site_with_arms_enough_speaks_for_itself(plant_file, monkeypatch):
    """Every other site gets what the whole plant says; a selector with wildcards gets each one under its own key."""
    monkeypatch.setattr(fleet_prior, "SITE_ARMS", 1)
    found = priors_of_plant(plant_file.database)
    assert [(each.site, each.arms) for each in found] == [(None, 2), ("north", 1), ("south", 1)]
    priors = Priors()
    priors.take(found)
    with router(plant_file) as session:
        queryable = session.declare_queryable(f"{PLANT}/prior/*/*", priors.answer)

        def sites(selector):
            replies = session.get(f"{PLANT}/prior/{selector}", timeout=5.0, consolidation=zenoh.ConsolidationMode.NONE)
            found = [each.ok for each in replies if each.ok]
            return sorted((str(each.key_expr).split("/")[-2], json.loads(each.payload.to_bytes())["site"]) for each in found)

        assert sites("north/ur5") == [("north", "north")]
        assert sites("west/ur5") == [("west", None)]
        assert sites("west/ur10") == []
        assert sites("**") == [("-", None), ("north", "north"), ("south", "south")]
        queryable.undeclare()
