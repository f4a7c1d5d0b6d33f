"""Simulated arms behind routers, for the bench of the plant: `python -m tests.bench.plant_arms ARMS DAYS ROUTER…`.

Days pass when standard input says how many; after them, and at first, a line says how many replays and transitions the arms hold.
"""

import sys
import threading
import time

from monitor.recording import DAY_S
from monitor.studies.plant import Lives, PlantOnBus, SimulatedPlant


def main(arms: int, days: int, routers: tuple[str, ...]) -> None:
    """Be the monitors of so many arms until standard input ends."""
    lives = Lives(arms, 0, time.time() // DAY_S * DAY_S - (days + 30) * DAY_S)
    lives.live(days)
    stopping = threading.Event()
    with PlantOnBus(SimulatedPlant(arms=arms, sites=len(routers), days=days, routers=routers), lives) as simulated:
        thread = threading.Thread(target=simulated.run, args=(stopping,))
        thread.start()
        say(lives)
        for line in sys.stdin:
            for _ in range(int(line)):
                simulated.pass_day()
            say(lives)
        stopping.set()
        thread.join()


def say(lives: Lives) -> None:
    """What the arms hold."""
    print(sum(map(len, lives.replays)), sum(map(len, lives.transitions)), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), tuple(sys.argv[3:]))
