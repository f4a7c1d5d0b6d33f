"""A real HTTP server in this process: what it was asked is kept, what it answers is a function."""

import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class HttpServer:
    """A context manager. `answer(method, path, headers, body)` returns status, headers and body; None hangs up without an answer."""

    def __init__(self, answer=None):
        self.asked = []  # (method, path, headers, body)
        self._place = "127.0.0.1", 0
        self.answer = answer or (lambda *_: (204, {}, b""))

    def at(self, address, port):
        """At this address, instead of a port that the kernel chooses."""
        self._place = address, port
        return self

    def __enter__(self):
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do(self):
                length = int(self.headers.get("Content-Length") or 0)
                body = self.rfile.read(length)
                if len(body) < length:  # whoever asked was killed
                    self.close_connection = True
                    return
                headers = {name.lower(): value for name, value in self.headers.items()}
                outer.asked.append((self.command, self.path, headers, body))
                answer = outer.answer(self.command, self.path, headers, body)
                if answer is None:
                    self.close_connection = True
                    return
                status, more, content = answer
                self.send_response(status)
                for name, value in {"Content-Length": str(len(content)), **more}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(content)

            do_GET = do_POST = do_PUT = do_PATCH = do_DELETE = do  # noqa: N815 - of http.server

            def handle(self):
                with suppress(ConnectionError):  # whoever asked was killed
                    super().handle()

            def log_message(self, *_):
                pass

        self._server = ThreadingHTTPServer(self._place, Handler)
        self._server.daemon_threads = True
        self.url = f"http://{self._place[0]}:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
