"""The JSON form of a specification.

    {"system": "demo",
     "topics":      {"/chatter": {"type": "std_msgs/msg/String", "rate": 10, "qos": {"depth": 5}, "max_publishers": 1}},
     "services":    {"/map": {"type": "nav_msgs/srv/GetMap", "within_seconds": 0.05}},
     "actions":     {"/dock": {"type": "nav2_msgs/action/DockRobot"}},
     "resources":   {"gpu_memory": {"capacity": 8192}, "gpu on arm": {"host": "arm"}},
     "hosts":       {"arm": {"ssh": "robot@arm", "setup": "/opt/ros/jazzy/setup.bash", "folder": "/opt/robot"}},
     "environment": {"camera": {"guarantee": {"type": …}}, "recording": {"guarantee": {…}, "topic": "/odom"}},
     "components":  {"Talker": …},
     "containers":  {"pipeline": {"run": "component_container_mt", "package": "rclcpp_components"}},
     "nodes":       {"talker": {"component": "Talker", "attachments": {"out": ["/chatter"]},
                                "parameters": {"threshold": 0.5},
                                "respawn": {"delay_seconds": 2, "fallback": "SimpleTalker"}, "container": "pipeline"},
                     "gripper": {"component": "Gripper", "host": "arm"}},
     "constraints": [{"keep": "talker.talk", "at": "normal"}, {"limit": "talker.talk", "below_baseline_seconds": 2},
                     {"order": "talker", "before": "listener"}],
     "timing_seconds": {"create": 0.5},
     "changes_require": [{"topic": "/estop/released", "assumption": {"type": …, "where": …}, "max_age_seconds": 1}]}

What is the default may be left out, and is left out when it is written. Reading covers form and names; whether what is
declared makes sense is for :mod:`midstride.model.specification_checks` to judge.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, TypeAlias

import msgspec
from immutables import Map
from msgspec import UNSET, Meta, UnsetType

from midstride.codec.component_form import ComponentForm, SharedProgramForm
from midstride.codec.contract_form import (
    MessageType,
    PredicateForm,
    QoSForm,
    Rate,
    WhereForm,
    WithinForm,
    predicate_keys,
)
from midstride.codec.form import (
    END,
    LARGEST,
    TOKEN,
    Document,
    Form,
    HostName,
    NonEmptyName,
    PositiveSeconds,
    SecondsOrZero,
    Shape,
    ShapedForm,
    by_name,
    encode,
    field,
    finite,
    given,
    named,
    plain,
    stated,
)
from midstride.codec.parameter import SectionForm, SectionsForm, ValueForm, values_form, values_of
from midstride.codec.reading import decode
from midstride.model.component import Connector, EnvironmentGuarantee, FunctionalityRef, Resource
from midstride.model.contract import ConnectorKind, Predicate
from midstride.model.hosts import OWN_HOST, HostSpec, resource_key
from midstride.model.name_checks import specification_names
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import ChangeRequirement, Constraint, Keep, Limit, Node, Order, Specification

TopicName: TypeAlias = Annotated[str, field("the name of a topic", min_length=1)]
GraphName: TypeAlias = Annotated[TopicName, Meta(description="the name in the ROS graph, where it differs")]
ServiceType: TypeAlias = Annotated[
    str,
    field(
        "a service type",
        "the type of the service, pkg/srv/Type",
        help="write it as `std_srvs/srv/Trigger`",
        pattern=f"^{TOKEN}/srv/{TOKEN}{END}",
    ),
]
ActionType: TypeAlias = Annotated[
    str,
    field(
        "an action type",
        "the type of the ROS action, pkg/action/Type",
        help="write it as `nav2_msgs/action/Spin`",
        pattern=f"^{TOKEN}/action/{TOKEN}{END}",
    ),
]


class TopicForm(Form, frozen=True):
    """A topic: its contract, and how many may publish on it."""

    what: ClassVar[str] = "a topic"

    type: MessageType
    rate: Rate | UnsetType = UNSET
    qos: QoSForm | UnsetType = UNSET
    where: WhereForm | UnsetType = UNSET
    max_publishers: Annotated[int, field("the number of publishers allowed", ge=0)] | UnsetType = UNSET
    topic: GraphName | UnsetType = UNSET

    @classmethod
    def of_connector(cls, connector: Connector) -> TopicForm:
        stated_keys = predicate_keys(connector.guarantee)
        return cls(
            **{key: value for key, value in stated_keys.items() if key != "within"},
            max_publishers=stated(connector.max_publishers),
            topic=_other_name(connector),
        )

    def connector(self, name: str) -> Connector:
        predicate = PredicateForm(self.type, self.rate, self.qos, self.where).predicate()
        return Connector(name, predicate, given(finite(self.max_publishers)), given(self.topic) or "")


class ServedForm(Form, frozen=True):
    """A service or a ROS action: its type, and within what time (s) it answers."""

    type: str
    within: WithinForm | UnsetType = msgspec.field(default=UNSET, name="within_seconds")
    topic: GraphName | UnsetType = UNSET

    @classmethod
    def of_connector(cls, connector: Connector) -> ServedForm:
        return cls(connector.guarantee.type, stated(connector.guarantee.within), _other_name(connector))

    def connector(self, name: str) -> Connector:
        predicate = Predicate(self.type, within=given(finite(self.within)))
        return Connector(name, predicate, topic=given(self.topic) or "")


class ServiceForm(ServedForm, frozen=True):
    """A service: its type, and within what time (s) requests are answered."""

    what: ClassVar[str] = "a service"

    type: ServiceType
    topic: GraphName | UnsetType = msgspec.field(default=UNSET, name="service")


class ActionForm(ServedForm, frozen=True):
    """A ROS action: its type, and within what time (s) goals are accepted or rejected."""

    what: ClassVar[str] = "a ROS action"

    type: ActionType
    topic: GraphName | UnsetType = msgspec.field(default=UNSET, name="action")


CONNECTOR_FORMS: Final[Mapping[ConnectorKind, type[TopicForm | ServiceForm | ActionForm]]] = {
    "topic": TopicForm,
    "service": ServiceForm,
    "action": ActionForm,
}


def of_kind(connectors: Mapping[str, Connector], kind: ConnectorKind) -> dict[str, Connector]:
    """The connectors of that kind, sorted by name."""
    return {name: connectors[name] for name in sorted(connectors) if connectors[name].kind == kind}


def _connector_forms(specification: Specification, kind: ConnectorKind) -> dict[str, Any]:
    form = CONNECTOR_FORMS[kind]
    return {name: form.of_connector(found) for name, found in of_kind(specification.connectors, kind).items()}


def _other_name(connector: Connector) -> str | UnsetType:
    return UNSET if connector.topic == connector.name else connector.topic


class ResourceForm(Form, frozen=True):
    """Something of which there is a limited amount."""

    what: ClassVar[str] = "a resource"

    capacity: Annotated[float, field("a capacity", gt=0, le=LARGEST)] | UnsetType = UNSET
    host: Annotated[str, field("the name of a host", "the host that has it, which the key ends with: `gpu on arm`")] = (
        OWN_HOST
    )

    @classmethod
    def of(cls, resource: Resource) -> ResourceForm:
        return cls(plain(resource.capacity), resource.host)

    def resource(self, key: str) -> Resource:
        name = key.removesuffix(resource_key("", self.host))
        return Resource(name, 1.0 if self.capacity is UNSET else self.capacity, self.host)


class HostForm(Form, frozen=True):
    """A computer that the manager reaches by OpenSSH."""

    what: ClassVar[str] = "a host"

    ssh: (
        Annotated[str, field("a destination", "the destination as `ssh` takes it; unless stated the name")] | UnsetType
    ) = UNSET
    setup: Annotated[str, field("a file", "what a shell sources there before it starts anything")] | UnsetType = UNSET
    folder: (
        Annotated[str, field("a folder", "where programs run there; unless stated the user's home directory")]
        | UnsetType
    ) = UNSET

    @classmethod
    def of(cls, host: HostSpec) -> HostForm:
        return cls(UNSET if host.ssh == host.name else host.ssh, stated(host.setup), stated(host.folder))

    def host(self, name: str) -> HostSpec:
        return HostSpec(name, name if self.ssh is UNSET else self.ssh, given(self.setup), given(self.folder))


class OfferForm(Form, frozen=True):
    """A guarantee of the environment; with a topic, as a publisher of it."""

    what: ClassVar[str] = "a guarantee of the environment"

    guarantee: PredicateForm
    topic: TopicName | UnsetType = UNSET


class RespawnForm(Form, frozen=True):
    """The policy for starting a crashed node again; `{}`: with the defaults."""

    what: ClassVar[str] = "a restart policy"

    delay_seconds: Annotated[SecondsOrZero, Meta(description="the delay before the first restart")] = 0
    max_delay_seconds: (
        Annotated[SecondsOrZero, Meta(description="the longest delay; unless stated 30 s, or the first one")]
        | UnsetType
    ) = UNSET
    max_retries: (
        Annotated[int, field("a number of restarts", "the most restarts in the window; null: no limit", ge=0)] | None
    ) = 5
    window_seconds: Annotated[PositiveSeconds, Meta(description="the time in which restarts count")] = 60
    fallback: (
        Annotated[str, field("the name of a component", "what then replaces the node", min_length=1)] | UnsetType
    ) = UNSET
    fallback_host: (
        Annotated[str, field("the name of a host", "where the fallback runs; empty: the host of the manager")]
        | UnsetType
    ) = UNSET
    lease_seconds: (
        Annotated[
            PositiveSeconds,
            Meta(description="how long the node writes on while its host cannot be reached; unless stated 5 s"),
        ]
        | UnsetType
    ) = UNSET

    @classmethod
    def of(cls, policy: RespawnPolicy) -> RespawnForm:
        return cls(
            delay_seconds=plain(policy.delay),
            max_delay_seconds=stated(policy.max_delay),
            max_retries=policy.max_retries,
            window_seconds=plain(policy.window),
            fallback=stated(policy.fallback),
            fallback_host=stated(policy.fallback_host),
            lease_seconds=stated(policy.lease),
        )

    def policy(self) -> RespawnPolicy:
        return RespawnPolicy(
            float(self.delay_seconds),
            given(self.max_delay_seconds),
            None if self.max_retries is None else finite(self.max_retries),
            float(self.window_seconds),
            given(self.fallback),
            given(self.fallback_host),
            given(self.lease_seconds),
        )


class NodeForm(Form, frozen=True):
    """A node: its component, the topics of its ports, its own parameter values."""

    what: ClassVar[str] = "a node"

    component: Annotated[str, field("the name of a component", min_length=1)]
    attachments: Annotated[
        dict[str, Annotated[list[NonEmptyName], field("a list of names of topics")]],
        field("an object of attachments", "the topics of each port"),
    ] = {}
    parameters: Annotated[
        dict[str, ValueForm], field("an object of values", "its own values, over its component's")
    ] = {}
    respawn: RespawnForm | UnsetType = UNSET
    sections: SectionsForm = []
    container: (
        Annotated[str, field("the name of a container", "what loads it beside other nodes", min_length=1)] | UnsetType
    ) = UNSET
    host: HostName = OWN_HOST

    @classmethod
    def of(cls, node: Node, specification: Specification) -> NodeForm:
        component = specification.components.get(node.component)
        order = {} if component is None else {name: index for index, name in enumerate(component.ports())}
        ports = sorted(node.attachments, key=lambda name: (order.get(name, len(order)), name))
        return cls(
            component=node.component,
            attachments={name: list(node.attachments[name]) for name in ports if node.attachments[name]},
            parameters=values_form(node.parameters),
            respawn=UNSET if node.respawn is None else RespawnForm.of(node.respawn),
            sections=[SectionForm.of(section) for section in node.sections],
            container=stated(node.container),
            host=node.host,
        )

    def node(self, role: str) -> Node:
        """Raises ValueError as :func:`midstride.codec.parameter.values_of` does."""
        topics = {port: tuple(names) for port, names in self.attachments.items()}
        policy = None if self.respawn is UNSET else self.respawn.policy()
        sections = tuple(form.section() for form in self.sections)
        values = values_of(self.parameters)
        return Node(role, self.component, Map(topics), values, policy, sections, given(self.container), self.host)


class ConstraintForm(ShapedForm, frozen=True):
    """A constraint on every plan."""

    what: ClassVar[str] = (
        "a constraint with `keep` and `at`, `limit` and `below_baseline_seconds`, or `order` and `before`"
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape("the constraint `keep`", ("keep", "at")),
        Shape("the constraint `limit`", ("limit", "below_baseline_seconds")),
        Shape("the constraint `order`", ("order", "before")),
    )

    keep: Annotated[NonEmptyName, field("a name")] | UnsetType = UNSET
    at: Annotated[NonEmptyName, field("a name")] | UnsetType = UNSET
    limit: Annotated[NonEmptyName, field("a name")] | UnsetType = UNSET
    below_baseline_seconds: SecondsOrZero | UnsetType = UNSET
    order: Annotated[NonEmptyName, field("a name")] | UnsetType = UNSET
    before: Annotated[NonEmptyName, field("a name")] | UnsetType = UNSET

    @classmethod
    def of(cls, constraint: Constraint) -> ConstraintForm:
        if isinstance(constraint, Keep):
            return cls(keep=str(constraint.functionality), at=constraint.mode)
        if isinstance(constraint, Limit):
            return cls(limit=str(constraint.functionality), below_baseline_seconds=plain(constraint.seconds))
        return cls(order=constraint.first, before=constraint.then)

    def constraint(self) -> Constraint:
        """One of which a part could not be read is an order of nothing, which the checks of names pass over."""
        if self.keep and self.at:
            return Keep(FunctionalityRef.parse(self.keep), self.at)
        if self.limit and self.below_baseline_seconds is not UNSET:
            return Limit(FunctionalityRef.parse(self.limit), self.below_baseline_seconds)
        return Order(given(self.order) or "", given(self.before) or "")


class ChangeRequirementForm(Form, frozen=True):
    """A requirement for changes, of the last message on a topic that the manager listens to."""

    what: ClassVar[str] = "a requirement of changes"

    topic: TopicName
    assumption: PredicateForm
    max_age_seconds: Annotated[PositiveSeconds, Meta(description="how old that message may be at most")] | UnsetType = (
        UNSET
    )
    recovery: Annotated[
        bool, field("true or false", "restarts of crashed nodes, and restoring what has degraded, require it as well")
    ] = False

    @classmethod
    def of(cls, requirement: ChangeRequirement) -> ChangeRequirementForm:
        return cls(
            topic=requirement.topic,
            assumption=PredicateForm.of(requirement.assumption),
            max_age_seconds=stated(requirement.max_age),
            recovery=requirement.recovery,
        )

    def requirement(self) -> ChangeRequirement:
        return ChangeRequirement(
            self.topic, self.assumption.predicate(), given(finite(self.max_age_seconds)), self.recovery
        )


class TimingForm(Form, frozen=True):
    """The durations of steps, where known, and what a hand-over takes its time for."""

    what: ClassVar[str] = "the timing of steps"

    attach: SecondsOrZero | UnsetType = UNSET
    create: SecondsOrZero | UnsetType = UNSET
    degrade: SecondsOrZero | UnsetType = UNSET
    detach: SecondsOrZero | UnsetType = UNSET
    handover: SecondsOrZero | UnsetType = UNSET
    probation: SecondsOrZero | UnsetType = UNSET
    probation_timeout: SecondsOrZero | UnsetType = UNSET
    remove: SecondsOrZero | UnsetType = UNSET
    set: SecondsOrZero | UnsetType = UNSET
    state_timeout: PositiveSeconds | UnsetType = UNSET
    upgrade: SecondsOrZero | UnsetType = UNSET
    watch_after: SecondsOrZero | UnsetType = UNSET


# The last few specifications whose forms were asked for.
_lately: tuple[tuple[Specification, SpecificationForm], ...] = ()


class SpecificationForm(Form, frozen=True):
    """A whole specification: what a robot's software is made of."""

    what: ClassVar[str] = "a specification"

    system: Annotated[str, field("the name of the system", min_length=1, extra_json_schema=named())]
    topics: Annotated[dict[str, TopicForm], field("an object of topics", "the topics, by full name")] = {}
    services: Annotated[dict[str, ServiceForm], field("an object of services", "the services, by full name")] = {}
    actions: Annotated[dict[str, ActionForm], field("an object of ROS actions", "the ROS actions, by full name")] = {}
    resources: Annotated[
        dict[str, ResourceForm], field("an object of resources", "what there is a limited amount of")
    ] = {}
    environment: Annotated[
        dict[str, OfferForm],
        by_name("an object of guarantees of the environment", "what holds without any node"),
    ] = {}
    components: Annotated[dict[str, ComponentForm], by_name("an object of components", "types of nodes")] = {}
    containers: Annotated[
        dict[str, SharedProgramForm],
        by_name(
            "an object of containers",
            "what composable nodes share, by name, namespaces in front",
            f"{TOKEN}(/{TOKEN})*",
        ),
    ] = {}
    hosts: Annotated[
        dict[str, HostForm], by_name("an object of hosts", "the computers besides that of the manager, by name")
    ] = {}
    nodes: Annotated[
        dict[str, NodeForm],
        by_name("an object of nodes", "the nodes, by name, namespaces in front", f"{TOKEN}(/{TOKEN})*"),
    ] = {}
    constraints: Annotated[list[ConstraintForm], field("a list of constraints")] = []
    timing_seconds: TimingForm | UnsetType = UNSET
    changes_require: Annotated[
        list[ChangeRequirementForm],
        field("a list of requirements", "what has to hold, all of it, for a change to happen"),
    ] = []

    @classmethod
    def of(cls, specification: Specification) -> SpecificationForm:
        """The form of ``specification``: one and the same while it is one of the last few, since it is often needed."""
        global _lately
        for known, form in _lately:
            if known is specification:
                return form
        form = cls._of(specification)
        _lately = (specification, form), *_lately[:3]
        return form

    @classmethod
    def _of(cls, specification: Specification) -> SpecificationForm:
        timing = {kind: plain(seconds) for kind, seconds in specification.timing.items()}
        return cls(
            system=specification.name,
            topics=_connector_forms(specification, "topic"),
            services=_connector_forms(specification, "service"),
            actions=_connector_forms(specification, "action"),
            resources={key: ResourceForm.of(found) for key, found in sorted(specification.resources.items())},
            environment={
                offer.name: OfferForm(guarantee=PredicateForm.of(offer.guarantee), topic=offer.topic or UNSET)
                for offer in specification.environment
            },
            components={name: ComponentForm.of(found) for name, found in sorted(specification.components.items())},
            containers={name: SharedProgramForm.of(found) for name, found in sorted(specification.containers.items())},
            hosts={name: HostForm.of(found) for name, found in sorted(specification.hosts.items())},
            nodes={role: NodeForm.of(node, specification) for role, node in sorted(specification.nodes.items())},
            constraints=[ConstraintForm.of(constraint) for constraint in specification.constraints],
            timing_seconds=TimingForm(**timing) if timing else UNSET,
            changes_require=[ChangeRequirementForm.of(each) for each in specification.requirements],
        )

    def specification(self) -> Specification:
        """The specification; its names are not checked. Raises ValueError for values that only the model refuses."""
        timing = {} if self.timing_seconds is UNSET else encode(self.timing_seconds)
        return Specification(
            name=self.system,
            connectors=Map(
                {
                    name: form.connector(name)
                    for forms in (self.topics, self.services, self.actions)
                    for name, form in forms.items()
                }
            ),
            components=Map({name: form.component(name) for name, form in self.components.items()}),
            containers=Map({name: form.program() for name, form in self.containers.items()}),
            nodes=Map({role: form.node(role) for role, form in self.nodes.items()}),
            environment=tuple(
                EnvironmentGuarantee(name, form.guarantee.predicate(), given(form.topic))
                for name, form in self.environment.items()
            ),
            resources=Map({key: form.resource(key) for key, form in self.resources.items()}),
            hosts=Map({name: form.host(name) for name, form in self.hosts.items()}),
            constraints=tuple(form.constraint() for form in self.constraints),
            timing=Map(timing),
            requirements=tuple(form.requirement() for form in self.changes_require),
        )


def decode_specification(document: object) -> Specification:
    """The specification that a document states. Raises SpecificationError with every fault of form and of names."""
    return decode(document, SpecificationForm, SpecificationForm.specification, specification_names)


def decode_saved_specification(document: object) -> Specification:
    """Decode a saved specification, without checking names: a system runs by it already.

    Raises SpecificationError with every fault of form.
    """
    return decode(document, SpecificationForm, SpecificationForm.specification)


def encode_specification(specification: Specification) -> Document:
    """The document of a specification; what is empty or the default is left out."""
    return encode(SpecificationForm.of(specification))
