"""What is shipped beside the program: units, users, and examples for Zenoh, Prometheus and Grafana, written to a folder. I/O."""

import sys
from importlib.resources import files
from pathlib import Path

from monitor.errors import BadInput, StoreError

INSTALLED = "/opt/joint-monitor/bin/joint-monitor"  # in the units as shipped: where `make install` puts the program
SHIPPED = ("*.service", "*.sysusers", "*.tmpfiles", "zenoh/*", "prometheus/*", "grafana/**/*")  # of `deploy/`; the rest builds packages


def shipped_files() -> dict[Path, Path]:
    """The path of each file below a folder of the user's → where it is, in the checkout or in the installed package."""
    package = Path(str(files("monitor")))
    folder = next((each for each in (package / "_deploy", package.parent / "deploy") if each.is_dir()), None)
    if folder is None:
        raise BadInput("deploy-files: this installation has no files of deployment; install joint-monitor anew")
    return {path.relative_to(folder): path for pattern in SHIPPED for path in sorted(folder.glob(pattern)) if path.is_file()}


def write_deploy_files(folder: Path, *, force: bool) -> list[Path]:
    """Write the files into a folder, and return their paths. The units start the program that writes them.

    Raises BadInput where one exists already and `force` is not said, StoreError where the disk refuses.
    """
    found = shipped_files()
    there = [folder / name for name in found if (folder / name).exists()]
    if there and not force:
        raise BadInput(f"{there[0]} exists; nothing was done. Give another folder, or --force to replace it")
    program = Path(sys.prefix) / "bin" / "joint-monitor"
    try:
        for name, path in found.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            text = path.read_text("utf-8")
            (folder / name).write_text(text.replace(INSTALLED, str(program)), "utf-8")
    except OSError as wrong:
        raise StoreError(f"{folder}: cannot be written: {wrong.strerror}") from None
    return [folder / name for name in found]
