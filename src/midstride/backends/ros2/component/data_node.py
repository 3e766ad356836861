"""The data node of a component: it knows which parameters were set from outside, and what they were before.

That concerns parameters that are declared on the node itself, by the author or by ROS (``use_sim_time``). Those of
``Component.parameter`` are known to :class:`midstride.node.author.declared_parameters.Parameter`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterNotDeclaredException, ParameterUninitializedException
from rclpy.parameter import Parameter

from midstride.backends.ros2.component.admitting_node import AdmittingNode
from midstride.backends.ros2.component.parameter_services import as_json
from midstride.node.request_admission import RequestAdmission

# What ROS declares besides `use_sim_time` says how the node was made.
_FIXED: Final = ("qos_overrides.", "start_type_description_service")


class NodeParameter:
    """A parameter of the node, as :class:`midstride.node.component_host.HeldParameter` describes it."""

    def __init__(self, node: Any, name: str, declared: Any, set_from_outside: bool) -> None:
        self.name = name
        self.set_from_outside = set_from_outside
        self.closed = ""
        self._node = node
        self._declared = declared

    @property
    def value(self) -> Any:
        """None where it has none (any more), or one that cannot be written as JSON: of bytes."""
        try:
            return as_json(self._node.get_parameter(self.name).value)
        except (ParameterUninitializedException, ParameterNotDeclaredException):
            return None

    @property
    def declared(self) -> Any:
        """The value that it was started with. What the node's own code sets does not count as set at run time."""
        return self._declared if self.set_from_outside else self.value

    @declared.setter
    def declared(self, value: Any) -> None:
        self._declared = as_json(value)

    def fitted(self, value: Any) -> Any:
        return value  # the node checks it


class DataNode(AdmittingNode):
    """``parameters`` are the values that it is to have, ``set_parameters`` those that had been set at run time.

    ``changed`` is called on the data thread when a parameter has been set from outside.
    """

    def __init__(
        self,
        name: str,
        admission: RequestAdmission,
        *,
        parameters: Mapping[str, Any],
        set_parameters: Mapping[str, Any],
        **options: Any,
    ) -> None:
        self.changed: Callable[[], object] = lambda: None
        self._parameters_given = parameters
        self._parameters_set = set_parameters
        self._known: dict[str, NodeParameter] = {}
        # The type of an empty list is not known: it is set once the parameter is declared.
        begun = {name: value for name, value in {**parameters, **set_parameters}.items() if value != []}
        overrides = [Parameter(name, value=value) for name, value in begun.items()]
        super().__init__(name, admission, parameter_overrides=overrides, **options)

    def declare_parameters(self, namespace: str, parameters: Any, *arguments: Any, **options: Any) -> Any:
        parameters = list(parameters)
        declared = super().declare_parameters(namespace, parameters, *arguments, **options)
        for parameter, (_, *default) in zip(declared, parameters, strict=True):
            name, before = parameter.name, parameter.value
            if name in self._parameters_set:
                before = self._parameters_given.get(name, default[0] if default else None)
            self._known[name] = NodeParameter(self, name, as_json(before), name in self._parameters_set)
        return declared

    def held(self) -> dict[str, NodeParameter]:
        """The parameters that can be set, by name. Any thread."""
        known = self._known.copy().items()
        return {name: each for name, each in known if not name.startswith(_FIXED) and self.has_parameter(name)}

    def set_from_outside(self, parameters: list[Any]) -> Any:
        """Set all of them or none, as a client of the parameter services asks for it."""
        named = [self._known[each.name] for each in parameters if each.name in self._known]
        for parameter in named:
            if parameter.closed:
                reason = f"parameter {parameter.name} cannot be set any more: {parameter.closed}"
                return SetParametersResult(successful=False, reason=reason)
        result = self.set_parameters_atomically(parameters)
        if result.successful:
            for parameter in named:
                parameter.set_from_outside = True
            self.changed()
        return result
