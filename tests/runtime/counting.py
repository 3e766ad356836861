"""Systems whose state shows whether it moved exactly at the cut: components that count, and a bare reader.

A counter writes the next number, at a rate or for each message. Whoever replaces it must continue with the next one.
"""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

from midstride.backends.simulator import Simulator
from midstride.codec.specification_form import decode_specification
from midstride.model.contract import QoS
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace

T = TypeVar("T")

STRING = "std_msgs/msg/String"
# The parts of a counter's program; a test replaces some of them.
EXPORT = "return json.dumps(count).encode()"
IMPORT = "count.update(json.loads(state))"
_HEAD = """
import json, time
from midstride import Component
from std_msgs.msg import String

comp = Component("counter")
count = {{"out": 0, "log": 0}}

@comp.on_export_state
def export_state():
    {export}

@comp.on_import_state
def import_state(state):
    {import_}
"""
_AT_A_RATE = """
def driven(name, rate):
    output = comp.create_output(name, String, qos=200)
    def step():
        count[name] += 1
        output.write(String(data=f"{{count[name]}} {{comp.instance}}"))
    functionality = comp.create_functionality("count_" + name, outputs=[output])
    functionality.set_normal_mode(step, rate=rate, outputs=[output])
    functionality.set_degraded_mode(lambda: None)
"""
_FOR_MESSAGES = """
inlet = comp.create_input("in", String, qos=200)
output = comp.create_output("out", String, qos=200)

{kind} step(message):
    {before}
    count["out"] += 1
    output.write(String(data=f"{{count['out']}} {{comp.instance}} {{message.data}}"))

functionality = comp.create_functionality("count_out", inputs=[inlet], outputs=[output])
functionality.set_normal_mode(step, inputs=[inlet], outputs=[output], guarantees={{output: {rate}}})
functionality.set_degraded_mode(lambda: None)
"""
_SOURCE = """
from midstride import Component
from std_msgs.msg import String

comp = Component("source")
out = comp.create_output("out", String, qos=200)
ticks = [0]

def tick():
    ticks[0] += 1
    out.write(String(data="{prefix}" + str(ticks[0])))

talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(tick, rate={rate}, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
_SINK = """
from midstride import Component
from std_msgs.msg import String

comp = Component("sink")
inlet = comp.create_input("in", String)
hear = comp.create_functionality("hear", inputs=[inlet])
hear.set_normal_mode(lambda message: None, inputs=[inlet])
hear.set_degraded_mode(lambda: None)
comp.start()
"""


def at_rates(export: str = EXPORT, import_: str = IMPORT, more: str = "", **rates: float) -> str:
    """A program that counts on the outputs named in ``rates``; ``more`` is appended before it starts."""
    driven = "".join(f'driven("{name}", {rate})\n' for name, rate in rates.items())
    return _HEAD.format(export=export, import_=import_) + _AT_A_RATE.format() + driven + more + "\ncomp.start()\n"


def for_messages(rate: float, export: str = EXPORT, import_: str = IMPORT, pause: float | None = None) -> str:
    """A program that counts its messages, which come at ``rate``; with ``pause``, in async calls so long (s)."""
    before = "pass" if pause is None else f"await comp.clock.sleep({pause})"
    program = _FOR_MESSAGES.format(kind="def" if pause is None else "async def", before=before, rate=rate)
    return _HEAD.format(export=export, import_=import_) + program + "\ncomp.start()\n"


def system(folder: Path, old: str, new: str | None = None, *, source: float | None = None, **rates: float) -> Path:
    """The programs and the specification, in a folder: a counter of component A, which B may replace.

    ``rates`` are those of its outputs; or ``source`` is that of the messages that it counts.
    """
    (folder / "a.py").write_text(old)
    (folder / "b.py").write_text(old if new is None else new)
    outputs: dict[str, Any] = dict(rates) if source is None else {"out": source}

    def predicate(rate: float | None) -> dict[str, Any]:
        return {"type": STRING} if rate is None else {"type": STRING, "rate": rate}

    functionalities: dict[str, Any] = {
        f"count_{name}": {
            "produces": [name],
            "modes": {"normal": {"guarantees": {name: predicate(rate)}}, "degraded": {}},
        }
        for name, rate in outputs.items()
    }
    counter: dict[str, Any] = {"outputs": list(outputs), "functionalities": functionalities}
    topics = {f"/{name}": predicate(rate) for name, rate in outputs.items()}
    nodes: dict[str, Any] = {
        "counter": {"component": "A", "attachments": {name: [f"/{name}"] for name in outputs}},
    }
    (folder / "sink.py").write_text(_SINK)
    hear = {"uses": ["in"], "modes": {"normal": {"assumes": ["in"]}, "degraded": {}}}
    components: dict[str, Any] = {
        "Sink": {"run": "python3 sink.py", "inputs": {"in": predicate(None)}, "functionalities": {"hear": hear}}
    }
    nodes["sink"] = {"component": "Sink", "attachments": {"in": ["/out"]}}
    if source is not None:
        (folder / "source.py").write_text(_SOURCE.format(rate=source, prefix=""))
        counter["inputs"] = {"in": predicate(None)}
        functionalities["count_out"] |= {"uses": ["in"]}
        functionalities["count_out"]["modes"]["normal"]["assumes"] = ["in"]
        nodes["counter"]["attachments"]["in"] = ["/ticks"]
    components |= {name: {**counter, "run": f"python3 {name.lower()}.py"} for name in "AB"}
    document = {"system": "counting", "topics": topics, "components": components, "nodes": nodes}
    if source is not None:
        _add_source(document, "Source", "source", "/ticks", source)
    (folder / "counting.json").write_text(json.dumps(document))
    return folder


def listening(folder: Path, rate: float) -> None:
    """The counters of ``folder`` have a second functionality, ``hear``, for the messages of a source on /ticks."""
    (folder / "source.py").write_text(_SOURCE.format(rate=rate, prefix=""))

    def change(document: dict[str, Any]) -> None:
        for name in "AB":
            component = document["components"][name]
            component["inputs"] = {"in": {"type": STRING}}
            component["functionalities"]["hear"] = document["components"]["Sink"]["functionalities"]["hear"]
        _add_source(document, "Source", "source", "/ticks", rate)
        document["nodes"]["counter"]["attachments"]["in"] = ["/ticks"]

    _rewrite(folder, change)


def second_source(folder: Path, rate: float) -> None:
    """The counters also count the messages of another source, on /slow: s1, s2, ..."""
    (folder / "slow.py").write_text(_SOURCE.format(rate=rate, prefix="s"))

    def change(document: dict[str, Any]) -> None:
        _add_source(document, "Slow", "slow", "/slow", rate)
        document["nodes"]["counter"]["attachments"]["in"].append("/slow")

    _rewrite(folder, change)


def _add_source(document: dict[str, Any], component: str, node: str, topic: str, rate: float) -> None:
    contract = {"type": STRING, "rate": rate}
    talk = {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": contract}}, "degraded": {}}}
    document["components"][component] = {
        "run": f"python3 {node}.py",
        "outputs": ["out"],
        "functionalities": {"talk": talk},
    }
    document["nodes"][node] = {"component": component, "attachments": {"out": [topic]}}
    document["topics"][topic] = contract


def _rewrite(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    document = json.loads((folder / "counting.json").read_text())
    change(document)
    (folder / "counting.json").write_text(json.dumps(document))


class Reader:
    """A bare reader of one topic: everything that was published on it since it was made."""

    def __init__(self, simulator: Simulator, topic: str) -> None:
        self.words: list[str] = []
        self.times: list[float] = []
        self._clock = simulator.clock
        owner, qos = simulator.processes["sink"], QoS(history="keep_all")  # a process that outlives the counters
        self._reader = simulator.network.create_reader(owner, topic, STRING, qos, self._take)

    def _take(self) -> None:
        message, _ = self._reader.queue.popleft()
        self.words.append(message.data)
        self.times.append(self._clock.steady())

    def stop(self) -> None:
        self._reader.destroy()

    @property
    def numbers(self) -> list[int]:
        return [int(word.split()[0]) for word in self.words]

    @property
    def changes(self) -> int:
        """How often another component has continued."""
        sides = [word.split()[1] for word in self.words]
        return sum(earlier != later for earlier, later in itertools.pairwise(sides))

    def assert_exactly_once(self) -> None:
        numbers = self.numbers
        assert numbers, "it has received nothing"
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), self.words

    def longest_gap(self) -> float:
        return max(later - earlier for earlier, later in itertools.pairwise(self.times))


def counting(folder: Path, body: Callable[[Manager, Simulator], Awaitable[T]], simulator: Simulator | None = None) -> T:
    """Bring the system of ``folder`` up in virtual time, run ``body``, and shut everything down."""
    simulator = simulator or Simulator()
    specification = decode_specification(json.loads((folder / "counting.json").read_text()))

    async def main() -> T:
        manager = Manager(specification, simulator, Workspace(folder / "workspace"), folder)
        await manager.up()
        try:
            return await body(manager, simulator)
        finally:
            await manager.close()

    (folder / "workspace").mkdir(mode=0o700)
    return simulator.run(main())


async def exchanged(manager: Manager) -> Outcome:
    """Replace the counter by the other component."""
    other = "B" if manager.specification.nodes["counter"].component == "A" else "A"
    return await manager.change(PlanRequest(replace=(("counter", other),)))


# The commands that components send each other in a hand-over.
BETWEEN_PEERS = {"ping", "taken", "offer_state", "fetch_state", "importing", "export_state"}


async def settle(seconds: float = 0.3) -> None:
    await asyncio.sleep(seconds)
