"""What must hold of every system, as functions of drawn data. `test_properties` runs them, briefly and at length."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import assume
from hypothesis import strategies as st
from immutables import Map

from midstride.codec.component_form import decode_component, encode_component
from midstride.codec.contract_form import PredicateForm
from midstride.codec.form import encode
from midstride.codec.reading import decode_form
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import ActionRefused, SpecificationError
from midstride.model.action import Action
from midstride.model.best import best, consumers_of, lowered, rebalanced
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.contract import NOTHING, Predicate, explain, satisfies
from midstride.model.rules import violations
from midstride.model.specification import initial
from midstride.model.specification_checks import check, errors
from tests.model import twin
from tests.strategies.actions import actions
from tests.strategies.systems import (
    GeneratedSystem,
    components,
    contracts,
    predicates,
    scenes,
    specifications,
    stronger,
    value_sets,
)

Property = Callable[[st.DataObject], None]
STEPS = 6


# -- contracts -------------------------------------------------------------------------------------------


def satisfaction_is_the_twins(data: st.DataObject) -> None:
    p, q = data.draw(contracts()), data.draw(contracts())
    expected = twin.satisfies(twin.of_contract(p), twin.of_contract(q))
    assert satisfies(p, q) == expected
    assert (not explain(p, q)) == expected


def satisfaction_is_reflexive_but_for_nothing(data: st.DataObject) -> None:
    p = data.draw(contracts())
    assert satisfies(p, p) == (p is not NOTHING)
    if isinstance(p, Predicate):
        assert satisfies(p, replace(p))
    assert not satisfies(NOTHING, p)
    assert not satisfies(p, NOTHING)


def satisfaction_is_transitive(data: st.DataObject) -> None:
    r = data.draw(predicates())
    q = data.draw(st.one_of(stronger(r), predicates()))
    p = data.draw(st.one_of(stronger(q), predicates()))
    if satisfies(p, q) and satisfies(q, r):
        assert satisfies(p, r)


def stronger_satisfies(data: st.DataObject) -> None:
    """The strategy keeps its word; else the chains it makes would prove nothing."""
    weaker = data.draw(predicates())
    assert satisfies(data.draw(stronger(weaker)), weaker)


def intersection_is_what_both_hold(data: st.DataObject) -> None:
    one, other = data.draw(value_sets()), data.draw(value_sets())
    both = one.intersection(other)
    for value in (-1, 0, 0.5, 1, 1.5, 2, 2.5, 3, 4, True, False, "rgb8", "bgr8", "mono"):
        assert (value in both) == (value in one and value in other)
    assert both.is_subset(one)
    assert both.is_subset(other)
    assert one.intersection(other).is_empty == other.intersection(one).is_empty


# -- configurations and actions --------------------------------------------------------------------------


def _walk(data: st.DataObject, visit: Callable[[Configuration, Action], None]) -> None:
    """Along a sequence of actions, taken where they may be."""
    scene = data.draw(scenes())
    for _ in range(STEPS):
        action = data.draw(actions(scene))
        visit(scene.configuration, action)
        if not action.check(scene.configuration):
            scene = GeneratedSystem(action.apply(scene.configuration), scene.components)


def preconditions_and_effects_are_the_twins(data: st.DataObject) -> None:
    def visit(configuration: Configuration, action: Action) -> None:
        plain = twin.of_configuration(configuration)
        reasons = action.check(configuration)
        assert (not reasons) == twin.allowed(plain, action), (action.describe(configuration), reasons)
        if not reasons:
            assert twin.of_configuration(action.apply(configuration)) == twin.effect(plain, action)

    _walk(data, visit)


def actions_keep_what_is_valid(data: st.DataObject) -> None:
    def visit(configuration: Configuration, action: Action) -> None:
        if not action.check(configuration):
            after = action.apply(configuration)
            assert not violations(after)
            assert twin.valid(twin.of_configuration(after))

    _walk(data, visit)


def undo_undoes(data: st.DataObject) -> None:
    """Exactly, by steps each of which is itself accepted; and what is derived does not depend on the way."""

    def visit(configuration: Configuration, action: Action) -> None:
        if action.check(configuration):
            return
        back = action.apply(configuration)
        assert back == _from_scratch(back)
        for step in action.undo(configuration):
            back = step.apply(back)
            assert not violations(back)
        assert back == configuration

    _walk(data, visit)


def plans_roll_back(data: st.DataObject) -> None:
    """F6 for a sequence: each action undone in turn, last first."""
    taken: list[tuple[Configuration, Action]] = []

    def visit(configuration: Configuration, action: Action) -> None:
        if not action.check(configuration):
            taken.append((configuration, action))

    _walk(data, visit)
    if taken:
        configuration = taken[-1][1].apply(taken[-1][0])
        for before, action in reversed(taken):
            for step in action.undo(before):
                configuration = step.apply(configuration)
            assert configuration == before


def refusals_say_why(data: st.DataObject) -> None:
    def visit(configuration: Configuration, action: Action) -> None:
        reasons = action.check(configuration)
        if not reasons:
            return
        with pytest.raises(ActionRefused) as refused:
            action.apply(configuration)
        assert refused.value.reasons == reasons
        for reason in reasons:
            assert reason.precondition
            assert reason.because in str(refused.value)
            assert reason.subjects or reason.precondition == "named"
            unsaid = [name for name in reason.subjects[:1] if name.rpartition(".")[2] not in str(refused.value)]
            assert not unsaid

    _walk(data, visit)


def _from_scratch(configuration: Configuration) -> Configuration:
    return configure(
        configuration.context, configuration.instances.values(), configuration.attachments(), dict(configuration.modes)
    )


def violations_are_the_twins(data: st.DataObject) -> None:
    """In any modes, and with caps and capacities exceeded."""
    configuration = data.draw(scenes()).configuration
    modes = {
        ref: data.draw(st.integers(0, configuration.functionality(ref).last_mode))
        for ref in sorted(configuration.modes)
    }
    configuration = configuration.with_modes(modes)
    if data.draw(st.booleans()):
        capped = {name: replace(c, max_publishers=1) for name, c in configuration.context.connectors.items()}
        resources = {name: replace(r, capacity=0.2) for name, r in configuration.context.resources.items()}
        configuration = configuration.with_context(
            replace(configuration.context, connectors=Map(capped), resources=Map(resources))
        )
    assert (not violations(configuration)) == twin.valid(twin.of_configuration(configuration))


# -- best ------------------------------------------------------------------------------------------------


def _plain(modes: Map[FunctionalityRef, int]) -> dict[twin.Functionality, int]:
    return {(ref.instance, ref.functionality): index for ref, index in modes.items()}


def best_is_the_twins(data: st.DataObject) -> None:
    configuration = best(data.draw(scenes()).configuration)
    assert not violations(configuration)
    assert _plain(configuration.modes) == twin.best(twin.of_configuration(configuration))
    assert best(configuration) == configuration


def best_is_the_greatest(data: st.DataObject) -> None:
    """Among all valid assignments of a small system, found by trying them; pointwise (F2)."""
    configuration = data.draw(scenes(most=3)).configuration
    count = 1
    for ref in configuration.modes:
        count *= len(configuration.functionality(ref).modes)
    assume(count <= 100)
    found = _plain(best(configuration).modes)
    valid = twin.valid_assignments(twin.of_configuration(configuration))
    assert found in valid
    assert all(found[f] <= modes[f] for modes in valid for f in modes)
    for one in valid:  # closed under the pointwise better of two
        assert {f: min(one[f], found[f]) for f in one} in valid


def rebalanced_is_best(data: st.DataObject) -> None:
    """After any changes to the structure, several at once, whether or not an action would allow them."""
    scene = data.draw(scenes())
    configuration = best(scene.configuration)
    seeds: set[FunctionalityRef] = set()
    for _ in range(data.draw(st.integers(1, 4))):
        configuration = _changed(data, scene, configuration, seeds)
    changes = rebalanced(configuration, sorted(ref for ref in seeds if ref.instance in configuration.instances))
    assert configuration.with_modes(changes) == best(configuration)
    assert all(configuration.modes[ref] != index for ref, index in changes.items())


def _changed(
    data: st.DataObject, scene: GeneratedSystem, configuration: Configuration, seeds: set[FunctionalityRef]
) -> Configuration:
    kind = data.draw(st.sampled_from(("attach", "attach", "detach", "detach", "create", "remove")))
    name = data.draw(st.sampled_from(sorted(configuration.instances))) if configuration.instances else ""
    if kind == "create":
        new = Instance(f"new{len(seeds)}", "new", data.draw(st.sampled_from(scene.components)))
        if new.name not in configuration.instances:
            configuration = configuration.with_instance(new)
            seeds.update(new.functionality_refs())
    elif kind == "remove" and name:
        for port, connector in configuration.attached_ports(name):
            seeds.update(consumers_of(configuration, port, connector))
        configuration = configuration.without_instance(name)
    elif kind == "attach" and name and (ports := configuration.component(name).ports()):
        port = PortRef(name, data.draw(st.sampled_from(ports)))
        connector = data.draw(st.sampled_from(sorted(configuration.context.connectors)))
        if not configuration.is_attached(port, connector):
            configuration = configuration.with_attachment(port, connector)
            seeds.update(consumers_of(configuration, port, connector))
    elif kind == "detach" and (attached := sorted(configuration.attachments())):
        port, connector = data.draw(st.sampled_from(attached))
        seeds.update(consumers_of(configuration, port, connector))
        configuration = configuration.without_attachment(port, connector)
    return configuration


def rebalanced_keeps_below_a_ceiling(data: st.DataObject) -> None:
    scene = data.draw(scenes())
    top = {
        ref: data.draw(st.integers(0, scene.configuration.functionality(ref).last_mode))
        for ref in sorted(scene.configuration.modes)
    }
    configuration = _below(scene.configuration, top)
    seeds: set[FunctionalityRef] = set()
    for _ in range(2):
        configuration = _changed(data, scene, configuration, seeds)
    top.update({ref: 0 for ref in configuration.modes if ref not in top})
    live = sorted(ref for ref in seeds if ref.instance in configuration.instances)
    assert configuration.with_modes(rebalanced(configuration, live, lambda ref: top[ref])) == _below(configuration, top)


def _below(configuration: Configuration, top: dict[FunctionalityRef, int]) -> Configuration:
    """The best assignment no better than ``top``, as the twin would find it."""
    configuration = configuration.with_modes({ref: index for ref, index in top.items() if ref in configuration.modes})
    while True:
        plain = twin.of_configuration(configuration)
        unsatisfied = [
            ref for ref in configuration.modes if not twin.satisfied(plain, (ref.instance, ref.functionality))
        ]
        if not unsatisfied:
            return configuration
        configuration = configuration.with_modes({unsatisfied[0]: configuration.modes[unsatisfied[0]] + 1})


def lowered_is_the_least_degradation(data: st.DataObject) -> None:
    """F3: after detaching, from where one stands."""
    configuration = data.draw(scenes()).configuration
    seeds: list[FunctionalityRef] = []
    for port, connector in sorted(configuration.attachments()):
        if data.draw(st.booleans()):
            seeds += consumers_of(configuration, port, connector)
            configuration = configuration.without_attachment(port, connector)
    assert configuration.with_modes(lowered(configuration, seeds)) == _below(configuration, dict(configuration.modes))


# -- specifications --------------------------------------------------------------------------------------


def documents_come_back(data: st.DataObject) -> None:
    specification = data.draw(specifications())
    document = encode_specification(specification)
    again = json.loads(json.dumps(document))
    assert again == document
    assert decode_specification(again) == specification
    component = data.draw(components())
    assert decode_component(json.loads(json.dumps(encode_component(component)))) == component
    predicate = data.draw(predicates())
    again = json.loads(json.dumps(encode(PredicateForm.of(predicate))))
    assert decode_form(again, PredicateForm).predicate() == predicate


def spoilt_documents_are_refused_or_read(data: st.DataObject) -> None:
    """Whatever is put in whatever place: a specification, or SpecificationError with a path; nothing else."""
    document = encode_specification(data.draw(specifications(most=2)))
    for _ in range(data.draw(st.integers(1, 3))):
        _spoil(data, document)
    problems: tuple[Any, ...] = ()
    try:
        specification = decode_specification(document)
    except SpecificationError as error:
        problems = error.problems
        assert problems  # what else it may raise must come through
    else:
        check(specification)  # whatever it finds, it returns
    assert all(problem.path.startswith("/") and problem.severity == "error" for problem in problems)


def _spoil(data: st.DataObject, document: dict[str, Any]) -> None:
    strange = data.draw(st.sampled_from((None, True, -1, float("nan"), 10**400, "", "x", [], ["x"], {}, {"x": 1})))
    here: Any = document
    while True:
        keys = list(here) if isinstance(here, dict) else list(range(len(here)))
        key = data.draw(st.sampled_from(keys))
        deeper = isinstance(here[key], (dict, list)) and here[key]
        if deeper and data.draw(st.integers(0, 4)):
            here = here[key]
            continue
        how = data.draw(st.sampled_from(("put", "drop", "rename")))
        if how == "put" or not isinstance(here, dict):
            here[key] = strange
        elif how == "drop":
            del here[key]
        else:
            here[key + "x"] = here.pop(key)
        return


def drawn_specifications_are_well_formed(data: st.DataObject) -> None:
    specification = data.draw(specifications())
    problems = check(specification)
    assert not errors(problems)
    assert problems == check(specification)
    configuration = initial(specification)
    assert not violations(configuration)
    warned = {problem.subject[1] for problem in problems if problem.code == "W033"}
    assert warned == {ref.instance for ref, index in configuration.modes.items() if index > 0}


PROPERTIES: dict[Property, int] = {  # how many examples at each run of the tests
    satisfaction_is_the_twins: 300,
    satisfaction_is_reflexive_but_for_nothing: 100,
    satisfaction_is_transitive: 300,
    stronger_satisfies: 100,
    intersection_is_what_both_hold: 200,
    preconditions_and_effects_are_the_twins: 150,
    actions_keep_what_is_valid: 100,
    undo_undoes: 150,
    plans_roll_back: 80,
    refusals_say_why: 80,
    violations_are_the_twins: 150,
    best_is_the_twins: 150,
    best_is_the_greatest: 80,
    rebalanced_is_best: 200,
    rebalanced_keeps_below_a_ceiling: 80,
    lowered_is_the_least_degradation: 80,
    documents_come_back: 100,
    spoilt_documents_are_refused_or_read: 150,
    drawn_specifications_are_well_formed: 100,
}
