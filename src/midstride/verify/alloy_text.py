"""The text of a dump: atoms, steps as predicates, findings, commands, and the specification they use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from midstride.verify.alloy_atoms import AlloyAtoms
from midstride.verify.formulas import Formula
from midstride.verify.library import bundled

# The commands of a dump: whether all holds, what does not, whether the rules hold, whether the end is best.
VERIFIED, VERDICT, RULES, BEST = "Verified", "Verdict", "Rules", "Best"


@dataclass(frozen=True, slots=True)
class StepName:
    """A step of a plan, counted from 1."""

    number: int
    description: str

    def __str__(self) -> str:
        return f"step {self.number}: {self.description}"


@dataclass(frozen=True, slots=True)
class StepObligation:
    """A step to verify."""

    atom: str
    formula: Formula
    name: StepName


@dataclass
class Obligations:
    """The obligations that a dump verifies: steps, the end against the target, and details of what does not hold
    (field -> value).
    """

    steps: list[StepObligation] = field(default_factory=list)
    end: tuple[str, str] | None = None
    detail: dict[str, str] = field(default_factory=dict)

    @property
    def fields(self) -> dict[str, str]:
        """The fields of Findings and their types; an answer must have them all."""
        detail = {name: kind for name, kind in _DETAIL.items() if name in self.detail}
        return _ALWAYS | detail | (_END if self.end is not None else {})

    @property
    def checks(self) -> tuple[str, ...]:
        """The checks that must have no counterexample if nothing is found."""
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
# The rules of docs/semantics.md, sections 1 and 2, each with its message if it is broken.
_RULES: Final = {
    "preorder": "the satisfaction relation is not reflexive and transitive",
    "declared": "a port, functionality or mode does not belong to exactly one component",
    "chains": "the modes of a functionality are not a chain",
    "M1": "a last mode has an assumption",
    "M2": "a worse mode guarantees what a better one does not",
}


def configuration_detail(system: str) -> dict[str, str]:
    """The details that make a configuration invalid."""
    s = system
    return {
        "unsatisfied": f"unsatisfied[{s}, {s}.comps.funcs, {s}.roles, {s}.cur_mode]",
        "crowded": f"{{ k: {s}.conns | not cap_holds[{s}, {s}.roles, k] }}",
        "overloaded": f"{{ o: Overload | o.holders in {s}.comps }}",
    }


def step_detail(atoms: AlloyAtoms, given: Formula) -> dict[str, str]:
    """The part of a precondition that fails, and for which functionality or port."""
    parts = [f"(({condition}) implies none else {atoms.clause(message)})" for message, condition in given.clauses]
    return {"lacking": given.lacking, "attached": given.attached, "broken": " + ".join(parts) or "none"}


_HEAD = f"""\
 * Each atom below is one element of the file, and every relation is complete. Execute
 *   {VERIFIED:<12} no counterexample: configurations are valid, steps are allowed and have the stated effect
 *   {RULES:<12} no counterexample: satisfaction is a preorder, and the declarations obey M1 and M2
 *   {VERDICT:<12} always has an instance: the fields of Findings list what does not hold
"""
_HEAD_BEST = f" *   {BEST:<12} no counterexample: at the end no functionality could be in a better mode\n"


def render(atoms: AlloyAtoms, title: str, obligations: Obligations) -> str:
    scope = atoms.scope()
    rules = {rule: atoms.clause(message) for rule, message in _RULES.items()}
    parts = [
        f"/*\n * {title}\n *\n{_HEAD}{'' if obligations.end is None else _HEAD_BEST} */\n",
        atoms.text(),
        _steps(obligations.steps),
        _findings(atoms, obligations, rules),
        _commands(obligations, scope),
        f"/* ==== the specification that it is verified against ==== */\n\n{bundled()}",
    ]
    return "\n".join(parts)


def _steps(steps: list[StepObligation]) -> str:
    lines = ["abstract sig Step {}"]
    for step in steps:
        lines += [
            f"\n/* {step.name} */",
            f"one sig {step.atom} extends Step {{}}",
            f"pred {step.atom}_may {{ {step.formula.may} }}",
            f"pred {step.atom}_holds {{ {step.formula.whole} }}",
        ]
    return "\n".join(lines) + "\n"


def _findings(atoms: AlloyAtoms, obligations: Obligations, rules: Mapping[str, str]) -> str:
    """The signature and the predicate with which `Verdict` lists what does not hold.

    A predicate, not a fact: with a fact, the checks would evaluate it as well.
    """
    values = {
        "invalid": "{ s: System | not valid[s] }",
        "faults": " + ".join(f"({rule} implies none else {name})" for rule, name in rules.items()),
    }
    values |= obligations.detail
    if obligations.end is not None:
        reached, goal = obligations.end
        values |= {
            "missing": f"{goal}.roles - {reached}.roles",
            "extra": f"{reached}.roles - {goal}.roles",
            "absent": f"{goal}.comps - {reached}.comps",
            "left": f"{reached}.comps - {goal}.comps",
        }
    lines = ["/* What does not hold. */", "abstract sig Clause {}"]
    lines += [f"one sig {name} extends Clause {{}}" for name in atoms.clauses.values()]
    lines += [
        "one sig Findings {",
        *(f"  {name}: {kind}," for name, kind in obligations.fields.items()),
        "}",
        "pred findings {",
    ]
    lines += [f"  Findings.{name} = {value}" for name, value in values.items()]
    for step in obligations.steps:
        lines.append(f"  {step.atom} in Findings.refused iff not {step.atom}_may")
        lines.append(f"  {step.atom} in Findings.wrong iff {step.atom}_may and not {step.atom}_holds")
    return "\n".join([*lines, "}", ""])


def _commands(obligations: Obligations, scope: str) -> str:
    holds = ["all s: System | valid[s]", *(f"{step.atom}_holds" for step in obligations.steps)]
    lines = []
    if obligations.end is not None:
        reached, goal = obligations.end
        holds.append(f"{reached}.comps = {goal}.comps and {reached}.roles = {goal}.roles")
        lines += [
            "/* The better modes that exist at the end; no upgrade to any of them is allowed. */",
            "fun better: Functionality -> Mode {",
            f"  {{ f: {reached}.comps.funcs, m: f.modes | {reached}.cur_mode[f] in m.worse }}",
            "}",
            f"assert {BEST} {{",
            f"  all to: better.Mode -> Functionality.better | to in better => not can_upgrade_all[{reached}, to]",
            "}",
        ]
    lines += [f"assert {VERIFIED} {{", *(f"  {each}" for each in holds), "}", f"assert {RULES} {{ rules }}", ""]
    lines += [f"check {VERIFIED} {scope}", f"check {RULES} {scope}", f"run {VERDICT} {{ findings }} {scope}"]
    if obligations.end is not None:
        lines.append(f"check {BEST} {scope}")
    return "\n".join(lines) + "\n"
