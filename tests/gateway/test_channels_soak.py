"""Longer evidence: many arms, many outages, many changes; memory stays bounded and the other side has what holds."""

import json
import os
from collections import Counter
from pathlib import Path

import pytest
from mosquitto_broker import PROGRAM, Mosquitto, Onlooker, waited
from test_mqtt_broker import World as Mqtt
from test_opcua_server import World as Opcua
from told_arms import arm, row

pytestmark = pytest.mark.soak
ARMS = 500
PAGE = os.sysconf("SC_PAGE_SIZE")


def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 1e6


@pytest.mark.skipif(PROGRAM is None, reason="mosquitto is not installed: apt-get install mosquitto")
@pytest.mark.timeout(900)
def test_hundreds_of_arms_through_outages_of_the_broker(tmp_path, record_property):
    """After each outage the broker, which has lost everything, gets each topic once, and memory does not grow with the outages."""
    broker = Mosquitto(tmp_path, "max_queued_messages 0")
    names = [(f"site-{k % 10}", f"arm-{k}") for k in range(ARMS)]
    world = Mqtt(tmp_path, broker.port, *(arm(robot, site=site) for site, robot in names))
    world.step()
    after_first = None
    for outage in range(8):
        broker.kill()
        waited(lambda: not world.channel._broker.connected, "the loss is noticed")
        for minute in range(100):
            site, robot = names[(37 * minute + outage) % len(names)]
            world.put(arm(robot, site=site, friction={1: row(1, wear=(outage + minute) / 1000.0)}))
        broker.start()
        with Onlooker(broker.port, "joint-monitor/#") as onlooker:
            world.until(lambda: onlooker.kept.get("joint-monitor/availability") == b"online", "it is back")
            assert set(Counter(topic for topic, _ in onlooker.heard).values()) == {1}
            assert len(onlooker.heard) == 1 + ARMS * (3 + 6)
            told = json.loads(onlooker.kept["joint-monitor/{}/{}/joint/1".format(*names[(37 * 99 + outage) % ARMS])])
            assert told["wear_percent"] == (outage + 99) / 10.0
        after_first = after_first or resident_mb()
    grown = resident_mb() - after_first
    record_property("grown_mb", grown)
    assert grown < 60.0
    world.channel.close()
    broker.kill()


@pytest.mark.timeout(900)
def test_arms_that_come_and_go_leave_no_memory_behind(tmp_path, record_property):
    """An OPC UA server whose arms are replaced again and again has the nodes, and about the memory, of the first ones."""
    world = Opcua(tmp_path)
    nodes = world.server._server.iserver.aspace
    sizes = []
    for turn in range(25):
        world.put(*(arm(f"arm-{turn}-{k}", site=f"site-{turn % 3}") for k in range(4)))
        sizes.append((len(nodes._nodes), resident_mb()))
    world.server.close()
    record_property("sizes", sizes)
    assert len({count for count, _ in sizes}) == 1
    assert sizes[-1][1] - sizes[4][1] < 20.0
