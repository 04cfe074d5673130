"""What is measured of the motion of a row: clip by clip, by one lexicon and the same networks for all rows.

Lexemes of the motion are those of one lexicon, that of `ours`, so that rows without a lexicon, or with another, can be
compared. Figures of a set (FGD, diversity, motion variance) have no value for a clip; each clip gets the jackknife's:
n times the figure of all less n - 1 times the figure without it. So one paired test serves all (`eval.rows.claims`),
and small sets are freed of the greater part of their bias.
"""

from __future__ import annotations

import io
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.blocks import BlockSettings, cut
from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.speech.onsets import detect_onsets
from data_module.types import Array, Blocks, Motion, Speech
from eval import stats
from eval.clip.measure import measure, motion_values
from eval.metrics import fgd, gesture_features, pmb
from eval.metrics.diversity import diversity, motion_variance
from eval.metrics.encode import labels_of, read_motion
from eval.rows.row import COLUMNS, PAPERS_DELTA
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Statistics
from gesticulator.training.stages.lexicon import BlockLexicon

Lexemes = NDArray[np.int64]
Values = dict[str, float]


@dataclass(frozen=True)
class ClipSpeech:
    """A speech, its onsets in seconds, and the blocks of the preset as it is."""

    speech: Speech
    onsets: Array
    blocks: Blocks

    @classmethod
    def of(cls, speech: Speech, settings: BlockSettings) -> ClipSpeech:
        """Onsets and blocks found."""
        return cls(speech, detect_onsets(speech.samples, speech.sample_rate), cut(speech, settings))

    def lasting(self, seconds: float, settings: BlockSettings) -> ClipSpeech:
        """Cut to what there is motion for."""
        samples = max(1, round(seconds * self.speech.sample_rate))
        if samples >= len(self.speech.samples):
            return self
        return ClipSpeech.of(replace(self.speech, samples=self.speech.samples[:samples], words=None), settings)


@dataclass(frozen=True)
class JudgedClip:
    """What is measured on one clip. latents: [N, D] and lexemes: [N] of its blocks, by the judging lexicon; features:
    [n, E] of each network; pmb_curve: PMB for each delta; beats of the motion, onsets of the speech and edges [B + 1]
    of the blocks that the motion was made in, all in seconds."""

    name: str
    values: Values
    latents: Array
    lexemes: Lexemes
    features: list[Array]
    pmb_curve: Array
    beats: Array
    onsets: Array
    edges: Array


@dataclass(frozen=True)
class PlayedClip:
    """A motion to be judged. truth: the performer's, None where there is none; speaker: "" for a stranger; values: what
    is known of it already; lexemes, edges: those that it was made of and in, where they are the judge's."""

    name: str
    motion: Motion
    speech: ClipSpeech
    truth: Motion | None = None
    speaker: str = ""
    values: Values | None = None
    lexemes: Lexemes | None = None
    edges: Array | None = None


def features_of(motion: Motion, by: Sequence[gesture_features.Features]) -> list[Array]:
    """[n, E] of a motion, for each network."""
    return [gesture_features.pooled([motion], one)[0] for one in by]


@dataclass(frozen=True)
class Judge:
    """The lexicon of the preset with its settings and statistics, and the networks of FGD, the first of which the
    tables show."""

    config: Config
    statistics: Statistics
    lexicon: BlockLexicon
    by: Sequence[gesture_features.Features]

    @torch.no_grad()
    def clip(self, played: PlayedClip, place: int) -> JudgedClip:
        """Everything that is measured on a clip; place: seed of the shifts that give the chance level of PMB."""
        motion, speech, truth = played.motion, played.speech, played.truth
        clip = measure(motion, speech.speech, played.edges, speech.onsets)
        values = motion_values(clip, motion, motion if truth is None else truth, seed=place)
        if truth is None:
            values |= {"maje": float("nan"), "mad": float("nan")}
        read = read_motion(self.lexicon, self.config, self.statistics, motion, speech.blocks, played.speaker)
        lexemes = nearest = read.labels
        conditioned = played.lexemes is not None and len(played.lexemes) == len(nearest)
        if played.lexemes is not None and conditioned:
            lexemes = played.lexemes
        values |= {"pmb": pmb.pmb(clip.beats, clip.onsets, PAPERS_DELTA), "conditioned": float(conditioned)}
        return JudgedClip(
            played.name, {**dict.fromkeys(COLUMNS, float("nan")), **values, **(played.values or {})},
            read.latents.double().numpy(), lexemes, features_of(motion, self.by),
            pmb.delta_curve(clip.beats, clip.onsets).percent, clip.beats, clip.onsets,
            speech.blocks.edges if played.edges is None else played.edges)

    def summary(self, clips: Sequence[JudgedClip], real: Sequence[Sequence[Array]], paired: bool = True
                ) -> dict[str, Any]:
        """"clips" and "sets" of a cell: values of each clip, those of the whole set among them by the jackknife.

        real: for each clip the performer's features, one of each network; not paired: any number of clips of the
        performer's, all of which are compared with. Diversity is of the motion's own lexemes, read from it again; the
        variance is about the lexemes that it was made of, where those are the judge's (RG 7.4.2).
        """
        vectors = self.lexicon.vectors.double().numpy()
        read = [labels_of(self.lexicon, torch.as_tensor(clip.latents, dtype=torch.float32)) for clip in clips]

        def variety(chosen: list[int]) -> float:
            return diversity(np.concatenate([read[k] for k in chosen]), len(vectors)).nats

        def variance(chosen: list[int]) -> float:
            return motion_variance(np.concatenate([clips[k].latents for k in chosen]),
                                   np.concatenate([clips[k].lexemes for k in chosen]), vectors).mean

        every, count = list(range(len(clips))), len(clips)
        features = [clip.features for clip in clips]
        added = {"diversity": stats.jackknife(variety, count), "variance": stats.jackknife(variance, count),
                 "fgd": distances(self.by, features, real, paired)}
        return {
            "clips": [{"name": clip.name, **clip.values, **{key: float(values[k]) for key, values in added.items()}}
                      for k, clip in enumerate(clips)],
            "sets": {"diversity": variety(every), "variance": variance(every),
                     "fgd": set_distances(self.by, features, real, paired),
                     "pmb_curve": {"deltas": list(pmb.DELTAS),
                                   "percent": np.mean([clip.pmb_curve for clip in clips], axis=0).tolist()}}}


def distances(by: Sequence[gesture_features.Features], features: Sequence[Sequence[Array]],
              real: Sequence[Sequence[Array]], paired: bool = True) -> Array:
    """[clips] FGD in the first network by the jackknife, of features by clip and network; NaN without a network."""
    if not by:
        return np.full(len(features), np.nan)

    def distance(chosen: list[int]) -> float:
        beside = [real[k] for k in chosen] if paired else real
        ours, theirs = ([one[0] for one in clips if len(one[0])] for clips in ([features[k] for k in chosen], beside))
        if min(sum(map(len, ours)), sum(map(len, theirs))) < 2:
            return float("nan")
        return fgd.distance(np.concatenate(ours), np.concatenate(theirs))

    return stats.jackknife(distance, len(features))


def set_distances(by: Sequence[gesture_features.Features], features: Sequence[Sequence[Array]],
                  real: Sequence[Sequence[Array]], paired: bool = True) -> list[dict[str, Any]]:
    """FGD of the whole set in every network, with all that it depends on."""
    return [fgd.measure([clip[w] for clip in features], [clip[w] for clip in real], network, paired=paired).to_dict()
            for w, network in enumerate(by)]


def identity(by: Sequence[gesture_features.Features]) -> list[list[Any]]:
    """What tells networks apart, for the hash of figures in them."""
    return [[one.sha256, one.name, one.frames] for one in by]


# ---------------------------------------------------------------------------------------------------- what is kept

PLAYED_ARRAYS = ("latents", "lexemes", "beats", "onsets", "edges")
"""Of each clip, for the figures."""


@dataclass(frozen=True)
class PlayedStore:
    """Where the motion of a cell is kept in the work folder, with the key of the cell."""

    folder: Path
    key: str

    @property
    def file(self) -> Path:
        """What was measured of the motion; beside the folder, in which all files are motion."""
        return self.folder.with_name(f"{self.folder.name}.npz")

    def begin(self) -> None:
        """An empty folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)

    def write(self, clips: Sequence[JudgedClip]) -> None:
        """The plain arrays of what was measured."""
        memory, arrays = io.BytesIO(), dict[str, Any]()
        for k, clip in enumerate(clips):
            arrays |= {f"{what}_{k}": np.asarray(getattr(clip, what)) for what in PLAYED_ARRAYS}
        np.savez_compressed(memory, key=np.array(self.key), names=np.array([clip.name for clip in clips]), **arrays)
        write_bytes(self.file, memory.getvalue())

    def read(self) -> list[dict[str, NDArray[Any]]]:
        """What was measured of each clip, by name; InputError when it is not there, or of other settings."""
        try:
            with np.load(self.file, allow_pickle=False) as held:
                if str(held["key"]) == self.key:
                    return [{"name": name, **{what: held[f"{what}_{k}"] for what in PLAYED_ARRAYS}}
                            for k, name in enumerate(held["names"])]
        except FileNotFoundError:
            pass
        raise InputError(self.folder, "does not hold the motion of this row", "remove its cell and run the row again")
