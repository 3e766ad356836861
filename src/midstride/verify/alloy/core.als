/*
 * The paper's two-mode core (section 4.3), corrected: its signatures, names and six actions. As in the paper, an action
 * copies what it changes (conn_, c_, f_ for the paper's conn', c', f'). Differences from the listings are marked
 * `corrected`; docs/paper.md has the counterexamples. `system` and the modules above it build on this one.
 */
module core

abstract sig Bool {}
one sig True, False extends Bool {}

/* Section 3.2: predicates, ports, functionalities, components. `sat` is the satisfaction relation. */
sig Predicate { sat: set Predicate }
pred satisfy[p, q: set Predicate] { some p.sat & q }

abstract sig Port {}
sig Input extends Port { input_asm: one Predicate }
sig Output extends Port {}
sig Mode { mode_asms: set Predicate, mode_guars: Output -> lone Predicate }
sig Functionality {
  assoc_inputs: set Input,
  assoc_outputs: set Output,
  norm_mode: one Mode,
  degrad_mode: one Mode,
  cur_mode: one Mode,
  degraded: one Bool
}
sig Component { inputs: set Input, outputs: set Output, funcs: set Functionality }
sig Connector { roles: set Port, conn_guar: one Predicate }
sig System {
  comps: set Component,
  conns: set Connector,
  avail_funcs: set Functionality,
  env_guars: set Predicate
}

/* Satisfaction is a preorder; (i) to (iii) of section 4.2; what `degraded` means; the owners of ports. */
fact Rules {
  Predicate <: iden in sat and sat.sat in sat
  all f: Functionality | no f.degrad_mode.mode_asms
  all f: Functionality, o: f.assoc_outputs, q: Predicate |
    satisfy[f.degrad_mode.mode_guars[o], q] => satisfy[f.norm_mode.mode_guars[o], q]
  all f: Functionality | f.cur_mode in f.norm_mode + f.degrad_mode
  all f: Functionality | f.degraded = True <=> f.cur_mode = f.degrad_mode
  all c: Component, f: c.funcs | f.assoc_inputs in c.inputs and f.assoc_outputs in c.outputs
  all c: Component, disj f, g: c.funcs | no f.assoc_outputs & g.assoc_outputs
}

/* ---- the satisfaction chain of figure 3 ---- */

pred conn_satisfied[s: System, conn: Connector] { conn_satisfied_no_out[s, conn, none] }

pred input_satisfied[s: System, i: Input] { input_satisfied_no_conn[s, i, none] }

/* corrected: an input is satisfied by any of its connectors except the lost ones. */
pred input_satisfied_no_conn[s: System, i: Input, no_conn: set Connector] {
  some conn: s.conns - no_conn | i in conn.roles and satisfy[conn.conn_guar, i.input_asm] and conn_satisfied[s, conn]
}

pred asm_satisfied[s: System, f: Functionality, a: Predicate] {
  (some i: f.assoc_inputs | satisfy[i.input_asm, a] and input_satisfied[s, i]) or satisfy[s.env_guars, a]
}

/* The safety property of section 4.1. */
pred valid_sys[s: System] {
  well_formed[s]
  all f: s.comps.funcs, a: f.cur_mode.mode_asms | asm_satisfied[s, f, a]
}

/* corrected: not printed, but needed: no port and no functionality belongs to two components, and so on. */
pred well_formed[s: System] {
  all disj c, d: s.comps | no (c.inputs + c.outputs) & (d.inputs + d.outputs) and no c.funcs & d.funcs
  s.conns.roles in s.comps.inputs + s.comps.outputs
  s.avail_funcs = s.comps.funcs
}

pred safe_no_input[s: System, c: Component, no_i: set Input] {
  all f: c.funcs | func_safe_no_input[s, f, no_i]
}

pred func_safe_no_input[s: System, f: Functionality, no_i: set Input] {
  all a: f.cur_mode.mode_asms |
    (some i: (f.assoc_inputs - no_i) | satisfy[i.input_asm, a] and input_satisfied[s, i])
    or satisfy[s.env_guars, a]
}

pred conn_satisfied_no_out[s: System, conn: Connector, no_o: set Output] {
  some c: s.comps, f: c.funcs, o: (f.assoc_outputs - no_o) {
    o in conn.roles
    satisfy[f.cur_mode.mode_guars[o], conn.conn_guar]
    f in s.avail_funcs
  }
}

/* corrected: the inputs that are lost with `conns`: those on them that no other connector satisfies. */
fun lost_inputs[s: System, conns: set Connector]: set Input {
  { i: conns.roles & Input | not input_satisfied_no_conn[s, i, conns] }
}

/* ---- remove, create ---- */

pred remove[s, s_: System, c: Component] {
  c in s.comps
  all p: (c.inputs + c.outputs) | no conn: s.conns | p in conn.roles
  s_.comps = s.comps - c
  s_.avail_funcs = s.avail_funcs - c.funcs
  s_.conns = s.conns and s_.env_guars = s.env_guars
}

pred create[s, s_: System, c: Component] {
  c not in s.comps
  // corrected: the new component shares nothing with the others
  no (c.inputs + c.outputs) & (s.comps.inputs + s.comps.outputs)
  no c.funcs & s.comps.funcs
  all f: c.funcs | f.degraded = True
  s_.comps = s.comps + c
  s_.avail_funcs = s.avail_funcs + c.funcs
  s_.conns = s.conns and s_.env_guars = s.env_guars
}

/* ---- detach, attach ---- */

pred can_detach[s: System, conn: Connector, p: Port] {
  conn in s.conns
  p in conn.roles
  p in Input => (some c: s.comps | p in c.inputs and safe_no_input[s, c, p & lost_inputs[s, conn]])  // corrected: lost_inputs
  p in Output and not conn_satisfied_no_out[s, conn, p] =>
    (all c: s.comps | safe_no_input[s, c, lost_inputs[s, conn]])  // corrected: lost_inputs
}

pred detached[s, s_: System, conn: Connector, p: Port] {
  some conn_: Connector - (s.conns - conn) {  // corrected: not another connector of the system
    conn_.roles = conn.roles - p
    conn_.conn_guar = conn.conn_guar
    s_.conns = s.conns - conn + conn_
  }
  s_.comps = s.comps and s_.avail_funcs = s.avail_funcs and s_.env_guars = s.env_guars
}

pred detach[s, s_: System, conn: Connector, p: Port] { can_detach[s, conn, p] and detached[s, s_, conn, p] }

pred attach[s, s_: System, conn: Connector, p: Port] {
  conn not in s.conns => no conn.roles
  p in (s.comps.inputs + s.comps.outputs)
  p not in conn.roles
  p in Output => { some c: s.comps, f: c.funcs | p in f.assoc_outputs and
    satisfy[f.cur_mode.mode_guars[p], conn.conn_guar]
  } else {
    satisfy[conn.conn_guar, p.input_asm]
  }
  some conn_: Connector - (s.conns - conn) {  // corrected: not another connector of the system
    conn_.roles = conn.roles + p
    conn_.conn_guar = conn.conn_guar
    s_.conns = s.conns - conn + conn_
  }
  s_.comps = s.comps and s_.avail_funcs = s.avail_funcs and s_.env_guars = s.env_guars
}

/* ---- degrade, upgrade ---- */

pred can_degrade[s: System, c: Component, f: Functionality] {
  c in s.comps and f in c.funcs  // corrected
  f.degraded = False
  let aff_conns = { conn: s.conns |
    not conn_satisfied_no_out[s, conn, f.assoc_outputs]
    and (no o: f.assoc_outputs | o in conn.roles and satisfy[f.degrad_mode.mode_guars[o], conn.conn_guar])
  } | all g: s.comps.funcs - f | func_safe_no_input[s, g, lost_inputs[s, aff_conns]]  // corrected: f itself is exempt
}

/* f_ is f in another mode, c_ is c with f_ in place of f. corrected: both are new to the system. */
pred in_place[s, s_: System, c: Component, f, f_: Functionality] {
  f_ not in s.comps.funcs
  f_.assoc_inputs = f.assoc_inputs and f_.assoc_outputs = f.assoc_outputs
  f_.norm_mode = f.norm_mode and f_.degrad_mode = f.degrad_mode
  some c_: Component - s.comps {
    c_.inputs = c.inputs and c_.outputs = c.outputs
    c_.funcs = c.funcs - f + f_
    s_.comps = s.comps - c + c_
  }
  s_.avail_funcs = s.avail_funcs - f + f_
  s_.conns = s.conns and s_.env_guars = s.env_guars
}

pred degraded_to[s, s_: System, c: Component, f: Functionality] {
  some f_: Functionality | f_.cur_mode = f.degrad_mode and f_.degraded = True and in_place[s, s_, c, f, f_]
}

pred degrade[s, s_: System, c: Component, f: Functionality] { can_degrade[s, c, f] and degraded_to[s, s_, c, f] }

pred upgrade[s, s_: System, c: Component, f: Functionality] {
  c in s.comps and f in c.funcs  // corrected
  f.degraded = True
  all a: f.norm_mode.mode_asms | asm_satisfied[s, f, a]
  some f_: Functionality | f_.cur_mode = f.norm_mode and f_.degraded = False and in_place[s, s_, c, f, f_]
}

/* ---- checks ---- */

assert SafeRemove { all s, s_: System, c: Component | valid_sys[s] and remove[s, s_, c] => valid_sys[s_] }
assert SafeCreate { all s, s_: System, c: Component | valid_sys[s] and create[s, s_, c] => valid_sys[s_] }
assert SafeDetach {
  all s, s_: System, conn: Connector, p: Port | valid_sys[s] and detach[s, s_, conn, p] => valid_sys[s_]
}
assert SafeAttach {
  all s, s_: System, conn: Connector, p: Port | valid_sys[s] and attach[s, s_, conn, p] => valid_sys[s_]
}
assert SafeDegrade {
  all s, s_: System, c: Component, f: Functionality | valid_sys[s] and degrade[s, s_, c, f] => valid_sys[s_]
}
assert SafeUpgrade {
  all s, s_: System, c: Component, f: Functionality | valid_sys[s] and upgrade[s, s_, c, f] => valid_sys[s_]
}

/* The look-ahead refuses nothing that would be safe: the precondition is exact. */
assert ExactDetach {
  all s, s_: System, conn: s.conns, p: conn.roles |
    valid_sys[s] and detached[s, s_, conn, p] => (can_detach[s, conn, p] <=> valid_sys[s_])
}
assert ExactDegrade {
  all s, s_: System, c: s.comps, f: c.funcs |
    valid_sys[s] and f.degraded = False and degraded_to[s, s_, c, f] => (can_degrade[s, c, f] <=> valid_sys[s_])
}

check SafeRemove for 5 but 2 System expect 0
check SafeCreate for 5 but 2 System expect 0
check SafeDetach for 5 but 2 System expect 0
check SafeAttach for 5 but 2 System expect 0
check SafeDegrade for 5 but 2 System expect 0
check SafeUpgrade for 5 but 2 System expect 0
check ExactDetach for 5 but 2 System expect 0
check ExactDegrade for 5 but 2 System expect 0

run Remove {
  some s, s_: System, c: Component | valid_sys[s] and some s.conns.roles and remove[s, s_, c] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
run Create {
  some s, s_: System, c: Component | valid_sys[s] and some c.funcs and create[s, s_, c] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
run Detach {
  some s, s_: System, conn: Connector, p: Port | valid_sys[s] and detach[s, s_, conn, p] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
run Attach {
  some s, s_: System, conn: Connector, p: Port | valid_sys[s] and attach[s, s_, conn, p] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
run Degrade {
  some s, s_: System, c: Component, f: Functionality | valid_sys[s] and some f.cur_mode.mode_asms
    and degrade[s, s_, c, f] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
run Upgrade {
  some s, s_: System, c: Component, f: Functionality | valid_sys[s] and some f.norm_mode.mode_asms
    and upgrade[s, s_, c, f] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
