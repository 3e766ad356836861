/*
 * The paper's Alloy listings (section 4.3), word for word. The paper does not print the signatures and the predicates that
 * the listings use; they are added above the listings, and only there.
 *
 * This file does not parse. docs/paper.md explains why; `completed.als` is the closest version that does.
 */
module printed

abstract sig Bool {}
one sig True, False extends Bool {}
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

pred conn_satisfied[s: System, conn: Connector] { conn_satisfied_no_out[s, conn, none] }
pred input_satisfied[s: System, i: Input] {
  some conn: s.conns | i in conn.roles and satisfy[conn.conn_guar, i.input_asm] and conn_satisfied[s, conn]
}
pred asm_satisfied[s: System, f: Functionality, a: Predicate] {
  (some i: f.assoc_inputs | satisfy[i.input_asm, a] and input_satisfied[s, i]) or satisfy[s.env_guars, a]
}
pred valid_sys[s: System] {
  all f: s.comps.funcs, a: f.cur_mode.mode_asms | asm_satisfied[s, f, a]
}

/* ---- from here on, as printed ---- */

pred remove[s, s': System, c: Component] {
  // Preconditions
  c in s.comps
  all p: (c.inputs + c.outputs) | no conn: s.conns | p in conn.roles
  // Postconditions
  s'.comps = s.comps - c
  s'.avail_funcs = s.avail_funcs - c.funcs
  // Rest unchanged
  ...
}

pred create[s, s': System, c: Component] {
  // Preconditions
  c not in s.comps
  all f: c.funcs | f.degraded = True
  // Postconditions
  s'.comps = s.comps + c
  s'.avail_funcs = s.avail_funcs + c.funcs
  // Rest unchanged
  ...
}

pred detach[s, s': System, conn: Connector, p: Port] {
  // Preconditions
  conn in s.conns
  p in conn.roles
  p in Input => some c: s.comps | p in c.inputs and safe_no_input[s, c, p]
  p in Output and not conn_satisfied_no_out[s, conn, p] =>
    all c: s.comps | safe_no_input[s, c, (conn.roles & Input)]
  // Postconditions
  some conn': Connector {
    conn'.roles = conn.roles - p
    // Rest unchanged
    ...
  }
}

pred safe_no_input[s: System, c: Component, no_i: Input] {
  all f: c.funcs, a: f.cur_mode.mode_asms |
    (some i: (f.assoc_inputs - no_i) |
      satisfy[i.input_asm, a] and input_satisfied[s, i])
  or
    satisfy[s.env_guards, a]
}

pred conn_satisfied_no_out[s: System, conn: Connector, no_o: Output] {
  some c: s.comps, f: c.funcs, o: (f.assoc_outputs - no_o) {
    o in conn.roles
    satisfy[f.cur_mode.mode_guards[o], conn.conn_guar]
    f in s.avail_funcs
  }
}

pred attach[s, s': System, conn: Connector, p: Port] {
  // Preconditions
  conn not in s.conns => no conn.roles
  p in (s.comps.inputs + s.comps.outputs)
  p not in conn.roles
  p in Output => { some c: s.comps, f: c.funcs | p in f.assoc_outputs and
    satisfy[f.cur_mode.mode_guards[p], conn.conn_guar]
  } else {
    satisfy[conn.conn_guar, p.input_asm]
  }
  // Postconditions
  some conn': Connector {
    conn'.roles = conn.roles + p
    // Rest unchanged
    ...
  }
}

pred degrade[s, s': System, c: Component, f: Functionality] {
  f.degraded = False
  let aff_conns = { conn: s.conns |
    not conn_satisfied_no_out[s, conn, f.assoc_outputs]
    and
    no o: f.assoc_outputs | o in conn.roles and
    satisfy[f.degrad_mode.mode_guars[o], conn.conn_guar]
  }
  | all c: s.comps | safe_no_input[s, c, (aff_conns.roles & Input)]
  some c': Component, f': Functionality {
    f'.cur_mode = f.degrad_mode
    f'.degraded = True
    // Rest unchanged
    ...
  }
}

pred upgrade[s, s': System, c: Component,
    f: Functionality]
{
  // Preconditions
  f.degraded = True
  all a: f.norm_mode.mode_asms | asm_satisfied[s, f, a]
  // Postconditions
  some c': Component, f': Functionality {
    f'.cur_mode = f.norm_mode
    f'.degraded = False
    // Rest unchanged
    ...
  }
}

assert SafeDetach {
  all s, s': System, conn: Connector, p: Port |
    valid_sys[s] and detach[s, s', conn, p] => valid_sys[s']
}
check SafeDetach for 5
run Detach {
  some s, s': System, conn: Connector, p: Port |
    valid_sys[s] and detach[s, s', conn, p] and valid_sys[s']
} for 3 but exactly 2 System
