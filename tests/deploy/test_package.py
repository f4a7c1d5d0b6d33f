"""The Debian package: its content lies where the unit looks for it, and its unit is one that systemd takes."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(*command: object) -> str:
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="dpkg-deb is absent: this is no Debian")
def test_a_package_of_an_installed_tree_holds_unit_user_and_program(tmp_path):
    """As `make deb` builds it, of a tree with a stand-in for the program: paths, owner, version, dependencies, scripts."""
    root, package = tmp_path / "root", tmp_path / "joint-monitor.deb"
    for source, target in (
        ("deploy/joint-monitor@.service", "usr/lib/systemd/system/joint-monitor@.service"),
        ("deploy/joint-monitor.sysusers", "usr/lib/sysusers.d/joint-monitor.conf"),
        ("deploy/joint-monitor.tmpfiles", "usr/lib/tmpfiles.d/joint-monitor.conf"),
    ):
        (root / target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / source, root / target)
    program = root / "opt/joint-monitor/bin/joint-monitor"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    run(ROOT / "deploy/deb/build", root, "0.2.0", "3.11", package)
    content = run("dpkg-deb", "-c", package)
    for path in ("./usr/lib/systemd/system/joint-monitor@.service", "./usr/lib/sysusers.d/joint-monitor.conf", "./opt/joint-monitor/bin"):
        assert re.search(rf"root/root .* {re.escape(path)}", content), content
    about = run("dpkg-deb", "-I", package)
    assert "Version: 0.2.0" in about
    assert "python3 (>= 3.11), python3 (<< 3.12)" in about
    assert "postinst" in about
    unpacked = tmp_path / "unpacked"
    run("dpkg-deb", "-x", package, unpacked)
    unit = (unpacked / "usr/lib/systemd/system/joint-monitor@.service").read_text("utf-8")
    executed = re.search(r"^ExecStart=(\S+)", unit, re.MULTILINE)[1]
    assert (unpacked / executed.lstrip("/")).is_file()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is absent")
@pytest.mark.parametrize(
    ("shipped", "started"),
    [
        ("joint-monitor@.service", "joint-monitor@cell-1.service"),
        ("joint-monitor-plant.service", "joint-monitor-plant.service"),
        ("joint-monitor-gateway.service", "joint-monitor-gateway.service"),
    ],
)
def test_systemd_takes_the_unit_that_is_shipped(tmp_path, shipped, started):
    """`systemd-analyze verify` of an instance finds nothing wrong."""
    unit = tmp_path / started
    text = (ROOT / "deploy" / shipped).read_text("utf-8")
    unit.write_text(text.replace("/opt/joint-monitor/bin/joint-monitor", "/bin/true"))  # the program is not installed here
    checked = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=60, check=False)
    assert checked.returncode == 0, checked.stderr
    assert unit.name not in checked.stderr, checked.stderr


def test_a_container_is_built_from_what_a_service_needs():
    """It copies what the build reads, and leaves developers' tools out."""
    text = (ROOT / "deploy/Containerfile").read_text("utf-8")
    for line in re.findall(r"^COPY (?!--from)(.+)", text, re.MULTILINE):
        for name in line.split()[:-1]:
            assert (ROOT / name).exists(), name
    assert "[plots,plant,archive,gateway]" in text
    assert "dev" not in re.findall(r"\[([\w,]+)\]", text)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert not any(name.startswith("matplotlib") for name in extras["dependencies"])
    assert any(name.startswith("matplotlib") for name in extras["optional-dependencies"]["plots"])
