/*
 * The model of docs/semantics.md, sections 1 to 3: predicates, components, chains of modes, configurations, validity.
 *
 * The names are the paper's (section 4.3). State that the paper keeps inside a component or connector and copies on change
 * (c', f', conn') is a relation of the System here, so that "the rest unchanged" takes one line:
 *
 *     the paper           here
 *     conn.roles          s.roles[conn]
 *     f.cur_mode          s.cur_mode[f]
 *     f.degraded = True   s.cur_mode[f] = degrad_mode[f]
 *     s.avail_funcs       s.comps.funcs
 *
 * `nothing` is the absence of a predicate: it satisfies no predicate.
 */
module system

/* An assumption of a mode: a predicate, which any associated input may satisfy, or inputs by name. */
abstract sig Assumption {}

/* A predicate over the messages on a port. `sat` is the satisfaction relation, p |= q. */
sig Predicate extends Assumption { sat: set Predicate }

/* `left or right`: one of these inputs is satisfied, each by its own assumption. */
sig NamedInputs extends Assumption { named: some Input }

pred satisfy[p, q: set Predicate] { some p.sat & q }

/* Reflexive and transitive; `nothing` is not among the predicates. */
pred preorder { Predicate <: iden in sat and sat.sat in sat }

abstract sig Port {}
sig Input extends Port { input_asm: one Predicate }
sig Output extends Port {}

sig Connector { conn_guar: one Predicate }

/* A mode has assumptions, and guarantees on its functionality's outputs. `worse` holds every worse mode. */
sig Mode {
  mode_asms: set Assumption,
  mode_guars: Output -> lone Predicate,
  worse: set Mode
}

sig Functionality {
  assoc_inputs: set Input,
  assoc_outputs: set Output,
  modes: some Mode
}

sig Component {
  inputs: set Input,
  outputs: set Output,
  funcs: set Functionality
}

fun norm_mode[f: Functionality]: set Mode { f.modes - f.modes.worse }
fun degrad_mode[f: Functionality]: set Mode { { m: f.modes | no m.worse } }
fun ports[c: set Component]: set Port { c.inputs + c.outputs }

/* Ownership of modes, ports and functionalities. */
pred declared {
  all m: Mode | one modes.m and m.mode_guars.Predicate in (modes.m).assoc_outputs
  all m: Mode | m.mode_asms.named in (modes.m).assoc_inputs
  all f: Functionality | one funcs.f and f.assoc_inputs in (funcs.f).inputs and f.assoc_outputs in (funcs.f).outputs
  all i: Input | one inputs.i
  all o: Output | one outputs.o and one assoc_outputs.o
}

/* The modes of a functionality form a chain, best first. */
pred chains {
  worse.worse in worse
  no iden & worse
  all f: Functionality, disj m, n: f.modes | m in n.worse or n in m.worse
  all f: Functionality | f.modes.worse in f.modes
}

/* M1. The last mode assumes nothing at all. */
pred M1 { all f: Functionality | no degrad_mode[f].mode_asms }

/* M2. If a worse mode's guarantee satisfies a predicate, so does every better mode's. */
pred M2 {
  all m: Mode, n: m.worse, o: Output, q: Predicate |
    satisfy[n.mode_guars[o], q] => satisfy[m.mode_guars[o], q]
}

/* The rules of sections 1 and 2. */
pred rules { preorder and declared and chains and M1 and M2 }

/* A publisher out of scope: what the environment guarantees on a topic. */
sig Publisher { on: one Connector, pub_guar: one Predicate }

/* A configuration and its context: the topics, and the environment's guarantees (`env_pubs`: those on a topic). */
sig System {
  comps: set Component,
  conns: set Connector,
  roles: Connector -> Port,
  cur_mode: Functionality -> Mode,
  env_guars: set Predicate,
  env_pubs: set Publisher
}

/*
 * Satisfaction (section 3) for given attachments and modes, so that an action can be checked against the configuration
 * that it would lead to.
 */
pred conn_satisfied[s: System, roles: Connector -> Port, mode: Functionality -> Mode, conn: Connector] {
  (some f: s.comps.funcs, o: f.assoc_outputs & roles[conn] | satisfy[mode[f].mode_guars[o], conn.conn_guar])
  or satisfy[(s.env_pubs & on.conn).pub_guar, conn.conn_guar]
}

pred input_satisfied[s: System, roles: Connector -> Port, mode: Functionality -> Mode, i: Input] {
  some conn: s.conns & roles.i | satisfy[conn.conn_guar, i.input_asm] and conn_satisfied[s, roles, mode, conn]
}

pred asm_satisfied[s: System, roles: Connector -> Port, mode: Functionality -> Mode, f: Functionality, a: Assumption] {
  (some i: a.named | input_satisfied[s, roles, mode, i])
  or (some i: f.assoc_inputs | satisfy[i.input_asm, a] and input_satisfied[s, roles, mode, i])
  or satisfy[s.env_guars, a]
}

/* All assumptions of f's mode are satisfied. */
pred works[s: System, roles: Connector -> Port, mode: Functionality -> Mode, f: Functionality] {
  all a: mode[f].mode_asms | asm_satisfied[s, roles, mode, f, a]
}

/* Every live functionality is in one of its modes; only ports of live components are attached, to existing topics. */
pred structured[s: System] {
  all f: s.comps.funcs | one s.cur_mode[f] and s.cur_mode[f] in f.modes
  s.cur_mode.Mode in s.comps.funcs
  s.roles in s.conns -> ports[s.comps]
}

/* The safety property: the assumptions of all functionalities are satisfied. */
pred valid_sys[s: System] {
  structured[s]
  all f: s.comps.funcs | works[s, s.roles, s.cur_mode, f]
}

/* The context is the same in both. */
pred same_world[s, t: System] {
  t.conns = s.conns
  t.env_guars = s.env_guars
  t.env_pubs = s.env_pubs
}

/* ---- checks ---- */

/* A non-trivial valid configuration exists: the rules are consistent. */
run ValidSystem {
  rules
  some s: System | valid_sys[s] and some s.roles and some s.cur_mode.Mode.assoc_inputs
    and some f: s.comps.funcs | s.cur_mode[f] = norm_mode[f] and some norm_mode[f].mode_asms & Predicate
} for 4 but 1 System expect 1

/* The finer-grained modes and the assumptions by name are not vacuous. */
run FinerModes {
  rules
  some s: System | valid_sys[s] and some f: s.comps.funcs |
    #f.modes = 3 and s.cur_mode[f] not in norm_mode[f] + degrad_mode[f] and some s.cur_mode[f].mode_asms & NamedInputs
} for 4 but 1 System expect 1
