"""A monitor on a real bus that only answers commands: a router session with a liveliness token and one queryable."""

import json
import socket

import zenoh

from monitor.publish.session import session_config


class AnsweringArm:
    """A context manager. `asked` are the commands that came; `refuses` is the reason of a refusal."""

    def __init__(self, name):
        self.prefix = f"joint-monitor/v1/{name}"
        self.asked, self.refuses = [], None
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"

    def __enter__(self):
        self._session = zenoh.open(session_config(mode="router", listen=(self.endpoint,)))
        self._token = self._session.liveliness().declare_token(f"{self.prefix}/alive/monitor")
        self._commands = self._session.declare_queryable(f"{self.prefix}/cmd/*", self._answer)
        return self

    def __exit__(self, *_):
        self._session.close()

    def _answer(self, query):
        with query:
            if self.refuses:
                query.reply_err(json.dumps({"error": self.refuses}))
                return
            self.asked.append((str(query.key_expr).rpartition("/")[2], json.loads(query.payload.to_bytes())))
            query.reply(query.key_expr, json.dumps({"done": "acknowledged"}))
