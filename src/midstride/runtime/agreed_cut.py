"""The cut of a hand-over: the moment from which the new publisher publishes instead of the old one.

It is a slot of the old publisher's time grid, agreed in advance (docs/semantics.md section 7).
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from midstride.model.action import Swap
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.runtime.component_client import ComponentClient
from midstride.wire.commands import CutInCommand, CutOutCommand, CutSwap, GridCommand, Trigger

# The old side resumes if the new side has not reported its first write for this many periods,
RESUME_PERIODS: Final = 10
# but at least for this long (s), which is more than the jitter of a busy machine.
SHORTEST_RESUME: Final = 0.1
# The same if no rate defines a period (s).
RESUME_WITHOUT_RATE: Final = 2.0


@dataclass(slots=True)
class Cut:
    """One cut between two components, for the outputs of one functionality, which share a time grid."""

    old: str
    new: str
    swaps: list[Swap]
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    trigger: Trigger = "none"
    epoch: int | None = None
    period: float | None = None
    at: int = 0

    def resume_after(self, configuration: Configuration) -> float:
        """How long the old side waits for the new one's first write (s)."""
        period = self.period if self.period is not None else _declared_period(configuration, self)
        if period is None:
            return RESUME_WITHOUT_RATE
        # The old side then writes in its next slot, which may be a period later.
        return max((RESUME_PERIODS - 1) * period, SHORTEST_RESUME)


def topic_of(configuration: Configuration, connector: str) -> str:
    return configuration.context.connectors[connector].topic


async def agree_cuts(
    client: ComponentClient, configuration: Configuration, swaps: Iterable[Swap], lead: float
) -> list[Cut]:
    """One cut for the outputs of each old functionality, all at the first slot after one common moment."""
    groups: dict[tuple[str, str, str], Cut] = {}
    moment: int | None = None
    for swap in swaps:
        owner = configuration.component(swap.old.instance).owner(swap.old.port).name
        cut = groups.setdefault(
            (swap.old.instance, swap.new.instance, owner), Cut(swap.old.instance, swap.new.instance, [])
        )
        cut.swaps.append(swap)
        if len(cut.swaps) > 1:
            continue
        grid = await client.read(swap.old.instance, GridCommand(port=swap.old.port))
        cut.trigger, cut.epoch, cut.period = grid.trigger, grid.epoch, grid.period
        moment = max(moment or 0, grid.now)
    assert moment is not None
    moment += int(lead * 1e9)
    for cut in groups.values():
        cut.at = moment
        if cut.trigger == "rate" and cut.epoch is not None and cut.period:
            step = cut.period * 1e9
            cut.at = cut.epoch + round(math.ceil((moment - cut.epoch) / step) * step)
    return list(groups.values())


def _declared_period(configuration: Configuration, cut: Cut) -> float | None:
    """The longest of the periods that the cut's topics require; None where one states no rate."""
    rates = [configuration.context.connectors[swap.connector].guarantee.rate for swap in cut.swaps]
    rates = [
        rate or (g.rate if isinstance(g := configuration.guarantee(swap.old), Predicate) else None)
        for rate, swap in zip(rates, cut.swaps, strict=True)
    ]
    return None if any(rate is None for rate in rates) else max(1 / rate for rate in rates if rate)


def cut_out(configuration: Configuration, cut: Cut) -> CutOutCommand:
    return CutOutCommand(
        cut=cut.id,
        swaps=[CutSwap(port=swap.old.port, topic=topic_of(configuration, swap.connector)) for swap in cut.swaps],
        at=cut.at,
        resume_after=cut.resume_after(configuration),
    )


def cut_in(configuration: Configuration, cut: Cut, address: str) -> CutInCommand:
    # An output without a rate or a driving message is written once, so its last message is written again at the cut.
    latch = cut.trigger == "none"
    return CutInCommand(
        cut=cut.id,
        swaps=[
            CutSwap(port=swap.new.port, topic=topic_of(configuration, swap.connector), latch=latch)
            for swap in cut.swaps
        ],
        at=cut.at,
        epoch=cut.at if cut.trigger == "rate" else None,
        peer=cut.old,
        address=address,
    )
