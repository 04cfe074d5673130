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

from data_module.errors import InputError, one_line_errors
from data_module.files import write_text
from data_module.kinematics import positions_of
from data_module.layers import freeze
from data_module.skeletons import from_vector
from data_module.store import Store
from generator.model import Generator
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator.card import model_card
from gesticulator.config import Config
from gesticulator.prepare import MOTION_WIDTH, Corpus, Statistics, Windows, prepare, sequences, with_silence
from interpreters.lstm import LstmInterpreter
from interpreters.style import StyleInterpreter
from lexicon import inventory as inventories
from lexicon.autoencoder import Lexicon
from lexicon.quantizer import perplexity

STAGES = ("lexicon", "generator", "interpreter", "style")


@dataclasses.dataclass
class Run:
    """A training run: its settings, its data and its work folder."""

    config: Config
    store: Store
    work: Path
    device: str = "cpu"
    progress: bool = True
    corpus: Corpus = dataclasses.field(init=False)

    def key(self, stage: str) -> str:
        """Hash of everything that shapes a stage: its own settings, those of the stages before it, and the data."""
        c = self.config
        parts: list[Any] = [self.store.fingerprint, c.seed, c.rhythm, c.front_end, c.motion, c.lexicon,
                            c.schedules.lexicon]
        if stage in ("generator", "style"):
            parts += [c.window, c.silence.augmentation, c.silence.longest_insert, c.generator, c.schedules.generator]
        if stage == "interpreter":
            parts += [c.window, c.silence.hint, c.interpreter, c.schedules.interpreter]
        if stage == "style":
            parts += [c.style, c.schedules.style]
        return configs.digest(stage, *[configs.to_dict(p) if dataclasses.is_dataclass(p) else p for p in parts])

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
        return fitting.fit(stage, model, make_batch, losses, getattr(self.config.schedules, stage), folder,
                           seed=self.seed(stage), validate=validate, device=self.device, before_step=before_step,
                           progress=self.progress)


def train_lexicon(run: Run) -> tuple[Lexicon, dict[str, float]]:
    """The VQ-VAE (RG 5.1)."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("lexicon"))
    model = Lexicon(config.lexicon, config.rhythm.frames, MOTION_WIDTH)
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


def lexeme_speeds(lexicon: Lexicon, statistics: Statistics, fps: float) -> NDArray[np.float64]:
    """[S] mean speed of the joints of each decoded lexeme, metres per second of normalised time."""
    with torch.no_grad():
        blocks = lexicon.decode(lexicon.vectors).double().numpy()
    poses = blocks * statistics.deviation + statistics.mean_pose.mean(axis=0)
    positions = [positions_of(from_vector(block, fps)) for block in poses]
    return np.array([np.linalg.norm(np.diff(p, axis=0), axis=-1).mean() * fps for p in positions])


@dataclasses.dataclass(frozen=True)
class Labelled:
    """The corpus as the lexicon reads it. labels, hinted: [N]; nearest: [S] silent lexeme for each lexeme."""

    labels: NDArray[np.int64]
    hinted: NDArray[np.int64]
    silent: NDArray[np.int64]
    nearest: NDArray[np.int64]
    style_numbers: NDArray[np.int64]
    inventory: inventories.Inventory


def label(run: Run, lexicon: Lexicon) -> Labelled:
    """Lexemes of all blocks, the silent ones, the hint on silent blocks, and the counts (RG 6.4.1, Eq. 24)."""
    corpus = run.corpus
    labels = lexicon.label(corpus.motion).numpy()
    train = corpus.select("train")
    speeds = lexeme_speeds(lexicon, corpus.statistics, run.config.rhythm.fps)
    silent = inventories.silent_lexemes(speeds, labels[train], corpus.silent[train])
    nearest = inventories.nearest_silent(lexicon.vectors.detach().double().numpy(), silent)
    hinted = np.where(corpus.silent & run.config.silence.hint, nearest[labels], labels)
    numbers = np.zeros(len(labels), dtype=np.int64)
    numbers[train] = np.arange(1, len(train) + 1)
    names = corpus.statistics.speakers
    counts = inventories.count(((names[corpus.speaker_of[r]], hinted[corpus.blocks_of(r)])
                                for r in corpus.recordings("train")), run.config.lexicon.size)
    return Labelled(labels, hinted, silent, nearest, numbers, counts)


def _validation(run: Run, labels: NDArray[np.int64], numbers: NDArray[np.int64]) -> list[fitting.Batch]:
    split = "val" if run.corpus.recordings("val") else "train"
    windows = Windows(run.corpus, sequences(run.corpus, labels, split, numbers * 0), run.config.window)
    return [batch for batch, _ in zip(windows.tiled(64), range(8), strict=False)]


def train_generator(run: Run, lexicon: Lexicon, labelled: Labelled) -> tuple[Generator, dict[str, float]]:
    """G, E_M, E_A and the style codes (RG 5.2, 5.3), with silent augmentation (RG 6.4.1)."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("generator"))
    model = Generator(config.generator, config.rhythm.frames, MOTION_WIDTH, corpus.low.shape[-1],
                      config.lexicon.code_width, style_blocks=int(labelled.style_numbers.max()))
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers)
    if config.silence.augmentation > 0:
        parts = with_silence(parts, corpus, labelled.nearest, config.silence.augmentation,
                             config.silence.longest_insert, np.random.default_rng([run.seed("generator"), 7]))
    windows = Windows(corpus, parts, config.window)
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


def train_interpreter(run: Run, lexicon: Lexicon, labelled: Labelled) -> tuple[LstmInterpreter, dict[str, float]]:
    """The lexeme interpreter (RG 6.1), taught the silent hint."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("interpreter"))
    model = LstmInterpreter(config.interpreter, config.rhythm.frames, corpus.high.shape[-1], lexicon.vectors,
                            len(corpus.statistics.speakers))
    windows = Windows(corpus, sequences(corpus, labelled.hinted, "train", labelled.style_numbers), config.window)
    checks = _validation(run, labelled.hinted, labelled.style_numbers)

    def as_labels(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": batch["lexeme_index"]}

    @torch.no_grad()
    def validate() -> dict[str, float]:
        right, entropy, count = 0.0, 0.0, 0.0
        for batch in checks:
            b = {key: value.to(run.device) for key, value in as_labels(batch).items()}
            logits, _ = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"])
            valid, wanted = b["valid"][:, 1:], b["lexeme"][:, 1:]
            right += float(((logits.argmax(-1) == wanted) * valid).sum())
            entropy -= float((torch.log_softmax(logits, -1).gather(-1, wanted[..., None])[..., 0] * valid).sum())
            count += float(valid.sum())
        return {"accuracy": right / count, "cross_entropy": entropy / count}

    def train(folder: Path) -> dict[str, float]:
        return run.fit("interpreter", model,
                       lambda rng: as_labels(windows.drawn(rng, config.schedules.interpreter.batch)), model.losses,
                       folder, validate)

    return model, run.stage("interpreter", model, train)


def train_style(run: Run, lexicon: Lexicon, generator: Generator, labelled: Labelled
                ) -> tuple[StyleInterpreter, dict[str, float]]:
    """The style interpreter (RG 6.2) on the style codes that the generator learned."""
    config, corpus = run.config, run.corpus
    torch.manual_seed(run.seed("style"))
    assert generator.styles is not None
    table = generator.styles.table.weight.detach()
    model = StyleInterpreter(config.style, config.rhythm.frames, corpus.low.shape[-1], lexicon.vectors,
                             config.generator.style_width, len(corpus.statistics.speakers))
    # Codes exist for training blocks alone, so a tenth of those recordings is kept for validation.
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers)
    kept = parts[::10] if len(parts) >= 10 else []
    windows = Windows(corpus, [p for i, p in enumerate(parts) if not kept or i % 10], config.window)
    checks = list(Windows(corpus, kept or parts, config.window).tiled(64))[:8]

    def with_codes(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": batch["lexeme_index"], "code": table[batch["style"]]}

    @torch.no_grad()
    def validate() -> dict[str, float]:
        batches = [{key: value.to(run.device) for key, value in with_codes(b).items()} for b in checks]
        error = sum(float(model.losses(b)["code"]) for b in batches) / len(batches)
        return {"code_error": error, "code_variance": float(table[1:].var(0).mean())}

    def train(folder: Path) -> dict[str, float]:
        return run.fit("style", model, lambda rng: with_codes(windows.drawn(rng, config.schedules.style.batch)),
                       model.losses, folder, validate)

    return model, run.stage("style", model, train)


def train(config: Config, store: Store, out: Path, work: Path, *, device: str = "cpu", workers: int = 1,
          progress: bool = True, redo: Sequence[str] = (), only: str | None = None) -> bundles.Bundle | None:
    """Run every stage that is not finished and write the bundle; None when `only` stops before the last stage."""
    work.mkdir(parents=True, exist_ok=True)
    _claim(work, store)
    run = Run(config, store, work, device, progress)
    for stage in redo:
        shutil.rmtree(work / f"{stage}-{run.key(stage)}", ignore_errors=True)
    run.corpus = prepare(store, config, work, workers=workers, progress=progress)
    lexicon, figures = train_lexicon(run)
    every: dict[str, Any] = {"lexicon": figures}
    if only == "lexicon":
        return None
    labelled = label(run, lexicon)
    if only in (None, "interpreter"):
        interpreter, every["interpreter"] = train_interpreter(run, lexicon, labelled)
        if only:
            return None
    generator, every["generator"] = train_generator(run, lexicon, labelled)
    if only == "generator":
        return None
    style, every["style"] = train_style(run, lexicon, generator, labelled)
    if only:
        return None
    trained = bundles.Bundle(config, run.corpus.statistics, lexicon, generator, interpreter, style, labelled.inventory,
                             labelled.silent, _provenance(store, run.corpus), every)
    bundles.save(trained, out, model_card(trained))
    return trained


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


def _provenance(store: Store, corpus: Corpus) -> dict[str, Any]:
    hours = {split: round(float(corpus.durations[corpus.select(split)].sum()) / 3600, 3)
             for split in ("train", "val", "test")}
    return {"store": store.corpus, "fingerprint": store.fingerprint, "licence": store.licence, "seed": store.seed,
            "hours": hours, "blocks": len(corpus.silent)}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("gesticulator.train", description="Train a bundle from a store.")
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by python -m data_module.build")
    p.add_argument("--out", required=True, metavar="BUNDLE", help="the folder to write the bundle to")
    p.add_argument("--preset", default="default", help="default, paper-trinity, paper-chinese or tiny")
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
                     only=arguments.stage)
        if made is not None:
            print(f"{out}: trained on {made.provenance['hours']['train']} h; "
                  + "; ".join(f"{stage} " + ", ".join(f"{k} {v:.4g}" for k, v in own.items())
                              for stage, own in made.figures.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
