"""RACER's stages over a corpus: what the reward model is shown, and RACER's own form from store to motion."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
import torch
from test_infer import babble

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh
from data_module.store import Store
from data_module.types import Speech
from gesticulator import infer
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.bundle.features import representation_of
from gesticulator.cli import main
from gesticulator.gesticulator import Gesticulator
from gesticulator.training import presets
from gesticulator.training.stages import REWARD, Run
from gesticulator.training.stages.corpus import Corpus, prepare
from gesticulator.training.stages.lexicon import decoded_blocks, token_labels
from gesticulator.training.stages.q_network import takes_of
from gesticulator.training.stages.reward import RewardWindows, block_audio, drawn_windows, groups, reward_table
from interpreters.reward import RewardConfig
from lexicon.racer import RacerCodec

NATIVE = ["schedules.lexicon.steps=30", "schedules.lexicon.batch=8", "schedules.reward.steps=6",
          "schedules.reward.batch=16", "schedules.cql.steps=8", "schedules.cql.batch=8", "racer.width=12",
          "racer.size=16", "reward.width=12", "reward.projection=6", "reward.window=4", "reward.longest=6",
          "cql.width=12", "cql.layers=1", "cql.decisions=6", "cql.audio_features=3", "front_end.bands=8",
          "episodes.prefix=2"]


@pytest.fixture(scope="module")
def corpus(tiny_store: Path, tiny_bundle: Path) -> Corpus:
    bundle = bundles.load(tiny_bundle)
    return prepare(Store.open(tiny_store), bundle.config, tiny_bundle.with_name(tiny_bundle.name + ".work"),
                   bundle.encoder, progress=False)


def test_windows_that_share_a_block_or_are_silent_are_no_rivals() -> None:
    # Rows 0 and 1 share block 5; 2 shares block 7 with 1, so it is joined to both; 3 stands alone; 4 and 5 are silent.
    blocks = np.array([[3, 4, 5], [5, 6, 7], [7, 8, 9], [20, 20, 21], [30, 31, 32], [50, 51, 52]])
    valid = np.ones((6, 3), np.float32)
    valid[3, 0] = 0  # padding on the left: the window is 20, 21
    silent = np.isin(blocks, [30, 31, 32, 50, 51, 52, 20])
    found = groups(blocks, valid, silent)
    assert found[0] == found[1] == found[2] and found[4] == found[5]
    assert len({found[0], found[3], found[4]}) == 3


def test_a_recording_is_drawn_by_how_many_blocks_it_has(corpus: Corpus) -> None:
    counts = (90, 10, 300, 20)
    uneven = replace(corpus, recording=np.repeat(np.arange(4), counts))
    blocks, _ = drawn_windows(uneven, [0, 1, 3], RewardConfig(window=4, longest=6), np.random.default_rng(0), 24000)
    shares = np.bincount(uneven.recording[blocks[:, -1]], minlength=4) / len(blocks)
    assert shares == pytest.approx([90 / 120, 10 / 120, 0.0, 20 / 120], abs=0.03)


def test_reward_windows_hold_what_belongs_together(corpus: Corpus, tiny_bundle: Path) -> None:
    bundle = bundles.load(tiny_bundle)
    labels = token_labels(bundle.lexicon, corpus)
    shown = decoded_blocks(bundle.lexicon, labels, corpus)
    audio = block_audio(corpus)
    frames = corpus.motion.shape[1]
    windows = RewardWindows(corpus, audio, shown, corpus.recordings("train"),
                            RewardConfig(window=4, longest=6), labels)
    batch = windows.sample(np.random.default_rng(0), 64)
    again = windows.sample(np.random.default_rng(0), 64)
    assert all(torch.equal(batch[key], again[key]) for key in batch)
    lengths = batch["valid"].sum(1)
    assert set(lengths.tolist()) == {2.0, 3.0, 4.0, 5.0, 6.0}
    assert (torch.diff(batch["valid"], dim=1) >= 0).all(), "padding stands on the left"
    # Motion and audio of a row are the same blocks, in order, in one recording; half the rows show lexemes.
    decoded = 0
    for row in range(64):
        kept = batch["valid"][row] > 0
        at = [int((audio.float() == piece).all((1, 2)).nonzero()[0]) for piece in batch["audio"][row][kept]]
        captured = torch.equal(batch["motion"][row][kept], corpus.motion[at])
        assert captured or torch.equal(batch["motion"][row][kept], shown[at])
        assert len({int(corpus.recording[b]) for b in at}) == 1
        decoded += not captured
    assert 20 <= decoded <= 44
    assert audio.shape[1:] == (frames, corpus.low.shape[-1] + corpus.high.shape[-1] - 1)
    torch.testing.assert_close(audio[..., -1], corpus.low[:, frames:2 * frames, -1], msg="the log duration, once")


def test_rivals_are_wrong_at_the_end_and_right_before(corpus: Corpus, tiny_bundle: Path) -> None:
    bundle = bundles.load(tiny_bundle)
    lexemes = bundle.block_lexicon.shown()
    labels = token_labels(bundle.lexicon, corpus)
    config = RewardConfig(window=4, longest=6, rivals=3)
    windows = RewardWindows(corpus, block_audio(corpus), decoded_blocks(bundle.lexicon, labels, corpus),
                            corpus.recordings("train"), config, labels, lexemes, bundle.transitions)
    batch = windows.sample(np.random.default_rng(1), 48, 1.0)
    assert batch["rivalled"].all() and batch["rival"].shape[:3] == (48, 3, 6)
    other = (batch["rival"] != batch["motion"][:, None]).flatten(3).any(3)  # [B, H, W]
    lengths = batch["valid"].sum(1)
    assert other[..., -1].all(), "the last lexeme is always another"
    for row, length in enumerate(lengths.int().tolist()):
        kept = 6 - max(1, length // 2)
        assert not other[row, :, 6 - length:kept].any(), "the first half is the truth"
    assert other[:, :, :-1].any(), "some have more than one wrong"
    shown = {tuple(piece.flatten()[:5].tolist()) for piece in lexemes}
    assert {tuple(piece.flatten()[:5].tolist()) for piece in batch["rival"][:, :, -1].flatten(0, 1)} <= shown


def test_a_reward_table_asks_about_the_corpus(corpus: Corpus, tiny_store: Path, tiny_bundle: Path) -> None:
    bundle = bundles.load(tiny_bundle)
    # The work folder of the training holds the reward model, which a bundle does not.
    run = Run(bundle.config, Store.open(tiny_store), tiny_bundle.with_name(tiny_bundle.name + ".work"), progress=False)
    bundle = bundle.with_parts(reward=run.get(REWARD))
    assert bundle.reward is not None
    labels = token_labels(bundle.lexicon, corpus)
    np.testing.assert_array_equal(labels, bundle.lexicon.label(corpus.motion).numpy())
    take = takes_of(corpus, labels, "test")[0]
    table = reward_table(bundle.reward, bundle.lexicon, corpus, literal=True)
    got = table.sequence(torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks))
    # The last step by hand: the last window of decoded blocks and of audio, through the model itself.
    last, model = torch.as_tensor(take.blocks[-bundle.config.reward.window:]), bundle.reward
    motion = bundle.block_lexicon.shown()[torch.as_tensor(labels)[last]][None]
    with torch.no_grad():
        pairs = [own.embed({"motion": motion, "audio": block_audio(corpus)[last].float()[None],
                             "valid": torch.ones(1, len(last))}) for own in model.models]
    by_hand = sum(float((one * two).sum()) for one, two in pairs) / len(pairs)
    assert float(got[-1]) == pytest.approx(by_hand, abs=1e-5)


@pytest.fixture(scope="module")
def native(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """RACER's own form, trained by the command at toy size."""
    out = tmp_path_factory.mktemp("native") / "bundle"
    settings = [part for setting in NATIVE for part in ("--set", setting)]
    assert main(["train", "--data", str(tiny_store), "--out", str(out), "--preset", "racer-native", "--threads", "1",
                 "--quiet", *settings]) == 0
    return out


def test_racers_own_form_gestures(native: Path, tmp_path: Path) -> None:
    soundfile.write(tmp_path / "speech.wav", babble(5.0), 16000)
    assert infer.main([str(tmp_path / "speech.wav"), "-o", str(tmp_path / "o.bvh"), "--explain",
                       str(tmp_path / "o.json"), "--preview", str(tmp_path / "o.html"), "--bundle", str(native),
                       "--quiet"]) == 0
    motion = read_bvh(tmp_path / "o.bvh")
    assert motion.duration == pytest.approx(5.0, abs=0.02) and np.isfinite(motion.rotations).all()
    plan = json.loads((tmp_path / "o.json").read_text())
    assert [round(block["end"] - block["start"], 3) for block in plan["blocks"][:-2]] == [0.4] * (
        len(plan["blocks"]) - 2)


def test_racers_own_form_decodes_its_codes_together(native: Path) -> None:
    system = Gesticulator.from_pretrained(native)
    codec = system.bundle.lexicon
    assert isinstance(codec, RacerCodec) and system.bundle.interpreters == ("cql", "statistical")
    speech = Speech(babble(4.0), 16000)
    made = system(speech, fps=20)
    rest = system.bundle.rest_lexeme(system.resolver.speaker(None))
    codes = torch.as_tensor([[rest, *made.lexemes.tolist()]])
    frames = codec.decode(codec.vectors[codes])[0, 8:].numpy().astype(np.float64)
    poses = system.bundle.statistics.denormalise(frames, system.resolver.speaker(None))
    # The frames of the motion at 20 fps are the decoded ones, but for the smoothing.
    wanted = representation_of(system.bundle.config).motion(poses[:-16], 20.0)
    gap = np.abs(np.einsum("tjq,tjq->tj", made.motion.rotations[1:len(wanted) + 1], wanted.rotations))
    assert gap.min() > 0.99
    still = system(speech, activity=0.0)
    assert set(still.lexemes.tolist()) == {rest}


@pytest.mark.parametrize(("options", "said"), [
    ({"interpreter": "lstm"}, r"interpreter lstm: is not in the bundle.*cql, statistical"),
    ({"hand_height": "high"}, "not supported by this bundle")])
def test_what_racer_has_not_is_said(options: dict[str, Any], said: str, native: Path) -> None:
    with pytest.raises(InputError, match=said):
        Gesticulator.from_pretrained(native)(Speech(babble(2.0), 16000), **options)


def test_a_codec_needs_its_frame_rate() -> None:
    with pytest.raises(InputError, match="fixed rate"):
        configs.with_settings(presets.preset("tiny"), ["system=racer", "front_end.name=mel"])


def test_published_sizes(tmp_path: Path) -> None:
    for name, steps in (("racer-trinity", 13_000), ("racer-chinese", 2_800)):
        config = presets.preset(name)
        assert (config.racer.width, config.racer.size, config.cql.width, config.cql.heads) == (512, 512, 768, 12)
        assert config.cql.decisions == 15 and config.cql.decisions * config.rhythm.frames == 120
        assert config.rhythm.frames / config.rhythm.fps == pytest.approx(0.4) and config.schedules.cql.steps == steps
        assert (config.episodes.truth, config.schedules.cql.betas) == (1.0, (0.5, 0.999))
