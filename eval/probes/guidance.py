"""What do obedience and timing cost each other? The front over guidance on sound and on the lexeme.

    gesticulator probe guidance --store STORE [--bundle DIR] [--audio 0 1 2 3] [--lexeme -1 0 0.4 1]
                                [--system NAME=BUNDLE ...] [--split val|test] [--limit N] [--renderings 1]
                                [--work DIR] [--out FILE.json]

Every pair of values is played on a minute of each recording of the split, the rest of the selection as the bundle was
frozen with; other bundles (`--system`), such as those with other beats, as they were frozen. A row: window Frechet
distance to real takes and to the split's own motion, PMB above chance by two detectors, the same of the sound rolled by
60 blocks on the same grid, the share of drawn blocks that are the lexeme that was asked for, and what hands do. At -1
the lexeme is left out: what it costs to be told one at all.

What fools it: blocks end on beats, so what is in time on its grid alone keeps its PMB when the sound is rolled; the row
of the split's own motion tells how much there is to be gained. Values are chosen on the validation split, never on
the test split or a real take.
"""

from __future__ import annotations

import argparse
import copy
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from data_module.errors import InputError
from data_module.store import Store
from eval.acceptance.motion.movements import BEST, encode
from eval.acceptance.motion.seen import POOLED, TO_CORPUS, measured, own_motion, sample_of
from eval.clip.foreign import named
from eval.metrics.eye import ReferenceSpace
from eval.metrics.eye.sample import CORPUS, EyeSample
from eval.runner.renderings import (
    AcceptanceVoice,
    BundleSystem,
    KeptRenderings,
    ListeningGesticulator,
    Pair,
    described,
    held_out_voices,
)
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.config import with_settings

AUDIO = (0.0, 1.0, 2.0, 3.0)
LEXEME = (-1.0, 0.0, 0.4, 1.0)
OBEYED, AMONG = "obeyed", f"among {BEST}"
FIGURES = {
    POOLED: Column("Frechet to real takes", "", 1, "low"),
    TO_CORPUS: Column("Frechet to the split", "", 1, "low"),
    "eye_above_1": Column("PMB above chance, first detector", "%", 0, "high"),
    "eye_rolled_1": Column("the same, sound rolled", "%", 0, "low"),
    "eye_above_2": Column("PMB above chance, second detector", "%", 0, "high"),
    "eye_rolled_2": Column("the same, sound rolled", "%", 0, "low"),
    OBEYED: Column("blocks that are the lexeme asked for", "%", 0, "high"),
    AMONG: Column(f"among the best {BEST}", "%", 0, "high"),
    "eye_hand_height_correlation": Column("heights of the hands correlate", "", 2),
    "eye_speed_50": Column("hand speed, median", "m/s", 2),
    "eye_speed_95": Column("95 %", "m/s", 2),
    "eye_stroke_amplitude": Column("stroke", "cm", 0),
    "eye_seam": Column("seams", "", 2, "low"),
}


def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    add = parser.add_argument
    add("--bundle", type=Path, metavar="DIR", help="bundle (default: the shipped one)")
    add("--store", required=True, metavar="STORE", help="a store built by `gesticulator build`")
    add("--audio", type=float, nargs="+", default=AUDIO, metavar="G", help="guidance on the audio (default 0 1 2 3)")
    add("--lexeme", type=float, nargs="+", default=LEXEME, metavar="G",
        help="guidance on the lexeme (default -1 0 0.4 1); -1 leaves it out")
    add("--split", choices=("val", "test"), default="val", help="split of the recordings (default val)")
    add("--limit", type=int, metavar="N", help="use only the first N recordings of the split")
    add("--system", action="append", default=[], metavar="NAME=BUNDLE", help="another bundle, with its own settings")
    add("--renderings", type=int, default=1, metavar="N", help="seeds per recording (default 1)")
    add("--work", type=Path, metavar="DIR", help="work folder for renderings (default: STORE.work)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """A row for each pair of values; InputError for what cannot be used."""
    torch.set_num_threads(1)
    for name, value in (("--limit", arguments.limit), ("--renderings", arguments.renderings)):
        if value is not None and value < 1:
            raise InputError(name, f"is {value}", "give 1 or more")
    places = named(arguments.system, "--system")
    store = Store.open(arguments.store)
    kept = KeptRenderings((arguments.work or Path(f"{store.path}.work") / "acceptance") / "renderings")
    ours = BundleSystem("ours", arguments.bundle or bundles.SHIPPED, kept)
    _ = ours.bundle.block_models  # a bundle of RACER's own codec has nothing to guide
    config = ours.bundle.config
    if not ours.bundle.system.varies:
        raise InputError(f"bundle {ours.folder}", "has a generator without guidance on sound and lexeme",
                         "use one with generator.head flow")
    voices = held_out_voices(store, arguments.limit, config.motion.joints, arguments.split)
    space = ReferenceSpace.found()
    corpus = own_motion(voices, space)
    rows: dict[str, dict[str, Cell]] = {CORPUS: {
        name: found for name, found in measured(corpus, space, None).items() if name in FIGURES}}
    frozen = (config.selection.audio_guidance, config.selection.lexeme_guidance)
    for pair in dict.fromkeys([frozen, *itertools.product(arguments.audio, arguments.lexeme)]):
        rows[_title(pair, frozen)] = _row(_guided(ours, *pair), voices, arguments.renderings, space, corpus)
    for name, place in places.items():
        rows[name] = _row(BundleSystem(name, Path(place), kept), voices, arguments.renderings, space, corpus)
    notes = [f"{len(voices)} recordings of the split {arguments.split}, a minute of each at most, "
             f"{arguments.renderings} renderings; intervals are bootstrap 95 % over recordings.",
             "At -1 the lexeme is left out; the grid of blocks, which ends on beats, is the same in all rows."]
    facts = {"store": store.fingerprint, "bundle": ours.key, "split": arguments.split, **described(voices)}
    return [Table("Guidance on sound and on the lexeme", FIGURES, rows, "guidance", notes, facts)]


def _title(pair: tuple[float, float], frozen: tuple[float, float]) -> str:
    told = f"sound {pair[0]:g}, lexeme {pair[1]:g}"
    return f"{told} (as frozen)" if pair == frozen else told


def _guided(ours: BundleSystem, audio: float, lexeme: float) -> BundleSystem:
    """The same bundle with other guidance."""
    other = copy.copy(ours)
    config = with_settings(ours.bundle.config, [f"selection.audio_guidance={audio!r}",
                                                f"selection.lexeme_guidance={lexeme!r}"])
    other.gesticulator = ListeningGesticulator(replace(ours.bundle, config=config))
    other.key = f"{ours.key} sound {audio!r} lexeme {lexeme!r}"
    return other


def _row(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int, space: ReferenceSpace | None,
         corpus: EyeSample) -> dict[str, Cell]:
    pairs = [(voice, pair) for voice in voices for pair in system.pairs(voice, range(renderings))]
    found: dict[str, Cell] = dict(measured(sample_of(pairs, space), space, corpus))
    found |= _obedience(system, pairs)
    return {name: found[name] for name in FIGURES if name in found}


def _obedience(system: BundleSystem, pairs: Sequence[tuple[AcceptanceVoice, Pair]]) -> dict[str, Interval]:
    """Percent of the drawn blocks."""
    ranks = [encode(system.bundle, made, system.gesticulator.speaker_index(system.speaker(voice)))
             for voice, (made, _) in pairs]
    groups = [voice.group or voice.name for voice, _ in pairs]
    return {name: mean_interval([100.0 * float((own < least).mean()) for own in ranks], [len(own) for own in ranks],
                                groups=groups)
            for name, least in ((OBEYED, 1), (AMONG, BEST))}
