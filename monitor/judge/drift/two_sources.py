"""What the filter keeps of its two sources of observations, replays and production, once production was observed: values only.

The filter has one state for both. Of each source it knows the noise between observations, and how often they come. The noise of the source
in force stands in the fields of `FilterState`; that of the other one stands here, and `from_production.swapped` exchanges the two. At rest
the source in force is the replay. Production has a level of its own, and a noise of its own with a correlation of its own: two more states.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from monitor.judge.drift.noise.volatility import Volatility
from monitor.recording import Array

EXTRA_STATES = 2  # the level of production and its noise, after the levels of the replays' contexts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoSources:
    """Both sources of N joints, (N,) each: `other_*` is the source that is not in force."""

    interval_days: Annotated[Array, "N"]  # usual time between observations of the source in force, to which its correlation belongs
    since_days: Annotated[Array, "N"]  # since its last observation
    number: Annotated[Array, "N"]  # of its observations that the filter learned from
    other_interval_days: Annotated[Array, "N"]
    other_since_days: Annotated[Array, "N"]
    other_number: Annotated[Array, "N"]
    other_step_var: Annotated[Array, "N"]  # noise of the other source, as the fields of `FilterState` without `other_`
    other_product: Annotated[Array, "N"]
    other_noise_weight: Annotated[Array, "N"]
    other_activity: Annotated[Array, "N"]
    other_volatility: Volatility
    other_residual: Annotated[Array, "N"]
    other_gate_run: Annotated[Array, "N"]
    coldest_c: Annotated[Array, "N"]  # and the warmest: temperatures of the production that was learned from; NaN before the first
    warmest_c: Annotated[Array, "N"]
    unconfirmed: Annotated[Array, "N"]  # [log] wear that production alone has found since the joint's last replay
    unconfirmed_rate: Annotated[Array, "N"]  # [1/usual day] wear rate likewise
    risen: Annotated[Array, "N"]  # 1 where a rise was found that began long ago, by either source, and wear has held it since; else 0

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
