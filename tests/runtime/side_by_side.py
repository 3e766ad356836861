"""Three counters, each with its own topic, that a change replaces side by side, and a bare reader of each topic."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.codec.specification_form import decode_specification
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.runtime.counting import _SINK, STRING, Reader, at_rates

T = TypeVar("T")

NODES = ("first", "second", "third")
RATE = 20


def program(before: str = "") -> str:
    """One that counts at RATE; ``before`` is put before its only write, where ``calls`` is a list for its use."""
    text = at_rates(out=RATE).replace("count = {", "calls = []\ncount = {")
    return text.replace("        output.write", f"        {before}\n        output.write") if before else text


def three(folder: Path, new: Mapping[str, str] = Map(), **timing: float) -> Specification:
    """The system, its programs in ``folder``; ``new``: the replacement of a node, where it is not as the old one."""
    (folder / "old.py").write_text(program())
    (folder / "sink.py").write_text(_SINK)
    contract = {"type": STRING, "rate": RATE}
    count = {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": contract}}, "degraded": {}}}
    hear = {"uses": ["in"], "modes": {"normal": {"assumes": ["in"]}, "degraded": {}}}
    components = {"Old": {"run": "python3 old.py", "outputs": ["out"], "functionalities": {"count_out": count}}}
    for node in NODES:
        (folder / f"{node}.py").write_text(new.get(node, program()))
        components[f"New{node}"] = {**components["Old"], "run": f"python3 {node}.py"}
    nodes = {node: {"component": "Old", "attachments": {"out": [f"/{node}"]}} for node in NODES}
    nodes["sink"] = {"component": "Sink", "attachments": {"in": [f"/{node}" for node in NODES]}}
    sink = {"run": "python3 sink.py", "inputs": {"in": {"type": STRING}}, "functionalities": {"hear": hear}}
    document = {
        "system": "three",
        "topics": {f"/{node}": contract for node in NODES},
        "components": {**components, "Sink": sink},
        "nodes": nodes,
    }
    return replace(decode_specification(document), timing=Map(timing))


def all_replaced(*nodes: str) -> PlanRequest:
    """Each of ``nodes`` by its new component; without any, all three."""
    return PlanRequest(replace=tuple((node, f"New{node}") for node in nodes or NODES))


def managed(
    folder: Path,
    specification: Specification,
    body: Callable[[Manager, Simulator, dict[str, Reader]], Awaitable[T]],
) -> T:
    """Bring the system up in virtual time, with a reader of each topic, run ``body``, and shut everything down."""
    simulator = Simulator()

    async def main() -> T:
        manager = Manager(specification, simulator, Workspace(folder / "workspace"), folder)
        await manager.up()
        readers = {node: Reader(simulator, f"/{node}") for node in NODES}
        await asyncio.sleep(0.3)
        try:
            return await body(manager, simulator, readers)
        finally:
            await manager.close()

    (folder / "workspace").mkdir(mode=0o700)
    return simulator.run(main())
