"""Inspection duties: hours and stops as they are heard, checks with their due dates, and where all of it is shown."""

import json
import queue
import socket
import struct
import time
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from published import last_values
from typer.testing import CliRunner

from monitor.acquire.driver import ReportedError, ReportedMode
from monitor.acquire.duty import DutyCounter
from monitor.acquire.listen import LiveState
from monitor.acquire.ur.primary import ReportedErrors, reported_error, reported_mode
from monitor.cli.main import app
from monitor.config.load import from_document
from monitor.errors import BadConfiguration, BadInput, StoreError
from monitor.judge.inspection import PLANS, Done, InspectionItem, InspectionSettings, due
from monitor.publish.documents import as_json
from monitor.publish.metrics import Families, families
from monitor.publish.queries import InspectedRequest, UndoInspectedRequest
from monitor.publish.registry import schema
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S
from monitor.service.duty import Duty
from monitor.service.history.inspection import declare, inspection_document
from monitor.service.shared_state import SharedState
from monitor.simulate.machine.journal import SafetyMessage
from monitor.simulate.machine.state import SafetyMode
from monitor.simulate.wire.primary import encoded
from monitor.store.store import Store
from monitor.views.language.catalogue import language
from monitor.views.report.sections import inspection
from monitor.views.terminal.arm import inspection_lines

NOW = 20_000.5 * DAY_S  # noon of 2024-10-04
ROBOT = {"model": "ur5", "site": "lab", "id": "cell-1"}


def state(t_s: float, *, mode: int = 7, safety: int = 1, speed: float = 0.0) -> LiveState:
    zero = np.zeros(6)
    return LiveState(
        t_s=t_s, q=zero, qd=np.array([0.0, speed, 0.0, 0.0, 0.0, 0.0]), current=zero, temperature_c=zero,
        target_q=zero, target_qd=zero, target_qdd=zero, robot_mode=mode, safety_mode=safety, runtime_state=2,
    )  # fmt: skip


def configuration(folder: Path, **inspection: object):
    return from_document({"robot": ROBOT, "store": {"directory": str(folder)}, "inspection": inspection}, folder / "cell.toml")


class Said:
    """Counts the documents that are published."""

    def __init__(self) -> None:
        self.said = 0

    def inspection(self) -> None:
        self.said += 1


class Watched:
    """The daemon's part, on a history and a clock of its own."""

    def __init__(self, folder: Path, store: Store, **settings: object) -> None:
        self.configuration, self.store, self.said, self.clock = configuration(folder, **settings), store, Said(), NOW
        self.state = SharedState(self.configuration, self.store, lambda: self.clock)
        self.duty = self.started()

    def started(self) -> Duty:
        return Duty(self.state, self.said)  # type: ignore[arg-type]

    def hear(self, *states: LiveState) -> None:
        self.duty.take(states)

    def document(self) -> dict:
        found = inspection_document(self.configuration.inspection, self.store, self.clock)
        assert found is not None
        return as_json(found)


@pytest.fixture
def watched(tmp_path):
    with Store.open(tmp_path) as store:
        yield Watched(tmp_path, store, plan="universal-robots", hours_before=1000.0)


def test_hours_are_counted_while_rows_come_and_a_gap_counts_for_nothing():
    """Half a second off, one on, one in motion; then two minutes without a row, and a controller that started again."""
    counter = DutyCounter()
    rows = [state(0.0, mode=3), state(0.5, mode=3), state(1.5), state(2.5, speed=0.3), state(122.5), state(3.0), state(3.5)]
    seconds, edges = counter.take(rows)
    assert seconds == pytest.approx((3.0, 2.5, 1.0))
    assert not edges


def test_a_stop_counts_once_however_often_it_is_heard_and_over_a_restart(watched):
    """A stop that stands while the monitor starts again is the same one; a program that resets its stops makes many."""
    watched.hear(state(0.0), state(0.1, safety=3), state(0.2, safety=3))
    watched.duty = watched.started()
    watched.hear(state(0.3, safety=3), state(0.4))
    watched.hear(*(state(1.0 + 0.1 * k, safety=3 if k % 2 else 1) for k in range(10)))
    watched.hear(state(3.0, safety=9), state(3.1, safety=5), state(3.2, safety=7))  # a guard's door and an emergency stop are people's
    watched.duty.step()
    found = watched.document()
    assert found["stops"] == 1 + 5 + 1
    assert [stop["kind"] for stop in found["last_stops"]] == ["fault", *["protective_stop"] * 6]
    assert all(stop["ended_at"] for stop in found["last_stops"])
    assert watched.said.said >= 3


def test_a_stop_that_the_history_refuses_waits_for_it_as_the_hours_do(watched, monkeypatch):
    """A full disk: each is written once it takes them, in order and with the time, the cause and the replay of then."""

    def refuse(*_, **__):
        raise StoreError("the disk is full")

    with monkeypatch.context() as full, watched.state.replaying:
        full.setattr(watched.store.duties, "add", refuse)
        full.setattr(watched.store.duties, "stop_began", refuse)
        watched.hear(state(0.0), state(0.1, safety=3))
        watched.clock += 1.0
        watched.hear(state(1.1), state(1.2, safety=9))
    assert watched.document()["last_stops"] == []
    watched.duty.hear([ReportedError("C153A2", 3)])
    watched.clock += 600.0
    watched.duty.step()
    found = watched.document()
    assert found["stops"] == 2
    assert [(stop["kind"], stop["at"], stop["code"], stop["during_replay"]) for stop in found["last_stops"]] == [
        ("fault", rfc3339(NOW + 1.0), "C153A2", True), ("protective_stop", rfc3339(NOW), None, True),
    ]  # fmt: skip
    assert found["heard_h"] == pytest.approx(1.2 / 3600.0)


def test_a_stop_of_a_replay_is_marked_as_one(watched):
    """The daemon's own motion stands apart from production."""
    with watched.state.replaying:
        watched.hear(state(0.0), state(0.1, safety=3))
    watched.hear(state(0.2), state(0.3, safety=3))
    assert [stop["during_replay"] for stop in watched.document()["last_stops"]] == [False, True]


def test_nothing_is_counted_or_shown_where_nothing_is_configured(tmp_path):
    """No row of the history, no document, no line, no section."""
    with Store.open(tmp_path) as store:
        silent = Watched(tmp_path, store)
        silent.hear(state(0.0), state(0.5, safety=3))
        silent.duty.step()
        silent.duty.keep()
        assert (store.duties.total(), store.duties.stops(), silent.said.said) == ((None, 0.0, 0.0, 0.0, 0), [], 0)
        assert inspection_document(silent.configuration.inspection, store, NOW) is None
    assert inspection_lines(None) == []
    assert inspection({}, language("de")) == []


def test_a_check_without_a_record_is_due():
    """An empty record is no proof of an inspection."""
    item = InspectionItem(name="flat rings", every_days=30.0)
    assert due(item, None, NOW, 0.0, 0.0, 14.0).state == "unrecorded"


@pytest.mark.parametrize(
    ("days_ago", "hours_ago", "state_", "days_left"),
    [(0.0, 0.0, "done", 30.0), (20.0, 0.0, "soon", 10.0), (30.0, 0.0, "due", 0.0), (1.0, 400.0, "soon", 12.5), (1.0, 516.0, "due", -2.0)],
)
def test_a_check_is_due_by_date_or_by_hours_whichever_comes_first(days_ago, hours_ago, state_, days_left):
    """Every 30 days or 500 hours, at 8 operating hours a day, called soon two weeks before."""
    item = InspectionItem(name="gripper", every_days=30.0, every_hours=500.0)
    found = due(item, Done(NOW - days_ago * DAY_S, 1000.0 - hours_ago), NOW, 1000.0, 8.0, 14.0)
    assert (found.state, found.days_left) == (state_, pytest.approx(days_left))


def test_a_last_time_that_is_yet_to_come_is_no_record(tmp_path):
    """A slip in the file's year, which would else put the check off for decades; today's date is today's in every time zone."""
    with Store.open(tmp_path) as store:
        items = [{"name": day, "every_days": 30.0, "last_done": day} for day in ("2062-10-01", rfc3339(NOW + 0.5 * DAY_S)[:10])]
        arm = Watched(tmp_path, store, items=items)
        assert [item["state"] for item in arm.document()["items"]] == ["unrecorded", "done"]


@pytest.mark.parametrize("before", [0.0, 5200.0])
def test_a_check_by_hours_that_was_made_before_the_count_falls_due(tmp_path, before):
    """What the arm did between that check and the first row is not known; the hours since then count, with and without `hours_before`."""
    with Store.open(tmp_path) as store:
        item = {"name": "gripper", "every_hours": 100.0, "last_done": "2024-01-31"}
        arm = Watched(tmp_path, store, items=[item], hours_before=before)
        assert [each["hours_left"] for each in arm.document()["items"]] == [None], "nothing is counted yet"
        for day, left in ((19_990, 92.0), (19_991, 84.0)):
            store.duties.add(day, 10 * 3600.0, 8 * 3600.0, 3600.0)
            assert [each["hours_left"] for each in arm.document()["items"]] == [pytest.approx(left)]
        for day in range(19_992, 20_004):
            store.duties.add(day, 10 * 3600.0, 8 * 3600.0, 3600.0)
        assert [each["state"] for each in arm.document()["items"]] == ["due"]


def test_operating_hours_make_a_check_due_and_recording_it_begins_anew(tmp_path):
    """Ten days of eight hours; 100 hours between two checks of the gripper: the date follows from the usual pace."""
    with Store.open(tmp_path) as store:
        arm = Watched(tmp_path, store, items=[{"name": "gripper", "every_hours": 100.0, "last_done": "2024-09-24"}])
        for day in range(19_990, 20_000):
            store.duties.add(day, 10 * 3600.0, 8 * 3600.0, 3600.0)
        [item] = arm.document()["items"]
        assert (item["state"], item["hours_left"]) == ("soon", pytest.approx(100.0 - 9 * 8.0)), "of the day itself nothing counts"
        assert item["days_left"] == pytest.approx(28.0 / 8.0)
        answer = declare(store, arm.configuration.inspection, InspectedRequest(item="Gripper", by="Ada", why="no play"), NOW)
        assert answer.inspection.hours_left == pytest.approx(100.0)
        assert answer.inspection.last_by == "Ada"
        answer = declare(store, arm.configuration.inspection, UndoInspectedRequest(item="gripper", by="Ada"), NOW)
        assert answer.inspection.hours_left == pytest.approx(28.0)
        with pytest.raises(BadInput, match="nothing is recorded"):
            declare(store, arm.configuration.inspection, UndoInspectedRequest(item="gripper", by="Ada"), NOW)
        with pytest.raises(BadInput, match="known are 'gripper'"):
            declare(store, arm.configuration.inspection, InspectedRequest(item="griper", by="Ada", why="x"), NOW)
        with pytest.raises(BadInput, match="yet to come"):
            declare(store, arm.configuration.inspection, InspectedRequest(item="gripper", by="Ada", why="x", at="2030-01-01"), NOW)


def test_the_manufacturers_checks_are_named_with_their_source_and_an_item_replaces_an_interval():
    """The shortest timeframe of the manual stands for all; one's own reading of it replaces it, and further checks follow."""
    own = (InspectionItem(name="flat rings", every_days=182.0), InspectionItem(name="robot cable", last_done="2024-01-01"))
    checks = InspectionSettings(plan="universal-robots", items=(*own, InspectionItem(name="jaws", every_hours=9.0))).checks
    by_name = {item.name: item for item in checks}
    assert [item.name for item in checks] == [item.name for item in PLANS["universal-robots"].items] + ["jaws"]
    assert (by_name["flat rings"].every_days, by_name["robot cable"].every_days, by_name["blue lids"].every_days) == (182.0, 30.0, 30.0)
    assert by_name["robot cable"].last_done == "2024-01-01"


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"plan": "kuka"}, "inspection.plan = 'kuka'; expected 'universal-robots'"),
        ({"items": [{"name": "a"}]}, "'a' has no interval"),
        ({"items": [{"name": "a", "every_days": 1.0}, {"name": "a", "every_days": 2.0}]}, "comes twice"),
        ({"items": [{"name": "a", "every_day": 1.0}]}, "inspection.items.0.every_day: unknown key (did you mean every_days?)"),
        ({"items": [{"name": "a", "every_days": -1.0}]}, "inspection.items.0.every_days = -1.0"),
        ({"items": [{"every_days": 1.0}]}, "inspection.items.name: missing"),
        ({"items": [{"name": "a", "every_days": 1.0, "last_done": "soon"}]}, "expected a date"),
        ({"items": "flat rings"}, "inspection.items"),
    ],
)
def test_a_mistake_in_a_check_is_named(tmp_path, table, said):
    """With its key, and what would be right."""
    with pytest.raises(BadConfiguration) as refused:
        configuration(tmp_path, **table)
    assert said in str(refused.value).replace("items.0.name", "items.name")


def test_the_document_fits_its_schema_and_stands_in_status_report_and_metrics(watched):
    """English and German; OpenMetrics' own parser reads counters and gauges."""
    watched.hear(state(0.0), state(1.0, speed=1.0), state(1.1, safety=3))
    watched.duty.step()
    watched.store.duties.stop_explained(1, 3, "C153A2")
    settings = watched.configuration.inspection
    declare(watched.store, settings, InspectedRequest(item="flat rings", by="Ada", why="as new", at="2024-10-01"), watched.clock)
    found = watched.document()
    jsonschema.validate(found, schema("inspection"), format_checker=jsonschema.FormatChecker())
    lines = "\n".join(inspection_lines(found))
    assert "operating hours 1000.0 h" in lines
    assert "protective stop: Elbow (joint 3), C153A2, it stands" in lines
    assert "check flat rings: due 2024-10-31; last done 2024-10-01 by Ada" in lines
    assert "check blue lids: due, nobody has recorded when it was done last" in lines
    page = "".join(inspection({"inspection": {**found, "stops_period": 1}}, language("de")))
    for text in ("Prüfpflichten", "Flachringe", "nie eingetragen", "Ellbogen", "C153A2", "Schutzstopp"):
        assert text in page, text
    registry = CollectorRegistry()
    registry.register(Families(lambda: families(last_values({"info": {"robot": ROBOT, "version": "1"}, "inspection": found}))))
    samples = {
        (sample.name, sample.labels.get("item", sample.labels.get("joint", ""))): sample.value
        for family in text_string_to_metric_families(generate_latest(registry).decode())
        for sample in family.samples
    }
    assert samples["joint_monitor_operating_seconds_total", ""] == pytest.approx(3600.0 * 1000.0 + 1.1)
    assert samples["joint_monitor_safety_stops_total", ""] == 1.0
    assert samples["joint_monitor_safety_stops_kept", "3"] == 1.0
    assert samples["joint_monitor_inspection_due", "flat rings"] == 0.0
    assert samples["joint_monitor_inspection_due", "blue lids"] == 1.0
    assert samples["joint_monitor_inspection_due_timestamp_seconds", "flat rings"] == pytest.approx(20_027 * DAY_S)
    watched.clock += 60.0
    declare(watched.store, settings, InspectedRequest(item="robot cable", by="Ada", why="as new"), watched.clock)
    since = {item["name"]: item["stops_since"] for item in watched.document()["items"]}
    assert (since["flat rings"], since["robot cable"], since["blue lids"]) == (1, 0, 1), "before a check, after it, and with none"


def test_a_check_is_recorded_without_a_daemon_and_status_tells_it(tmp_path):
    """By the command line alone, on a history that has seen no replay."""
    with Store.open(tmp_path / "history"):
        pass
    text = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:9"]\n'
    (tmp_path / "cell.toml").write_text(f'{text}[[inspection.items]]\nname = "flat rings"\nevery_days = 182.0\n')

    def run(*arguments: str):
        return CliRunner().invoke(app, [*arguments, "--config", str(tmp_path / "cell.toml")])

    done = run("inspected", "flat rings", "--by", "Ada", "--why", "as new")
    assert done.exit_code == 0
    assert done.output.startswith("cell-1: flat rings: due 20")
    shown = json.loads(run("status", "--json").output)["inspection"]
    assert [(item["name"], item["state"], item["last_by"]) for item in shown["items"]] == [("flat rings", "done", "Ada")]
    assert "check flat rings: due" in run("status").output
    taken = run("inspected", "flat rings", "--by", "Ada", "--why", "typed wrongly", "--undo")
    assert taken.output == "cell-1: taken back: flat rings: due, nobody has recorded when it was done last.\n"
    wrong = run("inspected", "blue lids", "--by", "Ada", "--why", "x")
    assert "known are 'flat rings'" in str(wrong.exception)


def error(code: int, argument: int, level: int = 3) -> bytes:
    """A robot message as the manufacturer's guide lays it out: type 20, an error code of its own kind 6."""
    payload = struct.pack(">QbB", 1, 7, 6) + struct.pack(">iiiII", code, argument, level, 0, 0) + b"text"
    return struct.pack(">iB", len(payload) + 5, 20) + payload


@pytest.mark.parametrize(
    ("message", "found"),
    [
        (error(153, 2), ("C153A2", 3)), (error(153, 6), ("C153A6", None)), (error(209, 0, 2), ("C209A0", None)), (error(153, 2, 1), None),
        (error(153, 2)[:20], None), (bytes(5) + struct.pack(">QbB", 1, 7, 5) + bytes(40), None),
    ],
)  # fmt: skip
def test_an_error_names_its_joint_where_its_code_does(message, found):
    """Position deviates from path, a stop that a program asked for, an information, a torn message, another kind."""
    assert reported_error(message[5:]) == found


def mode(safety: int) -> bytes:
    """A robot message of the kind 5: the safety mode has changed."""
    payload = struct.pack(">QbB", 1, 7, 5) + struct.pack(">iiBII", 0, 0, safety, 0, 0)
    return struct.pack(">iB", len(payload) + 5, 20) + payload


def test_a_change_of_the_safety_mode_is_read_as_the_simulated_controller_says_it():
    """And as the manufacturer's guide lays it out; a torn message, and one of another kind, are none."""
    assert reported_mode(mode(3)[5:]) == ReportedMode(3)
    assert reported_mode(encoded(SafetyMessage(0.0, SafetyMode.PROTECTIVE_STOP))[5:]) == ReportedMode(3)
    assert [reported_mode(message) for message in (mode(3)[5:16], error(153, 2)[5:], b"")] == [None, None, None]


def test_stops_that_are_reset_within_milliseconds_count_where_the_controller_reports_them(watched):
    """Each one in the rows stands for one that is reported, whichever comes first; those that no row shows count as short stops."""
    stop, normal = ReportedMode(3), ReportedMode(1)

    def passes(seconds, *reported):
        watched.clock += seconds
        watched.duty.hear(reported)

    watched.hear(state(0.0))
    passes(1.0, stop, normal, stop, stop, normal)  # two, of which no row shows any
    passes(0.1, ReportedError("C153A2", 3), stop, normal, stop)  # two more; the last one stands
    watched.hear(state(1.1, safety=3))
    assert watched.document()["stops"] == 1
    passes(3.0)
    assert watched.document()["stops"] == 4
    passes(0.1, normal)
    watched.hear(state(4.2), state(4.3, safety=8), state(4.4))  # a violation, which is reported a moment later
    passes(0.2, ReportedMode(8), normal)
    passes(600.0, stop)  # nobody hears rows for ten minutes
    passes(600.0)
    assert watched.document()["stops"] == 5
    watched.hear(state(1200.0, safety=3))
    passes(1.0, normal)
    watched.hear(state(1201.0))
    passes(10.0)
    stops = watched.store.duties.stops()
    assert [each.kind for each in stops] == ["protective_stop"] * 4 + ["violation", "protective_stop"]
    assert all(each.ended_at_unix_s is not None for each in stops)
    watched.duty = watched.started()
    watched.hear(state(1300.0, safety=3))
    passes(3.0)
    assert watched.document()["stops"] == 7


def test_a_short_stop_does_not_end_the_count_of_one_that_stands_over_a_restart(watched):
    """The pause between the two was too short for the rows."""
    watched.hear(state(0.0), state(0.1, safety=3))
    watched.duty.hear([ReportedMode(3), ReportedMode(1), ReportedMode(3)])
    watched.clock += 5.0
    watched.duty.hear([])
    watched.duty = watched.started()
    watched.hear(state(9.0, safety=3))
    assert watched.document()["stops"] == 2


def test_errors_come_over_the_primary_port_and_again_after_it_was_lost():
    """A real socket: states between the messages, a message in two pieces, no answer, another protocol."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(30.0)
        link = ReportedErrors("127.0.0.1", server.getsockname()[1])
        found: list = []

        def until(done):
            deadline = time.monotonic() + 30.0
            while not done() and time.monotonic() < deadline:
                link._next_try_at = 0.0
                found.extend(link.poll())
                time.sleep(0.005)
            assert done()

        link.poll()
        controller, _ = server.accept()
        message = error(153, 4)
        controller.sendall(struct.pack(">iB", 1005, 16) + bytes(1000) + message[:9])
        controller.sendall(message[9:] + error(209, 0, 2))
        until(lambda: found == [("C153A4", 5), ("C209A0", None)])
        controller.close()
        until(lambda: link._link is None)
        link._next_try_at = 0.0
        link.poll()
        controller, _ = server.accept()
        controller.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        until(lambda: link._link is None)
        link._next_try_at = 0.0
        link.poll()
        server.accept()
        assert link._link is not None
        link._heard_at -= 60.0  # a cut cable says nothing
        link.poll()
        assert link._link is None
        link.close()
        controller.close()


def test_a_controllers_name_is_looked_up_beside_the_main_loop(monkeypatch):
    """A name server that does not answer ends nothing; the next try asks again."""
    answers: queue.Queue = queue.Queue()

    def asked(name: str) -> str:
        assert name == "arm.invalid"
        answer = answers.get(timeout=30.0)
        if isinstance(answer, OSError):
            raise answer
        return answer

    monkeypatch.setattr(socket, "gethostbyname", asked)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(30.0)
        link = ReportedErrors("arm.invalid", server.getsockname()[1])

        def until(done):
            deadline = time.monotonic() + 30.0
            while not done() and time.monotonic() < deadline:
                assert link.poll() == []
                time.sleep(0.005)
            assert done()

        assert link.poll() == []  # nobody has answered yet
        answers.put(socket.gaierror(socket.EAI_AGAIN, "no answer"))
        until(lambda: link._next_try_at > 0.0)
        assert link._link is None
        link._next_try_at = 0.0
        answers.put("127.0.0.1")
        until(lambda: link._link is not None and link._link.stands)
        server.accept()
        link.close()


def test_a_stop_and_the_error_beside_it_are_one_whichever_comes_first(watched):
    """Within two seconds; an error of long before tells nothing of it."""
    watched.hear(state(0.0), state(0.1, safety=3))
    watched.duty.hear([ReportedError("C100A0", None), ReportedError("C153A2", 3)])
    watched.hear(state(0.2))
    watched.clock += 60.0
    watched.duty.hear([ReportedError("C153A0", 1)])
    watched.clock += 1.0
    watched.hear(state(61.1, safety=3), state(61.2))
    watched.duty.hear([ReportedError("C153A5", 6)])
    watched.clock += 10.0
    watched.hear(state(71.0, safety=3))
    assert [(stop["code"], stop["joint"]) for stop in watched.document()["last_stops"]] == [(None, None), ("C153A0", 1), ("C153A2", 3)]
    assert watched.document()["stops_by_joint"] == [{"joint": 1, "stops": 1}, {"joint": 3, "stops": 1}]
