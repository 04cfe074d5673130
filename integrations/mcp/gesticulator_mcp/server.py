"""The tools, with the descriptions that a language model reads; their schemas come from the signatures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Annotated, Any, Literal

from mcp.server.mcpserver import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from pydantic import BaseModel, Field

from data_module.errors import InputError, one_line
from gesticulator.cli import __version__
from gesticulator_mcp.studio import Studio, listed

Formats = Annotated[list[str], Field(description="Suffixes of the files to write besides the page: bvh, glb, vrma, "
                                     "fbx, usda, csv and others.")]
Character = Annotated[str, Field(description="Path of a character (VRM, GLB, BVH); empty: the default figure.")]
Energy = Literal["calm", "neutral", "lively"]


class PlacedGesture(BaseModel):
    """A gesture at a word or at a time."""

    gesture: str = Field(description="A name of list_gestures.")
    word: str | None = Field(None, description="The spoken word at which it is made; or give a time.")
    occurrence: int = Field(1, ge=1, description="Which of equal words.")
    time: float | None = Field(None, ge=0, description="Seconds; in place of a word.")
    intensity: float = Field(1.0, ge=0, le=2, description="Size: 1 is usual.")
    mirror: bool = Field(False, description="Make it with the other hand.")


@contextmanager
def _mistakes_told() -> Iterator[None]:
    """The model reads what a user would read in the terminal; other errors are hidden from it."""
    try:
        yield
    except (InputError, OSError) as error:
        raise ToolError(one_line(error)) from None


def server_of(studio: Studio) -> MCPServer[Any]:
    """The server of a studio's tools."""
    server: MCPServer[Any] = MCPServer(
        "gesticulator", version=__version__, log_level="WARNING",
        instructions="Makes a character gesture to speech. perform makes a first version with a plan of its gestures; "
                     "edit_plan changes gestures in the plan, and render plays the edited plan. Everything else stays "
                     "the same, frame for frame. Show the user the address in `page`.")

    @server.tool()
    @_mistakes_told()
    def perform(speech: Annotated[str, Field(description="Path of a sound file; empty: the text is spoken.")] = "",
                text: Annotated[str, Field(description="What is said. Marks such as [shrug] make a gesture at the next "
                                           "word.")] = "",
                character: Character = "", formats: Formats = ["bvh"],  # noqa: B006 - a schema, never changed
                speaker: Annotated[str | None, Field(description="A manner of moving of the bundle.")] = None,
                energy: Energy = "neutral",
                seed: Annotated[int, Field(ge=0, description="Another number gives another take.")] = 0
                ) -> dict[str, Any]:
        """Make gestures for a recording of speech, or for a text that a synthetic voice speaks. Returns the files, the
        address of a page that plays them, and the plan, which edit_plan and render take."""
        options = {"speaker": speaker, "energy": energy, "seed": seed}
        return asdict(studio.perform(speech, text, character, formats, options))

    @server.tool()
    @_mistakes_told()
    def list_gestures(search: Annotated[str, Field(description="Words of a name or a meaning; empty: all.")] = ""
                      ) -> list[dict[str, Any]]:
        """List the gestures that have a name and a meaning, for add in edit_plan and for marks in a text."""
        return listed(search)

    @server.tool()
    @_mistakes_told()
    def edit_plan(plan: Annotated[str, Field(description="Path of a plan.")],
                  add: Annotated[list[PlacedGesture], Field(description="Gestures to make.")] = [],  # noqa: B006
                  remove: Annotated[list[str], Field(description="Names of gestures, or words at which one is made, to "
                                                     "leave out.")] = [],  # noqa: B006
                  hold_still: Annotated[list[tuple[float, float]] | None, Field(
                      description="Ranges of seconds in which the hands rest.")] = None,
                  energy: Energy | None = None,
                  intensity: Annotated[float | None, Field(ge=0, le=2, description="Size of all gestures.")] = None
                  ) -> dict[str, Any]:
        """Change the gestures of a plan; writes a new plan and returns its path. Nothing is played until render."""
        knobs = {"hold_still": None if hold_still is None else tuple(hold_still), "energy": energy,
                 "intensity": intensity}
        return studio.edit_plan(plan, [cue.model_dump() for cue in add], remove,
                                {name: value for name, value in knobs.items() if value is not None})

    @server.tool()
    @_mistakes_told()
    def render(plan: Annotated[str, Field(description="Path of a plan.")],
               speech: Annotated[str, Field(description="Path of the sound that the plan was made for.")],
               character: Character = "", formats: Formats = ["bvh"]) -> dict[str, Any]:  # noqa: B006
        """Play an edited plan. Returns the files and the address of the page."""
        return asdict(studio.render(plan, speech, character, formats))

    return server
