"""From the options of a user to the `Setup` of a performance: checked, with the defaults of the bundle filled in."""

from __future__ import annotations

import difflib
import warnings
from dataclasses import replace
from typing import Any

from data_module.controls import FEATURES, Controls, Curve, parse
from data_module.errors import InputError, shown
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.files import lexicon_hash
from gesticulator.directing.record import Origin
from gesticulator.options import HandControl, InferenceOptions, interpreter_name
from gesticulator.plan.plan import ENERGIES, PlanMeaning
from gesticulator.sampling.loop import Setup
from gesticulator.version import __version__
from interpreters import INTERPRETERS
from interpreters.base import as_interpreter


class InterpreterWarning(UserWarning):
    """An interpreter was chosen that is no better than another, or worse (`InterpreterEntry.doubt`)."""


class SetupResolver:
    """Resolves options for one bundle."""

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle

    def speaker(self, name: str | None) -> int:
        """The index of a performer, or of the default one for None; `InputError` lists the known names."""
        speakers = self._bundle.speakers
        if name is None:
            # A bundle of other data may not have the performer that the preset names.
            preferred = self._bundle.config.default_speaker
            return speakers.index(preferred) if preferred in speakers else 0
        if name not in speakers:
            near = difflib.get_close_matches(name, speakers, 1)
            raise InputError(f"speaker {shown(name)}", "is not in the bundle",
                             (f"did you mean {near[0]}? " if near else "") + f"choose among {', '.join(speakers)}")
        return speakers.index(name)

    def setup(self, options: InferenceOptions, text: bool) -> Setup:
        """The setup of a performance. text: its words are read. `InputError` for options that the bundle cannot
        follow."""
        bundle, defaults = self._bundle, self._bundle.config.selection
        activity = (defaults.activity if options.activity is None else options.activity) * ENERGIES[options.energy][1]
        # With rest by phrases (silence.rest=life) activity works without a gate, which would only rank the phrases.
        if 0 < activity < 1 and "gate" not in bundle.parts and not bundle.config.rests_by_phrase:
            raise InputError(f"activity {activity:g}", "needs a gate, and this bundle has none", "use 0 or 1")
        if options.variation and not bundle.system.VARIES:
            raise InputError(f"variation {options.variation}", "needs a generator that samples, and this bundle's is "
                             "deterministic", "leave it out, or choose another seed")
        chosen = options.interpreter or bundle.interpreters[0]
        # An object may have `start` and `step` alone, and gets defaults for the rest.
        interpreter = as_interpreter(bundle.interpreter_named(chosen, text) if isinstance(chosen, str) else chosen)
        known = INTERPRETERS.get(interpreter.name)
        temperature = options.temperature
        if temperature is None and known is not None:
            temperature = known.temperature
        if temperature is None:
            # Q values and log-probabilities have different scales, so each has a default of its own.
            temperature = defaults.q_temperature if interpreter.gives_values else defaults.temperature
        # beta depends on the temperature: it is a weight on scores that are divided by it.
        interpreter = interpreter.steered(options.beta, temperature)
        # Interpreters of other packages have no figures of ours, so there is nothing to warn of.
        if known is not None and known.doubt:
            warnings.warn(InterpreterWarning(known.doubt), stacklevel=2)
        return Setup(interpreter, self.speaker(options.speaker), temperature, int(options.seed), activity,
                     hand_controls(bundle, options), int(options.variation), interpreter.beta, text)


def hand_controls(bundle: Bundle, options: InferenceOptions) -> Controls:
    """The hand controls of the options as numbers: "low", "mid" and "high" by the bundle's levels, curves as they
    are. `InputError` for an invalid control, or if the bundle was trained without style editing."""
    controls = options.controls or Controls.free()
    if controls == Controls.free() and not any(hand is not None for hand in options.hands):
        return controls
    levels = bundle.levels
    if levels is None:
        raise InputError(f"the control of {', '.join(FEATURES)}", "is not supported by this bundle",
                         "use a bundle trained with generator.use_control")
    if options.controls is not None:
        return controls

    def number(feature: str, value: HandControl) -> float | Curve | None:
        if value is None or isinstance(value, Curve):
            return value
        # The same parser as on the command line, so a level and a number mean the same.
        text = value if isinstance(value, str) else repr(float(value))
        return parse(f"--hand-{feature}", text, feature, levels)

    return Controls(**{name: number(name, hand) for name, hand in zip(FEATURES, options.hands, strict=True)})


def origin_of(bundle: Bundle, options: InferenceOptions, setup: Setup, meanings: tuple[PlanMeaning, ...]) -> Origin:
    """The provenance of a performance, as a plan records it: the options with everything filled in."""
    # A plan must render alike with a later version whose defaults differ.
    used = replace(options, speaker=bundle.speakers[setup.speaker],
                   interpreter=options.interpreter or bundle.interpreters[0],
                   temperature=setup.temperature, beta=setup.beta,
                   activity=bundle.config.selection.activity if options.activity is None else options.activity,
                   controls=setup.controls, hand_height=None, hand_speed=None, hand_radius=None)
    program = {"gesticulator": __version__,
               "bundle": {"preset": bundle.config.name, "lexicon": lexicon_hash(bundle.vectors)}}
    return Origin(used, program, _settings(used, setup), setup.score_is, meanings)


def _settings(used: InferenceOptions, setup: Setup) -> dict[str, Any]:
    """Everything that a generation depends on, in plain values. used: options with everything filled in."""
    settings: dict[str, Any] = {
        "speaker": used.speaker, "interpreter": interpreter_name(used.interpreter or ""), "words": setup.text,
        "seed": int(used.seed), "variation": int(used.variation),
        **{key: float(getattr(used, key)) for key in ("temperature", "activity", "fps", "gain")}}
    if used.beta is not None:
        settings["beta"] = float(used.beta)
    if used.legs or used.seated:
        settings["legs"] = "seated" if used.seated else "standing"
    for feature in FEATURES:
        value = getattr(setup.controls, feature)
        if value is not None:
            settings[f"hand_{feature}"] = ({"times": list(value.times), "values": list(value.values)}
                                           if isinstance(value, Curve) else float(value))
    return settings
