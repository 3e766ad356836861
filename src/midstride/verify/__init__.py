"""The evidence for "safe": the Alloy specification, exact dumps of configurations and plans, unbounded proofs.

`alloy/` is the specification (read it first), `library` loads it and `specification` checks it. `alloy_atoms`,
`world_encoder`, `formulas`, `alloy_text` and `export` translate model values to Alloy text; `run` runs the Alloy
Analyzer; `trace`, `chain` and `diagram` translate its answer back to the names of the file; `verdict` holds the
answers; `checking` puts these together. `prove/` has the proofs by SMT solvers.
"""

PUBLIC = (
    "Alloy AlloyOptions Answer Checked Verdict chain_lines check_specification find parallel_jobs tasks to_dot "
    "to_mermaid verify_configuration verify_plan verify_specification"
)
