"""Recordings of the simulated UR5 as files, made once for all tests of the commands."""

from dataclasses import replace
from pathlib import Path

import pytest

from monitor.config.files import find_excitation
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording


@pytest.fixture(scope="session")
def replayed(tmp_path_factory):
    """One replay of the simulated UR5 without payload as a file, and the controller that played it."""
    controller = Controller(SimulateSettings(robot="ur5"))
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=2)
    path = tmp_path_factory.mktemp("replay") / "replay.parquet"
    write_recording(path, stepped_replay(controller, excitation))
    return path, controller


@pytest.fixture(scope="session")
def pair(tmp_path_factory):
    """Two replays of the same simulated arm as files: without payload, and with 3 kg at the flange."""
    folder, excitation = tmp_path_factory.mktemp("pair"), replace(find_excitation("ur5-ground", Path()), repetitions=2)
    paths = []
    for name, payload_kg in (("empty", 0.0), ("loaded", 3.0)):
        paths.append(folder / f"{name}.parquet")
        write_recording(paths[-1], stepped_replay(Controller(SimulateSettings(robot="ur5", payload_kg=payload_kg)), excitation))
    return paths
