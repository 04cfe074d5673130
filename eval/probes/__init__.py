"""Probes: one question each about a bundle, a data set or a voice. `gesticulator probe NAME`, `--list` shows all.

A probe is a module with `arguments(parser)`, which adds what it takes, and `run(arguments)`, which gives the tables
that answer the question; the command writes and shows them. A new one is a file and an entry here. Nothing imports a
probe: what two of them need lies below, in `eval.metrics`, `eval.clip` or `eval.runner`. The acceptances of motion, of
RACER and of a corpus have a room of their own.
"""

from __future__ import annotations

PROBES: dict[str, tuple[str, str]] = {
    "eye": ("eval.probes.eye",
            "does the motion look human, compared with a real recording, the corpus and unit selection?"),
    "stance": ("eval.probes.stance", "are legs stable? Foot sliding, knees, weight shifts, stillness"),
    "motion": ("eval.acceptance.motion.command",
               "does the motion of a bundle meet the acceptance criteria? Each with bound and verdict"),
    "quality": ("eval.probes.quality", "how good is a bundle on the test split, compared with baselines?"),
    "corpus": ("eval.acceptance.corpus.command", "is a built data set good enough to learn from?"),
    "languages": ("eval.probes.languages", "is a model of one language in time with another?"),
    "racer": ("eval.acceptance.racer.command",
              "does RACER improve the motion? Every acceptance criterion with bound and verdict"),
    "rewards": ("eval.probes.rewards", "does RACER's reward rank motion?"),
    "style-editing": ("eval.probes.style_editing", "does the motion follow the style controls?"),
    "knobs": ("eval.probes.knobs", "what is the effect of the knobs? Response curves against the range of real people"),
}
"""By name: the module, and one line about it."""
