"""The targets of the hands as they are written on the command line: a level, or a number in the unit of its feature."""

import warnings

from data_module.controls import FEATURES, LEVELS, Levels
from data_module.errors import InputError

UNITS = {"height": "m", "speed": "m/s", "radius": "m"}
LIMITS = {"height": (-1.5, 2.0), "speed": (0.0, 20.0), "radius": (0.0, 2.0)}
"""Smallest and greatest values of the features: no body does more."""
# Spreads from the mean beyond which a value is far from the training data.
_FAR = 3.0


class ControlWarning(UserWarning):
    """A control value is valid, but far from the training data."""


def parse(flag: str, text: str, feature: str, levels: Levels) -> float:
    """The target of a feature from "low", "mid" or "high", or a number in its unit. `InputError` names the flag. A
    value far from the training data gives a `ControlWarning` and is used."""
    plain = text.strip()
    if plain.lower() in LEVELS:
        return levels.value(feature, plain.lower())
    try:
        number, (low, high) = float(plain), LIMITS[feature]
    except ValueError:
        raise InputError(f"{flag} {text!r}", f"is neither a level nor a number ({UNITS[feature]})",
                         f"give {', '.join(LEVELS)} or a number such as {levels.value(feature, 'mid'):.2f}") from None
    if not low <= number <= high:  # also NaN
        raise InputError(f"{flag} {plain}", f"is not a possible {feature} of a hand",
                         f"give {UNITS[feature]} from {low:g} to {high:g}")
    index = FEATURES.index(feature)
    if abs(number - levels.mean[index]) > _FAR * levels.spread[index]:
        # Attributed to this module, because commands show only the warnings of our packages.
        warnings.warn(ControlWarning(
            f"{flag} {plain}: a {feature} of {number:g} {UNITS[feature]} is far from the training data (low "
            f"{levels.value(feature, 'low'):.2f}, high {levels.value(feature, 'high'):.2f}); expect less"),
            stacklevel=1)
    return number
