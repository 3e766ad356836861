/*
 * The hand-over (docs/semantics.md, section 4): on each topic a new output replaces an old one, all in one step.
 * `swap` holds topic -> old -> new.
 */
module handover
open system

/* The attachments that a hand-over removes, and those that it adds. */
fun leaving[swap: Connector -> Output -> Output]: Connector -> Output { swap.Output }
fun coming[swap: Connector -> Output -> Output]: Connector -> Output {
  { conn: swap.Output.Output, new: Output | some conn.swap.new }
}

/* No (port, topic) occurs twice. */
pred each_once[swap: Connector -> Output -> Output] {
  all conn: swap.Output.Output, o: Output | lone conn.swap[o] and lone conn.swap.o
  no leaving[swap] & coming[swap]
}

pred can_handover[s: System, swap: Connector -> Output -> Output] {
  some swap
  leaving[swap].Output in s.conns
  leaving[swap] in s.roles
  no coming[swap] & s.roles
  Connector.(leaving[swap] + coming[swap]) in s.comps.outputs
  each_once[swap]
  // each new output satisfies the topic in its current mode
  all conn: swap.Output.Output, new: coming[swap][conn] |
    satisfy[s.cur_mode[assoc_outputs.new].mode_guars[new], conn.conn_guar]
}

pred handover[s, t: System, swap: Connector -> Output -> Output] {
  can_handover[s, swap]
  t.comps = s.comps
  t.roles = s.roles + coming[swap] - leaving[swap]
  t.cur_mode = s.cur_mode
  same_world[s, t]
}

/* ---- checks ---- */

assert SafeHandover {
  rules => all s, t: System, swap: Connector -> Output -> Output | valid_sys[s] and handover[s, t, swap] => valid_sys[t]
}
check SafeHandover for 5 but 2 System expect 0

run Handover {
  rules
  some s, t: System, swap: Connector -> Output -> Output | valid_sys[s] and handover[s, t, swap]
    and some s.cur_mode.Mode.assoc_inputs and #swap = 2
} for 4 but 2 System expect 1

/* Judged by its normal mode instead of its current one, the new output may leave the topic unsatisfied. */
run HandoverNeedsCurrentMode {
  rules
  some s, t: System, conn: s.conns, old, new: s.comps.outputs {
    valid_sys[s] and not valid_sys[t]
    conn -> old in s.roles and conn -> new not in s.roles
    satisfy[norm_mode[assoc_outputs.new].mode_guars[new], conn.conn_guar]
    t.comps = s.comps and t.cur_mode = s.cur_mode and same_world[s, t]
    t.roles = s.roles + conn -> new - conn -> old
  }
} for 4 but 2 System expect 1
