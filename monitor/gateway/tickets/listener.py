"""Where acknowledgements of the maintenance system come in: signed webhooks, each carried out once. I/O.

A request is signed as our own messages are (`monitor.gateway.connection`); the arm itself carries it out, and the audit names who asked.
"""

import asyncio
import errno
import socket
import threading
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from monitor.errors import BadInput, StoreError
from monitor.gateway.channel import Channel, Surroundings
from monitor.gateway.connection import Finding, NotReached, Steps, attempted, verified
from monitor.gateway.outbox import DELIVERED
from monitor.gateway.tickets.channel import OPEN, Rest, Tickets
from monitor.gateway.tickets.settings import TicketSettings
from monitor.gateway.values import Delivery, Transition
from monitor.plant.arm import ArmName
from monitor.plant.pull import read_document
from monitor.plant.screen.people import role_named
from monitor.plant.settings import PlantConfiguration
from monitor.publish.queries import Who, Why
from monitor.views.web.app import read_body
from monitor.views.web.server import WebServer
from monitor.views.web.settings import address_of

PATH = "/acknowledge"
LONGEST_NAME = 200  # letters of a webhook-id
Short = Annotated[str, Field(min_length=1, max_length=100)]


class Acknowledge(BaseModel):
    """What is posted: an alert by its ticket's number, or by name; by whom and why."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    ticket: Annotated[str, Field(min_length=1, max_length=200, coerce_numbers_to_str=True)] | None = None
    site: Short | None = None
    robot: Short | None = None
    joint: Annotated[int, Field(ge=1, le=8)] | None = None
    condition: Short | None = None
    by: Who
    why: Why = ""


class Listener:
    """A `Channel` that only listens."""

    name = "acknowledgements"

    def __init__(self, settings: TicketSettings, surroundings: Surroundings) -> None:
        """Nothing is opened before the first step: a taken address is this channel's trouble alone."""
        self._settings, self._surroundings = settings, surroundings
        self._role = role_named(settings.role)
        self._doing = threading.Lock()  # one at a time: the second of two equal ones finds that the first is done
        self._done = 0
        self._server: WebServer | None = None

    def offer(self, transition: Transition) -> Sequence[Delivery]:  # noqa: ARG002 - of Channel
        """Nothing: it only listens."""
        return ()

    def step(self, now_unix_s: float) -> float:  # noqa: ARG002 - of Channel
        """The first one begins to serve; the server has threads of its own. Raises as `errors.cannot_listen`."""
        if self._server is None:
            server = WebServer(self._settings.listen, *address_of(self._settings.listen, "tickets"), "acknowledgements")
            server.serve(Starlette(routes=[Route(PATH, self._acknowledge, methods=["POST"])]), threading.Event())
            self._server = server
        return 60.0

    def status(self) -> str:
        """Where, and how many."""
        return "not listening" if self._server is None else f"listens on {self._server.url}, {self._done} carried out"

    def close(self) -> None:
        """Serve no longer."""
        if self._server is not None:
            self._server.__exit__()

    async def _acknowledge(self, request: Request) -> Response:
        body = await read_body(request)
        if body is None:
            return JSONResponse({"error": "too long, or too slow"}, status_code=413)
        try:
            name = verified(self._settings.webhook_secret, request.headers, body, self._surroundings.now())
        except BadInput as error:
            address = request.client.host if request.client else "?"
            return await asyncio.to_thread(self._refused, f"nobody ({address})", str(error), 401)
        try:
            wanted = Acknowledge.model_validate(read_document(body))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the body"
            return await asyncio.to_thread(self._refused, "tickets", f"{where}: {first['msg']}", 400)
        except ValueError as error:
            return await asyncio.to_thread(self._refused, "tickets", f"the body is no JSON: {error}", 400)
        try:
            return await asyncio.to_thread(self._carried_out, name[:LONGEST_NAME], wanted)
        except StoreError:
            return JSONResponse({"error": "the plant's database does not answer; send it again"}, status_code=503)

    def _carried_out(self, name: str, wanted: Acknowledge) -> Response:
        outbox = self._surroundings.outbox
        with self._doing:
            before = outbox.found(self.name, [name]).get(name)
            if before is not None:
                return JSONResponse({"done": "already", **(before[1] or {})})
            try:
                arm, document = self._alert(wanted)
            except BadInput as error:
                return self._refused(wanted.by, str(error), 409)
            try:
                self._surroundings.commands.send(arm, "ack", document, who=wanted.by, role=self._role, via="tickets")
            except BadInput as error:
                return JSONResponse({"error": str(error)}, status_code=409)
            answer = {"robot": str(arm), "joint": document["joint"], "condition": document["condition"]}
            outbox.note(self.name, Delivery(key=name, recipient=wanted.by, kind="ack", document=answer, robot=str(arm)), DELIVERED, answer)
            self._done += 1
            return JSONResponse({"done": "acknowledged", **answer})

    def _refused(self, who: str, why: str, code: int) -> Response:
        """Say it, and note it: whoever looks for a lost acknowledgement finds it in the audit."""
        self._surroundings.commands.audit(who, "ack", None, f"by tickets: refused: {why}")
        return JSONResponse({"error": why}, status_code=code)

    def _alert(self, wanted: Acknowledge) -> tuple[ArmName, dict[str, Any]]:
        """Which alert is meant. Raises BadInput where there is none."""
        if wanted.ticket is not None:
            for owed in self._surroundings.outbox.answered("tickets", OPEN):
                if isinstance(owed.answer, Mapping) and owed.answer.get("number") == wanted.ticket:
                    said = owed.document
                    return ArmName(said["site"], said["robot"]), {"joint": said["joint"], "condition": said["condition"], "why": wanted.why}
            raise BadInput(f"ticket {wanted.ticket} is none of ours")
        if not (wanted.site and wanted.robot and wanted.condition):
            raise BadInput("expected ticket, or site, robot and condition, with joint where it is one joint's")
        return ArmName(wanted.site, wanted.robot), {"joint": wanted.joint, "condition": wanted.condition, "why": wanted.why}


def channels(settings: TicketSettings, surroundings: Surroundings) -> Sequence[Channel]:
    """The tickets, and what listens for acknowledgements where it is configured. Raises BadInput, BadConfiguration without httpx."""
    return [Tickets(settings, surroundings), *([Listener(settings, surroundings)] if settings.listen else [])]


def check(settings: TicketSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """How far tickets get, and whether acknowledgements can be listened for. No ticket is opened."""

    def walk(steps: Steps) -> None:
        rest = Rest(settings, plant.folder)
        try:
            rest.try_it(settings, steps)
        finally:
            rest.close()

    return [
        *attempted("tickets", walk),
        *(attempted("acknowledgements", lambda steps: _try_address(settings, steps)) if settings.listen else []),
    ]


def _try_address(settings: TicketSettings, steps: Steps) -> None:
    """Whether somebody could listen there. Raises NotReached."""
    host, port = address_of(settings.listen, "tickets")
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise NotReached("address", f"{settings.listen}: {error.strerror}: is it an address of this host?") from None
        steps.say("address", f"{settings.listen}: {error.strerror}: the gateway that runs has it, or another program")
        return
    steps.say("address", f"{settings.listen} is free: the gateway does not run yet")
