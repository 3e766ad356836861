/*
 * Publisher caps and resources (docs/semantics.md, sections 2 and 4).
 *
 * A capped topic has one slot for each publisher that it allows; a service or ROS action has one, for its server. For a
 * resource, all that matters is which components together exceed it. An `Overload` is a smallest such set; every
 * superset exceeds the resource as well.
 */
module limits
open system
open actions
open groups
open handover

sig Slot {}
sig Capped in Connector { slots: set Slot }
sig Overload { holders: some Component }

/* Attached outputs count against a cap, silent ones too, and so do the environment's publishers on the topic. */
pred cap_holds[s: System, roles: Connector -> Port, conn: Connector] {
  conn in Capped => #((roles[conn] & Output) + (s.env_pubs & on.conn)) =< #conn.slots
}

pred capacities_hold[comps: set Component] { no o: Overload | o.holders in comps }

/* Full validity: the safety property, caps and capacities. */
pred valid[s: System] {
  valid_sys[s]
  all conn: s.conns | cap_holds[s, s.roles, conn]
  capacities_hold[s.comps]
}

pred can_create_within[s: System, c: Component] { can_create[s, c] and capacities_hold[s.comps + c] }
pred can_attach_within[s: System, conn: Connector, p: Port] {
  can_attach[s, conn, p]
  cap_holds[s, s.roles + conn -> p, conn]
}
pred can_handover_within[s: System, swap: Connector -> Output -> Output] {
  can_handover[s, swap]
  all conn: leaving[swap].Output | cap_holds[s, s.roles + coming[swap] - leaving[swap], conn]
}

/* ---- checks ---- */

assert WithinCreate {
  rules => all s, t: System, c: Component | valid[s] and create[s, t, c] and can_create_within[s, c] => valid[t]
}
assert WithinRemove { rules => all s, t: System, c: Component | valid[s] and remove[s, t, c] => valid[t] }
assert WithinAttach {
  rules => all s, t: System, conn: Connector, p: Port |
    valid[s] and attach[s, t, conn, p] and can_attach_within[s, conn, p] => valid[t]
}
assert WithinDetach {
  rules => all s, t: System, conn: Connector, p: Port | valid[s] and detach[s, t, conn, p] => valid[t]
}
assert WithinModes {
  rules => all s, t: System, to: Functionality -> Mode |
    valid[s] and (degrade_all[s, t, to] or upgrade_all[s, t, to]) => valid[t]
}
assert WithinHandover {
  rules => all s, t: System, swap: Connector -> Output -> Output |
    valid[s] and handover[s, t, swap] and can_handover_within[s, swap] => valid[t]
}
/* A hand-over replaces outputs one to one, so caps stay satisfied. */
assert HandoverKeepsCaps {
  rules => all s: System, swap: Connector -> Output -> Output |
    valid[s] and can_handover[s, swap] => can_handover_within[s, swap]
}
check WithinCreate for 5 but 2 System, 5 Int expect 0
check WithinRemove for 5 but 2 System, 5 Int expect 0
check WithinAttach for 5 but 2 System, 5 Int expect 0
check WithinDetach for 5 but 2 System, 5 Int expect 0
check WithinModes for 5 but 2 System, 5 Int expect 0
check WithinHandover for 5 but 2 System, 5 Int expect 0
check HandoverKeepsCaps for 5 but 1 System, 5 Int expect 0

run WithinLimits {
  rules
  some s, t: System, swap: Connector -> Output -> Output | valid[s] and handover[s, t, swap] and can_handover_within[s, swap]
    and leaving[swap].Output in Capped and some Overload
} for 4 but 2 System, 5 Int expect 1

/* Without the cap, one output too many can be attached. */
run AttachNeedsTheCap {
  rules
  some s, t: System, conn: Connector, p: Output | valid[s] and attach[s, t, conn, p] and not valid[t]
} for 3 but 2 System, 5 Int expect 1
run CreateNeedsTheCapacity {
  rules
  some s, t: System, c: Component | valid[s] and create[s, t, c] and not valid[t]
} for 3 but 2 System, 5 Int expect 1
