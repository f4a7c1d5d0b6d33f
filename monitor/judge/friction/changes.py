"""Changes: wear that jumps, or begins to grow, at any replay; their size is integrated out.

A candidate c is a replay and a sort: a small or a large step of wear, or a slow or a fast new rate, each N(0, V). The filter of a kind of
noise assumes that nothing changes. B_c = ∂(truth − estimate)/∂size follows the filter's own recursion, so with g = H·B_c, innovations e of
variance S:

    r = Σ w·g·e/S,   I = Σ g²/S,   W = Σ w·g²/S,
    LR_c = (1 + V·I)^−½·(1 + r²/(I + 1/V)/ν)^((ν+1)/2),   size | c ~ N(r·v, v),   v = 1/(W + 1/V)

w is Huber's weight of an innovation, 1 where it is no outlier: outliers prove little, and leave the size open. ν is the number of replays
that σ is known from, the arm's other joints among them; LR → exp(½r²/(I + 1/V))/√(1 + V·I). This is the likelihood ratio of Willsky and
Jones (1976) with the maximum over the size replaced by its mean over the prior. `bank` candidates are kept; the others are merged with an
older neighbour.
"""

from dataclasses import dataclass

import numpy as np

from monitor.judge.friction.states import RATE, WEAR
from monitor.recording import Array

STEP, NEW_RATE = range(2)
SHAPES = [STEP, STEP, NEW_RATE, NEW_RATE]  # of the sorts


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePriors:
    """How large changes are, and how many candidates are kept."""

    steps_std: tuple[float, float] = (0.04, 0.15)  # [log] small ones and large ones …
    rates_std: tuple[float, float] = (0.30 / 365.0, 3.0 / 365.0)  # [log/day] slow ones, and those of a joint that fails within weeks
    shares: tuple[float, float, float, float] = (0.4, 0.1, 0.4, 0.1)  # of the sorts
    a_year: float = 1.0  # of a joint
    bank: int = 16

    @property
    def variances(self) -> Array:
        """(4, 1) V of the sorts."""
        return np.array([[std**2] for std in (*self.steps_std, *self.rates_std)], np.float32)


@dataclass(slots=True, kw_only=True, eq=False)
class Bank:
    """Candidates, by kind of noise H, place C, sort of change 2 and channel N. float32: their evidence needs no more."""

    B: Array  # (H, D, C, 2, N)
    r: Array  # (H, C, 2, N)
    I: Array  # (H, C, 2, N)  # noqa: E741
    W: Array  # (H, C, 2, N) Σ w·g²/S
    days: Array  # (C, N) on which each may have begun
    born: np.ndarray  # (C,) number of the replay; −1: an empty place
    born_use: Array  # (C, N) usual days since the channel began …
    born_days: Array  # … and its age [days] then

    @classmethod
    def empty(cls, kinds: int, channels: int, states: int, priors: ChangePriors) -> "Bank":
        """No candidates."""
        H, C, N = kinds, priors.bank, channels
        return cls(
            B=np.zeros((H, states, C, 2, N), np.float32),
            r=np.zeros((H, C, 2, N), np.float32),
            I=np.zeros((H, C, 2, N), np.float32),
            W=np.zeros((H, C, 2, N), np.float32),
            days=np.zeros((C, N)),
            born=np.full(C, -1),
            born_use=np.zeros((C, N)),
            born_days=np.zeros((C, N)),
        )

    def forget(self, n: np.ndarray) -> None:
        """No candidate of the channels n (N,)."""
        self.days[:, n] = self.r[..., n] = self.I[..., n] = self.W[..., n] = self.B[..., n] = 0.0

    def add(self, number: int, days: Array, use: Array, age_days: Array) -> None:
        """A candidate that begins with the replay of that number. days : (N,) since the replay before; use : (N,) usual days so far."""
        i = self._place(number)
        self.born[i], self.days[i], self.born_use[i], self.born_days[i] = number, days, use, age_days
        self.r[:, i] = self.I[:, i] = self.W[:, i] = self.B[:, :, i] = 0.0
        self.B[:, WEAR, i, STEP] = self.B[:, RATE, i, NEW_RATE] = 1.0

    def _place(self, number: int) -> int:
        """A free place, or that of the candidate that is least missed between its neighbours; its days go to the older one."""
        free = np.flatnonzero(self.born < 0)
        if free.size:
            return int(free[0])
        order = np.argsort(self.born)
        born = self.born[order]
        lost = (born[2:] - born[:-2]) / (number - born[1:-1] + 1.0)
        i = int(np.argmin(lost)) + 1
        self.days[order[i - 1]] += self.days[order[i]]
        return int(order[i])

    def learn(self, H: Array, K: Array, e: Array, S: Array, w: Array, seen: np.ndarray) -> None:
        """The replay of row H (D, N), of the channels `seen` (N,): gain K (H, D, N), innovation e, its variance S and weight w, (H, N)."""
        states = np.flatnonzero(H.any(axis=1))
        row, gain, white, inverse, weight = (
            each.astype(np.float32) for each in (H * seen, K * (w * seen)[:, None], w * e / S * seen, 1.0 / S, w / S)
        )
        for h, B in enumerate(self.B):  # kind by kind: what is at hand fits a processor's cache
            g = row[states[0]] * B[states[0]]
            for i in states[1:]:
                g += row[i] * B[i]
            self.r[h] += g * white[h]
            square = g * g
            self.I[h] += square * inverse[h]
            self.W[h] += square * weight[h]
            for i in range(len(B)):
                B[i] -= g * gain[h, i]

    def evidence(self, replays: Array, priors: ChangePriors) -> Array:
        """(H, C, 4, N) log of days·LR of each candidate, by sort. replays : (N,) ν."""
        V = priors.variances.reshape(2, -1, 1)  # (2, 2, 1) by shape; the sorts are shape by shape
        nu = np.maximum(replays, 1.0).astype(np.float32)
        days = np.log(np.maximum(self.days, 1e-30))[:, None] + np.log(np.array(priors.shares))[:, None]
        of = days.astype(np.float32) - 0.5 * np.log(priors.variances)
        evidence = np.empty((len(self.r), *of.shape), np.float32)
        for h, (r, I) in enumerate(zip(self.r, self.I, strict=True)):  # kind by kind, in place: it takes half the time  # noqa: E741
            precision = I[:, :, None] + 1.0 / V
            fit = (r * r / nu)[:, :, None] / precision
            np.log1p(fit, out=fit)
            fit *= 0.5 * (nu + 1.0)
            np.log(precision, out=precision)
            precision *= 0.5
            fit -= precision
            np.add(fit.reshape(of.shape), of, out=evidence[h])
        return evidence

    def shares(self, replays: Array, priors: ChangePriors) -> tuple[Array, Array]:
        """Odds of a change against none (H, N), and the probability of each candidate given that one is true (H, C, 4, N).

        Which one it is, W tells: r and W are what replays weigh, as least squares with these weights see them. I counts an outlier in full,
        so that to it a large step looks as well like a small one, an earlier one, or a fast rate.
        """
        odds = priors.a_year / 365.0 * np.exp(np.minimum(self.evidence(replays, priors).astype(float), 80.0)).sum(axis=(1, 2))
        V, r, W = priors.variances, self.r[:, :, SHAPES], self.W[:, :, SHAPES]
        of = np.log(np.maximum(self.days, 1e-30))[:, None] + np.log(np.array(priors.shares))[:, None]
        fit = 0.5 * r**2 / (W + 1.0 / V) - 0.5 * np.log1p(V * W) + of
        share = np.exp(fit - fit.max(axis=(1, 2), keepdims=True)).astype(float)
        return odds, share / share.sum(axis=(1, 2), keepdims=True)

    def sizes(self, priors: ChangePriors) -> tuple[Array, Array]:
        """Mean and variance of each candidate's size, (H, C, 4, N) each."""
        v = 1.0 / (self.W[:, :, SHAPES] + 1.0 / priors.variances)
        return self.r[:, :, SHAPES] * v, v

    def sizes_at(self, h: np.ndarray, c: np.ndarray, k: np.ndarray, n: np.ndarray, priors: ChangePriors) -> tuple[Array, Array]:
        """The same of candidates by number, of each index (M,): kind of noise, place, sort, channel."""
        shape = np.array(SHAPES)[k]
        v = 1.0 / (self.W[h, c, shape, n] + 1.0 / priors.variances[k, 0])
        return self.r[h, c, shape, n] * v, v

    def effect_now(self, use: Array) -> Array:
        """(C, 4, N) wear by now of a unit change. use : (N,) usual days so far."""
        lasted = np.maximum(use - self.born_use, 1e-3)
        return np.stack([np.ones_like(lasted), lasted], axis=1)[:, SHAPES]

    def of(self, n: np.ndarray) -> "Bank":
        """The candidates of the channels n."""
        each = {name: getattr(self, name)[..., n] for name in ("B", "r", "I", "W", "days", "born_use", "born_days")}
        return Bank(born=self.born, **each)


def absorb(x: Array, P: Array, log_evidence: Array, bank: Bank, n: np.ndarray, replays: Array, priors: ChangePriors) -> None:
    """The change that channels n (numbers) have had becomes part of each kind's filter, in place; its date and sort stay unsure.

    The mixture over "nothing changed" and the candidates is collapsed to its moments, the evidence of each kind becomes its sum, and the
    bank begins anew. A kind of noise that sees no change keeps what it believes.
    """
    few = bank.of(n)
    size, v = (a.astype(float) for a in few.sizes(priors))
    odds, share = few.shares(replays[n], priors)
    log_evidence[:, n] += np.log1p(odds)
    w = share * (odds / (1.0 + odds))[:, None, None]
    B = few.B[:, :, :, SHAPES].astype(float)
    mean = np.einsum("hckn,hdckn->hdn", w * size, B)
    P[..., n] += np.einsum("hckn,hickn,hjckn->hijn", w * (v + size**2), B, B) - mean[:, :, None] * mean[:, None]
    x[..., n] += mean
    bank.forget(n)
