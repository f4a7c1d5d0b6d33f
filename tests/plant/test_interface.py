"""The plant's interface /api/v1: what programs read and send, who may what at which site, and that it is as its document says."""

import http.client
import json
import re
import time
from pathlib import Path
from urllib.parse import quote

import pytest
import sqlalchemy as sa
from plant_screen import ALERT, NOW, Browser, PlantOfATest, documents

from monitor.plant.screen.access import INTERFACE
from monitor.plant.screen.interface import Guarded
from monitor.plant.screen.people import NEEDED, Role
from monitor.plant.screen.settings import ScreenSettings
from monitor.plant.tables import friction, history, transition

MORE = {**ALERT, "joint": 4, "acknowledged_at": "2026-01-03T05:00:00Z", "acknowledged_by": "ada"}
ARMS = {
    ("hall-1", "cell-1"): documents(),
    ("hall-1", "cell-2"): documents("MAINTENANCE_REQUIRED", alerts=[ALERT, MORE]),
    ("hall-2", "cell-1"): documents("MAINTENANCE_REQUIRED", model="ur10e", alerts=[{**ALERT, "joint": 1, "tier": "limit"}]),
}
SICK = f"{INTERFACE}/arms/hall-1/cell-2"
LIMITED = ("acknowledge@hall-1", "move@hall-2")
ROLES = ("look", "acknowledge", "move", "configure", *LIMITED)
READ = dict.fromkeys(("listArms", "readArm", "listJoints", "readHistory", "listPeers", "listAlerts", "streamEvents"), "look")
SENT = dict.fromkeys(("ack", "unack", "shelve", "unshelve", "serviced", "unserviced", "inspected", "uninspected"), "acknowledge")
NEEDS = {**READ, **SENT, "readAudit": "configure"}  # said here once more: an operation without a line fails
PAGE = Path(__file__).parents[2] / "docs" / "interface.md"
SAID = {"joint": 3, "condition": "wear_rising", "why": "seen", "hours": 1.0, "kind": "greased", "item": "screws"}


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    with PlantOfATest(tmp_path_factory.mktemp("plant"), arms=ARMS, roles=ROLES) as made:
        row = {"arm": 2, "history": 1, "joint": 3, "wear": 0.05, "wear_std": 0.01, "reference_torque_nm": 12.0}
        with made.database.write() as connection:
            rows = [{**row, "recorded_at": NOW + 3600.0 * (k // 2), "replay": k + 1} for k in range(7)]  # some at the same time
            connection.execute(sa.insert(friction), rows)
        yield made


def client(plant, role):
    """A program with the token of a role."""
    return Browser(plant.url, **({"Authorization": f"Bearer {plant.tokens[role]}"} if role else {}))


def read(plant, path, role="look"):
    status, text, answer = client(plant, role).ask("GET", path)
    assert status == 200, text
    assert answer.getheader("Content-Type") == "application/json"
    return json.loads(text)


def refused(plant, path, role="look", method="GET", body=None, **headers):
    """Status and sentence of a refusal, which is a problem."""
    status, text, answer = client(plant, role).ask(method, path, body, **headers)
    problem = json.loads(text)
    assert answer.getheader("Content-Type") == "application/problem+json"
    assert problem["status"] == status >= 400
    assert problem["type"] == "about:blank"
    return status, problem["detail"]


def operations(plant):
    """By name: the route of each operation, from the application's own table."""
    return {route.operation_id: route for route in plant.server.screen.served.routes if isinstance(route, Guarded)}


def body_of(command):
    fields = {"serviced": ("joint", "kind", "why"), "unserviced": ("joint", "why"), "inspected": ("item", "why")}
    names = fields.get(command) or (("item", "why") if command == "uninspected" else ("joint", "condition", "why"))
    return {name: SAID[name] for name in (*names, *(("hours",) if command == "shelve" else ()))}


def test_an_arm_and_its_joints_are_read(plant):
    """As the screen shows them, with the newest friction of each joint."""
    arm = read(plant, SICK)
    assert (arm["robot"], arm["grade"], arm["waiting"]) == ("cell-2", "sick", 1)
    assert arm == next(each for each in read(plant, f"{INTERFACE}/arms")["arms"] if each["robot"] == "cell-2")
    joints = read(plant, f"{SICK}/joints")["joints"]
    assert [(each["joint"], each["pill"]) for each in joints][2] == (3, "MAINTENANCE_REQUIRED")
    assert (joints[2]["newest"]["replay"], joints[2]["newest"]["wear"]) == (7, 0.05)
    assert joints[0]["newest"] is None


def test_the_peers_of_a_joint_are_its_newest_figures_and_no_more_is_read(plant):
    asked = []
    sa.event.listen(sa.Engine, "before_cursor_execute", hear := lambda _c, _u, statement, *_: asked.append(statement))
    try:
        peers = read(plant, f"{SICK}/joints/3/peers")["peers"]
    finally:
        sa.event.remove(sa.Engine, "before_cursor_execute", hear)
    assert [(each["robot"], each["this"], each["wear"]) for each in peers] == [("cell-2", True, 0.05)]
    of_figures = [each for each in asked if "friction.wear" in each]
    assert of_figures
    assert not any("coulomb" in each for each in of_figures)


def test_alerts_are_filtered_and_paged(plant):
    """Each page goes on behind the last row of the one before, also where that one has gone meanwhile."""

    def found(query):
        answer = read(plant, f"{INTERFACE}/alerts?{query}")
        return [f"{each['site']}/{each['robot']}/{each['joint']}" for each in answer["alerts"]], answer["next_cursor"]

    one, two, three = "hall-1/cell-2/3", "hall-1/cell-2/4", "hall-2/cell-1/1"
    assert found("") == ([one, two, three], None)
    assert found("state=waits")[0] == [one, three]
    assert found("state=acknowledged")[0] == [two]
    assert found("tier=limit")[0] == [three]
    assert found("site=hall-1&robot=cell-2")[0] == [one, two]
    assert found("site=hall-9")[0] == []
    seen, cursor = found("limit=1")
    while cursor is not None:
        more, cursor = found(f"limit=1&cursor={quote(cursor)}")
        seen += more
    assert seen == [one, two, three]


def test_a_history_is_paged_without_a_gap(plant):
    """Two replays of one moment lie on two pages."""
    path, seen, cursor = f"{SICK}/joints/3/history?limit=1", [], None
    while cursor is not None or not seen:
        answer = read(plant, path + ("" if cursor is None else f"&cursor={quote(cursor)}"))
        cursor = answer["next_cursor"]
        seen += [each["replay"] for each in answer["replays"]]
    assert seen == [1, 2, 3, 4, 5, 6, 7]
    some = read(plant, f"{SICK}/joints/3/history?since=2026-01-05T01:00:00Z&until=2026-01-05T03:00:00%2B00:00")["replays"]
    assert [(each["recorded_at"], each["replay"]) for each in some] == [
        *(("2026-01-05T01:00:00Z", replay) for replay in (3, 4)),
        *(("2026-01-05T02:00:00Z", replay) for replay in (5, 6)),
    ]


@pytest.mark.parametrize(
    ("path", "status", "says"),
    [
        ("/arms/hall-9/cell-9", 404, "no such arm"),
        ("/of-tomorrow", 404, "Not Found"),
        ("/arms/hall-1/cell-2/joints/9/history", 422, "path.joint: Input should be less than or equal to 8"),
        ("/alerts?states=waits", 422, "query.states: Extra inputs are not permitted"),
        ("/alerts?cursor=x", 422, "query.cursor: String should match pattern"),
        ("/audit?cursor=x", 403, "looker may look; this needs the role configure"),
    ],
)
def test_a_wrong_question_is_a_problem_in_a_sentence(plant, path, status, says):
    found = refused(plant, f"{INTERFACE}{path}")
    assert found[0] == status
    assert says in found[1]


def test_an_answer_that_another_method_asks_for_is_a_problem(plant):
    assert refused(plant, f"{INTERFACE}/arms", method="DELETE")[0] == 405


@pytest.mark.parametrize(
    ("body", "kind", "status"),
    [
        ("{}", "text/plain", 415),
        ("{", "application/json", 422),
        ("\udcff".encode("utf-8", "surrogateescape"), "application/json", 400),
        ("[]", "application/json", 422),
        ('{"joint": 1e999, "condition": "x"}', "application/json", 422),
        ('{"joint": 3, "condition": "x", "force": true}', "application/json", 422),
        (f'{{"joint": 3, "condition": "{"x" * 30_000}"}}', "application/json", 413),
    ],
)
def test_a_body_that_is_no_command_reaches_no_arm(plant, body, kind, status):
    asked, before = len(plant.link.asked), len(plant.audit())
    assert refused(plant, f"{SICK}/ack", "acknowledge", "POST", body, **{"Content-Type": kind})[0] == status
    assert len(plant.link.asked) == asked
    assert [(*line[:3], line[3].startswith("refused: ")) for line in plant.audit()[before:]] == [
        ("acknowledgeer", "ack", "hall-1/cell-2", True)
    ]


def test_every_operation_has_a_rule_and_it_is_the_one_that_this_test_knows(plant):
    """Also in the document; no program moves an arm; every other address below /api is the document itself."""
    assert {name: route.needs.name for name, route in operations(plant).items()} == NEEDS
    assert set(SENT) == {command for command, role in NEEDED.items() if role < Role.move}
    others = [route.path for route in plant.server.screen.served.routes if route.path.startswith("/api") and not isinstance(route, Guarded)]
    assert others == ["/api/openapi.json"]
    document = json.loads(client(plant, None).ask("GET", "/api/openapi.json")[1])
    said = {each["operationId"]: each["x-role"] for methods in document["paths"].values() for each in methods.values()}
    assert said == NEEDS
    rows = re.findall(r"^\| (?:GET|POST) .*?\| (.*?)[:;|].*\| (\w+) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert {name: role for names, role in rows for name in re.findall(r"`(\w+)`", names)} == NEEDS
    assert document["openapi"].startswith("3.1")
    assert not [name for name in document["components"]["schemas"] if "__" in name]  # two types of one name: generators take neither


@pytest.mark.parametrize("role", [*ROLES, None])
@pytest.mark.parametrize("site", ["hall-1", "hall-2"])
@pytest.mark.parametrize("operation", [each for each in NEEDS if each != "streamEvents"])
def test_each_role_does_what_it_may_at_each_site_and_each_refusal_is_audited(plant, operation, site, role):
    """Role × act × site, over the application's own routes: everybody sees every site, and acts where his role holds."""
    route, name = operations(plant)[operation], (site, "cell-2" if site == "hall-1" else "cell-1")
    path = route.path.format(site=site, robot=name[1], joint=3)
    kind, _, limited = (role or "").partition("@")
    rank = list(Role.__members__).index
    of_arm = "{site}" in route.path
    has = role is not None and rank(kind if not limited or (of_arm and limited == site) else "look") >= rank(NEEDS[operation])
    before, asked = len(plant.audit()), len(plant.link.asked)
    body, headers = (json.dumps(body_of(operation)), {"Content-Type": "application/json"}) if operation in SENT else (None, {})
    status, text, _ = client(plant, role).ask(*route.methods, path, body, **headers)
    assert status == (200 if has else 401 if role is None else 403), text
    who = "nobody (127.0.0.1)" if role is None else f"{kind}er{limited}"
    sent, noted = plant.link.asked[asked:], plant.audit()[before:]
    if operation in SENT:
        robot = "/".join(name)
        assert [(each[0], each[1]["by"]) for each in sent] == ([(f"joint-monitor/v1/{robot}/cmd/{operation}", who)] if has else [])
        assert [(*each[:3], each[3].startswith("refused")) for each in noted] == [(who, operation, robot, not has)]
    else:
        assert sent == []
        assert [(each[0], each[1], each[3].startswith("refused")) for each in noted] == ([(who, operation, True)] if status == 403 else [])


def test_a_command_needs_a_token_or_the_page(plant):
    """The session of a browser alone does not prove that the person wanted it; his page's own token does."""
    person = Browser(plant.url)
    person.sign_in(plant.tokens["acknowledge"])
    headers, body = {"Content-Type": "application/json", "Origin": f"http://{person.at}"}, json.dumps(body_of("ack"))
    status, text, _ = person.ask("POST", f"{SICK}/ack", body, **headers)
    assert (status, "Authorization: Bearer" in text) == (403, True)
    token = plant.server.screen._access.page_token
    assert person.ask("POST", f"{SICK}/ack", body, **headers, **{"X-Page-Token": token})[0] == 200


@pytest.mark.parametrize("proxied", [True, False])
def test_a_token_that_names_nobody_here_stands_for_no_page(tmp_path, proxied):
    """A proxy may add its own to whatever a browser sends; and without users there is none that means anything."""
    settings = ScreenSettings(listen="127.0.0.1:0", **({"proxies": ("127.0.0.1",), "proxy_role": "move"} if proxied else {}))
    with PlantOfATest(tmp_path, settings, arms=ARMS) as plant:
        person = Browser(plant.url, Authorization="Bearer of-the-proxy", **({"X_Forwarded_User": "ada"} if proxied else {}))
        headers, body = {"Content-Type": "application/json"}, json.dumps({**body_of("ack"), "by": "ada"})
        assert person.ask("GET", f"{INTERFACE}/arms")[0] == 200
        assert person.ask("POST", f"{SICK}/ack", body, **headers)[0] == 403
        headers |= {"Origin": f"http://{person.at}", "X-Page-Token": plant.server.screen._access.page_token}
        assert person.ask("POST", f"{SICK}/ack", body, **headers)[0] == 200


def test_a_wrong_token_is_refused_slowly_and_noted_once_an_hour(plant):
    """It alone counts, whatever session is beside it; a program that goes on with it does not fill the audit."""
    before = len(plant.audit())
    person = Browser(plant.url)
    person.sign_in(plant.tokens["look"])
    begun = time.monotonic()
    for _ in range(2):
        status, text, answer = person.ask("GET", f"{INTERFACE}/arms", Authorization="Bearer guessed")
        assert (status, json.loads(text)["detail"], answer.getheader("WWW-Authenticate")) == (401, "sign in first", "Bearer")
    assert time.monotonic() - begun > 2.0
    assert plant.audit()[before + 1 :] == [("nobody (127.0.0.1)", "sign in", None, "refused: a token that nobody has")]


def test_a_token_that_is_taken_back_is_out_at_once(tmp_path):
    with PlantOfATest(tmp_path, roles=("look", "move")) as plant:
        assert client(plant, "look").ask("GET", f"{INTERFACE}/arms")[0] == 200
        (tmp_path / "users").write_text((tmp_path / "users").read_text().splitlines()[1] + "\n")
        assert client(plant, "look").ask("GET", f"{INTERFACE}/arms")[0] == 401


class Stream:
    """Events of the server, one after the other."""

    def __init__(self, plant, **headers):
        browser = client(plant, "look")
        self.connection = http.client.HTTPConnection(browser.at, timeout=20)
        self.connection.request("GET", f"{INTERFACE}/events", headers={**browser.headers, **headers})
        self.answer = self.connection.getresponse()
        assert self.answer.getheader("Content-Type").startswith("text/event-stream")

    def event(self):
        fields = {}
        while line := self.answer.fp.readline().strip().decode():
            name, _, value = line.partition(": ")
            if name in ("id", "event", "data"):
                fields[name] = value
            elif not fields and len(line) < 5:  # the length of a chunk
                continue
        return (fields["event"], fields.get("id"), json.loads(fields["data"])) if fields else self.event()


def copied(plant, *seqs):
    """As if the plant had copied these transitions of an arm."""
    with plant.database.write() as connection:
        row = {"arm": 2, "history": 1, "joint": 3, "condition": "wear_rising", "tier": "wear", "kind": "raised", "document": ALERT}
        connection.execute(sa.insert(transition), [{**row, "seq": seq, "at": NOW + seq} for seq in seqs])
        connection.execute(sa.update(history).where(history.c.arm == 2).values(event_cursor=max(seqs)))


def test_transitions_come_as_a_stream_and_nothing_is_lost_over_a_cut(plant):
    """Whoever comes back with the last identifier gets what he has missed, once; whoever has another run's is told to read anew."""
    first = Stream(plant)
    assert first.event()[::2] == ("begin", {"resumed": False})
    copied(plant, 1, 2)
    events = [first.event(), first.event()]
    assert [(name, data["robot"], data["seq"], data["text"]) for name, _, data in events] == [
        ("transition", "cell-2", seq, ALERT["text"]) for seq in (1, 2)
    ]
    first.connection.close()
    copied(plant, 3)
    again = Stream(plant, **{"Last-Event-ID": events[0][1]})
    assert again.event()[::2] == ("begin", {"resumed": True})
    assert [again.event()[2]["seq"] for _ in range(2)] == [2, 3]
    again.connection.close()
    for unknown in ("00000000-1", "x", events[0][1] + "0000"):
        other = Stream(plant, **{"Last-Event-ID": unknown})
        assert other.event()[::2] == ("begin", {"resumed": False})
        other.connection.close()


def test_a_stream_ends_with_its_token_and_is_not_for_other_pages(tmp_path, monkeypatch):
    """Out at once; and a foreign page, which could read nothing, takes nobody's place. Nor can more listen than there are places."""
    with PlantOfATest(tmp_path, roles=("look", "move")) as plant:
        status, why = refused(plant, f"{INTERFACE}/events", **{"Sec-Fetch-Site": "cross-site"})
        assert (status, "of this very host" in why) == (403, True)
        monkeypatch.setattr("monitor.plant.screen.interface.MAX_STREAMS", 1)
        stream = Stream(plant)
        assert stream.event()[0] == "begin"
        assert refused(plant, f"{INTERFACE}/events") == (503, "1 are listening already")
        (tmp_path / "users").write_text((tmp_path / "users").read_text().splitlines()[1] + "\n")
        begun = time.monotonic()
        while stream.answer.fp.readline():  # until the server ends it
            assert time.monotonic() - begun < 8.0
        assert client(plant, "move").ask("GET", f"{INTERFACE}/arms")[0] == 200
