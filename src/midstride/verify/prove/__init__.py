"""Unbounded proofs: the facts F1, F2, F3 and F6 of docs/semantics.md, for systems of any size.

`terms` has formulas as SMT-LIB text, `theory` sections 1 to 3, `actions` section 4, `goals` and `facts`
what is proved, `solvers` z3 and cvc5, `run` the verdicts, and `counterexample` the text of counterexamples.
"""

from midstride.verify.prove.run_proofs import GOALS, Proof, Weakened, prove, prove_goal
from midstride.verify.prove.solvers import NAMES, version_of

__all__ = ["GOALS", "NAMES", "Proof", "Weakened", "prove", "prove_goal", "version_of"]
