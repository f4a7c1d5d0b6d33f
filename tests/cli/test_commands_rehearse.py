"""The command `rehearse --world`: one world that the judge does not assume."""

import json

import pytest
from command_line import printed

from monitor.cli import judge as commands
from monitor.errors import BadInput
from monitor.studies.worlds import verdicts
from monitor.studies.worlds.table import WORLDS
from monitor.studies.worlds.verdicts import play_world

CONFIG = ("rehearse", "--config", "config/monitor.toml")


@pytest.mark.parametrize("world", ["all-joints-3"])
def test_a_world_is_played_by_its_name(world, monkeypatch):
    """As one object and as tables; here four months of sixteen arms."""
    monkeypatch.setattr(commands, "WORLD_DAYS", 120)
    played: list[tuple] = []

    def once(*given, **settings):
        if not played:
            played.append((given, settings, play_world(*given, **settings)))
        assert (given, settings) == played[0][:2]  # object and tables are asked for the same
        return played[0][2]

    monkeypatch.setattr(verdicts, "play_world", once)
    options = (*CONFIG, "--world", world, "--arms", "16", "--seed", "2")
    document = json.loads(printed(*options, "--json"))
    assert document["world"] == world
    assert document["arms"] == 16
    assert document["false_advisories"]["counted"]["kinds"] == ["rising", "falling"]
    assert {row["wear"] for row in document["detection"]} == {"5 % step", "10 %/year"}
    assert document["goal"]["false_advisories"] == 0.1
    text = printed(*options)
    assert WORLDS[world].sentence in text.replace("\n", " ")
    assert "not counted" in text


def test_an_unknown_world_is_refused_with_the_names_of_all():
    """Exit code 2, as with every mistake on the command line."""
    with pytest.raises(BadInput) as refused:
        printed(*CONFIG, "--world", "nowhere")
    assert refused.value.exit_code == 2
    assert all(name in str(refused.value) for name in WORLDS)


@pytest.mark.parametrize("option", [("--noise", "0.03"), ("--plot", "a.png")])
def test_what_a_world_decides_itself_is_not_asked_beside_it(option):
    """Its noise is its own, and there is no plot of it."""
    with pytest.raises(BadInput, match="--world"):
        printed(*CONFIG, "--world", "plain", *option)
