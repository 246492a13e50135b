// Measures between two Gaussians that are clicked. Runs before viser's code: three.js announces its scenes to the
// developer tools, and the meshes of Gaussians in them hold all centres and the camera that draws them.
(function () {
  const scenes = [], tools = window.__THREE_DEVTOOLS__ || new EventTarget();
  tools.addEventListener("observe", event => { if (event.detail && event.detail.isScene) scenes.push(event.detail); });
  window.__THREE_DEVTOOLS__ = tools;

  const meshes = () => {
    const found = [];
    for (const scene of scenes) scene.traverse(one => {
      const uniforms = one.material && one.material.uniforms;
      if (uniforms && uniforms.textureBuffer && uniforms.textureBuffer.value && uniforms.textureT_camera_groups) found.push(one);
    });
    return found;
  };
  // Centre of a Gaussian in the frame of the camera, whose units are those of the scene.
  const centre = (mesh, i) => {
    const uniforms = mesh.material.uniforms, words = uniforms.textureBuffer.value.image.data;
    const p = new Float32Array(words.buffer, words.byteOffset + 32 * i, 3), m = 12 * words[8 * i + 3];
    const T = uniforms.textureT_camera_groups.value.image.data;
    return [0, 4, 8].map(row => T[m + row] * p[0] + T[m + row + 1] * p[1] + T[m + row + 2] * p[2] + T[m + row + 3]);
  };
  // The Gaussian nearest to the camera of those whose centres are drawn within 8 pixels, or else the one whose
  // centre is drawn nearest to the pointer; null beyond 40 pixels.
  const pick = (x, y, canvas) => {
    const box = canvas.getBoundingClientRect();
    let best = null;
    for (const mesh of meshes()) {
      const uniforms = mesh.material.uniforms, P = uniforms.projectionMatrixCustom.value.elements;
      for (let i = 0; i < uniforms.numGaussians.value; i++) {
        const [cx, cy, cz] = centre(mesh, i);
        if (cz >= 0) continue;
        const sx = (P[0] * cx + P[8] * cz) / -cz, sy = (P[5] * cy + P[9] * cz) / -cz;
        const off = Math.hypot(box.left + (sx + 1) / 2 * box.width - x, box.top + (1 - sy) / 2 * box.height - y);
        if (off > 40) continue;
        const cost = off <= 8 ? 1 / cz : off;
        if (!best || cost < best.cost) best = { cost, mesh, i };
      }
    }
    return best;
  };

  document.addEventListener("DOMContentLoaded", () => {
    const head = document.getElementById("alula-head");
    if (!head) return;
    const line = document.createElement("p"), button = document.createElement("button"), words = document.createElement("span");
    line.id = "alula-measure"; line.hidden = true; button.textContent = "measure"; button.style.cssText = "font:inherit;margin-right:6px";
    line.append(button, words); head.append(line);
    let points = null, down = null;
    const say = text => { words.textContent = text; };
    button.onclick = () => { points = points ? null : []; say(points ? "click one end of a length" : ""); };
    const waiting = setInterval(() => { if (meshes().length) { line.hidden = false; clearInterval(waiting); } }, 300);
    window.addEventListener("pointerdown", event => { down = [event.clientX, event.clientY]; }, true);
    window.addEventListener("pointerup", event => {
      const canvas = event.target;
      if (!points || !down || !(canvas instanceof HTMLCanvasElement) || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
      const found = pick(event.clientX, event.clientY, canvas);
      if (!found) return say("no Gaussian there; click one end of a length");
      if (points.length === 2) points = [];
      points.push(found);
      if (points.length === 1) return say("click the other end");
      const [one, other] = points.map(each => centre(each.mesh, each.i));
      say("distance " + Math.hypot(...one.map((c, k) => c - other[k])).toFixed(4));
    }, true);
  });
})();
