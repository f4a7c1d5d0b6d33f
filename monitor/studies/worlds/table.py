"""The worlds by name: those of a table of goals, and others of their classes."""

from dataclasses import replace

import numpy as np

from monitor.studies.worlds.fleet import Goal, World
from monitor.studies.worlds.laws import (
    RATE_10,
    STEP_5,
    Correlated,
    Heat,
    Wear,
    bad_days,
    exponential,
    gain,
    level_jumps,
    modulated,
    payload,
    power,
    power_law,
    regrease,
    running_in,
    sawtooth,
    seasonal_std,
    sensor_shift,
    sensor_silence,
    step,
    stepping_std,
    straight,
    swelling_std,
    telegraph,
    together,
    wandering,
    weekday,
    yearly,
)

LATE_RATE = Wear(name="10 %/year", path=straight(0.10), earliest_day=260.0, latest_day=425.0)
LATE_STEP = Wear(name="5 % step", path=step(0.05), earliest_day=260.0, latest_day=425.0)
SUMMER_STEP = Wear(name="5 % step", path=step(0.05), earliest_day=90.0, latest_day=290.0)
LOW_SPEED = Wear(name="slow friction", path=step(1.0), dry=0.20, viscous=-0.18)
LOCAL = Wear(name="one place", path=step(1.0), dry=0.02, viscous=0.02, residual=float(np.log(2.0)))

_LISTED = (
    World(
        name="plain",
        sentence="σ 2 %, ρ 0.5, temperature known",
        goal=Goal(within_days=(("5 % step", 11), ("10 %/year", 115)), nine_of_ten_days=(("5 % step", 30),)),
    ),
    World(name="noise-3", sentence="σ 3 % in every joint", noise=Correlated(std=0.03)),
    World(name="noise-4", sentence="σ 4 % in every joint", noise=Correlated(std=0.04), goal=Goal(within_days=(("5 % step", 40),))),
    World(name="noise-5", sentence="σ 5 % in every joint", noise=Correlated(std=0.05)),
    World(name="noise-mixed", sentence="σ from 0.5 to 5 % from joint to joint", noise=Correlated(std=(0.005, 0.05))),
    World(name="ar-08", sentence="σ 2 %, ρ 0.8", noise=Correlated(rho=0.8)),
    World(name="ar-09", sentence="σ 2 %, ρ 0.9", noise=Correlated(rho=0.9), goal=Goal(false=0.15)),
    World(name="one-over-f", sentence="1/f noise, σ 2 % over three years", noise=power_law(), goal=Goal(false=0.3)),
    World(
        name="seasonal-noise",
        sentence="σ 4 % in winter, 1 % in summer",
        noise=modulated(seasonal_std(0.04, 0.01)),
        goal=Goal(false=0.2),
    ),
    World(
        name="seasonal-noise-mild",
        sentence="σ 2.8 % in winter, 1.4 % in summer",
        noise=modulated(seasonal_std(0.028, 0.014)),
    ),
    World(name="student-t3", sentence="Student's t₃, σ 2 %, ρ 0.5", noise=Correlated(degrees=3.0)),
    World(
        name="running-in",
        sentence="friction falls by 5–10 % in the first months",
        changes=(running_in(),),
        goal=Goal(within_days=(("5 % step", 30), ("10 %/year", 200))),
    ),
    World(
        name="slow-common",
        sentence="±2 % a year that is not temperature, common to the joints",
        changes=(yearly(common=True),),
        goal=Goal(false=0.3),
    ),
    World(
        name="slow-joint",
        sentence="±2 % a year that is not temperature, of each joint",
        changes=(yearly(common=False),),
        goal=Goal(false=0.3),
    ),
    World(
        name="all-joints-3",
        sentence="another scale of current, +3 %, undeclared",
        changes=(gain(),),
        goal=Goal(counted=("rising", "falling")),
    ),
    World(name="payload-03", sentence="0.3 kg mounted, undeclared", changes=(payload(),)),
    World(
        name="regrease-then-wear",
        sentence="new grease undeclared, −10 %, then wear",
        changes=(regrease(),),
        wear=(LATE_STEP, LATE_RATE),
        goal=Goal(counted=("rising",), within_days=(("10 %/year", 150),)),
    ),
    World(
        name="summer-24",
        sentence="learnt in winter, the summer is 24 K warmer",
        heat=Heat(season_k=12.0, coldest_day=15.0),
        wear=(SUMMER_STEP, RATE_10),
        goal=Goal(nine_of_ten_days=(("5 % step", 45),)),
    ),
    World(
        name="quiet",
        sentence="σ 1 %, ρ 0",
        noise=Correlated(std=0.01, rho=0.0),
        goal=Goal(within_days=(("5 % step", 4), ("10 %/year", 91))),
    ),
    World(
        name="low-speed-wear",
        sentence="wear at low speed only: dry +20 %, viscous −18 %",
        wear=(LOW_SPEED,),
        goal=Goal(within_days=((LOW_SPEED.name, 30),)),
    ),
    World(
        name="local-wear",
        sentence="wear at one place of the joint: +60 % over 0.1 rad, what the fit leaves doubles",
        wear=(LOCAL,),
        goal=Goal(within_days=((LOCAL.name, 30),)),
    ),
    World(
        name="two-joints",
        sentence="two joints wear at once",
        wear=(Wear(name="5 % step in two", path=step(0.05), joints=2),),
        goal=Goal(within_days=(("5 % step in two", 9),)),
    ),
    World(
        name="all-six",
        sentence="all six joints wear at once",
        wear=(Wear(name="5 % step in all", path=step(0.05), joints=6),),
        goal=Goal(within_days=(("5 % step in all", 12),)),
    ),
    World(
        name="grease-lag",
        sentence="the grease lags 10–30 min, replays at random times after the start",
        heat=Heat(lag_min=(10.0, 30.0), started_min=(2.0, 90.0), warm_up_k=(6.0, 16.0)),
        goal=Goal(interval=(0.85, 0.95)),
    ),
    World(
        name="paths",
        sentence="wear on straight, exponential, √t and quadratic paths to +30 % in one to two and a half years",
        wear=tuple(
            Wear(name=name, path=path, latest_day=120.0, life_years=(1.0, 2.5))
            for name, path in (
                ("straight", straight(0.30)),
                ("exponential", exponential(0.30)),
                ("√t", power(0.30, 0.5)),
                ("t²", power(0.30, 2.0)),
            )
        ),
    ),
)
_OTHERS = (
    World(name="student-t3-white", sentence="Student's t₃, σ 2 %, ρ 0", noise=Correlated(degrees=3.0, rho=0.0)),
    World(
        name="running-in-slow",
        sentence="friction falls by 5–15 % in the first year",
        changes=(running_in(fall=(0.05, 0.15), time_constant_days=(60.0, 150.0)),),
        wear=(LATE_STEP, LATE_RATE),
        goal=Goal(within_days=(("5 % step", 30), ("10 %/year", 200))),
    ),
    World(
        name="summer-24-sudden",
        sentence="learnt in winter, and the 24 K come within weeks",
        heat=Heat(season_k=12.0, coldest_day=15.0, sharpness=3.0),
        wear=(SUMMER_STEP, RATE_10),
        goal=Goal(nine_of_ten_days=(("5 % step", 45),)),
    ),
    World(
        name="low-speed-wear-two-figures",
        sentence="the same, and of each fit only F, fc and fv",
        wear=(LOW_SPEED,),
        channels=False,
        goal=Goal(within_days=((LOW_SPEED.name, 30),)),
    ),
    World(
        name="noise-steps",
        sentence="σ jumps between 1.5 and 4 %, for half a year each",
        noise=modulated(stepping_std(0.015, 0.04, 180.0)),
        goal=Goal(false=0.2),
    ),
    World(
        name="noise-swells",
        sentence="σ of each joint swells and calms down by a factor of two, about 2 %, within a month",
        noise=modulated(swelling_std(0.02, 30.0, 0.6)),
        goal=Goal(false=0.3),
    ),
    World(name="student-t4-ar-07", sentence="Student's t₄ with ρ 0.7", noise=Correlated(degrees=4.0, rho=0.7)),
    World(name="missing-weeks", sentence="four gaps of three weeks a year", gap=(4.0, 21), missed=0.1),
    World(name="weekdays", sentence="Mondays differ by 2 %", changes=(weekday(),)),
    World(
        name="walk-common",
        sentence="a slow walk of 2 % within four months, common to the joints",
        changes=(wandering(common=True),),
        goal=Goal(false=0.3),
    ),
    World(
        name="walk-joint",
        sentence="a slow walk of 1.5 % within four months, of each joint",
        changes=(wandering(common=False, std=0.015),),
        goal=Goal(false=0.3),
    ),
    World(
        name="walk-in-noise",
        sentence="σ 3.5 %, and a slow walk of 2.5 % within four months, of each joint",
        noise=Correlated(std=0.035),
        changes=(wandering(common=False, std=0.025),),
        goal=Goal(false=0.3),
    ),
    World(
        name="noise-and-walk",
        sentence="white noise of 1.5 % and 1/f² noise of 1 % over three years",
        noise=together(Correlated(std=0.015, rho=0.0), power_law(std=0.01, exponent=2.0)),
        goal=Goal(false=0.3),
    ),
    World(
        name="gear-oil-creep",
        sentence="new oil undeclared, −6 %, half of it creeps back",
        changes=(regrease(fall=0.06, creep=0.5, creep_days=60.0),),
        wear=(LATE_STEP, LATE_RATE),
        goal=Goal(counted=("rising",)),
    ),
    World(
        name="payload-heavier",
        sentence="0.8 kg mounted, undeclared",
        changes=(payload(mass_kg=0.8, rise=(0.003, 0.035, 0.030, 0.012, 0.008, 0.001)),),
        goal=Goal(false=0.3),
    ),
    World(
        name="payload-for-a-month",
        sentence="0.3 kg mounted for a month, undeclared",
        changes=(payload(kept_days=30.0),),
        wear=(STEP_5,),
    ),
    World(
        name="twice-a-day-replay",
        sentence="two replays a day, what differs belongs to the replay: σ 2 %, ρ 0.25",
        replays_a_day=2,
        noise=Correlated(rho=0.25),
    ),
    World(
        name="twice-a-day-time",
        sentence="two replays a day, what differs belongs to the time: σ 2 %, ρ 0.9 from one to the next",
        replays_a_day=2,
        noise=Correlated(rho=0.9),
        goal=Goal(false=0.2),
    ),
    World(
        name="four-a-day",
        sentence="four replays a day: σ 2 %, ρ 0.5 from one to the next",
        replays_a_day=4,
    ),
    World(
        name="noise-shared",
        sentence="half of the variance is common to the arm's joints; σ 2 %, ρ 0.5",
        noise=together(Correlated(std=0.0141), Correlated(std=0.0141, common=True)),
    ),
    World(
        name="rho-mixed",
        sentence="ρ from 0 to 0.9, σ from 1 to 4 % from joint to joint",
        noise=Correlated(std=(0.01, 0.04), rho=(0.0, 0.9)),
        goal=Goal(false=0.15),
    ),
    World(
        name="shift-of-kinds",
        sentence="a slow walk of 4 % from dry to viscous friction and back, of each joint",
        changes=(wandering(common=False, std=0.04, dry=1.0, viscous=-0.9),),
        goal=Goal(false=0.3),
    ),
    World(
        name="walk-of-residual",
        sentence="what the fit leaves walks by 15 % within four months, of each joint",
        changes=(wandering(common=False, std=0.15, dry=0.0, viscous=0.0, residual=1.0),),
        goal=Goal(false=0.3),
    ),
    World(
        name="everything",
        sentence="σ 1–3 % and ρ 0–0.8 from joint to joint, t₄ of a third of it, running-in, ±1 % a year in common, gaps of a week",
        noise=together(Correlated(std=(0.01, 0.03), rho=(0.0, 0.8)), Correlated(std=0.007, rho=0.0, degrees=4.0)),
        changes=(running_in(), yearly(amplitude=0.01)),
        gap=(3.0, 7),
        goal=Goal(false=0.2),
    ),
    World(
        name="level-jumps-common",
        sentence="friction of all joints jumps together, three times a year by 2 % one σ, and stays",
        changes=(level_jumps(),),
        goal=Goal(counted=("rising", "falling")),
    ),
    World(name="telegraph", sentence="each joint goes back and forth between two levels 3 % apart, 20 days each", changes=(telegraph(),)),
    World(
        name="bad-days",
        sentence="once a year one joint is off by 5–40 % on two to five days, each by another share; alerts meanwhile count",
        changes=(bad_days(),),
        goal=Goal(false=0.6),
    ),
    World(
        name="yearly-sawtooth",
        sentence="friction of all joints rises by 4 % over ten months and falls back within six weeks, every year",
        changes=(sawtooth(),),
        goal=Goal(false=0.3),
    ),
    World(name="sensor-2k", sentence="the temperature sensor of one joint reads 2 K too much from one day on", changes=(sensor_shift(),)),
    World(name="sensor-silent", sentence="the temperature of one joint is unknown for weeks, three times", changes=(sensor_silence(),)),
    World(
        name="payload-forgotten",
        sentence="0.5 kg mounted in the sixth month and never declared; wear begins a year later",
        changes=(
            payload(mass_kg=0.5, rise=(0.002, 0.023, 0.020, 0.008, 0.005, 0.001), days=(150.0, 180.0), declared_after_days=(1e9, 1e9)),
        ),
        wear=(replace(STEP_5, earliest_day=500.0, latest_day=560.0), replace(RATE_10, earliest_day=500.0, latest_day=560.0)),
    ),
    World(
        name="payload-never-declared",
        sentence="0.3 kg mounted, and nobody ever declares it",
        changes=(payload(declared_after_days=(1e9, 1e9)),),
    ),
)

WORLDS: dict[str, World] = {world.name: world for world in (*_LISTED, *(replace(each, listed=False) for each in _OTHERS))}
