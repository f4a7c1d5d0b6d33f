"""From an arm's alert to a button of Home Assistant and back: a real monitor, bus, plant, gateway and broker."""

import json
import time
from contextlib import ExitStack, suppress

import pytest
import sqlalchemy as sa
import zenoh
from mosquitto_broker import PROGRAM, Mosquitto, Onlooker

from monitor.config.load import from_document
from monitor.gateway.run import Gateway
from monitor.gateway.settings import load_gateway
from monitor.judge.alerts.health import Alert, Health, JointHealth
from monitor.plant.run import Plant
from monitor.plant.settings import load_plant
from monitor.plant.tables import audit
from monitor.publish.session import session_config
from monitor.reason import reason_of
from monitor.service.daemon import Daemon
from monitor.store.store import Store

ARM = "joint-monitor/lab/cell-1"


def raised(daemon, joint):
    """An alert, as a verdict raises it: stored, held and published."""
    at = time.time()
    alert = Alert(
        joint=joint, condition="wear_rising", tier="wear", raised_at_unix_s=at, updated_at_unix_s=at,
        change=0.06, probability=0.99, text=reason_of(f"Joint {joint}: friction rose"), action=reason_of("inspect"),
    )  # fmt: skip
    with daemon.state.revising:
        joints = tuple(JointHealth(joint=k, state="NORMAL", why="well", since_unix_s=at) for k in range(1, 7))
        daemon.alerts.keep(Health(joints=joints, alerts=(*daemon.state.alerts.alerts, alert)), "raised", alert, at)


@pytest.mark.skipif(PROGRAM is None, reason="mosquitto is not installed: apt-get install mosquitto")
def test_a_press_of_a_button_is_carried_out_by_the_arm_and_its_state_returns(free_port, tmp_path):
    """As Home Assistant does it: by what the discovery message says of the button, and nothing else."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    cell = {"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}, "store": {"directory": str(tmp_path / "history")}}
    cell["bus"] = {"connect": [endpoint], "listen": []}
    with ExitStack() as stack:
        broker = Mosquitto(tmp_path)
        stack.callback(broker.kill)
        (tmp_path / "plant.toml").write_text(
            f'[plant]\nconnect = ["{endpoint}"]\ndatabase = "sqlite:///{tmp_path}/plant.sqlite"\n'
            f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\ntls = false\nallow_acknowledge = true\n'
        )
        stack.enter_context(zenoh.open(session_config(mode="router", listen=(endpoint,))))
        store = stack.enter_context(Store.open(tmp_path / "history"))
        daemon = stack.enter_context(Daemon(from_document(cell, tmp_path / "cell.toml"), store, now=time.time, play=None))
        plant = stack.enter_context(Plant(load_plant(tmp_path / "plant.toml", {})))
        gateway = stack.enter_context(Gateway(load_gateway(tmp_path / "plant.toml", {})))
        home = stack.enter_context(Onlooker(broker.port))

        def until(condition):
            deadline = time.monotonic() + 60.0
            while not condition():
                assert time.monotonic() < deadline, (plant.status(), gateway.status())
                plant.step()
                gateway.step()
                if gateway.trouble is None:
                    gateway.start()
                time.sleep(0.02)

        def of_joint(joint):
            with suppress(KeyError):
                return json.loads(home.kept[f"{ARM}/joint/{joint}"])["unacknowledged"]

        raised(daemon, 3)
        raised(daemon, 5)
        until(lambda: (of_joint(3), of_joint(5)) == (1, 1) and "homeassistant/device/joint-monitor_-lab_-cell-1/config" in home.kept)
        (discovery,) = (said for topic, said in home.kept.items() if topic.endswith("/config"))
        button = json.loads(discovery)["components"]["j3_acknowledge"]
        home.publish(button["command_topic"], button["payload_press"])
        until(lambda: (f"{ARM}/cmd/ack/answer", b'{"done":1,"text":"acknowledged: 1"}') in home.heard)
        until(lambda: (of_joint(3), of_joint(5)) == (0, 1))
        held = {alert.joint: alert.acknowledged_by for alert in daemon.state.alerts.alerts}
        assert held == {3: "Home Assistant (MQTT)", 5: None}
        assert [(each.document["kind"], each.document["by"]) for each in store.events.rows(after=2)] == [
            ("acknowledged", "Home Assistant (MQTT)")
        ]
        shown = {each["joint"]: each["acknowledged_by"] for each in json.loads(home.kept[f"{ARM}/alerts"])["alerts"]}
        assert shown == held
        with plant.database.read() as connection:
            assert [tuple(row) for row in connection.execute(sa.select(audit.c.who, audit.c.act, audit.c.robot))] == [
                ("Home Assistant (MQTT)", "ack", "lab/cell-1")
            ]
