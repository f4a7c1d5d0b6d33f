"""Beliefs of older releases, in the form of this release. What an older release did not store is learned from then on."""

import copy
import math
from typing import Any

from monitor.errors import BadInput
from monitor.judge.document import plain
from monitor.judge.drift.filter_state import RATE, WEAR, WINDOW
from monitor.judge.drift.usage import no_usage
from monitor.judge.temperature.curves import no_bins


def from_version_2(document: dict[str, Any]) -> dict[str, Any]:
    """A document of version 3 from one of version 2, which had the wear rate of the logarithm, no usage, and straight lines only.

    Raises BadInput where the document is not one of version 2.
    """
    migrated = copy.deepcopy(document)
    try:
        J = len(migrated["reference_temperature_c"])
        for mean, cov in zip(migrated["track"]["mean"], migrated["track"]["cov"], strict=True):
            grown = math.exp(mean[WEAR])  # the derivative of e^w is e^w times that of w
            mean[RATE] *= grown
            cov[RATE] = [value * grown for value in cov[RATE]]
            for row in cov:
                row[RATE] *= grown
        migrated["usage"] = plain(no_usage(J))
        for law in ("viscous", "coulomb"):
            migrated[law]["bins"] = plain(no_bins(J))
    except (KeyError, TypeError, IndexError, ValueError) as wrong:
        raise BadInput(f"belief: not what schema_version 2 wrote: {wrong!r}") from None
    migrated["schema_version"] = 3
    return migrated


def from_version_3(document: dict[str, Any]) -> dict[str, Any]:
    """A document of version 4 from one of version 3, whose change bank had fewer starts: the others begin without evidence.

    Raises BadInput where the document is not one of version 3.
    """
    migrated = copy.deepcopy(document)
    try:
        track = migrated["track"]
        for ages in track["ages"]:
            ages += [ages[-1] + 1.0 + k for k in range(WINDOW - len(ages))]
        for name in ("responses", "scores", "raw_scores", "informations"):
            for kind in (kind for joint in track[name] for kind in joint):
                nothing = [0.0] * len(kind[0]) if name == "responses" else 0.0
                kind += [copy.copy(nothing) for _ in range(WINDOW - len(kind))]
    except (KeyError, TypeError, IndexError) as wrong:
        raise BadInput(f"belief: not what schema_version 3 wrote: {wrong!r}") from None
    migrated["schema_version"] = 4
    return migrated
