"""Metrics: as Prometheus itself reads them, with the shipped rules evaluated by the real program."""

import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from monitor.errors import BadInput, BusError
from monitor.publish.metrics import MetricsServer, MetricsSettings, families

DEPLOY = Path(__file__).parents[2] / "deploy" / "prometheus"


def friction(joint, wear):
    return {
        "joint": joint, "coulomb_nm": 9.0, "coulomb_std_nm": 0.1, "viscous_nm_s_per_rad": 8.0, "viscous_std_nm_s_per_rad": 0.2,
        "temperature_c": 31.5, "reference_torque_nm": None, "wear": wear, "wear_std": 0.01, "wear_rate_per_day": 0.001,
        "remaining_life": {"trend_probability": 0.99, "p10_days": 10.0, "p50_days": 20.0, "p90_days": None, "verdict": "trend"},
    }  # fmt: skip


LAST = {
    "info": {"robot": {"site": "lab", "id": "cell-1", "model": "ur5"}, "version": "1.0"},
    "health": {
        "state": "MAINTENANCE_REQUIRED",
        "joints": [{"joint": 1, "state": "NORMAL"}, {"joint": 3, "state": "MAINTENANCE_REQUIRED"}],
        "next_replay_due": "2026-01-05T03:00:00Z",
        "said_at": "2026-01-05T02:00:00Z",
    },
    "alert/j3/wear_rising": {
        "joint": 3, "condition": "wear_rising", "tier": "wear", "active": True, "acknowledged_at": None, "change": 0.07,
    },
    "joint/1/friction": friction(1, 0.001),
    "joint/3/friction": friction(3, 0.07),
    "torque/live": {},
}  # fmt: skip


@pytest.fixture
def port(free_port):
    with MetricsServer(MetricsSettings(listen=f"127.0.0.1:{free_port}"), lambda: LAST):
        yield free_port


def scraped(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5.0) as answer:
        return answer.read().decode()


def test_a_scrape_has_the_figures_of_the_bus(port):
    """Read by Prometheus' own parser: states, alerts, friction and life, each with its labels; what is unknown is absent."""
    samples = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(scraped(port))
        for sample in family.samples
    }
    assert samples["joint_monitor_health_state", "3", "MAINTENANCE_REQUIRED", "cell-1", "lab"] == 1.0
    assert samples["joint_monitor_health_state", "3", "NORMAL", "cell-1", "lab"] == 0.0
    assert samples["joint_monitor_alert_active", "3", "cell-1", "lab", "wear", "wear_rising"] == 1.0
    assert samples["joint_monitor_alert_acknowledged", "3", "cell-1", "lab", "wear_rising"] == 0.0
    assert samples["joint_monitor_wear_ratio", "3", "cell-1", "lab"] == 0.07
    assert samples["joint_monitor_remaining_life_days", "0.50", "3", "cell-1", "lab"] == 20.0
    assert samples["joint_monitor_next_replay_due_timestamp_seconds", "cell-1", "lab"] == 1767582000.0
    assert not any(name == "joint_monitor_reference_friction_newton_metres" for name, *_ in samples)
    assert not any("0.90" in labels for _, *labels in samples)


def test_a_monitor_without_a_replay_can_be_scraped():
    """Before the first replay there is no error, and no state is exported."""
    names = [family.name for family in families({})]
    assert "joint_monitor_health_state" in names
    assert all(sample.value == 0.0 for family in families({}) if family.name.endswith("state") for sample in family.samples)


def test_a_port_in_use_and_an_invalid_address_are_refused(port):
    """The message names the port or the address."""
    with pytest.raises(BusError, match=str(port)):
        MetricsServer(MetricsSettings(listen=f"127.0.0.1:{port}"), dict)
    for listen in ("9464", "127.0.0.1:", ":9464", "127.0.0.1:99999"):
        with pytest.raises(BadInput, match="expected HOST:PORT"):
            MetricsSettings(listen=listen)


def test_a_real_prometheus_scrapes_it_and_its_rules_fire(port, tmp_path, free_port):
    """The shipped scrape configuration and rules, only target and interval changed: JointWear fires for joint 3 and for no other."""
    prometheus = shutil.which("prometheus")
    if prometheus is None:
        pytest.skip("Prometheus is not installed: apt-get install prometheus")
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        own_port = probe.getsockname()[1]
    shutil.copy(DEPLOY / "joint-monitor.rules.yml", tmp_path)
    scrape = (DEPLOY / "scrape.yml").read_text("utf-8").replace("127.0.0.1:9464", f"127.0.0.1:{port}").replace("30s", "1s")
    (tmp_path / "prometheus.yml").write_text(scrape, "utf-8")
    subprocess.run(["promtool", "check", "rules", str(tmp_path / "joint-monitor.rules.yml")], check=True, capture_output=True)
    server = subprocess.Popen(
        [prometheus, f"--config.file={tmp_path / 'prometheus.yml'}", f"--storage.tsdb.path={tmp_path / 'data'}",
         f"--web.listen-address=127.0.0.1:{own_port}", "--log.level=error"],
    )  # fmt: skip
    try:
        firing, deadline = [], time.monotonic() + 60.0
        while not firing and time.monotonic() < deadline:
            time.sleep(0.5)
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{own_port}/api/v1/alerts", timeout=2.0) as answer:
                    alerts = json.load(answer)["data"]["alerts"]
            except OSError:
                continue
            firing = [alert["labels"] for alert in alerts if alert["state"] == "firing" and alert["labels"]["alertname"] == "JointWear"]
        assert [(labels["robot"], labels["joint"], labels["tier"]) for labels in firing] == [("cell-1", "3", "wear")]
    finally:
        server.terminate()
        server.wait(timeout=20)
