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
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from data_module import blocks as block_module
from data_module.errors import InputError
from data_module.speech.front_ends import MelFrontEnd, scaled_windows
from data_module.speech.silence import reference_level
from data_module.speech.speech_encoder import HIGH, LEVELS, LOW, SpeechEncoder, load_fairseq
from data_module.store import SPLITS, Recording, RecordingInfo, Split, Store
from data_module.text.word_vectors import word_frames
from data_module.types import Array, Samples
from eval.draw.lexicon_map import evenly
from eval.encode import encode_motion
from eval.linear_probes import LevelFeatures, ProbeScore, grouped, probe_frames, probe_words, tokens_of
from eval.metrics import audio_clusters
from eval.stats import Interval, mean_interval
from eval.table import Column, Table
from gesticulator.bundle import Bundle
from gesticulator.config import Config
from gesticulator.pipeline import Gesticulator

MEL = "mel"
TASKS = {"new_words": "new words, AUC", "known_words": "known words, recall", "energy": "energy, R2",
         "pitch": "pitch, R2"}
_LOWEST, _HIGHEST = 60.0, 500.0  # Hz, of the voice
_BATCH = 4


def level_name(level: int) -> str:
    """What a row of the table is called."""
    return f"level {level}"


def untrained(encoder: SpeechEncoder, seed: int = 0) -> SpeechEncoder:
    """An encoder of the same shape as it was before training."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return SpeechEncoder(encoder.config).eval()


def pitch_of(stretched: Samples, frames: int, sample_rate: int) -> Array:
    """[N, K] log2 of the fundamental frequency in Hz in the middle of each frame of blocks [N, L]; NaN if unvoiced."""
    import librosa

    hop = stretched.shape[1] // frames
    # pyin's frames stand at multiples of the hop: half a frame is cut off, so that they stand in the middles.
    sound = np.append(stretched.ravel()[hop // 2:], np.zeros(hop, np.float32))
    found, _, _ = librosa.pyin(sound, fmin=_LOWEST, fmax=_HIGHEST, sr=sample_rate, frame_length=1024, hop_length=hop,
                               resolution=0.2)
    return np.asarray(np.log2(found[:stretched.shape[0] * frames]), dtype=np.float64).reshape(-1, frames)


def listen(recording: Recording, config: Config, encoders: Mapping[str, SpeechEncoder]) -> LevelFeatures:
    """A recording through every encoder (rows "NAMElevel L") and the mel front end, as in use: windows of three blocks
    at the voice's own level."""
    speech, rate = recording.speech, recording.speech.sample_rate
    blocks = block_module.cut(speech, config.rhythm)
    frames, per_frame = blocks.frames, block_module.samples_per_frame(rate, blocks.fps)
    mel = MelFrontEnd(frames=3 * frames, samples_per_frame=per_frame, sample_rate=rate)
    stretched = block_module.stretch_speech(speech, blocks)
    windows = block_module.windows_of(stretched)
    reference = reference_level(speech.samples, rate, blocks.edges)
    parts: dict[str, list[NDArray[np.float16]]] = {}
    middle = slice(frames, 2 * frames)
    for _, scaled in scaled_windows(windows, reference, windows.shape[1], _BATCH):
        parts.setdefault(MEL, []).append(mel.rows(scaled)[:, middle].astype(np.float16))
        for prefix, encoder in encoders.items():
            with torch.inference_mode():
                levels = encoder.levels(torch.from_numpy(scaled), 3 * frames, range(1, LEVELS + 1))
            for level, rows in enumerate(levels, 1):
                parts.setdefault(prefix + level_name(level), []).append(rows[:, middle].numpy().astype(np.float16))
    features = {name: np.concatenate(rows) for name, rows in parts.items()}
    words, info = speech.words or (), recording.info
    return LevelFeatures(
        info.name, info.group or info.name, info.voice, features,
        features[MEL][..., -1].astype(np.float64),
        pitch_of(stretched, frames, rate), word_frames(words, blocks, config.text.bridge),
        tuple(plain(word.text, info.language) for word in words), blocks.silent)


def plain(word: str, language: str) -> str:
    """A word in small letters without the marks around it, after its language; "" for none."""
    bare = re.sub(r"^[\W_]+|[\W_]+$", "", word.lower())
    return f"{language}:{bare}" if bare else ""


def probes(train: Sequence[LevelFeatures], test: Sequence[LevelFeatures], progress: bool = False
           ) -> dict[str, dict[str, ProbeScore]]:
    """Every task for every row that both have: {row: {task: figure per recording}}."""
    out: dict[str, dict[str, ProbeScore]] = {}
    for row in tqdm(test[0].features, desc="probes", disable=not progress):
        out[row] = probe_words(tokens_of(train, row), tokens_of(test, row), len(test))
        out[row]["energy"] = probe_frames(train, test, row, lambda own: own.energy)
        out[row]["pitch"] = probe_frames(train, test, row, lambda own: own.pitch)
    return out


def compare(rows: Mapping[str, Mapping[str, ProbeScore]], groups: Sequence[str], task: str, better: str, worse: str
            ) -> Interval:
    """How much more one row knows of a task than another, paired over recordings, with its interval."""
    a, b = (grouped(rows[name][task], groups) for name in (better, worse))
    return mean_interval(a.values - b.values, a.weights)


def summary(rows: Mapping[str, Mapping[str, ProbeScore]], groups: Sequence[str], low: int = LOW, high: int = HIGH
            ) -> dict[str, Any]:
    """The table, and what the paper claims as paired differences: above 0 where it holds."""
    table: dict[str, dict[str, Interval]] = {}
    for name, tasks in rows.items():
        table[name] = {}
        for task, judged in tasks.items():
            own = grouped(judged, groups)
            table[name][task] = mean_interval(own.values, own.weights)
    lower, upper = level_name(low), level_name(high)
    pairs = [(task, *((upper, lower) if task.endswith("words") else (lower, upper))) for task in TASKS]
    pairs += [(task, upper, f"untrained {upper}") for task in ("new_words", "known_words")]
    pairs += [(task, lower, f"untrained {lower}") for task in ("energy", "pitch")]
    return {"table": table, "differences": [
        {"task": task, "more": a, "less": b, "difference": compare(rows, groups, task, a, b)}
        for task, a, b in pairs if a in rows and b in rows]}


def hold_out(store: Store, split: Split, limit: int | None, train_limit: int) -> tuple[
        list[RecordingInfo], list[RecordingInfo], bool]:
    """Recordings to fit probes on, to judge them on, and whether no voice is in both.

    The training split without the judged voices; where nothing would be left, with them.
    """
    test = evenly(store, split, limit)
    voices = {info.voice for info in test}
    all_train = [info for info in store.of_split("train") if split != "train" or info not in test]
    train = [info for info in all_train if info.voice not in voices] or all_train
    if not train:
        raise InputError(store.path, "has no recording to fit probes on", "judge them on another split")
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


def lexemes(system: Gesticulator, recording: Recording, seed: int = 0) -> dict[str, NDArray[np.int64]]:
    """[N] the lexeme of each block by whose motion it is: the performer's, and that made for the same speech."""
    known = recording.info.speaker in system.speakers
    made = system(recording.speech, speaker=recording.info.speaker if known else None, seed=seed,
                  fps=recording.motion.fps)
    length = min(len(made.motion), len(recording.motion))
    blocks = block_module.cut(recording.speech, system.bundle.config.rhythm)
    return {name: encode_motion(system.bundle, motion, blocks, recording.info.speaker).labels
            for name, motion in (("performer", recording.motion), ("generated", made.motion.crop(0, length)))}


def figure_14(test: Sequence[LevelFeatures], labels: Sequence[Mapping[str, NDArray[np.int64]]], low: str, high: str,
              clusters: int = audio_clusters.CLUSTERS) -> dict[str, Any]:
    """`audio_clusters.association` of the blocks with speech, for each whose motion (RG Figure 14)."""
    spoken = [~own.silent for own in test]
    names = sorted({own.group for own in test})
    sizes = [int(kept.sum()) for kept in spoken]
    recording = np.repeat(np.arange(len(test)), sizes)
    group = np.array([names.index(own.group) for own in test])[recording]
    groups = np.unique(group, return_inverse=True)[1]
    found = {f"{kind}, {row}": audio_clusters.cluster(np.concatenate(
        [own.features[row][kept].astype(np.float32).mean(axis=1) for own, kept in zip(test, spoken, strict=True)]),
        clusters) for kind, row in (("low", low), ("high", high))}
    return {whose: audio_clusters.association(
        found, np.concatenate([own[whose][kept] for own, kept in zip(labels, spoken, strict=True)]), recording, groups)
        for whose in labels[0]}


def figures(system: Gesticulator, store: Store, *, split: Split = "test", limit: int | None = None,
            train_limit: int = 24, progress: bool = True) -> dict[str, Any]:
    """Every table, as plain values."""
    config = system.bundle.config
    encoder = encoder_of(system.bundle, "--bundle")
    encoders = {"": encoder, "untrained ": untrained(encoder)}
    train_infos, test_infos, apart = hold_out(store, split, limit, train_limit)

    def heard(infos: Sequence[RecordingInfo], title: str) -> list[LevelFeatures]:
        return [listen(store.load(info.name), config, encoders)
                for info in tqdm(infos, desc=title, disable=not progress)]

    train, test = heard(train_infos, "train"), heard(test_infos, split)
    low, high = config.front_end.layers or (LOW, HIGH)
    rows = probes(train, test, progress)
    labels = [lexemes(system, store.load(info.name)) for info in tqdm(test_infos, desc="motion", disable=not progress)]
    met = {word for own in train for word in own.words}
    return {
        "fitted_on": {"recordings": len(train), "voices": sorted({own.voice for own in train}),
                      "seconds": round(sum(info.seconds for info in train_infos), 1)},
        "judged_on": {"recordings": len(test), "voices": sorted({own.voice for own in test}), "voices_unheard": apart,
                      "seconds": round(sum(info.seconds for info in test_infos), 1),
                      "new_words": len({word for own in test for word in own.words} - met)},
        "low": low, "high": high, **summary(rows, [own.group for own in test], low, high),
        "figure_14": figure_14(test, labels, level_name(low), level_name(high))}


def tables(result: Mapping[str, Any]) -> list[Table]:
    """What every level knows, what the paper says of them, and Figure 14.

    The facts of the first have the claim of RG Fig. 14: how much more the high level says of the lexemes that were
    made than the low one.
    """
    fitted, judged = result["fitted_on"], result["judged_on"]
    voices = "none of them among the first" if judged["voices_unheard"] else "SOME OF THEM AMONG THE FIRST"
    about = (f"Linear probes on frozen features, fitted on {fitted['recordings']} recordings "
             f"({fitted['seconds']:.0f} s, {len(fitted['voices'])} voices), judged on {judged['recordings']} "
             f"({judged['seconds']:.0f} s, {len(judged['voices'])} voices, {voices}; {judged['new_words']} new words).")
    claim = [own.to_dict() for own in result["figure_14"]["generated"]["gain_differences"].values()]
    facts = {key: result[key] for key in ("fitted_on", "judged_on", "low", "high", "store") if key in result}
    differences = {f"{TASKS[own['task']]}: {own['more']} - {own['less']}": {"difference": own["difference"]}
                   for own in result["differences"]}
    return [Table("Linear probes", {task: Column(title, digits=3, good="high") for task, title in TASKS.items()},
                  result["table"], "features", [about], {**facts, "claim": claim}),
            Table("What is said of the levels", {"difference": Column("difference", digits=3)}, differences, "task"),
            *(audio_clusters.table(found, [name for name in found if name.startswith(("low, ", "high, "))], whose)
              for whose, found in result["figure_14"].items())]


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle, how many recordings."""
    parser.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--split", default="test", choices=SPLITS)
    parser.add_argument("--limit", type=int, metavar="N", help="that many recordings, evenly chosen (all)")
    parser.add_argument("--train", type=int, default=24, metavar="N", help="recordings to fit the probes on (24)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Probe every level; InputError for a bundle without a speech encoder."""
    torch.set_num_threads(1)
    if arguments.train < 1:
        raise InputError("--train", "must be 1 or more", "give the number of recordings")
    store = Store.open(arguments.data)
    system = Gesticulator.from_pretrained(arguments.bundle)
    encoder_of(system.bundle, arguments.bundle or "the shipped bundle")
    result = figures(system, store, split=arguments.split, limit=arguments.limit, train_limit=arguments.train)
    return tables({**result, "store": {"name": store.corpus, "fingerprint": store.fingerprint,
                                       "split": arguments.split}})
