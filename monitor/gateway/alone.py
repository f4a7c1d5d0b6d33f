"""One gateway alone works with a database: two of them would send everything twice. I/O.

Embedded, a lock on a file beside the database; with PostgreSQL, an advisory lock of a connection. Both end with their process.
"""

import fcntl
import os
from contextlib import ExitStack, suppress

import sqlalchemy as sa

from monitor.errors import StoreError, StoreUnavailable
from monitor.plant.database import Database

KEY = 7_447_027  # of the advisory lock


class AnotherGateway(StoreUnavailable):
    """Another gateway works with this database: this one waits for its end."""


class Alone:
    """The lock. `take` again and again is cheap."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._held = ExitStack()
        self._file: int | None = None
        self._connection: sa.Connection | None = None

    def take(self) -> None:
        """Take the lock, or see that it is still ours. Raises AnotherGateway, StoreUnavailable."""
        if self._database.postgresql:
            self._take_of_server()
        elif self._file is None:
            self._take_of_file()

    def release(self) -> None:
        """Give it back."""
        with suppress(StoreError, sa.exc.SQLAlchemyError):
            self._held.close()
        self._file = self._connection = None

    def _take_of_file(self) -> None:
        path = f"{self._database.file}.gateway.lock"
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        except OSError as error:
            raise StoreUnavailable(f"{path}: cannot be made: {error.strerror}") from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            raise AnotherGateway(f"another gateway works with {self._database.name}; nothing is sent here until it ends") from None
        self._file = handle
        self._held.callback(os.close, handle)

    def _take_of_server(self) -> None:
        if self._connection is not None:
            try:
                self._connection.execute(sa.text("SELECT 1"))
                self._connection.rollback()
                return
            except sa.exc.SQLAlchemyError:  # its lock ended with the connection
                self.release()
        stack = ExitStack()
        try:
            connection = stack.enter_context(self._database.session())
            got = connection.execute(sa.text("SELECT pg_try_advisory_lock(:key)"), {"key": KEY}).scalar_one()
            connection.commit()  # the lock is the session's: an open transaction would only keep old rows from being cleaned
        except BaseException as error:
            with suppress(sa.exc.SQLAlchemyError):
                stack.close()
            if isinstance(error, sa.exc.SQLAlchemyError):
                raise StoreUnavailable(
                    f"{self._database.name}: the connection was lost while the lock of the gateway was asked for"
                ) from None
            raise
        if not got:
            stack.close()
            raise AnotherGateway(f"another gateway works with {self._database.name}; nothing is sent here until it ends")
        self._held, self._connection = stack, connection
