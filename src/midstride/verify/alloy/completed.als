/*
 * The paper's Alloy listings, corrected only as far as needed to parse:
 *  - s', c', f', conn' are s_, c_, f_, conn_ (in Alloy 6 the prime is an operator);
 *  - mode_guards and env_guards are mode_guars and env_guars (both spellings are printed);
 *  - `...` after "Rest unchanged" is written out, marked `ours`.
 * The paper does not print what is above the listings.
 */
module completed

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

/* Section 4.2, (i) to (iii), and what `degraded` means. */
fact Section42 {
  Predicate <: iden in sat and sat.sat in sat
  all f: Functionality | no f.degrad_mode.mode_asms
  all f: Functionality, o: f.assoc_outputs, q: Predicate |
    satisfy[f.degrad_mode.mode_guars[o], q] => satisfy[f.norm_mode.mode_guars[o], q]
  all f: Functionality | f.cur_mode in f.norm_mode + f.degrad_mode
  all f: Functionality | f.degraded = True <=> f.cur_mode = f.degrad_mode
}

/* A component's functionalities use its ports, and no output belongs to two of them. */
fact Ports {
  all c: Component, f: c.funcs | f.assoc_inputs in c.inputs and f.assoc_outputs in c.outputs
  all c: Component, disj f, g: c.funcs | no f.assoc_outputs & g.assoc_outputs
}

/* The safety property of section 4.1. */
pred valid_sys[s: System] {
  all f: s.comps.funcs, a: f.cur_mode.mode_asms | asm_satisfied[s, f, a]
}

/* Not printed: no port and no functionality belongs to two components, and so on. */
pred well_formed[s: System] {
  all disj c, d: s.comps | no (c.inputs + c.outputs) & (d.inputs + d.outputs) and no c.funcs & d.funcs
  s.conns.roles in s.comps.inputs + s.comps.outputs
  s.avail_funcs = s.comps.funcs
}

/* ---- the listings ---- */

pred remove[s, s_: System, c: Component] {
  // Preconditions
  c in s.comps
  all p: (c.inputs + c.outputs) | no conn: s.conns | p in conn.roles
  // Postconditions
  s_.comps = s.comps - c
  s_.avail_funcs = s.avail_funcs - c.funcs
  // Rest unchanged
  s_.conns = s.conns and s_.env_guars = s.env_guars  -- ours
}

pred create[s, s_: System, c: Component] {
  // Preconditions
  c not in s.comps
  all f: c.funcs | f.degraded = True
  // Postconditions
  s_.comps = s.comps + c
  s_.avail_funcs = s.avail_funcs + c.funcs
  // Rest unchanged
  s_.conns = s.conns and s_.env_guars = s.env_guars  -- ours
}

pred detach[s, s_: System, conn: Connector, p: Port] {
  // Preconditions
  conn in s.conns
  p in conn.roles
  p in Input => some c: s.comps | p in c.inputs and safe_no_input[s, c, p]
  p in Output and not conn_satisfied_no_out[s, conn, p] =>
    all c: s.comps | safe_no_input[s, c, (conn.roles & Input)]
  // Postconditions
  some conn_: Connector {
    conn_.roles = conn.roles - p
    // Rest unchanged
    conn_.conn_guar = conn.conn_guar  -- ours
    s_.conns = s.conns - conn + conn_  -- ours
    s_.comps = s.comps and s_.avail_funcs = s.avail_funcs and s_.env_guars = s.env_guars  -- ours
  }
}

pred safe_no_input[s: System, c: Component, no_i: Input] {
  all f: c.funcs, a: f.cur_mode.mode_asms |
    (some i: (f.assoc_inputs - no_i) |
      satisfy[i.input_asm, a] and input_satisfied[s, i])
  or
    satisfy[s.env_guars, a]
}

pred conn_satisfied_no_out[s: System, conn: Connector, no_o: Output] {
  some c: s.comps, f: c.funcs, o: (f.assoc_outputs - no_o) {
    o in conn.roles
    satisfy[f.cur_mode.mode_guars[o], conn.conn_guar]
    f in s.avail_funcs
  }
}

pred attach[s, s_: System, conn: Connector, p: Port] {
  // Preconditions
  conn not in s.conns => no conn.roles
  p in (s.comps.inputs + s.comps.outputs)
  p not in conn.roles
  p in Output => { some c: s.comps, f: c.funcs | p in f.assoc_outputs and
    satisfy[f.cur_mode.mode_guars[p], conn.conn_guar]
  } else {
    satisfy[conn.conn_guar, p.input_asm]
  }
  // Postconditions
  some conn_: Connector {
    conn_.roles = conn.roles + p
    // Rest unchanged
    conn_.conn_guar = conn.conn_guar  -- ours
    s_.conns = s.conns - conn + conn_  -- ours
    s_.comps = s.comps and s_.avail_funcs = s.avail_funcs and s_.env_guars = s.env_guars  -- ours
  }
}

pred degrade[s, s_: System, c: Component, f: Functionality] {
  f.degraded = False
  let aff_conns = { conn: s.conns |
    not conn_satisfied_no_out[s, conn, f.assoc_outputs]
    and
    no o: f.assoc_outputs | o in conn.roles and
    satisfy[f.degrad_mode.mode_guars[o], conn.conn_guar]
  }
  | all c: s.comps | safe_no_input[s, c, (aff_conns.roles & Input)]
  some c_: Component, f_: Functionality {
    f_.cur_mode = f.degrad_mode
    f_.degraded = True
    // Rest unchanged
    f_.assoc_inputs = f.assoc_inputs and f_.assoc_outputs = f.assoc_outputs  -- ours
    f_.norm_mode = f.norm_mode and f_.degrad_mode = f.degrad_mode  -- ours
    c_.inputs = c.inputs and c_.outputs = c.outputs and c_.funcs = c.funcs - f + f_  -- ours
    s_.comps = s.comps - c + c_ and s_.avail_funcs = s.avail_funcs - f + f_  -- ours
    s_.conns = s.conns and s_.env_guars = s.env_guars  -- ours
  }
}

pred upgrade[s, s_: System, c: Component,
    f: Functionality]
{
  // Preconditions
  f.degraded = True
  all a: f.norm_mode.mode_asms | asm_satisfied[s, f, a]
  // Postconditions
  some c_: Component, f_: Functionality {
    f_.cur_mode = f.norm_mode
    f_.degraded = False
    // Rest unchanged
    f_.assoc_inputs = f.assoc_inputs and f_.assoc_outputs = f.assoc_outputs  -- ours
    f_.norm_mode = f.norm_mode and f_.degrad_mode = f.degrad_mode  -- ours
    c_.inputs = c.inputs and c_.outputs = c.outputs and c_.funcs = c.funcs - f + f_  -- ours
    s_.comps = s.comps - c + c_ and s_.avail_funcs = s.avail_funcs - f + f_  -- ours
    s_.conns = s.conns and s_.env_guars = s.env_guars  -- ours
  }
}

/* ---- checks: `expect` states the actual result, not the desired one ---- */

assert SafeRemove {
  all s, s_: System, c: Component | well_formed[s] and valid_sys[s] and remove[s, s_, c] => valid_sys[s_]
}
assert FormedRemove {
  all s, s_: System, c: Component | well_formed[s] and valid_sys[s] and remove[s, s_, c] => well_formed[s_]
}
run Remove {
  some s, s_: System, c: Component | well_formed[s] and valid_sys[s] and remove[s, s_, c] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
assert SafeCreate {
  all s, s_: System, c: Component | well_formed[s] and valid_sys[s] and create[s, s_, c] => valid_sys[s_]
}
assert FormedCreate {
  all s, s_: System, c: Component | well_formed[s] and valid_sys[s] and create[s, s_, c] => well_formed[s_]
}
run Create {
  some s, s_: System, c: Component | well_formed[s] and valid_sys[s] and create[s, s_, c] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
assert SafeDetach {
  all s, s_: System, conn: Connector, p: Port | well_formed[s] and valid_sys[s] and detach[s, s_, conn, p] => valid_sys[s_]
}
assert FormedDetach {
  all s, s_: System, conn: Connector, p: Port | well_formed[s] and valid_sys[s] and detach[s, s_, conn, p] => well_formed[s_]
}
run Detach {
  some s, s_: System, conn: Connector, p: Port | well_formed[s] and valid_sys[s] and detach[s, s_, conn, p] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
assert SafeAttach {
  all s, s_: System, conn: Connector, p: Port | well_formed[s] and valid_sys[s] and attach[s, s_, conn, p] => valid_sys[s_]
}
assert FormedAttach {
  all s, s_: System, conn: Connector, p: Port | well_formed[s] and valid_sys[s] and attach[s, s_, conn, p] => well_formed[s_]
}
run Attach {
  some s, s_: System, conn: Connector, p: Port | well_formed[s] and valid_sys[s] and attach[s, s_, conn, p] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
assert SafeDegrade {
  all s, s_: System, c: Component, f: Functionality | well_formed[s] and valid_sys[s] and degrade[s, s_, c, f] => valid_sys[s_]
}
assert FormedDegrade {
  all s, s_: System, c: Component, f: Functionality | well_formed[s] and valid_sys[s] and degrade[s, s_, c, f] => well_formed[s_]
}
run Degrade {
  some s, s_: System, c: Component, f: Functionality | well_formed[s] and valid_sys[s] and degrade[s, s_, c, f] and valid_sys[s_]
} for 3 but exactly 2 System expect 1
assert SafeUpgrade {
  all s, s_: System, c: Component, f: Functionality | well_formed[s] and valid_sys[s] and upgrade[s, s_, c, f] => valid_sys[s_]
}
assert FormedUpgrade {
  all s, s_: System, c: Component, f: Functionality | well_formed[s] and valid_sys[s] and upgrade[s, s_, c, f] => well_formed[s_]
}
run Upgrade {
  some s, s_: System, c: Component, f: Functionality | well_formed[s] and valid_sys[s] and upgrade[s, s_, c, f] and valid_sys[s_]
} for 3 but exactly 2 System expect 1

check SafeRemove for 5 but 2 System expect 0
check SafeCreate for 5 but 2 System expect 0
check SafeDetach for 5 but 2 System expect 0
check SafeAttach for 5 but 2 System expect 0
check FormedRemove for 5 but 2 System expect 0
check FormedDetach for 5 but 2 System expect 0
check FormedAttach for 5 but 2 System expect 0

/* 1. degrade and upgrade do not require that f is a functionality of c, nor that c is in the system. */
check SafeDegrade for 5 but 2 System expect 1
check SafeUpgrade for 5 but 2 System expect 1

/* 2. create does not require that the new component shares no ports or functionalities with others. */
check FormedCreate for 5 but 2 System expect 1

/* 3. The changed component (c') may be another component of the system, which is then lost. */
check FormedDegrade for 5 but 2 System expect 1
check FormedUpgrade for 5 but 2 System expect 1
assert FormedDegradeOfItsOwn {
  all s, s_: System, c: s.comps, f: c.funcs | well_formed[s] and valid_sys[s] and degrade[s, s_, c, f] => well_formed[s_]
}
check FormedDegradeOfItsOwn for 5 but 2 System expect 1

/* 4. Without well-formedness, which is not printed, detach is unsafe: it checks only one of two components with the input. */
assert SafeDetachOfAnySystem {
  all s, s_: System, conn: Connector, p: Port | valid_sys[s] and detach[s, s_, conn, p] => valid_sys[s_]
}
check SafeDetachOfAnySystem for 5 but 2 System expect 1

/* 5. An input on two topics counts as lost when one of them is: a harmless detach is refused. */
run DetachRefusesTooMuch {
  some s, s_: System, disj conn, other, conn_: Connector, p: Input {
    well_formed[s] and valid_sys[s] and valid_sys[s_]
    conn + other in s.conns and p in conn.roles & other.roles
    conn_.roles = conn.roles - p and conn_.conn_guar = conn.conn_guar
    s_.conns = s.conns - conn + conn_
    s_.comps = s.comps and s_.avail_funcs = s.avail_funcs and s_.env_guars = s.env_guars
    not detach[s, s_, conn, p]
  }
} for 4 but exactly 2 System expect 1

/* 6. A functionality that consumes its own output can never be degraded: it must stay satisfied in the mode it leaves. */
run DegradeRefusesTooMuch {
  some s, s_: System, c: s.comps, f: c.funcs, c_: Component - s.comps, f_: Functionality - s.avail_funcs {
    well_formed[s] and valid_sys[s] and valid_sys[s_] and f.degraded = False
    all i: Input | lone s.conns & roles.i  -- not by 5
    f_.cur_mode = f.degrad_mode and f_.degraded = True
    f_.assoc_inputs = f.assoc_inputs and f_.assoc_outputs = f.assoc_outputs
    f_.norm_mode = f.norm_mode and f_.degrad_mode = f.degrad_mode
    c_.inputs = c.inputs and c_.outputs = c.outputs and c_.funcs = c.funcs - f + f_
    s_.comps = s.comps - c + c_ and s_.avail_funcs = s.avail_funcs - f + f_
    s_.conns = s.conns and s_.env_guars = s.env_guars
    not degrade[s, s_, c, f]
  }
} for 4 but exactly 2 System expect 1
