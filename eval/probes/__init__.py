"""Probes: one question each about a bundle, a data set or a voice. `gesticulator probe NAME`, `--list` shows all.

A probe is a module with `arguments(parser)`, which adds what it takes, and `run(arguments)`, which gives the tables
that answer the question; the command writes and shows them. A new one is a file and an entry here. Nothing imports a
probe: what two of them need lies below, in `eval.metrics`, `eval.clip` or `eval.runner`. The acceptances of motion, of
RACER and of a corpus have a room of their own.
"""

from __future__ import annotations

from data_module.registry import Registry, RegistryEntry, is_tool

PROBES: Registry[RegistryEntry] = Registry("probes", "a probe", {
    "face": RegistryEntry("does the mouth follow the sound? Visemes, closures and silence beside simpler mouths",
                          "eval.probes.face"),
    "meaning": RegistryEntry("does what is said choose the right gesture? Precision, recall, traps, rate and cost",
                             "eval.probes.meaning"),
    "recognition": RegistryEntry("do named gestures look like people's? Named by a classifier of people's clips",
                                 "eval.probes.recognition"),
    "corpus": RegistryEntry("is a built data set good enough to learn from?", "eval.acceptance.corpus.command"),
    "languages": RegistryEntry("is a model of one language in time with another?", "eval.probes.languages"),
    "racer": RegistryEntry("does RACER improve the motion? Every acceptance criterion with bound and verdict",
                           "eval.acceptance.racer.command"),
    "rewards": RegistryEntry("does RACER's reward rank motion?", "eval.probes.rewards"),
    "knobs": RegistryEntry("what is the effect of the knobs? Response curves against the range of real people",
                           "eval.probes.knobs"),
}, RegistryEntry, fits=is_tool)
