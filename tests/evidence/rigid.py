"""How far rigid parameters lie from the truth, in their own standard deviations, on simulated arms whose friction no law here matches.

`python -m tests.evidence.rigid [--arms N] [--seed FIRST]` prints docs/identification.md's table. Each arm has its own friction, motion and
noise, and masses that are not quite the manufacturer's, since a simulated arm of the manufacturer's own masses would flatter `consistent`.
"""

import argparse
from dataclasses import replace

import numpy as np

from monitor.design.trajectory import Task, design
from monitor.identify.identify import METHODS, identify
from monitor.model.regressor import ROTOR
from monitor.model.robot import PER_JOINT, Mounting, load_robot
from monitor.simulate.arm.physics import drive_gain
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

MODELS = ("ur3", "ur5", "ur10e")
EVALUATIONS = 200  # of the search for a motion: enough for a condition number of the order of the paper's
FRICTION_SPREAD, EXPONENT_SPREAD = 0.3, 0.06  # between arms, joint by joint; of the logarithm, and of the exponent of speed
MASS_SPREAD = 0.1  # by which masses, centres and inertias differ from the manufacturer's


def arm(model, seed):
    """A replay of 30 s of one arm, and its true standard parameters."""
    robot, rng = load_robot(model), np.random.default_rng(seed)
    task = Task(robot=robot, mounting=Mounting(), objective="condition")
    motion, _ = design(task, software="evidence", seed=seed, evaluations=EVALUATIONS)
    controller = Controller(SimulateSettings(robot=model, seed=seed))
    law = controller.arm.law
    own = {
        name: getattr(law, name) * np.exp(FRICTION_SPREAD * rng.standard_normal(robot.joints))
        for name in ("coulomb_nm", "load_factor", "concave_nm", "linear_nm_s_per_rad")
    }
    exponent = np.clip(law.exponent + EXPONENT_SPREAD * rng.standard_normal(robot.joints), 0.4, 0.9)
    controller.arm.law = replace(law, exponent=exponent, **own)
    controller.arm.set_temperatures(controller.arm.temperatures)  # computes friction anew
    true = robot.nominal_parameters(with_inertia=True)
    true[ROTOR::PER_JOINT] = controller.arm.rotor_kg_m2
    return stepped_replay(controller, motion), true


def as_the_manufacturer_says(robot, seed):
    """The robot with masses, centres and inertias that are somewhat off."""
    rng = np.random.default_rng((seed, 1))
    mass, centre, inertia = (1.0 + MASS_SPREAD * rng.standard_normal((3, robot.joints))).clip(0.7, 1.3)
    return replace(
        robot,
        mass_kg=robot.mass_kg * mass,
        com_m=robot.com_m * centre[:, None],
        inertia_kg_m2=robot.inertia_kg_m2 * inertia[:, None, None],
    )


def off(model, seeds):
    """Method → distances of all identified rigid parameters of these arms from the truth, in standard deviations."""
    robot, found = load_robot(model), {method: [] for method in METHODS}
    for seed in seeds:
        replay, true = arm(model, seed)
        for method in METHODS:
            one = identify([replay], as_the_manufacturer_says(robot, seed), Mounting(), method=method, gains=drive_gain(robot))
            rigid = np.array([not name.startswith("f") for name in one.names]) & np.isfinite(one.std)
            found[method].append((np.abs(one.values - one.combination @ true) / one.std)[rigid])
    return {method: np.concatenate(each) for method, each in found.items()}


def main():
    """Print, by model and method, the distance of half and of nine tenths of the parameters."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1000, help="of the first arm")
    given = parser.parse_args()
    print("| model | method | half within | nine of ten within | farthest |\n|---|---|---|---|---|")
    for model in MODELS:
        for method, z in off(model, range(given.seed, given.seed + given.arms)).items():
            half, most = np.quantile(z, [0.5, 0.9])
            print(f"| {model} | `{method}` | {half:.2f} σ | {most:.2f} σ | {np.max(z):.1f} σ |", flush=True)


if __name__ == "__main__":
    main()
