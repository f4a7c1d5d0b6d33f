"""The reproduction of the paper: what a short campaign must show, and the report that comes of it."""

import dataclasses
import json
import re

import numpy as np
import pytest

from monitor.errors import BadInput
from monitor.model.base import base_parameters
from monitor.model.robot import Mounting, load_robot
from monitor.studies.paper import printed as paper
from monitor.studies.paper.campaign import CampaignSettings, campaign
from monitor.studies.paper.reproduce import reproduce, reproduction_page
from monitor.studies.paper.statements import sections
from monitor.views.report.html import check_page

# so short a search by the genetic algorithm ends within its first generation
SHORT = CampaignSettings(replays=2, evaluations=200, repetitions=1, optimiser="cma")
pytestmark = pytest.mark.timeout(600)  # on a machine that may be busy


@pytest.fixture(scope="module")
def found():
    """The campaign with two short runs, one cold and one after half an hour, and a short search."""
    return campaign("ur5", SHORT, lambda text, share: None)


@pytest.fixture(scope="module")
def parts(found):
    """The sections of the campaign."""
    return list(sections(found))


def test_what_must_agree_with_the_paper_agrees(parts):
    """Ranks, counts, equations, signs and orders of magnitude agree; at least one figure is marked as one that must differ."""
    checks = [check.document for section in parts for check in section.checks]
    failed = [check for check in checks if check["verdict"] == "DOES NOT HOLD"]
    assert not failed
    assert sum(check["holds"] is True for check in checks) >= 20
    assert any(check["expected"] == "differ" and check["holds"] is None for check in checks)
    assert all(check["holds"] is not None for check in checks if check["expected"] != "differ")


def test_every_joint_of_tables_4_to_7_is_held_against_a_bound_and_a_miss_is_told_with_its_reason(found, parts):
    """A figure beyond its bound is missed, on the page too, and says how warm the joint became; it contradicts nothing."""
    near = [check for section in parts for check in section.checks if check.expected == "near"]
    for table, count in (
        ("table 4: change of fv, ", 6),
        ("table 4: change of fv a kelvin, ", 6),
        ("table 5", 6),
        ("table 6", 6),
        ("table 7", 2),
    ):
        assert sum(check.what.startswith(table) for check in near) == count, table
    warmer = dataclasses.replace(found, viscous=np.stack([found.viscous[0], 0.1 * found.viscous[0]]))
    missed = {check.what: check for section in sections(warmer) for check in section.checks if check.verdict == "missed"}
    told = missed["table 4: change of fv, joint 1"]
    assert (told.paper, told.ours) == ("-8.8 %", "-90.0 %")
    assert "the paper's by 11 K" in told.why
    page = reproduction_page([warmer], {"ur5": sections(warmer)}, SHORT, 1.0)
    assert '<span class="warn">missed</span>' in page
    assert "each of the others says why" in page


def test_every_figure_and_table_of_the_paper_has_its_section(parts):
    """Figures 1 to 9, tables 3 to 8 and the appendix appear in the titles."""
    titles = " ".join(section.title for section in parts)
    for item in ("Figure 1", "Figure 2", "Figure 3", "Figures 4–6", "table 3", "tables 4–7", "Figure 7", "Figure 8", "Figure 9", "table 8"):
        assert item.lower() in titles.lower(), item
    assert len(next(section for section in parts if section.key == "appendix").tables[0][1].rows) == 54


def test_a_result_that_contradicts_the_paper_fails_its_check(found):
    """The checks fail for friction that rises with temperature, and for parameters that do not carry over to another mounting."""
    upside_down = dataclasses.replace(
        found, viscous=found.viscous[::-1], transfer={**found.transfer, "ground regressor": found.transfer["ceiling"]}
    )
    failed = {check.what for section in sections(upside_down) for check in section.checks if check.document["holds"] is False}
    assert {"fv of every joint falls as it warms", "and not with the wrong one"} <= failed


@pytest.mark.soak
def test_the_page_is_one_file_that_needs_no_network(found, parts):
    """It has no script and no link to another file, and contains every drawing and table."""
    text = reproduction_page([found], {"ur5": parts}, SHORT, 1.0)
    assert not re.search(r"<script|<link|<img|url\(\s*[\"']?http|src=", text)
    assert text.count("<svg") == text.count("</svg>") == sum(len(section.drawings) for section in parts) == 7
    assert "0.4207" in text  # the paper's own number stands there
    assert "DOES NOT HOLD" not in text
    json.dumps([section.as_document() for section in parts], allow_nan=False)


@pytest.mark.soak
def test_the_same_seed_gives_the_same_trajectories_and_figures(found):
    """The search and the noise of the replays repeat to the last bit."""
    again = campaign("ur5", SHORT, lambda text, share: None)
    assert again.trajectories["ground"].digest == found.trajectories["ground"].digest
    assert np.array_equal(again.identified.values, found.identified.values)
    assert np.array_equal(again.viscous, found.viscous)


@pytest.mark.parametrize("name", sorted(paper.PRINTED))
def test_the_appendix_of_either_arm_follows_from_its_lengths(name):
    """Rows of equations A1 and A2 agree with the formulas; the UR3's second row is that of the erratum."""
    robot = load_robot(name)
    terms = {next(iter(row)): row for row in base_parameters(robot, Mounting.parse("wall")).terms}
    for lead, others in paper.appendix(robot).items():
        assert paper.furthest({key: value for key, value in terms[lead].items() if key != lead}, others) < 1e-9  # rounding
    assert paper.furthest({"J2xz": 1.0}, {"J2zz": 1.0}) == float("inf")


def test_what_cannot_be_reproduced_is_refused_before_anything_is_played(tmp_path):
    """A robot that the paper does not have and a file that cannot be written are refused."""
    with pytest.raises(BadInput, match="the paper has ur3 and ur5"):
        reproduce(["ur10"], SHORT, lambda *_: None)
    for path in (tmp_path / "report.pdf", tmp_path / "nowhere" / "report.html", tmp_path):
        with pytest.raises(BadInput, match="-o "):
            check_page(path)
