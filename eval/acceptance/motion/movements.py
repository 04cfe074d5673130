"""Does a lexeme name a movement, and does the generator draw the movement that was asked for?

Told on held-out motion, in joint positions (metres, hips at the origin, the joints of the 16-joint character), over the
blocks of strokes: those in which a wrist is faster than 0.3 m/s. With x the truth, y what is decoded, both [K, J, 3],
and l the last true frame before the block:

- within-block R2: 1 - sum |(y - mean y) - (x - mean x)|^2 / sum |x - mean x|^2. A lexicon of postures has none.
- displacement R2: 1 - sum |y - x|^2 / sum |x - l|^2. Holding the last pose has none.

Open loop decodes each block from the true frames before it, closed loop from what was decoded. A lexicon of poses takes
no notice of either.

Obedience: free-running, a drawn block is encoded again, after the block that was drawn before it; its rank is how many
lexemes are nearer than the one that was asked for. What fools it: a lexicon of few lexemes, or one that is used alone;
beside it stands the share that the most frequent lexeme would reach.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import blocks as block_module
from data_module.motion.kinematics import positions_of
from data_module.motion.movement import Pasts, joined, pasts_of
from data_module.motion.skeletons import CHARACTER
from data_module.store import Store
from data_module.types import Array, Motion
from eval import stats
from eval.claim import ANY, Verdict, at_least, at_most, judged, skipped
from eval.metrics.eye import common_body, hands, strokes
from eval.metrics.eye.body import HZ
from eval.renderings import AcceptanceVoice, BundleSystem, Rendering
from eval.stats import Interval
from eval.table import Table
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from lexicon.autoencoder import Lexicon
from lexicon.movement import MovementLexicon

OBEYED, AMONG = 0.60, 0.85
"""Shares of blocks whose lexeme is the one that was asked for, and among the best `BEST`."""
BEST = 5
WITHIN, DISPLACED, HEIGHTS = 0.5, 0.65, 0.05
RESTS = 0.2
"""m/s: hands in a block of a silent lexeme that follows another one."""
ALL, ALONE = "all levels", "the lexeme alone"

Decode = Callable[[Tensor, Pasts], Tensor]
"""Blocks [B, K, D_m] and what came before each, to the blocks as their codes tell them."""


@dataclass(frozen=True)
class HeldOut:
    """A recording's own motion in N blocks. motion: [N, K, D_m] normalised; durations: [N] s; first: [D_m] the pose at
    time 0; positions: [D_m vectors -> joints] metres."""

    name: str
    motion: Tensor
    durations: Tensor
    first: Tensor
    positions: Callable[[Tensor], Array]

    def pasts(self) -> Pasts:
        """The true frames before each block; before the first it stands still."""
        return pasts_of(self.motion, self.durations, self.first)


def codes_of(lexicon: Lexicon | MovementLexicon) -> dict[str, Decode]:
    """What a lexicon makes of blocks by all of its codes, and by the lexeme alone."""
    if isinstance(lexicon, MovementLexicon):
        return {ALL: partial(_movements, lexicon, None), ALONE: partial(_movements, lexicon, 0)}
    # A lexicon of poses has one level.
    return {ALL: partial(_poses, lexicon), ALONE: partial(_poses, lexicon)}


@torch.no_grad()
def _movements(lexicon: MovementLexicon, levels: int | None, blocks: Tensor, past: Pasts) -> Tensor:
    return lexicon.basis.compose(lexicon.quantised(lexicon.basis.coefficients(blocks, past), levels), past)


@torch.no_grad()
def _poses(lexicon: Lexicon, blocks: Tensor, past: Pasts) -> Tensor:
    return lexicon.decode(lexicon.vectors[lexicon.label(blocks)])


def open_loop(decode: Decode, held: HeldOut) -> Tensor:
    """[N, K, D_m] every block after the true frames before it."""
    return decode(held.motion, held.pasts())


def closed_loop(decode: Decode, recordings: Sequence[HeldOut]) -> list[Tensor]:
    """[N, K, D_m] of each recording: every block after what was decoded before it."""
    made: list[list[Tensor]] = [[] for _ in recordings]
    true = [held.pasts() for held in recordings]
    before = joined(past[:1] for past in true).frames
    for at in range(max(len(held.motion) for held in recordings)):
        on = [k for k, held in enumerate(recordings) if at < len(held.motion)]
        ratio = torch.stack([true[k].ratio[at] for k in on])
        told = decode(torch.stack([recordings[k].motion[at] for k in on]), Pasts(before[on], ratio))
        before[on] = told[:, -before.shape[1]:]
        for k, block in zip(on, told, strict=True):
            made[k].append(block)
    return [torch.stack(blocks) for blocks in made]


@dataclass(frozen=True)
class Fit:
    """Of one recording. within, displaced: [2] squared errors, and what they are compared with, m2; heights: [2]
    correlation of both hands' heights, of what is decoded and of the truth."""

    within: Array
    displaced: Array
    heights: Array


def fit_of(held: HeldOut, decoded: Tensor) -> Fit:
    """How near decoded blocks [N, K, D_m] are to the truth, in the blocks of strokes."""
    truth, told = held.positions(held.motion), held.positions(decoded)
    last = np.concatenate([held.positions(held.first[None, None])[:, -1:], truth[:-1, -1:]])
    moving = stroke_blocks(truth, held.durations.numpy())
    x, y, l0 = truth[moving], told[moving], last[moving]
    inner = x - x.mean(axis=1, keepdims=True)
    wrists = [CHARACTER.index(side + "Hand") for side in ("Right", "Left")]
    heights = [hands.correlation(places[..., wrists, 1].reshape(-1, 2)) for places in (told, truth)]
    return Fit(np.array([((y - y.mean(axis=1, keepdims=True) - inner) ** 2).sum(), (inner ** 2).sum()]),
               np.array([((y - x) ** 2).sum(), ((x - l0) ** 2).sum()]), np.array(heights))


def stroke_blocks(places: Array, durations: Array) -> NDArray[np.bool_]:
    """[N] blocks of places [N, K, J, 3] in which a wrist is faster than a stroke's fastest moment must be."""
    wrists = places[:, :, [CHARACTER.index(side + "Hand") for side in ("Right", "Left")]]
    step = np.linalg.norm(np.diff(wrists, axis=1), axis=-1) * (places.shape[1] / durations)[:, None, None]
    return np.asarray(step.max(axis=(1, 2)) > strokes.MOVES, dtype=bool)


def r_squared(sums: Array) -> Interval:
    """1 - error over what it is compared with, of sums [recordings, 2], with the interval over recordings."""
    def figure(chosen: Array) -> float:
        error, whole = sums[chosen].sum(axis=0)
        return float(1.0 - error / whole) if whole > 0 else float("nan")

    return stats.of_set(figure, len(sums), basic=False)


def lexicon_clauses(recordings: Sequence[HeldOut], codes: Mapping[str, Decode]) -> list[Verdict]:
    """Within-block and displacement R2 and the tie between the hands, of all codes and of the lexeme alone."""
    out = []
    for name, decode in codes.items():
        for loop, decoded in (("open loop", [open_loop(decode, held) for held in recordings]),
                              ("closed loop", closed_loop(decode, recordings))):
            fits = [fit_of(held, own) for held, own in zip(recordings, decoded, strict=True)]
            asked = name == ALL and loop == "open loop"
            on = f"strokes, {name}, {loop}"
            out.append(judged(f"within-block R2 of {on}", r_squared(np.array([own.within for own in fits])),
                              at_least(WITHIN) if asked else ANY))
            out.append(judged(f"displacement R2 of {on}", r_squared(np.array([own.displaced for own in fits])),
                              at_least(DISPLACED) if asked else ANY))
            told, true = (stats.mean_interval([own.heights[k] for own in fits]) for k in (0, 1))
            apart = Interval.exact(abs(told.mean - true.mean), told.n)
            out.append(judged(f"L/R height correlation, decoded from the truth's, {name}, {loop}", apart,
                              at_most(HEIGHTS) if asked else ANY,
                              reason=f"decoded {told.text()}, truth {true.text()}"))
    return out


def absent_clause(decoded: Sequence[Tensor], present: Tensor) -> Verdict:
    """Numbers that no source has must not move at all. present: [D_m] 1 where some source has them."""
    lacking = present < 0.5
    name = "movement of absent joints, decoded, normalised units"
    if not lacking.any():
        return skipped(name, "every joint is present in some source")
    moved = max(float(np.ptp(own[..., lacking].reshape(-1, int(lacking.sum())).numpy(), axis=0).max())
                for own in decoded)
    return judged(name, moved, at_most(0.0), digits=6, reason=f"{int(lacking.sum())} of {len(present)} numbers")


# ---------------------------------------------------------------------------------------------------------- obedience

@torch.no_grad()
def encode(bundle: Bundle, rendering: Rendering, speaker: int) -> NDArray[np.int64]:
    """[N] ranks of what was asked for: how many lexemes are nearer to each drawn block than the one that was played."""
    lexicon = bundle.block_models.lexicon
    blocks, asked = torch.as_tensor(rendering.drawn), torch.as_tensor(rendering.lexemes)
    if isinstance(lexicon, Lexicon):
        return ranks_of(lexicon.quantizer.distances(lexicon.latents(blocks)), asked)
    assert rendering.edges is not None
    durations = torch.as_tensor(np.diff(rendering.edges), dtype=torch.float32)
    ranks = lexicon.ranks(blocks, pasts_of(blocks, durations, bundle.rest_feature(speaker)), asked)
    return np.asarray(ranks.numpy(), dtype=np.int64)


def ranks_of(distances: Tensor, asked: Tensor) -> NDArray[np.int64]:
    """[N] how many of distances [N, S] are below that of the lexeme asked for [N]."""
    nearer = distances < distances.gather(-1, asked[:, None])
    return np.asarray(nearer.sum(-1).numpy(), dtype=np.int64)


def obedience_clauses(ranks: Sequence[NDArray[np.int64]], lexemes: Sequence[NDArray[np.int64]],
                      groups: Sequence[str], silent: NDArray[np.int64], bare: bool = False) -> list[Verdict]:
    """Shares of all blocks, with intervals over recordings; ranks, lexemes: [N] of each. Beside them, not judged, of
    those that were asked for a gesture: where a silent lexeme is played, the layer of rest holds or sinks the hands
    whatever was drawn, and the lexicon names that otherwise. bare: of the generator alone, which is shown and not
    judged."""
    where = ", generator alone, without rest and life" if bare else ""
    sizes = [len(own) for own in ranks]
    every = np.concatenate(lexemes)
    common = float(np.bincount(every).max() / len(every))

    def share(least: int) -> Interval:
        return stats.mean_interval([float((own < least).mean()) for own in ranks], sizes, groups=list(groups))

    told = (f"{sum(sizes)} blocks, {len(np.unique(every))} lexemes in use; always requesting the most frequent one "
            f"would reach {common:.2f}")
    gestures = [~np.isin(own, silent) for own in lexemes]
    among = stats.mean_interval([float((own[gesture] < BEST).mean()) if gesture.any() else float("nan")
                                 for own, gesture in zip(ranks, gestures, strict=True)],
                                [int(gesture.sum()) for gesture in gestures], groups=list(groups))
    return [judged(f"a drawn block is the requested lexeme, share{where}", share(1),
                   ANY if bare else at_least(OBEYED), reason=told),
            judged(f"it is among the best {BEST}, share{where}", share(BEST), ANY if bare else at_least(AMONG)),
            judged(f"the same of blocks whose lexeme is not a silent one{where}", among, ANY,
                   reason=f"{sum(int(gesture.sum()) for gesture in gestures)} blocks")]


def silent_speed(motion: Motion, edges: Array, quiet: NDArray[np.bool_]) -> float:
    """Mean hand speed, m/s, in blocks that are quiet, as the block before them was; NaN where there is none."""
    speed = common_body(motion).hand_speed.mean(axis=1)
    at = np.clip(np.searchsorted(edges, np.arange(len(speed)) / HZ, side="right") - 1, 0, len(quiet) - 1)
    settled = quiet & np.concatenate([[False], quiet[:-1]])
    own = speed[settled[at]]
    return float(own.mean()) if len(own) else float("nan")


def silent_clause(renderings: Sequence[Rendering], silent: NDArray[np.int64], groups: Sequence[str]) -> Verdict:
    """Silent lexemes rest."""
    name = "hand speed where silent lexemes follow each other, m/s"
    values = [silent_speed(own.motion, own.edges, np.isin(own.lexemes, silent)) for own in renderings
              if own.edges is not None]
    found = stats.mean_interval(values, groups=list(groups))
    if not np.isfinite(found.mean):
        return skipped(name, "no silent lexeme followed another")
    return judged(name, found, at_most(RESTS), reason=f"{len(silent)} silent lexemes")


# ------------------------------------------------------------------------------------------------------------- group

def held_out(bundle: Bundle, store: Store) -> list[HeldOut]:
    """The test split as the bundle's lexicon reads it; whom it does not know is centred on the recording's own mean."""
    representation, statistics = representation_of(bundle.config), bundle.statistics
    out = []
    for info in store.of_split("test"):
        recording = store.load(info.name, bundle.config.motion.joints)
        blocks = block_module.cut(recording.speech, bundle.config.rhythm)
        if len(blocks) < 2:
            continue
        poses = block_module.normalise_motion(recording.motion, blocks, representation)
        known = info.speaker in statistics.speakers
        mean = statistics.mean_pose[statistics.speakers.index(info.speaker)] if known else poses.mean(axis=(0, 1))
        first = block_module.first_pose(recording.motion, representation)
        moves = statistics.present.numpy()  # as `Statistics.normalise` has it: exactly 0 in what never moves
        features, start = (torch.as_tensor((values - mean) / statistics.deviation * moves, dtype=torch.float32)
                           for values in (poses, first))

        def positions(blocks: Tensor, mean: Array = mean) -> Array:
            poses = blocks.double().numpy() * statistics.deviation + mean
            moved = representation.motion(poses.reshape(-1, poses.shape[-1]), HZ)
            joints = [moved.skeleton.index(joint) for joint in CHARACTER.names]
            return positions_of(moved)[:, joints].reshape(*poses.shape[:2], len(joints), 3)

        out.append(HeldOut(info.name, features, torch.as_tensor(blocks.durations, dtype=torch.float32), start,
                           positions))
    return out


def run(ours: BundleSystem, store: Store | None, voices: Sequence[AcceptanceVoice], renderings: int
        ) -> tuple[list[Verdict], list[Table]]:
    """Everything of this group."""
    if store is None:
        return [skipped("lexicon and obedience", "no store was given (--store)")], []
    recordings, codes = held_out(ours.bundle, store), codes_of(ours.bundle.block_models.lexicon)
    clauses = lexicon_clauses(recordings, codes)
    clauses.append(absent_clause([open_loop(codes[ALL], held) for held in recordings], ours.bundle.statistics.present))
    made = [ours.render(voice, k % renderings) for k, voice in enumerate(voices)]
    groups = [voice.group or voice.name for voice in voices]
    clauses += _obedience(ours, voices, made)
    if ours.bundle.rests_by_phrase:
        bare = ours.bare()
        clauses += _obedience(ours, voices, [bare.render(voice, k % renderings) for k, voice in enumerate(voices)],
                              bare=True)
    clauses.append(silent_clause(made, ours.bundle.silent, groups))
    return clauses, []


def _obedience(ours: BundleSystem, voices: Sequence[AcceptanceVoice], made: Sequence[Rendering], bare: bool = False
               ) -> list[Verdict]:
    speakers = [ours.gesticulator.speaker_index(ours.speaker(voice)) for voice in voices]
    ranks = [encode(ours.bundle, own, speaker) for own, speaker in zip(made, speakers, strict=True)]
    groups = [voice.group or voice.name for voice in voices]
    return obedience_clauses(ranks, [own.lexemes for own in made], groups, ours.bundle.silent, bare)
