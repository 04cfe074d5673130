"""The papers' figures, drawn from what the rows of an ablation left behind (see `eval.ablate`).

A figure is FIGURE.svg or FIGURE.png in the folder of the cells, with FIGURE.json beside it: which figure of the paper
it is, its title, caption and numbers. It is drawn again when what it is drawn from has another key. What it shows of
motion is of the first seed and, where one clip is shown, of the first test recording, whatever it looks like.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module import intervals
from data_module.blocks import cut
from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion.bvh import read_bvh
from data_module.motion.motion_beats import acting_positions, acting_speed
from data_module.speech.beats import find_beats
from data_module.store import Recording
from data_module.types import Array
from eval import audio_clusters, style_editing
from eval.ablation_bench import Bench
from eval.ablation_cells import SHOWN_SEED, bundle_of, kept
from eval.ablation_tables import PAPERS_DELTA, finished
from eval.ablations import OURS, PERFORMER, REAL_TAKE, SIZES, TABLES
from eval.draw.lexicon_map import NEIGHBOURS, draw_latents, embed, evenly, neighbours_agree
from eval.draw.plots import (
    beat_strips,
    cluster_bars,
    delta_curves,
    embedding_panels,
    joint_embedding,
    overview,
    size_sweep,
)
from eval.draw.strips import draw_strip, frame_times, save_strip
from eval.metrics import pmb
from eval.results import dumped
from gesticulator import config as configs
from gesticulator.pipeline import Gesticulator

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

VERSION = 1
"""Raised when the same rows would be drawn otherwise."""
POINTS = 3000
"""Blocks in the picture of the lexicon."""
EACH = 500
"""Blocks of each row in a joint picture."""
HEARD = 24
"""Training recordings whose intervals are counted."""
STRETCH = 8.0
"""Seconds of a clip that are shown."""

Labels = NDArray[np.int64]
Drawn = tuple["Picture", str, dict[str, Any]]
"""The picture, its caption, its numbers."""


@dataclass
class Ground:
    """What figures are drawn from: the bench, and the rows of the tables."""

    bench: Bench
    rows: Mapping[str, Any]

    def seen(self, name: str) -> list[dict[str, NDArray[Any]]]:
        """What was kept of a row's motion, clip by clip."""
        return kept(self.bench, name).read()

    @cached_property
    def first(self) -> Recording:
        """The first test recording."""
        return self.bench.loaded(self.bench.recordings("test")[0])

    def labels(self, latents: Array) -> Labels:
        """[N] the lexeme nearest to each latent [N, D], by the judging lexicon."""
        vectors = self.bench.judge[0].vectors.double().numpy()
        nearest = np.argmin(np.square(latents).sum(1)[:, None] - 2 * latents @ vectors.T + np.square(vectors).sum(1), 1)
        return np.asarray(nearest, dtype=np.int64)

    @property
    def start(self) -> float:
        """Where the stretch that is shown begins: a third into the recording, or earlier in a short one."""
        return max(0.0, min(self.first.speech.duration / 3, self.first.speech.duration - STRETCH))


# -------------------------------------------------------------------------------------------------------- the pictures

def onset_intervals(ground: Ground) -> Drawn:
    """RG Fig. 5 and 8a."""
    store = ground.bench.first.store
    infos = evenly(store, "train", HEARD)
    found = sum((intervals.measure(store.load(info.name).speech)[1] for info in infos), intervals.Intervals())
    bounds = ground.bench.first.config.rhythm.beats
    share = found.share(bounds.d_min, bounds.d_max)
    return intervals.drawn(found, f"{store.corpus}, {len(infos)} recordings"), (
        f"Intervals between onsets of the speech, and between beats; {share:.0%} of the former lie between "
        f"{bounds.d_min:g} and {bounds.d_max:g} s."), {"recordings": len(infos), "share_within_bounds": share}


def lexicon(ground: Ground) -> Drawn:
    """RG Fig. 6 and 8b."""
    (judge, labelled), corpus = ground.bench.judge, ground.bench.first.corpus
    own = np.flatnonzero(corpus.select("train")) if corpus.select("train").dtype == bool else corpus.select("train")
    few = np.sort(np.random.default_rng(0).permutation(own)[:POINTS])
    latents = judge.latents(corpus.motion[few]).double().numpy()
    labels = np.asarray(labelled.labels)[few]
    flat = embed(latents)
    shown, true = neighbours_agree(flat, labels), neighbours_agree(latents, labels)
    caption = (f"E(M) of {len(few)} blocks by t-SNE, coloured by lexeme, silent ones crossed. {100 * shown:.0f} % of "
               f"the {NEIGHBOURS} nearest neighbours share the lexeme, {100 * true:.0f} % in latent space.")
    return draw_latents(flat, labels, labelled.silent.tolist(), len(judge.vectors), ""), caption, {
        "blocks": len(few), "lexemes_used": len(np.unique(labels)), "neighbours_in_picture": shown,
        "neighbours_in_latents": true}


def pipeline(ground: Ground) -> Drawn:
    """RG Fig. 2, on a stretch of real data."""
    recording, seen = ground.first, ground.seen(OURS)[0]
    motion = read_bvh(kept(ground.bench, OURS).folder / f"{recording.info.name}.bvh")
    blocks = cut(recording.speech, ground.bench.first.config.rhythm)
    beats = find_beats(recording.speech, ground.bench.first.config.rhythm.beats)
    picture = overview(recording.speech, beats, blocks.edges, seen["lexemes"],
                       acting_speed(acting_positions(motion), motion.fps), motion.fps, ground.start, STRETCH,
                       recording.speech.words or (), silent=ground.bench.judge[1].silent.tolist(),
                       motion_beats=seen["beats"])
    return picture, "Speech is cut at its beats; each block gets a lexeme; the generator draws the motion.", {}


def strip(name: str) -> Callable[[Ground], Drawn]:
    """RG Fig. 9, of a row or of the performer."""
    def drawn(ground: Ground) -> Drawn:
        recording = ground.first
        motion = (recording.motion if name == PERFORMER
                  else read_bvh(kept(ground.bench, name).folder / f"{recording.info.name}.bvh"))
        times = frame_times(motion, ground.start, STRETCH / 2, 9)
        return draw_strip(motion, times, ("front",), recording.speech, find_beats(recording.speech)), (
            f"{name}: {STRETCH / 2:g} s of {recording.info.name}."), {}

    return drawn


def edited(ground: Ground) -> Drawn:
    """RG Fig. 10."""
    bench = ground.bench
    bundle, _, _ = bundle_of(bench, "style-editing", SHOWN_SEED)
    if bundle.levels is None:
        raise InputError("style-editing", "hears no controls", "leave generator.use_control as the row sets it")
    found = style_editing.figures(style_editing.played_by(Gesticulator(bundle)),
                                  style_editing.excerpts(bench.first.store, 4), bundle.levels)
    numbers = {f"{feature}, asked {level}": row["mean"] for feature in style_editing.FEATURES
               for level in style_editing.LEVELS
               for row in [found["rows"][style_editing.row_name(feature, level)][feature]]}
    return style_editing.figure_10(found), (
        "Motion for the same speech when low, middle and high values of each feature are asked for."), numbers


def curves(ground: Ground) -> Drawn:
    """RG Fig. 11."""
    names = [line.row for line in TABLES["RG Table 1"].lines if line.row in ground.rows]
    beside = [name for name in (REAL_TAKE, "shuffled") if name in ground.rows]
    shown = {name: ground.rows[name]["pmb_curve"] for name in (*names, *beside)}
    return delta_curves(shown, pmb.DELTAS, dashed=(PERFORMER, *beside)), (
        "PMB over the distance delta at which a motion beat counts as matched; shuffled motion shows how much of it is "
        "chance."), {name: dict(zip(map(str, pmb.DELTAS), curve, strict=True)) for name, curve in shown.items()}


def clusters(ground: Ground) -> Drawn:
    """RG Fig. 14."""
    bench, corpus, frames = ground.bench, ground.bench.first.corpus, ground.bench.first.config.rhythm.frames
    groups = np.unique(bench.groups("test"), return_inverse=True)[1]
    own = [np.asarray(corpus.blocks_of(number)) for number in bench.recordings("test")]
    spoken = [~np.asarray(corpus.silent)[blocks].astype(bool) for blocks in own]
    every = np.concatenate([blocks[kept] for blocks, kept in zip(own, spoken, strict=True)])
    place = np.repeat(np.arange(len(own)), [int(kept.sum()) for kept in spoken])
    found = {f"{kind} level": audio_clusters.cluster(
        features[every][:, frames:2 * frames].float().mean(dim=1).numpy())
        for kind, features in (("low", corpus.low), ("high", corpus.high))}
    told = {}
    for name in (PERFORMER, OURS):
        lexemes = [ground.labels(clip["latents"])[kept] for clip, kept in zip(ground.seen(name), spoken, strict=True)]
        told[name] = audio_clusters.association(found, np.concatenate(lexemes), place, groups[place])
    return cluster_bars(told), (
        "H(lexeme of the motion | cluster of the audio), less than by chance where the level says something of the "
        "lexeme. The paper's claim is that the high level says more than the low one."), {
        f"{name}, {what}": value for name, own_told in told.items() for what, value in (
            *((f"{level}, gain in nats", own_told[level]["gain"]["mean"]) for level in found),
            *((f"{pair}, difference of gains", one["mean"]) for pair, one in own_told["gain_differences"].items()))}


def panels(title: str, *names: str) -> Callable[[Ground], Drawn]:
    """RG Figs 15 and 17: the latents of rows in one embedding."""
    def drawn(ground: Ground) -> Drawn:
        seen = {name: ground.seen(name) for name in names}
        latents = {name: np.concatenate([clip["latents"] for clip in clips]) for name, clips in seen.items()}
        labels = {name: np.concatenate([clip["lexemes"] for clip in clips]) for name, clips in seen.items()}
        _, labelled = ground.bench.judge
        size = len(ground.bench.judge[0].vectors)
        shown = {name: (points, labels[name][chosen])
                 for name, (points, chosen) in joint_embedding(latents, EACH).items()}
        return embedding_panels(shown, size, labelled.silent.tolist()), title, {
            f"{name}, lexemes": len(np.unique(own)) for name, own in labels.items()}

    return drawn


def strips_of_beats(ground: Ground) -> Drawn:
    """RG Fig. 16."""
    names = [line.row for line in TABLES["RG Table 4"].lines]
    first = {name: ground.seen(name)[0] for name in (*names, PERFORMER)}
    found = {name: (own["beats"], own["onsets"], own["edges"]) for name, own in first.items()}
    return beat_strips(found, ground.start, STRETCH, PAPERS_DELTA), (
        f"Onsets of the speech above, beats of the motion below, pairs within {PAPERS_DELTA} s joined. No chance level "
        "is drawn: at this delta most beats find an onset in any motion (Fig. 11)."), {
        name: pmb.pmb(own["beats"], own["onsets"], PAPERS_DELTA) for name, own in first.items()}


def sizes(ground: Ground) -> Drawn:
    """RG Fig. 18."""
    there = [size for size in SIZES if f"size-{size}" in ground.rows]
    if len(there) < 2:
        raise InputError("figure-18", "needs two sizes", "run the rows size-N")

    def of(key: str) -> list[tuple[float, float, float]]:
        cells = [ground.rows[f"size-{size}"]["figures"][key] for size in there]
        return [(own["mean"], own["low"], own["high"]) for own in cells]

    keys = {"FGD": "fgd", f"PMB at {pmb.DELTA} s above chance, %": "pmb_above_chance"}
    beside = ground.rows.get(f"{PERFORMER}-val")
    reference = {title: beside["figures"][key]["mean"] for title, key in keys.items()} if beside else {}
    chosen = ground.bench.first.config.lexicon.size
    return size_sweep(there, {title: of(key) for title, key in keys.items()}, reference, chosen=chosen), (
        "Lexicons of different sizes on the validation split; the performer dashed."), {
        f"{size} lexemes, {title}": of(key)[k][0] for title, key in keys.items() for k, size in enumerate(there)}


# ------------------------------------------------------------------------------------------------------------ the list

@dataclass(frozen=True)
class PaperFigure:
    """A figure: which of the paper it is, what it shows, the rows that it is drawn from, how; dots: as PNG."""

    paper: str
    title: str
    draw: Callable[[Ground], Drawn]
    rows: tuple[str, ...] = ()
    dots: bool = False


_STEPS = ("no-audio-no-style", "no-style", "random-style", OURS)
FIGURES: dict[str, PaperFigure] = {
    "figure-2": PaperFigure("RG Fig. 2", "from speech to motion", pipeline, (OURS,)),
    "figure-5": PaperFigure("RG Fig. 5 and 8a", "intervals between onsets", onset_intervals),
    "figure-6": PaperFigure("RG Fig. 6 and 8b", "the lexicon", lexicon, dots=True),
    "figure-9-performer": PaperFigure("RG Fig. 9", "the performer", strip(PERFORMER), (PERFORMER,), dots=True),
    "figure-9-ours": PaperFigure("RG Fig. 9", "ours", strip(OURS), (OURS,), dots=True),
    "figure-10": PaperFigure("RG Fig. 10", "style editing", edited, ("style-editing",), dots=True),
    "figure-11": PaperFigure("RG Fig. 11", "PMB over delta", curves),
    "figure-14": PaperFigure("RG Fig. 14", "what two levels of the audio say of the lexeme", clusters,
                             (PERFORMER, OURS)),
    "figure-15": PaperFigure("RG Fig. 15", "what style codes add", panels(
        "Latents of the motion in one t-SNE, coloured by the lexeme that it was made of (the performer: nearest).",
        PERFORMER, *_STEPS), (PERFORMER, *_STEPS), dots=True),
    "figure-16": PaperFigure("RG Fig. 16", "beats under three ranges of intervals", strips_of_beats,
                             (*(line.row for line in TABLES["RG Table 4"].lines), PERFORMER)),
    "figure-17": PaperFigure("RG Fig. 17", "what lexemes add", panels(
        "Latents of the motion in one t-SNE, coloured by the lexeme that it was made of (else: nearest).",
        PERFORMER, "no-lexemes", OURS), (PERFORMER, "no-lexemes", OURS), dots=True),
    "figure-18": PaperFigure("RG Fig. 18", "how many lexemes", sizes),
}


def figure_key(bench: Bench, name: str, rows: Mapping[str, Any]) -> str:
    """Hash of what a figure is drawn from: the rows whose motion it shows, or else all figures of the tables."""
    own = FIGURES[name].rows
    stands = [kept(bench, row).key for row in own] if own else [bench.shared, dict(rows)]
    return configs.digest(VERSION, name, stands)


def draw(bench: Bench, name: str, rows: Mapping[str, Any], out: Path) -> str:
    """Write a figure unless it stands there; why it cannot be drawn, or ""."""
    own, place = FIGURES[name], out / f"{name}.json"
    lacking = [row for row in own.rows if row not in rows]
    if lacking:
        return f"not run: {', '.join(lacking)}"
    key = figure_key(bench, name, rows)
    if finished(place, key) is not None:
        return ""
    try:
        picture, caption, numbers = own.draw(Ground(bench, rows))
    except InputError as error:
        return str(error)
    save_strip(picture, out / f"{name}.{'png' if own.dots else 'svg'}")
    told = {"figure": own.paper, "title": own.title, "caption": caption, "numbers": numbers}
    write_text(place, dumped({**told, "key": key, "shared": bench.shared}))
    return ""
