"""The model's actions are those of the Alloy specification: on drawn worlds the two agree, and faults do not pass."""

from __future__ import annotations

from collections import Counter

import pytest

from midstride.model.action import Attach, Handover, Swap
from midstride.model.contract import ConnectorKind
from midstride.verify.run import find
from tests.kinds import of_kind
from tests.model.build import at, component, mode, port, source, system
from tests.verify.conformance import ATOMS, Batch, Disagreement, explained
from tests.verify.faults import FAULTS, Fault
from tests.verify.walks import Claim, World, claimed, key, walks

pytestmark = [pytest.mark.alloy, pytest.mark.full]

# Of each fault so many of the claims it changes are put to the specification.
SHOWN = 2


def batched(worlds: list[World]) -> tuple[Batch, dict[int, World]]:
    """As many of the worlds as one run can take."""
    batch, taken = Batch(), {}
    for number, world in enumerate(worlds):
        if not world.claims or batch.atoms.size > ATOMS:
            continue
        batch.add(number, world)
        taken[number] = world
    return batch, taken


def faulty_claims(fault: Fault, worlds: dict[int, World]) -> list[Claim]:
    """What the broken code says, where it is not what the whole code says."""
    found: list[Claim] = []
    with pytest.MonkeyPatch.context() as patch:
        fault.plant(patch)
        for number, world in worlds.items():
            for claim in world.claims:
                if claim.action.kind != fault.kind or len(found) == SHOWN:
                    continue
                broken = claimed(number, claim.before, claim.action)
                if broken.allowed is not claim.allowed:
                    # Where it leads to is never asked: the specification refuses the one or allows the other.
                    after = None if broken.after is None else claim.before
                    found.append(Claim(number, claim.before, claim.action, broken.reasons, after))
                elif broken.after is not None and claim.after is not None and key(broken.after) != key(claim.after):
                    found.append(broken)
    return found


@pytest.fixture(scope="module")
def judged() -> tuple[Batch, dict[int, World], dict[str, list[Claim]], list[Disagreement]]:
    """One run of the Analyzer: what the code says, and what it would say with each of the faults planted."""
    batch, worlds = batched(walks(24, tries=80, configurations=16, start=3))
    faulty = {f"{fault.kind}: {fault.name}": faulty_claims(fault, worlds) for fault in FAULTS}
    for claims in faulty.values():
        for claim in claims:
            batch.claim(claim)
    return batch, worlds, faulty, batch.disagreements(find())


Judged = tuple[Batch, dict[int, World], dict[str, list[Claim]], list[Disagreement]]


def ours(disagreements: list[Disagreement], faulty: dict[str, list[Claim]]) -> list[Disagreement]:
    """Those about the code as it is."""
    planted = {id(claim) for claims in faulty.values() for claim in claims}
    return [each for each in disagreements if id(each.claim) not in planted]


def test_code_and_specification_agree(judged: Judged) -> None:
    batch, worlds, faulty, disagreements = judged
    found = ours(disagreements, faulty)
    assert [str(each) for each in explained(find(), worlds, found[:12])] == []
    assert not [claim for claim in batch.inexpressible if claim.allowed]


def test_everything_is_tried(judged: Judged) -> None:
    """Each action is allowed many times and refused many times, groups and whole hand-overs too."""
    batch, worlds, _, _ = judged
    claims = [claim for world in worlds.values() for claim in world.claims]
    assert len(claims) >= 800
    tried = Counter((claim.action.kind, claim.allowed) for claim in claims)
    for kind in ("create", "remove", "attach", "detach", "degrade", "upgrade", "handover"):
        assert tried[kind, True] >= 10, kind
        assert tried[kind, False] >= 10, kind
    groups = Counter(claim.action.kind for claim in claims if claim.allowed and _size(claim) > 1)
    assert groups["degrade"] >= 3
    assert groups["upgrade"] >= 3
    assert batch.atoms.capped
    assert any("server 1 of at most 1" in comment for comment in batch.atoms.sigs["Slot"].values())
    assert batch.atoms.sigs["Overload"]
    assert batch.atoms.sigs["NamedInputs"]
    assert batch.atoms.tuples["env_guars"]
    assert batch.atoms.tuples["env_pubs"]
    assert sum(not expected for expected in batch.expected.values()) >= 10, "some configurations are not valid"


def _size(claim: Claim) -> int:
    return len(getattr(claim.action, "modes", ()))


@pytest.fixture(scope="module")
def messages(judged: Judged) -> dict[int, str]:
    """The message for each claim of broken code that the specification does not share."""
    _, worlds, faulty, disagreements = judged
    planted = {id(claim) for claims in faulty.values() for claim in claims}
    caught = [each for each in disagreements if id(each.claim) in planted]
    return {id(each.claim): str(each) for each in explained(find(), worlds, caught)}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.kind}: {fault.name}")
def test_a_fault_in_an_action_is_caught_and_explained(fault: Fault, judged: Judged, messages: dict[int, str]) -> None:
    claims = judged[2][f"{fault.kind}: {fault.name}"]
    assert claims, "the fault changes nothing that was tried"
    for claim in claims:
        assert id(claim) in messages, f"{claim} passes"
        assert messages[id(claim)].startswith(str(claim))
    assert any(fault.message in messages[id(claim)] for claim in claims), [messages[id(claim)] for claim in claims]


@pytest.mark.parametrize("cap", [1, 3, 7])
def test_one_publisher_too_many_is_counted(cap: int) -> None:
    """Alloy's numbers have as many bits as a dump needs: also for the publisher that is refused."""
    full = system(
        {f"n{number}": source() for number in range(cap + 1)},
        [f"n{number}.out /a" for number in range(cap)],
        caps={"/a": cap},
    )
    claim = claimed(0, full, Attach(port(f"n{cap}.out"), "/a"))
    assert not claim.allowed
    batch = Batch()
    batch.add(0, World(list(full.instances.values()), {key(full): full}, [claim], []))
    assert batch.disagreements(find()) == []


@pytest.mark.parametrize("kind", ["service", "action"])
def test_a_second_server_is_refused_and_a_hand_over_to_it_is_not(kind: ConnectorKind) -> None:
    contract = of_kind(at(5.0, "demo_msgs/msg/A"), kind)
    server = component("Server", {}, ["out"], [mode("normal", out=contract), mode("degraded")])
    modes = {"n0.work": 0, "n1.work": 0}
    served = system({"n0": server, "n1": server}, ["n0.out /s"], topics={"/s": contract}, modes=modes)
    second = claimed(0, served, Attach(port("n1.out"), "/s"))
    swapped = claimed(0, served, Handover((Swap("/s", port("n0.out"), port("n1.out")),)))
    assert not second.allowed
    assert swapped.after is not None
    configurations = {key(each): each for each in (served, swapped.after)}
    batch = Batch()
    batch.add(0, World(list(served.instances.values()), configurations, [second, swapped], []))
    assert batch.disagreements(find()) == []


@pytest.mark.long
@pytest.mark.parametrize("part", range(1, 5))
def test_code_and_specification_agree_on_thousands(part: int) -> None:
    batch, worlds = batched(walks(20, tries=330, configurations=26, start=100 + part))
    assert len(batch.cases) >= 2000
    found = batch.disagreements(find(), limit=1500)
    assert [str(each) for each in explained(find(), worlds, found[:12])] == []
