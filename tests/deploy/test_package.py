"""The Debian package: its content lies where the unit looks for it, and its unit is one that systemd takes."""

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from contextlib import chdir
from pathlib import Path

import pytest
from command_line import ended
from hatchling.build import build_wheel

from monitor import __version__

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
    assert "[archive,gateway]" in text
    assert "dev" not in re.findall(r"\[([\w,]+)\]", text)


def test_the_files_of_deployment_are_written_whole_and_start_the_program_that_wrote_them(tmp_path):
    """`deploy-files` writes every file of `deploy/` that a machine needs, as it is but for the program's place, and the pages that a
    configuration of `init` names; again only with --force."""
    assert ended("deploy-files", tmp_path / "a").returncode == 0
    written = {path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()}
    packaging = {
        Path("Containerfile"),
        *(Path(f"try-{what}") for what in ("wheel", "deb", "commands")),
        *(path.relative_to(ROOT / "deploy") for path in (ROOT / "deploy/deb").iterdir()),
    }
    pages = {Path("docs") / path.name for path in (ROOT / "docs").iterdir() if path.suffix in {".md", ".png", ".svg"}}
    assert {Path("docs/configuration.md"), Path("docs/real-robot-safety.md"), Path("docs/plant.md")} <= pages <= written
    for page in pages:
        assert (tmp_path / "a" / page).read_bytes() == (ROOT / page).read_bytes()
    written -= pages
    assert written == {path.relative_to(ROOT / "deploy") for path in (ROOT / "deploy").rglob("*") if path.is_file()} - packaging
    for name in written:
        shipped = (ROOT / "deploy" / name).read_text("utf-8")
        assert (tmp_path / "a" / name).read_text("utf-8") == shipped.replace("/opt/joint-monitor/bin", f"{sys.prefix}/bin")
    assert f"ExecStart={sys.prefix}/bin/joint-monitor run" in (tmp_path / "a/joint-monitor@.service").read_text("utf-8")
    again = ended("deploy-files", tmp_path / "a")
    assert again.returncode == 2
    assert "exists; nothing was done" in again.stderr
    assert ended("deploy-files", tmp_path / "a", "--force").returncode == 0
    (tmp_path / "file").write_text("")
    assert "cannot be written" in ended("deploy-files", tmp_path / "file" / "b").stderr


def test_the_wheel_carries_what_a_user_needs_and_its_version_is_the_programs(tmp_path):
    """Built by the backend itself: marker of types, configuration, files of deployment; the version stands in one place."""
    with chdir(ROOT):
        name = build_wheel(str(tmp_path))
    with zipfile.ZipFile(tmp_path / name) as wheel:
        names = set(wheel.namelist())
    assert f"joint_monitor-{__version__}-" in name
    assert {"monitor/py.typed", "monitor/_config/monitor.toml", "monitor/_deploy/joint-monitor@.service", "monitor/api.py"} <= names
    assert {f"monitor/_deploy/{path}" for path in ("zenoh/router.json5", "prometheus/scrape.yml")} <= names
    assert any(each.startswith("monitor/_deploy/grafana/dashboards/") for each in names)
    assert {f"monitor/_docs/{path.name}" for path in (ROOT / "docs").glob("*.md")} <= names
    assert "version" not in tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def test_a_python_that_a_package_or_a_service_cannot_reach_is_refused_with_the_one_that_they_can(tmp_path):
    """Below /home, and for a package anywhere but in /usr: said before anything is built, with the words that would be right."""
    python = tmp_path / "python"
    for prefix, targets in (("/home/ada/.pyenv", ("install", "deb", "release")), ("/opt/python3.12", ("deb", "release"))):
        python.write_text(f'#!/bin/sh\nexec {sys.executable} -c "import sys; sys.base_prefix = \'{prefix}\'; exec(sys.argv[1])" "$2"\n')
        python.chmod(0o755)
        for target in targets:
            command = ["make", "--no-print-directory", target, f"PYTHON={python}", f"DESTDIR={tmp_path / 'root'}"]
            refused = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
            assert refused.returncode == 2, refused.stderr
            assert f"make {target} PYTHON=/usr/bin/python3" in refused.stderr
            assert not (tmp_path / "root").exists()


def test_hosted_ci_and_our_own_call_the_same_targets_which_exist():
    """What the workflows and `.ci/run` call is in the Makefile."""
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    ours = set(re.findall(r"^make ([a-z ]+)$", (ROOT / ".ci/run").read_text("utf-8"), re.MULTILINE))
    hosted = {
        name
        for path in (ROOT / ".github/workflows").iterdir()
        for line in re.findall(r"run: make ([a-z ]+)", path.read_text("utf-8"))
        for name in line.split()
    }
    assert ours <= hosted <= targets
    assert {"lint", "quick", "test", "docs", "wheel", "release"} <= hosted
