"""One replay through the filter: gate, look for shifts, update, learn the noise. One scalar measurement a joint.

Gated replays in a row on one side, and a one-sided CUSUM on whitened innovations, tell a change from chance: then the filter
is made unsure of wear. Neither raises an alert; the posterior that follows does, or does not.
"""

import math
from dataclasses import replace

import numpy as np
from filterpy.kalman import update

from monitor.identify.caveats import Caveat
from monitor.judge.belief import ORDINARY, OUTLIER, RATE, SETTLING, SLOPE, STEP, UNSEEN, WEAR, Belief
from monitor.judge.evidence import DriftSettings, Observation
from monitor.recording import Array


def filtered(belief: Belief, seen: Observation, elapsed_days: float, settings: DriftSettings) -> tuple[Belief, list[Caveat]]:
    """Gate, update and learn the noise, joint by joint."""
    J = belief.joints
    mean, cov = belief.mean.copy(), belief.cov.copy()
    noise_var = belief.noise_var
    noise_step_var, autocorrelation, noise_weight = belief.noise_step_var.copy(), belief.autocorrelation.copy(), belief.noise_weight.copy()
    cusum, cusum_replays = belief.cusum.copy(), belief.cusum_replays.copy()
    gate_run, outliers, consistency = belief.gate_run.copy(), belief.outliers.copy(), belief.consistency.copy()
    innovation, normalised, event = np.full(J, np.nan), np.full(J, np.nan), np.full(J, float(UNSEEN))
    rho = np.maximum(belief.autocorrelation, 0.0)
    # what is alike from replay to replay averages out slowly: n correlated replays are worth n·(1−ρ)/(1+ρ)
    dulled = (1.0 + rho) / (1.0 - rho)
    recent = elapsed_days <= 3.0  # noise of longer ago has nothing to do with today's

    for j in np.flatnonzero(np.isfinite(seen.log_torque)):
        warm = seen.temperature_c[j] - belief.reference_temperature_c[j]
        within = seen.variance[j]
        if not math.isfinite(warm):
            within += (mean[j, SLOPE] ** 2 + cov[j, SLOPE, SLOPE]) * settings.unknown_temperature_std_k**2
            warm = 0.0
        H = np.array([[1.0, -warm, 1.0, 0.0]])
        nu = float(seen.log_torque[j] - H[0] @ mean[j])
        foreseen = float(H[0] @ cov[j] @ H[0])
        z = nu / math.sqrt(foreseen + within + noise_var[j])
        innovation[j], normalised[j] = nu, z
        # only where a replay was foreseen well does its surprise tell of noise and shifts
        event[j] = ORDINARY if foreseen <= 2.0 * (within + noise_var[j]) else SETTLING
        followed = recent and event[j] == ORDINARY and belief.event[j] == ORDINARY

        if abs(z) > settings.gate_sigma:
            side = math.copysign(1.0, z)
            gate_run[j] = gate_run[j] + side if gate_run[j] * side > 0 else side
            outliers[j] += 1
            if abs(gate_run[j]) < settings.gate_run:
                event[j] = OUTLIER
                continue
            event[j], jump = STEP, nu  # so many on one side are no accident: wear has jumped, by about as much
        elif event[j] == ORDINARY:
            white = (z - rho[j] * belief.normalised_innovation[j]) / math.sqrt(1.0 - rho[j] ** 2) if followed else z
            cusum[j] = np.maximum(cusum[j] + [white, -white] - settings.cusum_slack, 0.0)
            cusum_replays[j] = np.where(cusum[j] > 0, cusum_replays[j] + 1, 0)
            up = int(np.argmax(cusum[j]))
            if cusum[j, up] > settings.cusum_limit:
                event[j] = STEP
                jump = (settings.cusum_slack + cusum[j, up] / cusum_replays[j, up]) * math.sqrt(foreseen + within + noise_var[j])
        gate_run[j] = 0.0
        if event[j] == STEP:
            cov[j, WEAR, WEAR] += jump**2
            cov[j, RATE, RATE] += (jump / settings.jump_days) ** 2
            cusum[j] = cusum_replays[j] = 0.0

        R = within + noise_var[j] * dulled[j]
        mean[j], P = update(mean[j], cov[j], np.array([seen.log_torque[j]]), np.array([[R]]), H)
        cov[j] = symmetric(P)
        if event[j] == belief.event[j] == ORDINARY and elapsed_days <= 10.0:
            n = noise_weight[j] = min(noise_weight[j] + 1.0, settings.memory_replays)
            differs = 0.5 * (nu - belief.innovation[j]) ** 2 - within
            noise_step_var[j] = max(noise_step_var[j] + (differs - noise_step_var[j]) / n, settings.between_floor**2)
            if followed:  # clipped and slow: wear that sets in must not soon pass for noise that lasts
                product = np.clip(z, -2.0, 2.0) * np.clip(belief.normalised_innovation[j], -2.0, 2.0)
                raised = autocorrelation[j] + (product - autocorrelation[j]) / (n + 2.0 * settings.between_replays)
                autocorrelation[j] = min(raised, settings.autocorrelation_max)
        if event[j] == ORDINARY:
            consistency[j] += (z**2 - consistency[j]) / 20.0

    updated = replace(
        belief,
        mean=mean,
        cov=cov,
        joint_replays=belief.joint_replays + (event <= STEP),
        noise_step_var=noise_step_var,
        autocorrelation=autocorrelation,
        noise_weight=noise_weight,
        consistency=consistency,
        innovation=innovation,
        normalised_innovation=normalised,
        event=event,
        gate_run=gate_run,
        cusum=cusum,
        cusum_replays=cusum_replays,
        outliers=outliers,
    )
    return updated, _told(updated)


def _told(belief: Belief) -> list[Caveat]:
    """What of the last update a reader must know."""
    caveats = []
    for j in np.flatnonzero(belief.event == OUTLIER):
        off, sigmas = belief.innovation[j], abs(belief.normalised_innovation[j])
        text = f"joint {j + 1}: {off:+.1%} from the expected friction, {sigmas:.1f} σ: not learnt from"
        caveats.append(Caveat("outlier", text))
    for j in np.flatnonzero(belief.event == STEP):
        text = f"joint {j + 1}: several replays off to one side, now by {belief.innovation[j]:+.1%}: taken as a change of the joint"
        caveats.append(Caveat("step", text))
    if (belief.event == UNSEEN).any():
        text = (
            f"joints {numbers(belief.event == UNSEEN)}: friction at {belief.reference_speed_rad_s:g} rad/s is not resolved in this replay"
        )
        caveats.append(Caveat("joint_unseen", text))
    if (belief.consistency > 2.5).any():  # 20 replays' mean of χ²(1): 2.5 is about 5 σ
        text = f"joints {numbers(belief.consistency > 2.5)}: replays scatter more than the filter believes"
        caveats.append(Caveat("filter_inconsistent", text))
    return caveats


def symmetric(P: Array) -> Array:
    """Rounding leaves a covariance slightly lopsided; this does not change it otherwise."""
    even: Array = 0.5 * (P + np.swapaxes(P, -1, -2))
    return even


def numbers(mask: np.ndarray) -> str:
    """The joints of a mask, counted from 1."""
    return " ".join(str(j + 1) for j in np.flatnonzero(mask))
