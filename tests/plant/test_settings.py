"""The plant's file: strict, every mistake at once, and no message repeats a password."""

import pytest
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadConfiguration
from monitor.gateway.settings import load_gateway
from monitor.plant.database import Database
from monitor.plant.settings import load_plant

SECRET = "hunter2"


def refused(tmp_path, text, environment=None):
    (tmp_path / "plant.toml").write_text(text)
    with pytest.raises(BadConfiguration) as error:
        load_plant(tmp_path / "plant.toml", environment or {})
    return str(error.value)


def test_every_mistake_is_named_with_its_line(tmp_path):
    """Unknown keys and sections, wrong types, figures out of range, endpoints that are none."""
    said = refused(tmp_path, '[plant]\nworkers = 99\nconect = ["tcp/a:1"]\nsilent_s = "long"\n[arms]\n')
    for part in ("5 mistakes", "plant.toml:2:", "did you mean connect?", "silent_s", "[arms]: unknown section"):
        assert part.replace("5", "4") in said
    assert "'router' is no endpoint" in refused(tmp_path, '[plant]\nconnect = ["router"]\n')
    assert "no arm can be reached" in refused(tmp_path, "[plant]\nconnect = []\n")


def test_metrics_have_an_address_of_their_own_and_the_gateway_leaves_it_alone(tmp_path):
    """The two read one file."""
    assert "metrics.listen = '9465'; expected HOST:PORT" in refused(tmp_path, '[metrics]\nlisten = "9465"\n')
    (tmp_path / "plant.toml").write_text('[metrics]\nlisten = "127.0.0.1:9465"\n')
    assert load_plant(tmp_path / "plant.toml", {}).metrics.listen == "127.0.0.1:9465"
    load_gateway(tmp_path / "plant.toml", {})


@pytest.mark.parametrize("address", [f"postgres://u:{SECRET}@h/d", f"postgresql+psycopg://u:{SECRET}@h", f"mysql://u:{SECRET}@h/d"])
def test_a_wrong_address_of_a_database_is_refused_without_its_password(tmp_path, address):
    """The message says what would be right."""
    said = refused(tmp_path, f'[plant]\ndatabase = "{address}"\n')
    assert "postgresql+psycopg://USER@HOST/NAME" in said
    assert SECRET not in said


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f'[plant]\ndatabase = ["postgresql+psycopg://u:{SECRET}@h/d"]', "plant.database: expected text in quotes"),
        (f'[screen]\nproxy_secret = ["{SECRET}"]', "screen.proxy_secret: expected text in quotes"),
        ('[plant]\ndirectory = "a\\u0000b"', "no name of a file holds the sign NUL"),
        ('[plant]\ndatabase = "sqlite:////var/plant?mode=ro"', "sqlite:///PATH"),
        ('[plant]\nconnect = ["tcp/router.example"]', "has no port; expected HOST:PORT"),
        ('[plant]\nconnect = ["tls/router.example:99999"]', "has no port"),
        ('[plant]\nconnect = ["tcp/router.example:7447", "tcp/router.example:7447"]', "names an endpoint twice"),
        ("plant = 3", "expected a table [plant]"),
        ("[[plant]]\nworkers = 2", "expected a table [plant]"),
        ("[plant]\nworkers = 2\nworkers = 3", "not TOML: Cannot overwrite a value"),
        ("[plant]\nsilent_s = nan", "plant.silent_s = nan: "),
    ],
)
def test_what_people_type_is_named_and_repeats_no_secret(tmp_path, text, says):
    """With the file's line where it has one."""
    said = refused(tmp_path, text)
    assert says in said
    assert SECRET not in said


def test_files_that_the_configuration_names_are_read_by_the_check_and_at_the_start(tmp_path):
    """A service whose certificates or users are missing ends with 78 as well, instead of being started again and again."""
    for text, says in (
        ('[plant]\nzenoh = "nowhere.json5"', "nowhere.json5"),
        ('[screen]\nlisten = "127.0.0.1:0"\nusers_file = "nobody"', "nobody: cannot be read"),
        ('[screen]\nlisten = "127.0.0.1:0"\nusers_file = "plant.toml"', "line 1: "),
    ):
        (tmp_path / "plant.toml").write_text(text)
        for words in (["run", "--only-check"], ["run"]):
            asked = CliRunner().invoke(app, ["plant", *words, "--config", str(tmp_path / "plant.toml")])
            assert asked.exit_code == 78, asked.output
            assert says in asked.output


def test_a_credential_of_the_screen_is_asked_for_by_the_running_plant_alone(tmp_path):
    """The gateway's unit has none of it, nor has whoever types `plant status`."""
    (tmp_path / "plant.toml").write_text('[screen]\nproxies = ["127.0.0.1"]\nproxy_secret = "credential:proxy"\nproxy_role = "look"\n')
    load_gateway(tmp_path / "plant.toml", {})
    load_plant(tmp_path / "plant.toml", {}, database_alone=True)
    with pytest.raises(BadConfiguration, match="asks for the credential proxy"):
        load_plant(tmp_path / "plant.toml", {})


def test_a_password_comes_from_a_credential_or_the_environment_and_the_history_lies_where_the_service_may_write(tmp_path, monkeypatch):
    """Relative paths start from the file."""
    (tmp_path / "secret").write_text(f"postgresql+psycopg://u:{SECRET}@h/d\n")
    (tmp_path / "plant.toml").write_text('[plant]\ndatabase = "credential:secret"\n')
    assert SECRET in load_plant(tmp_path / "plant.toml", {"CREDENTIALS_DIRECTORY": str(tmp_path)}).database
    assert "credential secret" in refused(tmp_path, '[plant]\ndatabase = "credential:secret"\n')
    (tmp_path / "plant.toml").write_text("")
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    found = load_plant(tmp_path / "plant.toml", {"JOINT_MONITOR__PLANT__WORKERS": "7", "JOINT_MONITOR__BUS__LISTEN": "x"})
    assert found.plant.workers == 7
    assert found.database == tmp_path / "var/joint-monitor-plant/plant.sqlite"
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    assert found.database == tmp_path / "state/plant.sqlite"


def test_the_command_ends_with_78_where_the_configuration_is_wrong_and_with_2_where_an_argument_is(tmp_path):
    """systemd does not start a service again whose configuration is wrong."""
    (tmp_path / "plant.toml").write_text("[plant]\nworkers = 0\n")
    asked = CliRunner().invoke(app, ["plant", "--config", str(tmp_path / "plant.toml"), "--only-check"])
    assert asked.exit_code == 78
    assert "workers = 0" in asked.output
    (tmp_path / "plant.toml").write_text("")
    config = ["--config", str(tmp_path / "plant.toml")]
    assert CliRunner().invoke(app, ["plant", "run", *config, "--only-check"]).output.endswith("is right\n")
    for wrong in (["backup"], ["status", "file"], ["dance"]):
        assert CliRunner().invoke(app, ["plant", *wrong, *config]).exit_code != 0


def test_the_embedded_database_lies_where_the_file_says_whatever_signs_its_name_has(tmp_path):
    """A question mark would end the name of a file in an address."""
    (tmp_path / "plant.toml").write_text('[plant]\ndirectory = "Halle 3? 50 %25 #1"\n')
    database = Database(load_plant(tmp_path / "plant.toml", {}).database)
    database.migrate()
    database.close()
    assert (tmp_path / "Halle 3? 50 %25 #1/plant.sqlite").is_file()
    for path, at in (("a/b.sqlite", tmp_path / "a/b.sqlite"), (f"{tmp_path}/c.sqlite", tmp_path / "c.sqlite")):
        (tmp_path / "plant.toml").write_text(f'[plant]\ndatabase = "sqlite:///{path}"\n')
        assert load_plant(tmp_path / "plant.toml", {}).database == at  # wherever the command is typed
