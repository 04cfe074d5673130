"""The scripts of the named gestures, as data: one or several takes of each, of which a draw chooses one.

The parts are explained in `gesticulator.directing.gesture_parts`; the names and what they mean are those of
`gesticulator.plan.gestures`.
"""

from __future__ import annotations

from gesticulator.directing.gesture_parts import GestureScript
from gesticulator.directing.scripts_of_ideas import IDEAS
from gesticulator.directing.scripts_of_people import PEOPLE
from gesticulator.directing.scripts_of_things import THINGS
from gesticulator.plan.gestures import ALIASES

SCRIPTS: dict[str, tuple[GestureScript, ...]] = {**PEOPLE, **IDEAS, **THINGS}
SCRIPTS |= {alias: SCRIPTS[name] for alias, name in ALIASES.items()}
"""Name -> its takes."""
