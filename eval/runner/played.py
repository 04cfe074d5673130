"""Motion as it is played, block by block, for a reward that must know a person from a shuffle.

Each voice is played with the lexemes of several policies, by the same generator and the same speaker: those that the
performer's motion is read as (`REPLAYED`), and those of interpreters and of policies that know nothing. What all
have in common, such as the look of what is generated, tells none of them apart. The captured motion is kept beside.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from data_module.files import write_bytes
from eval.baselines.interpreters import Majority, Random, ReplayInterpreter
from eval.metrics.encode import SpeechBlocks, encode_motion
from eval.renderings import AcceptanceVoice, BundleSystem, program_key
from interpreters.base import LexemeInterpreter

PERFORMER, REPLAYED = "performer", "performer's lexemes"
RANDOM, MAJORITY = "random", "majority"
UNITS = "unit selection"
_PROGRAM = ("data_module", "lexicon", "generator", "gesticulator.sampling", "gesticulator.systems",
            "gesticulator.bundle", "interpreters.lstm", "interpreters.cql", "interpreters.advantage",
            "interpreters.statistical", "interpreters.planner")
"""What makes the motion; models that judge it do not."""


@dataclass(frozen=True)
class PlayedVoice:
    """A voice in N blocks. audio: [N, K, d]; silent: [N]; log_duration: [N]; motions: by policy [N, K, D_m],
    normalised by the statistics of `speaker`; group: voices of one group are alike."""

    name: str
    group: str
    audio: Tensor
    silent: NDArray[np.bool_]
    log_duration: Tensor
    motions: Mapping[str, Tensor]
    speaker: int = 0


@dataclass(frozen=True)
class FurtherPolicy:
    """An interpreter that no bundle holds, and the temperature at which its lexemes are drawn (0: the best one). key:
    a hash of all that shapes it."""

    interpreter: LexemeInterpreter
    temperature: float
    key: str


class VoicePlayer:
    """Plays voices with a bundle, and keeps what was played in a folder (None: nothing is kept). further: policies that
    are not in the bundle, by the name that they are asked for by."""

    def __init__(self, ours: BundleSystem, folder: Path | None,
                 further: Mapping[str, FurtherPolicy] | None = None) -> None:
        self.ours, self._folder, self.further = ours, folder, dict(further or {})

    @property
    def joints(self) -> int:
        """Of the bundle's motion."""
        return self.ours.bundle.config.motion.joints

    def voices(self, voices: Sequence[AcceptanceVoice], policies: Sequence[str],
               others: Mapping[str, Any] | None = None, progress: bool = True) -> list[PlayedVoice]:
        """Each voice as captured and by each policy; others: systems by name (`RenderedSystem`), which need not be of
        the bundle."""
        return [self.play(voice, seed, policies, others or {})
                for seed, voice in enumerate(tqdm(voices, desc="playing", disable=not progress))]

    def play(self, voice: AcceptanceVoice, seed: int, policies: Sequence[str], others: Mapping[str, Any]
             ) -> PlayedVoice:
        """One voice, with a seed."""
        assert voice.own is not None
        speaker = self.ours.speaker(voice) or self.ours.gesticulator.speakers[
            self.ours.gesticulator.speaker_index(None)]
        heard = SpeechBlocks.heard(self.ours.bundle, replace(voice.speech, speaker=speaker, words=None))
        read = encode_motion(self.ours.bundle, voice.own, heard.blocks, speaker)
        motions = {PERFORMER: read.poses}
        for policy in policies:
            motions[policy] = self._kept(voice, seed, policy, read.labels)
        for name, system in others.items():
            made = system.pairs(voice, [seed])[0][0]
            motions[name] = encode_motion(self.ours.bundle, made.motion, heard.blocks, speaker).poses
        count = min(len(heard.blocks.silent), *(len(motion) for motion in motions.values()))
        assert heard.audio is not None
        return PlayedVoice(voice.name, voice.group or voice.name, heard.audio[:count], heard.blocks.silent[:count],
                           torch.as_tensor(np.log(heard.blocks.durations[:count])).float(),
                           {name: motion[:count].float() for name, motion in motions.items()},
                           self.ours.gesticulator.speaker_index(speaker))

    def _kept(self, voice: AcceptanceVoice, seed: int, policy: str, labels: NDArray[np.int64]) -> Tensor:
        further = self.further.get(policy)
        asked = policy if further is None else [further.key, further.temperature]
        key = [self.ours.key, program_key(_PROGRAM), voice.key, self.ours.speaker(voice), seed, asked]
        name = hashlib.sha256(json.dumps(key).encode()).hexdigest()[:24]
        file = None if self._folder is None else self._folder / f"{name}.npz"
        if file is not None and file.is_file():
            try:
                with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as held:
                    return torch.as_tensor(held["drawn"].astype(np.float32))
            except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
                pass  # damaged: played again
        wordless = replace(voice, speech=replace(voice.speech, words=None))
        self.ours.perform(wordless, seed, **self._asked(policy, labels))
        drawn = self.ours.gesticulator.drawn.astype(np.float16)
        if file is not None:
            memory = io.BytesIO()
            np.savez(memory, drawn=drawn)
            file.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(file, memory.getvalue())
        return torch.as_tensor(drawn.astype(np.float32))

    def _asked(self, policy: str, labels: NDArray[np.int64]) -> dict[str, Any]:
        """What the pipeline is asked for."""
        bundle = self.ours.bundle
        if policy in self.further:
            return {"interpreter": self.further[policy].interpreter, "temperature": self.further[policy].temperature}
        if policy == REPLAYED:
            # The speech may be cut into a block more than the motion was read in.
            padded = np.concatenate([labels, labels[-1:].repeat(2)])
            return {"interpreter": ReplayInterpreter([padded], len(bundle.vectors)), "temperature": 0.0}
        if policy == RANDOM:
            return {"interpreter": Random(len(bundle.vectors)), "temperature": 1.0}
        if policy == MAJORITY:
            return {"interpreter": Majority(bundle), "temperature": 1.0}
        return {"interpreter": policy}
