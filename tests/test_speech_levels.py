"""Probes of the speech levels find what was put in and nothing where nothing is, and hold words and voices apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.speech.speech_encoder import EncoderConfig, SpeechEncoder
from data_module.store import RecordingInfo, Store
from data_module.types import Array
from eval import level_features
from eval.commands import PROBE
from eval.level_features import LevelFeatures
from eval.linear_probes import (
    ProbeScore,
    Tokens,
    probe_frames,
    probe_words,
    same_word,
    tokens_of,
)
from eval.metrics import audio_clusters
from eval.probes import speech_levels
from eval.stats import Interval
from eval.table import load
from gesticulator import config as configs
from gesticulator import presets

BLOCKS, FRAMES = 60, 10


def spoken(number: int, voice: str, vocabulary: list[str], seed: int = 0) -> LevelFeatures:
    """A recording of words of 5 frames. Row "content": the word's own vector, with noise; "sound": energy and pitch in
    a mix of columns, and the voice; "noise": nothing."""
    rng = np.random.default_rng([seed, number])
    mixing = np.random.default_rng(9).standard_normal((3, 24))
    count = BLOCKS * FRAMES // 5
    words = [vocabulary[i] for i in rng.integers(len(vocabulary), size=count)]
    word_at = np.repeat(np.arange(count), 5).reshape(BLOCKS, FRAMES)
    word_at[:, -1] = -1
    energy, pitch = rng.standard_normal((2, BLOCKS, FRAMES))
    own = {word: np.random.default_rng(list(word.encode())).standard_normal(24) for word in vocabulary}
    content = np.array([own[word] for word in words])[word_at] + rng.standard_normal((BLOCKS, FRAMES, 24))
    timbre = np.full((BLOCKS, FRAMES), float(len(voice)))
    sound = np.stack([energy, pitch, timbre], axis=-1) @ mixing + 0.3 * rng.standard_normal((BLOCKS, FRAMES, 24))
    pitch = np.where(rng.random(pitch.shape) < 0.3, np.nan, pitch)
    features = {"content": content, "sound": sound, "noise": rng.standard_normal((BLOCKS, FRAMES, 24))}
    return LevelFeatures(f"r{number}", f"g{number // 2}", voice, {k: v.astype(np.float16) for k, v in features.items()},
                  energy, pitch, word_at, tuple(words), np.arange(BLOCKS) % 10 == 0)


OLD, NEW = [f"old{i}" for i in range(40)], [f"new{i}" for i in range(12)]
TRAIN = [spoken(i, f"voice{'x' * (i % 4)}", OLD) for i in range(8)]
TEST = [spoken(10 + i, f"other{'x' * (i % 3)}", NEW + OLD[:20]) for i in range(6)]


def mean(judged: ProbeScore) -> float:
    there = np.isfinite(judged.values)
    return float(np.average(judged.values[there], weights=judged.weights[there]))


def test_words_are_found_where_they_are_and_nowhere_else() -> None:
    found = {row: probe_words(tokens_of(TRAIN, row), tokens_of(TEST, row), len(TEST)) for row in TRAIN[0].features}
    assert mean(found["content"]["new_words"]) > 0.9
    assert mean(found["content"]["known_words"]) > 0.9
    for row in ("sound", "noise"):
        assert abs(mean(found[row]["new_words"]) - 0.5) < 0.05
        assert mean(found[row]["known_words"]) < 4 / len(OLD)


def test_energy_and_pitch_are_found_where_they_are_and_nowhere_else() -> None:
    for target in (lambda own: own.energy, lambda own: own.pitch):
        assert 0.8 < mean(probe_frames(TRAIN, TEST, "sound", target)) < 1
        for row in ("content", "noise"):
            assert -0.1 < mean(probe_frames(TRAIN, TEST, row, target)) < 0.03


def test_r2_is_one_less_error_over_variance_of_the_frames_that_count() -> None:
    def target(own: LevelFeatures) -> Array:
        return own.pitch

    def stacked(parts: list[LevelFeatures]) -> tuple[Array, Array]:
        xs, ys = [], []
        for own in parts:
            kept = np.isfinite(own.pitch) & ~own.silent[:, None]
            rows = own.features["sound"][kept].astype(float)
            xs.append(rows - rows.mean(axis=0))
            ys.append(own.pitch[kept] - own.pitch[kept].mean())
        return np.concatenate(xs), np.concatenate(ys)

    (x, y), (tx, ty) = stacked(TRAIN), stacked(TEST)
    wanted = 1 - ((ty - tx @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2).sum() / (ty ** 2).sum()
    judged = probe_frames(TRAIN, TEST, "sound", target)
    assert judged.weights.sum() == len(ty)
    assert mean(judged) == pytest.approx(wanted, abs=2e-3)  # the ridge is slight
    unvoiced = [replace(own, pitch=np.full_like(own.pitch, np.nan)) for own in TEST]
    assert np.isnan(probe_frames(TRAIN, unvoiced, "sound", target).values).all()


def test_a_token_is_the_means_over_the_thirds_of_its_frames() -> None:
    word_at = TEST[0].word_at.copy()
    word_at.ravel()[-3:] = -1
    own = replace(TEST[0], word_at=word_at)
    tokens = tokens_of([TRAIN[0], own], "content")
    mine = tokens.where(tokens.recording == 1)
    kept = [n for n in range(len(own.words)) if (own.word_at == n).sum() >= 3]
    assert len(kept) == len(own.words) - 1
    assert mine.words.tolist() == [own.words[n] for n in kept]
    assert set(mine.voices) == {own.voice}
    for at in (0, 7, len(kept) - 1):
        rows = own.features["content"][own.word_at == kept[at]].astype(float)
        cut = (2, 4) if len(rows) == 5 else (2, 3)
        thirds = [rows[:cut[0]].mean(0), rows[cut[0]:cut[1]].mean(0), rows[cut[1]:].mean(0)]
        assert np.allclose(mine.vectors[at], np.concatenate(thirds))
    silent = replace(own, word_at=np.full_like(own.word_at, -1))
    assert tokens_of([silent], "content").vectors.shape == (0, 72)


def test_same_word_asks_other_voices_only() -> None:
    words = np.array(["a", "b", "a", "b", "a", "c"])
    voices = np.array(["v", "v", "v", "w", "w", "x"])
    recording = np.array([0, 0, 1, 2, 2, 3])
    vectors = np.array([[1.0, 0.1], [0.1, 1.0], [1.0, 0.0], [0.0, 1.0], [2.0, 0.2], [1.0, 1.0]])
    judged = same_word(vectors, Tokens(vectors, words, voices, recording), 4)
    # recording 3 says a word that nobody else says; each other one ranks its same words first
    assert judged.values[:3].tolist() == [1, 1, 1] and np.isnan(judged.values[3])
    assert judged.weights.tolist() == [2, 1, 3, 0]
    swapped = same_word(vectors[[1, 0, 2, 3, 4, 5]], Tokens(vectors, words, voices, recording), 4)
    assert swapped.values[0] == 0


def test_too_little_to_fit_is_no_figure() -> None:
    few = [replace(TRAIN[0], words=tuple(f"once{i}" for i in range(len(TRAIN[0].words))))]
    found = probe_words(tokens_of(few, "content"), tokens_of(TEST, "content"), len(TEST))
    assert np.isnan(found["new_words"].values).all() and np.isnan(found["known_words"].values).all()


def test_recordings_of_a_group_count_once_and_differences_are_paired() -> None:
    judged = ProbeScore(np.array([0.2, 0.4, np.nan, 0.9]), np.array([1.0, 3.0, 0.0, 2.0]))
    low = ProbeScore(judged.values - 0.1, judged.weights)
    rows = {"level 8": dict.fromkeys(speech_levels.TASKS, judged), "level 2": dict.fromkeys(speech_levels.TASKS, low)}
    probed, claimed = speech_levels.summary(rows, ["a", "a", "b", "c"])
    cell = probed.rows["level 8"]["pitch"]
    assert isinstance(cell, Interval) and cell.mean == pytest.approx((4 * 0.35 + 2 * 0.9) / 6)
    assert (cell.n, cell.low, cell.high) == (2, pytest.approx(0.35), pytest.approx(0.9)), "the first two are one"
    told = {name: row["difference"] for name, row in claimed.rows.items()}
    assert list(told) == ["new words, AUC: level 8 - level 2", "known words, recall: level 8 - level 2",
                          "energy, R2: level 2 - level 8", "pitch, R2: level 2 - level 8"]
    for name, sign in (("known words, recall: level 8 - level 2", 1), ("energy, R2: level 2 - level 8", -1)):
        assert [told[name].low, told[name].high] == pytest.approx([sign * 0.1] * 2)  # type: ignore[union-attr]


@pytest.mark.parametrize("hertz", [90.0, 210.0])
def test_pitch_is_heard_in_the_middle_of_its_frame(hertz: float) -> None:
    frequency = np.where(np.arange(4 * 8000) < 2 * 8000, hertz, 1.5 * hertz)
    phase = 2 * np.pi * np.cumsum(frequency) / 16000
    tone = sum(np.sin(k * phase) / k for k in range(1, 6)).astype(np.float32)
    tone[3 * 8000:] = 0
    found = level_features.pitch_of(0.1 * tone.reshape(4, 8000), 10, 16000)
    assert found.shape == (4, 10)
    assert np.allclose(2 ** found[:2].ravel()[:-1], hertz, rtol=0.02)
    assert np.allclose(2 ** found[2, 1:-1], 1.5 * hertz, rtol=0.02)
    assert np.isnan(found[3, 1:]).all()


def test_words_lose_their_marks_and_keep_their_language() -> None:
    assert level_features.plain("“Don't,”", "en") == "en:don't"
    assert level_features.plain("die", "de") != level_features.plain("die", "en")
    assert level_features.plain("…", "en") == ""


# ---------------------------------------------------------------------------------------------------- Figure 14

@given(st.integers(0, 99), st.integers(1, 6), st.integers(1, 6))
def test_conditional_entropy_is_the_joint_less_the_marginal(seed: int, rows: int, columns: int) -> None:
    table = np.random.default_rng(seed).integers(0, 4, (rows, columns)).astype(float)
    table[0, 0] += 1
    wanted = 0.0
    for row in table:
        if row.sum():
            p = row[row > 0] / row.sum()
            wanted -= row.sum() / table.sum() * (p * np.log(p)).sum()
    assert audio_clusters.conditional_entropy(table) == pytest.approx(wanted, abs=1e-12)
    assert np.allclose(audio_clusters.conditional_entropy(np.stack([table, 3 * table])), wanted)


def test_association_finds_the_tie_and_no_other() -> None:
    rng = np.random.default_rng(0)
    recording = np.repeat(np.arange(8), 150)
    lexemes = rng.integers(0, 6, 1200)
    tied = np.where(rng.random(1200) < 0.7, lexemes, rng.integers(0, 6, 1200))
    loose = rng.integers(0, 6, 1200)
    found = audio_clusters.association({"loose": loose, "tied": tied, "same": lexemes}, lexemes, recording,
                                       recording // 2, draws=60, turns=40)
    assert found["same"]["entropy"] == 0
    assert found["same"]["by_chance"] == pytest.approx(np.log(6), abs=0.05)
    assert abs(found["loose"]["gain"].mean) < 0.02 and found["loose"]["p"] > 0.05
    assert found["tied"]["gain"].low > 0.4 and found["tied"]["p"] == pytest.approx(1 / 41)
    assert found["gain_differences"]["tied - loose"].low > 0.4
    assert found["tied"]["gain"].n == 4
    assert found["lexeme_entropy"] == pytest.approx(np.log(6), abs=0.01)
    # who performs is no tie: lexemes and clusters that only differ between recordings gain nothing
    own = audio_clusters.association({"who": recording}, recording % 3, recording, recording, draws=10, turns=20)
    assert own["who"]["entropy"] == 0 and own["who"]["gain"].mean == pytest.approx(0)


def test_turning_keeps_each_recordings_lexemes_in_their_order() -> None:
    recording = np.array([0] * 30 + [1] * 25 + [2])
    labels = np.arange(56)
    out = audio_clusters.turned(labels, recording, np.random.default_rng(3))
    for own in range(3):
        before, after = labels[recording == own], out[recording == own]
        shift = int(np.flatnonzero(after == before[0])[0])
        assert np.array_equal(np.roll(before, shift), after)
        assert own == 2 or 10 <= shift <= len(before) - 10


def test_clusters_are_those_that_were_put_in() -> None:
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 5, 300)
    points = 10 * rng.standard_normal((5, 7))[truth] + 0.1 * rng.standard_normal((300, 7))
    found = audio_clusters.cluster(points, 5)
    assert len(set(zip(found.tolist(), truth.tolist(), strict=True))) == 5
    assert audio_clusters.cluster(points[:3], 50).max() == 2


def test_figure_14_leaves_silence_out_and_sees_which_level_is_tied() -> None:
    rng = np.random.default_rng(0)
    rows, labels = [], []
    for own in TEST:
        kind = rng.integers(1, 7, BLOCKS)
        labels.append({"performer": np.where(own.silent, 0, kind)})
        tied = np.eye(7)[kind][:, None] + 0.3 * rng.standard_normal((BLOCKS, FRAMES, 7))
        rows.append(replace(own, features={"a": own.features["noise"], "b": tied.astype(np.float16)}))
    found = speech_levels.figure_14(rows, labels, "a", "b", clusters=12)["performer"]
    assert found["blocks"] == sum(int((~own.silent).sum()) for own in TEST)
    assert found["gain_differences"]["high, b - low, a"].low > 0.5
    assert found["lexeme_entropy"] == pytest.approx(np.log(6), abs=0.05)  # and not the seventh, of silence


# ---------------------------------------------------------------------------------------------------- the command

def info(name: str, split: str, voice: str) -> RecordingInfo:
    return RecordingInfo(name, split, "p", voice, "en", 1.0)  # type: ignore[arg-type]


def test_probes_are_judged_on_voices_that_they_were_not_fitted_on(tmp_path: Path) -> None:
    def store(infos: list[RecordingInfo]) -> Store:
        made = Store(tmp_path, {"corpus": "c", "settings": {}, "seed": 0, "licence": "", "fingerprint": "",
                                "recordings": []})
        made.recordings = tuple(infos)
        return made

    test = [info("t1", "test", "a"), info("t2", "test", "b")]
    own = [info(f"r{i}", "train", voice) for i, voice in enumerate("abcdcd")]
    train, judged, apart = speech_levels.hold_out(store(test + own), None, 3)
    assert (judged, apart) == (test, True)
    assert [i.voice for i in train] == ["c", "c", "d"]
    train, _, apart = speech_levels.hold_out(store(test + own[:2]), None, 9)
    assert (len(train), apart) == (2, False)
    with pytest.raises(InputError, match="no recording to fit"):
        speech_levels.hold_out(store(test), None, 9)


def test_a_recording_is_heard_as_the_models_hear_it(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    recording = store.load(store.names[0])
    recording = replace(recording, speech=replace(recording.speech, samples=recording.speech.samples[:16000 * 8]))
    config = presets.preset("tiny")
    torch.manual_seed(1)
    encoder = SpeechEncoder(EncoderConfig(width=4)).eval()
    heard = level_features.listen(recording, config, {"": encoder})
    from data_module.speech.front_ends import front_end
    from gesticulator.cutter import encode_speech

    front = front_end("vqwav2vec", bands=32, frames=30, samples_per_frame=800, sample_rate=16000, encoder=encoder)
    usual = encode_speech(recording.speech, config, front)
    assert np.array_equal(heard.silent, usual.blocks.silent)
    for row, level in (("level 2", usual.low), ("level 8", usual.high)):
        assert np.allclose(heard.features[row], level[:, 10:20, :4], atol=5e-3)
    assert np.allclose(heard.energy, usual.low[:, 10:20, 5], atol=2e-2)
    assert heard.features["mel"].shape == (*heard.energy.shape, 34)
    assert len(heard.words) == len(recording.speech.words or ())
    fresh = level_features.untrained(encoder)
    assert not torch.equal(fresh.convolutions[0].weight, encoder.convolutions[0].weight)
    again = level_features.untrained(encoder)
    assert torch.equal(fresh.convolutions[3].weight, again.convolutions[3].weight)


def test_the_command_measures_a_bundle(tiny_store: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "figures" / "levels.json"

    def ask(*more: str) -> int:
        return PROBE.main("gesticulator probe", [
            "speech-levels", "--bundle", str(tiny_bundle), "--data", str(tiny_store), "--train", "2", *more])

    assert ask("--limit", "1", "--out", str(out)) == 0
    probes, differences, *figure_14 = load(out)
    rows = [f"{kind}level {level}" for kind in ("", "untrained ") for level in range(1, 9)] + ["mel"]
    assert sorted(probes.rows) == sorted(rows)
    assert probes.rows["mel"]["energy"].mean > 0.99, "one of its columns"  # type: ignore[union-attr]
    assert len(figure_14) == 2 and "performer" in figure_14[0].title and "generated" in figure_14[1].title
    gain = next(row["gain"] for name, row in figure_14[1].rows.items() if name.endswith(", gain"))
    assert probes.facts["claim"] == [gain.to_dict()]  # type: ignore[union-attr]
    assert len(differences.rows) >= 4
    for wrong in (["--train", "0"], ["--limit", "0"]):
        with pytest.raises(SystemExit) as left:
            ask(*wrong)
        assert left.value.code == 2


def test_a_bundle_without_an_encoder_is_refused(tiny_bundle: Path) -> None:
    from gesticulator import bundle as bundles

    bundle = bundles.load(tiny_bundle)
    config = replace(bundle.config, front_end=configs.FrontEndConfig(name="mel"))
    bare = replace(bundle, config=config).with_parts(encoder=None)
    with pytest.raises(InputError, match="'mel' and has no speech encoder"):
        speech_levels.encoder_of(bare, "bundle")
