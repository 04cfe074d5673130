"""Training end to end on the tiny preset: stages, resuming, refusals, and what the models learned."""

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
import torch
from safetensors.torch import load_file

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh
from data_module.store import Recording, Store
from gesticulator import infer
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.bundle.files import read_index
from gesticulator.cli import main
from gesticulator.training import fit as fitting
from gesticulator.training import presets
from gesticulator.training.stages import BLOCKS, LABELS, STAGES, Run, training
from gesticulator.training.stages.corpus import prepare
from gesticulator.training.stages.windows import Windows, sequences, with_silence

SIZES = {"speech": 6, "contrast": 6, "lexicon": 40, "interpreter": 10, "interpreter_text": 10, "gate": 6,
         "reward": 6, "reward_judge": 6, "q_network": 14, "generator": 12, "style": 8,
         "style_text": 8}
"""Steps of every stage of a short run, in the order in which the stages are trained."""
SCHEDULES = [STAGES[stage].schedule for stage in SIZES if not stage.endswith(("_text", "_judge"))]
SHORT = [f"schedules.{STAGES[stage].schedule}.steps={steps}" for stage, steps in SIZES.items()
         if not stage.endswith(("_text", "_judge"))]
BATTERY = set(STAGES) - {"codec"}
"""The stages of the tiny preset."""


def train_short(store: Store, out: Path, work: Path) -> None:
    training.train(Run(short(), store, work, progress=False), out)


def short() -> configs.Config:
    return configs.with_settings(presets.preset("tiny"), SHORT)


@pytest.fixture(scope="module")
def work(tiny_bundle: Path) -> Path:
    return tiny_bundle.with_name(tiny_bundle.name + ".work")


def test_every_stage_learned(work: Path) -> None:
    # The generator is fed the truth at first and its past output later, so its reconstruction gets worse, and what it
    # gains on a minute of unseen speech is within chance. That its blocks become those of their lexemes is not.
    for stage, term in (("speech", "predictive"), ("contrast", "contrast"), ("lexicon", "reconstruction"),
                        ("generator", "lexeme"), ("interpreter", "nll"),
                        ("interpreter_text", "nll"), ("style", "code"), ("style_text", "code"),
                        ("gate", "activity"), ("reward", "contrast"),
                        ("reward_judge", "contrast"), ("q_network", "conservative")):
        log = next(iter(work.glob(f"{stage}-*/{stage}.jsonl")))
        rows = [json.loads(line) for line in log.read_text().splitlines()]
        values = [row[term] for row in rows if term in row]
        few = min(5, len(values) // 4)
        # Twenty steps are enough for the first two to have begun, eighty for the interpreters to lose a few per cent.
        most = {"speech": 0.99, "contrast": 0.99, "generator": 0.7}.get(stage, 0.97)
        assert np.mean(values[-few:]) < most * np.mean(values[:few]), f"{stage}: {values[0]} to {values[-1]}"
        assert [row["step"] for row in rows] == list(range(len(rows)))


class Killed(Exception):
    pass


def with_caches(work: Path, folder: Path) -> Path:
    """A new work folder that has the blocks and the word vectors of another already."""
    folder.mkdir()
    for cached in (*work.glob("blocks-*"), *work.glob("words-*")):
        (shutil.copytree if cached.is_dir() else shutil.copy)(cached, folder / cached.name)
    return folder


def test_a_run_killed_in_every_stage_and_resumed_is_the_unbroken_run(
        tiny_store: Path, work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.open(tiny_store)
    train_short(store, tmp_path / "whole", with_caches(work, tmp_path / "whole.work"))
    broken, one_step = with_caches(work, tmp_path / "broken.work"), fitting._Learner.step
    plain = fitting.fit
    monkeypatch.setattr(fitting, "fit", lambda *given: plain(
        *given[:-1], dataclasses.replace(given[-1], checkpoint_seconds=-1.0)))  # a checkpoint each step
    left = 0
    for stage, size in SIZES.items():
        count, limit = 0, left + size // 2  # the rest of the stage before, and half of this one
        left = size - size // 2

        def counted(*arguments: object, limit: int = limit) -> object:
            nonlocal count
            count += 1
            if count > limit:
                raise Killed
            return one_step(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(fitting._Learner, "step", counted)
        with pytest.raises(Killed):
            train_short(store, tmp_path / "broken", broken)
        folder = next(iter(broken.glob(f"{stage}-*")))
        assert (folder / f"{stage}.ckpt").exists() and not (folder / "figures.json").exists(), stage
        assert not (tmp_path / "broken").exists(), "no bundle before the end"
    monkeypatch.setattr(fitting._Learner, "step", one_step)
    train_short(store, tmp_path / "broken", broken)
    names = sorted(file.name for file in (tmp_path / "whole").glob("*.safetensors"))
    assert len(names) == 10 and names == sorted(file.name for file in (tmp_path / "broken").glob("*.safetensors"))
    for name in names:
        a, b = (load_file(tmp_path / run / name) for run in ("whole", "broken"))
        assert a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a), name
    whole, again = (read_index(tmp_path / run)["figures"] for run in ("whole", "broken"))
    assert set(whole) == set(SIZES) and whole == again


HEARD = {"contrast", "interpreter", "interpreter_text", "gate", "planner", "generator", "style", "style_text", "reward",
         "reward_judge", "q_network", "q_network_literal"}
"""What follows the first stage of the speech encoder."""
MADE, READ = {"generator", "style", "style_text"}, {"interpreter", "interpreter_text"}


def keys(store: Store, work: Path, *settings: str) -> dict[str, str]:
    run = Run(configs.with_settings(presets.preset("tiny"), settings), store, work)
    return {name: run.key(stage) for name, stage in STAGES.items()}


@pytest.mark.parametrize(("setting", "stages"), [
    ("style.width=33", {"style", "style_text"}),
    ("generator.lstm_width=50", MADE),
    ("silence.augmentation=0.1", MADE),
    ("silence.lexemes=[1,2]", HEARD - {"contrast"}),  # rivals of the reward models follow the hinted lexemes
    ("control.free=0.6", {*MADE, *READ, "q_network"}),  # the interpreter acts in the Q-network's data set
    ("interpreter.width=49", {*READ, "q_network"}),
    ("reward.width=17", {"reward", "q_network", "q_network_literal"}),
    ("judge.width=17", {"reward_judge"}),
    ("episodes.prefix=4", {"q_network"}),
    ("cql.width=18", {"q_network"}), ("schedules.cql.steps=31", {"q_network"}), ("selection.q_temperature=1.0", set()),
    ("cql_literal.width=18", {"q_network_literal"}), ("schedules.cql_literal.steps=31", {"q_network_literal"}),
    ("gate.width=17", {"gate"}), ("planner.width=17", {"planner"}),
    ("interpreter.text_features=9", {"interpreter_text"}),
    ("style.text_features=9", {"style_text"}),
    ("schedules.contrast.steps=21", HEARD),
    ("encoder.width=17", {"speech", *HEARD}),
    ("schedules.speech.steps=21", {"speech", *HEARD}),
    ("front_end.name=mel", HEARD - {"contrast"}),
    ("lexicon.size=13", {"lexicon", *HEARD} - {"contrast"}),
    ("motion.representation=positions", {"lexicon", *HEARD} - {"contrast"}),
    ("rhythm.beats.d_max=0.6", BATTERY),
    ("seed=2", BATTERY),
    ("selection.temperature=0.5", set()), ("selection.activity=0.5", set()),
])
def test_only_what_a_setting_shapes_is_trained_again(setting: str, stages: set[str], tiny_store: Path, work: Path
                                                     ) -> None:
    store = Store.open(tiny_store)
    base, other = keys(store, work), keys(store, work, setting)
    assert len(set(base.values())) == len(base)
    assert {stage for stage in BATTERY if base[stage] != other[stage]} == stages


@pytest.mark.parametrize(("arguments", "said"), [
    (["--data", "nowhere"], "nowhere"), (["--preset", "huge"], "huge"), (["--set", "lexicon.siez=3"], "siez"),
    (["--set", "motion.representation=dance"], "dance"),
    (["--set", "front_end.name=ears"], "ears"), (["--set", "encoder.width=0"], "encoder.width"),
    (["--set", "schedules.lexicon.steps=-3"], "schedules.lexicon.steps"), (["--set", "lexicon.size=0"], "lexicon.size"),
    (["--set", "front_end.bands=0"], "front_end.bands"), (["--set", "generator.lexeme=NaN"], "generator.lexeme"),
    (["--threads", "0"], "--threads 0"), (["--seed", "-1"], "seed"),
    (["--seed", str(2**31)], "seed"),
])
def test_bad_arguments_are_one_line_and_exit_code_2(tiny_store: Path, work: Path, tmp_path: Path,
                                                    arguments: list[str], said: str,
                                                    refused: Any) -> None:
    assert said in refused("train", "--data", tiny_store, "--out", tmp_path / "b", "--preset", "tiny", "--quiet",
                           "--threads", "1", "--work", with_caches(work, tmp_path / "work"), *arguments)
    assert not (tmp_path / "b").exists()


def test_a_store_without_words_is_refused_before_a_block_is_cut(tiny_store: Path, tmp_path: Path,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    load = Store.load

    def unsaid(store: Store, *asked: Any) -> Recording:
        recording = load(store, *asked)
        return dataclasses.replace(recording, speech=dataclasses.replace(recording.speech, words=None))

    monkeypatch.setattr(Store, "load", unsaid)
    with pytest.raises(InputError, match=r"no recording with words.* --set text\.encoder= "):
        train_short(Store.open(tiny_store), tmp_path / "b", tmp_path / "work")
    assert not list((tmp_path / "work").glob("blocks-*"))


@pytest.mark.skipif(os.name != "posix", reason="Ctrl C is sent to a group of processes, which Windows lacks")
def test_ctrl_c_says_how_to_go_on_and_leaves_no_traceback(tiny_store: Path, tmp_path: Path) -> None:
    """While processes cut blocks, and again while a stage is trained; the second run goes on from the first."""
    command = [sys.executable, "-m", "gesticulator", "train", "--data", str(tiny_store), "--out", str(tmp_path / "b"),
               "--preset", "tiny", "--threads"]
    for threads, sign in (("2", "blocks:"), ("1", "stage 1 of 12: speech")):
        lines = ""
        with subprocess.Popen([*command, threads], stderr=subprocess.PIPE, text=True,
                              start_new_session=True) as process:
            assert process.stderr is not None
            while sign not in lines:
                character = process.stderr.read(1)
                assert character, lines
                lines += character
            os.killpg(process.pid, signal.SIGINT)
            lines += process.stderr.read()
        assert process.returncode == 130 and "Traceback" not in lines, lines
        assert f"the same command goes on from what {tmp_path / 'b'}.work holds" in lines
    assert len(list((tmp_path / "b.work").glob("blocks-*/*.npz"))) == 9 and not (tmp_path / "b").exists()


def test_silent_augmentation_holds_poses_and_keeps_its_budget(tiny_store: Path, work: Path) -> None:
    config = presets.preset("tiny")
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
    corpus = prepare(Store.open(tiny_store), presets.preset("tiny"), work, progress=False)
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


def test_the_silent_hint_names_a_silent_lexeme_on_silent_blocks_alone(tiny_store: Path, work: Path) -> None:
    for hint in (True, False):
        run = started(tiny_store, work, f"silence.hint={str(hint).lower()}")
        labelled, silent = run.get(LABELS), run.get(BLOCKS).silent
        assert silent.any() and not silent.all()
        np.testing.assert_array_equal(labelled.hinted[~silent], labelled.labels[~silent])
        if hint:
            assert set(labelled.hinted[silent].tolist()) <= set(labelled.silent.tolist())
            np.testing.assert_array_equal(labelled.hinted[silent], labelled.nearest[labelled.labels[silent]])
        else:
            np.testing.assert_array_equal(labelled.hinted, labelled.labels)


def started(tiny_store: Path, work: Path, *settings: str) -> Run:
    return Run(configs.with_settings(presets.preset("tiny"), settings), Store.open(tiny_store), work, progress=False)


def test_silent_lexemes_by_hand_are_taken_as_told(tiny_store: Path, work: Path) -> None:
    run = started(tiny_store, work, "silence.lexemes=[7,2,7]")
    labelled = run.get(LABELS)
    assert labelled.silent.tolist() == [2, 7]
    assert set(labelled.hinted[run.get(BLOCKS).silent].tolist()) <= {2, 7}
    np.testing.assert_array_equal(labelled.active, ~np.isin(labelled.labels, [2, 7]))
    with pytest.raises(InputError, match=r"silence\.lexemes.*0 to 11"):
        started(tiny_store, work, "silence.lexemes=[12]").get(LABELS)


def test_ten_joints_in_space_are_trained_on_and_become_a_skeleton(tiny_store: Path, tmp_path: Path) -> None:
    settings = ["motion.representation=positions", "lexicon.warm_up=0.5",
                *(f"schedules.{stage}.steps=10" for stage in SCHEDULES)]
    out = tmp_path / "bundle"
    assert main(["train", "--data", str(tiny_store), "--out", str(out), "--preset", "tiny", "--threads", "1", "--quiet",
                 *(part for setting in settings for part in ("--set", setting))]) == 0
    bundle = bundles.load(out)
    assert bundle.lexicon.motion_width == 30
    present = bundle.statistics.present.reshape(10, 3).astype(bool)
    assert not present[0].any() and present[1:].all(), "the spine is the origin"
    sound = tmp_path / "speech.wav"
    soundfile.write(sound, Store.open(tiny_store).load("talk_0007_puppet").speech.samples[:48000], 16000)
    assert infer.main([str(sound), "-o", str(tmp_path / "o.bvh"), "--bundle", str(out), "--quiet", "--fps", "20"]) == 0
    motion = read_bvh(tmp_path / "o.bvh")
    assert motion.duration == pytest.approx(3.0, abs=0.05) and np.isfinite(motion.rotations).all()
    still = motion.rotations[:, motion.skeleton.index("LeftHand")]
    np.testing.assert_allclose(np.abs(still[:, 0]), 1.0, atol=1e-6)  # ten points tell nothing of a hand's turn
    assert np.ptp(motion.rotations[:, motion.skeleton.index("RightForeArm")], axis=0).max() > 1e-3
