"""The Robot API of a PolyScope X over a plain socket: what the others ask the dashboard server.

HTTP is read and written by h11. Each question has one time limit for all of it, also where the answer comes in drops. No proxy is asked. A
redirect is followed on the same server only: a `stop` must not reach another robot.

Endpoints by version: programs from 10.11 on; modes, control and the loaded program from 10.12 on; model and serial number from 10.14 on.
What a version does not have is answered 404, and counts as not reported.
"""

import contextlib
import json
import re
import socket
import time
from typing import Any, NamedTuple, Self
from urllib.parse import urljoin, urlsplit

import h11

from monitor.acquire.state import Identity
from monitor.acquire.ur.dashboard import NobodyListens
from monitor.errors import RobotUnreachable

PORT = 80
BASE = "/universal-robots/robot-api"
PROGRAM, CONTROL, OPERATION = "/program/v1/state", "/system/v1/controlmode", "/system/v1/operationalmode"
SAFETY, INFORMATION = "/robotstate/v1/safetymode", "/system/v1/information"
LONGEST_ANSWER = 262_144  # bytes; an answer about a mode has some tens
MOST_REDIRECTS = 3
REDIRECTS = frozenset({301, 302, 307, 308})
SAID_MAX = 200  # characters of what the controller says that are told


class Said(NamedTuple):
    """One answer: the status of HTTP, the body, and where to ask instead."""

    status: int
    body: bytes
    location: str = ""


class Refused(RobotUnreachable):
    """The Robot API answers, and does not do or tell what it is asked for."""


class RobotApi:
    """One conversation over one connection, which is opened again where the controller has closed it.

    Every method raises RobotUnreachable where the controller does not answer in time or not as a Robot API does.
    """

    def __init__(self, host: str, timeout_s: float = 2.0, *, port: int = PORT) -> None:
        self._host, self._timeout_s, self._port = host, timeout_s, port
        self._socket: socket.socket | None = None
        self._http = h11.Connection(h11.CLIENT)

    def __enter__(self) -> Self:
        try:
            self.program()  # whatever answers here must be a Robot API
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def program(self) -> tuple[str, str | None]:
        """PLAYING, PAUSED, STOPPED or another word; the API does not name the program that plays."""
        state = self._word(PROGRAM, "state")
        if state is None:
            raise RobotUnreachable(f"{self._name} answers 404: PolyScope X has a Robot API from 10.11 on")
        return state, None

    def remote_control(self) -> bool | None:
        """Whether the controller takes commands over the network; None where its version does not say."""
        return self._one_of(CONTROL, {"REMOTE": True, "LOCAL": False})

    def automatic(self) -> bool | None:
        """Whether the controller is in automatic mode; None where its version does not say."""
        return self._one_of(OPERATION, {"AUTOMATIC": True, "MANUAL": False})

    def safety_mode(self) -> str | None:
        """The safety mode in capitals; None where its version does not say."""
        return self._word(SAFETY, "mode")

    def stop(self) -> None:
        """Stop the program that runs; without effect where none does. Raises Refused where the controller does not take it."""
        said = self._ask("PUT", PROGRAM, {"action": "stop"})
        if said.status != 409:  # in conflict with its state: no program runs
            self._accept(said, "PUT", PROGRAM)

    def identity(self) -> Identity:
        """Remote control and operational mode; model and serial number where its version tells them. It does not tell its software."""
        said = self._ask("GET", INFORMATION)
        information = {} if said.status == 404 else self._document(self._accept(said, "GET", INFORMATION), INFORMATION)
        model = re.fullmatch(r"UR\d+e?", str(information.get("robotType") or ""), re.IGNORECASE)
        serial = re.fullmatch(r"\d+", str(information.get("serialNumber") or ""))
        return Identity(
            model=model.group() if model else None,
            serial=serial.group() if serial else None,
            firmware=None,
            remote_control=self.remote_control(),
            automatic=self.automatic(),
            robot_api=True,
        )

    @property
    def _name(self) -> str:
        return f"{self._host}: the Robot API on port {self._port}"

    def _one_of(self, path: str, meanings: dict[str, bool]) -> bool | None:
        word = self._word(path, "mode")
        if word is None:
            return None
        if word not in meanings:  # a mode that nobody knows is not taken for a mode that is not told
            raise RobotUnreachable(f"{self._name} says {word[:SAID_MAX]!r} for {path}; expected {' or '.join(meanings)}")
        return meanings[word]

    def _word(self, path: str, key: str) -> str | None:
        """The word that the answer has under this key, in capitals; None where this version has no such endpoint."""
        said = self._ask("GET", path)
        if said.status == 404:
            return None
        word = self._document(self._accept(said, "GET", path), path).get(key)
        if not isinstance(word, str) or not word:
            raise RobotUnreachable(f"{self._name} does not say {key!r} for {path}: {_printable(said.body)}")
        return word.upper()

    def _accept(self, said: Said, method: str, path: str) -> Said:
        """The answer itself. Raises Refused where it is no success."""
        if 200 <= said.status < 300:
            return said
        why = {401: ": it asks for a password", 403: ": it is in local control, or forbids this address"}.get(said.status, "")
        raise Refused(f"{self._name} refuses {method} {path} with {said.status}{why}{_reason(said.body)}")

    def _document(self, said: Said, path: str) -> dict[str, Any]:
        document = _object(said.body)
        if document is None:
            raise RobotUnreachable(f"{self._name} answers {path} with something else than a JSON object: {_printable(said.body)}")
        return document

    def _ask(self, method: str, path: str, document: dict[str, Any] | None = None) -> Said:
        """The answer to one request, redirects on the same server followed."""
        until = time.monotonic() + self._timeout_s
        target, body = BASE + path, b"" if document is None else json.dumps(document).encode()
        for _ in range(MOST_REDIRECTS + 1):
            said = self._exchange(method, target, body, until)
            if said.status not in REDIRECTS:
                return said
            target = self._place(target, said.location)
        raise RobotUnreachable(f"{self._name} redirects {path} more than {MOST_REDIRECTS} times")

    def _place(self, target: str, location: str) -> str:
        """Where to ask instead of this target. Raises RobotUnreachable where that is no place on the same server."""
        try:
            place = urlsplit(urljoin(f"http://{self._host}:{self._port}{target}", location))
            same = location.isascii() and (place.scheme, place.hostname, place.port or 80) == ("http", self._host, self._port)
        except ValueError:  # it is no address
            same = False
        if not same:
            raise RobotUnreachable(f"{self._name} sends us elsewhere, to {_printable(location.encode())}; it is not followed")
        return place.path + (f"?{place.query}" if place.query else "")

    def _exchange(self, method: str, target: str, body: bytes, until: float) -> Said:
        """One request and its answer.

        A question is asked once more where the connection had been kept open and the controller has closed it meanwhile. A command is not:
        it may have been taken, and whoever sends it must look again at what it would meet. So a connection that has ended is seen before.
        """
        self._close_if_ended()
        kept = self._socket is not None and method == "GET"
        try:
            return self._once(method, target, body, until)
        except _Closed:
            if kept:
                with contextlib.suppress(_Closed):
                    return self._once(method, target, body, until)
            raise RobotUnreachable(f"{self._name} closed the connection without an answer") from None

    def _once(self, method: str, target: str, body: bytes, until: float) -> Said:
        try:
            if self._socket is None:
                self._connect(until)
            assert self._socket is not None
            host = self._host if self._port == PORT else f"{self._host}:{self._port}"
            headers = [("Host", host), ("Accept", "application/json")]
            if body:
                headers += [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
            request = [h11.Request(method=method, target=target, headers=headers), *([h11.Data(data=body)] if body else [])]
            try:
                self._socket.settimeout(max(until - time.monotonic(), 1e-3))
                self._socket.sendall(b"".join(self._http.send(part) or b"" for part in (*request, h11.EndOfMessage())))
            except (ConnectionResetError, BrokenPipeError):
                raise _Closed from None
            said = self._answer(until)
        except h11.ProtocolError as error:
            self._close()
            raise RobotUnreachable(f"{self._name} does not speak HTTP: {error}") from None
        except OSError as error:
            self._close()
            raise RobotUnreachable(f"{self._name} does not answer ({error})") from None
        except BaseException:
            self._close()
            raise
        if self._http.our_state is h11.DONE and self._http.their_state is h11.DONE:
            self._http.start_next_cycle()
        else:
            self._close()
        return said

    def _connect(self, until: float) -> None:
        self._http = h11.Connection(h11.CLIENT)
        try:
            self._socket = socket.create_connection((self._host, self._port), timeout=max(until - time.monotonic(), 1e-3))
        except OSError as error:
            raise NobodyListens(f"{self._host}: no Robot API on port {self._port} ({error})") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _answer(self, until: float) -> Said:
        """The next answer on the connection. Raises _Closed where it ends before the first byte."""
        assert self._socket is not None
        status, location, body, heard = 0, "", b"", False
        while True:
            event = self._http.next_event()
            match event:
                case h11.NEED_DATA:
                    left_s = until - time.monotonic()
                    if left_s <= 0.0:
                        raise TimeoutError(f"no whole answer within {self._timeout_s:g} s")
                    self._socket.settimeout(left_s)
                    try:
                        data = self._socket.recv(65_536)
                    except ConnectionResetError:
                        data = b""
                    if not data and not heard:
                        raise _Closed
                    heard = True
                    self._http.receive_data(data)
                case h11.Response():
                    status = event.status_code
                    location = next((value.decode("ascii", "replace") for name, value in event.headers if name == b"location"), "")
                case h11.Data():
                    body += event.data
                    if len(body) > LONGEST_ANSWER:
                        raise OSError(f"its answer is longer than {LONGEST_ANSWER} bytes")
                case h11.EndOfMessage():
                    return Said(status, body, location)
                case h11.ConnectionClosed() | h11.PAUSED:
                    raise OSError("its answer ends too early")

    def _close_if_ended(self) -> None:
        """Close a connection that the controller has closed, or on which it says what nobody asked for."""
        if self._socket is None:
            return
        self._socket.settimeout(0.0)
        try:
            self._socket.recv(1, socket.MSG_PEEK)
        except BlockingIOError:  # it is open, and silent
            return
        except OSError:
            pass
        self._close()

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None


class _Closed(Exception):
    """The controller has closed the connection before a byte of its answer."""


def _object(body: bytes) -> dict[str, Any] | None:
    """The JSON object in an answer; None where it is something else."""
    try:
        document = json.loads(body)
    except (ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


def _reason(body: bytes) -> str:
    """What the controller says of a refusal, as a part of a sentence; empty where it says nothing that can be told."""
    document = _object(body) or {}
    said = [document[key] for key in ("message", "details") if isinstance(document.get(key), str) and document[key]]
    return f" ({_printable('; '.join(said).encode())})" if said else ""


def _printable(text: bytes) -> str:
    return re.sub(r"[^ -~]", "?", text.decode("utf-8", "replace"))[:SAID_MAX]
