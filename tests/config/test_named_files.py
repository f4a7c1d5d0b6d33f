"""Files that a configuration names, and addresses that it wants to listen on: a mistake in them is a mistake in the configuration."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trustme
from command_line import ended
from prepared import run

from monitor.config.load import load
from monitor.errors import BadConfiguration
from monitor.publish.session import read_as_session

CELL = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "127.0.9.1"\n[store]\ndirectory = "history"\n'


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificate and key of a monitor, the certificate of their authority, and a key that is of neither."""
    folder = tmp_path_factory.mktemp("tls")
    ours = trustme.CA()
    ours.cert_pem.write_to_path(folder / "ca.pem")
    issued = ours.issue_cert("127.0.0.1")
    issued.private_key_pem.write_to_path(folder / "monitor.key")
    issued.cert_chain_pems[0].write_to_path(folder / "monitor.pem")
    ours.issue_cert("127.0.0.1").private_key_pem.write_to_path(folder / "other.key")
    return folder


def written(folder: Path, more: str, free_port: int = 7447, zenoh: object = None, listen: str = "tcp") -> Path:
    """A configuration of one arm with these further lines, beside a Zenoh configuration `z.json5`."""
    if zenoh is not None:
        (folder / "z.json5").write_text(zenoh if isinstance(zenoh, str) else json.dumps(zenoh))
    path = folder / "cell.toml"
    path.write_text(f'{CELL}[bus]\nlisten = ["{listen}/127.0.0.1:{free_port}"]\n{more}')
    return path


def of_tls(tls: Path, **files: str) -> dict[str, object]:
    """A Zenoh configuration for TLS with these files of the folder `tls`."""
    return {"transport": {"link": {"tls": {name: str(tls / file) for name, file in files.items()}}}}


LISTENS = {"root_ca_certificate": "ca.pem", "listen_certificate": "monitor.pem", "listen_private_key": "monitor.key"}
RENAMED = {  # Zenoh 1.0 renamed them
    "client_auth": "enable_mtls",
    "server_private_key": "listen_private_key",
    "server_certificate": "listen_certificate",
    "client_private_key": "connect_private_key",
    "client_certificate": "connect_certificate",
    "server_name_verification": "verify_name_on_connect",
}
MISTAKES = [
    pytest.param('zenoh = "none.json5"\n', None, ["bus.zenoh", "none.json5"], id="no Zenoh configuration"),
    pytest.param('zenoh = "z.json5"\n', "{", ["bus.zenoh", "z.json5"], id="no JSON5"),
    pytest.param('zenoh = "z.json5"\n', '{transport: {link: {tls: {enable_mtl: true}}}}', ["did you mean enable_mtls?"], id="misspelt"),
    pytest.param('zenoh = "z.json5"\n', "{nonsense: 1}", ["bus.zenoh", "nonsense"], id="unknown key"),
    pytest.param(
        'zenoh = "z.json5"\n', {"transport": {"auth": {"usrpwd": {"user": "a", "password": "b", "dictionary_file": "/nowhere"}}}},
        ["bus.zenoh", "user-password dictionary file"], id="no file of passwords",
    ),
    pytest.param('client_zenoh = "z.json5"\n', "{nonsense: 1}", ["bus.client_zenoh", "nonsense"], id="that of the commands"),
    pytest.param('[page]\nlisten = "127.0.0.1:0"\ntoken_file = "nowhere"\n', None, ["page.token_file", "nowhere"], id="no token"),
    pytest.param('[page]\nlisten = "127.0.0.1:0"\ntoken_file = "z.json5"\n', "short", ["page.token_file", "16"], id="a short token"),
    pytest.param('[replay]\ncell = "nowhere.toml"\n', None, ["replay.cell", "nowhere.toml"], id="no cell"),
    pytest.param('[replay]\nexcitation = "nowhere.json"\n', None, ["replay.excitation", "nowhere.json"], id="no trajectory"),
    pytest.param('[drift]\nprior = "nowhere.json"\n', None, ["drift.prior", "nowhere.json"], id="no prior"),
    *(
        pytest.param('zenoh = "z.json5"\n', {"transport": {"link": {"tls": {old: "x"}}}}, ["bus.zenoh", old, f"now {new}"], id=old)
        for old, new in RENAMED.items()
    ),
]  # fmt: skip
ARCHIVE_MISTAKES = [
    ('recordings_keys_file = "nowhere"', "recordings_keys_file"),
    ('recordings_keys_file = "cell.toml"', "recordings_keys_file"),
    ('recordings_ca_file = "nowhere"', "recordings_ca_file"),
    ('recordings_ca_file = "cell.toml"', "recordings_ca_file"),
]


@pytest.mark.parametrize(("more", "zenoh", "says"), MISTAKES)
def test_a_mistake_in_a_file_is_one_of_the_configuration_for_run_check_and_reload(tmp_path: Path, free_port: int, more, zenoh, says):
    """`run` and `run --only-check` end with 78, `check` with 2, a reload refuses; all say the key, the file and what is wrong."""
    path = written(tmp_path, more, free_port, zenoh)
    for words, code in ((["run"], 78), (["run", "--only-check"], 78), (["check"], 2)):
        asked = ended(*words, "--config", path)
        assert asked.returncode == code, (words, asked.stderr)
        assert [part for part in says if part not in asked.stderr] == [], (words, asked.stderr)
    with pytest.raises(BadConfiguration, match=says[0]):
        load(path, reads_files=True)


@pytest.mark.parametrize(("line", "key"), ARCHIVE_MISTAKES)
def test_keys_and_certificates_of_the_archive_are_read_where_the_configuration_is(tmp_path: Path, monkeypatch, line, key):
    """Keys in a file that has none would leave every recording here, for weeks."""
    monkeypatch.delenv("AWS_ACCESS_KEY_ID", raising=False)
    path = tmp_path / "cell.toml"
    path.write_text(f'{CELL}recordings = "s3://bucket"\n{line}\n')
    asked = ended("run", "--only-check", "--config", path)
    assert asked.returncode == 78
    assert f"cell.toml:9: store.{key}: " in asked.stderr


@pytest.mark.parametrize(
    ("listen", "files", "says"),
    [
        ("tls", {}, "certificate|private key"),
        ("tls", {**LISTENS, "listen_private_key": "nowhere.key"}, "nowhere.key: cannot be read"),
        ("tls", {**LISTENS, "listen_certificate": "monitor.key"}, "certificate"),
        ("tls", {**LISTENS, "listen_private_key": "other.key"}, "monitor.pem|[Kk]ey"),
        ("tcp", {"root_ca_certificate": "nowhere.pem"}, "nowhere.pem"),
        ("tcp", {"connect_certificate": "monitor.pem", "connect_private_key": "other.key"}, "other.key"),
        ("tls", LISTENS, None),
        ("tls", {**LISTENS, "connect_certificate": "monitor.pem", "connect_private_key": "monitor.key"}, None),
    ],
)
def test_certificates_and_keys_that_zenoh_would_read_are_read_by_the_check(tmp_path: Path, free_port: int, tls: Path, listen, files, says):
    """Each as the session will use it; and right ones pass, while another process listens on the same address."""
    path = written(tmp_path, 'zenoh = "z.json5"\n', free_port, of_tls(tls, **files), listen)
    with socket.create_server(("127.0.0.1", free_port)):
        if says is None:
            load(path, reads_files=True)
        else:
            with pytest.raises(BadConfiguration, match=says):
                load(path, reads_files=True)


def test_a_reload_by_the_service_manager_needs_no_secret(tmp_path: Path, free_port: int, monkeypatch: pytest.MonkeyPatch):
    """systemd lets the main process alone read credentials: `run --only-check` checks everything else, also in the same file."""
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    passwords = '{user: "a", password: "${CREDENTIAL:p}", dictionary_file: "${CREDENTIALS_DIRECTORY}/u"}'
    zenoh = f"{{transport: {{auth: {{usrpwd: {passwords}}}}}}}"
    page = '[page]\nlisten = "127.0.0.1:0"\ntoken_file = "${CREDENTIALS_DIRECTORY}/token"\n'
    path = written(tmp_path, f'zenoh = "z.json5"\n{page}', free_port, zenoh)
    assert ended("run", "--only-check", "--config", path).returncode == 0
    began = ended("run", "--config", path)
    assert began.returncode == 78
    assert "CREDENTIALS_DIRECTORY" in began.stderr
    (tmp_path / "z.json5").write_text(zenoh.replace("usrpwd", "usrpaswd"))
    assert ended("run", "--only-check", "--config", path).returncode == 78


def test_a_file_of_a_person_that_the_service_may_not_read_does_not_keep_it_from_starting(tmp_path: Path, free_port: int):
    """`client_zenoh` is for the commands alone, which other users call: the daemon never opens it."""
    path = written(tmp_path, 'client_zenoh = "z.json5"\n', free_port, "{nonsense: 1}")
    (tmp_path / "z.json5").chmod(0o000)
    for folder in (tmp_path, *tmp_path.parents[:4]):
        if folder.name.startswith(("test_", "pytest-", "popen-")):
            folder.chmod(0o755)
    before = os.geteuid()
    os.seteuid(65534)  # root may read everything
    try:
        load(path, reads_files=True)
    finally:
        os.seteuid(before)


def test_reading_a_configuration_of_zenoh_leaves_nothing_open(tmp_path: Path, free_port: int, tls: Path):
    """Twenty reloads, and as many file descriptors as before."""
    (tmp_path / "z.json5").write_text(json.dumps(of_tls(tls, **LISTENS)))
    descriptors = []
    for _ in range(20):
        read_as_session(str(tmp_path / "z.json5"), listen=(f"tls/127.0.0.1:{free_port}",))
        descriptors.append(len(list(Path("/proc/self/fd").iterdir())))
    assert descriptors[-1] <= descriptors[4] + 3  # those of Zenoh's threads come with the first


TAKEN = {
    "the bus": "",
    "the page": '[page]\nlisten = "127.0.0.1:{taken}"\n',
    "metrics": '[metrics]\nlisten = "127.0.0.1:{taken}"\n',
    "the program's node": '[replay]\nhand_over = "external_control"\nhand_over_listen = "127.0.0.1:{taken}"\n',
}


@pytest.mark.parametrize("what", TAKEN)
def test_a_taken_port_ends_the_service_with_78_and_says_which(tmp_path: Path, what: str):
    """Started again every half minute it would never come up, and nobody would read why."""
    with socket.create_server(("127.0.0.1", 0)) as other, socket.create_server(("127.0.0.1", 0)) as spare:
        taken, bus = other.getsockname()[1], spare.getsockname()[1]
        if what != "the bus":
            spare.close()
        path = written(tmp_path, TAKEN[what].format(taken=taken), taken if what == "the bus" else bus)
        ended = run([sys.executable, "-m", "monitor", "run", "--config", str(path)], 60.0)
    assert ended.returncode == 78, ended.stderr
    said = ended.stderr.splitlines()[-1]
    assert f"127.0.0.1:{taken}" in said
    assert "another program listens there" in said
    assert "Traceback" not in ended.stderr


def test_a_port_that_a_command_has_for_a_moment_keeps_no_service_down(tmp_path: Path):
    """`replay` and `check` ask for a permit at the bus's own port; a service that began meanwhile ended with 78 and stayed down."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        path = written(tmp_path, "", taken)
        daemon = subprocess.Popen([sys.executable, "-m", "monitor", "run", "--config", str(path)], stderr=subprocess.PIPE, text=True)
        time.sleep(2.5)
    try:
        until = time.monotonic() + 60.0
        while time.monotonic() < until and not listens(taken):
            time.sleep(0.1)
        assert daemon.poll() is None
        assert listens(taken)
    finally:
        daemon.kill()
        daemon.wait()


def listens(port: int) -> bool:
    with socket.socket() as asked:
        asked.settimeout(0.5)
        return asked.connect_ex(("127.0.0.1", port)) == 0


def test_a_taken_port_of_the_plant_ends_it_with_78(tmp_path: Path):
    """Its screen and its metrics."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        for section in ("screen", "metrics"):
            (tmp_path / "plant.toml").write_text(f'[{section}]\nlisten = "127.0.0.1:{taken}"\n')
            asked = ended("plant", "run", "--config", tmp_path / "plant.toml")
            assert asked.returncode == 78, (section, asked.stderr)
            assert f"{section}: 127.0.0.1:{taken}: another program listens there" in asked.stderr


PERSON = 'sender = "a@b.example"\n[[notify.to]]\nname = "a"\nmail = ["c@d.example"]\n'


@pytest.mark.parametrize(
    ("section", "says"),
    [
        (f'[notify]\nsmtp = "mail.example:587"\nca_file = "nowhere.pem"\n{PERSON}', "nowhere.pem"),
        ('[mqtt]\nhost = "broker.example"\nca_file = "nowhere.pem"\n', "nowhere.pem"),
        ('[mqtt]\nhost = "broker.example"\ntls = true\ncert_file = "nowhere.pem"\nkey_file = "nowhere.key"\n', "nowhere"),
        ('[opcua]\nlisten = "127.0.0.1:48400"\nusers_file = "nowhere"\n', "nowhere"),
        ('[opcua]\nlisten = "127.0.0.1:48400"\nallow_anonymous = true\ncert_file = "nowhere.der"\nkey_file = "nowhere.key"\n', "nowhere"),
        ('[ros2]\nconnect = "tcp/127.0.0.1:7448"\nzenoh = "nowhere.json5"\n', "nowhere.json5"),
        ('[ros2]\nconnect = "tcp/127.0.0.1:7448"\n[plant]\nzenoh = "nowhere.json5"\n', "nowhere.json5"),
    ],
)  # fmt: skip
def test_files_of_the_gateway_are_read_by_its_check_and_at_its_start(tmp_path: Path, section: str, says: str):
    """As those of the plant: 78, and the file's name."""
    (tmp_path / "plant.toml").write_text(section)
    for words in (["run", "--only-check"], ["run"]):
        asked = ended("gateway", *words, "--config", tmp_path / "plant.toml")
        assert asked.returncode == 78, (words, asked.stderr)
        assert says in asked.stderr


def test_a_reload_with_a_mistake_in_a_file_keeps_the_daemon_as_it_is(tmp_path: Path, free_port: int):
    """The journal names the key; the daemon goes on, and the next right reload is taken."""
    path = written(tmp_path, 'zenoh = "z.json5"\n', free_port, "{}")
    with subprocess.Popen(
        [sys.executable, "-m", "monitor", "run", "--config", str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as daemon:
        try:
            assert daemon.stderr is not None
            _heard(daemon.stderr, "watching robot")
            (tmp_path / "z.json5").write_text("{transport: {link: {tls: {client_auth: true}}}}")
            daemon.send_signal(signal.SIGHUP)
            said = _heard(daemon.stderr, "reload refused")
            assert "bus.zenoh" in said
            assert "client_auth" in said
            (tmp_path / "z.json5").write_text("{}")
            daemon.send_signal(signal.SIGHUP)
            _heard(daemon.stderr, "reloaded: nothing has changed")
        finally:
            daemon.terminate()
            daemon.wait(20)


def _heard(lines, words: str) -> str:
    until = time.monotonic() + 60.0
    for line in lines:
        if words in line:
            return str(line)
        assert time.monotonic() < until, words
    raise AssertionError(f"ended before it said {words!r}")
