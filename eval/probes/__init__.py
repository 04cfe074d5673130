"""Probes: one question each about a bundle, a data set or a voice. `gesticulator probe NAME`, `--list` shows all.

A probe is a module with `arguments(parser)`, which adds what it takes, and `run(arguments)`, which gives the tables
that answer the question; the command writes and shows them. A new one is a file and an entry here. Nothing imports a
probe: what two of them need lies below, in `eval.metrics` or `eval.clip`. Those of the training corpus and of the lips
are in `gesticulator-performer`.
"""

from __future__ import annotations

from data_module.registry import Registry, RegistryEntry, is_tool

PROBES: Registry[RegistryEntry] = Registry("probes", "a probe", {}, RegistryEntry, fits=is_tool)
"""Empty here: distributions such as gesticulator-performer bring theirs as entry points `gesticulator.probes`."""
