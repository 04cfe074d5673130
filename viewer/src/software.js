// Whether the processor draws the pictures, where there is no GPU: it draws a tenth as many triangles in the same time.

/** The names that browsers give it. */
const NAMES = /swiftshader|llvmpipe|softpipe|software|basic render/i;
let known = null;

/** Whether the processor draws; false where nothing can be drawn. */
export function processorDraws() {
  if (known !== null) return known;
  const gl = document.createElement("canvas").getContext("webgl2");
  const told = gl?.getExtension("WEBGL_debug_renderer_info");
  known = Boolean(gl) && NAMES.test(String(gl.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER)));
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return known;
}
