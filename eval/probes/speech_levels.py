"""What does each level of the speech encoder know? `gesticulator probe speech-levels --data STORE [--bundle DIR]`

Theory: the paper wants content in level 8 and everything else in the levels below (RG 4.1.3). Whether it is there is
asked by probes: linear fits on the frozen features, made afresh for every level and of the same size for each, and
judged on voices that they were not fitted on.
- New words: a linear discriminant (32 directions) is fitted on the words of the training voices; then, of two spoken
  words that it never met, from two voices that it never heard, is it the same word? The area under the ROC curve of
  the cosine, 0.5 by chance. Function words, which all texts share, are therefore not in it.
- Known words: which of the training words is it, from new voices; the mean recall over words.
- Energy and pitch: ridge regression of a frame's log power and log fundamental frequency (pyin), each less its mean in
  the recording (how a voice moves, not whose it is); R2, 0 by chance.
Beside the eight levels stand an untrained encoder of the same shape, which tells what training did, and the mel
features. Then Figure 14 (`metrics.audio_clusters`): clusters of the low and the high level, and the lexemes on them.

What fools it: the loss of Eq. 1 says nothing, since its projections alone can lower it; so no projection of the
training is used here. A word is the means over its thirds: sounds are easily told by their spectra, so even an
untrained level knows words, and the difference from it is what counts. Which word it is, is not what it means. The
encoder's windows are normalised, so energy means energy within three blocks. The mel row's width differs, and energy is
one of its columns. The encoder itself has heard the training voices.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from data_module.errors import InputError
from data_module.speech.speech_encoder import HIGH, LOW, SpeechEncoder, load_fairseq
from data_module.store import Recording, RecordingInfo, Store
from eval.draw.lexicon_map import evenly
from eval.encode import encode_motion
from eval.level_features import LevelFeatures, level_name, listen, untrained
from eval.linear_probes import ProbeScore, probe_frames, probe_words, tokens_of
from eval.metrics import audio_clusters
from eval.stats import mean_interval, paired
from eval.table import Cell, Column, Table
from gesticulator.bundle import Bundle
from gesticulator.pipeline import Gesticulator

TASKS = {"new_words": "new words, AUC", "known_words": "known words, recall", "energy": "energy, R2",
         "pitch": "pitch, R2"}


def probes(train: Sequence[LevelFeatures], test: Sequence[LevelFeatures]) -> dict[str, dict[str, ProbeScore]]:
    """Every task for every row: {row: {task: figure per recording}}."""
    return {row: {**probe_words(tokens_of(train, row), tokens_of(test, row), len(test)),
                  "energy": probe_frames(train, test, row, lambda own: own.energy),
                  "pitch": probe_frames(train, test, row, lambda own: own.pitch)}
            for row in tqdm(test[0].features, "probes")}


def summary(rows: Mapping[str, Mapping[str, ProbeScore]], groups: Sequence[str], low: int = LOW, high: int = HIGH
            ) -> list[Table]:
    """Every row's figures, and what the paper claims as paired differences: above 0 where it holds.

    groups: of each recording; those of one group share their speech and count once in an interval.
    """
    cells: dict[str, dict[str, Cell]] = {
        name: {task: mean_interval(judged.values, judged.weights, groups=groups) for task, judged in tasks.items()}
        for name, tasks in rows.items()}
    lower, upper = level_name(low), level_name(high)
    pairs = [(task, *((upper, lower) if task.endswith("words") else (lower, upper))) for task in TASKS]
    pairs += [(task, *((upper, f"untrained {upper}") if task.endswith("words") else (lower, f"untrained {lower}")))
              for task in TASKS]
    differences: dict[str, dict[str, Cell]] = {f"{TASKS[task]}: {more} - {less}": {"difference": paired(
        rows[more][task].values, rows[less][task].values, rows[more][task].weights, groups=groups)}
        for task, more, less in pairs if more in rows and less in rows}
    return [Table("Linear probes", {task: Column(title, digits=3, good="high") for task, title in TASKS.items()}, cells,
                  "features"),
            Table("What is said of the levels", {"difference": Column("difference", digits=3)}, differences, "task")]


def hold_out(store: Store, limit: int | None, train_limit: int) -> tuple[
        list[RecordingInfo], list[RecordingInfo], bool]:
    """Training recordings to fit probes on, test recordings to judge them on, and whether no voice is in both: those of
    judged voices are left out, unless nothing would be left."""
    test = evenly(store, "test", limit)
    voices = {info.voice for info in test}
    train = [info for info in store.of_split("train") if info.voice not in voices] or store.of_split("train")
    if not train:
        raise InputError(store.path, "has no recording to fit probes on", "build a store with a training split")
    count = min(train_limit, len(train))
    chosen = [train[i] for i in np.linspace(0, len(train) - 1, count).round().astype(int)]
    return chosen, test, not voices & {info.voice for info in chosen}


def encoder_of(bundle: Bundle, subject: str) -> SpeechEncoder:
    """The bundle's encoder, or the published one that its settings name; InputError when there is none."""
    if bundle.encoder is not None:
        return bundle.encoder
    kind, _, path = bundle.config.front_end.name.partition(":")
    if kind == "fairseq":
        return load_fairseq(path)
    raise InputError(subject, f"hears by {bundle.config.front_end.name!r} and has no speech encoder",
                     "give a bundle trained with front_end.name=vqwav2vec")


def lexemes(system: Gesticulator, recording: Recording) -> dict[str, NDArray[np.int64]]:
    """[N] the lexeme of each block by whose motion it is: the performer's, and that made for the same speech."""
    speaker, motion = recording.info.speaker, recording.motion
    made = system(recording.speech, speaker=speaker if speaker in system.speakers else None, seed=0, fps=motion.fps)
    generated = made.motion.crop(0, min(len(made.motion), len(motion)))
    return {name: encode_motion(system.bundle, own, made.blocks, speaker).labels
            for name, own in (("performer", motion), ("generated", generated))}


def figure_14(test: Sequence[LevelFeatures], labels: Sequence[Mapping[str, NDArray[np.int64]]], low: str, high: str,
              clusters: int = audio_clusters.CLUSTERS) -> dict[str, Any]:
    """`audio_clusters.association` of the blocks with speech, for each whose motion (RG Figure 14)."""
    spoken = [~own.silent for own in test]
    recording = np.repeat(np.arange(len(test)), [int(kept.sum()) for kept in spoken])
    group = np.unique(np.array([own.group for own in test])[recording], return_inverse=True)[1]
    found = {f"{kind}, {row}": audio_clusters.cluster(np.concatenate(
        [own.features[row][kept].astype(np.float32).mean(axis=1) for own, kept in zip(test, spoken, strict=True)]),
        clusters) for kind, row in (("low", low), ("high", high))}
    return {whose: audio_clusters.association(found, np.concatenate(
        [own[whose][kept] for own, kept in zip(labels, spoken, strict=True)]), recording, group)
        for whose in labels[0]}


def described(infos: Sequence[RecordingInfo]) -> dict[str, Any]:
    """How much speech there is, and whose."""
    return {"recordings": len(infos), "voices": sorted({info.voice for info in infos}),
            "seconds": round(sum(info.seconds for info in infos), 1)}


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle, how many recordings."""
    parser.add_argument("--bundle", metavar="DIR",
                        help="one with a speech encoder, as of the preset regression (default: the shipped one)")
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--limit", type=int, metavar="N", help="that many test recordings, evenly chosen (all)")
    parser.add_argument("--train", type=int, default=24, metavar="N", help="recordings to fit the probes on (24)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """What every level knows, what the paper says of them, and Figure 14; InputError for a bundle without a speech
    encoder.

    The facts of the first have the claim of RG Fig. 14: how much more the high level says of the lexemes that were
    made than the low one.
    """
    torch.set_num_threads(1)
    if arguments.train < 1:
        raise InputError("--train", "must be 1 or more", "give the number of recordings")
    store, system = Store.open(arguments.data), Gesticulator.from_pretrained(arguments.bundle)
    encoder, config = encoder_of(system.bundle, arguments.bundle or "the shipped bundle"), system.bundle.config
    train_infos, test_infos, apart = hold_out(store, arguments.limit, arguments.train)
    encoders = {"": encoder, "untrained ": untrained(encoder)}
    train, test = ([listen(store.load(info.name), config, encoders) for info in tqdm(infos, "listening")]
                   for infos in (train_infos, test_infos))
    low, high = config.front_end.layers or (LOW, HIGH)
    probed, claimed = summary(probes(train, test), [own.group for own in test], low, high)
    codes = [lexemes(system, store.load(info.name, config.motion.joints)) for info in tqdm(test_infos, "motion")]
    clusters = figure_14(test, codes, level_name(low), level_name(high))
    met = {word for own in train for word in own.words}
    fitted, judged = described(train_infos), described(test_infos)
    judged |= {"voices_unheard": apart, "new_words": len({word for own in test for word in own.words} - met)}
    voices = "none of them among the first" if apart else "SOME OF THEM AMONG THE FIRST"
    about = (f"Linear probes on frozen features, fitted on {fitted['recordings']} recordings "
             f"({fitted['seconds']:.0f} s, {len(fitted['voices'])} voices), judged on {judged['recordings']} "
             f"({judged['seconds']:.0f} s, {len(judged['voices'])} voices, {voices}; {judged['new_words']} new words).")
    facts = {"fitted_on": fitted, "judged_on": judged, "low": low, "high": high,
             "store": {"name": store.corpus, "fingerprint": store.fingerprint, "split": "test"},
             "claim": [own.to_dict() for own in clusters["generated"]["gain_differences"].values()]}
    return [replace(probed, notes=[about], facts=facts), claimed,
            *(audio_clusters.table(found, [name for name in found if name.startswith(("low, ", "high, "))], whose)
              for whose, found in clusters.items())]
