"""The publishing end of one connection: written to from the data thread, which it never blocks.

rospy's own either blocks the publisher until the slowest subscriber has read, or keeps a thread for each connection and
drops its queue when the topic is closed. Here the data that the socket does not take at once waits in a queue, which
the control thread's event loop empties.
"""

from __future__ import annotations

import asyncio
import fcntl
import socket
import struct
import termios
import threading
from collections import deque
from typing import Any


class SubscriberConnection:
    """Takes the place of rospy's transport of one subscriber in rospy's lists.

    ``numbered``: it requested numbers; ``compatible``: it requests no more than is offered.
    """

    def __init__(
        self, transport: Any, numbered: bool, compatible: bool, depth: int, control: asyncio.AbstractEventLoop
    ) -> None:
        self.numbered = numbered
        self.compatible = compatible
        self.gone = threading.Event()
        self.transport = transport
        self._socket: socket.socket = transport.socket
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._depth = depth
        self._control = control
        self._lock = threading.Lock()
        self._waiting: deque[memoryview] = deque()
        self._writing = False
        control.call_soon_threadsafe(self._watch)

    def __getattr__(self, name: str) -> Any:
        """Everything else that rospy expects of a transport."""
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.transport, name)

    def write(self, frame: bytes) -> None:
        """Send one message. Where more than ``depth`` wait, the oldest is dropped."""
        self.transport.stat_bytes += len(frame)
        self.transport.stat_num_msg += 1
        with self._lock:
            if self.gone.is_set():
                return
            if self._waiting:
                self._waiting.append(memoryview(frame))
                if len(self._waiting) > self._depth + 1:
                    del self._waiting[1]  # the first may be half sent
                return
            sent = self._send(frame)
            if sent < len(frame):
                self._waiting.append(memoryview(frame)[sent:])
                self._control.call_soon_threadsafe(self._go_on)

    def _send(self, data: bytes | memoryview) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:  # the control thread will read its end
            return len(data)

    @property
    def idle(self) -> bool:
        """Return whether the kernel at the other end has everything that was written."""
        if self.gone.is_set():
            return True
        if self._waiting:
            return False
        try:
            (unacknowledged,) = struct.unpack("i", fcntl.ioctl(self._socket, termios.TIOCOUTQ, b"\0\0\0\0"))
        except (OSError, ValueError):
            return True
        return bool(unacknowledged == 0)

    # -- control thread ------------------------------------------------------------------------------

    def _watch(self) -> None:
        """Notice at once when the subscriber leaves: it sends nothing else."""
        if not self.gone.is_set():
            self._control.add_reader(self._socket, self._readable)

    def _readable(self) -> None:
        try:
            if self._socket.recv(4096):
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self.leave()

    def _go_on(self) -> None:
        """Send from the queue what the socket takes."""
        if self.gone.is_set():
            return
        with self._lock:
            while self._waiting:
                sent = self._send(self._waiting[0])
                if sent < len(self._waiting[0]):
                    self._waiting[0] = self._waiting[0][sent:]
                    break
                self._waiting.popleft()
            left = bool(self._waiting)
        if left and not self._writing:
            self._control.add_writer(self._socket, self._go_on)
        elif not left and self._writing:
            self._control.remove_writer(self._socket)
        self._writing = left

    def finish(self) -> None:
        """Nothing more will come: the subscriber reads what was sent, and then leaves."""
        if not self.gone.is_set():
            try:
                self._socket.shutdown(socket.SHUT_WR)
            except OSError:
                self.leave()

    def leave(self) -> None:
        """Close the connection; rospy removes it from its lists."""
        if self.gone.is_set():
            return
        self.gone.set()
        self._control.remove_reader(self._socket)
        self._control.remove_writer(self._socket)
        self.transport.close()

    def close(self) -> None:
        """rospy, in any thread, when it drops a connection or shuts down."""
        if not self._control.is_closed():
            self._control.call_soon_threadsafe(self.leave)
