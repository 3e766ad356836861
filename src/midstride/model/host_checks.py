"""The rules of hosts: how one is declared, and what may be where (docs/semantics.md sections 2 and 3)."""

from __future__ import annotations

from collections.abc import Iterator

from midstride.model.diagnostics import Problem, SubjectPath
from midstride.model.hosts import MANAGER, HostSpec, host_in_words, resource_key, word_of_host
from midstride.model.specification import Node, Specification


def host_rules(specification: Specification) -> Iterator[Problem]:
    """Hosts that cannot be reached as they are declared (E018), and what is where it cannot be (E019)."""
    for name, host in sorted(specification.hosts.items()):
        yield from _declaration(host, ("hosts", name))
    for key, resource in sorted(specification.resources.items()):
        if key != resource.key:
            message = f"resource `{key}` is said to belong to {host_in_words(resource.host)}"
            yield Problem("E019", ("resources", key), message, f"its key is `{resource.key}`")
    for role, node in sorted(specification.nodes.items()):
        yield from placement_problems(specification, node, ("nodes", role))


def placement_problems(specification: Specification, node: Node, path: SubjectPath) -> Iterator[Problem]:
    """A node that its container, or a resource that it holds, has no place for on its host (E019)."""
    if node.host and node.host not in specification.hosts:
        return  # an unknown name
    where, word = (*path, "host"), word_of_host(node.host)
    container = None if node.container is None else specification.containers.get(node.container)
    if container is not None and container.host != node.host:
        message = (
            f"{node.role} is on {host_in_words(node.host)}, and its container {node.container} is on "
            f"{host_in_words(container.host)}: a container loads nodes on its own host alone"
        )
        help = f"write `on {word_of_host(container.host)}`, or name a container that is on {host_in_words(node.host)}"
        yield Problem("E019", where, message, help)
    component = specification.components.get(node.component)
    for resource in () if component is None else sorted(component.resource_usage):
        if resource_key(resource, node.host) in specification.resources:
            continue
        others = sorted(each.host for each in specification.resources.values() if each.name == resource)
        if not others:
            continue  # an unknown name
        has = " and ".join(host_in_words(other) for other in others)
        message = (
            f"{node.role} is on {host_in_words(node.host)} and holds {resource}, which only {has} "
            f"{'have' if len(others) > 1 else 'has'}: a process cannot use the resources of another host"
        )
        declare = f"`resource {resource}{f' on {word}' if node.host else ''}`"
        choice = " or ".join(f"`on {word_of_host(other)}`" for other in others)
        yield Problem("E019", where, message, f"declare {declare}, or put the node {choice}")


def _declaration(host: HostSpec, path: SubjectPath) -> Iterator[Problem]:
    if host.name == MANAGER:
        message = f"`{MANAGER}` is the host of the manager, which has no declaration"
        yield Problem("E018", path, message, "use another name")
    if host.ssh.startswith("-") or not host.ssh.isprintable() or len(host.ssh.split()) != 1 or " " in host.ssh:
        message = f"`{host.ssh}` is no destination of `ssh`"
        help = 'write it as `ssh "robot@arm"`; options belong in ~/.ssh/config, under a name of their own'
        yield Problem("E018", (*path, "ssh"), message, help)
    for word, value in (("setup", host.setup), ("folder", host.folder)):
        if value is not None and not (value.startswith("/") and value.isprintable()):
            message = f"`{value}` is no absolute path on {host_in_words(host.name)}"
            yield Problem("E018", (*path, word), message, f'write the whole path: `{word} "/opt/robot/…"`')
