"""Questions in SQL over histories and recordings: DuckDB asks tables that were read before, and can neither write nor reach a file."""

import decimal
import math
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date, datetime, time, timedelta
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from monitor.errors import BadInput
from monitor.service.history.query_tables import FLAG, NUMBER, TABLES, TEXT, TIME, WHOLE, Source

if TYPE_CHECKING:
    import duckdb

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
    duckdb = _duckdb()
    _refuse_other_statements(duckdb, sql)
    with _database(duckdb) as connection:
        for table in TABLES:
            _create(connection, table)
        # a word that is no table costs time, and a table that is not loaded would be a wrong answer
        wanted = [table for table in TABLES if re.search(rf"\b{table}\b", sql, re.IGNORECASE)]
        for source in sources if wanted else ():
            for table, batch in source.rows(wanted):
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


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise BadInput("query needs DuckDB, which is not installed: pip install 'joint-monitor[archive]'") from None
    return duckdb


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
def _database(duckdb: Any) -> Iterator["duckdb.DuckDBPyConnection"]:
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


def _load(connection: "duckdb.DuckDBPyConnection", table: str, batch: Sequence[Sequence[Any]]) -> None:
    """Hand some thousand rows over."""
    kinds = TABLES[table]
    columns = zip(*batch, strict=True)
    arrays = [_array(values, kind) for values, kind in zip(columns, kinds.values(), strict=True)]
    connection.register("batch", pa.table(arrays, names=list(kinds)))
    connection.execute(f"INSERT INTO read.{table} SELECT * FROM batch")  # noqa: S608 - fixed names
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
