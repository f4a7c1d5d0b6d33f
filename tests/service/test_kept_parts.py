"""What a history keeps of an identification can be read back: without a recording, another verdict is made of it."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.judge.settings import AssessSettings
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.service.history.assess_and_store import kept_parts, read_parts
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

EXCITATION = Path(__file__).parents[2] / "config/excitation/ur5-ground.json"


def test_what_is_kept_of_a_verdict_is_read_back_to_the_last_bit():
    excitation = replace(excitation_from_document(json.loads(EXCITATION.read_text("utf-8"))), repetitions=1)
    recording = stepped_replay(Controller(SimulateSettings(seed=3)), excitation)
    recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=1_700_000_000.0))
    verdict = assess(
        recording, robot=load_robot("ur5"), mounting=Mounting(), belief=None, health=None, settings=AssessSettings(), model=None
    )
    assert isinstance(verdict, Assessment)
    kept = kept_parts(verdict.identification, recording)
    read = read_parts(kept)
    assert kept_parts(read.identification, recording) == kept
    assert (read.context, read.samples, read.source) == (recording.context, recording.samples, recording.source)
    names = {field.name for field in fields(read.identification)}
    arrays = {name for name in names if isinstance(getattr(verdict.identification, name), np.ndarray)}
    left_out = {name for name in arrays if getattr(read.identification, name) is None}
    assert left_out == {"total_covariance", "misfit_cov", "paper_d"}  # what is shown of a fit beside its verdict
    for name in arrays - left_out:
        np.testing.assert_array_equal(getattr(read.identification, name), getattr(verdict.identification, name), err_msg=name)
