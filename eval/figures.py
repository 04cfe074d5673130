"""`python -m eval.figures --data STORE --bundle BUNDLE`: the figures of the README, on the test split.

Each table has the rows that a reader asks for: the performer (the rule that made the corpus), the systems, always the
commonest lexeme, and, where GESTICULATOR_DATA is set, a real take of a person speaking.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA
from tqdm import tqdm

from data_module.blocks import cut, normalise_motion
from data_module.errors import InputError, one_line_errors
from data_module.motion import bvh, skeletons
from data_module.motion.kinematics import positions_of, resample
from data_module.motion.motion_beats import motion_beats
from data_module.speech.audio import load_speech
from data_module.speech.beats import detect_onsets
from data_module.speech.silence import FRAME as SILENCE_FRAME
from data_module.speech.silence import pauses, silent_frames
from data_module.store import Recording, Store
from data_module.types import Array, Motion, Speech
from eval.bootstrap import interval
from eval.metrics import pmb
from eval.metrics.accuracy import lexeme_accuracy
from eval.parts import hinted_labels
from eval.results import publish
from gesticulator import bundle as bundles
from gesticulator.pipeline import FPS, Gesticulator
from gesticulator.prepare import Corpus, prepare, representation_of
from gesticulator.train import lexicon_figures
from interpreters import BlockFeatures, LexemeInterpreter, LstmInterpreter, select

REAL_FPS = 15.0
_HANDS = ("RightHand", "LeftHand")


class Commonest:
    """Always the lexeme that the speaker uses most: the floor of every table."""

    def __init__(self, bundle: bundles.Bundle) -> None:
        self._best = [int(bundle.inventory.frequencies[name].argmax()) for name in bundle.speakers]
        self._size = bundle.lexicon.quantizer.size

    def start(self, speaker: int, first_lexeme: int) -> int:
        """The state is the speaker."""
        return speaker

    def step(self, state: int, features: BlockFeatures, previous_lexeme: int) -> tuple[Array, int]:
        """The same scores for every block."""
        scores = np.full(self._size, -20.0)
        scores[self._best[state]] = 0.0
        return scores, state


class PreviousAndSpeaker:
    """The commonest successor of the previous lexeme for this speaker: what accuracy needs no ears."""

    def __init__(self, successors: NDArray[np.int64], size: int) -> None:
        """successors: [speakers, S]."""
        self._successors, self._size = successors, size

    def start(self, speaker: int, first_lexeme: int) -> int:
        """The state is the speaker."""
        return speaker

    def step(self, state: int, features: BlockFeatures, previous_lexeme: int) -> tuple[Array, int]:
        """One lexeme, by the table."""
        scores = np.full(self._size, -20.0)
        scores[self._successors[state, previous_lexeme]] = 0.0
        return scores, state


def successors(corpus: Corpus, labels: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """[speakers, S] the commonest next lexeme in the training split."""
    counts = np.zeros((len(corpus.statistics.speakers), size, size))
    for recording in corpus.recordings("train"):
        own = labels[corpus.blocks_of(recording)]
        np.add.at(counts[corpus.speaker_of[recording]], (own[:-1], own[1:]), 1)
    return counts.argmax(-1)


# ---------------------------------------------------------------------------------------------------- lexicon

def stroke_kinds(recording: Recording, edges: Array) -> NDArray[np.int64]:
    """For each block [N]: 1 when its middle lies in a stroke that training never showed, 0 in a known one, else -1."""
    kinds = np.full(len(edges) - 1, -1)
    middles = (edges[1:] + edges[:-1]) / 2
    for stroke in recording.truth.strokes if recording.truth else ():
        kinds[(middles >= stroke.start) & (middles < stroke.end)] = int(stroke.held_out)
    return kinds


@torch.no_grad()
def reconstructions(bundle: bundles.Bundle, motion: torch.Tensor) -> dict[str, NDArray[np.float32]]:
    """Squared error of each block [N] through the lexicon, for blocks [N, K, D_m]."""
    latents = bundle.drawn.lexicon.latents(motion)
    labels = bundle.lexicon.quantizer.labels(latents)
    one = int(np.mean([bundle.inventory.frequencies[name] for name in bundle.speakers], axis=0).argmax())
    codes = {"unquantised": latents, "quantised": bundle.lexicon.vectors[labels],
             "always the commonest lexeme": bundle.lexicon.vectors[torch.full_like(labels, one)]}
    return {name: ((torch.cat([bundle.lexicon.decode(part) for part in own.split(4096)]) - motion) ** 2
                   ).mean(dim=(1, 2)).numpy() for name, own in codes.items()}


def lexicon_table(bundle: bundles.Bundle, corpus: Corpus, recordings: Sequence[Recording],
                  take: tuple[Motion, Speech] | None) -> dict[str, Any]:
    """Use of the codes and errors of reconstruction on the test split, in normalised features squared.

    PCA with as many components as a lexeme is wide, and k-means with as many means as there are lexemes, both fitted
    on the training split, are what a linear method of the same size does. Blocks in strokes that training showed and
    in strokes that it did not are told apart. The real take is centred on its own mean pose, like every performer.
    """
    train, test = (torch.as_tensor(corpus.select(split)) for split in ("train", "test"))
    size, width = bundle.config.lexicon.size, bundle.config.lexicon.code_width
    known = corpus.motion[train].flatten(1).numpy().astype(np.float64)
    unknown = corpus.motion[test].flatten(1).numpy().astype(np.float64)
    few = known[np.random.default_rng(0).permutation(len(known))[:20_000]]
    linear = PCA(min(width, *few.shape), random_state=0).fit(few)
    means = KMeans(min(size, len(few)), n_init=3, random_state=0).fit(few)
    errors = {
        "PCA": ((linear.inverse_transform(linear.transform(unknown)) - unknown) ** 2).mean(1),
        "k-means": ((means.cluster_centers_[means.predict(unknown)] - unknown) ** 2).mean(1),
    }
    errors |= reconstructions(bundle, corpus.motion[test])
    own = corpus.recording[corpus.select("test")]
    clips = np.unique(own)
    kinds = np.concatenate([stroke_kinds(r, cut(r.speech, bundle.config.rhythm).edges) for r in recordings])
    for name, kind in (("quantised, strokes seen in training", 0), ("quantised, strokes never seen", 1)):
        errors[name] = np.where(kinds == kind, errors["quantised"], np.nan)
    table = {name: interval([np.nanmean(error[own == clip]) if np.isfinite(error[own == clip]).any() else np.nan
                             for clip in clips]).to_dict() for name, error in errors.items()}
    if take is not None:
        blocks = normalise_motion(take[0], cut(take[1], bundle.config.rhythm),
                                  representation_of(bundle.config))
        centred = (blocks - blocks.mean(axis=(0, 1))) / bundle.statistics.deviation
        for name, error in reconstructions(bundle, torch.as_tensor(centred, dtype=torch.float32)).items():
            table[f"real take (BEAT), {name}"] = interval([float(error.mean())]).to_dict()
    return {"errors": table, "variance": float(unknown.var(0).mean()),
            **lexicon_figures(bundle.drawn.lexicon, corpus.motion[test])}


# --------------------------------------------------------------------------------------------------- accuracy

def accuracy_table(bundle: bundles.Bundle, corpus: Corpus, hinted: NDArray[np.int64],
                   rows: dict[str, LexemeInterpreter]) -> dict[str, Any]:
    """Share of test blocks whose lexeme is the performer's (with the silent hint), teacher-forced and free-running.

    Both take the best score, under the silent mask. Percent; the interval is over recordings (one that reads text:
    over those with words).
    """
    table: dict[str, Any] = {}
    for name, system in rows.items():
        scores: dict[str, list[float]] = {"teacher_forced": [], "free_running": []}
        sizes = []
        for recording in corpus.recordings("test", isinstance(system, LstmInterpreter) and system.config.reads):
            own = corpus.blocks_of(recording)
            sizes.append(len(own) - 1)
            for kind, values in scores.items():
                made = likeliest(system, corpus, hinted, bundle.silent, recording, kind == "teacher_forced")
                values.append(lexeme_accuracy(made, hinted[own[1:]]).percent)
        table[name] = {kind: interval(values, sizes).to_dict() for kind, values in scores.items()}
    return table


@torch.inference_mode()
def likeliest(system: LexemeInterpreter, corpus: Corpus, hinted: NDArray[np.int64], silent: NDArray[np.int64],
              recording: int, teacher: bool) -> NDArray[np.int64]:
    """[n - 1] the best lexeme of each block of a recording but the first, which is given; under the silent mask.

    hinted: [N] the performer's, with the silent hint; teacher: that past is heard, and not the system's own.
    """
    own, reads = corpus.blocks_of(recording), isinstance(system, LstmInterpreter) and system.config.reads
    previous, chosen = int(hinted[own[0]]), []
    state = system.start(int(corpus.speaker_of[recording]), previous)
    for block in own[1:]:
        quiet = bool(corpus.silent[block])
        text = corpus.text(np.array([block]))[0] if reads else None
        heard = BlockFeatures(corpus.low[block].float(), corpus.high[block].float(), quiet, text)
        scores, state = system.step(state, heard, previous)
        chosen.append(select(scores, allowed=silent if quiet else None))
        previous = int(hinted[block]) if teacher else chosen[-1]
    return np.array(chosen, dtype=np.int64)


# ----------------------------------------------------------------------------------------------------- motion

@dataclass
class Clip:
    """What is measured on one clip of motion."""

    onsets: Array
    beats: Array
    duration: float
    hand_speed: Array
    silent: NDArray[np.bool_]
    heights: Array
    seam_speed: Array = field(default_factory=lambda: np.zeros(0))


def measure(motion: Motion, speech: Speech, edges: Array | None = None, onsets: Array | None = None) -> Clip:
    """Onsets, motion beats, speeds of both hands [T - 1, 2] in m/s, which of those frames lie in a settled silence.

    A frame is silent when the second before it was. Heights of the hands over the hips, metres. edges: block edges,
    for the hand speed across the seams. onsets: those of the speech, where they are known already.
    """
    faced = skeletons.facing(motion)
    positions = positions_of(faced)
    hands = positions[:, [motion.skeleton.index(name) for name in _HANDS]]
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1) * motion.fps
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    settled = np.convolve(quiet, np.ones(round(1 / SILENCE_FRAME)))[:len(quiet)] >= round(1 / SILENCE_FRAME) - 0.5
    at = np.minimum((np.arange(len(speed)) / motion.fps / SILENCE_FRAME).astype(int), len(settled) - 1)
    onsets = detect_onsets(speech.samples, speech.sample_rate) if onsets is None else onsets
    clip = Clip(onsets, motion_beats(motion), speech.duration, speed,
                settled[at], hands[..., 1] - positions[:, :1, 1])
    if edges is not None and len(speed):
        seams = np.clip(np.round(edges[1:-1] * motion.fps).astype(int), 1, len(speed) - 1)
        # Largest change of any joint's position within the two frames that meet at the beat.
        every = np.linalg.norm(np.diff(positions, axis=0), axis=-1).max(axis=1) * motion.fps
        clip.seam_speed = np.maximum(every[seams - 1], every[seams])
    return clip


def rhythm_row(clips: Sequence[Clip]) -> dict[str, Any]:
    """PMB with its chance level at three deltas, the share above chance, and the curve (all in percent)."""
    out: dict[str, Any] = {"motion_beats_per_second": interval([len(c.beats) / c.duration for c in clips]).to_dict()}
    for delta in (0.05, 0.1, 0.2):
        own = [pmb.pmb(c.beats, c.onsets, delta) for c in clips]
        chances = [pmb.chance(c.beats, c.onsets, c.duration, delta, seed=i) for i, c in enumerate(clips)]
        above = [100 * pmb.above_chance(a, b.mean) for a, b in zip(own, chances, strict=True)]
        out[f"{delta:g}"] = {"pmb": interval(own).to_dict(), "chance": interval([c.mean for c in chances]).to_dict(),
                             "above_chance": interval(above).to_dict(),
                             "clips_with_p_below_0.01": int(sum(c.p_value < 0.01 for c in chances))}
    curves = [pmb.delta_curve(c.beats, c.onsets) for c in clips]
    out["curve"] = {"deltas": curves[0].deltas.tolist(),
                    "percent": np.nanmean([c.percent for c in curves], axis=0).tolist()}
    return out


def motion_row(clips: Sequence[Clip]) -> dict[str, Any]:
    """Hand speeds in speech and in settled silence (m/s), percentiles, stillness, heights, seams."""
    def over(pick: Callable[[Clip], Array], reduce: Callable[[Array], float]) -> dict[str, float]:
        return interval([reduce(pick(c)) if pick(c).size else float("nan") for c in clips]).to_dict()

    speed = np.concatenate([c.hand_speed.ravel() for c in clips])
    seams = np.concatenate([c.seam_speed for c in clips])
    return {
        "speed_percentiles": dict(zip(("5", "25", "50", "75", "95", "99"),
                                      np.percentile(speed, [5, 25, 50, 75, 95, 99]).round(3).tolist(), strict=True)),
        "under_0.1": 100 * float((speed < 0.1).mean()),
        "speech_speed": over(lambda c: c.hand_speed[~c.silent], lambda v: float(v.mean())),
        "silence_speed": over(lambda c: c.hand_speed[c.silent], lambda v: float(v.mean())),
        "heights": np.percentile(np.concatenate([c.heights.ravel() for c in clips]), [5, 50, 95]).round(3).tolist(),
        "seam_speed_99": float(np.percentile(seams, 99)) if len(seams) else float("nan"),
    }


def play(system: Gesticulator, recordings: Sequence[Recording], interpreter: str | LexemeInterpreter,
         progress: bool, label: str, words: bool = False) -> list[Clip]:
    """A system's motion for the speech of recordings, in the habits of each one's performer; heard only, or read."""
    clips = []
    for recording in tqdm(recordings, desc=label, disable=not progress):
        speech = recording.speech if words else replace(recording.speech, words=None)
        made = system(speech, speaker=recording.info.speaker, interpreter=interpreter)
        clips.append(measure(made.motion, recording.speech, made.blocks.edges))
    return clips


def real_take() -> tuple[Motion, Speech] | None:
    """The real take that lies in GESTICULATOR_DATA, on our character at 60 fps; None without it."""
    place = os.environ.get("GESTICULATOR_DATA")
    folder = Path(place) / "takes" / "beat_scott" if place else None
    if folder is None or not folder.is_dir():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", bvh.BvhWarning)
        motion = bvh.read_bvh(next(iter(sorted(folder.glob("*.bvh")))), fps=REAL_FPS)
    return resample(skeletons.to_character(motion), FPS), load_speech(next(iter(sorted(folder.glob("*.wav")))))


def figures(store: Store, system: Gesticulator, work: Path, progress: bool = True) -> dict[str, Any]:
    """Every table, as plain values."""
    bundle = system.bundle
    corpus = prepare(store, bundle.config, work, bundle.encoder, workers=os.cpu_count() or 1, progress=progress)
    hinted = hinted_labels(bundle, corpus)
    size = bundle.config.lexicon.size
    deaf: dict[str, LexemeInterpreter] = {"statistical": bundle.statistical(), "commonest": Commonest(bundle)}
    by_table = PreviousAndSpeaker(successors(corpus, hinted, size), size)
    recordings = [store.load(corpus.names[r]) for r in corpus.recordings("test")]
    take = real_take()
    out: dict[str, Any] = {
        "store": {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(recordings),
                  "test_seconds": round(sum(r.speech.duration for r in recordings), 1)},
        "lexicon": lexicon_table(bundle, corpus, recordings, take),
        "rhythm": {}, "motion": {},
    }
    rows: dict[str, list[Clip]] = {"performer": [
        measure(r.motion, r.speech, cut(r.speech, bundle.config.rhythm).edges) for r in recordings]}
    rows["lstm"] = play(system, recordings, "lstm", progress, "lstm")
    read = {}
    if bundle.interpreter_text is not None:
        rows["lstm with text"] = play(system, recordings, "lstm", progress, "lstm with text", words=True)
        read["lstm with text"] = bundle.interpreter_text
    for name, interpreter in deaf.items():
        rows[name] = play(system, recordings, interpreter, progress, name)
    out["accuracy"] = accuracy_table(bundle, corpus, hinted, {
        "lstm": bundle.drawn.interpreter, **read, "previous lexeme and speaker": by_table, **deaf})
    if take is not None:
        motion, speech = take
        made = system(speech)
        rows["real take (BEAT)"] = [measure(motion, speech, made.blocks.edges)]
        rows["lstm on the real take's voice"] = [measure(made.motion, speech, made.blocks.edges)]
    for name, clips in rows.items():
        out["rhythm"][name], out["motion"][name] = rhythm_row(clips), motion_row(clips)
    return out


def _cell(value: dict[str, float], digits: int = 1) -> str:
    return f"{value['mean']:.{digits}f} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def markdown(result: dict[str, Any]) -> str:
    """The tables of `figures` for a reader."""
    lexicon = result["lexicon"]
    lines = [f"Test split: {result['store']['test_recordings']} recordings, {result['store']['test_seconds']:.0f} s. "
             "Means over recordings with bootstrap 95 % intervals.", "",
             "| reconstruction (normalised features squared) | error |", "|---|---|"]
    lines += [f"| {name} | {_cell(value, 3)} |" for name, value in lexicon["errors"].items()]
    lines += ["", f"Lexemes used on the test split: {100 * lexicon['usage']:.0f} %; perplexity "
              f"{lexicon['perplexity']:.1f}.", "",
              "| lexeme accuracy, % | teacher-forced | free-running |", "|---|---|---|"]
    lines += [f"| {name} | {_cell(row['teacher_forced'])} | {_cell(row['free_running'])} |"
              for name, row in result["accuracy"].items()]
    lines += ["", "| in time with the voice | beats/s | PMB at 0.1 s | chance | above chance, % | at 0.05 / 0.2 s |",
              "|---|---|---|---|---|---|"]
    lines += [f"| {name} | {row['motion_beats_per_second']['mean']:.2f} | {_cell(row['0.1']['pmb'])} | "
              f"{row['0.1']['chance']['mean']:.1f} | {_cell(row['0.1']['above_chance'])} | "
              f"{row['0.05']['pmb']['mean']:.1f} / {row['0.2']['pmb']['mean']:.1f} |"
              for name, row in result["rhythm"].items()]
    lines += ["", "| hands | speed 5/25/50/75/95/99 %, m/s | under 0.1 m/s | in speech | in silence | "
              "height over hips 5/50/95 %, m | seam speed 99 % |", "|---|---|---|---|---|---|---|"]
    lines += [f"| {name} | {' / '.join(f'{v:.2f}' for v in row['speed_percentiles'].values())} | "
              f"{row['under_0.1']:.0f} % | {_cell(row['speech_speed'], 2)} | {_cell(row['silence_speed'], 3)} | "
              f"{' / '.join(f'{v:.2f}' for v in row['heights'])} | {row['seam_speed_99']:.2f} |"
              for name, row in result["motion"].items()]
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.figures", description="The figures of the README, on a store's test split.")
    p.add_argument("--data", required=True, metavar="STORE")
    p.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    p.add_argument("--work", metavar="DIR", help="where blocks are cached (default: STORE.work)")
    p.add_argument("--out", default="docs/results/figures.json", metavar="FILE.json", help="a .md is written beside it")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.figures"):
        torch.set_num_threads(1)
        store = Store.open(arguments.data)
        system = Gesticulator.from_pretrained(arguments.bundle)
        work = Path(arguments.work) if arguments.work else Path(str(store.path) + ".work")
        if not any(info.split == "test" for info in store.recordings):
            raise InputError(store.path, "has no test split", "build the store again")
        result = figures(store, system, work)
        publish(result, markdown(result), arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
