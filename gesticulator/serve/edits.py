"""The plans of one recording, rendered again and again while they are edited: an edit costs what it changes."""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from gesticulator.directing.directions import planned
from gesticulator.export.html import describe
from gesticulator.options import InferenceOptions
from gesticulator.performance import Performance
from gesticulator.plan.plan import GesturePlan, parse_plan

if TYPE_CHECKING:
    from gesticulator.directing.editing import PlanRenderer
    from gesticulator.pipeline import Gesticulator

MOST_DRAWINGS = 4
"""First drawings that are kept at once: the takes of a page, and plans that were opened from files since."""
_REPLAYED = ("made_by", "seed", "variation", "speaker", "interpreter", "drawn", "words")
"""Members of a plan that tell its first drawing."""


class LivePlans:
    """Renders plans of the recording of a performance. Not for several threads at once."""

    def __init__(self, system: Gesticulator, performance: Performance) -> None:
        """performance: any of this recording; its sound and words are used."""
        self._system, self._speech, self._name = system, performance.speech, performance.sound_name
        self._renderers: OrderedDict[str, PlanRenderer] = OrderedDict()

    def prepare(self, plan: GesturePlan) -> None:
        """Draw what a plan replays, so that the first edit of it is fast."""
        self._renderer(planned(InferenceOptions(plan=plan)))

    def render(self, plan: GesturePlan) -> Performance:
        """The plan as it is now; `InputError` with its line where it cannot be used, or is of another recording."""
        options = planned(InferenceOptions(plan=plan))
        made = self._system.render(self._speech, options, self._renderer(options))
        return replace(made, sound_name=self._name, notes=plan.notes)

    def answer(self, plan: dict[str, Any]) -> dict[str, Any]:
        """What a page is told of a plan that it sent as JSON."""
        return describe(self.render(parse_plan(json.dumps(plan, indent=1), "plan")).scene())

    def _renderer(self, options: InferenceOptions) -> PlanRenderer:
        plan = options.plan
        assert plan is not None
        replayed = plan.to_dict()
        key = json.dumps([replayed.get(name) for name in _REPLAYED], sort_keys=True)
        if key not in self._renderers:
            self._renderers[key] = self._system.plan_renderer(self._speech, options)
        self._renderers.move_to_end(key)
        while len(self._renderers) > MOST_DRAWINGS:
            self._renderers.popitem(last=False)
        return self._renderers[key]
