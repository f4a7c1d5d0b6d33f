"""A thousand arms, whose transitions go on while plant, three routers and PostgreSQL are killed: each is copied once, in order."""

import copy
import statistics
import time
from datetime import UTC, datetime

import pytest
from killed_plant import ROLES, KilledPlant, wrong_order, wrong_transitions

WHAT = {"joint": 1, "condition": "wear_rising", "tier": "wear", "kind": "raised"}
AT = "2026-01-05T05:00:00.000000Z"


def ledger():
    """Two arms as they write themselves, and the rows of a right copy."""
    arms = [
        {"arm": ["hall", f"cell-{k}"], "replays": 1, "transitions": [
            {"seq": seq, "at": AT.replace("05:00", f"05:{seq:02d}"), **WHAT, "by": None, "change": 0.1 * k}
            for seq in (1, 2, 3)
        ]}
        for k in (1, 2)
    ]  # fmt: skip
    rows = [
        [
            *arm["arm"],
            1,
            event["seq"],
            dict(event),
            datetime(2026, 1, 5, 5, event["seq"], tzinfo=UTC),
            1,
            "wear_rising",
            "wear",
            "raised",
            None,
        ]
        for arm in arms
        for event in arm["transitions"]
    ]
    return arms, rows


def damages():
    """Each way to be wrong, by name."""
    _, rows = ledger()
    changed = copy.deepcopy(rows)
    changed[2][4]["change"] = 0.11
    another = copy.deepcopy(rows)
    another[1][2] = 2
    column = copy.deepcopy(rows)
    column[4][9] = "cleared"
    return {
        "lost": rows[:1] + rows[2:], "the last lost": rows[:-1], "doubled": rows[:2] + rows[1:], "swapped": [rows[1], rows[0], *rows[2:]],
        "of another arm": [*rows[:5], ["hall", "cell-1", *rows[5][2:]]], "of nobody": [*rows, ["hall", "cell-9", *rows[5][2:]]],
        "of another history": another, "changed": changed, "another column": column, "nothing": [],
    }  # fmt: skip


def test_a_right_copy_has_nothing_wrong():
    """Whatever way a time is written."""
    arms, rows = ledger()
    for row in rows:
        row[4]["at"] = row[4]["at"].replace(".000000Z", "+00:00")
    assert wrong_transitions(arms, rows) == []
    assert wrong_order(arms, [row[:4] for row in rows]) == []


@pytest.mark.parametrize("name", damages())
def test_a_wrong_copy_is_found(name):
    """Each kind of damage; a count alone would not see most of them."""
    arms, _ = ledger()
    assert wrong_transitions(arms, damages()[name])


@pytest.mark.parametrize("name", ["lost", "doubled", "swapped", "of another history", "nothing"])
def test_a_wrong_order_of_writing_is_found(name):
    """By the server's own counter."""
    arms, _ = ledger()
    assert wrong_order(arms, [row[:4] for row in damages()[name]])


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_a_kill_of_each_loses_doubles_and_swaps_nothing(postgres, tmp_path):
    """The soak in small: plant, each router and the database, once each."""
    with KilledPlant(postgres, tmp_path, arms=12, days=3, changes_a_s=20.0, day_every_s=5.0, seed=1) as world:
        killed = list(world.kills(1))
        arms, _ = world.finish()
        assert sorted(role for each in killed for role in each.roles) == sorted(ROLES)
        assert world.wrong(arms) == []


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_fifty_kills_among_a_thousand_arms(postgres, tmp_path, soak_row, capfd):
    """Ten of each; `-s` is not needed for the line of progress."""
    began = time.monotonic()

    def tell(each):
        with capfd.disabled():
            print(
                f"{time.monotonic() - began:6.0f} s: {' and '.join(each.roles)} killed with {each.held} to copy, away {each.away_s:.1f} s, "
                f"goes on after {each.again_s:.1f} s",
                flush=True,
            )

    with KilledPlant(postgres, tmp_path, arms=1000, days=10, changes_a_s=10.0, day_every_s=120.0, seed=26) as world:
        first_s = world.caught_up()
        held = world.held()
        killed = []
        for each in world.kills(10):
            killed.append(each)
            tell(each)
        arms, last_s = world.finish()
        wrong = world.wrong(arms)
        transitions = sum(len(arm["transitions"]) for arm in arms)
    kills = sum(len(each.roles) for each in killed)
    soak_row("1000 arms, 3 routers, PostgreSQL: kills −9, ten of each", f"{kills}", "50")
    soak_row("… of them while something else was still away", f"{sum(len(each.roles) for each in killed if len(each.roles) > 1)}", "told")
    soak_row("… transitions at the arms, and made between the kills", f"{transitions}, {transitions - sum(held.values())}", "told")
    soak_row("… arms with one that is lost, doubled or out of order", f"{len(wrong)} of 1000", "0")
    for role in ROLES:
        times = [each.again_s for each in killed if role in each.roles]
        soak_row(
            f"… {role}: seconds until its arms' transitions come again", f"{statistics.median(times):.1f}, at most {max(times):.1f}", "told"
        )
    soak_row("… the first copy, and all of the end [s]", f"{first_s:.0f}, {last_s:.0f}", "told")
    soak_row("… the whole run [min]", f"{(time.monotonic() - began) / 60:.0f}", "≤ 40")
    assert wrong == []
