"""Accepted trajectories are free of collisions, their proof is right, and one seed gives one file. `soak` repeats it on a thousand."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dense_check import judge
from tasks import pose, problem, task

from monitor.config.files import load_cell, shared_file
from monitor.design.cell import Box, Cell
from monitor.design.clearance import surroundings
from monitor.design.optimise import Progress, optimise, random_curve
from monitor.design.problem import Infeasible
from monitor.design.proof import along, cell_of, prove, recheck
from monitor.design.trajectory import design
from monitor.errors import BadInput
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot

ROOT = Path(__file__).parents[2]
SHIPPED = sorted((ROOT / "config" / "excitation").glob("*.json"))
DENSE_HZ = {"cb3": 1250.0, "e-series": 5000.0}  # ten times the controller's
MANY = [("ur5", "ground", 40), ("ur3", "wall", 20), ("ur10", "ceiling", 20), ("ur5", "ceiling", 20)]
SOME = [(robot, mounting, count // 10) for robot, mounting, count in MANY]


def accepted(robot, mounting, seed):
    """One random trajectory as the command would accept it: drawn, then proved at 500 Hz."""
    one = problem(robot, mounting)
    excitation = one.family.excitation(random_curve(one, seed).u)
    proof = prove(excitation, one.surroundings, one.family.limits, one.information, one.approaches_rad, "test")
    return one, excitation, proof


def verify(robot, mounting, seeds):
    """No collision at ten times the rate on path and approaches; at each 100th pose, exact shapes have at least the proof's clearance."""
    arm, mount, cell = load_robot(robot), Mounting.parse(mounting), problem(robot, mounting).surroundings.cell
    capsules, cylinders = judge(arm, mount, cell), judge(arm, mount, cell, exact=True)
    generation = load_robot(robot).generation
    nearest = np.inf
    for seed in seeds:
        one, excitation, proof = accepted(robot, mounting, seed)
        clearance = proof["clearance"]
        assert clearance["to_itself_m"] >= cell.self_margin_m
        assert clearance["to_cell_m"] >= cell.margin_m
        q = excitation.at(np.linspace(0.0, excitation.period_s, int(excitation.period_s * DENSE_HZ[generation]) + 1)).q
        ways = [q[0] + np.linspace(0.0, 1.0, 400)[:, None] * (rest - q[0]) for rest in one.approaches_rad]
        assert not capsules.collides(np.vstack([q, *ways])), (robot, mounting, seed)
        seen = cylinders.gaps(q[::100])
        # five digits are kept of a clearance of centimetres, and coal stops within 1e-6
        assert clearance["to_itself_m"] <= seen.to_itself_m.min() + 3e-6
        assert clearance["to_cell_m"] <= seen.to_cell_m.min() + 3e-6
        nearest = min(nearest, float(seen.to_itself_m.min()), float(seen.to_cell_m.min()))
    return nearest


@pytest.mark.parametrize(("robot", "mounting", "count"), SOME, ids=str)
@pytest.mark.slow
def test_ten_random_accepted_trajectories_collide_nowhere(robot, mounting, count):
    """By frames of pinocchio and distances of coal at ten times the controller's rate; approaches too."""
    assert verify(robot, mounting, range(count)) >= 0.01  # the smaller of the two margins


@pytest.mark.soak
@pytest.mark.timeout(400)
@pytest.mark.parametrize(("robot", "mounting", "count"), MANY, ids=str)
def test_a_hundred_random_accepted_trajectories_collide_nowhere(robot, mounting, count):
    """The same twenty and eighty more."""
    assert verify(robot, mounting, range(count)) >= 0.01  # the smaller of the two margins


@pytest.mark.soak
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("block", range(4))
def test_a_thousand_random_accepted_trajectories_collide_nowhere(block, capsys):
    """The same on other seeds, e-Series included."""
    counts = [("ur5", "ground", 75), ("ur3", "wall", 60), ("ur10", "ceiling", 60), ("ur5e", "wall", 30), ("ur20", "ground", 25)]
    rows = []
    for robot, mounting, count in counts:
        first = 1000 + block * count
        rows.append((robot, mounting, count, verify(robot, mounting, range(first, first + count))))
    with capsys.disabled():
        print(f"\nrandom trajectories, block {block}: robot, mounting, how many, nearest approach seen [mm]")
        for robot, mounting, count, nearest in rows:
            print(f"  {robot:6} {mounting:8} {count:4} {1000 * nearest:7.1f}")
    assert min(row[3] for row in rows) >= 0.01


def test_the_independent_check_finds_a_collision():
    """The check must be able to fail: the elbow is folded, the arm goes through the table, or a box is in the way."""
    ground = judge(load_robot("ur5"), Mounting(), Cell())
    assert ground.collides(pose(0, -1.57, 2.9, 0, 0, 0)[None])
    assert ground.collides(pose(0, 0.4, 0, 0, 0, 0)[None])
    assert not ground.collides(pose(0, -1.57, 0, 0, 0, 0)[None])
    boxed = judge(load_robot("ur5"), Mounting(), Cell(boxes=(Box(name="b", centre_m=(0, 0, 0.7), size_m=(0.5, 0.5, 0.2)),)))
    assert boxed.collides(pose(0, -1.57, 0, 0, 0, 0)[None])


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
@pytest.mark.slow
def test_every_shipped_trajectory_is_proved_and_the_proof_holds_when_done_again(path):
    """For the cell of its mounting, by our bound at 500 Hz and by coal; at rest at both ends; the digests are of what is in the file."""
    excitation = excitation_from_document(json.loads(path.read_text("utf-8")))
    robot, cell = load_robot(excitation.robot), cell_of(excitation)
    assert f"{excitation.robot}-{path.stem.rsplit('-', 1)[1]}" == path.stem
    assert cell == load_cell(shared_file(f"cell/{path.stem.rsplit('-', 1)[1]}.toml"))
    assert Mounting.parse(path.stem.rsplit("-", 1)[1]) == excitation.mounting
    proof = excitation.proof
    assert proof is not None
    assert (proof["path_digest"], proof["cell_digest"]) == (excitation.path_digest, cell.digest)
    assert recheck(excitation, robot, cell) is None
    nearest = along(excitation, surroundings(robot, excitation.mounting, cell))
    assert proof["clearance"]["to_itself_m"] == pytest.approx(nearest.itself.gap_m, abs=1e-6)
    ends = excitation.at(np.array([0.0, excitation.duration_s]))
    assert np.max(np.abs(ends.qd)) < 1e-12
    assert np.max(np.abs(ends.qdd)) < 1e-12
    q = excitation.at(np.linspace(0.0, excitation.period_s, 1250)).q
    assert not judge(robot, excitation.mounting, cell).collides(q)
    for approach in proof["approaches"]:
        assert np.max(np.abs(q[0] - approach["from_rad"])) < 2.5  # a replay would refuse to approach from farther
    assert max(max(proof[f"{name}_share"]) for name in ("position", "speed", "acceleration", "torque")) <= 1.0


def test_every_model_on_every_mounting_has_one():
    """Nine models, three mountings; repetitions and time scale are fields, not files."""
    assert len(SHIPPED) == 27
    assert {path.stem.split("-")[0] for path in SHIPPED} == {"ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30"}


@pytest.mark.parametrize("optimiser", ["cma", "ga"])
@pytest.mark.slow
def test_the_same_seed_gives_the_same_file_and_another_seed_another(optimiser):
    """Byte for byte, whatever numpy's global random state is."""
    made = []
    for seed in (1, 1, 2):
        np.random.rand(seed + len(made))  # noqa: NPY002 the global random state must have no effect
        excitation, _ = design(task(), software="test", seed=seed, evaluations=40, optimiser=optimiser)
        made.append(json.dumps(excitation.as_document()))
    assert made[0] == made[1] != made[2]


@pytest.mark.parametrize("optimiser", ["cma", pytest.param("ga", marks=pytest.mark.soak)])
@pytest.mark.slow
def test_a_search_improves_and_returns_its_best_when_it_is_stopped(optimiser):
    """The best never rises; asked to stop, the search returns at once what it had."""
    states: list[Progress] = []

    # the GA's first 300 are drawn at random: what it does with them shows later
    enough = {"cma": 320, "ga": 1000}[optimiser]

    def stop(at: Progress) -> bool:
        states.append(at)
        return at.evaluations < enough

    found = optimise(problem(), evaluations=10_000, seed=3, optimiser=optimiser, on_progress=stop)
    best = [at.best for at in states]
    assert found.stopped
    assert found.evaluations == enough
    assert all(later <= earlier for earlier, later in itertools.pairwise(best))
    assert found.value == best[-1] < best[20]
    assert problem().allowed(problem().family.excitation(found.u))


@pytest.mark.slow
def test_a_start_and_a_cell_with_a_tool_are_kept():
    """The whole task of a real site: start pose, box, fence, tool; what comes out is clear by the independent judge."""
    cell = load_cell(shared_file("cell/example.toml"))
    start = pose(0.3, -1.5, 0.4, -1.2, 0.2, 0.0)
    excitation, _ = design(task(cell=cell, start_rad=start, approaches_rad=(pose(0, -1.57, 0, -1.57, 0, 0),)), software="t", evaluations=60)
    np.testing.assert_allclose(excitation.at(np.array([0.0, 10.0])).q, [start, start], atol=1e-12)
    q = excitation.at(np.linspace(0.0, 10.0, 2501)).q
    seen = judge(load_robot("ur5"), Mounting(), cell).gaps(q[::10])
    assert seen.to_itself_m.min() >= cell.self_margin_m
    assert seen.to_cell_m.min() >= cell.margin_m


def test_a_cell_that_contains_the_arm_is_refused_with_the_thing_that_touches():
    """The message has the name, the parts and the depth."""
    cell = Cell(boxes=(Box(name="crate", centre_m=(0.0, 0.0, 0.5), size_m=(2.0, 2.0, 2.0)),))
    with pytest.raises(Infeasible, match=r"and crate come to be .* mm inside each other, .* mm short of the margin_m of 30 mm"):
        design(task(cell=cell), software="test", evaluations=10)


def test_limits_that_no_curve_keeps_end_with_the_one_that_binds():
    """A flange that may hardly move: the message names the limit that no curve keeps."""
    with pytest.raises(Infeasible, match=r"no allowed curve in 60 evaluations; .* the flange moves at .* m/s beyond its limit of 0.00 m/s"):
        design(task(flange_speed_limit_m_s=1e-3), software="test", evaluations=60)


def test_a_changed_curve_fails_its_proof_of_clearance():
    """The proof is computed again: a larger swing is found, and a cell whose digest does not match."""
    path = ROOT / "config" / "excitation" / "ur5-ground.json"
    excitation = excitation_from_document(json.loads(path.read_text("utf-8")))
    wider = replace(excitation, a_rad_s=1.6 * excitation.a_rad_s, b_rad_s=1.6 * excitation.b_rad_s)
    cell = cell_of(excitation)
    assert cell is not None
    assert recheck(wider, load_robot("ur5"), cell) is not None
    forged = replace(excitation, cell={**excitation.cell, "digest": "0" * 16})
    with pytest.raises(BadInput, match="digest"):
        cell_of(forged)
