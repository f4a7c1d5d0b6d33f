"""`python -m tests.golden write|compare DIR [--only NAME]`; `expected` for the small part that is committed."""

import argparse
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

from . import entry, small
from .compare import compared
from .parts import PARTS
from .run import Run

SET = "set"  # what is compared; beside it lie the artefacts


def main() -> int:
    """0 where everything is as it was, else 1."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("do", choices=("write", "compare", "expected"))
    parser.add_argument("folder", nargs="?", type=Path, help="where the set is")
    parser.add_argument("--only", action="append", choices=sorted(PARTS), help="one part; may be given again")
    parser.add_argument("--stored-recordings", action="store_true", help="compare: take the set's recordings, do not simulate anew")
    parser.add_argument("--keep", type=Path, help="compare: keep what was regenerated here")
    given = parser.parse_args()
    if given.do == "expected":
        return small.rewrite()
    if given.folder is None:
        parser.error("which folder?")
    folder = given.folder.resolve()
    chosen = given.only or list(PARTS)
    print(f"the code below {entry.package_folder()}, parts {', '.join(chosen)}", flush=True)
    with tempfile.TemporaryDirectory(prefix="golden-") as scratch:
        production = Path(scratch) / "production"
        production.mkdir()
        if given.do == "write":
            run = Run(into=folder / SET, production=production, artefacts=folder)
            for name in chosen:
                shutil.rmtree(run.into / name, ignore_errors=True)
            _made(run, chosen)
            return 0
        artefacts = (given.keep or Path(scratch) / "found").resolve()
        run = Run(into=artefacts / SET, production=production, artefacts=artefacts, earlier=folder, simulate=not given.stored_recordings)
        made = _made(run, chosen)
        return 0 if compared(folder / SET, run.into, made) else 1


def _made(run: Run, chosen: list[str]) -> set[str]:
    """The parts that could be made."""
    made = set()
    for name in chosen:
        began, used = time.monotonic(), _processor_s()
        if not PARTS[name](run):
            continue
        made.add(name)
        run.close()
        print(f"{name}: {time.monotonic() - began:.0f} s, {_processor_s() - used:.0f} s of processor", flush=True)
    return made


def _processor_s() -> float:
    """Of this process and of those that it has ended."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in usage)


if __name__ == "__main__":
    sys.exit(main())
