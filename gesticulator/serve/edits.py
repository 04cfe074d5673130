"""Rendering of one recording's plans while they are edited; each edit costs only the blocks that it changes."""

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
"""First generations in memory: for the takes of a page, and for plans that were opened from files since."""


class LivePlans:
    """Renders plans of the recording of a performance. Not thread-safe."""

    def __init__(self, system: Gesticulator, performance: Performance) -> None:
        """performance: any performance of the recording; its sound and words are used."""
        self._system, self._speech, self._name = system, performance.speech, performance.sound_name
        self._renderers: list[tuple[tuple[Any, ...], PlanRenderer]] = []  # the most recently used comes last
        self._exchange = PlanExchange()

    def prepare(self, plan: GesturePlan) -> None:
        """Generate the blocks that a plan replays, so that its first edit is fast."""
        self._renderer(planned(InferenceOptions(plan=plan)))

    def render(self, plan: GesturePlan) -> Performance:
        """Render a plan; `InputError` with the line if it is invalid or of another recording."""
        options = planned(InferenceOptions(plan=plan))
        performance = self._system.render(self._speech, options, self._renderer(options))
        return performance.labelled(self._name, plan.notes)

    def answer(self, plan: dict[str, Any]) -> dict[str, Any]:
        """The answer to a page that sent this plan as JSON: motion and rendered plan."""
        performance = self.render(self._exchange.read(plan))
        return {**describe_motion(performance.scene()), "plan": self._exchange.plain(performance.plan())}

    def _renderer(self, options: InferenceOptions) -> PlanRenderer:
        plan = options.plan
        assert plan is not None
        # Everything that identifies a first generation. Equal parts of the plans that a page sends are the same
        # objects, so comparing the tuples is fast.
        key = (plan.made_by, plan.seed, plan.variation, plan.speaker, plan.interpreter, plan.drawn, plan.words)
        at = next((at for at, (known, _) in enumerate(self._renderers) if known == key), None)
        entry = (key, self._system.plan_renderer(self._speech, options)) if at is None else self._renderers.pop(at)
        self._renderers = [*self._renderers, entry][-MOST_DRAWINGS:]
        return entry[1]
