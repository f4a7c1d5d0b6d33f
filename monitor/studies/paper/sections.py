"""A campaign beside the paper: each table and figure with the difference, and what must agree although the arm is simulated.

Structure, ranks, equations, signs and orders of magnitude must agree. Figures that come from the paper's own arms (how much friction, how
warm, how noisy) must differ: the simulated arm has a friction law, heat and noise of its own.
"""

from collections.abc import Iterator

from monitor.studies.paper.campaign import Campaign
from monitor.studies.paper.section import Section
from monitor.studies.paper.sections_model import appendix, identifiability, parameters, trajectories, transfer, validation
from monitor.studies.paper.sections_temperature import torques, viscous, warm_up

IN_THE_PAPERS_ORDER = (identifiability, trajectories, parameters, validation, warm_up, viscous, torques, transfer, appendix)


def sections(found: Campaign) -> Iterator[Section]:
    """All sections of one campaign, in the paper's order."""
    for section in IN_THE_PAPERS_ORDER:
        yield section(found)
