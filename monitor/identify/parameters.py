"""What a fit says of an arm: the paper's base parameters with their covariances, and the law of the residual friction."""

from typing import NamedTuple

import numpy as np

from monitor.identify.fit.covariance import Causes, covariances, law_doubt, mapped, positive
from monitor.identify.fit.fit import Fit, FitProblem, mean_load, projection, refit
from monitor.identify.identification import QUOTED_SPEEDS_RAD_S, FrictionFit, Identification, ResidualFrictionFit
from monitor.identify.validate import errors_of
from monitor.model.friction import PAPER, residual_law
from monitor.recording import Array, Mask


class PaperParameters(NamedTuple):
    """The fit in the base parameters of the paper; the fields are those of `Identification`."""

    values: Array
    covariance: Array
    coulomb_nm: Array
    viscous_nm_s_per_rad: Array
    friction_cov: Array
    friction: FrictionFit | None
    total_covariance: Array
    misfit_cov: Array
    paper_d: Array


def paper_parameters(problem: FitProblem, found: Fit, causes: Causes, rigid_from: Identification | None) -> PaperParameters:
    """The paper's base parameters and their covariances, whatever the friction law. causes : as in `covariances`."""
    layout, solution = problem.layout, found.solution
    sure = covariances(problem, found, causes)
    covariance = sure.noise
    richer_law = found.law != PAPER  # a line needs no load
    loads = [eq.load(solution.values[: len(problem.prior)], layout) for eq in problem.equations] if richer_law else []
    M, places = projection(problem, loads, found), layout.of_law(found.law)  # (B, X), (J, K)
    values, base_covariance = M @ solution.values, mapped(M, covariance)
    total = base_covariance + mapped(M, sure.leaning)
    misfit = mapped(M, sure.lasting) - mapped(M, np.nan_to_num(covariance))
    if rigid_from is not None:
        values[layout.rigid] = rigid_from.values[layout.rigid]
        rigid = np.ix_(layout.rigid, layout.rigid)
        base_covariance[rigid] = rigid_from.covariance[rigid]
        total[rigid] = (rigid_from.covariance if rigid_from.total_covariance is None else rigid_from.total_covariance)[rigid]
    excited, both = np.all(solution.excited[places], axis=1), problem.both_ways  # (J,)
    told = np.stack(
        [excited & both, excited], axis=1
    )  # (J, 2) fc and fv: an offset of the drive passes for fc of a joint that turns one way
    pair = layout.friction[:, :, None], layout.friction[:, None, :]
    coulomb, viscous = np.where(told, values[layout.friction], np.nan).T  # (J,), (J,)
    speeds = np.max([np.max(np.abs(eq.motion.qd), axis=0) for eq in problem.equations], axis=0)  # (J,)
    off = law_doubt(problem, sure.upright, values[layout.friction], QUOTED_SPEEDS_RAD_S)  # (J,) [N·m]
    another = np.array([off_nm**2 * np.diag([1.0, 1.0 / max(speed, 0.1) ** 2]) for off_nm, speed in zip(off, speeds, strict=True)])
    misfit_cov = np.where(told[:, :, None] & told[:, None], positive(misfit[pair]) + another, np.nan)
    total[pair] += misfit_cov
    richer = None
    if richer_law:
        richer = FrictionFit(
            law=found.law,
            values=np.where(both[:, None], solution.values[places], np.nan),
            covariance=covariance[places[:, :, None], places[:, None, :]],
            load_nm=mean_load(problem, loads),
        )
    return PaperParameters(
        values=values,
        covariance=base_covariance,
        coulomb_nm=coulomb,
        viscous_nm_s_per_rad=viscous,
        friction_cov=base_covariance[pair],
        friction=richer,
        total_covariance=total,
        misfit_cov=misfit_cov,
        paper_d=np.linalg.norm((M @ solution.directions), axis=1),
    )


def residual_friction(problem: FitProblem, paper: Fit, moving: Mask) -> ResidualFrictionFit:
    """The law of the residual friction on the same equations. moving : (N, J) the samples of all motions whose residual counts."""
    law, B = residual_law(), len(problem.prior)
    solution, residuals = refit(problem, paper, law)
    values, places = solution.values, problem.layout.of_law(law)
    loads = [np.where(eq.used, np.abs(eq.load(values[:B], problem.layout)), 0.0) for eq in problem.equations]
    left = np.concatenate(residuals)
    return ResidualFrictionFit(
        law=law,
        rigid=values[:B],
        friction=np.where(np.all(solution.excited[places], axis=1)[:, None], values[places], np.nan),
        load_nm=np.max(np.concatenate(loads), axis=0),
        rms_nm=errors_of(left, np.zeros_like(left), moving).rms_nm,
    )
