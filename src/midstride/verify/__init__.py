"""What backs the word "safe": the Alloy specification, dumps of configurations and plans, and proofs without bounds.

`alloy/` is the specification (read it first), `library` its checks. `naming`, `universe`, `scene`, `formulas`, `text`
and `export` turn what the model holds into Alloy text; `run` runs the Alloy Analyzer; `trace`, `chain` and `picture`
tell what comes back in the file's own names; `verdict` holds the answers; `checking` puts these together. `prove/` is
the SMT side.
"""
