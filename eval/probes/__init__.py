"""Probes: one question each about a bundle, a data set or a voice. `gesticulator probe NAME`, `--list` shows all.

A probe is a module with `arguments(parser)`, which adds what it takes, and `run(arguments)`, which gives the tables
that answer the question; the command writes and shows them. A new one is a file and an entry here.
"""

from __future__ import annotations

from eval.plugin import Plugin

PROBES: dict[str, Plugin] = {
    "eye": Plugin("eval.probes.eye", "does the motion look human, compared with a real recording, the corpus and "
                                     "unit selection?"),
    "stance": Plugin("eval.probes.stance", "are legs stable? Foot sliding, knees, weight shifts, stillness"),
    "motion": Plugin("eval.probes.motion", "does the motion of a bundle meet the acceptance criteria? Each with "
                                           "bound and verdict"),
    "guidance": Plugin("eval.probes.guidance", "what is the trade-off between lexeme accuracy and timing?"),
    "quality": Plugin("eval.probes.quality", "how good is a bundle on the test split, compared with baselines?"),
    "policies": Plugin("eval.probes.policies", "which interpreter is the best policy?"),
    "corpus": Plugin("eval.probes.corpus", "is a built data set good enough to learn from?"),
    "languages": Plugin("eval.probes.languages", "is a model of one language in time with another?"),
    "gate": Plugin("eval.probes.gate", "does the gate separate gesture from rest, and what is its effect?"),
    "racer": Plugin("eval.probes.racer", "does RACER improve the motion? Every acceptance criterion with bound and "
                                         "verdict"),
    "rewards": Plugin("eval.probes.rewards", "does RACER's reward rank motion?"),
    "style-editing": Plugin("eval.probes.style_editing", "does the motion follow the style controls?"),
    "knobs": Plugin("eval.probes.knobs", "what is the effect of the knobs? Response curves against the range of real "
                                         "people"),
}
