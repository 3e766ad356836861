"""SUAVE's node mission_metrics: when the mission asks for it, it writes the mission's row to its log."""

import json

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import TransitionEvent
from metrics import Metrics
from rcl_interfaces.msg import ParameterEvent
from std_msgs.msg import Bool, Float32, String
from suave_messages import seconds, values

from midstride import Component

comp = Component("mission_metrics")
state = comp.create_input("state", String)
detected = comp.create_input("detected", Bool)
distance = comp.create_input("distance", Float32)
diagnostics = comp.create_input("diagnostics", DiagnosticArray, qos=100)
transition = comp.create_input("transition", TransitionEvent, qos=100)
parameter_events = comp.create_input("parameter_events", ParameterEvent, qos=100)
save = comp.create_input("save", Bool)
inputs = [state, detected, distance, diagnostics, transition, parameter_events, save]
measure = comp.create_functionality("measure", inputs=inputs)
metrics = Metrics()


def on_state(message: String) -> None:
    if message.data == "GUIDED" and metrics.began is None:
        metrics.began = comp.clock.seconds()


def on_detected(message: Bool) -> None:
    if message.data and metrics.found is None:
        metrics.found = comp.clock.seconds()


def on_distance(message: Float32) -> None:
    metrics.inspected = message.data


def on_diagnostics(array: DiagnosticArray) -> None:
    for key, value in values(array):
        metrics.on_diagnostic(key, value, seconds(array.header.stamp))


def on_transition(event: TransitionEvent) -> None:
    metrics.on_transition(event.goal_state.label, comp.clock.seconds())


def on_parameters(event: ParameterEvent) -> None:
    for changed in event.changed_parameters:
        if changed.name == "spiral_altitude":
            metrics.on_altitude(changed.value.double_value, comp.clock.seconds())


def on_save(message: Bool) -> None:
    comp.logger.info(f"result {json.dumps(metrics.row(comp.clock.seconds()))}")


handlers = [on_state, on_detected, on_distance, on_diagnostics, on_transition, on_parameters, on_save]
measure.set_normal_mode(dict(zip(inputs, handlers, strict=True)), inputs=inputs)
measure.set_degraded_mode(lambda: None, name="off")
comp.start()
