"""Two plants of one PostgreSQL: the one that leads is killed, the other goes on within half a minute, and nothing is lost or doubled."""

import json
import statistics
import time

import psycopg
import pytest
from killed_plant import SITES, KilledPlant, free_ports
from plant_screen import Browser

from monitor.errors import StoreUnavailable
from monitor.plant.database import Database
from monitor.plant.lock import OnlyOne

PLANTS = ("plant", "plant 2")
TAKES_OVER_S = 30.0


class TwoPlants(KilledPlant):
    """The plant and its standby, as processes. A context manager."""

    def __init__(self, *words, **settings):
        self.screens = {}
        super().__init__(*words, **settings)
        try:
            self.until(lambda: self.leader() == PLANTS[0], "the first plant leads")
            self.start(PLANTS[1])
            self.until(lambda: "another plant leads" in self.log(PLANTS[1]), "the standby")
        except BaseException:
            self.__exit__()
            raise

    def configuration(self, role):
        """That of the first one, with a screen of its own."""
        if role not in self.screens:
            (port,) = free_ports(1)
            self.screens[role] = f"http://127.0.0.1:{port}/"
            text = super().configuration(role).read_text()
            (self.folder / f"{role} with its screen.toml").write_text(f'{text}[screen]\nlisten = "127.0.0.1:{port}"\n')
        return self.folder / f"{role} with its screen.toml"

    def leader(self):
        """Which one says in the database that it runs; None where nobody does yet."""
        found = self.asked("SELECT (document->>'pid')::int FROM note WHERE key = 'running'")
        return next((role for role in PLANTS if role in self._running and (self._running[role].pid,) in found), None)

    def kill_the_leader(self):
        """Seconds until the other one leads, and until newer transitions of every site are written; the killed one begins again then."""
        before = self.leader()
        self.kill(before)
        held, began = self.held(), time.monotonic()
        leads_s = self.until(lambda: self.leader() not in (None, before), "the other one leads", within_s=120.0)
        self.until(lambda: all(self.copied()[site] > held[site] for site in SITES), "goes on", within_s=120.0)
        goes_on_s = time.monotonic() - began
        self.start(before)
        return leads_s, goes_on_s


def killed(postgres, folder, *, kills, arms, changes_a_s):
    """By kill: the seconds until the standby led and copied; and what is wrong at the end."""
    with TwoPlants(postgres, folder, arms=arms, days=3, changes_a_s=changes_a_s, day_every_s=30.0, seed=3) as world:
        world.caught_up()
        times = []
        for _ in range(kills):
            time.sleep(world.chance.uniform(0.0, 3.0))
            times.append(world.kill_the_leader())
        made, _ = world.finish()
        return times, world.wrong(made)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_plant_that_is_killed_is_taken_over_within_half_a_minute(postgres, tmp_path):
    """Twice: the one that was killed first has come back as the standby, and takes over in its turn."""
    times, wrong = killed(postgres, tmp_path, kills=2, arms=9, changes_a_s=20.0)
    assert wrong == []
    assert max(goes_on for _, goes_on in times) <= TAKES_OVER_S, times


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_screen_of_the_standby_shows_every_arm_and_its_commands_reach_them(postgres, tmp_path):
    """While the other one leads: a person need not know which of the two he looks at."""
    with TwoPlants(postgres, tmp_path, arms=6, days=3, changes_a_s=5.0, day_every_s=30.0, seed=4) as world:
        world.caught_up()
        standby = Browser(world.screens[PLANTS[1]])
        arms = json.loads(standby.ask("GET", "/api/v1/arms")[1])
        assert (len(arms["arms"]), arms["not_running"]) == (6, None)
        arm = f"{arms['arms'][0]['site']}/{arms['arms'][0]['robot']}"
        status, text = standby.command(arm, "ack", {"joint": 1, "condition": "of_nobody", "by": "ada", "why": "seen"})
        assert (status, "does not answer" in text, "of_nobody" in text) == (409, False, True), text
        assert world.leader() == PLANTS[0]
        assert world.asked("SELECT who, act, robot FROM audit") == [("ada", "ack", arm)]


@pytest.mark.soak
@pytest.mark.timeout(3000)
def test_fifty_take_overs_lose_and_double_nothing(postgres, tmp_path, soak_row):
    times, wrong = killed(postgres, tmp_path, kills=50, arms=100, changes_a_s=20.0)
    for what, k in (("leads", 0), ("has copied newer transitions of every site", 1)):
        of = [each[k] for each in times]
        soak_row(
            f"50 kills −9 of the plant that leads: seconds until the other {what}",
            f"{statistics.median(of):.1f}, at most {max(of):.1f}",
            "≤ 30",
        )
    soak_row("… arms with a transition that is lost, doubled or out of order", f"{len(wrong)} of 100", "0")
    assert wrong == []
    assert max(goes_on for _, goes_on in times) <= TAKES_OVER_S


def test_the_lock_of_a_session_that_the_server_ends_is_somebody_elses(postgres):
    """As of a machine that is gone: whoever had it sees that it has it no more, before it writes."""
    address = postgres.address()
    databases = [Database(address) for _ in range(2)]
    first, second = (OnlyOne(each, "plant", 1) for each in databases)
    assert [first.take(), second.take(), first.take()] == [True, False, True]
    with psycopg.connect(address.replace("+psycopg", ""), autocommit=True) as admin:
        admin.execute("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'")
        deadline = time.monotonic() + 10.0
        while not second.take():
            assert time.monotonic() < deadline
    assert [first.take(), second.take()] == [False, True]
    postgres.kill()
    with pytest.raises(StoreUnavailable):
        second.take()
    postgres.start()
    for each in (first, second):
        each.release()
    for each in databases:
        each.close()
