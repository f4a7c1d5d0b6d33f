"""A recording written by a process of its own, or here where that one ends: nothing of a motion is lost. I/O."""

import logging
from pathlib import Path

from monitor.recording import Recording
from monitor.service.processes.apart import Compute, ComputingFailed
from monitor.store.formats.recordings import write_recording

log = logging.getLogger(__name__)


def written_apart(compute: Compute, path: Path, recording: Recording) -> None:
    """Write a recording. Raises StoreError where the disk refuses."""
    try:
        compute(write_recording, path, recording)
    except ComputingFailed as error:
        log.warning("%s is written here: %s", path.name, error)
        write_recording(path, recording)
