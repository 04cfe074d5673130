"""The group `motion`: does it read as a person? The bundle beside itself without the sound, and beside real motion.

Everything is a mean over renderings: of the real take's voice with several seeds, and of every voice of the test split.
Real motion is the take itself, and the corpus: the test split's own motion. The figures are those of `eval.metrics.eye`
and `timing`; the bounds that they must keep stand in `bounds.toml`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from data_module.blocks import cut
from eval.acceptance import timing
from eval.acceptance.bounds import Measured, Results
from eval.acceptance.timing import Timed
from eval.metrics.eye import ReferenceSpace
from eval.metrics.eye.sample import CORPUS, EyeSample
from eval.renderings import TEST, AcceptanceVoice, BundleSystem

OURS, SPEAKERS, WITHOUT_SOUND = "ours", "speakers", "statistical"
"""`WITHOUT_SOUND`: the bundle with an interpreter that ignores the sound."""
ON_TAKE, ON_TEST = "BEAT voice", "test split"
"""Sets of stimuli: the voice of the real take, and those of the store's test split."""


def own_motion(voices: Sequence[AcceptanceVoice], space: ReferenceSpace | None) -> EyeSample:
    """The motion of the speakers themselves, with seams where a system would cut; a real take has no seams."""
    sample = EyeSample()
    for voice in voices:
        if voice.own is not None:
            # Nothing was joined in a real take; a corpus is judged at the seams that a system would have made.
            edges = cut(voice.speech).edges if voice.place == TEST else None
            sample.add(voice.own, voice.heard, edges, space, group=voice.group or voice.name)
    return sample


def rendered(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int, space: ReferenceSpace | None,
             **options: Any) -> tuple[EyeSample, list[Timed]]:
    """The bundle on the real take's voice with every seed, or on each voice of the test split with one of its own."""
    sample, timed = EyeSample(), []
    for number, voice in enumerate(voices):
        for seed in [number % renderings] if voice.place == TEST else range(renderings):
            rendering = system.render(voice, seed, **options)
            # The interval draws the renderings of one group of voices together.
            sample.add(rendering.motion, voice.heard, rendering.edges, space, group=voice.group or voice.name)
            timed.append(Timed.of(rendering.motion, voice))
    return sample, timed


def measure(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int, space: ReferenceSpace | None
            ) -> dict[str, Results]:
    """The figures of the bundle, of the bundle without the sound, and of the speakers themselves."""
    takes, tests = ([voice for voice in voices if (voice.place == TEST) == test] for test in (False, True))
    corpus = own_motion(tests, space) if tests else None
    figures = {} if corpus is None else corpus.figures(space)
    beside = {(figure, CORPUS): Measured(value) for figure, value in figures.items()}
    known = [name for name in (WITHOUT_SOUND,) if name in system.gesticulator.interpreters]
    results: dict[str, Results] = {name: dict(beside) for name in (OURS, *known, SPEAKERS)}
    for on, chosen in ((ON_TAKE, takes), (ON_TEST, tests)):
        if not chosen:
            continue
        samples = {OURS: rendered(system, chosen, renderings, space),
                   **{name: rendered(system, chosen, renderings, space, interpreter=name) for name in known},
                   SPEAKERS: (own_motion(chosen, space),
                              [Timed.of(voice.own, voice) for voice in chosen if voice.own is not None])}
        for name, (sample, timed) in samples.items():
            results[name] |= {(figure, on): Measured(value) for figure, value in sample.figures(space, corpus).items()}
            results[name] |= {(figure, on): measured for figure, measured in timing.figures(timed).items()}
    return results
