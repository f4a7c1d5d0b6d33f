"""A temperature is sought until a replay was made at it, and again a week later: friction there may be another by then."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.config.load import load
from monitor.model.fourier import excitation_from_document
from monitor.publish.compensation import SOUGHT_AGAIN_DAYS
from monitor.recording import DAY_S
from monitor.service.daemon import Daemon
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store

EXCITATION = Path(__file__).parents[2] / "config/excitation/ur5-ground.json"
NOON = 1.78e9


@pytest.mark.slow
def test_a_temperature_is_sought_again_a_week_after_the_last_replay_at_it(tmp_path: Path, free_port: int) -> None:
    """The history of a daemon decides, not what it remembers: another one, started later, says the same."""
    excitation = replace(excitation_from_document(json.loads(EXCITATION.read_text("utf-8"))), repetitions=1)
    recording = stepped_replay(Controller(SimulateSettings(seed=3)), excitation)
    recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=NOON))
    (tmp_path / "cell.toml").write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    configuration, clock = load(tmp_path / "cell.toml"), [NOON]
    with Store.open(configuration.state_directory) as store:
        with Daemon(configuration, store, now=lambda: clock[0], play=lambda *_: recording) as daemon:
            assert daemon.monitor.missing_row([40.0] * 6) is None, "before the first replay the clock alone decides"
            row = daemon.monitor.perform(NOON, closes_unix_s=NOON + 60.0)
            assert row is not None
            assert row.state == "assessed"
        here = [each["temperature_c"] for each in store.assessments.friction()]
        with Daemon(configuration, store, now=lambda: clock[0], play=lambda *_: recording) as daemon:
            assert daemon.monitor.missing_row([45.0] * 6) == 9
            assert daemon.monitor.missing_row(here) is None
            clock[0] = NOON + (SOUGHT_AGAIN_DAYS - 1.0) * DAY_S
            assert daemon.monitor.missing_row(here) is None
            clock[0] = NOON + (SOUGHT_AGAIN_DAYS + 1.0) * DAY_S
            assert daemon.monitor.missing_row(here) == round(float(np.median(here)) / 5.0)
