// The way to the server. The socket belongs to a worker (worker.js), so that messages go in time although
// the page may be busy; a message goes now or never, nothing is kept for later.

const SILENT = 1000; // ms after which a server that says nothing counts as gone

export class Link {
  // told: what the server says, or null; slow: the page let a quarter of a second pass with the dead-man held
  constructor(path, station, told, slow) {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const address = `${scheme}//${location.host}${path}?station=${encodeURIComponent(station)}`;
    this.opened = this.late = false;
    this.heard = performance.now();
    this.worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    this.worker.onmessage = ({ data }) => {
      if ("open" in data) this.opened = data.open;
      if ("late" in data) {
        this.late = data.late;
        if (data.late) slow();
      }
      if (!("status" in data)) return;
      this.heard = performance.now();
      told(data.status);
    };
    this.worker.postMessage({ address });
  }

  alive() {
    return this.opened && performance.now() - this.heard < SILENT;
  }

  send(sticks, held) {
    this.worker.postMessage({ sticks, held });
  }

  // nothing to say: this page does not drive, or is not seen
  quiet() {
    this.worker.postMessage({ quiet: true });
  }

  close() {
    this.worker.terminate();
  }
}
