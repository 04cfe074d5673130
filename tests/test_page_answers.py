"""What the page shows of answers that come in parts, and of those that it abandons: its modules, run without a browser.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from javascript import printed_by

SOURCES = Path(__file__).resolve().parents[1] / "viewer" / "src"
FRAMES, UNIT = 4, 32767
SCRIPT = """
import { Live } from "./live.js";
import { Session } from "./session.js";

const base64 = (bytes) => Buffer.from(bytes.buffer).toString("base64");
const skeleton = (...names) => ({ names, parents: names.map((_, k) => k - 1), offsets: names.map(() => [0, 0, 0]) });
const numbers = (frames, joints, step) => Int16Array.from({ length: frames * joints * 4 }, (_, k) => k * step);
const draw = { seed: 0, variation: 0, block: 0 };
const block = { start: 0, end: 1, lexeme: 1, silent: false, draw, alternatives: [] };
const shape = { fps: 4, frames: 4, duration: 1, steps: 32767, skeleton: skeleton("Hips", "LeftHand") };
const sent = { name: "one", ...shape, rotations: base64(numbers(4, 2, 10)), root: base64(new Float32Array([0, 1, 0])),
  plan: { blocks: [block], speaker: "a" } };
const session = new Session({ takes: [sent] });
const shown = () => [...session.take.rotations].map((value) => Math.round(value * 32767));
const message = (header, data = new Int16Array(0)) => {
  const bytes = new Uint8Array(data.buffer);
  const text = new TextEncoder().encode(JSON.stringify({ ...header, bytes: bytes.length }));
  const out = new Uint8Array(4 + text.length + bytes.length);
  new DataView(out.buffer).setUint32(0, text.length, true);
  out.set(text, 4);
  out.set(bytes, 4 + text.length);
  return out;
};
let parts = [], asked = [];
globalThis.fetch = async (_, { body, signal }) => {
  asked.push(JSON.parse(body));
  const stream = new ReadableStream({
    start(sink) {
      for (const part of parts) sink.enqueue(part);
      signal.addEventListener("abort", () => sink.error(new Error("abandoned")));
    },
  });
  return { ok: true, status: 200, body: stream };
};
const said = [];
new Live(session, { token: "t", renderings: [7] }, (state) => said.push(state));
const rest = () => new Promise((go) => setTimeout(go, 80));
const out = { first: shown() };

// A draft of two frames; the user takes the edit back before more comes.
parts = [message({ kind: "frames", ranges: [[1, 3]], share: 0 }, numbers(2, 2, -10)),
  message({ kind: "progress", ranges: [], share: 0.5 })];
session.edit({ ...session.plan, speaker: "b" });
await rest();
out.draft = shown();
session.undo();
await rest();
out.undone = shown();

// The draft of another one has more joints; the next edit begins from what was whole, and is answered as a whole.
const legs = { ...shape, skeleton: skeleton("Hips", "LeftUpLeg", "LeftHand") };
parts = [message({ kind: "frames", ranges: [[1, 2]], share: 0, root: 0, shape: legs }, numbers(1, 3, 1))];
session.edit({ ...session.plan, speaker: "c" });
await rest();
out.legs = shown();
parts = [message({ kind: "done", rendering: 8, shape: null, root: 0, ranges: [[0, 1]],
  changes: { blocks: [], parts: {} } }, numbers(1, 2, 7))];
session.edit({ ...session.plan, speaker: "d" });
await rest();
out.done = shown();
out.asked = asked.map(({ have }) => have);
out.same = session.plan === session.lane.rendered && said.at(-1) === "same";
console.log(JSON.stringify(out));
process.exit(0);
"""


def _answers() -> dict[str, Any]:
    answers: dict[str, Any] = printed_by(SCRIPT, SOURCES)
    return answers


def test_a_draft_is_shown_and_goes_when_its_edit_is_abandoned() -> None:
    answers = _answers()
    first = [10 * at for at in range(FRAMES * 2 * 4)]
    assert answers["first"] == first
    draft = [-10 * at for at in range(16)]
    assert answers["draft"] == [*first[:8], *draft, *first[24:]], "the visible stretch; the rest stays"
    assert answers["undone"] == first
    # Joints of the same name turn as before outside of the draft, and new ones hang straight.
    legs = [answers["legs"][at:at + 4] for at in range(0, FRAMES * 3 * 4, 4)]
    assert legs[3:6] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]
    assert legs[0] == first[:4] and legs[1] == [UNIT, 0, 0, 0] and legs[2] == first[4:8]
    assert legs[11] == first[28:32]
    # What was abandoned is forgotten: the answer is patched onto the last whole motion, which the page named.
    assert answers["done"] == [*(7 * at for at in range(8)), *first[8:]]
    assert answers["asked"] == [7, 7, 7] and answers["same"]
