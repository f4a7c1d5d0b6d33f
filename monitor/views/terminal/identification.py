"""What the commands `identify`, `base`, `energy` and `design` print."""

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from monitor.identify.signals.ripple import FAST
from monitor.views.terminal.figures import number, pair, percent, standard_output, table_of


def print_identification(document: dict[str, Any], *, verbose: bool = False) -> None:
    """Print an identification: its recordings, friction and fit of every joint, what was asked beside, and warnings.

    verbose : also the gears' ripple, and the error of the whole fit on recordings that were held out.
    """
    console = standard_output(120, highlight=True)
    for recording in document["recordings"]:
        why = ", ".join(f"{count} {reason}" for reason, count in recording["rejected_why"].items())
        rejected = f", {recording['rejected_samples']} rows rejected ({why})" if recording["rejected_samples"] else ""
        size = f"{recording['samples']} samples, {recording['rate_hz']:.0f} Hz, {recording['duration_s']:.1f} s"
        line = f"{escape(recording['file'])}: {size}{rejected}"
        console.print(line, highlight=False)
    base = document["base_parameters"]
    console.print(
        f"{base['count']} base parameters by {document['method']}, condition number {number(base['condition_number'], '.0f')}",
        highlight=False,
    )
    friction, fit = document["friction"], document["fit"]
    table = Table()
    # ± is noise; another motion may change fc and fv by so much more, as the law is not quite the arm's
    others = [friction.get(key) for key in ("coulomb_misfit_std_nm", "viscous_misfit_std_nm_s_per_rad")]
    other = ["motion"] if others[0] is not None else []
    titles = ["joint", "fc [Nm]", *other, "fv [Nm·s/rad]", *other, "T [°C]", "RMS [Nm]", "relative"]
    for validation in document["validation"]:
        titles.append(f"held out:\n{validation['file'].rsplit('/', 1)[-1][-24:]}")
    for title in titles:
        table.add_column(title, justify="right")
    temperatures = friction["temperature_c"] or [None] * len(friction["coulomb_nm"])
    for j, temperature in enumerate(temperatures):
        cells = [
            str(j + 1),
            pair(friction["coulomb_nm"][j], friction["coulomb_std_nm"][j]),
            *(f"± {number(each[j], '.2f')}" for each in others[:1] if each is not None),
            pair(friction["viscous_nm_s_per_rad"][j], friction["viscous_std_nm_s_per_rad"][j]),
            *(f"± {number(each[j], '.2f')}" for each in others[1:] if each is not None),
            number(temperature, ".1f"),
            number(fit["rms_nm"][j], ".3f"),
            percent(fit["relative_rms"][j]),
        ]
        for held in document["validation"]:
            cells.append(
                f"{percent(held['relative_rms'][j])} ({number(held['nominal_rms_nm'][j], '.1f')} → {number(held['rms_nm'][j], '.2f')} Nm)"
            )
        table.add_row(*cells)
    console.print(table)
    _print_speeds(console, friction.get("at_speeds", []))
    _print_extras(console, document, verbose=verbose)
    for warning in document["warnings"]:
        console.print(f"[yellow]{warning['code']}[/]: {warning['text']}", highlight=False)


def _print_speeds(console: Console, speeds: list[dict[str, Any]]) -> None:
    """Print friction at some speeds, with nine tenths of what another run finds: a row a joint."""
    if not speeds:
        return
    table = Table()
    for title in ("joint", *(f"F at {row['speed_rad_s']} rad/s, 90 % [Nm]" for row in speeds)):
        table.add_column(title, justify="right")
    for j in range(len(speeds[0]["torque_nm"])):
        cells = [f"{number(row['torque_nm'][j], '.2f')} ± {number(row['another_run_90_nm'][j], '.2f')}" for row in speeds]
        table.add_row(str(j + 1), *cells)
    console.print(table)


def _print_extras(console: Console, document: dict[str, Any], *, verbose: bool) -> None:
    """Print the parts of the document that options ask for: friction law, validation, joint gains, physical arm, payload."""
    friction = document["friction"]
    if verbose:
        _print_ripple(console, document.get("ripple", []))
    law = friction["law"]
    if law.get("values"):
        for name in law["parameters"]:
            pairs = zip(law["values"][name], law["std"][name], strict=True)
            values = "  ".join(f"{number(value, '.3f')} ± {number(std, '.3f')}" for value, std in pairs)
            console.print(f"friction law {law['name']}, {name}: {values}", highlight=False)
    if law.get("held_out"):
        errors = ", ".join(f"{name} {number(error, '.3f')}" for name, error in law["held_out"].items())
        console.print(f"chosen by the error on data left out, in units of the noise: {errors}", highlight=False)
    for held in document["validation"] if verbose else ():
        before, after = held["nominal_normalised_error_nm"], held["normalised_error_nm"]
        console.print(f"{held['file']}: e_N before {before:.4f}, after {after:.4f} Nm ({held['samples']} samples)", highlight=False)
    if "gains" in document:
        gains = document["gains"]
        pairs = zip(gains["values_nm_per_a"], gains["std_nm_per_a"], strict=True)
        values = "  ".join("– " if value is None else f"{value:.2f} ± {std:.2f}" for value, std in pairs)
        console.print(f"joint gains from the payload pair [Nm/A]: {values}", highlight=False)
    if "physical" in document:
        physical = document["physical"]
        masses = "  ".join(f"{link['mass_kg']:.2f}" for link in physical["links"])
        console.print(
            f"physically consistent: masses {masses} kg; residual {100 * (physical['residual_ratio'] - 1):+z.2f} % beside unconstrained",
            highlight=False,
        )
    if "payload" in document:
        payload = document["payload"]
        centre = ", ".join(number(value, ".3f") for value in payload["com_m"])
        console.print(
            f"payload: {payload['mass_kg']:.3f} ± {payload['mass_std_kg']:.3f} kg, centre ({centre}) m in the flange's frame",
            highlight=False,
        )


def _print_ripple(console: Console, joints: list[dict[str, Any]]) -> None:
    """Print the gear ripple of all joints, a line for each order; where the sample rate hides it, that is said."""
    for order, often in enumerate(("once", "twice", "four times")):
        pairs = [(joint["amplitude_a"][order], joint["std_a"][order]) for joint in joints]
        if any(amplitude is not None for amplitude, _ in pairs):
            values = "  ".join(
                "–" if None in (amplitude, std) else f"{1000 * amplitude:.0f} ± {1000 * std:.0f}" for amplitude, std in pairs
            )
            console.print(f"gear ripple, {often} a turn of the motor, in mA: {values}", highlight=False)
        hidden = [joint for joint in joints if joint["why_not"][order] == FAST]
        if hidden:
            who = " ".join(str(joint["joint"]) for joint in hidden)
            limit = max(joint["up_to_rad_s"][order] for joint in hidden)
            text = f"gear ripple, {often} a turn of the motor: not quoted for joints {who}, which are too fast for the sample rate; "
            console.print(f"{text}it shows ripple up to {limit:.2g} rad/s", highlight=False)


def print_base(document: dict[str, Any]) -> None:
    """Print the base parameters, the singular values of the regressor, and which parameters are identifiable alone."""
    console = standard_output(120)
    sigma, count = document["singular_values"], document["count"]
    console.print(f"{escape(document['robot'])}: {count} base parameters of {len(sigma)} standard ones")
    table = Table()
    table.add_column("", justify="right")
    table.add_column("base parameter, led by the column that is kept")
    for k, row in enumerate(document["combinations"]):
        table.add_row(str(k + 1), row["text"])
    console.print(table)
    console.print("singular values of the regressor at 25 random states, and their cumulative energy Σσ²:")
    pairs = [f"{value:.3g} ({100 * share:.2f} %)" for value, share in zip(sigma, document["cumulative_energy"], strict=True)]
    console.print("  " + ", ".join(pairs[:count]) + (f"; then {sigma[count]:.1g} and less" if count < len(sigma) else ""))
    counts = table_of(("parameters", "fully", "in combination", "not identifiable"), left=("parameters",))
    for title, key in (("by columns", "by_column"), ("as the paper counts", "as_in_paper")):
        row = document["classification"][key]
        counts.add_row(title, str(row["fully"]), str(row["in_combination"]), str(row["not_identifiable"]))
    console.print(counts)
    quotable = document["quotable"]
    console.print(f"may be quoted alone, in {quotable['frames']} frames: {', '.join(quotable['parameters']['fully'])}")
    console.print(f"without effect on any torque: {', '.join(quotable['parameters']['not_identifiable'])}")
    for note in document["notes"]:
        console.print(f"[yellow]note[/]: {note}")


def print_energy(document: dict[str, Any]) -> None:
    """Print kinetic energy and flange speed along a trajectory, and the transfer energy to every body region."""
    console = standard_output(120)
    energy, speed = document["kinetic_energy_j"], document["flange_speed_m_s"]
    std = number(energy["std_at_max"], ".2g")
    console.print(
        f"{escape(document['robot'])} along {escape(document['along'])}: {document['samples']} samples, {document['duration_s']:.1f} s"
    )
    console.print(f"kinetic energy at most {energy['max']:.2f} ± {std} J (at {energy['at_s']:.2f} s), {energy['mean']:.2f} J on average")
    console.print(f"flange at most {speed['max']:.2f} m/s (at {speed['at_s']:.2f} s)")
    if document.get("regions"):
        mass = document["effective_mass"]
        console.print(f"effective mass of the robot {mass['robot_kg']:.2f} kg with {mass['payload_kg']:g} kg payload: {mass['formula']}")
        table = table_of(
            ("region", "limit [J]", "its mass [kg]", "transfer energy [J]", "time above", "below limit", "whole arm below"),
            left=("region",),
        )
        words = {True: "[green]yes[/]", False: "[bold red]no[/]", None: "unknown"}
        for row in document["regions"]:
            table.add_row(
                escape(row["region"]),
                f"{row['limit_j']:g}",
                number(row["body_mass_kg"], "g") if row["body_mass_kg"] is not None else "cannot yield",
                f"{row['transfer_energy_max_j']:.3f}",
                f"{100 * row['share_of_time_above']:.1f} %",
                words[row["transfer_energy_below_limit"]],
                words[row["whole_arm_below_limit"]],
            )
        console.print(table)
    console.print(f"[bold]{document['statement']}[/]")
    for warning in document["warnings"]:
        console.print(f"[yellow]{warning['code']}[/]: {warning['text']}")


def print_design(file: str, document: dict[str, Any]) -> None:
    """Print what a designed trajectory is worth: clearance, conditioning, and for every joint the expected standard deviations."""
    console = standard_output(120)
    proof, merits = document["proof"], document["objectives"]
    console.print(f"{file}: {document['robot']}, {document['repetitions']} × {document['period_s']:g} s; {document['source']}")
    clearance = proof["clearance"]
    console.print(f"clear of itself by {1000 * clearance['to_itself_m']:.0f} mm ({clearance['itself']})")
    if "to_cell_m" in clearance:
        cell = document["cell"]["cell"]
        console.print(f"clear of the cell {cell['name']!r} by {1000 * clearance['to_cell_m']:.0f} mm ({clearance['cell']})")
    for approach in proof["approaches"]:
        gap = min(approach["to_itself_m"], approach.get("to_cell_m", float("inf")))
        pose = ", ".join(f"{angle:.2f}" for angle in approach["from_rad"])
        console.print(f"approach from [{pose}]: clear by {1000 * gap:.0f} mm", markup=False)
    console.print(
        f"condition number {number(merits['condition_number'], '.0f')}, of scaled columns "
        f"{number(merits['scaled_condition_number'], '.0f')}; log det of the covariance: all "
        f"{number(merits['log_det_covariance_all'], '.1f')}, friction {number(merits['log_det_covariance_friction'], '.1f')}"
    )
    console.print(f"flange at most {proof['flange_speed_m_s']:.2f} m/s")
    table = table_of(
        ("joint", "fc std [Nm]", "fv std [Nm·s/rad]", "speeds [rad/s]", "moving", "position", "speed", "acceleration", "torque")
    )
    for j, (slow, fast) in enumerate(merits["speed_range_rad_s"]):
        shares = (proof[f"{name}_share"][j] for name in ("position", "speed", "acceleration", "torque"))
        table.add_row(
            str(j + 1),
            number(merits["coulomb_std_nm"][j], ".3f"),
            number(merits["viscous_std_nm_s_per_rad"][j], ".3f"),
            f"{number(slow, '.2f')} – {number(fast, '.2f')}",
            f"{100 * merits['moving_share'][j]:.0f} %",
            *(f"{100 * share:.0f} %" for share in shares),
        )
    console.print(table)
    console.print("deviations to expect of one repetition, residuals correlated; shares are of the limits")
