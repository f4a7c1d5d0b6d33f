"""The computing process, which `apart` starts: it computes one thing, sends the results, and ends."""

import logging
import pickle
import sys
from typing import Any, NoReturn

from monitor.acquire.child import bind_to_parent, leave, leave_if_orphaned
from monitor.errors import MonitorError
from monitor.service.processes.apart import FAILED, LENGTH, RESULT, ComputingFailed

log = logging.getLogger(__name__)


def main() -> NoReturn:
    """Compute what standard input says. The arguments name the pipe for the results, and the parent."""
    bind_to_parent()
    leave_if_orphaned(int(sys.argv[2]))
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s %(message)s")
    with open(int(sys.argv[1]), "wb") as results:

        def send(kind: int, value: Any) -> None:
            data = pickle.dumps((kind, value), pickle.HIGHEST_PROTOCOL)
            results.write(LENGTH.pack(len(data)) + data)
            results.flush()

        try:
            function, args, kwargs, in_steps = pickle.load(sys.stdin.buffer)  # noqa: S301 - from our own parent
            for result in function(*args, **kwargs) if in_steps else (function(*args, **kwargs),):
                send(RESULT, result)
        except MonitorError as error:
            send(FAILED, error)
        except Exception as error:  # the parent says what was not computed; the log says why
            log.exception("a computation met a fault")
            send(FAILED, ComputingFailed(f"internal: {type(error).__name__}: {error}"))
    leave(0)  # no destructor of a library holds it up


if __name__ == "__main__":
    main()
