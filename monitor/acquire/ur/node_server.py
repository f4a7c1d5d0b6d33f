"""The server that a controller asks for the text of its hand-over nodes, at Play."""

import contextlib
import logging
import socket
import socketserver
import threading

from monitor.errors import cannot_listen

log = logging.getLogger(__name__)

PATIENCE_S = 3.0  # for the connection, and for each part of an answer: the server is on this host, which may be busy
PORT = 50002  # where the manufacturer's External Control node asks
REQUEST = b"request_program"
REQUEST_S = 5.0  # a client that asks for nothing is let go after so long
LEAVES_S = 0.5  # a client that has the text closes the connection within so long: PolyScope X after 0.1 s of silence
REQUEST_MAX_BYTES = 256
CLIENTS_MAX = 16


class _Handler(socketserver.BaseRequestHandler):
    server: "_Server"

    def handle(self) -> None:
        """Answer one request with the whole text in one write: a controller reads only while something is ready."""
        self.request.settimeout(REQUEST_S)
        asked = b""
        try:
            while b"\n" not in asked and len(asked) < REQUEST_MAX_BYTES:
                data = self.request.recv(REQUEST_MAX_BYTES)
                if not data:
                    break
                asked += data
            if asked.split(b"\n")[0].strip() == REQUEST:
                self.request.sendall(self.server.text.encode())
                self.server.served += 1
                self.request.settimeout(LEAVES_S)
                with contextlib.suppress(TimeoutError):
                    self.request.recv(1)  # the client closes first: some versions of PolyScope X's node never see the end of a connection
            else:
                log.warning("hand-over: %s asked for %r, which is not known", self.client_address[0], asked[:40])
        except OSError as wrong:
            log.warning("hand-over: %s: %s", self.client_address[0], wrong)


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = CLIENTS_MAX
    text = ""
    served = 0


class HandOverServer:
    """Serves a text as long as it is open. Use it as a context."""

    def __init__(self, text: str, *, bind: str, port: int = PORT) -> None:
        """Listen. Raises as `cannot_listen`."""
        try:
            self._server = _Server((bind, port), _Handler)
        except OSError as wrong:
            raise cannot_listen(f"replay.hand_over_listen: {bind}:{port}", wrong.errno, str(wrong.strerror)) from None
        self._server.text = text
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="hand-over", daemon=True)
        self._thread.start()

    def serve(self, text: str) -> None:
        """Serve another text from now on."""
        self._server.text = text

    @property
    def port(self) -> int:
        """The port that was bound."""
        return int(self._server.server_address[1])

    @property
    def served(self) -> int:
        """How often the text was served."""
        return self._server.served

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> "HandOverServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def answer_of(address: str, port: int) -> str | None:
    """What the port answers to a node's request; None where nobody listens."""
    answer = b""
    try:
        with socket.create_connection((address, port), timeout=PATIENCE_S) as wire, contextlib.suppress(TimeoutError):
            wire.sendall(REQUEST + b"\n")
            while data := wire.recv(65536):
                answer += data
    except ConnectionResetError:
        pass
    except OSError:
        return None
    return answer.decode("utf-8", errors="replace")
