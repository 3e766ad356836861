"""Processes that several instances share, with a container in the place of that of ROS: starts, hangs, ends at once."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Coroutine
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from msgspec import structs

from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.ros2.manager.own_names import StartName
from midstride.backends.ros2.manager.shared_processes import SharedProcess, SharedProcesses
from midstride.codec.component_form import NamedComponentForm
from midstride.errors import BackendError, EndUnknown, StartFailed
from midstride.foreign.page import GATES_FOLDER
from midstride.foreign.preloading import StartedPrograms
from midstride.foreign.record import ForeignRecord
from midstride.lang.load import load_text
from midstride.model.component import DEFAULT_STOP, KILL_AT_ONCE, StopTimes
from midstride.model.load_words import LoadWords
from midstride.runtime.backend_protocol import Exited, Handle, Launch
from midstride.runtime.timeouts import within
from tests.lang.test_shared_containers import TEXT

COMPONENT = load_text(TEXT.replace("gate preload", "gate none")).require().components["Talker"]


class World:
    """What the container has, as its services say it; ``hung``: the nodes whose load it does not answer yet.

    ``refused``: how often it does not unload; ``asked``: the nodes that it was asked to unload, with each request;
    ``left``: those that nothing was to call any more. ``mute``: it does not answer
    such a request; ``silent``: nor any other.
    """

    def __init__(self) -> None:
        self.nodes: list[str] = []
        self.hung: dict[str, asyncio.Future[str | None]] = {}
        self.unloading = asyncio.Event()
        self.unloading.set()
        self.refused, self.mute, self.silent = 0, False, False
        self.asked: list[str] = []
        self.left: list[str] = []

    def finish(self, node: str) -> None:
        """The constructor of ``node`` returns."""
        self.nodes.append(node)
        self.hung.pop(node).set_result(None)


def services(world: World) -> type:
    from midstride.backends.ros2.manager.container_services import LoadUnanswered, UnloadUnanswered

    class Services:
        def __init__(self, node: Any, name: str) -> None: ...

        def close(self) -> None: ...

        async def load(self, request: LoadRequest, timeout: float) -> None:
            await asyncio.sleep(0)
            if request.node in world.hung:
                raise LoadUnanswered("it has not answered", world.hung[request.node])
            world.nodes.append(request.node)

        async def unload(self, node: str, timeout: float) -> None:
            assert node in world.left, "nothing calls a node that is to be unloaded"
            world.asked.append(node)
            if world.mute:
                raise UnloadUnanswered("unload_node has not answered")
            await world.unloading.wait()
            if world.hung:
                raise BackendError("it does not answer")
            if world.refused:
                world.refused -= 1
                raise BackendError("it refuses")
            world.nodes.remove(node)

        async def require_answer(self, timeout: float) -> None:
            if world.silent:
                raise BackendError("it says nothing")

        async def until_gone(self, node: str) -> None:
            await world.unloading.wait()
            while node in world.nodes:
                await asyncio.sleep(0.001)

        async def until_known(self, node: str, is_loading: Any) -> str | None:
            if node in world.hung:
                return await asyncio.shield(world.hung[node])
            return None if node in world.nodes else "it is not there"

    return Services


class Made:
    """A back end for containers, whose process does nothing."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        from midstride.backends.ros2.manager import container_backend

        self.world = World()
        monkeypatch.setattr(container_backend, "ContainerServices", services(self.world))
        monkeypatch.setattr(container_backend, "_AGAIN", 0.01)
        monkeypatch.setattr(container_backend, "_UNLOAD", 0.2)
        monkeypatch.setattr(ForeignNodes, "_answer", self._answer)
        leaves = ForeignNodes.leaves

        async def noted(nodes: ForeignNodes, record: ForeignRecord, now: bool = True) -> None:
            await leaves(nodes, record, now)
            (self.world.left.append if now else self.world.left.remove)(record.node)

        monkeypatch.setattr(ForeignNodes, "leaves", noted)
        self.exits: list[Exited] = []
        self.folder = folder
        self.backend: Any = self.another()

    async def _answer(self, record: ForeignRecord) -> None:
        """No node is there that could be answered for."""

    def another(self) -> Any:
        """The back end of another manager."""
        from midstride.backends.ros2.manager import container_backend

        class Backend(container_backend.ContainerBackend):
            name = "ros2"

            def _environment_of_spares(self, token: str) -> dict[str, str]:
                return {}

            def _python(self) -> str:
                return "python3"

            def _exited(self, instance: str, status: int | None, process: Any) -> None:
                raise AssertionError("each shares its process")

            async def _died(self, instance: str) -> None:
                self._gone(instance)

            def _gone(self, instance: str) -> None:
                self._foreign_nodes.gone(instance)

        backend = Backend(self.folder / "control", self.folder / "logs", None)
        backend._on_exit, backend._node, backend._context = self.exits.append, None, object()
        backend._graph, backend._arguments = Mock(has=lambda name: False), Mock(of=lambda *_: [])
        backend._arguments.load_request = lambda launch, component, name: LoadRequest("/box", "d", "d::T", name.full)
        backend._shared = SharedProcesses()
        backend._foreign_nodes = ForeignNodes(
            self.folder / "control" / GATES_FOLDER,
            backend.transport,
            lambda _: None,
            load=backend._load,
            failed=backend._not_loaded,
        )
        return backend

    async def start(self, instance: str, **changes: Any) -> Handle:
        words = LoadWords.of("demo::Talker")
        launch = Launch(instance, "", ("sleep",), "t", self.folder, foreign=COMPONENT, load=words, process="box")
        launch = replace(launch, role=instance.partition("_")[0], **changes)
        self.backend._shared.require_not_loading(launch)
        name = StartName(f"/{instance}")
        programs = StartedPrograms(("sleep",), dict(os.environ))
        found: Handle = await self.backend._start_shared(launch, COMPONENT, name, ("sleep", "600"), programs)
        return found

    async def load_first(self) -> None:
        """Start `a`, in a new process."""
        await self.start("a")
        await self.until(lambda: self.world.nodes == ["/a"])

    def hang(self, instance: str) -> None:
        """Have the constructor of ``instance`` not return."""
        self.world.hung[f"/{instance}"] = asyncio.get_running_loop().create_future()

    @property
    def shared(self) -> SharedProcess:
        found: SharedProcess = self.backend._shared["box"]
        return found

    async def until(self, condition: Any) -> None:
        async with within(20):
            while not condition():
                await asyncio.sleep(0.001)


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Made:
    pytest.importorskip("rclpy")
    monkeypatch.setattr("midstride.backends.ros2.manager.container_backend.component_library", lambda *_: __file__)
    return Made(tmp_path, monkeypatch)


def run(made: Made, body: Coroutine[Any, Any, None]) -> None:
    async def whole() -> None:
        try:
            await body
        finally:
            for shared in made.backend._shared.processes():
                await shared.process.end(KILL_AT_ONCE)
            made.backend._shared.close()
            await made.backend._foreign_nodes.close()
            await made.backend._stop_watching()

    asyncio.run(whole())


def test_a_node_whose_constructor_hangs_is_known_until_it_is_there_and_then_unloaded(made: Made) -> None:
    async def body() -> None:
        await made.load_first()
        made.hang("b")
        await made.start("b")
        await made.until(lambda: made.exits)
        [exited] = made.exits
        assert exited.loading and "The constructor of b may still run in box" in str(exited.because)
        await made.backend.end("b", DEFAULT_STOP)
        assert (made.shared.members, [*made.shared.unanswered]) == ({"a"}, ["b"]), "its end ends nothing else"
        [said] = made.backend.hanging()
        assert said.startswith(
            "box has not answered the request to load b. The constructor of b may still run in box, "
        )
        assert ForeignRecord.read(made.folder / "control" / GATES_FOLDER, "b") is not None
        for instance, why in (("b", "b would be there twice"), ("c", "c cannot be loaded into box")):
            with pytest.raises(StartFailed, match=f"{why}. The constructor of b may still run"):
                await made.start(instance)
        with pytest.raises(StartFailed, match="b_2 would be there twice"):
            await made.start("b_2", process="")
        assert made.shared.members == {"a"} and len(made.exits) == 1
        made.world.finish("/b")
        await made.until(lambda: not made.shared.unanswered)
        assert made.backend.hanging() == []
        assert made.world.nodes == ["/a"], "it does not run, now that it is there"
        await made.start("b")
        await made.until(lambda: made.world.nodes == ["/a", "/b"])

    run(made, body())


def test_one_that_hangs_ends_with_its_container(made: Made) -> None:
    async def body() -> None:
        await made.load_first()
        made.hang("b")
        await made.start("b")
        await made.until(lambda: made.exits)
        process = made.shared.process
        await made.backend.end("a", DEFAULT_STOP)
        assert not process.running and [*made.backend._shared] == []
        assert list(ForeignRecord.all(made.folder / "control" / GATES_FOLDER)) == []
        made.world.hung.clear()
        await made.start("b")
        assert made.shared.process is not process

    run(made, body())


def test_another_manager_unloads_what_the_one_before_has_asked_for(made: Made) -> None:
    """Once it is there; until then, as little is loaded as before. What is not coming any more is forgotten."""

    async def body() -> None:
        handle, folder = await made.start("a"), made.folder / "control" / GATES_FOLDER
        await made.until(lambda: made.world.nodes == ["/a"])
        for hung in ("b", "c"):  # the manager was killed as it loaded c, and knew that b hung
            made.hang(hung)
            record = ForeignRecord.read(folder, "a")
            assert record is not None
            structs.replace(record, instance=hung, role=hung, node=f"/{hung}", loaded=False).write(folder)
        made.world.hung.pop("/c")
        made.shared.process.close()
        made.backend = made.another()
        assert await made.backend._adopt_shared(handle)
        await made.backend.end_orphans("none", ["a"], DEFAULT_STOP)
        assert (made.shared.members, [*made.shared.unanswered]) == ({"a"}, ["b"])
        made.world.finish("/b")
        await made.until(lambda: not made.shared.unanswered)
        assert made.backend.hanging() == []
        assert made.world.nodes == ["/a"]

    run(made, body())


def test_a_node_that_comes_as_the_last_one_ends_gets_a_new_process(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        await made.load_first()
        first = made.shared.process
        ending = asyncio.ensure_future(made.backend.end("a", DEFAULT_STOP))
        while not first._ending:
            await asyncio.sleep(0)
        await made.start("b")
        await ending
        await made.until(lambda: made.world.nodes[1:] == ["/b"])
        assert not first.running and made.shared.process.running
        assert made.exits == []

    run(made, body())


def test_one_of_several_that_is_killed_ends_all_and_each_is_said(made: Made) -> None:
    """Also while it is being unloaded, which does not return."""

    async def body() -> None:
        for instance in ("a", "b"):
            await made.start(instance)
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        made.world.unloading.clear()
        ending = asyncio.ensure_future(made.backend.end("a", DEFAULT_STOP))
        await made.until(lambda: made.shared.leaving)
        await made.backend.end("a", KILL_AT_ONCE)
        await ending
        assert [each.instance for each in made.exits] == ["b"]
        assert [*made.backend._shared] == []

    run(made, body())


def test_a_roll_back_loads_a_node_where_it_was_although_its_library_is_another_now(
    made: Made, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    async def body() -> None:
        await made.start("a")
        (tmp_path / "lib.so").touch()
        library = str(tmp_path / "lib.so")
        monkeypatch.setattr("midstride.backends.ros2.manager.container_backend.component_library", lambda *_: library)
        with pytest.raises(StartFailed, match="has changed since that was started"):
            await made.start("b")
        await made.start("b", returns=True)
        await made.until(lambda: made.world.nodes == ["/a", "/b"])

    run(made, body())


def test_a_node_that_was_being_unloaded_as_the_manager_died_is_unloaded_by_the_next_one(made: Made) -> None:
    """Nothing calls it any more: it is not kept as one that runs."""

    async def body() -> None:
        handles, folder = (
            [await made.start(instance) for instance in ("a", "b")],
            made.folder / "control" / GATES_FOLDER,
        )
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        made.world.unloading.clear()
        ending = asyncio.ensure_future(made.backend.end("b", DEFAULT_STOP))
        await made.until(lambda: made.world.asked)
        ending.cancel()
        await asyncio.wait({ending})
        record = ForeignRecord.read(folder, "b")
        assert record is not None and not record.loaded
        made.world.unloading.set()
        made.world.left.clear()
        made.shared.process.close()
        made.backend = made.another()
        assert [await made.backend._adopt_shared(handle) for handle in handles] == [True, False]
        assert (made.world.nodes, made.world.left) == (["/a"], ["/b"])

    run(made, body())


def test_a_node_that_is_not_unloaded_goes_on_also_for_the_next_manager(made: Made) -> None:
    async def body() -> None:
        handles = [await made.start(instance) for instance in ("a", "b")]
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        made.world.refused = 1
        with pytest.raises(BackendError, match=r"b goes on in box: it refuses. It can only end with its container"):
            await made.backend.end("b", DEFAULT_STOP)
        assert made.world.left == [], "it is called again"
        made.shared.process.close()
        made.backend = made.another()
        assert [await made.backend._adopt_shared(handle) for handle in handles] == [True, True]

    run(made, body())


@pytest.mark.parametrize("again", [False, True], ids=["late", "asked again"])
def test_an_unload_that_is_not_answered_may_still_be_carried_out(made: Made, again: bool) -> None:
    """Until it is, the node is not called; then it has exited, but for one that was ended once more."""

    async def body() -> None:
        for instance in ("a", "b"):
            await made.start(instance)
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        made.world.mute = True
        made.world.unloading.clear()
        with pytest.raises(EndUnknown, match=r"b may still end in box, .* until then it is not known: unload_node has"):
            await made.backend.end("b", DEFAULT_STOP)
        assert (made.world.left, made.shared.members) == (["/b"], {"a", "b"})
        [said] = made.backend.hanging()
        assert said.startswith(
            "b may still end in box, which has not answered; until then it is not known: it was asked"
        )
        made.world.mute = False
        made.world.unloading.set()
        if again:
            await made.backend.end("b", DEFAULT_STOP)
            assert (made.exits, made.world.nodes) == ([], ["/a"])
        else:
            made.world.nodes.remove("/b")
            await made.until(lambda: made.exits)
            assert [each.words for each in made.exits] == [
                "b has ended: box has unloaded it after all, as it was asked to"
            ]
        assert (made.shared.members, made.shared.unloads, made.backend.hanging()) == ({"a"}, {}, [])
        assert ForeignRecord.read(made.folder / "control" / GATES_FOLDER, "b") is None
        assert made.shared.process.running

    run(made, body())


def test_a_late_node_that_is_not_unloaded_is_said_once(made: Made, caplog: pytest.LogCaptureFixture) -> None:
    async def body() -> None:
        await made.load_first()
        made.hang("b")
        await made.start("b")
        await made.until(lambda: made.exits)
        made.world.refused = 3
        made.world.finish("/b")
        await made.until(lambda: not made.shared.unanswered)
        assert made.backend.hanging() == []
        assert (made.world.nodes, made.world.asked) == (["/a"], ["/b"] * 4)
        said = [each.getMessage() for each in caplog.records if "is being removed" in each.getMessage()]
        assert said == ["/b is in it, and is being removed: it refuses; box is asked again until it has unloaded it"]

    run(made, body())


@pytest.mark.parametrize("opened", [True, False])
def test_a_node_leaves_also_where_the_page_is_of_an_earlier_manager(made: Made, opened: bool) -> None:
    """Its library is told before the node is unloaded; with what an agent knows of it, which is not lost."""

    async def body() -> None:
        await made.load_first()
        nodes, page = made.backend._foreign_nodes, Mock(is_called=Mock(return_value=False))
        record = ForeignRecord.read(made.folder / "control" / GATES_FOLDER, "a")
        assert record is not None

        async def open_page(environment: Any) -> tuple[Mock, Path]:
            assert not opened
            return page, made.folder

        nodes._page, nodes._opened = page if opened else None, open_page
        record = structs.replace(record, index=3)
        changed: list[dict[str, bool]] = []
        nodes._agents["a"] = Mock(node=Mock(record=record, change_record=lambda **changes: changed.append(changes)))
        for now in (True, False):
            await nodes.leaves(record, now)
        assert [call.args for call in page.leaves.call_args_list] == [(3, True), (3, False)]
        assert changed == [{"loaded": False}, {"loaded": True}]
        del nodes._agents["a"]
        nodes._page = None

    run(made, body())


@pytest.mark.parametrize("whole", [False, True])
def test_a_node_does_not_begin_to_end_in_a_container_that_answers_nothing(made: Made, whole: bool) -> None:
    """But where all of it ends: as a lifecycle node, it would have been shut down, and go on."""

    async def body() -> None:
        for instance in ("a", "b"):
            await made.start(instance)
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        finished: list[str] = []

        async def finish(instance: str) -> None:
            finished.append(instance)

        made.backend._foreign_nodes.finish = finish
        made.world.silent = True
        if whole:
            assert await made.backend.end("b", replace(DEFAULT_STOP, whole=True)) == []
            assert finished == ["b"]
        else:
            with pytest.raises(BackendError, match=r"b goes on in box: it says nothing. It can only end with its cont"):
                await made.backend.end("b", DEFAULT_STOP)
            assert (finished, made.world.left, made.shared.members) == ([], [], {"a", "b"})
            await made.backend.end("b", KILL_AT_ONCE)

    run(made, body())


def test_what_a_container_has_besides_its_instances_is_known(made: Made) -> None:
    """As a node that it has not unloaded: no instance has it any more, and it does not end with one of the others."""

    async def body() -> None:
        for instance in ("a", "b"):
            await made.start(instance)
        nodes, folder = made.backend._foreign_nodes, made.folder / "control" / GATES_FOLDER
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        has = {2: "/a", 3: "/b", 4: "/lingers"}
        page = Mock(
            mark=lambda index: b"m" * 12,
            ros_nodes=lambda index: [has[index]] if index in has else ["/box"],
            loaded_into=lambda process, but: {name for index, name in has.items() if index not in but},
        )
        for index, instance in ((2, "a"), (3, "b")):
            record = ForeignRecord.read(folder, instance)
            assert record is not None
            record = structs.replace(record, index=index, process_index=1, token="t")
            nodes._agents[instance] = Mock(node=Mock(record=record))
        nodes._page = page
        found = [(each.instance, each.node) for _, each in nodes.marked()]
        assert found == [("/a", "/a"), ("/b", "/b"), ("", "/lingers")]
        [asked] = nodes.processes(["a"])
        assert asked.not_its_own == {"/box", "/b", "/lingers"}
        nodes._agents.clear()
        nodes._page = None

    run(made, body())


@pytest.mark.parametrize("ends", [True, False])
def test_a_call_that_has_begun_ends_before_its_node_is_unloaded(
    made: Made, caplog: pytest.LogCaptureFixture, ends: bool
) -> None:
    """Or has had the time of its `drain`."""

    async def body() -> None:
        await made.load_first()
        nodes, looks = made.backend._foreign_nodes, iter([True, True, False] if ends else repeat(True))
        record = ForeignRecord.read(made.folder / "control" / GATES_FOLDER, "a")
        assert record is not None
        stop = NamedComponentForm.of(replace(COMPONENT, stop=StopTimes(drain=0.2)))
        nodes._page = Mock(is_called=lambda index: next(looks))
        await nodes.leaves(structs.replace(record, index=3, declaration=stop))
        assert next(looks, None) is (None if ends else True)
        said = [each.getMessage() for each in caplog.records]
        words = "a callback of /a seems to run still, 0.2 s (`drain`) after it was to be the last"
        assert said == ([] if ends else [f"{words}; the node is unloaded all the same, which may end its container"])
        nodes._page = None

    run(made, body())


@pytest.mark.parametrize("mute", ["the one", "all"])
def test_a_container_that_does_not_unload_a_node_ends_with_the_last_that_leaves_it(made: Made, mute: str) -> None:
    """Where all of it leave. Nothing more is asked of it once it has not answered."""

    async def body() -> None:
        for instance in ("a", "b", "c"):
            await made.start(instance)
        await made.until(lambda: made.world.nodes == ["/a", "/b", "/c"])
        made.world.mute = True
        made.world.unloading.clear()
        whole, process = replace(DEFAULT_STOP, whole=True), made.shared.process
        if mute == "the one":
            with pytest.raises(EndUnknown):
                await made.backend.end("b", DEFAULT_STOP)
        assert await made.backend.end("b", whole) == []
        assert (process.running, made.shared.members, [*made.shared.left]) == (True, {"a", "c"}, ["b"])
        [said] = made.backend.hanging()
        assert said.startswith("b is to end with box, which has not unloaded it. ")
        assert f"`kill -9 {process.pid}`" in said
        with pytest.raises(StartFailed, match=r"b_2 would be there twice. b is to end with box"):
            await made.start("b_2", process="")
        assert await made.backend.end("a", whole) == []
        assert process.running and made.world.asked == ["/b"]
        await made.backend.end("c", whole)
        assert process.status is not None and ([*made.backend._shared], made.exits) == ([], [])
        assert list(ForeignRecord.all(made.folder / "control" / GATES_FOLDER)) == []

    run(made, body())


def test_what_was_to_end_with_its_container_does_so_also_for_the_next_manager(made: Made) -> None:
    """It does not take it for one that runs, and asks for it to be unloaded, which is not answered again."""

    async def body() -> None:
        handles = [await made.start(instance) for instance in ("a", "b", "c")]
        await made.until(lambda: made.world.nodes == ["/a", "/b", "/c"])
        made.world.mute, whole = True, replace(DEFAULT_STOP, whole=True)
        await made.backend.end("b", whole)
        made.shared.process.close()
        made.world.left.clear()
        made.backend = made.another()
        assert [await made.backend._adopt_shared(handle) for handle in handles] == [True, False, True]
        assert (made.shared.members, [*made.shared.unanswered]) == ({"a", "c"}, ["b"])
        for instance in ("a", "c"):
            await made.backend.end(instance, whole)
        assert ([*made.backend._shared], made.exits) == ([], [])
        assert list(ForeignRecord.all(made.folder / "control" / GATES_FOLDER)) == []

    run(made, body())


def test_a_node_that_was_asked_to_end_is_not_called_again_because_its_container_answers_nothing(made: Made) -> None:
    async def body() -> None:
        for instance in ("a", "b"):
            await made.start(instance)
        await made.until(lambda: made.world.nodes == ["/a", "/b"])
        made.world.mute = True
        made.world.unloading.clear()
        with pytest.raises(EndUnknown):
            await made.backend.end("b", DEFAULT_STOP)
        made.world.mute, made.world.refused = False, 1
        made.world.unloading.set()
        with pytest.raises(EndUnknown, match="b may still end in box"):
            await made.backend.end("b", DEFAULT_STOP)
        assert "/b" in made.world.left
        made.world.nodes.remove("/b")
        await made.until(lambda: made.exits)

    run(made, body())
