"""Plans: from a running configuration to a target, with the least loss of functionality on the way.

A `request` and the two specifications make a `change` (what differs); a strategy of the `registry` (`minimal`, `paper`,
`quiesce` or `stop`) makes a `plan` (steps and costs) of it. The strategies write their plans with `plan_builder`, which
adds the mode changes that a structural change needs (`mode_ordering`); `minimal` searches the conflict core
(`search_state`, `moves`). `disruption` and `schedule` are the costs, `constraints` what the user asks for, `explain`
the reasons why something degrades, `validate` an independent replay. `impact` and `specification_diff` answer
questions about specifications without a plan.
"""

PUBLIC = (
    "Alternative Change Degradation Estimate LevelShift Levels Origin Overlap Plan PlanLowering PlanRequest "
    "RuntimeValue SET_BY Step Values alternatives change_between decide differences impacts left_behind measured_key "
    "of_change one_by_one overlap planned_instances renamed_components requested_change require require_unbroken_bonds "
    "runtime_value sensitivity setting time_of unmeasured_pair with_time_for_goals with_time_for_state with_times "
    "without_outputs"
)
