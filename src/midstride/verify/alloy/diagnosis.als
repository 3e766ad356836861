/*
 * For dumps: the parts of preconditions, so that a refusal can say which part failed, and for which functionality.
 */
module diagnosis
open system
open actions
open groups
open handover
open limits

/* The contracts of a port and a topic fit, as `attach` requires. */
pred fits[conn: Connector, p: Port] {
  p in Output => satisfy[norm_mode[assoc_outputs.p].mode_guars[p], conn.conn_guar]
  p in Input => satisfy[conn.conn_guar, p.input_asm]
}

/* An output, in its functionality's current mode, satisfies a topic, as `handover` requires. */
pred satisfies_now[s: System, conn: Connector, o: Output] {
  satisfy[s.cur_mode[assoc_outputs.o].mode_guars[o], conn.conn_guar]
}

/* The assumptions that would not be satisfied with these attachments and modes. */
fun unsatisfied[s: System, among: set Functionality, roles: Connector -> Port, mode: Functionality -> Mode]:
  Functionality -> Assumption {
  { f: among, a: mode[f].mode_asms | not asm_satisfied[s, roles, mode, f, a] }
}

/* Nothing changes, as with `set`. */
pred unchanged[s, t: System] {
  t.comps = s.comps
  t.roles = s.roles
  t.cur_mode = s.cur_mode
  same_world[s, t]
}

/* ---- checks ---- */

/* The parts agree with the preconditions. */
assert FitsIsAttach {
  all s: System, conn: s.conns, p: ports[s.comps] - s.roles[conn] | can_attach[s, conn, p] <=> fits[conn, p]
}
assert NoneUnsatisfiedIsDetach {
  all s: System, conn: Connector, p: s.roles[conn] |
    can_detach[s, conn, p] <=> no unsatisfied[s, s.comps.funcs, s.roles - conn -> p, s.cur_mode]
}
check FitsIsAttach for 5 but 1 System expect 0
check NoneUnsatisfiedIsDetach for 5 but 1 System expect 0
run SomeUnsatisfied {
  rules
  some s: System, conn: Connector, p: s.roles[conn] |
    valid_sys[s] and some unsatisfied[s, s.comps.funcs, s.roles - conn -> p, s.cur_mode]
} for 4 but 1 System expect 1
