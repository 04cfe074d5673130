"""Another package adds an interpreter with weights: two files of its own and an entry, and none of ours."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file

from data_module.errors import InputError
from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.bundle.bundle import load
from gesticulator.bundle.files import read_index
from gesticulator.training.command import main as train
from interpreters import INTERPRETERS

MODEL = '''
"""A linear layer on the sound of a block."""
from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional

from data_module.settings import Share, Width
from interpreters.base import InterpreterDefaults


@dataclass(frozen=True)
class LoudSettings:
    width: Width = 8
    dropout: Share = 0.0


class LoudInterpreter(nn.Module, InterpreterDefaults):
    name = "loud"
    Settings = LoudSettings

    def __init__(self, settings, audio, lexemes):
        super().__init__()
        self.hidden, self.out = nn.Linear(audio, settings.width), nn.Linear(settings.width, lexemes)

    @classmethod
    def build(cls, settings, sizes):
        return cls(settings, sizes.high, len(sizes.lexemes))

    @property
    def needs(self):
        return frozenset()

    @property
    def weights(self):
        return {"nll": 1.0}

    def logits(self, audio):
        return self.out(torch.tanh(self.hidden(audio.mean(-2))))

    def losses(self, batch, progress=1.0):
        scores = self.logits(batch["audio_high"])
        return {"nll": functional.cross_entropy(scores.flatten(0, 1), batch["lexeme"].flatten())}

    def start(self, speaker, first_lexeme):
        return None

    @torch.inference_mode()
    def step(self, state, features, previous_lexeme):
        return torch.log_softmax(self.logits(features.high).double(), -1).cpu().numpy(), None
'''
STAGE = '''
"""How it is trained."""
from gesticulator.bundle import models
from gesticulator.bundle.config import FitSettings
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Stage
from gesticulator.training.stages.speech import CORPUS
from gesticulator.training.stages.lexicon import LABELS, model_sizes
from gesticulator.training.stages.windows import Windows, sequences, validation


def _train(run, model, folder):
    corpus, labelled = run.get(CORPUS), run.get(LABELS)
    windows = Windows(corpus, sequences(corpus, labelled.labels, "train", labelled.style_numbers), run.config.window)
    checks = validation(corpus, labelled.labels, run.config.window)

    def validate():
        return {"nll": sum(float(model.losses(batch)["nll"].detach()) for batch in checks) / len(checks)}

    batch = run.schedule(LOUD).batch
    return run.fit(LOUD, model, fitting.Task(windows.sample, validate=validate), folder)


LOUD = Stage("loud", settings=("others.loud", "window"), needs=lambda config: (CORPUS, LABELS), part="loud",
             default=FitSettings(steps=30, batch=8, rate=1e-2), wanted=lambda config: "loud" in config.others,
             build=lambda run: models.build("loud", model_sizes(run)), train=_train)
'''
ENTRY = '''
"""The entry, which imports neither the model nor the stage."""
from interpreters import InterpreterEntry

LOUD = InterpreterEntry("the loudness of a block", "loud_package.model:LoudInterpreter", part="loud",
                        stage="loud_package.stage:LOUD")
'''


def install(patch: pytest.MonkeyPatch, *points: EntryPoint) -> None:
    """Make these the entry points of interpreters, as of installed packages."""
    patch.setattr(INTERPRETERS, "_points", {point.name: point for point in points})


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The other package, installed and registered."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "loud_package").mkdir()
    for name, text in (("__init__", ENTRY), ("model", MODEL), ("stage", STAGE)):
        (folder / "loud_package" / f"{name}.py").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        install(patch, EntryPoint("loud", "loud_package:LOUD", INTERPRETERS.group))
        yield
    for name in [name for name in sys.modules if name.startswith("loud_package")]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def trained(package: None, tiny_store: Path, tiny_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with it: the stages of the tiny bundle, which are found in its work folder, and the new one."""
    folder = tmp_path_factory.mktemp("outside")
    work = shutil.copytree(tiny_bundle.with_name(tiny_bundle.name + ".work"), folder / "work")
    before = {path.name for path in work.iterdir()}
    out = folder / "bundle"
    assert train(["--data", str(tiny_store), "--out", str(out), "--work", str(work), "--preset", "tiny", "--threads",
                  "1", "--quiet", "--set", "others.loud.width=6", "--set", "schedules.others.loud.steps=40"]) == 0
    new = {path.name.partition("-")[0] for path in work.iterdir() if path.name not in before}
    assert new == {"loud"}, "another stage was trained again"
    return out


def test_its_weights_learn_and_stand_in_the_bundle_beside_the_others(trained: Path, tiny_bundle: Path) -> None:
    index, other = read_index(trained), read_index(tiny_bundle)
    assert index["format"] == other["format"]
    assert {name: digest for name, digest in index["files"].items() if name not in ("loud.safetensors",
            "MODEL_CARD.md")} == {name: digest for name, digest in other["files"].items() if name != "MODEL_CARD.md"}
    assert index["config"].pop("others") == {"loud": {"width": 6, "dropout": 0.0}}
    assert index["config"]["schedules"].pop("others") == {"loud": {"steps": 40}}
    assert index["config"] == other["config"], "settings that name no other interpreter are written as before"
    assert index["figures"]["loud"]["nll"] < np.log(len(load(trained).vectors))
    assert load_file(trained / "loud.safetensors")["hidden.weight"].shape[0] == 6


def test_it_plays_and_its_plan_is_rendered_again(trained: Path) -> None:
    g = Gesticulator.from_pretrained(trained)
    assert g.interpreters == ("lstm", "cql", "advantage", "statistical", "loud")
    rng = np.random.default_rng(4)
    bursts = np.repeat(rng.random(12) > 0.4, 4000) * rng.normal(scale=0.1, size=48000)
    speech = Speech(bursts.astype(np.float32), 16000)
    first, deaf = (
        g(speech, interpreter=name, temperature=1.0, seed=2) for name in ("loud", "statistical"))
    assert not np.allclose(first.scores, deaf.scores)
    assert first.plan().interpreter == "loud"
    again = g(speech, plan=first.plan())
    np.testing.assert_array_equal(first.rotations, again.rotations)


def test_a_bundle_whose_interpreter_is_not_installed_says_so(trained: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    with pytest.raises(InputError, match=r"others\.loud"):
        load(trained)
