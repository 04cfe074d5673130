"""How good is a bundle on the test split: its lexicon, its interpreters, its rhythm, its hands, each beside baselines.

Each table has the rows that a reader asks for: the performer (the rule that made the corpus), the systems, always the
speaker's most frequent lexeme, and, where GESTICULATOR_DATA is set, a real take of a person speaking.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA
from tqdm import tqdm

from data_module.blocks import cut, normalise_motion
from data_module.store import Recording
from data_module.types import Array, Motion, Speech
from eval import stats
from eval.baselines import Bigram, Majority
from eval.clip import ClipMeasurement, measure, real_take
from eval.context import EvalContext
from eval.metrics import pmb
from eval.policy import Decisions, accuracy
from eval.table import Cell, Column, Table
from gesticulator import bundle as bundles
from gesticulator.features import representation_of
from gesticulator.pipeline import FPS, Gesticulator
from gesticulator.stages.lexicon import lexicon_figures
from gesticulator.stages.q_network import takes_of
from interpreters.base import LexemeInterpreter
from interpreters.lstm import LstmInterpreter

FIT_BLOCKS = 20_000
"""Blocks that PCA and k-means are fitted on: more changes their errors in the third digit."""
DELTAS = (0.05, 0.1, 0.2)
"""Seconds: the tolerances that are shown; the papers print the last."""
QUANTILES = (5, 25, 50, 75, 95, 99)
"""Percentiles of hand speed."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store and a bundle."""
    EvalContext.arguments(parser)


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """All four tables."""
    return quality(EvalContext.of(arguments))


def quality(context: EvalContext) -> list[Table]:
    """Lexicon, accuracy, rhythm and hands."""
    bundle, recordings, take = context.bundle, context.recordings(), real_take(FPS)
    baselines: dict[str, LexemeInterpreter] = {"statistical": bundle.statistical(), "majority": Majority(bundle)}
    clips: dict[str, list[ClipMeasurement]] = {"performer": [
        measure(one.motion, one.speech, cut(one.speech, bundle.config.rhythm).edges) for one in recordings]}
    clips["lstm"] = play(context.system, recordings, "lstm", context.progress)
    read = {}
    if bundle.interpreter_text is not None:
        clips["lstm with text"] = play(context.system, recordings, "lstm", context.progress, words=True)
        read["lstm with text"] = bundle.interpreter_text
    for name, interpreter in baselines.items():
        clips[name] = play(context.system, recordings, interpreter, context.progress)
    if take is not None:
        motion, speech = take
        made = context.system(speech)
        clips["real take (BEAT)"] = [measure(motion, speech, made.blocks.edges)]
        clips["lstm on the real take's voice"] = [measure(made.motion, speech, made.blocks.edges)]
    bigram = Bigram.fitted(context.corpus, context.labels, bundle.config.lexicon.size)
    seconds = sum(one.speech.duration for one in recordings)
    lexicon = lexicon_table(context, recordings, take)
    interpreters: dict[str, LexemeInterpreter] = {
        "lstm": bundle.block_models.interpreter, **read, "previous lexeme and speaker": bigram, **baselines}
    return [replace(lexicon, facts={**lexicon.facts, **context.described(), "seconds": seconds}),
            accuracy_table(context, interpreters), rhythm_table(clips), hands_table(clips)]


def play(system: Gesticulator, recordings: Sequence[Recording], interpreter: str | LexemeInterpreter, progress: bool,
         words: bool = False) -> list[ClipMeasurement]:
    """A system's motion for the speech of recordings, in the habits of each one's performer; words: read too."""
    clips = []
    for recording in tqdm(recordings, desc="clips", disable=not progress):
        speech = recording.speech if words else replace(recording.speech, words=None)
        made = system(speech, speaker=recording.info.speaker, interpreter=interpreter)
        clips.append(measure(made.motion, recording.speech, made.blocks.edges))
    return clips


# ------------------------------------------------------------------------------------------------------------ lexicon

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
    latents = bundle.block_models.lexicon.latents(motion)
    labels = bundle.lexicon.quantizer.labels(latents)
    one = int(bundle.frequencies.mean(axis=0).argmax())
    codes = {"unquantised": latents, "quantised": bundle.vectors[labels],
             "always the most frequent lexeme": bundle.vectors[torch.full_like(labels, one)]}
    return {name: ((torch.cat([bundle.lexicon.decode(part) for part in own.split(4096)]) - motion) ** 2
                   ).mean(dim=(1, 2)).numpy() for name, own in codes.items()}


def lexicon_table(context: EvalContext, recordings: Sequence[Recording], take: tuple[Motion, Speech] | None) -> Table:
    """Use of the codes and errors of reconstruction on the test split, in normalised features squared.

    PCA with as many components as a lexeme is wide, and k-means with as many means as there are lexemes, both fitted
    on the training split, are what a linear method of the same size does. Blocks in strokes that training showed and
    in strokes that it did not are told apart. The real take is centred on its own mean pose, like every performer.
    """
    bundle, corpus = context.bundle, context.corpus
    train = torch.as_tensor(corpus.select("train"))
    test = torch.as_tensor(np.concatenate([corpus.blocks_of(number) for number in context.numbers()]))
    size, width = bundle.config.lexicon.size, bundle.config.lexicon.code_width
    known, unknown = (corpus.motion[part].flatten(1).numpy().astype(np.float64) for part in (train, test))
    few = known[np.random.default_rng(0).permutation(len(known))[:FIT_BLOCKS]]
    linear = PCA(min(width, *few.shape), random_state=0).fit(few)
    means = KMeans(min(size, len(few)), n_init=3, random_state=0).fit(few)
    errors = {"PCA": ((linear.inverse_transform(linear.transform(unknown)) - unknown) ** 2).mean(1),
              "k-means": ((means.cluster_centers_[means.predict(unknown)] - unknown) ** 2).mean(1),
              **reconstructions(bundle, corpus.motion[test])}
    kinds = np.concatenate([stroke_kinds(one, cut(one.speech, bundle.config.rhythm).edges) for one in recordings])
    for name, kind in (("quantised, strokes seen in training", 0), ("quantised, strokes never seen", 1)):
        errors[name] = np.where(kinds == kind, errors["quantised"], np.nan)
    owner = corpus.recording[test.numpy()]
    body: dict[str, dict[str, Cell]] = {name: {"error": stats.mean_interval([
        np.nanmean(error[owner == clip]) if np.isfinite(error[owner == clip]).any() else np.nan
        for clip in np.unique(owner)])} for name, error in errors.items()}
    if take is not None:
        blocks = normalise_motion(take[0], cut(take[1], bundle.config.rhythm), representation_of(bundle.config))
        centred = (blocks - blocks.mean(axis=(0, 1))) / bundle.statistics.deviation
        for name, error in reconstructions(bundle, torch.as_tensor(centred, dtype=torch.float32)).items():
            body[f"real take (BEAT), {name}"] = {"error": float(error.mean())}
    used = lexicon_figures(bundle.block_models.lexicon, corpus.motion[test])
    return Table("Reconstruction", {"error": Column("error, normalised features squared", digits=3, good="low")}, body,
                 "through", [f"Lexemes used on the test split: {100 * used['usage']:.0f} %; perplexity "
                             f"{used['perplexity']:.1f}. Variance of the features: {unknown.var(0).mean():.3f}. Means "
                             "over recordings with bootstrap 95 % intervals."],
                 {**used, "variance": float(unknown.var(0).mean())})


# ----------------------------------------------------------------------------------------------------------- accuracy

def accuracy_table(context: EvalContext, rows: Mapping[str, LexemeInterpreter]) -> Table:
    """Share of test blocks whose lexeme is the performer's (with the silent hint), teacher-forced and free-running.

    Both take the best score, under the silent mask. The interval is over recordings (one that reads text: over those
    with words).
    """
    columns = {"teacher_forced": Column("teacher-forced", "%", 1), "free_running": Column("free-running", "%", 1)}
    takes = takes_of(context.corpus, context.labels, "test")
    body: dict[str, dict[str, Cell]] = {}
    for name, interpreter in rows.items():
        reads = isinstance(interpreter, LstmInterpreter) and interpreter.config.reads
        wanted = set(context.numbers(with_text=reads))
        decisions = Decisions(context.corpus, [take for take in takes if take.recording in wanted],
                              context.bundle.silent, True, len(context.bundle.vectors))
        body[name] = {kind: stats.mean_interval(
            [accuracy(interpreter, decisions, take, kind == "teacher_forced") for take in decisions.takes],
            [len(take.blocks) - 1 for take in decisions.takes]) for kind in columns}
    return Table("Lexeme accuracy", columns, body, "interpreter")


# ------------------------------------------------------------------------------------------------------------- motion

def rhythm_table(rows: Mapping[str, Sequence[ClipMeasurement]]) -> Table:
    """PMB with its chance level and the share above it at three deltas; the curve over delta in the facts."""
    columns = {"rate": Column("motion beats", "1/s")}
    for delta in DELTAS:
        columns |= {f"pmb {delta:g}": Column(f"PMB at {delta:g} s", "%", 1, "high"),
                    f"chance {delta:g}": Column("chance", "%", 1),
                    f"above {delta:g}": Column("above chance", "%", 1, "high")}
    body: dict[str, dict[str, Cell]] = {}
    curves, sure = {}, {}
    for name, clips in rows.items():
        body[name] = {"rate": stats.mean_interval([clip.beats_per_second for clip in clips])}
        for delta in DELTAS:
            found = [clip.rhythm(delta, seed=k) for k, clip in enumerate(clips)]
            body[name] |= {f"pmb {delta:g}": stats.mean_interval([one.pmb for one in found]),
                           f"chance {delta:g}": stats.mean_interval([one.chance for one in found]),
                           f"above {delta:g}": stats.mean_interval([one.above_chance for one in found])}
            sure[f"{name}, {delta:g}"] = sum(one.p_value < 0.01 for one in found)
        curves[name] = np.nanmean([pmb.delta_curve(clip.beats, clip.onsets).percent for clip in clips], axis=0).tolist()
    return Table("In time with the voice", columns, body, "motion", facts={
        "deltas": list(pmb.DELTAS), "curves": curves, "clips_with_p_below_0.01": sure})


def hands_table(rows: Mapping[str, Sequence[ClipMeasurement]]) -> Table:
    """Hand speeds in speech and in settled silence, percentiles, stillness, heights, speed across the seams."""
    columns = {f"speed {level}": Column(f"speed, {level} %", "m/s", 2, "near") for level in QUANTILES}
    columns |= {"still": Column("under 0.1 m/s", "%", 0, "near"), "speech": Column("in speech", "m/s", 2, "near"),
                "silence": Column("in silence", "m/s", 3, "near"),
                **{f"height {level}": Column(f"height over hips, {level} %", "m", 2, "near") for level in (5, 50, 95)},
                "seam": Column("seam speed, 99 %", "m/s", 2, "near")}
    body: dict[str, dict[str, Cell]] = {}

    def over(clips: Sequence[ClipMeasurement], of: Callable[[ClipMeasurement], float]) -> stats.Interval:
        return stats.mean_interval([of(clip) for clip in clips])

    for name, clips in rows.items():
        speed, heights, seams = (np.concatenate([getattr(clip, key).ravel() for clip in clips])
                                 for key in ("hand_speed", "heights", "seam_speed"))
        body[name] = {f"speed {level}": float(np.percentile(speed, level)) for level in QUANTILES}
        body[name] |= {"still": 100 * float((speed < 0.1).mean()), "speech": over(clips, lambda c: c.speech_speed),
                       "silence": over(clips, lambda c: c.silence_speed),
                       **{f"height {level}": float(np.percentile(heights, level)) for level in (5, 50, 95)},
                       "seam": float(np.percentile(seams, 99)) if len(seams) else None}
    return Table("Hands", columns, body, "motion")
