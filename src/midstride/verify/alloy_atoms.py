"""The atoms and relations of a dump, and their Alloy text (docs/semantics.md, sections 1 to 3).

Each value of the model becomes one atom, named after it. Predicates are atoms too. The model computes their
satisfaction relation (`contract.satisfies`) and the sets of components that exceed a resource together; Alloy checks
that the relation is a preorder. Several systems may share one set of atoms.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from midstride.model.component import FunctionalityRef
from midstride.model.contract import Predicate, satisfies
from midstride.verify.library import declared_names

# Alloy multiplies the atoms of a relation's columns, and Kodkod counts the result in 32 bits.
MAX_ATOMS: Final = 1290
_WIDTH: Final = 116
_TERMS_PER_UNION: Final = 6
_MIN_COUNT: Final = 2
# Alloy's keywords, and the names that a dump declares beside the bundled specification.
_RESERVED: Final = """abstract after all always and as assert before but check disj else enabled enum eventually exactly
    expect extends fact for fun historically iden iff implies in Int int invariant let lone modifies module no none not
    once one open or pred private releases run seq set sig since some steps String sum this triggered univ until var
    Best better Capped Clause Findings findings Rules Step Verdict Verified"""
_INVALID: Final = re.compile(r"[^A-Za-z0-9]+")

Pair = tuple[str, ...]


class TooLarge(Exception):
    """The dump would have more atoms, or more sets of holders, than Alloy can handle; the message says which."""


@dataclass(frozen=True, slots=True)
class ModeName:
    """A mode of a functionality of an instance."""

    functionality: FunctionalityRef
    mode: str

    def __str__(self) -> str:
        return f"{self.functionality} in mode {self.mode}"


@dataclass(frozen=True, slots=True)
class SystemName:
    """A configuration of the dump, by its position in the plan."""

    number: int
    description: str

    def __str__(self) -> str:
        return self.description


class Names:
    """Identifiers of Alloy that read like the names of the file, and what each stands for."""

    def __init__(self) -> None:
        self._used = set(_RESERVED.split()) | declared_names()
        self.meanings: dict[str, object] = {}

    def assign(self, base: str, meaning: object) -> str:
        """An identifier like ``base``, for ``meaning`` alone."""
        stem = "_".join(_INVALID.sub("_", part).strip("_") for part in base.split("__")) or "x"
        if not stem[0].isalpha():
            stem = f"x{stem}"
        name, number = stem, 1
        while name in self._used or name.endswith(("_may", "_holds")):  # names of the predicates of steps
            number += 1
            name = f"{stem}_{number}"
        self._used.add(name)
        self.meanings[name] = meaning
        return name


class AlloyAtoms:
    """Collects atoms and tuples; :meth:`text` renders them."""

    SIGS: Final = (
        "Predicate", "NamedInputs", "Input", "Output", "Connector", "Mode", "Functionality", "Component", "Publisher",
        "System", "Slot", "Overload",
    )  # fmt: skip
    # The fields of the specification's signatures are constants here: Alloy evaluates constants once, but searches for
    # the values of fields.
    FIELDS: Final = {
        "sat": "Predicate Predicate",
        "named": "NamedInputs Input",
        "input_asm": "Input Predicate",
        "conn_guar": "Connector Predicate",
        "mode_asms": "Mode Assumption",
        "mode_guars": "Mode Output Predicate",
        "worse": "Mode Mode",
        "assoc_inputs": "Functionality Input",
        "assoc_outputs": "Functionality Output",
        "modes": "Functionality Mode",
        "inputs": "Component Input",
        "outputs": "Component Output",
        "funcs": "Component Functionality",
        "on": "Publisher Connector",
        "pub_guar": "Publisher Predicate",
        "slots": "Connector Slot",
        "holders": "Overload Component",
        "comps": "System Component",
        "conns": "System Connector",
        "roles": "System Connector Port",
        "cur_mode": "System Functionality Mode",
        "env_guars": "System Predicate",
        "env_pubs": "System Publisher",
    }

    def __init__(self) -> None:
        self.names = Names()
        self.sigs: dict[str, dict[str, str]] = {name: {} for name in self.SIGS}
        self.tuples: dict[str, dict[Pair, None]] = {name: {} for name in self.FIELDS}
        self.capped: list[str] = []
        self.clauses: dict[str, str] = {}
        self._predicates: dict[Predicate, str] = {}

    def atom(self, sig: str, base: str, meaning: object, comment: str = "") -> str:
        """A new atom that stands for ``meaning``, named after ``base``."""
        name = self.names.assign(base, meaning)
        self.sigs[sig][name] = comment or str(meaning)
        return name

    def add(self, relation: str, *atoms: str) -> None:
        self.tuples[relation][atoms] = None

    def clause(self, message: str) -> str:
        """The atom of a clause."""
        if message not in self.clauses:
            self.clauses[message] = self.names.assign(message, message)
        return self.clauses[message]

    def predicate(self, contract: Predicate) -> str:
        """The atom of a predicate. Relates it to every predicate so far."""
        known = self._predicates.get(contract)
        if known is not None:
            return known
        rate = "" if contract.rate is None else f"_{contract.rate:g}Hz"
        bound = "" if contract.within is None else f"_within_{contract.within:g}s"
        name = self.atom("Predicate", f"{contract.type.rpartition('/')[2]}{rate}{bound}", contract)
        self._predicates[contract] = name
        for other, atom in self._predicates.items():
            if satisfies(contract, other):
                self.add("sat", name, atom)
            if satisfies(other, contract):
                self.add("sat", atom, name)
        return name

    @property
    def size(self) -> int:
        return sum(len(atoms) for atoms in self.sigs.values())

    @property
    def bitwidth(self) -> int:
        """Bits for any count of publishers or slots of a capped topic; nothing else is counted.

        There is room for one more than the maximum, the publisher that `attach` must refuse: Alloy's integers wrap.
        """
        publishers = {(topic, port) for _, topic, port in self.tuples["roles"] if port in self.sigs["Output"]}
        publishers |= {(topic, publisher) for publisher, topic in self.tuples["on"]}
        counts = [Counter(topic for topic, _ in pairs) for pairs in (publishers, self.tuples["slots"])]
        most = max([_MIN_COUNT, *(count[topic] for count in counts for topic in self.capped)])
        return (most + 1).bit_length() + 1

    def scope(self) -> str:
        """The scope that contains exactly these atoms, and the one of Findings."""
        exactly = ", ".join(f"exactly {len(atoms)} {sig}" for sig, atoms in self.sigs.items())
        return f"for 1 but {exactly}, {self.bitwidth} Int"

    def text(self) -> str:
        """The signatures and relations. Raises TooLarge if they exceed what Alloy can handle."""
        if self.size + 2**self.bitwidth > MAX_ATOMS:
            raise TooLarge(f"{self.size} atoms, more than the {MAX_ATOMS - 2**self.bitwidth} that Alloy can handle")
        lines: list[str] = []
        for sig, atoms in self.sigs.items():
            if atoms:
                width = max(len(name) for name in atoms)
                lines += [
                    f"one sig {name} extends {sig} {{}}{' ' * (width - len(name))}  -- {' '.join(comment.split())}"
                    for name, comment in atoms.items()
                ]
                lines.append("")
        for name, columns in self.FIELDS.items():
            sorts = columns.split()
            terms = self._by_systems(name) if sorts[0] == "System" else _terms(self.tuples[name])
            lines += _relation(name, sorts, terms)
        lines.append(f"fun Capped: set Connector {{ {' + '.join(self.capped) or 'none'} }}")
        return "\n".join(lines) + "\n"

    def _by_systems(self, relation: str) -> list[str]:
        """A relation of configurations, with the configurations grouped that share a tuple."""
        systems_with: dict[Pair, list[str]] = {}
        for entry in self.tuples[relation]:
            systems_with.setdefault(entry[1:], []).append(entry[0])
        shared: dict[Pair, list[Pair]] = {}
        for rest, systems in systems_with.items():
            shared.setdefault(tuple(systems), []).append(rest)
        every = len(self.sigs["System"])
        return [
            f"{'System' if len(systems) == every else _union(list(systems))} -> {_union(_terms(tuples), within=True)}"
            for systems, tuples in shared.items()
        ]


def _terms(tuples: Iterable[Pair]) -> list[str]:
    """``a -> b``; tuples that differ in their last atom alone are merged."""
    grouped: dict[Pair, list[str]] = {}
    for entry in tuples:
        grouped.setdefault(entry[:-1], []).append(entry[-1])
    return [" -> ".join((*head, _union(last))) for head, last in grouped.items()]


def _relation(name: str, sorts: list[str], terms: list[str]) -> list[str]:
    """The union of the terms, wrapped."""
    body = _union(terms, outer=True) if terms else " -> ".join(["none"] * len(sorts))
    words = f"{body} }}".split(" ")
    lines, line = [], f"fun {name}: {' -> '.join(sorts)} {{"
    for word in words:
        if len(line) + len(word) >= _WIDTH:
            lines.append(line)
            line = " "
        line += f" {word}"
    return [*lines, line]


def _union(terms: list[str], *, outer: bool = False, within: bool = False) -> str:
    """A union, nested in brackets if it is long: Alloy's type checker is cubic in the depth of a union.

    A single term needs no brackets, unless it is a product ``within`` another one.
    """
    while len(terms) > _TERMS_PER_UNION:
        terms = [_union(terms[i : i + _TERMS_PER_UNION]) for i in range(0, len(terms), _TERMS_PER_UNION)]
    joined = " + ".join(terms)
    bare = outer or (len(terms) == 1 and not (within and "->" in joined))
    return joined if bare else f"({joined})"
