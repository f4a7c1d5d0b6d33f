"""The sections on parameters, trajectories and prediction: figures 1 to 6 and 9, tables 3 and 8, the appendix."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from monitor.studies.paper import figures
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign
from monitor.studies.paper.figures import ORDER, Check, Rows, Section

NEAR = 5e-4  # largest difference of a coefficient: the paper prints three decimals
REST = 1e-6  # largest speed [rad/s] and acceleration [rad/s²] at rest: a trajectory's file has twelve decimals
LEAST_CLIFF = 1e9  # ratio of the last singular value that counts to the next one, which is rounding
LEAST_GAIN = 0.8  # of the error before identification that LS must take away; the paper says about 90 %
ALIKE = 0.1  # largest relative difference of the errors by LS and WLS
LARGEST_TRANSFER_RATIO, LEAST_WRONG_RATIO = 2.0, 10.0  # of errors, with the right and with the wrong regressor


def identifiability(found: Campaign) -> Section:
    """Figure 1 and §2.3: how many parameters are identifiable."""
    section = Section(
        "figure_1",
        "Figure 1 and §2.3: how many parameters show",
        "Singular values of the regressor at 25 random states, and what of the 78 standard parameters any motion can reveal.",
    )
    for mounting, base in found.bases.items():
        expected = paper.COUNTS[mounting]
        section.checks.append(
            Check(f"base parameters, {mounting}", str(expected), str(base.count), "agree", base.count == expected, "rank of the regressor")
        )
        cliff = base.singular_values[base.count - 1] / max(base.singular_values[base.count], 1e-300)
        section.checks.append(
            Check(
                f"cliff after value {base.count}, {mounting}",
                "the rest vanish",
                f"{cliff:.0e} between two neighbours",
                "agree",
                bool(cliff > LEAST_CLIFF),
                "a rank is one only where the values fall off",
            )
        )
    rows = []
    for mounting, printed in paper.CLASSES.items():
        base = found.bases[mounting]
        ours, columns = base.as_in_paper.counts, base.by_column.counts
        section.checks.append(
            Check(
                f"fully / in combination / without effect, {mounting}",
                " / ".join(map(str, printed)),
                " / ".join(map(str, ours)),
                "agree",
                ours == printed,
                "counted as the paper counts",
            )
        )
        rows.append([mounting, " / ".join(map(str, printed)), " / ".join(map(str, ours)), " / ".join(map(str, columns))])
    section.tables.append(
        (
            "Fully identifiable / in combination / without effect",
            Rows(("mounting", "paper", "ours, as it counts", "ours, by columns"), rows),
        )
    )
    section.drawings.append((figures.singular_values, "Singular values, and the share of their energy Σσ² in the first ones."))
    return section


def trajectories(found: Campaign) -> Section:
    """Figure 2: the excitation trajectories."""
    section = Section(
        "figure_2",
        "Figure 2: excitation trajectories",
        "Fifth-order Fourier series of 10 s, three times, about [0, −π/2, 0, 0, 0, 0], searched for the smallest condition number of the "
        "base regressor. Ours must also keep clear of the arm itself and of the table or ceiling, along the whole path: the paper's limits "
        "on position do not see to that, and the best curves that touch something are not allowed here.",
    )
    ground, ceiling = (found.trajectories[mounting] for mounting in ("ground", "ceiling"))
    of = {name: float((one.objectives or {})["condition_number"]) for name, one in (("ground", ground), ("ceiling", ceiling))}
    section.checks.append(
        Check(
            "condition number, ceiling over ground",
            f"about {paper.CEILING_CONDITION:g}",
            f"{of['ceiling']:.0f} / {of['ground']:.0f} = {of['ceiling'] / of['ground']:.2f}",
            "differ",
            None,
            f"what a search finds within {found.settings.evaluations} evaluations and within clearance; a longer one finds smaller ones",
        )
    )
    for name, one in (("ground", ground), ("ceiling", ceiling)):
        t, state = one.sampled(500.0)
        ends = float(max(np.max(np.abs(state.qd[[0, -1]])), np.max(np.abs(state.qdd[[0, -1]]))))
        section.checks.append(
            Check(
                f"at rest at both ends, {name}",
                "q̇ = q̈ = 0",
                f"at most {ends:.0e} rad/s, rad/s²",
                "agree",
                ends < REST,
                "equation (7); written to 1e-12",
            )
        )
        fastest = float(np.max(np.abs(state.qd) / np.minimum(np.pi, found.robot.max_speed_rad_s)))
        period = one.period_s == 10.0 and one.harmonics == 5 and t[-1] == 10.0 * found.settings.repetitions
        section.checks.append(
            Check(
                f"within the limits of speed, {name}",
                "5 harmonics, 10 s, 3 times",
                f"fastest joint at {100 * fastest:.0f} %",
                "agree",
                bool(fastest <= 1.0 and period),
                "5.5π rad/s² and π rad/s, or the robot's own where it is slower",
            )
        )
    section.drawings.append((figures.trajectories, "One period on the ground and on the ceiling."))
    return section


def parameters(found: Campaign) -> Section:
    """Figure 3: the identified base parameters, with the true ones of the simulated arm."""
    identified, own = found.identified, found.truth
    section = Section(
        "figure_3",
        "Figure 3: base parameters and their standard deviations",
        "Identified from one cold run by least squares as in the paper. A simulated arm has a truth to compare with; its friction follows "
        "another law, so fc and fv have none. The deviation σ is of noise; what the law misses moves the others by more.",
    )
    rigid = np.isfinite(own)
    deviations = np.abs(identified.values - own)[rigid] / identified.std[rigid]
    section.checks.append(
        Check("parameters identified", "52", str(len(identified.names)), "agree", len(identified.names) == 52, "ground, joint 1 upright")
    )
    unchanged = int(np.sum(rigid))
    section.checks.append(
        Check(
            "of them not friction", str(paper.UNCHANGED), str(unchanged), "agree", unchanged == paper.UNCHANGED, "52 less fc and fv of six"
        )
    )
    section.checks.append(
        Check(
            "distance from the truth",
            "not known of a real arm",
            f"median {np.median(deviations):.1f} σ, nine of ten within {np.percentile(deviations, 90):.1f} σ",
            "differ",
            None,
            "σ of noise alone: what fc and fv cannot describe of a concave law goes into the other parameters",
        )
    )
    rows = [
        [name, f"{value:z.4f}", f"{std:.4f}", None if not np.isfinite(true) else f"{true:z.4f}"]
        for name, value, std, true in zip(identified.names, identified.values, identified.std, own, strict=True)
    ]
    section.tables.append(("Base parameters on the ground", Rows(("parameter", "identified", "σ", "the simulated arm's own"), rows)))
    section.drawings.append((figures.parameters, "Base parameters by their leading term; the axis is linear within ± 0.1."))
    return section


def validation(found: Campaign) -> Section:
    """Figures 4 to 6 and table 3: torque predicted along a trajectory that was not fitted."""
    section = Section(
        "table_3",
        "Figures 4–6 and table 3: validation on a trajectory that was not fitted",
        f"e_N = √(eᵀe)/N in Nm, at the paper's N = {paper.SAMPLES}. Before: the manufacturer's masses and centres of mass alone.",
    )
    scale = np.sqrt(found.samples / paper.SAMPLES)  # e_N falls with 1/√N: ours as if it had the paper's N
    errors = {key: one.normalised_nm * scale for key, one in found.validation.items()}
    section.tables.append(_error_table(found, errors))
    section.tables.append(
        (
            "Time to solve",
            Rows(
                ("method", "paper", "ours"),
                [["LS", f"{paper.LS_S:.2f} s", f"{found.ls_s:.2f} s"], ["WLS", f"{paper.WLS_S:.1f} s", f"{found.wls_s:.2f} s"]],
            ),
        )
    )
    section.checks += _validation_checks(found, errors["before"], errors["LS"], errors["WLS"])
    section.drawings.append((figures.validation, "One period of the validation trajectory."))
    return section


def _error_table(found: Campaign, errors: Mapping[str, float]) -> tuple[str, Rows]:
    """e_N [N·m] and RMS of each joint, by method."""
    printed = paper.PRINTED[found.robot.name].validation
    rows: list[list[Any]] = []
    for name, theirs, key in (
        ("before", printed[0], "before"),
        ("LS", printed[1], "LS"),
        ("WLS, the paper's W", printed[2], "WLS"),
        ("WLS as the monitor does it", None, "own"),
    ):
        ours = errors[key]
        rows.append(
            [
                name,
                None if theirs is None else f"{theirs:.4f}",
                f"{ours:.4f}",
                None if theirs is None else f"{ours - theirs:+z.4f}",
                None if theirs is None else f"{100 * (ours / theirs - 1):+z.0f} %",
                "  ".join(f"{value:.2f}" for value in found.validation[key].rms_nm),
            ]
        )
    return "e_N [Nm]", Rows(("method", "paper", "ours", "difference", "relative", "RMS by joint [Nm]"), rows)


def _validation_checks(found: Campaign, before: float, ls: float, wls: float) -> list[Check]:
    """What LS and WLS gain, from e_N [N·m] at the paper's N."""
    printed = paper.PRINTED[found.robot.name].validation
    better, theirs = 1.0 - ls / before, 1.0 - printed[1] / printed[0]
    return [
        Check(
            "error taken away by LS",
            f"{100 * theirs:.0f} %",
            f"{100 * better:.0f} %",
            "agree",
            better > LEAST_GAIN,
            "“about 90 %” in the abstract",
        ),
        Check(
            "LS and WLS alike",
            f"{100 * (printed[2] / printed[1] - 1):+z.0f} %",
            f"{100 * (wls / ls - 1):+z.1f} %",
            "agree",
            abs(wls / ls - 1.0) < ALIKE,
            "the weights hardly matter for the whole torque",
        ),
        Check(
            "order of magnitude, before",
            f"{printed[0]:.4f}",
            f"{before:.4f}",
            "alike",
            1 / ORDER < before / printed[0] < ORDER,
            "friction and inertia that the manufacturer's data leave out",
        ),
        Check(
            "order of magnitude, LS",
            f"{printed[1]:.4f}",
            f"{ls:.4f}",
            "alike",
            1 / ORDER < ls / printed[1] < ORDER,
            "a simulated arm has no backlash and no flexible gears: less is left over",
        ),
        Check(
            "time of WLS over that of LS",
            f"{paper.WLS_S / paper.LS_S:.0f}",
            f"{found.wls_s / found.ls_s:.1f}",
            "differ",
            None,
            "a dense W of 22 500 × 22 500 against a factor for each row; the estimate is the same",
        ),
    ]


def transfer(found: Campaign) -> Section:
    """Figure 9 and table 8: the parameters of one mounting used on another."""
    ours = tuple(found.transfer[key].normalised_nm for key in ("ground", "ceiling", "ground regressor"))
    section = Section(
        "table_8",
        "Figure 9 and table 8: the ground's parameters on the ceiling",
        "Without friction, as in the paper's own simulator. Parameters are identified on the ground and predict the ceiling's torque.",
    )
    names = ("ground", "ceiling, its own regressor", "ceiling, the ground's regressor")
    rows = [
        [name, f"{theirs:.4f}", f"{mine:.4f}", f"{mine - theirs:+z.4f}"]
        for name, theirs, mine in zip(names, paper.TRANSFER, ours, strict=True)
    ]
    section.tables.append(("e_N [Nm]", Rows(("", "paper", "ours", "difference"), rows)))
    section.checks += [
        Check(
            "parameters carry over with the right regressor",
            f"{paper.TRANSFER[1] / paper.TRANSFER[0]:.2f} of the ground's error",
            f"{ours[1] / ours[0]:.2f}",
            "agree",
            ours[1] / ours[0] < LARGEST_TRANSFER_RATIO,
            "the same 52 combinations describe the arm on either",
        ),
        Check(
            "and not with the wrong one",
            f"{paper.TRANSFER[2] / paper.TRANSFER[1]:.0f} times worse",
            f"{ours[2] / ours[1]:.0f} times worse",
            "agree",
            ours[2] / ours[1] > LEAST_WRONG_RATIO,
            "gravity enters through the regressor",
        ),
        Check(
            "size of the error",
            f"{paper.TRANSFER[0]:.4f}",
            f"{ours[0]:.4f}",
            "differ",
            None,
            "our simulated currents carry the noise and ripple of real drives",
        ),
    ]
    section.drawings.append((figures.transfer, "One period of the ceiling's trajectory."))
    return section


def appendix(found: Campaign) -> Section:
    """Equations A1 and A2: the symbolic combinations of the base parameters."""
    base = found.bases["wall"]
    terms = {next(iter(row)): row for row in base.terms}
    section = Section(
        "appendix",
        f"Appendix, equations A{1 if found.robot.name == 'ur3' else 2}: the base parameters in symbols",
        "All combinations on a wall, 54 of them, each led by the parameter that is kept. Rows that carry lengths of the arm are compared "
        "with the same rows as formulas of its published lengths.",
    )
    worst = 0.0
    expected = paper.appendix(found.robot)
    for lead, others in expected.items():
        distance = paper.furthest({name: value for name, value in terms.get(lead, {}).items() if name != lead}, others)
        worst = max(worst, distance)
    section.checks.append(
        Check(
            "coefficients of the appendix",
            "formulas of the arm's lengths, printed to three decimals",
            f"{len(expected)} rows with lengths, at most {worst:.0e} off the formulas",
            "agree",
            worst < NEAR,
            "UR3's second row corrected, see errata",
        )
    )
    section.checks.append(Check("rows", "54", str(len(base.texts)), "agree", len(base.texts) == 54, "wall"))
    section.tables.append(
        ("Combinations on a wall", Rows(("", "combination"), [[str(number), text] for number, text in enumerate(base.texts, start=1)]))
    )
    return section
