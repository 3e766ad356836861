"""The catalogue of the diagnostics that concern what a specification says, in whatever notation (E001 to E099, W001 to
W099). The model and the codec report them; those of the JSON form have examples in JSON."""

from __future__ import annotations

from typing import Final

from midstride.lang.catalogue_entry import (
    CHATTER,
    NODE,
    STARTED,
    TALKING,
    CatalogueEntry,
    CatalogueExample,
    entry,
    respawning,
)

_LISTENER: Final = """component Listener {
  input in : std_msgs/msg/String @ 5 Hz
  functionality listen {
    uses in
    mode normal { assume in }
    mode deaf   { }
  }
}
"""
_TOPIC: Final = "topic /chatter : std_msgs/msg/String @ 10 Hz\n"
_SLOW: Final = (
    "component Slow like Talker { functionality talk { produces out\n"
    "  mode normal { guarantee out : std_msgs/msg/String @ 1 Hz }\n  mode silent { } } }\n"
)
# A talker on a host, with a restart policy.
_ON_ARM: Final = respawning("respawn   POLICY").replace(
    "node talker : Talker", "host arm { }\nnode talker : Talker on arm"
)
_PAIR: Final = TALKING + _LISTENER + "node listener : Listener { in <- /chatter }\n"


def _entry(heading: str, explanation: str, advice: str, *examples: str | CatalogueExample) -> CatalogueEntry:
    return entry(heading, f"{explanation}\n\nWhat to do: {advice}.", *examples)


def _json(text: str) -> CatalogueExample:
    return CatalogueExample(text, "example.json")


def _listening(contract: str) -> str:
    """A system whose listener assumes ``contract`` of its input."""
    return _PAIR.replace("std_msgs/msg/String @ 5 Hz", contract)


def _component(body: str) -> str:
    return "system s\ncomponent C {\n" + body + "}\n"


MODEL: Final = (
    _entry(
        "E001: wrong type of value",
        """A value in the JSON form does not have the type that its key requires, or the file is not valid JSON.""",
        "write a value of the type that the message names",
        _json('{"system": 5}\n'),
        _json('{"system": "s"\n'),
        _json('{"system": "s", "nodes": []}\n'),
    ),
    _entry(
        "E002: unknown key",
        """The JSON form has no such key here. A similar key is suggested if there is one.""",
        "remove the key, or write it as the message suggests",
        _json('{"system": "s", "topic": {}}\n'),
    ),
    _entry(
        "E003: missing key",
        """A key that the JSON form requires is missing.""",
        "add the key",
        _json("{}\n"),
    ),
    _entry(
        "E004: number out of range",
        """The number is not finite or is out of range: rates and capacities must be greater than 0; times and
        weights cannot be negative. Numbers are at most 1e18, in Hz and seconds; integer parameters have at most
        64 bits. A number of tolerated messages needs a rate, since without one no message is ever missed. A condition
        needs a constraint on a field, since without one every message meets it.""",
        "write a finite number within the range that the message names",
        TALKING + "resource memory = -1\n",
        TALKING + "limit talker.talk below baseline -1 s\n",
        TALKING.replace("talk {", "talk weight -1 {"),
        TALKING.replace("  output", "  holds memory -1\n  output") + "resource memory = 4\n",
        TALKING + "timing { create -1 s }\n",
        TALKING + "timing { state_timeout 0 s }\n",
        "system s\ntopic /chatter : std_msgs/msg/String qos(deadline = 0 s)\n",
        _component("  input a : std_msgs/msg/String tolerates 3 missed\n"),
        _component("  input a : std_msgs/msg/String condition\n"),
        _json('{"system": "s", "topics": {"/chatter": {"type": "std_msgs/msg/String", "rate": -1}}}\n'),
        _json('{"system": "s", "topics": {"/chatter": {"type": "std_msgs/msg/String", "rate": 1e308}}}\n'),
    ),
    _entry(
        "E005: unknown word",
        """The key accepts only certain values.""",
        "write one of the words that the message lists",
        _json('{"system": "s", "topics": {"/a": {"type": "std_msgs/msg/String", "qos": {"reliability": "sure"}}}}\n'),
    ),
    _entry(
        "E006: not a name",
        """This is not a valid name in ROS. Names have at most 255 characters.""",
        "names consist of letters, digits and underscores and do not start with a digit; topics start with /",
        _json('{"system": "my robot"}\n'),
    ),
    _entry(
        "E007: duplicate name",
        """Two declarations of the same kind have the same name, so references to it are ambiguous. Included files
        share one set of names with the file that includes them.""",
        "give each its own name",
        CHATTER + _TOPIC + "node talker : Talker { out -> /chatter }\n",
        TALKING + "node talker : Talker\n",
        _component("  input a : std_msgs/msg/String\n  input a : std_msgs/msg/Header\n"),
        _component("  functionality f {\n    mode a { }\n    mode a { }\n  }\n"),
        _component("  parameters { a = 1, a = 2 }\n"),
        "system s\nresource memory = 1\nresource memory = 2\n",
        "system s\ntiming { create 1 s   create 2 s }\n",
    ),
    _entry(
        "E008: unknown name",
        """The name of a contract, topic, component, node, port, functionality, mode, resource, host or parameter is not
        declared anywhere. A similar name is suggested if there is one. Relative names are resolved in the enclosing
        namespace.""",
        "declare it, or use a declared name",
        CHATTER + "node talker : Talkr { out -> /chatter }\n",
        CHATTER + "node talker : Talker { out -> /chater }\n",
        CHATTER + "node talker : Talker { outt -> /chatter }\n",
        "system s\ntopic /scan : Scan\n",
        TALKING + "keep talker.talks at normal\n",
        TALKING + "keep talker.talk at norml\n",
        TALKING + "order talkr before talker\n",
        _component("  holds memory 5\n"),
        _component(
            "  input in : std_msgs/msg/String\n  functionality f {\n    uses inn\n    mode a { }\n    mode b { }\n  }\n"
        ),
        _component(
            "  input in : std_msgs/msg/String\n"
            "  functionality f {\n    uses in\n    mode a { assume inn }\n    mode b { }\n  }\n"
        ),
        CHATTER + "node talker : Talker { out -> /chatter   parameters { volume = 3 } }\n",
        "system s\nenvironment { guarantee camera on /image : sensor_msgs/msg/Image }\n",
        "system s\ntiming { creat 1 s }\n",
        "system s\ncomponent B like A\n",
        TALKING.replace("Talker { out", "Talker on amr { out") + "host arm { }\n",
    ),
    _entry(
        "E009: not a shell command",
        """A command is split into words as in a shell, but run without one. Here a quote is not closed, or the
        command is empty; or with `package`, it names a file instead of an executable, or that is no package's name;
        or what follows the class of a composable node (`run component`) is nothing that a container takes.
        The same holds for a prefix. In an environment, a variable is one that Midstride itself sets.""",
        "write the command as in a shell, with its quotes closed, and an executable of a package without a folder",
        _component('  run "python3 -c \'print(1)"\n'),
        _component('  run ""\n'),
        _component('  run "./talker" package "demo_nodes"\n'),
        _component('  run "talker" package "demo nodes"\n'),
        _component('  run component "demo::Talker -p rate:=5" package "demo" gate preload\n'),
        _component('  run component "demo::Talker" package "demo" in "./box" gate preload\n'),
        _component('  run component "demo::Talker" package "demo" in "box" package "my boxes" gate preload\n'),
        _component('  run "talker" prefix ""\n'),
        _component('  run "talker"\n  environment { MIDSTRIDE_NODE = "talker" }\n'),
    ),
    _entry(
        "E010: M1: the last mode assumes something",
        """Rule M1 of the semantics: the last mode of a functionality assumes nothing. This guarantees that each
        functionality always has a mode it can be in, whatever fails.""",
        "let the last mode assume nothing, or add a last mode that assumes nothing",
        "system s\n" + _TOPIC + _LISTENER.replace("mode deaf   { }", "mode deaf   { assume in }"),
    ),
    _entry(
        "E011: M2: a worse mode guarantees what a better one does not",
        """Rule M2 of the semantics: a better mode guarantees everything that a worse mode guarantees. Otherwise a
        functionality that recovers could withdraw a guarantee that others depend on.""",
        "let the better mode guarantee at least as much",
        TALKING.replace("mode silent { }", "mode silent { guarantee out : std_msgs/msg/String @ 20 Hz }"),
    ),
    _entry(
        "E012: M3: the modes disagree on the endpoint of an output",
        """Rule M3 of the semantics: the guarantees of one output state the same type and QoS in all modes, because
        the output is a single endpoint. Use two outputs for two types.""",
        "state one type and one QoS in all modes",
        TALKING.replace("mode silent { }", "mode silent { guarantee out : std_msgs/msg/Header @ 1 Hz }"),
        TALKING.replace(
            "mode silent { }",
            "mode silent { guarantee out : std_msgs/msg/String @ 1 Hz qos(reliability = best_effort) }",
        ),
    ),
    _entry(
        "E013: output owned by no functionality",
        """The guarantee of an output depends on the mode of the functionality that produces it. No functionality
        produces this one.""",
        "let a functionality produce it",
        _component("  output out\n"),
    ),
    _entry(
        "E014: output owned by several functionalities",
        """The guarantee of an output depends on the mode of the one functionality that produces it. Several
        functionalities produce this one.""",
        "let only one functionality produce it",
        _component(
            "  output out\n"
            "  functionality a {\n    produces out\n    mode on { }\n    mode off { }\n  }\n"
            "  functionality b {\n    produces out\n    mode on { }\n    mode off { }\n  }\n"
        ),
    ),
    _entry(
        "E015: nothing to degrade to",
        """A functionality has at least two modes, best first: the normal mode, and the degraded mode that it falls
        back to.""",
        "give the functionality at least two modes, best first",
        _component("  functionality f {\n    mode only { }\n  }\n"),
    ),
    _entry(
        "E016: empty field constraint",
        """The constraints on a field together define a set of values, and this set is empty: no message satisfies
        them.""",
        "widen the constraints until some value meets them all",
        "system s\ncontract Wide = sensor_msgs/msg/Image where width >= 640, width < 320\n",
        "system s\ncontract None = sensor_msgs/msg/Image where encoding in {}\n",
        "system s\ncontract Wide = sensor_msgs/msg/Image where width >= 640\n"
        "contract Slim = Wide where width in [1, 99]\n",
    ),
    _entry(
        "E017: clause that another kind of contract has",
        """Messages have a rate, a QoS profile and constraints on fields. A service or a ROS action has a bound: within
        what time it answers a request, or accepts or rejects a goal.""",
        "leave the clause out, or state what belongs to the type",
        "system s\ncontract Map = nav_msgs/srv/GetMap @ 10 Hz\nservice /map : Map\n",
        "system s\nservice /map : nav_msgs/srv/GetMap qos(depth = 1)\n",
        "system s\ncontract Chat = std_msgs/msg/String responds within 1 s\ntopic /chatter : Chat\n",
        _json(
            '{"system": "s", "components": {"C": {"inputs": {"map": {"type": "a/srv/B", "where": {"x": {"=": 1}}}}}}}\n'
        ),
    ),
    _entry(
        "E018: host that cannot be reached as declared",
        """The manager reaches a host by OpenSSH, with the destination that `ssh` states, which is one word and no
        option. What `setup` and `folder` name is on that host, so they are absolute paths. `manager` is the host of
        the manager, which needs no declaration.""",
        "write what the message says; ports, keys and other options of OpenSSH belong in ~/.ssh/config",
        'system s\nhost arm { ssh "-p 2222 robot@arm" }\n',
        'system s\nhost arm { folder "robot" }\n',
        "system s\nhost manager { }\n",
    ),
    _entry(
        "E019: host that does not have it",
        """A process uses the resources of its own host alone, and a container loads nodes on its own host. Here a node
        is on another one than what it needs. In the JSON form, the key of a resource ends with its host.""",
        "put both on one host, or declare the resource on the host of the node",
        "system s\nhost arm { }\nresource gpu on arm\ncomponent Detector { holds gpu }\nnode detector : Detector\n",
        "system s\nhost arm { }\ncontainer pipeline\n"
        'component Talker { run component "demo::Talker" package "demo" gate preload }\n'
        "node talker : Talker in pipeline on arm\n",
        _json('{"system": "s", "hosts": {"arm": {}}, "resources": {"gpu": {"host": "arm"}}}\n'),
    ),
    _entry(
        "E020: attachment whose contracts do not fit",
        """An output can be attached to a topic if the guarantee of its normal mode satisfies the contract of the
        topic; an input can be attached if the contract of the topic satisfies the assumption of the input. The
        message lists each mismatch: type, rate, QoS policy or field.""",
        "weaken what is needed or strengthen what is guaranteed",
        TALKING.replace("/msg/String @ 10 Hz\ncomponent", "/msg/String @ 20 Hz\ncomponent"),
        _listening("std_msgs/msg/String @ 50 Hz"),
        _listening("std_msgs/msg/Header @ 5 Hz"),
        _listening("std_msgs/msg/String where data = hello"),
        _listening("std_msgs/msg/String qos(durability = transient_local)"),
    ),
    _entry(
        "E021: port attached twice to one topic",
        """A port can be attached to a topic only once.""",
        "attach it once",
        CHATTER + "node talker : Talker { out -> /chatter, /chatter }\n",
    ),
    _entry(
        "E022: too many publishers",
        """The topic limits the number of its publishers, as a velocity command does, for example. All attached
        outputs count, including silent ones, as do environment guarantees on the topic.""",
        "detach a publisher or raise the cap",
        TALKING.replace("10 Hz\ncomponent", "10 Hz { publishers <= 1 }\ncomponent")
        + "node other : Talker { out -> /chatter }\n",
    ),
    _entry(
        "E023: capacity exceeded",
        """Together the nodes use more of a resource than its capacity. A device has capacity 1.""",
        "remove a node that holds the resource, or raise the capacity",
        "system s\nresource /dev/video0\ncomponent Camera { holds /dev/video0 }\nnode a : Camera\nnode b : Camera\n",
        "system s\nresource memory = 100\ncomponent Big { holds memory 60 }\nnode a : Big\nnode b : Big\n",
    ),
    _entry(
        "E024: constraints that contradict each other",
        """No plan can satisfy these constraints together.""",
        "remove one of them",
        _PAIR + "order talker before listener\norder listener before talker\n",
        _PAIR + "order talker before talker\n",
    ),
    _entry(
        "E025: parameter of the wrong type",
        """A node sets a parameter to a value of a different type than its component declares, which ROS 2 would
        reject. An integer is accepted for a floating-point parameter.""",
        "write a value of the type that the component declares",
        CHATTER.replace("  output", "  parameters { volume = 0.5 }\n  output")
        + "node talker : Talker { out -> /chatter   parameters { volume = loud } }\n",
        CatalogueExample(
            CHATTER.replace("  output", "  parameters { volume = 0.5 }\n  output")
            + 'node talker : Talker { out -> /chatter   parameters "p.yaml" }\n',
            files={"p.yaml": "talker:\n  ros__parameters:\n    volume: [0.5]\n"},
        ),
    ),
    _entry(
        "E026: restart policy that cannot be carried out",
        """The longest delay of `respawn_delay` is shorter than the first one; the component of the node, or the one
        named by `respawn_fallback`, has no `run` command; or that one does not fit the topics of the node, lacks what a
        constraint on the node names, or never comes, since the restarts are unlimited. Or the fallback is on another
        host: then the lease has at least 1 s, the node is in no container, and where its host is not the manager's, it
        uses Midstride's API and has no servers.""",
        "correct the statement that the message names",
        respawning("respawn   respawn_delay 5 s to 2 s"),
        CHATTER + "node talker : Talker { out -> /chatter   respawn }\n",
        respawning("respawn   respawn_fallback Slow").replace("node", _SLOW + "node"),
        respawning("respawn   respawn_max_retries unlimited   respawn_fallback Other").replace(
            "node", "component Other like Talker { }\nnode"
        ),
        _ON_ARM.replace("POLICY", "respawn_fallback Talker on manager lease 0.2 s"),
        _ON_ARM.replace("POLICY", "respawn_fallback Talker on manager").replace('.talker"', '.talker" gate preload'),
    ),
    _entry(
        "E027: gate that cannot work",
        """A component with a `gate`, whose program does not use Midstride's API, has no `run` command, an input that is
        a `condition`, or a mode between the first and the last that sets no parameter; with `gate lifecycle`, it has
        several functionalities; with `gate relay`, an output for which no mode states a type, or a client; its node
        attaches a port to several topics; or a component without a `gate` has a name for the topic of a port
        (`as`), a mode with parameters, a `lazy` output, or states how it is ended (`stop`); or one that cannot be a
        lifecycle node states how long it may take to `activate`; or a lifecycle manager of the system, such as Nav2's,
        has a node in its `node_names` that has `gate lifecycle`, so that two would manage it; or a composable node
        (`run component`) has no package, no gate, `gate relay`, `once`, `unnamed` or `renames`; or a node is `in` a
        container, and its component is no composable node, or states what only a process has; or a container states
        `drain` or `patience`, which its nodes have. A parameter of a mode is declared in the component, with a value of
        the same type, and belongs to the modes of one functionality.""",
        "correct the statement that the message names",
        STARTED.replace("output out", "output out as chat") + NODE,
        STARTED.replace("component", "container box\ncomponent") + NODE.replace(" {", " in box {"),
        STARTED.replace('talker"', 'talker" gate relay').replace(
            "output out", "output out\n  client reset : std_srvs/srv/Trigger"
        )
        + NODE,
        STARTED.replace('talker"', 'talker" gate preload').replace("mode silent", "mode quiet { }\n    mode silent")
        + NODE,
        STARTED.replace('talker"', 'talker" gate lifecycle').replace(
            "  functionality", "  functionality log { mode on { } mode off { } }\n  functionality"
        )
        + NODE,
        STARTED.replace('talker"', 'talker" gate preload').replace(
            "mode silent", "mode quiet { parameters { volume = 1 } }\n    mode silent"
        )
        + NODE,
        STARTED.replace("mode silent { }", "mode silent { parameters { volume = 1 } }") + NODE,
        STARTED.replace('talker"', 'talker" gate relay')
        .replace("output out", "output out\n  output log")
        .replace("produces out", "produces out, log")
        + NODE,
        STARTED.replace('talker"', 'talker" gate relay').replace("mode silent", "mode quiet { }\n    mode silent")
        + NODE,
        STARTED.replace('talker"', 'talker" stop sigterm 10 s sigkill 5 s') + NODE,
        STARTED.replace('talker"', 'talker" stop drain 5 s gate relay') + NODE,
        STARTED.replace('talker"', 'talker" stop patience 20 s gate none') + NODE,
        STARTED.replace('talker"', 'talker" activate 10 s') + NODE,
        STARTED.replace("output out", "output out lazy") + NODE,
        _json(
            '{"system": "s", "components": {"T": {"run": "t", "gate": "none", "lazy": ["out"],\n'
            '  "functionalities": {"talk": {"modes": {"normal": {}, "silent": {}}}}}}}\n'
        ),
        STARTED.replace('talker"', 'talker" gate preload').replace(
            "component", "topic /talk : std_msgs/msg/String\ncomponent"
        )
        + "node talker : Talker { out -> /chatter, /talk }\n",
        _json(
            '{"system": "s", "components": {"T": {"gate": "none", "topics": {"in": "chat"},\n'
            '  "functionalities": {"talk": {"modes": {"normal": {}, "silent": {}}}}}}}\n'
        ),
        'system s\ncomponent Planner { run "planner" gate lifecycle preload }\n'
        'component Manager {\n  run "lifecycle_manager" gate preload\n'
        '  parameters {\n    autostart = true\n    node_names = ["planner"]\n  }\n}\n'
        "node planner : Planner\nnode manager : Manager\n",
        STARTED.replace('run "python3 -m s.talker"', 'run component "demo::Talker" gate preload') + NODE,
        STARTED.replace('run "python3 -m s.talker"', 'run component "demo::Talker" package "demo"') + NODE,
        STARTED.replace('run "python3 -m s.talker"', 'run component "demo::Talker" package "demo" gate relay') + NODE,
        STARTED.replace('run "python3 -m s.talker"', 'run component "demo::Talker" package "demo" gate preload unnamed')
        + NODE,
        STARTED.replace(
            'run "python3 -m s.talker"', 'run component "demo::Talker" package "demo" gate preload renames talker'
        )
        + NODE,
        'system s\ncontainer box { run "component_container" stop drain 3 s }\n',
    ),
    _entry(
        "E028: part of a program that ends",
        """A component that is `once` is a program that ends when it has done its work, such as a spawner. Here it has
        ports, functionalities, resources, allowed endpoints or a gate, which only a program has that keeps running; or
        it has no `run` command.""",
        "omit what the message names, or omit `once`",
        STARTED.replace('talker"', 'talker" once') + NODE,
        'system s\nresource arm\ncomponent Home {\n  run "./home" once gate preload\n  holds arm\n'
        "  allows service ~/home\n}\nnode home : Home\n",
        _json('{"system": "s", "components": {"T": {"once": true}}, "nodes": {"t": {"component": "T"}}}\n'),
    ),
    _entry(
        "W030: port that is attached to no topic",
        """A port of this node is not attached to any topic: an output without subscribers, or an input that is never
        satisfied.""",
        "attach it, or remove it",
        CHATTER + "node talker : Talker\n",
    ),
    _entry(
        "W031: topic that no publisher satisfies",
        """Nothing satisfies the contract of the topic: it has no publisher, or the environment guarantees too
        little. Inputs attached to it will not be satisfied.""",
        "attach an output that guarantees enough",
        "system s\n" + _TOPIC,
        "system s\n" + _TOPIC + "environment { guarantee slow on /chatter : std_msgs/msg/String @ 1 Hz }\n",
    ),
    _entry(
        "W032: assumption that nothing can satisfy",
        """A mode assumes a predicate that neither an input of its functionality nor the environment can satisfy, so
        the functionality can never be in that mode.""",
        "add an input that satisfies it, or weaken it",
        _component(
            "  functionality f {\n    mode normal { assume sensor_msgs/msg/Image }\n    mode degraded { }\n  }\n"
        ),
    ),
    _entry(
        "W033: functionality that starts below its normal mode",
        """When the system starts, this functionality will not be in its normal mode. The message follows the chain
        of reasons to the root cause.""",
        "fix the root cause, listed last",
        _PAIR.replace("node talker : Talker { out -> /chatter }\n", ""),
    ),
    _entry(
        "W034: constraint that does not hold at the start",
        """A `keep` constraint requires a mode that the functionality will not be in when the system starts.""",
        "fix what keeps the functionality in a lower mode, or remove the constraint",
        _PAIR.replace("node talker : Talker { out -> /chatter }\n", "") + "keep listener.listen at normal\n",
    ),
    _entry(
        "W035: fallback that is the node's component, or on its host",
        """`respawn_fallback` names the component that the node has: when its restarts are used up, it is left. Or it
        names the host that the node is on: nothing takes over when that cannot be reached.""",
        "name another component or host, or remove `respawn_fallback`",
        respawning("respawn   respawn_fallback Talker"),
        _ON_ARM.replace("POLICY", "respawn_fallback Talker on arm"),
    ),
)
