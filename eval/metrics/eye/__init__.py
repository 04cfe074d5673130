"""The figures for the eye: is it mirrored, stiff, small, or dead? A chapter each, on one common body.

Tables of joint errors and beats passed motion that any viewer refuses: both hands rising together, a fixed head, small
strokes with a pulse at every block. These figures see that. They are defined on `body.CommonBody`, at 60 Hz, so that
people and rigs of all sizes compare; each chapter tells its theory, unit, and what fools it.

`hands` (two hands, speeds, drift) · `trunk` (head, chest, freezes, contact, fingers) · `strokes` (size, seams,
repetition) · `arms` (jumps, freezes, lean, preparations) · `posture` (forearms, elbows, wrists, fingers, shoulders) ·
`together` (head and trunk with the hands, activity over seconds) · `units` (gesture units, holds, pauses, first
movements) · `voice` (timing by two detectors, silence) · `frechet` (everything at once). `stability` compares two
takes, `pitch` many recordings.

Real people differ, and the anchors that the chapters quote are those of a few. Which values a system must keep is told
by the bounds of `gesticulator acceptance`.
"""

import math

from data_module.types import Array, Motion
from eval.metrics import EYE_METRICS
from eval.metrics.eye import arms, hands, posture, strokes, together, trunk, units, voice
from eval.metrics.eye.body import CommonBody, common_body
from eval.metrics.eye.frechet import ReferenceSpace
from eval.metrics.eye.voice import VoiceActivity, hear

__all__ = ["SHORTEST", "CommonBody", "ReferenceSpace", "VoiceActivity", "common_body", "figures", "hear", "of_body"]

SHORTEST = 2.0
"""Seconds: shorter motion has no figure, as a window of the Frechet distance lasts so long."""


def figures(motion: Motion, voice_activity: VoiceActivity | None = None, edges: Array | None = None
            ) -> dict[str, float]:
    """Every one of `EYE_METRICS` of a motion of any upper body; NaN where one is not defined.

    voice_activity: of its speech (`hear`), without which the figures of the voice are undefined; edges: [N + 1] seconds
    of its own blocks, for the seams. InputError where the joints are not known.
    """
    return of_body(common_body(motion), voice_activity, edges)


def of_body(body: CommonBody, voice_activity: VoiceActivity | None = None, edges: Array | None = None
            ) -> dict[str, float]:
    """The same of a body that is at hand."""
    # A chapter leaves out what it cannot define, so NaN stands here once for all of them.
    out = dict.fromkeys(EYE_METRICS, math.nan)
    if body.duration < SHORTEST:
        return out
    for chapter in (hands, trunk, posture, together, arms):
        out |= chapter.figures(body)
    out |= strokes.figures(body, edges)
    if voice_activity is not None:
        out |= voice.figures(body, voice_activity) | units.figures(body, voice_activity)
    return out
