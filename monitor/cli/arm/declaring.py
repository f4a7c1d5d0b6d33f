"""What the commands share by which a person says what was done to an arm: while the daemon runs, and without it."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from monitor.cli.options import client_of, refuse_no_time
from monitor.errors import BadInput, BusError, StoreError, StoreInUse

if TYPE_CHECKING:
    from monitor.config.schema import Configuration
    from monitor.publish.client import Client
    from monitor.publish.documents import Answer


def check_words(by: str, why: str, at: str | None, *, undo: bool) -> None:
    """Raises BadInput, before any history or daemon is asked: --by or --why is empty, --at stands beside --undo, or is no time."""
    for option, text in (("--by", by), ("--why", why)):
        if not text.strip():
            raise BadInput(f"{option} is empty: it is kept in the history, and somebody will ask")
    if undo and at is not None:
        raise BadInput("--at and --undo: a mistake is taken back as a whole; expected one of them")
    if at is not None:
        refuse_no_time("--at", at)


def declared(
    configuration: "Configuration", offline: Callable[[float], dict[str, Any]], asked: Callable[["Client"], "Answer"], nothing_yet: str
) -> dict[str, Any]:
    """The answer of `offline`, which writes into the history where no daemon runs on it, at a time since 1970; else `asked` on the bus.

    nothing_yet : what it means that there is no history, for the message. Raises BadInput, BusError, StoreError.
    """
    from monitor.service.monitor_document import present_unix_s, read_monitor_document
    from monitor.store.backup import present

    where, refused = configuration.state_directory, None
    try:
        if present(where):
            return offline(present_unix_s(read_monitor_document(where), time.time()))  # a trial that is over has its own time
    except StoreError as error:  # a daemon has it, or this user may not write it: the daemon can be asked
        refused = error
    try:
        with client_of(configuration) as client:
            return asked(client).model_dump(mode="json")
    except BusError:
        if refused is None:
            raise StoreError(f"{where}: no history yet{nothing_yet}") from None
        if isinstance(refused, StoreInUse):
            raise
        raise refused from None
