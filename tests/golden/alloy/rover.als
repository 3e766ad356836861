/*
 * rover: a plan of 4 steps, by strategy minimal
 *
 * Each atom below is one element of the file, and every relation is complete. Execute
 *   Verified     no counterexample: configurations are valid, steps are allowed and have the stated effect
 *   Rules        no counterexample: satisfaction is a preorder, and the declarations obey M1 and M2
 *   Verdict      always has an instance: the fields of Findings list what does not hold
 *   Best         no counterexample: at the end no functionality could be in a better mode
 */

one sig Twist_10Hz extends Predicate {}  -- geometry_msgs/msg/Twist @ 10 Hz
one sig Image_10Hz extends Predicate {}  -- sensor_msgs/msg/Image @ 10 Hz

one sig assume_motor_in extends NamedInputs {}    -- motor.in
one sig assume_planner_in extends NamedInputs {}  -- planner.in

one sig motor_in extends Input {}    -- motor.in : geometry_msgs/msg/Twist @ 10 Hz
one sig planner_in extends Input {}  -- planner.in : sensor_msgs/msg/Image @ 10 Hz

one sig left_out extends Output {}     -- left.out
one sig planner_cmd extends Output {}  -- planner.cmd
one sig right_out extends Output {}    -- right.out
one sig left_2_out extends Output {}   -- left_2.out

one sig topic_cmd extends Connector {}    -- /cmd : geometry_msgs/msg/Twist @ 10 Hz
one sig topic_image extends Connector {}  -- /image : sensor_msgs/msg/Image @ 10 Hz

one sig left_see_normal extends Mode {}        -- left.see in mode normal
one sig left_see_degraded extends Mode {}      -- left.see in mode degraded
one sig motor_drive_normal extends Mode {}     -- motor.drive in mode normal
one sig motor_drive_degraded extends Mode {}   -- motor.drive in mode degraded
one sig planner_plan_normal extends Mode {}    -- planner.plan in mode normal
one sig planner_plan_degraded extends Mode {}  -- planner.plan in mode degraded
one sig right_see_normal extends Mode {}       -- right.see in mode normal
one sig right_see_degraded extends Mode {}     -- right.see in mode degraded
one sig left_2_see_normal extends Mode {}      -- left_2.see in mode normal
one sig left_2_see_degraded extends Mode {}    -- left_2.see in mode degraded

one sig left_see_f extends Functionality {}      -- left.see
one sig motor_drive_f extends Functionality {}   -- motor.drive
one sig planner_plan_f extends Functionality {}  -- planner.plan
one sig right_see_f extends Functionality {}     -- right.see
one sig left_2_see_f extends Functionality {}    -- left_2.see

one sig left extends Component {}     -- left, a Camera
one sig motor extends Component {}    -- motor, a Motor
one sig planner extends Component {}  -- planner, a Planner
one sig right extends Component {}    -- right, a Camera
one sig left_2 extends Component {}   -- left_2, a NewCamera

one sig S0 extends System {}  -- at the start
one sig S1 extends System {}  -- after step 1
one sig S2 extends System {}  -- after step 2
one sig S3 extends System {}  -- after step 3
one sig S4 extends System {}  -- after step 4
one sig S5 extends System {}  -- at the target

one sig topic_cmd_slot1 extends Slot {}  -- publisher 1 of at most 1 on /cmd

fun sat: Predicate -> Predicate { Twist_10Hz -> Twist_10Hz + Image_10Hz -> Image_10Hz }
fun named: NamedInputs -> Input { assume_motor_in -> motor_in + assume_planner_in -> planner_in }
fun input_asm: Input -> Predicate { motor_in -> Twist_10Hz + planner_in -> Image_10Hz }
fun conn_guar: Connector -> Predicate { topic_cmd -> Twist_10Hz + topic_image -> Image_10Hz }
fun mode_asms: Mode -> Assumption { motor_drive_normal -> assume_motor_in + planner_plan_normal -> assume_planner_in
  }
fun mode_guars: Mode -> Output -> Predicate { left_see_normal -> left_out -> Image_10Hz + planner_plan_normal ->
  planner_cmd -> Twist_10Hz + right_see_normal -> right_out -> Image_10Hz + left_2_see_normal -> left_2_out ->
  Image_10Hz }
fun worse: Mode -> Mode { left_see_normal -> left_see_degraded + motor_drive_normal -> motor_drive_degraded +
  planner_plan_normal -> planner_plan_degraded + right_see_normal -> right_see_degraded + left_2_see_normal ->
  left_2_see_degraded }
fun assoc_inputs: Functionality -> Input { motor_drive_f -> motor_in + planner_plan_f -> planner_in }
fun assoc_outputs: Functionality -> Output { left_see_f -> left_out + planner_plan_f -> planner_cmd + right_see_f ->
  right_out + left_2_see_f -> left_2_out }
fun modes: Functionality -> Mode { left_see_f -> (left_see_normal + left_see_degraded) + motor_drive_f ->
  (motor_drive_normal + motor_drive_degraded) + planner_plan_f -> (planner_plan_normal + planner_plan_degraded) +
  right_see_f -> (right_see_normal + right_see_degraded) + left_2_see_f -> (left_2_see_normal + left_2_see_degraded)
  }
fun inputs: Component -> Input { motor -> motor_in + planner -> planner_in }
fun outputs: Component -> Output { left -> left_out + planner -> planner_cmd + right -> right_out + left_2 ->
  left_2_out }
fun funcs: Component -> Functionality { left -> left_see_f + motor -> motor_drive_f + planner -> planner_plan_f +
  right -> right_see_f + left_2 -> left_2_see_f }
fun on: Publisher -> Connector { none -> none }
fun pub_guar: Publisher -> Predicate { none -> none }
fun slots: Connector -> Slot { topic_cmd -> topic_cmd_slot1 }
fun holders: Overload -> Component { none -> none }
fun comps: System -> Component { (S0 + S1 + S2 + S3) -> left + System -> (motor + planner + right) + (S1 + S2 + S3 +
  S4 + S5) -> left_2 }
fun conns: System -> Connector { System -> (topic_cmd + topic_image) }
fun roles: System -> Connector -> Port { (S0 + S1 + S2) -> (topic_image -> left_out) + System -> (topic_cmd ->
  (motor_in + planner_cmd) + topic_image -> (planner_in + right_out)) + (S3 + S4 + S5) -> (topic_image ->
  left_2_out) }
fun cur_mode: System -> Functionality -> Mode { (S0 + S1 + S2 + S3) -> (left_see_f -> left_see_normal) + System ->
  (motor_drive_f -> motor_drive_normal + planner_plan_f -> planner_plan_normal + right_see_f -> right_see_normal) +
  S1 -> (left_2_see_f -> left_2_see_degraded) + (S2 + S3 + S4 + S5) -> (left_2_see_f -> left_2_see_normal) }
fun env_guars: System -> Predicate { none -> none }
fun env_pubs: System -> Publisher { none -> none }
fun Capped: set Connector { topic_cmd }

abstract sig Step {}

/* step 1: create left_2 (NewCamera) */
one sig step1 extends Step {}
pred step1_may { can_create_within[S0, left_2] }
pred step1_holds { can_create_within[S0, left_2] and create[S0, S1, left_2] }

/* step 2: upgrade left_2.see from degraded to normal */
one sig step2 extends Step {}
pred step2_may { can_upgrade_all[S1, left_2_see_f -> left_2_see_normal] }
pred step2_holds { upgrade_all[S1, S2, left_2_see_f -> left_2_see_normal] }

/* step 3: hand over /image from left.out to left_2.out */
one sig step3 extends Step {}
pred step3_may { some univ and some univ and can_handover_within[S2, topic_image -> left_out -> left_2_out] }
pred step3_holds { some univ and some univ and can_handover_within[S2, topic_image -> left_out -> left_2_out] and handover[S2, S3, topic_image -> left_out -> left_2_out] }

/* step 4: remove left */
one sig step4 extends Step {}
pred step4_may { can_remove[S3, left] }
pred step4_holds { remove[S3, S4, left] }

/* What does not hold. */
abstract sig Clause {}
one sig the_satisfaction_relation_is_not_reflexive_and_transitive extends Clause {}
one sig a_port_functionality_or_mode_does_not_belong_to_exactly_one_component extends Clause {}
one sig the_modes_of_a_functionality_are_not_a_chain extends Clause {}
one sig a_last_mode_has_an_assumption extends Clause {}
one sig a_worse_mode_guarantees_what_a_better_one_does_not extends Clause {}
one sig Findings {
  refused: set Step,
  wrong: set Step,
  invalid: set System,
  faults: set Clause,
  missing: Connector -> Port,
  extra: Connector -> Port,
  absent: set Component,
  left: set Component,
}
pred findings {
  Findings.invalid = { s: System | not valid[s] }
  Findings.faults = (preorder implies none else the_satisfaction_relation_is_not_reflexive_and_transitive) + (declared implies none else a_port_functionality_or_mode_does_not_belong_to_exactly_one_component) + (chains implies none else the_modes_of_a_functionality_are_not_a_chain) + (M1 implies none else a_last_mode_has_an_assumption) + (M2 implies none else a_worse_mode_guarantees_what_a_better_one_does_not)
  Findings.missing = S5.roles - S4.roles
  Findings.extra = S4.roles - S5.roles
  Findings.absent = S5.comps - S4.comps
  Findings.left = S4.comps - S5.comps
  step1 in Findings.refused iff not step1_may
  step1 in Findings.wrong iff step1_may and not step1_holds
  step2 in Findings.refused iff not step2_may
  step2 in Findings.wrong iff step2_may and not step2_holds
  step3 in Findings.refused iff not step3_may
  step3 in Findings.wrong iff step3_may and not step3_holds
  step4 in Findings.refused iff not step4_may
  step4 in Findings.wrong iff step4_may and not step4_holds
}

/* The better modes that exist at the end; no upgrade to any of them is allowed. */
fun better: Functionality -> Mode {
  { f: S4.comps.funcs, m: f.modes | S4.cur_mode[f] in m.worse }
}
assert Best {
  all to: better.Mode -> Functionality.better | to in better => not can_upgrade_all[S4, to]
}
assert Verified {
  all s: System | valid[s]
  step1_holds
  step2_holds
  step3_holds
  step4_holds
  S4.comps = S5.comps and S4.roles = S5.roles
}
assert Rules { rules }

check Verified for 1 but exactly 2 Predicate, exactly 2 NamedInputs, exactly 2 Input, exactly 4 Output, exactly 2 Connector, exactly 10 Mode, exactly 5 Functionality, exactly 5 Component, exactly 0 Publisher, exactly 6 System, exactly 1 Slot, exactly 0 Overload, 3 Int
check Rules for 1 but exactly 2 Predicate, exactly 2 NamedInputs, exactly 2 Input, exactly 4 Output, exactly 2 Connector, exactly 10 Mode, exactly 5 Functionality, exactly 5 Component, exactly 0 Publisher, exactly 6 System, exactly 1 Slot, exactly 0 Overload, 3 Int
run Verdict { findings } for 1 but exactly 2 Predicate, exactly 2 NamedInputs, exactly 2 Input, exactly 4 Output, exactly 2 Connector, exactly 10 Mode, exactly 5 Functionality, exactly 5 Component, exactly 0 Publisher, exactly 6 System, exactly 1 Slot, exactly 0 Overload, 3 Int
check Best for 1 but exactly 2 Predicate, exactly 2 NamedInputs, exactly 2 Input, exactly 4 Output, exactly 2 Connector, exactly 10 Mode, exactly 5 Functionality, exactly 5 Component, exactly 0 Publisher, exactly 6 System, exactly 1 Slot, exactly 0 Overload, 3 Int

