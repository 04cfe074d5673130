"""The model card that every bundle carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gesticulator.bundle.bundle import Bundle


def _words(bundle: Bundle) -> str:
    if bundle.text is None:
        return ("It hears the voice and does not know what is said: pointing and negation come at times the sound "
                "suggests, not words.")
    return (f"What is said counts only where a transcript is given; its words are read by `{bundle.text.encoder}`, an "
            "English model. Without one, pointing and negation come at times the sound suggests.")


def model_card(bundle: Bundle) -> str:
    """Markdown: what the weights were trained on, what they do, and what they cannot do."""
    p, c = bundle.provenance, bundle.config
    hours = p["hours"]
    figures = "\n".join(f"| {stage} | {name} | {value:.4g} |" for stage, own in bundle.figures.items()
                        for name, value in own.items())
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
- {_words(bundle)}
- A speaker is a performer's habit of moving; it has nothing to do with whose voice is heard.
- Speech over music or over other speakers was not trained on.
"""
