"""What the filter keeps of its two sources of observations, replays and the arm's ordinary work, once work was observed: values only.

The filter has one state for both. Of each source it knows the noise between observations, and how often they come. The noise of the source
in force stands in the fields of `FilterState`; that of the other one stands here, and `from_work.swapped` exchanges the two. At rest the
source in force is the replay. Work has a level of its own, and a noise of its own with a correlation of its own: two more states.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from monitor.judge.document import array
from monitor.judge.drift.noise.volatility import Volatility, volatility_from_document
from monitor.recording import Array

EXTRA_STATES = 2  # the level of work and its noise, after the levels of the replays' contexts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoSources:
    """Both sources of N joints, (N,) each: `other_*` is the source that is not in force."""

    interval_days: Array  # usual time between observations of the source in force, to which its correlation belongs
    since_days: Array  # since its last observation
    number: Array  # of its observations that the filter learned from
    other_interval_days: Array
    other_since_days: Array
    other_number: Array
    other_step_var: Array  # noise of the other source, as the fields of `FilterState` without `other_`
    other_product: Array
    other_noise_weight: Array
    other_activity: Array
    other_volatility: Volatility
    other_residual: Array
    other_gate_run: Array
    coldest_c: Array  # and the warmest: temperatures of the work that was learned from; NaN before the first
    warmest_c: Array
    unconfirmed: Array  # [log] wear that work alone has found since the joint's last replay
    unconfirmed_rate: Array  # [1/usual day] wear rate likewise
    risen: Array  # 1 where a rise was found that began long ago, by either source, and wear has held it since; else 0

    def of_new_joints(self, new: np.ndarray) -> "TwoSources":
        """The sources where the joints in `new` (N,) are other ones; replays are in force. Nothing was found of them yet."""
        return replace(
            self,
            other_residual=np.where(new, np.nan, self.other_residual),
            other_gate_run=np.where(new, 0.0, self.other_gate_run),
            unconfirmed=np.where(new, 0.0, self.unconfirmed),
            unconfirmed_rate=np.where(new, 0.0, self.unconfirmed_rate),
            risen=np.where(new, 0.0, self.risen),
        )


def sources_from_document(document: Any, joints: int) -> TwoSources | None:
    """The sources from their document; None where only replays were observed. Raises BadInput naming the key."""
    if document is None:
        return None
    complete = {"risen": [0.0] * joints, **document} if isinstance(document, dict) else document  # releases without it
    where = "belief: track: sources"
    arrays = {f.name: array(complete, f.name, (joints,), where=where) for f in fields(TwoSources) if f.name != "other_volatility"}
    volatility = volatility_from_document(complete.get("other_volatility"), joints, where=f"{where}: other_volatility")
    return TwoSources(**arrays, other_volatility=volatility)
