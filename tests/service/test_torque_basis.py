"""What the history gives to the torque band of the next motion: the latest model and replays, as long as they are of the same load."""

from dataclasses import replace
from pathlib import Path

import pytest
from excitations import short

from monitor.config.files import find_excitation
from monitor.config.load import load
from monitor.judge.assess import assess
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context, Recording
from monitor.service.torque_basis import torque_basis
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording
from monitor.store.store import Store

EXCITATION = replace(find_excitation("ur5-ground", Path()), repetitions=1)
CONTEXT = Context(payload_kg=0.0, mounting_rad=(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def seen() -> list[tuple[Recording, dict]]:
    """Two replays of one simulated arm, each with the model after it."""
    arm, found, last = Controller(SimulateSettings()), [], None
    for day in (0, 1):
        recording = stepped_replay(arm, EXCITATION)
        recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=1.75e9 + day * 86_400.0))
        known = {} if last is None else {"model": last.model}
        belief, health = (None, None) if last is None else (last.belief, last.health)
        last = assess(recording, robot=load_robot("ur5"), mounting=Mounting(), belief=belief, health=health, **known)
        found.append((recording, last.model.as_document()))
    return found


@pytest.fixture
def configuration(tmp_path: Path):
    (tmp_path / "cell.toml").write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n')
    return load(tmp_path / "cell.toml")


def stored(store: Store, recording: Recording, model: dict, day: int) -> int:
    ledger_id = store.ledger.claim(day * 86_400.0, "scheduled", day * 86_400.0)
    assert ledger_id is not None
    write_recording(store.recordings.path(ledger_id), recording)
    store.ledger.mark_recorded(ledger_id)
    values = {"at_unix_s": 10.0, "recorded_at_unix_s": 5.0, "assessment": {}, "friction": [], "belief": {}, "health": {}, "events": []}
    store.assessments.commit(ledger_id, model=model, **values)
    return ledger_id


def test_the_first_motion_has_nothing_and_later_ones_model_and_profile(configuration, seen):
    """A pruned or damaged recording is left out; without any, nothing says of which load the model is."""
    with Store.open(configuration.state_directory) as store:
        assert torque_basis(store, configuration, EXCITATION, CONTEXT).model is None
        ids = [stored(store, *each, day) for day, each in enumerate(seen, start=1)]
        basis = torque_basis(store, configuration, EXCITATION, CONTEXT)
        assert (basis.model["revision"], basis.profile.replays, basis.payload_kg) == (2, 2, 0.0)
        store.recordings.path(ids[1]).write_bytes(b"PAR1")
        assert torque_basis(store, configuration, EXCITATION, CONTEXT).profile.replays == 1
        store.recordings.path(ids[0]).unlink()
        assert torque_basis(store, configuration, EXCITATION, CONTEXT).description == "the manufacturer's parameters"


@pytest.mark.parametrize(
    "changes", [{"payload_kg": 1.0}, {"tool": "gripper"}, {"mounting_rad": (0.1, 0.0, 0.0)}], ids=["payload", "tool", "mounting"]
)
def test_after_a_change_of_load_what_was_learnt_is_not_used(configuration, seen, changes):
    """Also not for the first ordinary replay after the first pass with the new load: the model is still the old one."""
    with Store.open(configuration.state_directory) as store:
        stored(store, *seen[0], 1)
        context = replace(CONTEXT, **changes)
        store.first_passes.add("digest", {"payload_kg": context.payload_kg}, 2 * 86_400.0)
        basis = torque_basis(store, configuration, EXCITATION, context)
        assert (basis.model, basis.profile, basis.payload_kg) == (None, None, None)


def test_another_trajectory_has_the_model_and_no_profile(configuration, seen):
    """So has the slow first pass along the same path."""
    with Store.open(configuration.state_directory) as store:
        stored(store, *seen[0], 1)
        for other in (short(), replace(EXCITATION, time_scale=0.25)):
            basis = torque_basis(store, configuration, other, CONTEXT)
            assert basis.model is not None
            assert basis.profile is None


def test_a_history_whose_model_cannot_be_read_gives_the_manufacturers_band(configuration, seen):
    """The motion is no less safe for it, only its band is wider."""
    with Store.open(configuration.state_directory) as store:
        stored(store, seen[0][0], {"m": 1}, 1)
        assert torque_basis(store, configuration, EXCITATION, CONTEXT).model is None


def test_a_payload_that_is_not_configured_goes_with_the_model(configuration, seen):
    """The streaming process compares it with the payload that the controller reports then."""
    carried = replace(seen[0][0], context=replace(seen[0][0].context, payload_kg=1.5))
    with Store.open(configuration.state_directory) as store:
        stored(store, carried, seen[0][1], 1)
        assert torque_basis(store, configuration, EXCITATION, replace(CONTEXT, payload_kg=None)).payload_kg == 1.5


def test_long_recordings_do_not_delay_the_motion(configuration, seen, monkeypatch):
    """The newest recording counts in any case, earlier ones while there are few rows."""
    monkeypatch.setattr("monitor.service.torque_basis.PROFILE_ROWS", 2000)
    with Store.open(configuration.state_directory) as store:
        for day, each in enumerate(seen, start=1):
            stored(store, *each, day)
        assert torque_basis(store, configuration, EXCITATION, CONTEXT).profile.replays == 1
