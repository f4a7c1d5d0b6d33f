"""A warm-up campaign against the real daemon on the bus: it asks, is refused as anybody is, ends when warm, and is bounded."""

import itertools
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.config.files import find_excitation
from monitor.config.load import from_document
from monitor.errors import BadInput, BusError, MotionRefused
from monitor.publish.client import Client
from monitor.reason import reason_of
from monitor.service.campaign import Bounds, Made, campaign, steady
from monitor.service.daemon import Daemon
from monitor.service.shared_state import ReplayRequests
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store

pytestmark = pytest.mark.timeout(600)  # each replay is judged
START_UNIX_S = 1_767_582_000.0
EVERY_S = 300.0  # from one replay of these campaigns to the next


class Warming:
    """An arm in the simulated controller's place: the recordings of one replay, at temperatures that rise and level out."""

    def __init__(self) -> None:
        excitation = replace(find_excitation("ur5-ground", Path()), repetitions=1)
        self.recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), excitation)
        self.played, self.refuses, self.time_constant, self.goes_on = 0, False, 1.0, threading.Event()
        self.goes_on.set()

    def now(self) -> float:
        return START_UNIX_S + EVERY_S * self.played

    def play(self, excitation, context, should_stop, window):
        if self.refuses:
            raise MotionRefused(reason_of("the teach button is held"))
        self.played += 1
        self.goes_on.wait(60.0)
        shape = self.recording.temperature_c.shape
        warm = np.full(shape, 40.0 - 15.0 * np.exp(-self.played / self.time_constant))
        return replace(self.recording, temperature_c=warm, context=replace(context, firmware=self.recording.context.firmware))


@pytest.fixture
def cell(tmp_path: Path, free_port: int) -> Iterator[tuple[Daemon, Warming, Client]]:
    """A daemon whose requests are performed by a thread, as its scheduler does."""
    document = {
        "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
        "replay": {"allow_motion": True},
        "store": {"directory": str(tmp_path / "history")},
        "bus": {"listen": [f"tcp/127.0.0.1:{free_port}"]},
    }
    arm, requests, done = Warming(), ReplayRequests(), threading.Event()
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(from_document(document, tmp_path / "cell.toml"), store, now=arm.now, play=arm.play, requests=requests) as daemon,
    ):

        def perform() -> None:
            number = 0
            while not done.is_set():
                requests.wait(0.05)
                if requests.take_request():
                    number += 1
                    daemon.monitor.perform(START_UNIX_S + number, "requested")

        worker = threading.Thread(target=perform)
        worker.start()
        with Client(f"tcp/127.0.0.1:{free_port}", "lab", "cell-1") as client:
            yield daemon, arm, client
        done.set()
        worker.join()


def test_a_campaign_ends_when_no_joint_changes_any_more_and_the_history_has_each_replay(cell):
    """15 K with a time constant of one replay: after six the last ten minutes, three replays, differ by less than half a kelvin."""
    daemon, arm, client = cell
    told: list[Made] = []
    ended = campaign(client, Bounds(hours=12.0), by="ada", why="a cold morning", tell=told.append, now=arm.now)
    assert ended.steady
    assert tuple(told) == ended.made
    assert len(ended.made) == arm.played == 6
    assert [row.state for row in daemon.state.store.ledger.rows()] == ["assessed"] * arm.played
    assert ended.made[-1].temperature_c[0] == pytest.approx(40.0, abs=0.5)


def test_a_campaign_is_bounded_and_ends_with_the_first_replay_that_is_not_learnt_from(cell):
    """By number, by time, on request, by a refusal of the arm, and by one of the daemon, with its words."""
    daemon, arm, client = cell

    def run(stop: bool = False, **bounds: float):
        return campaign(client, Bounds(**bounds), by="ada", why="", should_stop=lambda: stop, now=arm.now)

    assert run(stop=True).why.code == "campaign_stopped"
    assert arm.played == 0
    assert run(most=2).why.code == "campaign_enough"
    assert arm.played == 2
    assert run(hours=0.01).why.code == "campaign_time_over"
    assert arm.played == 3
    with daemon.state.replaying:  # the replay that was under way ends by itself
        arm.refuses = True
    assert "was skipped: the teach button is held" in str(run().why)
    daemon.state.configuration = replace(daemon.state.configuration, replay=replace(daemon.state.configuration.replay, allow_motion=False))
    assert "motion is not allowed here (allow_motion is false)" in str(run().why)
    assert arm.played == 3


@pytest.mark.parametrize(
    ("bounds", "says"), [({"most": 0}, "--most 0: expected 1 to 200"), ({"hours": 13.0}, "--hours 13: expected more than 0")]
)
def test_a_bound_that_is_none_is_named(bounds, says):
    with pytest.raises(BadInput, match=says):
        Bounds(**bounds)


def test_steady_needs_ten_minutes_in_which_every_joint_was_measured():
    """A joint that still warms, a hole in its temperatures, or a shorter time: not steady."""
    made = [Made(k, 300.0 * k, (30.0, 30.0 + 0.1 * k)) for k in range(3)]
    assert steady(made, 0.5)
    assert not steady(made[1:], 0.5)
    assert not steady([each._replace(temperature_c=(30.0, 30.0 + each.replay)) for each in made], 0.5)
    assert not steady([*made[:2], made[2]._replace(temperature_c=(30.0, None))], 0.5)


def test_temperatures_that_never_change_are_no_steady_ones(cell):
    """Sensors that stand still, each at one number, say nothing of the arm: the campaign says so, and not that it is warm."""
    _, arm, client = cell
    arm.time_constant = 0.01
    ended = campaign(client, Bounds(), by="ada", why="", now=arm.now)
    assert not ended.steady
    assert str(ended.why) == "no temperature of any joint changed at all in 3 replays: their sensors are stuck"


def test_a_replay_whose_end_is_never_told_is_not_waited_for_until_the_hours_are_over(cell):
    """As where the daemon's disk is full: it cannot enter the end."""
    _, arm, client = cell
    arm.goes_on.clear()
    clock = itertools.count(START_UNIX_S, 100.0)
    ended = campaign(client, Bounds(longest_s=1000.0), by="ada", why="", now=lambda: next(clock), sleep=lambda _: None)
    assert (ended.why.code, ended.made) == ("campaign_not_ended", ())
    arm.goes_on.set()


def test_the_end_of_a_replay_that_the_disk_refused_is_told_once_it_is_entered(cell):
    """Else it would stay announced on the bus until the next one."""
    daemon, _, client = cell
    number = daemon.state.store.ledger.claim(START_UNIX_S, "requested", START_UNIX_S)
    daemon.monitor.recover()
    [told] = client.get("replay")
    assert (told.document["state"], told.document["replay"], told.document["verdict"]) == ("ended", number, "aborted")


def test_a_daemon_that_dies_meanwhile_ends_the_campaign_within_seconds(cell):
    """It is not waited for until the hours are over."""
    daemon, arm, client = cell
    arm.goes_on.clear()

    def dies() -> bool:
        if arm.played:
            daemon.bus.close()
        return False

    with pytest.raises(BusError):
        campaign(client, Bounds(), by="ada", why="", should_stop=dies, now=arm.now)
    arm.goes_on.set()
