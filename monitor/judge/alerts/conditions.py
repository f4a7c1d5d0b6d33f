"""The alert conditions. A further condition is one more record in `CONDITIONS`: its rules, state, texts and advice stand in it.

A replay cannot raise the conditions of the monitor itself (nothing moves, nothing is learnt, the arm is not heard, the history was
restored), because they say that there is none. The service looks at them between replays: see `ServiceSituation`.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from monitor.judge.alerts.condition import (
    AlertCondition,
    AlertTier,
    ArmSituation,
    ConditionStatus,
    Headlines,
    JointSituation,
    Rule,
    ServiceSituation,
    Standing,
    repeated,
    two_replays,
)
from monitor.judge.alerts.evidence import joint_rise_beside, noisier, ripple_rise, shift_beside
from monitor.judge.alerts.health import CHECK_FUNCTION, FAILURE, MAINTENANCE_REQUIRED, NORMAL, OFF_SPEC, TIERS, Confirmations
from monitor.judge.belief import Belief
from monitor.judge.drift.step import UNRESOLVED
from monitor.judge.drift.undeclared import GAINS, MOUNTING, PAYLOAD
from monitor.judge.friction.noise import Kind
from monitor.judge.friction.step import FrictionModel
from monitor.judge.temperature.stuck import all_held_still
from monitor.reason import Reason, Sentence, parts_of, together
from monitor.recording import DAY_S

STORE_RESTORED = "store_restored"
STOPPED, STALE, UNHEARD = "stopped", "stale", "unheard"
REFUSED_WINDOWS, REFUSED_DAYS = 3, 1.0  # so many windows in a row, over so long, are no working day of the cell
NOTHING_MOVES = Sentence("nothing_moves", "Nothing moves since {since_unix_s:time}: {why}. It waits for a person.")
REFUSED = Sentence(
    "every_window_refused", "Nothing moves since {since_unix_s:time}: every window since then was refused; the last one: {why}."
)
OUT_OF_DATE = Sentence(
    "nothing_learnt", "Nothing was learnt of this arm since {since_unix_s:time}: what is known of its joints is of then, not of now."
)
LAST_WINDOW = Sentence("last_window", "The last window: {why}.")
REPLAY_DUE = Sentence("replay_due", "A replay is due since {since_unix_s:time}, {why}.")
NOT_HEARD = Sentence("not_heard", "The arm is not heard since {since_unix_s:time}.")
NOT_HEARD_WHY = Sentence("not_heard_why", "The arm is not heard since {since_unix_s:time}: {why}.")
NO_REASON = Sentence("no_reason", "no reason is known")()


def _stopped(situation: ServiceSituation) -> Reason | None:
    """A stop waits for a person; or every window is refused, so that nothing will move by itself either."""
    if situation.stop is not None:
        return NOTHING_MOVES(since_unix_s=situation.stop.since_unix_s, why=situation.stop.reason or NO_REASON)
    refused = situation.refused
    if refused is None or refused.windows < REFUSED_WINDOWS or situation.now_unix_s - refused.since_unix_s < REFUSED_DAYS * DAY_S:
        return None
    return REFUSED(since_unix_s=refused.since_unix_s, why=refused.reason or NO_REASON)


def _stale(situation: ServiceSituation) -> Reason | None:
    learnt = situation.unlearnt
    if learnt is None or not _over(learnt, situation):
        return None
    last = LAST_WINDOW(why=learnt.reason) if learnt.reason else None
    if situation.due is not None:
        last = REPLAY_DUE(since_unix_s=situation.due.since_unix_s, why=situation.due.reason or NO_REASON)
    return together(OUT_OF_DATE(since_unix_s=learnt.since_unix_s), last)


def _unheard(situation: ServiceSituation) -> Reason | None:
    heard = situation.unheard
    if heard is None or not _over(heard, situation):
        return None
    since = heard.since_unix_s
    return NOT_HEARD_WHY(since_unix_s=since, why=heard.reason) if heard.reason else NOT_HEARD(since_unix_s=since)


def _over(standing: Standing, situation: ServiceSituation) -> bool:
    """Whether it has lasted for longer than it may."""
    return standing.until_unix_s is not None and situation.now_unix_s >= standing.until_unix_s


SERVICE_CONDITIONS = (
    AlertCondition(
        name=STORE_RESTORED,
        headlines=Headlines(arm="The monitor's history was damaged, and a backup has taken its place."),
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look at the disk, and at what set-aside file and backups say; then acknowledge this.",
                "the history was damaged and the newest good backup replaced it, or it lost its newest entries",
            )
        },
    ),
    AlertCondition(
        name=STOPPED,
        headlines=Headlines(arm="Nothing moves, and nothing will until a person has put it right."),
        service=_stopped,
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look at the arm and at the reason (joint-monitor check); put it right, or allow motion (joint-monitor allow). "
                "Until the arm replays again, wear goes unnoticed.",
                "a stop waits for a person; or every window was refused, three or more in a row over a day or longer",
            )
        },
    ),
    AlertCondition(
        name=STALE,
        headlines=Headlines(arm="What the monitor knows of this arm is out of date."),
        service=_stale,
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look why the last windows failed (joint-monitor status): until one succeeds, wear goes unnoticed.",
                "no replay was learned from for schedule.learn_within_days: as it is shipped, for three windows and two days",
            )
        },
    ),
    AlertCondition(
        name=UNHEARD,
        headlines=Headlines(arm="The monitor does not hear the arm."),
        service=_unheard,
        tiers={
            "advisory": AlertTier(
                CHECK_FUNCTION,
                "Look whether the arm is switched on, and at its cable and address (joint-monitor check).",
                "the arm did not answer for schedule.heard_within_days: as it is shipped, for two windows and a day",
            )
        },
    ),
)


# --- The alert conditions --------------------------------------------------------------------------------

WEAR_RISING, SUDDEN_STEP = "wear_rising", "sudden_step"
FALLING = "friction_falling"
CURRENT_NOISE = "current_noise"
GEAR_RIPPLE = "gear_ripple"
RISES = (WEAR_RISING, SUDDEN_STEP)  # of one joint's friction: at most one of them is active
SCATTER_RATIO = 2.5  # of replays to the scatter that the filter expects: beyond it a joint's data are unreliable
RATIO_RESTATED = 0.22  # [log] by which the noise of a current has changed when its alert says so
LOADED = (1, 2)  # shoulder and elbow (from 0), which carry what the flange does
MOSTLY_LOAD = 1.5  # times the median joint's change, in shoulder and elbow: then a payload is likelier than a supply
HAS_RISEN = "has risen by more than the tier's rise"


# --- friction of one joint ----------------------------------------------------------------------------------


def _kind_of_rise(situation: JointSituation) -> str:
    """The condition of a joint's risen friction: the active one; else a step where most of the wear came as one.

    What friction at the reference speed does not show is wear: nobody can tell by the other channels whether it came at once.
    """
    belief, j = situation.belief, situation.j
    for condition in RISES:
        alert = situation.arm.alerts.get((j + 1, condition))
        if alert is not None and alert.active:
            return condition
    evidence = situation.arm.evidence
    if joint_rise_beside(evidence.beside, evidence.wear, j).found:
        return WEAR_RISING
    return SUDDEN_STEP if belief.found(j).at_once > 0.5 else WEAR_RISING


def _rising(name: str, situation: JointSituation, _: Confirmations) -> ConditionStatus | None:
    """Friction of one joint above the lowest that it surely held.

    None where its rise is the other one of `RISES`, or nothing was learnt of the joint.
    """
    if name != _kind_of_rise(situation) or not situation.heard:
        return None
    j, evidence, settings = situation.j, situation.arm.evidence, situation.settings
    beside = joint_rise_beside(evidence.beside, evidence.wear, j)
    change = math.expm1(max(evidence.wear[j], beside.rise))
    return ConditionStatus(
        raise_tier=int(evidence.raises[j]) if evidence.raises[j] >= 0 else None,
        hold_tier=max((k for k in range(3) if change >= settings.clear_fraction * settings.rises[k]), default=None),
        change=change,
        probabilities=np.maximum(evidence.above[j], beside.above(settings)),
        text=partial(beside.text, j, partial(_friction_text, situation), situation.belief.residual_peak_rad),
        attribution=situation.attribution,
        lowest_at_unix_s=_lowest_at_unix_s(situation.belief, j),
    )


def _falling(situation: JointSituation, _: Confirmations) -> ConditionStatus | None:
    """Friction of one joint below that of the beginning, running-in left out; None where nothing was learnt of it."""
    if not situation.heard:
        return None
    j, evidence, settings = situation.j, situation.arm.evidence, situation.settings
    change = math.expm1(evidence.fall[j])
    return ConditionStatus(
        raise_tier=0 if evidence.falls[j] else None,
        hold_tier=0 if change <= -settings.clear_fraction * settings.wear_rise else None,
        change=change,
        probabilities=evidence.below[[j, j, j]],
        text=partial(_friction_text, situation, since_beginning=True),
        attribution=situation.attribution,
    )


FRICTION_CHANGED = Sentence(
    "friction_changed",
    "{joint:joint}: friction at {speed_rad_s:g} rad/s and {temperature_c:.1f} °C went from {before_nm:.2f} to {now_nm:.2f} N·m "
    "({change:+z.1%} ± {std:.1%}), temperature taken out (it falls by {slope:.2%}/K).",
)
FRICTION_ABOVE_LOWEST = Sentence(
    "friction_above_lowest",
    "{joint:joint}: friction at {speed_rad_s:g} rad/s and {temperature_c:.1f} °C went from {before_nm:.2f} to {now_nm:.2f} N·m "
    "({change:+z.1%} ± {std:.1%} above the lowest level held, {fallen:+z.1%} from the beginning, reached by {lowest_at_unix_s:day}), "
    "temperature taken out (it falls by {slope:.2%}/K).",
)
FOUND_BY = Sentence(
    "change_found",
    "When this was found, chance alone shows as much in a sound joint once in {odds:.0f} days at most ({needed:.0f} are asked for); it had "
    "begun {began_days:.0f} ± {began_std:.0f} days before, {sort:word} ({probability:.0%}).",
)
NOISE_KINDS = {  # what the likeliest kind of noise does
    "short": Sentence("noise_short", "of one day telling nothing of the next"),
    "days": Sentence("noise_days", "alike for days (correlation {rho:.2f} a day)"),
    "weather": Sentence("noise_weather", "as strong as season and weather make it"),
    "wandering": Sentence("noise_wandering", "wandering for months"),
    "yearly": Sentence("noise_yearly", "swinging with the year"),
}
NOISE_BELIEVED = Sentence("noise_believed", "noise between replays is believed to be ± {std:.1%}, {kind} ({probability:.0%})")
CAUSES = Sentence(
    "causes_of_change",
    "Of the measured {whole:+z.1%}, temperature makes {temperature:+z.1%}, payload and context {payload:+z.1%}, wear {wear:+z.1%}, "
    "chance {rest:+z.1%}.",
)


SHORT = 0.1  # correlation of one day and the next by which the one tells nothing of the other


def noise_reason(belief: Belief, model: FrictionModel, j: int) -> Reason:
    """What noise of a joint (from 0) is believed to be, as a clause."""
    p = belief.friction.of_joints(belief.friction.p)[:, j]
    names = [_name_of(kind) for kind in model.noise.kinds]
    name = max(dict.fromkeys(names), key=lambda one: sum(p[h] for h, of in enumerate(names) if of == one))
    probability = sum(p[h] for h, of in enumerate(names) if of == name)
    rho = float(p @ model.noise.column("from_day_to_day")[:, 0])
    kind = NOISE_KINDS[name](rho=rho) if name == "days" else NOISE_KINDS[name]()
    return NOISE_BELIEVED(std=belief.noise_std(model)[j], kind=kind, probability=probability)


def _name_of(kind: Kind) -> str:
    if math.isfinite(kind.period_days):
        return "yearly"
    if kind.lasts:
        return "wandering"
    if kind.arm_steady_replays < kind.steady_replays:
        return "weather"
    return "days" if kind.from_day_to_day > SHORT else "short"


def _friction_text(situation: JointSituation, *, since_beginning: bool = False) -> Reason:
    """Friction before and after, how its change was found, and the causes of the change.

    since_beginning : whether before is the beginning, as for a fall, and not the lowest level held, as for a rise.
    """
    belief, j, causes = situation.belief, situation.j, situation.attribution
    evidence = situation.arm.evidence
    change, std = (each[j] for each in ((evidence.fall, evidence.fall_std) if since_beginning else (evidence.wear, evidence.wear_std)))
    now, std = float(belief.level()[j] + evidence.wear[j]), math.exp(change) * float(std)
    figures = {
        **{"joint": j + 1, "speed_rad_s": belief.reference_speed_rad_s, "temperature_c": belief.reference_temperature_c[j]},
        **{
            "before_nm": math.exp(now - change),
            "now_nm": math.exp(now),
            "change": math.expm1(change),
            "std": std,
            "slope": belief.slope[j],
        },
    }
    lowest_at = None if since_beginning else _lowest_at_unix_s(belief, j)
    if lowest_at is None:
        text = FRICTION_CHANGED(**figures)
    else:
        fallen = math.expm1(evidence.fall[j] - evidence.wear[j])
        text = FRICTION_ABOVE_LOWEST(**figures, fallen=fallen, lowest_at_unix_s=lowest_at)
    of_causes = None if causes is None else CAUSES(**{name: math.expm1(part) for name, part in causes._asdict().items()})
    return together(text, _found_text(belief, j), of_causes)


def _found_text(belief: Belief, j: int) -> Reason | None:
    """How the joint's last change was found; None where none was."""
    found = belief.found(j)
    if not found.odds:
        return None
    at_once = found.at_once > 0.5
    return FOUND_BY(
        odds=found.odds,
        needed=found.needed,
        began_days=found.began_days,
        began_std=found.began_std,
        sort="all at once" if at_once else "little by little",
        probability=found.at_once if at_once else 1.0 - found.at_once,
    )


def _lowest_at_unix_s(belief: Belief, j: int) -> float | None:
    """When the level was reached from which a rise counts; None where that is the level at the beginning."""
    held_days = belief.friction.of_joints(belief.friction.held_days)[j]
    return float(belief.at_unix_s - held_days * DAY_S) if math.isfinite(held_days) else None


# --- friction of most joints together -----------------------------------------------------------------------


def _common_mode(situation: ArmSituation, _: Confirmations) -> ConditionStatus | None:
    """Friction that rose, or fell, in most joints together; None where nothing was learnt of most, or no temperature is known."""
    if _temperatures_stand_still(situation) or 2 * np.count_nonzero(situation.belief.learnt_from) < situation.belief.joints:
        return None
    evidence, settings = situation.evidence, situation.settings
    common, std = float(evidence.common[0]), max(float(evidence.common_std[0]), 1e-9)
    change = math.expm1(common)
    rose, fell = change >= settings.clear_fraction * settings.advisory_rise, change <= -settings.clear_fraction * settings.wear_rise
    beyond = common - math.log1p(settings.advisory_rise) if change >= 0 else math.log1p(-settings.wear_rise) - common
    return ConditionStatus(
        raise_tier=0 if evidence.together[0] else None,
        hold_tier=0 if rose or fell else None,
        change=change,
        probabilities=np.full(3, float(scipy.special.ndtr(beyond / std))),
        text=partial(_common_text, change, situation),
    )


COMMON = {  # by whether friction rose, and whether shoulder and elbow changed most
    (True, False): Sentence(
        "common_rise", "Friction has risen in most joints together, by about {change:+z.1%}: not the wear of one joint."
    ),
    (False, False): Sentence(
        "common_fall", "Friction has fallen in most joints together, by about {change:+z.1%}: not the grease of one joint."
    ),
    (True, True): Sentence(
        "common_rise_of_loaded",
        "Friction has risen in shoulder and elbow most, as an undeclared payload makes it, by about {change:+z.1%}: "
        "not the wear of one joint.",
    ),
    (False, True): Sentence(
        "common_fall_of_loaded",
        "Friction has fallen in shoulder and elbow most, as an undeclared payload makes it, by about {change:+z.1%}: "
        "not the grease of one joint.",
    ),
}


def _common_text(change: float, situation: ArmSituation) -> Reason:
    shared = situation.belief.friction.of_joints(situation.belief.friction.shared)
    most = np.argsort(-np.abs(shared))[: len(LOADED)]
    load = len(shared) > max(LOADED) and set(most) == set(LOADED) and np.abs(shared[most]).min() > MOSTLY_LOAD * np.median(np.abs(shared))
    return COMMON[change >= 0, bool(load)](change=change)


# --- data and declarations ----------------------------------------------------------------------------------


def _lacks_temperature(situation: JointSituation) -> bool | None:
    """The joint's temperature is unknown, and that of another joint is known; without any, the arm's condition is another one."""
    T = situation.belief.temperature_c
    return not math.isfinite(T[situation.j]) if np.isfinite(T).any() else None


def _arm_lacks_temperature(situation: ArmSituation) -> bool:
    together = bool(situation.evidence.together[0]) and _temperatures_stand_still(situation)
    return together or not np.isfinite(situation.belief.temperature_c).any()


def _temperatures_stand_still(situation: ArmSituation) -> bool:
    """Whether no joint's sensor moves: what most joints do together is then what their sensors do not tell."""
    sensors = situation.belief.sensors
    return sensors is not None and all_held_still(sensors)


def _noisier(situation: JointSituation) -> bool | None:
    """The joint's current is noisier than it was; None where nothing was learnt of it."""
    return bool(noisier(situation.belief.drift_state)[situation.j]) if situation.heard else None


def _rippling(situation: JointSituation) -> bool | None:
    """The ripple of the joint's gear has risen; None where nothing was learnt of it."""
    return bool(ripple_rise(situation.belief.drift_state).found[situation.j]) if situation.heard else None


def _ripple_text(situation: JointSituation, confirmations: Confirmations) -> Reason:
    rise, j = ripple_rise(situation.belief.drift_state), situation.j
    shares = {"before": float(rise.before[j]), "now": float(rise.now[j])}
    return RIPPLES(joint=j + 1, cycles=int(rise.cycles[j]), replays=confirmations.replays, **shares)


def _noise_text(situation: JointSituation, confirmations: Confirmations) -> Reason:
    return NOISIER(joint=situation.j + 1, ratio=_noise_ratio(situation), replays=confirmations.replays)


def _noise_ratio(situation: JointSituation) -> float:
    """Of the noise of the joint's current to that of before."""
    return math.exp(shift_beside(situation.belief.drift_state, "noise")[0][situation.j])


def _noise_status(situation: JointSituation, confirmations: Confirmations) -> ConditionStatus | None:
    """As any condition that repeats; an alert that was raised by the first few replays says a better ratio later."""
    status = REPEATED_NOISE.status(situation, confirmations)
    alert = situation.arm.alerts.get((situation.j + 1, CURRENT_NOISE))
    if status is None or alert is None or not alert.active or not confirmations.replays:
        return status
    said = [part.parameters["ratio"] for part in parts_of(alert.text) if part.code == NOISIER.code]
    same = bool(said) and isinstance(said[0], float) and abs(math.log(_noise_ratio(situation) / said[0])) <= RATIO_RESTATED
    return status._replace(restated=not same)


def _unreliable(situation: JointSituation) -> bool | None:
    """The replay does not resolve the joint's friction, or replays scatter.

    An undeclared change of the arm is another condition, and nothing is learnt from its replay: it cannot tell.
    """
    belief, j = situation.belief, situation.j
    if situation.arm.undeclared.withheld:
        return None
    return bool(belief.event[j] == UNRESOLVED or belief.consistency[j] > SCATTER_RATIO)


def outside_learnt_range(situation: JointSituation) -> bool | None:
    """The joint's temperature is outside the temperatures learned so far, and learning has ended; None where it is not known."""
    belief, j = situation.belief, situation.j
    if not math.isfinite(belief.temperature_c[j]):
        return None
    return bool(not belief.inside_range[j] and belief.replays > situation.settings.learning_replays)


NO_TEMPERATURE = Sentence(
    "no_temperature", "{joint:joint} tells no temperature, or none that can be believed, in {replays} replays in a row."
)
NO_TEMPERATURES = Sentence(
    "no_temperatures",
    "No joint tells a temperature that can be believed, in {replays} replays in a row: of wear nothing is told until one does.",
)
NOISIER = Sentence(
    "current_noisier",
    "The current of {joint:joint} is {ratio:.1f} times as noisy as before, in {replays} replays in a row. Noise alone is no wear.",
)
REPEATED_NOISE = repeated(_noisier, _noise_text)
RIPPLES = Sentence(
    "gear_ripples",
    "The current of {joint:joint} ripples with its motor, {cycles} × a turn: {now:.0%} of friction, {before:.0%} before, "
    "in {replays} replays in a row.",
)
NOT_RESOLVED = Sentence(
    "not_resolved", "{joint:joint} is not resolved, or scatters more than the filter believes, in {replays} replays in a row."
)
NEW_TEMPERATURE = Sentence(
    "new_temperature", "{joint:joint} at {temperature_c:.1f} °C is outside the temperatures learnt so far, in {replays} replays in a row."
)


def _undeclared(name: str) -> Rule[ArmSituation]:
    """An undeclared change of one kind. Two replays that show it suffice: each of them contradicts the declaration by itself."""

    def shows(situation: ArmSituation) -> bool | None:
        """Only one change is found in a replay: one of another kind says nothing about this one."""
        found = situation.undeclared.condition
        return found == name if found in (None, name) else None

    two = repeated(shows, lambda situation, _: situation.undeclared.reason, two_replays)

    def status(situation: ArmSituation, confirmations: Confirmations) -> ConditionStatus | None:
        """An alert that is raised already says it when wear is judged again."""
        of_two = two.status(situation, confirmations)
        return None if of_two is None else of_two._replace(restated=situation.undeclared.begins)

    return replace(two, status=status)


# --- the records --------------------------------------------------------------------------------------------

CONDITIONS: dict[str, AlertCondition] = {
    condition.name: condition
    for condition in (
        AlertCondition(
            name=WEAR_RISING,
            headlines=Headlines(joint="{joint:name} turns {rise} heavier than {since}."),
            joint=Rule(partial(_rising, WEAR_RISING), raises=TIERS),
            probability_of=HAS_RISEN,
            tiers={
                "advisory": AlertTier(
                    NORMAL, "Nothing yet: watch this joint.", "friction rose beyond what chance shows, most likely by 2 % or more"
                ),
                "wear": AlertTier(
                    MAINTENANCE_REQUIRED,
                    "Plan an inspection of this joint: lubrication, backlash, noise.",
                    "friction rose by 5 % or more, with a probability of 0.95",
                ),
                "limit": AlertTier(
                    FAILURE,
                    "Replace or overhaul this joint: friction has reached the configured limit.",
                    "friction rose by 30 % or more, with a probability of 0.95",
                ),
            },
        ),
        AlertCondition(
            name=SUDDEN_STEP,
            headlines=Headlines(joint="{joint:name} all at once turns {rise} heavier than {since}."),
            joint=Rule(partial(_rising, SUDDEN_STEP), raises=TIERS),
            probability_of=HAS_RISEN,
            tiers={
                "advisory": AlertTier(
                    NORMAL,
                    "Ask what happened that day: a collision, a service, another load that was not declared.",
                    "friction rose beyond what chance shows, most likely by 2 % or more, and most of it at once",
                ),
                "wear": AlertTier(
                    MAINTENANCE_REQUIRED,
                    "Inspect this joint soon: friction does not jump by itself. Look for a collision, a brake that drags, a seal.",
                    "friction rose by 5 % or more, most of it at once",
                ),
                "limit": AlertTier(
                    FAILURE,
                    "Stop using this joint until it is inspected: friction jumped beyond the configured limit.",
                    "friction rose by 30 % or more, most of it at once",
                ),
            },
        ),
        AlertCondition(
            name=FALLING,
            headlines=Headlines(joint="{joint:name} turns {rise} lighter than {since}."),
            joint=Rule(_falling),
            probability_of="has fallen by more than the wear tier's rise",
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Tell the monitor if the joint was greased or replaced; otherwise check its brake, current and temperature.",
                    "friction fell by 5 % or more",
                )
            },
        ),
        AlertCondition(
            name="common_mode",
            headlines=Headlines(
                arm="Most joints turn {rise} heavier than {since}, all together.",
                arm_fallen="Most joints turn {rise} lighter than {since}, all together.",
            ),
            arm=Rule(_common_mode),
            probability_of=HAS_RISEN,
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Check what all joints share: temperature sensors, supply voltage, payload and mounting as configured.",
                    "friction of most joints rose together, or fell together by 5 % or more",
                )
            },
        ),
        AlertCondition(
            name=GAINS,
            headlines=Headlines(arm="Torque and current no longer fit together, and nobody has declared a new drive."),
            arm=_undeclared(GAINS),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Was a drive replaced or recalibrated? Then declare it (another tool, serial or gains); nothing is learnt of wear "
                    "until then, or until 20 replays agree.",
                    "the torque per ampere of a joint changed, undeclared",
                )
            },
        ),
        AlertCondition(
            name=MOUNTING,
            headlines=Headlines(arm="The arm stands otherwise than the monitor was told."),
            arm=_undeclared(MOUNTING),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Compare [robot] mounting with how the arm stands; nothing is learnt of wear until they agree.",
                    "gravity points elsewhere than configured",
                )
            },
        ),
        AlertCondition(
            name=PAYLOAD,
            headlines=Headlines(arm="The arm carries another load than the monitor was told."),
            arm=_undeclared(PAYLOAD),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Compare [robot] payload_kg with what the arm carries in the replay; nothing is learnt of wear until they agree, "
                    "or until 20 replays have weighed the same.",
                    "the arm carries another mass than before, undeclared",
                )
            },
        ),
        AlertCondition(
            name="temperature_sensor",
            headlines=Headlines(
                joint="{joint:name} reports no temperature that can be believed.",
                arm="No joint reports a temperature that can be believed.",
            ),
            joint=repeated(_lacks_temperature, NO_TEMPERATURE),
            arm=repeated(_arm_lacks_temperature, NO_TEMPERATURES),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Check the temperature reading: without it, or with a wrong one, cold looks like wear.",
                    "three replays in a row without a temperature, or with one that stands still though the others move or it used to",
                )
            },
        ),
        AlertCondition(
            name=CURRENT_NOISE,
            headlines=Headlines(joint="The current of {joint:name} has become noisy."),
            joint=Rule(_noise_status, _noisier),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Look at the cable, the connectors, the encoder and the drive of this joint: nothing says that it is worn.",
                    "the current of a joint is twice as noisy as before or more, beyond the other joints, in three replays in a row",
                )
            },
        ),
        AlertCondition(
            name=GEAR_RIPPLE,
            headlines=Headlines(joint="The current of {joint:name} ripples more with each turn of its motor."),
            joint=repeated(_rippling, _ripple_text),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Listen to this joint, and look at its gear and the encoder of its motor: friction alone does not show them.",
                    "gear ripple plus 3 % of friction doubled or more, beyond the other joints, in three replays in a row",
                )
            },
        ),
        AlertCondition(
            name="data_quality",
            headlines=Headlines(joint="The last replays do not show how heavily {joint:name} turns."),
            joint=repeated(_unreliable, NOT_RESOLVED),
            tiers={
                "advisory": AlertTier(
                    CHECK_FUNCTION,
                    "Look at the last recordings: torn rows, lost packets, a trajectory that does not move this joint.",
                    "three replays in a row in which friction was not resolved",
                )
            },
        ),
        AlertCondition(
            name="outside_range",
            headlines=Headlines(joint="{joint:name} works at temperatures that are new to the monitor."),
            joint=repeated(outside_learnt_range, NEW_TEMPERATURE),
            tiers={
                "advisory": AlertTier(
                    OFF_SPEC,
                    "Nothing to repair: the monitor has not seen these temperatures yet; replays at them will teach it.",
                    "three replays in a row outside the temperatures learned so far",
                )
            },
        ),
        *SERVICE_CONDITIONS,
    )
}
