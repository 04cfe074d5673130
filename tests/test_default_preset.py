"""The shipped system at toy size: movements, a head that samples, 46 joints, and what stands around them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from untrained import PLAIN, sampled_blocks, untrained

from data_module.blocks import cut
from data_module.motion.skeletons import CHARACTERS
from data_module.speech.audio import write_flac
from data_module.store import Recording, Store
from data_module.types import Speech
from eval.commands import QUALITY
from eval.context import EvalContext
from eval.metrics.encode import encode_motion, latents_of, normalised_blocks
from eval.table import load
from generator.flow import FlowGenerator
from gesticulator.bundle import bundle as bundles
from gesticulator.gesticulator import Gesticulator
from gesticulator.infer import main as infer
from gesticulator.performance import Performance
from gesticulator.sampling import loop
from gesticulator.sampling.loop import Request, Setup
from gesticulator.systems import movement
from gesticulator.training.stages.lexicon import token_labels
from interpreters.planner import CODE, UnitStyleInterpreter
from lexicon.movement import MovementLexicon

AHEAD = 1.5
"""Seconds before the end of a recording from which on its end may be heard: the blocks to come and the smoothing."""


@pytest.fixture(scope="module")
def system(tiny_movement_bundle: Path) -> Gesticulator:
    return Gesticulator.from_pretrained(tiny_movement_bundle)


@pytest.fixture(scope="module")
def recording(tiny_store: Path) -> Recording:
    store = Store.open(tiny_store)
    return store.load(store.of_split("test")[0].name)


@pytest.fixture(scope="module")
def played(system: Gesticulator, recording: Recording) -> Performance:
    return system(recording.speech, seed=3)


def written(made: Performance, path: Path) -> bytes:
    return made.save(path).read_bytes()


def test_it_draws_the_whole_character_at_every_frame(system: Gesticulator, played: Performance,
                                                     recording: Recording) -> None:
    bundle = system.bundle
    assert isinstance(bundle.lexicon, MovementLexicon) and isinstance(bundle.generator, FlowGenerator)
    assert isinstance(bundle.style, UnitStyleInterpreter) and bundle.planner is not None and bundle.encoder is None
    assert played.motion.skeleton.names == CHARACTERS[46].names
    assert played.motion.duration == pytest.approx(recording.speech.duration, abs=0.05)
    assert np.isfinite(played.motion.rotations).all()
    assert played.codes.shape == (len(played.blocks), len(CODE))
    assert len(np.unique(played.lexemes)) > 1 and played.lexemes.max() < len(bundle.vectors)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(system: Gesticulator, played: Performance,
                                                                  recording: Recording, tmp_path: Path) -> None:
    first = written(played, tmp_path / "first.bvh")
    assert written(system(recording.speech, seed=3), tmp_path / "again.bvh") == first
    assert written(system(recording.speech, seed=4), tmp_path / "other.bvh") != first


def test_a_bundle_that_draws_in_one_way_has_no_variations(recording: Recording, tmp_path: Path,
                                                          capsys: pytest.CaptureFixture[str]) -> None:
    bundles.save(untrained(*PLAIN), tmp_path / "regression", "# Never trained\n")
    sound = tmp_path / "speech.flac"
    write_flac(sound, recording.speech)
    with pytest.raises(SystemExit) as stopped:
        infer([str(sound), "-o", str(tmp_path / "out.bvh"), "--bundle", str(tmp_path / "regression"),
               "--variation", "1"])
    told = capsys.readouterr().err.strip()
    assert stopped.value.code == 2 and "variation 1: needs a generator that samples" in told and "\n" not in told
    assert not (tmp_path / "out.bvh").exists()


def test_what_comes_later_changes_nothing_before_it(system: Gesticulator, recording: Recording) -> None:
    """The noise is keyed by seed and block, and nothing is drawn but from what came before."""
    speech = recording.speech
    end = speech.duration * 0.6
    part = Speech(speech.samples[:round(end * speech.sample_rate)], speech.sample_rate)
    whole, first = (system(own, seed=5) for own in (dataclasses.replace(speech, words=None), part))
    safe = int(np.searchsorted(first.blocks.edges, end - AHEAD)) - 1
    assert safe > 5
    np.testing.assert_array_equal(whole.blocks.edges[:safe], first.blocks.edges[:safe])
    np.testing.assert_array_equal(whole.lexemes[:safe - 1], first.lexemes[:safe - 1])
    frames = int(whole.blocks.edges[safe - 1] * whole.motion.fps) - 2
    np.testing.assert_allclose(whole.motion.rotations[:frames], first.motion.rotations[:frames], atol=1e-4)


# ------------------------------------------------------------------------------------------------------ evaluation

@pytest.fixture(scope="module")
def context(tiny_store: Path, tiny_movement_bundle: Path) -> EvalContext:
    work = tiny_movement_bundle.with_name(tiny_movement_bundle.name + ".work")  # what the training cut and heard
    return EvalContext.over(Store.open(tiny_store), bundles.load(tiny_movement_bundle), work, progress=False)


def test_motion_is_read_as_the_training_read_it(context: EvalContext) -> None:
    bundle, corpus = context.bundle, context.corpus
    number = context.numbers("train")[0]
    recording = context.store.load(corpus.names[number], bundle.config.motion.joints)
    blocks = cut(recording.speech, bundle.config.rhythm)
    own = encode_motion(bundle, recording.motion, blocks, recording.info.speaker)
    rows = corpus.blocks_of(number)
    known = token_labels(bundle.block_lexicon, corpus)[rows]
    # The corpus is kept in half precision, which decides a block between two lexemes now and then.
    assert (own.labels == known).mean() > 0.95
    lexicon = bundle.block_lexicon
    assert isinstance(lexicon, MovementLexicon)
    _, past = normalised_blocks(bundle.config, bundle.statistics, recording.motion, blocks, recording.info.speaker)
    distances = torch.cdist(latents_of(lexicon, own.poses, past).double(), bundle.vectors.double())
    assert (distances.argmin(1).numpy() == own.labels).mean() > 0.99


def test_levels_and_lexemes_tell_more_than_the_past_alone(context: EvalContext, tiny_movement_bundle: Path,
                                                          tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    out = tmp_path / "quality.json"
    assert QUALITY.main("gesticulator quality", [
        "--data", str(context.store.path), "--bundle", str(tiny_movement_bundle), "--work",
        str(context.work), "--out", str(out), "--quiet"]) == 0
    rows = load(out)[0].rows
    error = {name: row["error"].mean for name, row in rows.items()}  # type: ignore[union-attr]
    assert error["unquantised"] < error["quantised"] < error["the lexeme alone"]
    assert error["the lexeme alone"] < error["predicted from the past alone"]
    assert error["the lexeme alone"] < error["always the most frequent lexeme"]
    assert {"lstm", "statistical", "majority"} <= set(load(out)[1].rows)


def test_the_motion_of_a_block_depends_on_its_lexeme(system: Gesticulator, recording: Recording,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(movement, "LEXEME_GUIDANCE", 0.0)
    monkeypatch.setattr(movement, "CANDIDATES", 1)  # nothing to choose
    encoded = system.encode_speech(recording.speech)

    def sampled(lexeme: int) -> np.ndarray:
        bundle = system.bundle
        setup = Setup(system.bundle.interpreter_named("lstm"), 0, temperature=1.0, seed=0)
        requests = [Request(encoded.block(i), lexeme=lexeme) for i in range(len(encoded))]
        return loop.motion_of(bundle, setup, sampled_blocks(bundle, setup, requests, encoded.text is not None))

    # Neither is silent: hands rest in a silent lexeme. It reaches the head through the code alone, which has learned
    # little in 60 steps.
    first, second = [lexeme for lexeme in range(24) if lexeme not in set(system.bundle.silent.tolist())][:2]
    assert np.abs(sampled(first) - sampled(second)).max() > 1e-5
