"""Carries the parameter values that were set at run time from an instance to the one that replaces it.

A new instance is started with them, and its own callbacks must then accept them. The two are compared again right
before the cut and when the old one ends: any ROS tool may set a parameter meanwhile (docs/protocols/state.md). The next
manager does the latter where one dies in between (docs/protocols/recovery.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from immutables import Map

from midstride.codec.parameter import from_json, json_values
from midstride.errors import CommandRefused, MidstrideError, PlanRefused, StepFailed
from midstride.model.component import ROS_PARAMETERS, ParameterValue, same_value
from midstride.model.configuration import Configuration, Instance
from midstride.plan.change import Change
from midstride.plan.runtime_values import (
    Origin,
    RuntimeValue,
    Values,
    decide,
    left_behind,
    runtime_value,
    setting,
    with_times,
)
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.watch.reported_values import ReportedValues
from midstride.verdicts.assessment import seconds_in_words
from midstride.wire.commands import SetParametersCommand
from midstride.wire.state import ComponentState


def unread_parameters(instance: Instance, state: ComponentState | None) -> str | None:
    """The reason why what was set on ``instance`` at run time is unknown; None where it is known, or no matter."""
    if state is None or not state.unread_parameters:
        return None
    when = "since it last said its parameters" if state.parameters else "while it ran"
    why = "its parameter services do not answer"
    return f"whether parameters of {instance.name} were set {when} is not known, since {why}; what was set is lost"


_NONE: Final[Mapping[str, Origin]] = Map()
_NO_VALUES: Final[Values] = Map()
# What a change reports of values also where it was rolled back.
_OF_A_ROLLED_BACK_CHANGE: Final = ("late", "set_back", "not_set", "not_set_back")


@dataclass
class ParameterTransfer:
    """For one change. ``planned``: what the plan says becomes of each value; without ``keep``, none travels.

    ``carried``: by instance, the values when they were last carried over; ``save`` is called with these when they have
    changed, for the next manager.
    """

    client: ComponentClient
    reported: ReportedValues
    change: Change
    planned: tuple[RuntimeValue, ...]
    keep: bool
    save: Callable[[Mapping[str, Values]], object] = lambda carried: None
    carried: dict[str, Values] = field(default_factory=dict)
    # By new instance, that it is not known what was set on the one that it replaces.
    unknown: dict[str, str] = field(init=False)
    _found: dict[tuple[str, str], RuntimeValue] = field(default_factory=dict)
    # By instance: the values that it was started with.
    _given: dict[str, dict[str, Any]] = field(default_factory=dict)
    _origins: dict[str, Mapping[str, Origin]] = field(default_factory=dict)  # of these, the unknown ones

    def __post_init__(self) -> None:
        replaced, stand_ins = self.change.replaced, self.change.stand_ins
        self._predecessors = {new: old for old, new in replaced.items()}
        for name in stand_ins:  # it may lack what the one that it stands in for has
            if name in replaced:
                self._predecessors[replaced[name]] = self._predecessors[name]
        self._record(*self.planned)
        self.unknown = {}
        for old, new in replaced.items():
            latest = self.client.life.latest(old)
            if (
                words := unread_parameters(self.change.instance(old), None if latest is None else latest.state)
            ) is not None:
                self.unknown[new] = words

    def report(self, done: bool) -> list[RuntimeValue]:
        """Report what became of each value. Unless the change is ``done``, only of those that are lost nevertheless."""
        found = [self._found[key] for key in sorted(self._found)]
        return found if done else [value for value in found if value.fate in _OF_A_ROLLED_BACK_CHANGE]

    def _record(self, *values: RuntimeValue) -> None:
        self._found |= {(value.node, value.parameter): value for value in with_times(values, self._set_at)}

    def _set_at(self, role: str) -> Mapping[str, float]:
        """Return when requests set the parameters of the instance of ``role`` that is replaced (Unix time, s)."""
        replaced = (old for old in self.change.replaced if self.change.instance(old).role == role)
        return next((self.reported.set_at(old) for old in replaced), {})

    # -- a new instance ----------------------------------------------------------------------------

    async def ask(self, instance: Instance) -> None:
        """Have the predecessor of ``instance`` say its values, if it does not report them at once."""
        old = self._predecessors.get(instance.name)
        if old is not None and self.change.component_of(old).gate is not None:
            await self._observe(old)

    def start_values(self, instance: Instance) -> dict[str, Any]:
        """The values that ``instance`` starts with instead of the declared ones.

        Raises StepFailed where one does not fit its declaration.
        """
        if self._returns(instance):
            return dict(self.reported.of(instance.name))
        old = self._predecessors.get(instance.name)
        values = self.reported.saved.get(instance.role, {}) if old is None else self.reported.of(old)
        self._origins[instance.name] = unknown = self._unknown(instance, values)
        if old is not None:
            self._note_carried(old)
        self._given[instance.name] = given = self._kept(instance, values, unknown)
        # rcl reads an empty list in a parameter file as no value: it is set once the instance has started.
        return {name: value for name, value in given.items() if value not in ([], ())}

    def _unknown(self, instance: Instance, values: Collection[str]) -> Mapping[str, Origin]:
        """Of the ``values`` that ``instance`` starts with, those of unknown origin; of an earlier manager's, all."""
        if (old := self._predecessors.get(instance.name)) is not None:
            return self.reported.unknown_of(old)
        if instance.component.gate is None:
            return {}
        unknown = self.reported.unknown_after(instance.role)
        return dict.fromkeys(values, "unknown") if unknown is None else unknown

    def _returns(self, instance: Instance) -> bool:
        """Return whether the instance ran at the start: it is started again, or goes on, in a roll-back."""
        return instance.name in self.change.start.instances

    def _kept(self, instance: Instance, values: Values, unknown: Mapping[str, Origin] = _NONE) -> dict[str, Any]:
        """The ``values`` of its predecessor that ``instance`` is to have; what becomes of each is recorded."""
        before, after = self.change.specification, self.change.target
        if instance.role not in before.nodes:
            return {}
        try:
            decided = decide(before, after, instance.role, values, keep=self.keep, unknown=unknown)
        except PlanRefused as error:
            raise StepFailed(str(error)) from error
        self._record(*decided)
        return {value.parameter: from_json(value.value) for value in decided if value.fate == "kept"}

    async def started(self, instance: Instance) -> None:
        """Have a new instance accept the values that it was started with. Raises StepFailed with its reason."""
        old, given = self._predecessors.get(instance.name), self._given.get(instance.name, {})
        now = given if old is None else self.reported.of(old)
        unknown = self._origins.get(instance.name, _NONE) if old is None else self.reported.unknown_of(old)
        for name, value in given.items():
            if name in now and same_value(now[name], value):
                await self._set(instance, name, value, unknown)
        if old is not None:
            await self._compare(old, instance)
        self._note_carried(instance.name)

    def _note_carried(self, *instances: str) -> None:
        """Note that the values of these instances, as they are now, have been carried over."""
        self.carried |= {name: self.reported.of(name) for name in instances}
        self.save(self.carried)

    async def _observe(self, instance: str) -> None:
        """Request the values of an instance that answers; of any other, those that it last reported count."""
        if self.client.life.responsive(instance) is not None:
            with suppress(MidstrideError):
                self.reported.report(await self.client.peek(instance))

    async def _set(
        self, instance: Instance, name: str, value: ParameterValue, unknown: Mapping[str, Origin] = _NONE
    ) -> None:
        """One value, so that a refusal is about it. Raises StepFailed, or BackendError.

        That the new one refuses what the old node itself may have set (``unknown``) is no failure. One that does not
        say which parameters it has was started with the value.
        """
        origin = unknown.get(name, "set")
        state = await self.client.peek(instance.name)
        if state.unread_parameters and name in self._given.get(instance.name, {}):
            return
        if name not in ROS_PARAMETERS and name not in state.parameters and not state.unread_parameters:
            if instance.name in self.change.stand_ins:
                return
            self._record(left_behind(instance.role, name, value, instance.component.name, origin))
            return
        command = SetParametersCommand(
            parameters=json_values({name: value}), declared={}, unknown_origin=[] if origin == "set" else [name]
        )
        try:
            await self.client.change(instance.name, command)
        except CommandRefused as error:
            if origin == "set":
                raise StepFailed(f"{name} = {value!r}, set at run time: {error}") from error
            self._record(runtime_value(instance.role, name, value, "refused", f"not kept: {error}", origin))
            return
        decided = self._found.get((instance.role, name))
        if decided is not None and decided.fate == "kept":  # a plan does not know yet what a program declares
            self._record(runtime_value(instance.role, name, value, "kept", "kept", decided.origin))

    # -- what is set later -------------------------------------------------------------------------

    async def before_cut(self, old: str, new: Instance) -> None:
        """Set on ``new`` what was set on ``old`` meanwhile, if it replaces that.

        Raises StepFailed where ``new`` refuses it.
        """
        if self._predecessors.get(new.name) == old:
            await self._observe(old)
            await self._compare(old, new)

    def set_in_place(self, instance: Instance, values: Values) -> None:
        """The specification's values have taken the place of ``values``, which were set at run time."""
        self._kept(instance, values)

    # -- what the change itself sets ---------------------------------------------------------------

    def was_set(self, instance: Instance, values: Values, before: Values) -> None:
        """Note that the node has accepted the ``values``, which are set at run time."""
        self._record(
            *(setting(instance.role, name, values[name], "set", f"set; it was {before[name]!r}") for name in values)
        )

    def not_set(self, instance: Instance, values: Values, because: str) -> None:
        """Note that the node has not accepted the ``values``."""
        self._record(*(setting(instance.role, name, values[name], "not_set", f"not set: {because}") for name in values))

    def set_back(self, instance: Instance, values: Values, before: Values, seconds: float) -> None:
        """Note that the node had the ``values`` for at most so long (s), and has those ``before`` again."""
        for name, value in values.items():
            words = f"it had that for {seconds_in_words(seconds)} at most, and has {before[name]!r} again"
            self._record(setting(instance.role, name, value, "set_back", words, round(seconds, 6)))

    def not_set_back(self, instance: Instance, values: Values, because: str) -> None:
        """Note that the node has the ``values``, although the change is rolled back."""
        words = f"it has that still, as it could not be set back: {because}"
        self._record(*(setting(instance.role, name, values[name], "not_set_back", words) for name in values))

    async def leaving(self, name: str, configuration: Configuration) -> None:
        """To be called right before and after an instance ends: what was set on it last is set on its partner.

        The partner is its replacement, or in a roll-back the instance that it was to replace. It has taken over, so
        where it refuses a value, the report says so.
        """
        await self._observe(name)
        partner = self.change.replaced.get(name) or self._predecessors.get(name)
        if partner in configuration.instances and self.client.life.responsive(str(partner)) is not None:
            await self._compare(name, configuration.instances[str(partner)], late=True)

    def set_since(self, instance: str) -> dict[str, ParameterValue | None]:
        """Return the values set on ``instance`` since values were last carried over; None for one that was set back."""
        before, now = self.carried.get(instance, _NO_VALUES), self.reported.of(instance)
        changed: dict[str, ParameterValue | None] = {
            name: value for name, value in now.items() if name not in before or not same_value(before[name], value)
        }
        return changed | dict.fromkeys(before.keys() - now.keys())

    async def _compare(self, old: str, new: Instance, late: bool = False) -> None:
        """Set on ``new`` what has been set on ``old`` since.

        ``late``: ``new`` has taken over, so that what has been set on it since was set later.
        """
        if old not in self.carried or not (found := self.set_since(old)):
            return
        self.carried[old] = self.reported.of(old)
        state = await self.client.peek(new.name)
        if late and new.name in self.carried:
            self.reported.report(state)
            found = {name: value for name, value in found.items() if name not in self.set_since(new.name)}
        changed = {name: value for name, value in found.items() if value is not None}
        back = found.keys() - changed.keys()  # set back to the declared value: so is the new one's
        for name in found:
            self._found.pop((new.role, name), None)
        unknown = self.reported.unknown_of(old)
        if self._returns(new):  # what the one that was to replace it has set itself is for that one
            values = {name: value for name, value in changed.items() if unknown.get(name) != "node"}
        else:
            values = self._kept(new, changed, unknown)
        values |= {name: from_json(state.declared[name]) for name in back if name in state.declared}
        for name, value in values.items():
            if late and name in state.parameters and same_value(from_json(state.parameters[name]), value):
                continue
            try:
                await self._set(new, name, value, unknown)
            except MidstrideError as error:
                if not late:
                    raise
                words = f"too late, after the hand-over: {error}"
                origin = unknown.get(name, "set")
                self._record(runtime_value(new.role, name, value, "late", words, origin))
        self._note_carried(new.name)  # what was set on the old one meanwhile is carried over the next time
