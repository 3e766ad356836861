/*
 * Several functionalities in one step (docs/semantics.md, section 4), for those that support each other in a cycle: no
 * sequence of single steps can degrade or upgrade them. `to` maps each functionality to its new mode.
 */
module groups
open system
open actions

pred can_degrade_all[s: System, to: Functionality -> Mode] {
  some to
  all f: to.Mode | f in s.comps.funcs and one to[f] and to[f] in f.modes & s.cur_mode[f].worse
  all g: s.comps.funcs | works[s, s.roles, s.cur_mode ++ to, g]
}

pred degrade_all[s, t: System, to: Functionality -> Mode] {
  can_degrade_all[s, to]
  t.comps = s.comps
  t.roles = s.roles
  t.cur_mode = s.cur_mode ++ to
  same_world[s, t]
}

pred can_upgrade_all[s: System, to: Functionality -> Mode] {
  some to
  all f: to.Mode | f in s.comps.funcs and one to[f] and to[f] in f.modes and s.cur_mode[f] in to[f].worse
  all f: to.Mode | works[s, s.roles, s.cur_mode ++ to, f]
}

pred upgrade_all[s, t: System, to: Functionality -> Mode] {
  can_upgrade_all[s, to]
  t.comps = s.comps
  t.roles = s.roles
  t.cur_mode = s.cur_mode ++ to
  same_world[s, t]
}

/* ---- checks ---- */

assert SafeDegradeAll {
  rules => all s, t: System, to: Functionality -> Mode | valid_sys[s] and degrade_all[s, t, to] => valid_sys[t]
}
assert SafeUpgradeAll {
  rules => all s, t: System, to: Functionality -> Mode | valid_sys[s] and upgrade_all[s, t, to] => valid_sys[t]
}
/* A single functionality is a group of one. */
assert OneIsAGroup {
  rules => all s, t: System, f: Functionality, m: Mode {
    degrade[s, t, f, m] <=> degrade_all[s, t, f -> m]
    upgrade[s, t, f, m] <=> upgrade_all[s, t, f -> m]
  }
}
check SafeDegradeAll for 5 but 2 System expect 0
check SafeUpgradeAll for 5 but 2 System expect 0
check OneIsAGroup for 5 but 2 System expect 0

run DegradeAll { rules and some s, t: System, to: Functionality -> Mode | valid_sys[s] and #to = 2 and degrade_all[s, t, to] }
  for 4 but 2 System expect 1
run UpgradeAll { rules and some s, t: System, to: Functionality -> Mode | valid_sys[s] and #to = 2 and upgrade_all[s, t, to] }
  for 4 but 2 System expect 1

/* A cycle: two can be upgraded or degraded together, but neither alone. */
run RaisedOnlyTogether {
  rules
  some s, t: System, to: Functionality -> Mode {
    valid_sys[s] and #to = 2 and upgrade_all[s, t, to]
    no f: to.Mode | can_upgrade[s, f, to[f]]
  }
} for 4 but 2 System expect 1
run LoweredOnlyTogether {
  rules
  some s, t: System, to: Functionality -> Mode {
    valid_sys[s] and #to = 2 and degrade_all[s, t, to]
    no f: to.Mode | can_degrade[s, f, to[f]]
  }
} for 4 but 2 System expect 1
