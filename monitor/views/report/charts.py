"""The charts of the report: friction over time and over temperature, one panel for each joint."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.publish.timestamps import unix_s
from monitor.recording import Array
from monitor.views.language.catalogue import MONTHS, Language, utc
from monitor.views.report.sections import draw_maintenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

# of a NAMUR NE 107 state; dark enough for text on white paper
STATE_COLOURS = {
    "NORMAL": "#14682f", "CHECK_FUNCTION": "#a34e00", "OFF_SPEC": "#7d5e00", "MAINTENANCE_REQUIRED": "#1b4fae", "FAILURE": "#a3161c",
}  # fmt: skip
LINE, POINT = "#1f6fb4", "#c8781e"  # of the estimate, of a single replay; they differ in grey as well
MANY_POINTS = 300  # from so many on, points are drawn finer
MAX_POINTS = 1500  # of one joint in one chart; in print, more points merge


def _panels(height: float) -> "tuple[Figure, Any]":
    """A figure of `height` inches, and its six panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, height), layout="constrained")
    return figure, figure.subplots(2, 3).ravel()  # Any: the stubs of Axes do not accept times


def _of_joint(report: Mapping[str, Any], joint: int) -> list[Mapping[str, Any]]:
    """The history of one joint (from 1), thinned to about MAX_POINTS rows."""
    rows = [row for row in report["history"] if row["joint"] == joint]
    return rows[:: max(1, len(rows) // MAX_POINTS)]


def friction_over_time_caption(report: Mapping[str, Any], say: Language) -> str:
    """The caption of `friction_over_time`. It says how many replays have no point."""
    rows, of = report["history"], report["thresholds"]
    parts = [
        say.say(
            "Friction since the beginning, temperature taken out: the estimate as a line with its 2σ band, each replay by itself as a "
            "point with its 2σ interval. Across: the wear tier at {wear} % dashed, the limit at {limit} % dash-dotted.",
            wear=f"{100 * of['wear_rise']:g}",
            limit=f"{100 * of['limit_rise']:g}",
        )
    ]
    if any(row["remaining_life"]["p50_days"] is not None for row in report["joints"]):
        parts.append(say.say("Where there is a trend, a fan leads to the limit (P10 to P90, P50 dashed)."))
    missing = sum(1 for row in rows if row.get("replay_torque_nm") is None)
    if missing:
        parts.append(
            say.say(
                "Of {missing} of {count} figures the history keeps the estimate only, so they have no point.",
                missing=missing,
                count=len(rows),
            )
        )
    return " ".join(parts)


def single_replay_change(rows: Sequence[Mapping[str, Any]]) -> tuple[Array, Array]:
    """Change of friction [%] that each replay shows by itself, relative to the unworn friction of its day, and its std; both (N,).

    NaN where the history does not have it.
    """
    keys = ("replay_torque_nm", "replay_torque_std_nm", "reference_torque_nm", "wear")
    one, std, every, wear = (np.array([row.get(key) for row in rows], dtype=float) for key in keys)
    unworn = every / (1.0 + wear)
    return 100 * (one / unworn - 1.0), 100 * std / unworn


def friction_over_time(report: Mapping[str, Any], say: Language) -> "Figure":
    """Draw the change of friction since the beginning [%]: the estimate with its 2σ band, single replays, thresholds, remaining life."""
    from matplotlib.dates import AutoDateLocator

    figure, axes = _panels(2.75)
    of = report["thresholds"]
    for j, one in enumerate(axes):
        rows = _of_joint(report, j + 1)
        if not rows:
            one.set_visible(False)
            continue
        at = [utc(unix_s(row["recorded_at"])).replace(tzinfo=None) for row in rows]
        wear, std = (100 * np.array([row[key] for row in rows]) for key in ("wear", "wear_std"))
        one.fill_between(at, wear - 2 * std, wear + 2 * std, color=LINE, alpha=0.2, lw=0)
        alone, alone_std = single_replay_change(rows)
        many = len(rows) >= MANY_POINTS
        one.errorbar(at, alone, 2 * alone_std, fmt=".", ms=2 if many else 3, lw=0.25 if many else 0.4, color=POINT, alpha=0.5)
        one.plot(at, wear, "-", lw=1.4, color=LINE)
        top = max(float(np.max(wear + 2 * std)), float(np.nanmax([0.0, *(alone + 2 * alone_std)])), 100 * of["wear_rise"] * 1.3)
        # each level has its own dashes, because the page may be printed in grey
        for level, colour, dash in (
            (of["wear_rise"], STATE_COLOURS["MAINTENANCE_REQUIRED"], "--"),
            (of["limit_rise"], STATE_COLOURS["FAILURE"], "-."),
        ):
            if 100 * level < 1.2 * top or (_has_fan(rows[-1], level) and level == of["life_limit_rise"]):  # a fan leads to this line
                one.axhline(100 * level, color=colour, lw=0.9, ls=dash)
        one.set_ylim(min(-3.0, float(np.min(wear - 2 * std)), float(np.nanmin([0.0, *(alone - 2 * alone_std)]))), 1.15 * top)
        draw_maintenance(one, report, j + 1, at[-1], say)
        _remaining_life_fan(one, at, rows[-1], of["life_limit_rise"])
        locator = AutoDateLocator(minticks=2, maxticks=5)  # type: ignore[no-untyped-call]
        one.xaxis.set_major_locator(locator)
        one.xaxis.set_major_formatter(_date_ticks(at, say))
        _label(one, say, say.name(j + 1), say.say("change [%]") if j % 3 == 0 else "")
    return figure


def _has_fan(row: Mapping[str, Any], limit: float) -> bool:
    """Whether a joint has a remaining life that can be drawn."""
    life = row["remaining_life"]
    return life["verdict"] == "trend" and life["p50_days"] is not None and row["wear"] < limit


def _remaining_life_fan(one: Any, at: Sequence[datetime], row: Mapping[str, Any], limit: float) -> None:
    """Draw remaining life as a fan that ends at the limit: P10 to P90 filled, P50 dashed. It draws nothing where there is no trend."""
    if not _has_fan(row, limit):
        return
    life, wear = row["remaining_life"], row["wear"]
    ends = [np.inf if life[key] is None else life[key] for key in ("p10_days", "p50_days", "p90_days")]
    to = min(max(1.5 * (at[-1] - at[0]).days, 60.0), 1.05 * ends[2])
    parts = [min(1.0, to / end) for end in ends]
    x = [at[-1] + timedelta(days=min(to, end)) for end in ends]
    y = [100 * (wear + part * (limit - wear)) for part in parts]
    one.fill([at[-1], x[0], x[2], x[2]], [100 * wear, y[0], y[0], y[2]], color=LINE, alpha=0.2, lw=0)
    one.plot([at[-1], x[1]], [100 * wear, y[1]], "--", lw=1.1, color=LINE)
    one.set_ylim(top=max(one.get_ylim()[1], 1.12 * y[0]))


def friction_over_temperature(report: Mapping[str, Any], say: Language) -> "Figure":
    """Draw viscous friction over joint temperature [°C]: replays with wear taken out, and the temperature law with its 2σ band."""
    figure, axes = _panels(2.75)
    laws = {law["joint"]: law for law in report["verdict"]["temperature"]} if report["verdict"] else {}
    for j, one in enumerate(axes):
        rows = [row for row in _of_joint(report, j + 1) if row["temperature_c"] is not None and row["viscous_nm_s_per_rad"] is not None]
        if not rows:
            one.set_visible(False)
            continue
        T = np.array([row["temperature_c"] for row in rows])
        fv = np.array([row["viscous_nm_s_per_rad"] / (1.0 + row["wear"]) for row in rows])
        one.plot(T, fv, ".", ms=4, color=POINT)
        law = laws.get(j + 1)
        if law is not None and law["viscous_nm_s_per_rad"] is not None:
            pace = 100 * law["slope_nm_s_per_rad_k"] / law["viscous_nm_s_per_rad"]
            at, fv_at, std_at = law_points(law, [float(T.min()), float(T.max())])
            one.fill_between(at, fv_at - 2 * std_at, fv_at + 2 * std_at, color=LINE, alpha=0.2, lw=0)
            one.plot(at, fv_at, lw=1.4, color=LINE, label=f"{say.figure(pace, 2, signed=True)} %/K")
            one.legend(fontsize="x-small", frameon=False, loc="upper right")
        if j >= 3:
            one.set_xlabel("T [°C]", fontsize="small")
        _label(one, say, say.name(j + 1), "fv [N·m·s/rad]" if j % 3 == 0 else "")
    return figure


def law_points(law: Mapping[str, Any], seen_c: Sequence[float]) -> Array:
    """(3, P) temperature [°C], fv and its std [N·m·s/rad] along the law.

    A verdict of an early version has no points; then these are the two ends of its straight line, over `seen_c` where it has no range.
    """
    if law.get("viscous_by_temperature"):
        return np.array(law["viscous_by_temperature"]).T
    ends = np.array(law["range_c"] or seen_c)
    line = law["viscous_nm_s_per_rad"] + law["slope_nm_s_per_rad_k"] * (ends - law["reference_temperature_c"])
    return np.stack([ends, line, np.zeros(2)])


def _date_ticks(at: Sequence[datetime], say: Language) -> "FuncFormatter":
    """Dates along an axis in the reader's language: days, with hours within two days, or months with their year over more than a year."""
    from matplotlib.dates import num2date
    from matplotlib.ticker import FuncFormatter

    years, hours = (at[-1] - at[0]).days > 365, (at[-1] - at[0]).days < 2

    def text(value: float, _position: int | None) -> str:
        then = num2date(value)  # type: ignore[no-untyped-call]
        month = say.say(MONTHS[then.month - 1])[:3]
        day = f"{month} {then.year % 100:02d}" if years else say.say("{day} {month}", day=then.day, month=month)
        return f"{then:%H:%M}\n{day}" if hours else day

    return FuncFormatter(text)


def _label(one: Any, say: Language, title: str, ylabel: str) -> None:
    """Label one panel in the small type of the report, with the decimal sign of the language."""
    from matplotlib.ticker import FuncFormatter

    decimal = say.figure(0.5, 1)[1]
    one.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "\u2212").replace(".", decimal)))
    one.set_title(title, fontsize="small", loc="left")
    one.set_ylabel(ylabel, fontsize="small")
    one.tick_params(labelsize="x-small")
    one.xaxis.get_offset_text().set_size("x-small")
    one.grid(alpha=0.25)
