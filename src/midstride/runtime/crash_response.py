"""How the model follows crashes and unexpected degradations, and which functionalities to degrade because of them.

A crash is an unplanned removal. The model is updated to the actual state; then exactly the functionalities that are
lower in `best` of the remaining system are degraded. Upgrades are left to plans (docs/semantics.md section 7).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from midstride.model.best import lowered
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration


def respond(
    configuration: Configuration,
    crashed: Iterable[str],
    degraded: Mapping[FunctionalityRef, int],
    pending: Iterable[FunctionalityRef] = (),
) -> tuple[Configuration, dict[FunctionalityRef, int]]:
    """The configuration without ``crashed`` and with the modes in ``degraded``, and the modes to degrade others to.

    ``pending`` are functionalities that an earlier response could not degrade.
    """
    touched: set[FunctionalityRef] = set(pending)
    for name in crashed:
        for port, connector in configuration.attached_ports(name):
            if configuration.is_output(port):
                touched.update(configuration.consumers(connector))
        configuration = configuration.without_instance(name)
    for ref in degraded:
        for output in configuration.functionality(ref).outputs:
            for connector in configuration.attached_to(PortRef(ref.instance, output)):
                touched.update(configuration.consumers(connector))
    configuration = configuration.with_modes(degraded)
    return configuration, lowered(configuration, [ref for ref in touched if ref.instance in configuration.instances])
