// Follows the timeline of viser: its slider tells the time, and its field of the time takes one.
(function () {
  const data = JSON.parse(document.getElementById("alula-data").textContent);
  const at = id => document.getElementById("alula-" + id), root = document.getElementById("alula");
  const flights = data.flights, colors = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];
  if (window.innerWidth < 640) at("head").open = false;
  for (const [name, color] of Object.entries(data.legend)) {
    const item = document.createElement("span"), dot = document.createElement("i");
    dot.style.background = color; item.append(dot, name); at("legend").append(item);
  }
  if (window.self === window.top || window.alulaNote) at("notes").textContent = data.notes.concat(window.alulaNote || []).join("; ");
  if (window.alulaFlat) {  // nothing plays: a picture, and what became of the first flight
    at("still").hidden = false;
    if (flights.length) at("words").textContent = flights[0].label + " " + flights[0].words;
    return;
  }
  // A browser without a GPU draws little and slowly: first it shows the picture.
  const drawnBefore = Boolean(window.alulaNote && at("still").querySelector("img"));
  const turn = () => { at("still").hidden = true; };
  if (drawnBefore) {
    const button = document.createElement("button");
    button.textContent = "show it in 3D"; button.onclick = turn;
    at("why").textContent = "In three dimensions this page draws " + window.alulaNote + ". ";
    at("why").append(button); at("still").hidden = false;
    window.addEventListener("pointerdown", event => {
      if (![at("head"), at("still")].some(part => part.contains(event.target))) turn();
    }, true);
  }
  if (!flights.length) return;
  root.classList.remove("no-plots");
  const choice = document.createElement("select");
  choice.setAttribute("aria-label", "Flight, the worst first");
  flights.forEach((f, i) => choice.append(new Option(f.label + ": " + f.outcome, i)));
  const toggle = document.createElement("button");
  toggle.textContent = "plots"; toggle.style.cssText = "font:inherit;margin-left:6px";
  toggle.onclick = () => root.classList.toggle("no-plots");
  at("choice").append(choice, toggle);

  const time = () => {
    const slider = document.querySelector('[role="slider"]');
    return slider ? parseFloat(slider.getAttribute("aria-valuenow")) || 0 : null;
  };
  const seek = t => {
    const slider = document.querySelector('[role="slider"]');
    if (!slider) return;
    let bar = slider; while (bar && !bar.querySelector("input[type=text], input:not([type])")) bar = bar.parentElement;
    const field = bar && bar.querySelector("input[type=text], input:not([type])");
    if (!field) return;
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(field, Math.max(0, t).toFixed(2));
    field.dispatchEvent(new Event("input", { bubbles: true }));
  };
  choice.onchange = () => { turn(); seek(flights[choice.value].begin + 0.01); };
  window.alulaSeek = seek; window.alulaTime = time;

  let shown = -1, canvases = [];
  const show = i => {
    shown = i; choice.value = i;
    const f = flights[i], plots = at("plots");
    at("words").textContent = f.label + " " + f.words;
    at("words").style.borderLeft = "4px solid " + f.color; at("words").style.paddingLeft = "6px";
    plots.textContent = ""; canvases = f.plots.map(() => document.createElement("canvas"));
    plots.append(...canvases);
    if (!f.plots.length) root.classList.add("no-plots");
  };
  const draw = (f, t) => canvases.forEach((canvas, k) => {
    const plot = f.plots[k], ratio = window.devicePixelRatio || 1;
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w) return;
    if (canvas.width !== Math.round(w * ratio)) { canvas.width = w * ratio; canvas.height = h * ratio; }
    const pen = canvas.getContext("2d"), style = getComputedStyle(root);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, w, h);
    const values = plot.curves.flatMap(c => c.v.filter(v => v !== null));
    if (plot.limit !== null) values.push(plot.limit);
    let low = Math.min(...values), high = Math.max(...values);
    if (!(high > low)) { low = Math.min(0, low); high = Math.max(high, low + 1); }
    const pad = 0.06 * (high - low), left = 42, right = 8, top = 20, bottom = 6;
    low -= pad; high += pad;
    const end = Math.max(f.end - f.begin, 1e-6);
    const x = s => left + (w - left - right) * s / end, y = v => h - bottom - (h - top - bottom) * (v - low) / (high - low);
    pen.font = "11px system-ui, sans-serif"; pen.fillStyle = style.getPropertyValue("--ink");
    const wide = text => pen.measureText(text).width, many = plot.curves.length > 1 ? plot.curves : [];
    const room = w - left - many.reduce((sum, c) => sum + wide(c.label) + 8, 10);
    const name = wide(plot.name) > room ? plot.name.split(/[:[]/)[0].trim() : plot.name;
    pen.fillText(name, left, 13);
    let words = left + wide(name) + 10;
    pen.strokeStyle = style.getPropertyValue("--line"); pen.strokeRect(left, top, w - left - right, h - top - bottom);
    pen.fillStyle = style.getPropertyValue("--soft"); pen.textAlign = "right";
    for (const v of [low + pad, high - pad]) pen.fillText(v && Math.abs(v) < 0.01 ? v.toExponential(0) : v.toPrecision(2), left - 4, y(v) + 4);
    pen.textAlign = "left"; pen.save(); pen.beginPath(); pen.rect(left, top, w - left - right, h - top - bottom); pen.clip();
    const line = (x0, y0, x1, y1) => { pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x1, y1); pen.stroke(); };
    if (plot.limit !== null) { pen.setLineDash([4, 3]); pen.strokeStyle = "#d7301f"; line(left, y(plot.limit), w, y(plot.limit)); pen.setLineDash([]); }
    pen.strokeStyle = style.getPropertyValue("--soft"); pen.setLineDash([2, 3]); line(x(f.worst), top, x(f.worst), h); pen.setLineDash([]);
    plot.curves.forEach((c, i) => {
      pen.strokeStyle = colors[i % 6]; pen.lineWidth = 1.5; pen.setLineDash(i % 2 ? [6, 3] : []); pen.beginPath();
      let on = false;
      c.t.forEach((s, j) => { if (c.v[j] === null) { on = false; return; } on ? pen.lineTo(x(s), y(c.v[j])) : pen.moveTo(x(s), y(c.v[j])); on = true; });
      pen.stroke();
    });
    pen.setLineDash([]); pen.strokeStyle = style.getPropertyValue("--mark"); pen.lineWidth = 2; line(x(t), top, x(t), h);
    pen.restore();
    many.forEach((c, i) => {
      pen.fillStyle = colors[i % 6]; pen.fillText(c.label, words, 13); words += wide(c.label) + 8;
    });
    pen.lineWidth = 1;
  });
  const value = (f, t) => f.plots.map(plot => plot.curves.map(c => {
    let j = c.t.findIndex(s => s > t); j = j < 0 ? c.t.length - 1 : Math.max(0, j - 1);
    return (c.label === plot.name.split(" ")[0] ? "" : c.label + " ") + (c.v[j] === null ? "–" : c.v[j].toFixed(2)) + " " + (plot.name.match(/\[(.*)\]/) || ["", ""])[1];
  }).join(", ")).slice(0, 2).join("; ");
  let before = null, isBegun = window.parent === window && !drawnBefore;
  const step = () => {
    const t = time();
    if (t !== null && !isBegun) { // in a report, and behind the picture, it rests at the worst moment, until somebody presses play
      isBegun = true; seek(flights[0].begin + Math.max(0.01, flights[0].worst));
    }
    if (t === null || (t === before && canvases.length && canvases[0].width === Math.round(canvases[0].clientWidth * (window.devicePixelRatio || 1)))) return;
    before = t;
    let i = flights.findIndex(f => t <= f.end + 1); if (i < 0) i = flights.length - 1;
    if (i !== shown) show(i);
    const f = flights[i], own = Math.min(Math.max(t - f.begin, 0), f.end - f.begin);
    const spell = f.status.filter(s => s[0] <= own).pop();
    at("now").textContent = own.toFixed(1) + " s; " + value(f, own) + (spell && spell[1] ? "; filter: " + spell[1] : "");
    draw(f, own);
    if (window.parent !== window) window.parent.postMessage({ alula: "time", run: f.run, trial: f.trial, time: f.from + own }, "*");
  };
  window.addEventListener("message", event => { // from the report around this page
    const asked = event.data;
    if (event.source !== window.parent || window.parent === window || !asked || asked.alula !== "seek") return;
    const f = flights.find(one => one.run === asked.run && one.trial === asked.trial);
    if (f) turn();
    if (f) seek(f.begin + Math.min(Math.max(asked.time - f.from, 0), f.end - f.begin));
  });
  at("plots").onclick = event => {
    const canvas = event.target.closest("canvas"), f = flights[shown];
    if (!canvas || !f) return;
    turn();
    const box = canvas.getBoundingClientRect();
    seek(f.begin + Math.min(1, Math.max(0, (event.clientX - box.left - 42) / (box.width - 50))) * (f.end - f.begin));
  };
  window.addEventListener("keydown", event => {
    if (/INPUT|SELECT|TEXTAREA/.test(event.target.tagName) || time() === null) return;
    turn();
    if (event.key === "ArrowRight" || event.key === "ArrowLeft") {
      seek(time() + (event.key === "ArrowRight" ? 0.5 : -0.5)); event.preventDefault();
    }
    if (event.key === "n" || event.key === "p") {
      const i = Math.min(flights.length - 1, Math.max(0, shown + (event.key === "n" ? 1 : -1)));
      seek(flights[i].begin + 0.01);
    }
  });
  setInterval(step, 80);
})();
