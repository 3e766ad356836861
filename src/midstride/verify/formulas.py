"""Actions as formulas of the Alloy specification: precondition, whole action, and the reasons for a failure."""

from __future__ import annotations

from dataclasses import dataclass

from midstride.model.action import Action, Attach, Create, Degrade, Detach, Handover, Remove, SetParameters, Upgrade
from midstride.model.component import PortRef
from midstride.verify.world_encoder import NotEncoded, WorldEncoder


@dataclass(frozen=True, slots=True)
class Formula:
    """An action in a configuration.

    ``whole`` holds between the configurations before and after iff the precondition ``may`` holds before and the effect
    is the action's. ``clauses`` are the parts of the precondition that need no witness, each with its message if it
    fails. ``lacking`` is the set of functionality -> assumption that would no longer be satisfied, ``attached`` that of
    topic -> port that would have to be detached first.
    """

    may: str
    whole: str
    clauses: tuple[tuple[str, str], ...] = ()
    lacking: str = "none -> none"
    attached: str = "none -> none"


def formula(encoder: WorldEncoder, action: Action, before: str, after: str) -> Formula:
    """``action`` from the system ``before`` to the system ``after``. Raises NotEncoded."""
    s, t = before, after
    match action:
        case Create():
            c = encoder.components[action.instance.name]
            return Formula(
                f"can_create_within[{s}, {c}]",
                f"can_create_within[{s}, {c}] and create[{s}, {t}, {c}]",
                (
                    ("it is already live", f"{c} not in {s}.comps"),
                    ("a resource would be exceeded", f"capacities_hold[{s}.comps + {c}]"),
                ),
            )
        case Remove():
            c = encoder.components[action.instance]
            return Formula(
                f"can_remove[{s}, {c}]",
                f"remove[{s}, {t}, {c}]",
                (("it is not live", f"{c} in {s}.comps"),),
                attached=f"{s}.roles & Connector -> ports[{c}]",
            )
        case Attach():
            p, k = encoder.ports[action.port], encoder.connectors[action.connector]
            return Formula(
                f"can_attach_within[{s}, {k}, {p}]",
                f"can_attach_within[{s}, {k}, {p}] and attach[{s}, {t}, {k}, {p}]",
                (
                    ("its component is not live", f"{p} in ports[{s}.comps]"),
                    ("it is already attached there", f"{k} -> {p} not in {s}.roles"),
                    ("the contracts do not fit", f"fits[{k}, {p}]"),
                    ("the cap on publishers would be exceeded", f"cap_holds[{s}, {s}.roles + {k} -> {p}, {k}]"),
                ),
            )
        case Detach():
            p, k = encoder.ports[action.port], encoder.connectors[action.connector]
            return Formula(
                f"can_detach[{s}, {k}, {p}]",
                f"detach[{s}, {t}, {k}, {p}]",
                (("it is not attached there", f"{k} -> {p} in {s}.roles"),),
                lacking=f"unsatisfied[{s}, {s}.comps.funcs, {s}.roles - {k} -> {p}, {s}.cur_mode]",
            )
        case Degrade() | Upgrade():
            return _modes(encoder, action, s, t)
        case Handover():
            return _handover(encoder, action, s, t)
        case SetParameters():  # the specification has no parameters: the model checks whether they are changeable
            live = f"{encoder.components[action.instance]} in {s}.comps"
            return Formula(live, f"{live} and unchanged[{s}, {t}]", (("it is not live", live),))
    raise TypeError(f"no formula for {action!r}")


def _modes(encoder: WorldEncoder, action: Degrade | Upgrade, s: str, t: str) -> Formula:
    atoms = []
    for ref, index in sorted(action.modes.items()):
        functionality = encoder.functionalities[ref]
        if (ref, index) not in encoder.modes:
            raise NotEncoded(f"{ref} has no mode number {index}")
        atoms.append((functionality, encoder.modes[ref, index]))
    to = " + ".join(f"{functionality} -> {mode}" for functionality, mode in atoms) or "none -> none"
    fs = " + ".join(functionality for functionality, _ in atoms) or "none"
    if isinstance(action, Degrade):
        among, worse, direction = f"{s}.comps.funcs", "worse", f"({to})[f] in {s}.cur_mode[f].worse"
    else:
        among, worse, direction = f"({fs})", "better", f"{s}.cur_mode[f] in ({to})[f].worse"
    return Formula(
        f"can_{action.kind}_all[{s}, {to}]",
        f"{action.kind}_all[{s}, {t}, {to}]",
        (
            ("no functionality is named", f"some {fs}"),
            ("a functionality named is not live", f"{fs} in {s}.comps.funcs"),
            (f"a mode named is not {worse} than the current one", f"all f: {fs} | {direction}"),
        ),
        lacking=f"unsatisfied[{s}, {among}, {s}.roles, ({s}.cur_mode ++ ({to}))]",
    )


def _handover(encoder: WorldEncoder, action: Handover, s: str, t: str) -> Formula:
    swaps = [
        (encoder.connectors[swap.connector], _output(encoder, swap.old), _output(encoder, swap.new))
        for swap in action.swaps
    ]
    # Checked here because the specification cannot express it: a repeated swap is the same tuple, an input is in none.
    outputs = [each for each in swaps if all(port in encoder.atoms.sigs["Output"] for port in each[1:])]
    swap = " + ".join(" -> ".join(each) for each in outputs) or "none -> none -> none"
    ports = " + ".join(dict.fromkeys(port for each in outputs for port in each[1:])) or "none"
    new = " and ".join(f"satisfies_now[{s}, {k}, {n}]" for k, _, n in outputs) or "some univ"
    once = "some univ" if len(set(swaps)) == len(swaps) else "some none"
    only = "some univ" if len(outputs) == len(swaps) else "some none"
    may = f"{once} and {only} and can_handover_within[{s}, {swap}]"
    return Formula(
        may,
        f"{may} and handover[{s}, {t}, {swap}]",
        (
            ("no swap is named", "some univ" if swaps else "some none"),
            ("a port occurs twice on one topic", f"{once} and each_once[{swap}]"),
            ("a port is not an output of a live component", f"{only} and ({ports}) in {s}.comps.outputs"),
            ("the old output is not attached", f"leaving[{swap}] in {s}.roles"),
            ("the new output is already attached", f"no coming[{swap}] & {s}.roles"),
            ("the new output does not satisfy the topic in its current mode", new),
            (
                "the cap on publishers would be exceeded",
                f"all k: leaving[{swap}].Output | cap_holds[{s}, {s}.roles + coming[{swap}] - leaving[{swap}], k]",
            ),
        ),
    )


def _output(encoder: WorldEncoder, ref: PortRef) -> str:
    port = encoder.ports[ref]
    if port not in encoder.atoms.sigs["Output"]:
        raise NotEncoded(f"{ref} is an input, not an output")
    return port
