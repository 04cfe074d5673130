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
from collections.abc import Sequence
from pathlib import Path

from data_module.corpora.folder import SOUNDS
from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion.bvh import write_bvh
from data_module.speech.audio import load_speech
from data_module.store import Store
from data_module.types import Motion, Speech
from eval.acceptance.motion.seen import OURS, REAL, own_motion, sample_of
from eval.baselines.unit_selection import NAME as UNITS
from eval.clip.foreign import named
from eval.clip.measure import real_take
from eval.metrics.eye import ReferenceSpace
from eval.metrics.eye.body import HZ
from eval.metrics.eye.frechet import REFERENCE
from eval.metrics.eye.sample import CORPUS, EyeSample, controls, eye_tables
from eval.renderings import (
    TAKE,
    TEST,
    AcceptanceVoice,
    BundleSystem,
    FiledSystem,
    KeptRenderings,
    Pair,
    RenderedSystem,
    UnitSystem,
    plan_of,
)
from eval.table import Table
from gesticulator.bundle.files import bundle_folder

Pairs = Sequence[tuple[AcceptanceVoice, Pair]]


def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    parser.add_argument("--system", action="append", default=[], metavar="NAME=DIR",
                        help="another system's motion files")
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="audio files, or folders of them (default: the voice of the real recording)")
    parser.add_argument("--data", metavar="STORE",
                        help="also compare with its test split (the corpus) and with unit selection")
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
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
    files = _checked(arguments)
    space = ReferenceSpace.load(arguments.reference) if arguments.reference else ReferenceSpace.found()
    take = real_take(HZ)
    voices = _voices(arguments.speech, take)
    store = Store.open(arguments.data) if arguments.data else None
    players = _players(arguments, store)
    tested = [] if store is None else _of_test_split(store, arguments.limit)
    samples: dict[str, EyeSample] = {}
    wrong: dict[str, EyeSample] = {}
    if take is not None:
        # On its own rig, which has fingers; the controls are made on the character.
        whole = real_take(HZ, own_rig=True) or take
        real = AcceptanceVoice(TAKE, take[1], TAKE, whole[0])
        samples[REAL] = own_motion([real], space)
        wrong = controls(take[0], real.heard, space)
    if tested:
        samples[CORPUS] = own_motion(tested, space)
    notes = []
    for player in players:
        pairs = [(voice, pair) for voice in voices for pair in player.pairs(voice, range(arguments.renderings))]
        samples[player.name] = sample_of(pairs, space)
        notes.append(f"{player.name}: real-time factor {_factor(pairs):.3f}.")
        if arguments.write is not None:
            _write(pairs, arguments.write / player.name)
    for name, place in files.items():
        samples[name] = sample_of(_read(name, Path(place), voices), space)
    if space is None:
        notes.append(f"No Frechet distance: {REFERENCE} is not at hand (--reference).")
    facts = {"sounds": [voice.name for voice in voices], "renderings": arguments.renderings,
             "store": None if store is None else store.fingerprint}
    told = (voices[0].name if arguments.speech else "the real take's voice") if len(voices) == 1 else (
        f"{len(voices)} voices")
    tables = eye_tables(samples, wrong, space, f"Perceptual figures, on {told}", notes, facts)
    if arguments.test_voices:
        once = {player.name: sample_of([(voice, pair) for voice in tested for pair in player.pairs(voice, [0])], space)
                for player in players}
        tables.append(eye_tables({CORPUS: samples[CORPUS], **once}, wrong, space,
                                 "Perceptual figures, on the voices of the test split")[0])
    return tables


def _checked(arguments: argparse.Namespace) -> dict[str, str]:
    """The folders of other systems by name; InputError for what does not go together."""
    if arguments.renderings < 1:
        raise InputError("--renderings", f"is {arguments.renderings}", "give 1 or more")
    if arguments.test_voices and not arguments.data:
        raise InputError("--test-voices", "needs a store", "add --data STORE")
    systems = named(arguments.system, "--system")
    for name in (REAL, CORPUS, UNITS, OURS):
        if name in systems:
            raise InputError(f"--system {name}", "is the name of a column of its own", "choose another")
    return systems


def _voices(told: Sequence[Path], take: tuple[Motion, Speech] | None) -> list[AcceptanceVoice]:
    """Those that are named, or the take's; InputError where there is neither."""
    if not told:
        if take is None:
            raise InputError("probe eye", "has no sound to gesture for", "give --speech, or set GESTICULATOR_DATA")
        return [AcceptanceVoice(TAKE, take[1], TAKE)]
    files = [file for place in told for file in (sorted(place.iterdir()) if place.is_dir() else [place])]
    found = [AcceptanceVoice(file.stem, load_speech(file), "named") for file in files
             if file.suffix.lower() in SOUNDS or file in told]
    if not found:
        raise InputError(told[0], "holds no sound", f"name {' or '.join(SOUNDS)} files")
    return found


def _of_test_split(store: Store, limit: int | None) -> list[AcceptanceVoice]:
    """Whole recordings with their own motion; the bundle plays them with its default performer."""
    recordings = [store.load(info.name) for info in store.of_split("test")[:limit]]
    return [AcceptanceVoice(one.info.name, one.speech, TEST, one.motion, group=one.info.group) for one in recordings]


def _players(arguments: argparse.Namespace, store: Store | None) -> list[RenderedSystem]:
    """Unit selection, where there is a store, and ours."""
    kept = KeptRenderings(None)
    ours = BundleSystem(OURS, bundle_folder(arguments.bundle), kept)
    if store is None:
        return [ours]
    work = arguments.work or Path(f"{store.path}.work")
    return [UnitSystem(UNITS, store, work, kept, ours.bundle.config.rhythm), ours]


def _factor(pairs: Pairs) -> float:
    """Seconds of computing for a second of sound."""
    return sum(made.spent for _, (made, _) in pairs) / sum(voice.speech.duration for voice, _ in pairs)


def _write(pairs: Pairs, folder: Path) -> None:
    """VOICE.SEED.bvh, with a plan beside it, as `--system` reads them."""
    folder.mkdir(parents=True, exist_ok=True)
    seeds: dict[str, int] = {}
    for voice, (made, _) in pairs:
        seed = seeds[voice.name] = seeds.get(voice.name, -1) + 1
        write_bvh(folder / f"{voice.name}.{seed}.bvh", made.motion)
        write_text(folder / f"{voice.name}.{seed}.json", plan_of(made))


def _read(name: str, place: Path, voices: Sequence[AcceptanceVoice]) -> Pairs:
    """What another system made of the voices; InputError where a voice has no motion."""
    system, pairs = FiledSystem(name, place, fingers=True), []
    for voice in voices:
        found = system.pairs(voice, [0])
        if not found:
            raise InputError(place, f"holds no motion for {voice.name}", f"name it {voice.name}.bvh")
        pairs += [(voice, pair) for pair in found]
    return pairs
