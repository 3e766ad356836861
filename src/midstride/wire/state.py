"""The reports of a component: its registration, once, and its state, after every change."""

from __future__ import annotations

import socket
from typing import Any, Final, Literal, TypeAlias

import msgspec

from midstride.codec.parameter import from_json

GateState: TypeAlias = Literal["open", "closed"]

# By how much a measured rate may be below the declared one: the tolerance of ROS's own diagnostic_updater.
RATE_TOLERANCE: Final = 0.1

# The name of the computer or container that this process runs on.
THIS_HOST: Final = socket.gethostname()


class WireValue(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The base of everything on the wire: unknown and missing fields are refused by name."""


class Endpoint(WireValue, frozen=True, kw_only=True):
    """An endpoint of a component's node that is neither a port nor one of ROS's own.

    ``serves``: the node is the server of the service or ROS action, False: it calls it; None: a topic, or not known.
    """

    kind: Literal["topic", "service", "ROS action"]
    name: str
    serves: bool | None = None

    @property
    def words(self) -> str:
        """The endpoint in words, such as ``ROS action /dock``."""
        return f"{self.kind} {self.name}"


class UndeclaredTopic(WireValue, frozen=True, kw_only=True):
    """A topic, by its full name, that a node without Midstride's API publishes on or subscribes to beside its ports.

    ``handed_over``: of two instances of its role, at most one publishes there at any moment.
    """

    output: bool
    topic: str
    type: str
    handed_over: bool = False

    @property
    def words(self) -> str:
        """The endpoint in words, such as ``publishes on /chatter (std_msgs/msg/String)``."""
        return f"{'publishes on' if self.output else 'subscribes to'} {self.topic} ({self.type})"


class FunctionalityState(WireValue, frozen=True, kw_only=True):
    """``since``: seconds in this mode. ``busy``: for how many seconds a call of user code has been running.

    ``reflex``: the local reflex has entered this mode; no command did, and no exception. ``conditional``: a condition
    that does not hold has led to it, or to a lower one before it, and nothing else.
    """

    mode: str
    since: float
    because: str
    busy: float | None = None
    reflex: bool = False
    conditional: bool = False


class Measured(WireValue, frozen=True, kw_only=True):
    """The measurements of the messages of one attachment, on the node's ROS clock, in the last ``window`` seconds.

    ``covered`` seconds of the window are measured: less than all of it soon after the attachment. ``rate`` (Hz) is then
    None before the second message; it is 0 once the window has none. ``age``: seconds since the last message, None
    before the first. ``jitter`` is the standard deviation of the times between messages, ``longest`` the longest of
    them, that since the last message included (s); None where no two are known.
    """

    window: float
    covered: float = 0.0
    rate: float | None = None
    age: float | None = None
    jitter: float | None = None
    longest: float | None = None

    def meets(self, rate: float) -> bool | None:
        """Return whether a declared rate (Hz) is kept, to within ``RATE_TOLERANCE``; None until a whole window is
        measured.
        """
        if self.covered < self.window:
            return None
        return (self.rate or 0.0) >= (1 - RATE_TOLERANCE) * rate


class MeasuredResponses(WireValue, frozen=True, kw_only=True):
    """The responses of the server at one attachment, which has a bound of ``within`` (s).

    It has ``answered`` so many of the requests that were looked at, ``late`` of these later than the bound.
    ``longest``: the longest that one has taken since the last look (s), None where none was answered. ``silent``: for
    how long it has not done what it should (s); ``broken`` says what that is once it is more than what is
    ``tolerated`` (s), else None.
    """

    within: float
    tolerated: float
    answered: int = 0
    late: int = 0
    longest: float | None = None
    silent: float = 0.0
    broken: str | None = None

    @property
    def words(self) -> str:
        """The breach in words, such as ``has not answered a request for 0.3 s, 50 ms are promised``."""
        return f"{self.broken} for {duration_in_words(self.silent)}, {self.promised}"

    @property
    def promised(self) -> str:
        """The promise in words, such as ``50 ms are promised``."""
        return f"{duration_in_words(self.within)} are promised"


def duration_in_words(seconds: float) -> str:
    """A duration such as ``50 ms``, ``0.3 s`` or ``12.5 s``: in ms below 0.1 s."""
    return f"{seconds * 1e3:.3g} ms" if seconds < 0.1 else f"{seconds:.1f} s" if seconds >= 10 else f"{seconds:.2g} s"


class FieldSamples(WireValue, frozen=True, kw_only=True):
    """Of ``checked`` messages, ``violations`` did not meet a constraint on a field: ``run`` since the last that met it.

    ``last``: the field's value in the last one that did not meet it, None where there is none.
    """

    constraint: str
    checked: int
    violations: int
    run: int
    last: bool | int | float | str | None = None


# What a component waits for that has been started, and is not yet part of its system.
NOT_WELCOMED: Final = "no manager has welcomed it yet"


class LinkState(WireValue, frozen=True, kw_only=True):
    """One attachment. ``count`` messages have passed, ``gated`` have not; an input has no gate.

    ``fields``: samples of the fields that the contract in force constrains.
    ``fenced``: its gate was closed although user code did not return, and nothing but lifting that opens it.
    ``inactive``: for how long in all, at most (s), an output of a lifecycle node that nothing else gates was silent
    since it was first handed to this one, because no node that writes it was active; None for any other.
    ``responses``: of a server, or of a client, where a bound is stated and something measures it.
    ``by_input``: of an output of a node without the API, whether each of its last messages has answered one that the
    node had taken; None where nothing sees that. ``kept_out``: without its gate, it would use intra-process
    communication, which goes past one.
    """

    gate: GateState | None
    count: int
    gated: int = 0
    measured: Measured | None = None
    fields: dict[str, FieldSamples] = msgspec.field(default_factory=dict)
    fenced: bool = False
    inactive: float | None = None
    responses: MeasuredResponses | None = None
    by_input: bool | None = None
    kept_out: bool = False


class GoalCounts(WireValue, frozen=True, kw_only=True):
    """The goals of an instance since its start: of those that it ``accepted``, so many ``ended``.

    So many others ended as they were ``cancelled``. To so many requests it has answered that it does not know the goal
    (``unknown``), which no other instance knew either.
    """

    accepted: int = 0
    ended: int = 0
    cancelled: int = 0
    unknown: int = 0

    @property
    def in_progress(self) -> int:
        return self.accepted - self.ended - self.cancelled


class ComponentState(WireValue, frozen=True, kw_only=True, omit_defaults=True):
    """``revision`` counts the component's changes. ``waiting``: what it waits for, if anything.
    ``differences``: in which way its node is not what is declared, ``undeclared``: its topics that are no ports. Only a
    node without Midstride's API can show these. The same holds for ``serves``, the services and ROS actions that end
    with it, for ``lifecycle_callers``, the nodes that call its lifecycle services, for ``calls``, in words, those to
    which it may have sent requests and goals, and for ``unanswered``: for how long it
    has not answered its agent, which answers here (s). ``managed``: why it must not end, as a lifecycle manager would
    take all of its nodes down; ``starting``: the instances that have just been started, and may be such managers.
    ``looked``: the graph has been asked for these since it started; ``shown``: it has shown something of the node.

    ``node``: the full name of its ROS node, None where there is none. ``keeps_name``: it has no API, and a replacement
    with a gate inside gets this name as well. ``answers``: it answers requests to the node's
    services; of several instances of a role, one does.
    ``simulated_time``: its ROS clock follows ``/clock``, and gains ``clock_speed`` seconds in each second (0: it stands
    still, or that is not known yet). ``stopping`` is how long it may take to end in order (s).
    ``ports`` maps port -> topic -> attachment. ``imported`` counts the modules that its process has imported: where it
    has grown, so may have the files of its program. ``declared`` has the parameters that were set while it ran, each
    with the value that it was started with. ``keeps_state``: it exports state for its replacement. ``host``: the name
    of the computer or container that its process runs on, empty where that is not known. ``unread_parameters``: whether
    any were set while it ran is not known, as its parameter services do not answer. ``unknown_origin``: those of
    ``declared`` that a ROS tool has set, or the node itself; ``own_values``: those of them that the node has set, as no
    other program has asked it to set them since its start. ``set_at``: when a request has set those of ``declared`` of
    which that is known (Unix time, s). ``unfinished``: once it ends, in which way its `on_stop`
    has failed, or what it has left unanswered, or which goals. ``goals``: those of its ROS actions, None where it has
    had none. ``ending``: it has been asked to end, refuses changes, and ends by itself.
    """

    instance: str
    uuid: str
    pid: int
    revision: int
    functionalities: dict[str, FunctionalityState]
    ports: dict[str, dict[str, LinkState]]
    parameters: dict[str, Any]
    stopping: float
    waiting: str | None = None
    simulated_time: bool = False
    imported: int = 0
    clock_speed: float = 1.0
    node: str | None = None
    keeps_name: bool = False
    answers: bool = True
    declared: dict[str, Any] = msgspec.field(default_factory=dict)
    keeps_state: bool = False
    differences: list[str] = []
    undeclared: list[UndeclaredTopic] = []
    serves: list[Endpoint] = []
    lifecycle_callers: list[str] = []
    managed: list[str] = []
    starting: list[str] = []
    calls: list[str] = []
    looked: bool = True
    shown: bool = True
    unanswered: float | None = None
    host: str = ""
    unread_parameters: bool = False
    unknown_origin: list[str] = []
    own_values: list[str] = []
    set_at: dict[str, float] = {}
    unfinished: str | None = None
    goals: GoalCounts | None = None
    ending: bool = False

    def set_values(self) -> dict[str, Any]:
        """The values of the parameters that were set while it ran."""
        return {name: from_json(self.parameters[name]) for name in self.declared}
