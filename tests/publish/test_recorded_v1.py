"""Documents and schemas of earlier daemons, read by today's code: within v1, fields are only added."""

import json
from pathlib import Path

import jsonschema
import pytest
from undeclared import undeclared

from monitor.publish.queries import Request
from monitor.publish.registry import KINDS, schema

RECORDED = Path(__file__).parent / "recorded_v1"
DOCUMENTS = sorted(path for path in RECORDED.glob("*/*.json") if path.name != "schemas.json")
SCHEMAS = sorted(RECORDED.glob("*/schemas.json"))


def name(path: Path) -> str:
    return f"{path.parent.name}/{path.stem}"


def broken(before: dict, after: dict, *, asked: bool) -> list[str]:
    """What an earlier schema has and a later one has not, or has otherwise; `asked`: it is a request.

    An earlier reader must find every required field, and an earlier request must still be accepted.
    """
    found = []
    for title, old in {"": before, **before.get("$defs", {})}.items():
        new = after if not title else after.get("$defs", {}).get(title)
        if new is None:
            found.append(f"{title} is gone")
            continue
        for field, kind in old.get("properties", {}).items():
            if field not in new.get("properties", {}):
                found.append(f"{title}.{field} is gone")
            elif not asked and not set(types(kind)) >= set(types(new["properties"][field])):
                found.append(f"{title}.{field} was {types(kind)}, is {types(new['properties'][field])}")
            elif asked and not set(types(kind)) <= set(types(new["properties"][field])):
                found.append(f"{title}.{field} took {types(kind)}, takes {types(new['properties'][field])}")
        was, now = set(old.get("required", ())), set(new.get("required", ()))
        lost = now - was if asked else was - now
        found += [f"{title}.{field} is {'now asked for' if asked else 'no longer sure to be there'}" for field in sorted(lost)]
    return found


def types(kind: dict) -> list[str]:
    """The JSON types that a property may have, references by name."""
    if "anyOf" in kind:
        return sorted(one for part in kind["anyOf"] for one in types(part))
    if "$ref" in kind:
        return [kind["$ref"]]
    if kind.get("type") == "array":
        return [f"array of {' or '.join(types(kind.get('items', {})))}"]
    return [str(kind.get("type", "anything"))]


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_a_recorded_document_is_read_by_todays_types_and_valid_by_todays_schema(path):
    """Every field still has its name, and reads back as it was written."""
    recorded = json.loads(path.read_text("utf-8"))
    kind, document = recorded["kind"], recorded["document"]
    jsonschema.validate(document, schema(kind), format_checker=jsonschema.FormatChecker())
    read = KINDS[kind].model.model_validate(document)
    assert undeclared(read) == []
    assert read.model_dump(mode="json", exclude_unset=True) == document


def test_every_released_kind_is_recorded():
    """A kind is released once its schema is recorded; a permit's question and answer are the cell's. `record_v1.py` records both."""
    recorded = {json.loads(path.read_text("utf-8"))["kind"] for path in DOCUMENTS}
    released = {kind for path in SCHEMAS for kind in json.loads(path.read_text("utf-8"))}
    assert len(released) >= 20
    assert released <= set(KINDS)
    assert released - recorded <= {"permit", "permit-answer"}


@pytest.mark.parametrize("path", SCHEMAS, ids=name)
def test_todays_schemas_keep_the_promises_of_earlier_ones(path):
    """No field is removed, has another type or is no longer required, and requests need no new field."""
    before = json.loads(path.read_text("utf-8"))
    assert set(before) <= set(KINDS)
    for kind, old in before.items():
        assert broken(old, schema(kind), asked=issubclass(KINDS[kind].model, Request)) == [], kind


def test_a_field_that_is_renamed_removed_or_newly_asked_for_is_found():
    """The comparison finds the change of an alert and of a request. An addition is no change."""
    alert, request = schema("alert"), schema("ack-request")
    added = json.loads(json.dumps(alert))
    added["properties"]["more"] = {"type": "string"}
    assert broken(alert, added, asked=False) == []
    renamed = json.loads(json.dumps(alert))
    renamed["properties"]["told"] = renamed["properties"].pop("text")
    assert broken(alert, renamed, asked=False) == [".text is gone"]
    loose = json.loads(json.dumps(alert))
    loose["required"].remove("active")
    assert broken(alert, loose, asked=False) == [".active is no longer sure to be there"]
    other = json.loads(json.dumps(alert))
    other["properties"]["change"] = {"type": "string"}
    assert broken(alert, other, asked=False) == [".change was ['number'], is ['string']"]
    demanding = json.loads(json.dumps(request))
    demanding["required"].append("why")
    assert broken(request, demanding, asked=True) == [".why is now asked for"]
