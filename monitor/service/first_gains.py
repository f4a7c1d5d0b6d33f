"""Joint gains for a first configuration, from the best source there is, with a sentence that says which."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from monitor.acquire.survey import published_gains, reported_gains
from monitor.errors import BadInput, RobotUnreachable
from monitor.identify.gains import gains_from_torque, payload_gains
from monitor.model.reported_gains import REPORTED_GAINS
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array
from monitor.store.identify_files import named_recordings

DIGITS = 3  # after the point: a gain is known to 1 % at best


class FirstGains(NamedTuple):
    """Joint gains [N·m/A] and their source as a sentence; no values where none were found, and then the sentence says what to do."""

    values: tuple[float, ...]
    source: str


class PayloadPair(NamedTuple):
    """Two recordings of the same program: without a mass, and with a known one at the flange."""

    empty: Path
    loaded: Path
    payload_kg: float
    com_m: tuple[float, ...] = (0.0, 0.0, 0.0)


def gains_of_pair(pair: PayloadPair, model: str, mounting: str) -> FirstGains:
    """The gains that a known payload shows; a joint on which it does not act gets the published or reported figure.

    Raises BadInput where a recording is missing or shows nothing, and where a joint stays without a gain.
    """
    robot = load_robot(model)
    empty, loaded = named_recordings([pair.empty, pair.loaded], None)
    found = payload_gains(empty, loaded, robot, Mounting.parse(mounting), pair.payload_kg, pair.com_m)
    values, source = _completed(found.values, model)
    own = np.isfinite(found.values)
    spread = ", ".join(f"{100.0 * std / value:.0f} %" for value, std in zip(found.values[own], found.std[own], strict=True))
    return FirstGains(
        values, f"from {pair.empty.name} and {pair.loaded.name}, without and with {pair.payload_kg:g} kg, each ± {spread}{source}"
    )


def gains_of_recording(path: Path, model: str) -> FirstGains:
    """The gains of a recording that holds current and torque, `actual_current` and `actual_current_as_torque`.

    Raises BadInput where it does not, and where a joint stays without a gain.
    """
    (recording,) = named_recordings([path], None)
    if recording.current is None or recording.torque is None:
        raise BadInput(
            f"{path}: expected actual_current and actual_current_as_torque of the same ticks; an e-Series tells both from 5.23 on"
        )
    gains = gains_from_torque(recording.current, recording.torque)
    if not np.any(np.isfinite(gains)):
        raise BadInput(f"{path}: on no joint is the torque a multiple of the current: it is not what the drives deliver")
    values, source = _completed(gains, model)
    return FirstGains(values, f"from {path.name}, torque beside current{source}")


def gains_of_arm(host: str, model: str) -> FirstGains | None:
    """The gains that the controller's own torques show; None where it reports none, or where they are no multiples of the currents."""
    try:
        gains = reported_gains(host)
    except RobotUnreachable:
        return None
    if gains is None or not np.all(np.isfinite(gains)):
        return None
    return FirstGains(_rounded(gains), f"of this arm: its controller tells torque beside current (actual_current_as_torque) of the {model}")


def gains_of_model(model: str) -> FirstGains:
    """Published gains need no key; else those that others have reported; else none, with what to do."""
    if published_gains(model) is not None:
        return FirstGains((), f"published for the {model}, so none are needed here")
    if (reported := REPORTED_GAINS.get(model)) is not None:
        return FirstGains(
            reported.values_nm_per_a, f"{reported.source}. Wear is a ratio and needs no better ones; N·m are as right as these figures"
        )
    return FirstGains(
        (),
        f"nobody has published them for a {model}, and without them nothing moves. Record a program of yours without and with a "
        "weighed mass (joint-monitor record), then: joint-monitor init --payload-pair EMPTY LOADED --pair-payload KG",
    )


def _completed(gains: Array, model: str) -> tuple[tuple[float, ...], str]:
    """The gains with other sources for the joints that have none, and what that adds to the sentence."""
    lacking = np.flatnonzero(~np.isfinite(gains))
    if not lacking.size:
        return _rounded(gains), ""
    joints = ", ".join(str(j + 1) for j in lacking)
    published = published_gains(model)
    if published is None and (reported := REPORTED_GAINS.get(model)) is not None:
        published = np.array(reported.values_nm_per_a)
    if published is None:
        raise BadInput(f"the gains of joints {joints} do not show, and nobody has published them for a {model}; give --gains")
    return _rounded(np.where(np.isfinite(gains), gains, published)), f"; joints {joints} as reported for the model"


def _rounded(gains: Sequence[float] | Array) -> tuple[float, ...]:
    return tuple(round(float(value), DIGITS) for value in gains)
