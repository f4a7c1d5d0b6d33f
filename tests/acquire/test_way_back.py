"""An arm that was stopped on its trajectory, in real time: the next motion brings it back over the way it came, and everything goes on."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short
from simulated_arm import simulated_arm

from monitor.acquire.watch import Caller
from monitor.config.load import load
from monitor.errors import ReplayAborted
from monitor.model.fourier import Excitation
from monitor.service.motion import move
from monitor.simulate.remote import Remote
from monitor.store.store import Store

pytestmark = pytest.mark.real_time

FAR = short(period_s=5.0, amplitude_rad=1.2)
HOME = FAR.at(np.zeros(1)).q[0] + 0.05


class Arm:
    """A monitor of one simulated arm; each motion is one of a process that has just started."""

    def __init__(self, host: str, folder: Path) -> None:
        self.host, self.phases = host, []
        (folder / "cell.toml").write_text(
            f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\nhost = "{host}"\npayload_kg = 0.0\n[store]\ndirectory = "history"\n'
            '[replay]\nallow_motion = true\nfirst_pass = false\ncell = "unchecked"\nmax_approach_rad = 0.8\napproach_speed_rad_s = 1.2\n'
        )
        self.configuration = replace(load(folder / "cell.toml"), excitation=FAR)

    def move(self, stop_in: str = "", after_s: float = 0.0) -> ReplayAborted | None:
        """One motion, stopped on request in a phase where one is named, and the next where a busy machine ended it; how the last ended."""
        for _ in range(4):
            ended = self._move_once(stop_in, after_s)
            if ended is None or ended.cause not in {"late", "timeout", "stalled", "no_control"}:
                break
        return ended

    def _move_once(self, stop_in: str, after_s: float) -> ReplayAborted | None:
        self.phases.clear()
        at = [("", 0.0)]

        def on_progress(progress):
            at[0] = (progress.phase, progress.elapsed_s)
            self.phases.append(progress.phase)

        with Store.open(self.configuration.state_directory) as store:
            try:
                move(
                    self.configuration,
                    store,
                    FAR,
                    self.configuration.context,
                    caller=Caller(should_stop=lambda: at[0][0] == stop_in and at[0][1] > after_s, on_progress=on_progress),
                    first_pass_path=self.configuration.state_directory / "first.parquet",
                )
            except ReplayAborted as error:
                return error
        return None

    @property
    def q(self) -> np.ndarray:
        with Remote(self.host) as remote:
            return np.array(remote.truth()["q"])


def curve_of(excitation: Excitation) -> np.ndarray:
    return excitation.at(np.linspace(0.0, excitation.pass_s, 4001)).q


def test_an_arm_that_was_stopped_on_its_trajectory_is_brought_back_and_rests_where_it_began(tmp_path):
    """Stopped in the play, stopped again on its way back, then brought back, replayed, and returned to where the first motion began."""
    home = ",".join(str(angle) for angle in HOME)
    with simulated_arm("127.0.2.27", f"--home={home}") as host:
        arm = Arm(host, tmp_path)
        stopped = arm.move(stop_in="play", after_s=3.0)
        assert stopped is not None
        assert stopped.cause == "parent_asked_to_stop", stopped
        left = arm.q
        assert np.max(np.abs(left - HOME)) > 0.8  # too far to begin from there
        assert not stopped.needs_a_person
        again = arm.move(stop_in="way_back", after_s=1.0)
        assert again is not None
        assert again.cause == "parent_asked_to_stop", again
        assert np.max(np.abs(arm.q - left)) > 0.02
        assert np.min(np.max(np.abs(curve_of(FAR) - arm.q), axis=1)) < 0.01  # on its path
        assert arm.move() is None
        assert {"way_back", "play", "return"} <= set(arm.phases)
        assert "approach" not in arm.phases
        time.sleep(0.2)
        assert np.max(np.abs(arm.q - HOME)) < 0.005
        after_all = arm.move(stop_in="play", after_s=0.2)
        assert after_all is not None
        assert after_all.cause == "parent_asked_to_stop", after_all
        assert "play" in arm.phases
        assert "way_back" not in arm.phases
