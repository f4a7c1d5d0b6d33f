"""What a plant has copied teaches as much as the arms' own folders: the same bits, whichever database."""

import json
import sqlite3
from datetime import UTC, datetime
from types import SimpleNamespace

import pyarrow
import pytest
import sqlalchemy as sa
from command_line import ended, printed
from lived_monitor import configuration, identified, live_through
from pyarrow import parquet
from simulated import Way, copy, plant_file, refusing
from sqlalchemy.dialects import postgresql

from monitor.errors import DOES_NOT_HOLD
from monitor.plant.daily import prune
from monitor.plant.pull import pull
from monitor.recording import DAY_S
from monitor.service.handlers import Handlers
from monitor.store.archive.archive import Archive, key_of
from monitor.store.archive.places import ArchiveSettings
from monitor.store.store import Store
from monitor.store.stored import COPIED, keep_log
from monitor.studies.from_plant import arms_of_plant, history_of, rows_of
from monitor.studies.query import TABLES, ArmSource, PlantSource, ask

NAMES = ("north/press", "south/saw")


def tables(path):
    """All rows of the tables that are copied, and friction; of the notes the archive's alone."""
    with sqlite3.connect(path) as connection:
        found = {name: connection.execute(f"SELECT * FROM {name} ORDER BY 1, 2").fetchall() for name in (*COPIED, "friction")}
    found["note"] = [row for row in found["note"] if row[0] == "archive"]
    found["friction"] = [(*row[:3], json.loads(row[3])) for row in found["friction"]]
    found["event"] = [row[:4] for row in found["event"]]
    return found


@pytest.fixture
def folder(tmp_path):
    """Two arms of 46 days; a third one that nothing was learnt of."""
    settings = configuration(tmp_path).assess
    for seed, name in enumerate(NAMES):
        with Store.open(tmp_path / "arms" / name) as store:
            live_through(store, settings, *identified(), 46, seed=seed)
    with Store.open(tmp_path / "arms" / "south" / "torch"):
        pass
    return tmp_path / "arms"


def test_a_prior_of_the_plant_is_that_of_the_folders(folder, database, address, tmp_path):
    """The same document, but for the names of the arms; an arm that nothing was learnt of is named."""
    copy(database, folder, (*NAMES, "south/torch"))
    of_folders = json.loads(printed("prior", folder / "north", folder / "south", "--json"))
    of_plant = json.loads(printed("prior", "--plant", plant_file(tmp_path, address), "--json"))
    named = [f"{folder}/{said}" for said in of_plant["learnt_from"].pop("left_out")]
    assert named == of_folders["learnt_from"].pop("left_out") == [f"{folder}/south/torch: nothing was assessed yet"]
    assert of_plant.pop("made_at") >= of_folders.pop("made_at")
    assert of_plant == of_folders
    both = ended("prior", folder, "--plant", tmp_path / "plant.toml")
    assert (both.returncode, "either folders of histories, or --plant FILE" in both.stderr) == (2, True)


def test_a_question_to_the_plant_has_the_answer_of_the_folders(folder, database, address, tmp_path, monkeypatch):
    """Row by row, in all views; the samples of a recording come from the archive. A number that two arms have needs the arm's name."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    content = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table({"timestamp": [0.0, 0.1], "actual_q_0": [1.0, 2.0]}), content)
    content = content.getvalue().to_pybytes()
    archive = Archive.open(ArchiveSettings(address=str(tmp_path / "archive")))
    (tmp_path / "archive").mkdir()
    for name in NAMES:
        with Store.open(folder / name) as store:
            at = store.assessments.judged()[6].recorded_at_unix_s
            store.archived.note_place(archive.settings)
            store.archived.add(7, archive.put(content, key_of(*name.split("/"), at, 7, content)), at)
            address_of_7 = store.archived.of(7).address
            reason = DOES_NOT_HOLD(condition="permit", why="the cell's door is open")
            store.ledger.end(store.ledger.claim(5e9, "requested", 5e9), "skipped", reason, 5e9)
    copy(database, folder, NAMES)
    plant_file(tmp_path, address)
    of_folders = [ArmSource(folder / name, *name.split("/")) for name in NAMES]
    for view, columns in TABLES.items():
        named = ", ".join(name for name in columns if name not in ("history", "is_here"))
        asked = f"SELECT {named} FROM {view} ORDER BY ALL"
        expected = ask(asked, of_folders, 10_000)
        assert len(expected.rows) >= {"friction": 500, "events": 4, "ledger": 94, "recordings": 88}[view]
        assert ask(asked, [PlantSource(database)], 10_000) == expected
    for asked in (
        "SELECT robot, max(wear) - min(wear) AS rise FROM friction WHERE joint = 3 GROUP BY ALL ORDER BY ALL",
        "SELECT replay, wear FROM friction WHERE recorded_at > (SELECT max(recorded_at) FROM friction) - INTERVAL 3 DAY ORDER BY ALL",
        "SELECT count(*) FROM friction WHERE recorded_at < now() AND wear IS NOT NULL",
        "SELECT f.robot, f.joint, e.tier, f.p50_days FROM friction f JOIN events e USING (robot, replay, joint) ORDER BY ALL",
        "FROM (PIVOT friction ON joint USING max(wear) GROUP BY robot) ORDER BY robot",
        "PIVOT friction ON joint USING max(reference_torque_nm) GROUP BY robot ORDER BY robot",
        "SELECT robot, wear FROM friction QUALIFY rank() OVER (PARTITION BY robot ORDER BY replay DESC, joint) = 1 ORDER BY 1",
        "WITH a AS (SELECT robot, COLUMNS('wear.*') FROM friction) SELECT robot, sum(wear_std) > 0 FROM a GROUP BY 1 ORDER BY 1",
        "SELECT f.wear FROM friction f WHERE EXISTS (FROM ledger l WHERE l.replay = f.replay AND l.state = 'assessed') ORDER BY 1 LIMIT 9",
        "DESCRIBE friction",
    ):
        assert ask(asked, [PlantSource(database)], 100) == ask(asked, of_folders, 100), asked
    for which in ("'north/press/7'", "'press/7'", f"'{address_of_7}'"):
        found = json.loads(
            printed("query", "--plant", tmp_path / "plant.toml", f"SELECT sum(actual_q_0) AS s FROM replay({which})", "--json")
        )
        assert found["rows"] == [{"s": 3.0}]
    for which, says in (("7", "2 arms have one of this number"), ("'press/8'", "there is no recording")):
        wrong = ended("query", "--plant", tmp_path / "plant.toml", f"FROM replay({which})")
        assert (wrong.returncode, says in wrong.stderr, "Traceback" in wrong.stderr) == (2, True, False)


def test_a_question_of_a_month_reads_that_month_alone(folder, database, address, tmp_path):
    """By --from and --to, in every view; on a server only the partition of that month stands in the plan."""
    copy(database, folder, NAMES)
    source = PlantSource(database, *(datetime(2026, month, 1, tzinfo=UTC).timestamp() for month in (7, 8)))
    found = ask("SELECT count(*), min(recorded_at), max(recorded_at) FROM friction", [source], 1).rows
    within = "FROM friction WHERE recorded_at >= '2026-07-01' AND recorded_at < '2026-08-01'"
    assert found == ask(f"SELECT count(*), min(recorded_at), max(recorded_at) {within}", [PlantSource(database)], 1).rows
    assert 0 < found[0][0] < ask("SELECT count(*) FROM friction", [PlantSource(database)], 1).rows[0][0]
    if database.postgresql:
        asked = source.friction(("robot", "wear")).compile(dialect=postgresql.dialect(), compile_kwargs={"literal_binds": True})
        with database.read() as connection:
            plan = " ".join(connection.execute(sa.text(f"EXPLAIN {asked}".replace(":", r"\:"))).scalars())
        assert ("friction_2026_07" in plan, "friction_2026_06" in plan, "friction_other" in plan) == (True, False, False)
    command = ("query", "--plant", plant_file(tmp_path, address), "SELECT count(*) AS n FROM ledger", "--from", "2026-07-01", "--json")
    assert 0 < json.loads(printed(*command))["rows"][0]["n"] < 94
    wrong = ended("query", "--history", folder, "SELECT 1", "--to", "2026-07-01")
    assert (wrong.returncode, "--from and --to are for --plant" in wrong.stderr) == (2, True)


def test_a_copied_history_is_made_anew_to_the_last_bit(folder, database, tmp_path):
    """Of everything that a verdict follows from; also what changes and goes after it was copied once."""
    copy(database, folder, NAMES)
    with Store.open(folder / "north" / "press") as store:
        store.assessments.roll_back(store.assessments.judged()[-3].recorded_at_unix_s, None)
        store.notes.set("archive", json.dumps({"address": "s3://bucket/arms"}))
        store.notes.set("arm_serial", "of no copy")
    copy(database, folder, NAMES)
    copy(database, folder, NAMES)
    for arm in arms_of_plant(database):
        with history_of(database, arm) as made:
            own = tables(folder / arm.name / "history.sqlite")
            assert tables(made.folder / "history.sqlite") == own
            assert len(own["assessment"]) > 30
            with history_of(database, arm) as again:
                assert again.digest == made.digest


def test_identified_parts_go_after_their_time_and_everything_else_stays(folder, database):
    """Of one arm by its own replays' times; a second call finds nothing more, and a limit of 0 takes nothing away."""
    with Store.open(folder / "north" / "press") as store, store.database.transaction() as writing:
        judged = store.assessments.judged()
        writing.executemany("INSERT INTO identified VALUES (?, x'00')", [(each.ledger_id,) for each in judged])
    copy(database, folder, NAMES)
    press = arms_of_plant(database)[0]
    before = {table: len(rows_of(database, press, table)) for table in COPIED}
    now = judged[-1].recorded_at_unix_s + 3600.0
    assert prune(database, 0.0, now) == 0
    old = [each for each in judged if each.recorded_at_unix_s < now - 30 * DAY_S]
    assert 10 < len(old) < len(judged)
    assert (prune(database, 30.0, now), prune(database, 30.0, now)) == (len(old), 0)
    after = {table: len(rows_of(database, press, table)) for table in COPIED}
    assert after == before | {"identified": len(judged) - len(old)}


def test_an_arm_of_an_earlier_release_is_named_and_the_others_teach(folder, database, address, tmp_path):
    """Its monitor refuses the question: its rows are missing, and it is followed as before."""
    copy(database, folder, ("north/press",))
    with Store.open(folder / "south" / "saw") as store:
        handlers = Handlers(SimpleNamespace(robot=SimpleNamespace(joints=6), store=store), None)

        def history(parameters):
            return (
                refusing("history: unknown parameter 'stored_after'")(parameters)
                if "stored_after" in parameters
                else handlers.history(parameters)
            )

        assert pull(
            database, Way({"history": history, "event": handlers.events}), "joint-monitor/v1/x", "south", "saw", lambda: 5.0
        ).change.seq
    said = printed("prior", "--plant", plant_file(tmp_path, address))
    assert "ur5: 1 arm" in said
    assert "south/saw: the rows of its history are not copied: its monitor is of an earlier release" in said


def test_a_plant_of_which_no_arm_teaches_says_why(folder, database, address, tmp_path):
    """The arms that say nothing are named with the reason, as of `simulate-plant`: no history of them is counted as empty."""
    with Store.open(folder / "south" / "saw") as store:
        handlers = Handlers(SimpleNamespace(robot=SimpleNamespace(joints=6), store=store), None)

        def history(parameters):
            return refusing("history: unknown parameter")(parameters) if "stored_after" in parameters else handlers.history(parameters)

        pull(database, Way({"history": history, "event": handlers.events}), "joint-monitor/v1/x", "south", "saw", lambda: 5.0)
    refused = ended("prior", "--plant", plant_file(tmp_path, address))
    assert refused.returncode == 2
    assert "1 says nothing, the first one: south/saw: the rows of its history are not copied" in refused.stderr
    refused = ended("reassess", "--plant", tmp_path / "plant.toml", "--results", tmp_path / "results")
    assert refused.returncode == 2
    assert "no replay was judged yet of what the plant has; 1 of 1 arms hand over nothing that they judged" in refused.stderr


def test_a_history_that_an_earlier_release_began_is_copied_whole(folder, database):
    """The first start of this one gives it the log, with every row that there is."""
    path = folder / "north" / "press" / "history.sqlite"
    with sqlite3.connect(path) as connection:
        for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'trigger' AND name LIKE '%_stored_%'").fetchall():
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute("DROP TABLE stored")
        connection.execute("DROP TABLE identified")
    with Store.reader(path.parent) as store:
        assert store.assessments.identified(1) is None
    copy(database, folder, ("north/press",))
    with history_of(database, arms_of_plant(database)[0]) as made:
        assert tables(made.folder / "history.sqlite") == tables(path)
    with sqlite3.connect(path) as connection:
        before = connection.execute("SELECT count(*) FROM stored").fetchone()
        keep_log(connection)
        assert connection.execute("SELECT count(*) FROM stored").fetchone() == before
