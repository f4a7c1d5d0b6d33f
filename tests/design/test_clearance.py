"""Distances against those of coal, bounds against dense sampling, shapes against the extents of published meshes."""

import coal
import numpy as np
import pytest
from dense_check import judge
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.design.cell import Box, Cell, Tool, Wall, cell_from_document, plain_cell
from monitor.design.clearance import frames, surroundings
from monitor.design.distance import between_segments, segment_to_box
from monitor.design.shapes import SIZES, arm_capsules, around_cylinder
from monitor.errors import BadInput
from monitor.model.robot import Mounting, load_robot

GROUND = Mounting()
UPRIGHT = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])
points = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)
# coal's GJK stops within 1e-6 of the distance
GJK_M = 2e-6

# least and greatest corner of each link's published collision mesh in its DH frame [m], frames 0 to 6
MESHES = {
    "ur3": (
        ((-0.064, -0.064, -0.0007), (0.064, 0.0995, 0.086)), ((-0.0453, -0.0658, -0.0459), (0.0456, 0.0571, 0.054)),
        ((-0.0387, -0.0456, 0.054), (0.2895, 0.0456, 0.1771)), ((-0.0321, -0.0376, -0.0192), (0.2507, 0.0375, 0.078)),
        ((-0.0322, -0.0464, -0.0464), (0.0323, 0.0303, 0.0424)), ((-0.0322, -0.0301, -0.0481), (0.0321, 0.0467, 0.0406)),
        ((-0.0318, -0.0358, -0.0413), (0.0317, 0.0338, -0.0014)),
    ),
    "ur5": (
        ((-0.0736, -0.0736, -0.003), (0.0736, 0.11, 0.021)), ((-0.0595, -0.0652, -0.0597), (0.0594, 0.0685, 0.0705)),
        ((-0.0599, -0.0595, 0.0706), (0.4847, 0.0599, 0.2044)), ((-0.039, -0.0585, -0.041), (0.4502, 0.0579, 0.0707)),
        ((-0.0386, -0.0455, -0.0572), (0.0389, 0.0395, 0.0475)), ((-0.0389, -0.0387, -0.0572), (0.0387, 0.0455, 0.0475)),
        ((-0.0375, -0.043, -0.035), (0.0375, 0.0375, -0.0005)),
    ),
    "ur10": (
        ((-0.075, -0.0751, 0.0), (0.075, 0.092, 0.038)), ((-0.0755, -0.089, -0.0754), (0.0755, 0.0881, 0.086)),
        ((-0.0624, -0.0752, 0.0859), (0.6865, 0.0754, 0.2632)), ((-0.0472, -0.06, -0.02), (0.631, 0.0602, 0.1164)),
        ((-0.0457, -0.054, -0.0568), (0.0453, 0.0461, 0.062)), ((-0.0456, -0.0464, -0.0573), (0.0457, 0.0537, 0.0616)),
        ((-0.045, -0.046, -0.0306), (0.045, 0.0441, -0.0001)),
    ),
}  # fmt: skip


def placed_box(half, rpy_deg=(0.0, 0.0, 0.0), centre=(0.0, 0.0, 0.0)):
    from monitor.design.cell import rotation

    return coal.CollisionObject(coal.Box(*(2.0 * np.array(half))), rotation(rpy_deg), np.array(centre))


def placed_capsule(p, q, radius):
    """coal's capsule lies along z about its middle."""
    length = float(np.linalg.norm(q - p))
    z = (q - p) / length if length > 0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return coal.CollisionObject(coal.Capsule(radius, length), np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (p + q))


def distance(one, other):
    return coal.distance(one, other, coal.DistanceRequest(), coal.DistanceResult())


@given(p1=points, q1=points, p2=points, q2=points)
def test_the_distance_of_two_segments_equals_that_of_coal(p1, q1, p2, q2):
    """Thin capsules apart from each other: coal, the library for collision checking, gives the reference."""
    ours = float(between_segments(p1, q1, p2, q2))
    theirs = distance(placed_capsule(p1, q1, 1e-4), placed_capsule(p2, q2, 1e-4)) + 2e-4
    if ours > 1e-3:  # at smaller distances coal returns penetration depths
        assert ours == pytest.approx(theirs, abs=GJK_M)
    else:
        assert theirs < 1e-3 + GJK_M


@given(p=points, way=points, s=st.floats(0.0, 1.0), t=st.floats(0.0, 1.0), shift=points)
def test_the_distance_of_parallel_segments_equals_that_of_brute_force(p, way, s, t, shift):
    """Where the closest points are many, a formula may pick a wrong pair."""
    q, p2 = p + way, p + s * way + shift
    q2 = p2 + t * way
    ours = float(between_segments(p, q, p2, q2))
    grid = np.linspace(0.0, 1.0, 101)
    one, other = p + grid[:, None] * (q - p), p2 + grid[:, None] * (q2 - p2)
    brute = np.min(np.linalg.norm(one[:, None] - other[None], axis=2))
    # sampling at 1 % of each length, at most √3 long twice over, misses the closest pair by no more
    assert brute - 0.02 * np.linalg.norm(way) <= ours <= brute + 1e-9


@given(p=points, q=points, half=st.lists(st.floats(0.05, 0.8), min_size=3, max_size=3).map(np.array))
def test_the_distance_of_a_segment_to_a_box_equals_that_of_coal_and_is_never_more(p, q, half):
    """Outside, both agree. Inside, both report an overlap."""
    ours = float(segment_to_box(p, q, half))
    theirs = distance(placed_box(half), placed_capsule(p, q, 1e-4)) + 1e-4
    if ours > 1e-3:
        assert ours == pytest.approx(theirs, abs=GJK_M)
    else:
        assert theirs < 1e-3 + GJK_M


@given(start=points, end=points, radius=st.floats(0.01, 0.2), along=st.floats(0.0, 1.0), angle=st.floats(0.0, 2 * np.pi))
def test_a_capsule_around_a_cylinder_holds_its_edges(start, end, radius, along, angle):
    """Every point of the mantle is inside, the rims of the flat ends too, also of a flat disc."""
    if np.linalg.norm(end - start) < 1e-6:
        end = start + np.array([0.0, 0.0, 1e-3])
    z = (end - start) / np.linalg.norm(end - start)
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    rim = radius * (np.cos(angle) * x + np.sin(angle) * np.cross(z, x))
    p, q, fat = around_cylinder(start, end, radius)
    for share in (0.0, along, 1.0):
        point = start + share * (end - start) + rim
        assert between_segments(p, q, point, point) <= fat + 1e-12


@pytest.mark.parametrize("name", sorted(SIZES))
def test_the_frames_equal_those_of_pinocchio(name):
    """Orientation and position of every DH frame are equal, on ceiling and wall too."""
    import pinocchio as pin

    robot = load_robot(name)
    model = robot.pinocchio_model()
    data = model.createData()
    rng = np.random.default_rng(1)
    for mounting in (GROUND, Mounting.parse("ceiling"), Mounting.parse("90,20,30")):
        q = rng.uniform(-3.0, 3.0, (4, 6))
        R, p = frames(robot, mounting, q)
        for n in range(4):
            pin.framesForwardKinematics(model, data, q[n])
            for i in range(1, 7):
                placed = data.oMf[model.getFrameId(f"dh_{i}")]
                np.testing.assert_allclose(R[n, i], mounting.rotation @ placed.rotation, atol=1e-12)
                np.testing.assert_allclose(p[n, i], mounting.rotation @ placed.translation, atol=1e-12)


@pytest.mark.parametrize("name", sorted(MESHES))
def test_the_capsules_reach_as_far_as_the_published_meshes(name):
    """In every direction of every link's frame. A housing that turns about its own axis is fixed to the link before it."""
    capsules, robot = arm_capsules(name), load_robot(name)
    R, p = frames(robot, GROUND, UPRIGHT[None])
    for i, (least, greatest) in enumerate(MESHES[name]):
        mine = np.flatnonzero((capsules.link == i) | (capsules.link == i - 1))
        link = capsules.link[mine]
        world = np.einsum("cij,cej->cei", R[0, link], capsules.ends_m[mine]) + p[0, link, None]
        local = (world - p[0, i]) @ R[0, i]
        radius = capsules.radius_m[mine, None]
        assert np.all(np.min(local.min(axis=1) - radius, axis=0) <= least), i
        assert np.all(np.max(local.max(axis=1) + radius, axis=0) >= greatest), i


@pytest.mark.parametrize("name", sorted(SIZES))
def test_an_upright_arm_is_clear_of_itself_and_of_its_table(name):
    """Pairs that always touch are not checked, because otherwise no trajectory could be designed."""
    cell = plain_cell(GROUND)
    assert surroundings(load_robot(name), GROUND, cell).line(UPRIGHT, UPRIGHT).keeps(cell)


@pytest.mark.parametrize("q3", [2.9, -2.9])
def test_a_folded_elbow_and_a_pose_through_the_table_are_detected(q3):
    """So the check can fail."""
    cell = plain_cell(GROUND)
    around = surroundings(load_robot("ur5"), GROUND, cell)
    folded = np.array([0.0, -np.pi / 2, q3, 0.0, 0.0, 0.0])
    assert around.gaps(folded[None]).to_itself_m[0] < 0.0
    down = np.array([0.0, 0.4, 0.0, 0.0, 0.0, 0.0])
    assert around.gaps(down[None]).to_cell_m[0] < 0.0


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25)
@pytest.mark.slow
def test_between_the_samples_no_distance_is_below_the_bound(seed):
    """A coarse path with its bound against the same path sampled fifty times finer, self and cell, with a box and a tool."""
    rng = np.random.default_rng(seed)
    cell = Cell(
        walls=(Wall(name="wall", point_m=(0.0, 0.5, 0.0), normal=(0.0, -1.0, 0.2)),),
        boxes=(Box(name="box", centre_m=(0.5, 0.0, 0.3), size_m=(0.3, 0.3, 0.3), rpy_deg=(10.0, 20.0, 30.0)),),
        tool=Tool(shape="capsule"),
    )
    robot = load_robot("ur5")
    around = surroundings(robot, GROUND, cell)
    start, way = UPRIGHT + rng.uniform(-1.0, 1.0, 6), rng.uniform(-1.0, 1.0, 6)
    curl = rng.uniform(-0.3, 0.3, 6)

    def path(s):
        return start + np.outer(s, way) + np.outer(s**2, curl)

    coarse = np.linspace(0.0, 1.0, 9)
    bow = 0.25 * 2.0 * np.abs(curl) * (1.0 / 8.0) ** 2  # |q''| = 2·curl
    bound = around.along(path(coarse), bow)
    fine = around.gaps(path(np.linspace(0.0, 1.0, 401)))
    assert bound.itself.gap_m <= fine.to_itself_m.min() + 1e-12
    assert bound.cell is not None
    assert bound.cell.gap_m <= fine.to_cell_m.min() + 1e-12


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25)
def test_coal_with_the_true_shapes_finds_no_smaller_clearance(seed):
    """Tools as boxes, turned boxes, planes: an independent check of the whole chain, frames by pinocchio, distances by coal."""
    rng = np.random.default_rng(seed)
    cell = Cell(
        table_top_m=-0.1,
        boxes=(Box(name="box", centre_m=(0.6, 0.1, 0.3), size_m=(0.3, 0.2, 0.4), rpy_deg=tuple(rng.uniform(-90, 90, 3).tolist())),),
        tool=Tool(shape="box", centre_m=(0.01, 0.0, 0.08), size_m=(0.06, 0.12, 0.16), rpy_deg=(10.0, 5.0, 40.0)),
    )
    mounting = Mounting.parse(str(rng.choice(["ground", "ceiling", "wall"])))
    robot = load_robot(str(rng.choice(sorted(SIZES))))
    q = rng.uniform(-2.5, 2.5, (3, 6))
    ours = surroundings(robot, mounting, cell).gaps(q)
    theirs = judge(robot, mounting, cell).gaps(q)
    apart = ours.to_itself_m > 0.0  # where shapes overlap, the two define the depth of penetration differently
    assert np.all(ours.to_itself_m[apart] <= theirs.to_itself_m[apart] + GJK_M)
    apart = ours.to_cell_m > 0.0
    assert np.all(ours.to_cell_m[apart] <= theirs.to_cell_m[apart] + GJK_M)


def test_a_cell_is_read_back_from_its_document_and_every_mistake_is_named():
    """What is read back is the same cell with the same digest; a name changes no digest, a box does."""
    cell = Cell(
        name="press", table_top_m=-0.3, walls=(Wall(name="fence", point_m=(0.0, 1.0, 0.0), normal=(0.0, -2.0, 0.0)),),
        boxes=(Box(name="press", centre_m=(1.0, 0.0, 0.0), size_m=(0.1, 0.2, 0.3)),), tool=Tool(shape="box"),
    )  # fmt: skip
    again = cell_from_document({**cell.as_document(), "digest": "whatever"})
    assert again.as_document() == cell.as_document()
    assert again.digest == cell.digest
    assert Cell(name="a").digest == Cell(name="b").digest != cell.digest
    with pytest.raises(BadInput) as refused:
        cell_from_document({"cell": {"margn_m": 1}, "box": [{"name": "b", "centre_m": [1, 2], "size_m": "big"}], "tol": {}})
    for part in ("margn_m", "size_m = 'big'", "'tol'"):
        assert part in str(refused.value)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"cell": {"margin_m": float("nan")}}, "margin_m = nan"),
        ({"cell": {"margin_m": -0.1}}, "margin_m = -0.1"),
        ({"cell": {"table_top_m": float("inf")}}, "table_top_m = inf"),
        ({"wall": [{"name": "w", "point_m": [0, 0, 0], "normal": [0, 0, 0]}]}, "has no length"),
        ({"wall": [{"name": "w", "point_m": [0, 0, 0]}]}, "normal is missing"),
        ({"box": [{"name": "b", "centre_m": [0, 0, 0], "size_m": [1, 0, 1]}]}, "three positive edge lengths"),
        ({"box": [{"name": "b", "centre_m": [0, 0], "size_m": [1, 1, 1]}]}, "three finite numbers"),
        ({"tool": {"shape": "cone"}}, "none, capsule or box"),
        ({"tool": {"shape": "capsule", "radius_m": 0.0}}, "must be positive"),
    ],
)
def test_an_invalid_cell_is_refused_with_the_key(document, words):
    """The message names the figure to correct."""
    with pytest.raises(BadInput, match=words):
        cell_from_document(document)


def test_the_shipped_cells_are_the_defaults():
    """The files document the code, and the example can be read."""
    from monitor.config.files import load_cell, shared_file

    for name in ("ground", "ceiling", "wall"):
        assert load_cell(shared_file(f"cell/{name}.toml")) == plain_cell(Mounting.parse(name))
    assert load_cell(shared_file("cell/example.toml")).boxes
