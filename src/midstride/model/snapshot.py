"""The JSON form of a configuration: what is live, attached and in which mode, and the world it lives in.

{"world": {"system": "world", "topics": …, "resources": …, "environment": …},   as in a specification
 "instances": [{"name": "talker_2", "role": "talker", "component": {"name": "NewTalker", …}, "parameters": {…}}],
 "attachments": [["talker_2.out", "/chatter"]],
 "modes": {"talker_2.talk": "normal"}}
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from immutables import Map

from midstride.errors import SpecificationError
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.document import (
    Document,
    component_from_document,
    component_to_document,
    parameters_to_document,
    specification_from_document,
    specification_to_document,
)
from midstride.model.specification import Specification


def configuration_to_document(configuration: Configuration) -> Document:
    """The document of a configuration."""
    world = Specification(
        "world",
        connectors=configuration.context.connectors,
        environment=configuration.context.environment,
        resources=configuration.context.resources,
    )
    return {
        "world": specification_to_document(world),
        "instances": [
            {
                "name": instance.name,
                "role": instance.role,
                "component": component_to_document(instance.component),
                "parameters": parameters_to_document(instance.parameters),
            }
            for _, instance in sorted(configuration.instances.items())
        ],
        "attachments": [[str(port), connector] for port, connector in sorted(configuration.attachments())],
        "modes": {str(ref): configuration.mode(ref).name for ref in sorted(configuration.modes)},
    }


def configuration_from_document(document: Mapping[str, Any]) -> Configuration:
    """The configuration that a document says; nothing is judged. Raises SpecificationError where it is none."""
    try:
        instances = [
            Instance(
                entry["name"], entry["role"], component_from_document(entry["component"]), Map(entry["parameters"])
            )
            for entry in document["instances"]
        ]
        live = {instance.name: instance for instance in instances}
        modes = {}
        for text, mode in document["modes"].items():
            ref = FunctionalityRef.parse(text)
            modes[ref] = live[ref.instance].component.functionalities[ref.functionality].mode_index(mode)
        attachments = [(PortRef.parse(port), connector) for port, connector in document["attachments"]]
        return configure(specification_from_document(document["world"]).context, instances, attachments, modes)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SpecificationError(f"not a configuration ({type(error).__name__}: {error})") from error
