"""Edit a gesture plan: silence the start, replace a gesture, make one larger; everything else stays the same.

    python examples/edit_plan.py examples/speech.flac edited.bvh plan.json
"""

from __future__ import annotations

import sys
from dataclasses import replace

from gesticulator import Gesticulator
from gesticulator.plan.plan import edited_blocks
from gesticulator.plan.plan_file import write_plan_file


def main(sound: str, output: str, plan_output: str) -> None:
    """Draw once, edit what was decided, and render that."""
    gesticulator = Gesticulator.from_pretrained()
    plan = gesticulator(sound).plan()
    blocks = list(plan.blocks)
    for at, block in enumerate(blocks):
        if 1.0 <= block.start < 1.5:
            blocks[at] = replace(block, silent=True)
        elif 2.0 <= block.start < 2.5:  # the best other lexeme of those that were considered
            other = next(one for one in block.alternatives if one.lexeme != block.lexeme)
            blocks[at] = replace(block, lexeme=other.lexeme)
        elif block.start >= 3.0:
            blocks[at] = replace(block, intensity=1.4)
    plan = replace(plan, blocks=tuple(blocks))
    made = gesticulator(sound, plan=plan)
    print(f"{made.save(output)}: {sum(edited_blocks(plan))} of {len(blocks)} blocks are generated again "
          f"-> {write_plan_file(plan_output, made.plan())}")


if __name__ == "__main__":
    main(*sys.argv[1:])
