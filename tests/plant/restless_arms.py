"""Simulated arms whose alerts change all the time, as a process beside a plant that a soak kills.

python restless_arms.py ARMS DAYS CHANGES_A_S DAY_EVERY_S SEED ROUTER…    each site joins the router of its turn

They read lines: `held` is answered by how many transitions they hold at each site; `stop FOLDER` ends the changes and writes what each arm
holds into FOLDER/arms.jsonl; the answer is the number of lines.
"""

import json
import random
import sys
import threading
import time
from pathlib import Path

from monitor.recording import DAY_S
from monitor.studies.plant import Lives, PlantOnBus, SimulatedPlant, Transition

BEFORE_NOW_DAYS = 400  # the simulated days end before the present one, however long it lasts
KINDS, TIERS = ("raised", "updated", "acknowledged", "shelved", "cleared"), ("advisory", "wear")


class RestlessArms(PlantOnBus):
    """Arms none of which hangs; any joint's alert may change at any moment."""

    def __init__(self, settings, lives, seed):
        self._chance, self._day, self._day_began = random.Random(seed), lives.day, time.monotonic()
        super().__init__(settings, lives)

    def frozen(self, arm):
        return False

    def change(self, day_lasts_s):
        """One transition of one arm. Its time is within the simulated day: the times of an arm's transitions grow with their numbers."""
        chance, lives = self._chance, self.lives
        arm, joint, kind, tier = chance.randrange(lives.arms), chance.randint(1, 6), chance.choice(KINDS), chance.choice(TIERS)
        with self._lock:
            if self._day != lives.day:  # seen here, where no day can pass meanwhile: a share of the new day in the old one would go back
                self._day, self._day_began = lives.day, time.monotonic()
            share = min((time.monotonic() - self._day_began) / day_lasts_s, 1.0)
            at = lives.at_unix_s(lives.day - 1) + 1.0 + 0.9 * DAY_S * share
            who = {"by": f"person {chance.randrange(50)}", "why": "seen"} if kind in {"acknowledged", "shelved"} else {}
            lives.transitions[arm].append(Transition(lives.day - 1, joint, kind, tier, 0, chance.uniform(0.05, 0.4), at, **who))
            event = lives.event(arm, len(lives.transitions[arm]))
        self.say(arm, "event", event)

    def held(self):
        """Transitions at each site."""
        found = {}
        with self._lock:
            for (site, _), those in zip(self.names, self.lives.transitions, strict=True):
                found[site] = found.get(site, 0) + len(those)
        return found

    def write(self, file):
        """A line an arm: its name, its transitions as it publishes them, and how many replays it has. Returns the number of lines."""
        with self._lock:
            for arm, name in enumerate(self.names):
                events = [self.lives.event(arm, seq) for seq in range(1, len(self.lives.transitions[arm]) + 1)]
                file.write(json.dumps({"arm": name, "transitions": events, "replays": len(self.lives.replays[arm])}) + "\n")
        return len(self.names)


def arms(count, days, changes_a_s, day_every_s, seed, routers):
    lives = Lives(count, seed, time.time() // DAY_S * DAY_S - (days + BEFORE_NOW_DAYS) * DAY_S)
    lives.live(days)
    settled, closing = threading.Event(), threading.Event()  # no more changes; no more words
    with RestlessArms(SimulatedPlant(arms=count, sites=len(routers), days=days, seed=seed, connect=routers), lives, seed) as simulated:

        def changes():
            due = time.monotonic()
            while not settled.wait(max(due - time.monotonic(), 0.0)):
                simulated.change(day_every_s)
                due += 1.0 / changes_a_s

        def nights():
            while not settled.wait(day_every_s):
                simulated.pass_day()

        changing = [threading.Thread(target=changes), threading.Thread(target=nights)]
        saying = threading.Thread(target=simulated.run, args=(closing,))
        print(json.dumps(simulated.held()), flush=True)
        for thread in (*changing, saying):
            thread.start()
        for line in sys.stdin:
            word, _, folder = line.strip().partition(" ")
            if word == "held":
                print(json.dumps(simulated.held()), flush=True)
            else:
                settled.set()
                for thread in changing:
                    thread.join()
                with (Path(folder) / "arms.jsonl").open("w") as file:
                    lines = simulated.write(file)
                print(lines, flush=True)
        settled.set()
        closing.set()
        for thread in (*changing, saying):
            thread.join()


if __name__ == "__main__":
    arms(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5]), tuple(sys.argv[6:]))
