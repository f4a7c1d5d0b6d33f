"""How good the predicted remaining life is, as those who predict lives state it: `python -m tests.evidence.prognosis`.

Metrics of Saxena, Celaya, Saha, Saha and Goebel, "Metrics for Offline Evaluation of Prognostic Performance", International Journal of
Prognostics and Health Management 1 (2010), to which ISO 13381-1 leaves the choice; of P50, which is what a person reads:

- prognostic horizon: how long before the end P50 comes, and from then on stays, within ± α of the whole life;
- α-λ: whether at a share λ of life P50 is within ± α of what is left;
- relative accuracy 1 − |P50 − truth|/truth at λ; cumulative: its mean over every time of asking with a date;
- convergence: distance of the centre of the area below |P50 − truth|/life from the first time of asking at no error; shares of life.

Arms begin to wear on day 60, and are asked at each twentieth of the life of their joint.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from typing import NamedTuple

import numpy as np

from monitor.judge.settings import AssessSettings
from monitor.recording import Array
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.rehearse import LifeAnswer, life_jobs

ALPHA = 0.2
ASKED_AT = tuple(np.arange(2, 20) / 20)
SHOWN_AT = (0.25, 0.5, 0.75, 0.9)  # λ
SEED = 770077  # not used while anything was chosen


class Trace(NamedTuple):
    """What one joint was predicted. K times of asking; lives are 1 long."""

    share: Array  # (K,) of life, when it was asked
    left: Array  # (K,) P50 of what is left; infinity where it is out of sight, NaN where no date was given

    @property
    def truth(self) -> Array:
        """(K,) what was left."""
        return 1.0 - self.share


def prognostic_horizon(trace: Trace, alpha: float = ALPHA) -> float:
    """Share of life before the end from which P50 stays within ± α of the whole life; 0 where it never does."""
    good = np.abs(trace.left - trace.truth) <= alpha  # NaN and infinity are not
    stays = np.logical_and.accumulate(good[::-1])[::-1]
    return float(trace.truth[np.argmax(stays)]) if stays.any() else 0.0


def alpha_lambda(trace: Trace, at: float, alpha: float = ALPHA) -> bool:
    """Whether P50 is within ± α of what is left at a share of life."""
    k = int(np.searchsorted(trace.share, at - 1e-9))
    return bool(abs(trace.left[k] / trace.truth[k] - 1.0) <= alpha)


def relative_accuracy(trace: Trace) -> Array:
    """(K,) 1 where P50 is the truth; NaN where no date was given."""
    accuracy: Array = 1.0 - np.abs(trace.left - trace.truth) / trace.truth
    return accuracy


def cumulative_relative_accuracy(trace: Trace) -> float:
    """Mean of the relative accuracy where a date was given; NaN where none ever was."""
    dated = relative_accuracy(trace)[~np.isnan(trace.left)]
    return float(dated.mean()) if dated.size else float("nan")


def convergence(trace: Trace) -> float:
    """Distance of the centre of the area below the error from the first date at no error; the smaller, the sooner it comes close.

    Errors are shares of life, and 1 where P50 is out of sight. NaN with fewer than two dates.
    """
    dated = ~np.isnan(trace.left)
    t, error = trace.share[dated], np.minimum(np.abs(trace.left - trace.truth)[dated], 1.0)
    if len(t) < 2 or not error[:-1].any():
        return float("nan")
    width, height = np.diff(t), error[:-1]
    area = (width * height).sum()
    x = 0.5 * ((t[1:] ** 2 - t[:-1] ** 2) * height).sum() / area
    y = 0.5 * (width * height**2).sum() / area
    return float(np.hypot(x - t[0], y))


def traces(answers: Sequence[LifeAnswer]) -> list[Trace]:
    """One of each arm that was asked at every share."""
    ordered = sorted(answers, key=lambda each: (each.arm, each.share))
    found = []
    for _, of_arm in groupby(ordered, key=lambda each: each.arm):
        each = list(of_arm)
        share = np.array([answer.share for answer in each])
        found.append(Trace(share, np.array([answer.ratio for answer in each]) * (1.0 - share)))
    return found


HEAD = "| path of wear | arms | horizon | α-λ at {} of life | relative accuracy | cumulative | convergence | P10–P90 holds |\n"
RULE = "|---|---|---|---|---|---|---|---|\n"


def row(path: str, groups: Sequence[Sequence[LifeAnswer]]) -> str:
    """One row of the table: medians over arms."""
    of_path = [trace for group in groups for trace in traces(group)]
    held = [answer.covered for group in groups for answer in group if answer.covered is not None]
    near = [np.mean([alpha_lambda(each, at) for each in of_path]) for at in SHOWN_AT]
    accuracy = np.array([relative_accuracy(each)[np.searchsorted(each.share, np.array(SHOWN_AT) - 1e-9)] for each in of_path])
    cells = [
        path,
        str(len(of_path)),
        f"{np.median([prognostic_horizon(each) for each in of_path]):.2f}",
        ", ".join(f"{100 * each:.0f} %" for each in near),
        ", ".join("–" if np.isnan(each).all() else f"{np.nanmedian(each):.2f}" for each in accuracy.T),
        f"{np.nanmedian([cumulative_relative_accuracy(each) for each in of_path]):.2f}",
        f"{np.nanmedian([convergence(each) for each in of_path]):.2f}",
        f"{100 * np.mean(held):.0f} % of {len(held)}",
    ]
    return "| " + " | ".join(cells) + " |\n"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence.prognosis", description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=96, help="of a straight path; half as many of each other")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--workers", type=int, help="processes; as many as there are cores")
    arguments = parser.parse_args()
    jobs = life_jobs(arguments.arms, AssessSettings(), seed=arguments.seed, base=FleetSettings(), asked_at=ASKED_AT)
    with ProcessPoolExecutor(arguments.workers) as pool:
        groups = [future.result() for future in [pool.submit(job) for job in jobs]]
    text = HEAD.format(", ".join(f"{at:g}" for at in SHOWN_AT)) + RULE
    for path in dict.fromkeys(group[0].group for group in groups):
        text += row(str(path), [group for group in groups if group[0].group == path])
    print(text, end="")


if __name__ == "__main__":
    main()
