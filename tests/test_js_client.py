"""The npm package: its stream in a real browser against the server, its player beside the reference player, and
poses through a data channel."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from javascript import printed_by
from pipecat_gesticulator import Joint, Poses, SteadyPlayer, Welcome
from pipecat_gesticulator.messages import LONGEST, hello_messages, pose_messages, to_rtvi

from data_module.motion import rotation

FOLDER = Path(__file__).resolve().parents[1] / "integrations" / "gesticulator-client"
def node(script: str) -> Any:
    """What a module in the package's folder prints as JSON."""
    return printed_by(script, FOLDER)


SOCKETS = """
    import { GestureStream } from "./src/stream.js";
    const sockets = [], pause = (time) => new Promise((go) => setTimeout(go, time));
    class Socket {
      static OPEN = 1;
      constructor() { this.sent = []; this.readyState = 1; sockets.push(this); }
      send(data) { this.sent.push(typeof data === "string" ? JSON.parse(data) : data.length); }
      close() {}
      say(message) { this.onmessage({ data: JSON.stringify(message) }); }
      hello() { this.say({ type: "hello", joints: [] }); }
      poses(first, count) {
        const text = JSON.stringify({ first, count, joints: 1, fps: 60, state: "speaking" });
        const packet = new ArrayBuffer(104 + 4 * count * 7);
        new DataView(packet).setUint32(0, 100, true);
        new Uint8Array(packet, 4, 100).set(new TextEncoder().encode(text.padEnd(100)));
        this.onmessage({ data: packet });
      }
    }
"""
"""Sockets that the test answers by itself, in the order in which they were opened."""


def test_a_server_that_lost_the_stream_gets_the_sound_again_and_frames_are_numbered_on() -> None:
    """Against a socket that is written here: what is sent on the second connection, and how its frames are numbered."""
    got = node(SOCKETS + """
        const events = [];
        const onEvent = (event) => events.push(event.type);
        const stream = new GestureStream("", { sampleRate: 16000, Socket, random: () => 0, onEvent });
        sockets[0].onopen();
        sockets[0].hello();
        for (let k = 0; k < 20; k++) stream.send(new Float32Array(1600));
        stream.idle(1);
        sockets[0].poses(0, 87);
        sockets[0].onclose({ code: 1006, reason: "" });
        stream.send(new Float32Array(800));
        stream.addWords([{ text: "on", start: 3.1, end: 3.4 }]);
        await pause(200);
        sockets[1].onopen();
        sockets[1].hello();
        stream.interrupt(2.45);
        sockets[1].say({ type: "interrupted", time: 1.0 });
        sockets[1].poses(0, 30);
        sockets[1].say({ type: "state", state: "idle", time: 0.5 });
        console.log(JSON.stringify({ hello: sockets[1].sent[0], sent: sockets[1].sent.slice(1), end: stream.end,
          source: stream.frames.get(90).source, frames: [...stream.frames.keys()], events, time: stream.time }));
        stream.close();
    """)
    assert got["hello"]["type"] == "hello"
    # 87 frames are 1.45 s: half of the piece from 1.4 s, five more, the wait, and what was said meanwhile.
    assert got["sent"][:8] == [800, *[1600] * 5, {"type": "idle", "seconds": 1}, 800]
    words = got["sent"][8]["words"][0]
    assert (words["start"], words["end"]) == (pytest.approx(1.65), pytest.approx(1.95))
    assert got["sent"][9]["type"] == "interrupt" and got["sent"][9]["time"] == pytest.approx(1.0)
    assert got["frames"] == list(range(117)) and got["end"] == 117 and got["source"] == 1
    assert got["time"] == pytest.approx(2.45)
    assert got["events"] == ["hello", "poses", "lost", "back", "interrupted", "poses", "state"]


def test_an_interruption_that_the_server_did_not_answer_is_said_again() -> None:
    """Poses that were on their way when it was sent begin where those begin that would replace them."""
    got = node(SOCKETS + """
        const stream = new GestureStream("", { sampleRate: 16000, Socket, random: () => 0 });
        sockets[0].onopen();
        sockets[0].hello();
        stream.send(new Float32Array(16000));
        sockets[0].poses(0, 12);
        stream.interrupt();
        stream.idle(0.5);
        sockets[0].poses(12, 24);
        const taken = stream.end;
        sockets[0].onclose({ code: 1006, reason: "" });
        await pause(200);
        sockets[1].onopen();
        sockets[1].hello();
        const again = sockets[1].sent.slice(1);
        sockets[1].say({ type: "interrupted", time: 0 });
        sockets[1].poses(0, 30);
        console.log(JSON.stringify({ taken, again, end: stream.end }));
        stream.close();
    """)
    assert got["taken"] == 12 and got["end"] == 42
    assert got["again"] == [{"type": "interrupt", "time": 0}, {"type": "idle", "seconds": pytest.approx(0.5)}]


@pytest.mark.parametrize(("held", "retry_after"), [(0, None), (4, None), (6, None), (0, 7)])
def test_a_server_that_greets_and_breaks_is_visited_ever_less_often(held: float, retry_after: float | None) -> None:
    """Time goes by only where it is waited for; each connection is greeted, holds so many seconds, and breaks."""
    got = node(f"""
        import {{ GestureStream }} from "./src/stream.js";
        const held = {held}, retryAfter = {json.dumps(retry_after)}, due = [], visits = [], events = [];
        let now = 1e6;
        Date.now = () => now;
        globalThis.setTimeout = (go, wait) => due.push([now + wait, go]);
        class Socket {{
          static OPEN = 1;
          constructor() {{
            this.readyState = 1;
            visits.push((now - 1e6) / 1000);
            setTimeout(() => {{
              this.onopen();
              const greeting = {{ type: "hello", joints: [] }};
              this.onmessage({{ data: JSON.stringify(greeting) }});
            }}, 0);
            setTimeout(() => {{
              if (retryAfter !== null) this.onmessage({{ data: JSON.stringify(
                {{ type: "error", code: 4429, message: "full", retry_after: retryAfter }}) }});
              this.onclose({{ code: retryAfter === null ? 1006 : 4429, reason: "" }});
            }}, 1000 * held);
          }}
          send() {{}}
          close() {{}}
        }}
        const onEvent = (event) => events.push(event.type);
        new GestureStream("", {{ sampleRate: 16000, Socket, random: () => 0, patience: 60, onEvent }});
        while (due.length && visits.length < 40) {{
          due.sort((a, b) => a[0] - b[0]);
          const [at, go] = due.shift();
          now = at;
          go();
        }}
        console.log(JSON.stringify({{ visits, last: events.at(-1) }}));
    """)
    waits = np.diff(got["visits"]) - held
    if held > 5:  # each loss is a new one: soon back, and never given up
        np.testing.assert_allclose(waits, 0.125)
        assert len(waits) == 39
        return
    asked = retry_after or 0.0
    np.testing.assert_allclose(waits[:4], asked + 0.125 * 2.0 ** np.arange(4))
    assert got["last"] == "closed" and 30 < got["visits"][-1] < 65
    assert sum(at < 10 for at in got["visits"]) <= 8


def test_its_player_shows_what_the_reference_player_shows() -> None:
    """Through the stream, idling, and another connection."""
    rng = np.random.default_rng(4)
    t = np.arange(300)[:, None, None] / 60
    walk = rotation.from_exponential_map(sum(rng.normal(0, 0.3, (1, 3, 3)) * np.sin(f * t + rng.uniform(0, 6, 3))
                                             for f in (1.0, 3.0))).astype(np.float32)
    roots = rng.normal(0, 0.02, (300, 3)).cumsum(0).astype(np.float32)
    joints = tuple(Joint(name, number - 1, (0, 0, 0)) for number, name in enumerate(("Hips", "Spine1", "Neck")))
    player = SteadyPlayer(Welcome("", 60.0, "joints", 0.0, joints, {}))
    parts = [(0, 100, 0, 0), (160, 300, 160, 1)]  # frames, at which picture they come, source
    ours = []
    for picture in range(300):
        for first, end, when, source in parts:
            if picture == when:
                player.add(Poses(first, 60.0, walk[first:end], roots[first:end], "", 0.0, source))
        pose = player.pose_at(picture / 60 + 1e-4)
        assert pose is not None
        ours.append([*pose[0].ravel(), *pose[1]])
    data = json.dumps({"walk": walk.reshape(300, -1).tolist(), "roots": roots.tolist(), "parts": parts})
    theirs = node(f"""
        import {{ SteadyPlayer }} from "./src/steady.js";
        import {{ GestureStream }} from "./src/stream.js";
        const {{ walk, roots, parts }} = {data};
        const stream = Object.create(GestureStream.prototype);
        const joints = ["Hips", "Spine1", "Neck"].map((name) => ({{ name }}));
        Object.assign(stream, {{ frames: new Map(), fps: 60, end: 0, welcome: {{ joints }} }});
        const player = new SteadyPlayer(stream), shown = [];
        for (let picture = 0; picture < 300; picture++) {{
          for (const [first, end, when, source] of parts) if (picture === when) {{
            for (let k = first; k < end; k++)
              stream.frames.set(k, {{ turns: Float32Array.from(walk[k]), root: roots[k], source }});
            stream.end = end;
          }}
          const {{ turns, root }} = player.poseAt(picture / 60 + 1e-4);
          shown.push([...turns, ...root]);
        }}
        console.log(JSON.stringify(shown));
    """)
    np.testing.assert_allclose(np.array(theirs), np.array(ours), atol=1e-5)
    assert np.abs(np.diff(np.array(ours)[:, 12:], axis=0)).max() < 0.12


@pytest.mark.parametrize("face", [False, True])
def test_poses_through_a_data_channel_are_those_that_were_sent(face: bool) -> None:
    """In messages of bounded size, read by the browser's client; what an interruption took back is replaced."""
    rng = np.random.default_rng(5)
    joints = tuple(Joint(f"Joint{number}", number - 1, tuple(rng.normal(0, 0.2, 3))) for number in range(46))
    welcome = Welcome("1", 60.0, "joints", 1.63, joints, {})

    def packet(first: int, count: int, source: int) -> Poses:
        turns = rotation.from_exponential_map(rng.normal(0, 1.0, (count, 46, 3))).astype(np.float32)
        return Poses(first, 60.0, turns, rng.normal(0, 1, (count, 3)).astype(np.float32), "speaking", 0.0, source,
                     rng.uniform(0, 1, (count, 20)).astype(np.float32) if face else None)

    packets = [packet(0, 100, 0), packet(100, 1, 0), packet(60, 30, 1)]
    sent = [to_rtvi(one) for one in hello_messages(welcome)]
    sent += [to_rtvi(one) for k, poses in enumerate(packets) for one in pose_messages(poses, 2.5 + k)]
    assert max(len(json.dumps(one)) for one in sent) <= LONGEST
    got = node(f"""
        import {{ MessageStream }} from "./src/index.js";
        let now = 10;
        const stream = new MessageStream({{ clock: () => now }});
        if (stream.take({{ type: "metrics" }}) || stream.time !== 0) throw new Error("not ours");
        for (const one of {json.dumps(sent)}) if (!stream.take(one)) throw new Error("ours");
        now += 0.25;
        const shown = [...stream.frames].map(([k, {{ turns, root, source, face }}]) =>
          [k, source, [...turns], [...root], [...(face ?? [])]]);
        console.log(JSON.stringify([stream.welcome.joints, stream.end, stream.time, shown]));
    """)
    assert [one["name"] for one in got[0]] == [one.name for one in joints] and got[1] == 90
    assert got[2] == pytest.approx(4.75)
    assert [row[0] for row in got[3]] == list(range(90)) and {row[1] for row in got[3][60:]} == {1}
    ours = np.concatenate([packets[0].rotations[:60], packets[2].rotations])
    np.testing.assert_allclose([row[2] for row in got[3]], ours.reshape(90, -1), atol=4e-5)
    if face:
        assert packets[0].face is not None and packets[2].face is not None
        np.testing.assert_allclose([row[4] for row in got[3]], np.concatenate([packets[0].face[:60], packets[2].face]))
