"""Attacks on the plant's screen that are no act of the matrix: what stays open, what headers and addresses carry, names of people."""

import http.client
import socket
import time

import pytest
from plant_screen import Browser, PlantOfATest
from starlette.requests import Request

from monitor.plant.screen.access import robot_of
from monitor.plant.screen.people import Person, Role, person_of_proxy
from monitor.plant.screen.settings import ScreenSettings

SICK = "hall-1/cell-2"
LIVE = f"/arms/{SICK}/api/live"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    with PlantOfATest(tmp_path_factory.mktemp("plant"), roles=("look", "move")) as made:
        yield made


def raw(plant, *lines):
    """The first line of the answer to a request as bytes: a client of ours would refuse to send it."""
    host, port = plant.url.removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port)), timeout=20.0) as way:
        way.sendall("\r\n".join([*lines, "Connection: close", "", ""]).encode())
        return way.makefile("rb").readline().decode()


def opened(browser, **headers):
    """A stream of live values, and its status."""
    connection = http.client.HTTPConnection(browser.at, timeout=20)
    connection.request("GET", LIVE, headers={**browser.headers, **headers})
    return connection, connection.getresponse()


def test_a_stream_that_is_open_ends_when_its_person_is_taken_out(tmp_path):
    """Out at once: the live values of the arm as well, and only of that person."""
    with PlantOfATest(tmp_path, roles=("look", "move")) as plant:
        browsers = {role: Browser(plant.url) for role in ("look", "move")}
        assert [browser.sign_in(plant.tokens[role]) for role, browser in browsers.items()] == [303, 303]
        (connection, stream), (other, kept) = (opened(browser) for browser in browsers.values())
        assert [stream.fp.readline() != b"", kept.fp.readline() != b""] == [True, True]
        lines = (tmp_path / "users").read_text().splitlines()
        (tmp_path / "users").write_text(f"{lines[1]}\n")
        begun = time.monotonic()
        while stream.fp.readline():  # until the server ends it
            assert time.monotonic() - begun < 6.0
        begun, heard = time.monotonic(), []
        while b"event: time\r\n" not in heard and b"event: time\n" not in heard:  # the other one is told the time every five seconds
            heard.append(kept.fp.readline())
            assert time.monotonic() - begun < 15.0
        connection.close()
        other.close()


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_foreign_page_opens_no_stream(tmp_path, site):
    """It could read nothing of it, and take every place of those who look."""
    with PlantOfATest(tmp_path) as plant:  # of this machine, where nobody signs in
        assert Browser(plant.url).ask("GET", LIVE, **{"Sec-Fetch-Site": site})[0] == 403
        connection, stream = opened(Browser(plant.url), **{"Sec-Fetch-Site": "same-origin"})
        assert stream.status == 200
        connection.close()


def test_a_host_that_carries_a_path_moves_no_refusal_to_another_arm(plant):
    """The audit names the arm of the address by which the request was routed."""
    browser = Browser(plant.url)
    browser.sign_in(plant.tokens["look"])
    host = f"Host: {browser.at}/arms/hall-2/cell-1"
    raw(plant, f"POST /arms/{SICK}/api/cmd/replay HTTP/1.1", host, f"Cookie: {browser.headers['Cookie']}", "Content-Length: 0")
    assert plant.audit()[-1][:3] == ("looker", "replay", SICK)
    assert plant.link.asked == []
    # also where the framework takes the Host into the address, as some of its versions do
    scope = {"type": "http", "scheme": "http", "server": ("127.0.0.1", 80), "path": f"/arms/{SICK}/api/cmd/ack", "query_string": b""}
    assert robot_of(Request({**scope, "headers": [(b"host", b"a/arms/hall-2/cell-1")]})) == SICK


@pytest.mark.parametrize("address", ["%1B[2J%0Aaudit who='ada'", "%E2%80%AEkca", "x" * 9000], ids=["terminal", "turned round", "long"])
@pytest.mark.parametrize("signed_in", [True, False])
def test_an_address_writes_nothing_of_its_own_into_audit_and_journal(plant, caplog, address, signed_in):
    """No sign that moves a terminal or turns a text round, and no text without end; also of somebody who is not signed in."""
    browser = Browser(plant.url)
    if signed_in:
        browser.sign_in(plant.tokens["look"])
    address = address.replace(" ", "%20")
    caplog.set_level("INFO")
    for path in (f"/arms/{SICK}/api/cmd/{address}", f"/arms/hall-1/{address}/api/cmd/ack"):
        caplog.clear()
        before = len(plant.audit())
        assert browser.ask("POST", path)[0] in {401, 403, 404}
        for _, act, robot, text in plant.audit()[before:]:
            assert f"{act}{robot or ''}{text}".isprintable()
            assert len(act) <= 40
            assert robot in (None, SICK)
        assert all(
            record.getMessage().isprintable() and len(record.getMessage()) < 2200
            for record in caplog.records
            if record.name.startswith("monitor")
        )


@pytest.mark.parametrize(
    "lines",
    [
        ["X_Forwarded_User: ada"],
        ["x-forwarded-user : ada"],
        [" X-Forwarded-User: ada"],
        ["X-Forwarded-User: ada", "X-Forwarded-User: ada"],
        ["X-Forwarded-Groups: chiefs"],
        ["Connection: X-Forwarded-User", "Forwarded: for=127.0.0.1;by=ada"],
        ["X-Forwarded-User:"],
    ],
)
def test_a_header_that_a_proxy_does_not_take_out_names_nobody(tmp_path, lines):
    """Written otherwise than the proxy writes it, said twice, empty, or groups alone."""
    settings = ScreenSettings(listen="127.0.0.1:0", proxies=("127.0.0.1",), proxy_roles=("ada=configure", "chiefs=configure"))
    with PlantOfATest(tmp_path, settings) as plant:
        host = plant.url.removeprefix("http://").rstrip("/")
        assert " 200 " in raw(plant, "GET /api/v1/audit HTTP/1.1", f"Host: {host}", "X-Forwarded-User: ada")
        answer = raw(plant, "GET /api/v1/audit HTTP/1.1", f"Host: {host}", *lines)
        assert any(f" {status} " in answer for status in (400, 401)), answer


def test_whoever_calls_himself_as_a_group_is_called_has_not_its_role():
    """In many directories people choose their own names."""
    roles = ScreenSettings(proxies=("127.0.0.1",), proxy_roles=("group:mechanics=acknowledge", "user:ada=move", "guests=look")).roles()
    assert person_of_proxy(["mechanics"], [], roles, None) is None
    assert person_of_proxy(["eve"], ["ada"], roles, None) is None
    assert person_of_proxy(["group:mechanics", "user:ada"], ["user:ada", "group:mechanics"], roles, None) is None
    assert person_of_proxy(["eve"], ["mechanics"], roles, None) == Person("eve", Role.acknowledge)
    assert person_of_proxy(["ada"], [], roles, None) == Person("ada", Role.move)
    roles = ScreenSettings(
        proxies=("127.0.0.1",), proxy_roles=("bo=acknowledge@a,b", "bo=move@b", "cy=move@a", "group:cy=acknowledge")
    ).roles()
    assert person_of_proxy(["bo"], [], roles, None) == Person("bo", Role.look, {"a": Role.acknowledge, "b": Role.move})
    assert person_of_proxy(["cy"], ["cy"], roles, None) == Person("cy", Role.acknowledge, {"a": Role.move})
    assert person_of_proxy(["guests"], [], roles, None) == person_of_proxy(["guests"], ["guests"], roles, None)


@pytest.mark.parametrize("length", ["both", "twice", "chunks"])
def test_a_request_within_a_request_is_not_carried_out(plant, length):
    """What a proxy and the screen could read as two different requests: two lengths, or a length and chunks."""
    browser, asked = Browser(plant.url), len(plant.link.asked)
    browser.sign_in(plant.tokens["move"])
    inner = "\r\n".join(
        [f"POST /arms/{SICK}/api/cmd/replay HTTP/1.1", f"Host: {browser.at}", f"Cookie: {browser.headers['Cookie']}",
         f"Origin: http://{browser.at}", f"X-Page-Token: {plant.server.screen._access.page_token}", "Content-Type: application/json",
         "Content-Length: 2", "", "{}"]
    )  # fmt: skip
    heads = {
        "both": ["Content-Length: 4", "Transfer-Encoding: chunked"],
        "twice": ["Content-Length: 0", f"Content-Length: {len(inner)}"],
        "chunks": ["Transfer-Encoding: chunked, identity"],
    }
    body = f"{len(inner):x}\r\n{inner}\r\n0\r\n\r\n" if length == "both" else inner
    host, port = browser.at.split(":")
    with socket.create_connection((host, int(port)), timeout=20.0) as way:
        way.sendall("\r\n".join(["POST /login HTTP/1.1", f"Host: {browser.at}", *heads[length], "", body]).encode())
        way.settimeout(2.0)
        try:
            while way.recv(65536):
                pass
        except TimeoutError:
            pass
    assert len(plant.link.asked) == asked
    with socket.create_connection((host, int(port)), timeout=20.0) as way:  # alone, the same bytes are a request that is carried out
        way.sendall(inner.encode())
        assert b" 200 " in way.makefile("rb").readline()
    assert len(plant.link.asked) == asked + 1
