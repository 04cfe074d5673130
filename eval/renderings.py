"""Voices, the systems that gesture for them, and their renderings, kept between runs of the acceptance.

A rendering is kept in a folder under a key of everything that it is made of: the bundle, the sound, the seed, what was
asked, and the program itself, so that no change is overlooked. All figures are of what was read back, so that a second
run gives the same to the digit.
"""

from __future__ import annotations

import copy
import hashlib
import importlib
import io
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.arrays import as_floats
from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.motion import rotation
from data_module.motion.kinematics import resample
from data_module.speech import audio
from data_module.store import Store
from data_module.types import Array, Motion, Skeleton, Speech
from eval.baselines import controls as baselines
from eval.baselines.unit_selection import UnitDatabase, UnitSelection
from eval.clip.excerpts import excerpt
from eval.clip.foreign import edges_of_plan, find_motions, read_motion
from eval.metrics.eye import VoiceActivity, hear
from eval.metrics.eye.body import HZ
from eval.metrics.eye.pitch import pitch_track
from gesticulator.assembly import Assembler
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance
from gesticulator.sampling.loop import GeneratedMotion

TAKE, TEST = "take", "test"
"""Where a voice comes from: the real take, or the store's test split."""
SECONDS = 60.0
"""Of each test recording: a minute, over which drift is asked for."""
SHORTEST = 20.0
"""Seconds: shorter recordings have no repetition and hardly a stroke to speak of; they are left out."""
PROGRAM = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval.baselines")


@dataclass(frozen=True)
class AcceptanceVoice:
    """A voice. own: what its speaker does, where known; performer: whose habits are asked for; group: voices of one
    group are alike; place: `TAKE`, `TEST`, or "made" for sounds that were put together."""

    name: str
    speech: Speech
    place: str
    own: Motion | None = None
    performer: str | None = None
    group: str = ""

    @cached_property
    def heard(self) -> VoiceActivity:
        """The onsets, levels and silences of the sound, for the figures."""
        return hear(self.speech)

    @cached_property
    def pitch(self) -> Array:
        """Its track for `eval.metrics.eye.pitch`."""
        return pitch_track(self.speech)

    @cached_property
    def key(self) -> str:
        """Of sound and words."""
        # By content and not by name: the same file under another name is the same rendering.
        digest = hashlib.sha256(self.speech.samples.tobytes())
        digest.update(repr((self.speech.sample_rate, self.speech.words)).encode())
        return digest.hexdigest()


def held_out_voices(store: Store, limit: int | None, joints: int) -> list[AcceptanceVoice]:
    """The middle of every test recording that lasts long enough, the first `limit` of them, with its performer's motion
    in so many joints; InputError where none does."""
    chosen = [info for info in store.of_split("test") if info.seconds >= SHORTEST][:limit]
    if not chosen:
        raise InputError(store.path, f"has no test recording of {SHORTEST:g} s or more", "build a larger store")
    out = []
    for info in chosen:
        piece = excerpt(store.load(info.name, joints), SECONDS)
        out.append(AcceptanceVoice(info.name, piece.speech, TEST, piece.motion, info.speaker,
                                   info.group or info.name))
    return out


@dataclass(frozen=True)
class Rendering:
    """Output of a system. edges: [N + 1] seconds of its blocks, None where they are not known; silent: [N]; lexemes:
    [N] those played; drawn: [N, K, D_m] the blocks as they were drawn; both empty where there are none."""

    motion: Motion
    edges: Array | None
    silent: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    lexemes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    drawn: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))

    def packed(self) -> bytes:
        """As an archive of arrays."""
        skeleton, memory = self.motion.skeleton, io.BytesIO()
        np.savez(memory, rotations=self.motion.rotations.astype(np.float32),
                 root=self.motion.root_positions.astype(np.float32), fps=self.motion.fps,
                 names=np.array(skeleton.names), parents=np.array(skeleton.parents), offsets=skeleton.offsets,
                 absent=np.array(self.motion.absent, dtype=str),
                 edges=np.zeros(0) if self.edges is None else self.edges, silent=self.silent, lexemes=self.lexemes,
                 drawn=self.drawn)
        return memory.getvalue()

    @classmethod
    def unpacked(cls, data: bytes) -> Rendering:
        """The inverse, but for single precision; ValueError or KeyError where it is none."""
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            skeleton = Skeleton(tuple(held["names"].tolist()), tuple(held["parents"].tolist()), held["offsets"])
            motion = Motion(skeleton, rotation.normalise(as_floats(held["rotations"])), as_floats(held["root"]),
                            float(held["fps"]), tuple(held["absent"].tolist()))
            return cls(motion, held["edges"] if len(held["edges"]) else None, held["silent"], held["lexemes"],
                       held["drawn"])


Pair = tuple[Rendering, Rendering | None]
"""A rendering, and what the system makes of the same sound rolled."""


@cache
def program_key() -> str:
    """SHA-256 of every line of the packages that make motion, so that a changed program renders anew."""
    digest = hashlib.sha256()
    for package in PROGRAM:
        # `eval.baselines` holds unit selection, whose renderings are kept under the same key.
        for place in importlib.import_module(package).__path__:
            for file in sorted(Path(place).rglob("*.py")):
                digest.update(file.read_bytes())
    return digest.hexdigest()


class KeptRenderings:
    """A folder of renderings; without one nothing is kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def of(self, key: Sequence[Any], make: Callable[[], Rendering]) -> Rendering:
        """The rendering of a key; it is made where it is not there, and where its file is damaged."""
        file = None
        if self._folder is not None:
            file = self._folder / f"{hashlib.sha256(json.dumps(list(key), default=str).encode()).hexdigest()[:24]}.npz"
            try:
                return Rendering.unpacked(file.read_bytes())
            except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
                pass
        data = make().packed()
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(file, data)
        # Packing rounds to single precision: without this a first run would differ from a second in the last digits.
        return Rendering.unpacked(data)


class ListeningGesticulator(Gesticulator):
    """Keeps the normalised motion of the last blocks that were sampled."""

    drawn: NDArray[np.float32]

    def assemble(self, assembler: Assembler, generated: GeneratedMotion) -> Performance:
        """The performance of generated blocks."""
        self.drawn = generated.motion
        return super().assemble(assembler, generated)


class RenderedSystem(Protocol):
    """Who gestures. `pairs` gives its renderings of a voice, one for each seed, where it has any."""

    name: str

    def pairs(self, voice: AcceptanceVoice, seeds: Sequence[int]) -> list[Pair]:
        """With the sound rolled where that can be had."""


class BundleSystem:
    """A bundle that is played here, at the guidance and temperature that it was frozen with."""

    def __init__(self, name: str, folder: Path, kept: KeptRenderings, bundle: bundles.Bundle | None = None) -> None:
        """bundle: that of the folder, where it was opened before."""
        self.name, self.folder, self._kept = name, folder, kept
        self.gesticulator = ListeningGesticulator(bundle or bundles.load(folder))
        # The index names the hash of every file of the bundle, so its own hash stands for all of them.
        self.key = hashlib.sha256((folder / INDEX).read_bytes()).hexdigest()
        self._encoded: dict[str, SpeechFeatures] = {}
        self._asked: dict[str, Any] = {}

    @property
    def bundle(self) -> bundles.Bundle:
        """The bundle that is rendered."""
        return self.gesticulator.bundle

    def asking(self, name: str, **asked: Any) -> BundleSystem:
        """The same under another name, with these options in every rendering."""
        # A shallow copy: models and encoded speech are shared, options are not.
        other = copy.copy(self)
        other.name, other._asked = name, self._asked | asked
        return other

    @property
    def megabytes(self) -> float:
        """Of its files."""
        return sum(file.stat().st_size for file in self.folder.iterdir() if file.is_file()) / 1e6

    def speaker(self, voice: AcceptanceVoice) -> str | None:
        """The voice's performer where the bundle knows that name, else None, the bundle's default."""
        return voice.performer if voice.performer in self.gesticulator.bundle.speakers else None

    def render(self, voice: AcceptanceVoice, seed: int, rolled: bool = False, **asked: Any) -> Rendering:
        """A voice with a seed. asked: options beside speaker and seed."""
        asked = self._asked | asked

        def made() -> Rendering:
            performance = self.perform(voice, seed, rolled, **asked)
            blocks = performance.blocks
            return Rendering(performance.motion, blocks.edges, blocks.silent, performance.lexemes,
                             self.gesticulator.drawn)

        return self._kept.of(("bundle", self.key, program_key(), voice.key, self.speaker(voice), seed, rolled,
                              sorted(asked.items())), made)

    def perform(self, voice: AcceptanceVoice, seed: int, rolled: bool = False, **asked: Any) -> Performance:
        """The same as a performance that is not kept."""
        speech = audio.resample(voice.speech, audio.SAMPLE_RATE)
        if voice.key not in self._encoded:
            # One voice at a time: the features of an hour do not fit.
            self._encoded = {voice.key: self.gesticulator.encode_speech(speech)}
        encoded = self._encoded[voice.key]
        return self.gesticulator(speech, encoded=baselines.rolled(encoded) if rolled else encoded, seed=seed,
                                 speaker=self.speaker(voice), **self._asked | asked)

    def pairs(self, voice: AcceptanceVoice, seeds: Sequence[int]) -> list[Pair]:
        """Every seed, and with the sound rolled."""
        return [(self.render(voice, seed), self.render(voice, seed, rolled=True)) for seed in seeds]


class UnitSystem:
    """Unit selection over a store's whole training split."""

    def __init__(self, name: str, store: Store, work: Path | None, kept: KeptRenderings) -> None:
        self.name, self._store, self._work, self._kept = name, store, work, kept

    @cached_property
    def _units(self) -> UnitSelection:
        return UnitSelection(UnitDatabase.of(self._store, work=self._work))

    def _render(self, voice: AcceptanceVoice, seed: int, rolled: bool) -> Rendering:
        def made() -> Rendering:
            played = self._units(voice.speech, seed=seed, rolled=baselines.ROLLED if rolled else 0)
            return Rendering(played.motion, played.blocks.edges, played.blocks.silent)

        return self._kept.of(("units", self._store.fingerprint, program_key(), voice.key, seed, rolled), made)

    def pairs(self, voice: AcceptanceVoice, seeds: Sequence[int]) -> list[Pair]:
        """Every seed, and with the sound rolled."""
        return [(self._render(voice, seed, False), self._render(voice, seed, True)) for seed in seeds]


class FiledSystem:
    """Motion files of another: VOICE.bvh or VOICE.ANYTHING.bvh, with the edges of its blocks in a plan beside it.
    The real take's voice is called "take", those of the test split as their recordings."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self._files, _ = find_motions(folder)

    def pairs(self, voice: AcceptanceVoice, seeds: Sequence[int]) -> list[Pair]:
        """All of its files for a voice, whatever the seeds; nothing rolled."""
        # VOICE.0, VOICE.1 and so on are renderings of one voice with different seeds.
        files = [file for stem, file in self._files.items() if stem == voice.name or stem.startswith(f"{voice.name}.")]
        return [(Rendering(resample(read_motion(file), HZ),
                           edges_of_plan(file.with_suffix(".json"))), None) for file in files]


def system_at(name: str, place: Path, kept: KeptRenderings) -> RenderedSystem:
    """A bundle where the folder holds one or where it is the name of a shipped one and no folder, else motion files;
    InputError where it holds neither."""
    # A folder goes before a shipped bundle of the same name.
    place = place if place.exists() else bundle_folder(str(place))
    return BundleSystem(name, place, kept) if (place / INDEX).is_file() else FiledSystem(name, place)
