"""The lives of a plant's arms: the rehearsal fleet, judged day by day by the daemon's own functions, as the documents of its monitors."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.assess import AssessSettings
from monitor.judge.drift.filter_state import RATE
from monitor.publish.documents import AckRequest, ShelveRequest
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S, Array
from monitor.studies.figures import DAYS_A_YEAR
from monitor.studies.rehearsal.fleet import Fleet, FleetSettings, Wear
from monitor.studies.rehearsal.play import JudgedDay, judged_days

WORN_SHARE = 0.2  # of the arms: one joint of each wears
PER_YEAR = 0.1, 1.5  # fraction: rates between which they are drawn
ONSET_DAYS = 10.0, 120.0
CLEARED_AFTER = 5  # replays without a tier end an alert
LONGEST_DAYS = 20_000  # of a life
CONDITION = "wear_rising"
TIERS = tuple(CONDITIONS[CONDITION].tiers)


class Figures(NamedTuple):
    """All arms after one morning, (A, J) each; float32, so that a year of 1000 arms fits into memory."""

    day: int
    replayed: np.ndarray  # (A,)
    torque_nm: Array
    torque_std_nm: Array
    wear: Array
    wear_std: Array
    rate: Array
    rate_std: Array
    temperature_c: Array
    coulomb_nm: Array
    viscous: Array


class Transition(NamedTuple):
    """One transition of the alert of one joint."""

    day: int
    joint: int  # from 1
    kind: str
    tier: str
    raised: int  # day
    change: float
    at_unix_s: float | None = None  # where a person did it; none: at the replay of the day
    by: str | None = None
    why: str | None = None


@dataclass(slots=True)
class _Alert:
    """The alert of one joint while it is active."""

    tier: int
    raised: int
    updated: int
    without: int = 0  # replays in a row without a tier
    change: float = 0.0
    said: dict[str, Any] = field(default_factory=dict)  # what people have done to it, as its document says


class Lives:
    """The arms of a plant, from a seed. Every number counts from 1: replays, changes and transitions of each arm."""

    def __init__(self, arms: int, seed: int, begin_unix_s: float, assess: AssessSettings | None = None) -> None:
        """Nothing has happened yet; `live` lets days pass. begin_unix_s : of the first day."""
        self.assess = assess or AssessSettings()
        self.arms, self.seed, self.begin_unix_s = arms, seed, begin_unix_s
        self.fleet = Fleet(FleetSettings(arms=arms, seed=seed), _wear(arms, seed))
        self.joints = self.fleet.joints
        self.figures: list[Figures] = []
        self.replays: list[list[int]] = [[] for _ in range(arms)]  # the days on which each arm replayed: the k-th is replay k + 1
        self.transitions: list[list[Transition]] = [[] for _ in range(arms)]
        self._alerts: list[dict[int, _Alert]] = [{} for _ in range(arms)]
        self._days: Iterator[JudgedDay] = judged_days(self.fleet, LONGEST_DAYS, self.assess)

    @property
    def day(self) -> int:
        """Days that have passed."""
        return len(self.figures)

    def live(self, days: int = 1) -> None:
        """Let days pass: work, a night, and the replay of the next morning."""
        for judged in (next(self._days) for _ in range(days)):
            figures = self._figures(judged)
            raises = judged.evidence.raises.reshape(self.arms, self.joints)
            for arm in np.flatnonzero(figures.replayed).tolist():
                self.replays[arm].append(figures.day)
                for joint in range(self.joints):
                    if raises[arm, joint] >= 0 or joint in self._alerts[arm]:
                        self._alert(arm, joint, int(raises[arm, joint]), figures)
            self.figures.append(figures)

    def at_unix_s(self, day: int) -> float:
        """When the replay of a day was recorded: at five in the morning."""
        return self.begin_unix_s + day * DAY_S + 5 * 3600.0

    def row(self, arm: int, replay: int, joint: int) -> dict[str, Any]:
        """One joint after one replay, as a row of `history`. joint : from 0."""
        day = self.replays[arm][replay - 1]
        of = self.figures[day]
        coulomb, viscous, torque, std = (float(each[arm, joint]) for each in (of.coulomb_nm, of.viscous, of.torque_nm, of.torque_std_nm))
        temperature = float(of.temperature_c[arm, joint])
        return {
            **{"replay": replay, "joint": joint + 1, "recorded_at": rfc3339(self.at_unix_s(day))},
            **{"coulomb_nm": coulomb, "coulomb_std_nm": 0.01 * coulomb, "viscous_nm_s_per_rad": viscous},
            **{"viscous_std_nm_s_per_rad": 0.02 * viscous, "temperature_c": temperature if np.isfinite(temperature) else None},
            **{"reference_speed_rad_s": self.fleet.settings.reference_speed_rad_s, "reference_temperature_c": 25.0},
            **{"reference_torque_nm": torque, "reference_torque_std_nm": std, "wear": float(of.wear[arm, joint])},
            **{"wear_std": float(of.wear_std[arm, joint]), "wear_rate_per_day": float(of.rate[arm, joint])},
            "wear_rate_std_per_day": float(of.rate_std[arm, joint]),
            "remaining_life": {"trend_probability": 0.0, "p10_days": None, "p50_days": None, "p90_days": None, "verdict": "not simulated"},
        }

    def change(self, arm: int, seq: int) -> dict[str, Any]:
        """One entry of the log of changes: here a replay was judged when it was recorded."""
        rows = [self.row(arm, seq, joint) for joint in range(self.joints)]
        return {"seq": seq, "replay": seq, "at": rows[0]["recorded_at"], "rows": rows}

    def event(self, arm: int, seq: int) -> dict[str, Any]:
        """One transition as it is published."""
        found = self.transitions[arm][seq - 1]
        active = found.kind != "cleared"
        at = self.at_unix_s(found.day) if found.at_unix_s is None else found.at_unix_s
        return {
            **{"seq": seq, "kind": found.kind, "at": rfc3339(at), "by": found.by, "why": found.why},
            **self._alert_document(found.joint, found.tier, found.raised, found.day, found.change),
            **{"active": active, "cleared_at": None if active else rfc3339(self.at_unix_s(found.day))},
        }

    def health(self, arm: int) -> dict[str, Any]:
        """The arm at a glance, without the times that only its publisher knows."""
        active = self._alerts[arm]
        last = self.replays[arm][-1] if self.replays[arm] else None
        stale = last is not None and self.day - 1 - last > self.assess.health.stale_days
        states = []
        for joint in range(self.joints):
            tier = TIERS[active[joint].tier] if joint in active else None
            state = CONDITIONS[CONDITION].tiers[tier].state if tier else "NORMAL"
            since = self.at_unix_s(active[joint].raised if joint in active else (self.replays[arm] or [0])[0])
            why = _text(joint + 1, active[joint].change) if joint in active else "no change"
            states.append({"joint": joint + 1, "state": state, "why": why, "since": rfc3339(since), "stale": stale})
        order = ("NORMAL", "MAINTENANCE_REQUIRED", "FAILURE")
        worst = max(states, key=lambda each: order.index(str(each["state"])))
        alerts = [
            {**self._alert_document(j + 1, TIERS[a.tier], a.raised, a.updated, a.change), **a.said} for j, a in sorted(active.items())
        ]
        return {
            **{"state": None if last is None else worst["state"], "why": worst["why"], "since": worst["since"]},
            **{"joints": states if last is not None else [], "alerts": alerts, "next_replay_due": None, "stale": stale},
        }

    def act(self, arm: int, kind: str, request: AckRequest, at_unix_s: float) -> dict[str, Any]:
        """What a person does to an alert; returns the alert after it. kind : of the transition that it makes.

        Raises BadInput without such an active alert.
        """
        alert = self._alerts[arm].get((request.joint or 0) - 1)
        if alert is None or request.condition != CONDITION:
            where = "arm" if request.joint is None else f"j{request.joint}"
            raise BadInput(f"there is no active alert {where}/{request.condition}")
        at = rfc3339(at_unix_s)
        if kind == "acknowledged":
            alert.said |= {"acknowledged_at": at, "acknowledged_by": request.by, "acknowledged_why": request.why}
        elif kind == "shelved":
            assert isinstance(request, ShelveRequest)
            until = rfc3339(at_unix_s + 3600.0 * request.hours)
            alert.said |= {"shelved_until": until, "shelved_by": request.by, "shelved_why": request.why}
        else:
            what = {"unacknowledged": "acknowledged", "unshelved": "shelved"}[kind]
            alert.said = {name: value for name, value in alert.said.items() if not name.startswith(what)}
        self._transition(arm, alert.updated, (request.joint or 0) - 1, kind, at_unix_s, request.by, request.why)
        return next(each for each in self.health(arm)["alerts"] if each["joint"] == request.joint)

    def _alert(self, arm: int, joint: int, tier: int, of: Figures) -> None:
        """The alert of a joint after a replay that gives a tier, or −1."""
        alerts, change = self._alerts[arm], float(np.expm1(of.wear[arm, joint]))
        alert = alerts.get(joint)
        if alert is None:
            alerts[joint] = _Alert(tier=tier, raised=of.day, updated=of.day, change=change)
            self._transition(arm, of.day, joint, "raised")
        elif tier < 0:
            alert.without += 1
            if alert.without >= CLEARED_AFTER:
                self._transition(arm, of.day, joint, "cleared")
                del alerts[joint]
        else:
            alert.without, alert.change = 0, change
            if tier > alert.tier:
                alert.tier, alert.updated = tier, of.day
                self._transition(arm, of.day, joint, "updated")

    def _transition(self, arm: int, day: int, joint: int, kind: str, *of_person: Any) -> None:
        alert = self._alerts[arm][joint]
        self.transitions[arm].append(Transition(day, joint + 1, kind, TIERS[alert.tier], alert.raised, alert.change, *of_person))

    def _alert_document(self, joint: int, tier: str, raised: int, updated: int, change: float) -> dict[str, Any]:
        return {
            **{"joint": joint, "condition": CONDITION, "tier": tier, "active": True, "raised_at": rfc3339(self.at_unix_s(raised))},
            **{"updated_at": rfc3339(self.at_unix_s(updated)), "change": change, "probability": 0.99, "text": _text(joint, change)},
            "action": CONDITIONS[CONDITION].tiers[tier].advice,
        }

    def _figures(self, judged: JudgedDay) -> Figures:
        state, shape = judged.result.state.filter_state, (self.arms, self.joints)
        mean, std = state.reference(np.full(state.joints, 25.0), judged.result.state.slot)
        torque, seen = np.exp(mean), judged.now.seen
        rate_std = np.sqrt(np.maximum(state.cov[:, RATE, RATE], 0.0))
        each = (torque, torque * std, state.wear, state.wear_std, state.mean[:, RATE], rate_std)
        figures = (*each, seen.temperature_c, np.nan_to_num(seen.coulomb_nm), np.nan_to_num(seen.viscous_nm_s_per_rad))
        small: list[Any] = [np.asarray(one, np.float32).reshape(shape) for one in figures]
        return Figures(judged.number, judged.now.replayed.copy(), *small)


def _text(joint: int, change: float) -> str:
    return f"Friction of joint {joint} is {100.0 * change:+.0f} % against its beginning."


def _wear(arms: int, seed: int) -> Wear:
    """One joint of some arms wears, at rates and from days of their own."""
    rng = np.random.default_rng(seed + 1)
    worn = rng.random(arms) < WORN_SHARE
    per_year = np.exp(rng.uniform(np.log(PER_YEAR[0]), np.log(PER_YEAR[1]), arms))
    return Wear(
        joint=rng.integers(0, 6, arms).astype(float),
        onset_day=np.where(worn, rng.uniform(*ONSET_DAYS, arms).round(), 1e9),
        step=np.zeros(arms),
        per_day=np.where(worn, per_year / DAYS_A_YEAR, 0.0),
    )
