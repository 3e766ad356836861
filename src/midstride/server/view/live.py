"""The live view of one manager: built from what components push, and only where something has changed.

A report only marks its component. What is marked is built a moment later, all at once, for all clients together. While
there is no client, measurements are left as they are: only what the timeline needs is built.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import operator
import secrets
import time
from collections.abc import Callable, Container, Iterable, Iterator

from msgspec import UNSET, structs

from midstride.codec.writing import to_json
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator, violations
from midstride.runtime.backend_protocol import OtherNodes
from midstride.runtime.process.component_client import ComponentEvent
from midstride.runtime.records.events import Wakers
from midstride.runtime.records.reports import Event
from midstride.runtime.records.status_forms import InstanceStatus, RunningCommand, SilenceFault, Status
from midstride.runtime.view.condition import condition
from midstride.runtime.view.instance_status import EntryShape, instance_status, is_sound, port_statuses
from midstride.runtime.view.status import system_values, topic_status
from midstride.runtime.view.watched_system import Baseline
from midstride.server.manager_lifecycle import Lifecycle
from midstride.server.view.change_views import ChangeTracker
from midstride.server.view.changed_parts import changed_parts
from midstride.server.view.noticeable_changes import (
    entries_differ_in_measurements_only,
    rates_met_as_shown,
    reports_differ_in_measurements_only,
    same_parameters_and_reasons,
)
from midstride.server.view.table import PartKey, ViewTable, encode_view
from midstride.server.view.timing import LOOK, MEASURED_EVERY, SOON, TOGETHER, Alarm, measurements_interval
from midstride.server.view.view_forms import VERSION, SystemView, Timeline
from midstride.server.view.view_history import ModeHistory, ViewRecording
from midstride.wire.state import ComponentState


class LiveView:
    """Kept up to date from :meth:`start` to :meth:`close`. Used on the manager's loop alone.

    ``manager`` identifies this run of the manager, ``now`` gives the UNIX time.
    """

    def __init__(self, lifecycle: Lifecycle, *, now: Callable[[], float] = time.time) -> None:
        self.manager = secrets.token_hex(8)
        self.table = ViewTable()
        self.lifecycle = lifecycle
        self._watched = watched = lifecycle.manager.watched
        self.now = now
        self._changes = ChangeTracker()
        self._recording = ViewRecording()
        self._modes = ModeHistory()
        self._wakers = Wakers()
        self._shapes: dict[str, EntryShape] = {}
        self._shown: dict[str, InstanceStatus] = {}
        self._reported: dict[str, ComponentState] = {}  # what the entries were built from
        self._others: dict[str, OtherNodes] = {}  # the other nodes of their processes, as of the last look
        self._unsound: set[str] = set()  # the components that are not as modelled
        self._dirty: set[str] = set()  # to be built
        self._measured: set[str] = set()  # those of which only measurements may have changed
        self._revalued: set[str] = set()  # those of which only measurements, parameters and reasons have
        self._configuration = Configuration()
        self._baseline: Baseline | None = None
        self._violations: list[str] = []
        self._silences: list[SilenceFault] | None = None  # None: to be looked for
        self._tick = Alarm(watched.clock, lambda: self.refresh(measurements=bool(self._wakers)))
        self._looking = Alarm(watched.clock, self._look)
        self._waking = Alarm(watched.clock, self._wakers.wake)
        self._alarms = (self._tick, self._looking, self._waking)
        self._refreshed_at = -math.inf  # when the view was last built (steady s)
        self._revalued_at = -math.inf  # the same with parameters and reasons
        self._measurements_at = 0.0  # the same with measurements
        self._interval = MEASURED_EVERY  # how often that is (s)
        self._measurements_of: dict[str, float] = {}  # the same by component
        self._rated_at: dict[str, float] = {}  # when it was last looked whether it keeps its rates, by component
        self._started = False
        watched.client.listeners.append(self.on_component_event)
        watched.events.listeners.append(self._on_event)
        lifecycle.on_phase = self._soon

    # -- what happens --------------------------------------------------------------------------------

    def start(self) -> None:
        """From now on the view is kept up to date. Needs a running loop."""
        if not self._started:
            self._started = True
            for alarm in self._alarms:
                alarm.start()
            self.refresh(measurements=True)
            self._look()

    def close(self) -> None:
        self._started = False
        for alarm in self._alarms:
            alarm.stop()
        self._wakers.wake()

    def on_component_event(self, event: ComponentEvent) -> None:
        name, now = event.instance, self._watched.clock.steady()
        if not isinstance(event, ComponentState) or not self._may_wait(event):
            self._dirty.add(name)
            self._soon()
        elif not self._as_measured(event, now) or not same_parameters_and_reasons(self._reported.get(name), event):
            self._revalued.add(name)
            self._tick.at(max(now + SOON, self._revalued_at + self._interval))
        else:
            self._measured.add(name)
            if self._wakers:
                self._tick.at(max(now + SOON, self._measurements_at + self._interval))

    def _may_wait(self, state: ComponentState) -> bool:
        """Return whether a report differs from the entry of its component in measurements and values at most."""
        shown = self._shown.get(state.instance)
        return (
            shown is not None
            and shown.reachable
            and reports_differ_in_measurements_only(self._reported.get(state.instance), state)
        )

    def _as_measured(self, state: ComponentState, now: float) -> bool:
        """Return whether declared rates are met as the entry says; judged as often as measurements are refreshed."""
        name = state.instance
        if now - self._rated_at.get(name, -math.inf) < self._interval:
            return True
        self._rated_at[name] = now
        return rates_met_as_shown(self._shown[name], state, self._configuration.context)

    def _on_event(self, event: Event) -> None:
        self._changes.on_event(event)
        if event.kind in {"silence", "silence_ended", "note"}:
            self._silences = None
        self._soon()
        if self._wakers:  # the event is sent even if the view has just been built
            self._waking.at(self._watched.clock.steady() + TOGETHER)

    def _soon(self) -> None:
        self._tick.at(max(self._watched.clock.steady() + TOGETHER, self._refreshed_at + SOON))

    def _look(self) -> None:
        """Find what no report shows."""
        silent = {name for name, each in self._shown.items() if self._differs(each)}
        others, self._others = self._others, self._watched.system.other_nodes
        moved = {name for name in self._shown if others.get(name) != self._others.get(name)}
        if silent or moved or self._wakers:
            self._dirty |= silent | moved
            self._silences = None
            self.refresh(measurements=bool(self._wakers))
        self._looking.at(self._watched.clock.steady() + LOOK)

    def _differs(self, shown: InstanceStatus) -> bool:
        """Return whether it is now otherwise whether an instance answers, or its host can be reached."""
        silent = self._watched.system.life.responsive(shown.name) is None
        configuration = self._watched.system.configuration
        lost = silent and shown.name in configuration.instances
        lost = lost and self._watched.monitor.is_unreachable(shown.name, configuration)
        return (shown.reachable, shown.unreachable) != (not silent, lost)

    # -- the view ------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def client(self) -> Iterator[asyncio.Event]:
        """One more client while the context is open: its event is set whenever the view or the log has changed."""
        self.refresh(measurements=True)  # they were left as they are while there was none
        with self._wakers.client() as waker:
            yield waker

    def document(self) -> bytes:
        """The whole view as it is now, as JSON."""
        return encode_view(VERSION, self.manager, self.table.n, self.table.at, self.table.parts())

    def view(self, status: Status) -> SystemView:
        """The whole view, where ``status`` is the one now: of what is measured it says more than the stream."""
        self.refresh(measurements=False)
        return SystemView(
            **structs.asdict(status),
            version=VERSION,
            manager=self.manager,
            n=self.table.n,
            at=self.table.at,
            phase=self.lifecycle.phase,
            change=self._changes.current,
        )

    def document_at(self, at: float) -> bytes | None:
        """The view as it was at ``at`` (UNIX time); None for a time before the oldest that is known."""
        past = self._recording.view_at(at)
        return None if past is None else encode_view(VERSION, self.manager, past.n, past.at, past.parts)

    def timeline(self, since: float, until: float) -> Timeline:
        """The events between two times (UNIX time), as far as it is remembered."""
        events = self._watched.events.since()
        return Timeline(
            manager=self.manager,
            since=since,
            until=until,
            oldest=self.oldest,
            modes=self._modes.between(since, until),
            changes=list(self._changes.between(since, until)),
            events=[event for event in events if since <= event.at <= until],
        )

    @property
    def oldest(self) -> float:
        """The earliest time of which the view is known (UNIX time)."""
        return self.now() if self._recording.oldest is None else self._recording.oldest

    def refresh(self, *, measurements: bool) -> None:
        """Build what has changed, also ``measurements`` if that is all that has; then clients are woken."""
        now, steady = self.now(), self._watched.clock.steady()
        self._refreshed_at = steady
        due = measurements and steady - self._measurements_at >= self._interval
        if due:
            self._measurements_at = steady
        if self._revalued and (due or steady - self._revalued_at >= self._interval):
            self._revalued_at = steady
            self._dirty |= self._revalued
            self._revalued = set()
        minor: set[PartKey] = set()
        changes: dict[PartKey, bytes | None] = dict(self._built(now, due, minor))
        changes.update(self._single())
        changed = self.table.update(changes, now)
        lasting = {part: json for part, json in changed.items() if part not in minor}
        if lasting:
            self._recording.record(self.table.n, now, lasting)
        if changed:
            self._wakers.wake()

    def _built(self, now: float, measurements: bool, minor: set[PartKey]) -> Iterator[tuple[PartKey, bytes | None]]:
        """The entries that may have changed; ``minor`` are those of which nothing but measurements has."""
        system = self._watched.system
        configuration, before = system.configuration, self._configuration
        if self._baseline is not (baseline := self._watched.baseline()):
            self._baseline = baseline
            self._dirty.update(configuration.instances)
        if configuration is not before:
            instances, connectors = changed_parts(before, configuration)
            self._dirty |= instances
            if before.context is not configuration.context:
                self._shapes.clear()
            for name in instances:
                self._shapes.pop(name, None)
            self._configuration = configuration
            self._interval = measurements_interval(len(configuration.instances))
            self._violations = [str(violation) for violation in violations(configuration)]
            evaluator = Evaluator(configuration)
            for name in sorted(connectors):
                known = name in configuration.context.connectors
                yield ("topics", name), to_json(topic_status(configuration, evaluator, name)) if known else None
        names = self._dirty | self._measured if measurements else self._dirty
        dirty, self._dirty = self._dirty, set()
        self._measured = set() if measurements else self._measured - names
        yield from self._instances(names, dirty, configuration, now, minor)

    def _instances(
        self,
        names: Iterable[str],
        dirty: Container[str],
        configuration: Configuration,
        now: float,
        minor: set[PartKey],
    ) -> Iterator[tuple[PartKey, bytes | None]]:
        """The entries of ``names``; of those that are not ``dirty``, nothing but measurements has changed."""
        client, steady = self._watched.client, self._watched.clock.steady()
        for name in sorted(names):
            part, shown = ("instances", name), self._shown.get(name)
            instance, latest = configuration.instances.get(name), client.life.latest(name)
            if latest is None or instance is None:
                self._reported.pop(name, None)
            else:
                self._reported[name] = latest.state
            if instance is None:
                self._shapes.pop(name, None)
                self._measurements_of.pop(name, None)
                self._rated_at.pop(name, None)
                self._unsound.discard(name)
                if self._shown.pop(name, None) is not None:
                    self._modes.gone(name, now)
                    yield part, None
                continue
            shape, before = self._shapes.get(name), () if shown is None else shown.ports
            if shape is None:
                shape, before = self._shapes.setdefault(name, EntryShape.of(configuration, instance)), ()
            refresh = steady - self._measurements_of.get(name, -math.inf) >= self._interval
            if refresh:
                self._measurements_of[name] = steady
            ports = port_statuses(shape, client.life.responsive(name), before, refresh=refresh)
            if before and name not in dirty and all(map(operator.is_, ports, before)):
                continue
            view = instance_status(self._watched, shape, now, shown, ports)
            self._shown[name] = view
            if shown is not None and entries_differ_in_measurements_only(shown, view):
                minor.add(part)
            else:
                self._modes.shown(view, now)
                (self._unsound.discard if is_sound(view) else self._unsound.add)(name)
            yield part, to_json(view)

    def _single(self) -> Iterator[tuple[PartKey, bytes]]:
        """The parts that are one value."""
        watched, running = self._watched, self._watched.commands.current
        if self._silences is None:
            faults = watched.monitor.faults(self._configuration)
            self._silences = [structs.replace(each, seconds=UNSET) for each in faults]
        silences = [each for each in self._silences if each.instance in self._configuration.instances]
        system = system_values(watched)
        values = {
            **system,
            "condition": condition(watched, self._shown.values(), system["crashed"], silences, self._violations),
            "phase": self.lifecycle.phase,
            "running": None if running is None else RunningCommand(running),
            "valid": not (self._violations or silences or self._unsound),
            "violations": self._violations,
            "silences": silences,
            "change": self._changes.current,
        }
        for field, value in values.items():
            yield (field, ""), to_json(value)
