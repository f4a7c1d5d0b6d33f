"""A lock beside the plant's database that one process alone has, and that ends with it: also by kill -9, and with its machine. I/O."""

import fcntl
import os
from contextlib import ExitStack, suppress

import sqlalchemy as sa

from monitor.errors import StoreError, StoreUnavailable
from monitor.plant.database import Database

# the server notices within 20 s that the machine of a session is gone; its own default is two hours
NOTICES = "SET tcp_keepalives_idle = 5; SET tcp_keepalives_interval = 5; SET tcp_keepalives_count = 3"


class OnlyOne:
    """The lock: of PostgreSQL for a session of its own, of a file beside SQLite. `take` again and again is cheap."""

    def __init__(self, database: Database, what: str, key: int) -> None:
        """`what` : plant or gateway. key : of PostgreSQL's advisory lock."""
        self._database, self._what, self._key = database, what, key
        self._held = ExitStack()
        self._file: int | None = None
        self._connection: sa.Connection | None = None

    def take(self) -> bool:
        """Take the lock, or see that it is still ours; False where another process has it. Raises StoreUnavailable."""
        return self._take_of_server() if self._database.postgresql else self._file is not None or self._take_of_file()

    def release(self) -> None:
        """Give it back."""
        with suppress(StoreError, sa.exc.SQLAlchemyError):
            self._held.close()
        self._file = self._connection = None

    def _take_of_file(self) -> bool:
        path = f"{self._database.file}.{self._what}.lock"
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        except OSError as error:
            raise StoreUnavailable(f"{path}: cannot be made: {error.strerror}") from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            return False
        self._file = handle
        self._held.callback(os.close, handle)
        return True

    def _take_of_server(self) -> bool:
        if self._connection is not None:
            try:
                self._connection.execute(sa.text("SELECT 1"))
                self._connection.rollback()
                return True
            except sa.exc.SQLAlchemyError:  # its lock ended with the connection
                self.release()
        stack = ExitStack()
        try:
            connection = stack.enter_context(self._database.session())
            connection.execute(sa.text(NOTICES))
            got = connection.execute(sa.text("SELECT pg_try_advisory_lock(:key)"), {"key": self._key}).scalar_one()
            connection.commit()  # the lock is the session's: an open transaction would only keep old rows from being cleaned
        except BaseException as error:
            with suppress(sa.exc.SQLAlchemyError):
                stack.close()
            if isinstance(error, sa.exc.SQLAlchemyError):
                raise StoreUnavailable(
                    f"{self._database.name}: the connection was lost while the lock of the {self._what} was asked for"
                ) from None
            raise
        if not got:
            stack.close()
            return False
        self._held, self._connection = stack, connection
        return True
