"""The paper's statements and tables beside ours: a statement is a row of `STATEMENTS` with the bounds of one figure of the campaign.

Texts are templates of `figures_of`. A statement holds where its figure lies within its bounds. Figures that belong to the paper's own arms
(friction, temperature, noise) need not agree, because the simulated arm has a friction law, heat and noise of its own: joint by joint they
are held within a factor that was set before, and one beyond it is told as missed, with what is known of why. Some have no bounds at all.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.studies.paper import drawings
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import Campaign

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ORDER = 5.0  # two figures whose ratio is within this factor have the same order of magnitude
WITHIN_ORDER = (1.0 / ORDER, ORDER)
NEAR_FACTOR = 2.0  # between one joint's figure of the paper's arm and of ours: two arms of one model differ by 1.3 to 1.5 joint by joint
WITHIN_NEAR = (1.0 / NEAR_FACTOR, NEAR_FACTOR)
FOLLOWED = 0.8  # least share of the variance of a joint's torque that the identified parameters explain in figures 5 and 6
NEAR = 5e-4  # largest difference of a coefficient: the paper prints three decimals
REST = 1e-6  # largest speed [rad/s] and acceleration [rad/s²] at rest: a trajectory's file has twelve decimals
LEAST_CLIFF = 1e9  # ratio of the last singular value that counts to the next one, which is rounding
LEAST_GAIN = 0.8  # of the error before identification that LS must take away; the paper says about 90 %
ALIKE = 0.1  # largest relative difference of the errors by LS and WLS
LARGEST_TRANSFER_RATIO, LEAST_WRONG_RATIO = 2.0, 10.0  # of errors, with the right and with the wrong regressor
LEAST_FALL = 0.02  # of fv over the warm-up, as a fraction; less is noise
STRAIGHT = 0.95  # least R² of a line through fv over temperature
RISE_K = (5.0, 50.0)  # of joint temperature over the warm-up
SLOPES_PER_K = (-0.04, -0.004)  # of fv: half to twice what the paper finds
LARGEST_RIGID_CHANGE = 0.02  # torque of the rigid parameters' change over the whole torque
JOINT_SIZES = {"ur3": {56.0: 2, 28.0: 1, 12.0: 0}, "ur5": {150.0: 3, 28.0: 1}}  # maximum joint torque [N·m] → size, by robot

# to the last figure or sign; in order of magnitude; within a bound, though the arms are others and a miss contradicts nothing; not at all
Expected = Literal["agree", "alike", "near", "differ"]


class Check(NamedTuple):
    """One statement of the paper beside ours. The paper is reproduced where every check holds that can."""

    what: str
    paper: str
    ours: str
    expected: Expected
    holds: bool | None  # None: the figures must differ, as the arm is another one
    why: str

    @property
    def document(self) -> dict[str, Any]:
        """The check as plain JSON."""
        return {**self._asdict(), "verdict": self.verdict}

    @property
    def verdict(self) -> str:
        """What is shown of it."""
        if self.holds is None:
            return "must differ"
        return "holds" if self.holds else "missed" if self.expected == "near" else "DOES NOT HOLD"


class Rows(NamedTuple):
    """A table. The first column holds words, the others figures."""

    columns: tuple[str, ...]
    rows: list[list[Any]]


@dataclass(frozen=True, slots=True)
class Section:
    """One figure or table of the paper, and its comparison. `drawings` are functions of the campaign, each with a caption."""

    key: str
    title: str
    text: str
    checks: list[Check]
    tables: list[tuple[str, Rows]] = field(default_factory=list)
    drawings: tuple[tuple[Callable[[Campaign], "Figure"], str], ...] = ()

    def as_document(self) -> dict[str, Any]:
        """Checks and tables as plain JSON."""
        return {
            "section": self.key,
            "title": self.title,
            "checks": [check.document for check in self.checks],
            "tables": [{"title": title, "columns": list(rows.columns), "rows": rows.rows} for title, rows in self.tables],
        }


class Statement(NamedTuple):
    """A row of the comparison. Each is made once for every name in `of`, which chooses its figures and stands for {of}."""

    section: str
    what: str
    paper: str
    ours: str
    expected: Expected
    figure: str | None  # name of the figure that is bounded; None where figures must differ
    within: tuple[float, float]
    why: str
    of: tuple[str, ...] = ("",)

    def checks(self, figures: Mapping[str, Any]) -> Iterator[Check]:
        """The statement held against the figures of a campaign."""
        for name in self.of:
            if name and name not in figures:
                continue  # an arm has not every size of joint
            own = {**figures, **figures.get(name, {}), "of": name}
            value = None if self.figure is None else own[self.figure]
            if self.expected == "near" and value is None:
                continue  # nobody published the figure
            holds = None if value is None else bool(self.within[0] <= value <= self.within[1])
            what, theirs, ours = (text.format_map(own) for text in (self.what, self.paper, self.ours))
            yield Check(what, theirs, ours, self.expected, holds, self.why.format_map(own))


MOUNTINGS = ("ground", "ceiling", "wall")
JOINTS = tuple(f"joint {n}" for n in range(1, 7))
BY_HEAT = "ours warmed by {rise_k:.0f} K{their_rise_k}; our friction and load of a joint are in proportion to its largest torque"
SIZES = tuple(f"size {size}" for size in range(4))
FREE = (-inf, inf)
STATEMENTS = (
    Statement("figure_1", "base parameters, {of}", "{expected}", "{rank}", "agree", "too_many", (0, 0), "rank of the regressor", MOUNTINGS),
    Statement(
        "figure_1", "cliff after value {rank}, {of}", "the rest vanish", "{cliff:.0e} between two neighbours", "agree", "cliff",
        (LEAST_CLIFF, inf), "a rank is one only where the values fall off", MOUNTINGS,
    ),
    Statement(
        "figure_1", "fully / in combination / without effect, {of}", "{classes}", "{our_classes}", "agree", "classes_agree", (1, 1),
        "counted as the paper counts", tuple(paper.CLASSES),
    ),
    Statement(
        "figure_2", "condition number, ceiling over ground", f"about {paper.CEILING_CONDITION:g}",
        "{ceiling[condition]:.0f} / {ground[condition]:.0f} = {condition_ratio:.2f}", "near", "their_condition_ratio", WITHIN_NEAR,
        "both by the paper's genetic algorithm, 300 curves a generation, {evaluations} evaluations; ours within clearance",
    ),
    Statement(
        "figure_2", "at rest at both ends, {of}", "q̇ = q̈ = 0", "at most {ends:.0e} rad/s, rad/s²", "agree", "ends", (0, REST),
        "equation (7); written to 1e-12", MOUNTINGS[:2],
    ),
    Statement(
        "figure_2", "within the limits of speed, {of}", "5 harmonics, 10 s, 3 times", "fastest joint at {fastest_percent:.0f} %", "agree",
        "speed", (0, 1), "5.5π rad/s² and π rad/s, or the robot's own where it is slower", MOUNTINGS[:2],
    ),
    Statement("figure_3", "parameters identified", "52", "{identified}", "agree", "identified", (52, 52), "ground, joint 1 upright"),
    Statement(
        "figure_3", "of them not friction", str(paper.UNCHANGED), "{rigid}", "agree", "rigid", (paper.UNCHANGED, paper.UNCHANGED),
        "52 less fc and fv of six",
    ),
    Statement(
        "figure_3", "distance from the truth", "not known of a real arm", "median {off:.1f} σ, nine of ten within {off_90:.1f} σ", "near",
        "off_90", (0.8, 2.5), "1.64 is right; σ holds noise and what fc and fv cannot describe of a concave law",
    ),
    Statement(
        "table_3", "error taken away by LS", "{their_gain:.0f} %", "{gain_percent:.0f} %", "agree", "gain", (LEAST_GAIN, inf),
        "“about 90 %” in the abstract",
    ),
    Statement(
        "table_3", "LS and WLS alike", "{their_wls_percent:+z.0f} %", "{wls_percent:+z.1f} %", "agree", "wls_off", (-ALIKE, ALIKE),
        "the weights hardly matter for the whole torque",
    ),
    Statement(
        "table_3", "e_N before", "{validation[0]:.4f}", "{before:.4f}", "near", "before_ratio", WITHIN_NEAR,
        "friction and inertia that the manufacturer's data leave out",
    ),
    Statement(
        "table_3", "e_N by LS", "{validation[1]:.4f}", "{LS:.4f}", "near", "ls_ratio", WITHIN_NEAR,
        "a simulated arm has no backlash and no flexible gears: less is left over",
    ),
    Statement(
        "table_3", "e_N by WLS", "{validation[2]:.4f}", "{WLS:.4f}", "near", "wls_ratio", WITHIN_NEAR,
        "the same, with the paper's weights",
    ),
    Statement(
        "table_3", "figures 5 and 6: identified torque follows the measured, {of}", "the curves overlap",
        "{followed:.0f} % of its variance; by the manufacturer's data {followed_before:.0f} %", "agree", "followed_share", (FOLLOWED, inf),
        "the paper draws curves and prints no figure for a joint", JOINTS,
    ),
    Statement(
        "table_3", "time of WLS over that of LS", f"{paper.WLS_S / paper.LS_S:.0f}", "{wls_time:.1f}", "differ", None, FREE,
        "a dense W of 22 500 × 22 500 against a factor for each row; the estimate is the same",
    ),
    Statement(
        "warm_up", "every joint warms by 5–50 K", "{their_rise}", "{rise}", "alike", "rise_inside", (1, 1),
        "heat of its own model, by the trajectory that was found: the order of the UR5's 10–17 K",
    ),
    Statement(
        "figure_8", "fv of every joint falls as it warms", "{their_change}", "{change}", "agree", "least_fall", (LEAST_FALL, inf),
        "sign, of all six joints",
    ),
    Statement(
        "figure_8", "table 4: change of fv, {of}", "{their_fv:+z.1f} %", "{our_fv:+z.1f} %", "near", "fv_ratio", WITHIN_NEAR, BY_HEAT,
        JOINTS,
    ),
    Statement(
        "figure_8", "table 4: change of fv a kelvin, {of}", "{their_pace}", "{our_pace:+z.2f} %/K", "near", "pace_ratio", WITHIN_NEAR,
        "without the heat, which is another's; the paper prints temperatures of the UR5 alone", JOINTS,
    ),
    Statement(
        "figure_8", "table 4: change of fv of a real arm elsewhere, {of}", "{their_fv:+z.1f} %", "{elsewhere}", "near", "elsewhere_ratio",
        WITHIN_NEAR, "a UR3 of another laboratory, one trajectory twice, 35 minutes apart; of a UR5 nobody published any", JOINTS,
    ),
    Statement(
        "figure_8", "linearly", "“linear”", "{straight}", "near", "least_r2", (STRAIGHT, inf),
        "over the sensor's temperature, which the simulated grease lags; its law is exponential, and ours warms further",
    ),
    Statement(
        "figure_8", "pace", "0.8–2.2 %/K", "{pace}", "alike", "pace_inside", (1, 1),
        "the simulated grease thins by 1.2–1.9 %/K, and lags behind its sensor",
    ),
    Statement(
        "figure_8", "rigid parameters stay", f"{paper.UNCHANGED} do not change",
        "they change {rigid_percent:.1f} % of the torque, {rigid_drift:.1f} σ at most", "agree", "rigid_share", (0, LARGEST_RIGID_CHANGE),
        "only fc and fv change with temperature",
    ),
    Statement(
        "figure_8", "fc", "changes too", "{coulomb}", "differ", None, FREE,
        "of the simulated arm's law: the line through a concave curve has less intercept as the curve sinks",
    ),
    Statement(
        "figure_7", "table 5: average change of torque, {of}", "{their_average:.2f} Nm", "{average:.2f} Nm", "near", "average_ratio",
        WITHIN_NEAR, BY_HEAT, JOINTS,
    ),
    Statement(
        "figure_7", "table 6: largest change of torque, {of}", "{their_largest:.2f} Nm", "{largest:.2f} Nm", "near", "largest_ratio",
        WITHIN_NEAR, BY_HEAT, JOINTS,
    ),
    Statement(
        "figure_7", "table 7: largest change over largest torque, {of}", "{their_share:.1f} %", "{share:.1f} %", "near", "share_ratio",
        WITHIN_NEAR, "mean of the joints of the size, which warmed by {rise_k:.0f} K", SIZES,
    ),
    Statement(
        "figure_7", "which joints are loaded most", "—", "large joints, by torque", "differ", None, FREE,
        "the simulated friction is in proportion to each joint's maximum torque, a real arm's is not quite",
    ),
    Statement(
        "table_8", "parameters carry over with the right regressor",
        f"{paper.TRANSFER[1] / paper.TRANSFER[0]:.2f} of the ground's error", "{carried:.2f}", "agree", "carried",
        (0, LARGEST_TRANSFER_RATIO), "the same 52 combinations describe the arm on either",
    ),
    Statement(
        "table_8", "and not with the wrong one", f"{paper.TRANSFER[2] / paper.TRANSFER[1]:.0f} times worse", "{worse:.0f} times worse",
        "agree", "worse", (LEAST_WRONG_RATIO, inf), "gravity enters through the regressor",
    ),
    Statement(
        "table_8", "error with the wrong one", f"{paper.TRANSFER[2]:.4f}", "{transfer[2]:.4f}", "near", "wrong_ratio", WITHIN_NEAR,
        "the weight of the arm, upside down, along another trajectory",
    ),
    Statement(
        "table_8", "size of the error", f"{paper.TRANSFER[0]:.4f}", "{transfer[0]:.4f}", "differ", None, FREE,
        "the paper's simulator adds no noise to its model's torque; ours adds that of real drives, without which the UR5 has 0.0008",
    ),
    Statement(
        "appendix", "coefficients of the appendix", "formulas of the arm's lengths, printed to three decimals",
        "{formulas} rows with lengths, at most {furthest:.0e} off the formulas", "agree", "furthest", (0, NEAR),
        "UR3's second row corrected, see errata",
    ),
    Statement("appendix", "rows", "54", "{wall[rank]}", "agree", "appendix_rows", (54, 54), "wall"),
)  # fmt: skip


def figures_of(found: Campaign) -> dict[str, Any]:
    """The figures of a campaign by the names in `STATEMENTS`; those of a mounting stand under its name."""
    return {**_of_model(found), **_of_temperature(found), **_of_joints(found), **_of_sizes(found)}


def _of_model(found: Campaign) -> dict[str, Any]:
    printed, identified = paper.PRINTED[found.robot.name], found.identified
    of: dict[str, dict[str, Any]] = {}
    for name, base in found.bases.items():
        sigma, classes = base.singular_values, paper.CLASSES.get(name)
        of[name] = {"rank": base.count, "expected": paper.COUNTS[name], "too_many": base.count - paper.COUNTS[name]}
        of[name] |= {"cliff": sigma[base.count - 1] / max(sigma[base.count], 1e-300)}
        if classes is not None:
            ours = base.as_in_paper.counts
            of[name] |= {"classes": _counts(classes), "our_classes": _counts(ours), "classes_agree": ours == classes}
    for name in MOUNTINGS[:2]:
        one = found.trajectories[name]
        t, state = one.sampled(500.0)
        fastest = float(np.max(np.abs(state.qd) / np.minimum(np.pi, found.robot.max_speed_rad_s)))
        as_in_paper = one.period_s == 10.0 and one.harmonics == 5 and t[-1] == 10.0 * found.settings.repetitions
        of[name] |= {
            "condition": float((one.objectives or {})["condition_number"]),
            "ends": float(max(np.max(np.abs(state.qd[[0, -1]])), np.max(np.abs(state.qdd[[0, -1]])))),
            "fastest_percent": 100.0 * fastest,
            "speed": fastest if as_in_paper else inf,
        }
    rigid = np.isfinite(found.truth)
    off = np.abs(identified.values - found.truth)[rigid] / identified.std[rigid]
    error = _errors(found)
    transfer = tuple(found.transfer[key].normalised_nm for key in ("ground", "ceiling", "ground regressor"))
    terms = {next(iter(row)): row for row in found.bases["wall"].terms}
    formulas = paper.appendix(found.robot)
    others = {lead: {name: value for name, value in terms.get(lead, {}).items() if name != lead} for lead in formulas}
    return {
        **of,
        "condition_ratio": of["ceiling"]["condition"] / of["ground"]["condition"],
        "their_condition_ratio": of["ceiling"]["condition"] / of["ground"]["condition"] / paper.CEILING_CONDITION,
        "evaluations": found.settings.evaluations,
        "identified": len(identified.names),
        "rigid": int(np.sum(rigid)),
        "off": np.median(off),
        "off_90": np.percentile(off, 90),
        "validation": printed.validation,
        **error,
        "gain": 1.0 - error["LS"] / error["before"],
        "gain_percent": 100.0 * (1.0 - error["LS"] / error["before"]),
        "their_gain": 100.0 * (1.0 - printed.validation[1] / printed.validation[0]),
        "wls_off": error["WLS"] / error["LS"] - 1.0,
        "wls_percent": 100.0 * (error["WLS"] / error["LS"] - 1.0),
        "their_wls_percent": 100.0 * (printed.validation[2] / printed.validation[1] - 1.0),
        "before_ratio": error["before"] / printed.validation[0],
        "ls_ratio": error["LS"] / printed.validation[1],
        "wls_ratio": error["WLS"] / printed.validation[2],
        "wls_time": found.wls_s / found.ls_s,
        "transfer": transfer,
        "carried": transfer[1] / transfer[0],
        "worse": transfer[2] / transfer[1],
        "wrong_ratio": transfer[2] / paper.TRANSFER[2],
        "formulas": len(formulas),
        "furthest": max(paper.furthest(others[lead], row) for lead, row in formulas.items()),
        "appendix_rows": len(found.bases["wall"].texts),
    }


def _of_temperature(found: Campaign) -> dict[str, Any]:
    printed = paper.PRINTED[found.robot.name]
    rise, change = found.temperature_c[-1] - found.temperature_c[0], _change(found.viscous)
    straight = _straight(found)
    runs, pace = len(found.viscous), change / rise
    return {
        "rise": span(rise, "K"),
        "their_rise": "10–17 K (UR5)" if printed.warm_c is not None else "not at hand for the UR3",
        "rise_inside": np.all((rise > RISE_K[0]) & (rise < RISE_K[1])),
        "change": span(100 * change, "%"),
        "their_change": span(100 * np.array(printed.viscous_change), "%"),
        "least_fall": -np.max(change),
        "straight": f"R² {np.min(straight):.3f} or more" if runs > 2 else "two runs make no line",
        "least_r2": np.min(straight) if runs > 2 else None,
        "pace": span(100 * pace, "%/K", digits=2),
        "pace_inside": np.all((pace > SLOPES_PER_K[0]) & (pace < SLOPES_PER_K[1])),
        "rigid_percent": 100 * found.rigid_std_of_torque,
        "rigid_share": found.rigid_std_of_torque,
        "rigid_drift": np.nanmax(np.abs(found.rigid_drift_std)),
        "coulomb": span(100 * _change(found.coulomb_nm), "%"),
    }


def _of_joints(found: Campaign) -> dict[str, dict[str, Any]]:
    """The figures of each joint beside the paper's, under its name."""
    printed, rise = paper.PRINTED[found.robot.name], found.temperature_c[-1] - found.temperature_c[0]
    fv, moved = _change(found.viscous), np.abs(found.warm_nm - found.cold_nm)
    measured = found.validation_nm["measured"]
    followed = {
        key: 1.0 - np.mean((measured - found.validation_nm[key]) ** 2, axis=0) / np.var(measured, axis=0) for key in ("LS", "before")
    }
    of: dict[str, dict[str, Any]] = {}
    for j, name in enumerate(JOINTS):
        theirs, average, largest = printed.viscous_change[j], np.mean(moved[:, j]), np.max(moved[:, j])
        of[name] = {
            "rise_k": rise[j], "their_rise_k": "", "followed": 100 * followed["LS"][j], "followed_before": 100 * followed["before"][j],
            "followed_share": followed["LS"][j], "their_fv": 100 * theirs, "our_fv": 100 * fv[j], "fv_ratio": fv[j] / theirs,
            "their_pace": "", "our_pace": 100 * fv[j] / rise[j], "pace_ratio": None,
            "elsewhere": "", "elsewhere_ratio": None,
            "their_average": printed.average_nm[j], "average": average, "average_ratio": average / printed.average_nm[j],
            "their_largest": printed.largest_nm[j], "largest": largest, "largest_ratio": largest / printed.largest_nm[j],
        }  # fmt: skip
        if printed.cold_c is not None and printed.warm_c is not None:
            their_rise = printed.warm_c[j] - printed.cold_c[j]
            of[name] |= {"their_rise_k": f", the paper's by {their_rise:.0f} K", "their_pace": f"{100 * theirs / their_rise:+z.2f} %/K"}
            of[name] |= {"pace_ratio": fv[j] / rise[j] / (theirs / their_rise)}
        if printed.elsewhere_change is not None:
            there = printed.elsewhere_change[j]
            of[name] |= {"elsewhere": f"{100 * there:+z.1f} %", "elsewhere_ratio": there / theirs}
    return of


def _of_sizes(found: Campaign) -> dict[str, dict[str, Any]]:
    """The largest change of torque over the maximum joint torque, as the mean over the joints of one size, under its name."""
    printed, limit = paper.PRINTED[found.robot.name], found.robot.max_torque_nm
    largest_nm, rise = np.max(np.abs(found.warm_nm - found.cold_nm), axis=0), found.temperature_c[-1] - found.temperature_c[0]
    of: dict[str, dict[str, Any]] = {}
    for torque, size in JOINT_SIZES[found.robot.name].items():
        own = limit == torque
        share, theirs = float(np.mean(largest_nm[own] / limit[own])), printed.share[size]
        figures = {"share": 100 * share, "their_share": 100 * theirs, "share_ratio": share / theirs, "rise_k": np.mean(rise[own])}
        of[f"size {size}"] = figures
    return of


def _counts(counts: tuple[int, ...]) -> str:
    return " / ".join(map(str, counts))


def _errors(found: Campaign) -> dict[str, float]:
    """e_N [N·m] of the validation by method, as if it had the paper's N: e_N falls with 1/√N."""
    scale = np.sqrt(found.samples / paper.SAMPLES)
    return {key: one.normalised_nm * scale for key, one in found.validation.items()}


def _change(values: Array) -> Array:
    """(J,) relative change from the first run to the last, of (R, J)."""
    result: Array = values[-1] / values[0] - 1.0
    return result


def _straight(found: Campaign) -> Array:
    """(J,) R² of a line through fv over temperature."""
    return np.array([r_squared(T, fv) for T, fv in zip(found.temperature_c.T, found.viscous.T, strict=True)])


def span(values: Array, unit: str, digits: int = 1) -> str:
    """The least and the largest of the values, with their unit."""
    return f"{np.min(values):.{digits}f} … {np.max(values):.{digits}f} {unit}"


def r_squared(x: Array, y: Array) -> float:
    """Share of the variance of y (N,) that a straight line over x (N,) explains; NaN for fewer than three points or a constant y."""
    if len(x) < 3 or not np.ptp(y) > 0:
        return float("nan")
    residual = y - np.polyval(np.polyfit(x, y, 1), x)
    return float(1.0 - np.var(residual) / np.var(y))


# --- The tables of the paper, with ours beside them ------------------------------------------------------


def _class_table(found: Campaign) -> tuple[str, Rows]:
    rows: list[list[Any]] = []
    for mounting, printed in paper.CLASSES.items():
        base = found.bases[mounting]
        rows.append([mounting, *map(_counts, (printed, base.as_in_paper.counts, base.by_column.counts))])
    columns = ("mounting", "paper", "ours, as it counts", "ours, by columns")
    return "Fully identifiable / in combination / without effect", Rows(columns, rows)


def _parameter_table(found: Campaign) -> tuple[str, Rows]:
    one = found.identified
    rows: list[list[Any]] = [
        [name, f"{value:z.4f}", f"{std:.4f}", None if not np.isfinite(true) else f"{true:z.4f}"]
        for name, value, std, true in zip(one.names, one.values, one.std, found.truth, strict=True)
    ]
    return "Base parameters on the ground", Rows(("parameter", "identified", "σ", "the simulated arm's own"), rows)


def _error_table(found: Campaign) -> tuple[str, Rows]:
    """e_N [N·m] and RMS of each joint, by method."""
    names = {"before": "before", "LS": "LS", "WLS": "WLS, the paper's W", "own": "WLS as the monitor does it"}
    errors, rows = _errors(found), []
    for (key, name), theirs in zip(names.items(), (*paper.PRINTED[found.robot.name].validation, None), strict=True):
        ours, rms = errors[key], "  ".join(f"{value:.2f}" for value in found.validation[key].rms_nm)
        beside = (None, None) if theirs is None else (f"{ours - theirs:+z.4f}", f"{100 * (ours / theirs - 1):+z.0f} %")
        rows.append([name, None if theirs is None else f"{theirs:.4f}", f"{ours:.4f}", *beside, rms])
    return "e_N [Nm]", Rows(("method", "paper", "ours", "difference", "relative", "RMS by joint [Nm]"), rows)


def _time_table(found: Campaign) -> tuple[str, Rows]:
    rows: list[list[Any]] = [["LS", f"{paper.LS_S:.2f} s", f"{found.ls_s:.2f} s"], ["WLS", f"{paper.WLS_S:.1f} s", f"{found.wls_s:.2f} s"]]
    return "Time to solve", Rows(("method", "paper", "ours"), rows)


def _temperature_table(found: Campaign) -> tuple[str, Rows]:
    printed, rows = paper.PRINTED[found.robot.name], []
    for j in range(found.robot.joints):
        cold, warm = found.temperature_c[0, j], found.temperature_c[-1, j]
        row = [f"joint {j + 1}", None, None, f"{cold:.1f}", f"{warm:.1f}", None]
        if printed.cold_c is not None and printed.warm_c is not None:
            row[1], row[2], row[5] = f"{printed.cold_c[j]:.1f}", f"{printed.warm_c[j]:.1f}", f"{warm - printed.warm_c[j]:+z.1f}"
        rows.append(row)
    columns = ("joint", "paper, cold", "paper, warm", "ours, cold", "ours, warm", "difference, warm")
    return "Joint temperatures [°C]", Rows(columns, rows)


def _viscous_table(found: Campaign) -> tuple[str, Rows]:
    theirs, change, coulomb = paper.PRINTED[found.robot.name].viscous_change, _change(found.viscous), _change(found.coulomb_nm)
    rise, straight = found.temperature_c[-1] - found.temperature_c[0], _straight(found)
    rows: list[list[Any]] = [
        [
            f"fv{j + 1}",
            f"{100 * theirs[j]:+z.1f} %",
            f"{100 * change[j]:+z.1f} %",
            f"{100 * (change[j] - theirs[j]):+z.1f}",
            f"{100 * change[j] / rise[j]:+z.2f}",
            f"{straight[j]:.3f}" if np.isfinite(straight[j]) else None,
            f"{100 * coulomb[j]:+z.1f} %",
        ]
        for j in range(found.robot.joints)
    ]
    columns = ("", "paper", "ours", "difference [%-points]", "ours [%/K]", "R² of the line", "fc, ours")
    return "Change over the campaign", Rows(columns, rows)


def _torque_table(found: Campaign) -> tuple[str, Rows]:
    printed, change = paper.PRINTED[found.robot.name], np.abs(found.warm_nm - found.cold_nm)
    rows: list[list[Any]] = []
    for j in range(found.robot.joints):
        row: list[Any] = [f"joint {j + 1}"]
        for theirs, ours in ((printed.average_nm[j], np.mean(change[:, j])), (printed.largest_nm[j], np.max(change[:, j]))):
            row += [f"{theirs:.2f}", f"{ours:.2f}", f"{ours - theirs:+z.2f}"]
        rows.append(row)
    columns = ("", "average, paper", "ours", "difference", "largest, paper", "ours", "difference")
    return "Change of joint torque [Nm]", Rows(columns, rows)


def _share_table(found: Campaign) -> tuple[str, Rows]:
    rows: list[list[Any]] = [
        [size, f"{one['their_share']:.1f} %", f"{one['share']:.1f} %", f"{one['share'] - one['their_share']:+z.1f}"]
        for size, one in _of_sizes(found).items()
    ]
    title = "Largest change over the maximum joint torque, mean of the size"
    return title, Rows(("joints", "paper", "ours", "difference [%-points]"), rows)


def _transfer_table(found: Campaign) -> tuple[str, Rows]:
    names = {"ground": "ground", "ceiling": "ceiling, its own regressor", "ground regressor": "ceiling, the ground's regressor"}
    rows: list[list[Any]] = []
    for (key, name), theirs in zip(names.items(), paper.TRANSFER, strict=True):
        ours = found.transfer[key].normalised_nm
        rows.append([name, f"{theirs:.4f}", f"{ours:.4f}", f"{ours - theirs:+z.4f}"])
    return "e_N [Nm]", Rows(("", "paper", "ours", "difference"), rows)


def _combinations(found: Campaign) -> tuple[str, Rows]:
    rows: list[list[Any]] = [[str(number), text] for number, text in enumerate(found.bases["wall"].texts, start=1)]
    return "Combinations on a wall", Rows(("", "combination"), rows)


# --- The sections in the order of the paper --------------------------------------------------------------


class Part(NamedTuple):
    """What a section shows besides its statements. Title and text are templates of robot, equations and replays."""

    title: str
    text: str
    tables: tuple[Callable[[Campaign], tuple[str, Rows]], ...] = ()
    drawing: tuple[Callable[[Campaign], "Figure"], str] | None = None


PARTS = {
    "figure_1": Part(
        "Figure 1 and §2.3: how many parameters show",
        "Singular values of the regressor at 25 random states, and what of the 78 standard parameters any motion can reveal.",
        (_class_table,),
        (drawings.singular_values, "Singular values, and the share of their energy Σσ² in the first ones."),
    ),
    "figure_2": Part(
        "Figure 2: excitation trajectories",
        "Fifth-order Fourier series of 10 s, three times, about [0, −π/2, 0, 0, 0, 0], searched by the paper's genetic algorithm for the "
        "smallest condition number of the base regressor. Ours must also keep clear of the arm itself and of the table or ceiling, along "
        "the whole path: the paper's limits on position do not see to that, and the best curves that touch something are not allowed here.",
        drawing=(drawings.trajectories, "One period on the ground and on the ceiling."),
    ),
    "figure_3": Part(
        "Figure 3: base parameters and their standard deviations",
        "Identified from one cold run by least squares as in the paper. A simulated arm has a truth to compare with; its friction follows "
        "another law, so fc and fv have none. The deviation σ is of noise; what the law misses moves the others by more.",
        (_parameter_table,),
        (drawings.parameters, "Base parameters by their leading term; the axis is linear within ± 0.1."),
    ),
    "table_3": Part(
        "Figures 4–6 and table 3: validation on a trajectory that was not fitted",
        f"e_N = √(eᵀe)/N in Nm, at the paper's N = {paper.SAMPLES}. Before: the manufacturer's masses and centres of mass alone.",
        (_error_table, _time_table),
        (drawings.validation, "One period of the validation trajectory."),
    ),
    "warm_up": Part(
        "Tables 4–7, first part: half an hour of warming up",
        "The same trajectory over and over; {replays} of the runs are stepped in full and identified, the heat of those "
        "between is computed from the last one's own losses.",
        (_temperature_table,),
    ),
    "figure_8": Part(
        "Figure 8 and tables 4–7, second part: viscous friction against temperature",
        "Overall change of fv from the first run to the last.",
        (_viscous_table,),
        (drawings.viscous_over_temperature, "fv of every identified run over the joint's mean temperature."),
    ),
    "figure_7": Part(
        "Figure 7 and tables 4–7, third part: joint torque, cold against warm",
        "Torque along the excitation as the cold and the warm identification have it.",
        (_torque_table, _share_table),
        (drawings.cold_and_warm, "One period of the excitation, first run and last."),
    ),
    "table_8": Part(
        "Figure 9 and table 8: the ground's parameters on the ceiling",
        "Without friction, as in the paper's own simulator. Parameters are identified on the ground and predict the ceiling's torque.",
        (_transfer_table,),
        (drawings.transfer, "One period of the ceiling's trajectory."),
    ),
    "appendix": Part(
        "Appendix, equations A{equations}: the base parameters in symbols",
        "All combinations on a wall, 54 of them, each led by the parameter that is kept. Rows that carry lengths of the arm are compared "
        "with the same rows as formulas of its published lengths.",
        (_combinations,),
    ),
}


def sections(found: Campaign) -> list[Section]:
    """The sections of one campaign in the order of the paper."""
    figures = figures_of(found)
    names = {"replays": found.settings.replays, "equations": 1 if found.robot.name == "ur3" else 2}
    return [
        Section(
            key,
            part.title.format_map(names),
            part.text.format_map(names),
            [check for statement in STATEMENTS if statement.section == key for check in statement.checks(figures)],
            [table(found) for table in part.tables],
            () if part.drawing is None else (part.drawing,),
        )
        for key, part in PARTS.items()
    ]
