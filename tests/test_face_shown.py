"""The face of the default figure in pages, and in the browser client."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from face_samples import FPS
from javascript import printed_by

from data_module.types import Array
from gesticulator.face.motion import FaceMotion
from gesticulator.face.shapes import vrm
from gesticulator.face.visemes import OPENINGS, VISEMES

ROOT = Path(__file__).resolve().parents[1]


# ------------------------------------------------------------------------------------------------- one mouth everywhere

def _faces(count: int) -> Array:
    """[count, 20] faces at random, the visemes summing to 1."""
    rng = np.random.default_rng(3)
    visemes = rng.dirichlet(np.full(15, 0.2), count)
    rest = rng.uniform([0, -1, -1, -0.5, -0.3], [1, 1, 1, 0.5, 0.3], (count, 5))
    return np.concatenate([visemes, rest], axis=1)


def node(script: str, *arguments: Any) -> Any:
    """What a module prints as JSON; it has `given`, the arguments."""
    return printed_by(f"const given = {json.dumps(arguments)};\n{script}", ROOT)


def test_the_mouth_has_the_width_and_the_opening_of_each_sound() -> None:
    faces = [*np.eye(15, 20).tolist(), [1.0, *[0.0] * 16, 1.0, 0.0, 0.0]]
    *sounds, smile = np.array(node("""import { lipCurves, mouthOf } from "./viewer/src/mouth.js";
        console.log(JSON.stringify(given[0].map((face) => lipCurves(mouthOf(face), 21))));""", faces))
    curves = np.array(sounds)
    gaps, half = (curves[..., 2] - curves[..., 4]).max(axis=1), curves[:, -1, 0]
    assert np.corrcoef(gaps, OPENINGS)[0, 1] > 0.99 and gaps[VISEMES.index("PP")] < 0.001
    assert half[VISEMES.index("ou")] < half[VISEMES.index("oh")] < half[0] < half[VISEMES.index("ih")]
    assert (np.diff(curves[..., 1:], axis=-1)[..., :2] <= 1e-9).all(), "the upper lip lies over the teeth"
    assert smile[0, 1] > smile[10, 1] + 0.002 - 0.0046, "its corners are up"
    assert smile[0, 2] > smile[10, 2] + 0.003


def test_the_browser_client_has_the_expressions_of_files() -> None:
    values = _faces(30)
    face = FaceMotion(values[:, :15], values[:, 15], values[:, 16], values[:, 17], values[:, 18:], FPS)
    got = node("""import { expressionsOf } from "./integrations/gesticulator-client/src/face.js";
        console.log(JSON.stringify(given[0].map(expressionsOf)));""", values.tolist())
    for name, curve in vrm(face).items():
        if not name.startswith("look"):
            np.testing.assert_allclose([one[name] for one in got], curve, atol=1e-9, err_msg=name)


def test_a_stream_and_its_player_hand_on_the_face() -> None:
    """Faces come with their frames; where the stream ends, the mouth shuts without a jump."""
    got = node("""import { GestureStream, SteadyPlayer } from "./integrations/gesticulator-client/src/index.js";
        const stream = Object.create(GestureStream.prototype);
        const welcome = { joints: [{ name: "Hips", parent: -1, offset: [0, 0, 0] }] };
        const empty = { frames: new Map(), fps: 60, end: 0, offset: 0, total: 0, source: 0 };
        Object.assign(stream, { ...empty, cut: Infinity, welcome, onEvent() {} });
        const text = JSON.stringify({ type: "poses", first: 0, count: 30, joints: 1, state: "speaking", face: 20 });
        const head = text.padEnd(Math.ceil(text.length / 4) * 4);
        const numbers = Float32Array.from({ length: 30 * (4 + 3 + 20) });
        for (let k = 0; k < 30; k++) {
          numbers[4 * k] = 1;
          numbers[30 * 7 + 20 * k + 10] = k / 30; // aa
        }
        const packet = new Uint8Array(4 + head.length + numbers.byteLength);
        new DataView(packet.buffer).setUint32(0, head.length, true);
        packet.set(new TextEncoder().encode(head), 4);
        packet.set(new Uint8Array(numbers.buffer), 4 + head.length);
        stream.take(packet.buffer);
        const player = new SteadyPlayer(stream), shown = [];
        for (let k = 0; k < 90; k++) shown.push(player.poseAt(k / 60 + 1e-4).face[10]);
        console.log(JSON.stringify(shown));""")
    np.testing.assert_allclose(got[:30], np.arange(30) / 30, atol=1e-6)
    assert np.abs(np.diff(got)).max() < 0.2 and got[29] > 0.9 and got[-1] < 1e-3
