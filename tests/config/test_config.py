"""The reference configuration documents every setting, and a mistake is named with its key."""

import dataclasses
import json
import re
import tomllib
from pathlib import Path
from typing import Annotated, get_type_hints

import pytest

from monitor.config import schema
from monitor.config.files import find_excitation
from monitor.config.load import from_document, load
from monitor.config.sections import keys_of
from monitor.errors import BadConfiguration, BadInput

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "config" / "monitor.toml"
LEAST = {"robot": {"model": "ur5", "site": "lab", "id": "cell-1"}}


def test_the_reference_configuration_holds_the_defaults():
    """An empty file gives the same settings as the reference: its figures are those of the code."""
    reference, least = load(REFERENCE), from_document(LEAST, REFERENCE)
    for name in ("robot", "schedule", "store", "replay", "bus", "metrics", "page", "notify", "assess"):
        assert getattr(reference, name) == getattr(least, name), name
    assert reference.excitation.digest == least.excitation.digest


def test_every_key_of_the_code_is_in_the_reference_with_its_reason():
    """Every setting is documented. Every documented key is known, or the file would be refused."""
    text = REFERENCE.read_text("utf-8")
    document = tomllib.loads(text)
    keys = set()

    def collect(cls: type, table: dict, place: str) -> None:
        hints = get_type_hints(cls)
        for field in keys_of(cls):
            hint = hints[field.name]
            if isinstance(hint, type) and dataclasses.is_dataclass(hint):
                collect(hint, table[field.name], f"{place}.{field.name}")
                continue
            if (place, field.name) == ("robot", "serial"):
                continue  # it has no default
            assert field.name in table, f"{place}.{field.name} is not in the reference"
            keys.add(field.name)

    loaded = load(REFERENCE)
    for name in ("robot", "schedule", "store", "replay", "bus", "metrics", "page", "notify"):
        collect(type(getattr(loaded, name)), document[name], name)
    for field in dataclasses.fields(loaded.assess):
        value = getattr(loaded.assess, field.name)
        if dataclasses.is_dataclass(value):
            collect(type(value), document[field.name], field.name)
    for line in text.splitlines():
        match = re.match(r"(\w+) = ", line)
        if match:
            assert re.search(r"#\s+\S.{2,}", line), f"{line!r} gives no reason"


def test_the_drift_filter_has_at_most_twelve_documented_keys():
    """What the monitor can learn from the arm is no key."""
    assert len(tomllib.loads(REFERENCE.read_text("utf-8"))["drift"]) <= 12


def test_a_key_of_a_version_before_1_0_is_refused_and_the_known_ones_are_named():
    """What the arm teaches is no key any more, and a section that had another name is unknown."""
    for key in ("gate_sigma", "shift_sigma", "memory_replays", "alike_replays"):
        assert f"drift.{key}: unknown key" in refusal(drift={key: 4.0})
    assert "drift.gate_sigma: unknown key; since version 1.0 known are reference_speed_rad_s, " in refusal(drift={"gate_sigma": 4.0})
    assert re.search(r"\[work\]: unknown section; since version 1\.0 known are robot, .*production", refusal(work={"listen": True}))


def refusal(**sections: object) -> str:
    with pytest.raises(BadConfiguration) as refused:
        from_document({**LEAST, **sections}, Path("cell.toml"))
    return str(refused.value)


def test_every_mistake_is_named_at_once_with_the_nearest_valid_key():
    """The operator sees all mistakes at once, and not one after each correction."""
    message = refusal(
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
        assert part in message, part


@pytest.mark.parametrize("word", ["yes", "true", 1, "on"])
def test_only_the_boolean_true_lets_an_arm_move(word: object):
    """A string or a number that looks like yes is a mistake and no permission."""
    assert "allow_motion" in refusal(replay={"allow_motion": word})


@pytest.mark.parametrize("host", ["", "http://192.168.0.10", "192.168.0.10:30004", "arm 1", "zelle-ü", "a" * 64, "a..b"])
def test_what_is_no_address_of_a_controller_is_refused_before_anybody_calls_it(host: str):
    assert f"robot.host: {host!r}: expected the controller's address alone" in refusal(robot={**LEAST["robot"], "host": host})


@pytest.mark.parametrize("folder", ["~/history", "$HOME/history"])
def test_a_folder_that_only_a_shell_would_understand_is_refused(folder: str):
    assert f"store.directory: {folder!r}: ~ and $ stand for nothing here" in refusal(store={"directory": folder})


def test_a_misspelt_model_or_mounting_is_one_mistake(tmp_path: Path):
    """The trajectory that would have been taken by its name is not missed as well."""
    for robot, key in (('model = "ur5x"', "robot.model"), ('model = "ur5"\nmounting = "sideways"', "robot.mounting")):
        (tmp_path / "a.toml").write_text(f'[robot]\n{robot}\nsite = "lab"\nid = "a"\n')
        with pytest.raises(BadConfiguration, match=key) as refused:
            load(tmp_path / "a.toml")
        assert "replay.excitation" not in str(refused.value)


def test_an_excitation_for_another_robot_or_no_file_is_refused(tmp_path: Path):
    """The trajectory must be made for the arm. The message about an unknown name lists the shipped ones."""
    assert "made for a ur3" in refusal(replay={"excitation": "ur3-ground"})
    assert "shipped are" in refusal(replay={"excitation": "ur5-moon"})
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(BadConfiguration, match=r"broken\.json"):
        from_document({**LEAST, "replay": {"excitation": "broken.json"}}, tmp_path / "cell.toml")


def test_a_missing_file_and_invalid_toml_give_a_message(tmp_path: Path):
    """Both give a message and no traceback."""
    with pytest.raises(BadConfiguration, match="cannot be read"):
        load(tmp_path / "absent.toml")
    (tmp_path / "bad.toml").write_text("[robot\n")
    with pytest.raises(BadConfiguration, match="not TOML"):
        load(tmp_path / "bad.toml")


@pytest.mark.parametrize("path", sorted((ROOT / "config" / "excitation").glob("*.json")), ids=lambda path: path.stem)
def test_every_shipped_excitation_starts_and_ends_at_rest_within_the_robots_limits(path: Path):
    """Every shipped trajectory can be replayed: it passes the check that guards a replay."""
    from monitor.acquire.safety.of_configuration import within_limits
    from monitor.model.fourier import excitation_from_document
    from monitor.model.robot import load_robot

    excitation = excitation_from_document(json.loads(path.read_text("utf-8")))
    robot = load_robot(excitation.robot)
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)


def bounded(cls: type, place: str = ""):
    """(key, type, least, most) of every setting of a room that has bounds."""
    from typing import get_args, get_origin

    for name, hint in get_type_hints(cls, include_extras=True).items():
        if dataclasses.is_dataclass(hint):
            yield from bounded(hint, f"{place}{name}.")
        elif get_origin(hint) is Annotated:
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


ROOMS = {"robot": schema.RobotSettings, "schedule": schema.section_classes()["schedule"]} | schema.assess_sections()


@pytest.mark.parametrize(("room", "key"), [(room, key) for room, cls in ROOMS.items() for key, *_ in bounded(cls)])
def test_a_figure_beyond_its_bounds_is_refused_by_name(room, key):
    """Values below the least and above the most are refused. The defaults lie within, or the reference would not load."""
    _, kind, least, most = next(row for row in bounded(ROOMS[room]) if row[0] == key)
    for value in (kind(least) - 1, kind(most) + 1):
        section = nested(key, value)
        message = refusal(**{room: {**LEAST.get(room, {}), **section}})
        assert f"{room}.{key} = {value!r}: input should be" in message


@pytest.mark.parametrize("text", ['{"a": ' * 100_000, "nonsense", "[]", '{"kind": "joint-monitor.excitation.v1"}'])
def test_a_file_that_is_no_excitation_is_refused_with_its_name(tmp_path, text):
    """Deeply nested, broken, other and empty files give a message and no traceback."""
    (tmp_path / "mine.json").write_text(text)
    with pytest.raises(BadInput, match=r"excitation|mine\.json"):
        find_excitation("mine.json", tmp_path)


@pytest.mark.parametrize("change", [{"repetitions": float("inf")}, {"period_s": 1e9}, {"repetitions": 10**9}])
def test_an_excitation_without_end_is_refused(tmp_path, change):
    """It is endless, lasts a century, or has a thousand million repetitions."""
    document = find_excitation("ur5-ground", Path()).as_document() | change
    (tmp_path / "mine.json").write_text(json.dumps(document))
    with pytest.raises(BadInput, match="excitation: "):
        find_excitation("mine.json", tmp_path)


def test_an_impossible_directory_is_refused():
    """The name contains NUL, or is empty."""
    for directory in ("a\0b", "  ", "~", "~/history"):
        assert "store.directory" in refusal(store={"directory": directory})


def test_a_directory_that_is_a_file_is_refused_where_the_files_are_read(tmp_path):
    """By `check` and `run`: the history's folder, and each folder above it; a path that does not exist yet is right."""
    (tmp_path / "file").write_text("")
    for directory, right in (("file", False), ("file/history", False), ("new/history", True)):
        path = tmp_path / "cell-1.toml"
        path.write_text(f'[robot]\nmodel = "ur5"\nsite = "a"\nid = "b"\n[store]\ndirectory = "{directory}"\n')
        if right:
            load(path, {}, reads_files=True)
            continue
        with pytest.raises(BadConfiguration, match=r"store\.directory.*is a file; expected a folder"):
            load(path, {}, reads_files=True)


# --- where a setting comes from, and where a mistake is ------------------------------------------------------------------


def written(folder: Path, text: str) -> Path:
    path = folder / "cell.toml"
    path.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n' + text)
    return path


def test_every_mistake_is_reported_with_its_file_and_line(tmp_path: Path):
    """All are reported at once: key, section, value out of range, and key of a nested table. A missing key has no line."""
    path = written(
        tmp_path, '[replay]\nallow_moton = true\ngain = 5.0\n[helth]\n[identify.signals]\n  cutof_hz = 3.0\n[schedule]\ncron = "noon"\n'
    )
    path.write_text(path.read_text().replace('site = "lab"\n', ""))
    with pytest.raises(BadConfiguration) as refused:
        load(path, {})
    lines = str(refused.value).splitlines()
    assert lines[0].endswith("6 mistakes")
    message = "\n".join(lines[1:])
    for part in (
        f"{path}:5: replay.allow_moton: unknown key (did you mean allow_motion?)",
        f"{path}:6: replay.gain = 5.0; expected",
        f"{path}:7: [helth]: unknown section (did you mean health?)",
        f"{path}:9: identify.signals.cutof_hz: unknown key (did you mean cutoff_hz?)",
        f"{path}:11: schedule.cron = 'noon'",
        "robot.site: missing",
    ):
        assert part in message, (part, message)


def test_mistakes_in_values_are_reported_all_at_once_with_line_and_toml_type(tmp_path: Path):
    """Several values of one section and several texts of one list are reported. A key of the wrong type is not also missing."""
    path = written(
        tmp_path,
        '[replay]\ngain = 5.0\npermit = "perhaps"\nwindows_utc = "22:00-05:00"\n'
        '[schedule]\nblackout = ["2026-13-01", "24.12.2026"]\njitter_s = 900.0\ncron = "noon"\n[page]\nlisten = "here"\n',
    )
    path.write_text(path.read_text().replace('id = "cell-1"', "id = 7"))
    with pytest.raises(BadConfiguration) as refused:
        load(path, {})
    lines = str(refused.value).splitlines()[1:]
    starts = (
        "4: robot.id = 7: expected text in quotes", "6: replay.gain = 5.0; expected", "7: replay.permit = 'perhaps'; expected",
        "8: replay.windows_utc = '22:00-05:00': expected a list", "10: schedule.blackout = '2026-13-01', '24.12.2026'",
        "11: schedule.jitter_s = 900", "12: schedule.cron = 'noon'", "14: page.listen = 'here'",
    )  # fmt: skip
    assert len(lines) == len(starts), lines
    for start in starts:
        assert any(line.strip().startswith(f"{path}:{start}") for line in lines), (start, lines)


def test_a_file_of_another_editor_is_read_or_refused_with_the_line(tmp_path: Path):
    """A byte order mark and CRLF are accepted. Another encoding and endless nesting give a message."""
    path = written(tmp_path, 'tool = "gripper"\n')
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert load(path, {}).robot.tool == "gripper"
    path.write_bytes(path.read_bytes().replace(b"gripper", b"gro\xdf"))
    with pytest.raises(BadConfiguration, match=r":5: .* is no UTF-8"):
        load(path, {})
    written(tmp_path, f"x = {'[' * 5000}{']' * 5000}\n")
    with pytest.raises(BadConfiguration, match="nested too deeply"):
        load(path, {})


def test_text_from_the_environment_stays_text_and_mistakes_there_are_attributed_to_it(tmp_path: Path):
    """A serial number consists of digits and stays text. Quotes around it are removed."""
    path = written(tmp_path, "")
    environment = {"JOINT_MONITOR__ROBOT__SERIAL": "20185500001", "JOINT_MONITOR__ROBOT__TOOL": '"true"'}
    loaded = load(path, environment)
    assert (loaded.robot.serial, loaded.robot.tool) == ("20185500001", "true")
    with pytest.raises(BadConfiguration) as refused:
        load(path, {"JOINT_MONITOR__HELTH__WEAR_RISE": "0.1", "JOINT_MONITOR__SCHEDULE__CRON__X": "1"})
    assert "environment JOINT_MONITOR__HELTH__WEAR_RISE: [helth]: unknown section (did you mean health?)" in str(refused.value)
    assert "environment JOINT_MONITOR__SCHEDULE__CRON__X: schedule.cron = " in str(refused.value)


def test_an_environment_variable_replaces_a_key_and_is_named_in_its_mistakes(tmp_path: Path):
    """Values are read as TOML, or else as text. The message begins with the variable, so nobody searches the file."""
    path = written(tmp_path, '[schedule]\ncron = "0 3 * * *"\n')
    environment = {
        "JOINT_MONITOR__SCHEDULE__CRON": "30 4 * * *",
        "JOINT_MONITOR__ROBOT__PAYLOAD_KG": "1.5",
        "JOINT_MONITOR__IDENTIFY__SIGNALS__CUTOFF_HZ": "7.5",
        "JOINT_MONITOR__ROBOT__HOST": "127.0.0.3",
        "JOINT_MONITOR_DATA": "/somewhere/else",
    }
    loaded = load(path, environment)
    assert (loaded.schedule.cron, loaded.robot.payload_kg, loaded.robot.host) == ("30 4 * * *", 1.5, "127.0.0.3")
    assert loaded.assess.identify.signals.cutoff_hz == 7.5
    assert set(loaded.overrides) == set(environment) - {"JOINT_MONITOR_DATA"}
    assert load(path, {}).overrides == ()
    with pytest.raises(BadConfiguration) as refused:
        load(path, {"JOINT_MONITOR__SCHEDULE__GRACE_S": "soon", "JOINT_MONITOR__CRON": "x", "JOINT_MONITOR__SCHEDULE__CORN": "1"})
    message = str(refused.value)
    assert "environment JOINT_MONITOR__SCHEDULE__GRACE_S: schedule.grace_s" in message
    assert "environment JOINT_MONITOR__CRON: expected JOINT_MONITOR__SECTION__KEY" in message
    assert "environment JOINT_MONITOR__SCHEDULE__CORN: schedule.corn: unknown key (did you mean cron?)" in message


def test_only_the_boolean_true_lets_an_arm_move_from_the_environment_too(tmp_path: Path):
    """`yes` and `1` are mistakes in the environment as in the file."""
    path = written(tmp_path, "")
    assert load(path, {"JOINT_MONITOR__REPLAY__ALLOW_MOTION": "true"}).replay.allow_motion is True
    for word in ("yes", "1", "True"):
        with pytest.raises(BadConfiguration, match="allow_motion"):
            load(path, {"JOINT_MONITOR__REPLAY__ALLOW_MOTION": word})


def test_a_secret_comes_from_the_service_managers_credentials_and_is_never_shown(tmp_path: Path):
    """It is read from $CREDENTIALS_DIRECTORY. A wrong value is refused without being shown, and a missing one is named."""
    (tmp_path / "secrets").mkdir()
    (tmp_path / "secrets" / "who").write_text("hunter-2\n")
    path = written(tmp_path, "")
    path.write_text(path.read_text().replace('"cell-1"', '"credential:who"'))
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path / "secrets")}
    assert load(path, environment).robot.id == "hunter-2"
    (tmp_path / "secrets" / "who").write_text("Hunter Two")
    with pytest.raises(BadConfiguration, match="the credential who") as refused:
        load(path, environment)
    assert "Hunter" not in str(refused.value)
    for environment, message in (
        ({}, "CREDENTIALS_DIRECTORY is not set.*by hand"),
        ({"CREDENTIALS_DIRECTORY": str(tmp_path)}, "cannot be read"),
    ):
        with pytest.raises(BadConfiguration, match=message):
            load(path, environment)
    path.write_text(path.read_text().replace("credential:who", "credential:../../etc/passwd"))
    with pytest.raises(BadConfiguration, match="the name of a file"):
        load(path, {"CREDENTIALS_DIRECTORY": str(tmp_path)})


def test_a_reload_applies_what_can_change_and_names_what_needs_a_restart(tmp_path: Path):
    """Thresholds, schedule, guards, payload: at once; sockets, files and identity: at a restart; reference speed: with a new history."""
    from monitor.config.reload import reloaded

    old = load(written(tmp_path, ""), {})
    new = load(
        written(
            tmp_path,
            '[schedule]\ncron = "0 5 * * *"\n[health]\nwear_rise = 0.08\n[bus]\nlive_rate_hz = 2.0\n'
            '[store]\ndirectory = "elsewhere"\nbackups = 3\n'
            "[drift]\nreference_speed_rad_s = 0.5\nresolution = 0.2\n[replay]\nallow_motion = true\n"
            "[residual]\nrise = 0.2\n",
        ),
        {"JOINT_MONITOR__ROBOT__PAYLOAD_KG": "2.0", "JOINT_MONITOR__ROBOT__HOST": "127.0.0.9"},
    )
    found = reloaded(old, new)
    assert found.changed == (
        "drift.resolution", "health.wear_rise", "replay.allow_motion", "residual.rise", "robot.payload_kg", "schedule.cron",
        "store.backups",
    )  # fmt: skip
    assert found.waiting == ("bus.live_rate_hz", "drift.reference_speed_rad_s", "robot.host", "store.directory")
    assert found.held == ()  # with another directory the restart begins a new history
    held = reloaded(old, load(written(tmp_path, "[drift]\nreference_speed_rad_s = 0.5\n"), {}))
    assert (held.changed, held.waiting, held.held) == ((), (), ("drift.reference_speed_rad_s",))
    assert held.configuration.assess.drift.reference_speed_rad_s == 0.4
    assert "stays as it is" in held.text
    assert "new history" in held.text

    merged = found.configuration
    assert (merged.schedule.cron, merged.robot.payload_kg, merged.robot.host) == ("0 5 * * *", 2.0, "127.0.0.1")
    assert merged.replay.host == "127.0.0.1"
    assert merged.replay.allow_motion is True
    assert merged.assess.drift == dataclasses.replace(old.assess.drift, resolution=0.2)
    assert merged.state_directory == old.state_directory
    assert reloaded(old, old).text == "nothing has changed"


def test_an_arm_that_may_move_needs_its_gains_when_the_file_is_read():
    """An e-Series arm without gains would be refused at every window: the file says so, by the key that is missing."""
    e_series = {"model": "ur5e", "site": "lab", "id": "cell-1"}
    message = refusal(robot=e_series, replay={"allow_motion": True})
    assert "robot.gains_nm_per_a" in message
    assert "joint-monitor init" in message
    assert "allow_motion" in message
    assert from_document({"robot": e_series}, Path("cell.toml")).replay.allow_motion is False  # it only listens
    known = {**e_series, "gains_nm_per_a": [10.2, 10.2, 10.1, 8.1, 8.2, 8.1]}
    assert from_document({"robot": known, "replay": {"allow_motion": True}}, Path("cell.toml")).gains_nm_per_a is not None
    assert from_document({**LEAST, "replay": {"allow_motion": True}}, Path("cell.toml")).gains_nm_per_a is None  # published for a UR5


def test_a_service_without_a_directory_has_its_history_where_systemd_put_it_and_commands_find_it(tmp_path, monkeypatch):
    """`$STATE_DIRECTORY` where it is set; for a file in /etc/joint-monitor the same folder without it; else beside the file, as ever."""
    least = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n'
    (tmp_path / "cell-1.toml").write_text(least)
    assert load(tmp_path / "cell-1.toml", {}).state_directory == tmp_path / "var/joint-monitor"
    assert load(tmp_path / "cell-1.toml", {"STATE_DIRECTORY": "/var/lib/x:/var/lib/y"}).state_directory == Path("/var/lib/x")
    monkeypatch.setattr("monitor.config.load.ETC", tmp_path)
    assert load(tmp_path / "cell-1.toml", {}).state_directory == Path("/var/lib/joint-monitor/cell-1")
    (tmp_path / "cell-1.toml").write_text(f'{least}[store]\ndirectory = "history"\n')
    assert load(tmp_path / "cell-1.toml", {"STATE_DIRECTORY": "/var/lib/x"}).state_directory == tmp_path / "history"


def test_a_secret_in_a_list_of_tables_comes_from_its_credential_too(tmp_path):
    """As the recipients of the gateway have them."""
    from monitor.config.sources import with_credentials

    (tmp_path / "hook").write_text("s3cret\n")
    mistakes, secrets = [], {}
    document = {"notify": {"to": [{"name": "a"}, {"secret": "credential:hook", "token": "credential:absent"}]}}
    read = with_credentials(document, str(tmp_path), mistakes, secrets)
    assert read["notify"]["to"][1]["secret"] == "s3cret"
    assert secrets == {"hook": "s3cret"}
    assert [mistake.key for mistake in mistakes] == [("notify", "to", "1", "token")]
