"""The plant's database: SQLite embedded, or PostgreSQL. One code through SQLAlchemy Core; Alembic brings the schema up to date. I/O.

A database that does not answer is `DatabaseUnavailable`: whoever can wait tries again. Messages never hold a password.
"""

import logging
import re
import sqlite3
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import orjson
import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from monitor.errors import BadConfiguration, StoreError, StoreUnavailable
from monitor.plant.tables import PARTITIONED
from monitor.recording import DAY_S
from monitor.store.disk import refused_by

MIGRATIONS = Path(__file__).parent / "migrations"
# times outside are some clock's mistake, and share one partition: an arm that sends any of them can make no more than 300 tables
FIRST_MONTH, LAST_MONTH = (2020, 1), (2045, 1)
# a server whose machine is gone without a word is noticed within half a minute
SERVER = {
    "connect_timeout": 5,
    "client_encoding": "utf8",
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 25_000,
}
WAIT_FOR_LOCK_S = 30.0
PATIENCE_S = 40  # of a service with one statement; the service manager's with the service is a minute
SESSION = (
    "SET datestyle = 'ISO, YMD'; SET timezone = 'UTC'; SET extra_float_digits = 3; "
    "SET SESSION CHARACTERISTICS AS TRANSACTION ISOLATION LEVEL READ COMMITTED"
)
ENCODING = "UTF8"  # texts of arms and people are of every language
LOCK_NOT_AVAILABLE = "55P03"  # PostgreSQL's code; its words are in the server's language
_PASSWORD = re.compile(r"(password\s*=\s*)\S+|(://[^:/@\s]*:)[^@\s]+(?=@)", re.IGNORECASE)


class DatabaseUnavailable(StoreUnavailable):
    """The database does not answer, or refuses: it may be starting again, so a caller that can wait tries again."""

    locked = False  # whether it is only that somebody held a lock for too long


class DataRefused(StoreError):
    """The database answers, and does not take these values: they are not what they should be."""


class Database:
    """One database with the plant's tables. Several threads may use it."""

    def __init__(self, address: str | Path, *, patience_s: int = 0) -> None:
        """`address`: sqlite:///PATH, postgresql+psycopg://…, or the path of an embedded one, whose name may hold any sign.

        patience_s : for which a server may work on one statement before it counts as away; 0: for ever. Nothing is opened yet.
        Raises BadConfiguration where it is no address.
        """
        try:
            url = sa.URL.create("sqlite", database=str(address)) if isinstance(address, Path) else sa.make_url(address)
            self.postgresql = url.get_backend_name() == "postgresql"
            options: dict[str, Any] = SERVER if self.postgresql else {"timeout": WAIT_FOR_LOCK_S, "check_same_thread": False}
            self._engine = sa.create_engine(
                url, connect_args=options, pool_pre_ping=self.postgresql, hide_parameters=True, json_serializer=_encoded
            )
        except (sa.exc.ArgumentError, ImportError, ValueError):
            raise BadConfiguration("plant.database: is no address of a database; expected postgresql+psycopg://USER@HOST/NAME") from None
        self.name = url.render_as_string(hide_password=True)
        self._file = None if self.postgresql else Path(url.database or "")
        self._writing = threading.Lock()  # SQLite has one writer; waiting here costs less than waiting for its lock
        self._partitions: set[str] = set()
        if self.postgresql:
            sa.event.listen(self._engine, "connect", _as_server(patience_s))
        if not self.postgresql:
            sa.event.listen(self._engine, "connect", _as_embedded)
            sa.event.listen(self._engine, "begin", _begin)

    def close(self) -> None:
        """Close every connection."""
        self._engine.dispose()

    @property
    def exists(self) -> bool:
        """Whether there is an embedded database already. Of a server this is not known before it is asked."""
        return self._file is None or self._file.is_file()

    @contextmanager
    def write(self) -> Iterator[sa.Connection]:
        """A transaction: all of it is committed, or nothing. Raises DatabaseUnavailable, StoreError."""
        with self._refusals():
            if self.postgresql:
                with self._engine.begin() as connection:
                    yield connection
            else:
                with self._writing, self._engine.connect().execution_options(writes=True) as connection, connection.begin():
                    yield connection

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """One moment of the database, while others write. Raises DatabaseUnavailable, StoreError."""
        with self._refusals(), self._engine.connect() as connection:
            moment = connection.execution_options(isolation_level="REPEATABLE READ") if self.postgresql else connection
            with moment.begin():
                yield moment

    @property
    def file(self) -> Path | None:
        """Of the embedded database; None: it is a server's."""
        return self._file

    @contextmanager
    def session(self) -> Iterator[sa.Connection]:
        """A connection that is nobody else's while the context lasts. Raises DatabaseUnavailable where it cannot be opened."""
        with self._refusals():
            connection = self._engine.connect()
            connection.detach()
        try:
            yield connection
        finally:
            connection.close()

    def make_folder(self) -> None:
        """Of an embedded database. Raises StoreError."""
        if self._file is not None:
            try:
                self._file.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise StoreError(f"{self._file.parent}: cannot be made: {error.strerror}") from None

    def migrate(self) -> None:
        """Make the tables of an empty database. Raises StoreError where it is of another version or program."""
        self.make_folder()
        logging.getLogger("alembic").setLevel(logging.WARNING)  # a step more is no news every time
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
        scripts = ScriptDirectory.from_config(config)
        with self.write() as connection:
            if self.postgresql:  # two plants that start at once; a step may take its time
                connection.execute(sa.text("SET LOCAL statement_timeout = 0"))
                connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": 7_447_026})
            present = MigrationContext.configure(connection).get_current_revision()
            if present is not None and present not in {script.revision for script in scripts.walk_revisions()}:
                what = f"{self.name}: has the schema {present} of another version of joint-monitor"
                raise StoreError(f"{what}; install that one, or begin with an empty database")
            if present is None and (others := sa.inspect(connection).get_table_names()):
                raise StoreError(
                    f"{self.name}: holds another program's tables ({', '.join(sorted(others)[:3])}); expected a database of its own"
                )
            if present is None and self.postgresql:
                has = connection.execute(sa.text("SHOW server_encoding")).scalar_one()
                if has != ENCODING:
                    made = f"createdb --encoding={ENCODING} --template=template0 NAME"
                    raise StoreError(f"{self.name}: has the encoding {has}; expected {ENCODING}: {made}")
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
        self._see_partitions()

    def check(self) -> None:
        """Whether the tables can be read as they are, without changing anything. Raises StoreError."""
        with self.read() as connection:
            present = MigrationContext.configure(connection).get_current_revision()
        if present is None:
            raise StoreError(f"{self.name}: holds no plant yet; the first `joint-monitor plant` with this configuration makes its tables")

    def make_partitions_ahead(self, now_unix_s: float) -> None:
        """Make this month and the next one before they are needed: a long query may hold them up for its time, and then copying waits.

        Raises StoreError; where somebody reads for longer than a moment, the next call tries again.
        """
        self._see_partitions()  # somebody may have taken empty ones away
        with suppress(DataRefused):
            for table in PARTITIONED:
                self.make_partitions(table, (now_unix_s, now_unix_s + 31.0 * DAY_S), patience_s=1)

    def make_partitions(self, table: str, times_unix_s: Iterable[float], patience_s: int = 5) -> None:
        """Make the months of these times, where the database has partitions and lacks them. In a transaction of its own.

        patience_s : for which a reader of the table is waited for, and everybody else waits behind us; 0: for ever. Raises DataRefused
        where somebody reads for longer, e.g. pg_dump.
        """
        if not self.postgresql:
            return
        for year, month in sorted({_month(at) for at in times_unix_s}):
            name = f"{table}_{year:04d}_{month:02d}"
            if name in self._partitions or not FIRST_MONTH <= (year, month) < LAST_MONTH:
                continue
            begin, end = (datetime(year + (month + k - 1) // 12, (month + k - 1) % 12 + 1, 1, tzinfo=UTC).isoformat() for k in (0, 1))
            try:
                self._make_partition(table, name, begin, end, patience_s)
            except DatabaseUnavailable as error:
                if not error.locked:
                    raise
                raise DataRefused(f"{self.name}: somebody reads {table} for more than {patience_s} s, and its new month waits") from None
            self._partitions.add(name)

    def _make_partition(self, table: str, name: str, begin: str, end: str, patience_s: int) -> None:
        with self._writing, self.write() as connection:
            connection.execute(sa.text(f"SET LOCAL lock_timeout = '{patience_s}s'"))
            connection.execute(sa.text(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE"))
            if connection.execute(sa.text(f"SELECT to_regclass('{name}')")).scalar_one() is None:
                connection.execute(sa.text(f"CREATE TABLE {name} (LIKE {table})"))
                # rows that came while there was no such month lie with those of broken clocks, and would hold it up
                within = f"{PARTITIONED[table]} >= '{begin}' AND {PARTITIONED[table]} < '{end}'"
                moved = f"DELETE FROM {table}_other WHERE {within} RETURNING *"  # noqa: S608 - fixed names
                connection.execute(sa.text(f"WITH moved AS ({moved}) INSERT INTO {name} SELECT * FROM moved"))  # noqa: S608
                connection.execute(sa.text(f"ALTER TABLE {table} ATTACH PARTITION {name} FOR VALUES FROM ('{begin}') TO ('{end}')"))

    def drop_empty_partitions(self) -> None:
        """Take away the months that hold nothing any more. One that somebody reads at this moment stays; nobody is held up."""
        if not self.postgresql:
            return
        self._see_partitions()
        for name in sorted(self._partitions):
            table = name.partition("_")[0]
            try:
                with self.write() as connection:
                    connection.execute(sa.text("SET LOCAL lock_timeout = '1s'"))
                    connection.execute(sa.text(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE"))
                    if connection.execute(sa.text(f"SELECT 1 FROM {name} LIMIT 1")).first() is None:  # noqa: S608
                        connection.execute(sa.text(f"DROP TABLE {name}"))
            except DatabaseUnavailable as error:
                if not error.locked:
                    raise
        self._see_partitions()

    def _see_partitions(self) -> None:
        """Learn which months there are."""
        if not self.postgresql:
            return
        months = "SELECT c.relname FROM pg_inherits i JOIN pg_class c ON c.oid = i.inhrelid WHERE i.inhparent = to_regclass(:of)"
        with self.read() as connection:
            found = [name for table in PARTITIONED for name in connection.execute(sa.text(months), {"of": table}).scalars()]
        self._partitions = {name for name in found if not name.endswith("_other")}

    def forget(self) -> None:
        """Close idle connections, and know nothing of partitions: the server may have come back with another content."""
        self._partitions.clear()
        self._engine.dispose()

    def _said(self, error: sa.exc.SQLAlchemyError) -> str:
        """The sentence of a database that cannot be worked with now."""
        orig = getattr(error, "orig", None)
        if self._file is not None and isinstance(orig, sqlite3.Error) and getattr(orig, "sqlite_errorcode", 1) != sqlite3.SQLITE_ERROR:
            return str(refused_by(orig, self._file))
        return f"{self.name}: {_sentence(error)}"

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Errors of the driver as errors of ours, in a sentence."""
        try:
            yield
        except (
            sa.exc.OperationalError,
            sa.exc.InterfaceError,
            sa.exc.ProgrammingError,
            sa.exc.InternalError,
            sa.exc.TimeoutError,
        ) as error:
            unavailable = DatabaseUnavailable(self._said(error))
            unavailable.locked = getattr(getattr(error, "orig", None), "sqlstate", None) == LOCK_NOT_AVAILABLE
            raise unavailable from None
        except (sa.exc.DataError, sa.exc.IntegrityError, OverflowError) as error:
            raise DataRefused(f"{self.name}: {_sentence(error)}") from None
        except sa.exc.DBAPIError as error:
            if error.connection_invalidated:
                raise DatabaseUnavailable(f"{self.name}: {_sentence(error)}") from None
            damaged = "malformed" in str(error) or "not a database" in str(error)
            what = "; move the file away, and everything comes back from the arms; the audit is in the newest backup" if damaged else ""
            raise StoreError(f"{self.name}: {_sentence(error)}{what}") from error


def _sentence(error: Exception) -> str:
    """What the driver says, in one line and without a password."""
    said = str(getattr(error, "orig", None) or error)
    line = "; ".join(part.strip() for part in said.splitlines() if part.strip() and "Multiple connection attempts" not in part)
    return _PASSWORD.sub(lambda match: f"{match[1] or match[2]}***", line)[:300] or type(error).__name__


def _month(at_unix_s: float) -> tuple[int, int]:
    at = datetime.fromtimestamp(at_unix_s, UTC)
    return at.year, at.month


def _encoded(document: Any) -> str:
    """A document as JSON. A figure without a value becomes null, as JSON knows no other."""
    return orjson.dumps(document).decode()


def _as_server(patience_s: int) -> Callable[[Any, Any], None]:
    """What a connection begins with, whatever the server, the database or the user has as default.

    Times are read and figures come back as they went in. A server that hangs, or a lock that somebody holds, ends in an error that can
    be told.
    """
    patience = f"; SET statement_timeout = '{patience_s}s'" if patience_s else ""

    def begin(connection: Any, _: Any) -> None:
        with connection.cursor() as cursor:
            cursor.execute(SESSION + patience)
        connection.commit()

    return begin


def _as_embedded(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # the driver would begin transactions by itself, and late
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin(connection: sa.Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE" if connection.get_execution_options().get("writes") else "BEGIN")
