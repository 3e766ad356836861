"""The codec: every command and reply comes back as it was sent; what is not a frame is refused with the reason."""

from __future__ import annotations

import json
from random import Random
from typing import Any

import msgspec
import pytest

from midstride.errors import CommandRefused, ProtocolError
from midstride.wire.channel import result_of
from midstride.wire.commands import (
    COMMANDS,
    AnswerCommand,
    AttachCommand,
    AwaitCutCommand,
    AwaitIdleCommand,
    AwaitMatchCommand,
    AwaitRateCommand,
    AwaitReadersCommand,
    AwaitWriteCommand,
    CancelCutCommand,
    CancelledGoalsCommand,
    Command,
    ConfirmCutCommand,
    CountWritesCommand,
    CutClaimCommand,
    CutInCommand,
    CutOutCommand,
    CutSwap,
    CutTakenCommand,
    DetachCommand,
    DiscoverCommand,
    ExportStateCommand,
    FenceCommand,
    FetchStateCommand,
    GateCommand,
    GridCommand,
    HoldCommand,
    ImportingCommand,
    ImportStateCommand,
    JoinRequestsCommand,
    KeepLeaseCommand,
    KeepResultsCommand,
    MeetCommand,
    MissingRequestsCommand,
    ModesCommand,
    MuteCommand,
    ObserveCommand,
    OfferStateCommand,
    PingCommand,
    PrepareStateCommand,
    ProgramCommand,
    RecordCommand,
    RecordsCommand,
    ReleaseCommand,
    ResolveCutsCommand,
    ServeCommand,
    SetParametersCommand,
    SharedSlotPort,
    ShareSlotCommand,
    StateTransfer,
    StopCommand,
    WelcomeCommand,
    YieldCommand,
)
from midstride.wire.frames import (
    DEEPEST,
    OLDEST,
    PROTOCOL,
    Greeting,
    Hello,
    Registration,
    Reply,
    Request,
    StateChanged,
    decode_command,
    decode_from_client,
    decode_from_component,
    decode_greeting,
    encode,
    encode_value,
    nested_too_deep,
)
from midstride.wire.program import FileFingerprint, Program
from midstride.wire.replies import (
    Answers,
    Attached,
    Claimed,
    Confirmed,
    CountedWrites,
    CutResult,
    Detached,
    Discovered,
    Done,
    ExportedState,
    FencedOutputs,
    FetchedState,
    GatedWrites,
    Grid,
    Idle,
    LastWrite,
    LeaseKept,
    MissingRequests,
    PagePlace,
    PreviousModes,
    PreviousParameters,
    RateVerdict,
    Receipt,
    RecordingSwitched,
    Records,
    ServedRequest,
    SharedSlotPlace,
    StateOffer,
    Yielded,
)
from midstride.wire.state import ComponentState, Endpoint, FunctionalityState, LinkState, WireValue

from .support import GREETING, HELLO, REGISTRATION

STATE = ComponentState(
    instance="front/talker",
    uuid="u",
    pid=7,
    revision=12,
    functionalities={
        "talk": FunctionalityState(mode="normal", since=1.5, because='"quoted"\nwords', busy=0.25, reflex=True)
    },
    ports={
        "out": {"/chatter": LinkState(gate="closed", count=3, gated=4)},
        "in": {"/t": LinkState(gate=None, count=1)},
    },
    parameters={"speed": 1.5, "names": ["a", "b"], "on": True},
    stopping=3.0,
    waiting="no manager has welcomed it yet",
    simulated_time=True,
    node="/front/talker",
    answers=False,
    imported=512,
    declared={"speed": 1.0},
)
SWAPS = [CutSwap(port="out", topic="/chatter", latch=True)]
PLACE = SharedSlotPlace(page="/page", library="/gate.so", baton=1, index=2, other=3, timed=True)
TRANSFER = StateTransfer(
    id="t", cuts=2, at=10**18, clock="message", changes=True, required=False, timeout=0.5, new="b", address="a"
)
ROW = Receipt(1, 2, 3, "p")
WRITE = {"out /chatter": LastWrite(number=4, source=5), "log /log": None}

# Every command, with no field at its default, and a reply to it.
SAMPLES: list[tuple[Command[Any], WireValue]] = [
    (PingCommand(timeout=1.5), Done()),
    (ObserveCommand(timeout=1.5), STATE),
    (
        ProgramCommand(timeout=1.5),
        Program(
            files=[FileFingerprint(path="/talker.py", size=9, modified=10**18, digest=None)],
            started=10**18,
            complete=False,
        ),
    ),
    (
        GridCommand(port="out", topic="/chatter", timeout=1.5),
        Grid(trigger="rate", now=10**18, epoch=10**18 - 1, period=0.1, readers=2, clock="message", speed=0.5),
    ),
    (
        RecordsCommand(input="in", timeout=1.5),
        Records(rows=[ROW], publisher_identity=True, now=9, moments=[(1, 2)], ros_sources=True),
    ),
    (ExportStateCommand(timeout=1.5), ExportedState(state=b"\x00\xff\n")),
    (
        AwaitWriteCommand(port="out", topic="/t", calls=3, patience=0.5, timeout=1.5),
        GatedWrites(gated=3, wrong_type="a String", failed=True),
    ),
    (
        AwaitRateCommand(port="out", topic="/t", rate=10.0, window=1.0, until="met", timeout=1.5, known_clock=True),
        RateVerdict(reached=True, rate=9.5, pause=0.2, failed=True),
    ),
    (AwaitMatchCommand(port="in", topic="/t", peers=2, timeout=1.5), Attached(matched=1)),
    (
        AwaitReadersCommand(port="out", topic="/t", peers=1, everyone=2, reader_ids=["r"], patience=0.5, timeout=1.5),
        Attached(matched=2),
    ),
    (CountWritesCommand(port="out", topic="/t", timeout=1.5), CountedWrites(written=3)),
    (AwaitIdleCommand(timeout=1.5), Idle(busy="talk for 2.0 s")),
    (DiscoverCommand(topic="/t", timeout=1.5), Discovered(found=True)),
    (AwaitCutCommand(cut="c", timeout=1.5), CutResult(outcome="resumed", last=WRITE, first=WRITE)),
    (WelcomeCommand(manager="m", timeout=1.5), STATE),
    (
        AttachCommand(
            port="out",
            topic="/t",
            gate="closed",
            peers=1,
            timeout=1.5,
            rate=50.0,
            tolerates=3,
            condition=True,
            await_ready=False,
        ),
        Attached(matched=2),
    ),
    (DetachCommand(port="out", topic="/t", timeout=1.5), Detached(acknowledged=None, last=7)),
    (ModesCommand(modes={"talk": "normal"}, because="why not", timeout=1.5), PreviousModes(before={"talk": "off"})),
    (HoldCommand(functionalities=["talk"], seconds=7.0, timeout=1.5), Done()),
    (
        SetParametersCommand(parameters={"a": [1, 2], "b": "x"}, declared={"a": [1]}, timeout=1.5),
        PreviousParameters(before={"a": 0.5}),
    ),
    (ImportStateCommand(state=b"\x00\xff\n", exporter="a uuid", timeout=1.5), Done()),
    (RecordCommand(inputs=["in"], on=True, timeout=1.5), RecordingSwitched(now=3)),
    (MeetCommand(peer="old", address="unix:/x", timeout=1.5), Done()),
    (
        PrepareStateCommand(peer="old", address="unix:/x", bulk=True, timeout=1.5),
        StateOffer(exports="changes"),
    ),
    (MuteCommand(timeout=1.5), Done()),
    (
        ShareSlotCommand(cut="c", peer="talker", ports=[SharedSlotPort(topic="/t", rate=50.0)], old=True, timeout=1.5),
        PLACE,
    ),
    (
        CutOutCommand(
            cut="c",
            swaps=SWAPS,
            at=10**18,
            resume_after=0.5,
            clock="message",
            state=TRANSFER,
            shared_slot=PLACE,
            lease=1.0,
            own_address="host:/h.sock#a",
            timeout=1.5,
        ),
        Done(),
    ),
    (
        CutInCommand(
            cut="c",
            swaps=SWAPS,
            at=1,
            peer="old",
            address="unix:/x",
            epoch=2,
            clock="message",
            state=TRANSFER,
            shared_slot=PLACE,
            resume_after=0.5,
            quiet=True,
            leased=True,
            shift=-5,
            timeout=1.5,
        ),
        Done(),
    ),
    (CancelCutCommand(cut="c", freed=True, timeout=1.5), Done()),
    (ConfirmCutCommand(cut="c", timeout=1.5), Done()),
    (CutClaimCommand(cut="c", timeout=1.5), Claimed(how="leased", seconds=1.0)),
    (GateCommand(port="out", topic="/t", gate="closed", latch=True, timeout=1.5), Done()),
    (FenceCommand(attachments=[("out", "/t")], lift=True, timeout=1.5), FencedOutputs(last={"out /t": 3})),
    (KeepLeaseCommand(seconds=5.0, seen=7, timeout=1.5), LeaseKept(now=8)),
    (
        AnswerCommand(peer="old", drain=3.0, address="unix:/x", own_address="host:/h.sock#a", timeout=1.5),
        Answers(outlasting=1),
    ),
    (JoinRequestsCommand(place=PagePlace(page="/p", library="/l", index=3), timeout=1.5), Done()),
    (ReleaseCommand(timeout=1.5), Done()),
    (StopCommand(timeout=1.5), Done()),
    (CutTakenCommand(cut="c", failed=True, lock="here", timeout=1.5), Confirmed(resumed=True)),
    (YieldCommand(address="/c/a_2.sock", instance="a_2", timeout=1.5), Yielded(handled=["1 2", "1 3"], goals=["0a"])),
    (MissingRequestsCommand(requests=["1 2", "1 3"], timeout=1.5), MissingRequests(requests=["1 3"])),
    (ServeCommand(request="1 3", service="/a/count", data=b"\0\1", timeout=1.5), ServedRequest(response=b"\2")),
    (CancelledGoalsCommand(request="cancel 00 1", response=b"\0\1", timeout=1.5), Done()),
    (KeepResultsCommand(results={"0a": b"\0\1"}, timeout=1.5), Done()),
    (ResolveCutsCommand(new=True, timeout=1.5), Done()),
    (OfferStateCommand(changes=True, timeout=1.5), StateOffer(exports="nothing")),
    (
        FetchStateCommand(transfer="t", timeout=1.5),
        FetchedState(state=b"\x00\xff\n", handled={"p": 10**18}, since=1, requests=["r"], goals=["0a"]),
    ),
    (ImportingCommand(transfer="t", done=True, timeout=1.5), Confirmed(resumed=False)),
]
ids = [command.name for command, _ in SAMPLES]


def request(**fields: Any) -> Request:
    return Request(id="1", revision=None, command=msgspec.Raw(msgspec.json.encode(fields)))


def test_there_is_a_sample_of_every_command_with_every_field() -> None:
    assert ids == list(COMMANDS)
    for command, _ in SAMPLES:
        for field in msgspec.structs.fields(command):
            assert getattr(command, field.name) != field.default, (command.name, field.name)


@pytest.mark.parametrize(("command", "result"), SAMPLES, ids=ids)
def test_commands_and_replies_come_back_as_they_were_sent(command: Command[Any], result: WireValue) -> None:
    line = encode(Request(id="7", revision=3, command=encode_value(command)))
    assert b"\n" not in line, "a frame is one line"
    frame = decode_from_client(line)
    assert isinstance(frame, Request) and (frame.id, frame.revision) == ("7", 3)
    assert decode_command(frame) == command
    line = encode(Reply(id="7", revision=4, result=encode_value(result)))
    reply = decode_from_component(line)
    assert b"\n" not in line and isinstance(reply, Reply) and reply.ok
    assert result_of(reply, command) == result


@pytest.mark.parametrize("command", [command for command, _ in SAMPLES], ids=ids)
def test_unknown_and_missing_fields_are_refused_by_name(command: Command[Any]) -> None:
    fields = msgspec.json.decode(encode_value(command))
    with pytest.raises(CommandRefused, match=f"`{command.name}`: .*unknown field `colour`"):
        decode_command(request(**fields, colour="red"))
    with pytest.raises(CommandRefused, match=rf"`{command.name}`: .*timeout"):
        decode_command(request(**{**fields, "timeout": -1}))
    for field in msgspec.structs.fields(command):
        if field.required:
            rest = {name: value for name, value in fields.items() if name != field.name}
            with pytest.raises(CommandRefused, match=f"`{command.name}`: .*missing required field `{field.name}`"):
                decode_command(request(**rest))


@pytest.mark.parametrize(
    "frame",
    [GREETING, REGISTRATION, StateChanged(state=STATE), Reply(id="1", revision=2, refused="no")],
    ids=lambda frame: type(frame).__name__,
)
def test_frames_of_a_component_come_back(frame: Greeting | Registration | StateChanged | Reply) -> None:
    assert decode_from_component(encode(frame)) == frame
    document = msgspec.json.decode(encode(frame))
    with pytest.raises(ProtocolError, match=r"not a frame of a component: .*unknown field `colour`"):
        decode_from_component(msgspec.json.encode({**document, "colour": "red"}))
    for field in msgspec.structs.fields(frame):
        if field.required:
            rest = {name: value for name, value in document.items() if name != field.name}
            with pytest.raises(ProtocolError, match=f"missing required field `{field.name}`"):
                decode_from_component(msgspec.json.encode(rest))


def test_endpoints_of_a_registration_come_back() -> None:
    endpoint = Endpoint(kind="ROS action", name="/navigate")
    frame = decode_from_component(encode(Registration(declaration=REGISTRATION.declaration, endpoints=[endpoint])))
    assert isinstance(frame, Registration) and frame.endpoints == [endpoint]
    assert frame.declaration.checked() == REGISTRATION.declaration.checked()


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"null",
        b"\xff\xfe",
        b'{"frame": "hello"',
        b'{"protocol": 1, "token": ""}',
        b'{"frame": "goodbye"}',
        b'{"frame": "hello", "protocol": "1", "token": ""}',
        b'{"frame": "hello", "protocol": 1, "token": "\xff"}',
        b'{"frame": "request", "id": "1", "command": {}, "revision": 1e400}',
        b'{"frame": "request", "id": "1", "command": ' + 100_000 * b"[" + 100_000 * b"]" + b"}",
        encode(GREETING),
    ],
    ids=lambda line: repr(line[:40]),
)
def test_garbage_is_not_a_frame_of_a_client(line: bytes) -> None:
    with pytest.raises(ProtocolError, match="not a frame of a client"):
        decode_from_client(line)


@pytest.mark.parametrize(
    "line", [b"", b"\xff\xfe", HELLO, 100_000 * b"[" + 100_000 * b"]"], ids=lambda line: repr(line[:20])
)
def test_garbage_is_not_a_frame_of_a_component(line: bytes) -> None:
    with pytest.raises(ProtocolError, match="not a frame of a component"):
        decode_from_component(line)


def test_how_deep_a_frame_may_be_nested_is_the_same_on_each_version_of_python() -> None:
    """Brackets in strings are none, also behind quotes that are escaped."""
    random, words = Random(5), ["[", "{", '"', "\\", '\\"[[', "]"]
    refused = 0
    for _ in range(300):
        value: Any = random.choice(words)
        depth = 0
        for _ in range(random.choice([3, DEEPEST - 1, DEEPEST, DEEPEST + 1, DEEPEST + 20])):
            beside = [random.choice(words), *[[]] * random.randrange(2)]
            flat = len(beside) - 1
            if random.random() < 0.5:
                value, depth = [*beside, value], 1 + max(depth, flat)
            else:
                value, depth = {random.choice(words): value, "beside": beside}, 1 + max(depth, 1 + flat)
        assert nested_too_deep(json.dumps(value).encode()) == (depth > DEEPEST)
        refused += depth > DEEPEST
    assert 50 < refused < 250
    with pytest.raises(ProtocolError, match=f"not a frame of a client: nested more than {DEEPEST} deep"):
        decode_from_client(b'{"frame": "request", "id": "1", "command": ' + DEEPEST * b"[" + DEEPEST * b"]" + b"}")
    for open_at_the_end in ((DEEPEST + 1) * b"{", b'"' + 2 * DEEPEST * b"[" + b'"' + (DEEPEST + 1) * b"["):
        assert nested_too_deep(open_at_the_end)
    assert not nested_too_deep(b"[]" * 10 * DEEPEST)


@pytest.mark.parametrize(
    "command", [b"{}", b"[]", b'{"command": 3}', b'{"command": "explode"}', b'{"command": "\xff"}']
)
def test_what_is_not_a_command_is_refused_with_the_list_of_commands(command: bytes) -> None:
    with pytest.raises(CommandRefused, match=r"is not a command; the commands are ping, observe, .*taken"):
        decode_command(Request(id="1", command=msgspec.Raw(command)))


def test_a_greeting_of_another_version_says_what_to_do_whatever_else_it_contains() -> None:
    assert decode_greeting(encode(GREETING)) == GREETING
    newer = {"frame": "welcome", "protocol": PROTOCOL + 1, "instance": "talker", "colour": "red"}
    with pytest.raises(
        ProtocolError, match=rf"talker speaks version {PROTOCOL + 1} .* speaks {OLDEST} to {PROTOCOL}: .*use that one"
    ):
        decode_greeting(msgspec.json.encode(newer))
    with pytest.raises(ProtocolError, match=rf"talker speaks version {OLDEST - 1} .*earlier version .*restart it"):
        decode_greeting(msgspec.json.encode({**newer, "protocol": OLDEST - 1}))
    earlier = msgspec.structs.replace(GREETING, protocol=OLDEST)
    assert decode_greeting(encode(earlier)) == earlier


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"SSH-2.0-OpenSSH_9.6", "not a greeting"),
        (b'{"frame": "greeting"}', "not a greeting: .*missing required field `protocol`"),
        (encode(Hello(protocol=PROTOCOL, token="")), "not a greeting"),
        (encode(GREETING).replace(b"}", b', "colour": 1}'), "not a greeting: .*unknown field `colour`"),
    ],
)
def test_what_is_not_a_greeting_is_refused(line: bytes, words: str) -> None:
    with pytest.raises(ProtocolError, match=words):
        decode_greeting(line)


def test_a_reply_of_another_shape_is_not_a_result() -> None:
    for result in (b'{"matched": "many"}', b'{"matched": 1, "\xff": 2}', b"null", 100_000 * b"["):
        with pytest.raises(ProtocolError, match="the reply to `attach` is malformed: "):
            result_of(Reply(id="1", revision=1, result=msgspec.Raw(result)), AttachCommand(port="out", topic="/t"))
    with pytest.raises(CommandRefused, match="busy"):
        result_of(Reply(id="1", revision=1, refused="busy"), PingCommand())
