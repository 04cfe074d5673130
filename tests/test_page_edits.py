"""Edits on the page by its modules, run without a browser: moves keep time whole and gestures alike, an edit waits for
a renderer that is away, and what was kept goes on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from javascript import printed_by

SOURCES = Path(__file__).resolve().parents[1] / "viewer" / "src"
MOVES = """
import { dragged, slid, snapped } from "./plan.js";
import { valueAt } from "./curves.js";
const { lengths, moves, marks, times } = JSON.parse(process.argv[1] ?? process.argv.at(-1));
let at = 0;
const blocks = lengths.map((length, k) => {
  const start = at;
  at = Math.round((at + length) * 1000) / 1000;
  return { start, end: at, lexeme: k, silent: false, flag: "onset", intensity: 1 + k / 100 };
});
const plan = { blocks };
console.log(JSON.stringify({ plan, made: moves.map(([first, last, time, copy]) => ({
  dragged: dragged(plan, first, last, time, copy), slid: slid(plan, first, last, time - blocks[first].start),
})), snapped: times.map((time) => snapped(time, marks, 0.05)),
curve: times.map((time) => valueAt([[0.5, 1], [1, 0], [2, 2]], time)) }));
"""
AWAY = """
import { Live } from "./live.js";
import { Session } from "./session.js";
const base64 = (bytes) => Buffer.from(bytes.buffer).toString("base64");
const skeleton = { names: ["Hips"], parents: [-1], offsets: [[0, 0, 0]] };
const shape = { fps: 4, frames: 1, duration: 1, steps: 32767, skeleton };
const draw = { seed: 0, variation: 0, block: 0 };
const block = { start: 0, end: 1, lexeme: 1, silent: false, draw, alternatives: [] };
const session = new Session({ takes: [{ name: "one", ...shape, rotations: base64(Int16Array.of(32767, 0, 0, 0)),
  root: base64(new Float32Array([0, 1, 0])), plan: { blocks: [block], speaker: "a" } }] });
const done = (() => {
  const changes = { blocks: [], parts: {} };
  const header = { kind: "done", rendering: 8, shape: null, root: 0, ranges: [], changes, bytes: 0 };
  const text = new TextEncoder().encode(JSON.stringify(header)), out = new Uint8Array(4 + text.length);
  new DataView(out.buffer).setUint32(0, text.length, true);
  out.set(text, 4);
  return out;
})();
const said = [], asked = [];
const answers = [
  () => { throw new TypeError("fetch failed"); },                          // nothing listens
  () => ({ ok: false, status: 404, text: async () => "{}" }),              // another program, or the one started again
  () => ({ ok: true, status: 200, body: new ReadableStream({ start(sink) { sink.close(); } }) }),  // it died meanwhile
  () => ({ ok: true, status: 200, body: new ReadableStream({ start(sink) { sink.enqueue(done); sink.close(); } }) }),
];
globalThis.fetch = async (path, { body, headers }) => {
  asked.push([path, headers["X-Gesticulator-Token"], JSON.parse(body).have ?? null]);
  return answers.shift()();
};
const live = new Live(session, { token: "t", renderings: [7] }, (state) => said.push(state));
const rest = (time) => new Promise((go) => setTimeout(go, time));
session.edit({ ...session.plan, speaker: "b" });
await rest(100);
const { plan } = session;
await rest(2100);
live.moved("/new/", "u");
await rest(100);
await rest(2100);
console.log(JSON.stringify({ said, asked, kept: session.plan.speaker, same: session.plan === session.lane.rendered }));
process.exit(0);
"""
KEPT = """
import { Kept } from "./kept.js";
import { Session } from "./session.js";
const base64 = (bytes) => Buffer.from(bytes.buffer).toString("base64");
const skeleton = { names: ["Hips"], parents: [-1], offsets: [[0, 0, 0]] };
const shape = { fps: 4, frames: 1, duration: 1, steps: 32767, skeleton };
const block = (lexeme) => ({ start: 0, end: 1, lexeme, silent: false });
const opened = () => new Session({ takes: [{ name: "one", ...shape, rotations: base64(Int16Array.of(32767, 0, 0, 0)),
  root: base64(new Float32Array([0, 1, 0])), plan: { blocks: [block(1)] } }] });
const store = new Map();
let room = 9;
const methods = { getItem: (name) => store.get(name) ?? null, removeItem: (name) => store.delete(name),
  setItem: (name, text) => {
    if (!store.has(name) && store.size >= room) throw new Error("full");
    store.set(name, text);
  } };
globalThis.localStorage = new Proxy(methods, { ownKeys: () => [...store.keys()],
  getOwnPropertyDescriptor: (_, name) => ({ value: store.get(name), enumerable: true, configurable: true }) });
globalThis.addEventListener = () => {};
const rest = () => new Promise((go) => setTimeout(go, 500));
const out = {};
const one = opened();
new Kept(one, "here", () => {});
one.edit({ ...one.plan, blocks: [block(2)] });
await rest();
const now = Date.now();
const lexeme = (since) => {
  const session = opened();
  new Kept(session, "here", () => {}, since);
  return session.plan.blocks[0].lexeme;
};
out.soon = lexeme(now - 60_000);     // the program ended before it had saved the edit
out.same = lexeme(now + 2000);       // it saved it, a little later
out.later = lexeme(now + 60_000);    // the plan file was changed since
out.left = [...store.keys()];
// A full storage makes room: what was kept of other pages goes.
store.set("gesticulator edits there", "old");
store.set("other", "stays");
room = 3;
const two = opened();
new Kept(two, "here", () => {});
two.edit({ ...two.plan, blocks: [block(3)] });
await rest();
out.full = [...store.keys()].sort();
console.log(JSON.stringify(out));
process.exit(0);
"""


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(100, 1000), min_size=3, max_size=12), st.data())
def test_moved_blocks_tile_the_time_and_keep_their_gestures(lengths: list[int], data: st.DataObject) -> None:
    count, duration = len(lengths), sum(lengths) / 1000
    moves = []
    for _ in range(12):
        first = data.draw(st.integers(0, count - 1))
        moves.append([first, data.draw(st.integers(first, count - 1)), data.draw(st.floats(0, duration)),
                      data.draw(st.booleans())])
    told = printed_by(MOVES, SOURCES, json.dumps({"lengths": [one / 1000 for one in lengths], "moves": moves,
                                                  "marks": [], "times": []}))
    before = told["plan"]["blocks"]
    for (first, last, time, copied), made in zip(moves, told["made"], strict=True):
        (moved, place), slid = made["dragged"], made["slid"]
        for blocks in (moved["blocks"], slid["blocks"]):
            edges = [one["start"] for one in blocks] + [blocks[-1]["end"]]
            assert edges[0] == 0 and edges[-1] == before[-1]["end"] and len(blocks) == count
            assert [one["end"] for one in blocks[:-1]] == edges[1:-1]
            assert all(0.0999 <= b - a <= 1.0001 for a, b in zip(edges, edges[1:], strict=False))
        # Slid blocks are as long as before, and all but their neighbours stay.
        for at, (now, was) in enumerate(zip(slid["blocks"], before, strict=True)):
            if first <= at <= last:
                assert now["end"] - now["start"] == pytest.approx(was["end"] - was["start"], abs=1.1e-3)
            elif not first - 1 <= at <= last + 1:
                assert now == was
        size = last - first + 1
        assert 0 <= place <= count - size
        gestures = [(one["lexeme"], one["intensity"]) for one in moved["blocks"][place:place + size]]
        assert gestures == [(one["lexeme"], one["intensity"]) for one in before[first:last + 1]]
        for at, now in enumerate(moved["blocks"]):
            if not place <= at < place + size:
                assert now["silent"] == (first <= at <= last and not copied and place != first)
                assert now["lexeme"] == before[at]["lexeme"]
        if place != first:
            nearest = min(range(count), key=lambda at: (abs(before[at]["start"] - time), at))
            assert place == min(nearest, count - size)


def test_times_snap_to_the_nearest_mark_within_reach_and_curves_are_straight_between_points() -> None:
    told = printed_by(MOVES, SOURCES, json.dumps({"lengths": [0.5], "moves": [], "marks": [1.0, 1.06, 3.0],
                                   "times": [0.2, 0.75, 1.02, 1.04, 1.5, 3.049, 3.2]}))
    assert told["snapped"] == [0.2, 0.75, 1.0, 1.06, 1.5, 3.0, 3.2]
    assert told["curve"] == pytest.approx([1, 0.5, 0.04, 0.08, 1, 2, 2])


def test_an_edit_waits_for_a_renderer_that_is_away_and_goes_to_where_it_is_again() -> None:
    told = printed_by(AWAY, SOURCES)
    assert told["kept"] == "b" and told["same"]
    assert told["asked"] == [["render", "t", 7], ["render", "t", 7], ["/new/render", "u", None],
                             ["/new/render", "u", None]]
    assert told["said"].count("bad") == 2, "it is told once each time that it goes away"
    assert "away" in told["said"] and told["said"][-1] == "same"


def test_the_later_of_what_the_browser_kept_and_what_the_program_saved_goes_on() -> None:
    told = printed_by(KEPT, SOURCES)
    assert told["soon"] == told["same"] == 2 and told["later"] == 1 and told["left"] == []
    assert told["full"] == ["gesticulator edits here", "gesticulator edits here at", "other"]
