"""Training end to end on the tiny preset: stages, resuming, refusals, and what the models learned."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from data_module.errors import InputError
from data_module.store import Store
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator import train
from gesticulator.prepare import Windows, prepare, sequences, with_silence

SHORT = ["schedules.lexicon.steps=40", "schedules.generator.steps=12", "schedules.interpreter.steps=10",
         "schedules.style.steps=8"]


def short() -> configs.Config:
    return configs.with_settings(configs.preset("tiny"), SHORT)


@pytest.fixture(scope="module")
def work(tiny_bundle: Path) -> Path:
    return tiny_bundle.with_name(tiny_bundle.name + ".work")


def test_every_stage_learned(work: Path) -> None:
    # The generator is fed the truth at first and its own past later, so its training loss rises; what it does on
    # unseen speech, always with its own past, must get better.
    for stage, term in (("lexicon", "reconstruction"), ("generator", "val_reconstruction"),
                        ("interpreter", "cross_entropy"), ("style", "code")):
        log = next(iter(work.glob(f"{stage}-*/{stage}.jsonl")))
        rows = [json.loads(line) for line in log.read_text().splitlines()]
        values = [row[term] for row in rows if term in row]
        few = min(5, len(values) // 4)
        assert np.mean(values[-few:]) < 0.95 * np.mean(values[:few]), f"{stage}: {values[0]} to {values[-1]}"
        assert [row["step"] for row in rows] == list(range(len(rows)))


def test_the_lexicon_uses_its_codes_and_beats_the_mean(tiny_bundle: Path) -> None:
    figures = bundles.read_index(tiny_bundle)["figures"]["lexicon"]
    assert figures["usage"] > 0.3  # one recording of 25 s
    assert figures["quantised"] < 0.8  # features have variance near 1


class Killed(Exception):
    pass


def test_a_run_killed_in_any_stage_and_resumed_is_the_unbroken_run(
        tiny_store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.open(tiny_store)
    train.train(short(), store, tmp_path / "whole", tmp_path / "whole.work", progress=False)
    real = fitting._one_step
    for kill_at in (17, 45, 58, 66):
        count = 0

        def counted(*arguments: object, limit: int = kill_at) -> object:
            nonlocal count
            count += 1
            if count > limit:
                raise Killed
            return real(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(fitting, "_one_step", counted)
        monkeypatch.setattr(fitting.time, "monotonic", iter(range(0, 10**7, 1000)).__next__)  # checkpoint each step
        shutil.rmtree(tmp_path / "broken.work", ignore_errors=True)
        with pytest.raises(Killed):
            train.train(short(), store, tmp_path / "broken", tmp_path / "broken.work", progress=False)
        assert not (tmp_path / "broken").exists(), "no bundle before the end"
        monkeypatch.undo()
        train.train(short(), store, tmp_path / "broken", tmp_path / "broken.work", progress=False)
        for name in ("lexicon", "generator", "lexeme_interpreter", "style_interpreter", "statistics"):
            a, b = (load_file(tmp_path / run / f"{name}.safetensors") for run in ("whole", "broken"))
            assert a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a), (kill_at, name)
        shutil.rmtree(tmp_path / "broken")


def test_only_what_a_setting_shapes_is_trained_again(tiny_store: Path, work: Path) -> None:
    store = Store.open(tiny_store)
    base = train.Run(configs.preset("tiny"), store, work)

    def changed(*settings: str) -> set[str]:
        other = train.Run(configs.with_settings(base.config, settings), store, work)
        return {stage for stage in train.STAGES if base.key(stage) != other.key(stage)}

    assert changed("style.width=33") == {"style"}
    assert changed("generator.lstm_width=50") == {"generator", "style"}
    assert changed("silence.hint=false") == {"interpreter"}
    assert changed("silence.augmentation=0.1") == {"generator", "style"}
    assert changed("lexicon.size=13") == set(train.STAGES)
    assert changed("rhythm.beats.d_max=0.6") == set(train.STAGES)
    assert changed("selection.temperature=0.5") == set()


def test_another_store_is_refused_in_a_used_work_folder(tiny_store: Path, work: Path, tmp_path: Path) -> None:
    class Other:
        path, fingerprint = tiny_store, "another"

    with pytest.raises(InputError, match="not the store"):
        train._claim(work, Other())  # type: ignore[arg-type]


@pytest.mark.parametrize(("arguments", "said"), [
    (["--data", "nowhere"], "nowhere"), (["--preset", "huge"], "huge"), (["--set", "lexicon.siez=3"], "siez"),
])
def test_bad_arguments_are_one_line_and_exit_code_2(tiny_store: Path, tmp_path: Path, arguments: list[str], said: str,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    base = ["--data", str(tiny_store), "--out", str(tmp_path / "b"), "--preset", "tiny", "--quiet"]
    with pytest.raises(SystemExit) as stop:
        train.main(base + arguments)
    error = capsys.readouterr().err
    assert stop.value.code == 2 and said in error and error.count("\n") == 1
    assert not (tmp_path / "b").exists()


def test_silent_augmentation_holds_poses_and_keeps_its_budget(tiny_store: Path, work: Path) -> None:
    config = configs.preset("tiny")
    corpus = prepare(Store.open(tiny_store), config, work, progress=False)
    labels = np.arange(len(corpus.silent)) % config.lexicon.size
    nearest = np.full(config.lexicon.size, 3)
    parts = sequences(corpus, labels, "train", np.arange(len(labels)) + 1)
    longer = with_silence(parts, corpus, nearest, 0.05, 10, np.random.default_rng(0))
    before, after = (sum(len(p.motion) for p in own) for own in (parts, longer))
    assert (after - before) / after == pytest.approx(0.05, abs=0.01)
    for part in longer:
        held = np.flatnonzero(part.held)
        assert (part.style[held] == 0).all() and (part.lexeme[held] == 3).all()
        assert corpus.silent[part.audio[held]].all()
    windows = Windows(corpus, longer, config.window)
    p = next(i for i, part in enumerate(longer) if part.held.any())
    at = int(np.flatnonzero(longer[p].held)[0])
    start = max(0, min(at - 1, len(longer[p].motion) - windows.length))
    motion = windows.batch(np.array([[p, start]]))["motion"][0]
    inserted, previous = motion[at - start], motion[at - start - 1]
    assert torch.equal(inserted, previous[-1:].expand_as(inserted)), "the last pose before it, on every frame"


def test_windows_tile_every_block_and_short_recordings_are_marked(tiny_store: Path, work: Path) -> None:
    corpus = prepare(Store.open(tiny_store), configs.preset("tiny"), work, progress=False)
    labels = np.zeros(len(corpus.silent), dtype=np.int64)
    numbers = np.arange(len(labels)) + 1
    parts = sequences(corpus, labels, "train", numbers)
    seen = set()
    for batch in Windows(corpus, parts, 8).tiled(16):
        seen |= set(batch["style"].flatten().tolist())
    assert seen == {int(n) for part in parts for n in part.style}
    longest = max(len(part.motion) for part in parts)
    batch = next(iter(Windows(corpus, parts, longest + 4).tiled(4)))
    assert (batch["valid"].sum(1) < longest + 5).all()


def test_statistics_undo_themselves_and_centre_each_speaker(tiny_store: Path, work: Path) -> None:
    corpus = prepare(Store.open(tiny_store), configs.preset("tiny"), work, progress=False)
    s = corpus.statistics
    poses = np.random.default_rng(0).normal(size=(7, s.deviation.size))
    np.testing.assert_allclose(s.denormalise(s.normalise(poses, 0), 0), poses, atol=1e-12)
    train_blocks = corpus.select("train")
    speaker = corpus.speaker_of[corpus.recording[train_blocks]]
    for own in range(len(s.speakers)):
        assert np.abs(corpus.motion[train_blocks[speaker == own]].mean(dim=(0, 1)).numpy()).max() < 1e-3


def test_the_silent_hint_names_a_silent_lexeme_on_silent_blocks_alone(tiny_store: Path, work: Path) -> None:
    config = configs.preset("tiny")
    for hint in (True, False):
        own = configs.with_settings(config, [f"silence.hint={str(hint).lower()}"])
        run = train.Run(own, Store.open(tiny_store), work, progress=False)
        run.corpus = prepare(run.store, own, work, progress=False)
        lexicon, _ = train.train_lexicon(run)
        labelled = train.label(run, lexicon)
        silent = run.corpus.silent
        assert silent.any() and not silent.all()
        np.testing.assert_array_equal(labelled.hinted[~silent], labelled.labels[~silent])
        if hint:
            assert set(labelled.hinted[silent].tolist()) <= set(labelled.silent.tolist())
            np.testing.assert_array_equal(labelled.hinted[silent], labelled.nearest[labelled.labels[silent]])
        else:
            np.testing.assert_array_equal(labelled.hinted, labelled.labels)
