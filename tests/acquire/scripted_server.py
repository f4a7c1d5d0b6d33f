"""A server on one port whose answers a test writes: one connection at a time, in a thread, for as long as its context lasts."""

import socket
import threading


class ScriptedServer:
    """`converse` is what a kind of server does with one connection; it returns soon after `over` is set."""

    def __init__(self, host: str, port: int) -> None:
        self.over = threading.Event()
        self._server = socket.create_server((host, port))
        self._server.settimeout(0.05)
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.over.set()
        self._thread.join()
        self._server.close()

    def converse(self, peer: socket.socket) -> None:
        raise NotImplementedError

    def _serve(self):
        while not self.over.is_set():
            try:
                peer, _ = self._server.accept()
            except TimeoutError:
                continue
            with peer:
                peer.settimeout(0.05)
                self.converse(peer)
