"""Does the motion read as a person? The figures for the eye, of a real take, the corpus, unit selection, ours, others.

    gesticulator probe eye [--system NAME=DIR ...] [--data STORE] [--speech FILE ...] [--renderings 8] [--out FILE.json]

Every system gestures for the same sounds: the real take's voice in GESTICULATOR_DATA, or those that `--speech` names.
Ours (`--bundle`) and, with `--data`, unit selection over the store's training split are rendered here, with seeds 0 to
N - 1, and once more with the sound rolled. Others bring files: DIR holds SOUND.bvh or SOUND.ANYTHING.bvh for each
rendering, with the block edges in a plan beside it (SOUND.ANYTHING.json of `infer --explain`) where they are known.
The corpus is the store's test split, with its own voices.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_module.blocks import cut
from data_module.corpora.folder import SOUNDS
from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion.bvh import write_bvh
from data_module.motion.kinematics import resample
from data_module.speech.audio import load_speech
from data_module.store import Recording, Store
from data_module.types import Array, Motion, Speech
from eval.baselines import controls as baselines
from eval.baselines.unit_selection import NAME as UNITS
from eval.baselines.unit_selection import UnitDatabase, UnitSelection
from eval.clip.foreign import edges_of_plan, find_motions, named, read_motion
from eval.clip.measure import real_take
from eval.metrics.eye import ReferenceSpace, VoiceActivity, hear
from eval.metrics.eye.body import HZ
from eval.metrics.eye.frechet import REFERENCE
from eval.metrics.eye.sample import CORPUS, EyeSample, controls, eye_tables
from eval.table import Table
from gesticulator.bundle import bundle as bundles
from gesticulator.pipeline import Gesticulator

TAKE, OURS = "real take", "ours"
VOICE = "take"
"""The name of the real take's voice."""


@dataclass(frozen=True)
class SpeechClip:
    """A voice that systems gesture for. name: of its files."""

    name: str
    speech: Speech
    heard: VoiceActivity


@dataclass
class Player:
    """A system that is rendered here. perform(speech, seed, rolled): its motion, and the edges [N + 1] of its blocks;
    rolled: of the sound as heard `baselines.ROLLED` blocks late. spent, sound: seconds of computing and of sound."""

    name: str
    perform: Callable[[Speech, int, bool], tuple[Motion, Array]]
    note: str = ""
    spent: float = 0.0
    sound: float = 0.0

    def __call__(self, speech: Speech, seed: int) -> tuple[Motion, Array]:
        """The same as `perform`, not rolled, on the clock."""
        begin = time.perf_counter()
        made = self.perform(speech, seed, False)
        self.spent += time.perf_counter() - begin
        self.sound += speech.duration
        return made

    def described(self) -> str:
        """What it cost."""
        factor = self.spent / self.sound if self.sound else math.nan
        return f"{self.name}: real-time factor {factor:.3f}{self.note}."


def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    parser.add_argument("--system", action="append", default=[], metavar="NAME=DIR",
                        help="another system's motion files")
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="audio files, or folders of them (default: the voice of the real recording)")
    parser.add_argument("--data", metavar="STORE",
                        help="also compare with its test split (the corpus) and with unit selection")
    parser.add_argument("--bundle", metavar="DIR", help="bundle (default: the shipped one)")
    parser.add_argument("--renderings", type=int, default=8, metavar="N", help="seeds per audio file (default 8)")
    parser.add_argument("--reference", type=Path, metavar="FILE",
                        help=f"feature space of the Fréchet distance (default: {REFERENCE} in GESTICULATOR_DATA)")
    parser.add_argument("--limit", type=int, metavar="N", help="maximum number of test recordings")
    parser.add_argument("--work", type=Path, metavar="DIR", help="work folder for the units (default: STORE.work)")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write the motion to DIR/SYSTEM/SOUND.SEED.bvh")
    parser.add_argument("--test-voices", action="store_true",
                        help="add a second table: every system on the voices of the test split, compared with its "
                        "motion")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """The table, and that of the controls; with --test-voices, that of the test split."""
    systems = _checked(arguments)
    space = ReferenceSpace.load(arguments.reference) if arguments.reference else ReferenceSpace.found()
    take = real_take(HZ)
    sounds = _sounds(arguments.speech, take)
    store = Store.open(arguments.data) if arguments.data else None
    recordings = [] if store is None else [store.load(info.name) for info in store.of_split("test")][:arguments.limit]
    samples: dict[str, EyeSample] = {}
    wrong: dict[str, EyeSample] = {}
    if take is not None:
        samples[TAKE], heard = EyeSample(), hear(take[1])
        samples[TAKE].add(take[0], heard, None, space)
        wrong = controls(take[0], heard, space)
    players = _players(arguments, store)
    if recordings:
        samples[CORPUS] = _corpus(recordings, space)
    for player in players:
        samples[player.name] = _played(player, sounds, arguments.renderings, space, arguments.write)
    for name, place in systems.items():
        samples[name] = _read(name, Path(place), sounds, space)
    notes = [player.described() for player in players]
    if space is None:
        notes.append(f"No Frechet distance: {REFERENCE} is not at hand (--reference).")
    facts = {"sounds": [sound.name for sound in sounds], "renderings": arguments.renderings,
             "store": None if store is None else store.fingerprint}
    told = (sounds[0].name if arguments.speech else "the real take's voice") if len(sounds) == 1 else (
        f"{len(sounds)} voices")
    tables = eye_tables(samples, wrong, space, f"Perceptual figures, on {told}", notes, facts)
    if arguments.test_voices:
        tables.append(_test_voices(players, recordings, samples[CORPUS], space, wrong))
    return tables


def _checked(arguments: argparse.Namespace) -> dict[str, str]:
    """The folders of other systems by name; InputError for what does not go together."""
    if arguments.renderings < 1:
        raise InputError("--renderings", f"is {arguments.renderings}", "give 1 or more")
    if arguments.test_voices and not arguments.data:
        raise InputError("--test-voices", "needs a store", "add --data STORE")
    systems = named(arguments.system, "--system")
    for name in (TAKE, CORPUS, UNITS, OURS):
        if name in systems:
            raise InputError(f"--system {name}", "is the name of a column of its own", "choose another")
    return systems


def _sounds(told: Sequence[Path], take: tuple[Motion, Speech] | None) -> list[SpeechClip]:
    """Those that are named, or the take's voice; InputError where there is neither."""
    if not told:
        if take is None:
            raise InputError("probe eye", "has no sound to gesture for", "give --speech, or set GESTICULATOR_DATA")
        return [SpeechClip(VOICE, take[1], hear(take[1]))]
    found = []
    for file in (file for place in told for file in (sorted(place.iterdir()) if place.is_dir() else [place])):
        if file.suffix.lower() in SOUNDS or file in told:
            speech = load_speech(file)
            found.append(SpeechClip(file.stem, speech, hear(speech)))
    if not found:
        raise InputError(told[0], "holds no sound", f"name {' or '.join(SOUNDS)} files")
    return found


def _players(arguments: argparse.Namespace, store: Store | None) -> list[Player]:
    """Unit selection, where there is a store, and ours."""
    bundle = bundles.load(Path(arguments.bundle) if arguments.bundle else bundles.SHIPPED)
    system = Gesticulator(bundle)

    def ours(speech: Speech, seed: int, rolled: bool) -> tuple[Motion, Array]:
        encoded = system.encode_speech(speech)
        made = system(speech, seed=seed, encoded=baselines.rolled(encoded) if rolled else encoded)
        return made.motion, made.blocks.edges

    players = [Player(OURS, ours)]
    if store is not None:
        begin = time.perf_counter()
        units = UnitSelection(UnitDatabase.of(store, bundle.config.rhythm,
                                              arguments.work or Path(f"{store.path}.work")))
        note = (f"; {len(units.database)} units of the training split in {units.database.megabytes:.0f} MB, opened in "
                f"{time.perf_counter() - begin:.0f} s")

        def select(speech: Speech, seed: int, rolled: bool) -> tuple[Motion, Array]:
            made = units(speech, seed=seed, rolled=baselines.ROLLED if rolled else 0)
            return made.motion, made.blocks.edges

        players.insert(0, Player(UNITS, select, note))
    return players


def _played(player: Player, sounds: Sequence[SpeechClip], renderings: int, space: ReferenceSpace | None,
            write: Path | None) -> EyeSample:
    """Every sound with every seed, and once more with the sound rolled."""
    sample = EyeSample()
    for sound in sounds:
        for seed in range(renderings):
            motion, edges = player(sound.speech, seed)
            late, _ = player.perform(sound.speech, seed, True)
            sample.add(motion, sound.heard, edges, space, group=sound.name, rolled=late)
            if write is not None:
                stem = write / player.name / f"{sound.name}.{seed}"
                stem.parent.mkdir(parents=True, exist_ok=True)
                write_bvh(stem.with_name(stem.name + ".bvh"), motion)
                write_text(stem.with_name(stem.name + ".json"), json.dumps({"edges": edges.tolist()}))
    return sample


def _corpus(recordings: Sequence[Recording], space: ReferenceSpace | None) -> EyeSample:
    """Recordings of the performer with their own voices. Its seams are at blocks that a system would cut."""
    sample = EyeSample()
    for recording in recordings:
        sample.add(recording.motion, hear(recording.speech), cut(recording.speech).edges, space,
                   group=recording.info.group or recording.info.name)
    return sample


def _read(name: str, place: Path, sounds: Sequence[SpeechClip], space: ReferenceSpace | None) -> EyeSample:
    """What another system made of the sounds; InputError where a sound has no motion."""
    held, _ = find_motions(place)
    sample = EyeSample()
    for sound in sounds:
        own = [file for stem, file in held.items() if stem == sound.name or stem.startswith(f"{sound.name}.")]
        if not own:
            raise InputError(place, f"holds no motion for {sound.name}", f"name it {sound.name}.bvh")
        for file in own:
            moved = resample(read_motion(file, fingers=True), HZ)
            sample.add(moved, sound.heard, edges_of_plan(file.with_suffix(".json")), space,
                       group=sound.name)
    return sample


def _test_voices(players: Sequence[Player], recordings: Sequence[Recording], corpus: EyeSample,
                 space: ReferenceSpace | None, wrong: dict[str, EyeSample]) -> Table:
    """Every system on the voices of the test split, once each, beside the corpus' own motion for them."""
    sounds = [SpeechClip(recording.info.name, recording.speech, hear(recording.speech)) for recording in recordings]
    samples = {CORPUS: corpus, **{player.name: _played(player, sounds, 1, space, None) for player in players}}
    return eye_tables(samples, wrong, space, "Perceptual figures, on the voices of the test split")[0]
