"""Whether the gains of the joints can be right: by the links that several joints move, and by the weight of the arm's own links.

A link's parameters stand in the equations of every joint inward of it. A gain that is wrong in one joint asks for other parameters than
the rest of the joints do, so this recording alone shows it, without any published mass. That holds of joints that weigh the arm: what
inertia alone tells of a gain is up to 30 % off on a sound real arm. Gains that are all wrong alike only scale the arm: that shows beside
the manufacturer's masses, with a payload of any mass at the flange left free.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.covariance import Causes
from monitor.identify.fit.fit import Fit, FitProblem
from monitor.identify.fit.jackknife import CORRELATED_S
from monitor.model.base import Base
from monitor.model.regressor import felt_columns, felt_weight
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Indices

SURE = 5.0  # standard deviations
APART = 0.12  # by which one gain contradicts the others; the joints of a real UR10e that carry the arm agree to 0.03
AS_WELL = 0.75  # of the explained square: another joint's gain explains the contradiction about as well
HEAVY = 0.045  # of the joint's largest torque, RMS: what the arm's own weight must be on a joint that weighs it
FEWEST_HEAVY = 2  # joints that weigh the arm
ALIKE = 1.25  # factor by which all gains may be off: published masses and the gains of another arm agree to 8 % on a real UR10e
OWN_SHARE = 0.2  # of the arm's weight that no payload at the flange can stand for
ROWS = 100  # places of all recordings together at which the weight is taken
FIRST_MOMENTS = 4  # m, mx, my, mz: what gravity feels of a payload


GAIN_DOUBTFUL = Sentence("gain_doubtful", "{why}")
OTHER_WEIGHT = Sentence(
    "other_weight",
    "joints {joints}: the arm's own links seem to weigh {factor:.3g} ± {std:.2g} times what the manufacturer says, "
    "whatever the arm carries: the gains of all joints, or the robot's model, are wrong",
)
OTHERS_DISAGREE = Sentence(
    "others_disagree",
    "joint {joint}: current or torque is {factor:.3g} ± {std:.2g} times what the other joints say of "
    "the links that they move as well{instead}: the joint's gain is wrong",
)
OR_THAT_OF = Sentence("or_that_of", "; or that of joint {joint} is {factor:.3g} ± {std:.2g} times")


class GainDoubt(NamedTuple):
    """How far each joint's torque contradicts the parameters that the other joints ask for, (J,) each; one joint at a time."""

    off: Array  # by so much of it the torque is too large
    std: Array
    explained: Array  # square of the residual that goes with it


def gain_warnings(problem: FitProblem, found: Fit, causes: Causes, robot: Robot, mounting: Mounting, base: Base) -> Iterator[Reason]:
    """Warnings about gains, for recordings whose fit is otherwise sound."""
    if problem.layout.frozen:
        return
    weighed = Weighed.of(problem, robot, mounting, base)
    if weighed is None:
        return
    doubt = gain_doubt(problem, causes)
    told = (np.abs(doubt.off) > APART) & (np.abs(doubt.off) > SURE * doubt.std)
    if told[list(weighed.joints)].any():
        yield _of_one_joint(doubt, [int(j) for j in np.flatnonzero(told)])
        return
    scale = arm_scale(problem, found, weighed)
    if scale is not None and abs(math.log(scale.factor)) > math.log(ALIKE) and abs(scale.factor - 1.0) > SURE * scale.std:
        yield GAIN_DOUBTFUL(why=OTHER_WEIGHT(joints=[j + 1 for j in scale.joints], factor=scale.factor, std=scale.std))


def _of_one_joint(doubt: GainDoubt, told: list[int]) -> Reason:
    """The joint whose gain explains most of the contradiction, and those that explain about as much."""
    worst = max(told, key=lambda j: float(doubt.explained[j]))
    others = [j for j in told if j != worst and doubt.explained[j] > AS_WELL * doubt.explained[worst]]
    instead = [OR_THAT_OF(joint=j + 1, factor=1.0 + doubt.off[j], std=doubt.std[j]) for j in others]
    found = {"joint": worst + 1, "factor": 1.0 + doubt.off[worst], "std": doubt.std[worst]}
    return GAIN_DOUBTFUL(why=OTHERS_DISAGREE(**found, instead=instead))


def gain_doubt(problem: FitProblem, causes: Causes) -> GainDoubt:
    """Each joint's gain beside the law of the residual friction, a delay and the warming."""
    columns, torque, rows = causes.gains()  # (r, J), (r,)
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, np.inf)
    along = columns.T @ torque / size  # (J,)
    rest = torque - columns @ np.linalg.lstsq(columns, torque, rcond=1e-6)[0]
    alike = max(1.0, CORRELATED_S * problem.equations[0].motion.rate_hz / causes.every)  # residuals agree for half a second
    std = math.sqrt(alike * float(rest @ rest) / max(rows, 1)) / size
    return GainDoubt(along / size, np.where(np.isfinite(size), std, np.inf), along**2)


class Weighed(NamedTuple):
    """The torque of gravity on the joints that weigh the arm, at some places of the recordings."""

    joints: tuple[int, ...]  # from 0
    nominal: list[Array]  # of each (n,): of the arm's own weight, by the manufacturer's masses
    blocks: list[Array]  # of each (n, K): columns of the base parameters whose weight it feels
    places: list[Indices]  # of each (K,): where these lie among the base parameters
    payload: Array  # (B, 4) base parameters of what a payload at the flange adds

    @classmethod
    def of(cls, problem: FitProblem, robot: Robot, mounting: Mounting, base: Base) -> "Weighed | None":
        """None where masses are not published."""
        J = robot.joints
        nominal = base.combination @ robot.nominal_parameters()
        if not np.all(np.isfinite(nominal)):
            return None
        step = max(1, sum(eq.motion.samples for eq in problem.equations) // ROWS)
        q = np.concatenate([eq.motion.q[::step] for eq in problem.equations])
        weighty = np.flatnonzero(np.array(base.columns) % PER_JOINT < FIRST_MOMENTS)
        felt = felt_columns([base.columns[k] for k in weighty], J, robot.innermost)
        blocks = [block[0].T for block in felt_weight(robot, robot.gravity(mounting)[:, None], felt, q)]
        places = [weighty[own] for own in felt.places]
        weights = [block @ nominal[own] for block, own in zip(blocks, places, strict=True)]
        joints = [j for j, weight in enumerate(weights) if math.sqrt(float(np.mean(weight**2))) > HEAVY * robot.max_torque_nm[j]]
        last = PER_JOINT * (J - 1)
        return cls(
            joints=tuple(joints),
            nominal=[weights[j] for j in joints],
            blocks=[blocks[j] for j in joints],
            places=[places[j] for j in joints],
            payload=base.combination[:, last : last + FIRST_MOMENTS],
        )


class ArmScale(NamedTuple):
    """The weight of the arm's own links over what the manufacturer says."""

    factor: float
    std: float
    joints: tuple[int, ...]  # from 0: those that weigh it


def arm_scale(problem: FitProblem, found: Fit, weighed: Weighed) -> ArmScale | None:
    """The factor on the manufacturer's weights that fits best beside any payload at the flange; None where too little weighs the arm.

    Only the torque of gravity counts: a payload adds its mass and first moments to the last link, and the factor is what the links inward
    of it need besides.
    """
    if len(weighed.joints) < FEWEST_HEAVY:
        return None
    sides, maps = [], []
    for j, nominal, block, places in zip(weighed.joints, weighed.nominal, weighed.blocks, weighed.places, strict=True):
        sides.append(found.weights[j] * np.column_stack([nominal, block @ weighed.payload[places]]))
        of_fit = np.zeros((len(block), len(weighed.payload)))
        of_fit[:, places] = found.weights[j] * block
        maps.append(of_fit * problem.layout.load)
    A, Y = np.concatenate(sides), np.concatenate(maps)  # (n, 5), (n, B)
    own = A[:, 0] - A[:, 1:] @ np.linalg.lstsq(A[:, 1:], A[:, 0], rcond=1e-6)[0]  # what no payload can stand for
    if not np.linalg.norm(own) > OWN_SHARE * np.linalg.norm(A[:, 0]):
        return None
    row = own @ Y / float(own @ A[:, 0])  # (B,) factor = row · parameters
    B = len(row)
    factor = float(row @ found.solution.values[:B])
    rate_hz = problem.equations[0].motion.rate_hz
    # weighted residuals have deviation 1, and agree for half a second
    std = math.sqrt(max(1.0, CORRELATED_S * rate_hz)) * float(np.linalg.norm(row @ found.solution.directions[:B]))
    return ArmScale(factor, std, weighed.joints) if factor > 0.0 else None
