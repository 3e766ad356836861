/*
 * talker: a plan of 7 steps, by strategy paper
 *
 * Each atom below is one element of the file, and every relation is complete. Execute
 *   Verified     no counterexample: configurations are valid, steps are allowed and have the stated effect
 *   Rules        no counterexample: satisfaction is a preorder, and the declarations obey M1 and M2
 *   Verdict      always has an instance: the fields of Findings list what does not hold
 *   Best         no counterexample: at the end no functionality could be in a better mode
 */

one sig String_10Hz extends Predicate {}  -- std_msgs/msg/String @ 10 Hz

one sig assume_listener_in extends NamedInputs {}  -- listener.in

one sig listener_in extends Input {}  -- listener.in : std_msgs/msg/String @ 10 Hz

one sig talker_out extends Output {}    -- talker.out
one sig talker_2_out extends Output {}  -- talker_2.out

one sig topic_chatter extends Connector {}  -- /chatter : std_msgs/msg/String @ 10 Hz

one sig listener_listen_normal extends Mode {}    -- listener.listen in mode normal
one sig listener_listen_degraded extends Mode {}  -- listener.listen in mode degraded
one sig talker_talk_normal extends Mode {}        -- talker.talk in mode normal
one sig talker_talk_degraded extends Mode {}      -- talker.talk in mode degraded
one sig talker_2_talk_normal extends Mode {}      -- talker_2.talk in mode normal
one sig talker_2_talk_degraded extends Mode {}    -- talker_2.talk in mode degraded

one sig listener_listen_f extends Functionality {}  -- listener.listen
one sig talker_talk_f extends Functionality {}      -- talker.talk
one sig talker_2_talk_f extends Functionality {}    -- talker_2.talk

one sig listener extends Component {}  -- listener, a Listener
one sig talker extends Component {}    -- talker, a Talker
one sig talker_2 extends Component {}  -- talker_2, a NewTalker

one sig S0 extends System {}  -- at the start
one sig S1 extends System {}  -- after step 1
one sig S2 extends System {}  -- after step 2
one sig S3 extends System {}  -- after step 3
one sig S4 extends System {}  -- after step 4
one sig S5 extends System {}  -- after step 5
one sig S6 extends System {}  -- after step 6
one sig S7 extends System {}  -- after step 7
one sig S8 extends System {}  -- at the target

fun sat: Predicate -> Predicate { String_10Hz -> String_10Hz }
fun named: NamedInputs -> Input { assume_listener_in -> listener_in }
fun input_asm: Input -> Predicate { listener_in -> String_10Hz }
fun conn_guar: Connector -> Predicate { topic_chatter -> String_10Hz }
fun mode_asms: Mode -> Assumption { listener_listen_normal -> assume_listener_in }
fun mode_guars: Mode -> Output -> Predicate { talker_talk_normal -> talker_out -> String_10Hz + talker_2_talk_normal
  -> talker_2_out -> String_10Hz }
fun worse: Mode -> Mode { listener_listen_normal -> listener_listen_degraded + talker_talk_normal ->
  talker_talk_degraded + talker_2_talk_normal -> talker_2_talk_degraded }
fun assoc_inputs: Functionality -> Input { listener_listen_f -> listener_in }
fun assoc_outputs: Functionality -> Output { talker_talk_f -> talker_out + talker_2_talk_f -> talker_2_out }
fun modes: Functionality -> Mode { listener_listen_f -> (listener_listen_normal + listener_listen_degraded) +
  talker_talk_f -> (talker_talk_normal + talker_talk_degraded) + talker_2_talk_f -> (talker_2_talk_normal +
  talker_2_talk_degraded) }
fun inputs: Component -> Input { listener -> listener_in }
fun outputs: Component -> Output { talker -> talker_out + talker_2 -> talker_2_out }
fun funcs: Component -> Functionality { listener -> listener_listen_f + talker -> talker_talk_f + talker_2 ->
  talker_2_talk_f }
fun on: Publisher -> Connector { none -> none }
fun pub_guar: Publisher -> Predicate { none -> none }
fun slots: Connector -> Slot { none -> none }
fun holders: Overload -> Component { none -> none }
fun comps: System -> Component { System -> listener + (S0 + S1 + S2) -> talker + (S4 + S5 + S6 + S7 + S8) ->
  talker_2 }
fun conns: System -> Connector { System -> topic_chatter }
fun roles: System -> Connector -> Port { System -> (topic_chatter -> listener_in) + (S0 + S1) -> (topic_chatter ->
  talker_out) + (S6 + S7 + S8) -> (topic_chatter -> talker_2_out) }
fun cur_mode: System -> Functionality -> Mode { (S0 + S7 + S8) -> (listener_listen_f -> listener_listen_normal) +
  (S0 + S1 + S2) -> (talker_talk_f -> talker_talk_normal) + (S1 + S2 + S3 + S4 + S5 + S6) -> (listener_listen_f ->
  listener_listen_degraded) + S4 -> (talker_2_talk_f -> talker_2_talk_degraded) + (S5 + S6 + S7 + S8) ->
  (talker_2_talk_f -> talker_2_talk_normal) }
fun env_guars: System -> Predicate { none -> none }
fun env_pubs: System -> Publisher { none -> none }
fun Capped: set Connector { none }

abstract sig Step {}

/* step 1: degrade listener.listen from normal to degraded */
one sig step1 extends Step {}
pred step1_may { can_degrade_all[S0, listener_listen_f -> listener_listen_degraded] }
pred step1_holds { degrade_all[S0, S1, listener_listen_f -> listener_listen_degraded] }

/* step 2: detach talker.out from /chatter */
one sig step2 extends Step {}
pred step2_may { can_detach[S1, topic_chatter, talker_out] }
pred step2_holds { detach[S1, S2, topic_chatter, talker_out] }

/* step 3: remove talker */
one sig step3 extends Step {}
pred step3_may { can_remove[S2, talker] }
pred step3_holds { remove[S2, S3, talker] }

/* step 4: create talker_2 (NewTalker) */
one sig step4 extends Step {}
pred step4_may { can_create_within[S3, talker_2] }
pred step4_holds { can_create_within[S3, talker_2] and create[S3, S4, talker_2] }

/* step 5: upgrade talker_2.talk from degraded to normal */
one sig step5 extends Step {}
pred step5_may { can_upgrade_all[S4, talker_2_talk_f -> talker_2_talk_normal] }
pred step5_holds { upgrade_all[S4, S5, talker_2_talk_f -> talker_2_talk_normal] }

/* step 6: attach talker_2.out to /chatter */
one sig step6 extends Step {}
pred step6_may { can_attach_within[S5, topic_chatter, talker_2_out] }
pred step6_holds { can_attach_within[S5, topic_chatter, talker_2_out] and attach[S5, S6, topic_chatter, talker_2_out] }

/* step 7: upgrade listener.listen from degraded to normal */
one sig step7 extends Step {}
pred step7_may { can_upgrade_all[S6, listener_listen_f -> listener_listen_normal] }
pred step7_holds { upgrade_all[S6, S7, listener_listen_f -> listener_listen_normal] }

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
  Findings.missing = S8.roles - S7.roles
  Findings.extra = S7.roles - S8.roles
  Findings.absent = S8.comps - S7.comps
  Findings.left = S7.comps - S8.comps
  step1 in Findings.refused iff not step1_may
  step1 in Findings.wrong iff step1_may and not step1_holds
  step2 in Findings.refused iff not step2_may
  step2 in Findings.wrong iff step2_may and not step2_holds
  step3 in Findings.refused iff not step3_may
  step3 in Findings.wrong iff step3_may and not step3_holds
  step4 in Findings.refused iff not step4_may
  step4 in Findings.wrong iff step4_may and not step4_holds
  step5 in Findings.refused iff not step5_may
  step5 in Findings.wrong iff step5_may and not step5_holds
  step6 in Findings.refused iff not step6_may
  step6 in Findings.wrong iff step6_may and not step6_holds
  step7 in Findings.refused iff not step7_may
  step7 in Findings.wrong iff step7_may and not step7_holds
}

/* The better modes that exist at the end; no upgrade to any of them is allowed. */
fun better: Functionality -> Mode {
  { f: S7.comps.funcs, m: f.modes | S7.cur_mode[f] in m.worse }
}
assert Best {
  all to: better.Mode -> Functionality.better | to in better => not can_upgrade_all[S7, to]
}
assert Verified {
  all s: System | valid[s]
  step1_holds
  step2_holds
  step3_holds
  step4_holds
  step5_holds
  step6_holds
  step7_holds
  S7.comps = S8.comps and S7.roles = S8.roles
}
assert Rules { rules }

check Verified for 1 but exactly 1 Predicate, exactly 1 NamedInputs, exactly 1 Input, exactly 2 Output, exactly 1 Connector, exactly 6 Mode, exactly 3 Functionality, exactly 3 Component, exactly 0 Publisher, exactly 9 System, exactly 0 Slot, exactly 0 Overload, 3 Int
check Rules for 1 but exactly 1 Predicate, exactly 1 NamedInputs, exactly 1 Input, exactly 2 Output, exactly 1 Connector, exactly 6 Mode, exactly 3 Functionality, exactly 3 Component, exactly 0 Publisher, exactly 9 System, exactly 0 Slot, exactly 0 Overload, 3 Int
run Verdict { findings } for 1 but exactly 1 Predicate, exactly 1 NamedInputs, exactly 1 Input, exactly 2 Output, exactly 1 Connector, exactly 6 Mode, exactly 3 Functionality, exactly 3 Component, exactly 0 Publisher, exactly 9 System, exactly 0 Slot, exactly 0 Overload, 3 Int
check Best for 1 but exactly 1 Predicate, exactly 1 NamedInputs, exactly 1 Input, exactly 2 Output, exactly 1 Connector, exactly 6 Mode, exactly 3 Functionality, exactly 3 Component, exactly 0 Publisher, exactly 9 System, exactly 0 Slot, exactly 0 Overload, 3 Int

