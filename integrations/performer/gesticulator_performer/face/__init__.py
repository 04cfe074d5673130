"""The network of the lips: its training on speech of known phones, and its probe."""

from data_module.registry import RegistryEntry

ENTRY = RegistryEntry("does the mouth follow the sound? Visemes, closures and silence beside simpler mouths",
                      "gesticulator_performer.face.probe")
