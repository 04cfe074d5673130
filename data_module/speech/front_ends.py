"""The front ends by name, and the one place in which they are built.

The network behind a learned one is imported only when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from data_module.errors import InputError
from data_module.speech.features import FrontEnd, MelFrontEnd

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder


def _vqwav2vec(encoder: SpeechEncoder | None = None, layers: Sequence[int] | None = None, **size: int) -> FrontEnd:
    from data_module.speech.learned_features import encoder_front_end

    if encoder is None:
        raise InputError("front end 'vqwav2vec'", "needs a trained speech encoder", "use a bundle that has one")
    return encoder_front_end(encoder, MelFrontEnd(**size), layers)


FRONT_ENDS: dict[str, Callable[..., FrontEnd]] = {"mel": MelFrontEnd, "vqwav2vec": _vqwav2vec}
"""Front ends by name; each takes frames, samples_per_frame and sample_rate, and what is its own by keyword."""


def front_end(name: str, *, bands: int, frames: int, samples_per_frame: int, sample_rate: int,
              encoder: SpeechEncoder | None = None, layers: Sequence[int] | None = None) -> FrontEnd:
    """A front end by name: one of `FRONT_ENDS`, "fairseq:PATH" or "hf:NAME" (a folder, or a model transformers has).

    bands: of "mel" alone (a learned one takes just onsets and loudness from it). frames: rows per window (3K).
    encoder: for "vqwav2vec". layers: which two are the low and the high level; None for the front end's own.
    InputError for an unknown name or a model that is not to be had.
    """
    size = {"frames": frames, "samples_per_frame": samples_per_frame, "sample_rate": sample_rate}
    if name == "mel":
        return FRONT_ENDS[name](bands=bands, **size)
    if name in FRONT_ENDS:
        return FRONT_ENDS[name](encoder=encoder, layers=layers, **size)
    kind, _, where = name.partition(":")
    if not where or kind not in ("fairseq", "hf"):
        raise InputError("front end", f"there is no {name!r}",
                         f"choose from {', '.join(FRONT_ENDS)}, fairseq:PATH, hf:NAME_OR_FOLDER")
    from data_module.speech.learned_features import encoder_front_end, transformers_front_end

    if kind == "hf":
        return transformers_front_end(where, MelFrontEnd(**size), layers)
    from data_module.speech.speech_encoder import load_fairseq

    return encoder_front_end(load_fairseq(where), MelFrontEnd(**size), layers, name=name)
