"""Which instance of a role answers requests to its node's services: the manager's part.

The components do it among themselves (:mod:`midstride.node.control.service_answering`); the manager says when.
"""

from __future__ import annotations

from midstride.errors import CallTimeout
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.commands import AnswerCommand


async def have_answer(client: ComponentClient, instance: str, instead_of: str | None = None) -> None:
    """Have ``instance`` answer requests, unless it reports that it does. Raises MidstrideError.

    ``instead_of`` is the running instance that has answered until now; None if there is none.
    """
    latest = client.life.latest(instance)
    if latest is not None and latest.state.answers:
        return
    if latest is not None and client.life.responsive(instance) is None:
        raise CallTimeout(f"{instance} reports nothing")  # what waits for it would only be late
    address = None if instead_of is None else client.address(instead_of)
    await client.change(instance, AnswerCommand(peer=instead_of or "", address=address))
