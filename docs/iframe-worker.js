// Pages that are opened from a disk may not start a web worker, which the search needs: run it in a hidden frame instead.
// The plugin `offline` looks for "iframe-worker" among the polyfills and would load one from another host otherwise.
if (location.protocol === "file:") {
  window.IFrameWorker = window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      this.loaded = new Promise((resolve) => frame.addEventListener("load", () => resolve(frame.contentWindow)));
      // What the worker sends goes to this object; what is sent to it arrives as a message event of the frame's window.
      frame.srcdoc = "<!doctype html><title>search</title>";
      document.documentElement.append(frame);
      this.ready = this.loaded.then((inside) => new Promise((resolve, reject) => {
        inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
        const script = inside.document.createElement("script");
        script.src = address;
        script.addEventListener("load", () => resolve(inside));
        script.addEventListener("error", reject);
        inside.document.body.append(script);
      }));
    }

    postMessage(data) {
      this.ready.then((inside) => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
    }
  };
}
