"""What the page of one arm shows, as a Protocol: the daemon fills it from its store, a plant from its database. With what it reads once."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.settings import HealthSettings, PrognosisSettings
from monitor.model.robot import Mounting, Robot
from monitor.reason import joint_name
from monitor.views.language.catalogue import LANGUAGES

MAX_REPLAYS = 400  # in a joint's line; more would be less than three pixels apart
NEWEST_REPLAYS = 60  # all of them are shown, as a change shows there first
EVENTS = 60  # newest transitions of alerts in the page's list
DIGITS = 5  # significant digits of a figure that becomes a pixel
SERIES = (  # fields of a friction document that the page draws
    "wear", "wear_std", "viscous_nm_s_per_rad", "temperature_c", "reference_torque_nm", "replay_torque_nm", "replay_torque_std_nm",
)  # fmt: skip


class BusAccess(Protocol):
    """What the page needs of the bus."""

    dropped: int  # documents that could not be sent

    def last_payloads(self) -> dict[str, bytes]:
        """The last value of every key, encoded as it was sent."""

    def ask(self, key: str, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """The answer to a query on a key. Raises BadInput where the query is refused."""


class PageContent(Protocol):
    """What the page of one arm shows, wherever it comes from. Methods may be called from any thread."""

    bus: BusAccess
    about: dict[str, Any]  # the robot's names, alert conditions and geometry
    language: str  # setting [page] language
    report: Callable[[str], str] | None  # the report as HTML, in the language of a code
    table: Callable[[str], str] | None  # the history as CSV
    file_name: str  # of the table, without its ending

    @property
    def now(self) -> Callable[[], float]:
        """The clock of what is shown [s since 1970]."""

    def history(self) -> dict[str, Any]:
        """The history of every joint as columns."""

    def began_unix_s(self, joint: int | None = None) -> float | None:
        """Since when friction is compared; None without a replay."""

    def newest_unix_s(self) -> float | None:
        """When the last replay was recorded; None without one."""

    def act(self, command: str, document: Mapping[str, Any]) -> Mapping[str, Any]:
        """What a person asks for. Raises BadInput where it is refused."""

    def schedule(self) -> dict[str, Any]:
        """The next windows; the last windows and transitions of alerts, newest first."""

    def monitor(self) -> dict[str, Any]:
        """The monitor's own state."""


def thinned(ids: Sequence[int], most: int, newest: int) -> list[int]:
    """About `most` of the numbers in their order: the `newest` last ones all, the others evenly spaced from the first."""
    old, new = ids[:-newest], ids[-newest:]
    every = max(1, math.ceil(len(old) / max(1, most - newest)))
    return [*old[::every], *new]


def columns(rows: Sequence[tuple[int, int, float, dict[str, Any]]]) -> dict[str, Any]:
    """Times [s since 1970], and for every joint a column of each figure; from rows (replay, joint, time, document)."""
    at: dict[int, int] = {}
    times: list[float] = []
    for replay, _, when, _ in rows:
        if replay not in at:
            at[replay] = len(times)
            times.append(round(when))
    joints: dict[int, dict[str, list[float | None]]] = {}
    for replay, joint, _, document in rows:
        own = joints.setdefault(joint, {name: [None] * len(times) for name in SERIES})
        for name in SERIES:
            value = document.get(name)
            own[name][at[replay]] = None if value is None else float(f"{value:.{DIGITS}g}")
    return {"t": times, "joints": {str(joint): joints[joint] for joint in sorted(joints)}}


# --- What the page of one arm reads once: its names, the alert levels and conditions, and the geometry of the arm ---

SHOWN = ("site", "id", "model", "mounting", "payload_kg", "tool")  # keys of [robot]


def about_arm(
    robot: Mapping[str, Any], key_prefix: str, arm: Robot, mounting: Mounting, health: HealthSettings, prognosis: PrognosisSettings
) -> dict[str, Any]:
    """The document. robot : the section [robot] of the arm's configuration."""
    return {
        "robot": {name: robot[name] for name in SHOWN},
        "key_prefix": key_prefix,
        "joints": [joint_name(j + 1) for j in range(arm.joints)],
        "languages": LANGUAGES,
        "levels": [
            {"name": "wear tier", "rise": health.wear_rise, "state": "MAINTENANCE_REQUIRED"},
            {"name": "limit", "rise": health.limit_rise, "state": "FAILURE"},
        ],
        "conditions": {
            name: {"probability_of": None if condition.change_probable is None else condition.change_probable.document()}
            for name, condition in CONDITIONS.items()
        },
        "life": {"limit_rise": prognosis.limit_rise, "service_days": prognosis.service_days},
        "arm": {
            "links": list(arm.link_names),
            "a_m": arm.a_m.tolist(),
            "d_m": arm.d_m.tolist(),
            "alpha_rad": arm.alpha_rad.tolist(),
            "zero_rad": arm.zero_rad.tolist(),
            "base": np.round(mounting.rotation @ arm.base_rotation, 12).tolist(),
            "max_torque_nm": arm.max_torque_nm.tolist(),
        },
    }
