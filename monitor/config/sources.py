"""The sources of a setting: a line of a TOML file, a variable of the environment, a credential of the service manager. I/O."""

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from monitor.config.sections import Mistake, of_key
from monitor.errors import BadConfiguration

PREFIX = "JOINT_MONITOR__"  # JOINT_MONITOR__SCHEDULE__CRON="0 4 * * *"
CREDENTIAL = "credential:"  # token = "credential:page-token": the file page-token in $CREDENTIALS_DIRECTORY
_HEADER = re.compile(r"\s*\[\s*([A-Za-z0-9_.\-\s\"']+?)\s*\]\s*(#.*)?$")
_LISTED = re.compile(r"\s*\[\[\s*([A-Za-z0-9_.\-\s\"']+?)\s*\]\]\s*(#.*)?$")  # of a table in a list
_KEY = re.compile(r"\s*([A-Za-z0-9_\-.\"']+)\s*=")


@dataclass
class Source:
    """A configuration while it is read: its document, and every mistake that was found."""

    path: Path
    text: str  # of the file; empty: there is none
    document: dict[str, Any]
    mistakes: list[Mistake] = field(default_factory=list)
    overrides: tuple[str, ...] = ()  # variables of the environment that replace values of the file
    secrets: dict[str, str] = field(default_factory=dict)  # credentials by name; messages leave them out
    _in_file: frozenset[str] = frozenset()  # its sections, before the environment added others

    @classmethod
    def read(cls, path: Path) -> "Source":
        """A TOML file. Raises BadConfiguration where it cannot be read."""
        try:
            text = path.read_text("utf-8-sig")  # some editors put a byte order mark before the first letter
            return cls(path, text, tomllib.loads(text))
        except OSError as error:
            raise BadConfiguration(f"{path}: cannot be read: {error.strerror}") from None
        except UnicodeDecodeError as error:
            line = error.object[: error.start].count(b"\n") + 1
            shown = error.object[error.start : error.end]
            raise BadConfiguration(f"{path}:{line}: {shown!r} is no UTF-8; save the file as UTF-8") from None
        except tomllib.TOMLDecodeError as error:
            raise BadConfiguration(f"{path}: not TOML: {error}") from None
        except RecursionError:
            raise BadConfiguration(f"{path}: is nested too deeply; expected tables of keys") from None

    def override(self, environment: Mapping[str, str], texts: Collection[str]) -> None:
        """Replace values by those of JOINT_MONITOR__SECTION__KEY.

        texts : dotted keys whose value is text, also where it looks like a number.
        """
        self._in_file = frozenset(self.document)
        self.overrides = tuple(overridden(self.document, environment, self.mistakes, texts))

    def take_credentials(self, directory: str | None, but: Collection[str] = ()) -> None:
        """Replace every `credential:NAME` by the text of the file NAME in `directory`. but : sections that stay as they are."""
        taken = {name: table for name, table in self.document.items() if name not in but}
        self.document |= with_credentials(taken, directory, self.mistakes, self.secrets)

    def refuse(self) -> None:
        """Raises BadConfiguration that lists every mistake with its line or variable, if there is one."""
        if not self.mistakes:
            return
        shown = [self._placed(mistake) for mistake in self.mistakes]
        raise BadConfiguration(shown[0] if len(shown) == 1 else "\n  ".join((f"{self.path}: {len(shown)} mistakes", *shown)))

    def _placed(self, mistake: Mistake) -> str:
        text, key = mistake.text, mistake.key
        for name, secret in self.secrets.items():
            if secret:
                text = text.replace(secret, f"(the credential {name})")
        if not key:
            return text
        for name in self.overrides:
            keys = tuple(name.removeprefix(PREFIX).lower().split("__"))
            if (len(key) > 1 or key[0] not in self._in_file) and keys[: len(key)] == key[: len(keys)]:
                return f"environment {name}: {text}"
        number = line_of(self.text, list(key))
        return f"{self.path}:{number}: {text}" if number else f"{self.path}: {text}"


def overridden(document: dict[str, Any], environment: Mapping[str, str], mistakes: list[Mistake], texts: Collection[str] = ()) -> list[str]:
    """Replace values of `document` by those of JOINT_MONITOR__SECTION__KEY. Returns the names of the variables that were used.

    Adds a message to `mistakes` for each variable that names no key.
    texts : dotted keys whose value is text, also where it looks like a number.
    """
    used = []
    for name in sorted(environment):
        if not name.startswith(PREFIX):
            continue
        keys = [key.lower() for key in name.removeprefix(PREFIX).split("__")]
        if len(keys) < 2 or not all(keys):
            mistakes.append(Mistake((), f"environment {name}: expected {PREFIX}SECTION__KEY, e.g. {PREFIX}SCHEDULE__CRON"))
            continue
        table = document
        for key in keys[:-1]:
            below = table.setdefault(key, {})
            if not isinstance(below, dict):
                mistakes.append(Mistake((), f"environment {name}: {key} is no table"))
                break
            table = below
        else:
            value = _value(environment[name])
            table[keys[-1]] = environment[name] if ".".join(keys) in texts and not isinstance(value, str) else value
            used.append(name)
    return used


def _value(text: str) -> Any:
    """The value as TOML; text that is no TOML stays text, so that a shell's quotes are enough."""
    try:
        return tomllib.loads(f"value = {text}")["value"] if "\n" not in text else text
    except tomllib.TOMLDecodeError:
        return text


def with_credentials(
    document: Any, directory: str | None, mistakes: list[Mistake], secrets: dict[str, str], place: tuple[str, ...] = ()
) -> Any:
    """The document with every `credential:NAME` replaced by the text of the file NAME in `directory`.

    Adds each text to `secrets` by its name, so that messages can leave it out, and a message to `mistakes` for each one that is missing.
    """
    if isinstance(document, dict):
        return {key: with_credentials(value, directory, mistakes, secrets, (*place, str(key))) for key, value in document.items()}
    if isinstance(document, list):
        return [with_credentials(value, directory, mistakes, secrets, (*place, str(number))) for number, value in enumerate(document)]
    if not (isinstance(document, str) and document.startswith(CREDENTIAL)):
        return document
    name = document.removeprefix(CREDENTIAL)
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name) or name in {".", ".."}:
        mistakes.append(of_key(place, f"{document!r}: expected {CREDENTIAL}NAME, the name of a file in $CREDENTIALS_DIRECTORY"))
    elif not directory:
        reason = (
            f"asks for the credential {name}, and $CREDENTIALS_DIRECTORY is not set; the service manager sets it for the service, "
            f"and by hand it is the folder of a file {name}"
        )
        mistakes.append(of_key(place, reason))
    else:
        try:
            secret = (Path(directory) / name).read_text("utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or "it is no text"
            mistakes.append(of_key(place, f"the credential {name} cannot be read: {why}"))
        else:
            secrets[name] = secret
            return secret
    return document


def line_of(text: str, keys: list[str]) -> int | None:
    """The line of a TOML file on which a key is set, else on which its table begins; None where neither stands in it."""
    section: list[str] = []
    table = None
    counts: dict[str, int] = {}  # tables of each list so far
    for number, line in enumerate(text.splitlines(), start=1):
        if listed := _LISTED.match(line):
            name = ".".join(_parts(listed[1]))
            section = [*name.split("."), str(counts.get(name, 0))]
            counts[name] = counts.get(name, 0) + 1
            if table is None and section in (keys, [*keys, "0"], keys[: len(section)]):
                table = number
        elif header := _HEADER.match(line):
            section = _parts(header[1])
            if section == keys or (section == keys[: len(section)] and table is None):
                table = number
        elif (key := _KEY.match(line)) and [*section, *_parts(key[1])] == keys:
            return number
    return table


def _parts(dotted: str) -> list[str]:
    return [part.strip().strip("\"'") for part in dotted.split(".")]
