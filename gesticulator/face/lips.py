"""From sound to the mouth: the lips network, co-articulation by dominance, and the strength of the mouth.

The network turns the sound around a frame of 20 ms into the weights of 15 visemes: a linear layer over the stacked mel
rows, a gated recurrent unit that remembers voice, level and noise, and a softmax. Its weights are in
`gesticulator/assets/face` and are read with the first face.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import read_bytes, read_object
from data_module.layers_run import Dense, Floats, Gru, Tensors, softmax
from data_module.speech.front_ends import MelFrontEnd
from data_module.speech.silence import FRAME, MARGIN, STEP, LoudnessTracker, frame_levels
from data_module.types import Array, Samples, Word
from gesticulator.face.visemes import RATE, SILENT, VISEMES

SAMPLE_RATE = 16000
BANDS = 32
WIDTH = BANDS + 1
"""Values of a row: the bands and the loudness, natural logarithms of power."""
HOP, ROWS, CONTEXT = 160, 2, 3
"""Samples of a row, rows of a frame, and rows of sound on either side that the windows of 64 ms reach into."""
BEFORE, AFTER = 4, 4
STACKED = (BEFORE + ROWS + AFTER) * WIDTH
"""Values of a frame."""
LOOK_AHEAD = (ROWS / 2 + AFTER + CONTEXT) * HOP / SAMPLE_RATE
"""Seconds of sound after the middle of a frame that it depends on."""
HIDDEN = 112
"""Width of both layers: 124,000 weights, 0.5 MB."""
Rows = NDArray[np.float32]
Weights = Mapping[str, NDArray[np.float32]]
SHIPPED = Path(__file__).parents[1] / "assets" / "face"
_AGAIN = "install gesticulator again, or train it: gesticulator train-face --out DIR"
DOMINANCE = np.array([2.0, 50.0, 16.0, 1.2, 1.0, 1.0, 6.0, 4.8, 1.0, 1.3, 6.0, 6.0, 6.0, 7.8, 9.6])
"""[15] how far each viseme imposes itself on those that it overlaps (Cohen and Massaro 1993): lips that must close or
touch do so even where a vowel is as likely, rounding spreads, and a tongue that moves behind the teeth (d, k, n, th)
leaves the lips to the vowels. Chosen on two readings that are not in the reported figures."""
_ABOVE, _SOFT = 1.0, 2.0
"""Decibels over the limit of silence at which the mouth may open by half, and over which that spreads: the network
alone leaves the mouth at 18 % in the silences of readings with a noisy room, with this it is at 2 %."""
_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
"""Smoothing over 5 frames of 20 ms: nothing above about 10 Hz remains, faster than lips move."""
_FORGOTTEN_AT_ONCE = 250
"""Rows of the curve: a list that loses its beginning is moved as a whole."""
REACH = max(LOOK_AHEAD, STEP * FRAME) + (len(_KERNEL) // 2 + 1) / RATE
"""Seconds of sound after an instant that the mouth at that instant depends on."""


@lru_cache(maxsize=2)
def load_weights(folder: Path = SHIPPED) -> Weights:
    """The weights of the lips network. `InputError` if the folder lacks them, or they are not what its record says."""
    from safetensors.numpy import load

    record = read_object(folder / "face.json", _AGAIN)
    path = folder / "visemes.safetensors"
    data = read_bytes(path, _AGAIN)
    # The hash is of the bytes that are read here, so that other weights never pass for the shipped ones.
    hashes: Any = record.get("sha256")
    expected = hashes.get(path.name) if isinstance(hashes, dict) else None
    if hashlib.sha256(data).hexdigest() != expected or record.get("visemes") != list(VISEMES):
        raise InputError(path, "is not the file that its record describes", _AGAIN)
    weights: Weights = load(data)
    if not all(np.isfinite(array).all() for array in weights.values()):
        raise InputError(path, "has weights that are not finite numbers", _AGAIN)
    return weights


@lru_cache(maxsize=2)
def front_end(rows: int) -> MelFrontEnd:
    return MelFrontEnd(BANDS, rows, HOP, SAMPLE_RATE, hops=1)


class LipFeatures:
    """Streamed sound to frames [STACKED], one at a time and always by the same operations, so that the numbers do not
    depend on the sizes of the pieces. Before the first sample there is silence."""

    def __init__(self) -> None:
        self._sound = np.zeros(CONTEXT * HOP, np.float32)
        self._rows: list[Rows] = []

    def feed(self, samples: Samples) -> list[Rows]:
        """The frames that `samples` at 16 kHz complete."""
        self._sound = np.concatenate([self._sound, samples])
        out: list[Rows] = []
        # A frame needs the rows around it, and each row the sound that its window reaches into.
        step, size = ROWS * HOP, (ROWS + 2 * CONTEXT) * HOP
        while len(self._sound) >= size:
            # [2, WIDTH] of the frame, from its samples and `CONTEXT` rows of sound on either side.
            rows = front_end(ROWS + 2 * CONTEXT).rows(self._sound[None, :size])[0, CONTEXT:CONTEXT + ROWS]
            rows = np.concatenate([rows[:, :BANDS], rows[:, -1:]], axis=1)
            before = [] if self._rows else [rows[0]] * BEFORE
            self._rows += [*before, rows[0], rows[1]]
            self._sound = self._sound[step:]
            if len(self._rows) == BEFORE + ROWS + AFTER:
                out.append(np.concatenate(self._rows))
                del self._rows[:ROWS]
        return out

    def flush(self) -> list[Rows]:
        """The remaining frames of the sound that was fed, as if silence followed."""
        return self.feed(np.zeros((ROWS - 1 + AFTER + CONTEXT) * HOP, np.float32))


class VisemeStepper:
    """The lips network, one frame after the other, by numpy: a file and a stream give the same bits, in a tenth of a
    millisecond per frame."""

    def __init__(self, weights: Weights) -> None:
        """weights: of the layers enter, memory (a GRU of torch) and leave, and the mean and deviation of frames.
        `InputError` for other shapes."""
        # The normalisation of the frames is folded into the first layer, which saves it for every frame.
        tensors = Tensors(weights, "the lips network")
        first = tensors.take("enter.weight", HIDDEN, STACKED) / tensors.take("deviation", STACKED)
        shift = tensors.take("enter.bias", HIDDEN) - first @ tensors.take("mean", STACKED)
        self._enter = Dense(first, np.asarray(shift, np.float32))
        self._memory = Gru(tensors.within("memory"), HIDDEN, HIDDEN)
        self._leave = tensors.dense("leave", 2 * HIDDEN, len(VISEMES))
        self._state: Floats | None = None

    def __call__(self, frame: Floats) -> Floats:
        """[15] weights of the visemes, summing to 1, of the next frame [STACKED]."""
        entered = np.maximum(self._enter(frame), 0.0)
        remembered, self._state = self._memory(entered[None, None], self._state)
        return softmax(self._leave(np.concatenate([entered, remembered[0, 0]])))


class Lips:
    """The mouth of an utterance: sound in, weights of visemes out."""

    def __init__(self, start: float = 0.0, weights: Weights | None = None) -> None:
        """start: media time of the first sample, seconds."""
        self.start = start
        self._features, self._step = LipFeatures(), VisemeStepper(load_weights() if weights is None else weights)
        self._gate = _Gate()
        self._curve: list[NDArray[np.float32]] = []
        self._opens: list[float] = []
        self._forgotten = 0
        """Rows before those of the curve."""

    def feed(self, samples: Samples) -> None:
        """Take more of the sound at 16 kHz."""
        self._curve += [self._step(frame) for frame in self._features.feed(samples)]
        self._opens += self._gate.feed(samples)

    def finish(self) -> None:
        """The sound ends."""
        self._curve += [self._step(frame) for frame in self._features.flush()]
        self._opens += self._gate.finish()

    def follow(self, words: Sequence[Word]) -> None:
        """Draw the mouth of the whole sound, which is over, towards the phones of its words (`phones`)."""
        from gesticulator.face.phones import spoken_weights

        self._curve = list(spoken_weights(self.weights, words).astype(np.float32))

    def cut(self, at: float) -> None:
        """Forget what comes after `at` seconds of media time; the mouth shuts."""
        last = max(math.floor((at - self.start) * RATE) - self._forgotten, 0)
        del self._curve[last:], self._opens[last:]
        # Sound that comes later follows a silence, and not what was cut off.
        self._features, self._gate = LipFeatures(), _Gate()

    def forget(self, before: float) -> None:
        """Forget what comes before that many seconds of media time, a few seconds at a time; it is not drawn again."""
        old = math.floor((before - self.start) * RATE) - len(_KERNEL) - self._forgotten
        old = min(old, len(self._curve), len(self._opens))
        if old >= _FORGOTTEN_AT_ONCE:
            del self._curve[:old], self._opens[:old]
            self._forgotten += old

    @property
    def weights(self) -> Array:
        """[M, 15] the network's output so far; row m is centred at start + (m + 0.5) / RATE. Not after `forget`."""
        return np.array(self._curve, dtype=np.float64).reshape(-1, len(VISEMES))

    def rows(self, first: int, last: int) -> Array:
        """[last - first, 15] weights of visemes as drawn: smoothed and with dominance; silence beyond the curve."""
        # The kernel needs rows before the first and after the last one; beyond the curve the mouth is shut.
        half = len(_KERNEL) // 2
        raw = np.zeros((last - first + 2 * half, len(VISEMES)))
        raw[:, SILENT] = 1.0
        old = self._forgotten
        begin, end = max(first - half, old), min(last + half, old + min(len(self._curve), len(self._opens)))
        if end > begin:
            # The gate takes weight off all shapes alike, and silence takes what they lose.
            opened = np.array(self._opens[begin - old:end - old])
            shaped = np.array(self._curve[begin - old:end - old]) * opened[:, None]
            shaped[:, SILENT] += 1.0 - shaped.sum(axis=1)
            raw[begin - first + half:end - first + half] = shaped
        # Smoothed first: dominance then acts on what overlaps, as co-articulation does.
        smooth = sum(share * raw[place:place + last - first] for place, share in enumerate(_KERNEL))
        return with_dominance(np.asarray(smooth))

    def at(self, times: Array) -> Array:
        """[T, 15] weights of visemes at rising media times [T]."""
        where = (times - self.start) * RATE - 0.5
        first = int(np.floor(where[0]))
        rows = self.rows(first, int(np.floor(where[-1])) + 2)
        place = np.floor(where).astype(np.int64) - first
        share = (where - np.floor(where))[:, None]
        return np.asarray(rows[place] * (1.0 - share) + rows[place + 1] * share)


class _Gate:
    """The share by which the mouth may open in each frame: none below the limit of silence, all above it."""

    def __init__(self) -> None:
        self._tracker = LoudnessTracker()
        self._sound = np.zeros(0, np.float32)

    def feed(self, samples: Samples) -> list[float]:
        """0 to 1 for each frame that the samples complete; the silence is found in steps of 0.1 s."""
        self._sound = np.concatenate([self._sound, samples])
        # Always in steps of one size: the tracker of loudness would give other numbers for other pieces.
        size = round(STEP * FRAME * SAMPLE_RATE)
        out: list[float] = []
        while len(self._sound) >= size:
            out += self._opening(self._sound[:size])
            self._sound = self._sound[size:]
        return out

    def finish(self) -> list[float]:
        """The same for the rest of the sound, which is then over."""
        rest, self._sound = self._sound, np.zeros(0, np.float32)
        return self._opening(rest, ended=True) if len(rest) else []

    def _opening(self, sound: Samples, ended: bool = False) -> list[float]:
        """0 to 1 for each frame of 20 ms of the next sound: the loudness is known every 10 ms."""
        step = self._tracker.step(frame_levels(sound, SAMPLE_RATE), ended)
        over = step.levels - np.maximum(step.floor + MARGIN, step.limit)
        pairs = np.resize(over, (len(over) + 1) // 2 * 2).reshape(-1, 2).mean(axis=1)
        return (1.0 / (1.0 + np.exp(-(pairs - _ABOVE) / _SOFT))).tolist()


def with_dominance(weights: Array) -> Array:
    """[..., 15] the weights after each viseme has imposed itself by its dominance; they sum to 1."""
    strong = weights * DOMINANCE
    return np.asarray(strong / strong.sum(axis=-1, keepdims=True))


def with_strength(visemes: Array, mouth: float) -> Array:
    """[..., 15] the visemes with the mouth's strength, 0 (shut) to 2; silence takes what they leave."""
    spoken = np.clip(visemes * mouth, 0.0, 1.0)
    spoken[..., SILENT] = 0.0
    spoken[..., SILENT] = np.maximum(1.0 - spoken.sum(axis=-1), 0.0)
    return spoken
