"""Friction at the reference speed by production alone, with its deviation, or the reason why not.

Production measures the difference Δ of fc and fv from the last replay's, X Δ = torque − rigid·p − friction of the replay. Its covariance is
(M + P)⁻¹ (κ M + G C Gᵀ + P) (M + P)⁻¹. M is the information on friction. κ is how much the paths differ beside what M promises: what the
model errs by on one path does not average out there. C is the covariance of the rigid parameters, one error common to all rows. P is a weak
expectation that fc and fv change in proportion, which alone says something of speeds at which the arm does not move. How far friction
differs from run to run, the days of the arm tell.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.identify.production.arm import friction_terms, rigid_parameters, rigid_places
from monitor.identify.production.gather import excess
from monitor.identify.production.information import (
    NO_BIN,
    Days,
    ProductionInformation,
    Sums,
    added,
    between_days,
    between_paths,
    noise_scale,
)
from monitor.identify.settings import ProductionSettings
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S, Array, Mask, known_or_none

SHAPE_STD = 0.4  # by which the change of fv may differ from that of fc, as a fraction of friction
ANYTHING = 20.0  # times the friction of the replay: what Δ is before any row
LAW_SHARE = 0.01  # of friction for each factor e between the speeds of production and the reference speed: no law is that of the arm
LEAST_S = 5.0  # of motion of a joint that tells of it
KNOWN_SHAPE = 0.15  # fraction of itself to which fc or fv alone must be known to be told
UNKNOWN_LOAD = Sentence(
    "production_unknown_load",
    "most motion is left out, since something else is in the hand than was declared: declare it (set_payload), or replay with it",
)
IN_ONE_DAY, IN_DAYS = Sentence("in_one_day", "in {days:g} day"), Sentence("in_days", "in {days:g} days")
HARDLY_MOVED = Sentence("production_hardly_moved", "{joint:joint}: it moved for {moving_s:.0f} s {during}; a replay is needed")
TOO_LITTLE = Sentence("production_too_little", "{joint:joint}: {share:.2g} of what is needed {during}; a replay is needed")
NO_MORE = Sentence(
    "production_tells_no_more",
    "{joint:joint}: {share:.2g} of what is needed {during}; more of the same work tells no more; a replay is needed",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionEstimate:
    """What production tells of the friction of J joints at the reference speed, in one period."""

    reference_speed_rad_s: float
    friction_nm: Array  # (J,) F(v*) at `temperature_c`; NaN where production told nothing
    deviation_nm: Array  # (J,) one standard deviation against what a replay would find; NaN as above
    noise_nm: Array  # (J,) the part of it that the next period of the same production does not share
    coulomb_nm: Array  # (J,) NaN where not known by itself
    viscous_nm_s_per_rad: Array  # (J,) likewise
    temperature_c: Array  # (J,) mean over the rows that counted; NaN where unknown
    speed_rad_s: Array  # (J,) mean |q̇| of these rows
    moving_s: Array  # (J,) their duration
    begin_unix_s: float
    end_unix_s: float
    share: Array  # (J,) information held beside what the stated deviation needs; 1 and more: known
    known: Mask  # (J,)
    reasons: tuple[Reason, ...]  # why a joint is not known, one sentence a joint, and what would help all of them
    left_out_s: Mapping[str, float]  # cause → seconds
    seen_s: float  # seconds listened to

    def to_document(self) -> dict[str, Any]:
        """A JSON object; null for unknown."""
        joints = [
            {
                "joint": j + 1,
                "known": bool(self.known[j]),
                "share": known_or_none(self.share[j]),
                **{
                    name: known_or_none(getattr(self, name)[j])
                    for name in (
                        "friction_nm",
                        "deviation_nm",
                        "noise_nm",
                        "coulomb_nm",
                        "viscous_nm_s_per_rad",
                        "temperature_c",
                        "speed_rad_s",
                        "moving_s",
                    )
                },
            }
            for j in range(len(self.known))
        ]
        return {
            "reference_speed_rad_s": self.reference_speed_rad_s,
            "begin_unix_s": self.begin_unix_s,
            "end_unix_s": self.end_unix_s,
            "joints": joints,
            "reasons": [reason.document() for reason in self.reasons],
            "seen_s": self.seen_s,
            "left_out_s": dict(self.left_out_s),
        }


def estimate(
    information: ProductionInformation,
    identification: Identification,
    settings: ProductionSettings,
    now_unix_s: float,
    *,
    during: Reason | None = None,
    past: ProductionInformation | None = None,
) -> ProductionEstimate:
    """What the production of the last `period_days` tells of friction.

    during : how the reasons call that time; None: by its days. past : whose days tell how well friction repeats; None: of `information`.
    identification : of the last replay; its rigid parameters are taken as they are, and their covariance is part of the deviation.
    Raises BadInput where the information is of another arm.
    """
    if information.robot != identification.robot:
        raise BadInput(f"information from production is of a {information.robot}, the identification of a {identification.robot}")
    J = len(identification.coulomb_nm)
    recent = information.since(now_unix_s - settings.period_days * DAY_S)
    left = recent.left_out()
    chosen, other_s = _chosen(recent, settings)
    if other_s > 0.0:
        left["other_temperature"] = other_s
    solved = None if chosen is None else _solved(chosen, information, identification, settings)
    if solved is not None:
        repeats = between_days(_days(recent if past is None else past, identification, settings), settings.between_runs)
        solved = solved.with_runs(repeats * np.abs(solved.torque))
    nothing = np.full(J, np.nan)
    F, std, noise, common = (nothing,) * 4 if solved is None else (solved.torque, solved.std, solved.noise, solved.common)
    moving = np.zeros(J) if chosen is None else chosen.moving_s
    told = np.isfinite(F) & (moving >= LEAST_S)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(told & (F > 0.0), (settings.deviation * F / std) ** 2, 0.0)
    known = share >= 1.0
    days = (IN_ONE_DAY if settings.period_days == 1 else IN_DAYS)(days=settings.period_days) if during is None else during
    saturated = common > settings.deviation * F
    reasons = tuple(_reason(j, float(share[j]), float(moving[j]), bool(saturated[j]), days) for j in range(J) if not known[j])
    if left.get("payload_unknown", 0.0) > float(np.max(moving)):
        reasons = (*reasons, UNKNOWN_LOAD())
    weight = np.zeros((2, J)) if chosen is None else chosen.temperature
    with np.errstate(invalid="ignore", divide="ignore"):
        temperature, speed = weight[0] / weight[1], (np.zeros(J) if chosen is None else chosen.speed) / moving
    return ProductionEstimate(
        reference_speed_rad_s=settings.reference_speed_rad_s,
        friction_nm=np.where(told, F, np.nan),
        deviation_nm=np.where(told, std, np.nan),
        noise_nm=np.where(told, noise, np.nan),
        coulomb_nm=nothing if solved is None else np.where(told, solved.coulomb, np.nan),
        viscous_nm_s_per_rad=nothing if solved is None else np.where(told, solved.viscous, np.nan),
        temperature_c=temperature,
        speed_rad_s=speed,
        moving_s=moving,
        begin_unix_s=now_unix_s if chosen is None else chosen.begin_unix_s,
        end_unix_s=now_unix_s if chosen is None else chosen.end_unix_s,
        share=share,
        known=known,
        reasons=reasons,
        left_out_s=left,
        seen_s=sum(recent.seen_s.values()),
    )


def _reason(j: int, share: float, moving_s: float, saturated: bool, during: Reason) -> Reason:
    """Why joint j (from 0) is not known."""
    if moving_s < LEAST_S:
        return HARDLY_MOVED(joint=j + 1, moving_s=moving_s, during=during)
    return (NO_MORE if saturated else TOO_LITTLE)(joint=j + 1, share=min(share, 0.99), during=during)


def _chosen(information: ProductionInformation, settings: ProductionSettings) -> tuple[Sums | None, float]:
    """The sums over the range of temperature that tells most, and the seconds of motion at other temperatures."""
    bins = sorted({key[1] for key in information.cells})
    if not bins:
        return None, 0.0
    wide = max(1, round(settings.temperature_range_k / information.temperature_bin_k))

    def told_s(first: int) -> float:
        inside = [sums for (_, at), sums in information.cells.items() if first <= at < first + wide]
        return float(sum(np.sum(sums.moving_s) for sums in inside))

    known = [at for at in bins if at != NO_BIN]
    first = max(known, key=told_s) if known else NO_BIN
    inside = [sums for (_, at), sums in sorted(information.cells.items()) if first <= at < first + wide]
    outside = [sums for (_, at), sums in information.cells.items() if not first <= at < first + wide]
    return added(inside), float(sum(np.max(sums.moving_s) for sums in outside))


class _Solved(NamedTuple):
    """(J,) each [N·m], [N·m·s/rad]."""

    torque: Array
    std: Array
    noise: Array
    common: Array  # the part of `std` that more production of the same kind leaves
    coulomb: Array
    viscous: Array

    def with_runs(self, runs_nm: Array) -> "_Solved":
        """The same with what friction differs by from run to run."""
        return self._replace(std=np.hypot(self.std, runs_nm), common=np.hypot(self.common, runs_nm))


def _days(information: ProductionInformation, found: Identification, settings: ProductionSettings) -> Days:
    """Friction by the production of each day, where a day tells it to within what friction usually differs by."""
    J = len(found.coulomb_nm)
    friction, temperature = [], []
    for day in sorted({key[0] for key in information.cells}):
        sums, _ = _chosen(information.of_days(day, day), settings)
        if sums is None:
            continue
        solved = _solved(sums, information, found, settings)
        tells = (sums.moving_s >= LEAST_S) & (solved.noise <= settings.between_runs * np.abs(solved.torque))
        friction.append(np.where(tells, solved.torque, np.nan))
        with np.errstate(invalid="ignore", divide="ignore"):
            temperature.append(sums.temperature[0] / sums.temperature[1])
    return Days(np.reshape(friction, (-1, J)), np.reshape(temperature, (-1, J)))


def _solved(sums: Sums, information: ProductionInformation, found: Identification, settings: ProductionSettings) -> _Solved:
    """Friction of the joints by the sums."""
    J, v = len(found.coulomb_nm), settings.reference_speed_rad_s
    terms = friction_terms(found)
    rigid = rigid_parameters(found, information.rigid_columns)
    x = np.array([1.0, v])
    replay = np.nan_to_num(found.friction_at(v)[0])  # (J,)
    size = np.maximum(np.abs(replay), 1e-3)
    P = np.zeros((2 * J, 2 * J))
    for j in range(J):
        own = slice(2 * j, 2 * j + 2)
        P[own, own] += np.diag(np.array([1.0, v**2]) / (ANYTHING * size[j]) ** 2)
        fc, fv = np.maximum(terms[j, :2], 0.1 * np.array([size[j], size[j] / v]))
        slope = np.array([1.0 / fc, -1.0 / fv]) / SHAPE_STD
        P[own, own] += np.outer(slope, slope)
    inverse = np.linalg.inv(sums.gram + P)
    change = (inverse @ excess(sums, rigid, terms)).reshape(J, 2)
    F = replay + change @ x
    paths, enough = between_paths(sums)
    common_cov = sums.rigid @ _rigid_covariance(found, information.rigid_columns) @ sums.rigid.T + P

    def along(cov: Array) -> Array:
        whole = inverse @ cov @ inverse
        return whole.reshape(J, 2, J, 2)[np.arange(J), :, np.arange(J)]  # (J, 2, 2)

    var_rows, var_paths, var_common = (np.einsum("a,jab,b->j", x, along(cov), x) for cov in (sums.gram, paths, common_cov))
    scale = noise_scale(var_rows, var_paths, enough & (sums.moving_s >= LEAST_S))
    var_noise = scale * var_rows
    with np.errstate(invalid="ignore", divide="ignore"):
        far = np.nan_to_num(np.abs(np.log(np.maximum(sums.speed / sums.moving_s, 1e-3) / v)))
    lasting = (LAW_SHARE * far * F) ** 2 + var_common
    cov = scale[:, None, None] * along(sums.gram) + along(common_cov)
    coulomb, viscous = np.nan_to_num(found.coulomb_nm) + change[:, 0], np.nan_to_num(found.viscous_nm_s_per_rad) + change[:, 1]
    sure_c = np.sqrt(cov[:, 0, 0]) <= KNOWN_SHAPE * np.abs(coulomb)
    sure_v = np.sqrt(cov[:, 1, 1]) <= KNOWN_SHAPE * np.abs(viscous)
    return _Solved(
        torque=F,
        std=np.sqrt(var_noise + lasting),
        noise=np.sqrt(var_noise),
        common=np.sqrt(lasting),
        coulomb=np.where(sure_c, coulomb, np.nan),
        viscous=np.where(sure_v, viscous, np.nan),
    )


def _rigid_covariance(found: Identification, columns: tuple[int, ...]) -> Array:
    """(R, R) of the rigid parameters; what the replay did not excite is as unknown as its size."""
    places = rigid_places(found, columns)
    whole = found.covariance if found.total_covariance is None else found.total_covariance
    cov = whole[np.ix_(places, places)].copy()
    unknown = ~np.isfinite(np.diag(cov))
    cov[unknown], cov[:, unknown] = 0.0, 0.0
    cov[unknown, unknown] = np.maximum(np.abs(found.values[places][unknown]), 0.1) ** 2
    covariance: Array = np.nan_to_num(cov)
    return covariance
