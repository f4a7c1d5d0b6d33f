"""Requests from templates: places in braces, in values and addresses; the number in an answer by a JSON pointer. Pure."""

import re
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import quote

from monitor.errors import BadInput

PLACES = {  # what may stand in braces, and what it becomes
    "key": "a name of the alert that no other one has",
    "site": "of the arm",
    "robot": "its id",
    "model": "its model, e.g. ur5e",
    "serial": "its serial number",
    "joint": "1 to 8; empty for the arm",
    "joint_name": "e.g. Elbow",
    "condition": "e.g. wear_rising",
    "tier": "wear or limit",
    "priority": "of the tier, from [tickets.priority]",
    "headline": "what is the case, in a sentence",
    "text": "the arm's own text with its figures",
    "action": "what to do",
    "change_percent": "by which friction has changed, e.g. 9.1",
    "raised_at": "RFC 3339, UTC",
    "at": "of this change, RFC 3339, UTC",
    "link": "to the arm's page of the plant's screen",
    "number": "of the ticket; once it is open",
}
_PLACE = re.compile(r"\{(\w+)\}")


def check_template(template: Any, where: str) -> None:
    """Raises BadInput naming a placeholder that does not exist."""
    for text in _texts(template):
        for name in _PLACE.findall(text):
            if name not in PLACES:
                raise BadInput(f"{where}: {{{name}}} is no placeholder; known are {', '.join(PLACES)}")


def filled(template: Any, values: Mapping[str, Any]) -> Any:
    """The template with its places filled. A text that is one place alone becomes the value itself: a figure stays a figure."""
    if isinstance(template, Mapping):
        return {key: filled(value, values) for key, value in template.items()}
    if isinstance(template, list | tuple):
        return [filled(value, values) for value in template]
    if not isinstance(template, str):
        return template
    alone = _PLACE.fullmatch(template)
    if alone is not None and alone[1] in values:
        return values[alone[1]]
    return _PLACE.sub(lambda place: _text(values.get(place[1], place[0])), template)


def filled_address(template: str, values: Mapping[str, Any]) -> str:
    """An address with its places filled; no value can add a part to it."""
    return _PLACE.sub(lambda place: quote(_text(values.get(place[1], "")), safe=""), template)


def pointed(document: Any, pointer: str) -> Any:
    """The value that a JSON pointer (RFC 6901) names; None where there is none."""
    found = document
    for part in pointer.split("/")[1:]:
        name = part.replace("~1", "/").replace("~0", "~")
        if isinstance(found, Mapping):
            found = found.get(name)
        elif isinstance(found, list) and re.fullmatch(r"0|[1-9]\d*", name) and int(name) < len(found):
            found = found[int(name)]
        else:
            return None
    return found


def check_pointer(pointer: str, where: str) -> None:
    """Raises BadInput where it is none."""
    if not re.fullmatch(r"(/([^~/]|~[01])*)+", pointer):
        raise BadInput(f'{where} = {pointer!r}; expected a JSON pointer (RFC 6901), e.g. "/id" or "/data/number"')


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _texts(template: Any) -> Iterator[str]:
    if isinstance(template, Mapping):
        for value in template.values():
            yield from _texts(value)
    elif isinstance(template, list | tuple):
        for value in template:
            yield from _texts(value)
    elif isinstance(template, str):
        yield template
