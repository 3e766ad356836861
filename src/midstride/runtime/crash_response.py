"""What becomes true by itself, and what has to follow from it.

A crash is an unplanned removal, and a component that could not go on has lowered itself: the model is brought to what
is true, and exactly those that `best` of what is left asks for are lowered. Raising again is a plan's affair.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from midstride.model.best import lowered
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration


def settled(
    configuration: Configuration,
    gone: Iterable[str],
    worse: Mapping[FunctionalityRef, int],
    owing: Iterable[FunctionalityRef] = (),
) -> tuple[Configuration, dict[FunctionalityRef, int]]:
    """The configuration without the instances in ``gone`` and with the modes in ``worse``, and what else to lower.

    ``owing`` are those that were to be lowered before, and could not be.
    """
    touched: set[FunctionalityRef] = set(owing)
    for name in gone:
        for port, connector in configuration.attached_ports(name):
            if configuration.is_output(port):
                touched.update(configuration.consumers(connector))
        configuration = configuration.without_instance(name)
    for ref in worse:
        for output in configuration.functionality(ref).outputs:
            for connector in configuration.attached_to(PortRef(ref.instance, output)):
                touched.update(configuration.consumers(connector))
    configuration = configuration.with_modes(worse)
    return configuration, lowered(configuration, [ref for ref in touched if ref.instance in configuration.instances])
