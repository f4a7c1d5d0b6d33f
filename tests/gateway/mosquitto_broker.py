"""A real mosquitto of the tests' own, and a client that sees what it keeps."""

import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

PROGRAM = shutil.which("mosquitto") or ("/usr/sbin/mosquitto" if Path("/usr/sbin/mosquitto").exists() else None)
PATIENCE_S = 30.0


def waited(condition, what):
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until, f"in {PATIENCE_S:g} s: {what}"
        time.sleep(0.01)


class Mosquitto:
    """One broker. `settings` are lines of its configuration."""

    def __init__(self, folder: Path, *settings: str, anonymous: bool = True) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        lines = [f"listener {self.port} 127.0.0.1", f"allow_anonymous {'true' if anonymous else 'false'}", "user root", *settings]
        self._file = folder / "mosquitto.conf"
        self._file.write_text("\n".join(lines) + "\n")
        self._log = folder / "mosquitto.log"
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen([PROGRAM, "-v", "-c", self._file], stdout=subprocess.DEVNULL, stderr=self._log.open("ab"))
        waited(self._listens, "mosquitto listens")

    def _listens(self) -> bool:
        assert self.process.poll() is None, self._log.read_text()[-2000:]
        try:
            socket.create_connection(("127.0.0.1", self.port), 1.0).close()
        except OSError:
            return False
        return True

    def kill(self) -> None:
        """What it kept is lost with it: nothing is written to disk."""
        self.process.kill()
        self.process.wait()

    @property
    def log(self) -> str:
        return self._log.read_text()


class Onlooker:
    """Everything that a broker keeps and passes on."""

    def __init__(self, port: int, topic: str = "#") -> None:
        self.kept: dict[str, bytes] = {}  # as a client that comes now would get it
        self.heard: list[tuple[str, bytes]] = []
        self._lock = threading.Lock()
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self.client.on_message = self._message
        subscribed = threading.Event()
        self.client.on_subscribe = lambda *_: subscribed.set()
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        self.client.subscribe(topic, 1)
        assert subscribed.wait(PATIENCE_S)

    def _message(self, _client, _data, message) -> None:
        with self._lock:
            self.heard.append((message.topic, message.payload))
            if message.payload:
                self.kept[message.topic] = message.payload
            else:
                self.kept.pop(message.topic, None)

    def publish(self, topic: str, payload: str, *, retain: bool = False) -> None:
        self.client.publish(topic, payload, 1, retain).wait_for_publish(PATIENCE_S)

    def __enter__(self) -> "Onlooker":
        return self

    def __exit__(self, *_) -> None:
        self.client.disconnect()
        self.client.loop_stop()
