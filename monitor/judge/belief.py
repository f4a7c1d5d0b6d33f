"""Belief: everything `assess` remembers of one arm, as a value that a JSON object carries exactly."""

import math
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import array, entry, plain
from monitor.judge.temperature import Law, Line, TemperatureSettings, fitted, law_from_document
from monitor.recording import Array, Context

SCHEMA_VERSION = 1
LEVEL, SLOPE, WEAR, RATE = range(4)  # order of the state: log N·m, 1/K, log, 1/day
COMPARABLE = ("serial", "firmware", "mounting_rad", "payload_kg", "tool", "trajectory_digest")
ORDINARY, SETTLING, STEP, OUTLIER, UNSEEN = range(5)  # what the last replay was to a joint; the last two are not learnt from


class OpenedContext(NamedTuple):
    """One context of the ledger: when its baseline began and how many replays it has."""

    context: Context
    opened_at_unix_s: float
    replays: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Belief:
    """Everything `assess` remembers of one arm: the next belief is a function of this one and the next recording."""

    robot: str
    reference_speed_rad_s: float
    at_unix_s: float  # of the last replay
    began_at_unix_s: float
    replays: int
    days: int  # UTC days with a replay
    contexts: tuple[OpenedContext, ...]  # oldest first; the last one is in force
    reference_temperature_c: Array  # (J,) T0
    mean: Array  # (J, 4) level, temperature slope, wear, wear rate per day
    cov: Array  # (J, 4, 4)
    joint_replays: Array  # (J,) learnt from
    noise_step_var: Array  # (J,) half the mean square of what differs from one replay to the next, within-replay noise taken off
    autocorrelation: Array  # (J,) mean product of successive normalised innovations
    noise_weight: Array  # (J,) replays behind both
    consistency: Array  # (J,) running mean of normalised innovations squared: 1 where the filter is consistent
    innovation: Array  # (J,) of the last replay; NaN where unseen
    normalised_innovation: Array  # (J,) in its own σ
    event: Array  # (J,) ORDINARY, SETTLING, STEP, OUTLIER or UNSEEN: the last replay
    gate_run: Array  # (J,) signed count of gated replays in a row
    cusum: Array  # (J, 2) whitened innovations summed up, upward and downward, beyond what chance does
    cusum_replays: Array  # (J, 2) replays since each sum left 0
    outliers: Array  # (J,) gated so far
    temperature_c: Array  # (J,) of the last replay
    inside_range: Array  # (J,) 1 where that lay in the range learnt before it
    viscous: Law
    coulomb: Law
    schema_version: int = SCHEMA_VERSION

    @property
    def joints(self) -> int:
        """J."""
        return len(self.mean)

    @property
    def context(self) -> Context:
        """The context in force."""
        return self.contexts[-1].context

    @property
    def wear(self) -> Array:
        """(J,) mean of w, in the logarithm of friction torque."""
        return self.mean[:, WEAR]

    @property
    def wear_std(self) -> Array:
        """(J,)."""
        return np.sqrt(np.maximum(self.cov[:, WEAR, WEAR], 0.0))

    @property
    def learnt_from(self) -> np.ndarray:
        """(J,) whether the last replay taught something of a joint."""
        learnt: np.ndarray = self.event <= STEP
        return learnt

    @property
    def noise_var(self) -> Array:
        """(J,) of y between replays: σ² = E[(εₖ − εₖ₋₁)²]/2 / (1 − ρ). A trend is in the differences once, in the values ever more."""
        return self.noise_step_var / (1.0 - np.maximum(self.autocorrelation, 0.0))

    def reference_torque_nm(self) -> tuple[Array, Array]:
        """F(v*, T0), wear included, and its standard deviation, (J,) each [N·m]; NaN where a joint was never seen."""
        h = np.array([1.0, 0.0, 1.0, 0.0])
        torque = np.where(self.joint_replays > 0, np.exp(self.mean @ h), np.nan)
        return torque, torque * np.sqrt(np.maximum(np.einsum("i,jik,k->j", h, self.cov, h), 0.0))

    def lines(self, settings: TemperatureSettings) -> tuple[Line, Line]:
        """fc(T) and fv(T) without wear, referred to T0."""
        T0 = self.reference_temperature_c
        return fitted(self.coulomb, T0, settings), fitted(self.viscous, T0, settings)

    def as_document(self) -> dict[str, Any]:
        """Plain JSON; `belief_from_document` is its exact inverse."""
        document: dict[str, Any] = plain(self)
        return document


def comparable(context: Context) -> Context:
    """Only what must be equal for two replays to be compared."""
    return Context(robot=context.robot, **{key: getattr(context, key) for key in COMPARABLE})


def differences(before: Context, after: Context) -> list[str]:
    """The names of what changed, in words. Payloads are equal to a gram, angles to a hundredth of a degree."""

    def same(a: object, b: object, tolerance: float) -> bool:
        if isinstance(a, tuple) and isinstance(b, tuple):
            return len(a) == len(b) and all(same(x, y, tolerance) for x, y in zip(a, b, strict=True))
        if isinstance(a, int | float) and isinstance(b, int | float):
            return math.isclose(a, b, rel_tol=0.0, abs_tol=tolerance)
        return a == b

    tolerance = {"payload_kg": 1e-3, "mounting_rad": math.radians(0.01)}
    pairs = [(key, getattr(before, key), getattr(after, key)) for key in COMPARABLE]
    return [f"{key} {old!r} → {new!r}" for key, old, new in pairs if not same(old, new, tolerance.get(key, 0.0))]


def belief_from_document(document: Any) -> Belief:
    """A Belief from `Belief.as_document()`.

    Raises BadInput naming the key that is missing or wrong, or the schema version that this release does not read.
    """
    where = "belief"
    version = entry(document, "schema_version", where=where)
    if version != SCHEMA_VERSION:
        raise BadInput(f"belief: schema_version is {version!r}; this release reads {SCHEMA_VERSION}")
    J = len(array(document, "reference_temperature_c", (-1,), where=where))
    shapes: dict[str, tuple[int, ...]] = {"mean": (J, 4), "cov": (J, 4, 4), "cusum": (J, 2), "cusum_replays": (J, 2)}
    arrays: dict[str, Any] = {
        f.name: array(document, f.name, shapes.get(f.name, (J,)), where=where) for f in fields(Belief) if f.type in (Array, "Array")
    }
    ledger = entry(document, "contexts", where=where)
    try:
        return Belief(
            robot=str(entry(document, "robot", where=where)),
            reference_speed_rad_s=float(entry(document, "reference_speed_rad_s", where=where)),
            at_unix_s=float(entry(document, "at_unix_s", where=where)),
            began_at_unix_s=float(entry(document, "began_at_unix_s", where=where)),
            replays=int(entry(document, "replays", where=where)),
            days=int(entry(document, "days", where=where)),
            contexts=tuple(OpenedContext(_context(o["context"]), float(o["opened_at_unix_s"]), int(o["replays"])) for o in ledger),
            viscous=law_from_document(entry(document, "viscous", where=where), J, where="belief: viscous"),
            coulomb=law_from_document(entry(document, "coulomb", where=where), J, where="belief: coulomb"),
            **arrays,
        )
    except (TypeError, ValueError, KeyError) as wrong:
        raise BadInput(f"belief: {wrong!r}") from None


def _context(document: dict[str, Any]) -> Context:
    """A Context from its fields."""
    mounting = document.get("mounting_rad")
    return Context(**{**document, "mounting_rad": None if mounting is None else tuple(float(angle) for angle in mounting)})
