// GLB, the binary form of glTF 2.0: read in its two parts, add an animation, write. Metres; quaternions w last.

const MAGIC = 0x46546c67, JSON_CHUNK = 0x4e4f534a, BIN_CHUNK = 0x004e4942, FLOAT = 5126;
const KINDS = { 1: "SCALAR", 3: "VEC3", 4: "VEC4" };

export class Glb {
  constructor(document, binary = new Uint8Array(0)) {
    this.document = document;
    this.parts = [binary];
    this.length = binary.length;
  }

  static read(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    let document = null, binary = new Uint8Array(0), at = 12;
    while (at + 8 <= bytes.length) {
      const size = view.getUint32(at, true), kind = view.getUint32(at + 4, true), chunk = bytes.subarray(at + 8, at + 8 + size);
      if (kind === JSON_CHUNK) document ??= JSON.parse(new TextDecoder().decode(chunk));
      else if (kind === BIN_CHUNK) binary = chunk;
      at += 8 + size;
    }
    return new Glb(document, binary);
  }

  added(list, entry) {
    return (this.document[list] ??= []).push(entry) - 1;
  }

  /** Add numbers, `width` to an entry; the accessor's index. bounds: tell the lowest and highest, as times must. */
  accessor(values, width, bounds = false) {
    const pad = -this.length & 3;
    this.parts.push(new Uint8Array(pad), new Uint8Array(values.buffer, values.byteOffset, values.byteLength));
    const bufferView = this.added("bufferViews", { buffer: 0, byteOffset: this.length + pad, byteLength: values.byteLength });
    this.length += pad + values.byteLength;
    const accessor = { bufferView, componentType: FLOAT, count: values.length / width, type: KINDS[width] };
    if (bounds) Object.assign(accessor, { min: [values[0]], max: [values.at(-1)] });
    return this.added("accessors", accessor);
  }

  /** Add an animation. tracks: [{ node, path: "rotation" or "translation", values }]. */
  animate(name, times, tracks) {
    const input = this.accessor(times, 1, true), samplers = [], channels = [];
    for (const { node, path, values } of tracks) {
      const output = this.accessor(values, path === "rotation" ? 4 : 3);
      channels.push({ sampler: samplers.push({ input, output }) - 1, target: { node, path } });
    }
    this.added("animations", { name, samplers, channels });
  }

  bytes() {
    const pad = -this.length & 3, binary = this.length + pad;
    (this.document.buffers ??= [{}])[0].byteLength = binary;
    let text = new TextEncoder().encode(JSON.stringify(this.document));
    const spaces = -text.length & 3;
    text = Uint8Array.from([...text, ...Array(spaces).fill(32)]);
    const out = new Uint8Array(12 + 8 + text.length + 8 + binary), view = new DataView(out.buffer);
    [MAGIC, 2, out.length, text.length, JSON_CHUNK].forEach((word, k) => view.setUint32(4 * k, word, true));
    out.set(text, 20);
    let at = 20 + text.length;
    view.setUint32(at, binary, true);
    view.setUint32(at + 4, BIN_CHUNK, true);
    at += 8;
    for (const part of this.parts) { out.set(part, at); at += part.length; }
    return out;
  }
}
