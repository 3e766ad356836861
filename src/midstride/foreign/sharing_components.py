"""Components with Midstride's API that share the requests to their services with a node that has the library.

Each has the part of one more node in the page (:mod:`midstride.node.shared_requests`).
"""

from __future__ import annotations

from collections.abc import Iterator

from midstride.errors import BackendError
from midstride.foreign.page import Page
from midstride.foreign.page_layout import HAS_AGENT, NAME, NOTED
from midstride.wire.replies import PagePlace


def share_requests(page: Page, instance: str, of: int | None = None) -> int:
    """Return the index of the part of the component ``instance``, which is set aside where it has none.

    It shares the requests with the node ``of`` (index), which answers them; without that, with one to come, and the
    component answers. Raises BackendError, also where the node ``of`` has ended: its part of the page has been taken
    back, and what it had claimed is not known any more.
    """
    nodes = page.layout.nodes
    if of is not None and not nodes[of].requests:
        raise BackendError("it has ended, so nothing tells which requests it had taken")
    for index in _parts(page, instance):
        if not page.is_dead(index) and (of is None or nodes[index].requests == nodes[of].requests):
            return index
    index = page.allocate(instance)
    page.have_requests(index, of)
    page.mix_requests(index)
    return index


def place(page: Page, index: int) -> PagePlace:
    """Return where the component joins whose part is ``index``."""
    return PagePlace(page=str(page.path.absolute()), library=str(page.library_path), index=index)


def has_joined(page: Page, index: int) -> bool:
    """Return whether the node ``index`` shares its requests, or is none that a component joins."""
    return bool(page.layout.nodes[index].used & (HAS_AGENT | NOTED) != HAS_AGENT)


def forget_component(page: Page, instance: str) -> None:
    """The component ``instance`` has ended: it shares no requests any more."""
    for index in list(_parts(page, instance)):
        page.free(index)


def _parts(page: Page, instance: str) -> Iterator[int]:
    name = instance.encode()[: NAME - 1]
    return (index for index, each in enumerate(page.layout.nodes) if each.used & HAS_AGENT and each.instance == name)
