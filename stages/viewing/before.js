// Runs before viser's code.
(function () {
  // three.js complains about the quads of viser's Gaussians, whose corners have two coordinates.
  const complain = console.error.bind(console);
  console.error = (...words) => {
    if (!/computeBoundingSphere\(\): Computed radius is NaN/.test(words.join(" "))) complain(...words);
  };
  let name = "none";
  try {
    const gl = document.createElement("canvas").getContext("webgl2"), info = gl.getExtension("WEBGL_debug_renderer_info");
    name = gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    gl.getExtension("WEBGL_lose_context").loseContext();
  } catch (error) { window.alulaFlat = name === "none"; }
  window.alulaDraws = (few, fewCount, many, count) => {
    if (!/swiftshader|llvmpipe|softpipe|software|basic render|^none$/i.test(name)) return many;
    window.alulaNote = fewCount.toLocaleString("en") + " of " + count.toLocaleString("en") + " Gaussians, because this browser draws without a GPU";
    return few;
  };
})();
