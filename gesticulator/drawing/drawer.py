"""Who draws a block: the paper's generator with its style codes, or the flow head with guidance and candidates."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.motion.movement import PAST, Pasts
from generator.flow import Circumstances, FlowGenerator, FlowInputs, alone
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import UNTOLD
from gesticulator.bundle.features import SpeechBlock
from gesticulator.bundle.system import FLOW, REGRESSION, Drawing
from gesticulator.drawing.candidates import CandidateChooser
from interpreters.base import BlockFeatures

if TYPE_CHECKING:
    from generator.model import Generator
    from lexicon.movement import MovementLexicon


@dataclass(frozen=True)
class Keys:
    """What a block's noise is drawn from, beside its number: the performance's seed, and which variation of it."""

    seed: int
    variation: int = 0

    def noise(self, block: int, shape: tuple[int, int]) -> Tensor:
        """Standard normal noise of a block, the same in a file, a stream and a second rendering."""
        return torch.as_tensor(np.random.default_rng([self.seed, self.variation, block]).standard_normal(
            shape, dtype=np.float32))

    def choice(self, block: int) -> np.random.Generator:
        """Random numbers that choose the lexeme of an edited block, apart from its noise."""
        return np.random.default_rng([self.seed, self.variation, block, 1])


@dataclass(frozen=True)
class Direction:
    """Instructions for one block.

    lexeme: the one to play, whatever the interpreter says; None lets it choose. keys: of the noise and the choice of an
    edited block; None for those of the performance. still: [K] frames in which the hands are to rest, or None. bias:
    [S] added to the interpreter's scores where it chooses, or None.
    """

    lexeme: int | None = None
    keys: Keys | None = None
    still: NDArray[np.bool_] | None = None
    bias: NDArray[np.float64] | None = None

    def biased(self, scores: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scores [S] as the director wants them."""
        return scores if self.bias is None else scores + self.bias


FREE = Direction()
"""Leaves everything to the models."""

HURRIED_STEPS = 2
"""Of Heun's method where a block must cost less; one alone draws the mean of what could be drawn."""


class Drawer(Protocol):
    """Draws one block after the other; it keeps what it must remember between them. keys: of the next block's noise;
    hurried: it is to cost less, where it can; unseen: nobody looks at the next block, because the body rests in it, so
    that any will do."""

    keys: Keys
    hurried: bool
    unseen: bool

    def fork(self) -> Drawer:
        """A twin that goes on from here by itself."""

    def block(self, speech: SpeechBlock, features: BlockFeatures, lexeme: int, past: Tensor) -> tuple[Tensor, Tensor]:
        """The next block [1, K, D_m] with its style code [1, d_z], after what was shown before it, past [1, K, D_m].

        speech: what is known of its sound; features: the same as the models hear it.
        """


def drawer_for(bundle: Bundle, speaker: int, lexeme: int, keys: Keys, text: bool = False) -> Drawer:
    """The drawer that the bundle's generator asks for; lexeme: the one before the first block; text: words are read."""
    kinds: dict[Drawing, Callable[..., Drawer]] = {REGRESSION: RegressionDrawer, FLOW: FlowDrawer}
    return kinds[bundle.system.drawing](bundle, speaker, lexeme, keys, text)


class RegressionDrawer:
    """The generator of RG 5.2, its decoder's state and the style interpreter's."""

    def __init__(self, bundle: Bundle, speaker: int, lexeme: int, keys: Keys, text: bool) -> None:
        self.bundle, self.keys = bundle, keys  # it draws a block in one way, whatever the keys
        self.hurried = self.unseen = False  # and it costs little anyhow
        self.generator = cast("Generator", bundle.generator)
        self.style = (bundle.style_text if text else None) or bundle.style
        self.style_state = None if self.style is None else self.style.start(speaker)
        rest = bundle.rest_feature(speaker)
        self.state = self.free = self.generator.first_state(rest[None], bundle.vectors[[lexeme]])

    def fork(self) -> RegressionDrawer:
        """See `Drawer.fork`."""
        return copy.copy(self)  # states are replaced, never changed

    def block(self, speech: SpeechBlock, features: BlockFeatures, lexeme: int, past: Tensor) -> tuple[Tensor, Tensor]:
        """See `Drawer.block`."""
        code = past.new_zeros(1, self.bundle.config.generator.style_width)
        if self.style is not None:
            assert self.style_state is not None
            code, self.style_state = self.style.step(self.style_state, features, lexeme)
        audio, vector = self.generator.encode_audio(features.low[None]), self.bundle.vectors[[lexeme]]
        control = None if features.control is None else features.control[None]
        made, self.state, _ = self.generator.step(past, audio, vector, code, self.state, control=control)
        if control is not None:
            # Beyond what it does when asked, away from what it does unasked.
            unled, self.free, _ = self.generator.step(past, audio, vector, code, self.free)
            made = unled + self.bundle.config.selection.guidance * (made - unled)
        return made, code


class FlowDrawer:
    """The flow head: guidance by audio, lexeme and what is asked, and several candidates a block."""

    def __init__(self, bundle: Bundle, speaker: int, lexeme: int, keys: Keys, text: bool) -> None:
        self.generator = cast(FlowGenerator, bundle.generator)
        self.lexicon = cast("MovementLexicon", bundle.lexicon)
        self.chooser = CandidateChooser(bundle, speaker)
        self.chosen, self.keys, self.device = bundle.config.selection, keys, bundle.vectors.device
        self.place = Circumstances()
        self.speaker = torch.nn.functional.one_hot(torch.tensor([speaker], device=self.device),
                                                   len(bundle.speakers)).float()
        self.share = self._of_trunk(self.chosen.trunk_guidance)
        self.noise = self.chosen.noise * self._of_trunk(self.chosen.trunk_noise)
        self.state: tuple[Tensor, Tensor] | None = None
        self.told: Pasts | None = None
        self.base = torch.zeros(0)
        """[1, K, D_m] what the body would do in the last block if nothing new came."""
        self.hurried = self.unseen = False

    def fork(self) -> FlowDrawer:
        """See `Drawer.fork`."""
        twin = copy.copy(self)
        twin.place = copy.deepcopy(self.place)
        return twin

    def block(self, speech: SpeechBlock, features: BlockFeatures, lexeme: int, past: Tensor) -> tuple[Tensor, Tensor]:
        """See `Drawer.block`; the code is empty."""
        added = past.new_zeros(1, self.generator.basis.width)
        if self.told is not None:  # what was shown may be other than what was drawn
            added = self.generator.squeeze(self.generator.basis.project(past - self.base))
        before, own, _ = torch.tensor(speech.durations, dtype=torch.float32, device=self.device)
        self.told = Pasts(past[:, -PAST:], (own / before)[None])
        self.base = self.generator.basis.base(self.told)
        place = self.place.step(speech.durations, speech.silent).to(self.device)
        if speech.foreseen and self.generator.config.after_dropout:
            place = alone(place)
        given, gains = self._given(place, features, lexeme, past)
        context, self.state = self.generator.contexts(given, added[None], self.state)
        if self.unseen:  # all but the states of what comes next
            return self.base * self.generator.present, past[:, :0, 0]
        steps, pull = self.chosen.flow_steps, torch.tensor(gains, device=self.device)[:, None] * self.share
        if self.hurried:
            # One candidate, in few steps, without guidance. The states of what guides go on, for when there is time.
            steps, context, pull = min(steps, HURRIED_STEPS), context[:1], pull[:0]
            drawn, made = self._draw(speech.number, 1, context, pull, steps)
            if not self.chooser.throws(speech, past[0].cpu().numpy(), made.cpu().numpy()):
                return made, past[:, :0, 0]
        drawn, made = self._draw(speech.number, self.chosen.candidates, context, pull, steps)
        best = self._best(speech, lexeme, drawn, made, past, features)
        return made[best:best + 1], past[:, :0, 0]

    def _draw(self, number: int, candidates: int, context: Tensor, pull: Tensor, steps: int) -> tuple[Tensor, Tensor]:
        """Coefficients [C, n] of so many candidates for block `number`, and the blocks [C, K, D_m] that they make."""
        noise = self.keys.noise(number, (candidates, self.generator.basis.width)).to(self.device) * self.noise
        drawn = self.generator.draw(context[:, 0], pull, noise, steps)
        return drawn, (self.base + self.generator.basis.expand(drawn)) * self.generator.present

    def _of_trunk(self, trunk: float) -> Tensor:
        """[n] this value for the coefficients of torso and head, 1 for the others."""
        basis = self.generator.basis
        return torch.cat([torch.full((width,), trunk if name in ("torso", "head") else 1.0)
                          for name, width in zip(basis.parts, basis.widths, strict=True)]).to(self.device)

    def _given(self, place: Tensor, features: BlockFeatures, lexeme: int, past: Tensor
               ) -> tuple[FlowInputs, list[float]]:
        """The block as it is, and once more for each thing that guides with this left out; and the guidance. place:
        [8] its circumstances."""
        chosen, none = self.chosen, self.generator.lexemes
        control = features.control
        untold = chosen.lexeme_guidance == UNTOLD
        gained = {"audio": chosen.audio_guidance, "lexeme": 0.0 if untold else chosen.lexeme_guidance,
                  "history": chosen.history - 1.0}
        if control is not None:
            gained["control"] = chosen.guidance - 1.0
        gained = {what: gain for what, gain in gained.items() if gain}
        left = ["", *gained]
        count = len(left)
        asked = None
        if control is not None:
            asked = control.expand(count, 1, -1, -1).clone()
            if left[-1] == "control":
                asked[-1] = 0.0
        names = torch.tensor([[none if untold or what == "lexeme" else lexeme] for what in left], device=self.device)
        return FlowInputs(
            features.low[None, None], names, past[:, None], cast(Pasts, self.told).ratio[None], place[None, None],
            self.speaker, asked, torch.tensor([what == "audio" for what in left], device=self.device),
            torch.tensor([what == "history" for what in left], device=self.device)), list(gained.values())

    def _best(self, speech: SpeechBlock, lexeme: int, drawn: Tensor, made: Tensor, past: Tensor,
              features: BlockFeatures) -> int:
        """Which candidate is kept, of coefficients [C, n] and the blocks [C, K, D_m] that they make."""
        if len(drawn) == 1:
            return 0
        away = self.lexicon.distances(drawn)
        nearer = (away < away[:, lexeme, None]).sum(-1)
        asked = None if features.control is None else features.control.cpu().numpy()
        return self.chooser.choose(speech, past[0].cpu().numpy(), made.cpu().numpy(), nearer.cpu().numpy(), asked)
