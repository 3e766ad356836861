/*
 * The best modes of a structure (docs/semantics.md, section 5, F2 and F3).
 *
 * `best` is the greatest valid assignment. A greatest one exists because there is a valid assignment (M1: everything in
 * its last mode), the pointwise better of two valid ones is valid (F2), and there are finitely many.
 */
module best
open system
open actions
open groups

/* Each live functionality has exactly one of its modes, and nothing else has a mode. */
pred assignment[s: System, mode: Functionality -> Mode] {
  mode in s.comps.funcs -> Mode
  all f: s.comps.funcs | one mode[f] and mode[f] in f.modes
}

/* Modes that would be valid for the live components of s with the attachments `roles`. */
pred valid_modes[s: System, roles: Connector -> Port, mode: Functionality -> Mode] {
  assignment[s, mode]
  all f: s.comps.funcs | works[s, roles, mode, f]
}

/* The pointwise better of two assignments; the order of assignments. */
fun better_of[m, n: Functionality -> Mode]: Functionality -> Mode {
  { f: Functionality, x: m[f] + n[f] | x not in (m[f] + n[f]).worse }
}
pred no_better[s: System, m, n: Functionality -> Mode] {
  all f: s.comps.funcs | m[f] = n[f] or m[f] in n[f].worse
}

/* ---- checks ---- */

/* F2, the least element: all last modes are valid, whatever the attachments. */
assert LastModesAreValid { rules => all s: System | valid_modes[s, s.roles, { f: s.comps.funcs, m: degrad_mode[f] }] }

/* F2: the pointwise better of two valid assignments is valid. */
assert BetterOfTwo {
  rules => all s: System, m, n: Functionality -> Mode |
    valid_modes[s, s.roles, m] and valid_modes[s, s.roles, n] => valid_modes[s, s.roles, better_of[m, n]]
}

/* F3: more attachments never make a functionality unsatisfied. */
assert MoreNeverUnsatisfies {
  rules => all s: System, more: Connector -> Port, mode: Functionality -> Mode |
    assignment[s, mode] and more in s.conns -> ports[s.comps] =>
      all f: s.comps.funcs | works[s, s.roles, mode, f] => works[s, s.roles + more, mode, f]
}

/* F3: the better of one assignment valid with less and one valid with more is valid with more, so best(less) <= best(more). */
assert BestGrows {
  rules => all s: System, more: Connector -> Port, m, n: Functionality -> Mode |
    more in s.conns -> ports[s.comps] and valid_modes[s, s.roles, m] and valid_modes[s, s.roles + more, n]
      => valid_modes[s, s.roles + more, better_of[m, n]]
}

/* One upgrade leads from any valid assignment to any better one, so to the best. */
assert OneUpgrade {
  rules => all s: System, n: Functionality -> Mode |
    valid_sys[s] and valid_modes[s, s.roles, n] and no_better[s, s.cur_mode, n] and n != s.cur_mode
      => can_upgrade_all[s, n - s.cur_mode]
}

/* Before a detach: one degrade to an assignment that is valid without the attachment; then the detach is allowed. */
assert DegradeThenDetach {
  rules => all s, t: System, conn: Connector, p: Port, n: Functionality -> Mode |
    valid_sys[s] and conn -> p in s.roles and valid_modes[s, s.roles - conn -> p, n] and no_better[s, n, s.cur_mode] => {
      n != s.cur_mode => can_degrade_all[s, n - s.cur_mode]
      t.comps = s.comps and t.roles = s.roles and t.cur_mode = n and same_world[s, t] => can_detach[t, conn, p]
    }
}

check LastModesAreValid for 5 but 1 System expect 0
check BetterOfTwo for 5 but 1 System expect 0
check MoreNeverUnsatisfies for 5 but 1 System expect 0
check BestGrows for 5 but 1 System expect 0
check OneUpgrade for 5 but 1 System expect 0
check DegradeThenDetach for 5 but 2 System expect 0

/* Two valid assignments can be incomparable. */
run TwoValidAssignments {
  rules
  some s: System, m, n: Functionality -> Mode | valid_modes[s, s.roles, m] and valid_modes[s, s.roles, n]
    and not no_better[s, m, n] and not no_better[s, n, m]
} for 4 but 1 System expect 1

/* Without M2, the better of two need not be valid. */
run BestNeedsM2 {
  preorder and declared and chains and M1
  some s: System, m, n: Functionality -> Mode |
    valid_modes[s, s.roles, m] and valid_modes[s, s.roles, n] and not valid_modes[s, s.roles, better_of[m, n]]
} for 4 but 1 System expect 1
