"""Probes: one question each about a bundle, a data set or a voice. `gesticulator probe NAME`, `--list` shows all.

A probe is a module with `arguments(parser)`, which adds what it takes, and `run(arguments)`, which gives the tables
that answer the question; the command writes and shows them. A new one is a file and an entry here.
"""

from __future__ import annotations

from eval.plugin import Plugin

PROBES: dict[str, Plugin] = {
    "eye": Plugin("eval.probes.eye", "does motion read as a person, beside a real take, the corpus, unit selection?"),
    "stance": Plugin("eval.probes.stance", "do legs stand? Sliding feet, knees, weight shifts, stillness"),
    "motion": Plugin("eval.probes.motion", "is the motion of a bundle accepted? Every clause with bound and verdict"),
    "guidance": Plugin("eval.probes.guidance", "what do obedience and timing cost each other?"),
    "quality": Plugin("eval.probes.quality", "how good is a bundle on the test split, beside baselines?"),
    "policies": Plugin("eval.probes.policies", "which interpreter chooses best, judged as policies?"),
    "corpus": Plugin("eval.probes.corpus", "is a built data set good enough to learn from?"),
    "languages": Plugin("eval.probes.languages", "does one language's model gesture in time with another?"),
    "gate": Plugin("eval.probes.gate", "does the gate know when people gesture, and what does it do?"),
    "racer": Plugin("eval.probes.racer", "does RACER pay? Every clause of its acceptance with bound and verdict"),
    "rewards": Plugin("eval.probes.rewards", "does RACER's reward rank?"),
    "style-editing": Plugin("eval.probes.style_editing", "does the motion do what is asked of its style?"),
    "knobs": Plugin("eval.probes.knobs", "what do the knobs do? Response curves, inside the band of real people?"),
}
