"""The walk-through of docs/CONTRIBUTING, "Add a bus document": one entry in the registry, and every reader knows the new kind."""

import json
from pathlib import Path

import jsonschema
import pytest
from pydantic import Field
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.config.load import from_document
from monitor.publish.client import Client
from monitor.publish.documents import Document
from monitor.publish.registry import KINDS, Delivery, DocumentKind, schema
from monitor.service.daemon import Daemon
from monitor.store.store import Store


class Lubrication(Document):
    """Grease of one joint."""

    joint: int = Field(ge=1)
    grease_g: float = Field(ge=0.0, description="left in the joint")


@pytest.fixture
def lubrication(monkeypatch: pytest.MonkeyPatch) -> DocumentKind:
    """The new kind, registered for one test."""
    kind = DocumentKind(
        name="lubrication",
        model=Lubrication,
        keys=("joint/{joint}/lubrication",),
        delivery=Delivery.LAST_VALUE,
        when="After every greasing.",
    )
    monkeypatch.setitem(KINDS, kind.name, kind)
    return kind


def never_plays(*_: object) -> None:
    raise AssertionError("no window is performed here")


def test_a_new_kind_of_document_is_one_entry_in_the_registry(lubrication: DocumentKind, tmp_path: Path, free_port: int):
    """The daemon publishes it on its key, the client reads it by its kind, and its schema is printed; nothing else knows its name."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    document = {"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}, "bus": {"listen": [endpoint]}}
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(from_document(document, tmp_path / "cell.toml"), store, now=lambda: 1.0e9, play=never_plays) as daemon,
        Client(endpoint, "lab", "cell-1") as client,
    ):
        for joint, grease_g in ((2, 7.5), (1, 9.0)):
            daemon.publisher.say(Lubrication(joint=joint, grease_g=grease_g))
        assert client.documents("lubrication") == [Lubrication(joint=1, grease_g=9.0), Lubrication(joint=2, grease_g=7.5)]
        (message,) = client.get("joint/2/lubrication")
    assert message.document == {"joint": 2, "grease_g": 7.5}
    jsonschema.validate(message.document, schema("lubrication"))
    printed = CliRunner().invoke(app, ["schema", "lubrication"])
    assert json.loads(printed.stdout)["$id"] == "joint-monitor.lubrication.v1"
    assert "lubrication      Grease of one joint." in CliRunner().invoke(app, ["schema"]).stdout


def test_every_kind_states_when_and_where_it_is_published():
    """Each has a sentence; each but the error reply has a key; a kind is known by its content's type alone."""
    assert all(kind.when.endswith(".") and kind.model.__doc__ for kind in KINDS.values())
    assert [name for name, kind in KINDS.items() if not kind.keys] == ["error"]
    assert len({kind.model for kind in KINDS.values()}) == len(KINDS)
    assert KINDS["friction"].selectors == ("joint/*/friction",)
    assert KINDS["friction"].key(joint=3) == "joint/3/friction"
