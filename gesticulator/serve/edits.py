"""The plans of one recording, rendered again and again while they are edited: an edit costs what it changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gesticulator.directing.directions import planned
from gesticulator.export.html import describe_motion
from gesticulator.options import InferenceOptions
from gesticulator.performance import Performance
from gesticulator.plan.exchange import PlanExchange
from gesticulator.plan.plan import GesturePlan

if TYPE_CHECKING:
    from gesticulator.directing.editing import PlanRenderer
    from gesticulator.pipeline import Gesticulator

MOST_DRAWINGS = 4
"""First drawings that are kept at once: the takes of a page, and plans that were opened from files since."""


class LivePlans:
    """Renders plans of the recording of a performance. Not for several threads at once."""

    def __init__(self, system: Gesticulator, performance: Performance) -> None:
        """performance: any of this recording; its sound and words are used."""
        self._system, self._speech, self._name = system, performance.speech, performance.sound_name
        self._renderers: list[tuple[tuple[Any, ...], PlanRenderer]] = []  # the last used is the last
        self._exchange = PlanExchange()

    def prepare(self, plan: GesturePlan) -> None:
        """Draw what a plan replays, so that the first edit of it is fast."""
        self._renderer(planned(InferenceOptions(plan=plan)))

    def render(self, plan: GesturePlan) -> Performance:
        """The plan as it is now; `InputError` with its line where it cannot be used, or is of another recording."""
        options = planned(InferenceOptions(plan=plan))
        made = self._system.render(self._speech, options, self._renderer(options))
        return made.labelled(self._name, plan.notes)

    def answer(self, plan: dict[str, Any]) -> dict[str, Any]:
        """What a page is told of a plan that it sent as JSON."""
        made = self.render(self._exchange.read(plan))
        return {**describe_motion(made.scene()), "plan": self._exchange.plain(made.plan())}

    def _renderer(self, options: InferenceOptions) -> PlanRenderer:
        plan = options.plan
        assert plan is not None
        # All that tells a first drawing. Equal parts of plans that a page sends are the same objects, so that equal
        # tuples are found without looking into them.
        replayed = (plan.made_by, plan.seed, plan.variation, plan.speaker, plan.interpreter, plan.drawn, plan.words)
        at = next((at for at, (known, _) in enumerate(self._renderers) if known == replayed), None)
        found = (replayed, self._system.plan_renderer(self._speech, options)) if at is None else self._renderers.pop(at)
        self._renderers = [*self._renderers, found][-MOST_DRAWINGS:]
        return found[1]
