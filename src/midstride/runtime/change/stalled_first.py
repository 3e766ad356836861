"""The nodes that a change replaces before all others: their middleware has stopped discovering.

One that discovers no new endpoints would not hear a new publisher, and not be heard by a new subscriber. So it is
replaced before anything that it exchanges messages with (docs/protocols/faults.md).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

from midstride.model.configuration import Configuration
from midstride.model.specification import Order
from midstride.plan.request import PlanRequest


def with_stalled_first(
    request: PlanRequest, configuration: Configuration, stopped: Collection[str]
) -> tuple[PlanRequest, tuple[Order, ...], tuple[str, ...]]:
    """``request`` with the roles of ``stopped`` instances that it needs, the order, and why in words.

    Left out are those that the change does not touch, and those that no manager can start.
    """
    roles: list[str] = []
    orders: list[Order] = []
    for name in sorted(stopped):
        instance = configuration.instances.get(name)
        if instance is None or instance.component.run is None or instance.role in request.remove:
            continue
        partners = set(_partners(request, configuration, name)) - {instance.role}
        if request.to is None:
            partners &= set(request.roles())
        elif instance.role not in request.to.nodes:
            continue
        if partners:
            roles.append(instance.role)
            orders += [Order(instance.role, partner) for partner in sorted(partners)]
    also = tuple(role for role in roles if role not in request.replaced())
    words = tuple(f"{role} is replaced first: its middleware discovers no new endpoints" for role in roles)
    orders = [order for order in orders if order.then not in roles]
    return replace(request, restart=(*request.restart, *also)), tuple(orders), words


def _partners(request: PlanRequest, configuration: Configuration, name: str) -> Iterator[str]:
    """The roles that exchange messages with an instance, or that are to: with repetitions."""
    for port, connector in configuration.attached_ports(name):
        output = configuration.is_output(port)
        others = (configuration.subscribers_on if output else configuration.publishers_on)(connector)
        for other in others:
            yield configuration.instances[other.instance].role
        for node in request.add:
            if any(connector in connectors for connectors in node.attachments.values()):
                yield node.role
