"""`python -m gesticulator.train --data STORE --out BUNDLE`: every stage, resumable, from a store to a bundle."""

from __future__ import annotations

import argparse
import copy
import dataclasses
import json
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from data_module.blocks import samples_per_frame
from data_module.errors import InputError, one_line_errors
from data_module.files import write_text
from data_module.layers import freeze
from data_module.motion.kinematics import positions_of
from data_module.motion.representation import Representation
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.speech_encoder import PredictiveCoding, SpeechEncoder, TextContrast
from data_module.store import Store
from generator.model import Generator
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator.card import model_card
from gesticulator.config import Config
from gesticulator.prepare import Corpus, Windows, prepare, sequences, with_silence
from gesticulator.racer import Tokens, token_labels, train_codec, train_q_network, train_reward
from gesticulator.sounds import Crops, folder_digest
from gesticulator.speech_features import three_blocks
from gesticulator.statistics import CONTROL_WIDTH, representation_of
from interpreters.gate import ActivityGate
from interpreters.lstm import LstmInterpreter
from interpreters.style import StyleInterpreter
from lexicon import inventory as inventories
from lexicon.autoencoder import Lexicon
from lexicon.quantizer import perplexity

STAGES = ("lexicon", "generator", "interpreter", "style", "speech", "contrast", "interpreter_text", "style_text",
          "gate", "reward", "reward_judge", "cql")
"""Everything that is trained. "interpreter" and "style" hear audio alone, their "_text" twins the words too."""


@dataclasses.dataclass
class Run:
    """A training run: its settings, its data and its work folder."""

    config: Config
    store: Store
    work: Path
    device: str = "cpu"
    progress: bool = True
    speech: tuple[Path, ...] = ()
    """Folders of more sound for the predictive coding."""
    corpus: Corpus = dataclasses.field(init=False)

    def key(self, stage: str) -> str:
        """Hash of everything that shapes a stage: its own settings, those of the stages before it, and the data."""
        c, s = self.config, self.config.schedules
        speech: list[Any] = [self.store.fingerprint, c.seed, c.rhythm, c.encoder, s.speech,
                             [folder_digest(folder) for folder in self.speech]]
        heard = [*speech, c.text, s.contrast, c.front_end] if c.front_end.name == "vqwav2vec" else [c.front_end]
        named = [c.racer, "racer"] if c.tokens == "racer" else [c.lexicon]
        lexicon: list[Any] = [self.store.fingerprint, c.seed, c.rhythm, c.motion, *named, s.lexicon]
        made = [*lexicon, *heard, c.window, c.silence.augmentation, c.silence.longest_insert, c.silence.lexemes,
                c.control, c.generator, s.generator]
        read = [*lexicon, *heard, c.window, c.silence.hint, c.silence.lexemes]
        rewarded = [*lexicon, *heard, c.reward, s.reward]
        acted = [*read, *rewarded, c.control, c.statistical, self.sized("interpreter"), s.interpreter, c.episodes]
        parts: dict[str, list[Any]] = {
            "speech": speech, "contrast": [*speech, c.text, s.contrast], "lexicon": lexicon, "generator": made,
            "interpreter": [*read, c.control, self.sized("interpreter"), s.interpreter],
            "interpreter_text": [*read, c.control, c.text, self.sized("interpreter_text"), s.interpreter,
                                 s.interpreter_text],
            "style": [*made, self.sized("style"), s.style], "style_text": [*made, c.text, self.sized("style_text"),
                                                                           s.style],
            "gate": [*read, c.gate, s.gate], "reward": rewarded, "reward_judge": rewarded,
            "episodes": acted, "cql": [*acted, c.cql, s.cql],
        }
        return configs.digest(stage, *[configs.to_dict(p) if dataclasses.is_dataclass(p) else p
                                       for p in parts[stage]])

    def schedule(self, stage: str) -> fitting.FitSettings:
        """How long a stage is trained."""
        schedules = self.config.schedules
        if stage == "interpreter_text" and self.begins_deaf:
            return schedules.interpreter_text
        return getattr(schedules, stage.removesuffix("_text").removesuffix("_judge"))

    @property
    def begins_deaf(self) -> bool:
        """The interpreter that reads the words begins as the audio-only one."""
        return self.config.schedules.interpreter_text.steps > 0

    def sized(self, stage: str) -> Any:
        """The settings of an interpreter: those of the bundle, without text for the audio-only twin."""
        if stage.startswith("interpreter"):
            heard = self.config.interpreter
            return heard if stage.endswith("_text") else heard.without_text()
        own = self.config.style
        return own if stage.endswith("_text") else dataclasses.replace(own, text_features=0, text_blocks=1,
                                                                       text_bottleneck=0)

    @property
    def representation(self) -> Representation:
        """How motion becomes numbers."""
        return representation_of(self.config)

    def seed(self, stage: str) -> int:
        """A seed of its own for each stage."""
        return self.config.seed * 1000 + STAGES.index(stage)

    def stage(self, name: str, model: nn.Module, train: Callable[[Path], dict[str, float]]) -> dict[str, float]:
        """Load a finished stage into `model`, or train it now; its validation figures."""
        folder = self.work / f"{name}-{self.key(name)}"
        weights, figures = folder / "weights.safetensors", folder / "figures.json"
        if not figures.exists():
            folder.mkdir(parents=True, exist_ok=True)
            result = train(folder)
            temporary = folder / "weights.tmp"
            save_file({key: value.detach().cpu().contiguous() for key, value in model.state_dict().items()}, temporary)
            os.replace(temporary, weights)
            write_text(figures, json.dumps(result))
            (folder / f"{name}.ckpt").unlink(missing_ok=True)
        model.cpu().load_state_dict(load_file(weights))
        freeze(model)
        return dict(json.loads(figures.read_text()))

    def fit(self, stage: str, model: nn.Module, make_batch: fitting.MakeBatch, losses: fitting.Losses, folder: Path,
            validate: fitting.Validate, before_step: Callable[[int], None] | None = None) -> dict[str, float]:
        """The one loop, with this run's settings."""
        schedule = self.schedule(stage)
        return fitting.fit(stage, model, make_batch, losses, schedule, folder,
                           seed=self.seed(stage), validate=validate, device=self.device, before_step=before_step,
                           progress=self.progress)


def train_encoder(run: Run) -> tuple[SpeechEncoder, dict[str, dict[str, float]]]:
    """The speech levels: predictive coding on speech alone, then Eq. 1 on speech with text (RG 4.1.3)."""
    coded, figures = _predictive(run)
    every = {"speech": figures}
    encoder = coded
    if run.corpus.words is not None and run.config.schedules.contrast.steps > 0:
        encoder, every["contrast"] = _contrast(run, coded)
    # A bundle keeps half precision: the features to train on are those that it will hear.
    encoder.half().float()
    freeze(encoder)
    return encoder, every


def _predictive(run: Run) -> tuple[SpeechEncoder, dict[str, float]]:
    names = [run.corpus.names[r] for r in run.corpus.recordings("train")]
    held = [run.corpus.names[r] for r in run.corpus.recordings("val") or run.corpus.recordings("train")[:1]]
    return pretrain(run, names, held)


def pretrain(run: Run, names: Sequence[str], held: Sequence[str]) -> tuple[SpeechEncoder, dict[str, float]]:
    """Predictive coding on the speech of recordings `names` of the run's store and of the run's folders of sound;
    checked on recordings `held`."""
    config = run.config
    torch.manual_seed(run.seed("speech"))
    model = PredictiveCoding(SpeechEncoder(config.encoder), config.encoder)
    batch = config.schedules.speech.batch

    def train(folder: Path) -> dict[str, float]:
        length = 3 * config.rhythm.frames * samples_per_frame(SAMPLE_RATE, config.rhythm.fps)
        known = Crops.of_store(run.store, names, run.speech, length)
        check = Crops.of_store(run.store, held, (), length)
        checks = [torch.as_tensor(check.drawn(fitting.generator_for(0, i), 32)) for i in range(4)]

        @torch.no_grad()
        def validate() -> dict[str, float]:
            torch.manual_seed(0)
            return {"predictive": sum(float(model.losses({"samples": b.to(run.device)})["predictive"])
                                      for b in checks) / len(checks)}

        return run.fit("speech", model, lambda rng: {"samples": torch.as_tensor(known.drawn(rng, batch))},
                       model.losses, folder, validate)

    figures = run.stage("speech", model, train)
    return model.encoder, figures


def _contrast(run: Run, encoder: SpeechEncoder) -> tuple[SpeechEncoder, dict[str, float]]:
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("contrast"))
    for parameter in encoder.parameters():
        parameter.requires_grad_(True)
    frames = config.rhythm.frames
    model = TextContrast(encoder, config.encoder, corpus.text_width - 1, frames)
    size = config.schedules.contrast.batch

    def batch_of(recordings: list[int]) -> fitting.MakeBatch:
        # Only blocks in which a word sounds: others have no anchor.
        assert corpus.word_at is not None
        spoken = (corpus.word_at[:, frames:2 * frames] > 0).any(1).numpy()
        sounds = {r: three_blocks(corpus.sound(r)[:, None], np.zeros(())).reshape(-1, 3 * corpus.sound(r).shape[1])
                  for r in recordings}
        begins = {r: int(corpus.blocks_of(r)[0]) for r in recordings}
        blocks = np.concatenate([corpus.blocks_of(r)[spoken[corpus.blocks_of(r)]] for r in recordings])

        def make(rng: np.random.Generator) -> fitting.Batch:
            assert corpus.word_at is not None
            chosen = rng.choice(blocks, size)
            owners = corpus.recording[chosen]
            samples = np.stack([sounds[r][b - begins[r]] for r, b in zip(owners, chosen, strict=True)])
            return {"samples": torch.as_tensor(samples).float(),
                    "text": corpus.text(chosen)[:, frames:2 * frames, :-1],
                    "word": corpus.word_at[torch.as_tensor(chosen), frames:2 * frames].long() - 1}

        return make

    def train(folder: Path) -> dict[str, float]:
        make_batch = batch_of(corpus.recordings("train", with_text=True))
        held = batch_of(corpus.recordings("val", with_text=True) or corpus.recordings("train", with_text=True)[:1])
        checks = [held(fitting.generator_for(1, i)) for i in range(4)]

        @torch.no_grad()
        def validate() -> dict[str, float]:
            on = [{key: value.to(run.device) for key, value in b.items()} for b in checks]
            found = torch.stack([model.retrieval(b) for b in on]).nanmean(0)
            return {"contrast": sum(float(model.losses(b)["contrast"]) for b in on) / len(on),
                    **{f"retrieval_{level + 1}": float(value) for level, value in enumerate(found)}}

        return run.fit("contrast", model, make_batch, model.losses, folder, validate)

    figures = run.stage("contrast", model, train)
    return model.encoder, figures


def train_lexicon(run: Run) -> tuple[Lexicon, dict[str, float]]:
    """The VQ-VAE (RG 5.1)."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("lexicon"))
    model = Lexicon(config.lexicon, config.rhythm.frames, run.representation.width, corpus.statistics.present)
    known, val = (torch.as_tensor(corpus.select(split)) for split in ("train", "val"))
    recording = torch.as_tensor(corpus.recording)
    settings = config.schedules.lexicon

    def make_batch(rng: np.random.Generator) -> fitting.Batch:
        index = known[torch.as_tensor(rng.integers(len(known), size=settings.batch))]
        return {"motion": corpus.motion[index], "mask": corpus.mask[recording[index]]}

    begin = next((s for s in range(settings.steps) if s / settings.steps >= config.lexicon.warm_up), 0)

    def before_step(step: int) -> None:
        if step == begin:
            model.start_codebook(corpus.motion[known].to(run.device), run.seed("lexicon"))

    def validate() -> dict[str, float]:
        return lexicon_figures(model, corpus.motion[val if len(val) else known].to(run.device))

    def train(folder: Path) -> dict[str, float]:
        return run.fit("lexicon", model, make_batch, model.losses, folder, validate, before_step)

    return model, run.stage("lexicon", model, train)


@torch.no_grad()
def lexicon_figures(lexicon: Lexicon, motion: Tensor) -> dict[str, float]:
    """Mean squared errors (normalised features) with and without quantisation, usage and perplexity.

    motion: [B, K, D_m].
    """
    latents = lexicon.latents(motion)
    labels = lexicon.quantizer.labels(latents)
    quantised = torch.cat([lexicon.decode(lexicon.vectors[part]) for part in labels.split(4096)])
    plain = torch.cat([lexicon.decode(part) for part in latents.split(4096)])
    size = lexicon.quantizer.size
    return {"quantised": float((quantised - motion).pow(2).mean()),
            "unquantised": float((plain - motion).pow(2).mean()),
            "usage": float((torch.bincount(labels, minlength=size) > 0).float().mean()),
            "perplexity": perplexity(labels, size)}


def lexeme_speeds(corpus: Corpus, labels: NDArray[np.int64], size: int, representation: Representation, fps: float,
                  most: int = 100) -> NDArray[np.float64]:
    """[S] mean speed of all joints in the training blocks of each lexeme, metres per second of normalised time.

    Measured on the blocks themselves (up to `most` of each lexeme): what the decoder makes of a lexeme is a mean, and
    its small errors from frame to frame look like movement. A lexeme without blocks counts as infinitely fast.
    """
    train, s = corpus.select("train"), corpus.statistics
    speeds = np.full(size, np.inf)
    for lexeme in range(size):
        own = train[labels[train] == lexeme]
        own = own[:: max(1, len(own) // most)][:most]
        if len(own) == 0:
            continue
        each = []
        for block in own:
            poses = s.denormalise(corpus.motion[int(block)].double().numpy(),
                                  int(corpus.speaker_of[corpus.recording[block]]))
            moved = np.diff(positions_of(representation.motion(poses, fps)), axis=0)
            each.append(np.linalg.norm(moved, axis=-1).mean() * fps)
        speeds[lexeme] = np.mean(each)
    return speeds


@dataclasses.dataclass(frozen=True)
class Labelled:
    """The corpus as the lexicon reads it. labels, hinted: [N]; nearest: [S] silent lexeme for each lexeme; active: [N]
    a gesture is made."""

    labels: NDArray[np.int64]
    hinted: NDArray[np.int64]
    silent: NDArray[np.int64]
    nearest: NDArray[np.int64]
    active: NDArray[np.bool_]
    style_numbers: NDArray[np.int64]
    inventory: inventories.Inventory


def label(run: Run, lexicon: Tokens) -> Labelled:
    """Lexemes of all blocks, the silent ones, the hint on silent blocks, and the counts (RG 6.4.1, Eq. 24)."""
    corpus = run.corpus
    labels = token_labels(lexicon, corpus)
    train = corpus.select("train")
    silent = silent_lexemes(run, labels)
    nearest = inventories.nearest_silent(lexicon.vectors.detach().double().numpy(), silent)
    hinted = np.where(corpus.silent & (run.config.silence.hint and len(silent) > 0), nearest[labels], labels)
    numbers = np.zeros(len(labels), dtype=np.int64)
    numbers[train] = np.arange(1, len(train) + 1)
    names = corpus.statistics.speakers
    counts = inventories.count(((names[corpus.speaker_of[r]], hinted[corpus.blocks_of(r)])
                                for r in corpus.recordings("train")), len(lexicon.vectors))
    return Labelled(labels, hinted, silent, nearest, ~np.isin(labels, silent), numbers, counts)


def silent_lexemes(run: Run, labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those that the settings name, or those found: slow, and at home in silence (RG 6.4.1)."""
    corpus, named = run.corpus, run.config.silence.lexemes
    if run.config.tokens == "racer":
        return np.zeros(0, dtype=np.int64)  # RACER knows no silence
    if named:
        if not 0 <= min(named) <= max(named) < run.config.lexicon.size:
            raise InputError("silence.lexemes", f"names {list(named)}", f"there are 0 to {run.config.lexicon.size - 1}")
        return np.array(sorted(set(named)), dtype=np.int64)
    train = corpus.select("train")
    speeds = lexeme_speeds(corpus, labels, run.config.lexicon.size, run.representation, run.config.rhythm.fps)
    return inventories.silent_lexemes(speeds, labels[train], corpus.silent[train])


def _validation(run: Run, labels: NDArray[np.int64], numbers: NDArray[np.int64], text: bool = False
                ) -> list[fitting.Batch]:
    split = "val" if run.corpus.recordings("val", text) else "train"
    windows = Windows(run.corpus, sequences(run.corpus, labels, split, numbers * 0, text), run.config.window,
                      text=text)
    return [batch for batch, _ in zip(windows.tiled(64), range(8), strict=False)]


def train_generator(run: Run, lexicon: Lexicon, labelled: Labelled) -> tuple[Generator, dict[str, float]]:
    """G, E_M, E_A and the style codes (RG 5.2, 5.3), with silent augmentation (RG 6.4.1)."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("generator"))
    model = Generator(config.generator, config.rhythm.frames, run.representation.width, corpus.low.shape[-1],
                      config.lexicon.code_width, int(labelled.style_numbers.max()), CONTROL_WIDTH,
                      corpus.statistics.present)
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers)
    if config.silence.augmentation > 0:
        parts = with_silence(parts, corpus, labelled.nearest, config.silence.augmentation,
                             config.silence.longest_insert, np.random.default_rng([run.seed("generator"), 7]))
    windows = Windows(corpus, parts, config.window, control=config.control if config.generator.use_control else None)
    frozen = freeze(copy.deepcopy(lexicon)).to(run.device)
    assert isinstance(frozen, Lexicon)
    checks = _validation(run, labelled.labels, labelled.style_numbers)

    def with_vectors(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": frozen.vectors[batch["lexeme_index"].to(run.device)]}

    @torch.no_grad()
    def validate() -> dict[str, float]:
        totals = []
        for batch in checks:
            b = {key: value.to(run.device) for key, value in with_vectors(batch).items()}
            zero = torch.zeros(*b["style"][:, 1:].shape, config.generator.style_width, device=run.device)
            made, _ = model.roll_out(b["motion"][:, 0], None, b["audio"][:, 1:], b["lexeme"][:, 1:], zero)
            true = b["motion"][:, 1:]
            totals.append(((made - true).pow(2).mean(), (frozen.encode(made.flatten(0, 1))
                                                         - frozen.encode(true.flatten(0, 1))).pow(2).mean()))
        return {"reconstruction": float(sum(t[0] for t in totals)) / len(totals),
                "perceptual": float(sum(t[1] for t in totals)) / len(totals)}

    def train(folder: Path) -> dict[str, float]:
        return run.fit("generator", model,
                       lambda rng: with_vectors(windows.drawn(rng, config.schedules.generator.batch)),
                       lambda batch, progress: model.losses(batch, progress, frozen.encode), folder, validate)

    return model, run.stage("generator", model, train)


def train_interpreter(run: Run, lexicon: Lexicon, labelled: Labelled, text: bool = False
                      ) -> tuple[LstmInterpreter, dict[str, float]]:
    """The lexeme interpreter (RG 6.1) with text, or from audio alone (RG 6.3); taught the silent hint."""
    stage = "interpreter_text" if text else "interpreter"
    config, corpus, sized = run.config, run.corpus, run.sized(stage)
    torch.manual_seed(run.seed(stage))
    model = LstmInterpreter(sized, config.rhythm.frames, corpus.high.shape[-1], lexicon.vectors,
                            len(corpus.statistics.speakers), corpus.text_width, CONTROL_WIDTH)
    if text and run.begins_deaf:
        model.begin_as(train_interpreter(run, lexicon, labelled)[0])
    windows = Windows(corpus, sequences(corpus, labelled.hinted, "train", labelled.style_numbers, text), config.window,
                      text=text, control=config.control if sized.use_control else None)
    checks = _validation(run, labelled.hinted, labelled.style_numbers, text)

    def as_labels(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": batch["lexeme_index"]}

    @torch.no_grad()
    def validate() -> dict[str, float]:
        right, entropy, count = 0.0, 0.0, 0.0
        for batch in checks:
            b = {key: value.to(run.device) for key, value in as_labels(batch).items()}
            logits, _ = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"], None,
                                     b["text"][:, 1:] if text else None)
            valid, wanted = b["valid"][:, 1:], b["lexeme"][:, 1:]
            right += float(((logits.argmax(-1) == wanted) * valid).sum())
            entropy -= float((torch.log_softmax(logits, -1).gather(-1, wanted[..., None])[..., 0] * valid).sum())
            count += float(valid.sum())
        return {"accuracy": right / count, "cross_entropy": entropy / count}

    def train(folder: Path) -> dict[str, float]:
        return run.fit(stage, model,
                       lambda rng: as_labels(windows.drawn(rng, run.schedule(stage).batch)), model.losses,
                       folder, validate)

    return model, run.stage(stage, model, train)


def train_gate(run: Run, labelled: Labelled) -> tuple[ActivityGate, dict[str, float]]:
    """Whether to gesture at all on a block (RG 8, third limitation)."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("gate"))
    model = ActivityGate(config.gate, config.rhythm.frames, corpus.low.shape[-1], len(corpus.statistics.speakers))
    windows = Windows(corpus, sequences(corpus, labelled.labels, "train", labelled.style_numbers), config.window)
    active = torch.as_tensor(labelled.active.astype(np.float32))

    def with_activity(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "active": active[batch["block"]]}

    checks = [with_activity(b) for b in _validation(run, labelled.labels, labelled.style_numbers)]

    @torch.no_grad()
    def validate() -> dict[str, float]:
        batches = [{key: value.to(run.device) for key, value in b.items()} for b in checks]
        return {"cross_entropy": sum(float(model.losses(b)["activity"]) for b in batches) / len(batches),
                "active": float(active[torch.as_tensor(corpus.select("train"))].mean())}

    def train(folder: Path) -> dict[str, float]:
        return run.fit("gate", model, lambda rng: with_activity(windows.drawn(rng, config.schedules.gate.batch)),
                       model.losses, folder, validate)

    return model, run.stage("gate", model, train)


def train_style(run: Run, lexicon: Lexicon, generator: Generator, labelled: Labelled, text: bool = False
                ) -> tuple[StyleInterpreter, dict[str, float]]:
    """The style interpreter (RG 6.2) on the style codes that the generator learned, with text or from audio alone."""
    stage = "style_text" if text else "style"
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed(stage))
    assert generator.styles is not None
    table = generator.styles.table.weight.detach()
    model = StyleInterpreter(run.sized(stage), config.rhythm.frames, corpus.low.shape[-1], lexicon.vectors,
                             config.generator.style_width, len(corpus.statistics.speakers), corpus.text_width)
    # Codes exist for training blocks alone, so a tenth of those recordings is kept for validation.
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers, text)
    kept = parts[::10] if len(parts) >= 10 else []
    windows = Windows(corpus, [p for i, p in enumerate(parts) if not kept or i % 10], config.window, text=text)
    checks = list(Windows(corpus, kept or parts, config.window, text=text).tiled(64))[:8]

    def with_codes(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": batch["lexeme_index"], "code": table[batch["style"]]}

    @torch.no_grad()
    def validate() -> dict[str, float]:
        batches = [{key: value.to(run.device) for key, value in with_codes(b).items()} for b in checks]
        error = sum(float(model.losses(b)["code"]) for b in batches) / len(batches)
        return {"code_error": error, "code_variance": float(table[1:].var(0).mean())}

    def train(folder: Path) -> dict[str, float]:
        return run.fit(stage, model, lambda rng: with_codes(windows.drawn(rng, config.schedules.style.batch)),
                       model.losses, folder, validate)

    return model, run.stage(stage, model, train)


def train(config: Config, store: Store, out: Path, work: Path, *, device: str = "cpu", workers: int = 1,
          progress: bool = True, redo: Sequence[str] = (), only: str | None = None, speech: Sequence[Path] = ()
          ) -> bundles.Bundle | None:
    """Run every stage that is not finished and write the bundle; None when `only` stops before the last stage.

    speech: folders of more sound for the predictive coding of the speech encoder.
    """
    work.mkdir(parents=True, exist_ok=True)
    _claim(work, store)
    run = Run(config, store, work, device, progress, tuple(speech))
    for stage in redo:
        shutil.rmtree(work / f"{stage}-{run.key(stage)}", ignore_errors=True)
    run.corpus = prepare(store, config, work, workers=workers, progress=progress)
    if run.corpus.words is None and any(stage.endswith("_text") for stage in _wanted(run)):
        raise InputError(store.path, "has no recording with words", "set text.encoder= (nothing) to train without text")
    encoder, every = None, dict[str, Any]()
    if only is not None and only not in (*_FIRST, *_wanted(run)):
        raise InputError(f"--stage {only}", "is not part of these settings", "see text, gate and front_end in --set")
    if config.front_end.name == "vqwav2vec" and only != "lexicon":
        encoder, every = train_encoder(run)
        if only in ("speech", "contrast"):
            return None
        run.corpus = prepare(store, config, work, encoder, workers=workers, progress=progress)
    tokens: Tokens
    tokens, every["lexicon"] = train_codec(run) if config.tokens == "racer" else train_lexicon(run)
    if only == "lexicon":
        return None
    labelled = label(run, tokens)
    models = _models(run, tokens, labelled, every, only)
    if only:
        return None
    trained = bundles.Bundle(
        config, run.corpus.statistics, tokens, models.get("generator"), models.get("interpreter"),
        models.get("style"), labelled.inventory, labelled.silent, _provenance(run), every, encoder=encoder,
        gate=models.get("gate"), q_network=models.get("cql"), reward=models.get("reward"),
        reward_judge=models.get("reward_judge"), interpreter_text=models.get("interpreter_text"),
        style_text=models.get("style_text"),
        text=bundles.TextSource.of(config, run.corpus.text_width))
    bundles.save(trained, out, model_card(trained))
    return trained


def _models(run: Run, tokens: Tokens, labelled: Labelled, every: dict[str, Any], only: str | None) -> dict[str, Any]:
    """The stages after the lexicon, by name; their figures go to `every`."""
    models: dict[str, Any] = {}
    made: tuple[nn.Module, dict[str, float]]
    for stage in (name for name in _wanted(run) if only in (None, name) or name in _NEEDS.get(only, ())):
        if stage.startswith("reward"):
            made = train_reward(run, tokens, labelled, stage == "reward_judge")
        elif stage == "cql":
            made = train_q_network(run, tokens, labelled, models["reward"], models.get("interpreter"))
        elif stage == "gate":
            made = train_gate(run, labelled)
        else:
            assert isinstance(tokens, Lexicon)
            made = _drawn(run, stage, tokens, labelled, models)
        models[stage], every[stage] = made
    return models


def _drawn(run: Run, stage: str, lexicon: Lexicon, labelled: Labelled, models: dict[str, Any]
           ) -> tuple[nn.Module, dict[str, float]]:
    """The stages of Rhythmic Gesticulator alone."""
    text = stage.endswith("_text")
    if stage.startswith("interpreter"):
        return train_interpreter(run, lexicon, labelled, text)
    if stage == "generator":
        return train_generator(run, lexicon, labelled)
    return train_style(run, lexicon, models["generator"], labelled, text)


_FIRST = ("speech", "contrast", "lexicon")
_NEEDS: dict[str | None, tuple[str, ...]] = {
    "style": ("generator",), "style_text": ("generator",), "cql": ("interpreter", "reward")}
"""What else is trained, or read, when one stage alone is asked for."""


def _wanted(run: Run) -> list[str]:
    """The stages that these settings ask for, in order, after the speech encoder and the lexicon."""
    config = run.config
    racer = ["reward", "reward_judge", "cql"] if config.schedules.cql.steps else []
    if config.tokens == "racer":
        return racer
    stages = ["interpreter", "gate", *racer, "generator", "style"]
    if config.schedules.gate.steps == 0:
        stages.remove("gate")
    if config.text.encoder and config.interpreter.reads:
        stages.insert(0, "interpreter_text")
    if config.text.encoder and config.style.text_features:
        stages.append("style_text")
    return stages


def _claim(work: Path, store: Store) -> None:
    """A work folder belongs to one store."""
    record = work / "store.json"
    if record.exists():
        known = json.loads(record.read_text()).get("fingerprint")
        if known != store.fingerprint:
            raise InputError(store.path, f"is not the store that {work} was started with (its settings or contents "
                             "differ)", "give another --work folder or delete that one")
    else:
        write_text(record, json.dumps({"fingerprint": store.fingerprint}))


def _provenance(run: Run) -> dict[str, Any]:
    store, corpus = run.store, run.corpus
    hours = {split: round(float(corpus.durations[corpus.select(split)].sum()) / 3600, 3)
             for split in ("train", "val", "test")}
    return {"store": store.corpus, "fingerprint": store.fingerprint, "licence": store.licence, "seed": store.seed,
            "hours": hours, "blocks": len(corpus.silent), "more_speech": [folder.name for folder in run.speech]}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("gesticulator.train", description="Train a bundle from a store.")
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by python -m data_module.build")
    p.add_argument("--out", required=True, metavar="BUNDLE", help="the folder to write the bundle to")
    p.add_argument("--preset", default="default", help=", ".join(configs.PRESETS))
    p.add_argument("--speech", action="append", default=[], metavar="DIR",
                   help="a folder of more sound (no motion, no text) for the speech encoder's first stage")
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for example generator.lstm_width=320")
    p.add_argument("--work", metavar="DIR", help="where stages are kept (default: BUNDLE.work); resumed when there")
    p.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    p.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="threads of torch (default: all cores)")
    p.add_argument("--stage", choices=STAGES, help="train this stage (and what it needs) and stop")
    p.add_argument("--redo", action="append", default=[], choices=STAGES, help="train this stage again")
    p.add_argument("--seed", type=int, help="the seed of the run")
    p.add_argument("--quiet", action="store_true", help="no progress bars")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    arguments = parser().parse_args(argv)
    with one_line_errors("gesticulator.train"):
        if arguments.device == "cuda" and not torch.cuda.is_available():
            raise InputError("--device cuda", "there is no CUDA device", "use --device cpu")
        torch.set_num_threads(max(1, arguments.threads))
        config = configs.with_settings(configs.preset(arguments.preset), arguments.settings)
        if arguments.seed is not None:
            config = dataclasses.replace(config, seed=arguments.seed)
        out = Path(arguments.out)
        work = Path(arguments.work) if arguments.work else out.with_name(out.name + ".work")
        made = train(config, Store.open(arguments.data), out, work, device=arguments.device,
                     workers=max(1, arguments.threads), progress=not arguments.quiet, redo=arguments.redo,
                     only=arguments.stage, speech=[Path(folder) for folder in arguments.speech])
        if made is not None:
            print(f"{out}: trained on {made.provenance['hours']['train']} h; "
                  + "; ".join(f"{stage} " + ", ".join(f"{k} {v:.4g}" for k, v in own.items())
                              for stage, own in made.figures.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
