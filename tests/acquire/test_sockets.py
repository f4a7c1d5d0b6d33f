"""The connections that ur-rtde opened, seen through the kernel."""

import select
import socket
import struct

import pytest

from monitor.acquire.ur.last_resorts import PeerWatch

HOST = "127.0.2.95"


@pytest.mark.parametrize("reset", [False, True])
def test_a_connection_that_its_peer_ended_is_known_before_anything_is_sent_on_it(reset):
    """By FIN and by RST; data that waits to be read is no end. ur-rtde notices it only in a call, which blocks then."""
    with socket.create_server((HOST, 0)) as server:
        port = server.getsockname()[1]
        clients = [socket.create_connection((HOST, port)) for _ in range(2)]
        peers = [server.accept()[0] for _ in range(2)]
        watch = PeerWatch(HOST, port)
        assert not watch.ended
        peers[0].sendall(b"a packet")
        clients[0].recv(1)
        assert not watch.ended
        if reset:
            peers[1].setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        peers[1].close()
        assert watch.ended
        for each in (*clients, peers[0]):
            each.close()


def test_a_connection_that_was_reset_before_anybody_watched_has_ended():
    """The kernel does not say any more where it led, so none is there to be watched. It was taken for one that stands."""
    with socket.create_server((HOST, 0)) as server, socket.create_connection(server.getsockname()) as client:
        peer = server.accept()[0]
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        peer.close()
        select.select([client], [], [], 5.0)  # until the reset has come
        assert PeerWatch(*server.getsockname()).ended
