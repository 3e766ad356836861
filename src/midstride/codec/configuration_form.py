"""The JSON form of a configuration: what is live, attached and in which mode, and the context it is in.

{"context": {"system": "world", "topics": …, "resources": …, "environment": …},   as in a specification
 "instances": [{"name": "talker_2", "role": "talker", "component": {"name": "NewTalker", …}, "parameters": {…}}],
 "attachments": [["talker_2.out", "/chatter"]],
 "modes": {"talker_2.talk": "normal"}}
"""

from __future__ import annotations

from typing import Annotated, ClassVar, TypeAlias

import msgspec
from msgspec import UNSET, UnsetType

from midstride.codec.component_form import NamedComponentForm, SharedProgramForm
from midstride.codec.form import Form, HostName, NonEmptyName, field
from midstride.codec.parameter import SectionForm, SectionsForm, ValueForm, values_form, values_of
from midstride.codec.reading import decode_form
from midstride.codec.specification_form import SpecificationForm
from midstride.errors import SpecificationError
from midstride.model.component import FunctionalityRef, PortRef, SharedContainer
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.diagnostics import Problem
from midstride.model.hosts import OWN_HOST
from midstride.model.specification import Specification

AttachmentForm: TypeAlias = Annotated[tuple[str, str], field("an attachment", "[port, topic]")]


class SharedContainerForm(SharedProgramForm, frozen=True, kw_only=True):
    """The container of a system that loads an instance."""

    what: ClassVar[str] = "a shared container"

    name: NonEmptyName
    sections: SectionsForm = []

    @classmethod
    def shared(cls, container: SharedContainer) -> SharedContainerForm:
        sections = [SectionForm.of(section) for section in container.sections]
        program = SharedProgramForm.of(container.program)
        return cls(**msgspec.structs.asdict(program), name=container.name, sections=sections)

    def container(self) -> SharedContainer:
        return SharedContainer(self.name, self.program(), tuple(form.section() for form in self.sections))


class InstanceForm(Form, frozen=True):
    """A running instance of a role's component, with the values of its parameters."""

    what: ClassVar[str] = "an instance"

    name: NonEmptyName
    role: NonEmptyName
    component: NamedComponentForm
    parameters: dict[str, ValueForm]
    sections: SectionsForm = []
    container: SharedContainerForm | UnsetType = UNSET
    process: str = ""
    host: HostName = OWN_HOST

    @classmethod
    def of(cls, instance: Instance) -> InstanceForm:
        return cls(
            name=instance.name,
            role=instance.role,
            component=NamedComponentForm.of(instance.component),
            parameters=values_form(instance.parameters),
            sections=[SectionForm.of(section) for section in instance.sections],
            container=UNSET if instance.container is None else SharedContainerForm.shared(instance.container),
            process=instance.process,
            host=instance.host,
        )

    def instance(self) -> Instance:
        """Raises SpecificationError where its component is faulty, ValueError where a parameter is."""
        sections = tuple(form.section() for form in self.sections)
        values = values_of(self.parameters)
        container = None if self.container is UNSET else self.container.container()
        component = self.component.checked()
        return Instance(self.name, self.role, component, values, sections, container, self.process, self.host)


class ConfigurationForm(Form, frozen=True):
    """A configuration, with the topics, resources and environment that it lives in."""

    what: ClassVar[str] = "a configuration"

    context: SpecificationForm
    instances: list[InstanceForm]
    attachments: Annotated[list[AttachmentForm], field("a list of attachments")]
    modes: Annotated[dict[str, str], field("an object of modes", "the current mode of each functionality")]

    @classmethod
    def of(cls, configuration: Configuration) -> ConfigurationForm:
        world = configuration.context
        around = Specification(
            "world", connectors=world.connectors, environment=world.environment, resources=world.resources
        )
        return cls(
            context=SpecificationForm.of(around),
            instances=[InstanceForm.of(instance) for _, instance in sorted(configuration.instances.items())],
            attachments=[(str(port), connector) for port, connector in sorted(configuration.attachments())],
            modes={str(ref): configuration.mode(ref).name for ref in sorted(configuration.modes)},
        )

    def configuration(self) -> Configuration:
        """The configuration; nothing is judged. Raises SpecificationError where the parts do not fit together."""
        live = {form.name: form.instance() for form in self.instances}
        modes = {}
        for text, mode in self.modes.items():
            ref = FunctionalityRef.parse(text)
            try:
                functionality = live[ref.instance].component.functionalities[ref.functionality]
                modes[ref] = functionality.mode_index(mode)
            except KeyError as error:
                message = f"no instance here has {error.args[0]!r}, which {text} in mode {mode} speaks of"
                raise SpecificationError([Problem("E008", ("modes", text), message)]) from None
        attachments = [(PortRef.parse(port), connector) for port, connector in self.attachments]
        try:
            return configure(self.context.specification().context, live.values(), attachments, modes)
        except (KeyError, ValueError) as error:
            raise SpecificationError(f"not a configuration: {error}") from None


def decode_configuration(document: object) -> Configuration:
    """The configuration that a document states; nothing is judged. Raises SpecificationError where it is none."""
    return decode_form(document, ConfigurationForm).configuration()
