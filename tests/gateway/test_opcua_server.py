"""OPC UA over the wire: the address space that the nodesets ask for, values that say how good they are, and nobody who may not."""

import asyncio
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime
from types import SimpleNamespace

import nodeset_judge
import page
import pytest
from asyncua import Client, ua
from asyncua.crypto.cert_gen import dump_private_key_as_pem, generate_private_key, generate_self_signed_app_certificate
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from told_arms import NOW_UNIX_S, REPLAYED_UNIX_S, alert, arm, health, row

from monitor.errors import BadInput
from monitor.gateway.opcua.nodes import ARTICULATED_ROBOT, CONDITION, NE107, arm_nodes, motion_profile, readings
from monitor.gateway.opcua.server import ConditionServer, NotReached, OpcuaChannel, Users
from monitor.gateway.opcua.settings import OpcuaSettings, check, identity, trust_store
from monitor.plant.arm import GONE
from monitor.plant.screen.people import Role, line_of, new_user

OWN = "urn:joint-monitor:friction-health"
SPACES = {OWN: "own", **{f"{nodeset_judge.FOUNDATION}{name}/": name for name in ("DI", "IA", "Machinery", "Robotics")}}
CLIENT = "urn:test:client"


class World:
    """A running server, and clients of it."""

    def __init__(self, folder, **settings):
        self.folder = folder
        user, self.token = new_user("scada", Role.look)
        (folder / "users").write_text(line_of(user) + "\n")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            listen = f"127.0.0.1:{probe.getsockname()[1]}"
        self.settings = OpcuaSettings(**{"listen": listen, "users_file": "users"} | settings)
        self.who = identity(self.settings, folder, folder)
        self.server = ConditionServer(self.settings, folder, self.who)
        self.url = self.settings.url(self.who.host)
        self.key, self.certificate = credentials(folder, "client")

    def put(self, *states, now=NOW_UNIX_S):
        written, complete = self.server.put(list(states), now)
        assert complete
        return written

    @asynccontextmanager
    async def client(self, user="scada", token=None, secured=True, credentials=None):
        client = Client(self.url, timeout=30.0)
        client.application_uri = CLIENT
        if secured:
            key, certificate = credentials or (self.key, self.certificate)
            await client.set_security(SecurityPolicyBasic256Sha256, certificate, key, server_certificate=self.who.certificate)
        if user is not None:
            client.set_user(user)
            client.set_password(self.token if token is None else token)
        async with client:
            yield client


def credentials(folder, name):
    """A client's key and certificate, as files."""
    key = generate_private_key()
    names = [x509.UniformResourceIdentifier(CLIENT), x509.DNSName("localhost")]
    certificate = generate_self_signed_app_certificate(key, name, {}, names, [x509.ExtendedKeyUsageOID.CLIENT_AUTH])
    (folder / f"{name}.pem").write_bytes(dump_private_key_as_pem(key))
    (folder / f"{name}.der").write_bytes(certificate.public_bytes(Encoding.DER))
    return folder / f"{name}.pem", folder / f"{name}.der"


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """One server for the tests of this module: it takes two seconds to start."""
    made = World(tmp_path_factory.mktemp("opcua"))
    yield made
    made.server.close()


def run(production):
    """In a thread of its own: another test's browser may have an event loop that runs in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, production).result()


async def read(client, path, device="device/lab/cell-3"):
    """A value with its status and times."""
    space = await client.get_namespace_index(OWN)
    return await client.get_node(ua.NodeId(f"{device}/{path}", space)).read_data_value(raise_on_bad_status=False)


async def seen(client, node, names):
    """What a client finds below a node: everything that it browses."""
    members = {}
    for each in await node.get_references(ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward):
        if each.ReferenceTypeId.Identifier in (ua.ObjectIds.HasComponent, ua.ObjectIds.HasProperty, ua.ObjectIds.HasAddIn):
            below = await seen(client, client.get_node(each.NodeId), names)
            data = None
            if each.NodeClass == ua.NodeClass.Variable:
                data = place(await client.get_node(each.NodeId).read_data_type(), names)
            name = f"{names[each.BrowseName.NamespaceIndex]}:{each.BrowseName.Name}"
            members[name] = below._replace(
                name=name, kind=f"UA{each.NodeClass.name}", type=place(each.TypeDefinition, names), data_type=data
            )
    return nodeset_judge.Found("", "UAObject", None, None, members)


def place(node_id, names):
    return f"{names[node_id.NamespaceIndex]}:{node_id.Identifier}"


async def spaces(client):
    return ["0", *(SPACES.get(uri, uri) for uri in (await client.get_namespace_array())[1:])]


def test_the_nodesets_find_every_mandatory_member(world):
    """Systems, devices, axes, motors and controllers have what OPC 40010-1, DI and Machinery ask of them, by a client's browsing."""
    world.put(arm(count=2), arm("cell 4/ä.x", site="new", count=1))
    nodesets = nodeset_judge.Nodesets()

    async def browsed():
        async with world.client() as client:
            names = await spaces(client)
            devices = await client.nodes.objects.get_child(f"{names.index('DI')}:DeviceSet")
            machines = await client.nodes.objects.get_child(f"{names.index('Machinery')}:Machines")
            found = await seen(client, devices, names)
            return found, {each.BrowseName.Name for each in await machines.get_children_descriptions()}

    found, machines = run(browsed())
    assert nodeset_judge.lacking(nodesets, found, "DeviceSet") == []
    assert machines == {"cell-3", "cell 4/ä.x"}
    systems = found.members
    assert set(systems) == {"own:lab", "own:new"}
    assert {each.type for each in systems.values()} == {"Robotics:1002"}
    devices = systems["own:lab"].members["Robotics:MotionDevices"].members
    assert set(devices["own:cell-3"].members["Robotics:Axes"].members) == {"own:J1", "own:J2"}
    assert devices["own:cell-3"].members["DI:DeviceHealth"].data_type == "DI:6244"
    # the judge finds what is taken away, so it can find what is forgotten
    axis = devices["own:cell-3"].members["Robotics:Axes"].members["own:J1"]
    without = axis._replace(members={name: member for name, member in axis.members.items() if name != "Robotics:MotionProfile"})
    assert nodeset_judge.lacking(nodesets, without, "J1") == ["J1: Robotics:MotionProfile is missing"]
    empty = systems["own:lab"].members["Robotics:MotionDevices"]._replace(members={})
    broken = systems["own:lab"]._replace(members=systems["own:lab"].members | {"Robotics:MotionDevices": empty})
    assert any("<MotionDeviceIdentifier>" in each for each in nodeset_judge.lacking(nodesets, broken, "lab"))


def test_the_numbers_of_states_and_kinds_are_the_nodesets():
    """Health by NE 107, an articulated robot, a rotary axis: as the OPC Foundation numbers them."""
    known = nodeset_judge.Nodesets().enumerations
    assert known["DI:DeviceHealthEnumeration"] == NE107
    assert known["Robotics:MotionDeviceCategoryEnumeration"]["ARTICULATED_ROBOT"] == ARTICULATED_ROBOT
    profiles = known["Robotics:AxisMotionProfileEnumeration"]
    turns = [motion_profile(model, joint) for model, joint in (("ur5e", 6), ("ur3e", 5), ("ur3e", 6), ("ur30", 6), (None, 1))]
    assert turns == [profiles["ROTARY"], profiles["ROTARY"], profiles["ROTARY_ENDLESS"], profiles["ROTARY"], None]


def test_a_joint_says_its_condition_with_unit_status_and_time(world):
    """Wear, its deviation, remaining life, temperature and state; what a member cannot know says so, and no figure is invented."""
    world.put(arm(alerts=[alert(3)], friction={3: row(3), 4: row(4, p10_days=None, p50_days=None, p90_days=None)}))

    async def values():
        async with world.client() as client:
            found = {}
            for joint in (3, 4, 5):
                for name in ("Wear", "WearStandardDeviation", "RemainingLifeP50", "JointTemperature", "ActiveAlerts", "ActualPosition"):
                    found[joint, name] = await read(client, f"J{joint}/ParameterSet/{name}")
            found["state"] = await read(client, "DeviceHealth")
            found["unit"] = await read(client, "J3/ParameterSet/Wear/EngineeringUnits")
            found["serial"] = await read(client, "SerialNumber")
            found["motor"] = await read(client, "P3/Motor/ParameterSet/MotorTemperature")
            return found

    found = run(values())
    at = datetime.fromtimestamp(REPLAYED_UNIX_S, UTC)
    wear = found[3, "Wear"]
    assert (wear.Value.Value, wear.StatusCode.is_good()) == (3.0, True)
    assert wear.SourceTimestamp.replace(tzinfo=UTC) == at
    assert found[3, "WearStandardDeviation"].Value.Value == 0.4
    assert found[3, "RemainingLifeP50"].Value.Value == 80.5
    assert found["motor"].Value.Value == found[3, "JointTemperature"].Value.Value == 33.0
    assert (found[3, "ActiveAlerts"].Value.Value, found[4, "ActiveAlerts"].Value.Value) == (1, 0)
    assert found["state"].Value.Value == 4  # MAINTENANCE_REQUIRED
    assert found["serial"].Value.Value == "20195500001"
    unit = found["unit"].Value.Value
    assert (unit.UnitId, unit.DisplayName.Text) == (20529, "%")  # P1 of UNECE recommendation 20
    assert found[4, "RemainingLifeP50"].StatusCode.name == "BadNoData"
    assert found[5, "Wear"].StatusCode.name == "BadWaitingForInitialData"
    assert found[3, "ActualPosition"].StatusCode.name == "BadNotSupported"
    assert found[3, "ActualPosition"].Value.Value is None


def test_the_pages_reader_reads(world, monkeypatch, capsys):
    """The program of the page runs as it stands, with this server's address and this client's credentials."""
    world.put(arm())
    (program,) = page.blocks("OPC UA", "python")
    changes = {"opc.tcp://plant.example:4840/joint-monitor": world.url, "urn:reader.example": CLIENT, "the token": world.token}
    changes |= {"reader.der": str(world.certificate), "reader.pem": str(world.key)}
    for shown, own in changes.items():
        assert shown in program
        program = program.replace(shown, own)
    with ThreadPoolExecutor(1) as thread:  # a browser of another test may keep an event loop running in this one
        thread.submit(exec, compile(program, "page", "exec"), {}).result()
    assert capsys.readouterr().out == "3.0\n"


def test_the_page_shows_each_key_status_and_name():
    """What stands in the tables is what there is."""
    assert sorted(page.first_cells("OPC UA", "key of `[opcua]`")) == sorted(page.keys(OpcuaSettings))
    silent = arm(silent_since_unix_s=NOW_UNIX_S)
    told = [readings(each, NOW_UNIX_S + hours * 3600.0, 86_400.0) for each, hours in ((silent, 1), (silent, 30))]
    told += [readings(arm(health=health(stale=True), friction={1: row(1, p10_days=None)}), NOW_UNIX_S, 86_400.0)]
    said = {reading.status for each in told for reading in each.values()} | {each.status for each in arm_nodes(arm())}
    assert set(page.first_cells("OPC UA", "status")) == said
    assert all(f"`{name}`" in page.section("OPC UA") for name, _, _ in CONDITION if not name.startswith("RemainingLife"))


def test_a_silent_arm_is_uncertain_and_then_bad(world):
    """Its last values stay readable for a day, and say what they are; then nobody gets them. What the arm is does not age."""
    silent = arm(silent_since_unix_s=NOW_UNIX_S, silent_why=GONE)
    stale = arm("cell-4", health=health(stale=True))

    async def values(*paths, device="device/lab/cell-3"):
        async with world.client() as client:
            return [await read(client, path, device) for path in paths]

    paths = ("DeviceHealth", "J1/ParameterSet/Wear", "ParameterSet/StateText", "SerialNumber")
    world.put(silent, stale, now=NOW_UNIX_S + 60.0)
    state, wear, why, serial = run(values(*paths))
    assert state.StatusCode.name == wear.StatusCode.name == "UncertainNoCommunicationLastUsableValue"
    assert wear.Value.Value == 1.0
    assert why.Value.Value == "its monitor is gone"
    assert serial.StatusCode.is_good()
    (state,) = run(values("DeviceHealth", device="device/lab/cell-4"))
    assert (state.StatusCode.name, state.Value.Value) == ("UncertainLastUsableValue", 0)
    world.put(silent, now=NOW_UNIX_S + 25 * 3600.0)
    state, wear, why, serial = run(values(*paths))
    assert state.StatusCode.name == wear.StatusCode.name == "BadNoCommunication"
    assert wear.Value.Value is None
    assert serial.StatusCode.is_good()
    world.put(arm())
    assert run(values("DeviceHealth"))[0].StatusCode.is_good()


def test_only_what_has_changed_is_written_and_subscribers_hear_it(world):
    """A second look at the same arm writes nothing; a new figure reaches whoever subscribed."""
    world.put(arm())
    assert world.put(arm()) == 0

    async def heard():
        async with world.client() as client:
            space = await client.get_namespace_index(OWN)
            values: asyncio.Queue = asyncio.Queue()
            handler = SimpleNamespace(datachange_notification=lambda node, value, data: values.put_nowait(value))
            subscription = await client.create_subscription(50, handler)
            await subscription.subscribe_data_change(client.get_node(ua.NodeId("device/lab/cell-3/J1/ParameterSet/Wear", space)))
            first = await asyncio.wait_for(values.get(), 30.0)
            changed = arm(friction={joint: row(joint, wear=0.25 if joint == 1 else 0.01 * joint) for joint in range(1, 7)})
            written = await asyncio.to_thread(world.put, changed)
            return first, await asyncio.wait_for(values.get(), 30.0), written

    assert run(heard()) == (1.0, 25.0, 1)


def test_an_arm_that_is_removed_leaves_nothing_behind(world):
    """Neither nodes nor references to them; another arm of its site stays, and the same arm may come back with more joints."""
    nodes = world.server._server.iserver.aspace
    world.put(arm("cell-8"))
    before = {str(node) for node in nodes._nodes}
    world.put(arm("cell-8"), arm("cell-9"), arm("cell-9", site="other"))
    world.put(arm("cell-8"))
    assert {str(node) for node in nodes._nodes} == before
    dangling = [(node, each.NodeId) for node in nodes._nodes for each in nodes[node].references if each.NodeId not in nodes]
    assert [each for each in dangling if "cell-9" in str(each) or "other" in str(each)] == []
    world.put(arm("cell-8"), arm("cell-9", count=7))
    assert ua.NodeId("device/lab/cell-9/J7", world.server._space._spaces[OWN]) in nodes


def test_nobody_writes_or_calls(world):
    """A user who may read may do nothing else: neither to our nodes nor to those of the nodesets."""
    world.put(arm())

    async def tried():
        async with world.client() as client:
            space = await client.get_namespace_index(OWN)
            wear = client.get_node(ua.NodeId("device/lab/cell-3/J1/ParameterSet/Wear", space))
            di = await client.get_namespace_index(f"{nodeset_judge.FOUNDATION}DI/")
            robotics = await client.get_namespace_index(f"{nodeset_judge.FOUNDATION}Robotics/")
            for node in (wear, client.get_node(ua.NodeId(6172, robotics))):
                with pytest.raises(ua.UaStatusCodeError, match="permission"):
                    await node.write_value(ua.Variant(0.0, ua.VariantType.Double))
            with pytest.raises(ua.UaStatusCodeError):
                await client.nodes.objects.add_object(di, "mine")
            with pytest.raises(ua.UaStatusCodeError):
                await client.nodes.server.call_method("0:GetMonitoredItems", 1)
            assert (await wear.read_value()) == 1.0

    run(tried())


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ({"token": "wrong"}, ua.uaerrors.BadUserAccessDenied),
        ({"user": "somebody"}, ua.uaerrors.BadUserAccessDenied),
        ({"user": None}, ua.uaerrors.BadIdentityTokenRejected),
        ({"secured": False}, ua.UaError),
        ({"secured": False, "user": None}, ua.UaError),
    ],
)
def test_nobody_gets_in_without_token_and_encryption(world, options, refusal):
    """A wrong token, another's name, nobody's name, and a channel without encryption are refused."""

    async def tried():
        async with world.client(**options):
            pass

    with pytest.raises(refusal):
        run(tried())


def test_endpoints_are_told_and_are_encrypted_ones_alone(world):
    """A client without encryption may look for endpoints: none of them is without."""
    found = run(Client(world.url, timeout=30.0).connect_and_get_server_endpoints())
    assert {each.SecurityMode for each in found} == {ua.MessageSecurityMode.SignAndEncrypt}
    assert {token.TokenType for each in found for token in each.UserIdentityTokens} == {ua.UserTokenType.UserName}
    assert {each.SecurityPolicyUri.rpartition("#")[2] for each in found} >= {"Basic256Sha256"}
    assert {each.Server.ApplicationUri for each in found} == {world.who.uri}


@pytest.mark.parametrize("secured", [True, False])
def test_a_session_is_not_taken_over_by_another_connection(world, secured):
    """Whoever knows or guesses its number gets nothing, not even with an encrypted channel of his own."""
    world.put(arm())

    async def tried():
        async with world.client() as client:
            number = client.uaclient.protocol.authentication_token
            thief = Client(world.url, timeout=30.0)
            if secured:
                await thief.set_security(
                    SecurityPolicyBasic256Sha256, world.certificate, world.key, server_certificate=world.who.certificate
                )
            await thief.connect_socket()
            try:
                await thief.send_hello()
                await thief.open_secure_channel()
                thief.uaclient.protocol.authentication_token = number
                with pytest.raises(ua.UaError):
                    await thief.uaclient.read_attributes([ua.NodeId(2259)], ua.AttributeIds.Value)
                with pytest.raises(ua.UaError):
                    await thief.uaclient.activate_session(ua.ActivateSessionParameters(UserIdentityToken=ua.AnonymousIdentityToken()))
            finally:
                thief.disconnect_socket()
            assert (await read(client, "SerialNumber")).StatusCode.is_good()

    run(tried())


def test_the_certificate_is_made_once_and_kept(world):
    """Whoever trusts it trusts it after the next start; the key is nobody else's."""
    from monitor.gateway.opcua.settings import ensure, load

    before = world.who.certificate.read_bytes()
    assert not ensure(world.who, world.settings)
    assert world.who.certificate.read_bytes() == before
    assert world.who.key.stat().st_mode & 0o777 == 0o600
    names = load(world.who.certificate).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.UniformResourceIdentifier) == [world.who.uri]


def test_check_says_users_certificate_and_address(world, tmp_path):
    """Of a running gateway, of an address that another program has, and of one that is free."""
    plant = SimpleNamespace(folder=world.folder, directory=world.folder)
    found = {each.step: each for each in check(world.settings, plant)}
    assert all(each.ok for each in found.values())
    assert "1 users" in found["authentication"].text
    assert "valid until" in found["certificate"].text
    assert "the gateway listens there" in found["address"].text
    assert page.said(found.values()) == page.findings("opcua")
    elsewhere = SimpleNamespace(folder=tmp_path, directory=tmp_path)
    found = {each.step: each for each in check(world.settings, elsewhere)}
    assert not found["authentication"].ok
    assert "the first start makes" in found["certificate"].text
    assert "another OPC UA server" in found["address"].text
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(NotReached, match="cannot listen"):
            World(tmp_path, listen=f"127.0.0.1:{port}")
    found = {each.step: each for each in check(replace(world.settings, listen=f"127.0.0.1:{port}"), elsewhere)}
    assert found["address"].ok
    assert "is free" in found["address"].text


def test_trusted_clients_alone_get_in_where_that_is_asked(world, tmp_path, monkeypatch):
    """With a folder of certificates a client needs one of them beside its token; anonymous only where allowed."""
    (tmp_path / "trusted").mkdir()
    settings = replace(world.settings, trusted_clients=str(tmp_path / "trusted"), allow_anonymous=True)
    with pytest.raises(BadInput, match=r"expected certificates there"):
        run(trust_store(settings, tmp_path))
    (tmp_path / "trusted" / "client.der").write_bytes(world.certificate.read_bytes())
    stranger = credentials(tmp_path, "stranger")
    users = Users(settings, world.folder, run(trust_store(settings, tmp_path)))
    monkeypatch.setattr(world.server._server.iserver, "user_manager", users)

    async def tried(**options):
        async with world.client(**options) as client:
            return await client.nodes.server_state.read_value()

    assert run(tried()) == 0
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        run(tried(credentials=stranger))
    own = world.certificate.read_bytes()
    assert users.get_user(None, None, None, own) is not None  # anonymous
    assert users.get_user(None, None, None, None) is None  # and not without encryption
    assert users.get_user(None, "scada", world.token, None) is None


def test_a_channel_serves_its_sites_and_no_more_arms_than_it_may(tmp_path, monkeypatch):
    """What is left out is told, and arms are looked at again only where they have changed."""
    served = []

    class Recorder:
        clients = 0

        def __init__(self, *_): ...

        def put(self, arms, _now):
            served.append([each.name for each in arms])
            return 0, True

        def close(self): ...

    monkeypatch.setattr("monitor.gateway.opcua.server.ConditionServer", Recorder)
    states = {each.name: each for each in (arm("a"), arm("b"), arm("c"), arm("d", site="other"))}
    about = SimpleNamespace(plant=SimpleNamespace(folder=tmp_path, directory=tmp_path), arms=lambda: states)
    channel = OpcuaChannel(OpcuaSettings(listen="127.0.0.1:4840", allow_anonymous=True, sites=("lab",), most_arms=2), about)
    assert channel.status() == "not listening"
    channel.step(NOW_UNIX_S)
    assert [[str(name) for name in each] for each in served] == [["lab/a", "lab/b"]]
    assert "1 arms are left out" in channel.status()
    states.clear()
    channel.step(NOW_UNIX_S)
    assert len(served) == 1  # a database that is not read yet takes nobody away
    channel.close()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"listen": "4840"}, "listen = '4840'"),
        ({"listen": "0.0.0.0:4840"}, "nobody could sign in"),
        ({"listen": "0.0.0.0:4840", "allow_anonymous": True, "cert_file": "a.der"}, "belong together"),
        ({"listen": "0.0.0.0:4840", "allow_anonymous": True, "host": "opc.tcp://plant"}, "host = "),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(changes, says):
    """The sentence names the key."""
    with pytest.raises(BadInput, match=says):
        OpcuaSettings(**changes)
