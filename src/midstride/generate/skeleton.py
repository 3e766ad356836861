"""The contents of a component's skeleton: imports, declarations, the wiring of modes, a method per mode."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import SpecificationError
from midstride.generate.generated_names import AttributeNames
from midstride.model.component import ComponentSpec, EnvironmentGuarantee, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import OneOf, Predicate, QoS, Scalar, ValueSet, format_number, satisfies

# Attributes of every skeleton.
_RESERVED: Final = ("component", "wire", "start")
# Names that a skeleton imports; a class of the same name is renamed.
_IMPORTED: Final = ("Component", "QoS", "Interval", "any_of", "at_least", "at_most", "between", "guarantee")


@dataclass(frozen=True, slots=True)
class Method:
    """A method of the skeleton: a mode, or the callback of a changed parameter."""

    name: str
    arguments: str
    about: str
    body: tuple[str, ...]


@dataclass(slots=True)
class Skeleton:
    """The input of the component template, as lines of Python."""

    name: str
    node: str
    midstride: list[str] = field(default_factory=list)
    imports: list[str] = field(default_factory=list)
    declarations: list[str] = field(default_factory=list)
    wiring: list[str] = field(default_factory=list)
    methods: list[Method] = field(default_factory=list)
    packages: list[str] = field(default_factory=list)


def skeleton(component: ComponentSpec, node: str, environment: tuple[EnvironmentGuarantee, ...] = ()) -> Skeleton:
    """The skeleton of ``component``, with the default node name ``node``.

    Raises SpecificationError if no mode states the type of an output, or if it has ROS actions.
    """
    if actions := [port for port in component.service_ports() if component.kind_of(port) == "action"]:
        raise SpecificationError(f"the ROS actions of {component.name} ({', '.join(actions)}) cannot be generated yet")
    name = f"{component.name}Node" if component.name in _IMPORTED else component.name
    return _Builder(component, environment, Skeleton(name, node)).build()


@dataclass(slots=True)
class _Builder:
    component: ComponentSpec
    environment: tuple[EnvironmentGuarantee, ...]
    result: Skeleton
    names: AttributeNames = field(default_factory=lambda: AttributeNames(_RESERVED))
    used: set[str] = field(default_factory=lambda: {"Component"})
    classes: dict[str, str] = field(default_factory=dict)  # the class name of each message type
    ports: dict[str, str] = field(default_factory=dict)

    def build(self) -> Skeleton:
        result, component = self.result, self.component
        self._import_types()
        for name in component.input_order:
            self.ports[name] = self.names.take(name, "input")
            if component.is_service(name):
                arguments = [repr(name), self.classes[component.inputs[name].type], *_within([component.inputs[name]])]
                result.declarations.append(f"{self.ports[name]} = self.component.create_client({', '.join(arguments)})")
                continue
            arguments = [repr(name), *self._stated(component.inputs[name])]
            if name in component.tolerates:
                arguments.append(f"tolerates={component.tolerates[name]}")
            if name in component.conditions:
                arguments.append("condition=True")
            result.declarations.append(f"{self.ports[name]} = self.component.create_input({', '.join(arguments)})")
        for name in component.outputs:
            self.ports[name] = self.names.take(name, "output")
            type_, qos = self._endpoint(name)
            if component.is_service(name):
                self._server(name, self.classes[type_])
                continue
            arguments = [repr(name), self.classes[type_], *self._qos(qos)]
            result.declarations.append(f"{self.ports[name]} = self.component.create_output({', '.join(arguments)})")
        self._parameters()
        for functionality in component:
            self._functionality(functionality)
        result.midstride = sorted(self.used, key=lambda name: (name[0].islower(), name))
        return result

    def _server(self, name: str, type_: str) -> None:
        modes = self.component.owner(name).modes
        stated = [mode.guarantees[name] for mode in modes if name in mode.guarantees]
        method = self.names.take(f"answer_{name}")
        about = f"Answers a request to `{name}`: fill the response."
        arguments = f"self, request: {type_}.Request, response: {type_}.Response"
        self.result.methods.append(Method(method, arguments, about, ()))
        created = ", ".join([repr(name), type_, f"self.{method}", *_within(stated)])
        self.result.declarations.append(f"{self.ports[name]} = self.component.create_server({created})")

    def _endpoint(self, output: str) -> tuple[str, QoS]:
        endpoint = self.component.output_endpoint(output)
        if endpoint is None:
            owner = self.component.owner(output)
            raise SpecificationError(
                f"output {output} of {self.component.name} has no type: no mode of {owner.name} guarantees anything"
            )
        return endpoint

    # -- types ---------------------------------------------------------------------------------------------

    def _import_types(self) -> None:
        types = {self.component.inputs[name].type for name in self.component.input_order}
        types |= {self._endpoint(output)[0] for output in self.component.outputs}
        names: dict[str, list[str]] = {}
        for type_ in sorted(types):
            names.setdefault(type_.rpartition("/")[2], []).append(type_)
        modules: dict[tuple[str, str], list[str]] = {}
        for name, alike in names.items():
            for type_ in alike:
                package, folder, _ = type_.split("/")
                own = name in {*_IMPORTED, self.result.name, f"{self.result.name}Base"} or len(alike) > 1
                called = f"{package.title().replace('_', '')}{name}" if own else name
                self.classes[type_] = called
                modules.setdefault((package, folder), []).append(name if called == name else f"{name} as {called}")
        for (package, folder), imported in sorted(modules.items()):
            self.result.imports.append(f"from {package}.{folder} import {', '.join(imported)}")
            if package not in self.result.packages:
                self.result.packages.append(package)

    def _stated(self, predicate: Predicate) -> Iterator[str]:
        """An input's assumption as arguments."""
        yield self.classes[predicate.type]
        if predicate.rate is not None:
            yield f"rate={format_number(predicate.rate)}"
        yield from self._qos(predicate.qos)
        if predicate.fields:
            yield f"where={self._where(predicate.fields)}"

    def _qos(self, qos: QoS) -> Iterator[str]:
        stated = [f"{name}={value!r}" for name in QoS.__slots__ if (value := getattr(qos, name)) is not None]
        if stated:
            self.used.add("QoS")
            yield f"qos=QoS({', '.join(stated)})"

    def _where(self, fields: tuple[tuple[str, ValueSet], ...]) -> str:
        return "{" + ", ".join(f"{path!r}: {self._values(values)}" for path, values in fields) + "}"

    def _values(self, values: ValueSet) -> str:
        if isinstance(values, OneOf):
            members = [repr(value) for value in values.values]
            return members[0] if len(members) == 1 else "{" + ", ".join(members) + "}"
        low, high = values.low, values.high
        if values.low_open or values.high_open or (math.isinf(low) and math.isinf(high)):
            if "from midstride.model.contract import Interval" not in self.result.imports:
                self.result.imports.insert(0, "from midstride.model.contract import Interval")
            ends = [f'float("{end}")' if math.isinf(end) else repr(end) for end in (low, high)]
            return f"Interval({ends[0]}, {ends[1]}, low_open={values.low_open}, high_open={values.high_open})"
        helper = "at_most" if math.isinf(low) else "at_least" if math.isinf(high) else "between"
        self.used.add(helper)
        return f"{helper}({', '.join(format_number(end) for end in (low, high) if not math.isinf(end))})"

    # -- parameters ------------------------------------------------------------------------------------------

    def _parameters(self) -> None:
        for name, parameter in sorted(self.component.parameters.items()):
            attribute = self.names.take(name, "parameter")
            change = ""
            if parameter.changeable:
                method = self.names.take(f"{attribute}_changed")
                change = f", on_change=self.{method}"
                about = f"Called when `{name}` is set; raise an exception to reject the value."
                self.result.methods.append(Method(method, "self, value: object", about, ()))
            created = f"self.component.parameter({name!r}, {parameter.value!r}{change})"
            self.result.declarations.append(f"{attribute} = {created}")

    # -- functionalities ---------------------------------------------------------------------------------------

    def _functionality(self, functionality: FunctionalitySpec) -> None:
        attribute = self.names.take(functionality.name, "functionality")
        arguments = [repr(functionality.name)]
        if functionality.inputs:
            arguments.append(f"inputs={self._ports(functionality.inputs)}")
        if functionality.outputs:
            arguments.append(f"outputs={self._ports(functionality.outputs)}")
        if functionality.weight not in {0, 1}:  # the API does not accept 0, and the manager uses the specification's
            arguments.append(f"weight={format_number(functionality.weight)}")
        created = f"self.component.create_functionality({', '.join(arguments)})"
        self.result.declarations.append(f"{attribute} = {created}")
        for index, mode in enumerate(functionality.modes):
            self._mode(functionality, attribute, index, mode)

    def _ports(self, names: tuple[str, ...]) -> str:
        return "[" + ", ".join(f"self.{self.ports[name]}" for name in names) + "]"

    def _mode(self, functionality: FunctionalitySpec, attribute: str, index: int, mode: Mode) -> None:
        guarantees = [(name, mode.guarantees[name]) for name in functionality.outputs if name in mode.guarantees]
        rates = [guarantee.rate for _, guarantee in guarantees if guarantee.rate is not None]
        assumed = list(self._assumed(functionality, mode))
        inputs = [name for names in assumed for name in names if not self.component.is_service(name)]
        method = self.names.take(f"{functionality.name}_{mode.name}")
        body = tuple(line for name, guarantee in guarantees for line in self._write(name, guarantee))
        about = self._about(functionality, mode)
        called = f"self.{method}"
        if rates or not inputs:
            self.result.methods.append(Method(method, "self", about, body))
        elif len(dict.fromkeys(inputs)) == 1:
            type_ = self.classes[self.component.inputs[inputs[0]].type]
            self.result.methods.append(Method(method, f"self, message: {type_}", about, body))
        else:
            entries = []
            for name in dict.fromkeys(inputs):
                handler = self.names.take(f"{method}_{name}")
                type_ = self.classes[self.component.inputs[name].type]
                text = f"{about[:-1]}; handles a message on `{name}`."
                self.result.methods.append(Method(handler, f"self, message: {type_}", text, body))
                entries.append(f"self.{self.ports[name]}: self.{handler}")
            called = "{" + ", ".join(entries) + "}"
        arguments = [called]
        if rates:
            arguments.append(f"rate={format_number(max(rates))}")
        if assumed:
            arguments.append(f"inputs=[{', '.join(self._alternatives(names) for names in assumed)}]")
        if guarantees:
            arguments.append(f"outputs={self._ports(tuple(name for name, _ in guarantees))}")
        constrained = [(name, guarantee) for name, guarantee in guarantees if guarantee.fields]
        if constrained:
            self.used.add("guarantee")
            entries = [f"self.{self.ports[n]}: guarantee(where={self._where(g.fields)})" for n, g in constrained]
            arguments.append(f"guarantees={{{', '.join(entries)}}}")
        setter = "set_degraded_mode" if index == functionality.last_mode else "set_normal_mode"
        if 0 < index < functionality.last_mode:
            setter, arguments = "set_mode", [repr(mode.name), *arguments]
        elif setter != f"set_{mode.name}_mode":
            arguments.append(f"name={mode.name!r}")
        self.result.wiring.append(f"self.{attribute}.{setter}({', '.join(arguments)})")

    def _assumed(self, functionality: FunctionalitySpec, mode: Mode) -> Iterator[tuple[str, ...]]:
        """The inputs of each assumption, except those that the environment satisfies."""
        for assumption in mode.assumptions:
            if isinstance(assumption, InputAlternatives):
                yield assumption.inputs
                continue
            if any(offer.topic is None and satisfies(offer.guarantee, assumption) for offer in self.environment):
                continue
            alike = tuple(n for n in functionality.inputs if satisfies(self.component.inputs[n], assumption))
            if alike:
                yield alike

    def _alternatives(self, names: tuple[str, ...]) -> str:
        if len(names) == 1:
            return f"self.{self.ports[names[0]]}"
        self.used.add("any_of")
        return f"any_of({', '.join(f'self.{self.ports[name]}' for name in names)})"

    def _about(self, functionality: FunctionalitySpec, mode: Mode) -> str:
        assumed = ", ".join(str(assumption) for assumption in mode.assumptions) or "nothing"
        text = f"Mode {mode.name} of {functionality.name}; assumes {assumed}."
        return text.replace("\\", "/").replace('"', "'")

    def _write(self, output: str, guarantee: Predicate) -> Iterator[str]:
        """Code that writes a message which meets the guarantee."""
        if guarantee.kind != "topic":
            return
        type_ = self.classes[guarantee.type]
        if not guarantee.fields:
            yield f"self.{self.ports[output]}.write({type_}())"
            return
        message = f"{self.ports[output]}_message"
        yield f"{message} = {type_}()"
        for path, values in guarantee.fields:
            yield f"{message}.{path} = {_example_value(values)!r}"
        yield f"self.{self.ports[output]}.write({message})"


def _within(stated: Iterable[Predicate]) -> list[str]:
    """The shortest bound that is stated, as an argument; none where none is."""
    bounds = [each.within for each in stated if each.within is not None]
    return [f"within={format_number(min(bounds))}"] if bounds else []


def _example_value(values: ValueSet) -> Scalar:
    """One of the values; a whole number if possible, because the field may be an integer."""
    if isinstance(values, OneOf):
        return values.values[0]
    candidates: list[float] = [0.0]
    for end in (values.low, values.high):
        if math.isfinite(end):
            candidates += [math.ceil(end), math.floor(end), end, end + 1, end - 1]
    candidates.append((values.low + values.high) / 2)
    found = next((value for value in candidates if value in values), values.low)
    return int(found) if found == int(found) else found
