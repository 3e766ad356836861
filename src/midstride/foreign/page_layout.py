"""The layout of the page of shared memory in which gates and batons are, as ``gate/page.h`` has it.

A test compares the two (``tests/foreign/test_gate_library.py``). :mod:`midstride.foreign.page` reads and writes it.
"""

from __future__ import annotations

import ctypes
import os
from ctypes import c_char, c_int64, c_uint8, c_uint32, c_uint64
from enum import IntEnum, IntFlag
from typing import Final

MAGIC: Final = 0x4D4944535452444E
VERSION: Final = 20
# The oldest layout that is used as well, where an earlier version has begun the page.
OLDEST: Final = 19
NODES: Final = 512
BATONS: Final = 1024
# How many ports a system may have in all, and how many the file has room for at first.
MOST_PORTS: Final = 65536
ROOM: Final = 64
NAME: Final = 256
# Of the identity of an endpoint in the graph.
MARK: Final = 16
# How many clients of its services are known for a role at once.
CLIENTS: Final = 512
# How many goals of its ROS actions, and requests to cancel many of them that are under way.
GOALS: Final = 256
ADDED: Final = 4
# Of how many pairs of an output and a writer of what it answers is the last answer known for a role.
ANSWERED: Final = 256
# How many of the requests to a role's services are known one by one.
KNOWN: Final = 4096
# Of how many messages it is known that an input has received them.
RECEIPTS: Final = 16384
# Of how many messages of an output it is known when they were written.
WRITES: Final = 128
# Of how many requests that a server has answered it is known how long each took.
LATEST: Final = 8

# Of a port. The gate is in what publishes or receives; the library adds a port for each server. NODE: it is none, and
# names a ROS node of the process.
UNUSED, OUTPUT, INPUT, SERVER, CLIENT, NODE = range(6)
CLOSED, OPEN = range(2)
# Of a node, in `used`. LISTS: the library adds a port for each of its topics, with an open gate. NAMES_ONE: a
# `__node:=` for all nodes of the process names the first of them alone. LEAVES: it is about to be unloaded, and nothing
# calls it any more. HAS_AGENT: it is a component with Midstride's API, which shares the requests to its services with a
# node that has the library. NOTED: it has noted what it had handled before.
IN_USE, LISTS, NAMES_ONE, LEAVES, HAS_AGENT, NOTED = 1, 2, 4, 8, 16, 32


class PortFlag(IntFlag):
    """RATED: its writes are slots. OFFERS: the baton is offered after one. TIMED: no port that shares it is rated.

    KEEPS: of what is written behind the gate, the last message is kept, and published when the gate lets it pass; of a
    latched publisher, as many as its depth.
    SHUT: an input that a probe closes, as long as the lease of the page lasts.
    ANSWERS: of what answers a message, more is kept, in case it is to be handed over between two inputs; with TIMED, it
    is (``answers.h``).
    """

    RATED = 1
    OFFERS = 2
    TIMED = 4
    KEEPS = 8
    SHUT = 16
    ANSWERS = 32


class Within(IntFlag):
    """Of an output: what becomes of intra-process communication, which goes past the gate (``within.c``).

    KEEP_OUT: its publishers are not to take part. KEPT_OUT: one would have. TAKES_PART: one does.
    """

    KEEP_OUT = 1
    KEPT_OUT = 2
    TAKES_PART = 4


class PagePort(ctypes.Structure):
    _fields_ = [
        ("kind", c_uint32),
        ("flags", c_uint32),
        ("gate", c_uint32),
        ("baton", c_uint32),
        ("passed", c_uint64),
        ("gated", c_uint64),
        ("last", c_int64),
        ("tried", c_int64),
        ("endpoints", c_uint32),
        ("matched", c_uint32),
        ("kept", c_uint32),
        ("half", c_uint32),
        ("node", c_uint32),
        ("number", c_uint32),
        ("waiting", c_int64),
        ("busy", c_int64),
        ("answered", c_uint32),
        ("took", c_uint32 * LATEST),
        ("in_step", c_uint32),
        ("falls", c_uint32),
        ("answers", c_uint64),
        ("overlaps", c_uint64),
        ("recorded", c_uint32),
        ("within", c_uint32),
        ("written", c_uint64),
        ("inside", c_uint64),
        ("wrote", c_uint32 * WRITES),
        ("topic", c_char * NAME),
    ]


class PageReceipt(ctypes.Structure):
    _fields_ = [
        ("place", c_uint64),
        ("received", c_int64),
        ("sent", c_int64),
        ("number", c_uint64),
        ("writer", c_uint8 * MARK),
    ]


class PageReceipts(ctypes.Structure):
    _fields_ = [
        ("count", c_uint64),
        ("last", PageReceipt * RECEIPTS),
    ]


class PageNode(ctypes.Structure):
    _fields_ = [
        ("pid", c_uint32),
        ("bell", c_uint32),
        ("beat", c_uint32),
        ("used", c_uint32),
        ("process", c_uint32),
        ("unlisted", c_uint32),
        ("requests", c_uint32),
        ("unanswered", c_uint32),
        ("answered", c_int64),
        ("unstated", c_uint32),
        ("asked", c_uint32),
        ("marked", c_uint32),
        ("mark", c_uint8 * MARK),
        ("cancels", c_uint32),
        ("beyond", c_uint32),
        ("goals", c_uint32 * 4),
        ("apart", c_uint32),
        ("loading", c_uint32),
        ("loads", c_uint32),
        ("calls", c_uint32),
        ("instance", c_char * NAME),
        ("name", c_char * NAME),
    ]


class PageBaton(ctypes.Structure):
    _fields_ = [
        ("word", c_uint64),
        ("offered", c_int64),
        ("patience", c_int64),
        ("collisions", c_uint64),
        ("padding", c_uint64 * 4),
    ]


class PageClient(ctypes.Structure):
    _fields_ = [
        ("id", c_uint64),
        ("word", c_uint64),
        ("seen", c_uint64),
        ("last", c_int64),
    ]


class PageGoal(ctypes.Structure):
    _fields_ = [
        ("word", c_uint64),
        ("id", c_uint64 * 2),
        ("at", c_int64),
        ("port", c_uint32),
        ("spare", c_uint32),
    ]


class PageAdded(ctypes.Structure):
    """The goals that a node has cancelled for a request which another one answers."""

    _fields_ = [
        ("word", c_uint64),
        ("client", c_uint64),
        ("number", c_int64),
        ("count", c_uint32),
        ("spare", c_uint32),
        ("goals", c_uint8 * 24 * GOALS),
    ]


class PageAnswered(ctypes.Structure):
    """Of an output of a role, and a writer of what it answers: the last answer."""

    _fields_ = [
        ("id", c_uint64),
        ("number", c_uint64),
        ("at", c_int64),
        ("by", c_uint32),
        ("spare", c_uint32),
    ]


class GoalState(IntEnum):
    """The states of a goal of a ROS action; ``goals.h`` has the steps."""

    NO_GOAL = 0
    RESERVED = 1
    ASKED = 2
    ACCEPTED = 3
    ENDED = 4
    FETCHED = 5


class PageRequests(ctypes.Structure):
    """The requests to the services of a role, and the messages that it answers; behind the place of the last port."""

    _fields_ = [
        ("word", c_uint64),
        ("until", c_int64),
        ("paused", c_int64),
        ("mixed", c_int64),
        ("shared", c_uint32),
        ("knows", c_uint32),
        ("lost", c_int64),
        ("spare", c_uint32 * 4),
        ("clients", PageClient * CLIENTS),
        ("goals", PageGoal * GOALS),
        ("added", PageAdded * ADDED),
        ("answered", PageAnswered * ANSWERED),
        ("known", c_uint64 * KNOWN),
    ]


class RequestsStep(IntEnum):
    """GIVE: a node is to answer. FORGET: it has ended."""

    GIVE = 0
    FORGET = 1


class PageLayout(ctypes.Structure):
    """The part of the page before the ports; ``room``: for how many of them the file has room."""

    _fields_ = [
        ("magic", c_uint64),
        ("version", c_uint32),
        ("size", c_uint32),
        ("node_size", c_uint32),
        ("port_size", c_uint32),
        ("lease", c_int64),
        ("room", c_uint32),
        ("spare", c_uint32 * 7),
        ("batons", PageBaton * BATONS),
        ("nodes", PageNode * NODES),
    ]


HEAD_SIZE: Final = PageLayout.batons.offset
# Where the requests are, from the start of the file.
REQUESTS_OFFSET: Final = ctypes.sizeof(PageLayout) + MOST_PORTS * ctypes.sizeof(PagePort)
PART_SIZES: Final = (ctypes.sizeof(PageLayout), ctypes.sizeof(PageNode), ctypes.sizeof(PagePort))


def version_of(file: int) -> int | None:
    """The layout of a page; None where the file is none."""
    head = PageLayout.from_buffer_copy(os.pread(file, HEAD_SIZE, 0).ljust(ctypes.sizeof(PageLayout), b"\0"))
    return int(head.version) if head.magic == MAGIC else None
