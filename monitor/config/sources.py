"""The sources of a setting: a line of the TOML file, a variable of the environment, a credential of the service manager. I/O."""

import re
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

PREFIX = "JOINT_MONITOR__"  # JOINT_MONITOR__SCHEDULE__CRON="0 4 * * *"
CREDENTIAL = "credential:"  # token = "credential:page-token": the file page-token in $CREDENTIALS_DIRECTORY
_HEADER = re.compile(r"\s*\[\s*([A-Za-z0-9_.\-\s\"']+?)\s*\]\s*(#.*)?$")
_LISTED = re.compile(r"\s*\[\[\s*([A-Za-z0-9_.\-\s\"']+?)\s*\]\]\s*(#.*)?$")  # of a table in a list
_KEY = re.compile(r"\s*([A-Za-z0-9_\-.\"']+)\s*=")
_PLACE = re.compile(r"\[(?P<section>[\w.-]+)\](?: \w+: (?P<key>\w+))?|(?P<dotted>[\w-]+(?:\.[\w-]+)+|[\w-]+)(?=[:\s])")


def overridden(document: dict[str, Any], environment: Mapping[str, str], mistakes: list[str], texts: Collection[str] = ()) -> list[str]:
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
            mistakes.append(f"environment {name}: expected {PREFIX}SECTION__KEY, e.g. {PREFIX}SCHEDULE__CRON")
            continue
        table = document
        for key in keys[:-1]:
            below = table.setdefault(key, {})
            if not isinstance(below, dict):
                mistakes.append(f"environment {name}: {key} is no table")
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


def with_credentials(document: Any, directory: str | None, mistakes: list[str], secrets: dict[str, str], place: str = "") -> Any:
    """The document with every `credential:NAME` replaced by the text of the file NAME in `directory`.

    Adds each text to `secrets` by its name, so that messages can leave it out, and a message to `mistakes` for each one that is missing.
    """
    if isinstance(document, dict):
        return {
            key: with_credentials(value, directory, mistakes, secrets, f"{place}.{key}" if place else str(key))
            for key, value in document.items()
        }
    if isinstance(document, list):
        return [with_credentials(value, directory, mistakes, secrets, f"{place}.{number}") for number, value in enumerate(document)]
    if not (isinstance(document, str) and document.startswith(CREDENTIAL)):
        return document
    name = document.removeprefix(CREDENTIAL)
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name) or name in {".", ".."}:
        mistakes.append(f"{place}: {document!r}: expected {CREDENTIAL}NAME, the name of a file in $CREDENTIALS_DIRECTORY")
    elif not directory:
        mistakes.append(
            f"{place}: asks for the credential {name}, and $CREDENTIALS_DIRECTORY is not set; the service manager sets it for the service, "
            f"and by hand it is the folder of a file {name}"
        )
    else:
        try:
            secret = (Path(directory) / name).read_text("utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            mistakes.append(f"{place}: the credential {name} cannot be read: {getattr(error, 'strerror', None) or 'it is no text'}")
        else:
            secrets[name] = secret
            return secret
    return document


def without_secrets(text: str, secrets: Mapping[str, str]) -> str:
    """The text with every secret replaced by its name."""
    for name, secret in secrets.items():
        if secret:
            text = text.replace(secret, f"(the credential {name})")
    return text


def placed(mistake: str, path: Path, text: str) -> str:
    """The mistake after the path of the file, and after the line of its key where the file has the key."""
    if mistake.startswith("environment "):
        return mistake
    match = _PLACE.match(mistake)
    number = None
    if match is not None:
        keys = (match["dotted"] or ".".join(part for part in (match["section"], match["key"]) if part)).split(".")
        number = line_of(text, keys)
    return f"{path}:{number}: {mistake}" if number else f"{path}: {mistake}"


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
