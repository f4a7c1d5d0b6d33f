"""The Robot API of a PolyScope X over plain sockets: what the others ask the dashboard server.

HTTP is read and written by h11, because no client of the standard library or of the house has one time limit for a whole answer, also
where it comes in drops. Each question has a connection of its own. No proxy is asked. A redirect is followed on the same server only: a
`stop` must not reach another robot.

Endpoints by version: programs from 10.11 on; modes, control and the loaded program from 10.12 on; model and serial number from 10.14 on.
What a version does not have is answered 404, and counts as not reported.
"""

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
from monitor.reason import Sentence

PORT = 80
BASE = "/universal-robots/robot-api"
PROGRAM, CONTROL, OPERATION = "/program/v1/state", "/system/v1/controlmode", "/system/v1/operationalmode"
SAFETY, INFORMATION = "/robotstate/v1/safetymode", "/system/v1/information"
LONGEST_ANSWER = 262_144  # bytes; an answer about a mode has some tens
MOST_REDIRECTS = 3
REDIRECTS = frozenset({301, 302, 307, 308})
SAID_MAX = 200  # characters of what the controller says that are told


API = "{host}: the Robot API on port {port}"
NO_ROBOT_API = Sentence("no_robot_api", "{host}: no Robot API on port {port} ({why})")
NO_ANSWER = Sentence("robot_api_no_answer", API + " does not answer ({why})")
NO_HTTP = Sentence("robot_api_no_http", API + " does not speak HTTP: {why}")
NO_PROGRAMS = Sentence("robot_api_no_programs", API + " answers 404: PolyScope X has a Robot API from 10.11 on")
NO_OBJECT = Sentence("robot_api_no_object", API + " answers {path} with something else than a JSON object: {said}")
UNKNOWN_WORD = Sentence("robot_api_unknown_word", API + " says {word!r} for {path}; expected {expected}")
WORD_MISSING = Sentence("robot_api_word_missing", API + " does not say {key!r} for {path}: {said}")
REFUSES = Sentence("robot_api_refuses", API + " refuses {method} {path} with {status}{said}")
ASKS_FOR_PASSWORD = Sentence("robot_api_asks_for_password", API + " refuses {method} {path} with {status}: it asks for a password{said}")
FORBIDDEN = Sentence(
    "robot_api_forbids", API + " refuses {method} {path} with {status}: it is in local control, or forbids this address{said}"
)
TOO_MANY_REDIRECTS = Sentence("robot_api_redirects", API + " redirects {path} more than {most} times")
ELSEWHERE = Sentence("robot_api_elsewhere", API + " sends us elsewhere, to {location}; it is not followed")


class Said(NamedTuple):
    """One answer: the status of HTTP, the body, and where to ask instead."""

    status: int
    body: bytes
    location: str = ""


class Refused(RobotUnreachable):
    """The Robot API answers, and does not do or tell what it is asked for."""


class RobotApi:
    """The questions to one controller.

    Every method raises RobotUnreachable where the controller does not answer in time or not as a Robot API does.
    """

    def __init__(self, host: str, timeout_s: float = 2.0, *, port: int = PORT) -> None:
        self._host, self._timeout_s, self._port = host, timeout_s, port
        self._at = {"host": host, "port": port}

    def __enter__(self) -> Self:
        self.program()  # whatever answers here must be a Robot API
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open between two questions."""

    def program(self) -> tuple[str, str | None]:
        """PLAYING, PAUSED, STOPPED or another word; the API does not name the program that plays."""
        state = self._word(PROGRAM, "state")
        if state is None:
            raise RobotUnreachable(NO_PROGRAMS(**self._at))
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

    def _one_of(self, path: str, meanings: dict[str, bool]) -> bool | None:
        word = self._word(path, "mode")
        if word is None:
            return None
        if word not in meanings:  # a mode that nobody knows is not taken for a mode that is not told
            raise RobotUnreachable(UNKNOWN_WORD(**self._at, word=word[:SAID_MAX], path=path, expected=" or ".join(meanings)))
        return meanings[word]

    def _word(self, path: str, key: str) -> str | None:
        """The word that the answer has under this key, in capitals; None where this version has no such endpoint."""
        said = self._ask("GET", path)
        if said.status == 404:
            return None
        word = self._document(self._accept(said, "GET", path), path).get(key)
        if not isinstance(word, str) or not word:
            raise RobotUnreachable(WORD_MISSING(**self._at, key=key, path=path, said=_printable(said.body)))
        return word.upper()

    def _accept(self, said: Said, method: str, path: str) -> Said:
        """The answer itself. Raises Refused where it is no success."""
        if 200 <= said.status < 300:
            return said
        refusal = {401: ASKS_FOR_PASSWORD, 403: FORBIDDEN}.get(said.status, REFUSES)
        raise Refused(refusal(**self._at, method=method, path=path, status=said.status, said=_reason(said.body)))

    def _document(self, said: Said, path: str) -> dict[str, Any]:
        document = _object(said.body)
        if document is None:
            raise RobotUnreachable(NO_OBJECT(**self._at, path=path, said=_printable(said.body)))
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
        raise RobotUnreachable(TOO_MANY_REDIRECTS(**self._at, path=path, most=MOST_REDIRECTS))

    def _place(self, target: str, location: str) -> str:
        """Where to ask instead of this target. Raises RobotUnreachable where that is no place on the same server."""
        try:
            place = urlsplit(urljoin(f"http://{self._host}:{self._port}{target}", location))
            same = location.isascii() and (place.scheme, place.hostname, place.port or 80) == ("http", self._host, self._port)
        except ValueError:  # it is no address
            same = False
        if not same:
            raise RobotUnreachable(ELSEWHERE(**self._at, location=_printable(location.encode())))
        return place.path + (f"?{place.query}" if place.query else "")

    def _exchange(self, method: str, target: str, body: bytes, until: float) -> Said:
        """One request and its answer, over a connection of its own: nothing is ever sent on one that the controller may have closed."""
        host = self._host if self._port == PORT else f"{self._host}:{self._port}"
        headers = [("Host", host), ("Accept", "application/json"), ("Connection", "close")]
        if body:
            headers += [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        http = h11.Connection(h11.CLIENT)
        request = [h11.Request(method=method, target=target, headers=headers), *([h11.Data(data=body)] if body else []), h11.EndOfMessage()]
        try:
            connection = socket.create_connection((self._host, self._port), timeout=max(until - time.monotonic(), 1e-3))
        except OSError as error:
            raise NobodyListens(NO_ROBOT_API(host=self._host, port=self._port, why=str(error))) from None
        with connection:
            try:
                connection.sendall(b"".join(http.send(part) or b"" for part in request))
                return self._answer(http, connection, until)
            except h11.ProtocolError as error:
                raise RobotUnreachable(NO_HTTP(**self._at, why=str(error))) from None
            except OSError as error:
                raise RobotUnreachable(NO_ANSWER(**self._at, why=str(error))) from None

    def _answer(self, http: h11.Connection, connection: socket.socket, until: float) -> Said:
        """The answer on the connection. Raises OSError, ProtocolError where it is none within the time."""
        status, location, body, heard = 0, "", b"", False
        while True:
            match http.next_event():
                case h11.NEED_DATA:
                    left_s = until - time.monotonic()
                    if left_s <= 0.0:
                        raise TimeoutError(f"no whole answer within {self._timeout_s:g} s")
                    connection.settimeout(left_s)
                    data = connection.recv(65_536)
                    if not data and not heard:
                        raise OSError("it closed the connection without an answer")
                    heard = True
                    http.receive_data(data)
                case h11.Response() as response:
                    status = response.status_code
                    location = next((value.decode("ascii", "replace") for name, value in response.headers if name == b"location"), "")
                case h11.Data() as part:
                    body += part.data
                    if len(body) > LONGEST_ANSWER:
                        raise OSError(f"its answer is longer than {LONGEST_ANSWER} bytes")
                case h11.EndOfMessage():
                    return Said(status, body, location)
                case h11.ConnectionClosed() | h11.PAUSED:
                    raise OSError("its answer ends too early")


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
