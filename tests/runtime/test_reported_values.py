"""The values that were set at run time, as the manager knows them once their node has crashed."""

from __future__ import annotations

from midstride.model.component import ComponentSpec
from midstride.model.configuration import Configuration, Instance
from midstride.plan.runtime_values import Values
from midstride.runtime.watch.reported_values import ReportedValues
from tests.wire.bare_state import bare_state


def test_who_has_set_a_value_is_known_after_the_crash_of_its_node_but_not_to_the_next_manager() -> None:
    runs = Configuration().with_instance(Instance("camera", "camera", ComponentSpec.of("Camera", gate="preload")))
    values = ReportedValues()
    values.update_saved(runs, {"camera": None})
    assert values.unknown_after("camera") is None, "it has not reported"
    state = bare_state(
        "camera",
        parameters={"gain": 2.0, "rate": 5.0, "mode": "b"},
        declared={"gain": 1.0, "rate": 1.0, "mode": "a"},
        unknown_origin=["rate", "mode"],
        own_values=["mode"],
    )
    values.report(state)
    set_values: Values = {"gain": 2.0, "rate": 5.0, "mode": "b"}
    assert values.update_saved(runs, {"camera": None}) == {"camera": set_values}
    values.update_saved(Configuration(), {"camera": None})
    values.forget_ended(Configuration())
    assert values.by_role(Configuration()) == {"camera": set_values}
    assert values.unknown_after("camera") == {"rate": "unknown", "mode": "node"}
    assert ReportedValues({"camera": set_values}).unknown_after("camera") is None
    values.update_saved(Configuration(), {})
    assert values.unknown_after("camera") is None
