/* Search in pages opened from the disk: browsers start no worker from a file, so its script runs in a hidden frame. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      this.waiting = [];
      const start = () => {
        const inside = frame.contentWindow;
        inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
        inside.importScripts = () => Promise.reject(new Error("one language only"));
        const script = inside.document.createElement("script");
        script.src = url;
        script.onload = () => {
          this.send = (data) => inside.dispatchEvent(new inside.MessageEvent("message", { data }));
          this.waiting.forEach((data) => this.send(data));
        };
        inside.document.body.appendChild(script);
      };
      document.body.appendChild(frame); // the theme starts it at the end of the page
      start();
    }

    postMessage(data) {
      if (this.send) this.send(data);
      else this.waiting.push(data);
    }
  };
}
