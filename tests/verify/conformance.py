"""Compares the model's actions with the Alloy predicates: thousands of cases in one run of the Analyzer.

Worlds are drawn, walked, and share one set of atoms. A case is an action tried in a configuration; where the model
allows it, the configuration that it leads to is one of those walked, so that a case costs hardly an atom. Alloy gets
neither the verdict nor the result of the model: for every case it decides whether the precondition holds, and whether
the action leads from the one configuration to the other. The two answers are compared here.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from midstride.model.configuration import Configuration
from midstride.verify.alloy_atoms import AlloyAtoms
from midstride.verify.formulas import Formula, formula
from midstride.verify.library import bundled
from midstride.verify.run import Alloy, SolverOutcome
from midstride.verify.world_encoder import NotEncoded, WorldEncoder
from tests.verify.walks import Claim, World, key

ATOMS: Final = 1000  # a little less than one run may have
_NONE: Final = "none -> none"
_NAMES: Final = "Answer refused wrong invalid broken Case".split()


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A claim that the specification does not share."""

    claim: Claim
    answer: str

    def __str__(self) -> str:
        return f"{self.claim}: {self.answer}"


class Batch:
    """Worlds and claims in one Alloy text, and the Analyzer's answers."""

    def __init__(self) -> None:
        self.atoms = AlloyAtoms()
        for name in _NAMES:
            self.atoms.names.assign(name, None)
        self.encoders: dict[int, WorldEncoder] = {}
        self.systems: dict[tuple[int, Hashable], str] = {}
        self.expected: dict[str, bool] = {}
        self.cases: list[tuple[Claim, str, Formula, str]] = []
        self.inexpressible: list[Claim] = []
        self._number: dict[str, int] = defaultdict(int)

    def add(self, number: int, world: World) -> None:
        encoder = self.encoders[number] = WorldEncoder(self.atoms, world.claims[0].before.context, f"w{number}_")
        for instance in world.instances:
            encoder.instance(instance)
        encoder.overloads()
        for configuration in world.configurations.values():
            self.expected[self.system(number, configuration)] = True
        for configuration in world.invalid:
            self.expected[self.system(number, configuration)] = False
        for claim in world.claims:
            self.claim(claim)

    def system(self, number: int, configuration: Configuration) -> str:
        where = (number, key(configuration))
        if where not in self.systems:
            self.systems[where] = self.encoders[number].system(configuration, len(self.systems), "a configuration")
        return self.systems[where]

    def claim(self, claim: Claim) -> None:
        """Add a claim. If the specification cannot express it, the code must refuse it."""
        before = self.system(claim.world, claim.before)
        after = before if claim.after is None else self.system(claim.world, claim.after)
        try:
            queries = formula(self.encoders[claim.world], claim.action, before, after)
        except NotEncoded:
            self.inexpressible.append(claim)
            return
        self._number[before] += 1
        self.cases.append((claim, before, queries, f"case{self._number[before]}"))

    def text(self) -> str:
        facts = []
        for claim, before, queries, case in self.cases:
            facts.append(f"  {before} -> {case} in Answer.refused iff not ({queries.may})")
            if claim.after is not None:
                facts.append(f"  {before} -> {case} in Answer.wrong iff not ({queries.whole})")
        most = max(self._number.values())
        return "\n".join(
            [
                self.atoms.text(),
                "abstract sig Case {}",
                f"one sig {', '.join(f'case{number}' for number in range(1, most + 1))} extends Case {{}}",
                "one sig Answer { refused: System -> Case, wrong: System -> Case, invalid: set System }",
                "fact {",
                "  Answer.invalid = { s: System | not valid[s] }",
                *facts,
                "}",
                f"assert Rules {{ rules }}\ncheck Rules {self.scope(most)}\nrun Answers {{}} {self.scope(most)}",
                bundled(),
            ]
        )

    def scope(self, cases: int) -> str:
        return self.atoms.scope().replace("for 1 but", f"for {max(1, cases)} but", 1)

    def disagreements(self, alloy: Alloy, limit: float = 600) -> list[Disagreement]:
        """The claims and configurations on which the specification disagrees."""
        outcomes = _solved(alloy, self.text(), limit)
        assert not outcomes["Rules"].satisfiable, "a world that was drawn breaks the rules"
        answer = outcomes["Answers"].values["Answer$0"]
        refused, wrong = _pairs(answer.get("refused", [])), _pairs(answer.get("wrong", []))
        invalid = {_atom(name) for (name,) in answer.get("invalid", [])}
        found = [
            Disagreement(claim, "the code allows it, the specification cannot express it")
            for claim in self.inexpressible
            if claim.allowed
        ]
        for claim, before, _, case in self.cases:
            if claim.allowed and (before, case) in refused:
                found.append(Disagreement(claim, "the code allows it, the specification refuses it"))
            elif not claim.allowed and (before, case) not in refused:
                reason = f"the code refuses it ({'; '.join(claim.reasons)}), the specification allows it"
                found.append(Disagreement(claim, reason))
            elif claim.allowed and (before, case) in wrong:
                found.append(Disagreement(claim, "the specification says that it leads elsewhere"))
        for name, expected in self.expected.items():
            assert (name not in invalid) is expected, f"{name} is {'not ' * expected}valid, says Alloy"
        return found


def _solved(alloy: Alloy, text: str, limit: float) -> dict[str, SolverOutcome]:
    with tempfile.TemporaryDirectory(prefix="midstride-conformance-") as folder:
        source = Path(folder) / "conformance.als"
        source.write_text(text, encoding="utf-8")
        return dict(alloy.solve(source, "*", limit=limit))


def _atom(name: str) -> str:
    return name.rpartition("$")[0].rpartition("/")[2]


def _pairs(entries: Iterable[list[str]]) -> set[tuple[str, str]]:
    return {(_atom(first), _atom(second)) for first, second in entries}


# -- why -------------------------------------------------------------------------------------------------------


def explained(alloy: Alloy, worlds: dict[int, World], disagreements: list[Disagreement]) -> list[Disagreement]:
    """The same with the reasons: which clause is broken, which functionality would lack what."""
    if not disagreements:
        return []
    batch = Batch()
    lines: list[str] = []
    queries: dict[tuple[str, str], str] = {}
    for number, claim in enumerate(each.claim for each in disagreements):
        if claim.world not in batch.encoders:
            batch.add(claim.world, replace_claims(worlds[claim.world], claim))
        for answer, condition in _clauses(batch, claim):
            pair = (f"case{number}", batch.atoms.clause(answer))
            queries[pair] = answer
            lines.append(f"  {' -> '.join(pair)} in Answer.broken iff not ({condition})")
    clauses = batch.atoms.clauses.values()
    text = "\n".join(
        [
            batch.atoms.text(),
            "abstract sig Case {}\nabstract sig Clause {}",
            f"one sig {', '.join(f'case{number}' for number in range(len(disagreements)))} extends Case {{}}",
            f"one sig {', '.join(clauses)} extends Clause {{}}",
            "one sig Answer { broken: Case -> Clause }",
            *("fact {", *lines, "}"),
            f"run Answers {{}} {batch.scope(max(len(disagreements), len(clauses)))}",
            bundled(),
        ]
    )
    broken = _pairs(_solved(alloy, text, 120)["Answers"].values["Answer$0"].get("broken", []))
    found = []
    for number, each in enumerate(disagreements):
        because = [
            answer for (case, clause), answer in queries.items() if case == f"case{number}" and (case, clause) in broken
        ]
        found.append(replace(each, answer=each.answer + (f" ({'; '.join(because)})" if because else "")))
    return found


def _clauses(batch: Batch, claim: Claim) -> Iterator[tuple[str, str]]:
    """What the specification asks of a claim's action, part by part: what it says where it is broken, and the part."""
    encoder, before = batch.encoders[claim.world], batch.system(claim.world, claim.before)
    queries = formula(encoder, claim.action, before, before)
    yield from queries.clauses
    if queries.lacking != _NONE:
        for ref, atom in encoder.functionalities.items():
            yield f"{ref} would lack what it assumes", f"no ({queries.lacking})[{atom}]"
    if queries.attached != _NONE:
        for port, atom in encoder.ports.items():
            yield f"{port} is still attached", f"no ({queries.attached}).{atom}"


def replace_claims(world: World, claim: Claim) -> World:
    """The world with nothing but what one claim needs."""
    return World(world.instances, {key(claim.before): claim.before}, [claim], [])
