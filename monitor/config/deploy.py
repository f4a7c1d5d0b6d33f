"""What is shipped beside the program: units, users, examples for Zenoh, Prometheus and Grafana, and the pages, written to a folder. I/O."""

import os
import sys
from importlib.resources import files
from pathlib import Path

from monitor.errors import BadInput, StoreError

INSTALLED = "/opt/joint-monitor/bin/joint-monitor"  # in the units as shipped: where `make install` puts the program
PAGES = ("*.md", "*.png", "*.svg")  # of `docs/`
SHIPPED = ("*.service", "*.sysusers", "*.tmpfiles", "zenoh/*", "prometheus/*", "grafana/**/*")  # of `deploy/`; the rest builds packages


def shipped_files() -> dict[Path, Path]:
    """The path of each file below a folder of the user's → where it is, in the checkout or in the installed package."""
    deploy, docs = (_folder(name) for name in ("deploy", "docs"))
    found = {path.relative_to(deploy): path for pattern in SHIPPED for path in sorted(deploy.glob(pattern)) if path.is_file()}
    return found | {Path("docs") / path.name: path for pattern in PAGES for path in sorted(docs.glob(pattern))}


def _folder(name: str) -> Path:
    """A folder of the checkout, which an installed package has with a `_`. Raises BadInput."""
    package = Path(str(files("monitor")))
    folder = next((each for each in (package / f"_{name}", package.parent / name) if each.is_dir()), None)
    if folder is None:
        raise BadInput(f"deploy-files: this installation has no folder {name}; install joint-monitor anew")
    return folder


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
            content = path.read_bytes()
            if path.suffix == ".service":
                content = content.replace(INSTALLED.encode(), os.fsencode(program))
            (folder / name).write_bytes(content)
    except OSError as wrong:
        raise StoreError(f"{folder}: cannot be written: {wrong.strerror}") from None
    return [folder / name for name in found]
