"""An installation without extras, simulated: `python bare.py ARGUMENTS` is `joint-monitor ARGUMENTS` where nothing else can be imported.

`python bare.py --lines` reads a list of such lines from standard input (JSON) and prints how each of them ended: one process for all.

What is hidden follows from what the package asks for: every installed module of a distribution that a bare installation would not bring.
So packages of extras and of developers are absent, and no network is needed.
"""

import json
import re
import sys
from importlib import metadata
from importlib.machinery import PathFinder
from pathlib import Path

from packaging.requirements import Requirement


def plain(name: str) -> str:
    """The name of a distribution as an index compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def brought(*extras: str) -> set[str]:
    """The distributions that an installation with these extras brings."""
    found: set[tuple[str, frozenset[str]]] = set()
    waiting = [("joint-monitor", frozenset(("", *extras)))]
    while waiting:
        name, wanted = each = waiting.pop()
        if each in found:
            continue
        found.add(each)
        try:
            lines = metadata.requires(name) or []
        except metadata.PackageNotFoundError:  # of another platform or version of Python
            continue
        asked = [Requirement(line) for line in lines]
        needed = [one for one in asked if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in wanted)]
        waiting += [(plain(one.name), frozenset(("", *one.extras))) for one in needed]
    return {name for name, _ in found}


def absent() -> set[str]:
    """The top-level modules that are installed here, and that a bare installation lacks."""
    bare = brought()
    return {
        module
        for module, names in metadata.packages_distributions().items()
        if module not in {"pip", "_distutils_hack"} and not any(plain(name) in bare for name in names)
    }


class Bare(PathFinder):
    """Finds what `PathFinder` finds, without what is absent."""

    hidden: frozenset[str] = frozenset()

    @classmethod
    def find_spec(cls, fullname, path=None, target=None):
        return None if fullname.partition(".")[0] in cls.hidden else super().find_spec(fullname, path, target)


if __name__ == "__main__":
    Bare.hidden = frozenset(absent())
    for loaded in [name for name in sys.modules if name.partition(".")[0] in Bare.hidden]:
        del sys.modules[loaded]
    sys.meta_path[sys.meta_path.index(PathFinder)] = Bare
    sys.argv[0] = "joint-monitor"
    if sys.argv[1:] == ["--lines"]:
        sys.path.append(str(Path(__file__).parents[1]))
        from command_line import ended

        results = [ended(*line) for line in json.load(sys.stdin)]
        json.dump([[result.returncode, result.stdout + result.stderr] for result in results], sys.stdout)
    else:
        from monitor.cli.main import main

        main()
