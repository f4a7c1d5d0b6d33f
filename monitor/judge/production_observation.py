"""What one period of the arm's ordinary work told of each joint's friction, as the judge takes it and the history keeps it."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import array, entry, plain
from monitor.judge.drift.observation import NOT_MEASURED, POSSIBLE_C, VISCOUS_SHARE, Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array, Context

# a context states these of the work as well; the motion is the program's own, and past work on joints is of the arm
COMPARED = ("serial", "firmware", "mounting_rad", "payload_kg", "tool")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionObservation:
    """An estimate of friction from ordinary work in one period. J joints; NaN where work did not tell a figure."""

    begin_unix_s: float
    end_unix_s: float
    reference_speed_rad_s: float
    friction_nm: Array  # (J,) F(v*) at `temperature_c`
    deviation_nm: Array  # (J,) one standard deviation against what a replay would find
    noise_nm: Array  # (J,) the part of it that the next period of the same work does not share
    temperature_c: Array  # (J,)
    share: Array  # (J,) information held beside what is needed; 1 and more: known
    known: Array  # (J,) 1 where the joint is known to the stated deviation, else 0: then the judge does not observe it
    arm: str = ""  # which frozen model of the arm it was made with: with another one work has another level
    reasons: tuple[str, ...] = ()  # why a joint is not known, a sentence each; empty of a joint that is
    left_out_s: tuple[tuple[str, float], ...] = ()  # seconds of work that did not count, by cause
    seen_s: float = 0.0  # seconds of work that were listened to

    @property
    def joints(self) -> int:
        """J."""
        return len(self.friction_nm)

    @property
    def observed(self) -> np.ndarray:
        """(J,) joints of which the work tells enough, with figures that can be used."""
        figures = np.isfinite(self.friction_nm) & (self.friction_nm > 0) & np.isfinite(self.noise_nm) & (self.noise_nm >= 0)
        mask: np.ndarray = (self.known > 0) & figures
        return mask

    def seen(self, settings: DriftSettings) -> Observation:
        """The observation that enters the filter. Raises BadInput where it is of another reference speed than the filter's."""
        if self.reference_speed_rad_s != settings.reference_speed_rad_s:
            was, now = self.reference_speed_rad_s, settings.reference_speed_rad_s
            raise BadInput(f"work was estimated at {was:g} rad/s, drift.reference_speed_rad_s is {now:g}; they must agree")
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

    def as_document(self) -> dict[str, Any]:
        """Plain JSON; `work_observation_from_document` is the exact inverse."""
        document: dict[str, Any] = plain(self)
        return document | {"left_out_s": dict(self.left_out_s)}


def production_observation_from_document(document: Any) -> ProductionObservation:
    """A WorkObservation from its document. Raises BadInput naming the key."""
    where = "observation from work"
    J = len(array(document, "friction_nm", (-1,), where=where))
    arrays = {f.name: array(document, f.name, (J,), where=where) for f in fields(ProductionObservation) if f.type in (Array, "Array")}
    try:
        return ProductionObservation(
            begin_unix_s=float(entry(document, "begin_unix_s", where=where)),
            end_unix_s=float(entry(document, "end_unix_s", where=where)),
            reference_speed_rad_s=float(entry(document, "reference_speed_rad_s", where=where)),
            arm=str(document.get("arm") or ""),
            reasons=tuple(str(each) for each in document.get("reasons") or ()),
            left_out_s=tuple((str(cause), float(seconds)) for cause, seconds in (document.get("left_out_s") or {}).items()),
            seen_s=float(document.get("seen_s") or 0.0),
            **arrays,
        )
    except (TypeError, ValueError, AttributeError) as wrong:
        raise BadInput(f"{where}: {wrong}") from None


def context_of_production(context: Context) -> Context:
    """Of a context, what must be equal for two periods of work to share a level."""
    return Context(robot=context.robot, **{key: getattr(context, key) for key in COMPARED})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionHistory:
    """What a belief remembers of the observations from ordinary work."""

    context: Context  # of the level in force, as `context_of_work`
    observations: int
    at_unix_s: float  # end of the last period
    learnt_at_unix_s: Array  # (J,) end of the last period that the filter learned from; NaN: none
    share: Array  # (J,) of the last period
    arm: str = ""  # as in `WorkObservation`
    asks: tuple[int, ...] = ()  # joints (from 1) whose wear work alone has found: a replay shall confirm it
    suspects: tuple[int, ...] = ()  # joints (from 1) of which work makes wear likely, since their last replay: replays shall tell


def production_history_from_document(document: Any, joints: int) -> ProductionHistory | None:
    """A WorkHistory from its document; None where there is none. Raises BadInput naming the key."""
    if document is None:
        return None
    where = "belief: ordinary_work"
    return ProductionHistory(
        context=context_from_document(entry(document, "context", where=where)),
        observations=int(entry(document, "observations", where=where)),
        at_unix_s=float(entry(document, "at_unix_s", where=where)),
        learnt_at_unix_s=array(document, "learnt_at_unix_s", (joints,), where=where),
        share=array(document, "share", (joints,), where=where),
        arm=str(document.get("arm") or ""),
        asks=tuple(int(joint) for joint in document.get("asks") or ()),
        suspects=tuple(int(joint) for joint in document.get("suspects") or ()),
    )


def context_from_document(document: Any) -> Context:
    """A Context from its plain document. Raises BadInput where it is none."""
    try:
        listed = {key: tuple(document[key]) for key in ("mounting_rad", "joint_serials", "revolutions") if document.get(key) is not None}
        return Context(**{**document, **listed})
    except (TypeError, AttributeError) as wrong:
        raise BadInput(f"context: {wrong}") from None
