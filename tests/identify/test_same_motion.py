"""Recordings of one motion are known by the motion itself, and those of another are told from them."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.errors import BadInput
from monitor.identify.signals.same_motion import of_one_trajectory, with_motions
from monitor.model.robot import load_robot
from monitor.recording import Context, Recording
from monitor.store.from_files.series import Series, assess_series, spaced

W = 2.0 * np.pi * np.array([0.1, 0.2, 0.3, 0.2, 0.1, 0.4])


def made(seconds=30.0, rate_hz=100.0, seed=0, start_s=0.0, scale=1.0, slow=1.0, wait_s=0.0, shift=0.0):
    """A recording with encoder noise; `start_s` of it are lost at the beginning, and the arm waits before it moves."""
    rng = np.random.default_rng(seed)
    t = np.arange(start_s - wait_s, seconds, 1.0 / rate_hz) + 0.0037 * seed
    u = np.maximum(t, 0.0) / slow
    ramp = np.minimum(1.0, u / 2.0)[:, None]  # an excitation that is not periodic from its first sample on
    q = scale * ramp * np.sin(np.outer(u, W)) * [1.0, 0.6, 0.8, 0.5, 0.9, 1.1] + shift * np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    qd = np.gradient(q, t, axis=0)
    return Recording(
        t_s=100.0 * seed + t,
        q=q + 2e-5 * rng.normal(size=q.shape),
        qd=qd + 1e-3 * rng.normal(size=q.shape),
        current=2.0 * np.sign(qd) + qd + 0.04 * rng.normal(size=q.shape),
        source=f"{seed}.csv",
    )


def digests(*recordings):
    return [recording.context.trajectory_digest for recording in with_motions(recordings)]


@pytest.mark.parametrize(
    "other",
    [
        {},
        {"start_s": 1.7},
        {"seconds": 26.0},
        {"rate_hz": 25.0},
        {"rate_hz": 500.0},
        {"wait_s": 4.0},
        {"start_s": 1.0, "seconds": 28.3, "rate_hz": 40.0},
    ],
    ids=str,
)
def test_a_replay_has_the_fingerprint_of_the_first(other):
    one, two = digests(made(seed=1), made(seed=2, **other))
    assert one == two is not None


@pytest.mark.parametrize(
    "other",
    [{"scale": 0.9}, {"scale": 1.1}, {"seconds": 15.0}, {"slow": 1.1}, {"slow": 0.9}, {"shift": 0.2}, {"seconds": 60.0}],
    ids=str,
)
def test_another_motion_has_another_fingerprint(other):
    one, two, again = digests(made(seed=1), made(seed=2, **other), made(seed=3))
    assert one != two
    assert one == again


def test_a_recording_that_names_its_trajectory_keeps_the_name_and_lends_it_to_the_same_motion():
    named = replace(made(seed=1), context=Context(trajectory_digest="abc"))
    assert digests(named, made(seed=2), made(seed=3, scale=0.8))[:2] == ["abc", "abc"]
    assert digests(made(seed=2), named)[1] == "abc"


def test_a_recording_that_cannot_be_used_stays_as_it_is():
    still = replace(made(seed=1), qd=np.zeros((3000, 6)), q=np.zeros((3000, 6)))
    assert digests(still, made(seed=2))[0] is None


def test_a_trajectory_that_was_stopped_early_is_compared_over_what_is_shared():
    """Under the name that is given, from the same beginning, whenever the arm began to move and however long it went on."""
    whole, waited, stopped = made(seed=1), made(seed=2, wait_s=4.0), made(seed=3, seconds=12.0)
    found = of_one_trajectory([whole, waited, stopped], "evening")
    assert {one.context.trajectory_digest for one in found} == {"motion-evening"}
    assert [one.duration_s for one in found] == pytest.approx([found[2].duration_s] * 3, abs=0.1)
    assert 11.0 < found[2].duration_s <= 12.0
    for one in found:  # at the same time after the beginning the arm is at the same place
        at = [np.interp(5.0, one.t_s - one.t_s[0], column) for column in one.q.T]
        assert at == pytest.approx([np.interp(5.0, found[0].t_s - found[0].t_s[0], column) for column in found[0].q.T], abs=0.1)


def test_another_motion_is_not_of_the_trajectory():
    """Whoever says so is told which file is another one."""
    with pytest.raises(BadInput, match=r"2.csv: is not of the trajectory 'evening'"):
        of_one_trajectory([made(seed=1), made(seed=2, shift=0.5)], "evening")


def test_four_runs_of_a_real_evening_are_one_context(real_data):
    """A UR3 that was stopped early three times: its verdicts have one baseline with `--trajectory`."""
    folder = real_data / "arms" / "ur3_brasilia"
    if not folder.exists():
        pytest.skip(f"{folder} is not here")
    files = sorted(folder.glob("*traj1*.csv"))
    series = Series(entries=spaced(files, "1h"), robot=load_robot("ur3"), trajectory="traj1")
    document = assess_series(series)
    assert [row["verdict"] for row in document["recordings"]] == ["assessed"] * 4
    assert len(document["contexts"]) == 1
