"""Questions in SQL over histories and recordings: DuckDB asks tables that were read before, and can neither write nor reach a file.

The tables are of one arm's history, of a plant's database, of an archive. Each is read in one moment of its history and let go of before
the question is asked: a daemon that writes is never held up.
"""

import decimal
import math
import os
import re
import sqlite3
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.csv as arrow_csv
import pyarrow.parquet as pq
import sqlalchemy as sa

from monitor.errors import BadInput
from monitor.plant.database import Database
from monitor.plant.settings import EMBEDDED
from monitor.plant.tables import FIGURES, LIFE_FIGURES, arm, friction, stored, transition
from monitor.store.archive.archive import Archive, ArchivedRecording, RecordingCache, recording_in, split_address
from monitor.store.archive.archived import PLACE
from monitor.store.archive.places import ArchiveSettings
from monitor.store.backup import HISTORY, connected
from monitor.store.store import Store
from monitor.store.stored import unpacked_row

if TYPE_CHECKING:
    import duckdb

TEXT, WHOLE, NUMBER, TIME, FLAG = "VARCHAR", "BIGINT", "DOUBLE", "TIMESTAMP", "BOOLEAN"
_ARM = {"site": TEXT, "robot": TEXT, "history": WHOLE}
LIFE = dict.fromkeys(LIFE_FIGURES, NUMBER)
TABLES: dict[str, dict[str, str]] = {  # column → DuckDB's type; times are UTC
    "friction": {**_ARM, "replay": WHOLE, "joint": WHOLE, "recorded_at": TIME, **dict.fromkeys(FIGURES, NUMBER), **LIFE},
    "events": {
        **_ARM, "seq": WHOLE, "happened_at": TIME, "replay": WHOLE, "kind": TEXT, "joint": WHOLE, "condition": TEXT, "tier": TEXT,
        "text": TEXT, "said_by": TEXT, "why": TEXT, "document": "JSON",
    },
    "ledger": {
        **_ARM, "replay": WHOLE, "window_at": TIME, "kind": TEXT, "state": TEXT, "reason": TEXT, "started_at": TIME, "ended_at": TIME,
    },
    "recordings": {
        **_ARM, "replay": WHOLE, "recorded_at": TIME, "year": WHOLE, "state": TEXT, "file": TEXT, "is_here": FLAG, "address": TEXT,
        "sha256": TEXT, "bytes": WHOLE, "verified_at": TIME,
    },
}  # fmt: skip
OWN = 0  # the number of a history that its own arm has; a plant counts those of an arm from 1
BATCH = 20_000  # rows that are handed over together
Rows = Iterator[Sequence[Any]]  # in the order of the table's columns; a time is a number of seconds since 1970
Batches = Iterator[tuple[str, list[Sequence[Any]] | pa.Table]]  # rows that were read, each with its table; of some columns alone as Arrow
MOMENT = {"friction": "recorded_at", "events": "happened_at", "ledger": "window_at", "recordings": "recorded_at"}  # of each row


@dataclass(frozen=True, slots=True)
class ArmSource:
    """The history of one arm, in a folder."""

    directory: Path
    site: str | None = None  # None: as the archive has it, else unknown
    robot: str | None = None  # None: likewise, else the folder's name
    archive: ArchiveSettings | None = None  # None: as the history has noted it

    def rows(self, tables: Mapping[str, Collection[str]]) -> Batches:
        """The rows of the tables, all of one moment."""
        with Store.reader(self.directory, self.archive) as store:
            connection = store.database.connection
            connection.execute("BEGIN")
            try:
                arm = self._arm(connection)
                for table in tables:
                    yield from _batches(table, ([*arm, OWN, *row] for row in _ARM_ROWS[table](connection, self.directory)))
            finally:
                connection.execute("ROLLBACK")

    def recording(self, which: str) -> Path | None:
        """The file of a recording: NUMBER, ROBOT/NUMBER, SITE/ROBOT/NUMBER, or its address; None where it is not of this arm."""
        with Store.reader(self.directory, self.archive) as store:
            number = self._number(store.database.connection, which)
            path = None if number is None else store.archived.path(number)
        return path if path is not None and path.is_file() else None

    def _number(self, connection: sqlite3.Connection, which: str) -> int | None:
        archived = connection.execute("SELECT ledger_id FROM archived WHERE address = ?", (which,)).fetchone()
        if archived is not None:
            return int(archived[0])
        site, robot = self._arm(connection)
        *arm, number = which.split("/")
        return int(number) if number.isdecimal() and len(arm) <= 2 and arm == [site, robot][2 - len(arm) :] else None

    def _arm(self, connection: sqlite3.Connection) -> tuple[str, str]:
        if self.robot is not None:
            return self.site or "", self.robot
        noted = connection.execute("SELECT address FROM archived ORDER BY ledger_id DESC LIMIT 1").fetchone()
        if noted is not None:
            parts = dict(part.split("=", 1) for part in split_address(noted[0])[1].split("/")[:2])
            return parts["site"], parts["robot"]
        return "", self.directory.resolve().name  # no value that is unknown: a join by it would find nothing, and say nothing


@dataclass(frozen=True, slots=True)
class PlantSource:
    """A plant's database: the histories of many arms, as far as they are copied. Recordings are in the archive, or with the arms."""

    database: Database
    begin_unix_s: float = -math.inf  # of the rows that are read
    end_unix_s: float = math.inf  # not included

    def rows(self, tables: Mapping[str, Collection[str]]) -> Batches:
        """The rows of the tables, all of one moment; of friction on a server the columns that are needed, whose figures are many."""
        with self.database.read() as moment_of:
            connection = moment_of.execution_options(yield_per=BATCH)
            for table, columns in tables.items():
                if table == "friction":
                    asked = self.friction(columns if self.database.postgresql else TABLES["friction"])
                    yield from _copied_out(connection, asked) if self.database.postgresql else _batches(table, connection.execute(asked))
                    continue
                moment = list(TABLES[table]).index(MOMENT[table])
                rows = _PLANT_ROWS[table](connection)
                yield from _batches(table, (row for row in rows if self.begin_unix_s <= row[moment] < self.end_unix_s))

    def friction(self, columns: Collection[str]) -> sa.Select[Any]:
        """What is asked; a server reads the months of these times alone."""
        own = [arm.c[name] if name in ("site", "robot") else friction.c[name] for name in TABLES["friction"] if name in columns]
        asked = sa.select(*own).select_from(friction.join(arm, arm.c.id == friction.c.arm))
        if self.begin_unix_s > -math.inf:
            asked = asked.where(friction.c.recorded_at >= self.begin_unix_s)
        return asked if self.end_unix_s == math.inf else asked.where(friction.c.recorded_at < self.end_unix_s)

    def recording(self, which: str) -> Path | None:
        """The file of an archived recording, as `ArmSource.recording`. Raises BadInput where several arms have one of this number."""
        *named, number = which.split("/")
        if "/site=" in which:
            found = recording_in(split_address(which)[1])
            named, number = [found.site, found.robot], str(found.replay)
        if not number.isdecimal() or len(named) > 2:
            return None
        of_arm = (stored.c.arm == arm.c.id) & (stored.c.history == arm.c.history)
        rows = sa.select(arm.c.id, stored.c.content).join(stored, of_arm)
        for column, name in zip((arm.c.robot, arm.c.site), reversed(named), strict=False):
            rows = rows.where(column == name)
        with self.database.read() as connection:
            there = connection.execute(rows.where(stored.c.of_table == "archived", stored.c.row == str(int(number)))).all()
            if len(there) > 1:
                raise BadInput(f"query: replay('{which}'): {len(there)} arms have one of this number; name the arm: SITE/ROBOT/{number}")
            noted = sa.select(stored.c.content).join(arm, of_arm).where(arm.c.id == (there[0][0] if there else None))
            place = connection.execute(noted.where(stored.c.of_table == "note", stored.c.row == PLACE)).scalar_one_or_none()
        row = unpacked_row(there[0][1]) if there else None
        if row is None or ("/site=" in which and row["address"] != which):
            return None
        settings = ArchiveSettings(address=row["address"])
        if place is not None:
            settings = ArchiveSettings.from_document(orjson.loads(unpacked_row(place)["value"]))
        return RecordingCache().fetched(settings, row["address"], row["sha256"])


@dataclass(frozen=True, slots=True)
class ArchiveSource:
    """An archive alone, without the histories of its recordings."""

    settings: ArchiveSettings

    def rows(self, tables: Mapping[str, Collection[str]]) -> Batches:
        """The recordings; nothing else is in an archive."""
        if "recordings" in tables:
            archive = Archive.open(self.settings)
            yield from _batches("recordings", (self._row(archive, each) for each in archive.recordings()))

    def recording(self, which: str) -> Path | None:
        """The file of a recording by its address; None where that is not of this archive."""
        archive = Archive.open(self.settings)
        return RecordingCache().fetched(self.settings, which) if which.startswith(archive.address("")) else None

    def _row(self, archive: Archive, each: ArchivedRecording) -> list[Any]:
        at, file = each.recorded_at_unix_s, each.key.rpartition("/")[2]
        where = archive.address(each.key)
        return [each.site, each.robot, OWN, each.replay, at, each.year, None, file, False, where, None, each.size, None]


Source = ArmSource | PlantSource | ArchiveSource


def sources_at(path: Path) -> list[Source]:
    """What lies at a path: one arm's history, folders of such histories, or a plant's database. Raises BadInput where there is nothing."""
    if path.is_file():
        return [ArmSource(path.parent) if path.name == HISTORY else _plant(path)]
    if (path / HISTORY).is_file():
        return [ArmSource(path)]
    found: list[Source] = [ArmSource(each.parent) for each in sorted([*path.glob(f"*/{HISTORY}"), *path.glob(f"*/*/{HISTORY}")])]
    found += [_plant(each) for each in sorted([*path.glob(EMBEDDED), *path.glob(f"*/{EMBEDDED}")])]
    if not found:
        raise BadInput(f"{path}: holds neither {HISTORY}, nor folders that do, nor {EMBEDDED}")
    return found


def _plant(path: Path) -> PlantSource:
    with closing(connected(path, "ro", isolation_level=None)) as connection:
        try:
            tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
        except sqlite3.Error as error:
            raise BadInput(f"{path}: cannot be read as SQLite: {error}") from None
    if not {"arm", "friction", "transition"} <= tables:
        raise BadInput(f"{path}: is no plant's database; expected {EMBEDDED}, or the folder of a history")
    return PlantSource(Database(path))


def _batches(table: str, rows: Rows) -> Batches:
    """Rows, read here: what is wrong with their file is told by whoever has opened it."""
    while batch := list(islice(rows, BATCH)):
        yield table, batch


def _friction(connection: sqlite3.Connection, _: Path) -> Rows:
    cursor = connection.execute("SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction ORDER BY ledger_id, joint")
    while rows := cursor.fetchmany(10_000):
        documents = orjson.loads(f"[{','.join([row[3] for row in rows])}]")  # one parse: several times faster than one a row
        for (replay, joint, at, _text), document in zip(rows, documents, strict=True):
            life = document.get("remaining_life") or {}
            yield [replay, joint, at, *(document.get(name) for name in FIGURES), *(life.get(name) for name in LIFE)]


def _events(connection: sqlite3.Connection, _: Path) -> Rows:
    for seq, at, replay, text in connection.execute("SELECT seq, at_unix_s, ledger_id, document FROM event ORDER BY seq"):
        yield _event(seq, at, replay, text)


def _event(seq: int, at: float, replay: int | None, text: str) -> list[Any]:
    document = orjson.loads(text)
    names = ("kind", "joint", "condition", "tier", "text", "by", "why")
    return [seq, at, replay, *(document.get(name) for name in names), text]


def _ledger(connection: sqlite3.Connection, _: Path) -> Rows:
    return connection.execute(
        "SELECT id, window_unix_s, kind, state, json_extract(reason, '$.text'), started_at_unix_s, ended_at_unix_s FROM ledger ORDER BY id"
    )


def _recordings(connection: sqlite3.Connection, directory: Path) -> Rows:
    here = {path.name: path.stat().st_size for path in (directory / "recordings").glob("replay-*.parquet")}
    for number, window, judged, state, name, *remote in connection.execute(
        "SELECT id, window_unix_s, recorded_at_unix_s, state, recording, address, sha256, bytes, verified_at_unix_s "
        "FROM ledger LEFT JOIN assessment a ON a.ledger_id = id LEFT JOIN archived r ON r.ledger_id = id "
        "WHERE recording IS NOT NULL ORDER BY id"
    ):
        at = window if judged is None else judged
        address, sha256, size, verified = remote
        size = here.get(name) if size is None else size
        yield [number, at, datetime.fromtimestamp(at, UTC).year, state, name, name in here, address, sha256, size, verified]


_ARM_ROWS = {"friction": _friction, "events": _events, "ledger": _ledger, "recordings": _recordings}


# --- the same rows of a plant's database: by columns as far as the plant has them, else from the copied rows of the arms' histories ---


def _copied_out(connection: sa.Connection, asked: sa.Select[Any]) -> Batches:
    """The rows of friction as the server writes them for a copy, without a Python object for each figure."""
    names = [column.name for column in asked.selected_columns]
    within = asked.compile(connection, compile_kwargs={"literal_binds": True})
    columns = ", ".join(f"(extract(epoch FROM q.{name}) * 1000000)::bigint" if name == "recorded_at" else f"q.{name}" for name in names)
    sql = f"COPY (SELECT {columns} FROM ({within}) q) TO STDOUT (FORMAT csv)"  # noqa: S608 - fixed names
    kinds = {name: pa.int64() if name == "recorded_at" else _ARROW[TABLES["friction"][name]] for name in names}
    driver: Any = connection.connection.driver_connection
    with tempfile.TemporaryFile(prefix="joint-monitor-query-") as file:
        with driver.cursor().copy(sql) as rows:
            for data in rows:
                file.write(data)
        if not file.tell():
            return
        file.seek(0)
        read = arrow_csv.ReadOptions(column_names=names, block_size=1 << 24)
        with arrow_csv.open_csv(file, read, convert_options=arrow_csv.ConvertOptions(column_types=kinds)) as parts:
            for part in parts:
                found = pa.Table.from_batches([part])
                if "recorded_at" in names:
                    at = names.index("recorded_at")
                    found = found.set_column(at, "recorded_at", found.column(at).cast(_ARROW[TIME]))
                yield "friction", found


def _plant_events(connection: sa.Connection) -> Rows:
    """An arm of an earlier release hands no rows over: its transitions are without their replay."""
    t = transition.c
    same = (stored.c.arm == t.arm) & (stored.c.history == t.history) & (stored.c.of_table == "event")
    asked = sa.select(arm.c.site, arm.c.robot, t.history, t.seq, t.at, t.document, stored.c.content)
    joined = asked.join(arm, arm.c.id == t.arm).join(stored, same & (stored.c.row == sa.cast(t.seq, sa.Text)), isouter=True)
    for site, robot, number, seq, at, document, content in connection.execute(joined):
        row: dict[str, Any] = {"ledger_id": None, "document": orjson.dumps(document).decode()} if content is None else unpacked_row(content)
        yield [site, robot, number, *_event(seq, at, row["ledger_id"], row["document"])]


def _plant_ledger(connection: sa.Connection) -> Rows:
    for of, row in _copied(connection, "ledger"):
        reason = None if row["reason"] is None else orjson.loads(row["reason"]).get("text")
        times = (row["started_at_unix_s"], row["ended_at_unix_s"])
        yield [*of, row["id"], row["window_unix_s"], row["kind"], row["state"], reason, *times]


def _plant_recordings(connection: sa.Connection) -> Rows:
    asked = sa.select(friction.c.arm, friction.c.history, friction.c.replay, friction.c.recorded_at).where(friction.c.joint == 1)
    judged = {(number, history, replay): at for number, history, replay, at in connection.execute(asked)}
    archived = {(*of, row["ledger_id"]): row for of, row in _copied(connection, "archived")}
    ids = {(site, robot): number for number, site, robot in connection.execute(sa.select(arm.c.id, arm.c.site, arm.c.robot))}
    for (site, robot, history), row in _copied(connection, "ledger"):
        if (name := row["recording"]) is None:
            continue
        at = judged.get((ids[site, robot], history, row["id"]), row["window_unix_s"])
        there = archived.get((site, robot, history, row["id"]), {})
        remote = (there.get(name) for name in ("address", "sha256", "bytes", "verified_at_unix_s"))
        yield [site, robot, history, row["id"], at, datetime.fromtimestamp(at, UTC).year, row["state"], name, False, *remote]


def _copied(connection: sa.Connection, table: str) -> Iterator[tuple[tuple[str, str, int], dict[str, Any]]]:
    """The copied rows of one table of the arms' histories: of which site, robot and history, and its columns."""
    asked = sa.select(arm.c.site, arm.c.robot, stored.c.history, stored.c.content).join(arm, arm.c.id == stored.c.arm)
    for site, robot, history, content in connection.execute(asked.where(stored.c.of_table == table)):
        yield (site, robot, history), unpacked_row(content)


_PLANT_ROWS = {"events": _plant_events, "ledger": _plant_ledger, "recordings": _plant_recordings}


# --- the question ----------------------------------------------------------------------------------

MEMORY, SPILL = "1GB", "4GB"  # beside a daemon: of memory, and of a temporary folder
_ARROW = {TEXT: pa.string(), "JSON": pa.string(), WHOLE: pa.int64(), NUMBER: pa.float64(), TIME: pa.timestamp("us"), FLAG: pa.bool_()}
_REPLAY = re.compile(r"\breplay\s*\(\s*(?:'([^']*)'|(\d+))\s*\)", re.IGNORECASE)


class Answer(NamedTuple):
    """The rows of an answer."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    more: bool  # than are in it


def ask(sql: str, sources: Sequence[Source], limit: int) -> Answer:
    """The answer to one question, of at most `limit` rows.

    Raises BadInput with DuckDB's own sentence where the question is wrong, and where it is not one question.
    """
    import duckdb

    _refuse_other_statements(duckdb, sql)
    with _memory_database(duckdb) as connection:
        for table in TABLES:
            _create(connection, table)
        # a word that is no table costs time, and a table that is not loaded would be a wrong answer
        wanted = [table for table in TABLES if re.search(rf"\b{table}\b", sql, re.IGNORECASE)]
        needed = _needed(connection, duckdb, sql, wanted)
        for source in sources if wanted else ():
            for table, batch in source.rows(needed):
                _load(connection, table, batch)
        _load_replays(connection, [match[1] if match[1] is not None else match[2] for match in _REPLAY.finditer(sql)], sources)
        connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")
        try:
            connection.execute(sql)
            columns = tuple(each[0] for each in connection.description or ())
            found = connection.fetchmany(limit + 1)
        except duckdb.Error as wrong:
            raise BadInput(f"query: {str(wrong).rstrip()}") from None
    return Answer(columns, found[:limit], len(found) > limit)


def _needed(connection: "duckdb.DuckDBPyConnection", duckdb: Any, sql: str, wanted: Sequence[str]) -> dict[str, Collection[str]]:
    """The columns of each table that the question reads, as DuckDB plans it; all of a table where the plan does not say."""
    needed: dict[str, Collection[str]] = {table: TABLES[table] for table in wanted}
    if str(duckdb.extract_statements(sql)[0].type).rpartition(".")[2] not in ("SELECT", "SELECT_STATEMENT"):
        return needed  # a PIVOT is several questions, of which one is planned
    try:
        # a filter in a scan reads columns that the plan does not name, and a table without rows may not be in it
        connection.execute("SET disabled_optimizers = 'filter_pushdown,statistics_propagation,empty_result_pullup'")
        plan = orjson.loads(connection.execute(f"EXPLAIN (FORMAT json) {sql}").fetchall()[0][1])
    except (duckdb.Error, orjson.JSONDecodeError):  # what is wrong with the question is told where it is asked
        return needed
    finally:
        connection.execute("SET disabled_optimizers = ''")
    scanned: dict[str, set[str]] = {}
    nodes = list(plan)
    while nodes:
        node = nodes.pop()
        nodes += node.get("children", [])
        about = node.get("extra_info", {})
        if "Table" in about:
            names = about.get("Projections") or []
            scanned.setdefault(about["Table"].rpartition(".")[2], set()).update([names] if isinstance(names, str) else names)
    return needed | {table: names & TABLES[table].keys() or {"replay"} for table, names in scanned.items() if table in needed}


def plain(value: Any) -> Any:
    """A value of an answer as JSON has it: times as RFC 3339 in UTC, what is not finite as null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, datetime):
        text = value.isoformat()
        return f"{text}Z" if value.tzinfo is None else text.replace("+00:00", "Z")
    if isinstance(value, date | time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return value.total_seconds()
    if isinstance(value, decimal.Decimal):
        return float(value)
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def unique(columns: Sequence[str]) -> list[str]:
    """The names of an answer's columns, each once: a second `wear` is `wear_2`."""
    names: list[str] = []
    for column in columns:
        name, k = column, 1
        while name in names:
            k += 1
            name = f"{column}_{k}"
        names.append(name)
    return names


def _refuse_other_statements(duckdb: Any, sql: str) -> None:
    """Raises BadInput unless the text is one question."""
    try:
        statements = duckdb.extract_statements(sql)
    except duckdb.Error as wrong:
        raise BadInput(f"query: {str(wrong).rstrip()}") from None
    if len(statements) != 1:
        raise BadInput(f"query: {len(statements)} statements given; expected one question")
    kind = str(statements[0].type).rpartition(".")[2].removesuffix("_STATEMENT")
    if kind not in {"SELECT", "EXPLAIN", "MULTI"}:  # PIVOT is several to DuckDB
        raise BadInput(f"query: {kind} is no question; histories and recordings are read alone: expected SELECT, FROM, DESCRIBE, …")


@contextmanager
def _memory_database(duckdb: Any) -> Iterator["duckdb.DuckDBPyConnection"]:
    """An empty database in memory that installs and loads nothing, and leaves cores to others."""
    with tempfile.TemporaryDirectory(prefix="joint-monitor-query-") as spill:
        settings = {
            "autoinstall_known_extensions": "false",
            "autoload_known_extensions": "false",
            "allow_community_extensions": "false",
            "python_enable_replacements": "false",
            "temp_directory": spill,
            "max_temp_directory_size": SPILL,
            "memory_limit": MEMORY,
            "threads": str(max(1, (os.cpu_count() or 2) // 2)),
        }
        connection = duckdb.connect(":memory:", config=settings)
        try:
            connection.execute("CREATE SCHEMA read")
            connection.execute("SET TimeZone = 'UTC'")  # the views' times are UTC: beside now() and dates a host's zone would shift them
            yield connection
        finally:
            connection.close()


def _create(connection: "duckdb.DuckDBPyConnection", table: str) -> None:
    columns = ", ".join(f'"{name}" {kind}' for name, kind in TABLES[table].items())
    connection.execute(f"CREATE TABLE read.{table} ({columns})")
    connection.execute(f"CREATE VIEW {table} AS SELECT * FROM read.{table}")  # noqa: S608 - fixed names


def _load(connection: "duckdb.DuckDBPyConnection", table: str, batch: Sequence[Sequence[Any]] | pa.Table) -> None:
    """Hand some thousand rows over; columns that were not read are empty."""
    if not isinstance(batch, pa.Table):
        kinds = TABLES[table]
        columns = zip(*batch, strict=True)
        batch = pa.table([_array(values, kind) for values, kind in zip(columns, kinds.values(), strict=True)], names=list(kinds))
    connection.register("batch", batch)
    connection.execute(f"INSERT INTO read.{table} BY NAME SELECT * FROM batch")  # noqa: S608 - fixed names
    connection.unregister("batch")


def _array(values: Sequence[Any], kind: str) -> pa.Array:
    if kind == TIME:
        seconds = np.array([np.nan if value is None else value for value in values], dtype=float)
        known = np.isfinite(seconds)
        return pa.array(np.round(np.where(known, seconds, 0.0) * 1e6).astype("int64"), mask=~known).cast(pa.timestamp("us"))
    if kind == NUMBER:
        return pa.array([None if value is None else float(value) for value in values], type=pa.float64())
    return pa.array(values, type=_ARROW[kind])


def _load_replays(connection: "duckdb.DuckDBPyConnection", asked: Sequence[str], sources: Sequence[Source]) -> None:
    """The rows of the recordings that the question names, as the table function `replay`. Raises BadInput for one that is nowhere."""
    parts = []
    for k, which in enumerate(dict.fromkeys(asked)):
        there = (path for source in sources if (path := source.recording(which)) is not None)
        found = list(islice(there, 1 if "/site=" in which else None))  # an address is of one recording, whoever has it
        if not found:
            raise BadInput(
                f"query: replay('{which}'): there is no recording of it here or in the archive; expected NUMBER, ROBOT/NUMBER, "
                "SITE/ROBOT/NUMBER or an address, as the view recordings shows them"
            )
        if len(found) > 1:
            raise BadInput(f"query: replay('{which}'): {len(found)} arms have one of this number; name the arm as well: ROBOT/{which}")
        connection.register(f"given_{k}", _table(found[0]))
        connection.execute(f"CREATE TABLE read.replay_{k} AS SELECT ? AS which, * FROM given_{k}", [which])  # noqa: S608 - fixed names
        connection.unregister(f"given_{k}")
        parts.append(f"FROM read.replay_{k}")
    if parts:
        union = " UNION ALL BY NAME ".join(parts)
        connection.execute(
            f"CREATE MACRO replay(asked) AS TABLE SELECT * EXCLUDE (which) FROM ({union}) WHERE which = asked::VARCHAR"  # noqa: S608
        )


def _table(path: Path) -> pa.Table:
    try:
        return pq.read_table(path).replace_schema_metadata(None)
    except (pa.ArrowException, OSError) as wrong:
        raise BadInput(f"{path}: is not readable Parquet: {str(wrong).splitlines()[0]}") from None
