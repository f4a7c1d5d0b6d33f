"""What one period of production told of each joint's friction, as the judge takes it and the history keeps it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from monitor.errors import BadInput
from monitor.judge.friction.observation import NOT_MEASURED, POSSIBLE_C, VISCOUS_SHARE, Observation
from monitor.judge.friction.settings import DriftSettings
from monitor.reason import Reason
from monitor.recording import Array, Context

# a context states these of the production as well; the motion is the program's own, and past work on joints is of the arm
COMPARED = ("serial", "firmware", "mounting_rad", "payload_kg", "tool")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionObservation:
    """An estimate of friction from production in one period. J joints; NaN where production did not tell a figure."""

    begin_unix_s: float
    end_unix_s: float
    reference_speed_rad_s: float
    friction_nm: Annotated[Array, "J"]  # F(v*) at `temperature_c`
    deviation_nm: Annotated[Array, "J"]  # one standard deviation against what a replay would find
    noise_nm: Annotated[Array, "J"]  # the part of it that the next period of the same production does not share
    temperature_c: Annotated[Array, "J"]
    share: Annotated[Array, "J"]  # information held beside what is needed; 1 and more: known
    known: Annotated[Array, "J"]  # 1 where the joint is known to the stated deviation, else 0: then the judge does not observe it
    arm: str = ""  # which frozen model of the arm it was made with: with another one production has another level
    reasons: tuple[Reason | None, ...] = ()  # why a joint is not known; None of a joint that is
    left_out_s: Mapping[str, float] = field(default_factory=dict)  # seconds of production that did not count, by cause
    seen_s: float = 0.0  # seconds of production that were listened to

    @property
    def joints(self) -> int:
        """J."""
        return len(self.friction_nm)

    @property
    def observed(self) -> np.ndarray:
        """(J,) joints of which the production tells enough, with figures that can be used."""
        figures = np.isfinite(self.friction_nm) & (self.friction_nm > 0) & np.isfinite(self.noise_nm) & (self.noise_nm >= 0)
        mask: np.ndarray = (self.known > 0) & figures
        return mask

    def seen(self, settings: DriftSettings) -> Observation:
        """The observation that enters the filter. Raises BadInput where it is of another reference speed than the filter's."""
        if self.reference_speed_rad_s != settings.reference_speed_rad_s:
            was, now = self.reference_speed_rad_s, settings.reference_speed_rad_s
            raise BadInput(f"production was estimated at {was:g} rad/s, drift.reference_speed_rad_s is {now:g}; they must agree")
        use, unknown = self.observed, np.full(self.joints, np.nan)
        F = np.where(use, self.friction_nm, 1.0)
        possible = (self.temperature_c >= POSSIBLE_C[0]) & (self.temperature_c <= POSSIBLE_C[1])
        return Observation(
            log_torque=np.where(use, np.log(F), np.nan),
            variance=np.where(use, (self.noise_nm / F) ** 2, np.nan),
            temperature_c=np.where(possible, self.temperature_c, np.nan),
            viscous_share=np.full(self.joints, VISCOUS_SHARE),
            warming_k_per_min=unknown,  # a mean over hours: the grease has the sensor's temperature but for a constant
            coulomb_nm=unknown,
            viscous_nm_s_per_rad=unknown,
            residual_rms_nm=NOT_MEASURED,
        )

    def of_joints(self, which: np.ndarray) -> "ProductionObservation":
        """The observation of the joints in `which` (J,) alone: the others are unknown in it."""
        return replace(self, known=np.where(which, self.known, 0.0))


def context_of_production(context: Context) -> Context:
    """Of a context, what must be equal for two periods of production to share a level."""
    return Context(robot=context.robot, **{key: getattr(context, key) for key in COMPARED})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionHistory:
    """What a belief remembers of the observations from production."""

    context: Context  # of the level in force, as `context_of_production`
    observations: int
    at_unix_s: float  # end of the last period
    learnt_at_unix_s: Annotated[Array, "J"]  # end of the last period that the filter learned from; NaN: none
    share: Annotated[Array, "J"]  # of the last period
    arm: str = ""  # as in `WorkObservation`
    asks: tuple[int, ...] = ()  # joints (from 1) whose wear production alone has found: a replay shall confirm it
    suspects: tuple[int, ...] = ()  # joints (from 1) of which production makes wear likely, since their last replay: replays shall tell
