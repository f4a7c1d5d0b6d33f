"""What the commands `assess`, `rehearse`, `reproduce` and `prior` print."""

import math
from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from monitor.judge.friction.noise import NoisePriors
from monitor.judge.friction.prior import LIFE_RISE, SHARES
from monitor.reason import joint_text
from monitor.views.terminal.arm import print_not_alerting
from monitor.views.terminal.figures import number, standard_output, table_of, whole_percent


def print_assessment(document: dict[str, Any], why: int | None = None) -> None:
    """Print the verdict of every recording, the alerts, the warnings; for joint `why` (from 1), why it has no further alert."""
    console = Console()
    table = Table(title=f"{document['robot']}: {document['health']['arm']}, {document['why']['arm']['text']}", title_justify="left")
    for title in ("recording", "made at", "verdict", *(f"J{j + 1} wear [%]" for j in range(len(document["health"]["joints"])))):
        table.add_column(title, justify="right" if "wear" in title else "left")
    by_time: dict[str, list[dict[str, Any]]] = {}
    for row in document["friction"]:
        by_time.setdefault(row["recorded_at"], []).append(row)
    for row in document["recordings"]:
        wear = [f"{100 * j['wear']:+z.1f} ± {100 * j['wear_std']:.1f}" for j in by_time.get(row["recorded_at"], [])]
        table.add_row(row["file"], row["recorded_at"], row["verdict"], *wear)
    console.print(table)
    for alert in document["alerts"]:
        place = "arm" if alert["joint"] is None else joint_text(alert["joint"])
        active = "" if alert["active"] else " (cleared)"
        console.print(f"{place}: {alert['condition']}, {alert['tier']}{active}: {alert['text']} {alert['action']}", highlight=False)
    if not document["alerts"]:
        console.print("no alert")
    for row in document["not_alerting"]:
        if row["joint"] == why:
            print_not_alerting(row["joint"], row["reasons"])
    for code in sorted({warning["code"] for warning in document["warnings"]}):
        first = next(warning for warning in document["warnings"] if warning["code"] == code)
        count = sum(warning["code"] == code for warning in document["warnings"])
        more = f" (and {count - 1} more like it)" if count > 1 else ""
        console.print(f"warning {code}: {first['file']}: {first['text']}{more}", highlight=False, markup=False)
    for row in document["recordings"]:
        if row["reason"]:
            console.print(f"rejected {row['file']}: {row['reason']['text']}", highlight=False, markup=False)


def print_rehearsal(document: dict[str, Any]) -> None:
    """Print false alarms, days to detection, coverage and remaining life of a rehearsal on the simulated fleet."""
    console = Console()
    years, noise = document["robot_years"], 100 * document["between_std"]
    console.print(
        f"{years:.0f} robot-years on which nothing wears, friction {noise:.1f} % from replay to replay with "
        f"ρ = {document['autocorrelation']:g}; the first {document['learning_days']} days left out",
        highlight=False,
    )
    table = table_of(
        ("scenario", "alerts", "a robot-year", "at most (95 %)"), left=("scenario",), title="alerts that mean nothing, advisories counted"
    )
    for name, rate in document["false_alarms"].items():
        table.add_row(name, str(rate["events"]), f"{rate['per_year']:.3f}", f"{rate['at_most']:.3f}")
    console.print(table)
    table = table_of(
        ("wear of one joint", "arms", "median", "9 of 10", "within 30", "right joint", "wear tier, median"),
        left=("wear of one joint",),
        title="days from the onset to the first tier",
    )
    for row in document["detection"]:
        days = [number(row[key], ".0f") for key in ("median_days", "p90_days")]
        shares = [whole_percent(row[key]["share"]) for key in ("within_30_days", "right_joint")]
        table.add_row(row["wear"], str(row["arms"]), *days, *shares, number(row["wear_tier_median_days"], ".0f"))
    console.print(table)
    life = document["remaining_life"]
    console.print(
        f"90 % intervals of friction hold the truth in {whole_percent(document['friction_interval_90']['value'])}; "
        f"P10–P90 of remaining life in {whole_percent(life['p10_p90_holds']['share'])}; P50 within 20 % at half-life in "
        f"{whole_percent(life['alpha_lambda_at_half_life']['share'])}",
        highlight=False,
    )


def print_world(document: dict[str, Any]) -> None:
    """Print false advisories, days to detection and coverage of a fleet in one world."""
    console = Console()
    console.print(
        f"{document['world']}: {document['sentence']}; {document['robot_years']:.0f} robot-years on which nothing wears, "
        f"the first {document['learning_days']} days left out",
        highlight=False,
        markup=False,
    )
    false, goal = document["false_advisories"], document["goal"]
    table = table_of(
        ("kind", "number", "come back", "a year", "at most (95 %)", "asked for"), left=("kind",), title="false advisories, a robot-year"
    )
    for name in ("rising", "falling", "common", "counted"):
        rate, counted = false[name], name in (*false["counted"]["kinds"], "counted")
        asked = f"≤ {goal['false_advisories']:g}" if name == "counted" else "" if counted else "not counted"
        again = str(rate["again"]) if "again" in rate else ""
        table.add_row(name, str(rate["events"]), again, f"{rate['per_year']:.3f}", f"{rate['at_most']:.3f}", asked)
    console.print(table)
    payload, wrong = document["payload_found"], false["payload"]["events"]
    if payload["of"]:
        console.print(
            f"payload_contradiction in {payload['arms']} of {payload['of']} arms that carry what nobody declared; {wrong} elsewhere"
        )
    table = table_of(
        ("wear", "arms", "median", "asked", "9 of 10", "in 30", "never", "right joint"),
        left=("wear",),
        title="days from the onset to the first tier",
    )
    for row in document["detection"]:
        asked = goal["median_days"].get(row["wear"])
        days = [number(row["median_days"], ".0f"), "" if asked is None else f"≤ {asked:g}", number(row["p90_days"], ".0f")]
        shares = [whole_percent(row[key]["share"]) for key in ("within_30_days", "never", "right_joint")]
        table.add_row(row["wear"], str(row["arms"]), *days, *shares)
    console.print(table)
    lives = [(row["wear"], life) for row in document["detection"] for life in row["remaining_life"]]
    if lives:
        table = table_of(
            ("wear", "at", "no date", "P10–P90 holds", "P50 within 20 %", "P50 / truth"), left=("wear",), title="remaining life, asked at"
        )
        for wear, life in lives:
            shares = [whole_percent(life[key]["share"]) for key in ("p10_p90_holds", "p50_near")]
            of_life = (whole_percent(life["at_share_of_life"]), f"{life['without_date']} of {life['asked']}")
            table.add_row(wear, *of_life, *shares, number(life["p50_over_truth"], ".2f"))
        console.print(table)
    interval = document["interval_90"]
    console.print(
        f"90 % intervals of friction hold the truth in {whole_percent(interval['healthy'])} of the days of healthy joints, and in "
        f"{whole_percent(interval['worn'])} of those that wear",
        highlight=False,
    )


def print_reproduction(document: dict[str, Any], output: str | None) -> None:
    """Print every compared statement of the paper, by robot, and where the report was written."""
    console = standard_output(150)
    styles = {"holds": "green", "missed": "yellow", "DOES NOT HOLD": "bold red"}
    for robot in document["robots"]:
        table = Table(title=robot["robot"], title_justify="left")
        for title in ("", "statement", "paper", "ours"):
            table.add_column(title, overflow="fold")
        for section in robot["sections"]:
            for check in section["checks"]:
                verdict = check["verdict"]
                table.add_row(
                    f"[{styles.get(verdict, 'dim')}]{verdict}[/]", escape(check["what"]), escape(check["paper"]), escape(check["ours"])
                )
        console.print(table)
    checks = [check for robot in document["robots"] for section in robot["sections"] for check in section["checks"]]
    told = Counter((check["expected"] == "near", check["verdict"]) for check in checks)
    console.print(
        f"{told[False, 'holds']} statements that must agree hold, {told[False, 'DOES NOT HOLD']} do not. Of the paper's own arms "
        f"{told[True, 'holds']} figures are within their bound, {told[True, 'missed']} are not; "
        f"{told[False, 'must differ']} must differ, as the arms are simulated; {document['took_s']:.0f} s"
    )
    for check in checks:
        if check["verdict"] == "missed":
            console.print(f"missed: {check['what']}, {check['ours']} for {check['paper']}: {check['why']}", markup=False)
    if output is not None:
        console.print(f"written: {output}", markup=False)


def print_prior(document: dict[str, Any], output: Path | None) -> None:
    """Print what a fleet says of a new arm, one table a model, and how a configuration takes it. output : the file; None: there is none."""
    console = standard_output(100)
    for model, own in document["models"].items():
        arms = f"{own['arms']} arm{'' if own['arms'] == 1 else 's'}"
        table = table_of(
            ("joint", "friction [N·m]", "falls [%/K]", "grease lags [%/(K/min)]"),
            title=f"{model}: {arms}, {own['joint_years']:.1f} joint-years",
        )
        for row in own["joints"]:
            table.add_row(
                str(row["joint"]),
                f"{row['friction_nm']:.2f} ± {100 * row['friction_spread']:.0f} %",
                f"{100 * row['slope_per_k']:.2f} ± {100 * row['slope_std_per_k']:.2f}",
                f"{100 * row['lag']:.1f} ± {100 * row['lag_std']:.1f}",
            )
        console.print(table)
        console.print(_noise_line(**own["noise"]), soft_wrap=True, markup=False)
        if (wear := own.get("wear")) is not None:
            paths = ", ".join(f"{100 * wear[name]:.0f} % {name}" for name in SHARES)
            life = f"{whole_percent(LIFE_RISE)} more friction {wear['life_days']:.0f} usual days after it began"
            paths += f"; {life}, × or ÷ {math.exp(wear['life_spread']):.1f}"
            console.print(f"{wear['joints']} joints that wear: {paths}", soft_wrap=True, markup=False)
    for sentence in document["learnt_from"]["left_out"]:
        console.print(f"left out: {sentence}", soft_wrap=True, markup=False)
    if output is not None:
        console.print(f'for a new arm, in its configuration: [drift] prior = "{output}"', soft_wrap=True, markup=False)


def _noise_line(std: float, weights: list[float]) -> str:
    """What a fleet says of noise between replays. weights : of the kinds of noise."""
    kinds = NoisePriors().kinds
    rho = sum(weight * kind.from_day_to_day for weight, kind in zip(weights, kinds, strict=True))
    slow = sum(weight for weight, kind in zip(weights, kinds, strict=True) if kind.lasts)
    return f"noise between replays ± {100 * std:.1f} %, correlation {rho:.2f} a day; {whole_percent(slow)} wander or swing with the year"
