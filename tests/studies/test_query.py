"""Questions in SQL: of one history, of many, of a plant's database and of an archive, beside whoever writes them."""

import csv
import io
import json
import os
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest
from command_line import ended
from test_archive import configuration, drained, rejected, uploads_of
from test_store import DAY, commit, replayed

from monitor.errors import BadInput, StoreError
from monitor.plant.database import Database
from monitor.store.store import Store
from monitor.studies.query import FIGURES, LIFE, TABLES, ArchiveSource, ArmSource, PlantSource, ask, plain, sources_at, unique

duckdb = pytest.importorskip("duckdb", reason="DuckDB is absent: it is of the extra `archive`")
ROOT = Path(__file__).parents[2]


def friction(wear: float, **changes: object) -> dict[str, object]:
    life = {"trend_probability": 0.5, "p10_days": 10.0, "p50_days": None, "p90_days": 30.0}
    return dict.fromkeys(FIGURES) | {"wear": wear, "coulomb_nm": 8.0, "remaining_life": life} | changes


def lived(folder: Path, replays: int = 3, joints: int = 2, begin: float = 0.0) -> Path:
    """A history whose friction and events are what this function says."""
    event = {"kind": "raised", "joint": 2, "condition": "wear_rising", "tier": "advisory", "text": "Joint 2's friction rises."}
    with Store.open(folder) as store:
        for n in range(replays):
            commit(
                store,
                replayed(store, begin + n * DAY),
                recorded_at_unix_s=begin + n * DAY,
                friction=[friction(0.01 * n + joint) for joint in range(joints)],
                events=[event] if n == 1 else [],
            )
    return folder


def answer(sql: str, *sources: object, limit: int = 1000) -> list[tuple[object, ...]]:
    return ask(sql, list(sources), limit).rows


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> ArmSource:
    return ArmSource(lived(tmp_path_factory.mktemp("arm") / "cell-1"), "lab", "cell-1")


def test_the_views_hold_what_the_history_holds(arm: ArmSource):
    """Row by row, as SQLite gives them without our code."""
    with closing(sqlite3.connect(arm.directory / "history.sqlite")) as history:
        rows = history.execute("SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction ORDER BY 1, 2").fetchall()
    expected = [
        ("lab", "cell-1", replay, joint, at, *(json.loads(text)[name] for name in FIGURES), *json.loads(text)["remaining_life"].values())
        for replay, joint, at, text in rows
    ]
    names = ", ".join((*FIGURES, *LIFE))
    found = answer(f"SELECT site, robot, replay, joint, epoch(recorded_at), {names} FROM friction ORDER BY replay, joint", arm)
    assert found == expected
    assert answer("SELECT count(*), max(history) FROM friction", arm) == [(6, 0)]
    assert answer("SELECT joint, condition, tier, document->>'kind' FROM events WHERE kind = 'raised'", arm) == [
        (2, "wear_rising", "advisory", "raised")
    ]
    assert answer("SELECT state, count(*), min(epoch(window_at)) FROM ledger GROUP BY state", arm) == [("assessed", 3, 0.0)]
    assert answer("SELECT replay, year, is_here, address, file FROM recordings ORDER BY replay LIMIT 1", arm) == [
        (1, 1970, True, None, "replay-000001.parquet")
    ]


@pytest.mark.parametrize(
    "sql",
    [
        "COPY (SELECT 1) TO 'out.csv'",
        "COPY friction TO 'out.parquet'",
        "EXPORT DATABASE 'out'",
        "ATTACH 'out.db'",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "CREATE TABLE mine AS SELECT 1",
        "DROP VIEW friction",
        "DELETE FROM read.friction",
        "PRAGMA database_list",
        "SELECT 1; SELECT 2",
        "",
        "-- nothing",
        "SELECT * FROM read_csv('history.toml')",
        "SELECT * FROM 'history.toml'",
        "SELECT content FROM read_text('history.toml')",
        "SELECT * FROM glob('*')",
        "SELECT * FROM query('COPY (SELECT 1) TO ''out.csv''')",
        "SELECT * FROM sources",
        "SELECT * FROM replay(99)",
        "SELECT * FROM replay('history.toml')",
        "SELECT torque FROM friction",
        "SELCT 1",
    ],
)
def test_what_is_no_question_is_refused_and_nothing_is_read_or_written(arm: ArmSource, tmp_path: Path, monkeypatch, sql: str):
    """Neither files of this machine nor extensions of another, whatever the spelling."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "history.toml").write_text("secret,word\n1,2\n")
    with pytest.raises(BadInput, match=r"^query: ") as told:
        ask(sql, [arm], 10)
    assert "secret" not in str(told.value)
    assert [path.name for path in tmp_path.iterdir()] == ["history.toml"]


@pytest.mark.parametrize("sql", ["DESCRIBE friction", "SUMMARIZE ledger", "EXPLAIN SELECT 1", "SHOW TABLES", "FROM ledger", "VALUES (1)"])
def test_what_explains_the_views_is_a_question(arm: ArmSource, sql: str):
    """Somebody who does not know the columns asks for them."""
    assert answer(sql, arm)


def test_a_pivot_and_a_join_of_the_views_are_questions(arm: ArmSource):
    """A view may stand twice in a question."""
    assert len(answer("PIVOT friction ON joint USING max(wear) GROUP BY replay", arm)) == 3
    later = "SELECT b.wear - a.wear FROM friction a JOIN friction b ON b.joint = a.joint AND b.replay = a.replay + 1 ORDER BY 1"
    assert [row[0] for row in answer(later, arm)] == pytest.approx([0.01] * 4)
    assert answer('SELECT count(*) FROM "friction" NATURAL JOIN LEDGER', arm) == [(6,)]


def test_a_daemon_that_writes_is_neither_waited_for_nor_held_up(tmp_path: Path):
    """While a transaction is open the question is answered, and the writer commits beside questions, without a lock."""
    arm = ArmSource(lived(tmp_path), "lab", "cell-1")
    with Store.open(tmp_path) as store:
        store.database.connection.execute("BEGIN IMMEDIATE")
        store.database.connection.execute("INSERT INTO note VALUES ('a', 'b')")
        assert answer("SELECT count(*) FROM friction", arm) == [(6,)]
        store.database.connection.execute("COMMIT")
        store.database.connection.execute("PRAGMA busy_timeout = 0")  # a writer that meets a lock fails at once
        done, counts = threading.Event(), []

        def asking() -> None:
            while not done.is_set() or not counts:
                counts.append(answer("SELECT count(*) FROM friction", arm)[0][0])

        thread = threading.Thread(target=asking)
        thread.start()
        try:
            for n in range(20):
                commit(store, replayed(store, (100 + n) * DAY), friction=[friction(0.0)])
        finally:
            done.set()
            thread.join(60.0)
        assert counts == sorted(counts)
        store.database.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        assert (tmp_path / "history.sqlite-wal").stat().st_size == 0  # nobody reads any more
    assert answer("SELECT count(*) FROM friction", arm) == [(26,)]


def test_many_histories_and_plants_are_found_below_a_folder(tmp_path: Path):
    """Each arm by the name of its folder. An empty folder, and a file that is something else, are told."""
    lived(tmp_path / "hall" / "cell-1")
    lived(tmp_path / "hall" / "cell-2", replays=1)
    sources = sources_at(tmp_path / "hall")
    assert answer("SELECT robot, site, count(*) FROM friction GROUP BY ALL ORDER BY robot", *sources) == [
        ("cell-1", "", 6), ("cell-2", "", 2),
    ]  # fmt: skip
    assert sources_at(tmp_path / "hall/cell-1/history.sqlite") == [sources[0]] == sources_at(tmp_path / "hall/cell-1")
    with pytest.raises(BadInput, match="2 arms have one of this number"):
        ask("FROM replay(1)", sources, 1)
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="holds neither"):
        sources_at(tmp_path / "empty")
    (tmp_path / "empty/other.sqlite").write_bytes(b"this is no database" * 100)
    with pytest.raises((BadInput, StoreError), match=r"SQLite|database"):
        sources_at(tmp_path / "empty/other.sqlite")


def test_recordings_of_an_archive_are_asked_with_and_without_their_history(tmp_path: Path, monkeypatch):
    """`replay` gives the samples of one that is only there."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "archive").mkdir()
    settings = configuration(tmp_path)
    with Store.open(tmp_path) as store:
        number = rejected(store, 1)
        rejected(store, 2)
        drained(uploads_of(store, settings)[0])
        store.recordings.path(number).unlink()
        address = store.archived.of(number).address
    arm, archive = ArmSource(tmp_path), ArchiveSource(settings.archive)
    here = "SELECT site, robot, replay, is_here, state FROM recordings ORDER BY replay"
    assert answer(here, arm) == [("lab", "cell-1", 1, False, "rejected"), ("lab", "cell-1", 2, True, "rejected")]
    assert answer(here, archive) == [("lab", "cell-1", 1, False, None), ("lab", "cell-1", 2, False, None)]
    for which in ("1", "'1'", "'cell-1/1'", "'lab/cell-1/1'", f"'{address}'"):
        assert answer(f"SELECT count(*), max(timestamp) FROM replay({which})", arm) == [(20, 1.9)]
    assert (
        answer(f"SELECT count(*) FROM replay('{address}')", archive)
        == [(20,)]
        == answer(f"SELECT count(*) FROM replay('{address}')", arm, archive)
    )
    both = "SELECT avg(a.actual_q_0 - b.actual_q_0) <> 0 FROM replay(1) a JOIN replay(2) b USING (timestamp)"
    assert answer(both, arm) == [(True,)]
    for which in ("'cell-2/1'", "'hall/cell-1/1'", f"'{tmp_path}/site=lab/x'"):
        with pytest.raises(BadInput, match="there is no recording"):
            ask(f"FROM replay({which})", [arm], 1)
    assert answer("SELECT count(*) FROM friction", archive) == [(0,)]
    everything = f"read_parquet('{tmp_path}/archive/**/*.parquet', hive_partitioning = true)"  # DuckDB alone, without our code
    assert duckdb.sql(f"SELECT site, robot, count(*) FROM {everything} GROUP BY ALL").fetchall() == [("lab", "cell-1", 40)]


def test_a_damaged_history_is_told_by_its_name(tmp_path: Path):
    """Also where the damage is in the midst of its rows. A plant's database likewise."""
    with Store.open(tmp_path) as store:
        rows = ((k, float(k), "x" * 200) for k in range(1, 400))
        store.database.connection.executemany("INSERT INTO ledger VALUES (?, ?, 'scheduled', 'rejected', 0.0, 1.0, ?, NULL, NULL)", rows)
    damage(tmp_path / "history.sqlite")
    with pytest.raises(StoreError, match=r"history\.sqlite: .*malformed"):
        answer("SELECT count(*) FROM ledger", ArmSource(tmp_path))
    with closing(sqlite3.connect(tmp_path / "plant.sqlite")) as plant:
        figures = ", ".join((*FIGURES, *LIFE))
        plant.executescript(
            f"CREATE TABLE arm (id, site, robot); CREATE TABLE friction (arm, history, replay, joint, recorded_at, {figures});"
            "INSERT INTO arm VALUES (1, 'hall', 'cell-1');"
        )
        rows = ((1, 1, k, 1, 1.0) for k in range(4000))
        plant.executemany("INSERT INTO friction (arm, history, replay, joint, recorded_at) VALUES (?, ?, ?, ?, ?)", rows)
        plant.commit()
    damage(tmp_path / "plant.sqlite")
    with pytest.raises(StoreError, match=r"plant\.sqlite: .*malformed"):
        answer("SELECT count(*) FROM friction", PlantSource(Database(tmp_path / "plant.sqlite")))


def damage(path: Path) -> None:
    """Every second page of the later half."""
    content = bytearray(path.read_bytes())
    pages = len(content) // 4096
    for page in range(pages // 2, pages, 2):
        content[4096 * page : 4096 * page + 64] = b"\x99" * 64
    path.write_bytes(content)


def test_the_command_prints_a_table_csv_or_json_and_says_when_there_is_more(tmp_path: Path):
    """A mistake gives DuckDB's sentence and exit code 2."""
    folder = lived(tmp_path / "cell-1")
    asked = (
        "query",
        "--history",
        folder,
        "SELECT robot, joint, wear, recorded_at, joint > 1 AS wrist FROM friction ORDER BY replay, joint",
    )
    table = ended(*asked, "--limit", 2)
    assert table.returncode == 0
    assert [word in table.stdout for word in ("cell-1", "1970-01-01 00:00:00", "2 rows")] == [True] * 3
    assert "the first 2 rows" in table.stderr
    wide = ended("query", "--history", folder, "SELECT * FROM friction", "--limit", 1).stdout.splitlines()
    assert [line.split() for line in wide if line.startswith(("robot", "wear ", "p50"))] == [
        ["robot", "cell-1"],
        ["wear", "0"],
        ["p50_days", "–"],
    ]
    document = json.loads(ended(*asked, "--json", "--limit", 3).stdout)
    assert document["more"]
    assert document["rows"][1] == {"robot": "cell-1", "joint": 2, "wear": 1.0, "recorded_at": "1970-01-01T00:00:00Z", "wrist": True}
    rows = list(csv.DictReader(io.StringIO(ended(*asked, "--csv").stdout)))
    assert (len(rows), rows[-1]["wear"], rows[-1]["wrist"]) == (6, "1.02", "true")
    wrong = ended("query", "--history", folder, "SELECT torque FROM friction")
    assert wrong.returncode == 2
    assert 'Referenced column "torque" not found' in wrong.stderr
    for mistake in ((*asked, "--csv", "--json"), ("query", "SELECT 1"), ("query", "--history", tmp_path / "none", "SELECT 1")):
        assert ended(*mistake).returncode == 2, mistake


def test_times_are_utc_beside_now_and_dates_too_whatever_the_zone_of_the_host():
    """In a process of its own: DuckDB reads the host's zone once. `now() - INTERVAL` was five hours off in New York."""
    question = (
        """SELECT now() - now()::TIMESTAMP, TIMESTAMP '2026-07-01 12:00:00' = TIMESTAMPTZ '2026-07-01 12:00:00+00', strftime(now(), '%Z')"""
    )
    text = f"from monitor.studies.query import ask; print(ask({question!r}, [], 1).rows)"
    done = subprocess.run(
        [sys.executable, "-c", text],
        env=os.environ | {"TZ": "America/New_York"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    assert done.stdout == "[(datetime.timedelta(0), True, 'UTC')]\n"


def test_values_of_every_kind_are_plain_json(arm: ArmSource):
    """Times are UTC; what is not finite is null, as JSON has no word for it."""
    sql = (
        "SELECT 1.5::DECIMAL(4, 2), 'nan'::DOUBLE, DATE '2026-01-31', TIME '03:00', INTERVAL 90 SECOND, [1, NULL], {'a': 1}, MAP {'b': 2}, "
        "'ab'::BLOB, TIMESTAMP '2026-01-31 03:00', uuid(), NULL, true, 170141183460469231731687303715884105727"
    )
    (row,) = answer(sql, arm)
    values = [plain(value) for value in row]
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    assert values[:10] == [
        1.5, None, "2026-01-31", "03:00:00", 90.0, [1, None], {"a": 1}, {"b": 2}, "6162", "2026-01-31T03:00:00Z",
    ]  # fmt: skip
    assert unique(("a", "b", "a", "a_2", "a")) == ["a", "b", "a_2", "a_2_2", "a_3"]


def test_the_page_names_every_column():
    """In the order of the views."""
    page = (ROOT / "docs/query.md").read_text("utf-8")
    for table, columns in TABLES.items():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| `{table}` |")]
        assert row.endswith(f"| {', '.join(f'`{name}`' for name in columns)} |")


def test_a_plants_database_is_asked_like_a_history(tmp_path: Path):
    """Friction and events also of arms that hand over no rows: their ledgers stay with them."""
    from monitor.plant.tables import arm as arms
    from monitor.plant.tables import friction as figures
    from monitor.plant.tables import transition

    database = Database(f"sqlite:///{tmp_path / 'plant.sqlite'}")
    database.migrate()
    document = {"kind": "raised", "text": "Joint 2's friction rises."}
    with database.write() as connection:
        for number, robot in enumerate(("cell-1", "cell-2"), start=1):
            connection.execute(arms.insert().values(id=number, site="hall", robot=robot, first_seen=0.0, history=1))
            one = {"arm": number, "history": 1, "joint": 2, "recorded_at": DAY, "replay": 7, "wear": 0.1 * number, "p50_days": 20.0}
            connection.execute(figures.insert().values(**one))
        about = {"arm": 1, "history": 1, "seq": 1, "at": DAY, "joint": 2, "condition": "wear_rising", "tier": "advisory", "kind": "raised"}
        connection.execute(transition.insert().values(document=document, **about))
    (source,) = sources_at(tmp_path)
    with database.write():  # while the plant writes
        assert answer("SELECT robot, joint, wear, p50_days, recorded_at = '1970-01-02' FROM friction ORDER BY robot", source) == [
            ("cell-1", 2, 0.1, 20.0, True), ("cell-2", 2, 0.2, 20.0, True),
        ]  # fmt: skip
    assert answer("SELECT site, robot, kind, text, history FROM events", source) == [("hall", "cell-1", "raised", document["text"], 1)]
    assert answer("SELECT (SELECT count(*) FROM ledger) + (SELECT count(*) FROM recordings)", source) == [(0,)]
    database.close()
