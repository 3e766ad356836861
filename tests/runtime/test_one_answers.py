"""Which instance of a role answers requests, over whole changes on the simulator; instances named in requests."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import Unreachable
from midstride.lang.load import load_text
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, managed, replace, stateful_talkers


def answering(simulator: Simulator, role: str) -> list[str]:
    """The instances of ``role`` that answer, as they report it."""
    states = {name: simulator.state(name) for name in simulator.processes if name.partition("_")[0] == role}
    return sorted(name for name, state in states.items() if state is not None and state.answers)


@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
@pytest.mark.parametrize(("name", "role"), [("talker", "talker"), ("talker", "listener"), ("filter", "filter")])
def test_never_do_two_instances_answer_and_afterwards_the_new_one_does(
    name: str, role: str, strategy: str, tmp_path: Path
) -> None:
    simulator = Simulator()
    seen: set[tuple[str, ...]] = set()

    async def look(instance: str, op: str) -> None:
        seen.add(tuple(answering(simulator, role)))

    async def body(manager: Manager, _: Simulator) -> None:
        for number in (2, 3):
            simulator.control.before_request = look
            outcome = await manager.change(PlanRequest(restart=(role,), strategy=strategy))
            assert outcome.outcome == "done", outcome.because
            await asyncio.sleep(1)
            assert answering(simulator, role) == [f"{role}_{number}"]
            (component,) = [each for each in (await manager.status()).instances if each.role == role]
            assert component.answers and component.node is None
        assert all(len(instances) <= 1 for instances in seen)

    managed(name, tmp_path, body, simulator)


def serving_talkers(folder: Path, attachment: str) -> Specification:
    """The talker's system; with an ``attachment``, the talker is a program that also serves."""
    component = "NewTalker" if attachment else "Talker"
    return load_text(f"""system talker
topic /chatter : std_msgs/msg/String @ 10 Hz
service /tell : std_srvs/srv/Trigger
component Talker {{
  run "python3 {folder}/Talker.py"
  output out
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 10 Hz }}
    mode degraded {{ }}
  }}
}}
component NewTalker {{
  run "python3 {folder}/NewTalker.py"
  output out
  server tell
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 10 Hz }}
    mode degraded {{ }}
  }}
  functionality serve {{ produces tell  mode normal {{ guarantee tell : std_srvs/srv/Trigger }}  mode off {{ }} }}
}}
node talker : {component} {{ out -> /chatter{attachment} }}
""").require()


@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
def test_a_replacement_with_its_first_server_answers_once_it_has_the_state(strategy: Any, tmp_path: Path) -> None:
    """Its server is attached before its outputs are handed over; what a request changed before that would be lost."""
    stateful_talkers(tmp_path)
    program = (tmp_path / "NewTalker.py").read_text()
    served = """
from std_srvs.srv import Trigger
tell = comp.create_server("tell", Trigger, lambda request, response: None)
serve = comp.create_functionality("serve", outputs=[tell])
serve.set_normal_mode(lambda: None, outputs=[tell])
serve.set_degraded_mode(lambda: None, name="off")
comp.start()
"""
    (tmp_path / "NewTalker.py").write_text(program.replace("comp.start()\n", served))
    before = serving_talkers(tmp_path, "")
    target = serving_talkers(tmp_path, "  tell -> /tell")
    simulator = Simulator()
    seen: set[bool] = set()

    async def look() -> None:
        while True:
            process = simulator.processes.get("talker_2")
            if process is not None and answering(simulator, "talker") == ["talker_2"]:
                program: Any = process._program
                seen.add(program._main.state.endswith("+"))
            await asyncio.sleep(0.001)

    async def body(manager: Manager, _: Simulator) -> None:
        looking = asyncio.ensure_future(look())
        outcome = await manager.change(PlanRequest(to=target, strategy=strategy))
        assert outcome.outcome == "done", outcome.because
        await asyncio.sleep(1)
        looking.cancel()
        assert answering(simulator, "talker") == ["talker_2"] and seen == {True}

    managed("talker", tmp_path, body, simulator, before)


def crashes(simulator: Simulator, instance: str, at: str) -> None:
    """Kill ``instance`` just before the manager sends it ``at``."""

    async def look(to: str, op: str) -> None:
        if (to, op) == (instance, at):
            simulator.faults.kill(instance)

    simulator.control.before_request = look


@pytest.mark.parametrize("at", ["attach", "await_cut", "answer"])
def test_a_replacement_that_dies_leaves_the_old_one_answering(at: str, tmp_path: Path) -> None:
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> None:
        crashes(simulator, "talker_2", at)
        outcome = await manager.change(replace("talker", "NewTalker"))
        await asyncio.sleep(1)
        remaining = ["talker"] if "talker" in simulator.processes else []
        assert answering(simulator, "talker") == remaining
        assert bool(remaining) == (outcome.outcome == "rolled_back")

    managed("talker", tmp_path, body, simulator)


@pytest.mark.parametrize("at", ["grid", "cut_out", "await_cut", "detach"])
def test_a_replacement_answers_although_the_old_one_dies(at: str, tmp_path: Path) -> None:
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> None:
        crashes(simulator, "talker", at)
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert outcome.outcome == "done", outcome.because
        await asyncio.sleep(1)
        assert answering(simulator, "talker") == ["talker_2"]

    managed("talker", tmp_path, body, simulator)


@pytest.mark.full
def test_whichever_command_a_manager_sent_last_one_answers_then_and_with_the_next_manager(tmp_path: Path) -> None:
    async def changed_until(manager: Manager, number: int) -> bool:
        """Restart the talker; only ``number`` commands are sent. Whether that was all."""
        send, left, dead = manager._client._send, number, False

        async def counted(*arguments: Any) -> Any:
            nonlocal left
            left -= 1
            while left < 0:
                await asyncio.sleep(1)
                if dead:
                    raise Unreachable("the manager was killed")
            return await send(*arguments)

        manager._client._send = counted  # type: ignore[method-assign, assignment]
        changing = asyncio.ensure_future(manager.change(PlanRequest(restart=("talker",))))
        simulator = manager._backend
        assert isinstance(simulator, Simulator)
        await asyncio.wait({changing}, timeout=20)
        done = changing.done()
        assert len(answering(simulator, "talker")) == 1
        await manager.close()
        following = Manager(manager.specification, simulator, manager._workspace, EXAMPLES / "talker")
        await following.up()
        await asyncio.sleep(1)
        assert answering(simulator, "talker") == [*following.configuration.instances_by_role["talker"]]
        await following.close()
        dead = True
        changing.cancel()
        await asyncio.wait({changing})
        return done

    async def main(number: int) -> bool:
        folder = tmp_path / str(number)
        folder.mkdir()
        manager = Manager(example("talker"), simulator, Workspace(folder), EXAMPLES / "talker")
        await manager.up()
        return await changed_until(manager, number)

    for number in range(1, 60, 2):
        simulator = Simulator()
        if simulator.run(main(number)):
            return
    pytest.fail("no change was completed")


# A program that only serves: nothing but its requests is handed over.
_SERVER = """
from midstride import Component
from std_srvs.srv import Trigger

comp = Component("teller")
tell = comp.create_server("tell", Trigger, lambda request, response: None)
serve = comp.create_functionality("serve", outputs=[tell])
serve.set_normal_mode(lambda: None, outputs=[tell])
serve.set_degraded_mode(lambda: None, name="off")
comp.start()
"""
_SERVING = """
system serving
service /tell : std_srvs/srv/Trigger
component Server {
  run "python3 server.py"
  server tell
  functionality serve { produces tell  mode normal { guarantee tell : std_srvs/srv/Trigger }  mode off { } }
}
node teller : Server { tell -> /tell }
"""


@pytest.mark.parametrize("lost", [2, 100])
def test_a_roll_back_has_the_old_one_answer_again_and_says_so_where_it_could_not(lost: int, tmp_path: Path) -> None:
    """The new one has had it stop and has died, and the first requests to answer again do not arrive."""
    (tmp_path / "server.py").write_text(_SERVER)
    simulator = Simulator()

    async def look(to: str, op: str) -> None:
        if (to, op) == ("teller", "yield"):
            asyncio.get_running_loop().call_later(0.1, simulator.faults.kill, "teller_2")

    async def body(manager: Manager, _: Simulator) -> None:
        simulator.faults.fail_next("teller", "yield", "delayed_reply", seconds=0.3)
        simulator.faults.fail_next("teller", "answer", "unreachable", lost)
        simulator.control.before_request = look
        outcome = await manager.change(PlanRequest(restart=("teller",)))
        await asyncio.sleep(1)
        assert sorted(simulator.processes) == ["teller"]
        words = [event.words for event in manager.log()]
        if lost == 2:
            assert (outcome.outcome, answering(simulator, "teller")) == ("rolled_back", ["teller"])
            assert "every step has been undone" in words
        else:
            assert (outcome.outcome, answering(simulator, "teller")) == ("failed", [])
            assert "teller does not answer requests to teller: teller cannot be reached" in str(outcome.because)
            assert "every step has been undone" not in words

    managed("teller", tmp_path, body, simulator, load_text(_SERVING).require(), directory=tmp_path)


def test_a_request_may_name_an_instance(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        assert (await manager.change(replace("talker", "NewTalker"))).outcome == "done"
        assert (await manager.change(replace("talker_2", "Talker"))).outcome == "done"
        assert (await manager.change(PlanRequest(restart=("talker_3",)))).outcome == "done"
        assert sorted(manager.configuration.instances) == ["listener", "talker_2"]
        gone = await manager.change(PlanRequest(restart=("talker_3",)))
        assert gone.outcome == "refused" and "there is no node `talker_3`" in str(gone.because)
        assert (await manager.change(PlanRequest(remove=("talker_2",)))).outcome == "done"
        assert sorted(manager.configuration.instances) == ["listener"]

    managed("talker", tmp_path, body)
