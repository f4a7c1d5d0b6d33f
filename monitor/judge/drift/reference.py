"""From which level of friction wear counts, and how that level differs from the one at the beginning.

Wear w of the filter counts from the lowest level that the joint surely held. At the beginning that is the level of the first replays.
Friction falls by itself while a joint runs in, and with new grease; a rise from the beginning would then hide the wear that follows. A fall
that is sure is therefore moved out of w into the filter's levels, and is kept here. So is a change that most joints of the arm had at the
same time: it is none of a single joint. The levels keep its uncertainty, and learn from the replays after it.
"""

from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np

from monitor.recording import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """What was moved out of wear so far, logarithms, (N,) each: wear since the beginning is w + fallen + run_in + shared."""

    fallen: Annotated[Array, "N"]  # falls of the joint, ≤ 0
    run_in: Annotated[Array, "N"]  # slow falls of its first months, ≤ 0
    fallen_var: Annotated[Array, "N"]  # variance of both together
    shared: Annotated[Array, "N"]  # changes that the joint had together with most joints of its arm, of either sign
    shared_var: Annotated[Array, "N"]
    held_days: Annotated[Array, "N"]  # [d] since the level that wear counts from was reached; NaN: since the beginning

    @property
    def moved(self) -> Array:
        """(N,) everything that was moved out of wear."""
        return self.fallen + self.run_in + self.shared

    @property
    def moved_var(self) -> Array:
        """(N,) its variance."""
        return self.fallen_var + self.shared_var


def from_beginning(joints: int) -> Reference:
    """The reference of joints that have held no lower level, nor changed together."""
    nothing = np.zeros(joints)
    return Reference(
        fallen=nothing, run_in=nothing, fallen_var=nothing, shared=nothing, shared_var=nothing, held_days=np.full(joints, np.nan)
    )


def forget(reference: Reference, new: np.ndarray) -> Reference:
    """The reference where the joints in `new` (N,) are new ones."""
    fresh = from_beginning(len(new))
    return replace(reference, **{f.name: np.where(new, getattr(fresh, f.name), getattr(reference, f.name)) for f in fields(Reference)})


def with_common_change(reference: Reference, shared: Array, var: Array, running_in: np.ndarray) -> Reference:
    """The reference after a change (N,) that most joints of an arm had together, with its variance (N,); both 0 where there was none.

    running_in : (N,) whether it is none of the arm, but all of its joints run in.
    """
    ran, common = np.where(running_in, shared, 0.0), np.where(running_in, 0.0, shared)
    return replace(
        reference,
        run_in=reference.run_in + ran,
        fallen_var=reference.fallen_var + np.where(running_in, var, 0.0),
        shared=reference.shared + common,
        shared_var=reference.shared_var + np.where(running_in, 0.0, var),
        held_days=np.where(ran < 0, 0.0, reference.held_days),
    )
