"""The model of a robot's software and of safe changes to it. Pure: no I/O, no clock.

Start with these five modules, in this order: `contract` (what messages are like, and when one promise is good enough
for another), `component` (what a component type declares), `configuration` (what runs right now), `rules` (when that
is valid) and `action` (the steps that change it safely).

Beyond them: `specification` (a whole system as its author declares it) and its design-time check
`specification_checks` (with `name_checks` and `component_rules`), which finds `diagnostics`; `best` (the best modes
that a structure allows), `diagnosis` (why a mode is out of reach), `wording` (actions in words).
The JSON forms are in :mod:`midstride.codec`.
"""

PUBLIC = (
    "AUTOSTART Action Assumption Attach BOND_TIMEOUT BOUND_WORDS CANCELLING ChangeRequirement ComponentSpec "
    "Configuration Connector ConnectorKind Constraint ContainerProgram Contract Create DEFAULT_CONTAINER DEFAULT_QOS "
    "DEFAULT_SECONDS DEFAULT_STOP Degrade Detach Diagnosis Durability EnvironmentGuarantee Evaluator FEWEST_PERIODS "
    "FunctionalityRef FunctionalitySpec GATES Gate HANDOVER_SECONDS Handover HistoryPolicy HostSpec "
    "InputAlternatives Instance "
    "Interval KILL_AT_ONCE KIND_WORDS Keep LOST_AT_END Limit Liveliness LoadWords MANAGEMENTS MANAGER MAX_NUMBER "
    "Management "
    "Mode NODE_NAMES NOTHING Node NodeEndpoint OF_PARAMETERS OWN_HOST OneOf Order PRIVATE_NAMES ParameterSection "
    "ParameterSpec "
    "ParameterValue PortRef Predicate Problem QoS ROS_PARAMETERS Reliability Remove Resource RespawnPolicy Scalar "
    "SetParameters Severity SharedContainer Specification StopTimes SubjectPath Swap SystemContext TIMING Upgrade "
    "ValueSet Violation "
    "attachment_shortfall best bond_timeout broken_bond canonical canonical_type cap_violation "
    "capacity_violation check check_component check_node command_files component component_names component_rules "
    "configure connector_kind consumers_of contract_reasons counted did_you_mean dotted_name errors exception_in "
    "explain extra_argument format_number fresh_name full_name handover_seconds has_bonds host_in_words host_of_word "
    "indefinite independent initial "
    "is_infrastructure is_intra_process is_named_after is_of_every_node log_file_name lowered managed_nodes "
    "missing_for_constraints "
    "nearest node_names on_one_line printable probation_seconds publishers_count reasons_against "
    "rebalanced resolved resource_key "
    "roles_of same_value satisfies specification_names split_name suggestion to_fraction unknown_name value_fits "
    "value_kind violations why_it_stays word_of_host wording"
)
