"""The correlation of the noise of successive replays, from all joints of an arm: how alike they are.

Joints differ where what disturbs them does: one whose grease creeps for weeks stands among joints that only scatter. A change is judged by
how far noise moves a mean of replays, σ²(1+ρ)/(1−ρ) over their number: with the ρ of its arm, 0.5, instead of its own, 0.9, a healthy joint
seems worn every few months.

Shapes: N joints, J per arm.
"""

import numpy as np

from monitor.judge.drift.noise.shrinkage import shrunk
from monitor.recording import Array

# Variance of arcsin ρ of n replays, times n: 1 where only the noise is unknown (Bartlett, 1946). Between the joints of simulated arms that
# have one ρ it is 1.0 to 1.5 of noise of 2 %, up to 3 where noise within the replay is half of it, and up to 3.3 of 1/f noise. So joints
# differ clearly only from CLEAR times the first on.
CHANCE, CLEAR = 1.5, 2.5
APART_VAR, APART_JOINTS = 5e-4, 4.0  # prior variance of arcsin ρ between the joints of an arm, and its weight in joints


def own_correlation(seen: Array, centre: Array, shown: Array, replays: Array, joints_per_arm: int) -> Array:
    """(N,) ρ of each joint, nearer to the arm's the less the joints of this arm differ beyond chance.

    seen : (N,) ρ of each joint alone, and centre : (N,) their middle in the arm. shown : (N,) ρ of the arm, with its prior. replays : (N,)
    that ρ was seen in. The scatter of arcsin ρ is about the same for every ρ. Beginning wear of one joint looks like correlated noise;
    a single joint must differ by several deviations of chance before it is believed.
    """
    J = joints_per_arm
    away = (_angle(seen) - _angle(centre)).reshape(-1, J)
    chance = CHANCE / replays.reshape(-1, J)
    told = chance.min(axis=1, keepdims=True) / chance  # a joint that is never resolved does not say that the others are alike
    nearer = shrunk(away, chance, prior_var=APART_VAR, prior_joints=APART_JOINTS, clear=CLEAR, told=told)
    own: Array = np.sin(np.clip(_angle(shown) + nearer.ravel(), -0.5 * np.pi, 0.5 * np.pi))
    return own


def _angle(rho: Array) -> Array:
    """Arcsin ρ; estimates of few replays may lie outside −1 … 1."""
    angle: Array = np.arcsin(np.clip(rho, -1.0, 1.0))
    return angle
