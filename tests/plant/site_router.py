"""A router for one site, until it is killed or its standard input ends: `python site_router.py ENDPOINT`. It imports little."""

import sys

import zenoh

from monitor.publish.session import session_config

if __name__ == "__main__":
    with zenoh.open(session_config(mode="router", listen=(sys.argv[1],))):
        print("open", flush=True)
        sys.stdin.read()
