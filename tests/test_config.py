"""The reference configuration documents what the rooms own, and a mistake is named with its key."""

import dataclasses
import json
import re
import tomllib
from pathlib import Path

import pytest

from monitor import config as configuration
from monitor.config import from_document, load
from monitor.errors import BadConfiguration, BadInput

ROOT = Path(__file__).parent.parent
REFERENCE = ROOT / "config" / "monitor.toml"
LEAST = {"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}}


def test_the_reference_configuration_holds_the_defaults():
    """A file that leaves everything out means the same as the reference: its figures are the code's."""
    reference, least = load(REFERENCE), from_document(LEAST, REFERENCE)
    for name in ("robot", "schedule", "store", "replay", "bus", "metrics", "page", "assess"):
        assert getattr(reference, name) == getattr(least, name), name
    assert reference.excitation.digest == least.excitation.digest


def test_every_key_that_a_room_owns_is_in_the_reference_with_a_word_of_reason():
    """Nothing configurable is undocumented; nothing documented is unknown (the file would be refused)."""
    text = REFERENCE.read_text("utf-8")
    document = tomllib.loads(text)
    keys = set()

    def collect(cls: type, table: dict, place: str) -> None:
        hints = configuration.get_type_hints(cls)
        for field in dataclasses.fields(cls):
            hint = hints[field.name]
            if isinstance(hint, type) and dataclasses.is_dataclass(hint):
                collect(hint, table[field.name], f"{place}.{field.name}")
                continue
            if (place, field.name) in {("replay", "host"), ("robot", "serial")}:
                continue  # host belongs to [robot]; a serial has no default to show
            assert field.name in table, f"{place}.{field.name} is not in the reference"
            keys.add(field.name)

    loaded = load(REFERENCE)
    for name in ("robot", "schedule", "store", "replay", "bus", "metrics", "page"):
        collect(type(getattr(loaded, name)), document[name], name)
    for field in dataclasses.fields(loaded.assess):
        value = getattr(loaded.assess, field.name)
        if dataclasses.is_dataclass(value):
            collect(type(value), document[field.name], field.name)
    for line in text.splitlines():
        match = re.match(r"(\w+) = ", line)
        if match:
            assert re.search(r"#\s+\S.{2,}", line), f"{line!r} gives no reason"


def refusal(**sections: object) -> str:
    with pytest.raises(BadConfiguration) as refused:
        from_document({**LEAST, **sections}, Path("cell.toml"))
    return str(refused.value)


def test_every_mistake_is_named_at_once_with_the_nearest_valid_key():
    """An operator who corrects one key should not meet the next mistake only then."""
    said = refusal(
        robot={**LEAST["robot"], "mountng": "wall", "site": "Ground Floor"},
        replay={"allow_moton": True, "gain": 5.0},
        identify={"signals": {"cutof_hz": 3.0}},
        helth={},
        schedule={"cron": "at noon"},
        bus={"live_rate_hz": "often"},
    )
    for part in (
        "did you mean mounting",
        "did you mean allow_motion",
        "did you mean cutoff_hz",
        "did you mean health",
        "schedule.cron",
        "bus.live_rate_hz",
    ):
        assert part in said, part


@pytest.mark.parametrize("word", ["yes", "true", 1, "on"])
def test_only_the_boolean_true_lets_an_arm_move(word: object):
    """A string or a number that looks like yes is a mistake, not a permission."""
    assert "allow_motion" in refusal(replay={"allow_motion": word})


def test_an_excitation_for_another_robot_or_no_file_is_refused(tmp_path: Path):
    """The trajectory must be made for the arm; an unknown name is answered with the shipped ones."""
    assert "made for a ur3" in refusal(replay={"excitation": "ur3-ground"})
    assert "shipped are" in refusal(replay={"excitation": "ur5-moon"})
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(BadConfiguration, match=r"broken\.json"):
        from_document({**LEAST, "replay": {"excitation": "broken.json"}}, tmp_path / "cell.toml")


def test_no_file_and_no_toml_are_sentences(tmp_path: Path):
    """Neither is a traceback."""
    with pytest.raises(BadConfiguration, match="cannot be read"):
        load(tmp_path / "absent.toml")
    (tmp_path / "bad.toml").write_text("[robot\n")
    with pytest.raises(BadConfiguration, match="not TOML"):
        load(tmp_path / "bad.toml")


@pytest.mark.parametrize("path", sorted((ROOT / "config" / "excitation").glob("*.json")), ids=lambda path: path.stem)
def test_every_shipped_excitation_starts_and_ends_at_rest_within_the_robots_limits(path: Path):
    """What is shipped can be replayed: the same check that guards a replay passes."""
    from monitor.acquire.limits import within_limits
    from monitor.model.fourier import excitation_from_document
    from monitor.model.robot import load_robot

    excitation = excitation_from_document(json.loads(path.read_text("utf-8")))
    robot = load_robot(excitation.robot)
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)


def bounded(cls: type, place: str = ""):
    """(key, type, least, most) of every setting of a room that has bounds."""
    from typing import get_args, get_origin

    for name, hint in configuration.get_type_hints(cls, include_extras=True).items():
        if dataclasses.is_dataclass(hint):
            yield from bounded(hint, f"{place}{name}.")
        elif get_origin(hint) is configuration.Annotated:
            kind, interval = get_args(hint)
            yield (
                f"{place}{name}",
                kind,
                interval.ge if interval.gt is None else interval.gt,
                interval.le if interval.lt is None else interval.lt,
            )


def nested(key: str, value: object) -> dict:
    first, _, rest = key.partition(".")
    return {first: nested(rest, value) if rest else value}


ROOMS = {"robot": configuration.RobotSettings, "schedule": configuration.ScheduleSettings} | configuration._assess_sections()


@pytest.mark.parametrize(("room", "key"), [(room, key) for room, cls in ROOMS.items() for key, *_ in bounded(cls)])
def test_a_figure_beyond_its_bounds_is_refused_by_name(room, key):
    """Below the least and above the most; the defaults lie within, or the reference would not load."""
    _, kind, least, most = next(row for row in bounded(ROOMS[room]) if row[0] == key)
    for value in (kind(least) - 1, kind(most) + 1):
        section = nested(key, value)
        said = refusal(**{room: {**LEAST.get(room, {}), **section}})
        assert f"{room}.{key} = {value!r}: input should be" in said


@pytest.mark.parametrize("text", ['{"a": ' * 100_000, "nonsense", "[]", '{"kind": "joint-monitor.excitation.v1"}'])
def test_what_is_no_excitation_is_refused_with_its_name(tmp_path, text):
    """Deep, broken, another thing, empty: a sentence, no traceback."""
    (tmp_path / "mine.json").write_text(text)
    with pytest.raises(BadInput, match=r"excitation|mine\.json"):
        configuration.find_excitation("mine.json", tmp_path)


@pytest.mark.parametrize("change", [{"repetitions": float("inf")}, {"period_s": 1e9}, {"repetitions": 10**9}])
def test_an_excitation_without_end_is_refused(tmp_path, change):
    """Endless, a century long, a thousand million times."""
    document = configuration.find_excitation("ur5-ground", Path()).as_document() | change
    (tmp_path / "mine.json").write_text(json.dumps(document))
    with pytest.raises(BadInput, match="excitation: "):
        configuration.find_excitation("mine.json", tmp_path)


def test_a_directory_that_no_folder_can_be_is_refused():
    """NUL, or nothing at all."""
    for directory in ("a\0b", "  "):
        assert "store.directory" in refusal(store={"directory": directory})
