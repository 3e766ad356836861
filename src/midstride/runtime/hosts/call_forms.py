"""The calls of a back end on another host, and the forms of what they take and return.

Each call is a method of :class:`midstride.runtime.backend_protocol.Backend`, but for :class:`ReadLog`. A form that
is read from a host is checked for its types and bounded; no text in it is taken for a command or a path of this host.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, TypeAlias

from immutables import Map

from midstride.codec.component_form import NamedComponentForm
from midstride.codec.parameter import from_json, json_values
from midstride.errors import (
    BackendError,
    CallTimeout,
    EndUnknown,
    ProtocolError,
    SpecificationError,
    StartFailed,
    Unreachable,
)
from midstride.model.component import ParameterSection, StopTimes
from midstride.model.load_words import LoadWords
from midstride.runtime.backend_protocol import Exited, Handle, Launch, OtherNode, OtherNodes, RemainingProcess
from midstride.wire.state import WireValue

_KINDS: Final = {
    each.__name__: each for each in (BackendError, StartFailed, CallTimeout, Unreachable, ProtocolError, EndUnknown)
}


def kind_of(error: BackendError) -> str:
    """The kind of an error, by which :func:`error_of` makes it again."""
    return type(error).__name__ if type(error).__name__ in _KINDS else BackendError.__name__


def error_of(kind: str, words: str) -> BackendError:
    """The error that a host has reported."""
    return _KINDS.get(kind, BackendError)(words)


class LaunchSectionForm(WireValue, frozen=True, kw_only=True):
    """A section of a parameter file."""

    pattern: str
    parameters: dict[str, Any] = {}


class LaunchForm(WireValue, frozen=True, kw_only=True):
    """A launch, but for its folder and its host, which the host process knows. ``loads``: a node into a container."""

    instance: str
    namespace: str
    arguments: list[str]
    token: str
    parameters: dict[str, Any]
    set_parameters: dict[str, Any]
    node: str
    standby: bool
    patience: float
    foreign: NamedComponentForm | None
    topics: dict[str, str]
    package: str | None
    prefix: list[str]
    environment: dict[str, str | None]
    sections: list[LaunchSectionForm]
    predecessor: str
    role: str
    loads: bool
    process: str
    returns: bool

    @classmethod
    def of(cls, launch: Launch) -> LaunchForm:
        return cls(
            instance=launch.instance,
            namespace=launch.namespace,
            arguments=list(launch.arguments),
            token=launch.token,
            parameters=json_values(launch.parameters),
            set_parameters=json_values(launch.set_parameters),
            node=launch.node,
            standby=launch.standby,
            patience=launch.patience,
            foreign=None if launch.foreign is None else NamedComponentForm.of(launch.foreign),
            topics=dict(launch.topics),
            package=launch.package,
            prefix=list(launch.prefix),
            environment=dict(launch.environment),
            sections=[
                LaunchSectionForm(pattern=each.pattern, parameters=json_values(each.parameters))
                for each in launch.sections
            ],
            predecessor=launch.predecessor,
            role=launch.role,
            loads=launch.load is not None,
            process=launch.process,
            returns=launch.returns,
        )

    def launch(self, directory: Path) -> Launch:
        """The launch on this host, in ``directory``. Raises StartFailed for one that is not well formed."""
        try:
            foreign = None if self.foreign is None else self.foreign.checked()
            load = LoadWords.of(foreign.run or "") if self.loads and foreign is not None else None
        except (SpecificationError, ValueError) as error:
            raise StartFailed(f"{self.instance}: its component cannot be read: {error}") from None
        return Launch(
            self.instance,
            self.namespace,
            tuple(self.arguments),
            self.token,
            directory,
            _values(self.parameters),
            _values(self.set_parameters),
            self.node,
            self.standby,
            self.patience,
            foreign,
            dict(self.topics),
            self.package,
            tuple(self.prefix),
            dict(self.environment),
            tuple(ParameterSection(each.pattern, Map(_values(each.parameters))) for each in self.sections),
            self.predecessor,
            self.role,
            load,
            self.process,
            self.returns,
        )


def _values(form: dict[str, Any]) -> dict[str, Any]:
    return {name: from_json(value) for name, value in form.items()}


class HandleForm(WireValue, frozen=True, kw_only=True):
    """A handle of a process on the host."""

    instance: str
    pid: int | None = None
    started: float | None = None
    log: str | None = None

    @classmethod
    def of(cls, handle: Handle) -> HandleForm:
        return cls(instance=handle.instance, pid=handle.pid, started=handle.started, log=handle.log)

    def handle(self, host: str) -> Handle:
        return Handle(self.instance, self.pid, self.started, self.log, host)


class StopTimesForm(WireValue, frozen=True, kw_only=True):
    """The times for ending a process."""

    sigterm: float
    sigkill: float
    drain: float
    patience: float
    asked: float
    whole: bool

    @classmethod
    def of(cls, stop: StopTimes) -> StopTimesForm:
        return cls(
            sigterm=stop.sigterm,
            sigkill=stop.sigkill,
            drain=stop.drain,
            patience=stop.patience,
            asked=stop.asked,
            whole=stop.whole,
        )

    def times(self) -> StopTimes:
        return StopTimes(self.sigterm, self.sigkill, self.drain, self.patience, self.asked, self.whole)


class RemainingForm(WireValue, frozen=True, kw_only=True):
    """A process that had to be killed."""

    pid: int | None
    program: str
    seconds: float

    @classmethod
    def of(cls, process: RemainingProcess) -> RemainingForm:
        return cls(pid=process.pid, program=process.program, seconds=process.seconds)

    def process(self) -> RemainingProcess:
        return RemainingProcess(self.pid, self.program, self.seconds)


class ExitedForm(WireValue, frozen=True, kw_only=True):
    """A component's process has exited."""

    instance: str
    status: int | None = None
    log_tail: str = ""
    because: str | None = None
    loading: bool = False

    @classmethod
    def of(cls, exited: Exited) -> ExitedForm:
        return cls(
            instance=exited.instance,
            status=exited.status,
            log_tail=exited.log_tail,
            because=exited.because,
            loading=exited.loading,
        )

    def exited(self) -> Exited:
        return Exited(self.instance, self.status, self.log_tail, self.because, self.loading)


class OtherNodeForm(WireValue, frozen=True, kw_only=True):
    """Another node of a process."""

    name: str
    publishes: list[str] = []
    serves: list[str] = []
    namesake: bool = False


class OtherNodesForm(WireValue, frozen=True, kw_only=True):
    """The other nodes of a process."""

    nodes: list[OtherNodeForm] = []
    unknown: str | None = None
    without_own: bool = False

    @classmethod
    def of(cls, others: OtherNodes) -> OtherNodesForm:
        nodes = [
            OtherNodeForm(
                name=each.name, publishes=list(each.publishes), serves=list(each.serves), namesake=each.namesake
            )
            for each in others.nodes
        ]
        return cls(nodes=nodes, unknown=others.unknown, without_own=others.without_own)

    def others(self) -> OtherNodes:
        nodes = (OtherNode(each.name, tuple(each.publishes), tuple(each.serves), each.namesake) for each in self.nodes)
        return OtherNodes(tuple(nodes), self.unknown, self.without_own)


class KnownIds(WireValue, frozen=True, kw_only=True):
    """The identities of publishers; None where the middleware does not tell."""

    ids: list[str] | None


class LogPiece(WireValue, frozen=True, kw_only=True):
    """A part of a log."""

    content: bytes


# -- the calls ---------------------------------------------------------------------------------------------


class _Call(WireValue, frozen=True, kw_only=True, tag_field="name"):
    """A call of the back end."""


class Start(_Call, frozen=True, kw_only=True, tag="start"):
    """Start a component; the result is a :class:`HandleForm`."""

    launch: LaunchForm


class Describe(_Call, frozen=True, kw_only=True, tag="describe"):
    """Fail as a start would, where a program or a file that it names is not there; the result is the command."""

    launch: LaunchForm


class Adopt(_Call, frozen=True, kw_only=True, tag="adopt"):
    """The result says whether the component runs."""

    handle: HandleForm


class End(_Call, frozen=True, kw_only=True, tag="end"):
    """The result is a list of :class:`RemainingForm`."""

    instance: str
    stop: StopTimesForm


class EndOrphans(_Call, frozen=True, kw_only=True, tag="end_orphans"):
    """The result is a list of names."""

    token: str
    known: list[str]
    stop: StopTimesForm


class KeepSpares(_Call, frozen=True, kw_only=True, tag="keep_spares"):
    """No result."""

    count: int
    token: str


class ForgetName(_Call, frozen=True, kw_only=True, tag="disconnected"):
    """A component that was started by hand has exited."""

    instance: str


class PublisherIds(_Call, frozen=True, kw_only=True, tag="publisher_ids"):
    """The result is :class:`KnownIds`."""

    topic: str
    instance: str


class LingeringReaders(_Call, frozen=True, kw_only=True, tag="lingering_readers"):
    """The result is a number."""

    topic: str


class ListLogs(_Call, frozen=True, kw_only=True, tag="list_logs"):
    """The result is the length of each log, by its file's name (bytes)."""


class ReadLog(_Call, frozen=True, kw_only=True, tag="read_log"):
    """Read a log from the byte ``begin`` on, at most ``longest`` bytes; the result is :class:`LogPiece`."""

    file: str
    begin: int
    longest: int


class ReadClock(_Call, frozen=True, kw_only=True, tag="read_clock"):
    """The result is the system clock (unix ns)."""


HostCall: TypeAlias = (
    Start
    | Describe
    | Adopt
    | End
    | EndOrphans
    | KeepSpares
    | ForgetName
    | PublisherIds
    | LingeringReaders
    | ListLogs
    | ReadLog
    | ReadClock
)

# What changes nothing on the host.
READING: Final = (Describe, ListLogs, ReadLog, ReadClock)
