"""MQTT with a real broker: what it keeps is what the arms are, through its outages, and for nobody who may not."""

import itertools
import json
import signal
import socket
import subprocess
import threading
from collections import Counter
from types import SimpleNamespace

import page
import pytest
import trustme
from mosquitto_broker import PROGRAM, Mosquitto, Onlooker, waited
from told_arms import NOW_UNIX_S, alert, arm, row

from monitor.errors import BadInput
from monitor.gateway.connection import NotReached
from monitor.gateway.mqtt.broker import Incoming, MqttSettings, check
from monitor.gateway.mqtt.channel import MqttChannel
from monitor.plant.screen.people import Role
from monitor.publish.queries import AckRequest

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="mosquitto is not installed: apt-get install mosquitto")
ROOT = "joint-monitor"
ROOTS = itertools.count()


class Commands:
    """Arms that carry out what they are asked."""

    def __init__(self):
        self.done = []

    def send(self, name, command, document, *, who, role, via):
        if document["why"] == "refuse":
            raise BadInput("the arm says no")
        self.done.append((str(name), command, dict(document), who, role, via))
        return {"done": True}


class World:
    """A channel and the arms that it tells of. Its steps are called by the tests."""

    def __init__(self, folder, port, *arms, **settings):
        self.states = {each.name: each for each in arms}
        self.commands = Commands()
        given = {"host": "127.0.0.1", "port": port, "tls": False} | settings
        about = SimpleNamespace(plant=SimpleNamespace(folder=folder), arms=lambda: dict(self.states), commands=self.commands)
        self.channel = MqttChannel(MqttSettings(**given), about)

    def put(self, state):
        self.states[state.name] = state

    def step(self, now=NOW_UNIX_S):
        while self.channel.step(now) == 0.0:
            pass
        assert self.channel._broker.wait_idle()

    def until(self, condition, what):
        """Steps as the gateway takes them, a lost connection among them."""

        def stepped():
            try:
                self.step()
            except NotReached:
                return False
            return condition()

        waited(stepped, what)


@pytest.fixture(scope="module")
def broker(tmp_path_factory):
    made = Mosquitto(tmp_path_factory.mktemp("mosquitto"))
    yield made
    made.kill()


@pytest.fixture
def own_broker(tmp_path):
    """Makes a broker for this test alone; it ends with it."""
    made = []

    def make(*settings, **options):
        made.append(Mosquitto(tmp_path, *settings, **options))
        return made[-1]

    yield make
    for each in made:
        each.kill()


@pytest.fixture
def world(request, broker, tmp_path):
    """A channel with a root of its own, so that tests share a broker."""
    root = f"{ROOT}-{next(ROOTS)}"
    made = World(tmp_path, broker.port, arm(), root=root, home_assistant=f"ha-{root}", allow_acknowledge=getattr(request, "param", False))
    made.root, made.base = root, f"{root}/lab/cell-3"
    yield made
    made.channel.close()


allowed = pytest.mark.parametrize("world", [True], indirect=True, ids=["allowed"])


def test_the_broker_keeps_each_arm_as_it_is(world, broker):
    """State, joints, alerts and availability are retained; a second look at the same arm publishes nothing."""
    with Onlooker(broker.port, f"{world.root}/#") as onlooker:
        world.step()
        waited(lambda: onlooker.kept.get(f"{world.root}/availability") == b"online", "the gateway is online")
        assert onlooker.kept[f"{world.base}/availability"] == b"online"
        assert json.loads(onlooker.kept[f"{world.base}/state"])["state"] == "NORMAL"
        assert json.loads(onlooker.kept[f"{world.base}/joint/3"])["wear_percent"] == 3.0
        before = len(onlooker.heard)
        world.step()
        world.put(arm(friction={joint: row(joint, wear=0.5 if joint == 3 else 0.01 * joint) for joint in range(1, 7)}))
        world.step()
        waited(lambda: json.loads(onlooker.kept[f"{world.base}/joint/3"])["wear_percent"] == 50.0, "the new figure")
        assert onlooker.heard[before:] == [(f"{world.base}/joint/3", onlooker.kept[f"{world.base}/joint/3"])]
    with Onlooker(broker.port, f"{world.root}/#") as later:
        waited(lambda: len(later.kept) == 1 + 3 + 6, "whoever comes later sees everything")
    assert "MQTT 5" in world.channel.status()


def test_the_last_will_says_that_the_gateway_is_gone(world, broker):
    """A gateway that dies says nothing; the broker says it, and retains it."""
    world.step()
    with Onlooker(broker.port, f"{world.root}/availability") as onlooker:
        waited(lambda: onlooker.kept == {f"{world.root}/availability": b"online"}, "it is online")
        world.channel._broker._client.socket().shutdown(socket.SHUT_RDWR)
        waited(lambda: onlooker.kept == {f"{world.root}/availability": b"offline"}, "the will")
    world.until(lambda: world.channel._online, "it comes back")


def test_a_gateway_that_ends_says_goodbye(world, broker):
    """Its availability is offline at once, not after the broker's patience."""
    world.step()
    world.channel.close()
    with Onlooker(broker.port, f"{world.root}/#") as onlooker:
        waited(lambda: onlooker.kept.get(f"{world.root}/availability") == b"offline", "goodbye")


def test_a_robot_that_is_removed_is_cleared(world, broker):
    """Its topics and its device are gone: while the gateway runs, and where it was removed while the gateway did not."""
    world.put(arm("cell-4"))
    world.put(arm("cell 5 ä+"))
    world.step()
    del world.states[arm("cell-4").name]
    with Onlooker(broker.port, f"+/{world.root}/#") as _, Onlooker(broker.port) as onlooker:
        world.step()

        def topics(of):
            return [topic for topic in onlooker.kept if topic.startswith((world.root, f"ha-{world.root}/")) and of in topic]

        waited(lambda: not topics("cell-4"), "cell-4 is cleared")
        world.channel.close()
        del world.states[arm("cell 5 ä+").name]
        again = World(world.channel._folder, broker.port, arm(), root=world.root, home_assistant=f"ha-{world.root}")
        again.until(lambda: not topics("cell%205") and not topics("cell_205"), "cell 5 is cleared by the next run")
        assert len(topics("cell-3")) == 3 + 6 + 1
        again.channel.close()


def test_home_assistant_is_told_again_when_it_starts(world, broker):
    """Its birth message is answered with every device; what it says when it stops is not."""
    world.step()
    config = f"ha-{world.root}/device/{world.channel._topics(arm().name).identity}/config"
    with Onlooker(broker.port, f"ha-{world.root}/#") as onlooker:
        waited(lambda: config in onlooker.kept, "the device is announced")
        onlooker.heard.clear()
        onlooker.publish(f"ha-{world.root}/status", "offline")
        onlooker.publish(f"ha-{world.root}/status", "online")
        world.until(lambda: (config, onlooker.kept[config]) in onlooker.heard, "the device is announced again")
        assert Counter(topic for topic, _ in onlooker.heard)[config] == 1


@allowed
def test_a_button_acknowledges_the_alerts_of_its_joint(world, broker):
    """Only those that wait, in the name that the message gives, with the role that the settings give; the answer stands beside it."""
    world.put(arm(alerts=[alert(3), alert(3, "offset", acknowledged_at="2026-11-18T04:00:00Z"), alert(None, "ran_in"), alert(4)]))
    world.step()
    with Onlooker(broker.port, f"{world.base}/#") as onlooker:
        press = json.loads(_announced(broker, world))["components"]["j3_acknowledge"]
        onlooker.publish(press["command_topic"], press["payload_press"])
        world.until(lambda: world.commands.done, "it is carried out")
        expected = {"joint": 3, "condition": "wear_rising", "why": ""}
        assert world.commands.done == [("lab/cell-3", "ack", expected, "Home Assistant (MQTT)", Role.acknowledge, "mqtt")]
        AckRequest.model_validate({**expected, "by": "Home Assistant (MQTT)"})  # as the arm reads it
        answer = f"{world.base}/cmd/ack/answer"
        waited(lambda: (answer, b'{"done":1,"text":"acknowledged: 1"}') in onlooker.heard, "its answer")


@allowed
@pytest.mark.parametrize(
    ("payload", "says"),
    [
        ("ON", "expected a JSON object"),
        ("[1]", "expected a JSON object"),
        ('{"joint": "3"}', "joint = '3'"),
        ('{"force": true}', "'force' is unknown"),
        ('{"joint": 3, "why": "refuse"}', "the arm says no"),
        ('{"joint": 5}', "no alert waits"),
    ],
)
def test_a_command_that_is_none_is_refused_with_the_reason(world, broker, payload, says):
    """And nothing is done."""
    world.put(arm(alerts=[alert(3)]))
    world.step()
    with Onlooker(broker.port, f"{world.base}/cmd/ack/answer") as onlooker:
        onlooker.publish(f"{world.base}/cmd/ack", payload)
        world.until(lambda: onlooker.heard, "an answer")
        answer = json.loads(onlooker.heard[0][1])
        assert answer["done"] == 0
        assert says in answer["text"]
    assert world.commands.done == []


@allowed
def test_arms_that_answer_late_do_not_make_a_step_long(world, monkeypatch):
    """What more is asked waits for the next step, and is done."""
    world.put(arm(alerts=[alert(3)]))
    world.step()
    done, sleep = world.commands.send, threading.Event().wait
    monkeypatch.setattr(world.commands, "send", lambda *about, **more: sleep(0.1) or done(*about, **more))
    monkeypatch.setattr("monitor.gateway.mqtt.channel.AT_MOST_S", 0.05)
    for _ in range(3):
        world.channel._broker.incoming.put(Incoming(f"{world.base}/cmd/ack", b'{"joint": 3}', False))
    assert world.channel.step(NOW_UNIX_S) == 0.0
    assert len(world.commands.done) <= 1
    world.until(lambda: len(world.commands.done) == 3, "all are done")


@allowed
def test_a_retained_command_is_never_carried_out(world, broker):
    """It is of nobody knows when, and would come again with each connection."""
    with Onlooker(broker.port, f"{world.base}/cmd/ack/answer") as onlooker:
        onlooker.publish(f"{world.base}/cmd/ack", '{"joint": 3}', retain=True)
        world.put(arm(alerts=[alert(3)]))
        world.until(lambda: onlooker.heard, "a refusal")
        assert b"retained" in onlooker.heard[0][1]
        onlooker.publish(f"{world.base}/cmd/ack", "", retain=True)
    assert world.commands.done == []


def test_without_leave_no_command_is_heard(world, broker):
    """The topic is not even subscribed to, and no button is offered."""
    world.put(arm(alerts=[alert(3)]))
    world.step()
    with Onlooker(broker.port, f"{world.base}/#") as onlooker:
        onlooker.publish(f"{world.base}/cmd/ack", '{"joint": 3}')
        waited(lambda: (f"{world.base}/cmd/ack", b'{"joint": 3}') in onlooker.heard, "the broker has passed it on")
        world.step()
    assert world.commands.done == []
    assert "command_topic" not in _announced(broker, world)


def _announced(broker, world):
    with Onlooker(broker.port, f"ha-{world.root}/device/#") as onlooker:
        waited(lambda: onlooker.kept, "a device is announced")
        return next(iter(onlooker.kept.values())).decode()


def test_after_an_outage_each_value_is_told_once_as_it_is_then(tmp_path, own_broker):
    """A day of changes is not queued: the broker, which has lost everything, gets the last value of each topic, and no other one."""
    broker = own_broker()
    world = World(tmp_path, broker.port, arm(), arm("cell-4"))
    world.step()
    broker.kill()
    waited(lambda: not world.channel._broker.connected, "the loss is noticed")
    for minute in range(1440):
        world.put(arm(friction={joint: row(joint, wear=minute / 1000.0) for joint in range(1, 7)}))
        if minute % 288 == 0:
            with pytest.raises(NotReached):
                world.step()
    broker.start()
    with Onlooker(broker.port) as onlooker:
        world.until(lambda: onlooker.kept.get(f"{ROOT}/availability") == b"online", "it is back")
        assert set(Counter(topic for topic, _ in onlooker.heard).values()) == {1}
        assert len(onlooker.heard) == 1 + 2 * (3 + 6 + 1)
        assert json.loads(onlooker.kept[f"{ROOT}/lab/cell-3/joint/1"])["wear_percent"] == 143.9
    assert "MQTT 5" in world.channel.status()
    world.channel.close()


def test_a_name_and_a_certificate_are_asked_for_and_shown(tmp_path, own_broker):
    """Over TLS with a client's certificate, user and password; what is wrong is said in a sentence, and never the password."""
    authority, other = trustme.CA(), trustme.CA()
    authority.issue_cert("127.0.0.1").private_key_and_cert_chain_pem.write_to_path(tmp_path / "broker.pem")
    for name, signs in (("gateway", authority), ("stranger", other)):
        signs.issue_cert("gateway@plant").private_key_and_cert_chain_pem.write_to_path(tmp_path / f"{name}.pem")
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    other.cert_pem.write_to_path(tmp_path / "other.pem")
    passwords, rights = tmp_path / "passwords", tmp_path / "rights"
    subprocess.run(["mosquitto_passwd", "-c", "-b", passwords, "gateway", "s3cret+word"], check=True, capture_output=True)
    rights.write_text(f"user gateway\ntopic readwrite {ROOT}/#\n")
    files = [f"cafile {tmp_path / 'ca.pem'}", f"certfile {tmp_path / 'broker.pem'}", f"keyfile {tmp_path / 'broker.pem'}"]
    broker = own_broker(*files, "require_certificate true", f"password_file {passwords}", f"acl_file {rights}", anonymous=False)
    good = {"host": "127.0.0.1", "port": broker.port, "user": "gateway", "password": "s3cret+word"}
    good |= {"ca_file": "ca.pem", "cert_file": "gateway.pem", "key_file": "gateway.pem"}
    plant = SimpleNamespace(folder=tmp_path)

    def steps(**changes):
        found = check(MqttSettings(**(good | changes)), plant)
        assert not any("s3cret" in each.text for each in found)
        return {each.step: each.ok for each in found}, found[-1].text

    reached = {"name": True, "tcp": True, "tls": True}
    assert steps(home_assistant="")[0] == reached | {"authentication": True, "authorisation": True}
    rights.write_text(rights.read_text() + "topic write homeassistant/device/#\ntopic read homeassistant/status\n")
    broker.process.send_signal(signal.SIGHUP)  # mosquitto reads its rights again
    waited(lambda: steps()[0] == reached | {"authentication": True, "authorisation": True}, "the rights of the page")
    assert page.said(check(MqttSettings(**good), plant)) == page.findings("mqtt")
    rights.write_text(f"user gateway\ntopic readwrite {ROOT}/#\n")
    broker.process.send_signal(signal.SIGHUP)
    waited(lambda: not all(steps()[0].values()), "fewer rights")
    ends, text = steps()
    assert ends == reached | {"authentication": True, "authorisation": False}
    assert "homeassistant" in text
    ends, text = steps(password="wrong")
    assert ends == reached | {"authentication": False}
    assert "user" in text
    ends, text = steps(ca_file="other.pem")
    assert ends == {"name": True, "tcp": True, "tls": False}
    assert "not believed" in text
    ends, text = steps(cert_file="stranger.pem", key_file="stranger.pem")
    assert not all(ends.values())
    ends, text = steps(tls=False, ca_file="", cert_file="", key_file="")
    assert not all(ends.values())
    ends, text = steps(cert_file="none.pem", key_file="none.pem")
    assert "none.pem" in text
    world = World(tmp_path, broker.port, arm(), **{key: value for key, value in good.items() if key != "port"}, tls=True)
    world.step()
    assert "refuses messages: Not authorized" in world.channel.status()  # discovery lies outside of its rights
    world.channel.close()


def test_a_broker_that_does_not_know_mqtt_5_is_spoken_to_in_3_1_1(tmp_path):
    """It hangs up on the newer version, and is spoken to in the older one at once."""
    levels = []

    def serve(listening):
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            with connection:
                asked = connection.recv(4096)
                levels.append(asked[asked.index(b"MQTT") + 4])
                if levels[-1] == 4:
                    connection.sendall(b"\x20\x02\x00\x00")
                    while (said := connection.recv(4096)) and said[0] >> 4 == 8:
                        connection.sendall(b"\x90\x03" + said[2:4] + b"\x01")  # a subscription, granted

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=serve, args=(listening,), daemon=True).start()
        world = World(tmp_path, listening.getsockname()[1], home_assistant="")
        world.channel.step(NOW_UNIX_S)
        assert levels == [5, 4]
        assert "MQTT 3.1.1" in world.channel.status()
        world.channel.close()
