"""Arms that nobody hears, and a plant's service that does not run: neither can say so, so the gateway does. No I/O, no clock."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from monitor.config.notify import PLANT_SILENT
from monitor.gateway.outbox import Owed
from monitor.gateway.values import CLEARED, ENDED, PLANT, RAISED, Delivery, Transition, transition_id
from monitor.plant.arm import UNKNOWN_SILENCE, ArmName, HeardArm
from monitor.publish.documents import Alert, worded
from monitor.publish.timestamps import utc
from monitor.reason import Reason, Sentence

CONDITION = "monitor_silent"
TIER = "advisory"
SILENCES = "silence"  # under this name the outbox keeps which silences are told
HEARD_AGAIN = Sentence("monitor_heard_again", "The monitor of this arm is heard again.")()
NOT_HEARD = Sentence("monitor_not_heard", "Nobody hears the monitor of this arm: {why}.")
LOOK_AT_MONITOR = Sentence(
    "look_at_monitor",
    "Look at the computer of this arm's monitor, and at the network between it and the plant: until it is heard, wear goes unnoticed.",
)()
PLANT_RUNS = Sentence("plant_runs_again", "The plant's service runs again.")()
PLANT_STANDS = Sentence("plant_does_not_run", "The plant's service does not run.")()
LOOK_AT_PLANT = Sentence(
    "look_at_plant", "Look at the service joint-monitor-plant: until it runs, nobody follows the arms and no alert gets through."
)()


class Silence(NamedTuple):
    """A silence that began to be worth telling, or ended."""

    transition: Transition
    begins: Delivery | None  # what is kept of it while it lasts
    ends: tuple[int, ...]  # what was kept of it


class ArmsWatch:
    """Which arms nobody hears. The plant dates a silence by its own clock, and this one has another: each counts by itself."""

    def __init__(self, silent_s: float) -> None:
        """`silent_s` : after which it is told; 0: never."""
        self._silent_s = silent_s
        self._seen_unix_s: dict[ArmName, float] = {}  # since when we have seen that an arm is silent

    def look(self, arms: Mapping[ArmName, HeardArm], said_unix_s: float | None, told: Sequence[Owed], now_unix_s: float) -> list[Silence]:
        """What has changed. said_unix_s : as of `PlantWatch`. told : silences that are told and not over."""
        seen = {name: self._seen_unix_s.get(name, now_unix_s) for name, arm in arms.items() if arm.silent_since_unix_s is not None}
        self._seen_unix_s = seen
        plant_unix_s = now_unix_s if said_unix_s is None else said_unix_s
        silent = [
            name
            for name, since in seen.items()
            if self._silent_s <= max(now_unix_s - since, plant_unix_s - (arms[name].silent_since_unix_s or 0.0))
        ]
        return _changed(arms, told, silent if self._silent_s else (), now_unix_s)


def _changed(arms: Mapping[ArmName, HeardArm], told: Sequence[Owed], silent: Collection[ArmName], now_unix_s: float) -> list[Silence]:
    known = {each.robot: each for each in told}
    found = []
    for name, arm in arms.items():
        since, before = arm.silent_since_unix_s, known.get(str(name))
        if since is None and before is not None:
            began = float(before.document["since_unix_s"])
            ended = _transition(name, CONDITION, began, now_unix_s, HEARD_AGAIN, over=True)
            found.append(Silence(ended, None, (before.id,)))
        elif since is not None and before is None and name in silent:
            text = NOT_HEARD(why=arm.silent_why or UNKNOWN_SILENCE)
            kept = Delivery(key=f"{name}/{since:.3f}", recipient="", kind="silence", document={"since_unix_s": since}, robot=str(name))
            found.append(Silence(_transition(name, CONDITION, since, now_unix_s, text, over=False), kept, ()))
    return found


class PlantWatch:
    """Whether the plant's service runs: it says so every few seconds. How its clock goes does not matter, only that its word changes."""

    def __init__(self, silent_s: float) -> None:
        """`silent_s` : after which it is told; 0: never."""
        self._silent_s = silent_s
        self._said_unix_s: float | None = None
        self._since_unix_s: float | None = None  # since when its word is this one, as we have seen it
        self._looked_unix_s = 0.0

    def look(self, said_unix_s: float | None, told: Sequence[Owed], now_unix_s: float) -> list[Silence]:
        """What has changed: at most one. said_unix_s : the service's newest word, by its own clock; None: it has never run."""
        slept = not 0.0 <= now_unix_s - self._looked_unix_s < self._silent_s  # or our clock was set: we do not know what it said
        if self._since_unix_s is None or said_unix_s != self._said_unix_s or slept:
            self._said_unix_s, self._since_unix_s = said_unix_s, now_unix_s
        self._looked_unix_s = now_unix_s
        before = next((each for each in told if each.kind == PLANT_SILENT), None)
        if before is not None and said_unix_s != before.document["said_unix_s"]:
            began = float(before.document["since_unix_s"])
            ended = _transition(PLANT, PLANT_SILENT, began, now_unix_s, PLANT_RUNS, over=True)
            return [Silence(ended, None, (before.id,))]
        since = self._since_unix_s
        if before is None and said_unix_s is not None and 0.0 < self._silent_s <= now_unix_s - since:
            document = {"since_unix_s": since, "said_unix_s": said_unix_s}
            kept = Delivery(key=f"{PLANT_SILENT}/{since:.3f}", recipient="", kind=PLANT_SILENT, document=document)
            begun = _transition(PLANT, PLANT_SILENT, since, now_unix_s, PLANT_STANDS, over=False)
            return [Silence(begun, kept, ())]
        return []

    def rest(self) -> None:
        """The database was away, and with it what the service says."""
        self._since_unix_s = None


def _transition(name: ArmName, condition: str, since_unix_s: float, now_unix_s: float, text: Reason, *, over: bool) -> Transition:
    action = None if over else LOOK_AT_PLANT if condition == PLANT_SILENT else LOOK_AT_MONITOR
    kind = CLEARED if over else RAISED
    alert = Alert(
        joint=None,
        condition=condition,
        tier=TIER,
        active=not over,
        raised_at=utc(since_unix_s),
        updated_at=utc(now_unix_s),
        cleared_at=utc(now_unix_s) if over else None,
        change=0.0,
        probability=1.0,
        **worded(text=text, action=action or ""),
    )
    return Transition(
        id=transition_id(name, None, condition, kind, TIER, since_unix_s),
        arm=name,
        joint=None,
        condition=condition,
        before=TIER if over else ENDED,
        after=ENDED if over else TIER,
        kind=kind,
        at_unix_s=now_unix_s,
        raised_at_unix_s=since_unix_s,
        alert=alert,
    )
