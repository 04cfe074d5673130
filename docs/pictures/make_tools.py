"""The pictures of the pages about tools, made of files as `gesticulator ... -o` writes them.

    python docs/pictures/make_tools.py [FOLDER [NAME ...]]

FOLDER is docs/pictures/tools unless another is given, NAME one of `PICTURES` (all of them). `blender` is rendered by
Blender, `threejs` and `vrm` are shots of a page in Chromium (`npm ci --prefix tests/js`, playwright). Unity, Unreal and
Godot cannot be run without a screen and an account: their pictures show the joints of the very file that is imported
there, in the axes and units of the tool. Needs matplotlib and Pillow, too.
"""

from __future__ import annotations

import io
import json
import mimetypes
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from doll import write_doll

from data_module.files import write_bytes
from data_module.types import Array
from gesticulator import Gesticulator, Performance
from gesticulator.characters.blender import run_in_blender

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SECONDS, FPS = 6.0, 30.0
WIDTH, HEIGHT = 480, 400
"""Pixels."""
COLOURS = 96
"""Of a picture's palette: keeps it under 60 kB."""
INK, SOFT, PALE, PAPER = "#262a31", "#8d8578", "#ded7ca", "#dfe3e2"
RED, GREEN, BLUE = "#c8553d", "#4f8a3c", "#3f6fb0"

PAGE = """<!doctype html><meta charset="utf-8"><style>body { margin: 0 }</style>
<script type="importmap">{ "imports": {
  "three": "/node_modules/three/build/three.module.js", "three/addons/": "/node_modules/three/examples/jsm/",
  "@pixiv/three-vrm": "/node_modules/@pixiv/three-vrm/lib/three-vrm.module.js",
  "@pixiv/three-vrm-animation": "/node_modules/@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js"
} }</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import { VRMAnimationLoaderPlugin, createVRMAnimationClip } from "@pixiv/three-vrm-animation";
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
renderer.setSize(innerWidth, innerHeight);
renderer.shadowMap.enabled = true;
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
scene.background = new THREE.Color("#dfe3e2");
const sun = new THREE.DirectionalLight("#fff4e2", 2.6);
sun.position.set(1.5, 3, 2.5);
sun.castShadow = true;
sun.shadow.mapSize.set(2048, 2048);
scene.add(sun, new THREE.HemisphereLight("#dfeaf2", "#8a8072", 1.6));
const floor = new THREE.Mesh(new THREE.CircleGeometry(12, 64), new THREE.MeshStandardMaterial({ color: "#c9c4ba" }));
floor.rotation.x = -Math.PI / 2;
floor.receiveShadow = true;
scene.add(floor);
const camera = new THREE.PerspectiveCamera(31, innerWidth / innerHeight, 0.1, 50);
camera.position.set(1.35, 1.55, 3.6);
camera.lookAt(0, 0.93, 0);
const loader = new GLTFLoader();
loader.register((parser) => new VRMLoaderPlugin(parser));
loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
window.play = async (model, motion, seconds) => {
  const gltf = await loader.loadAsync(model);
  const vrm = gltf.userData.vrm, root = vrm ? vrm.scene : gltf.scene;
  const clip = motion ? createVRMAnimationClip((await loader.loadAsync(motion)).userData.vrmAnimations[0], vrm)
                      : gltf.animations.at(-1);
  root.traverse((node) => { node.castShadow = true; node.frustumCulled = false; });
  scene.add(root);
  const mixer = new THREE.AnimationMixer(root);
  mixer.clipAction(clip).play();
  mixer.setTime(seconds);
  if (vrm) vrm.update(0);
  renderer.render(scene, camera);
};
window.ready = true;
</script>"""


class Tool(NamedTuple):
    """How a tool sees our axes. rows: its X, Y and Z in ours (Y up, she faces +Z, her left is +X); unit: of lengths,
    with how many of it a metre has."""

    suffix: str
    rows: tuple[tuple[int, int, int], ...]
    unit: str
    in_a_metre: float


TOOLS = {
    "unity": Tool(".fbx", ((-1, 0, 0), (0, 1, 0), (0, 0, 1)), "m", 1.0),
    "unreal": Tool(".fbx", ((1, 0, 0), (0, 0, 1), (0, 1, 0)), "cm", 100.0),
    "godot": Tool(".glb", ((1, 0, 0), (0, 1, 0), (0, 0, 1)), "m", 1.0),
}
"""Unity and Unreal are left-handed; Unreal's Z is up, and characters face +Y before they are turned to +X."""


@dataclass(frozen=True)
class Scene:
    """A gesture on the doll, its files in a folder, and the frame that is shown: both hands are highest in it."""

    made: Performance
    folder: Path
    frame: int


def make_scene(folder: Path) -> Scene:
    """The example recording, gestured by the shipped weights."""
    import soundfile

    samples, rate = soundfile.read(ROOT / "examples" / "speech.flac", frames=round(SECONDS * 16000))
    plain = Gesticulator.from_pretrained()(samples, rate, fps=FPS, legs=True)
    made = plain.on(write_doll(folder / "doll.glb"))
    write_doll(folder / "doll.vrm", vrm=True)
    for name in ("talk.glb", "talk.fbx"):
        made.save(folder / name)
    plain.save(folder / "talk.vrma")
    hands = plain.positions()[:, [plain.joints.index(side + "Hand") for side in ("Left", "Right")], 1]
    return Scene(made, folder, int(np.argmax(hands.min(axis=1))))


def png(picture: Any) -> bytes:
    """Bytes of an image (of Pillow), with few colours."""
    from PIL import Image

    out = io.BytesIO()
    picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return out.getvalue()


# ---------------------------------------------------------------- one picture each

def blender(scene: Scene, name: str) -> bytes:
    """talk.glb, imported at the defaults."""
    from PIL import Image

    target = scene.folder / "blender.png"
    run_in_blender(target, HERE / "blender_scene.py", str(scene.folder / "talk.glb"), f"{FPS:g}", str(scene.frame),
                   str(target), str(scene.folder / "blender.json"))
    drawn = Image.open(target)
    paper = Image.new("RGBA", drawn.size, PAPER)
    return png(Image.alpha_composite(paper, drawn.convert("RGBA")))


def browser(scene: Scene, name: str) -> bytes:
    """talk.glb in three.js, or talk.vrma on doll.vrm in three-vrm."""
    from PIL import Image
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))

    def serve(route: Any) -> None:
        asked = route.request.url.removeprefix("http://pictures.invalid/")
        if not asked:
            return route.fulfill(body=PAGE, content_type="text/html")
        path = ROOT / "tests" / "js" / asked if asked.startswith("node_modules/") else scene.folder / asked
        kind = "text/javascript" if path.suffix == ".js" else mimetypes.guess_type(path.name)[0]
        return route.fulfill(body=path.read_bytes(), content_type=kind or "application/octet-stream")

    with sync_playwright() as driver:
        window = driver.chromium.launch(executable_path=program, args=[
            "--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        page = window.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.set_default_timeout(180_000)
        page.route("**/*", serve)
        page.goto("http://pictures.invalid/")
        page.wait_for_function("window.ready === true")
        page.evaluate("([model, motion, time]) => play(model, motion, time)", [
            *(("doll.vrm", "talk.vrma") if name == "vrm" else ("talk.glb", None)), scene.frame / FPS])
        shot = page.screenshot()
        window.close()
    return png(Image.open(io.BytesIO(shot)))


def joints(scene: Scene, name: str) -> bytes:
    """The joints of the file as the tool counts them, at rest and in a frame."""
    from matplotlib.figure import Figure
    from PIL import Image

    tool = TOOLS[name]
    told = scene.folder / f"{name}.json"
    run_in_blender(told, HERE / "blender_scene.py", str(scene.folder / f"talk{tool.suffix}"), f"{FPS:g}",
                   str(scene.frame), "-", str(told))
    bones: dict[str, dict[str, Any]] = json.loads(told.read_text())

    def ours(place: list[float]) -> Array:  # Blender's Z up, she faces -Y
        return np.array([place[0], place[2], -place[1]])

    figure = Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_aspect("equal")
    for step in np.arange(-3, 4) * 0.25:  # the floor
        for line in (((step, 0, -0.75), (step, 0, 0.75)), ((-0.75, 0, step), (0.75, 0, step))):
            axes.plot(*_flat(np.array(line)).T, color=PALE, linewidth=0.8, zorder=0)
    for key, colour, wide in (("rest", "#b9b2a6", 1.0), ("place", INK, 2.2)):
        for bone in bones.values():
            if bone["parent"]:
                line = _flat(np.array([ours(bones[bone["parent"]][key]), ours(bone[key])]))
                axes.plot(*line.T, color=colour, linewidth=wide, solid_capstyle="round")
    corner = np.array([-0.55, 0.0, 0.75])
    for letter, row, colour in zip("XYZ", tool.rows, (RED, GREEN, BLUE), strict=True):
        start, end = _flat(np.array([corner, corner + 0.34 * np.array(row)]))
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2})
        axes.text(*(end + 0.09 * (end - start) / np.linalg.norm(end - start)), letter, color=colour, ha="center",
                  va="center", weight="bold")
    rows = np.array(tool.rows)
    for bone, text, side in (("Head", "head", 0.1), ("RightHand", "right hand", -0.06)):
        place = ours(bones[bone]["place"])
        x, y, z = rows @ place * tool.in_a_metre
        digits = 2 if tool.in_a_metre == 1.0 else 0
        at = _flat(place[None])[0]
        axes.annotate(f"{text}\n({x:.{digits}f}, {y:.{digits}f}, {z:.{digits}f}) {tool.unit}", at,
                      at + np.array([0.42 * np.sign(side), 0.16]), fontsize=8, color=INK, ha="center",
                      arrowprops={"arrowstyle": "-", "color": SOFT, "linewidth": 0.8})
    axes.text(0.02, 0.97, f"talk{tool.suffix}, {len(bones)} joints\ngrey: at rest", transform=axes.transAxes, va="top",
              fontsize=8, color=INK)
    axes.set_xlim(-1.3, 1.2)
    axes.set_ylim(-0.2, 1.88)
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return png(Image.open(out))


def _flat(places: Array) -> Array:
    """[..., 2] places of ours [..., 3], seen from ahead, a little from her left and above, without perspective."""
    turn, lean = np.radians(24.0), np.radians(9.0)
    x, y, z = places[..., 0], places[..., 1], places[..., 2]
    ahead = z * np.cos(turn) + x * np.sin(turn)
    return np.stack([x * np.cos(turn) - z * np.sin(turn), y * np.cos(lean) - ahead * np.sin(lean)], axis=-1)


PICTURES: dict[str, Callable[[Scene, str], bytes]] = {
    "blender": blender, "threejs": browser, "vrm": browser, "unity": joints, "unreal": joints, "godot": joints}
"""Name of a page -> how its picture is made."""


def main(folder: str = str(HERE / "tools"), *names: str) -> None:
    """Make all pictures, or those that are named."""
    with tempfile.TemporaryDirectory() as made:
        scene = make_scene(Path(made))
        for name in names or PICTURES:
            data = PICTURES[name](scene, name)
            write_bytes(Path(folder) / f"{name}.png", data)
            print(f"{name}.png: {len(data) / 1000:.0f} kB, frame {scene.frame}")


if __name__ == "__main__":
    main(*sys.argv[1:])
