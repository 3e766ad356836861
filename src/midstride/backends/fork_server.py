"""The fork server: a process that has imported the client library, and from which components and spares are forked.

``python -m midstride.backends.fork_server MODULE DESCRIPTOR ROOM`` has MODULE import what a component needs
(``load()`` of a back end's package), says so on the socket DESCRIPTOR, and forks a process for each request on it: a
byte, and a socket for the new process. That process sends its number there, and goes on as a spare (:mod:`.spare`).
Where the socket closes, the server exits. It has not joined ROS. ROOM is :data:`.process_title.ARGUMENT_ROOM`.
"""

from __future__ import annotations

import gc
import importlib
import os
import socket
import sys
from typing import Final

from midstride.backends import forking, spare

# The requests: a process that has joined ROS, or one that its program joins.
JOINED: Final = b"j"
LOADED: Final = b"l"
NUMBER_BYTES: Final = 4


def main(module_name: str, descriptor: int) -> None:
    module = importlib.import_module(module_name)
    with socket.socket(fileno=descriptor) as requests:
        requests.set_inheritable(False)
        module.load()
        forking.make_safe()
        gc.collect()
        gc.freeze()  # else the first collection in each process would copy what it walks
        requests.sendall(spare.READY)
        request, channel = _fork_on_request(requests)
    if channel is not None:
        channel.sendall(os.getpid().to_bytes(NUMBER_BYTES, "little"))
        if request == JOINED:
            module.prepare()
            channel.sendall(spare.READY)
        spare.wait(channel)


def _fork_on_request(requests: socket.socket) -> tuple[bytes, socket.socket | None]:
    """Returns in each process that is forked, with its socket; in the server, without one, when `requests` closes."""
    while True:
        request, descriptors, _, _ = socket.recv_fds(requests, 1, 1, socket.MSG_CMSG_CLOEXEC)
        if not request:
            return request, None
        channel = socket.socket(fileno=descriptors[0])
        if forking.fork_for_parent():
            return request, channel
        channel.close()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
