"""Backups keep what no arm knows; what the arms know comes back from them."""

import sqlite3
import time
from contextlib import closing

import pytest
import sqlalchemy as sa
from heard_documents import whole
from simulated import Way, copied, cursors
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadInput
from monitor.plant.backup import back_up, rebuild, restore
from monitor.plant.database import Database
from monitor.plant.ingest import RUNNING, add_audit, keep_last_values, known, set_note
from monitor.plant.pull import pull
from monitor.plant.tables import audit
from monitor.studies.plant import Lives, PlantOnBus

BEGIN_UNIX_S = 1_767_571_200.0
NAME = ("joint-monitor/v1/lab/cell-1", "lab", "cell-1")


class Answers(PlantOnBus):
    """The answers of one simulated arm, without a bus."""

    def __init__(self, lives):
        self.lives = lives

    def history_id(self, arm):
        return "one"


@pytest.fixture(scope="module")
def lives():
    made = Lives(1, 5, BEGIN_UNIX_S)
    made.live(40)
    return made


@pytest.fixture
def way(lives):
    answers = Answers(lives)
    return Way({"history": lambda given: answers._history(0, given), "event": lambda given: answers._events(0, given)})


def audited(database):
    with database.read() as connection:
        return connection.execute(sa.select(audit.c.who, audit.c.act).order_by(audit.c.id)).all()


def filled(database, way):
    pull(database, way, *NAME, lambda: 5.0)
    with database.write() as connection:
        add_audit(connection, 6.0, "ada", "acknowledge", "lab/cell-1", "seen")
    number = known(database, "lab", "cell-1", 7.0).arm
    keep_last_values(database, {(number, "health"): (7.0, whole("health", why="ö"))})
    return copied(database), cursors(database)


def test_a_backup_of_either_database_is_restored_into_the_other(address, postgres, way, tmp_path, lives):
    """Rows, cursors, last values and audit; the copying goes on from there, and numbers go on as well."""
    first = Database(address)
    first.migrate()
    before = filled(first, way)
    assert len(before[0]["lab/cell-1"][1]) == 6 * len(lives.replays[0]) > 200
    assert back_up(first, tmp_path / "backup") > 200
    other = Database(f"sqlite:///{tmp_path / 'other.sqlite'}" if first.postgresql else postgres.address())
    other.migrate()
    restore(other, tmp_path / "backup", force=False, who="ada")
    assert (copied(other), cursors(other)) == before
    assert audited(other) == [("ada", "acknowledge"), ("ada", "restore")]
    way.asked.clear()
    pull(other, way, *NAME, lambda: 5.0)
    assert (copied(other), cursors(other)) == before
    known(other, "lab", "cell-2", 9.0)  # a new arm gets a number of its own
    assert len(copied(other)) == 2
    first.close()
    other.close()


def test_a_database_that_is_not_empty_is_replaced_only_by_force_and_its_audit_stays(database, way, tmp_path):
    """Nothing is overwritten silently, and who acted is never forgotten."""
    filled(database, way)
    back_up(database, tmp_path / "backup")
    with database.write() as connection:
        add_audit(connection, 8.0, "bob", "shelve", "lab/cell-1", "later")
    with pytest.raises(BadInput, match="is not empty"):
        restore(database, tmp_path / "backup", force=False, who="ada")
    restore(database, tmp_path / "backup", force=True, who="ada")
    assert audited(database) == [("ada", "acknowledge"), ("bob", "shelve"), ("ada", "restore")]
    (tmp_path / "no").write_text("nothing")
    with pytest.raises(BadInput, match="no backup of a plant"):
        restore(database, tmp_path / "no", force=True, who="ada")


def test_a_rebuilt_database_is_the_same_again(database, way):
    """From the arm's own history; the audit stays, and says who asked for it."""
    before = filled(database, way)
    assert rebuild(database, who="ada") == 1
    assert copied(database) == {}
    pull(database, way, *NAME, lambda: 5.0)
    assert copied(database) == before[0]
    assert audited(database) == [("ada", "acknowledge"), ("ada", "rebuild")]


def test_a_backup_may_have_any_name(tmp_path):
    """What ends an address or means a sign in it is a sign of a file's name."""
    database = Database(f"sqlite:///{tmp_path / 'plant.sqlite'}")
    database.migrate()
    with database.write() as connection:
        add_audit(connection, 1.0, "ada", "acknowledge", None, "seen")
    rows = back_up(database, tmp_path / "Monday? 50 %25 #1")
    assert (rows, restore(database, tmp_path / "Monday? 50 %25 #1", force=True, who="bo")) == (1, 0)  # the audit holds that line
    database.close()


def test_a_backup_that_is_damaged_or_another_programs_changes_nothing(database, way, tmp_path):
    """Cut short by a full disk, with a page of zeros, empty, or an arm's own history: nothing is taken away for half of it."""
    before = filled(database, way)
    back_up(database, tmp_path / "whole")
    whole = (tmp_path / "whole").read_bytes()
    (tmp_path / "cut").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "hole").write_bytes(whole[:8192] + bytes(8192) + whole[16384:])
    with closing(sqlite3.connect(tmp_path / "other")) as other:
        other.execute("CREATE TABLE customer (id)")
    (tmp_path / "empty").write_bytes(b"")
    for name, says in (("cut", "is damaged"), ("hole", "is damaged"), ("other", "of another program"), ("empty", "no backup of a plant")):
        with pytest.raises(BadInput, match=says) as error:
            restore(database, tmp_path / name, force=True, who="ada")
        assert str(tmp_path / name) in str(error.value)
    assert (copied(database), cursors(database)) == before


def test_lines_of_the_audit_that_only_the_backup_has_come_back_at_their_time(database, tmp_path):
    """What was done since then still stands last."""
    for at, who in ((1.0, "ada"), (3.0, "bo")):
        with database.write() as connection:
            add_audit(connection, at, who, "ack", None, "seen")
    back_up(database, tmp_path / "backup")
    with database.write() as connection:
        connection.execute(sa.delete(audit).where(audit.c.who == "ada"))
        add_audit(connection, 4.0, "eve", "ack", None, "seen")
    restore(database, tmp_path / "backup", force=True, who="root")
    assert [who for who, _ in audited(database)] == ["ada", "bo", "eve", "root"]


def test_the_commands_say_what_they_did(tmp_path, way):
    """status before and after, backup, restore and rebuild, with the exit codes of every command."""
    (tmp_path / "plant.toml").write_text("")
    config = ["--config", str(tmp_path / "plant.toml")]

    def asked(*words, code=0):
        result = CliRunner().invoke(app, ["plant", *words, *config])
        assert result.exit_code == code, result.output
        return result.output + str(result.exception or "")

    assert "no database yet" in asked("status", code=1)
    database = Database(f"sqlite:///{tmp_path}/var/joint-monitor-plant/plant.sqlite")
    database.migrate()
    filled(database, way)
    stopped = "NOT FOLLOWED: the plant has never run with this database"
    assert asked("status").splitlines()[:2] == [stopped, "1 arms: 0 sick, 0 unseen, 0 doubtful, 1 well"]
    set_note(database, RUNNING, time.time(), {"ways": {"tcp/a:1": False}})
    assert "no answer from tcp/a:1" in asked("status")
    assert '"grade": "well"' in asked("status", "--json")
    assert "rows" in asked("backup", str(tmp_path / "backup"))
    assert "exists; nothing was done" in asked("backup", str(tmp_path / "backup"), code=1)
    assert "is not empty" in asked("restore", str(tmp_path / "backup"), code=1)
    assert "are restored" in asked("restore", str(tmp_path / "backup"), "--force")
    assert "--force does it" in asked("rebuild", code=1)
    assert "no arm of this plant" in asked("forget", "lab/cell-9", "--force", code=1)
    assert "everything that was copied of lab/cell-1; nothing was done" in asked("forget", "lab/cell-1", code=1)
    assert "Missing argument .SITE/ROBOT" in asked("forget", code=2).replace("'", ".")
    assert "forgotten: lab/cell-1" in asked("forget", "lab/cell-1", "--force")
    assert "\n0 arms" in "\n" + asked("status", "--all")
    assert "0 arms" in asked("rebuild", "--force")
    database.close()
    with closing(sqlite3.connect(tmp_path / "backup")) as backup:
        assert backup.execute("SELECT count(*) FROM arm").fetchone() == (1,)
