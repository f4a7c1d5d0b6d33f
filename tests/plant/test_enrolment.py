"""Enrolment: an inventory becomes configurations, certificates and access control; again, it adds what is new and keeps the rest."""

import json
import ssl
from datetime import UTC, datetime, timedelta

import pytest
import trustme
import zenoh
from cryptography import x509
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.config.load import load
from monitor.errors import BadInput, BusError
from monitor.plant.enrol.authority import Authority, Issued, describe, new_root
from monitor.plant.enrol.check import ask_all, lacks_of_files, lacks_on_bus
from monitor.plant.enrol.files import Plant, enrol
from monitor.plant.enrol.inventory import read_inventory
from monitor.plant.settings import load_plant
from monitor.publish.session import session_config

NOW = datetime(2026, 3, 2, 8, tzinfo=UTC)
INVENTORY = """site,id,model,host,computer,payload_kg,payload_cog_m,serial,tool
hall-1,cell-1,ur5e,10.0.1.1,ipc-1,1.2,0 0 0.05,20245500001,gripper
hall-1,cell-2,ur10e,10.0.1.2,ipc-1,,,20245500002,
hall-2,cell-1,ur5,10.0.2.1,,0.5,,,camera
"""
ROUTERS = {"hall-1": "tls/hall-1.example:7447", "hall-2": "tls/10.0.2.9:7447"}


def plant(text=INVENTORY, routers=ROUTERS, core="tls/core.example:7447", **more):
    return Plant(arms=read_inventory(text, "arms.csv"), routers=routers, core=core, **more)


def everything(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_arm_gets_a_configuration_that_loads_and_moves_nothing(tmp_path, monkeypatch):
    """Each TOML file with the Zenoh file beside it is a configuration; arms of one computer share no port and no name."""
    enrol(plant(), tmp_path, now=NOW)
    found = [load(path) for path in sorted(tmp_path.glob("computers/*/*.toml"))]
    assert [(each.robot.site, each.robot.id, each.robot.model) for each in found] == [
        ("hall-2", "cell-1", "ur5"),
        ("hall-1", "cell-1", "ur5e"),
        ("hall-1", "cell-2", "ur10e"),
    ]
    assert not any(each.replay.allow_motion for each in found)
    assert [each.bus.connect for each in found[1:]] == [("tls/hall-1.example:7447",)] * 2
    assert len({each.page.listen for each in found[1:]}) == 2
    assert found[1].robot.payload_cog_m == (0.0, 0.0, 0.05)


def test_the_plant_gets_its_configuration(tmp_path):
    """It connects to the core, or to every site's router where there is none."""
    enrol(plant(), tmp_path / "a", now=NOW)
    enrol(plant("site,id,model,host\nhall-1,c,ur5,h\n", {"hall-1": "tls/r:7447"}, ""), tmp_path / "b", now=NOW)
    found = [load_plant(tmp_path / name / "people/plant/joint-monitor-plant.toml", {}).plant for name in "ab"]
    assert [each.connect for each in found] == [("tls/core.example:7447",), ("tls/r:7447",)]
    assert found[0].zenoh == "/etc/joint-monitor/zenoh/plant.json5"


def test_certificates_name_their_bearer_and_hold_for_routers_addresses(tmp_path):
    """The other end of TLS finds the names it looks for, and the root that signed them; OpenSSL takes the chain."""
    enrol(plant(), tmp_path, now=datetime.now(UTC))
    root = (tmp_path / "authority/ca.pem").read_bytes()
    for place, name, addresses in (
        ("computers/ipc-1/tls/cell-2.pem", "hall-1.cell-2", ()),
        ("computers/hall-2.cell-1/tls/cell-1.pem", "hall-2.cell-1", ()),
        ("routers/hall-1/tls/router.pem", "router@hall-1", ("hall-1.example",)),
        ("routers/hall-2/tls/router.pem", "router@hall-2", ("10.0.2.9",)),
        ("core/tls/router.pem", "core", ("core.example",)),
        ("people/viewer/tls/viewer.pem", "viewer", ()),
        ("cells/hall-1.cell-1/tls/cell.pem", "cell@hall-1.cell-1", ()),
    ):
        told = describe((tmp_path / place).read_bytes(), place, root=root)
        assert (told.name, told.addresses) == (name, addresses)
        assert (tmp_path / place).with_name("ca.pem").read_bytes() == root
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tmp_path / place, (tmp_path / place).with_suffix(".key"))
    assert {path.stat().st_mode & 0o777 for path in tmp_path.rglob("*.key")} == {0o600}


def test_a_second_enrolment_changes_nothing(tmp_path):
    """Keys are not made anew: a service that has them goes on."""
    enrol(plant(), tmp_path, now=NOW)
    before = everything(tmp_path)
    written = enrol(plant(), tmp_path, now=NOW + timedelta(days=30))
    assert (written.new, written.changed, written.kept) == ([], [], [])
    assert everything(tmp_path) == before


def test_a_further_arm_adds_its_own_files_and_its_routers_rules(tmp_path):
    """Nothing else is touched."""
    enrol(plant(), tmp_path, now=NOW)
    written = enrol(plant(INVENTORY + "hall-1,cell-3,ur3e,10.0.1.3,,,,,\n"), tmp_path, now=NOW)
    assert written.changed == ["routers/hall-1/router.json5"]
    assert {name.split("/")[1] for name in written.new} == {"hall-1.cell-3"}


def test_what_a_person_changed_is_kept_and_told(tmp_path):
    """A configuration that differs from the inventory is replaced only with --force."""
    enrol(plant(), tmp_path, now=NOW)
    file = tmp_path / "computers/ipc-1/cell-1.toml"
    ours = file.read_bytes()
    file.write_bytes(ours.replace(b"allow_motion = false", b"allow_motion = true"))
    assert enrol(plant(), tmp_path, now=NOW).kept == ["computers/ipc-1/cell-1.toml"]
    assert b"allow_motion = true" in file.read_bytes()
    assert enrol(plant(), tmp_path, now=NOW, force=True).changed == ["computers/ipc-1/cell-1.toml"]
    assert file.read_bytes() == ours


def test_an_arm_that_left_the_inventory_is_told_and_shut_out(tmp_path):
    """Its files stay, and its site's router no longer knows it."""
    enrol(plant(), tmp_path, now=NOW)
    left = INVENTORY.replace("hall-1,cell-2,ur10e,10.0.1.2,ipc-1,,,20245500002,\n", "")
    assert enrol(plant(left), tmp_path, now=NOW).gone == ["computers/ipc-1/cell-2.toml"]
    router = (tmp_path / "routers/hall-1/router.json5").read_text()
    assert "hall-1.cell-1" in router
    assert "hall-1.cell-2" not in router


@pytest.mark.parametrize("spoil", ["near its end", "of another authority", "torn", "its key is another's", "its router moved"])
def test_a_certificate_that_is_no_longer_good_is_replaced(tmp_path, spoil):
    """Only that one, and it is good again."""
    enrol(plant(), tmp_path, now=NOW)
    pem, then, routers = tmp_path / "routers/hall-1/tls/router.pem", NOW, dict(ROUTERS)
    if spoil == "near its end":
        then = NOW + timedelta(days=825 - 30)
    elif spoil == "of another authority":
        pem.write_bytes(Authority(new_root("another", NOW), "").issue("router@hall-1", ("hall-1.example",), NOW, 825).certificate)
    elif spoil == "torn":
        pem.write_bytes(pem.read_bytes()[:200])
    elif spoil == "its key is another's":
        pem.with_suffix(".key").write_bytes((tmp_path / "core/tls/router.key").read_bytes())
    else:
        routers["hall-1"] = "tls/new.example:7447"
    before = everything(tmp_path)
    written = enrol(plant(routers=routers), tmp_path, now=then)
    assert "routers/hall-1/tls/router.pem" in written.changed
    assert describe(pem.read_bytes(), "", root=before["authority/ca.pem"]).until > then + timedelta(days=800)
    if spoil not in {"near its end", "its router moved"}:
        assert {name for name in written.changed if not name.startswith("routers/hall-1/tls/")} == set()


def test_an_authority_of_the_company_signs_and_its_key_is_not_copied(tmp_path):
    """As made by another's program; a certificate that is none, and a key that is another's, are refused."""
    theirs, other = trustme.CA(), trustme.CA()
    root = Issued(theirs.cert_pem.bytes(), theirs.private_key_pem.bytes())
    enrol(plant(), tmp_path, root=root, now=datetime.now(UTC))
    assert sorted(path.name for path in (tmp_path / "authority").iterdir()) == ["ca.pem"]
    leaf = x509.load_pem_x509_certificate((tmp_path / "computers/ipc-1/tls/cell-1.pem").read_bytes())
    leaf.verify_directly_issued_by(x509.load_pem_x509_certificate(root.certificate))
    issued = theirs.issue_cert("a.example")
    for wrong, says in (
        (Issued(root.certificate, other.private_key_pem.bytes()), "the private key is not that of the certificate"),
        (Issued(issued.cert_chain_pems[0].bytes(), issued.private_key_pem.bytes()), "that of no authority"),
        (Issued(b"nothing", root.key), "no certificate with an unencrypted private key"),
    ):
        with pytest.raises(BadInput, match=says):
            enrol(plant(), tmp_path / "elsewhere", root=wrong, now=datetime.now(UTC))
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("site,id,model\n", "column 'host': missing"),
        ("site,id,model,host,colour\n", "column 'colour': unknown; known are site, id"),
        ("site,id,model,host,host\n", "column 'host': 2 times"),
        ("site,id,model,host\n", "holds no arm"),
        ("site,id,model,host\nHall,c,ur5,h\n", "line 2: site = 'Hall': expected only a–z"),
        ("site,id,model,host\nh,c,ur6,h\n", "line 2: model = 'ur6': unknown; known are"),
        ("site,id,model,host\nh,c,ur5\n", "line 2: host: missing"),
        ("site,id,model,host\nh,c,ur5,a,b\n", "line 2: 5 cells, but 4 columns"),
        ("site,id,model,host\nh,c,ur5,a\nh,c,ur5,b\n", "line 3: arm h.c stands in line 2 already"),
        ("site,id,model,host\nh,c,ur5,a\nh,d,ur5,a\n", "line 3: host a stands in line 2 already"),
        ("site,id,model,host,computer\nh,c,ur5,a,p\ni,c,ur5,b,p\n", "line 3: id c at computer p stands in line 2 already"),
        ("site,id,model,host,payload_kg\nh,c,ur5,a,heavy\n", "line 2: payload_kg = 'heavy': expected a figure"),
        ("site,id,model,host,payload_kg\nh,c,ur5,a,nan\n", "line 2: payload_kg = 'nan': expected a finite figure"),
        ("site,id,model,host,payload_cog_m\nh,c,ur5,a,0 0\n", "line 2: payload_cog_m = '0 0': expected 3 figures"),
        (f"site,id,model,host\n{'h' * 40},{'c' * 40},ur5,a\n", "site and id together have 80 characters; expected at most 58"),
    ],
)
def test_mistakes_in_an_inventory_are_named_with_their_line(text, says):
    with pytest.raises(BadInput) as error:
        read_inventory(text, "arms.csv")
    assert says in str(error.value)


def test_all_mistakes_are_named_at_once():
    """A table of a thousand rows is mended in one go."""
    with pytest.raises(BadInput) as error:
        read_inventory("site,id,model,host\nh,c,ur6,a\nh,D,ur5,b\n", "arms.csv")
    assert "2 mistakes" in str(error.value)
    assert "line 2" in str(error.value)
    assert "line 3" in str(error.value)


def test_a_table_of_a_spreadsheet_is_read():
    """Semicolons, a byte order mark, empty rows, remarks, spaces around cells."""
    arms = read_inventory("\ufeffsite; id ;model;host\r\n# ours\r\n;;;\r\nh ; c;ur5;10.0.0.1\r\n", "arms.csv")
    assert [(arm.name, arm.host) for arm in arms] == [("h.c", "10.0.0.1")]


def test_a_row_that_makes_no_configuration_is_refused_before_anything_is_written(tmp_path):
    """The daemon would refuse it in the night of the installation."""
    text = "site,id,model,host,cron,timezone\nh,c,ur5,a,often,Europe/Berlin\nh,d,ur5,b,0 3 * * *,Mars\n"
    with pytest.raises(BadInput) as error:
        enrol(plant(text, {"h": "tls/r:7447"}, ""), tmp_path / "plant", now=NOW)
    assert "h.c: " in str(error.value)
    assert "h.d: " in str(error.value)
    assert not (tmp_path / "plant").exists()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"routers": {"hall-1": "tls/a:1"}}, "no router for the site hall-2"),
        ({"routers": {**ROUTERS, "hall-3": "tls/a:1"}}, "the inventory holds no arm of this site"),
        ({"core": ""}, "2 sites meet in a core router"),
        ({"core": "udp/core:7447"}, "expected a router's endpoint tls/HOST:PORT"),
        ({"days": 0}, "expected 1 to 3650"),
    ],
)
def test_a_plant_that_cannot_connect_is_refused(more, says):
    with pytest.raises(BadInput, match=says):
        plant(**more)


def test_behind_a_router_without_certificates_nothing_has_to_be_enrolled_and_everything_is_checked(tmp_path, free_port):
    """The plant's own example joins tcp/: of such an arm the check asks its monitor, and its file where there is one."""
    router = f"tcp/127.0.0.1:{free_port}"
    open_plant = plant(routers=dict.fromkeys(ROUTERS, router), core="")
    with pytest.raises(BadInput, match="behind tcp/ nothing has to be enrolled"):
        enrol(open_plant, tmp_path, now=NOW)
    assert not any(lacks_of_files(open_plant, tmp_path, NOW).values())
    with pytest.raises(BusError, match=r"no router answers; is it up, and does it listen there\?"):
        ask_all(open_plant, tmp_path, timeout_s=0.5)
    with zenoh.open(session_config(mode="router", listen=(router,))):
        found = lacks_on_bus(open_plant, ask_all(open_plant, tmp_path, timeout_s=0.5), NOW)
    assert {lack.cause for lacks in found.values() for lack in lacks} == {"silent"}


def test_half_an_authority_is_no_reason_for_a_new_one(tmp_path):
    """Another root would shut every arm out."""
    enrol(plant(), tmp_path, now=NOW)
    (tmp_path / "authority/ca.key").unlink()
    with pytest.raises(BadInput, match=r"ca\.key: is missing; bring it back"):
        enrol(plant(), tmp_path, now=NOW)


def test_a_file_whose_section_is_none_is_told_as_a_lack(tmp_path):
    """A person may have changed anything."""
    enrol(plant(), tmp_path, now=NOW)
    path = tmp_path / "computers/ipc-1/cell-2.toml"
    path.write_text("bus = 3\n" + path.read_text().partition("[bus]")[0])
    lacks = lacks_of_files(plant(), tmp_path, NOW)["hall-1.cell-2"]
    assert lacks[0].cause == "configuration"
    assert "bus" in lacks[0].text


def test_the_commands_write_say_and_check(tmp_path, monkeypatch):
    """From the inventory to a folder without a lack; then one arm's certificate goes missing, and the command says so."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arms.csv").write_text(INVENTORY)
    ways = ["--core", "tls/core.example:7447", *(word for site, way in ROUTERS.items() for word in ("--router", f"{site}={way}"))]

    def asked(*words, code=0):
        result = CliRunner().invoke(app, ["plant", *words, "arms.csv", *ways])
        assert result.exit_code == code, result.output
        return result.output + (str(result.exception) if isinstance(result.exception, BadInput) else "")

    assert asked("enrol").startswith("plant: 3 arms; ")
    told = json.loads(asked("enrol", "--json"))
    assert (told["new"], told["changed"], told["kept"]) == ([], [], [])
    assert "hall-2.cell-1: no_serial" in asked("check", "--offline", code=3)
    (tmp_path / "plant/computers/ipc-1/tls/cell-2.key").unlink()
    lacks = json.loads(asked("check", "--offline", "--json", code=3))
    assert [[each["cause"] for each in lacks[name]] for name in lacks] == [["no_gains"], ["no_gains", "certificate"], ["no_serial"]]
    (tmp_path / "arms.csv").write_text(INVENTORY.replace("ur5e", "ur6"))
    assert "model = 'ur6'" in asked("enrol", code=1)  # main says it with exit code 2
