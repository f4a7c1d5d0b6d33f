"""The clearance of an arm from itself and from its cell along a path, between the samples too.

A point of link i moves by Σ |Δqⱼ|·Lⱼᵢ at most, where Lⱼᵢ is the largest distance that any of its points can have from the axis of joint j.
So a gap with the values c₀ and c₁ at two neighbouring samples is between them at least (c₀ + c₁)/2 − ½·Σ |Δqⱼ|·Lⱼᵢ, where the sum is over
the joints that move the two bodies relative to each other.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.design.cell import Cell, rotation
from monitor.design.distance import between_segments, segment_to_box, segment_to_half_space
from monitor.design.shapes import Capsules, arm_capsules
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Indices, Mask

# Pairs of links with two joints between them, which every UR can turn all the way round. The manufacturer's meshes of UR3, UR5 and
# UR10 stay 0.3 mm or more apart; the capsules are larger and would always touch.
FREE_BY_DESIGN = ((3, 5), (4, 6))
CHUNK = 512  # samples at once: so many fit in the processor's cache


class Gaps(NamedTuple):
    """Smallest gaps at each of N samples; a negative gap is a penetration."""

    to_itself_m: Array  # (N,)
    to_cell_m: Array  # (N,) infinite where the cell is empty


class Nearest(NamedTuple):
    """The closest approach of two bodies along a path."""

    gap_m: float  # the least, between the samples too
    between: str  # the two bodies, e.g. "forearm and table-top"
    sample: int  # the sample nearest to it


class Clearance(NamedTuple):
    """The closest approaches along a path."""

    itself: Nearest
    cell: Nearest | None  # None: the cell is empty

    def keeps(self, cell: Cell) -> bool:
        """Whether both margins of the cell are kept."""
        return self.short_of(cell) is None

    def short_of(self, cell: Cell) -> str | None:
        """The bodies that are too near, their gap, and the missing distance, as a clause; None where both margins are kept."""
        for nearest, margin, key in ((self.cell, cell.margin_m, "margin_m"), (self.itself, cell.self_margin_m, "self_margin_m")):
            if nearest is not None and not nearest.gap_m >= margin:
                gap_mm, margin_mm = 1000.0 * nearest.gap_m, 1000.0 * margin
                how = f"{gap_mm:.1f} mm apart" if gap_mm >= 0.0 else f"{-gap_mm:.1f} mm inside each other"
                return f"{nearest.between} come to be {how}, {margin_mm - gap_mm:.1f} mm short of the {key} of {margin_mm:.0f} mm"
        return None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """An arm with its tool in its cell, prepared for many questions; `surroundings` makes it."""

    robot: Robot
    mounting: Mounting
    cell: Cell
    capsules: Capsules
    pairs: Indices  # (S, 2) pairs of capsules that can meet
    lever_m: Array  # (C, J) largest distance of a capsule's points from each joint's axis; 0 where the joint does not move it
    planes: tuple[tuple[str, Array, Array], ...]
    boxes: tuple[tuple[str, Array, Array, Array], ...]  # name, centre (3,), rotation (3, 3), half sizes (3,)

    def placed(self, q: Array) -> Array:
        """(N, C, 2, 3) ends of every capsule's axis in the cell's frame at q (N, J)."""
        R, p = frames(self.robot, self.mounting, q)  # (N, J+1, 3, 3), (N, J+1, 3)
        link, local = self.capsules.link, self.capsules.ends_m
        turn, origin = R.transpose(2, 3, 1, 0)[:, :, link], p.transpose(2, 1, 0)[:, link]  # (3, 3, C, N), (3, C, N)
        ends = np.empty((3, 2, len(link), len(q)))
        for e in range(2):
            ends[:, e] = origin + sum(turn[:, k] * local[:, e, k, None] for k in range(3))
        return ends.transpose(3, 2, 1, 0)

    def pair_gaps(self, ends: Array) -> Array:
        """(N, S) gap of every pair of capsules [m]. ends : as from `placed`."""
        first, second = self.pairs.T
        A, B = ends[:, first], ends[:, second]
        radii = self.capsules.radius_m[first] + self.capsules.radius_m[second]
        gaps: Array = between_segments(A[:, :, 0], A[:, :, 1], B[:, :, 0], B[:, :, 1]) - radii
        return gaps

    def cell_gaps(self, ends: Array) -> tuple[Array, Indices, list[str]]:
        """(N, K) gaps [m] of capsules to obstacles; (K,) the capsule of each gap; K names of the obstacles. ends : as from `placed`."""
        columns, which, names = [], [], []
        for name, point, normal in self.planes:
            # joint 1 turns the shoulder in a plane parallel to the surface, so neither shoulder nor base comes nearer to it
            square = abs(float(normal @ self.mounting.rotation @ self.robot.base_rotation[:, 2])) > 1.0 - 1e-9
            mobile = self._mobile(2 if square else 1)
            columns.append(segment_to_half_space(ends[:, mobile, 0], ends[:, mobile, 1], point, normal))
            which.append(mobile)
            names += [name] * len(mobile)
        for name, centre, turn, half in self.boxes:
            mobile = self._mobile(1)
            local = (ends[:, mobile] - centre) @ turn
            columns.append(segment_to_box(local[:, :, 0], local[:, :, 1], half))
            which.append(mobile)
            names += [name] * len(mobile)
        if not columns:
            return np.empty((len(ends), 0)), np.empty(0, dtype=np.intp), []
        capsule = np.concatenate(which)
        gaps: Array = np.concatenate(columns, axis=1) - self.capsules.radius_m[capsule]
        return gaps, capsule, names

    def gaps(self, q: Array) -> Gaps:
        """Smallest gaps at the samples q (N, J) only; an optimiser asks for this thousands of times."""
        ends = self.placed(q)
        cell, _, _ = self.cell_gaps(ends)
        return Gaps(self.pair_gaps(ends).min(axis=1), cell.min(axis=1) if cell.shape[1] else np.full(len(q), np.inf))

    def along(self, q: Array, bow_rad: Array | None = None) -> Clearance:
        """Closest approaches along the path through the samples q (N, J), between them too.

        bow_rad : (J,) travel of a joint beyond |Δq| between two samples, since the path between them is curved; None: 0.
        """
        itself: Nearest | None = None
        around: Nearest | None = None
        for first, pairs, (cell, capsule, names) in self._bounds(q, bow_rad):
            sample, column = np.unravel_index(np.argmin(pairs), pairs.shape)
            if itself is None or pairs[sample, column] < itself.gap_m:
                itself = Nearest(float(pairs[sample, column]), self._pair_name(int(column)), first + int(sample))
            if names:
                sample, column = np.unravel_index(np.argmin(cell), cell.shape)
                if around is None or cell[sample, column] < around.gap_m:
                    what = f"{self.capsules.names[capsule[column]]} and {names[int(column)]}"
                    around = Nearest(float(cell[sample, column]), what, first + int(sample))
        assert itself is not None  # N ≥ 1
        return Clearance(itself, around)

    def unproved(self, q: Array, bow_rad: Array | None = None) -> Mask:
        """(N − 1,) the intervals between samples in which the bound alone does not show that the cell's margins are kept."""
        unproved = np.zeros(len(q), dtype=bool)
        for first, pairs, (cell, _, names) in self._bounds(q, bow_rad):
            near = pairs.min(axis=1) < self.cell.self_margin_m
            if names:
                near |= cell.min(axis=1) < self.cell.margin_m
            unproved[first : first + len(near)] |= near
        return unproved[:-1]

    def _bounds(self, q: Array, bow_rad: Array | None) -> Iterator[tuple[int, Array, tuple[Array, Indices, list[str]]]]:
        """By chunks: the first sample, then lower bounds of the gaps of pairs and of the cell until the next sample."""
        travel = np.zeros(q.shape)  # to the next sample; 0 after the last
        travel[:-1] = np.abs(np.diff(q, axis=0)) + (0.0 if bow_rad is None else bow_rad)
        pair_lever = self._pair_lever()
        for first in range(0, max(1, len(q) - 1), CHUNK):
            part = q[first : first + CHUNK + 1]  # one more sample: the interval that leads to the next chunk
            step = travel[first : first + len(part) - 1]
            ends = self.placed(part)
            cell, capsule, names = self.cell_gaps(ends)
            bound = _lowest(cell, step @ self.lever_m[capsule].T)
            yield first, _lowest(self.pair_gaps(ends), step @ pair_lever.T), (bound, capsule, names)

    def line(self, start: Array, end: Array) -> Clearance:
        """Closest approaches along the straight line in joint space from start (J,) to end (J,), at any speed."""
        samples = max(2, int(np.ceil(np.max(np.abs(end - start)) / 0.002)) + 1)  # 2 mrad: a metre of lever moves by 2 mm
        return self.along(start + np.linspace(0.0, 1.0, samples)[:, None] * (end - start))

    def _mobile(self, from_link: int) -> Indices:
        """(C',) the capsules of links from this one outward."""
        return np.flatnonzero(self.capsules.link >= from_link)

    def _pair_lever(self) -> Array:
        """(S, J) lever of each pair: only the joints between the two links move them relative to each other."""
        low, high = (self.capsules.link[self.pairs[:, k]] for k in (0, 1))
        joint = np.arange(self.robot.joints)
        return np.where(joint >= low[:, None], self.lever_m[self.pairs[:, 1]], 0.0) * (joint < high[:, None])

    def _pair_name(self, pair: int) -> str:
        """The names of the two capsules, as a text."""
        first, second = (self.capsules.names[k] for k in self.pairs[pair])
        return f"{first} and {second}"


def surroundings(robot: Robot, mounting: Mounting, cell: Cell) -> Surroundings:
    """The arm in its cell.

    Raises BadInput for a robot whose shape is not known.
    """
    capsules = arm_capsules(robot.name)
    if cell.tool_capsules is not None:
        capsules = capsules.joined(cell.tool_capsules)
    link, tool = capsules.link, np.array([name == "tool" for name in capsules.names])
    far = link[None, :] - link[:, None] >= 2  # neighbouring links share a joint, and their housings touch by design
    for inner, outer in FREE_BY_DESIGN:
        far &= ~((link[:, None] == inner) & (link[None, :] == outer) & ~tool[None, :])
    first, second = np.nonzero(far)
    steps = np.hypot(robot.a_m, robot.d_m)  # (J,) from the origin of frame j to that of frame j + 1
    lever = np.zeros((len(link), robot.joints))
    for c, (i, reach) in enumerate(zip(link, capsules.reach_m, strict=True)):
        for j in range(i):
            lever[c, j] = np.sum(steps[j:i]) + reach
    turned = [(box.name, np.array(box.centre_m), rotation(box.rpy_deg), 0.5 * np.array(box.size_m)) for box in cell.boxes]
    return Surroundings(
        robot=robot, mounting=mounting, cell=cell, capsules=capsules, pairs=np.stack([first, second], axis=1),
        lever_m=lever, planes=cell.planes(mounting), boxes=tuple(turned),
    )  # fmt: skip


def frames(robot: Robot, mounting: Mounting, q: Array) -> tuple[Array, Array]:
    """Attitudes (N, J+1, 3, 3) and origins (N, J+1, 3) of the DH frames in the cell's frame, frame 0 first."""
    N, J = q.shape
    # memory runs along the samples: numpy is fast on long rows
    R, p = np.empty((3, 3, J + 1, N)), np.zeros((3, J + 1, N))
    R[:, :, 0] = (mounting.rotation @ robot.base_rotation)[:, :, None]
    angle = q.T + robot.zero_rad[:, None]  # (J, N)
    cos, sin = np.cos(angle), np.sin(angle)
    for i in range(J):
        x, y, z = R[:, 0, i], R[:, 1, i], R[:, 2, i]  # (3, N) each: the axes of frame i
        ca, sa = np.cos(robot.alpha_rad[i]), np.sin(robot.alpha_rad[i])
        ahead = cos[i] * x + sin[i] * y
        aside = cos[i] * y - sin[i] * x
        R[:, 0, i + 1], R[:, 1, i + 1], R[:, 2, i + 1] = ahead, ca * aside + sa * z, ca * z - sa * aside
        p[:, i + 1] = p[:, i] + robot.d_m[i] * z + robot.a_m[i] * ahead
    return R.transpose(3, 2, 0, 1), p.transpose(2, 1, 0)


def _lowest(gaps: Array, travel_m: Array) -> Array:
    """(N − 1, K) lower bounds of gaps (N, K) between two samples, by travel_m (N − 1, K). Of a single sample: its own gaps."""
    if len(gaps) == 1:
        return gaps
    between = 0.5 * (gaps[:-1] + gaps[1:] - travel_m)
    lowest: Array = np.minimum(between, np.minimum(gaps[:-1], gaps[1:]))
    return lowest
