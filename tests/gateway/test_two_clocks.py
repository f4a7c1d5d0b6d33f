"""Nobody's clock but the gateway's own decides whether a person is told: what is new is what was committed after the cursor."""

import random
from datetime import timedelta

import orjson
import pytest
from mail_server import MailServer
from small_plant import DAY_S, NOW_UNIX_S, SmallPlant, alert
from test_frame import gateway
from test_notify_mail import notify, to
from test_told_once import again

from monitor.gateway.source import Source
from monitor.plant.arm import GONE
from monitor.plant.backup import back_up, rebuild, restore
from monitor.plant.ingest import RUNNING, begin_another_history, known, set_arms, set_note
from monitor.plant.pull import CHANGES_MEANWHILE, pull
from monitor.publish.timestamps import rfc3339

HOUR_S, YEAR_S = 3600.0, 365.25 * DAY_S
OFFSETS_S = (0.0, -90.0, 90.0, -HOUR_S, HOUR_S, -40 * DAY_S, 40 * DAY_S, -3 * YEAR_S, 3 * YEAR_S, -NOW_UNIX_S)


@pytest.fixture
def server(tmp_path):
    with MailServer(tmp_path) as made:
        yield made


@pytest.mark.parametrize("behind_s", [120.0, 40 * DAY_S, 3 * YEAR_S, NOW_UNIX_S])
def test_seventeen_arms_that_reach_the_limit_by_a_clock_that_is_behind_are_all_told(plant, server, behind_s):
    """Their clock reads a time before the gateway's first start, by minutes or since 1970."""
    for k in range(17):
        plant.arm(f"hall/cell-{k}")
    people = notify(server, to("ada"))
    with plant.gateway(people) as running:
        plant.lives(running, HOUR_S)
        for k in range(17):
            plant.happens(f"hall/cell-{k}", tier="limit", condition=f"of_{k}", at_unix_s=plant.now - behind_s)
        plant.lives(running, HOUR_S)
        assert running.outbox.owed("mail") == []
    text = "\n".join(message.get_content() for _, message in server.taken)
    assert [text.count(f"hall/cell-{k}: ") for k in range(17)] == [1] * 17


class World:
    """One plant with arms whose clocks jump, a gateway that comes and goes, and what each arm has committed since the gateway first ran."""

    def __init__(self, folder, chance):
        self.plant, self.chance = SmallPlant(folder / "plant.sqlite"), chance
        self.logs = {f"hall/cell-{k}": [] for k in range(3)}
        self.history = dict.fromkeys(self.logs, 1)
        self.offset_s = {name: chance.choice(OFFSETS_S) for name in self.logs}
        self.expected, self.began, self.folder = [], False, folder
        self.untaken, self.gone = [], []  # since the gateway looked last: what is committed, and what the arm itself has lost of it
        for name in self.logs:
            self.plant.arm(name)

    def commits(self):
        """One transition of one arm, dated by its own clock, which may have jumped, or stand."""
        name = self.chance.choice(list(self.logs))
        if self.chance.random() < 0.3:
            self.offset_s[name] = self.chance.choice(OFFSETS_S)
        at = self.plant.now + self.offset_s[name]
        if self.logs[name] and self.chance.random() < 0.2:
            at = self.logs[name][-1]["at_unix_s"]  # a clock that starts at the same time after every boot
        step = {"kind": self.chance.choice(["raised", "cleared"]), "joint": self.chance.randint(1, 2), "tier": "limit", "at_unix_s": at}
        self.logs[name].append(step)
        self.plant.happens(name, **step)
        if self.began:
            self.expected.append(name)
            self.untaken.append((name, step))

    def looks(self, running):
        """The gateway takes what is there."""
        running.step()
        self.untaken, self.gone = [], []

    def rebuilds(self):
        """Everything is copied from the arms anew."""
        rebuild(self.plant.database, who="ada")
        for name in self.gone:  # the plant alone still had it
            self.expected.remove(name)
        self.gone = []
        for name in self.chance.sample(list(self.logs), 3):
            self.plant.arm(name)
            for step in self.logs[name]:
                self.plant.happens(name, **step)

    def restores_an_arm(self):
        """An arm's history comes from a backup of it, and loses its newest transitions; new ones take their numbers."""
        name = self.chance.choice(list(self.logs))
        site, _, robot = name.partition("/")
        before = known(self.plant.database, site, robot, self.plant.now)
        self.plant.now += HOUR_S
        begin_another_history(self.plant.database, before, name, None, CHANGES_MEANWHILE, self.plant.now)
        kept = max(len(self.logs[name]) - self.chance.randint(0, 2), 0)
        for step in self.logs[name][kept:]:
            if any(each is step for _, each in self.untaken):
                self.gone.append(name)
        del self.logs[name][kept:]
        for step in self.logs[name]:
            self.plant.happens(name, **step)

    def restores_the_plant(self):
        """The plant's database is put back to a moment ago, and the arms are copied from there."""
        target = self.folder / "backup"
        back_up(self.plant.database, target)
        restore(self.plant.database, target, force=True, who="ada")


@pytest.mark.parametrize("seed", range(12))
def test_whatever_clocks_say_each_transition_after_the_first_start_is_told_once(tmp_path, seed):
    """Clock offsets × first start × cursor states: the gateway is up or down, the plant is rebuilt, an arm's history is restored."""
    chance = random.Random(seed)
    world, told = World(tmp_path, chance), []
    plant = world.plant
    for _ in range(chance.randint(0, 12)):
        world.commits()
    for _ in range(12):
        up = chance.random() < 0.7
        acts = [world.commits] * 6 + [world.rebuilds, world.restores_an_arm, world.restores_the_plant]
        if not up:
            for _ in range(chance.randint(0, 5)):
                chance.choice(acts)()
            plant.now += chance.choice([60.0, DAY_S, 500 * DAY_S])
            continue
        with gateway(plant)[0] as running:
            world.looks(running)
            world.began = True
            for _ in range(chance.randint(0, 6)):
                chance.choice(acts)()
                if chance.random() < 0.7:
                    world.looks(running)
                plant.now += 10.0
            world.looks(running)
            running.outbox.prune()
            for each in running.outbox.owed("noting"):
                told.append(each.document["id"])
                running.outbox.delivered([each.id])
    if world.began:
        with gateway(plant)[0] as running:
            world.looks(running)
            told += [each.document["id"] for each in running.outbox.owed("noting")]
    assert len(told) == len(set(told)) == len(world.expected)
    assert sorted(world.expected) == sorted("/".join(each.split("/")[:2]) for each in told)
    plant.close()


def test_an_alert_of_an_arm_whose_history_cannot_be_copied_is_told_from_its_health(plant, server):
    """Whenever it was raised by the arm's clock: after the gateway's start as well."""
    plant.arm("hall/cell-1")
    with plant.gateway(notify(server, to("ada"))) as running:
        plant.lives(running, HOUR_S)
        said = alert(tier="limit", raised_unix_s=plant.now + 3 * YEAR_S)
        number = plant.arm("hall/cell-1", health={"state": "FAILURE", "alerts": [said]})
        set_arms(plant.database, [{"number": number, "since": None, "why": None, "problem": CHANGES_MEANWHILE}])
        plant.lives(running, HOUR_S)
    with again(plant) as running:
        plant.lives(running, DAY_S, 600.0)
    assert [subject.partition(": ")[0] for subject in server.subjects()] == ["Active already"]


@pytest.mark.parametrize("offset_s", [-3 * YEAR_S, -HOUR_S, HOUR_S, 3 * YEAR_S])
def test_an_alert_is_shelved_for_as_long_as_its_arm_s_own_clock_says(plant, server, offset_s):
    """Shelved for a day by the arm's clock: nobody is told within the day, and everybody after it."""

    def says(shelved_until_unix_s):
        here = plant.now + offset_s
        said = alert(raised_unix_s=NOW_UNIX_S + offset_s - 90 * DAY_S, shelved_until=rfc3339(shelved_until_unix_s + offset_s))
        plant.arm("hall/cell-1", health={"state": "MAINTENANCE_REQUIRED", "alerts": [said]}, monitor={"said_at": rfc3339(here)})

    until = plant.now + DAY_S
    says(until)
    with plant.gateway(notify(server, to("ada"))) as running:
        for _ in range(23):
            plant.lives(running, HOUR_S, 600.0)
            says(until)
        assert server.taken == []
        for _ in range(3):
            plant.lives(running, HOUR_S, 600.0)
            says(until)
    assert len(server.taken) == 1


@pytest.mark.parametrize("offset_s", [-3 * YEAR_S, -30 * DAY_S, 3 * YEAR_S])
def test_a_silent_arm_is_told_of_after_its_hours_though_the_plant_s_clock_is_another(plant, server, offset_s):
    """The plant dates the silence, and the gateway may run on another computer."""
    number = plant.arm("hall/cell-1")
    began = plant.now
    with plant.gateway("[gateway]\nplant_silent_minutes = 0\n" + notify(server, to("ada"))) as running:
        for hour in range(30):
            set_note(plant.database, RUNNING, plant.now + offset_s, {})
            if hour == 2:
                set_arms(plant.database, [{"number": number, "since": plant.now + offset_s, "why": GONE, "problem": None}])
            plant.lives(running, HOUR_S, 300.0)
            assert bool(server.taken) == (plant.now >= began + 26 * HOUR_S), hour


def test_the_weekly_report_has_what_was_told_in_its_week_whatever_the_arms_clocks_say(plant, server):
    """Each change stands in the report of the week in which it came, once."""
    plant.arm("hall/cell-1")
    with plant.gateway(notify(server, to("ada", 'reports = ["weekly"]'))) as running:
        plant.lives(running, DAY_S, HOUR_S)
        for k, offset_s in enumerate(OFFSETS_S):
            plant.happens("hall/cell-1", condition=f"of_{k}", at_unix_s=plant.now + offset_s, text=f"This is number {k}.")
        plant.lives(running, 14 * DAY_S, HOUR_S)
    pages = [message for _, message in server.taken if message.is_multipart()]
    assert len(pages) == 2
    assert [[page.get_body().get_content().count(f"\n{n} changes of alerts") for n in (len(OFFSETS_S), 0)] for page in pages] == [
        [1, 0],
        [0, 1],
    ]


def test_transitions_of_one_moment_are_told_apart(plant):
    """By their number in the arm's log: a clock that starts at the same time after every boot dates two of them alike."""
    plant.arm("hall/cell-1")
    with gateway(plant)[0] as running:
        running.step()
        for kind in ("raised", "cleared", "raised"):
            plant.happens("hall/cell-1", kind, at_unix_s=timedelta(days=365).total_seconds())
        assert len({each.id for each in Source(plant.database).transitions().transitions}) == 3
        running.step()
        assert len(running.outbox.owed("noting")) == 3


class Log:
    """The log of an arm, as its monitor answers, four transitions a page."""

    def __init__(self):
        self.events, self.pages, self.meanwhile = [], 0, "of_meanwhile"
        for k in range(9):
            self.commits(f"of_{k}", NOW_UNIX_S + k)

    def commits(self, condition, at_unix_s=1000.0):
        event = {
            **alert(1, condition, "limit", text=f"This is {condition}."),
            "seq": len(self.events) + 1,
            "kind": "raised",
            "at": rfc3339(at_unix_s),
        }
        self.events.append(event)

    def ask(self, key):
        log, _, parameters = key.rpartition("?")
        if log.endswith("history"):
            return orjson.dumps({"rows": [], "changes": [], "next": None, "history_id": "h"})
        after = int(parameters.partition("=")[2].partition(";")[0])
        found = self.events[after : after + 4]
        following = found[-1]["seq"] if found and found[-1]["seq"] < len(self.events) else None
        answer = {"events": found, "first_kept": 1, "last": len(self.events), "next": following, "history_id": "h"}
        self.pages += 1
        if self.pages == 1:  # while it is copied for the first time
            self.commits(self.meanwhile)
        return orjson.dumps(answer)


def test_an_arm_that_joins_tells_what_is_active_and_nothing_of_its_past_years(plant, server):
    """Its log when the plant first asks is of before, whatever its clock says; what it commits later is new, also after `plant rebuild`."""
    log = Log()

    def copied_and_told(running):
        pull(plant.database, log, "joint-monitor/v1/hall/cell-1", "hall", "cell-1", plant.clock)
        plant.lives(running, HOUR_S)

    with plant.gateway(notify(server, to("ada"))) as running:
        plant.lives(running, HOUR_S)
        plant.arm("hall/cell-1", health={"state": "FAILURE", "alerts": [alert(1, "of_3", text="This is of_3.")]})
        copied_and_told(running)
        log.commits("of_later")
        copied_and_told(running)
        rebuild(plant.database, who="ada")
        log.commits("of_rebuilding")
        copied_and_told(running)
        copied_and_told(running)
    told = [[each["condition"] for each in log.events if each["text"] in message.get_content()] for _, message in server.taken]
    assert told == [["of_meanwhile"], ["of_3"], ["of_later"], ["of_rebuilding"]]
