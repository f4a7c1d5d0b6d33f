"""The page's server: who may see the page, who may command, that years of history are quick, that no client can hold it up."""

import http.client
import json
import re
import socket
import sqlite3
import threading
import time
import tomllib
from contextlib import ExitStack
from pathlib import Path

import pytest
from lived_monitor import DAY_S, FIRST_UNIX_S, configuration, grow, monitor
from published import raw

from monitor.errors import BadConfiguration, BadInput
from monitor.publish.documents import as_json
from monitor.publish.registry import KINDS
from monitor.views.web.app import COMMANDS, STATIC
from monitor.views.web.page_content import columns, thinned
from monitor.views.web.settings import PageSettings
from monitor.views.web.worded import HEADERS

pytestmark = pytest.mark.xdist_group("page")
TOKEN = "correct horse battery staple"


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The page of an arm with forty days of history; its joint 3 wears."""
    with monitor(tmp_path_factory.mktemp("life"), days=40, moving=False) as (server, daemon, store):
        yield server, daemon, store


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guarded")
    (folder / "token").write_text(TOKEN + "\n")
    with monitor(folder, days=0, settings=configuration(folder, token_file="token"), moving=False) as (server, _, _):
        yield server


def ask(server, path, method="GET", body=None, **headers):
    host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)
    connection = http.client.HTTPConnection(host, int(port), timeout=60)
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, names)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), content


def origin(server):
    return server.url.rstrip("/")


def token_of(server, **headers):
    return re.search(rb'name="page-token" content="([^"]+)"', ask(server, "/", **headers)[2]).group(1).decode()


def command(server, name, document, **changed):
    headers = {"Origin": origin(server), "X_Page_Token": token_of(server), "Content_Type": "application/json"} | changed
    return ask(server, f"/api/cmd/{name}", "POST", json.dumps(document), **{k: v for k, v in headers.items() if v is not None})


def test_everything_the_page_needs_comes_from_here(served):
    """Every file that the page names is served, with a policy that forbids every other source."""
    server, _, _ = served
    status, headers, page = ask(server, "/")
    assert status == 200
    for name, value in HEADERS.items():
        assert headers[name.lower()] == value
    assert "default-src 'self'" in headers["content-security-policy"]
    named = set(re.findall(rb'(?:src|href)="([^"#]+)"', page))
    assert len(named) >= 7
    for path in named:
        if path in {b"/", b"/report?lang=en", b"/history.csv"}:  # links for a person, which the page itself does not need
            continue
        assert path.startswith((b"/static/", b"/words/")), path
        assert ask(server, path.decode())[0] == 200, path
    for name in STATIC:
        text = ask(server, f"/static/{name}")[2]
        assert not re.search(rb"""(?:src|href|fetch\(|import|url\()\s*=?\s*["'(]?https?://""", text), name
    assert b"MIT License" in ask(server, "/static/uPlot.LICENSE.txt")[2]
    for path in ("/static/../server.py", "/static/%2e%2e/server.py", "/static/page.js.bak", "/etc/passwd"):
        assert ask(server, path)[0] == 404


def test_the_history_comes_as_columns(served):
    """There are as many times as replays and a column for each figure of each joint; only the wearing joint has worn."""
    server, _, store = served
    past = json.loads(ask(server, "/api/history")[2])
    assert past["replays"] == past["shown"] == len(past["t"]) == len(store.assessments.replays()) == 38  # two windows were skipped
    assert set(past["joints"]) == set("123456")
    assert past["joints"]["3"]["wear"][-1] > 0.1
    assert max(abs(past["joints"][j]["wear"][-1]) for j in "12456") < 0.05
    schedule = json.loads(ask(server, "/api/schedule")[2])
    assert schedule["coming"] == sorted(schedule["coming"], key=lambda window: window["opens"]) != []
    assert any(row["state"] == "skipped" and "door" in row["reason"] for row in schedule["windows"])
    assert any(event["kind"] == "raised" and event["joint"] == 3 for event in schedule["events"])
    own = json.loads(ask(server, "/api/monitor")[2])
    assert own["disk_free_gb"] > 0
    assert own["resident_mb"] > 10


def test_the_stream_sends_the_values_of_the_bus(served):
    """The first events are the last values of the bus; a later value comes within a second."""
    server, daemon, _ = served
    host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)
    connection = http.client.HTTPConnection(host, int(port), timeout=10)
    connection.request("GET", "/api/live")
    stream = connection.getresponse()
    assert stream.getheader("content-type").startswith("text/event-stream")

    def next_value():
        while (line := stream.readline()) != b"event: value\n":
            assert line
        key, _, document = stream.readline()[6:].partition(b" ")
        return json.loads(key), json.loads(document)

    last = {key: as_json(document) for key, document in daemon.bus.last_values().items()}
    shown = dict(next_value() for _ in last)
    said = shown["alert/j3/wear_rising"].pop("said")
    assert shown["alert/j3/wear_rising"].pop("pill") == shown["health"].pop("shown")["pill"] == shown["health"].pop("pills")["3"]
    assert said["headline"] == "Elbow turns 24\u00a0% heavier than on 1 June."
    assert shown == last
    daemon.monitor.next_due(1.9e9)
    key, document = next_value()
    assert key == "health"
    assert document["next_replay_due"] == "2030-03-17T17:46:40Z"
    connection.close()


def test_a_stream_sends_the_monitors_time_again_and_again(served, monkeypatch):
    """The clock comes also without a new value on the bus, so a page notices a lost connection."""
    monkeypatch.setattr("monitor.views.web.app.CLOCK_PERIOD_S", 0.3)
    server, _, _ = served
    host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)
    connection = http.client.HTTPConnection(host, int(port), timeout=10)
    connection.request("GET", "/api/live")
    stream, times = connection.getresponse(), []
    while len(times) < 2:
        if stream.readline() == b"event: time\n":
            times.append(int(stream.readline()[6:]))
    assert times[0] == times[1] == pytest.approx(1000 * (FIRST_UNIX_S + 40 * DAY_S))  # the clock of the fixture does not move
    connection.close()


def test_a_person_acknowledges_through_the_same_code_as_the_bus(served):
    """The alert's document, the stored event and the answer name the person; a second person finds what the first one wrote."""
    server, daemon, store = served
    before = store.events.range()[1]
    status, _, answer = command(server, "ack", {"joint": 3, "condition": "wear_rising", "by": "Ada", "why": "grease is ordered"})
    assert status == 200
    assert json.loads(answer)["alert"]["acknowledged_by"] == "Ada"
    assert daemon.bus.last_values()["alert/j3/wear_rising"].acknowledged_why == "grease is ordered"
    (event,) = store.events.rows(after=before)
    assert event.document["kind"] == "acknowledged"


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"joint": 3, "condition": "wear_rising", "by": ""}, "by"),
        ({"joint": 5, "condition": "wear_rising", "by": "Ada"}, "no active alert j5/wear_rising"),
        ({"joint": 3, "condition": "wear_rising", "by": "Ada", "hours": 3}, "hours"),
        ({}, "condition"),
        ([], "expected a JSON object"),
    ],
)
def test_an_impossible_command_is_answered_with_the_reason(served, document, message):
    """As over the bus, the answer names the field, or the alerts that are active."""
    server, _, _ = served
    status, _, answer = command(server, "ack", document)
    assert status == 409
    assert message in json.loads(answer)["error"]


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(
    "changed",
    [
        {"Origin": "http://evil.example"},
        {"Origin": None},
        {"Origin": "null"},
        {"X_Page_Token": None},
        {"X_Page_Token": "guessed"},
        {"X_Page_Token": "gueßed"},
    ],
)
def test_a_page_of_another_site_cannot_command(served, name, changed):
    """A command with another origin, without one, or without the token that only our page can read is refused; nothing is written."""
    server, _, store = served
    before = store.events.range()
    changed = {key: value if value is None else value.encode("utf-8").decode("latin-1") for key, value in changed.items()}
    asked = {"joint": 3, "condition": "wear_rising", "by": "Eve", "hours": 1}
    assert command(server, name, asked, **changed)[0] == 403
    assert store.events.range() == before


def test_other_requests_that_are_no_commands_are_refused(served):
    """Refused are a body that is not JSON, of another type or too large, an unknown command, and the wrong method."""
    server, _, _ = served
    good = {"Origin": origin(server), "X_Page_Token": token_of(server)}
    assert ask(server, "/api/cmd/ack", "POST", "{", **good, Content_Type="application/json")[0] == 400
    assert ask(server, "/api/cmd/ack", "POST", "[" * 9000, **good, Content_Type="application/json")[0] == 400
    assert ask(server, "/api/cmd/ack", "POST", "{}", **good, Content_Type="text/plain")[0] == 415
    assert ask(server, "/api/cmd/ack", "POST", " " * 30_000, **good, Content_Type="application/json")[0] == 413
    assert ask(server, "/api/cmd/erase", "POST", "{}", **good, Content_Type="application/json")[0] == 404
    assert ask(server, "/api/cmd/ack")[0] == 405


def test_a_foreign_host_name_is_not_served(served):
    """A foreign site may let its own name resolve to 127.0.0.1; the Host header of its requests shows it."""
    server, _, _ = served
    port = server.url.rstrip("/").rsplit(":", 1)[1]
    assert ask(server, "/", Host=f"rebound.example:{port}")[0] == 421
    assert ask(server, "/api/history", Host=f"rebound.example:{port}")[0] == 421
    assert ask(server, "/", Host=f"localhost:{port}")[0] == 200


def test_without_the_token_nothing_is_shown(guarded):
    """This holds for every address except the page's static files; a wrong token takes a second, the right one opens a session."""
    for path in ("/api/about", "/api/history", "/api/schedule", "/api/monitor", "/api/live"):
        assert ask(guarded, path)[0] == 401, path
    status, _, page = ask(guarded, "/")
    assert status == 401
    assert b"Sign in" in page
    assert b"page-token" not in page
    form = {"Origin": origin(guarded), "Content_Type": "application/x-www-form-urlencoded"}
    began = time.monotonic()
    assert ask(guarded, "/login", "POST", "token=wrong", **form)[0] == 401
    assert time.monotonic() - began > 0.9
    typed = "token=" + TOKEN.replace(" ", "+")
    assert ask(guarded, "/login", "POST", typed, **{**form, "Origin": "http://evil.example"})[0] == 403
    status, headers, _ = ask(guarded, "/login", "POST", typed, **form)
    assert status == 303
    cookie = headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    session = cookie.partition(";")[0]
    status, headers, _ = ask(guarded, "/login")
    assert (status, headers["location"]) == (303, "/")
    assert ask(guarded, "/api/about", Cookie=session)[0] == 200
    assert ask(guarded, "/api/about", Cookie=session + "x")[0] == 401
    # a browser sends a host's cookies to all of its ports: another monitor of this machine must not end the session here
    assert session.partition("=")[0].endswith(guarded.url.rstrip("/").rsplit(":", 1)[1])


def test_five_years_of_history_are_answered_quickly(tmp_path):
    """With 7300 more replays, all data of the page cost less than 3 s of processor time, and some 400 replays are shown."""
    with monitor(tmp_path, days=3, moving=False, before=lambda store: grow(store, 7300)) as (server, _, _):
        ask(server, "/")
        began = time.process_time()
        for path in ("/", "/api/about", "/api/history", "/api/schedule", "/api/monitor"):
            assert ask(server, path)[0] == 200
        took = time.process_time() - began
        past = json.loads(ask(server, "/api/history")[2])
        assert past["replays"] == 7303
        assert 350 <= past["shown"] <= 450
        assert took < 3.0  # it takes 0.2 s on an idle machine; a page that read every row would take ten times as long


def test_browsers_that_never_read_hold_up_nobody_else(served):
    """With forty streams that nobody reads, the bus goes on and the page answers other requests."""
    server, daemon, _ = served
    host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)
    idle = []
    for _ in range(40):
        stuck = socket.create_connection((host, int(port)), timeout=10)
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        stuck.sendall(f"GET /api/live HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        idle.append(stuck)
    for k in range(200):
        daemon.bus.say(raw("torque-live", {"k": k, "padding": "x" * 20_000}))
    assert ask(server, "/api/history")[0] == 200
    assert ask(server, "/api/live")[0] == 503  # a 33rd stream is refused
    for stuck in idle:
        stuck.close()


def test_idle_connections_are_closed_and_the_page_answers_again(tmp_path, monkeypatch):
    """The server is full of silent connections and of headers and bodies that never end; it closes them, and answers again."""
    monkeypatch.setattr("monitor.views.web.server.IDLE_S", 2.0)  # two hundred connections take half a second on a busy machine
    with monitor(tmp_path, days=0, moving=False) as (server, _, _), ExitStack() as stack:
        host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)
        head = f"POST /login HTTP/1.1\r\nHost: {host}:{port}\r\n".encode()
        for k in range(200):
            silent = stack.enter_context(socket.create_connection((host, int(port)), timeout=10))
            silent.sendall([b"", head, head + b"Content-Length: 99\r\n\r\n"][k % 3])
        assert ask(server, "/")[0] == 503
        until = time.monotonic() + 10.0
        while ask(server, "/")[0] != 200:
            assert time.monotonic() < until
            time.sleep(0.1)


def test_a_thousand_malformed_requests_do_no_harm(served):
    """After random bytes on many sockets at once the page answers."""
    import random

    server, _, _ = served
    host, port = server.url.removeprefix("http://").rstrip("/").rsplit(":", 1)
    dice = random.Random(7)

    def wild(seeds):
        for seed in seeds:
            own = random.Random(seed)
            start = own.choice(
                [b"", b"GET / HTTP/1.1\r\n", b"POST /api/cmd/ack HTTP/1.1\r\nContent-Length: 99\r\n", b"GET /\xff HTTP/9\r\n"]
            )
            with socket.create_connection((host, int(port)), timeout=5) as wire:
                try:
                    wire.sendall(start + own.randbytes(own.randint(0, 300)) + b"\r\n\r\n")
                except OSError:
                    continue

    threads = [threading.Thread(target=wild, args=([dice.random() for _ in range(250)],)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    until = time.monotonic() + 10.0
    while ask(server, "/")[0] == 503 and time.monotonic() < until:  # the last connections are still being closed
        time.sleep(0.1)
    assert ask(server, "/")[0] == 200


def test_settings_that_open_the_page_to_everybody_are_refused(tmp_path):
    """Refused are a network address without a token, a wrong address, a missing file, a short token, and a port that is in use."""
    for wrong in ("0.0.0.0:8420", "192.168.1.4:80", "cell.example:80", "[::]:80"):
        with pytest.raises(BadInput, match="token_file"):
            PageSettings(listen=wrong)
    for wrong in ("8420", "127.0.0.1", "127.0.0.1:high", ":1", "127.0.0.1:70000"):
        with pytest.raises(BadInput, match="expected HOST:PORT"):
            PageSettings(listen=wrong)
    for right in ("127.0.0.1:0", "localhost:1", "[::1]:80", "127.8.8.8:80"):
        assert PageSettings(listen=right).loopback
    settings = PageSettings(listen="0.0.0.0:0", token_file="token")
    with pytest.raises(BadInput, match="cannot be read"):
        settings.token(tmp_path)
    (tmp_path / "token").write_text("short")
    with pytest.raises(BadInput, match="5 characters"):
        settings.token(tmp_path)
    with pytest.raises(BadConfiguration, match="token_file"):
        configuration(tmp_path, "0.0.0.0:8420")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        settings = configuration(tmp_path, f"127.0.0.1:{taken.getsockname()[1]}")
        refused = pytest.raises(BadConfiguration, match="another program listens there")
        with refused, monitor(tmp_path, days=0, settings=settings, moving=False):
            pass


def test_thinning_keeps_the_ends_and_the_newest():
    """The result is in order, without repetition, and about as long as asked for; a short history stays complete."""
    assert thinned([], 600, 60) == []
    assert thinned(list(range(50)), 600, 60) == list(range(50))
    for count in (61, 599, 601, 7300, 100_000):
        shown = thinned(list(range(count)), 600, 60)
        assert shown == sorted(set(shown))
        assert len(shown) <= 601
        assert shown[0] == 0
        assert shown[-60:] == list(range(count - 60, count))


def test_a_joint_without_a_figure_has_a_gap():
    """The column has None where a replay has no figure, and no figure moves to another day."""
    made = columns([(1, 1, 10.0, {"wear": 0.123456789}), (1, 2, 10.0, {"wear": None}), (2, 2, 20.0, {"wear": 0.5})])
    assert made["t"] == [10, 20]
    assert made["joints"]["1"]["wear"] == [0.12346, None]
    assert made["joints"]["2"]["wear"] == [None, 0.5]


def test_the_vendored_library_is_declared_and_shipped():
    """Its licence lies beside it, and the wheel contains the whole package folder."""
    root = Path(__file__).parents[2]
    static = root / "monitor" / "views" / "web" / "static"
    assert "MIT" in (static / "uPlot.LICENSE.txt").read_text("utf-8")
    assert tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == [
        "monitor"
    ]
    assert {path.name for path in static.iterdir()} == {*STATIC, "index.html", "login.html"}
    assert "answer" in KINDS  # what a command is answered with
    assert sqlite3.sqlite_version_info >= (3, 38)  # json_each is built in


def test_report_and_history_are_made_on_request(served):
    """The report is a page without scripts in the language of the address; the history is a table with a row for each joint and replay."""
    server, _, _ = served
    status, headers, page = ask(server, "/report?lang=de")
    assert status == 200
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "Bericht über den Reibungszustand" in page.decode()
    status, headers, table = ask(server, "/history.csv")
    assert status == 200
    assert headers["content-disposition"] == 'attachment; filename="hall-2-cell-1.csv"'
    assert len(table.decode().splitlines()) == 38 * 6 + 1


def test_the_page_comes_in_the_language_of_the_browser(served):
    """The header decides, the address before it; sentences of the bus come in it, and those of the bus itself stay English."""
    server, daemon, _ = served
    for path, accepted, code, word in (
        ("/", "de-CH,en;q=0.5", "de", "Meldungen"),
        ("/?lang=en", "de", "en", "Alerts"),
        ("/", "fr", "en", "Alerts"),
    ):
        page = ask(server, path, Accept_Language=accepted)[2].decode()
        assert f'<html lang="{code}">' in page
        assert word in page
        assert "[[" not in page
    schedule = json.loads(ask(server, "/api/schedule?lang=de")[2])
    assert any(row["reason"] == "Freigabe: the cell's door is open" for row in schedule["windows"])
    assert "friction" in daemon.bus.last_values()["alert/j3/wear_rising"].text
