"""The screen and its server: the list of all arms, sign-in, the interface, and below /arms/SITE/ROBOT/ the page of each arm."""

import asyncio
import json
import threading
import time
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.types import Receive, Scope, Send

from monitor.errors import BadInput, StoreError
from monitor.plant.arm import ArmName
from monitor.plant.database import Database
from monitor.plant.ingest import add_audit
from monitor.plant.screen.access import PlantAccess
from monitor.plant.screen.arm_page import ArmContent, Ways
from monitor.plant.screen.fleet import Fleet
from monitor.plant.screen.interface import Interface
from monitor.plant.screen.people import printable
from monitor.plant.screen.settings import ScreenSettings
from monitor.publish.session import prefix
from monitor.publish.timestamps import rfc3339
from monitor.views.language.catalogue import LANGUAGES
from monitor.views.web.app import STATIC, WRONG_TOKEN_DELAY_S, PageApp, read_body
from monitor.views.web.server import WebServer, log
from monitor.views.web.worded import Worded, with_headers

OWN_STATIC = {"plant.js": "text/javascript", "plant.css": "text/css"}
OPEN_ARMS = 100  # pages of arms that are kept; the one that was looked at longest ago is dropped for a further one


class Screen:
    """The application. `served` is what a server serves; setting `closing` ends every stream."""

    def __init__(self, database: Database, ways: Ways, access: PlantAccess, named_language: str) -> None:
        """`named_language` : setting [screen] language."""
        self._database, self._ways, self._access, self._named = database, ways, access, named_language
        self._fleet = Fleet(database)
        self._arms: dict[ArmName, tuple[PageApp, ArmContent]] = {}
        self._left: list[ArmContent] = []  # of pages that are no longer kept, until they receive nothing
        self._arms_lock = threading.Lock()
        self.closing = threading.Event()
        own, shared = files("monitor.plant.screen").joinpath("static"), files("monitor.views.web").joinpath("static")
        static = {name: (own.joinpath(name).read_bytes(), kind) for name, kind in OWN_STATIC.items()}
        static |= {name: (shared.joinpath(name).read_bytes(), kind) for name, kind in STATIC.items()}
        self._pages = Worded(static, named_language)
        self._index = own.joinpath("plant.html").read_text("utf-8")
        self._login = shared.joinpath("login.html").read_text("utf-8")
        self.served = Interface(database, self._fleet, ways, access, self._pages, self.closing).application()
        self.served.router.routes += [
            Route("/", self._page),
            Route("/login", self._sign_in, methods=["GET", "POST"]),
            Route("/static/{name}", self._pages.file),
            Route("/words/{code}.js", self._pages.words),
            Mount("/arms/{site}/{robot}", app=self._arm),
        ]

    def rest(self) -> None:
        """Stop receiving from arms that nobody looks at."""
        for _, content in list(self._arms.values()):
            content.live.rest()
        for content in list(self._left):
            if not content.live.rest():
                self._left.remove(content)

    async def _page(self, request: Request) -> Response:
        if (refusal := await self._refusal(request)) is not None:
            return refusal
        person = self._access.person(request)
        about = {
            "who": person.name if person else "",
            "role": person.role.name if person else "",
            "sites": {site: role.name for site, role in person.sites.items()} if person else {},
            "named": person is not None and self._access.names_people,
            "languages": LANGUAGES,
        }
        try:
            arms = await asyncio.to_thread(self._fleet.document, self._pages.language(request).code)
        except StoreError as error:
            arms = json.dumps(
                {"not_running": self._pages.language(request).say(error.reason), "ways": {}, "said_at": rfc3339(time.time()), "arms": []}
            ).encode()
        # the list stands in the page: the first view needs no second question
        page = self._pages.in_words(self._index, request).replace("%CSRF%", self._access.page_token)
        page = page.replace("%ABOUT%", _as_data(json.dumps(about, ensure_ascii=False))).replace("%ARMS%", _as_data(arms.decode()))
        return with_headers(Response(page, media_type="text/html"))

    async def _sign_in(self, request: Request) -> Response:
        if request.method != "POST":
            return with_headers(RedirectResponse("/", status_code=303))
        if not (self._access.has_tokens and self._access.knows_host(request) and self._access.same_origin(request)):
            return with_headers(Response("not from here", status_code=403))
        given = parse_qs((await read_body(request) or b"").decode("utf-8", "replace")).get("token", [""])[0].strip()
        response = RedirectResponse("/", status_code=303)
        if not await asyncio.to_thread(self._access.sign_in, given, request, response):
            await asyncio.sleep(WRONG_TOKEN_DELAY_S)
            page = self._pages.in_words(self._login, request).replace("hidden", "", 1)
            return with_headers(Response(page, status_code=401, media_type="text/html"))
        return with_headers(response)

    async def _arm(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One arm's page, made at the first look."""
        place = scope["path_params"]
        request = Request(scope, receive)
        response = await self._refusal(request)
        if response is None:
            try:
                page = await asyncio.to_thread(self._arm_page, _named(place))
            except KeyError:
                response = with_headers(Response("no such arm", status_code=404))
            except StoreError as error:
                response = with_headers(Response(str(error), status_code=503))
            else:
                await page.starlette(scope, receive, send)
                return
        await response(scope, receive, send)

    def _arm_page(self, name: ArmName) -> PageApp:
        with self._arms_lock:
            if name in self._arms:
                page, content = self._arms.pop(name)
            else:
                content = ArmContent(name, self._database, self._ways, self._access.audit, self._named)
                page = PageApp(content, self._access, f"/arms/{name.site}/{name.robot}", self.closing)
            self._arms[name] = page, content
            while len(self._arms) > OPEN_ARMS:
                self._left.append(self._arms.pop(next(iter(self._arms)))[1])
            return page

    async def _refusal(self, request: Request) -> Response | None:
        """The answer to whoever may not look; None: he may."""
        if not self._access.knows_host(request):
            return with_headers(Response("this name is not this screen's", status_code=421))
        if self._access.signed_in(request):
            return None
        if request.method == "POST":
            await asyncio.to_thread(self._access.refused, request, request.url.path.rpartition("/")[2], None, "nobody is signed in")
        if request.method == "GET" and not request.url.path.startswith("/api/") and self._access.has_tokens:
            return with_headers(Response(self._pages.in_words(self._login, request), status_code=401, media_type="text/html"))
        return with_headers(JSONResponse({"error": self._access.unknown}, status_code=401))


def _named(place: Mapping[str, str]) -> ArmName:
    """The arm of an address. Raises KeyError where no arm can have such a name."""
    try:
        prefix(place["site"], place["robot"])
    except BadInput:
        raise KeyError(place["robot"]) from None
    return ArmName(place["site"], place["robot"])


def _as_data(text: str) -> str:
    """JSON inside of a script element: nothing in it may end the element."""
    return text.replace("<", "\\u003c")


# --- The screen's HTTP server, in a thread of the plant

LONGEST_TEXT = 2000  # of a line of the audit; a reason that a person types has some hundred letters


class ScreenServer(WebServer):
    """A context manager; it serves until the context ends. `url` is the screen's address."""

    def __init__(self, settings: ScreenSettings, folder: Path, database: Database, ways: Ways) -> None:
        """Begin to serve. folder : from which relative names of files start.

        Raises as `errors.cannot_listen`, BadInput where the file of users cannot be read.
        """
        host, port = settings.address()
        super().__init__(settings.listen, host, port, "screen")
        try:
            access = PlantAccess(settings, folder, self.port, lambda *line: _note(database, *line))
        except BaseException:
            self.__exit__()
            raise
        if settings.believes_this_machine:
            log.warning("screen: proxies holds an address of this machine, and there is no proxy_secret: each process here can be anybody")
        self.screen = Screen(database, ways, access, settings.language)
        self.serve(self.screen.served, self.screen.closing, "" if settings.knows_people else " (everybody of this machine)")


def _note(database: Database, who: str, act: str, robot: str | None, text: str) -> None:
    """One line of the audit; it also stands in the journal, where the database may be away."""
    text = text[:LONGEST_TEXT]
    log.info("audit who=%r act=%s robot=%s: %s", who, act, robot, printable(text))
    try:
        with database.write() as connection:
            add_audit(connection, time.time(), who, act, robot, text)
    except StoreError as error:
        log.error("trouble=audit: the line above is not in the database: %s", error, extra={"trouble": "audit"})
