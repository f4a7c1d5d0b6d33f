"""Beliefs that an older release wrote, as this one would have written them. What it did not keep begins to be learnt."""

import copy
import math
from typing import Any

from monitor.errors import BadInput
from monitor.judge.document import plain
from monitor.judge.drift.filter_state import RATE, WEAR, WINDOW
from monitor.judge.drift.usage import no_usage
from monitor.judge.temperature.curves import no_bins


def from_version_2(document: dict[str, Any]) -> dict[str, Any]:
    """Version 2 counted wear a day in the logarithm, knew no use, and kept lines only.

    Raises BadInput where it is not what version 2 wrote.
    """
    told = copy.deepcopy(document)
    try:
        J = len(told["reference_temperature_c"])
        for mean, cov in zip(told["track"]["mean"], told["track"]["cov"], strict=True):
            grown = math.exp(mean[WEAR])  # a rise of the logarithm by ẇ is a rise of friction by e^w·ẇ
            mean[RATE] *= grown
            cov[RATE] = [value * grown for value in cov[RATE]]
            for row in cov:
                row[RATE] *= grown
        told["usage"] = plain(no_usage(J))
        for law in ("viscous", "coulomb"):
            told[law]["bins"] = plain(no_bins(J))
    except (KeyError, TypeError, IndexError, ValueError) as wrong:
        raise BadInput(f"belief: not what schema_version 2 wrote: {wrong!r}") from None
    told["schema_version"] = 3
    return told


def from_version_3(document: dict[str, Any]) -> dict[str, Any]:
    """Version 3 looked for changes at fewer replays: those it did not keep are as if nobody had seen them.

    Raises BadInput where it is not what version 3 wrote.
    """
    told = copy.deepcopy(document)
    try:
        track = told["track"]
        for ages in track["ages"]:
            ages += [ages[-1] + 1.0 + k for k in range(WINDOW - len(ages))]
        for name in ("responses", "scores", "raw_scores", "informations"):
            for kind in (kind for joint in track[name] for kind in joint):
                nothing = [0.0] * len(kind[0]) if name == "responses" else 0.0
                kind += [copy.copy(nothing) for _ in range(WINDOW - len(kind))]
    except (KeyError, TypeError, IndexError) as wrong:
        raise BadInput(f"belief: not what schema_version 3 wrote: {wrong!r}") from None
    told["schema_version"] = 4
    return told
