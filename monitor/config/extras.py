"""What an installation may lack: the packages of its extras, and the command that installs them beside it."""

import re
import shlex
import sys
from collections.abc import Iterator
from importlib.metadata import requires
from importlib.util import find_spec
from typing import NamedTuple


class Requirement(NamedTuple):
    """A package that this one asks for."""

    asked: str  # as an installer takes it, e.g. "duckdb<2,>=1.1"
    extra: str  # empty: every installation has it

    @property
    def module(self) -> str:
        """The name to import, for the packages of extras: that of the package."""
        return re.split(r"[^\w-]", self.asked)[0].replace("-", "_").lower()


def requirements() -> Iterator[Requirement]:
    """What the installed package says that it needs."""
    for line in requires("joint-monitor") or ():
        asked, _, marker = line.partition(";")
        extra = re.search(r"extra == ['\"]([\w-]+)", marker)
        yield Requirement(asked.strip(), extra[1] if extra else "")


def absent(module: str, what: str) -> str:
    """The sentence for a module that is not installed: what needs it, and the command that installs its extra, whole, in this environment.

    module : as it is imported, without what follows a dot. what : e.g. the command that needs it.
    """
    of = [each for each in requirements() if each.module == module]
    together = [each.asked for each in requirements() if of and of[0].extra and each.extra == of[0].extra]
    asked = together or [each.asked for each in of] or [module]
    installer = [sys.executable, "-m", "pip", "install"] if find_spec("pip") else ["uv", "pip", "install", "--python", sys.executable]
    return f"{what} needs the package {module}, which is not installed here. This installs it: {shlex.join([*installer, *asked])}"
