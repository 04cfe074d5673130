"""Does a lexeme name a movement, and does the generator sample the movement that was requested?

Measured on held-out motion, in joint positions (metres, hips at the origin, the joints of the 16-joint character), over
the blocks of strokes: those in which a wrist is faster than 0.3 m/s. With x the truth, y the decoded motion, both
[K, J, 3], and l the last true frame before the block:

- within-block R2: 1 - sum |(y - mean y) - (x - mean x)|^2 / sum |x - mean x|^2. A lexicon of postures has none.
- displacement R2: 1 - sum |y - x|^2 / sum |x - l|^2. Holding the last pose has none.

Each block is decoded by all of its codes from the true frames before it (open loop); a lexicon of poses takes no notice
of them. What the lexeme alone tells stands in `eval.quality`.

Obedience: free-running, a sampled block is encoded again, after the block that was sampled before it; its rank is how
many lexemes are nearer than the one that was requested. What fools it: a lexicon of few lexemes, or a lexeme that is
used alone; beside it stands the share that the most frequent lexeme would reach.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import blocks as block_module
from data_module.motion.kinematics import positions_of
from data_module.motion.movement import Pasts, pasts_of
from data_module.motion.skeletons import CHARACTER
from data_module.store import Store
from data_module.types import Array, Motion
from eval import stats
from eval.acceptance.bounds import LACKING, Measured, Results
from eval.metrics.eye import common_body, hands
from eval.metrics.eye.body import HZ
from eval.renderings import AcceptanceVoice, BundleSystem, Rendering
from eval.stats import Interval
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from lexicon.autoencoder import Lexicon
from lexicon.movement import MovementLexicon

BEST = 5
"""Lexemes that count as near the requested one."""
PLAYED = "as played"
"""With rest and life laid over the sampled motion."""
OPEN = "all levels, open loop"



@dataclass(frozen=True)
class HeldOut:
    """A recording's own motion in N blocks. motion: [N, K, D_m] normalised; durations: [N] s; first: [D_m] the pose at
    time 0; positions: [D_m vectors -> joints] metres."""

    motion: Tensor
    durations: Tensor
    first: Tensor
    positions: Callable[[Tensor], Array]

    def pasts(self) -> Pasts:
        """The true frames before each block; before the first it stands still."""
        return pasts_of(self.motion, self.durations, self.first)


@torch.no_grad()
def decoded_by(lexicon: Lexicon | MovementLexicon, blocks: Tensor, past: Pasts) -> Tensor:
    """Blocks [B, K, D_m] with what came before each, as all of their codes tell them."""
    if isinstance(lexicon, MovementLexicon):
        return lexicon.basis.compose(lexicon.quantised(lexicon.basis.coefficients(blocks, past)), past)
    return lexicon.decode(lexicon.vectors[lexicon.label(blocks)])


def fit_of(held: HeldOut, decoded: Tensor) -> Array:
    """[3, 2] of decoded blocks [N, K, D_m] of strokes: squared errors within blocks and of their places, each with what
    it is compared with, m2; the correlation of both hands' heights, as decoded and in truth."""
    truth, drawn = held.positions(held.motion), held.positions(decoded)
    last = np.concatenate([held.positions(held.first[None, None])[:, -1:], truth[:-1, -1:]])
    moving = stroke_blocks(truth, held.durations.numpy())
    x, y, l0 = truth[moving], drawn[moving], last[moving]
    # About the block's own mean: within a block the shape counts, its place is the displacement's.
    inner = x - x.mean(axis=1, keepdims=True)
    wrists = [CHARACTER.index(side + "Hand") for side in ("Right", "Left")]
    heights = [hands.correlation(places[..., wrists, 1].reshape(-1, 2)) for places in (drawn, truth)]
    return np.array([[((y - y.mean(axis=1, keepdims=True) - inner) ** 2).sum(), (inner ** 2).sum()],
                     [((y - x) ** 2).sum(), ((x - l0) ** 2).sum()], heights])


def stroke_blocks(places: Array, durations: Array) -> NDArray[np.bool_]:
    """[N] blocks of places [N, K, J, 3] in which a wrist is faster than a stroke's fastest moment must be."""
    # A stroke is recognised by its fastest moment, not by its mean: most of a block may be preparation.
    wrists = places[:, :, [CHARACTER.index(side + "Hand") for side in ("Right", "Left")]]
    step = np.linalg.norm(np.diff(wrists, axis=1), axis=-1) * (places.shape[1] / durations)[:, None, None]
    return np.asarray(step.max(axis=(1, 2)) > hands.MOVES, dtype=bool)


def r_squared(sums: Array) -> Interval:
    """1 - error over what it is compared with, of sums [recordings, 2], with the interval over recordings."""
    def figure(chosen: Array) -> float:
        error, whole = sums[chosen].sum(axis=0)
        return float(1.0 - error / whole) if whole > 0 else float("nan")

    return stats.of_set(figure, len(sums), basic=False)


def lexicon_figures(recordings: Sequence[HeldOut], decoded: Sequence[Tensor]) -> Results:
    """Within-block and displacement R2 and the tie between the hands of decoded recordings, each [N, K, D_m]."""
    fits = np.array([fit_of(held, blocks) for held, blocks in zip(recordings, decoded, strict=True)])
    drawn, true = (stats.mean_interval(fits[:, 2, k]) for k in (0, 1))
    return {("within_r2", OPEN): Measured(r_squared(fits[:, 0])),
            ("displacement_r2", OPEN): Measured(r_squared(fits[:, 1])),
            ("heights_apart", OPEN): Measured(Interval.exact(abs(drawn.mean - true.mean), drawn.n),
                                              f"decoded {drawn.text()}, truth {true.text()}")}


def absent_figure(decoded: Sequence[Tensor], present: NDArray[np.float32]) -> Measured:
    """Range of numbers that no source has, which must not move at all. present: [D_m] 1 where some source has them."""
    lacking = present < 0.5
    if not lacking.any():
        return Measured(missing="every joint is present in some source")
    # The range, not the mean: a constant offset of a joint that no source has is harmless.
    moved = max(float(np.ptp(blocks.numpy()[..., lacking].reshape(-1, lacking.sum()), axis=0).max())
                for blocks in decoded)
    return Measured(Interval.exact(moved, 1), f"{int(lacking.sum())} of {len(present)} numbers")


# ---------------------------------------------------------------------------------------------------------- obedience

@torch.no_grad()
def encode(bundle: Bundle, rendering: Rendering, speaker: int) -> NDArray[np.int64]:
    """[N] ranks of the requested lexemes: how many are nearer to each sampled block than the one that was requested."""
    lexicon = bundle.block_lexicon
    blocks, requested = torch.as_tensor(rendering.drawn), torch.as_tensor(rendering.lexemes)
    if isinstance(lexicon, Lexicon):
        return ranks_of(lexicon.quantizer.distances(lexicon.latents(blocks)), requested)
    durations = torch.as_tensor(np.diff(rendering.edges), dtype=torch.float32)
    ranks = lexicon.ranks(blocks, pasts_of(blocks, durations, torch.as_tensor(bundle.rest_feature(speaker))), requested)
    return np.asarray(ranks.numpy(), dtype=np.int64)


def ranks_of(distances: Tensor, requested: Tensor) -> NDArray[np.int64]:
    """[N] how many of distances [N, S] are below that of the requested lexeme [N]."""
    nearer = distances < distances.gather(-1, requested[:, None])
    return np.asarray(nearer.sum(-1).numpy(), dtype=np.int64)


def obedience_figures(ranks: Sequence[NDArray[np.int64]], lexemes: Sequence[NDArray[np.int64]], groups: Sequence[str]
                      ) -> Results:
    """Shares of all blocks, with intervals over recordings; ranks, lexemes: [N] of each."""
    sizes = [len(rank) for rank in ranks]
    every = np.concatenate(lexemes)
    # A generator that plays one lexeme all the time obeys as often as that lexeme is requested.
    common = float(np.bincount(every).max() / len(every))

    def share(least: int) -> Interval:
        return stats.mean_interval([float((rank < least).mean()) for rank in ranks], sizes, groups=groups)

    remark = (f"{sum(sizes)} blocks, {len(np.unique(every))} lexemes in use; always requesting the most frequent one "
              f"would reach {common:.2f}")
    return {("obeyed", PLAYED): Measured(share(1), remark), ("among_best", PLAYED): Measured(share(BEST))}


def silent_speed(motion: Motion, edges: Array, quiet: NDArray[np.bool_]) -> float:
    """Mean hand speed, m/s, in blocks that are quiet, as the block before them was; NaN where there is none."""
    speed = common_body(motion).hand_speed.mean(axis=1)
    at = np.clip(np.searchsorted(edges, np.arange(len(speed)) / HZ, side="right") - 1, 0, len(quiet) - 1)
    # The first silent block still carries the retraction of the gesture before it.
    settled = quiet & np.concatenate([[False], quiet[:-1]])
    resting = speed[settled[at]]
    return float(resting.mean()) if len(resting) else float("nan")


def silent_figure(renderings: Sequence[Rendering], silent: NDArray[np.int64], groups: Sequence[str]) -> Measured:
    """Hand speed, m/s, where silent lexemes follow each other."""
    values = [silent_speed(rendering.motion, rendering.edges, np.isin(rendering.lexemes, silent))
              for rendering in renderings]
    return Measured(stats.mean_interval(values, groups=groups), f"{len(silent)} silent lexemes")


# ------------------------------------------------------------------------------------------------------------- group

def held_out(bundle: Bundle, store: Store) -> list[HeldOut]:
    """The test split as the bundle's lexicon reads it; an unknown speaker is centred on the recording's mean."""
    representation, statistics = representation_of(bundle.config), bundle.statistics
    out = []
    for info in store.of_split("test"):
        recording = store.load(info.name, bundle.config.motion.joints)
        blocks = block_module.cut(recording.speech, bundle.config.rhythm)
        # A single block has no block before it whose end it could hold.
        if len(blocks) < 2:
            continue
        poses = block_module.normalise_motion(recording.motion, blocks, representation)
        # Every performer is centred on a pose of its own, as in training.
        known = info.speaker in statistics.speakers
        mean = statistics.mean_pose[statistics.speakers.index(info.speaker)] if known else poses.mean(axis=(0, 1))
        first = block_module.first_pose(recording.motion, representation)
        moves = statistics.present  # as `Statistics.normalise` has it: exactly 0 in what never moves
        features, start = (torch.as_tensor((values - mean) / statistics.deviation * moves, dtype=torch.float32)
                           for values in (poses, first))

        def positions(blocks: Tensor, mean: Array = mean) -> Array:
            poses = blocks.double().numpy() * statistics.deviation + mean
            moved = representation.motion(poses.reshape(-1, poses.shape[-1]), HZ)
            joints = [moved.skeleton.index(joint) for joint in CHARACTER.names]
            return positions_of(moved)[:, joints].reshape(*poses.shape[:2], len(joints), 3)

        out.append(HeldOut(features, torch.as_tensor(blocks.durations, dtype=torch.float32), start, positions))
    return out


def measure(system: BundleSystem, store: Store | None, voices: Sequence[AcceptanceVoice], renderings: int) -> Results:
    """The group `lexicon`; one missing figure without a store."""
    if store is None:
        return {("within_r2", OPEN): Measured(missing=LACKING["corpus"])}
    bundle, groups = system.bundle, [voice.group or voice.name for voice in voices]
    recordings = held_out(bundle, store)
    decoded = [decoded_by(bundle.block_lexicon, held.motion, held.pasts()) for held in recordings]
    played = [system.render(voice, k % renderings) for k, voice in enumerate(voices)]
    speaker = system.gesticulator.resolver.speaker(system.speaker)
    ranks = [encode(bundle, rendering, speaker) for rendering in played]
    return {**lexicon_figures(recordings, decoded),
            ("absent", ""): absent_figure(decoded, bundle.statistics.present),
            **obedience_figures(ranks, [rendering.lexemes for rendering in played], groups),
            ("silent_speed", ""): silent_figure(played, bundle.silent, groups)}
