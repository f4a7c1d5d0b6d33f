"""The plant's screen: who may look and act, that every act and every refusal is audited, and what stands on it."""

import base64
import gzip
import http.client
import json
import socket
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import sqlalchemy as sa
from heard_documents import whole
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from plant_screen import ALERT, ARMS, NOW, Browser, PlantOfATest, documents
from starlette.requests import Request
from starlette.responses import Response
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadConfiguration, BadInput
from monitor.plant.arm import DOUBLED, ArmName, HeardArm, documents_of
from monitor.plant.enrol.access import MOVES
from monitor.plant.ingest import keep_last_values
from monitor.plant.screen.fleet import shown_arm
from monitor.plant.screen.people import NEEDED, Role, line_of, new_user, read_users, role_named, user_of
from monitor.plant.screen.settings import ScreenSettings
from monitor.plant.settings import load_plant
from monitor.plant.tables import arm as arm_table
from monitor.plant.tables import friction
from monitor.publish.documents import Friction
from monitor.publish.registry import COMMANDS
from monitor.views.web.access import Sessions

ROLES = tuple(role.name for role in Role)
SICK = "hall-1/cell-2"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """A screen with one user of every role."""
    with PlantOfATest(tmp_path_factory.mktemp("plant"), roles=ROLES) as made:
        yield made


@pytest.fixture(scope="module")
def people(plant):
    """Everybody at his browser, and somebody who is not signed in."""
    signed = {role: Browser(plant.url) for role in ROLES}
    assert all(browser.sign_in(plant.tokens[role]) == 303 for role, browser in signed.items())
    return {**signed, None: Browser(plant.url)}


def test_the_list_shows_the_worst_first_with_its_alerts(people):
    """As JSON for the page's next looks, and inside of the page for the first."""
    status, text, _ = people["look"].ask("GET", "/api/v1/arms")
    listed = json.loads(text)["arms"]
    assert status == 200
    assert [(arm["site"], arm["robot"], arm["grade"]) for arm in listed] == [
        ("hall-1", "cell-2", "sick"),
        ("hall-1", "cell-1", "well"),
        ("hall-2", "cell-1", "well"),
    ]
    assert [alert["condition"] for alert in listed[0]["alerts"]] == ["wear_rising"]
    assert listed[0]["joints"][2] == "MAINTENANCE_REQUIRED"
    assert '"robot":"cell-2"' in people["look"].ask("GET", "/")[1]


def test_the_list_is_compressed_for_whoever_can_read_it(people):
    """A browser asks for it every three seconds, also on a phone far away."""
    browser = people["look"]
    connection = http.client.HTTPConnection(browser.at, timeout=20)
    connection.request("GET", "/api/v1/arms", headers={**browser.headers, "Accept-Encoding": "gzip, deflate, br"})
    answer = connection.getresponse()
    packed = gzip.decompress(answer.read())
    connection.close()
    assert answer.getheader("Content-Encoding") == "gzip"
    assert json.loads(packed)["arms"] == json.loads(browser.ask("GET", "/api/v1/arms")[1])["arms"]


LEAF = st.sampled_from([None, True, 0, -1.5, 1e308, "", "x", [], [None], {}, {"robot": 1}, {"name": 2}, {"state": []}, {"window": 3}])
JSON = LEAF | st.lists(LEAF, max_size=2)
DOCUMENT = st.dictionaries(st.sampled_from(["alerts", "joints", "state", "why", "stale", "troubles", "robot", "last_replay"]), JSON) | LEAF


@given(health=DOCUMENT, monitor=DOCUMENT, info=DOCUMENT, alert=st.dictionaries(st.sampled_from([*ALERT, "shelved_until"]), JSON))
@settings(max_examples=60, deadline=None, phases=[Phase.explicit, Phase.generate])
def test_whatever_one_arm_says_the_screen_of_all_arms_is_drawn(health, monitor, info, alert):
    """Each field that the page reads has its type."""
    if isinstance(health, dict):
        health = whole("health", **{**health, "alerts": [{**ALERT, **alert, "active": True}]})
    said = documents_of({"health": health, "monitor": monitor, "info": info}, NOW)
    found = shown_arm(HeardArm(name=ArmName("a", "b"), **said), {}, NOW)
    text, perhaps = str, str | None
    types = {"site": text, "robot": text, "grade": text, "model": perhaps, "state": perhaps, "why": text, "silent_why": perhaps}
    types |= {"problem": perhaps, "last_replay": perhaps, "waiting": int, "histories": int}
    assert all(isinstance(found[name], kind) for name, kind in types.items()), found
    assert all(isinstance(each, perhaps) for each in found["joints"])
    assert all(isinstance(each, str) for each in (*found["troubles"], *found["same_history"]))
    for each in found["alerts"]:
        assert all(isinstance(each[name], str) for name in ("condition", "tier", "text", "raised_at")), each
        assert all(isinstance(each[name], perhaps) for name in ("acknowledged_at", "acknowledged_by", "shelved_until")), each
        assert isinstance(each["joint"], int | None)


@pytest.mark.parametrize("role", [*ROLES, None])
@pytest.mark.parametrize("command", [*NEEDED, "allow", "of-tomorrow"])
def test_each_role_sends_the_commands_that_it_may_and_every_one_is_audited(plant, people, role, command):
    """The arm gets nothing else, and hears the name of whoever is signed in, whatever he typed."""
    before, asked = len(plant.audit()), len(plant.link.asked)
    request = {"joint": 3, "condition": "wear_rising", "by": "somebody else", "why": "seen", "hours": 1, "kind": "greased"}
    status, text = people[role].command(SICK, command, request, page_token=plant.server.screen._access.page_token)
    needed = NEEDED.get(command)
    allowed = role is not None and needed is not None and Role[role] >= needed
    assert (status == 200) == allowed, text
    sent = [document["by"] for key, document in plant.link.asked[asked:] if key.endswith(f"{SICK}/cmd/{command}")]
    assert sent == ([f"{role}er"] if allowed else [])
    noted = plant.audit()[before:]
    who = f"{role}er" if role else "nobody (127.0.0.1)"
    assert [(line[0], line[1], line[3].startswith("refused")) for line in noted] == [(who, command, not allowed)]


@pytest.mark.parametrize("role", [*ROLES, None])
def test_who_may_see_what(plant, people, role):
    """Everybody who is signed in sees list, arms and peers; the audit is for whoever configures; nobody else sees anything."""
    seen = {
        path: people[role].ask("GET", path)[0]
        for path in ("/", "/api/v1/arms", f"/arms/{SICK}/", "/api/v1/arms/hall-1/cell-2/joints/3/peers", "/api/v1/audit")
    }
    expected = dict.fromkeys(seen, 200 if role else 401)
    if role and role != "configure":
        expected["/api/v1/audit"] = 403
        assert plant.audit()[-1][:2] == (f"{role}er", "readAudit")
    assert seen == expected


def test_a_wrong_token_opens_nothing_and_is_audited(plant):
    """It takes a second, and the page says so."""
    stranger = Browser(plant.url)
    assert stranger.sign_in("guessed") == 401
    assert stranger.ask("GET", "/api/v1/arms")[0] == 401
    assert plant.audit()[-1][1:] == ("sign in", None, "refused: a token that nobody has")


def test_a_command_of_a_foreign_page_is_refused(plant, people):
    """The cookie alone does not prove that the person wanted it."""
    asked = len(plant.link.asked)
    assert people["configure"].command(SICK, "ack", {"joint": 3}, page_token="guessed")[0] == 403
    assert len(plant.link.asked) == asked
    assert plant.audit()[-1] == ("configureer", "ack", SICK, "refused: commands come from the page itself; load it anew")


@pytest.mark.parametrize("body", ["{", "[]", '{"joint": 1e999}', '{"joint": NaN}', "x" * 30_000])
def test_what_is_no_command_is_refused_and_audited(plant, people, body):
    """An infinite figure does not become null on its way, which would mean the whole arm."""
    asked, before = len(plant.link.asked), len(plant.audit())
    browser = people["configure"]
    headers = {"Origin": f"http://{browser.at}", "Content-Type": "application/json", "X-Page-Token": plant.server.screen._access.page_token}
    assert browser.ask("POST", f"/arms/{SICK}/api/cmd/ack", body, **headers)[0] in {400, 409, 413}
    assert len(plant.link.asked) == asked
    assert [line[:3] for line in plant.audit()[before:]] == [("configureer", "ack", SICK)]


@pytest.mark.parametrize(
    "path", ["/arms/hall-1/%00/", "/arms/hall-1/" + 300 * "x" + "/", "/api/v1/arms/hall-1/%2e%2e/x/9", "/api/v1/arms/hall-9/cell-9"]
)
def test_an_address_that_names_no_arm_is_not_found(people, path):
    """Whatever stands in it, the database is not asked for it."""
    assert people["look"].ask("GET", path)[0] == 404


def test_a_user_who_is_taken_out_of_the_file_is_out_at_once(tmp_path):
    """His session ends with his line; a file that cannot be read lets nobody in."""
    with PlantOfATest(tmp_path, roles=("look", "move")) as plant:
        browsers = {role: Browser(plant.url) for role in ("look", "move")}
        assert [browser.sign_in(plant.tokens[role]) for role, browser in browsers.items()] == [303, 303]
        lines = (tmp_path / "users").read_text().splitlines()
        (tmp_path / "users").write_text(f"{lines[1]}\n# look left\n")
        assert [browser.ask("GET", "/api/v1/arms")[0] for browser in browsers.values()] == [401, 200]
        (tmp_path / "users").write_text("nonsense\n")
        assert [browser.ask("GET", "/api/v1/arms")[0] for browser in browsers.values()] == [401, 401]


def test_a_session_ends_with_the_token_that_opened_it(tmp_path):
    """Another token is given where one was seen by somebody else; another role alone ends nothing."""
    with PlantOfATest(tmp_path, roles=("look",)) as plant:
        browser = Browser(plant.url)
        browser.sign_in(plant.tokens["look"])
        before = (tmp_path / "users").read_text()
        (tmp_path / "users").write_text(before.replace(":look:", ":configure:"))
        assert browser.ask("GET", "/api/v1/audit")[0] == 200
        another, token = new_user("looker", Role.look)
        (tmp_path / "users").write_text(f"{line_of(another)}\n")
        assert browser.ask("GET", "/api/v1/arms")[0] == 401
        assert [browser.sign_in(token), browser.ask("GET", "/api/v1/arms")[0]] == [303, 200]


def test_people_who_sign_in_at_once_are_all_in(monkeypatch):
    """Each signs in in a thread of his own, and none takes another one's session away."""
    monkeypatch.setattr("monitor.views.web.access.MAX_SESSIONS", 10_000)
    sessions, responses = Sessions("session"), [Response() for _ in range(1200)]
    request = Request({"type": "http", "scheme": "http", "path": "/login", "server": ("127.0.0.1", 80), "headers": []})
    switching_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(6) as threads:
            list(threads.map(lambda response: sessions.open(request, response, "ada"), responses))
    finally:
        sys.setswitchinterval(switching_s)
    assert len(sessions._open) == len(responses)


def test_a_refusal_that_waits_for_the_database_holds_up_nobody(tmp_path):
    """Its line in the audit may wait for a writer for half a minute; the screen goes on."""
    with PlantOfATest(tmp_path, roles=("look",)) as plant, ThreadPoolExecutor(2) as threads:
        browser = Browser(plant.url)
        browser.sign_in(plant.tokens["look"])
        with plant.database.write():
            command = threads.submit(browser.command, SICK, "replay", {})
            stranger = threads.submit(Browser(plant.url).ask, "POST", f"/arms/{SICK}/api/cmd/replay")
            time.sleep(0.3)
            begin = time.monotonic()
            assert Browser(plant.url).ask("GET", "/static/plant.css")[0] == 200
            assert time.monotonic() - begin < 5.0
            assert not command.done()
            assert not stranger.done()
        assert [command.result()[0], stranger.result()[0]] == [403, 401]
        assert [line[1:] for line in plant.audit()[-2:]].count(("replay", SICK, "refused: looker may look; this needs the role move")) == 1


def test_a_trusted_proxy_says_who_somebody_is_and_nobody_else_does(tmp_path):
    """The headers of oauth2-proxy, by group or by name; from another address they are only words."""
    settings = ScreenSettings(listen="127.0.0.1:0", proxies=("127.0.0.1",), proxy_roles=("mechanics=acknowledge", "ada@plant.example=move"))
    with PlantOfATest(tmp_path, settings) as plant:
        token = plant.server.screen._access.page_token
        mechanic = Browser(plant.url, X_Forwarded_User="17", X_Forwarded_Email="bo@plant.example", X_Forwarded_Groups="all, mechanics")
        ada = Browser(plant.url, X_Forwarded_User="18", X_Forwarded_Email="ada@plant.example")
        guest = Browser(plant.url, X_Forwarded_User="19", X_Forwarded_Email="eve@plant.example", X_Forwarded_Groups="all")
        assert mechanic.command(SICK, "ack", {"joint": 3}, page_token=token)[0] == 200
        assert plant.link.asked[-1][1]["by"] == "bo@plant.example"
        assert mechanic.command(SICK, "replay", {}, page_token=token)[0] == 403
        assert ada.command(SICK, "replay", {}, page_token=token)[0] == 200
        status, text, _ = guest.ask("GET", "/api/v1/arms")
        why = "the proxy names nobody who may look: proxy_roles and proxy_role say who may"
        assert (status, json.loads(text)["detail"]) == (401, why)
    elsewhere = ScreenSettings(listen="127.0.0.1:0", proxies=("192.0.2.1",), proxy_role="look")
    (tmp_path / "b").mkdir()
    with PlantOfATest(tmp_path / "b", elsewhere) as plant:
        assert Browser(plant.url, X_Forwarded_User="17").ask("GET", "/api/v1/arms")[0] == 401


def test_names_of_a_proxy_hold_any_letter_and_are_said_once(tmp_path):
    """Header lines as bytes: UTF-8, a line a group as older oauth2-proxies send them, and a second name that a browser sent itself."""
    settings = ScreenSettings(listen="127.0.0.1:0", proxies=("127.0.0.1",), proxy_roles=("/Süd/Wartung=configure", "Jürgen=look"))
    with PlantOfATest(tmp_path, settings) as plant:
        host, port = plant.url.removeprefix("http://").rstrip("/").split(":")
        for lines, path, seen in (
            (["X-Forwarded-User: Jürgen"], "/api/v1/arms", 200),
            (["X-Forwarded-User: Jürgen"], "/api/v1/audit", 403),
            (["X-Forwarded-User: bo", "X-Forwarded-Groups: all", "X-Forwarded-Groups: /Süd/Wartung"], "/api/v1/audit", 200),
            (["X-Forwarded-User: bo", "X-Forwarded-User: Jürgen"], "/api/v1/arms", 401),
        ):
            with socket.create_connection((host, int(port)), timeout=20.0) as way:
                head = "\r\n".join([f"GET {path} HTTP/1.1", f"Host: {host}:{port}", "Connection: close", *lines, "", ""])
                way.sendall(head.encode())
                answer = way.makefile("rb").readline()
            assert f" {seen} ".encode() in answer, (lines, answer)


def test_a_process_beside_the_proxy_is_not_believed_without_its_secret(tmp_path, caplog):
    """It comes from the same address; the proxy sends a header of its own, or oauth2-proxy's --basic-auth-password."""
    secret = "0123456789abcdef"
    settings = ScreenSettings(listen="127.0.0.1:0", proxies=("127.0.0.1",), proxy_role="configure", proxy_secret=secret)
    with PlantOfATest(tmp_path, settings) as plant:
        for given, seen in (
            ({}, 401),
            ({"X_Proxy_Secret": secret[:-1]}, 401),
            ({"X_Proxy_Secret": "ü"}, 401),
            ({"Authorization": f"Bearer {secret}"}, 401),
            ({"Authorization": "Basic ?"}, 401),
            ({"X_Proxy_Secret": secret}, 200),
            *(
                ({"Authorization": "Basic " + base64.b64encode(given.encode()).decode()}, seen)
                for given, seen in (
                    (f"ada:{secret}", 200),
                    (f"f:5b1c-11ee:ada:{secret}", 200),  # a name of Keycloak for somebody of an LDAP
                    (f"ada:x{secret}", 401),
                    (f"ada{secret}", 401),
                    (f":{secret}", 401),
                    (secret, 401),
                    ("", 401),
                )
            ),
        ):
            assert Browser(plant.url, X_Forwarded_User="ada", **given).ask("GET", "/api/v1/audit")[0] == seen, given
        assert caplog.text.count("127.0.0.1 names a person and does not send the proxy_secret") == 1


def test_a_command_comes_through_a_proxy_that_changes_the_host(tmp_path):
    """As nginx does unless it is told otherwise: the browser itself says whether its own page has sent it."""
    settings = ScreenSettings(listen="127.0.0.1:0", proxies=("127.0.0.1",), proxy_role="acknowledge")
    with PlantOfATest(tmp_path, settings) as plant:
        token = plant.server.screen._access.page_token
        headers = {"Content-Type": "application/json", "X-Page-Token": token, "Origin": "https://plant.example", "X-Forwarded-User": "ada"}
        for said, seen in (({"Sec-Fetch-Site": "same-origin"}, 200), ({"Sec-Fetch-Site": "same-site"}, 403), ({}, 403)):
            asked = Browser(plant.url).ask("POST", f"/arms/{SICK}/api/cmd/ack", '{"joint": 3}', **headers, **said)
            assert asked[0] == seen, asked[1]


def test_every_command_of_the_bus_needs_a_role():
    """One that is added there is refused by the screen until somebody says whose it is; what moves an arm is for those who may move."""
    assert {f"cmd/{command}" for command in NEEDED} == set(COMMANDS)
    assert {f"cmd/{command}" for command, role in NEEDED.items() if role >= Role.move} == set(MOVES)


def test_without_people_only_this_machine_by_its_own_names_may_look(tmp_path):
    """A foreign name that resolves here (DNS rebinding) is refused, and what X-Forwarded-For says changes nothing."""
    with PlantOfATest(tmp_path) as plant:
        assert Browser(plant.url).ask("GET", "/")[0] == 200
        assert Browser(plant.url).ask("GET", "/", Host="evil.example")[0] == 421
        assert Browser(plant.url).command(SICK, "ack", {"joint": 3, "by": "ada", "why": "seen"})[0] == 200
        assert plant.link.asked[-1][1]["by"] == "ada"
        assert plant.audit()[-1][:3] == ("ada", "ack", SICK)


def test_an_arm_that_does_not_answer_is_said_and_audited(tmp_path):
    """Nothing is said to be done that was not."""
    with PlantOfATest(tmp_path) as plant:
        plant.link.down.add("cell-2")
        status, text = Browser(plant.url).command(SICK, "ack", {"joint": 3, "by": "ada"})
        assert status == 409
        assert "does not answer, and nobody knows whether it was done" in text
        assert "refused by the arm" in plant.audit()[-1][3]


def test_a_name_of_two_arms_gets_no_command(tmp_path):
    """Either of them could do what is asked, and one of them would move."""
    with PlantOfATest(tmp_path) as plant:
        with plant.database.write() as connection:
            connection.execute(sa.update(arm_table).where(arm_table.c.robot == "cell-2").values(problem=DOUBLED))
        status, text = Browser(plant.url).command(SICK, "replay", {"by": "ada"})
        assert (status, plant.link.asked) == (409, [])
        assert "nothing was done: two monitors speak as this arm" in text
        assert "refused by the arm: nothing was done" in plant.audit()[-1][3]


def test_an_arms_page_is_that_of_its_own_monitor(people):
    """Its documents come from the database and from the arm; its addresses lie below the screen's."""
    status, page, _ = people["look"].ask("GET", f"/arms/{SICK}/")
    assert status == 200
    assert f'<meta name="base" content="/arms/{SICK}">' in page
    about = json.loads(people["look"].ask("GET", f"/arms/{SICK}/api/about")[1])
    assert (about["robot"]["model"], about["robot"]["tool"], len(about["arm"]["links"])) == ("ur5e", "gripper", 6)
    for document in ("history", "schedule", "monitor"):
        assert people["look"].ask("GET", f"/arms/{SICK}/api/{document}")[0] == 200
    assert people["look"].ask("GET", "/arms/hall-9/cell-9/")[0] == 404


def test_the_arms_own_alerts_come_while_somebody_looks(people):
    """The stream gives what the arm said last."""
    browser = people["look"]
    connection = http.client.HTTPConnection(browser.at, timeout=10)
    connection.request("GET", f"/arms/{SICK}/api/live", headers=browser.headers)
    answer, begun, text = connection.getresponse(), time.monotonic(), ""
    while '"alert/j3/wear_rising"' not in text and time.monotonic() - begun < 8:
        text += answer.fp.readline().decode()
    connection.close()
    assert '"alert/j3/wear_rising"' in text
    assert ALERT["text"] in text


def test_a_silent_arms_page_shows_what_was_copied_of_its_joints(tmp_path):
    """Its newest figures come from the copied history, where nobody says them any more; those of an older history do not."""
    from monitor.plant.screen.arm_page import ArmContent

    with PlantOfATest(tmp_path) as plant:
        row = {"arm": 1, "history": 1, "recorded_at": NOW, "replay": 7, "reference_speed_rad_s": 0.4, "reference_temperature_c": 25.0}
        row |= {"wear": 0.05, "wear_std": 0.01, "wear_rate_per_day": 1e-4, "wear_rate_std_per_day": 1e-5, "p50_days": None}
        with plant.database.write() as connection:
            older = {**row, "recorded_at": NOW - 86_400.0, "replay": 6, "wear": 0.01}
            rows = [{**each, "joint": joint} for each in (row, older) for joint in (1, 2)]
            connection.execute(sa.insert(friction), [*rows, {**row, "joint": 2, "p50_days": 90.0, "recorded_at": NOW + 1.0, "replay": 8}])
            connection.execute(sa.insert(friction), [{**row, "joint": 3, "history": 2}])
        content = ArmContent(ArmName("hall-1", "cell-1"), plant.database, lambda _: [], lambda *_: None, "en")
        said = {key: payload for key, payload in content.bus.last_payloads().items() if key.endswith("/friction")}
        found = {key: Friction.model_validate_json(payload) for key, payload in said.items()}
        assert {key: (each.wear, each.remaining_life.verdict) for key, each in found.items()} == {
            "joint/1/friction": (0.05, "no_trend"),
            "joint/2/friction": (0.05, "trend"),
        }
        failed = {"replay": 9, "window": "2026-01-07T05:00:00Z", "state": "failed", "reason": "the arm is in fault"}
        monitor = whole("monitor", last_replay=failed)
        keep_last_values(plant.database, {(1, "monitor"): (NOW, monitor)})
        shown = [(row["state"], row["count"], row["from"], row["window"], row["reason"]) for row in content.schedule()["windows"]]
        assert shown == [
            ("failed", 1, "2026-01-07T05:00:00Z", "2026-01-07T05:00:00Z", "the arm is in fault"),
            ("assessed", 2, "2026-01-04T00:00:00Z", "2026-01-05T00:00:00Z", None),
        ]


def test_an_arm_whose_page_is_no_longer_kept_is_no_longer_received(tmp_path, monkeypatch):
    """Whoever looks at every arm of a large plant, one after the other, leaves nothing behind."""
    monkeypatch.setattr("monitor.plant.screen.app.OPEN_ARMS", 1)
    with PlantOfATest(tmp_path) as plant:
        screen, live = plant.server.screen, []
        for site, robot in ARMS:
            assert Browser(plant.url).ask("GET", f"/arms/{site}/{robot}/")[0] == 200
            live += [content.live for _, content in screen._arms.values()]
        screen.rest()
        assert all(each._subscriber is not None for each in live)
        for each in live[:-1]:
            each._looked_at -= 61.0
        screen.rest()
        assert [each._subscriber is not None for each in live] == [False, False, True]
        assert screen._left == []


def test_names_from_the_bus_cannot_end_the_pages_data(tmp_path):
    """An arm says what it wants, also that a script ends here."""
    wicked = documents()
    wicked["health"]["why"] = "</script><script>alert(1)</script>"
    with PlantOfATest(tmp_path, arms={**ARMS, ("hall-1", "cell-3"): wicked}) as plant:
        assert "<script>alert(1)" not in Browser(plant.url).ask("GET", "/")[1]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('listen = "0.0.0.0:8400"', "open to the network; expected users_file or proxies"),
        ('listen = "8400"', "expected HOST:PORT"),
        ('proxies = ["proxy.example"]\nproxy_role = "look"', "is no address"),
        ('proxy_role = "look"', "but no proxies"),
        ('proxies = ["127.0.0.1"]', "nobody could look"),
        ('proxies = ["127.0.0.1"]\nproxy_roles = ["mechanics"]', 'expected "GROUP=ROLE"'),
        ('proxies = ["127.0.0.1"]\nproxy_roles = ["mechanics=rule"]', "is no role; expected look, acknowledge, move, configure"),
        ('language = "fr"', "expected browser, en, de"),
        ('proxies = ["127.0.0.1"]\nproxy_role = "look"\nproxy_secret = "short"', "holds 5 characters; expected 16 or more"),
        ('proxy_secret = "0123456789abcdef"', "but no proxies"),
        ("user_file = 1", "did you mean users_file?"),
    ],
)
def test_wrong_settings_of_the_screen_are_named(tmp_path, text, says):
    (tmp_path / "plant.toml").write_text(f"[screen]\n{text}\n")
    with pytest.raises(BadConfiguration, match="screen") as error:
        load_plant(tmp_path / "plant.toml", {})
    assert says in str(error.value)


def test_users_are_read_as_they_are_written():
    """A token stands nowhere in the file."""
    user, token = new_user("Ada Lovelace", Role.move)
    text = f"# ours\n\n{line_of(user)}\n"
    assert read_users(text, "users") == {"Ada Lovelace": user}
    assert token not in text
    for wrong in ("a b", "ada:rule:00", "ada:move:12", f"{line_of(user)}\n{line_of(user)}", ":move:" + 64 * "0"):
        with pytest.raises(BadInput, match="users: line"):
            read_users(wrong, "users")
    for name in ("", " ada", "a:b", "x" * 101, "a\nb"):
        with pytest.raises(BadInput, match="expected a name"):
            new_user(name, Role.look)
    with pytest.raises(BadInput, match="is no role"):
        role_named("rule")


def test_the_command_puts_users_in_and_takes_them_out(tmp_path):
    """His token opens the screen; remarks of the file stay; the last word on a person holds."""
    (tmp_path / "plant.toml").write_text('[screen]\nlisten = "127.0.0.1:0"\nusers_file = "users"\n')

    def asked(*words):
        result = CliRunner().invoke(app, ["plant", "user", *words, "--config", str(tmp_path / "plant.toml")])
        return json.loads(result.output) if "--json" in words and result.exit_code == 0 else result.output + str(result.exception or "")

    first = asked("ada", "look", "--json")
    (tmp_path / "users").write_text((tmp_path / "users").read_text() + "# the night shift\n")
    assert "bo may move. The token, which is shown only now: " in asked("bo", "move")
    again = asked("ada", "configure", "--json")
    users = read_users((tmp_path / "users").read_text(), "users")
    assert {name: user.role for name, user in users.items()} == {"ada": Role.configure, "bo": Role.move}
    assert user_of(again["token"], users) == users["ada"]
    assert user_of(first["token"], users) is None
    assert "# the night shift" in (tmp_path / "users").read_text()
    assert "is out of" in asked("bo", "--remove")
    assert "holds no user 'bo'" in asked("bo", "--remove")
    assert "is no role" in asked("bo", "rule")
    assert "cy may move at hall-1, hall-2. The token" in asked("cy", "move", "--site", "hall-1", "--site", "hall-2")
    assert read_users((tmp_path / "users").read_text(), "users")["cy"].person.sites == {"hall-1": Role.move, "hall-2": Role.move}
    assert "'a/b' is no site" in asked("cy", "move", "--site", "a/b")
    assert "look is of the whole plant" in asked("cy", "look", "--site", "hall-1")
    (tmp_path / "plant.toml").write_text("")
    assert "expected users_file" in asked("bo", "look")
