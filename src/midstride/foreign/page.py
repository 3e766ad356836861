"""The manager's view of the page of shared memory in which gates and batons are: the layout is that of ``page.h``.

Each step with a baton is one compare-and-swap, made by the functions of the library itself.
"""

from __future__ import annotations

import ctypes
import os
import struct
import time
from collections.abc import Container, Iterator, Sequence
from ctypes import c_int, c_int64, c_uint32, c_uint64, c_void_p
from pathlib import Path
from typing import Any, Final, NamedTuple

from midstride.errors import BackendError
from midstride.foreign.gate_file import write_gate_file
from midstride.foreign.page_layout import (
    BATONS,
    HAS_AGENT,
    HEAD_SIZE,
    IN_USE,
    INPUT,
    LEAVES,
    MAGIC,
    MOST_PORTS,
    NAME,
    NODE,
    NODES,
    NOTED,
    OLDEST,
    OPEN,
    OUTPUT,
    PART_SIZES,
    REQUESTS_OFFSET,
    ROOM,
    SERVER,
    VERSION,
    GoalState,
    PageBaton,
    PageLayout,
    PagePort,
    PageRequests,
    RequestsStep,
    version_of,
)
from midstride.node.handover.baton import BatonStep, BatonWord
from midstride.wire.state import GoalCounts

# What follows the name of a ROS action in those of its services which take goals, and respond with their results.
SEND_GOAL: Final = "/_action/send_goal"
GET_RESULT: Final = "/_action/get_result"
# How many bytes the results of goals have at most, in all, that are kept since no client has fetched them.
KEPT_RESULTS: Final = 16 << 20
# How the file of a node beside the page ends that has its requests to set parameters, and what precedes each of them:
# when it was taken (Unix time, ns), and how many bytes follow, the name of the service, a 0 and the request.
SETTINGS: Final = "settings"
_SETTING: Final = struct.Struct("<qQ")

# The folder beside the control sockets with the records of the nodes and this file.
GATES_FOLDER: Final = "gates"
PAGE: Final = "page"

# Until when it counts that a component shares requests, as long as it does (CLOCK_MONOTONIC, ns).
FOR_EVER: Final = 2**63 - 1
# A node that no process has joined as for so long (s) may be given to another: its manager had been killed meanwhile.
JOINED_WITHIN: Final = 60


class KnownGoal(NamedTuple):
    """A goal of a node in the page, by the full name of its ROS action; its UUID, its place, and its word there."""

    action: str
    state: GoalState
    id: bytes
    place: int
    word: int


class KnownSetting(NamedTuple):
    """A request to set parameters: when a node has taken it (Unix time, s), by which service, and its bytes."""

    at: float
    service: str
    request: bytes


def require_usable(path: Path) -> None:
    """Raises BackendError where the page at ``path`` has a layout that is not used here; there may be none."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return
    try:
        layout = version_of(file) if os.fstat(file).st_size else VERSION
    finally:
        os.close(file)
    if layout is None or not OLDEST <= layout <= VERSION:
        raise _unusable(path, layout)


def _unusable(path: Path, layout: int | None) -> BackendError:
    has = f"has layout {layout}, and this version uses {OLDEST} to {VERSION}"
    return BackendError(
        f"{path} {'is no page of Midstride' if layout is None else has}: nodes that run with it keep running, and "
        "this version cannot answer for them; use that version, or `midstride down`, and start the system again"
    )


def load_library(path: Path) -> Any:
    """The functions of the library that the manager calls."""
    library = ctypes.CDLL(str(path), mode=os.RTLD_LOCAL | os.RTLD_NOW)
    library.midstride_take_step.argtypes = [ctypes.POINTER(PageBaton), c_int, c_uint32, c_uint32, c_int]
    library.midstride_take_step.restype = c_uint64
    library.midstride_is_dead.argtypes = [c_int, c_uint32]
    library.midstride_map.argtypes, library.midstride_map.restype = [c_int], c_void_p
    library.midstride_reserve_port.argtypes, library.midstride_reserve_port.restype = (
        [c_void_p, c_int, c_uint32],
        c_uint32,
    )
    library.midstride_free.argtypes, library.midstride_free.restype = [c_void_p, c_uint32], None
    library.midstride_requests_step.argtypes = [c_void_p, c_int, c_uint32, c_int, c_uint32, c_int64]
    library.midstride_requests_step.restype = c_uint64
    library.midstride_forget_goal.argtypes = [c_void_p, c_uint32, c_uint32, c_uint64]
    library.midstride_forget_goal.restype = None
    library.midstride_ring.argtypes, library.midstride_ring.restype = [c_void_p, c_uint32], None
    return library


class Page:
    """The page at ``path``, created if need be. One manager writes to it at a time. Raises BackendError.

    It stays mapped for as long as the process lives.
    """

    def __init__(self, path: Path, library: Path) -> None:
        self.path, self.library_path = path, library
        self._library = load_library(library)
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            if os.fstat(self._file).st_size == 0:
                self._reserve(ctypes.sizeof(PageLayout) + ROOM * ctypes.sizeof(PagePort))
                fixed, node, port = PART_SIZES
                head = PageLayout(MAGIC, VERSION, fixed, node, port, room=ROOM)
                os.pwrite(self._file, bytes(head)[:HEAD_SIZE], 0)
            self._address = self._library.midstride_map(self._file)
        except OSError as error:
            raise BackendError(f"the page of the gates, {path}, cannot be used: {error.strerror or error}") from None
        if not self._address:
            raise _unusable(path, version_of(self._file))
        self.layout = PageLayout.from_address(self._address)
        self._ports = (PagePort * MOST_PORTS).from_address(self._address + ctypes.sizeof(PageLayout))
        self._requests = (PageRequests * NODES).from_address(self._address + REQUESTS_OFFSET)

    def _reserve(self, size: int) -> None:
        """Now: a process that writes where the disk has no space left by then is killed (SIGBUS). Raises OSError."""
        try:
            os.posix_fallocate(self._file, 0, size)
        except OSError:
            os.ftruncate(self._file, 0)  # the next one begins anew
            raise

    def allocate(self, instance: str, *, process: int | None = None, name: str = "") -> int:
        """The index of an unused node, which now is that of ``instance``. Raises BackendError where all are used.

        ``process``: the index of the node that its process is started as, where that is another one: then ``name`` is
        the full name of the ROS node by which the library tells it from others of the process.
        """
        now = int(time.monotonic())

        def use(index: int) -> int:
            node = self.layout.nodes[index]
            if not node.used:  # a process that goes on without this node of it keeps its lock
                return 3 if node.pid and not self.is_dead(index) else 0
            if node.pid:  # a manager that was killed has not freed what its nodes had
                return 1 if self.is_dead(index) else 3
            return 3 if 0 <= now - node.beat < JOINED_WITHIN else 2

        least, index = min((use(index), index) for index in range(NODES))
        if least == 3:
            raise BackendError(f"more than {NODES} nodes have a gate")
        self.free(index)
        node = self.layout.nodes[index]
        ctypes.memset(ctypes.addressof(node), 0, ctypes.sizeof(node))
        node.process = (index if process is None else process) + 1
        node.instance, node.name = instance.encode()[: NAME - 1], name.encode()[: NAME - 1]
        node.beat, node.used = now, IN_USE
        return index

    def ports(self, index: int) -> list[PagePort]:
        """The ports of a node, in their order; those of its servers are among :meth:`servers`."""
        found = [port for port in self.every_port() if port.node == index + 1 and port.kind in (OUTPUT, INPUT)]
        return sorted(found, key=lambda port: int(port.number))

    def ros_nodes(self, index: int) -> list[str] | None:
        """The full names of the ROS nodes that the node ``index`` stands for, sorted.

        They are all of a process, but those that are other nodes of the page, and what their components have made. A
        name that several have occurs as often. None where the page had no room for one of the process.
        """
        if self.layout.nodes[self.layout.nodes[index].process - 1].unlisted:
            return None
        found = (port for port in self.every_port() if port.node == index + 1 and port.kind == NODE)
        return sorted(port.topic.decode() for port in found)

    def loaded_into(self, process: int, but: Container[int | None]) -> set[str]:
        """The full names of the ROS nodes of other nodes of the page that the container ``process`` has or may have.

        Without those of ``but``. One that it has said to have unloaded counts as long as something of it is there.
        """
        found = set()
        for index, node in enumerate(self.layout.nodes):
            if node.process == process + 1 and node.name and index not in but and (node.used or self._lives(index)):
                found |= {node.name.decode(), *((self.ros_nodes(index) or ()) if node.used else ())}
        return found

    def loads(self, process: int, index: int | None) -> None:
        """The container that was started as the node ``process`` is asked to load the node ``index``; None: no more.

        What its thread creates meanwhile belongs to that node.
        """
        self.layout.nodes[process].loading = 0 if index is None else index + 1

    def is_loading(self, process: int) -> bool:
        """Return whether the container of the node ``process`` has taken a request to load, and not answered it."""
        return bool(self.layout.nodes[process].loads)

    def leaves(self, index: int, now: bool) -> None:
        """Have nothing call the node ``index`` of a container any more; not ``now``: it is called again."""
        node = self.layout.nodes[index]
        node.used = node.used | LEAVES if now else node.used & ~LEAVES
        self.ring(index)

    def is_called(self, index: int) -> bool:
        """Return whether a thread may be in a call of the node ``index`` of a container, as far as its library sees."""
        return bool(self.layout.nodes[index].calls)

    def every_port(self) -> Iterator[PagePort]:
        """The ports of all nodes, and the free ones."""
        return (self._ports[number] for number in range(self.layout.room))

    def index_of(self, instance: str) -> int | None:
        """The index of the node of ``instance``; of one that lives, as a broken-off hand-over may leave another."""
        name = instance.encode()[: NAME - 1]
        found = [
            index
            for index, node in enumerate(self.layout.nodes)
            if node.used and node.instance == name and not node.used & HAS_AGENT
        ]
        return min(found, key=lambda index: not self._lives(index), default=None)

    def free(self, index: int) -> None:
        number, baton = self.layout.nodes[index].requests, self.layout.nodes[index].unstated
        self._lose_requests(index)
        self._library.midstride_free(self._address, index)
        if baton:
            self._leave_unstated(index, baton)
        for path in self.path.parent.glob(f"{self.path.name}.{index}.*"):
            path.unlink(missing_ok=True)
        if number and any(node.used and node.requests == number for node in self.layout.nodes):
            self._step_requests(number, RequestsStep.FORGET, index)
            self._requests[number - 1].shared = False

    # -- topics that are no ports ----------------------------------------------------------------------

    def have_unstated(self, index: int, patience: float, of: int | None = None) -> None:
        """One baton decides for the topics of the node ``index`` that are no ports: its own, or the node ``of``'s.

        Before its process starts. ``patience`` (s): as in `baton.h`. Raises BackendError.
        """
        nodes = self.layout.nodes
        baton = (0 if of is None else nodes[of].unstated) or self.new_baton(index)
        self.layout.batons[baton - 1].patience = int(patience * 1e9)
        nodes[index].unstated = baton

    def unstated(self, index: int) -> dict[str, PagePort]:
        """By full name, the topics, no ports, on which the node ``index`` writes only with the baton for them."""
        baton = self.layout.nodes[index].unstated
        found = (port for port in self.every_port() if port.node == index + 1 and port.kind == OUTPUT)
        return {port.topic.decode(): port for port in found if baton and port.baton == baton and port.endpoints}

    def _leave_unstated(self, index: int, baton: int) -> None:
        """A node has ended that shared ``baton`` with others of its role."""
        word = self.word(baton)
        if word.predecessor == index + 1:
            self.step(baton, BatonStep.SETTLE, word.holder - 1)
        if word.successor == index + 1:
            self.step(baton, BatonStep.WITHDRAW, word.holder - 1)
        others = [other for other, node in enumerate(self.layout.nodes) if node.used and node.unstated == baton]
        if word.holder == index + 1 and others:
            other = min(others, key=lambda other: not self._lives(other))
            self.step(baton, BatonStep.GIVE, other)
            self.ring(other)

    # -- requests to services --------------------------------------------------------------------------

    def have_requests(self, index: int, of: int | None = None) -> None:
        """The node ``index`` answers the requests to its role, or those of the node ``of`` once it is given them.

        Before its process starts. Raises BackendError.
        """
        nodes = self.layout.nodes
        if of is not None and nodes[of].requests:
            nodes[index].requests = nodes[of].requests
            self._requests[nodes[of].requests - 1].shared = True
            self.ring(of)
            return
        used = {node.requests for node in nodes if node.used}
        number = next(number for number in range(1, NODES + 1) if number not in used)
        size = ctypes.sizeof(PageRequests)
        try:
            os.posix_fallocate(self._file, REQUESTS_OFFSET + (number - 1) * size, size)
        except OSError as error:
            raise BackendError(f"the page of the gates, {self.path}, cannot grow: {error.strerror}") from None
        ctypes.memset(ctypes.addressof(self._requests[number - 1]), 0, size)
        self._step_requests(number, RequestsStep.GIVE, index)
        nodes[index].requests = number

    def mix_requests(self, index: int) -> None:
        """The node ``index`` is a component with Midstride's API, which claims requests one by one."""
        self.layout.nodes[index].used |= HAS_AGENT
        self._requests[self.layout.nodes[index].requests - 1].mixed = FOR_EVER

    def _step_requests(self, number: int, step: RequestsStep, index: int, until: int = 0) -> None:
        self._library.midstride_requests_step(self._address, self._file, number - 1, step, index + 1, until)

    def give_requests(self, index: int, patience: float) -> None:
        """The node ``index`` is to answer from now on; the one before has ``patience`` (s) for what it has taken.

        Raises BackendError where it has ended: its part of the page has been taken back.
        """
        if not (number := self.layout.nodes[index].requests):
            raise BackendError("the node has ended, so it cannot answer requests")
        if (other := self.answering(index)) is not None:
            self._lose_requests(other)
        self._step_requests(number, RequestsStep.GIVE, index, time.monotonic_ns() + int(patience * 1e9))

    def _lose_requests(self, index: int) -> None:
        """Have no node answer what has arrived by now, if the node ``index`` answers and is a component that has not
        noted what it had handled: it may have answered each of them.
        """
        node = self.layout.nodes[index]
        if node.requests and node.used & (HAS_AGENT | NOTED) == HAS_AGENT and self.answering(index) is None:
            self._requests[node.requests - 1].lost = time.monotonic_ns()

    def pause_requests(self, index: int, longest: float) -> None:
        """No node of the role of the node ``index`` takes a request until resumed, or after ``longest`` (s)."""
        if number := self.layout.nodes[index].requests:
            self._requests[number - 1].paused = time.monotonic_ns() + int(longest * 1e9)

    def resume_requests(self, index: int) -> None:
        """The node that answers the requests to the role of the node ``index`` goes on with those that were held."""
        if number := self.layout.nodes[index].requests:
            self._requests[number - 1].paused = 0

    def answering(self, index: int) -> int | None:
        """The index of the node that answers the requests to the role of the node ``index``; None where it does."""
        number = self.layout.nodes[index].requests
        found = (self._requests[number - 1].word & 0xFFF) - 1 if number else index
        return None if found == index else int(found)

    def answered_before(self, index: int) -> int | None:
        """The index of the node that has answered before the one that does now, until it has ended."""
        number = self.layout.nodes[index].requests
        found = (self._requests[number - 1].word >> 12 & 0xFFF) - 1 if number else -1
        return None if found < 0 else int(found)

    def servers(self, index: int) -> dict[str, PagePort]:
        """By full name, the services that the node ``index`` has now."""
        found = (port for port in self.every_port() if port.node == index + 1 and port.kind == SERVER)
        return {port.topic.decode(): port for port in found if port.endpoints}

    def server(self, service: str, index: int | None = None, known: PagePort | None = None) -> PagePort | None:
        """The server that answers the requests to a service (full name), of the node ``index`` if that is given.

        ``known``: the one that it may still be. None where no node with a page answers.
        """
        name = service.encode()

        def serves(port: PagePort) -> bool:
            node = int(port.node) - 1
            own = index in (None, node) and bool(port.endpoints) and not self.layout.nodes[node].used & HAS_AGENT
            return own and (port.kind, port.topic) == (SERVER, name) and not self.is_dead(node)

        if known is not None and serves(known) and self.answering(known.node - 1) is None:
            return known
        found = [port for port in self.every_port() if port.kind == SERVER and serves(port)]
        return min(found, key=lambda port: self.answering(port.node - 1) is not None, default=None)

    # -- requests of the manager to one node ----------------------------------------------------------

    def ask(self, index: int, service: str, request: bytes) -> int:
        """Put a request to a service (full name) of the node ``index`` alone; its number. Raises BackendError."""
        node = self.layout.nodes[index]
        number = int(node.asked) + 1 & 0xFFFFFFFF
        path = self._asked(index, number)
        try:
            path.write_bytes(service.encode() + b"\0" + request)
        except OSError as error:
            raise BackendError(f"{path} cannot be written: {error.strerror or error}") from None
        node.asked = number
        self.ring(index)
        return number

    def response(self, index: int, number: int) -> bytes | None:
        """The response to the request ``number``; None until there is one. It is read once. Raises BackendError."""
        path = self._asked(index, number, ".answer")
        try:
            found = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise BackendError(f"{path} cannot be read: {error.strerror or error}") from None
        path.unlink(missing_ok=True)
        return found

    def withdraw(self, index: int, number: int) -> None:
        """The request ``number`` has been answered, or is not waited for any longer; it may be handled all the same."""
        for suffix in ("", ".answer"):
            self._asked(index, number, suffix).unlink(missing_ok=True)

    def settings(self, index: int) -> list[KnownSetting]:
        """The requests to set parameters that the node ``index`` has taken, in their order. Raises BackendError."""
        path, found = self.path.with_name(f"{self.path.name}.{index}.{SETTINGS}"), list[KnownSetting]()
        try:
            noted = path.read_bytes()
        except FileNotFoundError:
            return []
        except OSError as error:
            raise BackendError(f"{path} cannot be read: {error.strerror or error}") from None
        begin = 0
        while len(noted) >= begin + _SETTING.size:
            at, length = _SETTING.unpack_from(noted, begin)
            begin += _SETTING.size + length
            if len(noted) < begin:  # it is being written
                break
            service, _, request = noted[begin - length : begin].partition(b"\0")
            found.append(KnownSetting(at / 1e9, service.decode(errors="replace"), request))
        return found

    def _asked(self, index: int, number: int, suffix: str = "") -> Path:
        return self.path.with_name(f"{self.path.name}.{index}.{number}{suffix}")

    def mark(self, index: int) -> bytes | None:
        """The identity by which the graph shows the first publisher of the process; None until there is one."""
        node = self.layout.nodes[self.layout.nodes[index].process - 1]
        return bytes(node.mark) if node.marked else None

    # -- goals of ROS actions --------------------------------------------------------------------------

    def goals(self, index: int) -> list[KnownGoal]:
        """The goals that the node ``index`` has accepted, or is about to."""
        number = self.layout.nodes[index].requests
        found: list[KnownGoal] = []
        for place, goal in enumerate(self._requests[number - 1].goals if number else ()):
            word = int(goal.word)
            if word & 0xFFF == index + 1 and (state := GoalState(word >> 12 & 0xF)) is not GoalState.NO_GOAL:
                service = self._ports[goal.port - 1].topic.decode() if goal.port else ""
                found.append(KnownGoal(service.removesuffix(SEND_GOAL), state, bytes(goal.id), place, word))
        return found

    def forget_goal(self, index: int, goal: KnownGoal) -> None:
        """Have another goal take the place of this one of the node ``index``, whose result is kept beside the page."""
        if number := self.layout.nodes[index].requests:
            self._library.midstride_forget_goal(self._address, number - 1, goal.place, goal.word)

    def goal_counts(self, index: int) -> GoalCounts | None:
        """Count the goals of the node ``index`` by what has become of them; None where it has had none."""
        accepted, ended, cancelled, unknown = self.layout.nodes[index].goals
        found = GoalCounts(accepted=accepted, ended=ended, cancelled=cancelled, unknown=unknown)
        return found if found != GoalCounts() else None

    def cancel_goals(self, index: int) -> None:
        """Have the process of the node ``index`` cancel all its goals, as a client of its would."""
        self.layout.nodes[index].cancels = True
        self.ring(index)

    def keep_result(self, goal: bytes, response: bytes) -> None:
        """Keep the response with the result of a goal (its UUID) for the node that answers once its own has ended.

        The oldest are given up where all would have more than KEPT_RESULTS bytes. Raises BackendError.
        """
        path = self.path.with_name(f"{self.path.name}.result.{goal.hex()}")
        if len(response) > KEPT_RESULTS:
            raise BackendError(f"a result of {len(response)} bytes is not kept, only up to {KEPT_RESULTS}")
        kept = sorted(kept_results(self.path), key=lambda each: each.stat().st_mtime_ns)
        size = len(response) + sum(each.stat().st_size for each in kept)
        for oldest in kept:
            if size <= KEPT_RESULTS:
                break
            size -= oldest.stat().st_size
            oldest.unlink()
        write_gate_file(path, response)

    # -- what its processes do -------------------------------------------------------------------------

    def set_ports(self, index: int, topics: Sequence[tuple[str, int]]) -> None:
        """The topics of a node, each with its kind; closed. Raises BackendError where that cannot be."""
        if any(len(topic.encode()) >= NAME for topic, _ in topics):
            raise BackendError(f"the topic of a port with a gate has at most {NAME - 1} bytes")
        for number, (topic, kind) in enumerate(topics):
            reserved = self._library.midstride_reserve_port(self._address, self._file, index)
            if not reserved:
                raise BackendError(f"the page of the gates, {self.path}, has no room for a port")
            port = self._ports[reserved - 1]
            port.number, port.topic, port.kind = number, topic.encode(), kind

    def new_baton(self, holder: int) -> int:
        """The index + 1 of a baton that no port has; the node ``holder`` (index) holds it. Raises BackendError."""
        used = {port.baton for port in self.every_port() if port.node}
        used |= {node.unstated for node in self.layout.nodes if node.used}
        number = next((number for number in range(1, BATONS + 1) if number not in used), None)
        if number is None:
            raise BackendError(f"more than {BATONS} batons are in use")
        self.step(number, BatonStep.GIVE, holder)
        return number

    def word(self, baton: int) -> BatonWord:
        return BatonWord.of(self.layout.batons[baton - 1].word)

    def step(self, baton: int, step: BatonStep, node: int, successor: int = -1, at_once: bool = False) -> BatonWord:
        """Take ``step``; the word before. ``node`` and ``successor`` are indices."""
        entry = self.layout.batons[baton - 1]
        return BatonWord.of(
            self._library.midstride_take_step(ctypes.byref(entry), step, node + 1, successor + 1, at_once)
        )

    def silence(self, topic: str) -> float | None:
        """For how long no node that may publish on ``topic`` has written (s); None where none may, or has ever."""
        name, last = topic.encode(), 0
        for port in self.every_port():
            if (port.kind, port.gate, port.topic) == (OUTPUT, OPEN, name) and (
                not port.baton or self.word(port.baton).holder == port.node
            ):
                last = max(last, port.tried)
        return max(0, time.monotonic_ns() - last) / 1e9 if last else None

    def is_dead(self, index: int) -> bool:
        """Return whether the process that has joined as the node ``index`` has ended."""
        node = self.layout.nodes[index]
        return bool(node.pid) and bool(self._library.midstride_is_dead(self._file, index + 1))

    def _lives(self, index: int) -> bool:
        return bool(self.layout.nodes[index].pid) and not self.is_dead(index)

    def ring(self, index: int) -> None:
        """Have the helper thread of a node look at once."""
        self._library.midstride_ring(self._address, index)

    def beat(self, index: int) -> int:
        """A number that changes each time the helper thread of a node has looked."""
        return int(self.layout.nodes[self.layout.nodes[index].process - 1].beat)


def kept_results(page: Path) -> list[Path]:
    """The files with the results of goals that are kept beside the page, the file ``page``."""
    return list(page.parent.glob(f"{page.name}.result.*"))
