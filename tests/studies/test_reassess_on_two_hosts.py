"""A plant reassessed by workers of two computers that share an S3 server and no disk: two network namespaces of this machine."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest
from s3_server import KEYS, S3Server, s3_server
from simulated import copy, plant_file
from test_reassess import lived, without  # noqa: F401 - a fixture
from test_reassess_kills import ROOT, SOON_S, dask, end, kept, plant, scheduler_of, wait_for  # noqa: F401 - a fixture

from monitor.plant.database import Database

ARMS = 3  # of those of `plant`, of two months each
TOOLS = ("ip", "unshare", "mount")
pytestmark = [
    pytest.mark.soak,
    pytest.mark.timeout(240),
    pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: no other host can be made, so a reassessment on two of them is not tested"),
    pytest.mark.skipif(
        not all(map(shutil.which, TOOLS)), reason=f"{', '.join(TOOLS)}: one is missing, so a reassessment on two hosts is not tested"
    ),
]


class Host(NamedTuple):
    """A network namespace with one link, to the lead's bridge."""

    name: str
    address: str

    def with_disk_at(self, folder: Path) -> tuple[str, ...]:
        """The command that begins a process there, to which `folder` is an empty disk of its own."""
        script = 'mount -t tmpfs tmpfs "$0" && cd "$0" && exec "$@"'
        return ("ip", "netns", "exec", self.name, "unshare", "--mount", "sh", "-c", script, str(folder))


class Network(NamedTuple):
    """The lead's address on the bridge, and the hosts at it."""

    lead: str
    hosts: tuple[Host, Host]


def ip(words: str) -> None:
    subprocess.run(["ip", *words.split()], check=True)


@pytest.fixture(scope="module")
def network() -> Iterator[Network]:
    """A bridge and two hosts, named after this process, as another run may have some; 198.18.0.0/15 is for tests alone (RFC 2544)."""
    second, third = divmod(os.getpid() % 512, 256)
    bridge, network = f"jm{os.getpid()}", f"198.{18 + second}.{third}"
    hosts = tuple(Host(f"{bridge}-{k}", f"{network}.{10 + k}") for k in (1, 2))
    with ExitStack() as stack:
        for host in hosts:
            made = subprocess.run(["ip", "netns", "add", host.name], capture_output=True, text=True, check=False)
            if "not permitted" in made.stderr:
                pytest.skip(f"{made.stderr.strip()}: so a reassessment on two hosts is not tested")
            assert made.returncode == 0, made.stderr
            stack.callback(ip, f"netns del {host.name}")  # and the link in it
        ip(f"link add {bridge} type bridge")
        stack.callback(ip, f"link del {bridge}")
        ip(f"addr add {network}.1/24 dev {bridge}")
        ip(f"link set {bridge} up")
        for host in hosts:
            ip(f"link add {host.name} type veth peer name eth0 netns {host.name}")
            ip(f"link set {host.name} master {bridge} up")
            ip(f"-n {host.name} addr add {host.address}/24 dev eth0")
            for link in ("lo", "eth0"):
                ip(f"-n {host.name} link set {link} up")
        yield Network(f"{network}.1", hosts)


@pytest.fixture(scope="module")
def server(network: Network, tmp_path_factory) -> Iterator[S3Server]:
    """As that of `plant`, where the hosts reach it."""
    folder = tmp_path_factory.mktemp("s3")
    with s3_server(folder, host=network.lead) as running, pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", running.endpoint)
        patch.setenv("AWS_ACCESS_KEY_ID", KEYS[0])
        patch.setenv("AWS_SECRET_ACCESS_KEY", KEYS[1])
        yield running


def test_two_hosts_without_a_common_disk_say_what_this_machine_says_though_one_is_killed(
    plant: Path,  # noqa: F811
    network: Network,
    server: S3Server,
    tmp_path_factory,
    tmp_path: Path,
    soak_row,
):
    """From the plant's database and the archive. The hosts reach neither database nor histories, and only one is left in the end."""
    from distributed import Client

    address, everything = f"sqlite:///{tmp_path / 'plant.sqlite'}", tmp_path_factory.getbasetemp()
    database = Database(address)
    database.migrate()
    copy(database, plant.parent, [f"{plant.name}/arm-{k}" for k in range(ARMS)])
    database.close()
    client = server.client()
    command = [sys.executable, "-m", "monitor", "reassess", "--json", "--plant", str(plant_file(tmp_path, address))]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with ExitStack() as stack:
        scheduler, _ = scheduler_of(tmp_path, stack, "scheduler", network.lead)
        looking = stack.enter_context(Client(scheduler, set_as_default=False))
        of_worker = ("worker", scheduler, "--nthreads", "1", "--no-dashboard", "--host")
        workers = [
            stack.enter_context(dask(tmp_path, *of_worker, host.address, within=host.with_disk_at(everything))) for host in network.hosts
        ]
        looking.wait_for_workers(2, timeout=SOON_S)
        found = looking.run(os.readlink, "/proc/self/ns/net")
        assert len({*found.values(), os.readlink("/proc/self/ns/net")}) == 3
        for of_lead in (plant, tmp_path / "plant.sqlite"):
            assert of_lead.exists()
            assert not any(looking.run(os.path.exists, str(of_lead)).values())
        victim = next(each for each in found if f"//{network.hosts[0].address}:" in each)
        results = ("--results", f"s3://{server.bucket}/results", "--scheduler", scheduler)
        running = subprocess.Popen([*command, *results], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        stack.callback(running.kill)
        wait_for(lambda: kept(client, server, "identified") >= 2 and looking.processing()[victim], "it never is in the midst of its work")
        end(workers[0])
        before = kept(client, server, "identified")
        said, wrong = running.communicate(timeout=SOON_S)
        assert running.returncode == 0, wrong
        assert list(looking.scheduler_info()["workers"]) == [each for each in found if each != victim]
    here = subprocess.run(
        [*command, "--results", str(tmp_path / "here"), "--workers", "2"], capture_output=True, text=True, env=environment, check=False
    )
    assert here.returncode == 0, here.stderr
    document, expected = json.loads(said), json.loads(here.stdout)
    soak_row("a reassessment on two hosts, one killed", f"killed after {before} of {2 * ARMS} arm-months", "the document of one machine")
    assert before < 2 * ARMS
    assert without(document) == without(expected)
    assert (document["arms"], document["of_parts"], document["errors"], document["failed"]) == (ARMS, 0, [], [])
    assert document["verdicts"]["not_recomputable"] == 0
    assert kept(client, server, "identified") == 2 * ARMS, "one result a month: none was computed under two names"
    assert expected["cost"]["arm_months_found"] == 0, "it has computed them itself"
    assert all(each["cost"]["identify"]["bytes_read"] > 0 for each in (document, expected))
