"""The text of a dump: its data, its steps as predicates, its findings, its commands, and the specification they use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from midstride.verify.alloy_atoms import AlloyAtoms
from midstride.verify.formulas import Formula
from midstride.verify.library import carried

# The commands of a dump: whether all holds, what does not, whether the rules are kept, whether the end is best.
VERIFIED, VERDICT, RULES, BEST = "Verified", "Verdict", "Rules", "Best"


@dataclass(frozen=True, slots=True)
class StepName:
    """A step of a plan, counted from 1."""

    number: int
    told: str

    def __str__(self) -> str:
        return f"step {self.number}: {self.told}"


@dataclass(frozen=True, slots=True)
class JudgedStep:
    atom: str
    formula: Formula
    named: StepName


@dataclass
class Judged:
    """What a dump judges: steps, the end against the target, and in detail what does not hold (field -> value)."""

    steps: list[JudgedStep] = field(default_factory=list)
    end: tuple[str, str] | None = None
    detail: dict[str, str] = field(default_factory=dict)

    @property
    def fields(self) -> dict[str, str]:
        """The fields of Findings, each with its type: an answer must have them all."""
        detail = {name: kind for name, kind in _DETAIL.items() if name in self.detail}
        return _ALWAYS | detail | (_END if self.end is not None else {})

    @property
    def checks(self) -> tuple[str, ...]:
        """The checks that have no counterexample where nothing is found."""
        return (VERIFIED, RULES) if self.end is None else (VERIFIED, RULES, BEST)


_ALWAYS: Final = {"refused": "set Step", "wrong": "set Step", "invalid": "set System", "faults": "set Clause"}
_DETAIL: Final = {
    "unsatisfied": "Functionality -> Assumption",
    "crowded": "set Connector",
    "overloaded": "set Overload",
    "lacking": "Functionality -> Assumption",
    "attached": "Connector -> Port",
    "broken": "set Clause",
}
_END: Final = {
    "missing": "Connector -> Port",
    "extra": "Connector -> Port",
    "absent": "set Component",
    "left": "set Component",
}
# The rules of semantics.md sections 1 and 2, each with what it says where it is broken.
_RULES: Final = {
    "preorder": "the satisfaction relation is not reflexive and transitive",
    "declared": "a port, functionality or mode is not declared as one component's own",
    "chains": "the modes of a functionality are not a chain",
    "M1": "a last mode assumes something",
    "M2": "a worse mode guarantees what a better one does not",
}


def configuration_detail(system: str) -> dict[str, str]:
    """What is not valid in a configuration."""
    s = system
    return {
        "unsatisfied": f"unsatisfied[{s}, {s}.comps.funcs, {s}.roles, {s}.cur_mode]",
        "crowded": f"{{ k: {s}.conns | not cap_holds[{s}, {s}.roles, k] }}",
        "overloaded": f"{{ o: Overload | o.holders in {s}.comps }}",
    }


def step_detail(universe: AlloyAtoms, given: Formula) -> dict[str, str]:
    """Which part of a precondition fails, and for whom."""
    parts = []
    for told, held in given.clauses:
        parts.append(f"(({held}) implies none else {universe.clause(told)})")
    return {"lacking": given.lacking, "attached": given.attached, "broken": " + ".join(parts) or "none"}


_HEAD = f"""\
 * Every atom below is one thing of the file, and every relation is given in full. To judge it, execute
 *   {VERIFIED:<12} no counterexample: configurations are valid, steps may be taken and do as they say
 *   {RULES:<12} no counterexample: satisfaction is a preorder, and the declarations keep M1 and M2
 *   {VERDICT:<12} always has an instance: the fields of Findings say what does not hold
"""
_HEAD_BEST = f"""\
 *   {BEST:<12} no counterexample: at the end nothing could be in a better mode
"""


def written(universe: AlloyAtoms, title: str, judged: Judged) -> str:
    scope = universe.scope()
    rules = {held: universe.clause(told) for held, told in _RULES.items()}
    parts = [
        f"/*\n * {title}\n *\n{_HEAD}{'' if judged.end is None else _HEAD_BEST} */\n",
        universe.text(),
        _steps(judged.steps),
        _findings(universe, judged, rules),
        _commands(judged, scope),
        f"/* ==== the specification that it is judged by ==== */\n\n{carried()}",
    ]
    return "\n".join(parts)


def _steps(steps: list[JudgedStep]) -> str:
    lines = ["abstract sig Step {}"]
    for step in steps:
        lines += [
            f"\n/* {step.named} */",
            f"one sig {step.atom} extends Step {{}}",
            f"pred {step.atom}_may {{ {step.formula.may} }}",
            f"pred {step.atom}_holds {{ {step.formula.whole} }}",
        ]
    return "\n".join(lines) + "\n"


def _findings(universe: AlloyAtoms, judged: Judged, rules: Mapping[str, str]) -> str:
    """The signature and the predicate that make `Verdict` an account of what does not hold.

    It is no fact: the checks would have to work it out as well.
    """
    values = {
        "invalid": "{ s: System | not valid[s] }",
        "faults": " + ".join(f"({held} implies none else {name})" for held, name in rules.items()),
    }
    values |= judged.detail
    if judged.end is not None:
        reached, goal = judged.end
        values |= {
            "missing": f"{goal}.roles - {reached}.roles",
            "extra": f"{reached}.roles - {goal}.roles",
            "absent": f"{goal}.comps - {reached}.comps",
            "left": f"{reached}.comps - {goal}.comps",
        }
    lines = ["/* What does not hold. */", "abstract sig Clause {}"]
    lines += [f"one sig {name} extends Clause {{}}" for name in universe.clauses.values()]
    lines += [
        "one sig Findings {",
        *(f"  {name}: {kind}," for name, kind in judged.fields.items()),
        "}",
        "pred findings {",
    ]
    lines += [f"  Findings.{name} = {value}" for name, value in values.items()]
    for step in judged.steps:
        lines.append(f"  {step.atom} in Findings.refused iff not {step.atom}_may")
        lines.append(f"  {step.atom} in Findings.wrong iff {step.atom}_may and not {step.atom}_holds")
    return "\n".join([*lines, "}", ""])


def _commands(judged: Judged, scope: str) -> str:
    holds = ["all s: System | valid[s]", *(f"{step.atom}_holds" for step in judged.steps)]
    lines = []
    if judged.end is not None:
        reached, goal = judged.end
        holds.append(f"{reached}.comps = {goal}.comps and {reached}.roles = {goal}.roles")
        lines += [
            "/* The better modes there are at the end; none of them may be entered. */",
            "fun better: Functionality -> Mode {",
            f"  {{ f: {reached}.comps.funcs, m: f.modes | {reached}.cur_mode[f] in m.worse }}",
            "}",
            f"assert {BEST} {{",
            f"  all to: better.Mode -> Functionality.better | to in better => not can_upgrade_all[{reached}, to]",
            "}",
        ]
    lines += [f"assert {VERIFIED} {{", *(f"  {each}" for each in holds), "}", f"assert {RULES} {{ rules }}", ""]
    lines += [f"check {VERIFIED} {scope}", f"check {RULES} {scope}", f"run {VERDICT} {{ findings }} {scope}"]
    if judged.end is not None:
        lines.append(f"check {BEST} {scope}")
    return "\n".join(lines) + "\n"
