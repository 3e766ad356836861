// The forms of the HTTP API (docs/http.md), for the checker of the dashboard's modules.
// `make reference` writes this file from midstride.server.openapi.

declare namespace Api {
  /** A ROS action: its type, and within what time (s) goals are accepted or rejected. */
  interface ActionForm {
    /** the type of the ROS action, pkg/action/Type */
    type: string;
    /** within which a request is answered, or a goal accepted or rejected */
    within_seconds?: number;
    /** the name in the ROS graph, where it differs */
    action?: string;
  }

  /** The best plan in which one functionality does not fall below its baseline, or why there is none. */
  interface Alternative {
    functionality: string;
    /** that of its baseline */
    kept_at: string;
    disruption: number | null;
    /** that degrade instead */
    degraded: string[];
    /** why no plan keeps it; null where one does */
    impossible: string | null;
  }

  /** UNKNOWN is neither yes nor no: ``Verdict.because`` says why there is no answer. */
  type Answer = "holds" | "unknown" | "violated";

  /** An assessment of the work of a functionality, an output or a node. `lasting`: it is so afterwards, and no plan led there. */
  interface Assessment {
    subject: string;
    verdict: "kept" | "lost" | "not_measurable";
    /** the sentence, without a full stop */
    words: string;
    /** for how long it was lost; null: not lost, or not known */
    seconds: number | null;
    lasting: boolean;
    /** it was lost for no longer than `seconds`, and maybe for less */
    at_most: boolean;
  }

  /** All that is known about the work of a system during a change. `verdict`: the weakest of them. */
  interface Assessments {
    verdict: "kept" | "lost" | "not_measurable";
    headline: string;
    found: Assessment[];
  }

  /** One of several inputs, or what a message of some input must be like. */
  type AssumptionForm = { /** one of these inputs */ any_of: string[]; } | { /** the type of a message, pkg/msg/Type or pkg/Type, of a service, pkg/srv/Type, or of a ROS action, pkg/action/Type */ type: string; /** in Hz, at least */ rate?: number; qos?: QoSForm; /** the values that fields may have, by dotted path */ where?: Record<string, ValuesForm>; /** within which a request is answered, or a goal accepted or rejected */ within_seconds?: number; };

  /** A port of an instance is attached to a topic. */
  interface AttachStep {
    action: "attach";
    port: string;
    topic: string;
    seconds: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** The least loss by the creations and removals of some roles, whatever the others do. */
  interface BoundPartForm {
    roles: string[];
    /** in weighted functionality-seconds */
    bound: number;
  }

  /** One link of the chain from an assumption to its unmet cause, for diagrams. */
  interface CauseLink {
    kind: "assumption" | "environment" | "functionality" | "input" | "output" | "topic";
    name: string;
    detail: string;
    satisfied: boolean;
    causes?: CauseLink[];
  }

  /** A lock: no command changes the system, but `down`, until it is unlocked. */
  interface ChangeLock {
    reason: string;
    /** who has locked it, as `alice@robot` */
    by: string;
    /** in unix seconds */
    since: number;
    /** when it ends, in unix seconds; null: when it is unlocked */
    until: number | null;
    /** nor does the manager restart what has crashed, and restore what has degraded */
    holds_recovery: boolean;
  }

  /** A change; without an outcome, it is in progress. */
  interface ChangeRecord {
    number: number;
    /** when it began, in unix seconds */
    at: number;
    command: string;
    /** who asked for it, in the client's words */
    by: string | null;
    /** how many steps its plan has */
    total: number;
    /** those that were begun */
    steps: StepRecord[];
    /** of the specification that is in force afterwards */
    version: number;
    outcome: "done" | "failed" | "incomplete" | "refused" | "rolled_back" | null;
    because: string | null;
    seconds: number | null;
    /** the longest, in seconds; null where it is unknown */
    gap: number | null;
    /** messages, at all subscribers; null where it is unknown */
    missed: number | null;
    /** what was measured at each subscriber */
    swaps: SwapReport[];
    /** what was kept, what was lost, and what is not measurable; null: unknown */
    continuity: Assessments | null;
  }

  /** A change of the history. Null: not recorded, as by an earlier version, or because the manager ended meanwhile. */
  interface ChangeReport {
    change: ChangeRecord;
    plan: PlanPreview | null;
    /** the specification it began with */
    before: SpecificationForm | null;
    /** the one it was to lead to */
    after: SpecificationForm | null;
    /** as it was reported, without the plan */
    outcome: Outcome | null;
    timeline: ChangeTimeline | null;
    /** from its beginning to its end */
    incidents: Incident[];
  }

  /** A request for a change: single changes, or a whole specification (`to`) to change to. */
  interface ChangeRequest {
    /** [node, component] pairs */
    replace?: [string, string][];
    /** nodes to restart: each gets a new instance */
    restart?: string[];
    /** nodes to add */
    add?: NewNode[];
    /** nodes to remove */
    remove?: string[];
    /** values to set at run time, by node and parameter, and nothing else */
    parameters?: Record<string, Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>>;
    to?: SpecificationForm | null;
    /** components that the specification does not have yet */
    components?: NamedComponentForm[];
    strategy?: "minimal" | "paper" | "quiesce" | "stop";
    /** with `minimal`: nodes that stay may be moved, and roles have stand-ins meanwhile */
    detours?: boolean;
    /** start with the declared values of parameters, not with those set at run time */
    declared_parameters?: boolean;
    /** also where other nodes end with a process that the change ends: else it is refused */
    with_other_nodes?: boolean;
    /** a replaced node of a container starts in the process that it is in, with the same code */
    same_process?: boolean;
    /** the host that a node is to run on, by node; `manager`: that of the manager */
    on?: Record<string, string>;
    /** for a plan that is only shown: what it would cost to keep what it degrades */
    explain?: boolean;
  }

  /** A requirement for changes, of the last message on a topic that the manager listens to. */
  interface ChangeRequirementForm {
    topic: string;
    assumption: PredicateForm;
    /** how old that message may be at most */
    max_age_seconds?: number;
    /** restarts of crashed nodes, and restoring what has degraded, require it as well */
    recovery?: boolean;
  }

  /** The course of a change; times in unix seconds. ``modes``: of its nodes, and of all that was lowered. */
  interface ChangeTimeline {
    since: number;
    until: number;
    modes: ModeInterval[];
    events: Event[];
  }

  /** The change in progress, or the last one that ended. */
  interface ChangeView {
    /** the one in its request */
    id: string | null;
    command: string;
    /** seconds since 1970 */
    began: number;
    ended: number | null;
    outcome: "done" | "failed" | "incomplete" | "refused" | "rolled_back" | null;
    /** how it ended, in words */
    because: string | null;
    state: "ended" | "executing" | "measuring" | "planning" | "rolling_back" | "verifying";
    /** null until it is planned */
    plan: PlanPreview | null;
    /** the latest step that has begun, from 0 */
    index: number | null;
    /** how many steps the plan has */
    total: number | null;
    steps: StepView[];
    /** what each subscriber saw, as measured */
    swaps: SwapReport[];
  }

  /** The check of a text that is to be applied: if it can be, `request` is what `/plan` and `/change` take. */
  interface CheckedText {
    ok: boolean;
    diagnostics: DiagnosticReport[];
    /** null where there are errors */
    request: ChangeRequest | null;
  }

  /** A component, whose name is the key it is under. */
  interface ComponentForm {
    /** the command that starts it; none: started elsewhere */
    run?: string;
    /** the ROS 2 package of its program */
    package?: string;
    /** `run` is a class that this loads */
    container?: ContainerForm;
    /** the words before its program */
    prefix?: string;
    /** variables of its process; null: not inherited */
    environment?: Record<string, string | null>;
    takes_seconds?: number;
    /** how long a lifecycle node may take to activate */
    activate_seconds?: number;
    stop_seconds?: StopForm;
    /** what it holds of resources */
    holds?: Record<string, number>;
    /** its parameters */
    parameters?: Record<string, ParameterForm>;
    /** endpoints that are not ports */
    allows?: EndpointForm[];
    /** its assumption on each input */
    inputs?: Record<string, InputForm>;
    /** the names of its outputs */
    outputs?: string[];
    /** what it does */
    functionalities?: Record<string, FunctionalityForm>;
    /** what holds it back; none: it uses Midstride's API */
    gate?: "lifecycle" | "lifecycle preload" | "none" | "preload" | "relay";
    /** its program ends when it has done its work */
    once?: boolean;
    /** whether its program gives its node its name itself */
    unnamed?: boolean;
    /** what its program calls it */
    renames?: string;
    /** what its program calls the topics of its ports */
    topics?: Record<string, string>;
    /** the outputs that exist only while something subscribes to them */
    lazy?: string[];
  }

  /** A configuration, with the topics, resources and environment that it lives in. */
  interface ConfigurationForm {
    context: SpecificationForm;
    instances: InstanceForm[];
    attachments: [string, string][];
    /** the current mode of each functionality */
    modes: Record<string, string>;
  }

  /** A constraint on every plan. */
  type ConstraintForm = { keep: string; at: string; } | { limit: string; below_baseline_seconds: number; } | { order: string; before: string; };

  /** The program that loads a composable node. */
  interface ContainerForm {
    /** an executable of its package */
    run?: string;
    /** its package */
    package?: string;
  }

  /** An instance that exited unexpectedly, or could not be started. `status` is negative for a signal, null where it is not known. */
  interface CrashedInstance {
    name: string;
    status: number | null;
    log: string;
    /** what to do, in words */
    remedy: string | null;
    /** null: the node has no restart policy */
    respawn: RespawnStatus | null;
    /** null: the specification does not have it any more */
    role: string | null;
    /** why it does not run */
    words: string;
    /** of the system, that loads its node beside others */
    container: string | null;
  }

  /** A new instance is started. */
  interface CreateStep {
    action: "create";
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
    instance: string;
    role: string;
    component: string;
    parameters: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    /** parameters of further nodes in its process, as files order them */
    sections?: SectionForm[];
    container?: SharedContainerForm;
    process?: string;
    host?: string;
    seconds: number;
  }

  /** A host that a person has declared dead. Nothing is known of the ``instances`` of ``nodes`` that ran there. */
  interface DeadHost {
    host: string;
    instances: string[];
    nodes: string[];
  }

  /** The statement that a host which cannot be reached is dead, so that its nodes may be started elsewhere. */
  interface DeathRequest {
    host: string;
    by: string;
  }

  /** A functionality of a role below its baseline: the steps that take it there and back, how long, and why. Steps count from 1; from step 0: the plan begins below; to step null: it ends below. ``seconds`` adds up the estimates of the steps during which it is below. */
  interface Degradation {
    functionality: string;
    from_step: number;
    to_step: number | null;
    seconds: number;
    because: string;
    /** from which on no instance serves it; null where one always does */
    unserved_from_step: number | null;
    /** the capacities and caps that keep the new side from coming first */
    forced_by: string[];
  }

  /** Functionalities enter worse modes. */
  interface DegradeStep {
    action: "degrade";
    modes: Record<string, ModeChangeForm>;
    seconds: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** A functionality of a role that is in a worse mode than before the change, or if it is new, than its normal one. `planned`: the plan led there. Otherwise its code raised, say, or what it relies on has exited. */
  interface DegradedFunctionality {
    functionality: string;
    /** the better mode */
    from: string | null;
    /** the mode now; null: no instance serves it */
    to: string | null;
    planned: boolean;
    because: string | null;
  }

  /** A port of an instance is detached from a topic. */
  interface DetachStep {
    action: "detach";
    port: string;
    topic: string;
    seconds: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** The steps of one role beyond the change: it moves away and back, or has a stand-in, or both. */
  interface DetourForm {
    role: string;
    /** a node that stays is replaced by one like it */
    moved: boolean;
    /** of the instance that exists during the plan only */
    stand_in: string | null;
  }

  /** A problem in a text, as `midstride check --json` prints it; `end_column` is exclusive. */
  interface DiagnosticReport {
    code: string;
    severity: "error" | "warning";
    file: string;
    /** from 1 */
    line: number;
    /** from 1 */
    column: number;
    /** from 1 */
    end_line: number;
    /** from 1 */
    end_column: number;
    message: string;
    help: string | null;
    /** what follows from it */
    follows: string | null;
    notes: NotePlace[];
  }

  /** The system is down. `killed`: the processes that did not end when they were asked to, or not in order. */
  interface DownReport {
    outcome: "done";
    killed: KilledProcess[];
  }

  /** An endpoint of the node that is not a port. */
  interface EndpointForm {
    kind: "action" | "service" | "topic";
    name: string;
  }

  /** A service, ROS action or topic of an instance's node that is no port, as its component allows it. */
  interface EndpointStatus {
    kind: "ROS action" | "service" | "topic";
    /** in full, as `/map/save` */
    name: string;
    /** it is the server; false: it calls it; null: a topic, or not known */
    serves: boolean | null;
  }

  /** An event: numbered from 1, at a time (unix seconds), its kind, in words, with the details of that kind. */
  interface Event {
    n: number;
    at: number;
    kind: string;
    words: string;
    /** waiting: the command that waits */
    command?: string;
    /** waiting, command: the id in its request */
    id?: string | null;
    /** step…: which step, from 0 */
    index?: number;
    /** step…, rollback: how many steps there are */
    total?: number;
    /** step…: the step of the plan */
    step?: CreateStep | RemoveStep | AttachStep | DetachStep | DegradeStep | UpgradeStep | HandoverStep | SetStep;
    /** plan: what will be done */
    plan?: PlanPreview;
    /** measured: what each subscriber saw */
    swaps?: SwapReport[];
    /** verified: what Alloy found */
    verdict?: Verdict;
    /** outcome, parameters: how the command ended */
    outcome?: "done" | "failed" | "incomplete" | "refused" | "rolled_back";
    /** degraded: which functionality */
    functionality?: string;
    /** fenced, killed: which instance */
    instance?: string;
    /** killed: how long it had to end */
    seconds?: number;
    /** killed: whether it has ended by itself */
    unfinished?: boolean;
    /** exited: the last of the instance's output */
    log?: string;
  }

  /** An operation that failed. */
  interface Failure {
    error: FailureDetails;
  }

  /** The exception's name, as in midstride.errors, its message, and each fault of a specification. */
  interface FailureDetails {
    kind: string;
    message: string;
    problems?: string[];
  }

  /** An instance that hung, was stopped or too slow, and was replaced inside a call of its user code. */
  interface FencedInstance {
    instance: string;
    /** its outputs were closed, or its process was killed */
    how: "gate" | "killed";
    because: string;
    words: string;
  }

  /** Samples of one field that the contract constrains. */
  interface FieldStatus {
    field: string;
    constraint: string;
    checked: number;
    violations: number;
    /** how many of the latest samples violate it, without one that meets it */
    run: number;
    /** the last value that violated it */
    last: boolean | number | string | null;
  }

  /** One violation, in the names of the file. ``step`` counts from 1; None is the configuration at the start (or the only one), the declarations, or the end. */
  interface Finding {
    kind: "assumption" | "attachment" | "cap" | "capacity" | "document" | "effect" | "end" | "name" | "precondition" | "rule";
    step: number | null;
    where: string;
    subject: string;
    because: string;
    assumption: string | null;
    chain: CauseLink | null;
  }

  /** A computation from inputs to outputs, with its chain of modes. */
  interface FunctionalityForm {
    /** how much its loss matters */
    weight?: number;
    /** its inputs */
    uses?: string[];
    /** its outputs */
    produces?: string[];
    /** its modes, best first */
    modes: Record<string, ModeForm>;
  }

  /** A functionality of an instance, in the mode that its component reports, else in that of the manager's model. */
  interface FunctionalityStatus {
    name: string;
    mode: string;
    /** best first */
    modes: string[];
    /** the mode in the manager's model */
    modelled: string;
    /** it is in its best mode */
    normal: boolean;
    /** why it is in this mode */
    because: string | null;
    /** the component's local reflex has led to this mode */
    reflex: boolean;
    /** whether and when it is restored after that, in words; null: by a command only */
    restoring: string | null;
    /** when it entered this mode; null: not known */
    since: number | null;
    /** how long the current call of user code has taken, in seconds */
    busy?: number | null;
  }

  /** The goals of the ROS actions of a node that was replaced, and of its replacement, by what became of them. As both have counted, from the beginning of the change to its report. */
  interface GoalTally {
    old: string;
    new: string;
    /** in progress at the beginning, or accepted since */
    accepted: number;
    /** that succeeded or were aborted, at the replaced instance */
    ended_at_old: number;
    /** the same, at its replacement */
    ended_at_new: number;
    /** that ended as they were cancelled, at either */
    cancelled: number;
    /** that go on at the time of the report */
    in_progress: number;
    /** that had not ended when their instance did */
    lost: number;
    /** requests about goals that neither knew, which were answered so */
    unknown: number;
    words: string;
  }

  /** Topics change their publisher at one moment. */
  interface HandoverStep {
    action: "handover";
    swaps: SwapForm[];
    seconds: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** The latest changes, oldest first, and the incidents since the first of them. */
  interface History {
    changes: ChangeRecord[];
    incidents: Incident[];
    /** where an earlier history is kept that could not be read */
    damaged: string | null;
  }

  /** A computer that the manager reaches by OpenSSH. */
  interface HostForm {
    /** the destination as `ssh` takes it; unless stated the name */
    ssh?: string;
    /** what a shell sources there before it starts anything */
    setup?: string;
    /** where programs run there; unless stated the user's home directory */
    folder?: string;
  }

  /** The link to another host than the manager's, where the manager has started nodes, or may. While it is down, nothing is known of the nodes there, and nothing but ``fallbacks`` is started elsewhere. The manager connects again by itself. */
  interface HostStatus {
    name: string;
    /** as `ssh` takes it */
    destination: string;
    connected: boolean;
    /** from when on that has been so */
    since: number;
    /** why it cannot be reached, and what to do; null: it is connected */
    because: string | null;
    /** of Midstride there; empty: not known */
    version: string;
    /** of the manager's clock, as measured last (s); null: not measured yet */
    clock_ahead: number | null;
    /** of that when it was measured, give or take (s); the clocks may have drifted apart */
    clock_uncertainty: number | null;
    /** that run there, as far as is known */
    instances: string[];
    /** while it is down: what takes the place of which of them, and when */
    fallbacks: string[];
  }

  /** An event besides changes, such as an instance that exited. */
  interface Incident {
    at: number;
    kind: string;
    words: string;
  }

  /** The assumptions of an input about its topics, the missed messages it tolerates, and whether it is a condition. */
  interface InputForm {
    /** the type of a message, pkg/msg/Type or pkg/Type, of a service, pkg/srv/Type, or of a ROS action, pkg/action/Type */
    type: string;
    /** in Hz, at least */
    rate?: number;
    qos?: QoSForm;
    /** the values that fields may have, by dotted path */
    where?: Record<string, ValuesForm>;
    /** within which a request is answered, or a goal accepted or rejected */
    within_seconds?: number;
    /** missed in succession */
    tolerates?: number;
    /** whether its last message decides */
    condition?: boolean;
  }

  /** A running instance of a role's component, with the values of its parameters. */
  interface InstanceForm {
    name: string;
    role: string;
    component: NamedComponentForm;
    parameters: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    /** parameters of further nodes in its process, as files order them */
    sections?: SectionForm[];
    container?: SharedContainerForm;
    process?: string;
    /** the host that it runs on; empty: that of the manager */
    host?: string;
  }

  /** An instance, as it last reported itself. */
  interface InstanceStatus {
    name: string;
    role: string;
    component: string;
    /** of the system, that loads its node beside others */
    container: string | null;
    /** the process of that container which it shares; null: it has one for itself */
    process: string | null;
    /** of its role: `/` or `/front` */
    namespace: string;
    /** of the specification, else the computer or container that reports it; null: the manager's */
    host: string | null;
    /** the full name of its ROS node; null where there is none */
    node: string | null;
    pid: number | null;
    /** it has reported its state in the last 2 s */
    reachable: boolean;
    /** its host cannot be reached: whether it runs is not known */
    unreachable: boolean;
    /** it answers requests to its node's services */
    answers: boolean;
    /** it has been asked to end */
    ending: boolean;
    /** its program has ended as it should (`once`) */
    done: boolean;
    /** what it is waiting for */
    waiting: string | null;
    /** its modes are those of the manager's model */
    as_modelled: boolean;
    /** in which way its node is not what is declared */
    differences: string[];
    /** the topics of its node that are no ports */
    undeclared: string[];
    /** that end with it, besides its own */
    other_nodes: OtherNodeStatus[];
    /** why some of them may not be known */
    other_nodes_unknown: string | null;
    /** in which way it is not as specified, in words; null: it is */
    deviation: string | null;
    /** /clock drives its ROS clock */
    simulated_time: boolean;
    /** the command it was started with; null: it was started elsewhere */
    run: string | null;
    log_file: string | null;
    functionalities: FunctionalityStatus[];
    ports: PortStatus[];
    /** none where it is not reachable */
    parameters: ParameterStatus[];
    /** that are no ports, by kind and name */
    endpoints: EndpointStatus[];
    /** of its program: changed on disk since it started */
    changed_files?: string[];
    /** what is not known of its program's files */
    unknown_files?: string | null;
    /** the file of the package's executable that its `run` names */
    executable?: string | null;
  }

  /** A process whose end was cut short: it had to be killed, or its `on_stop` has failed. What it does then is lost. ``seconds``: how long it had. ``unfinished``: it was not killed, and it left undone what ``words`` says. */
  interface KilledProcess {
    instance: string;
    /** how long it had, from when it was asked to end */
    seconds: number;
    words: string;
    /** it was not killed, and left undone what `words` says */
    unfinished: boolean;
  }

  /** A functionality of a role that ends in another mode than it began in; null: no instance serves it. */
  interface LevelShift {
    functionality: string;
    from: string | null;
    to: string | null;
    /** by how many it ends lower */
    levels: number;
  }

  /** The configuration as its components report it; those in `silent` are as in the manager's model. */
  interface LiveConfiguration {
    revision: number;
    silent: string[];
    configuration: ConfigurationForm;
  }

  /** A lock, under which no command changes the system, but `down`: why, by whom, and until when (unix seconds). `holds_recovery`: nor is what has crashed restarted, and what has degraded restored. */
  interface LockRequest {
    reason: string;
    by: string;
    until?: number | null;
    holds_recovery?: boolean;
  }

  /** The middleware, and the variables of it that a back end sets for the processes it starts, and those it leaves. ``domain`` (of ROS 2), ``master`` (of ROS 1) and ``distribution`` are empty where a back end has none, or does not know. ``problem``: what kept nodes from finding each other as the manager was started; empty where nothing did. */
  interface Middleware {
    name: string;
    domain: string;
    master: string;
    distribution: string;
    problem: string;
    set: Record<string, string>;
    kept: Record<string, string>;
    notes: string[];
  }

  /** The mode that a functionality leaves, and the one that it enters. */
  interface ModeChangeForm {
    from: string;
    to: string;
  }

  /** A mode: what it assumes, and what it then guarantees on outputs; those left out produce nothing. */
  interface ModeForm {
    assumes?: (string | AssumptionForm)[];
    /** by output */
    guarantees?: Record<string, PredicateForm>;
    /** the parameters that are set on entry */
    parameters?: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
  }

  /** A functionality was in one mode; times in unix seconds. `because` says why it had entered it. */
  interface ModeInterval {
    instance: string;
    role: string;
    functionality: string;
    mode: string;
    /** of its mode: 0 is the best */
    level: number;
    /** how many modes it has */
    levels: number;
    because: string | null;
    /** the component's local reflex has led to this mode */
    reflex: boolean;
    began: number;
    /** null: it was in this mode to the end */
    ended: number | null;
  }

  /** Functionalities of several instances that support each other, and so changed their modes in one step. */
  interface ModeSkew {
    /** `degrade` or `upgrade` */
    kind: string;
    functionalities: string[];
    /** between the first and the last of them, as measured */
    seconds: number;
  }

  /** A component by itself, its name in it: what a node registers. */
  interface NamedComponentForm {
    /** the command that starts it; none: started elsewhere */
    run?: string;
    /** the ROS 2 package of its program */
    package?: string;
    /** `run` is a class that this loads */
    container?: ContainerForm;
    /** the words before its program */
    prefix?: string;
    /** variables of its process; null: not inherited */
    environment?: Record<string, string | null>;
    takes_seconds?: number;
    /** how long a lifecycle node may take to activate */
    activate_seconds?: number;
    stop_seconds?: StopForm;
    /** what it holds of resources */
    holds?: Record<string, number>;
    /** its parameters */
    parameters?: Record<string, ParameterForm>;
    /** endpoints that are not ports */
    allows?: EndpointForm[];
    /** its assumption on each input */
    inputs?: Record<string, InputForm>;
    /** the names of its outputs */
    outputs?: string[];
    /** what it does */
    functionalities?: Record<string, FunctionalityForm>;
    /** what holds it back; none: it uses Midstride's API */
    gate?: "lifecycle" | "lifecycle preload" | "none" | "preload" | "relay";
    /** its program ends when it has done its work */
    once?: boolean;
    /** whether its program gives its node its name itself */
    unnamed?: boolean;
    /** what its program calls it */
    renames?: string;
    /** what its program calls the topics of its ports */
    topics?: Record<string, string>;
    /** the outputs that exist only while something subscribes to them */
    lazy?: string[];
    name: string;
  }

  /** A node to add: its role, its component, and the topics its ports are attached to. */
  interface NewNode {
    component: string;
    /** the topics of each port */
    attachments?: Record<string, string[]>;
    /** its own values, over its component's */
    parameters?: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    respawn?: RespawnForm;
    /** parameters of further nodes in its process, as files order them */
    sections?: SectionForm[];
    /** what loads it beside other nodes */
    container?: string;
    /** the host that it runs on; empty: that of the manager */
    host?: string;
    role: string;
  }

  /** A node: its component, the topics of its ports, its own parameter values. */
  interface NodeForm {
    component: string;
    /** the topics of each port */
    attachments?: Record<string, string[]>;
    /** its own values, over its component's */
    parameters?: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    respawn?: RespawnForm;
    /** parameters of further nodes in its process, as files order them */
    sections?: SectionForm[];
    /** what loads it beside other nodes */
    container?: string;
    /** the host that it runs on; empty: that of the manager */
    host?: string;
  }

  /** A further place that a diagnostic is about. */
  interface NotePlace {
    message: string;
    file: string;
    /** from 1 */
    line: number;
    /** from 1 */
    column: number;
  }

  /** A guarantee of the environment; with a topic, as a publisher of it. */
  interface OfferForm {
    guarantee: PredicateForm;
    topic?: string;
  }

  /** The nodes, by their full names, with endpoints on a topic that are no ports, as ROS's graph shows them. */
  interface OtherEndpoints {
    /** empty where a port publishes */
    publishers: string[];
    /** empty where a port listens */
    subscribers: string[];
  }

  /** A ROS node that ends with an instance, since it is in its process, or in one that this has started. */
  interface OtherNodeStatus {
    /** its full name */
    name: string;
    /** topics */
    publishes: string[];
    /** services and ROS actions, in words */
    serves: string[];
    /** it has the name of the program's own node */
    namesake: boolean;
  }

  /** The result of a change; `refused`: nothing was changed. */
  interface Outcome {
    outcome: "done" | "failed" | "incomplete" | "refused" | "rolled_back";
    plan: PlanForm | null;
    seconds: number;
    /** those that were done, as measured */
    steps: StepTime[];
    skews: ModeSkew[];
    /** as measured, by functionality */
    below_baseline_seconds: Record<string, number>;
    swaps: SwapReport[];
    /** seconds by which a new component's first slot waited for its state, over a period */
    late: Record<string, number>;
    /** new components that continue without the state of the old one: what is lost, and why */
    own_state: Record<string, string>;
    /** by new node, where it or the old one has no API: the state that has moved to it */
    moved: Record<string, StateMove>;
    /** by role that was replaced: what became of the goals of its ROS actions */
    goals: Record<string, GoalTally>;
    because: string | null;
    /** what became of values that were set at run time */
    parameters: RuntimeValue[];
    /** of instances, meanwhile */
    unexpected_exits: string[];
    /** of functionalities, meanwhile */
    unexpected_degradations: string[];
    /** replaced although they hung */
    fenced: FencedInstance[];
    /** processes that did not end when they were asked to */
    killed: KilledProcess[];
    /** faults that began meanwhile, and last */
    silences: SilenceFault[];
    /** what is in a worse mode afterwards */
    remaining_degradations: DegradedFunctionality[];
    /** what Alloy found, where requested */
    verdict?: Verdict;
    /** what was kept, what was lost, and what is not measurable; null: refused */
    continuity: Assessments | null;
  }

  /** A parameter's value, and whether it can be set in place. */
  interface ParameterForm {
    /** the value of a parameter; a list is of one kind */
    value: boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[];
    changeable?: boolean;
  }

  /** Values to set at run time, all of them or none: of the parameters of a node, by name. `id`: as of a change. `by`: who asks, for the history. `despite_lock`: also while the system is locked; `despite_requirements`: although what its changes require does not hold. */
  interface ParameterSetting {
    node: string;
    parameters: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    id?: string | null;
    by?: string | null;
    despite_lock?: boolean;
    despite_requirements?: boolean;
  }

  /** A parameter of a component. Where it was set at run time, `declared` is the value that it was started with. `origin`: `unknown` where a ROS tool has set it, or the node itself; `node` where it is known that the node itself has, as nothing has asked it to set that parameter; absent otherwise. `set_at`: when a request has set it (Unix time, s), where that was noted. */
  interface ParameterStatus {
    name: string;
    /** the value of a parameter; a list is of one kind */
    value: boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[];
    /** the value of a parameter; a list is of one kind */
    declared: boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[];
    set_at_run_time: boolean;
    origin?: "node" | "unknown";
    set_at?: number;
  }

  /** Parameters of an instance, as it has them now. `unread`: why its node has not said them; `parameters` are then those that it said last. Absent if it has. */
  interface ParametersReport {
    instance: string;
    parameters: ParameterStatus[];
    unread?: string;
  }

  /** A change that this manager has carried out, or carries out. */
  interface PastChange {
    /** the one in its request */
    id: string | null;
    command: string;
    /** seconds since 1970 */
    began: number;
    ended: number | null;
    outcome: "done" | "failed" | "incomplete" | "refused" | "rolled_back" | null;
    /** how it ended, in words */
    because: string | null;
  }

  /** The changes of a view since what the client was last sent. What is absent is as before. `instances` and `topics` have the entries that changed, by name; null for one that is gone. */
  interface Patch {
    n: number;
    /** seconds since 1970 */
    at: number;
    system?: string;
    backend?: string;
    phase?: "down" | "failed" | "starting" | "up";
    revision?: number;
    running?: RunningCommand | null;
    lock?: ChangeLock | null;
    requirements?: RequirementStatus[];
    condition?: SystemCondition;
    valid?: boolean;
    violations?: string[];
    instances?: Record<string, InstanceStatus | null>;
    topics?: Record<string, TopicStatus | null>;
    crashed?: CrashedInstance[];
    silences?: SilenceFault[];
    unwritten?: string | null;
    damaged?: string | null;
    file?: string | null;
    changed_since?: boolean;
    middleware?: Middleware;
    spares?: SpareStatus;
    hosts?: HostStatus[];
    change?: ChangeView | null;
  }

  /** A plan, whole: it can be verified alone. */
  interface PlanForm {
    strategy: string;
    proved_minimal: boolean;
    /** in weighted functionality-seconds */
    disruption: number;
    lower_bound: number;
    /** the plans that the lower bound speaks of */
    proof_space: "detours" | "direct";
    /** the critical path of the steps, in seconds */
    makespan: number;
    /** one step after another */
    seconds: number;
    /** as the plan is carried out: what can start or end at once, does */
    duration?: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
    /** of roles, ever below their baseline */
    degraded: string[];
    /** when and why each of them is below its baseline */
    degradations: Degradation[];
    /** what is in another mode for good */
    level_shifts: LevelShift[];
    /** what is kept, what is lost, and what is not measurable */
    continuity?: Assessments;
    start: SpecificationForm;
    target: SpecificationForm;
    /** what it would cost to keep what degrades, where that was asked for */
    alternatives?: Alternative[];
    steps: (CreateStep | RemoveStep | AttachStep | DetachStep | DegradeStep | UpgradeStep | HandoverStep | SetStep)[];
    /** by role, at the start: instances without their role's name; null: none is live */
    start_instances?: Record<string, string | null>;
    /** at the start: the modes that are not the best possible */
    start_modes?: Record<string, string>;
    /** of parameters, set at run time, and what becomes of them */
    parameters?: RuntimeValue[];
    /** by new instance: why it starts with its own state */
    own_state?: Record<string, string>;
    /** what is done besides, and why */
    remarks?: string[];
    /** what is done beyond the change itself */
    detours?: DetourForm[];
    /** of the lower bound, which add up to it; absent where there is none */
    certificate?: BoundPartForm[];
    /** how long steps took in earlier runs: what is expected, the shortest and the longest (s); only of a plan whose proof covers detours, since it rests on steps that the plan does not take */
    measured?: Record<string, [number, number, number]>;
  }

  /** A plan without the specifications that it starts from and leads to. */
  interface PlanPreview {
    strategy: string;
    proved_minimal: boolean;
    /** in weighted functionality-seconds */
    disruption: number;
    lower_bound: number;
    /** the plans that the lower bound speaks of */
    proof_space: "detours" | "direct";
    /** the critical path of the steps, in seconds */
    makespan: number;
    /** one step after another */
    seconds: number;
    /** as the plan is carried out: what can start or end at once, does */
    duration?: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
    /** of roles, ever below their baseline */
    degraded: string[];
    /** when and why each of them is below its baseline */
    degradations: Degradation[];
    /** what is in another mode for good */
    level_shifts: LevelShift[];
    /** what is kept, what is lost, and what is not measurable */
    continuity?: Assessments;
    steps: (CreateStep | RemoveStep | AttachStep | DetachStep | DegradeStep | UpgradeStep | HandoverStep | SetStep)[];
    /** by role, at the start: instances without their role's name; null: none is live */
    start_instances?: Record<string, string | null>;
    /** at the start: the modes that are not the best possible */
    start_modes?: Record<string, string>;
    /** of parameters, set at run time, and what becomes of them */
    parameters?: RuntimeValue[];
    /** by new instance: why it starts with its own state */
    own_state?: Record<string, string>;
    /** what is done besides, and why */
    remarks?: string[];
    /** what is done beyond the change itself */
    detours?: DetourForm[];
    /** of the lower bound, which add up to it; absent where there is none */
    certificate?: BoundPartForm[];
    /** how long steps took in earlier runs: what is expected, the shortest and the longest (s); only of a plan whose proof covers detours, since it rests on steps that the plan does not take */
    measured?: Record<string, [number, number, number]>;
  }

  /** A plan, and the revision of the configuration that it was made for: `expected` of a change. `forbidden`: why it may not be carried out now; absent: it may. `requires`: what has to hold for that, and whether it does. */
  interface PlannedChange {
    strategy: string;
    proved_minimal: boolean;
    /** in weighted functionality-seconds */
    disruption: number;
    lower_bound: number;
    /** the plans that the lower bound speaks of */
    proof_space: "detours" | "direct";
    /** the critical path of the steps, in seconds */
    makespan: number;
    /** one step after another */
    seconds: number;
    /** as the plan is carried out: what can start or end at once, does */
    duration?: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
    /** of roles, ever below their baseline */
    degraded: string[];
    /** when and why each of them is below its baseline */
    degradations: Degradation[];
    /** what is in another mode for good */
    level_shifts: LevelShift[];
    /** what is kept, what is lost, and what is not measurable */
    continuity?: Assessments;
    start: SpecificationForm;
    target: SpecificationForm;
    /** what it would cost to keep what degrades, where that was asked for */
    alternatives?: Alternative[];
    steps: (CreateStep | RemoveStep | AttachStep | DetachStep | DegradeStep | UpgradeStep | HandoverStep | SetStep)[];
    /** by role, at the start: instances without their role's name; null: none is live */
    start_instances?: Record<string, string | null>;
    /** at the start: the modes that are not the best possible */
    start_modes?: Record<string, string>;
    /** of parameters, set at run time, and what becomes of them */
    parameters?: RuntimeValue[];
    /** by new instance: why it starts with its own state */
    own_state?: Record<string, string>;
    /** what is done besides, and why */
    remarks?: string[];
    /** what is done beyond the change itself */
    detours?: DetourForm[];
    /** of the lower bound, which add up to it; absent where there is none */
    certificate?: BoundPartForm[];
    /** how long steps took in earlier runs: what is expected, the shortest and the longest (s); only of a plan whose proof covers detours, since it rests on steps that the plan does not take */
    measured?: Record<string, [number, number, number]>;
    revision: number;
    forbidden?: string;
    requires?: RequirementStatus[];
  }

  /** A port of an instance on a topic, or on none, with what its component measures there on its ROS clock. In the stream, measurements are rounded, and refreshed where they change noticeably. */
  interface PortStatus {
    name: string;
    direction: "in" | "out";
    /** that write to it, or use it */
    functionalities: string[];
    /** the `name` in `topics`; null: it is attached to none */
    topic: string | null;
    type: string | null;
    /** null: an input, or not known */
    gate: "closed" | "open" | null;
    /** the rate (Hz) that is guaranteed or assumed now */
    declared: number | null;
    /** as measured (Hz) */
    rate: number | null;
    /** the rate is at least 90 % of the declared one; null until a whole window is measured */
    met: boolean | null;
    /** of the last message (s) */
    age: number | null;
    /** standard deviation of the times between messages (s) */
    jitter: number | null;
    /** the longest time between messages, or since the last one (s) */
    longest: number | null;
    /** over which all of this is measured (s); null: nothing is */
    window?: number | null;
    fields?: FieldStatus[];
    /** it would use intra-process communication, which goes past a gate, without one */
    kept_out: boolean;
  }

  /** A guarantee or an assumption: what messages are like, or how soon a service or ROS action answers. */
  interface PredicateForm {
    /** the type of a message, pkg/msg/Type or pkg/Type, of a service, pkg/srv/Type, or of a ROS action, pkg/action/Type */
    type: string;
    /** in Hz, at least */
    rate?: number;
    qos?: QoSForm;
    /** the values that fields may have, by dotted path */
    where?: Record<string, ValuesForm>;
    /** within which a request is answered, or a goal accepted or rejected */
    within_seconds?: number;
  }

  /** The program of an instance, as far as it is known. */
  interface ProgramStatus {
    name: string;
    role: string;
    /** its script, the modules that it has imported, and what `run` names */
    files: string[];
    /** those that have changed on disk since it started */
    changed: string[];
    /** what is not known of it */
    unknown: string | null;
    /** whether the manager can start it: its component has a `run` command */
    startable: boolean;
    /** the file of the package's executable that its `run` names, as the manager finds it */
    executable: string | null;
  }

  /** A QoS profile; what is not stated is ROS 2's default. */
  interface QoSForm {
    reliability?: "best_effort" | "reliable";
    durability?: "transient_local" | "volatile";
    deadline_seconds?: number;
    liveliness?: "automatic" | "manual_by_topic";
    lease_seconds?: number;
    depth?: number;
    history?: "keep_all" | "keep_last";
    lifespan_seconds?: number;
  }

  /** The results of the seeds, as `midstride simulate --json` prints them. */
  interface Rehearsal {
    seeds: number;
    /** how often the change ended in each way */
    outcomes: Record<string, number>;
    /** by kind of fault: how often it struck, and how often each branch of recovery followed */
    faults: Record<string, Record<string, number>>;
    /** those that violate an invariant */
    failed: RehearsedSeed[];
  }

  /** The result of one seed: the invariants that it violates, and how the change and its recovery ended. */
  interface RehearsedSeed {
    seed: number;
    problems: string[];
    outcomes: string[];
  }

  /** An instance is ended. */
  interface RemoveStep {
    action: "remove";
    instance: string;
    seconds: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** The data in a report file. Either `change` or `plans` is given; a plan is as POST /plan answers. */
  interface ReportDocument {
    version: number;
    /** the version of Midstride that has written it */
    midstride: string;
    /** unix seconds */
    written: number;
    system: string;
    backend: string | null;
    title: string;
    change: Record<string, unknown> | null;
    /** by strategy; `refused`: why there is none */
    plans: Record<string, Record<string, unknown>> | null;
    /** the system as modelled when the plan began */
    before: SystemView | null;
    /** and when all its steps are done */
    after: SystemView | null;
    /** what changes require, of a plan for which it was not judged */
    required: string[];
  }

  /** A requirement for changes of a topic, and whether it holds now; what is unknown does not hold. */
  interface RequirementStatus {
    /** as the specification states it */
    requirement: string;
    topic: string;
    /** restarts of what has crashed, and restoring, require it as well */
    recovery: boolean;
    holds: boolean;
    /** why it does not hold */
    because: string | null;
  }

  /** Something of which there is a limited amount. */
  interface ResourceForm {
    capacity?: number;
    /** the host that has it, which the key ends with: `gpu on arm` */
    host?: string;
  }

  /** The policy for starting a crashed node again; `{}`: with the defaults. */
  interface RespawnForm {
    /** the delay before the first restart */
    delay_seconds?: number;
    /** the longest delay; unless stated 30 s, or the first one */
    max_delay_seconds?: number;
    max_retries?: number | null;
    /** the time in which restarts count */
    window_seconds?: number;
    /** what then replaces the node */
    fallback?: string;
    /** where the fallback runs; empty: the host of the manager */
    fallback_host?: string;
    /** how long the node writes on while its host cannot be reached; unless stated 5 s */
    lease_seconds?: number;
  }

  /** The state of the restart policy of a crashed node: how many of its restarts are used up, and what is next. */
  interface RespawnStatus {
    /** false: its restarts are used up */
    restarting: boolean;
    /** until the next restart; null: it has begun, or there is none */
    seconds: number | null;
    restarts: number;
    /** in the window; null: no limit */
    max_retries: number | null;
    /** the time in which restarts count, in seconds */
    window: number;
    words: string;
  }

  /** The command that is being carried out, and for how long. */
  interface RunningCommand {
    command: string;
    seconds?: number;
  }

  /** A parameter value that was set while the node ran, and what becomes of it in a change. `kept`: the node keeps it. `file_wins`: the specification changed the value as well. `left_behind`: the new component does not declare the parameter. `not_kept`: the request says to start from the file. `late`: it was set on the old instance when the new one had taken over, and the new one refused it. `refused`: the new node, which does not use Midstride's API, refused it. Of a change that sets parameters: `set`: the node has the value. `set_back`: the change was rolled back, and the node had the value for `seconds`; `not_set_back`: it has it still. `not_set`: it has not accepted it. `origin`: `unknown` where a node without Midstride's API has another value than at its start, and that is not known to have been set: a ROS tool has set it, or the node itself. `node`: the node itself has, as nothing has asked it to set that parameter. `set_at`: when a request has set it, where that was noted. */
  interface RuntimeValue {
    node: string;
    parameter: string;
    /** the value of a parameter; a list is of one kind */
    value: boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[];
    fate: "file_wins" | "kept" | "late" | "left_behind" | "not_kept" | "not_set" | "not_set_back" | "refused" | "set" | "set_back";
    origin: "node" | "set" | "unknown";
    /** at most so long */
    seconds?: number;
    /** when a request has set it (Unix time, s) */
    set_at?: number;
    /** the same for people */
    words: string;
  }

  /** A section of a parameter file, for further nodes in a process. */
  interface SectionForm {
    /** as rcl matches it to nodes */
    name: string;
    /** its parameters */
    parameters?: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
  }

  /** The manager that answers, and whether its system is up. */
  interface Service {
    system: string;
    backend: string;
    version: string;
    pid: number;
    phase: "down" | "failed" | "starting" | "up";
    /** the version of the control protocol; 0: of one that does not say */
    protocol: number;
  }

  /** A service: its type, and within what time (s) requests are answered. */
  interface ServiceForm {
    /** the type of the service, pkg/srv/Type */
    type: string;
    /** within which a request is answered, or a goal accepted or rejected */
    within_seconds?: number;
    /** the name in the ROS graph, where it differs */
    service?: string;
  }

  /** Parameters of a live instance are set in place: `before` has the values it has, if they are set at run time. */
  interface SetStep {
    action: "set";
    instance: string;
    parameters: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    seconds: number;
    before?: Record<string, boolean | number | string | Record<string, "-inf" | "inf" | "nan"> | (boolean | number | string | Record<string, "-inf" | "inf" | "nan">)[]>;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** The container of a system that loads an instance. */
  interface SharedContainerForm {
    /** an executable of its package */
    run?: string;
    /** its package */
    package?: string;
    /** the words before its program */
    prefix?: string;
    /** variables of its process; null: not inherited */
    environment?: Record<string, string | null>;
    takes_seconds?: number;
    stop_seconds?: StopForm;
    /** the host that it runs on; empty: that of the manager */
    host?: string;
    name: string;
    /** parameters of further nodes in its process, as files order them */
    sections?: SectionForm[];
  }

  /** The program of a container that several nodes share, with how its process is started and ended. */
  interface SharedProgramForm {
    /** an executable of its package */
    run?: string;
    /** its package */
    package?: string;
    /** the words before its program */
    prefix?: string;
    /** variables of its process; null: not inherited */
    environment?: Record<string, string | null>;
    takes_seconds?: number;
    stop_seconds?: StopForm;
    /** the host that it runs on; empty: that of the manager */
    host?: string;
  }

  /** A component that does not answer, or a port that has been silent for so long (null: unknown). */
  interface SilenceFault {
    kind: "not_answering" | "not_discovering" | "not_publishing" | "not_receiving" | "not_responding" | "unreachable";
    instance: string;
    port: string | null;
    topic: string | null;
    seconds?: number | null;
    words: string;
  }

  /** The processes that are kept ready for the next components. */
  interface SpareStatus {
    kept: number;
    ready: number;
    /** instances whose command no spare can run */
    unused_by: string[];
  }

  /** A whole specification: what a robot's software is made of. */
  interface SpecificationForm {
    system: string;
    /** the topics, by full name */
    topics?: Record<string, TopicForm>;
    /** the services, by full name */
    services?: Record<string, ServiceForm>;
    /** the ROS actions, by full name */
    actions?: Record<string, ActionForm>;
    /** what there is a limited amount of */
    resources?: Record<string, ResourceForm>;
    /** what holds without any node */
    environment?: Record<string, OfferForm>;
    /** types of nodes */
    components?: Record<string, ComponentForm>;
    /** what composable nodes share, by name, namespaces in front */
    containers?: Record<string, SharedProgramForm>;
    /** the computers besides that of the manager, by name */
    hosts?: Record<string, HostForm>;
    /** the nodes, by name, namespaces in front */
    nodes?: Record<string, NodeForm>;
    constraints?: ConstraintForm[];
    timing_seconds?: TimingForm;
    /** what has to hold, all of it, for a change to happen */
    changes_require?: ChangeRequirementForm[];
  }

  /** A version of the specification. */
  interface SpecificationVersion {
    version: number;
    specification: SpecificationForm;
  }

  /** State has moved to a replacement, from or to a node without Midstride's API, and what waited for it. */
  interface StateMove {
    bytes: number;
    /** seconds from the last message of the old node to the first of the new one; null: none */
    silent: number | null;
    /** seconds for which requests to its services were held */
    held: number;
    words: string;
  }

  /** A step that was begun; without an outcome, its end is not recorded. */
  interface StepRecord {
    words: string;
    outcome: "done" | "failed" | "incomplete" | "refused" | "rolled_back" | null;
    seconds: number | null;
  }

  /** The duration of a step, and its begin after the first one, in seconds. Steps that overlap are in one round. */
  interface StepTime {
    /** its number in the plan, from 1 */
    step: number;
    began: number;
    seconds: number;
  }

  /** A step of a change: when it began, and when it was done. Steps that overlap were carried out at once. */
  interface StepView {
    /** from 0, in `plan.steps` */
    index: number;
    words: string;
    /** seconds since 1970 */
    began: number;
    ended: number | null;
    failed: boolean;
  }

  /** The way to end a program without Midstride's API: with SIGINT, after a time SIGTERM, after another SIGKILL. A signal that has 0 s to take effect is not sent. */
  interface StopForm {
    /** how long after SIGINT */
    sigterm?: number;
    /** how long after SIGTERM */
    sigkill?: number;
    /** how long it answers what it has taken */
    drain?: number;
    /** how long its goals may take to end */
    patience?: number;
  }

  /** A request to be carried out. `expected`: refuse it unless the configuration still has that revision. `verify`: refuse it unless Alloy finds every step of the plan safe, and verify the live configuration after each of them. `brief`: the next command does not wait until this change has been measured over 20 periods. `wait`: after how many seconds a hung component that is being replaced is fenced: replaced although its code does not return. `file`: the one that `to` was read from. `id`: any text; the events `waiting` and `command` of this change contain it, and those that follow until the next `command` belong to it. `by`: who asks, and for what, for the history. `despite_lock`: also while the system is locked; `despite_requirements`: although what its changes require does not hold. */
  interface SubmittedChange {
    request: ChangeRequest;
    expected?: number | null;
    verify?: boolean;
    brief?: boolean;
    wait?: number;
    file?: string | null;
    id?: string | null;
    by?: string | null;
    despite_lock?: boolean;
    despite_requirements?: boolean;
  }

  /** A change to be rehearsed on the running specification, with faults that are drawn from a seed each time. `seeds`: how often; `first`: the first of the seeds. After `seconds` no further one is begun. */
  interface SubmittedRehearsal {
    request: ChangeRequest;
    seeds?: number;
    first?: number;
    seconds?: number;
  }

  /** The text of a specification: JSON where `name` ends in `.json`, else the Stride language. */
  interface SubmittedText {
    text: string;
    /** for the diagnostics */
    name?: string;
  }

  /** A topic, the output that stops publishing on it and the one that starts. */
  interface SwapForm {
    topic: string;
    old: string;
    new: string;
  }

  /** The figures of one subscriber of one swapped topic. ``period`` and ``gap`` in seconds; None if unknown. */
  interface SwapReport {
    topic: string;
    subscriber: string;
    period: number | null;
    gap: number | null;
    gap_periods: number | null;
    missed: number | null;
    lost: number | null;
    duplicates: number | null;
  }

  /** The condition of a system: `degraded` where anything is missing or worse than it should be. It is about the components. Whether a configuration is valid is a word about the manager's model. */
  interface SystemCondition {
    state: "degraded" | "down" | "up";
    headline: string;
    /** what is missing or worse than it should be */
    faults: string[];
    /** what is not measurable here */
    unknown: string[];
    /** outputs somewhat below the rates that they guarantee: no faults */
    slow: string[];
  }

  /** The running system, and the change in it. */
  interface SystemView {
    system: string;
    backend: string;
    revision: number;
    /** the command in progress */
    running: RunningCommand | null;
    /** null: the system is not locked */
    lock: ChangeLock | null;
    /** what changes require */
    requirements: RequirementStatus[];
    /** what runs, and what is missing or worse than it should be */
    condition: SystemCondition;
    /** the configuration is, and its components report what the model has */
    valid: boolean;
    violations: string[];
    instances: InstanceStatus[];
    topics: TopicStatus[];
    crashed: CrashedInstance[];
    silences: SilenceFault[];
    /** why the state or the journal could not be written to disk */
    unwritten: string | null;
    /** where a damaged journal is kept, and what was wrong with it */
    damaged: string | null;
    /** the file that was brought up, or applied last */
    file: string | null;
    /** another command has changed the specification since then */
    changed_since: boolean;
    middleware: Middleware;
    spares: SpareStatus;
    /** other than the manager's */
    hosts: HostStatus[];
    version: number;
    /** of this run of the manager: numbers of another one mean nothing to it */
    manager: string;
    /** the number of this state: it grows with each that differs */
    n: number;
    /** seconds since 1970 */
    at: number;
    phase: "down" | "failed" | "starting" | "up";
    change: ChangeView | null;
  }

  /** The events between two times, as far as this manager remembers it; GET /history knows of earlier ones. */
  interface Timeline {
    manager: string;
    /** seconds since 1970 */
    since: number;
    /** seconds since 1970 */
    until: number;
    /** the view of no earlier time than this is known: GET /view/at */
    oldest: number;
    /** those that overlap the time, by their beginning */
    modes: ModeInterval[];
    changes: PastChange[];
    /** all kinds, also crashes (`exited`) */
    events: Event[];
  }

  /** The durations of steps, where known, and what a hand-over takes its time for. */
  interface TimingForm {
    attach?: number;
    create?: number;
    degrade?: number;
    detach?: number;
    handover?: number;
    probation?: number;
    probation_timeout?: number;
    remove?: number;
    set?: number;
    state_timeout?: number;
    upgrade?: number;
    watch_after?: number;
  }

  /** A topic: its contract, and how many may publish on it. */
  interface TopicForm {
    /** the message type, pkg/msg/Type or pkg/Type */
    type: string;
    /** in Hz, at least */
    rate?: number;
    qos?: QoSForm;
    /** the values that fields may have, by dotted path */
    where?: Record<string, ValuesForm>;
    max_publishers?: number;
    /** the name in the ROS graph, where it differs */
    topic?: string;
  }

  /** A topic, service or ROS action. `topic` is its name in ROS, which differs from `name` only while its contract is being changed. */
  interface TopicStatus {
    name: string;
    topic: string;
    type: string;
    /** that its contract guarantees (Hz) */
    rate: number | null;
    /** its contract, in the manager's model */
    satisfied: boolean;
    /** attached outputs, as `talker.out`; of a service, its server */
    publishers: string[];
    /** attached inputs; of a service, its clients */
    subscribers: string[];
    /** publishers outside the system, that the specification declares */
    outside: string[];
    /** the nodes that publish or listen where no port does; null: ports do both, or it is not known */
    others?: OtherEndpoints | null;
  }

  /** The end of a lock. */
  interface UnlockRequest {
    by: string;
  }

  /** The system is up, with these instances; `incomplete`: without those that are `missing`. */
  interface UpReport {
    outcome: "done" | "incomplete";
    instances: string[];
    /** what is not in its normal mode */
    degraded: DegradedFunctionality[];
    /** why nodes could not be started */
    missing: Record<string, string>;
    /** what an earlier manager had left half done and was ended, and what that has cost */
    half_done: string[];
  }

  /** Functionalities enter better modes. */
  interface UpgradeStep {
    action: "upgrade";
    modes: Record<string, ModeChangeForm>;
    seconds: number;
    /** the shortest and the longest, as measured or stated (s) */
    between?: [number, number];
  }

  /** A set of values: all that is stated holds. */
  interface ValuesForm {
    "="?: boolean | number | string;
    in?: (boolean | number | string)[];
    ">="?: number;
    ">"?: number;
    "<="?: number;
    "<"?: number;
  }

  /** The answer to one question. ``steps`` are a plan's; ``failed`` is the first that fails. */
  interface Verdict {
    verdict: Answer;
    subject: string;
    scope: string;
    by: string;
    because: string | null;
    findings: Finding[];
    steps: string[];
    failed: number | null;
    seconds: number;
  }

  /** The reason why a functionality of a node is in its mode: its own, what each better mode lacks, and what to do. */
  interface Why {
    functionality: string;
    /** of the node: the one that was looked at */
    instance: string;
    /** of the specification; left out: that of the manager */
    host?: string;
    mode: string;
    normal: boolean;
    because: string | null;
    chain: string[];
    /** whether each input is satisfied */
    inputs: Record<string, boolean>;
    /** what comes next, or what to do, for each root cause */
    remedies: string[];
  }
}
