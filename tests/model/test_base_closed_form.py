"""Every coefficient of the appendix against a closed form that never sees a regressor.

What the torques cannot tell apart is a mass moved between neighbours: whatever is symmetric about the axis of joint i (a point mass on
it, or a ring around it) may belong to link i or to link i − 1. Mayeda et al. (1990), Gautier and Khalil (1990). The parameters of such
bodies follow from a, d and α by the parallel-axis theorem alone; eliminating the rightmost parameters gives the basis.
"""

import numpy as np
import pytest

from monitor.errors import BadInput
from monitor.model.base import base_parameters
from monitor.model.identifiable import FRAMES, base_document, individually_identifiable, inertial_change
from monitor.model.regressor import parameter_names, regressor
from monitor.model.robot import PER_JOINT, Mounting, load_robot, robot_names

NAMES = parameter_names(6)
AT = {name: k for k, name in enumerate(NAMES)}
UPRIGHT, TILTED = ("ground", "ceiling"), ("wall", "30,40,50", "0.5,0,0")


def body(link, points):
    """Standard parameters of point masses (kg, x, y, z) on one link, about its DH origin."""
    p = np.zeros(len(NAMES))
    for m, *at in points:
        r = np.array(at)
        J = m * (r @ r * np.eye(3) - np.outer(r, r))
        p[PER_JOINT * link : PER_JOINT * link + 10] += [m, *(m * r), J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2]]
    return p


def unit(name):
    e = np.zeros(len(NAMES))
    e[AT[name]] = 1.0
    return e


def seen_from_link(robot, i, x, y, z):
    """A point given in frame i − 1 (turned by qᵢ, so z is joint i's axis), in frame i."""
    c, s = np.cos(robot.alpha_rad[i]), np.sin(robot.alpha_rad[i])
    x, z = x - robot.a_m[i], z - robot.d_m[i]
    return x, c * y + s * z, -s * y + c * z


def ring(robot, i, link):
    """Four points 1 m around joint i's axis, fixed to link i or to link i − 1: both see the same ring, at q = 0."""
    around = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]
    return body(link, [(0.25, *(seen_from_link(robot, i, *r) if link == i else r)) for r in around])


def on_axis(robot, i, link, height):
    return body(link, [(1.0, *(seen_from_link(robot, i, 0.0, 0.0, height) if link == i else (0.0, 0.0, height)))])


def invisible(robot, upright):
    """Rows: every combination of standard parameters that no torque depends on, by mechanics."""
    rows = []
    for i in range(1, 6):
        for height in (-1.0, 0.0, 1.0):  # three points determine m, m·z and Σzz on the axis
            rows.append(on_axis(robot, i, i, height) - on_axis(robot, i, i - 1, height))
    # link 1 turns about a fixed axis, its own y: only the inertia about it shows, together with the rotor's ...
    hidden = ["m1", "m1y1", "J1xx", "J1xy", "J1xz", "J1yz", "J1zz"]
    # ... and its weight where the axis is not along gravity
    rows += [unit(name) for name in hidden + (["m1x1", "m1z1"] if upright else [])]
    rows.append(unit("J1yy") - unit("Im1"))
    # a ring around axis 2 may sit on link 1, where it does not spin: link 2's spin is then a rotor's, as axis 1 ⊥ axis 2 adds none to it
    rows.append(ring(robot, 1, 1) - ring(robot, 1, 0) - unit("Im2"))
    return np.array(rows)


def eliminated(rows):
    """Gauss–Jordan from the right: each row ends in a 1 where no other row has anything. Returns rows and those places."""
    rows, ends = rows.copy(), []
    done = 0
    for k in reversed(range(rows.shape[1])):
        best = done + int(np.argmax(np.abs(rows[done:, k]))) if done < len(rows) else -1
        if best < 0 or abs(rows[best, k]) < 1e-9:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, k]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, k] * rows[done]
        ends.append(k)
        done += 1
    return rows[:done], ends


@pytest.mark.parametrize("name", robot_names())
@pytest.mark.parametrize("mounting", UPRIGHT + TILTED)
def test_every_coefficient_equals_its_closed_form(name, mounting):
    """The basis and all its coefficients, for every model: 1e-8 of the largest, where 1e-4 is what the paper's digits need.

    Half a degree of tilt leaves 1e-2 of a column's digits to rounding: 1e-6 there.
    """
    robot, attitude = load_robot(name), Mounting.parse(mounting)
    base = base_parameters(robot, attitude)
    rows, ends = eliminated(invisible(robot, upright=mounting in UPRIGHT))
    assert sorted(set(range(len(NAMES))) - set(ends)) == list(base.columns)
    expected = np.zeros_like(base.combination)
    expected[:, list(base.columns)] = np.eye(base.count)
    for row, k in zip(rows, ends, strict=True):  # Y·row = 0: column k is minus the kept columns times the row
        expected[:, k] = -row[list(base.columns)]
    tolerance = 1e-6 if mounting == "0.5,0,0" else 1e-8
    assert np.max(np.abs(base.combination - expected)) <= tolerance * np.max(np.abs(expected))
    assert np.array_equal(np.abs(base.combination) > 1e-6, np.abs(expected) > 1e-6)  # the same terms, none of rounding


@pytest.mark.parametrize("mounting", ["ground", "wall"])
def test_the_closed_form_has_no_torque(mounting):
    """The oracle's own oracle: Y times each of its rows is rounding of the regressor's entries."""
    robot, attitude = load_robot("ur5"), Mounting.parse(mounting)
    Y = regressor(robot, attitude, *np.random.default_rng(1).uniform(-3, 3, (3, 20, 6)))
    assert np.max(np.abs(Y @ invisible(robot, mounting == "ground").T)) <= 1e-12 * np.max(np.abs(Y))


@pytest.mark.parametrize(("name", "a2", "a3", "d4", "d5", "d6"), [
    ("ur3", 0.24365, 0.21325, 0.11235, 0.08535, 0.0819),
    ("ur5", 0.425, 0.39225, 0.10915, 0.09465, 0.0823),
])  # fmt: skip
def test_the_appendix_rows_by_hand(name, a2, a3, d4, d5, d6):
    """Rows of A1 and A2 as formulas of the published lengths; the paper prints them with three decimals."""
    terms = {next(iter(row)): row for row in base_parameters(load_robot(name), Mounting.parse("wall")).terms}
    by_hand = {
        "m1z1": {"J2xz": -1 / a2},
        "m2": {"J2zz": -1 / a2**2, "Im2": -1 / a2**2, "J3zz": 1 / a3**2},
        "m2x2": {"J2zz": -1 / a2, "Im2": -1 / a2},
        "m2z2": {"J2xz": 1 / a2, "J3xz": -1 / a3},
        "m3": {"J3zz": -1 / a3**2, "m4": 1.0, "m5": 1.0, "m6": 1.0},
        "m3x3": {"J3zz": -1 / a3},
        "m3z3": {"J3xz": 1 / a3, "m4": d4, "m4y4": 1.0, "m5": d4, "m6": d4},
        "m4z4": {"m5": d5, "m5y5": -1.0, "m6": d5},
        "J4yy": {"m5": d5**2, "m5y5": -2 * d5, "J5zz": 1.0, "m6": d5**2},
        "m5z5": {"m6": d6, "m6z6": 1.0},
        "J5yy": {"m6": d6**2, "m6z6": 2 * d6, "J6yy": 1.0},
        "J1yy": {"Im1": 1.0, "J2yy": 1.0, "J2zz": -1.0, "Im2": -1.0, "J3yy": 1.0, "J3zz": -1.0,
                 "m4": d4**2, "m4y4": 2 * d4, "J4zz": 1.0, "m5": d4**2, "m6": d4**2},
    }  # fmt: skip
    for lead, others in by_hand.items():
        assert terms[lead] == pytest.approx({lead: 1.0, **others}, rel=1e-6)  # rounding; lengths are given exactly


@pytest.mark.parametrize("name", ["ur3", "ur5"])
@pytest.mark.parametrize(("mounting", "columns", "paper"), [
    ("ground", (36, 33, 9), (30, 39, 9)),
    ("ceiling", (36, 33, 9), (30, 39, 9)),
    ("wall", (37, 34, 7), (30, 42, 6)),
])  # fmt: skip
def test_both_ways_of_counting_agree(name, mounting, columns, paper):
    """By columns, and as the paper counts, from one rule: a first moment is a product of a mass and a coordinate."""
    base = base_parameters(load_robot(name), Mounting.parse(mounting))
    assert base.by_column.counts == columns
    assert base.as_in_paper.counts == paper
    for classes in (base.by_column, base.as_in_paper):
        assert sorted(sum(classes, ())) == sorted(NAMES)


def test_singular_values_fall_off_and_their_energy_adds_up():
    """Figure 1: 52 values above the cliff; the cumulative energy never falls and ends at 1."""
    base = base_parameters(load_robot("ur3"), Mounting())
    assert np.all(np.diff(base.singular_values) <= 0.0)
    assert np.all(np.diff(base.cumulative_energy) >= 0.0)
    assert base.cumulative_energy[51] == pytest.approx(1.0, abs=1e-12)
    assert base.cumulative_energy[0] == pytest.approx(base.singular_values[0] ** 2 / np.sum(base.singular_values**2))


@pytest.mark.parametrize("mounting", ["ground", "wall"])
def test_in_the_papers_frames_individually_identifiable_is_a_column_of_its_own(mounting):
    """The row-space criterion and the columns agree: neither depends on the chosen basis."""
    robot, attitude = load_robot("ur5"), Mounting.parse(mounting)
    assert individually_identifiable(robot, attitude) == base_parameters(robot, attitude).by_column


@pytest.mark.parametrize("frames", ["modified-dh", "joint"])
def test_individually_identifiable_in_other_frames_means_that_no_invisible_change_contains_it(frames):
    """A parameter is individually identifiable exactly where no combination without torque contains it: here by the closed form."""
    robot = load_robot("ur5")
    classes = individually_identifiable(robot, Mounting.parse("wall"), frames)
    change = np.eye(len(NAMES))
    for i, frame in enumerate(FRAMES[frames](robot)):
        change[13 * i : 13 * i + 10, 13 * i : 13 * i + 10] = inertial_change(*frame)
    moved = np.linalg.solve(change, invisible(robot, upright=False).T)  # (78, 24) in the other frames
    untouched = {name for name, row in zip(NAMES, moved, strict=True) if np.max(np.abs(row)) < 1e-9}
    assert set(classes.fully) == untouched
    assert classes != individually_identifiable(
        robot, Mounting.parse("wall")
    )  # the classes depend on the frames: m2 is in sums here, and without effect there


def test_in_a_turned_frame_fewer_parameters_are_individually_identifiable():
    """Link 6 written in axes turned by 30° about its flange's x: Jxy and Jxz mix and stay so; Jyz and Jzz mix with sums and do not."""
    robot = load_robot("ur5")
    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    frames = [(np.eye(3), np.zeros(3))] * 5 + [(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.zeros(3))]
    lost = set(individually_identifiable(robot, Mounting()).fully) - set(individually_identifiable(robot, Mounting(), frames).fully)
    assert lost == {"m6y6", "J6yz", "J6zz"}


def test_moments_in_another_frame_equal_those_of_pinocchio():
    """The 10×10 change of frame against pinocchio's transport of an inertia, to rounding."""
    import pinocchio as pin

    rng = np.random.default_rng(3)
    where = pin.SE3.Random()
    inertia = pin.Inertia.Random()

    def parameters(body):
        p = body.toDynamicParameters()  # m, h, Ixx Ixy Iyy Ixz Iyz Izz about the origin
        return np.array([*p[:6], p[7], p[6], p[8], p[9]])

    change = inertial_change(where.rotation, where.translation)
    np.testing.assert_allclose(change @ parameters(inertia), parameters(where.act(inertia)), atol=1e-12 * (1 + rng.uniform()))


def test_unknown_frames_are_refused():
    """By name, and by count."""
    robot = load_robot("ur5")
    with pytest.raises(BadInput, match="known are standard-dh, modified-dh, joint"):
        individually_identifiable(robot, Mounting(), "craig")
    with pytest.raises(BadInput, match="expected 6"):
        individually_identifiable(robot, Mounting(), [(np.eye(3), np.zeros(3))])


def test_a_tilt_of_half_a_degree_has_a_note():
    """The rank is 54, with a note on how little of it a recording can show; a level base has no note."""
    robot = load_robot("ur3")
    document = base_document(robot, Mounting.parse("0.5,0,0"))
    assert document["count"] == 54
    assert len(document["notes"]) == 1
    assert "m1x1" in document["notes"][0]
    assert "0.5°" in document["notes"][0]
    assert base_document(robot, Mounting())["notes"] == []
