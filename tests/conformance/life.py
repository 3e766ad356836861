"""Starting, registering, being welcomed, ending; and which clients may send commands."""

from __future__ import annotations

from midstride.codec.component_form import decode_component
from midstride.errors import BackendError
from midstride.model.component import StopTimes
from midstride.wire.frames import Reply
from tests.conformance import puppets
from tests.conformance.lab import TOKEN, Lab, check


@check
async def starts_registers_and_waits(lab: Lab) -> None:
    """A component registers with every client that connects, and waits for its welcome, degraded and unattached."""
    description = puppets.relay()
    await lab.launch("relay_2", description)
    greeting, registration = await lab.registered("relay_2")
    assert greeting.start_token == TOKEN and greeting.instance == "relay_2"
    assert registration.declaration.checked() == decode_component(description["component"])
    assert registration.endpoints == []
    assert lab.backend.transport.present() == {"relay_2": lab.backend.transport.address("relay_2")}
    lab.registrations.clear()
    await lab.channel("relay_2", "of another client")
    await lab.eventually("it registers again", lambda: lab.registrations)
    state = await lab.read("relay_2", "observe")
    assert state["instance"] == "relay_2" and state["uuid"] == greeting.uuid
    assert state["waiting"] and state["ports"] == {"out": {}, "in": {}}
    assert state["functionalities"]["answer"]["mode"] == "degraded"
    welcomed = await lab.welcome("relay_2")
    assert "waiting" not in welcomed  # which says what has a default only where it differs
    reports = lab.reports
    await lab.eventually("it goes on reporting its state", lambda: lab.reports > reports + 1)
    await lab.shows(nodes=["/relay_2"])


@check
async def stops_in_order(lab: Lab) -> None:
    """`stop`: the author's `on_stop` still writes, then the process ends with status 0, and its endpoints with it."""
    await lab.listen()
    await lab.start("talker", puppets.talker(on_stop={"write": "last words"}))
    await lab.attach("talker", "out", "/chatter", peers=1)
    await lab.mode("talker", "talk", "normal")
    await lab.eventually("the sink hears it", lambda: lab.received("sink"))
    await lab.change("talker", "stop")
    exited = await lab.exited("talker")
    assert exited.status == 0, exited
    assert (await lab.received("sink"))[-1] == "last words"
    assert await lab.unreachable("talker")
    await lab.eventually(
        "the graph shows it no more",
        lab.backend.endpoints,
        lambda graph: "/talker" not in graph.nodes and "/talker" not in dict(graph.publishers),
    )


@check
async def ends_in_order_from_outside(lab: Lab) -> None:
    """`Backend.end` ends in order first, so `on_stop` writes. An exit that was requested is not reported."""
    await lab.listen()
    await lab.start("talker", puppets.talker(on_stop={"write": "last words"}))
    await lab.attach("talker", "out", "/chatter", peers=1)
    await lab.backend.end("talker", StopTimes(0.0, 10.0))
    assert await lab.received("sink") == ["last words"]
    assert await lab.unreachable("talker")
    await lab.sleep(0.3)
    assert "talker" not in lab.exits


@check
async def ends_what_does_not_end(lab: Lab) -> None:
    """An `on_stop` that takes too long does not keep a component alive: `end` kills it after its grace."""
    await lab.start("stubborn", puppets.talker(on_stop={"sleep": 60, "timeout": 60}))
    begun = lab.clock.steady()
    await lab.backend.end("stubborn", StopTimes(0.0, 1.0))
    assert lab.clock.steady() - begun < 15
    assert await lab.unreachable("stubborn")


@check
async def reports_processes_that_never_register(lab: Lab) -> None:
    """Code that raises on import, or exits at once, is reported with its status and output; none registers."""
    await lab.launch("raising", puppets.talker(at_import={"raise": "no such calibration file"}))
    await lab.launch("leaving", puppets.talker(at_import={"exit": 3}))
    await lab.launch("endless", puppets.talker(endless=True))
    raising, leaving = await lab.exited("raising"), await lab.exited("leaving")
    assert raising.status == 1 and "no such calibration file" in raising.log_tail, raising
    assert leaving.status == 3, leaving
    await lab.sleep(0.5)
    assert not lab.registrations and "endless" not in lab.exits
    await lab.backend.end("endless", StopTimes(0.0, 1.0))
    assert await lab.unreachable("endless")


@check
async def refuses_a_name_in_use(lab: Lab) -> None:
    """A second component of the same name does not start, and the first is not affected."""
    await lab.start("talker", puppets.talker())
    before = await lab.read("talker", "observe")
    refused = ""
    try:
        await lab.launch("talker", puppets.talker())
    except BackendError as error:
        refused = str(error)
    assert "talker" in refused, "a second component of the same name was started"
    assert (await lab.read("talker", "observe"))["uuid"] == before["uuid"]


@check
async def finds_what_an_earlier_manager_started(lab: Lab) -> None:
    """Closing the back end ends no component; a handle finds it again, as long as it runs."""
    await lab.start("talker", puppets.talker())
    handle = lab.handles["talker"]
    await lab.backend.close()
    await lab.backend.open(lab.on_exit)
    assert await lab.backend.adopt(handle)
    assert (await lab.read("talker", "observe"))["instance"] == "talker"
    await lab.change("talker", "stop")
    await lab.exited("talker")
    assert not await lab.backend.adopt(handle)


@check
async def obeys_its_manager_only(lab: Lab) -> None:
    """Without the token, or with another revision than the component's, a command is refused with the reason."""
    await lab.start("talker", puppets.talker())
    state = await lab.read("talker", "observe")
    degrade = {"modes": {"talk": "normal"}, "timeout": 1.0}
    now = state["revision"]
    attach = {"topic": "/chatter", "port": "put"}
    for op, arguments, token, revision, word in (
        ("modes", degrade, "of another system", now, "token"),
        ("modes", degrade, "", now, "token"),
        ("observe", {}, "of another system", None, "token"),
        ("modes", degrade, TOKEN, now - 1, "revision"),
        ("modes", degrade, TOKEN, now + 1, "revision"),
        ("modes", degrade, TOKEN, None, "revision"),
        ("explode", {}, TOKEN, now, "explode"),
        ("modes", {"modes": "normal"}, TOKEN, now, "modes"),
        ("attach", {"topic": "/chatter"}, TOKEN, now, "port"),
        ("attach", {**attach, "colour": "red"}, TOKEN, now, "colour"),
        ("attach", {**attach, "timeout": -1}, TOKEN, now, "timeout"),
        ("attach", attach, TOKEN, now, "put"),
    ):
        reply = await lab.send("talker", op, arguments, id=f"{op} {word}", token=token, revision=revision)
        assert reply.refused is not None and word in reply.refused, (op, arguments, reply)
        assert reply.revision == now, (op, arguments, reply)
    after = await lab.read("talker", "observe")
    assert after["functionalities"]["talk"]["mode"] == "degraded" and after["ports"] == {"out": {}}


@check
async def answers_a_repeat_as_before(lab: Lab) -> None:
    """A command that is sent twice is carried out once, and gets the same reply twice; so do refusals."""
    await lab.start("talker", puppets.talker())
    revision = (await lab.read("talker", "observe"))["revision"]
    link = {"port": "out", "topic": "/chatter"}

    async def attach() -> Reply:
        return await lab.send("talker", "attach", link, id="once", revision=revision)

    async def gate() -> Reply:
        return await lab.send("talker", "gate", {**link, "gate": "open"}, id="no", revision=revision + 2)

    first = await attach()
    assert first.ok and (await lab.send("talker", "detach", link, id="back", revision=revision + 1)).ok
    assert await attach() == first, "a late duplicate was not answered as the first"
    refused = await gate()
    assert refused.refused is not None and await gate() == refused
    state = await lab.read("talker", "observe")
    assert state["revision"] == revision + 2 and state["ports"] == {"out": {}}


@check
async def calls_to_missing_components_fail(lab: Lab) -> None:
    """A request to a component that does not run fails in time."""
    begun = lab.clock.steady()
    assert await lab.unreachable("missing")
    assert lab.clock.steady() - begun < 5
