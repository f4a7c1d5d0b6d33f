"""The cells by their names."""

from monitor.errors import BadInput
from monitor.model.robot import Robot
from monitor.simulate.cells.cell import Cell
from monitor.simulate.cells.disturbed import DISTURBED
from monitor.simulate.cells.making import Maker
from monitor.simulate.cells.production import PRODUCTION

CELLS = PRODUCTION | DISTURBED


def cell(name: str, robot: Robot, seed: int = 0) -> Cell:
    """A cell by its name for one arm. Raises BadInput for a name that is not in the catalogue, or an arm that it is not made for."""
    if name not in CELLS:
        raise BadInput(f"cell {name!r} is not known; known are {', '.join(CELLS)}")
    if robot.joints != 6:
        raise BadInput(f"cell {name}: the arm has {robot.joints} joints; expected 6")
    kind = CELLS[name]
    return kind.make(Maker(name, kind.about, robot, seed))
