// Runs before viser's code.
(function () {
  // three.js complains about the quads of viser's Gaussians, whose corners have two coordinates.
  const complain = console.error.bind(console);
  console.error = (...words) => {
    if (!/computeBoundingSphere\(\): Computed radius is NaN/.test(words.join(" "))) complain(...words);
  };
  // viser decodes a picture of its own surroundings before the page says that it has none: seconds without a GPU.
  const load = window.fetch.bind(window);
  window.fetch = (what, ...rest) =>
    /^data:image\/jpeg/.test(what.url || what) ? new Promise(() => {}) : load(what, ...rest);
  // viser's fields take the focus whenever their value changes, and a page around this one scrolls to it: only a
  // person gives a field the focus.
  for (const name of ["focus", "setSelectionRange"]) {
    const act = HTMLInputElement.prototype[name];
    HTMLInputElement.prototype[name] = function (...words) {
      if (document.activeElement === this) act.apply(this, words);
    };
  }
  // Options of viser in the address of the page.
  const options = {}, get = URLSearchParams.prototype.get;
  URLSearchParams.prototype.get = function (name) { return name in options ? options[name] : get.call(this, name); };
  const narrow = 1.2 * window.innerHeight / Math.max(1, window.innerWidth); // with room for what stands at the sides
  if (narrow > 1) { // the camera's field is that of the height: go back until the width holds the same
    const camera = window.alulaCamera;
    options.initialCameraPosition = camera.position.map((x, i) => camera.look_at[i] + narrow * (x - camera.look_at[i])).join();
  }
  let name = "none";
  try {
    const gl = document.createElement("canvas").getContext("webgl2"), info = gl.getExtension("WEBGL_debug_renderer_info");
    name = gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    gl.getExtension("WEBGL_lose_context").loseContext();
  } catch (error) { window.alulaFlat = name === "none"; }
  const hasGpu = !/swiftshader|llvmpipe|softpipe|software|basic render|^none$/i.test(name);
  if (!hasGpu) { // one sample for each pixel, and at most so many pixels
    const MOST_PIXELS = 300000, context = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, options) {
      return context.call(this, kind, /^webgl/.test(kind) ? { ...options, antialias: false } : options);
    };
    const ratio = Math.min(1, Math.sqrt(MOST_PIXELS / Math.max(1, window.innerWidth * window.innerHeight)));
    options.fixedDpr = ratio.toFixed(2); // pixels of the canvas per pixel of the page
  }
  window.alulaDraws = (few, words, many) => {
    if (hasGpu) return many;
    window.alulaNote = words;
    return few;
  };
})();
