"""RACER's stages over a lexicon: reward models, offline episodes, Q-network (RACER 4.2 and 4.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from data_module.errors import InputError
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator.prepare import Corpus
from interpreters.base import BlockFeatures, LexemeInterpreter
from interpreters.cql import ConservativeQ, QNetwork, cross_entropy
from interpreters.episodes import Episodes, Reward, SilentLexemes, Take, build, distance_rewards, looked_up
from interpreters.reward import Centred, RewardConfig, RewardModel, RewardTable
from interpreters.statistical import StatisticalInterpreter
from lexicon.autoencoder import Lexicon
from lexicon.quantizer import perplexity
from lexicon.racer import FRAMES, RacerCodec

if TYPE_CHECKING:
    from gesticulator.train import Labelled, Run

Tokens = Lexicon | RacerCodec
"""What names the gesture of a block: the lexicon of blocks at the beat, or RACER's own codec at a fixed rate."""

_TOGETHER = 8
"""Windows of one recording in a batch of the reward model: rivals of the same voice, so that the hour and not the
speaker has to be told."""


def block_audio(corpus: Corpus) -> Tensor:
    """[N, K, d] both levels of audio on the block itself; the log duration comes last."""
    frames = corpus.motion.shape[1]
    low = corpus.low[:, frames:2 * frames]
    if corpus.high is corpus.low:
        return low
    return torch.cat([low[..., :-1], corpus.high[:, frames:2 * frames]], dim=-1)


def decoded_lexemes(lexicon: Lexicon) -> Tensor:
    """[S, K, D_m] what each lexeme looks like."""
    with torch.no_grad():
        return lexicon.decode(lexicon.vectors)


@torch.no_grad()
def decoded_blocks(tokens: Tokens, labels: NDArray[np.int64], corpus: Corpus) -> Tensor:
    """[N, K, D_m] every block as its lexeme shows it."""
    if isinstance(tokens, Lexicon):
        return decoded_lexemes(tokens)[torch.as_tensor(labels)]
    rows = [tokens.decode_tokens(torch.as_tensor(labels[corpus.blocks_of(r)])[None])[0]
            for r in range(len(corpus.names))]
    return torch.cat(rows)


def token_labels(tokens: Tokens, corpus: Corpus) -> NDArray[np.int64]:
    """[N] the lexeme of every block."""
    if isinstance(tokens, Lexicon):
        return tokens.label(corpus.motion).numpy()
    out = np.empty(len(corpus.motion), dtype=np.int64)
    for recording in range(len(corpus.names)):
        own = corpus.blocks_of(recording)
        out[own] = tokens.label(corpus.motion[torch.as_tensor(own)].flatten(0, 1)[None])[0].numpy()
    return out


def reward_table(model: RewardModel, tokens: Tokens, corpus: Corpus) -> RewardTable:
    """A reward model over this lexicon and this corpus, ready to be asked."""
    audio, durations = block_audio(corpus).float(), torch.as_tensor(np.log(corpus.durations)).float()
    if isinstance(tokens, Lexicon):
        return RewardTable(model, audio, durations, decoded_lexemes(tokens))
    return RewardTable(model, audio, durations, decode=tokens.decode_tokens, size=len(tokens.vectors))


def q_batch(corpus: Corpus, windows: dict[str, Tensor], lookahead: int = 1) -> dict[str, Tensor]:
    """Windows of episodes with what a Q-network hears: audio [B, T + 1, 3K, d] and speaker one-hot [B, P].

    Without look-ahead that is the window around the block before. Decisions begin with a recording's second block.
    """
    return {**windows, "audio": corpus.high[windows["block"] - (1 - lookahead)].float(),
            "speaker": functional.one_hot(windows["speaker"], len(corpus.statistics.speakers)).float()}


@dataclass(frozen=True)
class RewardWindows:
    """Windows of motion and the audio that goes with them, of any length, for the contrastive loss.

    A batch would be easy if each window came from another speaker; so it holds eight windows of each of its recordings.
    shown: [N, K, D_m] the blocks as the lexicon shows them. labels: [N]. lexemes: [S, K, D_m] and after: [S, S] the
    transition matrix, from which rivals are made: windows whose last lexemes are replaced, half of them by lexemes that
    often follow, so that it takes ears to tell; None makes no rivals.
    """

    corpus: Corpus
    audio: Tensor
    shown: Tensor
    recordings: Sequence[int]
    config: RewardConfig
    labels: NDArray[np.int64]
    lexemes: Tensor | None = None
    after: NDArray[np.float64] | None = None

    def drawn(self, rng: np.random.Generator, count: int, decoded: float | None = None) -> fitting.Batch:
        """A batch of `count` windows, as `RewardModel.losses` takes it; `decoded` of them show lexemes."""
        config = self.config
        drawn = rng.choice(self.recordings, size=-(-count // _TOGETHER))
        owners = np.repeat(drawn, _TOGETHER)[:count]
        blocks, valid = np.zeros((count, config.longest), np.int64), np.zeros((count, config.longest), np.float32)
        for row, recording in enumerate(owners):
            own = self.corpus.blocks_of(int(recording))
            length = min(int(rng.integers(config.shortest, config.longest + 1)), len(own))
            start = int(rng.integers(len(own) - length + 1))
            blocks[row] = own[start]
            blocks[row, -length:] = own[start:start + length]
            valid[row, -length:] = 1
        share = config.decoded if decoded is None else decoded
        batch = self.batch(blocks, valid, rng.random(count) < share)
        if self.lexemes is not None and config.rivals:
            batch["rival"] = self.rivals(blocks, valid, rng)
        return batch

    def batch(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], decoded: NDArray[np.bool_]) -> fitting.Batch:
        """The windows of blocks [B, W], right-aligned; those marked `decoded` [B] show lexemes instead of capture."""
        at, shows = torch.as_tensor(blocks), torch.as_tensor(decoded)
        motion = torch.where(shows[:, None, None, None], self.shown[at], self.corpus.motion[at])
        return {"motion": motion, "audio": self.audio[at].float(), "valid": torch.as_tensor(valid),
                "log_duration": torch.as_tensor(np.log(self.corpus.durations[blocks])).float(),
                "group": torch.as_tensor(groups(blocks, valid, self.corpus.silent[blocks])), "rivalled": shows}

    def rivals(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], rng: np.random.Generator) -> Tensor:
        """[B, H, W, K, D_m] the decoded windows with one to half of their last lexemes replaced by others."""
        assert self.lexemes is not None and self.after is not None
        size, count = len(self.lexemes), self.config.rivals
        lexemes = np.repeat(self.labels[blocks][:, None], count, axis=1)
        cumulated = self.after.cumsum(axis=1)
        for row, length in enumerate(valid.sum(1).astype(int)):
            for rival in range(count):
                replaced = int(rng.integers(1, max(1, length // 2) + 1))
                likely = rng.random() < 0.5
                for at in range(-replaced, 0):
                    own, other = int(lexemes[row, rival, at]), int(rng.integers(size))
                    if likely and length > -at:
                        row_of = cumulated[lexemes[row, rival, at - 1]]
                        other = int(np.searchsorted(row_of, rng.random() * row_of[-1]))
                    if at == -1 and other == own:  # nothing else may be wrong
                        other = (own + 1 + int(rng.integers(size - 1))) % size
                    lexemes[row, rival, at] = other
        return self.lexemes[torch.as_tensor(lexemes)]


def groups(blocks: NDArray[np.int64], valid: NDArray[np.float32], silent: NDArray[np.bool_]) -> NDArray[np.int64]:
    """[B] alike for windows [B, W] that share a block (or are joined by one that does), and for all that are silent.

    Such windows suit each other's audio and must not count as each other's negatives.
    """
    last = blocks[:, -1]
    first = last - valid.sum(1).astype(np.int64) + 1
    out = np.empty(len(blocks), dtype=np.int64)
    group, end = 0, -1
    for row in np.argsort(first, kind="stable"):
        if first[row] > end:
            group += 1
        end = max(end, int(last[row]))
        out[row] = group
    out[(silent | (valid == 0)).all(axis=1)] = 0
    return out


def train_reward(run: Run, tokens: Tokens, labelled: Labelled, judge: bool = False
                 ) -> tuple[RewardModel, dict[str, float]]:
    """E_m and E_u (RACER 4.2). The judge is of another seed and hears the other half of the recordings: what a policy
    learned to please must not be what it is judged by."""
    stage = "reward_judge" if judge else "reward"
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed(stage))
    audio = block_audio(corpus)
    model = RewardModel(config.reward, config.rhythm.frames, corpus.motion.shape[-1], audio.shape[-1])
    known, held = corpus.recordings("train"), corpus.recordings("val")
    half = known[int(judge)::2] or known

    def of(recordings: Sequence[int], shown: Tensor) -> RewardWindows:
        lexemes = decoded_lexemes(tokens) if isinstance(tokens, Lexicon) else None
        return RewardWindows(corpus, audio, shown, recordings, config.reward, labelled.labels, lexemes,
                             labelled.inventory.transitions)

    def train(folder: Path) -> dict[str, float]:
        shown = decoded_blocks(tokens, labelled.labels, corpus)
        windows, check = of(half, shown), of(held or half, shown)
        checks = [check.drawn(fitting.generator_for(2, i), 128, 1.0) for i in range(4)]

        @torch.no_grad()
        def validate() -> dict[str, float]:
            batches = [{key: value.to(run.device) for key, value in b.items()} for b in checks]
            found = [{**model.retrieval(b), **({"right_one": model.right_one(b)} if "rival" in b else {})}
                     for b in batches]
            return {"contrast": sum(float(model.losses(b)["contrast"]) for b in batches) / len(batches),
                    **{key: float(np.mean([f[key] for f in found])) for key in found[0]}}

        return run.fit(stage, model, lambda rng: windows.drawn(rng, config.schedules.reward.batch), model.losses,
                       folder, validate)

    return model, run.stage(stage, model, train)


def takes_of(corpus: Corpus, labels: NDArray[np.int64], split: str) -> list[Take]:
    """What was really done in the recordings of a split."""
    out = []
    for recording in corpus.recordings(split):
        own = corpus.blocks_of(recording)
        out.append(Take(recording, int(corpus.speaker_of[recording]), own, labels[own], corpus.silent[own]))
    return out


def features_of(corpus: Corpus) -> Callable[[int], BlockFeatures]:
    """What an interpreter hears of a block of the corpus."""
    return lambda block: BlockFeatures(corpus.low[block].float(), corpus.high[block].float(),
                                       bool(corpus.silent[block]))


def taught_reward(table: RewardTable, corpus: Corpus, draws: int) -> RewardTable | Centred:
    """The reward as a policy is taught it: told from what random lexemes earn on the same audio, or as it is (0)."""
    if not draws:
        return table
    recordings = [torch.as_tensor(corpus.blocks_of(r)) for r in range(len(corpus.names))]
    return Centred(table, recordings, draws)


def step_reward(run: Run, tokens: Tokens, model: RewardModel) -> Reward:
    """What a step earns, by the settings: the contrastive reward, or the distance to the recording (RACER 5.5)."""
    if run.config.episodes.reward == "contrastive":
        return taught_reward(reward_table(model, tokens, run.corpus), run.corpus, run.config.episodes.baseline).sequence
    if not isinstance(tokens, Lexicon):
        raise InputError("episodes.reward=distance", "is of lexemes that are decoded one by one",
                         "use it over a lexicon, not with tokens=racer")
    return looked_up(distance_rewards(decoded_lexemes(tokens), run.corpus.motion))


def make_episodes(run: Run, tokens: Tokens, labelled: Labelled, model: RewardModel,
                  lstm: LexemeInterpreter | None) -> Episodes:
    """The offline data set of the training split, kept under the hash of all that shapes it (RACER 4.3)."""
    file = run.work / f"episodes-{run.key('episodes')}.npz"
    if file.exists():
        return Episodes.load(file)
    corpus, config = run.corpus, run.config
    frequencies = np.stack([labelled.inventory.frequencies[name] for name in corpus.statistics.speakers])
    others: dict[str, Any] = {"statistical": StatisticalInterpreter(frequencies, labelled.inventory.transitions,
                                                                    config.statistical)}
    if lstm is not None:
        others["sampled"] = lstm
    episodes = build(takes_of(corpus, labelled.hinted, "train"), config.episodes, step_reward(run, tokens, model),
                     silent=SilentLexemes(labelled.silent, labelled.nearest), vectors=tokens.vectors.numpy(),
                     interpreters=others, features=features_of(corpus), seed=run.seed("cql"))
    episodes.save(file)
    return episodes


def new_q_network(run: Run, tokens: Tokens, silent: NDArray[np.int64]) -> QNetwork:
    """An untrained Q-network over the lexicon."""
    config, corpus = run.config, run.corpus
    return QNetwork(config.cql, config.rhythm.frames, corpus.high.shape[-1], len(tokens.vectors),
                    len(corpus.statistics.speakers), silent.tolist())


def train_q_network(run: Run, tokens: Tokens, labelled: Labelled, model: RewardModel,
                    lstm: LexemeInterpreter | None) -> tuple[QNetwork, dict[str, float]]:
    """The Q-network by conservative Q-learning on the offline episodes (RACER Eq. 11)."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("cql"))
    learner = ConservativeQ(new_q_network(run, tokens, labelled.silent))
    decisions = config.cql.decisions

    def train(folder: Path) -> dict[str, float]:
        episodes = make_episodes(run, tokens, labelled, model, lstm)
        held = Episodes(build(takes_of(corpus, labelled.hinted, "val" if corpus.recordings("val") else "train"),
                              configs.LITERAL, step_reward(run, tokens, model),
                              silent=SilentLexemes(labelled.silent, labelled.nearest),
                              vectors=tokens.vectors.numpy()).episodes)
        ahead = config.cql.lookahead
        checks = [q_batch(corpus, held.windows(fitting.generator_for(3, i), 64, decisions), ahead) for i in range(4)]

        @torch.no_grad()
        def validate() -> dict[str, float]:
            return q_figures(learner, [{key: value.to(run.device) for key, value in b.items()} for b in checks])

        return run.fit("cql", learner, lambda rng: q_batch(corpus, episodes.windows(
            rng, config.schedules.cql.batch, decisions), ahead), learner.losses, folder, validate, learner.before_step)

    figures = run.stage("cql", learner, train)
    return learner.online, figures


@torch.no_grad()
def q_figures(learner: ConservativeQ, batches: Sequence[dict[str, Tensor]]) -> dict[str, float]:
    """On what was really done: cross-entropy of Q as logits, accuracy of arg max, squared Bellman error, mean Q."""
    totals = np.zeros(4)
    for batch in batches:
        q = learner.online.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
        allowed = learner.online.allowed(batch["silent"])
        masked = q.masked_fill(~allowed, -torch.inf)
        valid, action = batch["valid"], batch["action"][..., None]
        entropy = cross_entropy(q, batch["action"], allowed)
        right = (masked.argmax(-1, keepdim=True) == action)[..., 0].float()
        count = valid.sum()
        taken = q.gather(-1, action)[..., 0]
        error = learner.losses({**batch, "cloned": valid}).get("temporal_difference", torch.nan)
        totals += [float((entropy * valid).sum() / count), float((right * valid).sum() / count), float(error),
                   float((taken * valid).sum() / count)]
    names = ("cross_entropy", "accuracy", "temporal_difference", "mean_q")
    return {name: float(value) for name, value in zip(names, totals / len(batches), strict=True)}


def train_codec(run: Run) -> tuple[RacerCodec, dict[str, float]]:
    """RACER's own VQ-VAE on windows of as many codes as a decision sees (RACER 4.1; 120 frames in the paper)."""
    config, corpus = run.config, run.corpus
    if not fixed_rate(config):
        raise InputError("tokens=racer", "needs blocks of eight frames at a fixed rate",
                         "start from --preset racer-native, racer-trinity or racer-chinese")
    torch.manual_seed(run.seed("lexicon"))
    model = RacerCodec(config.racer, corpus.motion.shape[-1], corpus.statistics.present)
    length, settings = config.cql.decisions, config.schedules.lexicon

    def windows(split: str) -> NDArray[np.int64]:
        starts = [corpus.blocks_of(r)[:1 - length] for r in corpus.recordings(split)
                  if len(corpus.blocks_of(r)) >= length]
        if not starts:
            raise InputError("store", f"has no recording of {length} codes in its {split} split",
                             "build it from longer recordings")
        return np.concatenate(starts)

    known = windows("train")
    held = windows("val")[::length] if corpus.recordings("val") else known[::length]
    motion = corpus.motion.flatten(0, 1)
    frames = torch.arange(length * FRAMES)

    def crops(starts: NDArray[np.int64]) -> Tensor:
        return motion[torch.as_tensor(starts)[:, None] * FRAMES + frames]

    def make_batch(rng: np.random.Generator) -> fitting.Batch:
        chosen = rng.choice(known, settings.batch)
        return {"motion": crops(chosen), "mask": corpus.mask[torch.as_tensor(corpus.recording[chosen])]}

    def before_step(step: int) -> None:
        if step == 0:
            model.start_codebook(crops(known[::length]).to(run.device), run.seed("lexicon"))

    @torch.no_grad()
    def validate() -> dict[str, float]:
        true = crops(held).to(run.device)
        latents = model.encode(true)
        labels = model.quantizer.labels(latents.flatten(0, 1))
        made = model.decode(model.vectors[labels].unflatten(0, latents.shape[:2]))
        return {"quantised": float((made - true).pow(2).mean()),
                "unquantised": float((model.decode(latents) - true).pow(2).mean()),
                "usage": float((torch.bincount(labels, minlength=model.quantizer.size) > 0).float().mean()),
                "perplexity": perplexity(labels, model.quantizer.size)}

    def train(folder: Path) -> dict[str, float]:
        return run.fit("lexicon", model, make_batch, model.losses, folder, validate, before_step)

    return model, run.stage("lexicon", model, train)


def fixed_rate(config: configs.Config) -> bool:
    """Blocks are eight frames at a fixed rate, as RACER's codes are."""
    return config.rhythm.beats.rule == "even" and config.rhythm.frames == FRAMES
