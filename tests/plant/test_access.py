"""Who may do what through the routers of an enrolled plant: a matrix of every role and every act, with real routers and real TLS."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
import zenoh
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import NameOID
from published import raw

from monitor.plant.enrol.access import PEOPLE
from monitor.plant.enrol.authority import Authority, Issued, new_root
from monitor.plant.enrol.check import ask_all, lacks_on_bus
from monitor.plant.enrol.files import Plant, enrol
from monitor.plant.enrol.inventory import read_inventory
from monitor.publish.bus import Bus, QueryHandler
from monitor.publish.registry import COMMANDS
from monitor.publish.session import PLANT, BusSettings, prefix, session_config

INVENTORY = "site,id,model,host\nhall-1,cell-1,ur5e,10.0.1.1\nhall-1,cell-2,ur5e,10.0.1.2\nhall-2,cell-1,ur5,10.0.2.1\n"
OURS = "joint-monitor/v1/hall-1/cell-1"  # the arm that all acts are about
PERSONS = {person.name: set(person.commands) for person in PEOPLE}
OWN, CELL = "hall-1.cell-1", "cell@hall-1.cell-1"
STRANGERS = ("hall-1.cell-2", "hall-2.cell-1", "cell@hall-1.cell-2", "router@hall-2", "guest")
ACTS = ("look", "all", *COMMANDS, "cmd/of-tomorrow", "publish", "permit", "answer", "live", "publish wide", "prior", "be the plant")
PLACES = ("core", "site")  # to which router somebody connects


def allowed(who, act):
    """By the promise of the enrolment, not by its rules."""
    if act == "prior":
        return who in PERSONS or who in {OWN, "hall-1.cell-2"}  # the arms of this site
    if act == "be the plant":
        return who == "plant"
    if who in PERSONS:
        return act in {"look", "all"} or act in PERSONS[who] or (act == "cmd/of-tomorrow" and bool(PERSONS[who]))
    if who == OWN:  # the arm's own computer
        return act not in {"all", "publish wide"}
    return who == CELL and act == "permit"


@pytest.fixture(scope="module")
def world(tmp_path_factory, free_tcp_port_factory):
    """A core, the routers of two sites, and the bus of one arm, with the files that enrolment wrote."""
    folder = tmp_path_factory.mktemp("plant")
    core, one, two = (f"tls/127.0.0.1:{port}" for port in (free_tcp_port_factory() for _ in range(3)))
    plant = Plant(arms=read_inventory(INVENTORY, "arms.csv"), routers={"hall-1": one, "hall-2": two}, core=core)
    enrol(plant, folder)
    authority = Authority(Issued((folder / "authority/ca.pem").read_bytes(), (folder / "authority/ca.key").read_bytes()), "")
    now = datetime.now(UTC)
    (folder / "guest").mkdir()
    for name, by in (("guest", authority), ("forger", Authority(new_root("another", now), ""))):
        issued = by.issue("viewer" if name == "forger" else name, (), now, 30)
        (folder / "guest" / f"{name}.pem").write_bytes(issued.certificate)
        (folder / "guest" / f"{name}.key").write_bytes(issued.key)
    (folder / "guest/ca.pem").write_bytes(authority.pem)
    called = []
    answers = {
        command: QueryHandler("answer", lambda request: raw("answer", called.append(request) or {"done": "done"})) for command in COMMANDS
    }
    answers["cmd/of-tomorrow"] = answers["cmd/ack"]
    with ExitStack() as stack:
        for place in ("core", "routers/hall-1", "routers/hall-2"):
            text = (folder / place / "router.json5").read_text().replace("/etc/joint-monitor/tls", str(folder / place / "tls"))
            stack.enter_context(zenoh.open(zenoh.Config.from_json5(text)))
        settings = BusSettings(listen=(), connect=(one,), zenoh=zenoh_file(folder, OWN))
        bus = stack.enter_context(Bus(settings, prefix("hall-1", "cell-1"), answers))
        bus.say(raw("health", {"state": "NORMAL"}))
        made = SimpleNamespace(plant=plant, folder=folder, core=core, site=one, bus=bus, called=called)
        looker = stack.enter_context(session(made, "plant", "core"))
        made.heard = []
        looker.declare_subscriber("joint-monitor/v1/**", made.heard.append)
        made.alive = []
        looker.liveliness().declare_subscriber("joint-monitor/v1/**", made.alive.append, history=True)
        made.looker = looker
        made.prior = looker.declare_queryable(f"{PLANT}/prior/hall-1/ur5", lambda query: reply(query, {"prior": "of the plant"}))
        eventually(lambda: asked(looker, f"{OURS}/health"))
        yield made


def zenoh_file(folder, who):
    """The Zenoh file of somebody, with the place where its certificates lie here."""
    if who in {"guest", "forger"} or who.startswith("odd"):
        name, source = who, "people/viewer/zenoh/viewer.json5"
        tls = folder / "guest"
    elif who.startswith("cell@"):
        name, source, tls = "cell", f"cells/{who[5:]}/zenoh/cell.json5", folder / f"cells/{who[5:]}/tls"
    elif who.startswith("router@"):
        name, source, tls = "router", "people/viewer/zenoh/viewer.json5", folder / f"routers/{who[7:]}/tls"
    elif "." in who:
        name = who.split(".")[1]
        source, tls = f"computers/{who}/zenoh/{name}.json5", folder / f"computers/{who}/tls"
    else:
        name, source, tls = who, f"people/{who}/zenoh/{who}.json5", folder / f"people/{who}/tls"
    text = (folder / source).read_text().replace("/etc/joint-monitor/tls", str(tls)).replace("/viewer.", f"/{name}.")
    path = folder / f"{who}.json5"
    path.write_text(text)
    return str(path)


def session(world, who, place):
    config = session_config(mode="client", connect=(getattr(world, place),), zenoh_file=zenoh_file(world.folder, who))
    config.insert_json5("connect/timeout_ms", "2000")
    return zenoh.open(config)


def asked(by, key, payload=None, wait_s=1.0):
    """What a query brings, decoded."""
    return [json.loads(reply.ok.payload.to_bytes()) for reply in by.get(key, payload=payload, timeout=wait_s) if reply.ok]


def eventually(ask, within_s=15.0):
    deadline = time.monotonic() + within_s
    while not (answer := ask()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert answer
    return answer


def did(world, somebody, who, act):
    """Whether the act had the effect that its doer wants."""
    word = f"{who} {act} {time.monotonic_ns()}"
    if act == "look":
        return asked(somebody, f"{OURS}/health") == [{"state": "NORMAL"}]
    if act == "all":
        return bool(asked(somebody, "joint-monitor/v1/*/*/health"))
    if act.startswith("cmd/"):
        asked(somebody, f"{OURS}/{act}", json.dumps({"word": word}).encode())
        return any(request.get("word") == word for request in world.called)
    if act in {"publish", "publish wide"}:
        somebody.put(f"{OURS}/health" if act == "publish" else "joint-monitor/v1/*/cell-1/health", word)
        return within(lambda: any(sample.payload.to_string() == word for sample in world.heard))
    if act == "permit":
        with somebody.declare_queryable(f"{OURS}/permit/replay", lambda query: reply(query, {"allow": True, "why": word})):
            return within(lambda: (answer := world.bus.ask_permit({}, 0.3)) is not None and word in answer.text)
    if act == "answer":
        with somebody.declare_queryable(f"{OURS}/friction-of-{word.rsplit(maxsplit=1)[-1]}", lambda query: reply(query, {"word": word})):
            return within(lambda: {"word": word} in asked(world.looker, f"{OURS}/friction-of-{word.rsplit(maxsplit=1)[-1]}", wait_s=0.3))
    if act == "prior":
        return asked(somebody, f"{PLANT}/prior/hall-1/ur5") == [{"prior": "of the plant"}]
    if act == "be the plant":
        key = f"prior/hall-1/{word.rsplit(maxsplit=1)[-1]}"
        with somebody.declare_queryable(f"{PLANT}/{key}", lambda query: reply(query, {"word": word})):
            return within(lambda: word.encode() in (world.bus.ask_plant(key, 0.3) or b""))
    assert act == "live"
    with somebody.liveliness().declare_token(f"{OURS}/alive/{word.rsplit(maxsplit=1)[-1]}"):
        return within(lambda: any(str(sample.key_expr).endswith(word.rsplit(maxsplit=1)[-1]) for sample in world.alive))


def reply(query, document):
    with query:
        query.reply(query.key_expr, json.dumps(document))


def within(seen, wait_s=1.0):
    deadline = time.monotonic() + wait_s
    while time.monotonic() < deadline:
        if seen():
            return True
        time.sleep(0.03)
    return False


@pytest.mark.parametrize("who", [*PERSONS, OWN, CELL, *STRANGERS])
def test_each_may_do_what_its_role_says_and_nothing_else(world, who):
    """Every act of the matrix, at the router to which the role connects; persons also at the core."""
    for place in PLACES if who in PERSONS else PLACES[1:]:
        with session(world, who, place) as somebody:
            if any(allowed(who, act) for act in ACTS):
                first = next(act for act in ACTS if allowed(who, act))
                eventually(lambda who=who, first=first, somebody=somebody: did(world, somebody, who, first))
            with ThreadPoolExecutor(len(ACTS)) as at_once:  # most acts must come to nothing, and each is waited for
                done = at_once.map(lambda act, who=who, somebody=somebody: did(world, somebody, who, act), ACTS)
                found = dict(zip(ACTS, done, strict=True))
        assert found == {act: allowed(who, act) for act in ACTS}, place


def test_a_certificate_of_another_authority_opens_no_session(world):
    """Its name is on the list, its signature is not."""
    with pytest.raises(zenoh.ZError):
        session(world, "forger", "core")


ODD = ("operator ", " operator", "Operator", "operator\0", "operator\0x", "operator\n", "*", "hall-1.*", "operator,CN=guest", "CN=operator",
       "\u043eperator", "operator\u200b", "router@hall-1 ", "cell@hall-1.cell-1\0")  # fmt: skip


def odd_certificates(world):
    """Certificates of the plant's own authority whose names are nearly somebody's, or that hold somebody's name in a second place."""
    now = datetime.now(UTC)
    root = Issued((world.folder / "authority/ca.pem").read_bytes(), (world.folder / "authority/ca.key").read_bytes())
    issued = [Authority(root, "").issue(name, (), now, 30) for name in ODD]
    issued.append(Authority(root, "").issue("guest", ("operator", "viewer"), now, 30))  # as names of its host
    signer = load_pem_private_key(root.key, password=None)
    for kind in (NameOID.COMMON_NAME, NameOID.ORGANIZATIONAL_UNIT_NAME, NameOID.USER_ID, NameOID.EMAIL_ADDRESS):
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "guest"), x509.NameAttribute(kind, "operator")])
        built = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(x509.load_pem_x509_certificate(root.certificate).subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - timedelta(hours=1))
            .not_valid_after(now + timedelta(days=30))
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .sign(signer, SHA256())
        )
        pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        issued.append(Issued(built.public_bytes(Encoding.PEM), pem))
    for number, each in enumerate(issued):
        (world.folder / f"guest/odd{number}.pem").write_bytes(each.certificate)
        (world.folder / f"guest/odd{number}.key").write_bytes(each.key)
    return [f"odd{number}" for number in range(len(issued))]


def test_a_name_that_is_nearly_somebodys_may_nothing(world):
    """Spaces, letters of another alphabet, NUL, wildcards, and another one's name in a second place of the certificate."""
    acts = ("look", "cmd/replay", "publish", "permit", "live")

    def tried(who):
        try:
            with session(world, who, "site") as somebody:
                return [act for act in acts if did(world, somebody, who, act)]
        except zenoh.ZError:  # the router did not let it in at all
            return []

    names = odd_certificates(world)
    with session(world, "operator", "site") as operator:  # the same acts come to something where the name is right
        eventually(lambda: did(world, operator, "operator", "cmd/replay"))
    with ThreadPoolExecutor(len(names)) as at_once:
        assert dict(zip(names, at_once.map(tried, names), strict=True)) == {name: [] for name in names}


def test_the_check_of_a_plant_asks_every_monitor_with_the_plants_own_certificate(world):
    """An older version, another controller, a clock that is off and no replay due are named; an arm that does not answer is silent."""
    now = datetime.now(UTC)
    robot = {"model": "ur5e", "site": "hall-1", "id": "cell-1", "host": "10.0.9.9"}
    info = {"robot": robot, "version": "0.0.1", "host": "ipc", "trajectory_digest": "a", "started_at": now.isoformat()}
    nothing = {"lag_s": None, "last_replay": None, "next_replay_due": None, "next_replay_why": None, "reload": None}
    of_program = {"version": "0.0.1", "programs": {}, "started_at": now.isoformat(), "uptime_s": 1.0}
    of_computer = {
        "bus": {"to_send": 0, "to_answer": 0, "dropped": 0},
        "store": {"history_bytes": 1, "last_backup_at": None, "free_bytes": None, "sqlite": "3"},
        "process": {"resident_bytes": None, "cpu_s": 0.0, "threads": 1, "pid": 1, "pid_namespace": None},
    }
    monitor = {**nothing, **of_program, **of_computer, "workers": {}, "overrides": [], "troubles": [], "arm": {"heard": True}}
    for ahead, cause in ((timedelta(hours=3), "clock"), (timedelta(hours=-3), "silent")):
        world.bus.say(raw("info", info))
        world.bus.say(raw("monitor", {**monitor, "said_at": (now + ahead).isoformat()}))
        eventually(lambda ahead=ahead: asked(world.looker, f"{OURS}/monitor")[0]["said_at"] == (now + ahead).isoformat())
        found = lacks_on_bus(world.plant, ask_all(world.plant, world.folder, timeout_s=1.0), now)
        assert {lack.cause for lack in found[OWN]} == {cause, "version", "differs", "no_replay"}
        assert "runs version 0.0.1; this is" in " ".join(lack.text for lack in found[OWN])
        assert [lack.cause for lack in found["hall-2.cell-1"]] == ["silent"]
