"""The comparison of a campaign with the paper: a section for each table and figure.

Structure, ranks, equations, signs and orders of magnitude must agree. Figures that belong to the paper's own arms (friction, temperature,
noise) must differ, because the simulated arm has a friction law, heat and noise of its own.
"""

from collections.abc import Iterator

from monitor.studies.paper.campaign import Campaign
from monitor.studies.paper.section import Section
from monitor.studies.paper.sections_model import appendix, identifiability, parameters, trajectories, transfer, validation
from monitor.studies.paper.sections_temperature import torques, viscous, warm_up

PAPER_ORDER = (identifiability, trajectories, parameters, validation, warm_up, viscous, torques, transfer, appendix)


def sections(found: Campaign) -> Iterator[Section]:
    """The sections of one campaign in the order of the paper."""
    for section in PAPER_ORDER:
        yield section(found)
