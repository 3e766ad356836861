"""The parameters of live components that a change sets, sets back in its roll-back, and watches once all are set."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from midstride.codec.parameter import from_json, json_values
from midstride.errors import CommandRefused, MidstrideError
from midstride.model.action import SetParameters
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.change.settings_watch import Setting, SettingsWatch
from midstride.runtime.handover.probation import WATCHED_WINDOW
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.running_system import RunningSystem
from midstride.wire import replies
from midstride.wire.commands import SetParametersCommand


@dataclass(slots=True)
class ParameterSettings:
    """The actions of ``change`` that set parameters, carried out."""

    client: ComponentClient
    system: RunningSystem
    events: EventLog
    change: RunningChange
    _before: dict[str, replies.PreviousParameters] = field(default_factory=dict)  # by instance
    _settings: dict[str, Setting] = field(default_factory=dict)  # what is set, by instance

    async def put(self, action: SetParameters) -> None:
        """Set parameters of an instance: to the specification's values, or at run time."""
        name, at_run_time, transfer = action.instance, action.before is not None, self.change.parameters
        instance, values = self.system.configuration.instances[name], json_values(action.parameters)
        setting = Setting.begun(self.client, self.system, name, self.system.configuration)
        command = SetParametersCommand(parameters=values, declared={} if at_run_time else None)
        try:
            reply = await self.client.change(name, command)
        except MidstrideError as error:
            transfer.not_set(instance, action.parameters, str(error))
            if action.before is not None and not isinstance(error, CommandRefused):  # it may still be carried out
                await self.client.undo(name, setting.back(action.before))
            raise
        self._settings[name], self._before[name] = setting, reply
        if action.before is not None:
            transfer.was_set(instance, action.parameters, action.before)
        else:
            transfer.set_in_place(instance, {each: from_json(reply.before[each]) for each in reply.declared})

    async def put_back(self, action: SetParameters) -> None:
        """In a roll-back, restore the values before, also those that had been set at run time."""
        name, back = action.instance, action.parameters
        instance, setting = self.system.configuration.instances[name], self._settings.get(name)
        command = SetParametersCommand(parameters=json_values(back))
        before = self._before.get(name)
        if action.before is not None and setting is not None:
            command = setting.back(back)
        elif before is not None and before.declared:
            values = {each: before.before[each] for each in before.declared}
            declared = json_values(back)
            command = SetParametersCommand(
                parameters=json_values(declared | values), declared=json_values(declared | before.declared)
            )
        done = next(
            (
                each.parameters
                for each in self.change.actions
                if isinstance(each, SetParameters) and each.instance == name
            ),
            back,
        )
        self.client.forget_revision(name)  # it may have degraded by what was set
        try:
            await self.client.change(name, command)
        except MidstrideError as error:
            self.change.parameters.not_set_back(instance, done, str(error))
            raise
        if setting is not None:
            seconds = self.client.clock.steady() - setting.since
            restored = {each: from_json(value) for each, value in command.parameters.items()}
            self.change.parameters.set_back(instance, done, restored, seconds)

    def left_as_set(self, action: SetParameters) -> bool:
        """Return whether nothing is to be set back, as the instance has ended; the next one has the values before."""
        if not self.system.life.is_gone(action.instance):
            return False
        if (setting := self._settings.get(action.instance)) is not None:
            self.system.values.put_back(action.instance, setting.role, setting.values)
        return True

    @property
    def complete(self) -> bool:
        """Return whether the change has set all the parameters that it sets."""
        return self._settings.keys() >= {
            each.instance for each in self.change.actions if isinstance(each, SetParameters)
        }

    async def watch(self) -> None:
        """Watch what the instances do whose parameters were set. Raises BrokenBySetting."""
        timing = self.change.target.timing
        watch = SettingsWatch(self.client, self.system, self.events, self._settings)
        by_default = "watch_after" not in timing
        seconds, shortest = watch.by_default() if by_default else (timing["watch_after"], WATCHED_WINDOW)
        if seconds:
            await self.change.unless_hurried(asyncio.ensure_future(watch.run(seconds, shortest)), by_default)
