/*
 * The paper's six actions (docs/semantics.md, section 4; the paper's section 4.3), on one functionality or port at a time:
 * s before, t after. The precondition of each is a predicate `can_...`, so that it can be checked separately.
 */
module actions
open system

/* ---- create: live, isolated, every functionality in its last mode ---- */

pred can_create[s: System, c: Component] { c not in s.comps }

pred create[s, t: System, c: Component] {
  can_create[s, c]
  t.comps = s.comps + c
  t.roles = s.roles
  t.cur_mode = s.cur_mode + { f: c.funcs, m: degrad_mode[f] }
  same_world[s, t]
}

/* ---- remove: a live and isolated component, in any modes ---- */

pred can_remove[s: System, c: Component] {
  c in s.comps
  no s.roles & Connector -> ports[c]
}

pred remove[s, t: System, c: Component] {
  can_remove[s, c]
  t.comps = s.comps - c
  t.roles = s.roles
  t.cur_mode = s.cur_mode - c.funcs -> Mode
  same_world[s, t]
}

/* ---- attach: an output by its normal mode (the paper: by its current one), an input by its assumption ---- */

pred can_attach[s: System, conn: Connector, p: Port] {
  p in ports[s.comps]
  conn in s.conns
  p not in s.roles[conn]
  p in Output => satisfy[norm_mode[assoc_outputs.p].mode_guars[p], conn.conn_guar]
  p in Input => satisfy[conn.conn_guar, p.input_asm]
}

pred attach[s, t: System, conn: Connector, p: Port] {
  can_attach[s, conn, p]
  t.comps = s.comps
  t.roles = s.roles + conn -> p
  t.cur_mode = s.cur_mode
  same_world[s, t]
}

/* ---- detach: every functionality stays satisfied without it ---- */

pred can_detach[s: System, conn: Connector, p: Port] {
  conn -> p in s.roles
  all f: s.comps.funcs | works[s, s.roles - conn -> p, s.cur_mode, f]
}

pred detach[s, t: System, conn: Connector, p: Port] {
  can_detach[s, conn, p]
  t.comps = s.comps
  t.roles = s.roles - conn -> p
  t.cur_mode = s.cur_mode
  same_world[s, t]
}

/* ---- degrade, upgrade: one functionality; `groups` has the form for several ---- */

pred can_degrade[s: System, f: Functionality, m: Mode] {
  f in s.comps.funcs
  m in f.modes & s.cur_mode[f].worse
  all g: s.comps.funcs | works[s, s.roles, s.cur_mode ++ f -> m, g]
}

pred degrade[s, t: System, f: Functionality, m: Mode] {
  can_degrade[s, f, m]
  t.comps = s.comps
  t.roles = s.roles
  t.cur_mode = s.cur_mode ++ f -> m
  same_world[s, t]
}

pred can_upgrade[s: System, f: Functionality, m: Mode] {
  f in s.comps.funcs
  m in f.modes and s.cur_mode[f] in m.worse
  works[s, s.roles, s.cur_mode ++ f -> m, f]
}

pred upgrade[s, t: System, f: Functionality, m: Mode] {
  can_upgrade[s, f, m]
  t.comps = s.comps
  t.roles = s.roles
  t.cur_mode = s.cur_mode ++ f -> m
  same_world[s, t]
}

/* ---- checks ---- */

/* Every action takes a valid configuration to a valid one (F1). */

assert SafeCreate { rules => all s, t: System, c: Component | valid_sys[s] and create[s, t, c] => valid_sys[t] }
assert SafeRemove { rules => all s, t: System, c: Component | valid_sys[s] and remove[s, t, c] => valid_sys[t] }
assert SafeAttach {
  rules => all s, t: System, conn: Connector, p: Port | valid_sys[s] and attach[s, t, conn, p] => valid_sys[t]
}
assert SafeDetach {
  rules => all s, t: System, conn: Connector, p: Port | valid_sys[s] and detach[s, t, conn, p] => valid_sys[t]
}
assert SafeDegrade {
  rules => all s, t: System, f: Functionality, m: Mode | valid_sys[s] and degrade[s, t, f, m] => valid_sys[t]
}
assert SafeUpgrade {
  rules => all s, t: System, f: Functionality, m: Mode | valid_sys[s] and upgrade[s, t, f, m] => valid_sys[t]
}

check SafeCreate for 5 but 2 System expect 0
check SafeRemove for 5 but 2 System expect 0
check SafeAttach for 5 but 2 System expect 0
check SafeDetach for 5 but 2 System expect 0
check SafeDegrade for 5 but 2 System expect 0
check SafeUpgrade for 5 but 2 System expect 0

/* Every action is possible. */

run Create { rules and some s, t: System, c: Component | valid_sys[s] and some s.comps and some c.funcs and create[s, t, c] }
  for 3 but 2 System expect 1
run Remove { rules and some s, t: System, c: Component | valid_sys[s] and some s.roles and remove[s, t, c] }
  for 3 but 2 System expect 1
run AttachInput { rules and some s, t: System, conn: Connector, p: Input | valid_sys[s] and attach[s, t, conn, p] }
  for 3 but 2 System expect 1
run AttachOutput { rules and some s, t: System, conn: Connector, p: Output | valid_sys[s] and attach[s, t, conn, p] }
  for 3 but 2 System expect 1
run DetachInput { rules and some s, t: System, conn: Connector, p: Input | valid_sys[s] and detach[s, t, conn, p] }
  for 3 but 2 System expect 1
run DetachOutput { rules and some s, t: System, conn: Connector, p: Output | valid_sys[s] and detach[s, t, conn, p] }
  for 3 but 2 System expect 1
run Degrade {
  rules and some s, t: System, f: Functionality, m: Mode |
    valid_sys[s] and some s.cur_mode[f].mode_asms and degrade[s, t, f, m]
} for 3 but 2 System expect 1
run Upgrade {
  rules and some s, t: System, f: Functionality, m: Mode |
    valid_sys[s] and some m.mode_asms and upgrade[s, t, f, m]
} for 3 but 2 System expect 1

/* Without M1, a new component may have unsatisfied assumptions. */
run CreateNeedsM1 {
  preorder and declared and chains and M2
  some s, t: System, c: Component | valid_sys[s] and create[s, t, c] and not valid_sys[t]
} for 3 but 2 System expect 1

/* Without M2, an upgrade may leave others unsatisfied. */
run UpgradeNeedsM2 {
  preorder and declared and chains and M1
  some s, t: System, f: Functionality, m: Mode | valid_sys[s] and upgrade[s, t, f, m] and not valid_sys[t]
} for 4 but 2 System expect 1

/* Without isolation, remove is unsafe. */
run RemoveNeedsIsolation {
  rules
  some s, t: System, c: s.comps | valid_sys[s] and t.comps = s.comps - c and t.cur_mode = s.cur_mode - c.funcs -> Mode
    and t.roles = s.roles - Connector -> ports[c] and same_world[s, t] and structured[t] and not valid_sys[t]
} for 4 but 2 System expect 1
