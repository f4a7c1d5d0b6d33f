"""Metrics: as Prometheus itself reads them, with the shipped rules evaluated by the real program."""

import json
import re
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.parse
import urllib.request
from collections import Counter
from pathlib import Path

import pytest
import sqlalchemy as sa
from heard_documents import ALERT, SAID_AT, whole
from prometheus_client.parser import text_string_to_metric_families
from published import last_values

from monitor.errors import BadConfiguration, BadInput
from monitor.plant.arm import GONE
from monitor.plant.database import Database
from monitor.plant.ingest import RUNNING, enter, keep_last_values, set_note
from monitor.plant.metrics import plant_families
from monitor.plant.tables import arm, last_value
from monitor.publish.metrics import MetricsServer, families
from monitor.publish.session import MetricsSettings

DEPLOY = Path(__file__).parents[2] / "deploy" / "prometheus"
BOARDS = sorted((DEPLOY.parent / "grafana" / "dashboards").glob("*.json"))


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

MONITOR = {
    "arm": {"heard": True}, "lag_s": 1.0, "store": {"free_bytes": 1e9, "history_bytes": 1e6, "last_backup_at": "2026-01-05T01:00:00Z"},
    "process": {"resident_bytes": 1e8}, "bus": {"to_send": 0, "to_answer": 0, "dropped": 0},
    "last_replay": {"state": "assessed", "ended_at": "2026-01-05T02:00:00Z"}, "troubles": [{"name": "disk"}],
}  # fmt: skip
INSPECTION = {
    "said_at": SAID_AT, "counted_since": SAID_AT, "on_h_per_day": 8.0, "stops_28_days": 3, "last_stops": [], "plan": None,
    "heard_h": 20.0, "on_h": 10.0, "moving_h": 5.0, "operating_h": 1010.0, "stops": 3, "stops_by_joint": [{"joint": 3, "stops": 2}],
    "items": [
        {"name": "flat rings", "state": "due", "due": "2026-01-04T00:00:00Z"},
        {"name": "blue lids", "state": "unrecorded", "due": None},
    ],
}  # fmt: skip
ALL = {**LAST, "health": {**LAST["health"], "stale": False}, "monitor": MONITOR, "inspection": INSPECTION}
PLANT_ARMS = {  # robot → health; `gone` is silent
    "well": {"state": "NORMAL", "alerts": [], "joints": []},
    "gone": {"state": "NORMAL", "alerts": [], "joints": []},
    "sick": {
        "state": "MAINTENANCE_REQUIRED", "joints": [],
        "alerts": [{"joint": 3, "condition": "wear_rising", "tier": "wear", "active": True, "change": 0.07, "acknowledged_at": None}],
    },
}  # fmt: skip


def plant_of(folder):
    """The database of a plant of three arms and a router that does not answer."""
    database = Database(folder / "plant.sqlite")
    database.migrate()
    with database.write() as connection:
        for number, (robot, health) in enumerate(PLANT_ARMS.items(), start=1):
            silent = {"silent_since": 1.0, "silent_why": GONE} if robot == "gone" else {}
            connection.execute(sa.insert(arm), {"id": number, "site": "lab", "robot": robot, "first_seen": 1.0, "history": 1, **silent})
            said = {"health": health, "info": {"robot": {"model": "ur5"}, "version": "1.0"}, "inspection": INSPECTION}
            said["monitor"] = {"last_replay": {"window": "2026-01-05T02:00:00Z"}}
            said = {key: whole(key, **document) for key, document in said.items()}
            rows = [{"arm": number, "key": key, "heard_at": 1.0, "document": document} for key, document in said.items()]
            connection.execute(sa.insert(last_value), rows)
    set_note(database, RUNNING, time.time(), {"ways": {"tcp/router:7447": False}, "copying": 0})
    return database


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    """A plant's database."""
    database = plant_of(tmp_path_factory.mktemp("plant"))
    yield database
    database.close()


def free():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def ports(database):
    """Where an arm and a plant are scraped."""
    ports = free(), free()
    with (
        MetricsServer(MetricsSettings(listen=f"127.0.0.1:{ports[0]}"), lambda: families(last_values(ALL))),
        MetricsServer(MetricsSettings(listen=f"127.0.0.1:{ports[1]}"), lambda: plant_families(database)),
    ):
        yield ports


@pytest.fixture(scope="module")
def port(ports):
    """Where the arm is scraped."""
    return ports[0]


def scraped(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5.0) as answer:
        return answer.read().decode()


@pytest.fixture(scope="module")
def prometheus(ports, tmp_path_factory):
    """Prometheus with the shipped scrape configuration and rules, only targets and interval changed; asks its API below /api/v1/."""
    program = shutil.which("prometheus")
    if program is None:
        pytest.skip("Prometheus is not installed: apt-get install prometheus")
    folder, own_port = tmp_path_factory.mktemp("prometheus"), free()
    for rules in DEPLOY.glob("*.rules.yml"):
        shutil.copy(rules, folder)
    scrape = (DEPLOY / "scrape.yml").read_text("utf-8").replace("30s", "1s")
    for shipped, port in zip((9464, 9465), ports, strict=True):
        scrape = scrape.replace(f'"127.0.0.1:{shipped}"]', f'"127.0.0.1:{port}"]')
    (folder / "prometheus.yml").write_text(scrape, "utf-8")
    server = subprocess.Popen(
        [program, f"--config.file={folder / 'prometheus.yml'}", f"--storage.tsdb.path={folder / 'data'}",
         f"--web.listen-address=127.0.0.1:{own_port}", "--log.level=error"],
    )  # fmt: skip

    def ask(path, **parameters):
        try:
            with urllib.request.urlopen(
                f"http://127.0.0.1:{own_port}/api/v1/{path}?{urllib.parse.urlencode(parameters)}", timeout=5.0
            ) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as refused:
            if refused.code == 503:  # it listens, and still reads its own data
                return None
            raise AssertionError(f"{parameters}: {refused.read().decode()}") from None
        except OSError:
            return None  # it is starting

    try:
        yield ask
    finally:
        server.terminate()
        server.wait(timeout=20)


def until(found, seconds=90.0):
    """The first answer that is not empty."""
    deadline = time.monotonic() + seconds
    while not (answer := found()) and time.monotonic() < deadline:
        time.sleep(0.5)
    return answer


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
    with pytest.raises(BadConfiguration, match=str(port)):
        MetricsServer(MetricsSettings(listen=f"127.0.0.1:{port}"), list)
    for listen in ("9464", "127.0.0.1:", ":9464", "127.0.0.1:99999"):
        with pytest.raises(BadInput, match="expected HOST:PORT"):
            MetricsSettings(listen=listen)


def test_a_real_prometheus_scrapes_it_and_its_rules_fire(prometheus):
    """JointWear fires for joint 3 and for no other; the plant's rules for the arm that is sick."""

    def firing():
        alerts = [each["labels"] for each in (prometheus("alerts") or {"alerts": []})["alerts"] if each["state"] == "firing"]
        names = {labels["alertname"] for labels in alerts}
        return alerts if {"JointWear", "PlantArmNeedsMaintenance"} <= names else None

    alerts = until(firing)
    assert alerts
    wear = [(labels["robot"], labels["joint"], labels["tier"]) for labels in alerts if labels["alertname"] == "JointWear"]
    assert wear == [("cell-1", "3", "wear")]
    assert [labels["robot"] for labels in alerts if labels["alertname"] == "PlantArmNeedsMaintenance"] == ["sick"]


@pytest.mark.parametrize("board", BOARDS, ids=lambda path: path.stem)
def test_every_query_of_a_dashboard_is_answered_by_a_real_prometheus(prometheus, board):
    """Each panel shows something of an arm or a plant that has everything; each variable has its value."""
    document = json.loads(board.read_text("utf-8"))
    values = {"site": "lab", "robot": "cell-1", "joint": ".*", "datasource": ""}
    for variable in document["templating"]["list"][1:]:
        selector, label = re.fullmatch(r"label_values\((.+), (\w+)\)", variable["query"]["query"]).groups()
        series = until(lambda selector=selector: prometheus("series", **{"match[]": filled(selector, values)}))
        assert values[label] in {each[label] for each in series} or values[label] == ".*"
    queries = [target["expr"] for panel in document["panels"] for target in panel.get("targets", [])]
    assert len(queries) >= 15
    for query in queries:
        assert until(lambda query=query: (prometheus("query", query=filled(query, values)) or {"result": []})["result"]), query


def filled(query, values):
    """The query as Grafana sends it."""
    return re.sub(r"\$(\w+)", lambda found: values[found[1]], query)


@pytest.mark.parametrize("board", BOARDS, ids=lambda path: path.stem)
def test_a_dashboard_is_as_grafana_documents_it(board):
    """Ids are given once, panels lie beside each other and never on top of each other, and everything asks the chosen data source."""
    document = json.loads(board.read_text("utf-8"))
    assert document["schemaVersion"] >= 36
    assert document["id"] is None, "Grafana gives it at the import"
    assert re.fullmatch(r"[a-zA-Z0-9_-]{1,40}", document["uid"])
    [source, *variables] = document["templating"]["list"]
    assert (source["type"], source["name"], source["query"]) == ("datasource", "datasource", "prometheus")
    panels = document["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    taken = set()
    for panel in panels:
        at = panel["gridPos"]
        assert 0 <= at["x"] < at["x"] + at["w"] <= 24, panel["title"]
        cells = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert not cells & taken, panel["title"]
        taken |= cells
        assert panel["title"]
        for asking in [panel, *panel.get("targets", [])] if panel["type"] != "row" else []:
            assert asking["datasource"] == {"type": "prometheus", "uid": "${datasource}"}
        references = [target["refId"] for target in panel.get("targets", [])]
        assert len(set(references)) == len(references)
    used = set(re.findall(r"\$(\w+)", " ".join(target["expr"] for panel in panels for target in panel.get("targets", []))))
    assert used <= {variable["name"] for variable in variables}


@pytest.mark.parametrize("board", BOARDS, ids=lambda path: path.stem)
def test_grafanas_own_library_reads_a_dashboard_and_loses_nothing(board):
    """The types that Grafana generates from its schema: what they do not know, they drop."""
    models = pytest.importorskip("grafana_foundation_sdk.models.dashboard", reason="pip install grafana-foundation-sdk")
    from grafana_foundation_sdk.cog.encoder import JSONEncoder
    from grafana_foundation_sdk.cog.plugins import register_default_plugins

    register_default_plugins()
    document = json.loads(board.read_text("utf-8"))
    read = json.loads(json.dumps(models.Dashboard.from_json(document), cls=JSONEncoder))

    def lost(before, after, where=""):
        if isinstance(before, dict):
            for key, value in before.items():
                if value not in (None, "", [], {}, False):
                    yield from lost(value, after.get(key), f"{where}.{key}")
        elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
            for number, pair in enumerate(zip(before, after, strict=True)):
                yield from lost(*pair, f"{where}[{number}]")
        elif before != after:
            yield where

    assert list(lost(document, read)) == []


def test_every_rule_fires_when_it_should_and_not_before(tmp_path):
    """`promtool test rules` on series of days; each shipped rule has a case."""
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("Prometheus is not installed: apt-get install prometheus")
    text = (Path(__file__).parent / "rules" / "rules.test.yml").read_text("utf-8")
    (tmp_path / "rules.test.yml").write_text(text.replace("RULES", str(DEPLOY)), "utf-8")
    told = subprocess.run([promtool, "test", "rules", str(tmp_path / "rules.test.yml")], capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr
    shipped = {name for path in DEPLOY.glob("*.rules.yml") for name in re.findall(r"- alert: (\w+)", path.read_text("utf-8"))}
    assert shipped == set(re.findall(r"alertname: (\w+)", text))


PUBLISHED = {  # names that were published before promtool judged them: they stay
    "joint_monitor_remaining_life_days": 'use base unit "seconds" instead of "days"',
    "joint_monitor_borrowed_seconds": None,
}


def test_names_and_units_are_those_that_prometheus_recommends(ports):
    """`promtool check metrics` on both; what it blames was published before, and stays."""
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("Prometheus is not installed: apt-get install prometheus")
    for port in ports:
        told = subprocess.run([promtool, "check", "metrics"], input=scraped(port), capture_output=True, text=True, check=False)
        blamed = {line.partition(" ")[0] for line in told.stderr.splitlines() if line.strip()}
        assert blamed <= set(PUBLISHED), told.stderr


def test_a_plant_has_few_series_an_arm(database):
    """Twelve, and one for each alert: joints that are well have none."""
    series = [sample for family in plant_families(database) for sample in family.samples]
    of = Counter(sample.labels.get("robot", "") for sample in series)
    assert of["well"] <= 12
    assert of["sick"] == of["well"] + 2, "its alert, and how large it is"
    assert {sample.labels["robot"]: sample.value for sample in series if sample.name == "joint_monitor_plant_arm_silent"} == {
        "well": 0.0, "gone": 1.0, "sick": 0.0,
    }  # fmt: skip


def test_the_plant_s_table_of_alerts_lists_those_whose_change_nobody_knows(tmp_path):
    """The table asks for every active alert, and for the change beside it where there is one."""
    database = Database(tmp_path / "plant.sqlite")
    database.migrate()
    number = enter(database, [("lab", "cell-1")], 0.0)["lab", "cell-1"]
    alert = {**ALERT, "joint": None, "condition": "stopped", "tier": "advisory", "change": 0.0}
    keep_last_values(database, {(number, "health"): (0.0, whole("health", state="OFF_SPEC", alerts=[alert]))})
    shown = {sample.name for family in plant_families(database) for sample in family.samples if sample.labels.get("condition") == "stopped"}
    database.close()
    [board] = (json.loads(path.read_text("utf-8")) for path in BOARDS if "plant" in path.stem)
    [table] = (panel for panel in board["panels"] if (panel["type"], panel["title"]) == ("table", "Active alerts"))
    assert [name for name in shown if any(name in target["expr"] for target in table["targets"])] == ["joint_monitor_plant_alert_active"]


def test_a_plant_without_its_database_says_so(tmp_path):
    """One figure, and no error of the scrape."""
    database = Database(tmp_path / "gone" / "plant.sqlite")
    try:
        assert [(sample.name, sample.value) for family in plant_families(database) for sample in family.samples] == [
            ("joint_monitor_plant_database_up", 0.0)
        ]
    finally:
        database.close()
