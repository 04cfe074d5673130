"""BERT's encoder on arrays (Devlin et al. 2019): word pieces to a vector of each in its sentence."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.layers_run import Floats, Norm, Tensors, attention, gelu


class BertEncoder:
    """The embeddings and all layers of a BERT, in the names and the format of transformers."""

    def __init__(self, config: Mapping[str, Any], tensors: Tensors) -> None:
        """config: the content of `config.json`. KeyError for a missing setting, InputError as of `Tensors`."""
        width, table = config["hidden_size"], tensors.within("embeddings")
        self.width, self.longest = width, config["max_position_embeddings"]
        self._pieces = table.take("word_embeddings.weight", config["vocab_size"], width)
        # Every piece belongs to the first of the two segments that BERT was trained on.
        segments = table.take("token_type_embeddings.weight", config["type_vocab_size"], width)
        self._places = table.take("position_embeddings.weight", self.longest, width) + segments[0]
        self._norm = Norm(table.within("LayerNorm"), width, epsilon=config["layer_norm_eps"])
        self._layers = [_Layer(tensors.within(f"encoder.layer.{number}"), config)
                        for number in range(config["num_hidden_layers"])]

    def layers(self, batch: Sequence[Sequence[int]]) -> Iterator[list[Floats]]:
        """The vectors [n, width] of the pieces of each sequence (n of at most `longest`) after each layer, which is
        computed when it is asked for: all of them take .4 s for long texts."""
        # No padding: the rows of all sequences go through the layers together, and attend within their own.
        ends = np.cumsum([len(pieces) for pieces in batch])[:-1]
        rows = self._norm(self._pieces[np.concatenate(batch)]
                          + np.concatenate([self._places[:len(pieces)] for pieces in batch]))
        for layer in self._layers:
            rows = layer(rows, ends)
            yield np.split(rows, ends)


class _Layer:
    """norm(x + attention(x)), then norm(x + feed-forward(x))."""

    def __init__(self, tensors: Tensors, config: Mapping[str, Any]) -> None:
        width, wide, least = config["hidden_size"], config["intermediate_size"], config["layer_norm_eps"]
        self._heads = config["num_attention_heads"]
        self._parts = [tensors.dense(f"attention.self.{part}", width, width) for part in ("query", "key", "value")]
        self._join = tensors.dense("attention.output.dense", width, width)
        self._after_attention = Norm(tensors.within("attention.output.LayerNorm"), width, epsilon=least)
        self._widen = tensors.dense("intermediate.dense", width, wide)
        self._narrow = tensors.dense("output.dense", wide, width)
        self._after_feed = Norm(tensors.within("output.LayerNorm"), width, epsilon=least)

    def __call__(self, rows: Floats, ends: NDArray[np.int64]) -> Floats:
        """[M, width] of rows [M, width] of sequences that end before the rows `ends`."""
        query, key, value = (np.split(part(rows), ends) for part in self._parts)
        attended = [attention(*sequence, heads=self._heads) for sequence in zip(query, key, value, strict=True)]
        rows = self._after_attention(rows + self._join(np.concatenate(attended)))
        return self._after_feed(rows + self._narrow(gelu(self._widen(rows))))
