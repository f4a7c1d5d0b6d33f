"""The past judged once more on a Dask cluster: the same to the last bit, or what would have been said otherwise."""

import hashlib
import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from command_line import ended, printed
from once import once
from simulated import copy, plant_file

from monitor import __version__
from monitor.config.files import find_excitation
from monitor.config.load import from_document
from monitor.errors import BadConfiguration, BadInput, StoreError
from monitor.judge.alerts.health import alert_document
from monitor.judge.alerts.life_cycle import acknowledge
from monitor.judge.friction.noise import NoisePriors
from monitor.plant.database import Database
from monitor.publish.queries import ServicedRequest
from monitor.service.history.assess_and_store import assess_stored, load_state, state_after
from monitor.service.history.maintenance import declare_maintenance
from monitor.service.history.recompute import recompute
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.archive.archive import Archive, key_of
from monitor.store.archive.places import ArchiveSettings
from monitor.store.formats.recordings import write_recording
from monitor.store.provenance import provenance
from monitor.store.store import Store
from monitor.studies.reassess.cluster import SchedulerLost
from monitor.studies.reassess.identify_month import (
    IDENTIFIES,
    JUDGES,
    KIND,
    Results,
    address_of,
    from_bytes,
    identify_month,
    program,
    to_bytes,
)
from monitor.studies.reassess.judge_arm import Said, changed_alerts, counts, episodes, judge_arm
from monitor.studies.reassess.plan import Arm, Files, Month, ReadAhead, Stored, arm_of, histories, read_changes
from monitor.studies.reassess.reassess import Reassessment

if find_spec("distributed") is None:  # it is imported by the tests themselves: every worker of the suite reads this module
    pytest.skip("dask is absent: it is of the extra `archive`", allow_module_level=True)

DAY_S = 86_400.0
BEGAN_S = 1_764_201_600.0  # 2025-11-27: the history is of two months
DAYS, WORN_FROM = 20, 10


@pytest.fixture(scope="module")
def lived(tmp_path_factory) -> Path:
    """Two arms with a replay a day. Joint 3 of the first one wears; a person has seen the alert, and later greased it."""
    return once(tmp_path_factory, "reassessed-plant", two_arms)


def two_arms(folder: Path) -> Path:
    """The folder with the histories of `lived`."""
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=1)
    arm = Controller(SimulateSettings(robot="ur5"))
    new = stepped_replay(arm, excitation)
    arm.arm.set_wear(2, coulomb=1.6, viscous=1.3)
    worn, rng = stepped_replay(arm, excitation), np.random.default_rng(3)
    for name, days in (("site=north/press", DAYS), ("site=south/press", 2)):
        home = folder / name
        document = {"robot": {"model": "ur5", "site": "lab", "id": "press"}, "store": {"directory": str(home)}}
        configuration = from_document(document, home / "cell.toml")
        with Store.open(home) as store:
            known = load_state(store)
            for day in range(days):
                at, wear = BEGAN_S + day * DAY_S, 0.12 * max(0, day - WORN_FROM)
                number = store.ledger.claim(at, "scheduled", at)
                context = replace(configuration.context, firmware=new.context.firmware, recorded_at_unix_s=at)
                path = store.recordings.path(number)
                current = (new.current + wear * (worn.current - new.current)) * (1.0 + 0.004 * rng.normal(size=6))
                write_recording(path, replace(new, current=current, context=context, source=path.name))
                store.ledger.mark_recorded(number)
                known = state_after(known, assess_stored(store, configuration, known, number, lambda at=at: at + 60.0))
                if day == DAYS - 3:
                    health = acknowledge(known.health, 3, "wear_rising", by="Ada", why="seen", at_unix_s=at + 3600.0)
                    alert = next(each for each in health.active_alerts if each.joint == 3)
                    event = {"kind": "acknowledged", **alert_document(alert), "by": "Ada", "why": "seen"}
                    store.events.revise(health.as_document(), [event], at + 3600.0)
                    known = replace(known, health=health)
                if day == DAYS - 2:
                    request = ServicedRequest(joint=3, kind="greased", by="Ada", why="it was due")
                    known = declare_maintenance(store, configuration, known, request, at + 7200.0).state
    return folder


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a Dask scheduler with one worker; both live in this process, and speak by TCP."""
    import distributed

    options = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(host="127.0.0.1", **options) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def results(lived: Path, scheduler: str, tmp_path_factory) -> tuple[Path, dict]:
    """The place of the results of a first reassessment of the whole plant, and its document."""
    place = tmp_path_factory.mktemp("results") / "here"
    return place, json.loads(printed("reassess", lived, "--results", place, "--scheduler", scheduler, "--json"))


def test_every_verdict_of_a_plant_comes_out_the_same_to_the_last_bit(lived: Path, results: tuple[Path, dict]):
    """As the recomputation of one arm says; with acknowledgement and work between replays. No alert is another one."""
    _, document = results
    with Store.reader(lived / "site=south" / "press") as store:
        alone = recompute(store)
    assert (alone["identical"], alone["different"], alone["changed_since"]) == (2, 0, [])
    assert document["verdicts"] == {"identical": DAYS + 2, "different": 0, "not_recomputable": 0}
    assert (document["changed_since"], document["differing"]) == ([], [])
    assert document["changed_alerts"] == []
    assert document["alerts"]["same"] >= 1
    assert [row["arm"] for row in document["by_arm"]] == ["site=north/press", "site=south/press"]
    assert document["cost"]["arm_months"] == 3
    assert document["cost"]["identify"]["recordings"] == DAYS + 2


def test_a_second_call_identifies_nothing_again(lived: Path, results: tuple[Path, dict], scheduler: str):
    """Neither by the same settings nor by other ones of the judge: the months are found where the first call has kept them."""
    place, first = results
    again = json.loads(printed("reassess", lived, "--results", place, "--scheduler", scheduler, "--json"))
    assert (again["cost"]["arm_months_found"], again["cost"]["identify"]["recordings"]) == (3, 0)
    assert {key: value for key, value in again.items() if key != "cost"} == {key: value for key, value in first.items() if key != "cost"}


def test_other_thresholds_move_alerts_and_a_picture_shows_it(lived: Path, results: tuple[Path, dict], scheduler: str, tmp_path: Path):
    """A higher one comes later or not at all, a lower one earlier. What Ada did counts where the alert is active."""
    pytest.importorskip("matplotlib")
    place, _ = results
    higher, lower = tmp_path / "higher.toml", tmp_path / "lower.toml"
    higher.write_text('[health]\nadvisory_rise = 0.5\nwear_rise = 0.6\nlimit_rise = 0.7\n[robot]\nmodel = "ur10"\n')
    lower.write_text("[health]\nadvisory_rise = 0.01\nwear_rise = 0.03\n[assess]\nmethod = 'wls'\n")
    common = ("reassess", lived, "--results", place, "--scheduler", scheduler)
    document = json.loads(printed(*common, "--settings", higher, "--pictures", tmp_path / "drawn", "--json"))
    assert document["changes"] == {"health": {"advisory_rise": 0.5, "wear_rise": 0.6, "limit_rise": 0.7}}
    assert (document["alerts"]["gone"], document["alerts"]["new"]) == (len(document["changed_alerts"]), 0)
    assert {(row["arm"], row["joint"], row["condition"]) for row in document["changed_alerts"]} >= {("site=north/press", 3, "wear_rising")}
    assert document["cost"]["identify"]["recordings"] == 0
    assert "verdicts" not in document
    assert (tmp_path / "drawn" / "site=north_press.png").read_bytes().startswith(b"\x89PNG")
    other_filter = tmp_path / "filter.toml"
    other_filter.write_text("[identify.signals]\ncutoff_hz = 7.0\n")
    south = ("reassess", lived / "site=south", *common[2:])
    anew = json.loads(printed(*south, "--settings", other_filter, "--json"))
    assert anew["cost"]["identify"]["recordings"] == 2, "what identifies has changed"
    text = printed(*common, "--settings", lower)
    assert "health.wear_rise = 0.03" in text
    assert "earlier" in text or "new" in text


def test_the_next_recording_is_fetched_while_one_is_identified(tmp_path: Path):
    """One thread reads ahead of the one that computes. What cannot be read is told in its turn, and the one after it still comes."""
    recordings = [Stored(k, str(tmp_path / f"{k}.parquet"), "", hashlib.sha256(bytes([k])).hexdigest(), 0) for k in range(3)]
    for k in (0, 2):
        (tmp_path / f"{k}.parquet").write_bytes(bytes([k]))
    files = Files(Month("press", "2025-11", (), None, tuple(recordings)))
    with ReadAhead(files, [(stored, stored.sha256) for stored in recordings]) as contents:
        assert contents.next() == bytes([0])
        with pytest.raises(BadInput, match="no recording any more"):
            contents.next()
        begin = time.monotonic()
        while files.bytes_read < 2:
            assert time.monotonic() - begin < 30.0, "the third recording is not fetched before it is asked for"
            time.sleep(0.01)
        assert contents.next() == bytes([2])
    assert files.failed == ["1: no recording any more"]


def test_a_recording_that_cannot_be_read_is_told_and_the_rest_is_judged(lived: Path, scheduler: str, tmp_path: Path):
    """One file is damaged, and another one was removed, as by retention."""
    home = tmp_path / "press"
    shutil.copytree(lived / "site=north" / "press", home)
    (home / "recordings" / "replay-000004.parquet").write_bytes(b"PAR1 and nothing else")
    (home / "recordings" / "replay-000007.parquet").unlink()
    changes = tmp_path / "other.toml"
    changes.write_text("[health]\nadvisory_rise = 0.02\n")
    result = ended("reassess", home, "--results", tmp_path / "results", "--scheduler", scheduler, "--settings", changes)
    assert result.returncode == 0, result.stderr
    assert f"{DAYS - 1} of {DAYS} replays of 1 arms judged" in result.stdout
    assert "1 replays have no recording any more, and are judged of what was identified then" in result.stdout
    assert "1 replays have no recording any more, and nothing" in result.stdout
    assert "replay 4: " in result.stdout
    assert "replay-000004.parquet: is not readable Parquet" in result.stdout
    assert "replay 7" not in result.stdout


def without(document: dict, *names: str) -> dict:
    """What two reassessments must have in common."""
    return {key: value for key, value in document.items() if key not in ("cost", "results", *names)}


def test_a_plants_database_says_what_the_folders_say_without_any_recording(
    lived: Path, results: tuple[Path, dict], scheduler: str, tmp_path: Path
):
    """With the settings of then, and with other thresholds. What would be identified otherwise cannot be judged, and is named."""
    address = f"sqlite:///{tmp_path / 'plant.sqlite'}"
    database = Database(address)
    database.migrate()
    copy(database, lived, ("site=north/press", "site=south/press"))
    database.close()
    common = ("--results", tmp_path / "results", "--scheduler", scheduler)
    of_plant = ("reassess", "--plant", plant_file(tmp_path, address), *common)
    document = json.loads(printed(*of_plant, "--json"))
    assert document["of_parts"] == DAYS + 2
    assert without(document, "of_parts") == without(results[1], "of_parts")
    assert document["cost"]["identify"]["bytes_read"] == 0
    higher, other_filter = tmp_path / "higher.toml", tmp_path / "filter.toml"
    higher.write_text("[health]\nadvisory_rise = 0.5\nwear_rise = 0.6\nlimit_rise = 0.7\n")
    other_filter.write_text("[identify.signals]\ncutoff_hz = 7.0\n")
    of_folders = json.loads(printed("reassess", lived, "--results", results[0], *common[2:], "--settings", higher, "--json"))
    changed = json.loads(printed(*of_plant, "--settings", higher, "--json"))
    assert changed["alerts"]["gone"] > 0
    assert without(changed, "of_parts") == without(of_folders, "of_parts")
    pruned = tmp_path / "pruned"
    shutil.copytree(lived, pruned, ignore=shutil.ignore_patterns("recordings"))
    assert without(json.loads(printed("reassess", pruned, *common, "--settings", higher, "--json"))) == without(changed)
    said = printed(*of_plant, "--settings", other_filter)
    assert f"{DAYS + 2} replays have no recording any more, and nothing that could be judged in its place" in said
    for history in (tmp_path / "results" / "history").rglob("*"):
        if history.is_file():
            history.chmod(0o644)
            history.unlink()
    assert f"{DAYS + 2} of {DAYS + 2} replays of 2 arms judged" in printed(*of_plant, "--settings", higher), "it is kept there once more"
    both = ended(*of_plant, lived)
    assert (both.returncode, "either folders of histories, or --plant FILE" in both.stderr) == (2, True)


def test_a_history_that_cannot_be_read_is_told_and_the_others_are_judged(lived: Path, scheduler: str, tmp_path: Path):
    """One of a plant's databases is damaged; where it is the only one, its own error is said."""
    shutil.copytree(lived / "site=north" / "press", tmp_path / "plant" / "press")
    (tmp_path / "plant" / "ill").mkdir()
    (tmp_path / "plant" / "ill" / "history.sqlite").write_bytes(b"no database" * 1000)
    result = ended("reassess", tmp_path / "plant", "--results", tmp_path / "results", "--scheduler", scheduler)
    assert result.returncode == 1
    assert f"{DAYS} of {DAYS} replays of 1 arms judged" in result.stdout
    assert "not judged: ill: " in result.stdout
    assert "file is not a database" in result.stdout
    alone = ended("reassess", tmp_path / "plant" / "ill", "--results", tmp_path / "results", "--scheduler", scheduler)
    assert (alone.returncode, "file is not a database" in alone.stderr) == (1, True)


def only_arm(place: Path) -> Arm:
    (found,) = histories([place], {})
    return arm_of(found, {})


def test_recordings_that_only_the_archive_has_are_read_there_and_compared(lived: Path, tmp_path: Path):
    """The result is that of the local file; what lies there under its name and is another recording is told."""
    home, archive = tmp_path / "press", Archive.open(ArchiveSettings(address=str(tmp_path / "archive")))
    shutil.copytree(lived / "site=south" / "press", home)
    (tmp_path / "archive").mkdir()
    with Store.open(home) as store:
        store.archived.note_place(archive.settings)
        for number, path in store.recordings.numbered():
            content = path.read_bytes()
            there = archive.put(content, key_of("lab", "press", BEGAN_S + (number - 1) * DAY_S, number, content))
            store.archived.add(number, there, BEGAN_S)
            path.unlink()
    before = only_arm(lived / "site=south")
    after = only_arm(home)
    assert all(not each.path and each.sha256 for each in after.months[0].recordings)
    (tmp_path / "results").mkdir()
    local, remote = (identify_month(arm.months[0], str(tmp_path / "results")) for arm in (before, after))
    assert remote.address == local.address, "the same recordings are the same result, wherever they are kept"
    assert remote.found
    victim = next((tmp_path / "archive").rglob("*.parquet"))
    victim.chmod(0o644)
    victim.write_bytes(b"PAR1 another recording")
    (tmp_path / "again").mkdir()
    changed = identify_month(after.months[0], str(tmp_path / "again"))
    assert changed.address != local.address, "it may come back"
    content = Results(str(tmp_path / "again")).read(KIND, changed.address)
    assert sorted(row.state for row in from_bytes(content)) == ["changed", "identified"]


def test_a_worker_that_does_not_see_the_histories_says_so_and_keeps_nothing(lived: Path, tmp_path: Path):
    """On another computer a folder may have another name: its recordings are not gone."""
    arm = only_arm(lived / "site=south")
    elsewhere = arm.months[0]._replace(recordings=tuple(each._replace(path="/nowhere/replay.parquet") for each in arm.months[0].recordings))
    with pytest.raises(StoreError, match=r"/nowhere: a worker does not find it; expected histories where all workers reach them"):
        identify_month(elsewhere, str(tmp_path))
    with pytest.raises(StoreError, match="a worker does not find it"):
        judge_arm(arm._replace(history="/nowhere"), ["0"], {}, str(tmp_path))
    assert not list(tmp_path.iterdir())


def test_an_identified_month_is_kept_to_the_last_bit(lived: Path, tmp_path: Path):
    """What is read back writes the same bytes; NaN and the reasons of ripple included."""
    arm = only_arm(lived / "site=south")
    address = identify_month(arm.months[0], str(tmp_path)).address
    content = Results(str(tmp_path)).read(KIND, address)
    rows = from_bytes(content)
    assert rows[0].identification.covariance.shape == (len(rows[0].identification.names),) * 2
    assert from_bytes(to_bytes(rows))[1].identification.ripple.why == rows[1].identification.ripple.why
    assert to_bytes(rows) == content


def test_a_result_of_another_number_of_threads_is_another_result(monkeypatch):
    """Its last digits are others: a cluster with several threads leaves nothing that a call with one thread would find."""
    found = set()
    for threads in ("1", "2"):
        monkeypatch.setattr(
            "monitor.studies.reassess.identify_month.provenance", lambda threads=threads: {**provenance(), "threads": threads}
        )
        found |= {address_of(program.__wrapped__(parts)) for parts in (IDENTIFIES, JUDGES)}
    assert len(found) == 4


def test_a_replay_that_comes_meanwhile_is_left_for_the_next_call(lived: Path, results: tuple[Path, dict]):
    """The daemon has judged one more after the months were listed: neither it nor its alerts are missed."""
    arm = only_arm(lived / "site=north")
    first, last = arm.months
    shorter = arm._replace(months=(first, last._replace(recordings=last.recordings[:-1])))
    addresses = [identify_month(month, str(results[0])).address for month in shorter.months]
    document = judge_arm(shorter, addresses, {}, str(results[0])).document
    assert (document["replays"], document["verdicts"]["identical"]) == (DAYS - 1, DAYS - 1)
    assert {row["change"] for row in document["alerts"]} == {"same"}


def test_a_fleets_prior_is_tried_on_the_past_of_the_models_that_it_has(lived: Path, results: tuple[Path, dict], tmp_path: Path):
    """The file stands beside the settings. Its figures for this arm's model travel to the workers; an empty name means no prior."""
    joint = {"slope_per_k": 0.01, "slope_std_per_k": 0.01, "curve_per_k2": 0.0, "curve_std_per_k2": 1e-4, "lag": 0.0, "lag_std": 0.1}
    kinds = len(NoisePriors().kinds)
    own = {"arms": 40, "noise": {"std": 0.02, "weights": [1.0 / kinds] * kinds}, "joints": [joint] * 6}
    document = {"format": "joint-monitor/prior", "version": 2, "reference_speed_rad_s": 0.4, "models": {}}
    path = tmp_path / "prior.json"
    path.write_text(json.dumps(document | {"models": {"ur5": own}}))
    (tmp_path / "with.toml").write_text('[drift]\nprior = "prior.json"\n')
    changes = read_changes(tmp_path / "with.toml")
    (found,) = histories([lived / "site=south"], changes)
    arm = arm_of(found, changes)
    assert (arm.changes["drift"]["prior"]["model"], arm.changes["drift"]["prior"]["arms"]) == ("ur5", 40)
    months = [identify_month(month, str(results[0])) for month in arm.months]
    assert all(month.found for month in months), "what identifies has not changed"
    assert judge_arm(arm, [month.address for month in months], arm.changes, str(results[0])).document["judged"] == 2
    (tmp_path / "without.toml").write_text('[drift]\nprior = ""\n')
    assert arm_of(found, read_changes(tmp_path / "without.toml")).changes["drift"]["prior"] is None
    path.write_text(json.dumps(document))
    with pytest.raises(BadInput, match=r"press: .*holds no prior of a ur5; it holds none"):
        histories([lived / "site=south"], changes)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[helth]\nx = 1\n", r"\[helth\]: unknown section"),
        ("[health]\nwear_rise = 'much'\n", "health.wear_rise = 'much'"),
        ("[robot]\nmodel = 'ur5'\n", "changes nothing that a verdict depends on"),
        ("[health\n", "not TOML"),
    ],
)
def test_settings_that_cannot_be_tried_are_refused_by_name(tmp_path: Path, text: str, wrong: str):
    """Before anything is computed."""
    path = tmp_path / "other.toml"
    path.write_text(text)
    with pytest.raises((BadConfiguration, BadInput), match=wrong):
        read_changes(path)


@pytest.mark.flaky(reruns=1)  # Dask's own count of connections may fail its assertion while a client before it still closes
def test_a_cluster_that_does_not_fit_is_refused_in_a_sentence(lived: Path, scheduler: str, tmp_path: Path, monkeypatch):
    """No scheduler, an address that is none, workers of another Python, of another version, or that do not reach the results."""
    import distributed

    def refused(address: str, *words: str) -> str:
        result = ended("reassess", lived, "--results", tmp_path / "results", "--scheduler", address, *words)
        assert result.returncode == 2, result.stderr
        return result.stderr

    with monkeypatch.context() as patch:
        patch.setattr("monitor.studies.reassess.cluster.CONNECT_S", 0.5)
        assert "no Dask scheduler answers" in refused("tcp://127.0.0.1:9")
        assert "no Dask scheduler answers" in refused("ftp://127.0.0.1:9")
    (tmp_path / "twisted.toml").write_text("[health]\nadvisory_rise = 0.06\n")
    assert "do not fit those of the history: health: expected 0 < adv" in refused(scheduler, "--settings", str(tmp_path / "twisted.toml"))
    assert "expected one of them" in refused(scheduler, "--workers", "2")
    with monkeypatch.context() as patch:
        patch.setattr("monitor.studies.reassess.cluster.program", lambda _: {"joint_monitor": "0.1.0"})
        assert f"runs another program: joint_monitor: {__version__}, now 0.1.0 here" in refused(scheduler)
    with monkeypatch.context() as patch:
        patch.setattr("monitor.studies.reassess.cluster.probe_found", lambda *_: False)
        assert "does not reach --results" in refused(scheduler)
    versions = distributed.Client.get_versions

    def older(client, check):
        found = versions(client, check=check)
        for worker in found["workers"].values():
            worker["host"] = [("python", "3.9.1.final.0")]
        return found

    with monkeypatch.context() as patch:
        patch.setattr("distributed.Client.get_versions", older)
        assert "runs Python 3.9, this is 3." in refused(scheduler)


def test_places_without_a_history_are_refused(tmp_path: Path):
    """An empty folder, no folder, and a file that is no arm's."""
    (tmp_path / "notes.txt").write_text("x")
    for place, wrong in ((tmp_path, "holds no history"), (tmp_path / "none", "no such folder"), (tmp_path / "notes.txt", "is a file")):
        result = ended("reassess", place, "--results", tmp_path / "results")
        assert (result.returncode, wrong in result.stderr) == (2, True)


def said(condition: str, tier: str, raised: float, at: float, cleared: float | None = None) -> Said:
    return Said("raised", 3, condition, tier, raised * DAY_S, at * DAY_S, None if cleared is None else cleared * DAY_S)


def test_alerts_of_then_and_now_are_compared_tier_by_tier():
    """The same alert is the one that overlaps in time; tiers that are reached sooner, later, no more or in addition are named."""
    then = [said("wear_rising", "advisory", 10, 10), said("wear_rising", "wear", 10, 20, 30), said("wear_rising", "advisory", 50, 50)]
    now = [said("wear_rising", "advisory", 8, 8), said("wear_rising", "wear", 8, 22), said("wear_rising", "limit", 8, 40)]
    rows = changed_alerts(episodes(then), episodes([*now, said("outliers", "advisory", 5, 5), said("stale", "advisory", 1, 1)]))
    found = [(row["condition"], row["tier"], row["change"], row["days"]) for row in rows]
    assert found == [
        ("outliers", "advisory", "new", None),
        ("wear_rising", "advisory", "earlier", -2.0),
        ("wear_rising", "wear", "later", 2.0),
        ("wear_rising", "limit", "new", None),
        ("wear_rising", "advisory", "gone", None),
    ]
    assert changed_alerts(episodes(then), [], {50 * DAY_S})[-1]["change"] == "unknown", "that replay cannot be judged any more"
    assert counts(rows) == {"earlier": 1, "later": 1, "gone": 1, "new": 2, "unknown": 0, "same": 0}


def test_a_cluster_that_loses_every_worker_is_not_waited_for(lived: Path, tmp_path: Path, monkeypatch):
    """Nobody would ever know: the command ends, and says what is kept."""
    import distributed

    monkeypatch.setattr("monitor.studies.reassess.reassess.LOOK_S", 0.05)
    monkeypatch.setattr("monitor.studies.reassess.reassess.ALONE_S", 0.2)
    options = {"n_workers": 0, "processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(host="127.0.0.1", **options) as cluster, distributed.Client(cluster, set_as_default=False) as client:
        again = Reassessment(client, str(tmp_path), {}, lambda *_: None)
        with pytest.raises(SchedulerLost, match="every worker went away; 0 arm-months and 0 arms are kept"):
            again.run(histories([lived / "site=south"], {}))
        refused = ended("reassess", lived, "--results", tmp_path / "results", "--scheduler", cluster.scheduler_address)
    assert (refused.returncode, "has no worker; start some with `dask worker tcp://" in refused.stderr) == (2, True)
