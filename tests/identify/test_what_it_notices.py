"""The table of faults in the documentation: every code in it exists in the program and is told in a test, and the other way round."""

import re
from pathlib import Path

from monitor.identify.detectors import DETECTORS
from monitor.identify.signals.motion import Motion
from monitor.identify.signals.units import Repaired

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/identification.md").read_text("utf-8")
TABLE = PAGE.split("## What it notices")[1].split("## ")[0]
ROOMS = (ROOT / "monitor/identify", ROOT / "monitor/store/formats")  # what a reader of files tells is told with the rest
SIGNALS = "\n".join(path.read_text("utf-8") for room in ROOMS for path in sorted(room.rglob("*.py")))
TESTS = "\n".join(path.read_text("utf-8") for path in sorted((ROOT / "tests").rglob("test_*.py")) if path.name != Path(__file__).name)


def test_every_code_in_the_table_is_said_by_the_program_and_held_by_a_test():
    """A row that nobody tests would be a promise without proof."""
    codes = set(re.findall(r"`([a-z]+(?:_[a-z]+)*)`", TABLE))
    assert len(codes) > 20
    assert {code for code in codes if f'"{code}"' not in SIGNALS} == set()
    assert {code for code in codes if f'"{code}"' not in TESTS and f"'{code}'" not in TESTS} == set()


def test_every_detector_of_a_recordings_units_and_signals_is_in_the_table():
    """What the program corrects or doubts in a recording has a row, but for what a reader asked for or reads in the same report."""
    plain = {"repaired_spikes", "current_is_target", "low_rate", "payload", "temperature_drift"}
    said = {sentence.code for detector in DETECTORS if detector.looks_at in (Repaired, Motion) for sentence in detector.sentences}
    assert said - set(re.findall(r"`([a-z_]+)`", TABLE)) == plain


def test_each_warning_of_a_recording_is_said_by_one_detector():
    """So a reader finds what says it."""
    codes = [sentence.code for detector in DETECTORS for sentence in detector.sentences]
    assert sorted(set(codes)) == sorted(set(codes) | {"gain_doubtful"})
    assert len(codes) == len(set(codes)) + 1  # a gain is doubted by sizes, and by the joints beside it
