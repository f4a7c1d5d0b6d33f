"""What may happen to a production cell after its replay, beside the cells of the simulator's catalogue."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from monitor.recording import Array
from monitor.simulate.cells.cell import Cell
from monitor.simulate.cells.things import Mass, Thing, Tool
from monitor.simulate.machine.machine import Machine


@dataclass(slots=True, kw_only=True, eq=False)
class Hose(Thing):
    """A hose or cable that was tied to the tool and to a post: a spring with some slack, wherever the arm is."""

    post_m: tuple[float, float, float] = (0.0, 0.0, 1.1)
    slack_m: float = 0.45
    stiffness_n_m: float = 60.0

    def step(self, machine: Machine, tool: Tool) -> bool:
        """It is always there."""
        return True

    def force_n(self, at_m: Array) -> Array:
        """The pull towards the post [N]."""
        way = np.array(self.post_m) - at_m
        length = float(np.linalg.norm(way))
        result: Array = self.stiffness_n_m * max(length - self.slack_m, 0.0) * way / max(length, 1e-9)
        return result


@dataclass(slots=True, kw_only=True, eq=False)
class Knocks(Thing):
    """Parts and people that knock against one link after another, for 0.15 s each."""

    size_nm: Array  # (J,) torque of a knock on each joint
    every_s: float = 2.3
    seconds: float = 0.15
    _joint: int | None = None

    def step(self, machine: Machine, tool: Tool) -> bool:
        """Whether something knocks now."""
        number, since_s = divmod(machine.clock.now_s, self.every_s)
        self._joint = int(number) % len(self.size_nm) if since_s < self.seconds else None
        return self._joint is not None

    def torque_nm(self, joints: int) -> Array:
        """The knock on its joint."""
        result = np.zeros(joints)
        if self._joint is not None:
            result[self._joint] = self.size_nm[self._joint]
        return result


def heavier(before: Cell) -> Cell:
    """Another tool, 1 kg heavier than the one of the replay, at all times; nobody declared it."""
    return replace(before, tool=before.tool.with_(Mass(kg=1.0, com_m=(0.0, 0.0, 0.06))))


def hosed(before: Cell) -> Cell:
    """A hose pulls at the tool."""
    return replace(before, things=(*before.things, Hose()))


def knocked(before: Cell) -> Cell:
    """Knocks of a tenth of each joint's largest torque."""
    return replace(before, things=(*before.things, Knocks(size_nm=0.1 * before.layout.robot.max_torque_nm)))


MORE: dict[str, Callable[[Cell], Cell]] = {"heavier-tool": heavier, "hose": hosed, "knocks": knocked}
