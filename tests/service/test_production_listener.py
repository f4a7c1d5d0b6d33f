"""The daemon's part of ordinary work: rows become sums, a day of them an observation, and all of it outlives a kill."""

import math
import pickle
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from prepared import Process
from test_backups_and_retention import configuration, lived, recordings  # noqa: F401 - a fixture

from monitor.acquire.rows import columns
from monitor.acquire.ur.rtde import COLUMN, WIDTH
from monitor.identify.production.arm import rows_of_columns
from monitor.judge.alerts.health import health_from_document
from monitor.judge.belief import belief_from_document
from monitor.publish.documents import as_json
from monitor.publish.metrics import families
from monitor.recording import DAY_S, Array, Recording
from monitor.service import production
from monitor.service.computing import HERE, Apart, Compute, ComputingFailed
from monitor.service.history import status
from monitor.service.history.assess_and_store import load_state
from monitor.service.history.needed import from_production_document, needed
from monitor.service.history.recompute import recompute, roll_back
from monitor.service.history.report import report as report_document
from monitor.service.history.status import schedule_document, status_document
from monitor.service.production import ProductionListener
from monitor.service.shared_state import ReplayRequests, SharedState
from monitor.store.formats.recordings import read_recording
from monitor.store.history.database import packed
from monitor.store.history.production import DayOfProduction
from monitor.store.store import Store
from monitor.views.language.catalogue import language
from monitor.views.report.sections import from_production
from monitor.views.terminal.arm import from_production_lines

LIVED = 3  # days with a replay; their times are 1e9 s and whole days
FIRST_DAY = math.floor((1.0e9 + LIVED * DAY_S) / DAY_S)
RATE_HZ = 25.0
WORKING = {"robot_mode": 7, "safety_mode": 1, "runtime_state": 2, "speed_scaling": 1.0, "target_speed_fraction": 1.0, "payload": 0.0}


class Said:
    """What was published."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def health(self) -> None:
        self.said.append("health")

    def from_production(self) -> None:
        self.said.append("from_production")

    def alert(self, alert: object) -> None:
        self.said.append("alert")

    def event(self, event: object) -> None:
        self.said.append("event")


def rows_of(recording: Recording, began_s: float) -> Array:
    """The rows that a listener would have received at 25 Hz while the arm moved so: (N, WIDTH)."""
    step = max(1, round(1.0 / RATE_HZ / float(np.median(np.diff(recording.t_s)))))
    t = recording.t_s[::step]
    rows = np.full((len(t), WIDTH), np.nan)
    of = {
        "actual_q": recording.q,
        "actual_qd": recording.qd,
        "actual_current": recording.current,
        "joint_temperatures": recording.temperature_c,
        "target_q": recording.target_q,
        "target_qd": recording.target_qd,
        "target_qdd": recording.target_qdd,
    }
    for name, value in of.items():
        if value is not None:
            rows[:, COLUMN[name]] = value[::step]
    for name, number in WORKING.items():
        rows[:, COLUMN[name]] = number
    rows[:, COLUMN["timestamp"].start] = t - t[0] + began_s
    return rows


class Plant:
    """A daemon's parts on a history of three replays, and an arm that works like its excitation."""

    def __init__(self, folder: Path, store: Store, motions: list[Recording]) -> None:
        self.configuration = configuration(folder, production={"listen": True}, schedule={"replay": "when_needed", "learning_days": 0.0})
        self.store, self.motions, self.said = store, motions, Said()
        self.clock, self.robot_s = FIRST_DAY * DAY_S + 1000.0, 0.0
        self.state = SharedState(self.configuration, self.store, lambda: self.clock, ReplayRequests())
        self.state.take(load_state(store), None)
        self.production = self.started()

    def started(self, compute: Compute = HERE) -> ProductionListener:
        return ProductionListener(self.state, self.said, compute=compute)  # type: ignore[arg-type]

    def shift(self, cycles: int) -> None:
        """So many excitations as work, one after the other."""
        for cycle in range(cycles):
            rows = rows_of(self.motions[cycle % len(self.motions)], self.robot_s)
            self.robot_s = float(rows[-1, 0]) + 0.5 / RATE_HZ
            self.clock += float(rows[-1, 0] - rows[0, 0])
            self.production.take(list(rows))
            self.production.step()
        self.robot_s += 100.0  # a pause ends the block
        self.production.take(list(rows_of(self.motions[0], self.robot_s)[:1]))
        self.production.step()

    def midnight(self) -> None:
        self.clock = (math.floor(self.clock / DAY_S) + 1) * DAY_S + 10.0
        self.production.step()


@pytest.fixture(scope="module")
def history(tmp_path_factory, recordings) -> tuple[Path, list[Recording]]:  # noqa: F811
    folder = tmp_path_factory.mktemp("production")
    with Store.open(folder) as store:
        lived(store, configuration(folder), recordings, range(LIVED))
    return folder, recordings


@pytest.fixture
def plant(history, tmp_path) -> Iterator[Plant]:
    folder, motions = history
    shutil.copytree(folder, tmp_path / "history")
    with Store.open(tmp_path / "history") as store:
        yield Plant(tmp_path / "history", store, motions)


def test_a_day_of_production_is_judged_after_midnight_and_enters_the_history_with_the_state(plant: Plant):
    """A minute that moves as the excitation does tells of every joint; the belief learns from it, and a document says so."""
    plant.shift(6)
    assert plant.store.production.rows() == []
    plant.midnight()
    [day] = plant.store.production.rows()
    assert day.day == FIRST_DAY
    assert day.learnt == (1, 2, 3, 4, 5, 6)
    stored = plant.store.assessments.state()
    belief = belief_from_document(stored.belief)
    assert belief.as_document() == plant.state.estimator.belief.as_document()
    assert belief.production.observations == 1
    assert belief.production.arm == "replay 3"
    replayed = belief.reference_torque_nm(plant.configuration.assess.friction)[0]
    assert np.allclose(np.array(day.document["friction_nm"]) / replayed, 1.0, atol=0.2)
    assert plant.said.said == ["health", "from_production"]
    settings = plant.configuration.schedule
    found = needed(settings, plant.store, belief, health_from_document(stored.health))
    assert found.from_unix_s == pytest.approx(day.document["end_unix_s"] + 7 * DAY_S, abs=1.0)
    said = from_production_document(plant.store, plant.state.estimator, settings)
    document = as_json(said)
    assert [joint.learnt_from_production for joint in said.joints] == [1] * 6
    assert [joint.learnt_from_replays for joint in said.joints] == [LIVED] * 6
    status = status_document(plant.configuration, plant.clock)
    assert status["from_production"] == document
    assert "the next replay is needed from" in "\n".join(from_production_lines(status["from_production"]))
    schedule = schedule_document(plant.configuration, plant.clock, 1)
    assert schedule["needed"]["why"].startswith("work does not tell enough")
    page = report_document(plant.configuration, plant.store, None, None, plant.clock)
    assert "Was aus der normalen Arbeit kam" in "".join(from_production(page, language("de")))
    metrics = {sample.name: sample.value for family in families({"from_production": said}) for sample in family.samples}
    assert metrics["joint_monitor_observations"] == 1.0


def test_the_history_with_production_is_recomputed_to_the_last_bit(plant: Plant, recordings):  # noqa: F811
    """A replay after a day of work depends on that day: judged once more from what was kept, it is the same."""
    plant.shift(6)
    plant.midnight()
    known = lived(plant.store, plant.configuration, recordings, range(LIVED + 2, LIVED + 3))
    assert known.belief.production.observations == 1
    result = recompute(plant.store)
    assert (result["assessments"], result["identical"], result["different"]) == (LIVED + 1, LIVED + 1, 0)


@pytest.mark.soak
def test_a_process_of_its_own_judges_a_day_of_production_to_the_last_bit_and_the_daemon_loads_nothing_for_it(
    plant: Plant, history, tmp_path
):
    """What gathers lasts for years, and is told in memory: an interpreter that adds a minute of work to the sums loads no scipy."""
    shutil.copytree(history[0], tmp_path / "other")
    with Store.open(tmp_path / "other") as store:
        other = Plant(tmp_path / "other", store, plant.motions)
        other.production = other.started(Apart())
        for each in (plant, other):
            each.shift(3)
            each.midnight()
        assert other.store.production.rows() == plant.store.production.rows()
        assert other.store.assessments.state() == plant.store.assessments.state()
        arm = other.production._pinned.arm
    given = tmp_path / "given"
    given.write_bytes(pickle.dumps((arm, rows_of(plant.motions[0], 0.0), other.production._settings)))
    code = (
        "import pickle, sys, monitor.service.run\nfrom pathlib import Path\nfrom monitor.acquire.rows import columns\n"
        "from monitor.identify.production.gather import gather\nfrom monitor.identify.production.arm import rows_of_columns\n"
        f"arm, block, settings = pickle.loads(Path({str(given)!r}).read_bytes())\n"
        "assert gather(rows_of_columns(columns(block), at_unix_s=1e9), arm, settings).cells\n"
        "heavy = ('scipy.linalg', 'scipy.signal', 'scipy.special', 'scipy.ndimage', 'filterpy', 'pyarrow', 'pinocchio')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=110)
    assert done.stdout.strip() == "[]"


def test_a_day_that_could_not_be_computed_is_judged_later(plant: Plant):
    """A host without memory for the process that computes is asked again, and not every second."""
    plant.shift(3)
    asked = []

    def failing(*_: object) -> object:
        asked.append(plant.clock)
        raise ComputingFailed("no process can be started: Cannot allocate memory")

    plant.production._compute = failing  # type: ignore[assignment]
    for _ in range(3):
        with pytest.raises(ComputingFailed) if not asked else nullcontext():
            plant.midnight() if not asked else plant.production.step()
    assert len(asked) == 1
    plant.production._compute = HERE
    plant.clock += production.KEEP_EVERY_S
    plant.production.step()
    assert len(plant.store.production.rows()) == 1


@pytest.mark.parametrize(
    ("found", "replayed_days_ago", "allow_motion", "pulled_forward"),
    [
        ({"suspects": (3,)}, 0.9, True, False),  # a suspicion asks on every second day
        ({"suspects": (3,)}, 1.1, True, True),
        ({"asks": (2,)}, 0.1, True, True),  # what work alone has found waits for nothing
        ({"asks": (2,)}, 1.1, False, False),
        ({}, 1.1, True, False),
    ],
)
def test_what_a_day_of_production_makes_likely_pulls_a_replay_forward_where_motion_is_allowed(
    plant: Plant, monkeypatch, found, replayed_days_ago, allow_motion, pulled_forward
):
    sections = {"production": {"listen": True}, "schedule": {"replay": "when_needed"}, "replay": {"allow_motion": allow_motion}}
    requests = ReplayRequests()
    settings = configuration(Path(plant.configuration.store.directory), **sections)
    plant.state = SharedState(settings, plant.store, lambda: plant.clock, requests)
    plant.state.take(load_state(plant.store), None)

    def told(function, *arguments):
        result = function(*arguments)
        if function is not production.production_verdict:
            return result
        observation, verdict = result
        return observation, replace(verdict, **{"asks": (), "suspects": ()} | found)

    plant.production = ProductionListener(plant.state, plant.said, compute=told)  # type: ignore[arg-type]
    plant.shift(3)
    monkeypatch.setattr(type(plant.store.ledger), "learnt_at_unix_s", lambda _: plant.clock - replayed_days_ago * DAY_S)
    plant.midnight()
    assert len(plant.store.production.rows()) == 1
    assert requests.take_evidence() == (plant.clock if pulled_forward else None)


def test_a_kill_costs_the_last_minutes_and_no_day_is_judged_twice(plant: Plant):
    plant.shift(3)
    plant.clock += 400.0
    plant.production.step()  # the sums are kept
    kept = plant.store.production.information()
    plant.production = plant.started()  # as after a kill
    plant.shift(3)
    plant.midnight()
    assert kept["seen_s"][0]["seconds"] > 20.0
    [day] = plant.store.production.rows()
    assert day.document["seen_s"] > 1.8 * kept["seen_s"][0]["seconds"]
    plant.production = plant.started()
    plant.production.step()
    assert len(plant.store.production.rows()) == 1


def test_the_first_day_of_production_is_judged_after_a_night_that_nobody_watched(plant: Plant):
    """Killed in the evening and started after midnight, before any day was judged: the day is judged then, and not a day later."""
    plant.shift(6)
    plant.clock += 400.0
    plant.production.step()  # the sums are kept
    plant.clock = (FIRST_DAY + 1) * DAY_S + 3600.0
    plant.production = plant.started()
    plant.production.step()
    assert [day.day for day in plant.store.production.rows()] == [FIRST_DAY]


DAEMON = """
import sys, time
from pathlib import Path
from monitor.config.load import load
from monitor.service import production
from monitor.service.run import serve
from monitor.service.scheduler import Clocks
production.BLOCK_S, production.KEEP_EVERY_S, production.PAUSE_S = 3.0, 0.5, 0.1  # a minute of work in three seconds
began = time.monotonic()
serve(load(Path(sys.argv[1])), clocks=Clocks(now=lambda: float(sys.argv[2]) + time.monotonic() - began))
"""
HOST = "127.0.25.25"


def eventually(found: Callable[[], float], least: float) -> float:
    """The value as soon as it is so large; fails after a minute and a half."""
    for _ in range(450):
        value = found()
        if value >= least:
            return value
        time.sleep(0.2)
    raise AssertionError(f"{value:g} after 90 s; expected {least:g}")


@pytest.fixture
def working_arm() -> Iterator[str]:
    """The address of a simulated arm at work."""
    arm = Process([sys.executable, "-m", "monitor.simulate", "--bind", HOST, "--cell", "pick-and-place"], stdout=subprocess.PIPE, text=True)
    try:
        assert arm.stdout is not None
        assert "listening" in arm.stdout.readline()
        yield HOST
    finally:
        arm.terminate()
        arm.communicate(timeout=30)


@pytest.mark.timeout(300)
@pytest.mark.soak
def test_a_daemon_that_is_killed_between_days_of_production_loses_no_kept_sum_and_judges_no_day_twice(history, tmp_path, working_arm):
    """A process of its own beside an arm at work: killed in the afternoon, and after it has judged that day; what was kept counts once."""
    folder = tmp_path / "history"
    shutil.copytree(history[0], folder)
    robot = f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "{working_arm}"\n'
    (tmp_path / "cell.toml").write_text(f'{robot}[store]\ndirectory = "{folder}"\n[production]\nlisten = true\n')

    def kept(day: int) -> float:
        """Seconds of a day that are kept."""
        with Store.reader(folder) as store:
            seen = (store.production.information() or {}).get("seen_s", ())
        return sum(each["seconds"] for each in seen if each["day"] == day)

    def judged() -> list[DayOfProduction]:
        with Store.reader(folder) as store:
            return store.production.rows()

    def life(at_unix_s: float, until: Callable[[], float], least: float) -> None:
        """One daemon, from a time on, until there is enough; then it is killed."""
        daemon = Process([sys.executable, "-c", DAEMON, str(tmp_path / "cell.toml"), repr(at_unix_s)], stderr=subprocess.DEVNULL)
        try:
            eventually(until, least)
        finally:
            daemon.kill()
            daemon.wait()

    midnight = (FIRST_DAY + 1) * DAY_S
    life(midnight - 43_200.0, lambda: kept(FIRST_DAY), 5.5)
    afternoon = kept(FIRST_DAY)
    life(midnight + 5.0, lambda: min(10.0 * len(judged()), kept(FIRST_DAY + 1)), 2.5)
    [day] = judged()
    night = kept(FIRST_DAY + 1)
    assert day.day == FIRST_DAY
    assert day.document["seen_s"] == pytest.approx(afternoon)
    with Store.open(folder) as store:
        again = Plant(folder, store, history[1])
        again.clock = midnight + 3600.0
        again.production = again.started()
        again.shift(2)
        again.clock += 400.0
        again.production.step()
        assert judged() == [day]
    assert kept(FIRST_DAY) == pytest.approx(afternoon)
    assert kept(FIRST_DAY + 1) > night + 10.0


def test_production_waits_for_a_replay_that_is_recorded_and_not_assessed(plant: Plant):
    """Work that followed it would make the belief younger than the replay, which then could never be learned from."""
    waiting = plant.store.ledger.claim(plant.clock, "scheduled", plant.clock)
    plant.shift(6)
    plant.midnight()
    assert plant.store.production.rows() == []
    plant.store.ledger.end(waiting, "aborted", "the disk is full", plant.clock)
    plant.production.step()
    assert [day.day for day in plant.store.production.rows()] == [FIRST_DAY]


def test_a_replay_is_no_production_and_a_day_without_production_is_no_observation(plant: Plant):
    with plant.state.replaying:
        plant.shift(2)
    plant.midnight()
    assert plant.store.production.rows() == []
    assert plant.said.said == []


def test_production_with_a_payload_that_no_replay_had_waits_for_a_replay(plant: Plant, monkeypatch):
    """The frozen model is of another payload: what the arm carries now would count as friction. That replay is read once for it."""
    read = []
    monkeypatch.setattr(production, "read_recording", lambda path: read.append(path) or read_recording(path))
    robot = replace(plant.configuration.robot, payload_kg=2.0)
    plant.state.use(replace(plant.configuration, robot=robot))
    plant.shift(2)
    plant.midnight()
    assert plant.store.production.rows() == []
    assert len(read) == 1
    plant.state.use(plant.configuration)  # the payload is as in that replay again
    plant.shift(6)
    plant.midnight()
    assert len(plant.store.production.rows()) == 1


def test_the_thread_says_in_every_turn_that_it_lives(plant: Plant, monkeypatch):
    monkeypatch.setattr(production, "PAUSE_S", 0.001)
    stopping, turns = threading.Event(), []

    def alive() -> None:
        turns.append(0)
        if len(turns) == 3:
            stopping.set()

    plant.production.run(stopping, alive)
    assert len(turns) == 3


def test_a_clock_that_is_set_back_keeps_the_production_of_before_and_takes_back_that_of_the_future(plant: Plant):
    """Work that was judged after the last replay stays learnt, in the table and in the belief; a day a hundred days ahead is in neither."""
    plant.shift(6)
    plant.midnight()
    right, kept = plant.clock, plant.state.estimator.belief.as_document()
    plant.clock += 100.0 * DAY_S
    plant.shift(6)
    plant.midnight()
    assert len(plant.store.production.rows()) == 2
    plant.clock = right
    known = roll_back(plant.store, plant.clock)
    assert known.belief.as_document() == kept
    assert plant.store.assessments.state().belief == kept
    assert [day.day for day in plant.store.production.rows()] == [FIRST_DAY]
    plant.state.take(known, None)
    plant.shift(6)
    plant.midnight()
    assert [day.day for day in plant.store.production.rows()] == [FIRST_DAY, FIRST_DAY + 1]
    information = plant.store.production.information()
    assert max(cell["day"] for cell in information["cells"]) <= FIRST_DAY + 1


def test_a_history_without_production_shows_none_and_its_schedule_reads_no_belief(plant: Plant, monkeypatch):
    def never(_: object) -> None:
        raise AssertionError("read")

    assert "from_production" not in status.status_document(plant.configuration, plant.clock)
    monkeypatch.setattr(status, "belief_from_document", never)
    settings = replace(plant.configuration.schedule, replay="always")
    always = replace(plant.configuration, schedule=settings)
    assert "needed" not in status.schedule_document(always, plant.clock, 1)


def test_live_rows_carry_the_force_at_the_tcp():
    rows = np.zeros((3, WIDTH))
    rows[:, COLUMN["timestamp"].start] = [0.0, 0.04, 0.08]
    rows[:, COLUMN["actual_TCP_force"]] = [1.0, 2.0, 30.0, 0.0, 0.0, 0.0]
    assert rows_of_columns(columns(rows), at_unix_s=0.0).tcp_force[:, 2].tolist() == [30.0] * 3


def test_a_thread_that_is_late_loses_blocks_and_no_memory(plant: Plant):
    rows = list(rows_of(plant.motions[0], 0.0))
    for minute in range(12):
        plant.production.take([row + np.where(np.arange(WIDTH) == 0, 200.0 * minute, 0.0) for row in rows])
    assert plant.production.left_out > 0


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_a_month_of_production_takes_no_more_memory_than_a_week_of_it(plant: Plant, soak_row):
    """Thirty days, each with work and judged: memory and what is kept of the sums are those of the week that they are of."""
    pages, kept = {}, {}
    for day in range(30):
        plant.shift(6)
        plant.midnight()
        pages[day] = int(Path("/proc/self/statm").read_text("ascii").split()[1]) * 4096 / 1e6
        kept[day] = len(packed(plant.store.production.information()))
    assert len(plant.store.production.rows()) == 30
    grown = pages[29] - pages[9]
    soak_row("a month of ordinary work", f"{grown:+.1f} MB from day 10 to 30; {kept[29] / 1e3:.0f} kB of sums", "flat")
    assert kept[29] < 1.2 * kept[9]
    assert grown < 5.0
