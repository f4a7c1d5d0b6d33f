"""A machine for one unit file: a real systemd as PID 1 in its own namespaces, over a copy-on-write view of this machine's disk.

Needs root, systemd, util-linux and overlayfs. Nothing outside it changes, and it ends with the process. The program under test is this
checkout's, bound to /opt/joint-monitor, where the shipped unit expects it.
"""

import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PLANT = "joint-monitor-plant"  # name of the plant's configuration
NEEDED = ("unshare", "nsenter", "systemd-sysusers", "systemd-tmpfiles", "mount", "pivot_root")

BOOT = r"""
set -eu
mount --make-rprivate /
mount -t tmpfs none /mnt
mkdir /mnt/upper /mnt/work /mnt/root
mount -t overlay none -o lowerdir=/,upperdir=/mnt/upper,workdir=/mnt/work /mnt/root
R=/mnt/root
mount -t proc proc $R/proc
mount -t sysfs -o ro sysfs $R/sys
mount -t cgroup2 none $R/sys/fs/cgroup
mount -t tmpfs -o mode=755 none $R/dev
for device in null:3 zero:5 full:7 random:8 urandom:9; do mknod -m 666 "$R/dev/${device%%:*}" c 1 "${device##*:}"; done
mknod -m 666 $R/dev/tty c 5 0
mkdir $R/dev/pts $R/dev/shm
mount -t devpts -o newinstance,ptmxmode=0666,mode=620 none $R/dev/pts
mount -t tmpfs -o mode=1777 none $R/dev/shm
ln -s pts/ptmx $R/dev/ptmx
ln -s /proc/self/fd $R/dev/fd
ln -s null $R/dev/console
mount -t tmpfs -o mode=755 none $R/run
mount -t tmpfs -o mode=1777 none $R/tmp
rm -rf $R/etc/systemd/system $R/opt/joint-monitor $R/var/lib/joint-monitor $R/etc/joint-monitor $R/var/log/journal
mkdir -p $R/etc/systemd/system $R/opt/joint-monitor/bin $R/etc/joint-monitor
while read -r from to; do
    mkdir -p "$R$to"
    mount --bind "$from" "$R$to"
done < "$1/binds"
install -m 755 "$1/joint-monitor" $R/opt/joint-monitor/bin/joint-monitor
cp "$1"/etc/* $R/etc/joint-monitor/
if [ -f "$1/etc/joint-monitor-plant.toml" ]; then mv $R/etc/joint-monitor/joint-monitor-plant.toml $R/etc/; fi
cp -r "$1"/units/* $R/etc/systemd/system/
for target in sysinit basic shutdown network-online time-sync; do
    printf '[Unit]\nDescription=%s\n' $target > $R/etc/systemd/system/$target.target
done
printf '[Unit]\nDescription=what a test needs\nRequires=systemd-journald.service\nAfter=systemd-journald.service\n' \
    > $R/etc/systemd/system/test.target
for unit in systemd-journald.service systemd-journald.socket systemd-journald-dev-log.socket; do
    for folder in /lib/systemd/system /usr/lib/systemd/system; do
        if [ -f $folder/$unit ]; then cp -n $folder/$unit $R/etc/systemd/system/; fi
    done
done
systemd-sysusers --root=$R "$1/sysusers.conf"
systemd-tmpfiles --root=$R --create "$1/tmpfiles.conf"
ip link set lo up 2>/dev/null || true
cd $R
mkdir old
pivot_root . old
umount -l /old
cd /
mount --make-rshared /   # or credentials stay empty
rm -f /etc/machine-id
systemd-id128 new > /etc/machine-id
exec env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin container=test SYSTEMD_PROC_CMDLINE= SYSTEMD_UNIT_PATH=/etc/systemd/system \
    /lib/systemd/systemd --system --unit=test.target --log-target=journal --show-status=no
"""


def why_not() -> str | None:
    """The reason why no systemd can be booted here; None if it can."""
    if os.geteuid() != 0:
        return "this is not root"
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing or not Path("/lib/systemd/systemd").exists():
        return f"not installed: {', '.join(missing) or 'systemd'}"
    if _cgroup_root() is None:
        return "there is no cgroup tree that can be written to"
    return None


def _cgroup_root() -> Path | None:
    for folder in (Path("/sys/fs/cgroup/unified"), Path("/sys/fs/cgroup")):
        if (folder / "cgroup.procs").is_file() and os.access(folder, os.W_OK):
            return folder
    return None


class Machine:
    """A context manager; `run` executes inside, `unit` asks systemd for properties."""

    def __init__(self, folder: Path, configurations: dict[str, str], drop_ins: dict[str, str]) -> None:
        """`configurations`: robots' TOML by instance, PLANT: the plant's; `drop_ins`: all that the test changes, by shipped unit."""
        self._folder = folder
        (folder / "etc").mkdir()
        deploy = ROOT / "deploy"
        for unit in ("joint-monitor@", "joint-monitor-plant", "joint-monitor-gateway"):
            (folder / f"units/{unit}.service.d").mkdir(parents=True)
            (folder / f"units/{unit}.service.d/test.conf").write_text(drop_ins.get(unit, ""))
            shutil.copy(deploy / f"{unit}.service", folder / "units")
        shutil.copy(deploy / "joint-monitor.sysusers", folder / "sysusers.conf")
        shutil.copy(deploy / "joint-monitor.tmpfiles", folder / "tmpfiles.conf")
        for name, text in configurations.items():
            (folder / "etc" / f"{name}.toml").write_text(text)
        packages = Path(sysconfig.get_paths()["purelib"])
        binds = {ROOT / "monitor": "src/monitor", ROOT / "config": "src/config", packages: "lib", Path(sys.base_prefix): "python"}
        (folder / "binds").write_text("".join(f"{source} /opt/joint-monitor/{target}\n" for source, target in binds.items()))
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        here = "/opt/joint-monitor"
        (folder / "joint-monitor").write_text(
            f"#!/bin/sh\nexport LD_LIBRARY_PATH={here}/python/lib "
            f"PYTHONPATH={here}/src:{here}/lib:{here}/lib/cmeel.prefix/lib/{version}/site-packages\n"
            f'exec {here}/python/bin/{version} -m monitor "$@"\n'
        )

    def __enter__(self) -> "Machine":
        base = _cgroup_root()
        assert base is not None
        self._cgroup = base / f"joint-monitor-test-{os.getpid()}-{time.monotonic_ns()}"
        self._cgroup.mkdir()
        procs = self._cgroup / "cgroup.procs"
        into_cgroup = ["sh", "-c", 'echo 0 > "$1"; shift; exec "$@"', "enter", str(procs)]
        namespaces = ["--mount", "--pid", "--fork", "--kill-child=SIGKILL", "--cgroup", "--ipc", "--uts", "--net", "--mount-proc"]
        self._process = subprocess.Popen(
            [*into_cgroup, "unshare", *namespaces, "sh", "-c", BOOT, "boot", str(self._folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        deadline = time.monotonic() + 20.0
        self._init: str | None = None
        while time.monotonic() < deadline:
            time.sleep(0.05)
            if self._process.poll() is not None:
                break
            children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
            if children and Path(f"/proc/{children[0]}/comm").read_text().strip() == "systemd":
                self._init = children[0]
                if self.run("systemctl", "is-active", "test.target", check=False).stdout.strip() == "active":
                    return self
        self.__exit__()
        raise RuntimeError(f"systemd did not come up: {self._process.stdout.read()[-2000:]}")

    def __exit__(self, *_: object) -> None:
        if self._init is not None:
            os.kill(int(self._init), signal.SIGKILL)
        self._process.kill()
        self._process.wait()
        for folder, _, _ in os.walk(self._cgroup, topdown=False):
            for _ in range(40):
                try:
                    os.rmdir(folder)
                    break
                except OSError:
                    time.sleep(0.05)

    def run(self, *command: str, check: bool = True, timeout: float = 60.0) -> "subprocess.CompletedProcess[str]":
        """The path of a configuration inside the machine."""
        done = subprocess.run(
            ["nsenter", "--target", self._init, "--all", *command], capture_output=True, text=True, timeout=timeout, check=False
        )
        assert not check or done.returncode == 0, (command, done.stdout[-3000:], done.stderr[-3000:])
        return done

    def unit(self, name: str, *properties: str) -> dict[str, str]:
        """Properties of a unit."""
        output = self.run("systemctl", "show", name, "--property", ",".join(properties)).stdout
        return dict(line.split("=", 1) for line in output.strip().splitlines())

    def journal(self, *arguments: str) -> str:
        """The lines of the journal."""
        self.run("journalctl", "--sync", check=False)
        return self.run("journalctl", "--no-pager", *arguments).stdout

    def eventually(self, unit: str, name: str, value: str, within_s: float) -> dict[str, str]:
        """The properties of a unit, once one of them has the expected value."""
        deadline = time.monotonic() + within_s
        while time.monotonic() < deadline:
            if self.unit(unit, name)[name] == value:
                return self.unit(unit, "MainPID", "StatusText", "NRestarts", "Result", "SubState")
            time.sleep(0.1)
        raise AssertionError((unit, name, self.unit(unit, name, "StatusText", "Result"), self.journal("-u", unit)[-4000:]))
