"""The Robot API's port as an asyncio protocol: HTTP/1.1 by h11, one request after the other on a connection."""

import asyncio
import json

import h11

from monitor.simulate.controller.modes import Runtime
from monitor.simulate.polyscope import X
from monitor.simulate.wire.external_control import requested
from monitor.simulate.wire.ports import Port, Ports
from monitor.simulate.wire.robot_api import BASE, BODY_MAX_BYTES, Answer, answer

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
        if self._asks_hosts(method, target):
            self._playing = asyncio.ensure_future(self._play(method, target))
            return
        faulty = self.ports.faults.robot_api
        self._send(FAULTY[faulty] if faulty in FAULTY else answer(self.ports.controller, method, target, self._body))

    def _asks_hosts(self, method: str, target: str) -> bool:
        """Whether this request is a Play that asks other hosts for text."""
        controller = self.ports.controller
        starts = controller.modes.runtime == Runtime.STOPPED and bool(controller.programs.files.hosts)
        return (
            starts and not controller.identity.local and (method, target) == ("PUT", f"{BASE}/program/v1/state") and b'"play"' in self._body
        )

    async def _play(self, method: str, target: str) -> None:
        """Ask the hosts of the loaded program, and play it."""
        files = self.ports.controller.programs.files
        files.serve(await requested(files.hosts, generation=X))
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
