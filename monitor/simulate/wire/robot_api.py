"""The Robot API of a PolyScope X: one request of HTTP in, a status and a JSON document out.

It has what a dashboard server has been used for: programs, power, stops and modes. In local control, whatever acts is refused. What the
simulated controller cannot do (import, update and download of programs, support files) is not there.
Sources: the manufacturer's own client for it, and public accounts of the simulated controller that the manufacturer offers. Not verified
on a real controller: the version of the API in 10.11, the words of the messages, and which refusals are 409.
"""

import asyncio
import json
from collections.abc import Callable
from typing import Any, NamedTuple

import h11

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.state import RobotMode, Runtime, SafetyMode
from monitor.simulate.polyscope import robot_api_of
from monitor.simulate.wire.ports import Port, Ports

BASE = "/universal-robots/robot-api"
BODY_MAX_BYTES = 65_536
DEFAULT_PROGRAM = "Default program"  # what is loaded at first
PROGRAM_SUFFIX = ".urp"  # of the files that a simulated controller holds; the API names programs without one
MODES_SINCE, INFORMATION_SINCE = (3, 1, 4), (5, 0, 107)  # versions of the API
REMOTE_ONLY = "the robot must be in remote control"
SAFETY_MODES = {SafetyMode.ROBOT_EMERGENCY_STOP: "EMERGENCY_STOP", SafetyMode.SAFEGUARD_STOP: "PROTECTIVE_STOP"}  # the API has fewer words


class Answer(NamedTuple):
    """Status of HTTP, and what is said; `location` is where the client shall ask instead."""

    status: int
    document: dict[str, Any]
    location: str = ""


def answer(controller: Controller, method: str, target: str, body: bytes) -> Answer:
    """The answer to one request."""
    path = target.partition("?")[0]
    version = robot_api_of(controller.settings.polyscope)
    assert version is not None
    if not path.startswith(BASE):
        return _not_found(path)
    place = path.removeprefix(BASE).rstrip("/")
    if (method, place) == ("PUT", "/program/v1/load") and version >= MODES_SINCE:
        return Answer(307, {"message": "moved"}, f"{BASE}/program/v1/loaded")
    methods = {of: act for (of, at), (since, act) in ENDPOINTS.items() if at == place and since <= version and _still(place, version)}
    if not methods:
        return _not_found(path)
    if method not in methods:
        return Answer(405, {"message": f"Method not allowed; allowed are {', '.join(sorted(methods))}"})
    if method == "GET":
        return methods[method](controller, {})
    if controller.identity.local:
        return Answer(403, {"message": "Forbidden", "details": REMOTE_ONLY})
    try:
        asked = json.loads(body or b"null")
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        return _invalid("the body is not a JSON object")
    return methods[method](controller, asked)


def _still(place: str, version: tuple[int, ...]) -> bool:
    """Whether an endpoint has not been replaced by another one."""
    return not (place == "/program/v1/load" and version >= MODES_SINCE)


def _not_found(path: str) -> Answer:
    return Answer(404, {"message": f"{path[:200]} is not known"})


def _invalid(why: str) -> Answer:
    return Answer(422, {"message": "Validation error", "details": why})


def _conflict(why: str) -> Answer:
    return Answer(409, {"message": "Conflict", "details": why})


def _openapi(controller: Controller, _: dict[str, Any]) -> Answer:
    version = robot_api_of(controller.settings.polyscope) or ()
    paths: dict[str, dict[str, Any]] = {}
    for (method, place), (since, _act) in ENDPOINTS.items():
        if since <= version and _still(place, version):
            paths.setdefault(place, {})[method.lower()] = {"responses": {"200": {"description": "done"}}}
    return Answer(200, {"openapi": "3.1.0", "info": {"title": "Robot API", "version": ".".join(map(str, version))}, "paths": paths})


def _program_state(controller: Controller, _: dict[str, Any]) -> Answer:
    return Answer(200, {"state": controller.modes.runtime.name, "message": "ok", "details": None})


def _act_on_program(controller: Controller, asked: dict[str, Any]) -> Answer:
    programs, runtime = controller.programs, controller.modes.runtime
    match asked.get("action"):
        case "play":
            done = runtime == Runtime.STOPPED and programs.play()
        case "pause":
            done = programs.pause()
        case "resume":
            done = runtime == Runtime.PAUSED and programs.play()
        case "stop":
            done = programs.stop("Robot API: stop", by="dashboard")
        case other:
            return _invalid(f"action {other!r}; expected play, pause, resume or stop")
    if not done:
        return _conflict(
            f"{asked['action']} is not possible: the program is {runtime.name}, {controller.modes.obstacle or 'the arm may move'}"
        )
    return _program_state(controller, {})


def _loaded(controller: Controller, _: dict[str, Any]) -> Answer:
    return Answer(200, {"name": _loaded_name(controller), "message": "ok"})


def _loaded_name(controller: Controller) -> str:
    files = controller.programs.files
    return files.loaded.removesuffix(PROGRAM_SUFFIX) if files.program is not None else DEFAULT_PROGRAM


def _load(key: str) -> Callable[[Controller, dict[str, Any]], Answer]:
    """Load the program that this key of the request names."""

    def load(controller: Controller, asked: dict[str, Any]) -> Answer:
        name = asked.get(key)
        if not isinstance(name, str) or not name:
            return _invalid(f"{key} {name!r}; expected the name of a program")
        if controller.modes.runtime != Runtime.STOPPED:
            return _conflict("a program runs")
        if not controller.programs.files.load(f"{name}{PROGRAM_SUFFIX}"):
            return Answer(500, {"message": f"no program {name[:200]!r}"})
        return Answer(200, {"message": "loaded", "name": name})

    return load


def _programs(controller: Controller, _: dict[str, Any]) -> Answer:
    dates = {"createdDate": 0, "lastModifiedDate": None, "lastSavedDate": None}
    names = [name.removesuffix(PROGRAM_SUFFIX) for name in controller.programs.files.names]
    return Answer(
        200, {"programs": [{"name": name, "description": "", "programState": "FINAL", **dates} for name in names], "message": "ok"}
    )


def _act_on_robot(controller: Controller, asked: dict[str, Any]) -> Answer:
    safety, modes = controller.safety, controller.modes
    match asked.get("action"):
        case "POWER_ON":
            done = safety.power(RobotMode.IDLE)
        case "POWER_OFF":
            done = safety.power(RobotMode.POWER_OFF)
        case "BRAKE_RELEASE":
            done = safety.power(RobotMode.RUNNING)
        case "UNLOCK_PROTECTIVE_STOP":  # the manufacturer's own tests unlock within a second of the stop
            done = safety.unlock(after_s=0.0)
        case "RESTART_SAFETY":
            done = False  # nothing here needs it
        case other:
            return _invalid(f"action {other!r}; expected POWER_ON, POWER_OFF, BRAKE_RELEASE, UNLOCK_PROTECTIVE_STOP or RESTART_SAFETY")
    if not done:
        return _conflict(f"{asked['action']} is not possible: robot mode {modes.robot.name}, safety mode {_safety_word(modes.safety)}")
    return Answer(200, {"message": "done"})


def _robot_mode(controller: Controller, _: dict[str, Any]) -> Answer:
    return Answer(200, {"mode": controller.modes.robot.name, "message": "ok"})


def _safety_mode(controller: Controller, _: dict[str, Any]) -> Answer:
    return Answer(200, {"mode": _safety_word(controller.modes.safety), "message": "ok"})


def _safety_word(mode: SafetyMode) -> str:
    return SAFETY_MODES.get(mode, mode.name)


def _control_mode(controller: Controller, _: dict[str, Any]) -> Answer:
    return Answer(200, {"mode": "LOCAL" if controller.identity.local else "REMOTE", "message": "ok"})


def _operational_mode(controller: Controller, _: dict[str, Any]) -> Answer:
    return Answer(200, {"mode": controller.identity.operational_mode, "message": "ok"})


def _versions(controller: Controller, _: dict[str, Any]) -> Answer:
    version = ".".join(map(str, controller.identity.reported_version[:3]))
    return Answer(200, {"marketingVersion": version, "baselineVersion": version})


def _information(controller: Controller, _: dict[str, Any]) -> Answer:
    settings = controller.settings
    return Answer(200, {"robotType": settings.robot.removesuffix("e").upper(), "serialNumber": settings.serial})


ENDPOINTS: dict[tuple[str, str], tuple[tuple[int, ...], Callable[[Controller, dict[str, Any]], Answer]]] = {
    ("GET", "/openapi.json"): ((0,), _openapi),
    ("GET", "/program/v1/state"): ((0,), _program_state),
    ("PUT", "/program/v1/state"): ((0,), _act_on_program),
    ("PUT", "/program/v1/load"): ((0,), _load("programName")),
    ("GET", "/program/v1/loaded"): (MODES_SINCE, _loaded),
    ("PUT", "/program/v1/loaded"): (MODES_SINCE, _load("name")),
    ("GET", "/programs/v1"): (MODES_SINCE, _programs),
    ("PUT", "/robotstate/v1/state"): ((0,), _act_on_robot),
    ("GET", "/robotstate/v1/robotmode"): (MODES_SINCE, _robot_mode),
    ("GET", "/robotstate/v1/safetymode"): (MODES_SINCE, _safety_mode),
    ("GET", "/system/v1/controlmode"): (MODES_SINCE, _control_mode),
    ("GET", "/system/v1/operationalmode"): (MODES_SINCE, _operational_mode),
    ("GET", "/versions/v1"): (INFORMATION_SINCE, _versions),
    ("GET", "/system/v1/information"): (INFORMATION_SINCE, _information),
}


# --- The Robot API's port as an asyncio protocol: HTTP/1.1 by h11, one request after the other on a connection ---

ELSEWHERE = "http://127.255.255.254/universal-robots/robot-api/program/v1/state"  # where a faulty API sends its clients
FAULTY = {  # by the fault's argument
    "unauthorized": Answer(401, {"message": "Unauthorized", "details": "a password is needed"}),
    "forbidden": Answer(403, {"message": "Forbidden", "details": "not from this address"}),
    "failing": Answer(500, {"message": "Internal server error"}),
    "elsewhere": Answer(307, {"message": "moved"}, ELSEWHERE),
}


class RobotApiPort(Port):
    """One connection of a client of the Robot API."""

    service = "robot_api"

    def __init__(self, ports: Ports) -> None:
        super().__init__(ports)
        self._http = h11.Connection(h11.SERVER)
        self._request: h11.Request | None = None
        self._body = b""
        self._playing: asyncio.Future[None] | None = None  # a Play that waits for the hosts of its program

    def data_received(self, data: bytes) -> None:
        """Answer each request that is complete."""
        if self.writable is None or self.ports.faults.mute or self.ports.dead or self.ports.faults.robot_api == "silent":
            return
        self._http.receive_data(data)
        try:
            self._answer_all()
        except h11.ProtocolError:
            if self.transport is not None:
                self.transport.abort()

    def _answer_all(self) -> None:
        """Take what has come. Raises h11.ProtocolError where it is no HTTP."""
        while self.writable is not None:
            event = self._http.next_event()
            match event:
                case h11.NEED_DATA | h11.PAUSED | h11.ConnectionClosed():
                    return
                case h11.Request():
                    self._request, self._body = event, b""
                case h11.Data():
                    self._body += event.data
                    if len(self._body) > BODY_MAX_BYTES:
                        raise h11.RemoteProtocolError("the body is too long")
                case h11.EndOfMessage():
                    assert self._request is not None
                    self._answer(self._request.method.decode(), self._request.target.decode("ascii", "replace"))

    def _answer(self, method: str, target: str) -> None:
        if self.must_ask_hosts and (method, target) == ("PUT", f"{BASE}/program/v1/state") and b'"play"' in self._body:
            self._playing = asyncio.ensure_future(self._play(method, target))
            return
        faulty = self.ports.faults.robot_api
        self._send(FAULTY[faulty] if faulty in FAULTY else answer(self.ports.controller, method, target, self._body))

    async def _play(self, method: str, target: str) -> None:
        """Ask the hosts of the loaded program, and play it."""
        await self.ask_hosts()
        if self.writable is not None:
            self._send(answer(self.ports.controller, method, target, self._body))
            self._answer_all()

    def _send(self, said: Answer) -> None:
        transport = self.writable
        assert transport is not None
        garbage = self.ports.faults.robot_api == "garbage"
        body = b"<html>this is no JSON" if garbage else json.dumps(said.document).encode()
        headers = [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        if said.location:
            headers.append(("Location", said.location))
        sent = (
            self._http.send(h11.Response(status_code=said.status, headers=headers)),
            self._http.send(h11.Data(data=body)),
            self._http.send(h11.EndOfMessage()),
        )
        transport.write(b"".join(part for part in sent if part))
        if self._http.our_state is h11.DONE and self._http.their_state is h11.DONE:
            self._http.start_next_cycle()
        else:
            transport.close()
