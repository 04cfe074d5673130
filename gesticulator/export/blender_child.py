"""Run inside Blender: make a character's FBX file GLB, or an animated GLB FBX.

    python blender_child.py IN.fbx OUT.glb
    python blender_child.py IN.glb OUT.fbx FRAMES_PER_SECOND KEYS NAME [CHARACTER.fbx]

KEYS is the bound on the error of reduced keys in degrees, 0 for every frame; NAME that of the take. With a character's
FBX file, which IN.glb was made from, its own meshes and materials are written. Lines for the user are printed behind
"gesticulator: ". The script imports nothing from this package: Blender has its own Python.
"""

import datetime
import json
import os
import sys
import types
import zlib
from typing import Any

# The creation time that Blender writes into a file, fixed so that the same motion gives the same bytes.
MOMENT = datetime.datetime(2000, 1, 1)


class FixedDay(datetime.datetime):
    """A clock that always shows `MOMENT`."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> Any:
        return MOMENT


def convert(source: str, target: str, fps: float = 30.0, keys: float = 0.0, name: str = "", character: str = ""
            ) -> None:
    """Import a file into an empty scene at `fps` frames per second, and export the scene."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene: Any = bpy.context.scene
    if target.endswith(".glb"):
        import_fbx(source)
        bpy.ops.export_scene.gltf(filepath=target, export_format="GLB", export_animations=False)
        return
    whole = max(1, round(fps))
    # The importer of glTF takes the product of the two numbers for the frame rate, where it is their quotient.
    scene.render.fps, scene.render.fps_base = whole, fps / whole
    bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True, bone_heuristic="BLENDER")
    if character:
        give_actions(character)
    scene.render.fps, scene.render.fps_base = whole, whole / fps  # the importer of FBX sets that of the file
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_start, scene.frame_end = 0, max(1, round(max(ends, default=1)))
    scene.name = name or "gesture"
    export_fbx(target, keys)
    compare_materials(source, target)


def import_fbx(source: str) -> None:
    """Import an FBX file without its animations, in the pose that the mesh was bound in."""
    import bpy
    from io_scene_fbx import import_fbx as importer  # type: ignore[import-not-found, unused-ignore]

    # Lights are not used, and the importer of Blender 5.0 stumbles over them.
    importer.blen_read_light = lambda *_: bpy.data.lights.new("light", "POINT")
    if not hasattr(importer, "read_material"):  # once in a process
        importer.read_material = importer.blen_read_material
    importer.blen_read_material = lambda *given: with_products(importer, *given)
    bpy.ops.import_scene.fbx(filepath=source, use_anim=False)
    make_opaque({material: shader.inputs["Alpha"] for material, shader in shaders().items()})
    # A file may stand otherwise, with bones moved and scaled; what no key of ours sets would tear the mesh.
    for thing in bpy.data.objects:
        for bone in thing.pose.bones if thing.type == "ARMATURE" else ():
            bone.matrix_basis.identity()


def with_products(importer: Any, template: Any, entry: Any, settings: Any) -> Any:
    """A material with the transparency and the metalness that FBX means, which are products of a factor and a colour.
    Blender takes either alone; templates of other programs have factors of 1 beside black colours."""
    material = importer.read_material(template, entry, settings)
    wrap = settings.nodal_material_wrap_map[material]
    alone = importer.elem_find_first(entry, b"Properties70"), importer.fbx_elem_nil
    both = alone[0], importer.elem_find_first(template, b"Properties70", importer.fbx_elem_nil)

    def product(factor: bytes, colour: bytes) -> float:
        colours = importer.elem_props_get_color_rgb(both, colour, (0.0, 0.0, 0.0))
        return float(importer.elem_props_get_number(both, factor, 0.0) * max(colours))

    if wrap.alpha == 0.0 and importer.elem_props_get_number(alone, b"Opacity", None) is None:
        wrap.alpha = max(1.0 - product(b"TransparencyFactor", b"TransparentColor"), 0.0)
    if product(b"ReflectionFactor", b"ReflectionColor") == 0.0:
        wrap.metallic = 0.0
    return material


def shaders() -> dict[Any, Any]:
    """Material -> its node with the base colour."""
    import bpy

    nodes = {material: material.node_tree.nodes for material in bpy.data.materials if material.node_tree}
    return {material: node for material, some in nodes.items() for node in some if node.type == "BSDF_PRINCIPLED"}


COLOURED, HALF = 0.02, 0.5
"""Mean difference of a picture's channels above which it is no mask; share of half transparent points above which its
alpha channel is no transparency, but a mask of something else."""


def make_opaque(sockets: dict[Any, Any]) -> None:
    """Undo transparency that is a mistake: pictures in colour or masks of something else that were taken for it, and
    materials that would all be invisible. sockets: material -> its alpha."""
    import numpy as np

    for material, socket in sockets.items():
        for link in [link for link in socket.links if link.from_node.type == "TEX_IMAGE"]:
            pixels, node = pixels_of(link.from_node.image), link.from_node
            alpha, of_colour = pixels[:, 3], link.from_socket.name == "Color"
            if of_colour and np.ptp(pixels[:, :3], axis=1).mean() > COLOURED:
                # Its own alpha channel was meant, if it has one.
                material.node_tree.links.new(node.outputs["Alpha"], socket)
            elif of_colour:
                continue
            if alpha.min() == 1.0 or np.mean((alpha > 0.1) & (alpha < 0.9)) > HALF:
                material.node_tree.links.remove(socket.links[0])
                socket.default_value = 1.0
    invisible = [material for material, socket in sockets.items() if not socket.links and socket.default_value == 0.0]
    if invisible and len(invisible) == len(sockets):
        print("gesticulator: all of its materials are transparent, and are made opaque")
        for material in invisible:
            sockets[material].default_value = 1.0


def pixels_of(image: Any) -> Any:
    """[P, 4] colours of some points of a picture; opaque black ones of a missing one."""
    import bpy
    import numpy as np

    if image is None or not all(image.size):
        return np.array([[0.0, 0.0, 0.0, 1.0]])
    small = image.copy()
    small.scale(*(min(side, 64) for side in image.size))
    pixels = np.empty(len(small.pixels), np.float32)
    small.pixels.foreach_get(pixels)
    bpy.data.images.remove(small)
    return pixels.reshape(-1, 4)


def give_actions(character: str) -> None:
    """Replace the scene by that of a character's FBX file, whose objects take the actions of those of their names."""
    import bpy

    actions = {name: owner.animation_data.action for name, owner in animated() if owner.animation_data is not None}
    for things in (bpy.data.objects, bpy.data.meshes, bpy.data.armatures, bpy.data.materials, bpy.data.images):
        bpy.data.batch_remove(list(things))
    import_fbx(character)
    for name, owner in animated():
        if actions.get(name) is not None:
            moved = owner.animation_data_create()
            moved.action = actions[name]
            if getattr(moved, "action_suitable_slots", ()) and moved.action_slot is None:  # since Blender 4.4
                moved.action_slot = moved.action_suitable_slots[0]
        for bone in owner.pose.bones if hasattr(owner, "pose") else ():
            bone.rotation_mode = "QUATERNION"


def animated() -> list[tuple[str, Any]]:
    """What actions move, with its name: armatures, and the shape keys of meshes."""
    import bpy

    # The importer of glTF renames the objects of skinned meshes, not the meshes.
    return [*((thing.name, thing) for thing in bpy.data.objects if thing.type == "ARMATURE"),
            *((mesh.name, mesh.shape_keys) for mesh in bpy.data.meshes if mesh.shape_keys is not None)]


def export_fbx(target: str, keys: float) -> None:
    """Export the scene with its animation, with keys that linear interpolation needs within `keys` degrees."""
    import bpy
    from io_scene_fbx import encode_bin, export_fbx_bin  # type: ignore[import-not-found, unused-ignore]

    # Blender packs arrays as fast as it can; meshes and the times of keys become a little smaller.
    encode_bin.zlib = types.SimpleNamespace(compress=lambda data, *_: zlib.compress(data, 9))
    export_fbx_bin.datetime = types.SimpleNamespace(datetime=FixedDay)
    export_fbx_bin.AnimationCurveNodeWrapper.simplify = lambda curves, *_: reduce_keys(curves, keys)
    if not hasattr(export_fbx_bin, "all_animations"):  # once in a process
        export_fbx_bin.all_animations = export_fbx_bin.fbx_animations
    export_fbx_bin.fbx_animations = lambda data: without_modifiers(export_fbx_bin.all_animations, data)
    bpy.ops.export_scene.fbx(
        filepath=target, object_types={"ARMATURE", "MESH", "EMPTY"}, add_leaf_bones=False,
        # Metres stay metres: other tools find scale 1 on the armature.
        apply_scale_options="FBX_SCALE_ALL", axis_forward="-Z", axis_up="Y",
        bake_anim=True, bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False, bake_anim_step=1.0,
        bake_anim_simplify_factor=0.0, path_mode="COPY", embed_textures=True)


def compare_materials(source: str, target: str) -> None:
    """Print which materials of an FBX file differ, as Blender reads them, from those of the GLB that it is made of."""
    import bpy

    with open(source, "rb") as file:  # the first chunk of a GLB is its JSON
        head = file.read(20)
        wanted = json.loads(file.read(int.from_bytes(head[12:16], "little"))).get("materials", [])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=target, use_anim=False)
    written = {material.name: shader.inputs for material, shader in shaders().items()}
    odd: dict[str, list[str]] = {}
    for entry in wanted:
        inputs, plain = written.get(entry.get("name")), entry.get("pbrMetallicRoughness", {})
        if inputs is None:
            continue
        *colour, alpha = plain.get("baseColorFactor", [1.0] * 4)
        metal = "metallicRoughnessTexture" in plain or plain.get("metallicFactor", 1.0)
        base = inputs["Base Color"]
        clear = not inputs["Alpha"].links and inputs["Alpha"].default_value < 0.01
        if clear and (alpha > 0.01 or entry.get("alphaMode", "OPAQUE") == "OPAQUE"):
            odd.setdefault("are wholly transparent", []).append(entry["name"])
        if bool(base.links) != ("baseColorTexture" in plain) or (not base.links and max(
                abs(a - b) for a, b in zip(colour, base.default_value, strict=False)) > COLOURED):
            odd.setdefault("have another base colour", []).append(entry["name"])
        if metal is not True and abs(metal - inputs["Metallic"].default_value) > COLOURED:
            odd.setdefault("have another metalness", []).append(entry["name"])
    for what, names in odd.items():
        print(f"gesticulator: {len(names)} materials {what} in FBX: {', '.join(names[:3])}")


def without_modifiers(bake: Any, data: Any) -> Any:
    """Bake the bones' motion while meshes are not deformed: that took nearly all of the time, and is not used."""
    import bpy

    shown = [modifier for thing in bpy.data.objects for modifier in thing.modifiers if modifier.show_viewport]
    try:
        for modifier in shown:
            modifier.show_viewport = False
        return bake(data)
    finally:
        for modifier in shown:
            modifier.show_viewport = True


METRES_PER_DEGREE = 0.005
"""Bound on the error of translations per degree of the bound on rotations."""
SHARE = 5.0 ** -0.5
"""Bound on each angle of a rotation as a share of that on the rotation. Two of the three axes may be parallel, so that
the errors x, y and z make the angle (y^2 + (x + z)^2)^(1/2) at most."""


def reduce_keys(curves: Any, keys: float) -> None:
    """Choose the keys of the curves X, Y, Z of a property: none where it stays at its default, else the fewest found
    that keep it within its bound."""
    import numpy as np

    values = curves._frame_values_array
    if values is None:
        return
    turns = curves.fbx_group[0] == "Lcl Rotation"
    rests = np.array(curves.default_values)[:, None]
    still = np.abs(values - rests).max() < (1e-4 if turns else 1e-5)
    masks = curves._frame_write_mask_array
    masks[:] = not still
    if not keys or still:
        return
    for row, mask in zip(values, masks, strict=True):
        mask[:] = needed(row, keys * (SHARE if turns else METRES_PER_DEGREE / 2.0))


def needed(row: Any, bound: float) -> Any:
    """[T] which values of a curve need a key: added where the error is the greatest until none is beyond the bound."""
    import numpy as np

    has_key = np.zeros(len(row), dtype=bool)
    has_key[[0, -1]] = True
    frames = np.arange(len(row))
    while True:
        # Ramer, Douglas and Peucker, all segments of a curve in one step.
        at = np.flatnonzero(has_key)
        off = np.abs(np.interp(frames, at, row[at]) - row)
        worst = np.maximum.reduceat(off, at)
        bad = worst > bound
        if not bad.any():
            return has_key
        segment = np.cumsum(has_key) - 1
        has_key |= bad[segment] & (off == worst[segment])


if __name__ == "__main__":
    # Blender passes the arguments after "--"; a Python with bpy passes all.
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    # Omitted arguments take the defaults of `convert`.
    numbers = [float(number) for number in given[2:4]] + [30.0, 0.0][len(given[2:4]):]
    convert(given[0], given[1], numbers[0], numbers[1], *given[4:])
    # The file is complete; Blender as a Python module may crash while it is torn down.
    sys.stdout.flush()
    os._exit(0)
