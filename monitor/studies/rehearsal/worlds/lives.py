"""What the judge says of remaining life in joints whose wear follows a path to the limit, asked at shares of the true life."""

from typing import Any, NamedTuple

import numpy as np

from monitor.judge.alerts.remaining_life import RemainingLife, remaining_life_of_joint
from monitor.judge.assess import AssessSettings
from monitor.recording import known_or_none
from monitor.studies.figures import Share, share_document
from monitor.studies.rehearsal.play import JudgedDay
from monitor.studies.rehearsal.remaining_life import ALPHA, ASKED_AT
from monitor.studies.rehearsal.worlds.fleet import WorldFleet


class LifeAnswer(NamedTuple):
    """One joint's prediction, and the truth."""

    group: int  # number of the kind of wear
    share: float  # of life, when it was asked
    predicted: RemainingLife
    true_days: float


class Lives:
    """Asks every arm whose wear has a life at each of `ASKED_AT`, on the first replay from then on."""

    def __init__(self, fleet: WorldFleet, assess: AssessSettings) -> None:
        self.answers: list[LifeAnswer] = []
        self._fleet, self._assess = fleet, assess
        has_life = np.array([wear.life_years is not None for wear in fleet.world.wear] or [False])
        lives = (fleet.group >= 0) & has_life[fleet.group]
        self._open = np.repeat(lives[:, None], len(ASKED_AT), axis=1)  # (A, 2)

    def add(self, judged: JudgedDay) -> None:
        """One more day."""
        fleet = self._fleet
        due = judged.day >= fleet.onset_day[:, None] + np.array(ASKED_AT) * fleet.unit_days[:, None]
        for arm, k in np.argwhere(self._open & due & judged.now.replayed[:, None]).tolist():
            self._open[arm, k] = False
            joint = arm * fleet.joints + int(np.argmax(fleet.worn[arm]))
            left = fleet.onset_day[arm] + fleet.unit_days[arm] - judged.day
            predicted = remaining_life_of_joint(judged.result.state, joint, self._assess.drift, self._assess.prognosis)
            self.answers.append(LifeAnswer(int(fleet.group[arm]), ASKED_AT[k], predicted, float(left)))


def life_documents(answers: list[LifeAnswer], group: int) -> list[dict[str, Any]]:
    """For each share of life: how often P10–P90 held the truth, P50 was near, the median of P50 over the truth, and no date was given."""
    rows = []
    for share in ASKED_AT:
        asked = [each for each in answers if each.group == group and each.share == share]
        dated = [each for each in asked if each.predicted.p10_days is not None]
        if not asked:
            continue
        ratios = [np.inf if each.predicted.p50_days is None else each.predicted.p50_days / each.true_days for each in dated]
        held = [_holds(each) for each in dated]
        rows.append(
            {
                "at_share_of_life": share,
                "asked": len(asked),
                "without_date": len(asked) - len(dated),
                "p10_p90_holds": share_document(Share(hits=sum(held), of=len(held))),
                "p50_near": share_document(Share(hits=sum(abs(ratio - 1.0) <= ALPHA for ratio in ratios), of=len(asked))),
                "p50_over_truth": known_or_none(float(np.median(ratios))) if ratios else None,
            }
        )
    return rows


def _holds(answer: LifeAnswer) -> bool:
    """Whether P10–P90 holds the truth; a bound that is not given is beyond every date."""
    early, late = answer.predicted.p10_days, answer.predicted.p90_days
    return early is not None and early <= answer.true_days <= (np.inf if late is None else late)
