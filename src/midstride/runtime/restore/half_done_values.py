"""The parameter values of an instance that an earlier manager had left half done, for the one that goes on.

They are carried over as at the end of a change, by what a change uses (docs/protocols/recovery.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from immutables import Map

from midstride.codec.parameter import from_json
from midstride.errors import MidstrideError
from midstride.model.component import ParameterValue, same_value
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.runtime_values import RuntimeValue, Values
from midstride.runtime.change.parameter_transfer import ParameterTransfer
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.journal_records import Interrupted
from midstride.runtime.watch.reported_values import ReportedValues
from midstride.wire.state import ComponentState

_NO_VALUES: Final[Values] = Map()


@dataclass(frozen=True, slots=True)
class HalfDoneValues:
    """The values that were set in a system that ran ``specification`` when its manager ended.

    ``interrupted``: the changes that were then under way. ``carried``: by instance, the values when these had last
    carried them over.
    """

    client: ComponentClient
    reported: ReportedValues
    carried: Mapping[str, Values]
    specification: Specification
    interrupted: Sequence[Interrupted] = ()

    def between(self, ended: Instance, stays: Instance) -> ValuesOfEnded:
        """Return the values of ``ended``, for ``stays``, which has the same role."""
        specification, known = self.specification, {ended.name: _NO_VALUES, **self.carried}
        created = next((change for change in self.interrupted if ended.name in change.created), None)
        if created is not None:
            change, as_started = _replacement(stays, ended, specification, created.target), _NO_VALUES
        else:
            targets = [each.target for each in self.interrupted if stays.name in each.created]
            change = _replacement(ended, stays, specification, targets[-1] if targets else specification)
            as_started = known[ended.name]
        carried = {stays.name: as_started, **known}
        transfer = ParameterTransfer(self.client, self.reported, change, (), keep=True, carried=carried)
        return ValuesOfEnded(transfer, ended, stays, known[ended.name])


def _replacement(old: Instance, new: Instance, before: Specification, after: Specification) -> Change:
    """The replacement of ``old`` alone; ``after`` is that of a change that may have removed the role meanwhile."""
    target = after if new.role in after.nodes else before
    start = Configuration(context=before.context, instances=Map({old.name: old}))
    end = Configuration(context=target.context, instances=Map({new.name: new}))
    return Change(before, target, start, start, start, end, (old.name,), (new,), replaced=Map({old.name: new.name}))


@dataclass(frozen=True, slots=True)
class ValuesOfEnded:
    """The values of ``ended``, which is about to end, for ``stays``.

    ``carried``: those that a change had carried over.
    """

    transfer: ParameterTransfer
    ended: Instance
    stays: Instance
    carried: Values

    async def carry_over(self) -> None:
        """To be called right before and after it ends: set on ``stays`` what was set on it last."""
        both = Map({each.name: each for each in (self.ended, self.stays)})
        with suppress(MidstrideError):  # what is lost then is said as it has ended
            await self.transfer.leaving(self.ended.name, Configuration(instances=both))

    async def lost(self, last: ComponentState) -> dict[str, ParameterValue]:
        """Return the values of its ``last`` report that ``stays`` does not have, and :meth:`fates` does not name."""
        has: dict[str, ParameterValue] = {}
        with suppress(MidstrideError):
            stays = await self.transfer.client.peek(self.stays.name)
            has = {name: from_json(value) for name, value in stays.parameters.items()}
        known = (self.carried, has)
        said = {each.parameter for each in self._found}
        return {
            name: value
            for name, value in sorted(last.set_values().items())
            if name not in said and not any(name in values and same_value(values[name], value) for values in known)
        }

    @property
    def _found(self) -> list[RuntimeValue]:
        return self.transfer.report(done=True)

    def fates(self) -> list[str]:
        """Say what has become of each value that was carried over, or could not be."""
        return [each.words for each in self._found]
