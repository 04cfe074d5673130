"""The papers' figures, drawn from what the rows of an ablation left behind (see `eval.ablate.command`).

A figure is FIGURE.svg or FIGURE.png in the folder of the cells. The motion that it shows is of the first seed and,
where one clip is shown, of the first test recording, whatever it looks like.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from data_module.blocks import cut
from data_module.controls import FEATURES, LEVELS, Controls, measure
from data_module.errors import InputError
from data_module.motion.motion_beats import acting_positions, acting_speed, motion_beats
from data_module.speech.beats import find_beats
from data_module.speech.onsets import detect_onsets
from data_module.store import Recording
from data_module.types import Array
from eval.ablate.rows import COLUMNS, OURS, PERFORMER, REAL_TAKE, ROWS, TABLES
from eval.ablate.run import SHOWN_SEED, RgRows, configured
from eval.clip.excerpts import evenly
from eval.metrics import audio_clusters, pmb
from eval.metrics.encode import EncodedMotion, latents_of
from eval.metrics.evaluate import WIDE
from eval.pictures import intervals, plots
from eval.pictures.canvas import STYLE
from eval.pictures.embedding import embed, embedding_panels, joint_embedding, neighbours_agree
from eval.pictures.strips import PAGE, Source, draw_page, save_strip
from gesticulator.gesticulator import Gesticulator
from gesticulator.options import FPS, HAND_UNITS
from gesticulator.training.stages import LABELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

POINTS = 3000
"""Blocks in the picture of the lexicon."""
EACH = 500
"""Blocks of each row in a joint picture."""
COUNTED = 24
"""Training recordings whose intervals are counted."""
STRETCH = 8.0
"""Seconds of a clip that are shown."""
Summaries = Mapping[str, Any]
"""`eval.ablate.cells.summaries`."""
Draw = Callable[[RgRows, Summaries], "Picture"]


def shown_recording(rg: RgRows) -> Recording:
    """The test recording that figures of one clip show: the first."""
    return rg.recording(rg.names("test")[0])


def encoded(rg: RgRows, name: str) -> list[EncodedMotion]:
    """Latents and nearest lexemes of the motion of a row or of the performer, clip by clip, by the lexicon of ours."""
    return [clip for clip in rg.scored(rg.names("test")).encoded(rg.motions(name)) if clip is not None]


def start_of(recording: Recording) -> float:
    """Where the stretch that is shown begins, seconds: a third into the recording, or earlier in a short one."""
    return max(0.0, min(recording.speech.duration / 3, recording.speech.duration - STRETCH))


# -------------------------------------------------------------------------------------------------------- the pictures

def onset_intervals(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 5 and 8a."""
    store = rg.context.store
    infos = evenly(store, "train", COUNTED)
    counted = np.sum([intervals.measure(store.load(info.name).speech) for info in infos], axis=0)
    within = intervals.within_bounds(counted[0])
    return plots.interval_bars(counted, f"{store.corpus}, {len(infos)} recordings: {within}")


def lexicon(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 6 and 8b."""
    judge, labelled, corpus = rg.judge.block_lexicon, rg.first.get(LABELS), rg.context.corpus
    few = np.sort(np.random.default_rng(0).permutation(corpus.select("train"))[:POINTS])
    at = torch.as_tensor(few)
    latents = latents_of(judge, corpus.motion[at], corpus.pasts[at]).double().numpy()
    labels = np.asarray(labelled.labels)[few]
    flat = embed(latents)
    # A t-SNE bends distances: how much of the neighbourhood survives says what the picture can be read for.
    shown, true = neighbours_agree(flat, labels), neighbours_agree(latents, labels)
    title = f"neighbours with the lexeme: {100 * shown:.0f} %, in latent space {100 * true:.0f} %"
    return embedding_panels({title: (flat, labels)}, len(judge.vectors), labelled.silent.tolist())


def pipeline(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 2, on a stretch of real data."""
    recording, motion = shown_recording(rg), rg.motions(OURS)[0]
    rhythm = rg.first.config.rhythm
    shown = plots.Overview(recording.speech, find_beats(recording.speech, rhythm.beats),
                           cut(recording.speech, rhythm).edges, encoded(rg, OURS)[0].labels,
                           acting_speed(acting_positions(motion), motion.fps), motion.fps, motion_beats(motion),
                           recording.speech.words or (), rg.first.get(LABELS).silent.tolist())
    return plots.overview(shown, start_of(recording), STRETCH)


def strip(name: str) -> Draw:
    """RG Fig. 9, of a row or of the performer."""
    def drawn(rg: RgRows, rows: Summaries) -> Picture:
        recording, motion = shown_recording(rg), rg.motions(name)[0]
        # Nine figures over four seconds: close enough to see a stroke, few enough to tell them apart.
        start = start_of(recording)
        times = np.linspace(start, min(start + STRETCH / 2, (len(motion) - 1) / motion.fps), 9)
        return draw_page([Source(f"{name}, {recording.info.name}", motion)], times, recording.speech,
                         find_beats(recording.speech), layout=replace(PAGE, views=("front",)))

    return drawn


def style_editing(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 10, its last column: a feature of the hands at three levels that are asked for throughout a recording."""
    bundle = rg.trained("style-editing", SHOWN_SEED)[0]
    system, levels, recording = Gesticulator(bundle), bundle.levels, shown_recording(rg)
    assert levels is not None, "the row trains with controls"

    def measured(feature: str, target: float) -> tuple[float, Array]:
        # The same seed at every level: only the request differs.
        motion = system(recording.speech, speaker=recording.info.speaker, seed=SHOWN_SEED,
                        controls=Controls(**{feature: target})).motion
        return target, measure(motion)[:, FEATURES.index(feature)]

    return plots.editing_panels({f"{feature}, {HAND_UNITS[feature]}": {
        level: measured(feature, levels.value(feature, level)) for level in LEVELS} for feature in FEATURES}, FPS)


def curves(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 11."""
    beside = [PERFORMER, REAL_TAKE, "shuffled"]
    names = [*(line.row for line in TABLES["RG Table 1"].lines), *beside]
    shown = {name: rows[name]["pmb_curve"] for name in names if name in rows}
    return plots.delta_curves(shown, pmb.DELTAS, dashed=beside)


def clusters(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 14, of the blocks in which something is said."""
    corpus, frames = rg.context.corpus, rg.first.config.rhythm.frames
    blocks = [corpus.blocks_of(corpus.names.index(name)) for name in rg.names("test")]
    spoken = [~np.asarray(corpus.silent)[numbers].astype(bool) for numbers in blocks]
    every = np.concatenate(blocks)[np.concatenate(spoken)]
    # Features hold the block before and the one after it too; the block itself is the middle third.
    levels = {f"{kind} level": audio_clusters.cluster(
        features[every][:, frames:2 * frames].float().mean(dim=1).numpy())
        for kind, features in (("low", corpus.low), ("high", corpus.high))}
    return plots.cluster_bars({name: audio_clusters.association(levels, [
        clip.labels[voiced] for clip, voiced in zip(encoded(rg, name), spoken, strict=True)])
        for name in (PERFORMER, OURS)})


def panels(*names: str) -> Draw:
    """RG Figs 15 and 17: the latents of rows in one embedding."""
    def drawn(rg: RgRows, rows: Summaries) -> Picture:
        clips = {name: encoded(rg, name) for name in names}
        latents = {name: np.concatenate([clip.latents.double().numpy() for clip in of]) for name, of in clips.items()}
        shown = {name: (points, np.concatenate([clip.labels for clip in clips[name]])[chosen])
                 for name, (points, chosen) in joint_embedding(latents, EACH).items()}
        return embedding_panels(shown, len(rg.judge.lexicon.vectors), rg.first.get(LABELS).silent.tolist())

    return drawn


def strips_of_beats(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 16."""
    recording = shown_recording(rg)
    onsets = detect_onsets(recording.speech.samples, recording.speech.sample_rate)
    shown = {}
    for name in (*_RANGES, PERFORMER):
        rhythm = configured(rg.first.config, OURS if name == PERFORMER else name).rhythm
        shown[name] = (motion_beats(rg.motions(name)[0]), onsets, cut(recording.speech, rhythm).edges)
    return plots.beat_strips(shown, start_of(recording), STRETCH, WIDE)


def sizes(rg: RgRows, rows: Summaries) -> Picture:
    """RG Fig. 18."""
    there = [int(name.removeprefix("size-")) for name in ROWS if name.startswith("size-") and name in rows]
    if len(there) < 2:
        raise InputError("figure-18", "needs two sizes", "run the rows size-N")
    keys = {COLUMNS[key].heading: key for key in ("fgd", "pmb_above_chance")}
    bounds = {title: [(value.mean, value.low, value.high) for size in there
                      for value in [rows[f"size-{size}"]["figures"][key]]] for title, key in keys.items()}
    beside = rows.get(f"{PERFORMER}-val")
    reference = {title: beside["figures"][key].mean for title, key in keys.items()} if beside else {}
    return plots.size_sweep(there, bounds, reference, rg.first.config.lexicon.size)


# ------------------------------------------------------------------------------------------------------------ the list

@dataclass(frozen=True)
class PaperFigure:
    """A figure: how it is drawn, the rows that it is drawn from; dots: as PNG."""

    draw: Draw
    rows: tuple[str, ...] = ()
    dots: bool = False


_STEPS = (PERFORMER, "no-audio-no-style", "no-style", "random-style", OURS)
_LEXEMES = (PERFORMER, "no-lexemes", OURS)
_RANGES = tuple(line.row for line in TABLES["RG Table 4"].lines)
FIGURES: dict[str, PaperFigure] = {
    "figure-2": PaperFigure(pipeline, (OURS,)),
    "figure-5": PaperFigure(onset_intervals), "figure-6": PaperFigure(lexicon, dots=True),
    "figure-9-performer": PaperFigure(strip(PERFORMER), (PERFORMER,), dots=True),
    "figure-9-ours": PaperFigure(strip(OURS), (OURS,), dots=True),
    "figure-10": PaperFigure(style_editing, ("style-editing",)),
    "figure-11": PaperFigure(curves), "figure-14": PaperFigure(clusters, (PERFORMER, OURS)),
    "figure-15": PaperFigure(panels(*_STEPS), _STEPS, dots=True),
    "figure-16": PaperFigure(strips_of_beats, (*_RANGES, PERFORMER)),
    "figure-17": PaperFigure(panels(*_LEXEMES), _LEXEMES, dots=True),
    "figure-18": PaperFigure(sizes),
}


def draw(rg: RgRows, name: str, rows: Summaries, out: Path) -> str:
    """Write a figure to a folder; why it cannot be drawn, or ""."""
    figure = FIGURES[name]
    lacking = [row for row in figure.rows if row not in rows]
    if lacking:
        return f"not run: {', '.join(lacking)}"
    # A figure that cannot be drawn is named in the tables, and the others are drawn all the same.
    try:
        from matplotlib import rc_context

        with rc_context(STYLE):
            save_strip(figure.draw(rg, rows), out / f"{name}.{'png' if figure.dots else 'svg'}")
    except (ImportError, InputError) as error:
        return str(error)
    return ""
