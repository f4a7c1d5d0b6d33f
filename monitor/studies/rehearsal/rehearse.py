"""Would these thresholds detect wear, and how many false alerts would they raise? Every figure of a simulated fleet, as one document."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from monitor.judge.assess import AssessSettings
from monitor.recording import known_or_none
from monitor.studies.figures import DAYS_A_YEAR, Figure, Rate, over_arms, share_document
from monitor.studies.rehearsal.detection import Kind, false_alarms, kind_document, parts, play_part
from monitor.studies.rehearsal.fleet import SCENARIOS, FleetSettings
from monitor.studies.rehearsal.play import LEARNING_DAYS, play
from monitor.studies.rehearsal.remaining_life import life_jobs, summarise

FEWEST_ARMS = 12  # of any kind of wear

Each = Callable[[Callable[[Any], Any], list[Any]], Iterable[Any]]
"""`map`, or that of a pool of processes."""


def rehearse(
    assess: AssessSettings,
    *,
    arms: int,
    seed: int = 0,
    between_std: float = 0.02,
    robot: str = "ur5",
    lives: int | None = None,
    steps: int | None = None,
    each: Each = map,
) -> dict[str, Any]:
    """False alerts, detection delays, coverage and the quality of remaining life, as one document. `each` does not change it.

    lives : arms that are asked for their remaining life; None: half of `arms`.
    steps : arms with a 5 % step; None: `arms`.
    """
    base = FleetSettings(
        arms=arms, seed=seed, between_std=between_std, robot=robot, reference_speed_rad_s=assess.drift.reference_speed_rad_s
    )
    few = max(arms // 3, FEWEST_ARMS)
    kinds = [
        Kind("2 % step", 0.02, 0.0, few),
        Kind("5 % step", 0.05, 0.0, arms if steps is None else steps),  # its share within 30 days is compared with 99 %
        Kind("5 %/year", 0.0, 0.05, few),
        Kind("10 %/year", 0.0, 0.10, few),
        Kind("30 %/year", 0.0, 0.30, few),
        Kind("100 %/year", 0.0, 1.00, few),
    ]
    every_part = [part for kind in kinds for part in parts(kind, seed + 1)]
    asked = max(arms // 2 if lives is None else lives, FEWEST_ARMS)
    jobs = [partial(quiet_document, base, assess), *(partial(play_part, base, assess, part) for part in every_part)]
    jobs += life_jobs(asked, assess, seed=seed + 3, base=base)
    quiet, *rest = each(_done, jobs)
    reported = list(zip(every_part, rest[: len(every_part)], strict=True))
    life = summarise(rest[len(every_part) :])
    return {
        **quiet,
        "detection": [kind_document(kind, [group for part, group in reported if part.kind == kind]) for kind in kinds],
        "remaining_life": {
            "p10_p90_holds": share_document(life.interval),
            "alpha_lambda_at_half_life": share_document(life.alpha_lambda),
            "no_trend": life.no_trend,
            "by_path": list(life.by_path),
        },
    }


def quiet_document(base: FleetSettings, assess: AssessSettings) -> dict[str, Any]:
    """The figures of a fleet without wear."""
    quiet = play(base, assess)
    left = np.abs(quiet.slope_error_per_k)  # (A, J)
    return {
        "robot_years": base.arms * quiet.days / DAYS_A_YEAR,
        "learning_days": LEARNING_DAYS,
        "while_learning": _rate_document(Rate(events=quiet.early, robot_years=base.arms * LEARNING_DAYS / DAYS_A_YEAR)),
        "between_std": base.between_std,
        "autocorrelation": base.autocorrelation,
        "false_alarms": {name or "all": _rate_document(false_alarms(quiet, name)) for name in (None, *SCENARIOS)},
        "false_wear_alerts": int(np.isfinite(quiet.tier_day[:, :, 1]).sum()),
        "friction_interval_90": _figure_document(over_arms(np.mean, quiet.covered)),
        "slope_left_per_k": {
            **_figure_document(over_arms(np.nanmean, left)),
            "nine_of_ten": known_or_none(float(np.nanquantile(left, 0.9))),
        },
    }


def _done(job: Callable[[], Any]) -> Any:
    """The result of a job: a function of the module, so that a pool of processes can call it."""
    return job()


def _figure_document(figure: Figure) -> dict[str, float | None]:
    return {name: known_or_none(value) for name, value in figure._asdict().items()}


def _rate_document(rate: Rate) -> dict[str, float]:
    return {"events": rate.events, "robot_years": rate.robot_years, "per_year": rate.per_year, "at_most": rate.at_most}
