"""The plant's interface for programs, /api/v1: what the screen reads and sends as well, with its OpenAPI document. I/O.

Each operation names the role that it needs; one that names none cannot be added. An error is a problem (RFC 9457).
"""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from decimal import Decimal
from http import HTTPStatus
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Depends, FastAPI, Header, Path, Query, Security
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from fastapi.security import HTTPBearer
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, create_model, model_validator
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response

from monitor.errors import BadInput, StoreError
from monitor.plant.arm import ArmName, HeardArm
from monitor.plant.database import Database
from monitor.plant.screen import answers
from monitor.plant.screen.access import INTERFACE, PlantAccess, bearer, robot_of
from monitor.plant.screen.answers import ROBOT, SITE, AlertsAsked, Asked, AuditAsked, HistoryAsked, Problem
from monitor.plant.screen.arm_page import Ways, send
from monitor.plant.screen.events import PERIOD_S, Feed, Transition
from monitor.plant.screen.fleet import Fleet, Tickets, shown_alert, shown_arm
from monitor.plant.screen.people import NEEDED, Role
from monitor.plant.status import PlantStatus
from monitor.plant.tables import FIGURES, LIFE_FIGURES, audit, friction
from monitor.publish.documents import Answer, JointState
from monitor.publish.queries import Who
from monitor.publish.registry import KINDS
from monitor.publish.shown import person as person_of
from monitor.publish.timestamps import rfc3339, written_if
from monitor.views.language.catalogue import Language
from monitor.views.web.app import MAX_BODY_BYTES, MAX_STREAMS, WRONG_TOKEN_DELAY_S, read_body
from monitor.views.web.worded import Worded, with_headers

PROBLEM = "application/problem+json"
ROLE = "x-role"  # of an operation, in the OpenAPI document as well
TIMES_UNIX_S = (-62_135_596_800.0, 253_402_300_799.0)  # of the years 1 to 9999: what every database can hold
REFUSED = {
    401: "Nobody is known: a token, or a session of the screen, is needed.",
    403: "Who is known may not do this.",
    404: "There is no such arm.",
    421: "The name of the host is not this screen's.",
    422: "The request is none.",
    503: "The database does not answer, or no place for a stream is left.",
}
NOT_SENT = {
    400: "The body cannot be read.",
    409: "The arm refuses it, or does not answer.",
    413: "The body is too long.",
    415: "The body is no JSON.",
}
SiteName = Annotated[str, Path(pattern="^[a-z0-9_-]{1,100}$", examples=[SITE], description="as in the arm's configuration")]
RobotName = Annotated[str, Path(pattern="^[a-z0-9_-]{1,100}$", examples=[ROBOT], description="as in the arm's configuration")]
JointNumber = Annotated[int, Path(ge=1, le=8, examples=[3], description="from 1, counted from the base")]


def problem(status: int, detail: str, errors: list[str] | None = None, headers: Any = None) -> Response:
    """The answer to what came to nothing."""
    said = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, errors=errors or [])
    return with_headers(JSONResponse(said.model_dump(), status_code=status, media_type=PROBLEM, headers=headers))


class Guarded(APIRoute):
    """An operation for those who have its role: who asks is known before anything of the request is read."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **settings: Any) -> None:
        """Raises KeyError where the operation says no role."""
        self.needs = Role[settings["openapi_extra"][ROLE]]
        super().__init__(path, endpoint, **settings)

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The handler behind the guard."""
        answer = super().get_route_handler()

        async def guarded(request: Request) -> Response:
            await self._refuse(request.app.state.access, request)
            say = request.app.state.pages.language(request)
            try:
                if request.method == "POST":
                    await _read(request)
                return with_headers(await answer(request))
            except RequestValidationError as error:
                mistakes = [f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()]
                await self._note(request, "; ".join(mistakes))
                return problem(422, "; ".join(mistakes), mistakes)
            except HTTPException as error:
                await self._note(request, error.detail)
                raise
            except BadInput as error:
                return problem(409, say.say(error.reason))
            except StoreError as error:
                return problem(503, say.say(error.reason))

        return guarded

    async def _note(self, request: Request, why: str) -> None:
        """Note a command that is none."""
        if request.method == "POST":
            await asyncio.to_thread(request.app.state.access.note, request, str(self.operation_id), why)

    async def _refuse(self, access: PlantAccess, request: Request) -> None:
        """Raises HTTPException where whoever asks may not; it is noted."""
        act = str(self.operation_id)
        if not access.knows_host(request):
            raise HTTPException(421, "this name is not this screen's")
        token = bearer(request)
        if access.person(request) is None:
            if token is not None:
                await asyncio.to_thread(access.wrong_token, request, token)
                await asyncio.sleep(WRONG_TOKEN_DELAY_S)
            if request.method == "POST":
                await asyncio.to_thread(access.refused, request, act, robot_of(request), "nobody is signed in")
            raise HTTPException(401, access.unknown, {"WWW-Authenticate": "Bearer"})
        if (why := await asyncio.to_thread(access.lacks, request, self.needs, act)) is not None:
            raise HTTPException(403, why)
        if request.method == "POST" and not (access.by_token(request) or access.from_page(request)):
            why = "commands come from the page itself, or with a token: Authorization: Bearer TOKEN"
            await asyncio.to_thread(access.note, request, act, why)
            raise HTTPException(403, why)


class Interface:
    """The operations."""

    def __init__(self, database: Database, fleet: Fleet, ways: Ways, access: PlantAccess, pages: Worded, closing: threading.Event) -> None:
        self._database, self._fleet, self._ways, self._access = database, fleet, ways, access
        self._pages, self._closing = pages, closing
        self._feed, self._streams = Feed(database), 0

    def application(self) -> FastAPI:
        """An application with these operations; pages may be added to it."""
        app = FastAPI(
            title="The plant of joint-monitor", version="1", openapi_url="/api/openapi.json", docs_url=None, redoc_url=None,
            description="Friction health of many robot arms: what the plant's screen reads and sends. docs/interface.md explains it.",
        )  # fmt: skip
        app.state.access, app.state.pages = self._access, self._pages
        app.router.route_class = Guarded
        arm, joint = "/arms/{site}/{robot}", "/arms/{site}/{robot}/joints/{joint}"
        _add(app, "/arms", "listArms", self.arms, answers.Arms)
        _add(app, arm, "readArm", self.arm, answers.Arm)
        _add(app, f"{arm}/joints", "listJoints", self.joints, answers.Joints)
        _add(app, f"{joint}/history", "readHistory", self.history, answers.History)
        _add(app, f"{joint}/peers", "listPeers", self.peers, answers.Peers)
        _add(app, "/alerts", "listAlerts", self.alerts, answers.Alerts)
        _add(app, "/audit", "readAudit", self.audit, answers.Audit, needs=Role.configure)
        _add(app, "/events", "streamEvents", self._events(), None, response_class=EventSourceResponse)
        for command, role in NEEDED.items():
            if role < Role.move:  # what moves an arm is asked for by a person, at the screen or at the arm
                kind = next(each for each in KINDS.values() if f"cmd/{command}" in each.keys)
                _add(app, f"{arm}/{command}", command, self._command(command, kind.model), Answer, needs=role, methods=["POST"],
                     summary=kind.when, description=kind.model.__doc__)  # fmt: skip
        app.add_exception_handler(HTTPException, _other)
        app.add_exception_handler(Exception, _other)
        app.openapi = lambda: _described(app)  # type: ignore[method-assign]
        return app

    # --- what is read

    def arms(self, request: Request, asked: Annotated[Asked, Query()]) -> Response:  # noqa: ARG002 - of the document
        """Every arm, the worst first. At most half a minute old."""
        packs = "gzip" in request.headers.get("accept-encoding", "")
        body = self._fleet.document(self._say(request).code, packed=packs)
        headers = {"Content-Encoding": "gzip", "Vary": "Accept-Encoding"} if packs else {"Vary": "Accept-Encoding"}
        return Response(body, media_type="application/json", headers=headers)

    def arm(self, request: Request, site: SiteName, robot: RobotName, asked: Annotated[Asked, Query()]) -> Any:  # noqa: ARG002
        """One arm with its active alerts."""
        found, status, tickets = self._arm(site, robot)
        return shown_arm(found, tickets, status.at_unix_s, self._say(request))

    def joints(self, request: Request, site: SiteName, robot: RobotName, asked: Annotated[Asked, Query()]) -> Any:  # noqa: ARG002
        """The joints of an arm: how each is, and its newest friction."""
        say = self._say(request)
        found, _, _ = self._arm(site, robot)
        newest = self._fleet.newest(found)
        said = {each.joint: each for each in found.joints}
        return {
            "joints": [
                {
                    "joint": joint,
                    "pill": said[joint].shown.pill.value if joint in said else None,
                    "why": say.say(said[joint].shown.why) if joint in said else "",
                    "since": _since(said[joint].said if joint in said else None),
                    "age": (said[joint].shown if joint in said else found.shown).age.value,
                    "newest": _replay(newest[joint]) if joint in newest else None,
                }
                for joint in sorted({*said, *newest})
            ]
        }

    def history(self, site: SiteName, robot: RobotName, joint: JointNumber, asked: Annotated[HistoryAsked, Query()]) -> Any:
        """The friction of a joint after each replay, the oldest first: those of the arm's present history."""
        found, _, _ = self._arm(site, robot)
        wanted = sa.select(friction).where(friction.c.arm == found.number, friction.c.history == found.histories, friction.c.joint == joint)
        if asked.since is not None:
            wanted = wanted.where(friction.c.recorded_at >= asked.since.timestamp())
        if asked.until is not None:
            wanted = wanted.where(friction.c.recorded_at < asked.until.timestamp())
        if asked.cursor is not None:
            text, _, replay = asked.cursor.partition("/")
            at = min(max(float(text), TIMES_UNIX_S[0]), TIMES_UNIX_S[1])
            after = (friction.c.recorded_at == at) & (friction.c.replay > int(replay))
            wanted = wanted.where((friction.c.recorded_at > at) | after)
        with self._database.read() as connection:
            rows = connection.execute(wanted.order_by(friction.c.recorded_at, friction.c.replay).limit(asked.limit + 1)).all()
        more = len(rows) > asked.limit
        rows = rows[: asked.limit]
        cursor = f"{Decimal(repr(rows[-1].recorded_at)):f}/{rows[-1].replay}" if more else None
        return {"replays": [_replay(row) for row in rows], "next_cursor": cursor}

    def peers(self, site: SiteName, robot: RobotName, joint: JointNumber, asked: Annotated[Asked, Query()]) -> Any:  # noqa: ARG002
        """The last figures of this joint and of the same joint of every arm of its model."""
        return self._fleet.peers(self._arm(site, robot)[0], joint)

    def alerts(self, request: Request, asked: Annotated[AlertsAsked, Query()]) -> Any:
        """The active alerts of all arms."""
        say = self._say(request)
        status, tickets = self._fleet.read()
        found = []
        for arm in status.arms:
            if asked.site not in (None, arm.name.site) or asked.robot not in (None, arm.name.robot):
                continue
            now = arm.clock(status.at_unix_s)
            for each in arm.alerts:
                if asked.tier in (None, each.tier) and asked.state in (None, person_of(each, now).value):
                    found.append(((*arm.name, each.joint or 0, each.condition), arm, each))
        found.sort(key=lambda one: one[0])
        if asked.cursor is not None:
            site, robot, joint, condition = asked.cursor.split("/")
            found = [one for one in found if one[0] > (site, robot, int(joint), condition)]
        page = found[: asked.limit]
        return {
            "alerts": [
                {
                    **arm.name._asdict(),
                    **shown_alert(each, tickets.get((str(arm.name), each.joint, each.condition)), arm.clock(status.at_unix_s), say),
                }
                for _, arm, each in page
            ],
            "next_cursor": "/".join(map(str, page[-1][0])) if len(found) > asked.limit else None,
        }

    def audit(self, asked: Annotated[AuditAsked, Query()]) -> Any:
        """Who did what, or was refused it, the newest line first."""
        wanted = sa.select(audit).order_by(audit.c.id.desc()).limit(asked.limit + 1)
        if asked.cursor is not None:
            wanted = wanted.where(audit.c.id < int(asked.cursor))
        with self._database.read() as connection:
            rows = connection.execute(wanted).all()
        more = len(rows) > asked.limit
        rows = rows[: asked.limit]
        lines = [{"at": rfc3339(row.at), "who": row.who, "act": row.act, "robot": row.robot, "text": row.text} for row in rows]
        return {"rows": lines, "next_cursor": str(rows[-1].id) if more else None}

    async def _joins(
        self,
        request: Request,
        last_event_id: Annotated[str | None, Header(max_length=100, description="of the event before the cut")] = None,
    ) -> tuple[str, bool]:
        """Where a stream begins, and whether that is behind Last-Event-ID. Raises HTTPException where it may not begin, StoreError."""
        if request.headers.get("sec-fetch-site") in {"cross-site", "same-site"}:  # it can read nothing, and would take somebody's place
            raise HTTPException(403, "events are for programs and for pages of this very host")
        if self._streams >= MAX_STREAMS:
            raise HTTPException(503, f"{MAX_STREAMS} are listening already")
        if last_event_id is not None and await asyncio.to_thread(self._feed.after, last_event_id) is not None:
            return last_event_id, True
        return await asyncio.to_thread(self._feed.here), False

    def _events(self) -> Callable[..., Any]:
        """The operation that streams."""

        async def events(
            request: Request,
            asked: Annotated[Asked, Query()],  # noqa: ARG001 - of the document
            joined: Annotated[tuple[str, bool], Depends(self._joins)],
        ) -> AsyncIterator[ServerSentEvent]:
            """Transitions of alerts as the plant copies them.

            The first event is `begin`, and says whether everything since Last-Event-ID follows; where not, read the alerts anew.
            """
            say, (place, resumed) = self._say(request), joined
            self._streams += 1
            try:
                yield ServerSentEvent(event="begin", id=place, data={"resumed": resumed})
                while not self._closing.is_set() and self._access.signed_in(request):
                    try:
                        new = await asyncio.to_thread(self._feed.after, place)
                    except StoreError:
                        new = []  # the plant says that it waits for its database
                    if new is None:  # more came at once than is kept
                        return
                    for place, each in new:
                        yield ServerSentEvent(event="transition", id=place, data=_told(each, say))
                    await asyncio.sleep(PERIOD_S)
            finally:
                self._streams -= 1

        return events

    # --- what is sent

    def _command(self, command: str, model: type[BaseModel]) -> Callable[..., Any]:
        """The operation that sends a command to an arm."""

        def sent(request: Request, site: SiteName, robot: RobotName, body: Any, asked: Annotated[Asked, Query()]) -> Response:  # noqa: ARG001
            name = self._arm(site, robot)[0].name
            document = self._access.signed(request, body.model_dump(exclude_unset=True))
            answer = send(self._database, self._ways, self._access.audit, name, command, document)
            return JSONResponse(self._say(request).document(answer))

        # who sends it is known; without people, he says it himself
        whole: dict[str, Any] = {"whole": model_validator(mode="before")(_whole)}
        at_once = {"defer_build": False}  # documents wait for their first use; FastAPI does not
        body = create_model(
            model.__name__, __base__=model, __doc__=model.__doc__, __cls_kwargs__=at_once, __validators__=whole, by=(Who | None, None)
        )
        sent.__annotations__["body"] = body
        return sent

    # --- what both share

    def _say(self, request: Request) -> Language:
        return self._pages.language(request)

    def _arm(self, site: str, robot: str) -> tuple[HeardArm, PlantStatus, Tickets]:
        """An arm of the list. Raises HTTPException where there is none, StoreError."""
        try:
            return self._fleet.arm(ArmName(site, robot))
        except KeyError:
            raise HTTPException(404, "no such arm") from None


async def _read(request: Request) -> None:
    """Read the body of a command. Raises HTTPException where it is too long, or no JSON by what it says of itself."""
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise HTTPException(415, "expected application/json")
    if (body := await read_body(request)) is None:
        raise HTTPException(413, f"expected at most {MAX_BODY_BYTES} bytes, in some seconds")
    request._body = body  # where Starlette keeps it


async def _other(request: Request, error: Exception) -> Response:
    """The answer to what no operation answers: a problem below /api, a line elsewhere."""
    status, detail, headers = 500, "the plant's journal says what went wrong", None
    if isinstance(error, HTTPException):
        status, detail, headers = error.status_code, error.detail, error.headers
    if str(request.scope["path"]).startswith("/api/"):
        return problem(status, detail, headers=headers)
    return with_headers(PlainTextResponse(detail, status_code=status, headers=headers))


def _add(
    app: FastAPI, path: str, name: str, endpoint: Callable[..., Any], model: Any, *, needs: Role = Role.look, methods: Any = ("GET",),
    **more: Any,
) -> None:  # fmt: skip
    """Add an operation."""
    refusals = {**REFUSED, **(NOT_SENT if "POST" in methods else {})}
    said = {status: {"description": text, "content": {PROBLEM: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
            for status, text in sorted(refusals.items()) if status != 404 or "{" in path}  # fmt: skip
    app.add_api_route(
        f"{INTERFACE}{path}", endpoint, methods=list(methods), operation_id=name, response_model=model, responses=said,  # type: ignore[arg-type]
        dependencies=[Security(HTTPBearer(scheme_name="token", auto_error=False))], openapi_extra={ROLE: needs.name}, **more,
    )  # fmt: skip


def _described(app: FastAPI) -> dict[str, Any]:
    """The OpenAPI document, with the type of problems."""
    if app.openapi_schema is None:
        made = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
        made["components"]["schemas"]["Problem"] = Problem.model_json_schema()
        stream = made["paths"][f"{INTERFACE}/events"]["get"]["responses"]["200"]
        stream["content"] = {"text/event-stream": {"schema": {"type": "string"}}}  # FastAPI says it as OpenAPI 3.2 does
        app.openapi_schema = made
    return app.openapi_schema


def _replay(row: Any) -> dict[str, Any]:
    figures = {name: getattr(row, name) for name in (*FIGURES, *LIFE_FIGURES)}
    return {"recorded_at": rfc3339(row.recorded_at), "replay": row.replay, **figures}


def _since(said: JointState | None) -> str | None:
    return None if said is None else written_if(said.since)


def _told(each: Transition, say: Language) -> dict[str, Any]:
    """A transition for a program, its sentence in a language."""
    return {**each._asdict(), "at": rfc3339(each.at_unix_s), "text": say.at(each.document, "text")}


def _whole(body: Any) -> Any:
    """A body with each figure without a fraction as an integer: 3.0 is one in JSON, and none to whoever reads strictly."""
    if not isinstance(body, dict):
        return body
    return {name: int(each) if isinstance(each, float) and each.is_integer() else each for name, each in body.items()}
