"""Names for atoms: Alloy identifiers that still read like the file's own names, and the way back."""

from __future__ import annotations

import re
from typing import Final

# Alloy's own words, and those of the specification that a dump carries along.
_TAKEN: Final = frozenset(
    """abstract after all always and as asm_satisfied assert assoc_inputs assoc_outputs Assumption attach before
    Best better but cap_holds capacities_hold Capped chains check Clause coming Component comps conn_guar
    conn_satisfied Connector conns create cur_mode declared degrad_mode degrade degrade_all detach disj each_once
    else enabled enum env_guars env_pubs eventually exactly expect extends fact Findings fits for fun funcs
    Functionality handover historically holders iden iff implies in Input input_asm input_satisfied inputs Int int
    invariant leaving let lone M1 M2 Mode mode_asms mode_guars modes modifies module named NamedInputs no none
    norm_mode not on once one open or Output outputs Overload Port ports pred Predicate preorder private pub_guar
    Publisher releases remove roles Rules rules run same_world sat satisfies_now satisfy seq set sig since Slot
    slots some Step steps String structured sum System this triggered unchanged univ unsatisfied until upgrade
    upgrade_all valid valid_sys var Verdict Verified works worse""".split()
)
_STRANGE: Final = re.compile(r"[^A-Za-z0-9]+")


class Names:
    """Hands out identifiers, each once, and remembers what bears them."""

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self.bearers: dict[str, object] = {}

    def give(self, wanted: str, bearer: object) -> str:
        """An identifier like ``wanted``, for ``bearer`` alone."""
        base = "_".join(_STRANGE.sub("_", part).strip("_") for part in wanted.split("__")) or "x"
        if not base[0].isalpha():
            base = f"x{base}"
        name, number = base, 1
        while name in _TAKEN or name in self._taken or name.startswith("can_") or name.endswith(("_may", "_holds")):
            number += 1
            name = f"{base}_{number}"
        self._taken.add(name)
        self.bearers[name] = bearer
        return name
