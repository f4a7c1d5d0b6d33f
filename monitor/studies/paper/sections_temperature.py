"""The sections on temperature: the warm-up, viscous friction, and joint torque from cold to warm."""

import numpy as np

from monitor.recording import Array
from monitor.studies.paper import figures
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign
from monitor.studies.paper.figures import ORDER, Check, Rows, Section, r_squared, span

LEAST_FALL = 0.02  # of fv over the warm-up, as a fraction; less is noise
# maximum joint torque [N·m] → size of the joint, by robot
JOINT_SIZES = {"ur3": {56.0: 2, 28.0: 1, 12.0: 0}, "ur5": {150.0: 3, 28.0: 1}}
STRAIGHT = 0.95  # least R² of a line through fv over temperature
LEAST_RISE_K, LARGEST_RISE_K = 5.0, 50.0  # of joint temperature over the warm-up
SLOPES_PER_K = (-0.04, -0.004)  # bounds of the change of fv: half to twice what the paper finds
LARGEST_RIGID_CHANGE = 0.02  # torque of the rigid parameters' change over the whole torque


def warm_up(found: Campaign) -> Section:
    """Tables 4 to 7, first part: joint temperatures."""
    printed = paper.PRINTED[found.robot.name]
    section = Section(
        "warm_up",
        "Tables 4–7, first part: half an hour of warming up",
        f"The same trajectory over and over; {found.settings.replays} of the runs are stepped in full and identified, the heat of those "
        "between is computed from the last one's own losses.",
    )
    rows = []
    for j in range(found.robot.joints):
        cold, warm = found.temperature_c[0, j], found.temperature_c[-1, j]
        theirs = (None, None) if printed.cold_c is None or printed.warm_c is None else (printed.cold_c[j], printed.warm_c[j])
        rows.append(
            [
                f"joint {j + 1}",
                *(None if value is None else f"{value:.1f}" for value in theirs),
                f"{cold:.1f}",
                f"{warm:.1f}",
                None if theirs[1] is None else f"{warm - theirs[1]:+z.1f}",
            ]
        )
    section.tables.append(
        ("Joint temperatures [°C]", Rows(("joint", "paper, cold", "paper, warm", "ours, cold", "ours, warm", "difference, warm"), rows))
    )
    rise = found.temperature_c[-1] - found.temperature_c[0]
    in_paper = "10–17 K (UR5)" if printed.warm_c is not None else "not at hand for the UR3"
    section.checks.append(
        Check(
            "every joint warms by 5–50 K",
            in_paper,
            span(rise, "K"),
            "alike",
            bool(np.all((rise > LEAST_RISE_K) & (rise < LARGEST_RISE_K))),
            "heat of its own model, by the trajectory that was found: the order of the UR5's 10–17 K",
        )
    )
    return section


def viscous(found: Campaign) -> Section:
    """Figure 8 and tables 4 to 7, second part: viscous friction over joint temperature."""
    printed = paper.PRINTED[found.robot.name]
    change = found.viscous[-1] / found.viscous[0] - 1.0
    coulomb = found.coulomb_nm[-1] / found.coulomb_nm[0] - 1.0
    rise = found.temperature_c[-1] - found.temperature_c[0]
    straight = np.array([r_squared(T, fv) for T, fv in zip(found.temperature_c.T, found.viscous.T, strict=True)])
    section = Section(
        "figure_8",
        "Figure 8 and tables 4–7, second part: viscous friction against temperature",
        "Overall change of fv from the first run to the last.",
    )
    rows = [
        [
            f"fv{j + 1}",
            f"{100 * printed.viscous_change[j]:+z.1f} %",
            f"{100 * change[j]:+z.1f} %",
            f"{100 * (change[j] - printed.viscous_change[j]):+z.1f}",
            f"{100 * change[j] / rise[j]:+z.2f}",
            f"{straight[j]:.3f}" if np.isfinite(straight[j]) else None,
            f"{100 * coulomb[j]:+z.1f} %",
        ]
        for j in range(found.robot.joints)
    ]
    section.tables.append(
        ("Change over the campaign", Rows(("", "paper", "ours", "difference [%-points]", "ours [%/K]", "R² of the line", "fc, ours"), rows))
    )
    section.checks += _viscous_checks(found, change, rise, straight)
    section.drawings.append((figures.viscous_over_temperature, "fv of every identified run over the joint's mean temperature."))
    return section


def _viscous_checks(found: Campaign, change: Array, rise: Array, straight: Array) -> list[Check]:
    """Sign, straightness and slope of fv over temperature, and that nothing else changes; all arrays (J,)."""
    printed = paper.PRINTED[found.robot.name]
    coulomb = found.coulomb_nm[-1] / found.coulomb_nm[0] - 1.0
    return [
        Check(
            "fv of every joint falls as it warms",
            span(100 * np.array(printed.viscous_change), "%"),
            span(100 * change, "%"),
            "agree",
            bool(np.all(change < -LEAST_FALL)),
            "sign, of all six joints",
        ),
        Check(
            "linearly",
            "“linear”",
            f"R² {np.min(straight):.3f} or more" if len(found.viscous) > 2 else "two runs make no line",
            "agree",
            bool(np.min(straight) > STRAIGHT) if len(found.viscous) > 2 else None,
            "over the range of a warm-up",
        ),
        Check(
            "pace",
            "0.8–2.2 %/K",
            span(100 * change / rise, "%/K", digits=2),
            "alike",
            bool(np.all((change / rise < SLOPES_PER_K[1]) & (change / rise > SLOPES_PER_K[0]))),
            "the simulated grease thins by 1.2–1.9 %/K, and lags behind its sensor",
        ),
        Check(
            "rigid parameters stay",
            f"{paper.UNCHANGED} do not change",
            f"they change {100 * found.rigid_std_of_torque:.1f} % of the torque, {np.nanmax(np.abs(found.rigid_drift_std)):.1f} σ at most",
            "agree",
            found.rigid_std_of_torque < LARGEST_RIGID_CHANGE,
            "only fc and fv change with temperature",
        ),
        Check(
            "fc",
            "changes too",
            span(100 * coulomb, "%"),
            "differ",
            None,
            "of the simulated arm's law: the line through a concave curve has less intercept as the curve sinks",
        ),
    ]


def torques(found: Campaign) -> Section:
    """Figure 7 and tables 4 to 7, third part: the change of joint torque from cold to warm."""
    printed = paper.PRINTED[found.robot.name]
    change = np.abs(found.warm_nm - found.cold_nm)
    average, largest = np.mean(change, axis=0), np.max(change, axis=0)
    section = Section(
        "figure_7",
        "Figure 7 and tables 4–7, third part: joint torque, cold against warm",
        "Torque along the excitation as the cold and the warm identification have it.",
    )
    rows = [
        [
            f"joint {j + 1}",
            f"{printed.average_nm[j]:.2f}",
            f"{average[j]:.2f}",
            f"{average[j] - printed.average_nm[j]:+z.2f}",
            f"{printed.largest_nm[j]:.2f}",
            f"{largest[j]:.2f}",
            f"{largest[j] - printed.largest_nm[j]:+z.2f}",
        ]
        for j in range(found.robot.joints)
    ]
    columns = ("", "average, paper", "ours", "difference", "largest, paper", "ours", "difference")
    section.tables.append(("Change of joint torque [Nm]", Rows(columns, rows)))
    section.tables.append(_share_table(found, largest))
    ratio = average / np.array(printed.average_nm)
    section.checks += [
        Check(
            "order of magnitude of the average change",
            span(np.array(printed.average_nm), "Nm", digits=2),
            span(average, "Nm", digits=2),
            "alike",
            bool(1 / ORDER < np.exp(np.mean(np.log(ratio))) < ORDER),
            "geometric mean of the six joints within a factor of five",
        ),
        Check(
            "which joints are loaded most",
            "—",
            "large joints, by torque",
            "differ",
            None,
            "the simulated friction is in proportion to each joint's maximum torque, a real arm's is not quite",
        ),
    ]
    section.drawings.append((figures.cold_and_warm, "One period of the excitation, first run and last."))
    return section


def _share_table(found: Campaign, largest_nm: Array) -> tuple[str, Rows]:
    """The largest change of torque (J,) over the maximum joint torque, as the mean over the joints of one size."""
    printed, limit = paper.PRINTED[found.robot.name], found.robot.max_torque_nm
    rows = []
    for torque, size in JOINT_SIZES[found.robot.name].items():
        of = limit == torque
        ours = float(np.mean(largest_nm[of] / limit[of]))
        rows.append(
            [f"size {size}", f"{100 * printed.share[size]:.1f} %", f"{100 * ours:.1f} %", f"{100 * (ours - printed.share[size]):+z.1f}"]
        )
    title = "Largest change over the maximum joint torque, mean of the size"
    return title, Rows(("joints", "paper", "ours", "difference [%-points]"), rows)
