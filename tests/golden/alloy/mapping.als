/*
 * mapping: a plan of 7 steps, by strategy minimal
 *
 * Each atom below is one element of the file, and every relation is complete. Execute
 *   Verified     no counterexample: configurations are valid, steps are allowed and have the stated effect
 *   Rules        no counterexample: satisfaction is a preorder, and the declarations obey M1 and M2
 *   Verdict      always has an instance: the fields of Findings list what does not hold
 *   Best         no counterexample: at the end no functionality could be in a better mode
 */

one sig Trigger extends Predicate {}                -- std_srvs/srv/Trigger
one sig DockRobot_within_0_5s extends Predicate {}  -- nav2_msgs/action/DockRobot accepts within 0.5 s
one sig GetMap_within_0_05s extends Predicate {}    -- nav_msgs/srv/GetMap responds within 0.05 s
one sig LaserScan_10Hz extends Predicate {}         -- sensor_msgs/msg/LaserScan @ 10 Hz
one sig LaserScan_20Hz extends Predicate {}         -- sensor_msgs/msg/LaserScan @ 20 Hz
one sig GetMap_within_0_1s extends Predicate {}     -- nav_msgs/srv/GetMap responds within 0.1 s
one sig DockRobot extends Predicate {}              -- nav2_msgs/action/DockRobot
one sig GetMap_within_0_02s extends Predicate {}    -- nav_msgs/srv/GetMap responds within 0.02 s

one sig assume_docking_map extends NamedInputs {}        -- docking.map
one sig assume_docking_charge extends NamedInputs {}     -- docking.charge
one sig assume_map_server_scan extends NamedInputs {}    -- map_server.scan
one sig assume_mission_dock extends NamedInputs {}       -- mission.dock
one sig assume_map_server_2_scan extends NamedInputs {}  -- map_server_2.scan

one sig docking_map extends Input {}        -- docking.map : nav_msgs/srv/GetMap responds within 0.1 s
one sig docking_charge extends Input {}     -- docking.charge : std_srvs/srv/Trigger
one sig map_server_scan extends Input {}    -- map_server.scan : sensor_msgs/msg/LaserScan @ 10 Hz
one sig mission_dock extends Input {}       -- mission.dock : nav2_msgs/action/DockRobot
one sig map_server_2_scan extends Input {}  -- map_server_2.scan : sensor_msgs/msg/LaserScan @ 10 Hz

one sig docking_dock extends Output {}      -- docking.dock
one sig map_server_map extends Output {}    -- map_server.map
one sig map_server_2_map extends Output {}  -- map_server_2.map

one sig service_charge extends Connector {}  -- /charge : std_srvs/srv/Trigger
one sig action_dock extends Connector {}     -- /dock : nav2_msgs/action/DockRobot accepts within 0.5 s
one sig service_map extends Connector {}     -- /map : nav_msgs/srv/GetMap responds within 0.05 s
one sig topic_scan extends Connector {}      -- /scan : sensor_msgs/msg/LaserScan @ 10 Hz

one sig docking_docking_normal extends Mode {}     -- docking.docking in mode normal
one sig docking_docking_off extends Mode {}        -- docking.docking in mode off
one sig map_server_serve_normal extends Mode {}    -- map_server.serve in mode normal
one sig map_server_serve_off extends Mode {}       -- map_server.serve in mode off
one sig mission_drive_normal extends Mode {}       -- mission.drive in mode normal
one sig mission_drive_off extends Mode {}          -- mission.drive in mode off
one sig map_server_2_serve_normal extends Mode {}  -- map_server_2.serve in mode normal
one sig map_server_2_serve_off extends Mode {}     -- map_server_2.serve in mode off

one sig docking_docking_f extends Functionality {}     -- docking.docking
one sig map_server_serve_f extends Functionality {}    -- map_server.serve
one sig mission_drive_f extends Functionality {}       -- mission.drive
one sig map_server_2_serve_f extends Functionality {}  -- map_server_2.serve

one sig docking extends Component {}       -- docking, a Docking
one sig map_server extends Component {}    -- map_server, a Server
one sig mission extends Component {}       -- mission, a Mission
one sig map_server_2 extends Component {}  -- map_server_2, a QuickServer

one sig environment_charger extends Publisher {}  -- environment charger on /charge : std_srvs/srv/Trigger
one sig environment_lidar extends Publisher {}    -- environment lidar on /scan : sensor_msgs/msg/LaserScan @ 20 Hz

one sig S0 extends System {}  -- at the start
one sig S1 extends System {}  -- after step 1
one sig S2 extends System {}  -- after step 2
one sig S3 extends System {}  -- after step 3
one sig S4 extends System {}  -- after step 4
one sig S5 extends System {}  -- after step 5
one sig S6 extends System {}  -- after step 6
one sig S7 extends System {}  -- after step 7
one sig S8 extends System {}  -- at the target

one sig service_charge_slot1 extends Slot {}  -- server 1 of at most 1 on /charge
one sig action_dock_slot1 extends Slot {}     -- action server 1 of at most 1 on /dock
one sig service_map_slot1 extends Slot {}     -- server 1 of at most 1 on /map

fun sat: Predicate -> Predicate { (Trigger -> Trigger + DockRobot_within_0_5s -> (DockRobot_within_0_5s + DockRobot)
  + GetMap_within_0_05s -> (GetMap_within_0_05s + GetMap_within_0_1s) + LaserScan_10Hz -> LaserScan_10Hz +
  LaserScan_20Hz -> (LaserScan_10Hz + LaserScan_20Hz) + GetMap_within_0_1s -> GetMap_within_0_1s) + (DockRobot ->
  DockRobot + GetMap_within_0_02s -> (GetMap_within_0_05s + GetMap_within_0_1s + GetMap_within_0_02s)) }
fun named: NamedInputs -> Input { assume_docking_map -> docking_map + assume_docking_charge -> docking_charge +
  assume_map_server_scan -> map_server_scan + assume_mission_dock -> mission_dock + assume_map_server_2_scan ->
  map_server_2_scan }
fun input_asm: Input -> Predicate { docking_map -> GetMap_within_0_1s + docking_charge -> Trigger + map_server_scan
  -> LaserScan_10Hz + mission_dock -> DockRobot + map_server_2_scan -> LaserScan_10Hz }
fun conn_guar: Connector -> Predicate { service_charge -> Trigger + action_dock -> DockRobot_within_0_5s +
  service_map -> GetMap_within_0_05s + topic_scan -> LaserScan_10Hz }
fun mode_asms: Mode -> Assumption { docking_docking_normal -> (assume_docking_map + assume_docking_charge) +
  map_server_serve_normal -> assume_map_server_scan + mission_drive_normal -> assume_mission_dock +
  map_server_2_serve_normal -> assume_map_server_2_scan }
fun mode_guars: Mode -> Output -> Predicate { docking_docking_normal -> docking_dock -> DockRobot_within_0_5s +
  map_server_serve_normal -> map_server_map -> GetMap_within_0_05s + map_server_2_serve_normal -> map_server_2_map
  -> GetMap_within_0_02s }
fun worse: Mode -> Mode { docking_docking_normal -> docking_docking_off + map_server_serve_normal ->
  map_server_serve_off + mission_drive_normal -> mission_drive_off + map_server_2_serve_normal ->
  map_server_2_serve_off }
fun assoc_inputs: Functionality -> Input { docking_docking_f -> (docking_map + docking_charge) + map_server_serve_f
  -> map_server_scan + mission_drive_f -> mission_dock + map_server_2_serve_f -> map_server_2_scan }
fun assoc_outputs: Functionality -> Output { docking_docking_f -> docking_dock + map_server_serve_f ->
  map_server_map + map_server_2_serve_f -> map_server_2_map }
fun modes: Functionality -> Mode { docking_docking_f -> (docking_docking_normal + docking_docking_off) +
  map_server_serve_f -> (map_server_serve_normal + map_server_serve_off) + mission_drive_f -> (mission_drive_normal
  + mission_drive_off) + map_server_2_serve_f -> (map_server_2_serve_normal + map_server_2_serve_off) }
fun inputs: Component -> Input { docking -> (docking_map + docking_charge) + map_server -> map_server_scan + mission
  -> mission_dock + map_server_2 -> map_server_2_scan }
fun outputs: Component -> Output { docking -> docking_dock + map_server -> map_server_map + map_server_2 ->
  map_server_2_map }
fun funcs: Component -> Functionality { docking -> docking_docking_f + map_server -> map_server_serve_f + mission ->
  mission_drive_f + map_server_2 -> map_server_2_serve_f }
fun on: Publisher -> Connector { environment_charger -> service_charge + environment_lidar -> topic_scan }
fun pub_guar: Publisher -> Predicate { environment_charger -> Trigger + environment_lidar -> LaserScan_20Hz }
fun slots: Connector -> Slot { service_charge -> service_charge_slot1 + action_dock -> action_dock_slot1 +
  service_map -> service_map_slot1 }
fun holders: Overload -> Component { none -> none }
fun comps: System -> Component { System -> (docking + mission) + ((S0 + S1 + S2 + S3 + S4 + S5) + S6) -> map_server
  + ((S1 + S2 + S3 + S4 + S5 + S6) + (S7 + S8)) -> map_server_2 }
fun conns: System -> Connector { System -> (service_charge + action_dock + service_map + topic_scan) }
fun roles: System -> Connector -> Port { System -> (service_charge -> docking_charge + action_dock -> (docking_dock
  + mission_dock) + service_map -> docking_map) + (S0 + S1 + S2 + S3) -> (service_map -> map_server_map) + (S0 + S1
  + S2 + S3 + S4 + S5) -> (topic_scan -> map_server_scan) + ((S2 + S3 + S4 + S5 + S6 + S7) + S8) -> (topic_scan ->
  map_server_2_scan) + (S4 + S5 + S6 + S7 + S8) -> (service_map -> map_server_2_map) }
fun cur_mode: System -> Functionality -> Mode { System -> (docking_docking_f -> docking_docking_normal +
  mission_drive_f -> mission_drive_normal) + (S0 + S1 + S2 + S3 + S4) -> (map_server_serve_f ->
  map_server_serve_normal) + (S1 + S2) -> (map_server_2_serve_f -> map_server_2_serve_off) + (S3 + S4 + S5 + S6 + S7
  + S8) -> (map_server_2_serve_f -> map_server_2_serve_normal) + (S5 + S6) -> (map_server_serve_f ->
  map_server_serve_off) }
fun env_guars: System -> Predicate { none -> none }
fun env_pubs: System -> Publisher { System -> (environment_charger + environment_lidar) }
fun Capped: set Connector { service_charge + action_dock + service_map }

abstract sig Step {}

/* step 1: create map_server_2 (QuickServer) */
one sig step1 extends Step {}
pred step1_may { can_create_within[S0, map_server_2] }
pred step1_holds { can_create_within[S0, map_server_2] and create[S0, S1, map_server_2] }

/* step 2: attach map_server_2.scan to /scan */
one sig step2 extends Step {}
pred step2_may { can_attach_within[S1, topic_scan, map_server_2_scan] }
pred step2_holds { can_attach_within[S1, topic_scan, map_server_2_scan] and attach[S1, S2, topic_scan, map_server_2_scan] }

/* step 3: upgrade map_server_2.serve from off to normal */
one sig step3 extends Step {}
pred step3_may { can_upgrade_all[S2, map_server_2_serve_f -> map_server_2_serve_normal] }
pred step3_holds { upgrade_all[S2, S3, map_server_2_serve_f -> map_server_2_serve_normal] }

/* step 4: hand over /map from map_server.map to map_server_2.map */
one sig step4 extends Step {}
pred step4_may { some univ and some univ and can_handover_within[S3, service_map -> map_server_map -> map_server_2_map] }
pred step4_holds { some univ and some univ and can_handover_within[S3, service_map -> map_server_map -> map_server_2_map] and handover[S3, S4, service_map -> map_server_map -> map_server_2_map] }

/* step 5: degrade map_server.serve from normal to off */
one sig step5 extends Step {}
pred step5_may { can_degrade_all[S4, map_server_serve_f -> map_server_serve_off] }
pred step5_holds { degrade_all[S4, S5, map_server_serve_f -> map_server_serve_off] }

/* step 6: detach map_server.scan from /scan */
one sig step6 extends Step {}
pred step6_may { can_detach[S5, topic_scan, map_server_scan] }
pred step6_holds { detach[S5, S6, topic_scan, map_server_scan] }

/* step 7: remove map_server */
one sig step7 extends Step {}
pred step7_may { can_remove[S6, map_server] }
pred step7_holds { remove[S6, S7, map_server] }

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

check Verified for 1 but exactly 8 Predicate, exactly 5 NamedInputs, exactly 5 Input, exactly 3 Output, exactly 4 Connector, exactly 8 Mode, exactly 4 Functionality, exactly 4 Component, exactly 2 Publisher, exactly 9 System, exactly 3 Slot, exactly 0 Overload, 3 Int
check Rules for 1 but exactly 8 Predicate, exactly 5 NamedInputs, exactly 5 Input, exactly 3 Output, exactly 4 Connector, exactly 8 Mode, exactly 4 Functionality, exactly 4 Component, exactly 2 Publisher, exactly 9 System, exactly 3 Slot, exactly 0 Overload, 3 Int
run Verdict { findings } for 1 but exactly 8 Predicate, exactly 5 NamedInputs, exactly 5 Input, exactly 3 Output, exactly 4 Connector, exactly 8 Mode, exactly 4 Functionality, exactly 4 Component, exactly 2 Publisher, exactly 9 System, exactly 3 Slot, exactly 0 Overload, 3 Int
check Best for 1 but exactly 8 Predicate, exactly 5 NamedInputs, exactly 5 Input, exactly 3 Output, exactly 4 Connector, exactly 8 Mode, exactly 4 Functionality, exactly 4 Component, exactly 2 Publisher, exactly 9 System, exactly 3 Slot, exactly 0 Overload, 3 Int

