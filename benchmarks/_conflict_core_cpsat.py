"""The changes of the published set as a model for CP-SAT, written from docs/semantics.md and not from the planner.

One creation or removal for each place in the sequence. During it, the creations before it and the removals up to it are
done (the worse level counts). A role is absent between the removal of its old instance and the creation of its new one;
exclusive topics are handed over, so they forbid no order. No topic is read before what supplies it, so the modes
follow without a fixed point. Durations are whole quarters of a second in this set.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Final

from ortools.sat.python import cp_model

from midstride.model.component import InputAlternatives
from midstride.plan.change import Change

QUARTERS = 4
_LOOK: Final = 0.05  # how often the processor's time is looked at (s)


def solve(change: Change, seconds: float) -> tuple[bool, float, float]:
    """Whether the least disruption is proved within ``seconds`` of the processor, the best plan's, and the bound.

    The solver counts the clock, which other load makes longer: so it is watched, and stopped from beside it. What it
    takes to make the model counts too.
    """
    end = time.process_time() + seconds
    model = cp_model.CpModel()
    ops = [("create", each.name) for each in change.coming] + [("remove", name) for name in change.leaving]
    places = range(len(ops))
    at = {(op, place): model.new_bool_var(f"{op} at {place}") for op in ops for place in places}
    for op in ops:
        model.add_exactly_one(at[op, place] for place in places)
    for place in places:
        model.add_exactly_one(at[op, place] for op in ops)

    def done(op: tuple[str, str], before: int) -> Any:
        """Whether it is done before a place: at most 1."""
        return sum(at[op, place] for place in range(before))

    _room(model, change, done, places)
    costs = []
    for place in places:
        losses = _losses(model, change, done, place)
        most = sum(weight for weight, _ in losses)
        cost = model.new_int_var(0, most * 4 * QUARTERS, f"cost {place}")
        loss = sum(weight * lost for weight, lost in losses)
        for op in ops:
            taken = round(change.seconds(op[0], change.component_of(op[1])) * QUARTERS)
            model.add(cost >= taken * loss).only_enforce_if(at[op, place])
        costs.append(cost)
    model.minimize(sum(costs))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solved = threading.Event()

    def watch() -> None:
        while time.process_time() < end and not solved.wait(_LOOK):
            pass
        while not solved.wait(_LOOK):  # what is asked before the solver has begun is lost
            solver.stop_search()

    watching = threading.Thread(target=watch)
    watching.start()
    try:
        status = solver.solve(model)
    finally:
        solved.set()
        watching.join()
    best = solver.objective_value / QUARTERS if status in (cp_model.OPTIMAL, cp_model.FEASIBLE) else float("inf")
    return status == cp_model.OPTIMAL, best, solver.best_objective_bound / QUARTERS


def _room(model: cp_model.CpModel, change: Change, done: Any, places: range) -> None:
    context = change.start.context
    for resource in context.resources:
        held = {name: round(change.component_of(name).resource_usage.get(resource, 0)) for name in change.leaving}
        needed = {each.name: round(each.component.resource_usage.get(resource, 0)) for each in change.coming}
        for place in places:
            old = sum(amount * (1 - done(("remove", name), place)) for name, amount in held.items() if amount)
            new = sum(amount * done(("create", name), place + 1) for name, amount in needed.items() if amount)
            model.add(old + new <= round(context.capacity(resource)))


def _losses(model: cp_model.CpModel, change: Change, done: Any, place: int) -> list[tuple[int, Any]]:
    """The weights of the levels that can be lost at a place, and whether they are (at least)."""
    start, found = change.start, list[tuple[int, Any]]()
    silent: dict[str, Any] = {}
    for role in sorted(start.instances):  # in the order in which they read each other
        (functionality,) = start.component(role)
        new = change.replaced.get(role)
        absent: Any = 0
        if new is not None:
            absent = model.new_bool_var(f"{role} absent at {place}")
            model.add(absent >= done(("remove", role), place + 1) - done(("create", new), place))
        *better, _ = functionality.modes
        worse: Any = absent
        for mode in better:
            bad = model.new_bool_var(f"{role} not {mode.name} at {place}")
            model.add(bad >= absent)
            for needs in mode.assumptions:
                assert isinstance(needs, InputAlternatives)
                model.add(bad >= sum(silent["/" + name] for name in needs.inputs) - len(needs.inputs) + 1)
            found.append((round(functionality.weight), bad))
            worse = bad
        if new is not None:
            found.append((round(functionality.weight), absent))
        for output in functionality.outputs:
            silent["/" + output] = worse
    return found
