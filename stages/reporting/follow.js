// Shows the time of the 3D view in the curves of its flight; a click in them goes to a time. The page needs none of it.
(function () {
  const frame = document.querySelector("iframe");
  const charts = [...document.querySelectorAll("figure[data-time]")].map(figure => {
    const svg = figure.querySelector("svg"), view = svg.viewBox.baseVal, axis = JSON.parse(figure.dataset.time);
    const mark = document.createElementNS("http://www.w3.org/2000/svg", "line");
    mark.setAttribute("class", "now");
    mark.setAttribute("y1", view.y + view.height * axis.top);
    mark.setAttribute("y2", view.y + view.height * axis.bottom);
    svg.append(mark);
    svg.style.cursor = "crosshair";
    svg.addEventListener("click", event => {
      const box = svg.getBoundingClientRect(), at = (event.clientX - box.left) / box.width;
      const part = Math.min(1, Math.max(0, (at - axis.left) / (axis.right - axis.left)));
      const time = axis.begin + part * (axis.end - axis.begin);
      frame.contentWindow.postMessage({ alula: "seek", run: axis.run, trial: axis.trial, time }, "*");
    });
    const show = now => {
      const part = (now.time - axis.begin) / (axis.end - axis.begin);
      const isShown = now.run === axis.run && now.trial === axis.trial && part >= 0 && part <= 1;
      mark.style.display = isShown ? "inline" : "none";
      const x = view.x + view.width * (axis.left + part * (axis.right - axis.left));
      if (isShown) for (const end of ["x1", "x2"]) mark.setAttribute(end, x);
    };
    return show;
  });
  window.addEventListener("message", event => {
    if (event.source !== frame.contentWindow || !event.data || event.data.alula !== "time") return;
    for (const show of charts) show(event.data);
  });
})();
