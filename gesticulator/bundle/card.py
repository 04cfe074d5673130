"""The model card that every bundle carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gesticulator.bundle.bundle import Bundle


def model_card(bundle: Bundle) -> str:
    """The model card as Markdown: training data, validation figures and limits."""
    p, c = bundle.provenance, bundle.config
    hours, reads = p["hours"], bundle.text is not None
    # One row for each figure: stages have different ones.
    figures = "\n".join(f"| {stage} | {name} | {value:.4g} |" for stage, values in bundle.figures.items()
                        for name, value in values.items())
    return f"""# Model card

Preset `{c.name}`. Speech in, upper-body gesture of a {c.motion.joints}-joint character out, after
*Rhythmic Gesticulator* (2022) and *RACER* (2023).

## Trained on
{p["store"]}: {hours["train"]} h of speech and motion for training, {hours["val"]} h for validation and
{hours["test"]} h for test. Data fingerprint `{p["fingerprint"]}`. Performers: {", ".join(bundle.speakers)}.
Licence of the data: {p["licence"]}

## Figures on the validation split
| stage | figure | value |
|---|---|---|
{figures}

## Limits
- When the store is the scripted performer, the motion is real motion-capture strokes arranged by rule on (mostly
  synthetic) speech. The model then learned a rule's idea of when people gesture, not people.
- Upper body only: no {"fingers, " * (c.motion.joints == 16)}legs, face or walking. The root neither turns nor moves.
- Without a transcript, pointing and negation come at times the sound suggests{", as it reads no words" * (not reads)}.
- A speaker is a performer's habit of moving; it has nothing to do with whose voice is heard.
- Speech over music or over other speakers was not trained on.
"""
